//! The walk: prologue, handover and frames, as they are submitted to one queue.
//!
//! Where an access is objected to, it takes place all the same, so that one mistake is told once.

use super::Replay;
use super::memory::{Cell, Conflict, Contents, Read, Scope, State, Write};
use super::objection::{Actor, Findings, Kind, Missing, Objection, When};
use super::script::{Access, Clash, Script};
use super::stages::Pairs;
use crate::ir::{Accesses, Layout, PassId, ResourceId, Shape, Stages, Work};
use crate::plan::{Barrier, Plan, Step, Transition};

pub struct World {
    cells: Vec<Cell>,
    /// Of each resource; meaningless for buffers.
    layouts: Vec<Layout>,
    /// Passes that are left out because a former plan did their work.
    skipped: Vec<PassId>,
    /// Counts passes, calls of barriers and preparations by the host.
    time: u32,
    copies: u32,
    /// The call that is being recorded; kept for its memory.
    scopes: Vec<Scope>,
    pub findings: Findings,
}

/// A resource that lives on in the next plan.
pub struct Carried {
    name: String,
    shape: Shape,
    layout: Layout,
    contents: bool,
}

impl World {
    /// Fresh memory for a plan.
    pub fn new(script: &Script, first_only: bool) -> World {
        let mut world = World {
            cells: vec![Cell::FRESH; script.cells.len()],
            layouts: vec![Layout::Undefined; script.places.len()],
            skipped: Vec::new(),
            time: 0,
            copies: 1,
            scopes: Vec::new(),
            findings: Findings { objections: Vec::new(), first_only },
        };
        world.reset(script);
        world
    }

    /// Everything as [`World::new`] left it.
    pub fn reset(&mut self, script: &Script) {
        self.cells.iter_mut().for_each(Cell::reset);
        self.layouts.fill(Layout::Undefined);
        self.skipped.clear();
        self.findings.objections.clear();
        for (index, place) in script.places.iter().enumerate().filter(|(_, place)| place.uploaded) {
            self.fill(place.cells(0), ResourceId(index as u32));
        }
    }

    /// Contents that were there before the plan, and that everyone sees.
    fn fill(&mut self, cells: std::ops::Range<usize>, resource: ResourceId) {
        for cell in &mut self.cells[cells] {
            cell.contents = Contents { state: State::Written(resource), by: None };
        }
    }

    /// Takes over what lives on from a former plan. The barrier on everything that is recorded between the two makes
    /// records of it pointless: all is ordered and visible.
    pub fn adopt(&mut self, plan: &Plan, script: &Script, carried: &[Carried]) {
        for (index, resource) in plan.resources.iter().enumerate() {
            let id = ResourceId(index as u32);
            let lives_on =
                |old: &&Carried| resource.history.as_ref() == Some(&old.name) && resource.shape == old.shape;
            let Some(old) = carried.iter().find(lives_on) else { continue };
            if old.contents {
                self.fill(script.place(id).cells(0), id);
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

    /// What the next plan can take over.
    pub fn carry(&self, plan: &Plan, script: &Script) -> Vec<Carried> {
        let mut carried = Vec::new();
        for (index, resource) in plan.resources.iter().enumerate() {
            let Some(name) = &resource.history else { continue };
            let id = ResourceId(index as u32);
            let cells = &self.cells[script.place(id).cells(0)];
            carried.push(Carried {
                name: name.clone(),
                shape: resource.shape,
                layout: self.layouts[index],
                contents: cells.iter().all(|cell| cell.contents.hold(id, None)),
            });
        }
        carried
    }

    /// The whole replay, or as much as it takes to find something where that is enough.
    pub fn run(&mut self, plan: &Plan, script: &Script, replay: &Replay) {
        self.copies = replay.copies.max(1);
        self.prepare(script, replay, 0);
        for step in &plan.prologue {
            match plan.pass(step.pass).work {
                // Its image is where the pass would have left it; what else stands in the call may be for others.
                Work::Start { resource } if self.skipped.contains(&step.pass) => {
                    let others = step.barriers.iter().filter(|b| b.image.is_none_or(|t| t.image != resource));
                    let others: Vec<Barrier> = others.cloned().collect();
                    self.call(script, &others, When::Prologue, Some(step.pass));
                }
                _ => self.step(script, step, When::Prologue),
            }
            if self.findings.enough() {
                return;
            }
        }
        self.call(script, &plan.handover, When::Handover, None);
        for frame in 0..replay.frames {
            if frame > 0 {
                self.prepare(script, replay, frame);
            }
            for step in &plan.frame {
                self.step(script, step, When::Frame(frame));
                if self.findings.enough() {
                    return;
                }
            }
        }
    }

    fn copy(&self, when: When) -> u32 {
        when.frame() % self.copies
    }

    /// The host waits for the fence of an earlier frame and writes the uniform blocks. The submission makes them
    /// visible to the device (Vulkan 1.3, 7.9 "Host Write Ordering Guarantees").
    fn prepare(&mut self, script: &Script, replay: &Replay, frame: u32) {
        self.time += 1;
        let finished = |actor: Actor| actor.when().frame().saturating_add(replay.in_flight.max(1)) <= frame;
        let copy = self.copy(When::Frame(frame));
        let World { cells, findings, time, .. } = self;
        for (index, place) in script.places.iter().enumerate().filter(|(_, place)| place.per_frame()) {
            for number in place.cells(copy) {
                let cell = &mut cells[number];
                cell.fence(finished);
                if !place.host_writes {
                    continue;
                }
                let host = Actor::Host { frame };
                let resource = ResourceId(index as u32);
                for read in cell.reads.iter().filter(|read| !finished(read.actor)) {
                    let conflict = (Kind::WriteAfterRead, read.actor, read.resource, Missing::Order);
                    findings.add(objection(script, conflict, host, resource, number));
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

    fn step(&mut self, script: &Script, step: &Step, when: When) {
        self.call(script, &step.barriers, when, Some(step.pass));
        self.pass(script, step.pass, when);
    }

    /// Barriers that are recorded together.
    fn call(&mut self, script: &Script, barriers: &[Barrier], when: When, before: Option<PassId>) {
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
            self.check_layout(script, image.image, image.old, actor, true);
            if scope.transition().is_some() {
                self.check_transition(script, scope, image, actor);
                self.check_siblings(script, &scopes[..index], image, actor);
            }
        }
        for cell in &mut self.cells {
            cell.pass_through(&scopes);
        }
        for scope in &scopes {
            if let Some(image) = scope.transition() {
                self.transition(script, scope, image, Actor::Transition { when, image: image.image, before });
            }
        }
        self.scopes = scopes;
    }

    fn check_transition(&mut self, script: &Script, scope: &Scope, image: Transition, actor: Actor) {
        let World { cells, findings, .. } = self;
        for number in script.place(image.image).cells(0) {
            cells[number].check_transition(scope, |conflict| {
                findings.add(objection(script, conflict, actor, image.image, number));
            });
        }
    }

    /// Layout changes of one call are not ordered among each other.
    fn check_siblings(&mut self, script: &Script, others: &[Scope], image: Transition, actor: Actor) {
        let own = script.place(image.image).cells(0);
        for other in others.iter().filter_map(Scope::transition) {
            let cells = script.place(other.image).cells(0);
            let Actor::Transition { when, before, .. } = actor else { continue };
            let first = Actor::Transition { when, before, image: other.image };
            for number in own.start.max(cells.start)..own.end.min(cells.end) {
                let conflict = (Kind::WriteAfterWrite, first, other.image, Missing::Order);
                self.findings.add(objection(script, conflict, actor, image.image, number));
            }
        }
    }

    fn transition(&mut self, script: &Script, scope: &Scope, change: Transition, actor: Actor) {
        for number in script.place(change.image).cells(0) {
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
        self.spoil_layouts(script, change.image);
    }

    /// Writing a resource leaves the images in the same memory in no layout.
    fn spoil_layouts(&mut self, script: &Script, written: ResourceId) {
        for image in &script.place(written).alias_images {
            self.layouts[image.index()] = Layout::Undefined;
        }
    }

    fn check_layout(
        &mut self,
        script: &Script,
        image: ResourceId,
        needed: Layout,
        actor: Actor,
        change: bool,
    ) {
        let found = self.layouts[image.index()];
        if found == needed || change && needed == Layout::Undefined {
            return;
        }
        let cells = &script.cells[script.place(image).cells(0)];
        self.findings.add(Objection {
            kind: Kind::Layout,
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

    fn pass(&mut self, script: &Script, pass: PassId, when: When) {
        self.time += 1;
        let actions = script.actions(pass);
        let actor = Actor::Pass { when, pass };
        let copy = self.copy(when);
        for (image, layout) in &actions.layouts {
            self.check_layout(script, *image, *layout, actor, false);
        }
        for access in &actions.accesses {
            self.check(script, access, actor, copy);
        }
        for Clash { first, second } in &actions.clashes {
            let kind = match (first.writes(), second.writes()) {
                (true, true) => Kind::WriteAfterWrite,
                (true, false) => Kind::ReadAfterWrite,
                _ => Kind::WriteAfterRead,
            };
            let (one, other) = (first.cells(copy), second.cells(copy));
            for number in one.start.max(other.start)..one.end.min(other.end) {
                let conflict = (kind, actor, first.resource, Missing::Order);
                self.findings.add(objection(script, conflict, actor, second.resource, number));
            }
        }
        // Writes first: they clear away older records, and the pass's own reads are to stay.
        for access in actions.accesses.iter().filter(|access| access.writes()) {
            self.record_write(script, access, actor, copy);
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

    fn check(&mut self, script: &Script, access: &Access, actor: Actor, copy: u32) {
        let World { cells, findings, .. } = self;
        let Access { resource, stage, access: bit, needs_contents, .. } = *access;
        let fresh = script.place(resource).fresh.then_some(actor.when());
        for number in access.cells(copy) {
            let cell = &cells[number];
            let report = |conflict| findings.add(objection(script, conflict, actor, resource, number));
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
                findings.add(Objection {
                    kind: Kind::Unwritten,
                    first: cell.contents.by,
                    second: actor,
                    resource,
                    through: Some(through).filter(|through| *through != resource),
                    range: script.cells[number].clone(),
                    missing: Missing::Contents,
                    plan: 0,
                });
            }
        }
    }

    fn record_write(&mut self, script: &Script, access: &Access, actor: Actor, copy: u32) {
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
        self.spoil_layouts(script, access.resource);
    }
}

fn objection(
    script: &Script,
    conflict: Conflict,
    second: Actor,
    resource: ResourceId,
    cell: usize,
) -> Objection {
    let (kind, first, through, missing) = conflict;
    Objection {
        kind,
        first: Some(first),
        second,
        resource,
        through: Some(through).filter(|through| *through != resource),
        range: script.cells[cell].clone(),
        missing,
        plan: 0,
    }
}
