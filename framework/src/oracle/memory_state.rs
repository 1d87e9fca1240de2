//! Walks the prologue, the handover and the frames, as they are submitted to one queue.
//!
//! An access that violates the model takes place all the same, so that one mistake is reported once.

use super::Replay;
use super::cell::{Cell, Conflict, Contents, Read, Scope, State, Write};
use super::stages::Pairs;
use super::trace::{Access, Clash, Trace};
use super::violation::{Actor, Findings, Missing, Violation, ViolationKind, When};
use crate::ir::{Accesses, Layout, PassId, ResourceId, Shape, Stages, Work};
use crate::plan::{Barrier, Plan, Step, Transition};

/// Holds the state of all memory and of all image layouts during a replay.
pub struct MemoryState {
    cells: Vec<Cell>,
    /// The layout of each resource; meaningless for buffers.
    layouts: Vec<Layout>,
    /// Passes that are skipped because a former plan did their work.
    skipped: Vec<PassId>,
    /// Counts passes, calls of barriers and preparations by the host.
    time: u32,
    copies: u32,
    /// The barriers of the current call; kept to reuse the allocation.
    scopes: Vec<Scope>,
    pub findings: Findings,
}

/// Carries a resource with a history over to the next plan.
pub struct Carried {
    name: String,
    shape: Shape,
    layout: Layout,
    contents: bool,
}

impl MemoryState {
    /// Creates the state of fresh memory.
    pub fn new(trace: &Trace, first_only: bool) -> MemoryState {
        let mut memory = MemoryState {
            cells: vec![Cell::FRESH; trace.cells.len()],
            layouts: vec![Layout::Undefined; trace.places.len()],
            skipped: Vec::new(),
            time: 0,
            copies: 1,
            scopes: Vec::new(),
            findings: Findings { violations: Vec::new(), first_only },
        };
        memory.reset(trace);
        memory
    }

    /// Restores the state that [`MemoryState::new`] returns.
    pub fn reset(&mut self, trace: &Trace) {
        self.cells.iter_mut().for_each(Cell::reset);
        self.layouts.fill(Layout::Undefined);
        self.skipped.clear();
        self.findings.violations.clear();
        for (index, place) in trace.places.iter().enumerate().filter(|(_, place)| place.uploaded) {
            self.fill(place.cells(0), ResourceId(index as u32));
        }
    }

    /// Marks cells as written before the plan and visible everywhere.
    fn fill(&mut self, cells: std::ops::Range<usize>, resource: ResourceId) {
        for cell in &mut self.cells[cells] {
            cell.contents = Contents { state: State::Written(resource), by: None };
        }
    }

    /// Adopts the resources that a former plan carries over. They need no records: the barrier on everything between the two
    /// plans orders all and makes it visible.
    pub fn adopt(&mut self, plan: &Plan, trace: &Trace, carried: &[Carried]) {
        for (index, resource) in plan.resources.iter().enumerate() {
            let id = ResourceId(index as u32);
            let lives_on =
                |old: &&Carried| resource.history.as_ref() == Some(&old.name) && resource.shape == old.shape;
            let Some(old) = carried.iter().find(lives_on) else { continue };
            if old.contents {
                self.fill(trace.place(id).cells(0), id);
            }
            self.layouts[index] = old.layout;
            for step in &plan.prologue {
                let pass = plan.pass(step.pass);
                if matches!(pass.work, Work::Start { resource } if resource == id) {
                    self.skipped.push(step.pass);
                    let own = pass.uses.iter().filter(|touch| touch.resource == id);
                    if let Some(layout) = own.filter_map(|touch| touch.layout).next_back() {
                        self.layouts[index] = layout;
                    }
                }
            }
        }
    }

    /// Returns the resources that the next plan can adopt.
    pub fn carry(&self, plan: &Plan, trace: &Trace) -> Vec<Carried> {
        let mut carried = Vec::new();
        for (index, resource) in plan.resources.iter().enumerate() {
            let Some(name) = &resource.history else { continue };
            let id = ResourceId(index as u32);
            let cells = &self.cells[trace.place(id).cells(0)];
            carried.push(Carried {
                name: name.clone(),
                shape: resource.shape,
                layout: self.layouts[index],
                contents: cells.iter().all(|cell| cell.contents.hold(id, None)),
            });
        }
        carried
    }

    /// Runs the replay, up to the first violation if one is enough.
    pub fn run(&mut self, plan: &Plan, trace: &Trace, replay: &Replay) {
        self.copies = replay.copies.max(1);
        self.prepare(trace, replay, 0);
        for step in &plan.prologue {
            match plan.pass(step.pass).work {
                // Its image is in the layout that the pass would have left; the call's other barriers may serve other passes.
                Work::Start { resource } if self.skipped.contains(&step.pass) => {
                    let others = step.barriers.iter().filter(|b| b.image.is_none_or(|t| t.image != resource));
                    let others: Vec<Barrier> = others.cloned().collect();
                    self.call(trace, &others, When::Prologue, Some(step.pass));
                }
                _ => self.step(trace, step, When::Prologue),
            }
            if self.findings.enough() {
                return;
            }
        }
        self.call(trace, &plan.handover, When::Handover, None);
        for frame in 0..replay.frames {
            if frame > 0 {
                self.prepare(trace, replay, frame);
            }
            for step in &plan.frame {
                self.step(trace, step, When::Frame(frame));
                if self.findings.enough() {
                    return;
                }
            }
        }
    }

    fn copy(&self, when: When) -> u32 {
        when.frame() % self.copies
    }

    /// Waits for the fence of an earlier frame and writes the uniform blocks, as the host. The submission makes them
    /// visible to the device (Vulkan 1.3, 7.9 "Host Write Ordering Guarantees").
    fn prepare(&mut self, trace: &Trace, replay: &Replay, frame: u32) {
        self.time += 1;
        let finished = |actor: Actor| actor.when().frame().saturating_add(replay.in_flight.max(1)) <= frame;
        let copy = self.copy(When::Frame(frame));
        let MemoryState { cells, findings, time, .. } = self;
        for (index, place) in trace.places.iter().enumerate().filter(|(_, place)| place.per_frame()) {
            for number in place.cells(copy) {
                let cell = &mut cells[number];
                cell.fence(finished);
                if !place.host_writes {
                    continue;
                }
                let host = Actor::Host { frame };
                let resource = ResourceId(index as u32);
                for read in cell.reads.iter().filter(|read| !finished(read.actor)) {
                    let conflict = (ViolationKind::WriteAfterRead, read.actor, read.resource, Missing::Order);
                    findings.add(violation(trace, conflict, host, resource, number));
                }
                cell.record_write(Write {
                    actor: host,
                    resource,
                    time: *time,
                    stage: Stages::empty(),
                    access: Accesses::empty(),
                    ordered: Stages::all(),
                    chain: Stages::all(),
                    visible: Pairs::ALL,
                    visible_through_own: Pairs::NONE,
                });
                cell.contents = Contents { state: State::Written(resource), by: Some(host) };
            }
        }
    }

    fn step(&mut self, trace: &Trace, step: &Step, when: When) {
        self.call(trace, &step.barriers, when, Some(step.pass));
        self.pass(trace, step.pass, when);
    }

    /// Applies the barriers of one call.
    fn call(&mut self, trace: &Trace, barriers: &[Barrier], when: When, before: Option<PassId>) {
        if barriers.is_empty() {
            return;
        }
        self.time += 1;
        let mut scopes = std::mem::take(&mut self.scopes);
        scopes.clear();
        scopes.extend(barriers.iter().map(Scope::new));

        for (index, scope) in scopes.iter().enumerate() {
            let Some(image) = scope.image else { continue };
            let actor = Actor::Transition { when, image: image.image, before };
            self.check_layout(trace, image.image, image.old, actor, true);
            if scope.transition().is_some() {
                self.check_transition(trace, scope, image, actor);
                self.check_siblings(trace, &scopes[..index], image, actor);
            }
        }
        for cell in &mut self.cells {
            cell.pass_through(&scopes);
        }
        for scope in &scopes {
            if let Some(image) = scope.transition() {
                self.transition(trace, scope, image, Actor::Transition { when, image: image.image, before });
            }
        }
        self.scopes = scopes;
    }

    fn check_transition(&mut self, trace: &Trace, scope: &Scope, image: Transition, actor: Actor) {
        let MemoryState { cells, findings, .. } = self;
        for number in trace.place(image.image).cells(0) {
            cells[number].check_transition(scope, |conflict| {
                findings.add(violation(trace, conflict, actor, image.image, number));
            });
        }
    }

    /// Checks layout changes of one call against each other: they are not ordered.
    fn check_siblings(&mut self, trace: &Trace, others: &[Scope], image: Transition, actor: Actor) {
        let own = trace.place(image.image).cells(0);
        for other in others.iter().filter_map(Scope::transition) {
            let cells = trace.place(other.image).cells(0);
            let Actor::Transition { when, before, .. } = actor else { continue };
            let first = Actor::Transition { when, before, image: other.image };
            for number in own.start.max(cells.start)..own.end.min(cells.end) {
                let conflict = (ViolationKind::WriteAfterWrite, first, other.image, Missing::Order);
                self.findings.add(violation(trace, conflict, actor, image.image, number));
            }
        }
    }

    fn transition(&mut self, trace: &Trace, scope: &Scope, change: Transition, actor: Actor) {
        for number in trace.place(change.image).cells(0) {
            let cell = &mut self.cells[number];
            cell.record_write(Write {
                actor,
                resource: change.image,
                time: self.time,
                stage: Stages::empty(),
                access: Accesses::empty(),
                ordered: scope.target_reach,
                chain: scope.target_reach,
                visible: Pairs::NONE,
                visible_through_own: scope.target,
            });
            if change.old == Layout::Undefined {
                cell.contents = Contents { state: State::Discarded(change.image), by: Some(actor) };
            }
        }
        self.layouts[change.image.index()] = change.new;
        self.spoil_layouts(trace, change.image);
    }

    /// Forgets the layouts of the images that share a written resource's memory.
    fn spoil_layouts(&mut self, trace: &Trace, written: ResourceId) {
        for image in &trace.place(written).alias_images {
            self.layouts[image.index()] = Layout::Undefined;
        }
    }

    fn check_layout(&mut self, trace: &Trace, image: ResourceId, needed: Layout, actor: Actor, change: bool) {
        let found = self.layouts[image.index()];
        if found == needed || change && needed == Layout::Undefined {
            return;
        }
        let cells = &trace.cells[trace.place(image).cells(0)];
        self.findings.add(Violation {
            kind: ViolationKind::Layout,
            first: None,
            second: actor,
            resource: image,
            through: None,
            range: 0..cells.last().map_or(0, |cell| cell.end),
            missing: Missing::Layout { found, needed },
            plan: 0,
        });
        self.layouts[image.index()] = needed;
    }

    fn pass(&mut self, trace: &Trace, pass: PassId, when: When) {
        self.time += 1;
        let actions = trace.actions(pass);
        let actor = Actor::Pass { when, pass };
        let copy = self.copy(when);
        for (image, layout) in &actions.layouts {
            self.check_layout(trace, *image, *layout, actor, false);
        }
        for access in &actions.accesses {
            self.check(trace, access, actor, copy);
        }
        for Clash { first, second } in &actions.clashes {
            let kind = match (first.writes(), second.writes()) {
                (true, true) => ViolationKind::WriteAfterWrite,
                (true, false) => ViolationKind::ReadAfterWrite,
                _ => ViolationKind::WriteAfterRead,
            };
            let (one, other) = (first.cells(copy), second.cells(copy));
            for number in one.start.max(other.start)..one.end.min(other.end) {
                let conflict = (kind, actor, first.resource, Missing::Order);
                self.findings.add(violation(trace, conflict, actor, second.resource, number));
            }
        }
        // Writes first: they clear away older records, and the pass's own reads are to stay.
        for access in actions.accesses.iter().filter(|access| access.writes()) {
            self.record_write(trace, access, actor, copy);
        }
        for access in actions.accesses.iter().filter(|access| !access.writes()) {
            for number in access.cells(copy) {
                self.cells[number].record_read(Read {
                    actor,
                    resource: access.resource,
                    time: self.time,
                    stage: access.stage,
                    ordered: Stages::empty(),
                });
            }
        }
    }

    fn check(&mut self, trace: &Trace, access: &Access, actor: Actor, copy: u32) {
        let MemoryState { cells, findings, .. } = self;
        let Access { resource, stage, access: bit, needs_contents, .. } = *access;
        let fresh = trace.place(resource).fresh.then_some(actor.when());
        for number in access.cells(copy) {
            let cell = &cells[number];
            let report = |conflict| findings.add(violation(trace, conflict, actor, resource, number));
            if access.writes() {
                cell.check_write(stage, bit, resource, report);
            } else {
                cell.check_read(stage, bit, resource, report);
            }
            if needs_contents && !cell.contents.hold(resource, fresh) {
                let through = match cell.contents.state {
                    State::Never => resource,
                    State::Written(by) | State::Discarded(by) => by,
                };
                findings.add(Violation {
                    kind: ViolationKind::Unwritten,
                    first: cell.contents.by,
                    second: actor,
                    resource,
                    through: Some(through).filter(|through| *through != resource),
                    range: trace.cells[number].clone(),
                    missing: Missing::Contents,
                    plan: 0,
                });
            }
        }
    }

    fn record_write(&mut self, trace: &Trace, access: &Access, actor: Actor, copy: u32) {
        for number in access.cells(copy) {
            let cell = &mut self.cells[number];
            cell.record_write(Write {
                actor,
                resource: access.resource,
                time: self.time,
                stage: access.stage,
                access: access.access,
                ordered: Stages::empty(),
                chain: Stages::empty(),
                visible: Pairs::NONE,
                visible_through_own: Pairs::NONE,
            });
            cell.contents = Contents { state: State::Written(access.resource), by: Some(actor) };
        }
        self.spoil_layouts(trace, access.resource);
    }
}

fn violation(
    trace: &Trace,
    conflict: Conflict,
    second: Actor,
    resource: ResourceId,
    cell: usize,
) -> Violation {
    let (kind, first, through, missing) = conflict;
    Violation {
        kind,
        first: Some(first),
        second,
        resource,
        through: Some(through).filter(|through| *through != resource),
        range: trace.cells[cell].clone(),
        missing,
        plan: 0,
    }
}
