//! Replays the prologue, the handover and the frames, in the order of their submission to one queue.
//!
//! An access that violates the model still takes effect, so that one mistake causes one report.
//!
//! A replay walks over positions ([`At`]). It can be interrupted at any position to try other barriers, and then
//! continued, so a mutant shares the walk up to its mutation. Barriers apply to all memory, so they are stored in a
//! history ([`Calls`]), and a cell is brought up to date when it is next accessed.

use super::calls::Calls;
use super::cell::{Cell, Conflict, Contents, Read, Scope, State, Write};
use super::rules::{Replay, Rules};
use super::stages::Pairs;
use super::violation::{Actor, Findings, Missing, Violation, ViolationKind, What, When};
use crate::sync::barrier::{Barrier, Barriers};
use splatgraph_framework::ir::{Accesses, Layout, PassId, ResourceId, Shape, Stages, Work};
use splatgraph_framework::oracle::trace::{Access, Clash, Trace};
use splatgraph_framework::plan::{Plan, Transition};
use std::collections::HashSet;
use std::ops::Range;

pub struct MemoryState<'a> {
    plan: &'a Plan,
    trace: &'a Trace,
    replay: Replay,
    cells: Vec<Cell>,
    /// The barrier calls so far. `passed` has, for each cell, the number of calls that it has passed through.
    calls: Calls,
    passed: Vec<u32>,
    /// The state to restore after the current trial; `None` outside a trial.
    before_trial: Option<BeforeTrial>,
    rules: Rules,
    /// The current layout of each resource; meaningless for buffers.
    layouts: Vec<Layout>,
    /// Passes that are skipped because the plan continues their resource from a previous plan.
    skipped: Vec<PassId>,
    /// Number of passes, non-empty barrier calls and preparations by the host so far.
    time: u32,
    pub findings: Findings,
}

/// The state that a trial restores: the cells that it touched, all layouts, the time and the number of calls.
struct BeforeTrial {
    cells: Vec<(usize, Cell, u32)>,
    touched: HashSet<usize>,
    layouts: Vec<Layout>,
    time: u32,
    calls: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// Before a step of the prologue.
    Prologue(usize),
    Handover,
    /// Before a frame; the first has number 0.
    Begin(u32),
    /// Before a step of a frame.
    Frame(u32, usize),
}

/// The state in which a plan leaves a resource with a history, for the next plan.
pub struct Carried {
    name: String,
    shape: Shape,
    layout: Layout,
    contents: bool,
}

impl<'a> MemoryState<'a> {
    pub fn new(plan: &'a Plan, trace: &'a Trace, replay: Replay, rules: Rules, first_only: bool) -> Self {
        let mut memory = MemoryState {
            plan,
            trace,
            replay,
            cells: vec![Cell::FRESH; trace.cells.len()],
            calls: Calls::default(),
            passed: vec![0; trace.cells.len()],
            before_trial: None,
            rules,
            layouts: vec![Layout::Undefined; trace.resources.len()],
            skipped: Vec::new(),
            time: 0,
            findings: Findings { violations: Vec::new(), first_only },
        };
        for (index, place) in trace.resources.iter().enumerate().filter(|(_, place)| place.uploaded) {
            memory.fill(place.cells(0), ResourceId(index as u32));
        }
        memory
    }

    /// Returns a cell, after applying the calls that it has not passed through yet.
    fn cell(&mut self, number: usize) -> &mut Cell {
        let (cell, passed) = (&mut self.cells[number], &mut self.passed[number]);
        if let Some(before) = &mut self.before_trial
            && before.touched.insert(number)
        {
            before.cells.push((number, cell.clone(), *passed));
        }
        self.calls.pass(cell, passed);
        cell
    }

    /// Replays other barriers from `at` to the first violation, then restores the state. Returns true if there was a
    /// violation. `findings` must be empty before, and limited to the first violation.
    pub fn trial(&mut self, barriers: &Barriers, at: At) -> bool {
        self.before_trial = Some(BeforeTrial {
            cells: Vec::new(),
            touched: HashSet::new(),
            layouts: self.layouts.clone(),
            time: self.time,
            calls: self.calls.len(),
        });
        self.run_from(barriers, at);
        let found = !self.findings.violations.is_empty();
        self.findings.violations.clear();
        if let Some(before) = self.before_trial.take() {
            for (number, cell, passed) in before.cells {
                (self.cells[number], self.passed[number]) = (cell, passed);
            }
            (self.layouts, self.time) = (before.layouts, before.time);
            self.calls.truncate(before.calls);
        }
        found
    }

    /// Marks cells as written through `resource` before the replay, and visible everywhere.
    fn fill(&mut self, cells: Range<usize>, resource: ResourceId) {
        for cell in &mut self.cells[cells] {
            cell.contents = Contents { state: State::Written(resource), by: None };
        }
    }

    /// Adopts the resources that continue from a previous plan.
    ///
    /// Their accesses are not recorded: the barrier between the two plans orders all of them and makes them visible.
    pub fn adopt(&mut self, carried: &[Carried]) {
        let plan = self.plan;
        for (index, resource) in plan.resources.iter().enumerate() {
            let id = ResourceId(index as u32);
            let lives_on =
                |old: &&Carried| resource.history.as_ref() == Some(&old.name) && resource.shape == old.shape;
            let Some(old) = carried.iter().find(lives_on) else { continue };
            if writes_once(plan, id) {
                continue;
            }
            if old.contents {
                self.fill(self.trace.resource(id).cells(0), id);
            }
            self.layouts[index] = old.layout;
            for pass_id in &plan.prologue {
                let pass = plan.pass(*pass_id);
                if matches!(pass.work, Work::ClearHistory { resource } if resource == id) {
                    self.skipped.push(*pass_id);
                    let own = pass.uses.iter().filter(|touch| touch.resource == id);
                    if let Some(layout) = own.filter_map(|touch| touch.layout).next_back() {
                        self.layouts[index] = layout;
                    }
                }
            }
        }
    }

    pub fn carry(&self) -> Vec<Carried> {
        let mut carried = Vec::new();
        for (index, resource) in self.plan.resources.iter().enumerate() {
            let Some(name) = &resource.history else { continue };
            let id = ResourceId(index as u32);
            let cells = &self.cells[self.trace.resource(id).cells(0)];
            carried.push(Carried {
                name: name.clone(),
                shape: resource.shape,
                layout: self.layouts[index],
                contents: cells.iter().all(|cell| cell.contents.hold(id, None)),
            });
        }
        carried
    }

    pub fn run(&mut self, barriers: &Barriers) {
        let first = self.start();
        self.run_from(barriers, first);
    }

    fn run_from(&mut self, barriers: &Barriers, at: At) {
        let mut next = Some(at);
        while let Some(at) = next.filter(|_| !self.findings.enough()) {
            next = self.advance(barriers, at);
        }
    }

    /// Starts the replay, with the host's writes for the first frame, and returns the first position.
    pub fn start(&mut self) -> At {
        self.prepare(0);
        if self.plan.prologue.is_empty() { At::Handover } else { At::Prologue(0) }
    }

    /// Executes the step at a position, including the barriers before it. Returns the next position; `None` at the end
    /// of the replay.
    pub fn advance(&mut self, barriers: &Barriers, at: At) -> Option<At> {
        let plan = self.plan;
        match at {
            At::Prologue(step) => {
                let pass = plan.prologue[step];
                let call = barriers.at(Some(pass));
                match plan.pass(pass).work {
                    // The history's image is already in the layout that the pass would have left. The call's other
                    // barriers may serve other passes.
                    Work::ClearHistory { resource } if self.skipped.contains(&pass) => {
                        let others = call.iter().filter(|b| b.image.is_none_or(|t| t.image != resource));
                        let others: Vec<Barrier> = others.cloned().collect();
                        self.call(&others, When::Prologue, Some(pass));
                    }
                    _ => self.step(call, pass, When::Prologue),
                }
            }
            At::Handover => self.call(&barriers.handover, When::Handover, None),
            At::Begin(0) => {}
            At::Begin(frame) => self.prepare(frame),
            At::Frame(frame, step) => {
                let pass = plan.frame[step];
                self.step(barriers.at(Some(pass)), pass, When::Frame(frame));
            }
        }
        let frame = |frame| (frame < self.replay.frames).then_some(At::Begin(frame));
        match at {
            At::Prologue(step) if step + 1 < plan.prologue.len() => Some(At::Prologue(step + 1)),
            At::Prologue(_) => Some(At::Handover),
            At::Handover => frame(0),
            At::Begin(number) if plan.frame.is_empty() => frame(number + 1),
            At::Begin(number) => Some(At::Frame(number, 0)),
            At::Frame(number, step) if step + 1 < plan.frame.len() => Some(At::Frame(number, step + 1)),
            At::Frame(number, _) => frame(number + 1),
        }
    }

    fn copy(&self, when: When) -> u32 {
        when.frame() % self.replay.copies.max(1)
    }

    /// Simulates the host before a frame. Waits for the fence of an earlier frame, and writes the uniform blocks and
    /// host buffers.
    ///
    /// Submission makes these writes visible to the device (Vulkan 1.3, 7.9 "Host Write Ordering Guarantees").
    fn prepare(&mut self, frame: u32) {
        self.time += 1;
        let in_flight = self.replay.in_flight.max(1);
        let finished = |actor: Actor| actor.when.frame().saturating_add(in_flight) <= frame;
        let (copy, trace, time) = (self.copy(When::Frame(frame)), self.trace, self.time);
        for (index, place) in trace.resources.iter().enumerate().filter(|(_, place)| place.per_frame()) {
            for number in place.cells(copy) {
                let cell = self.cell(number);
                cell.fence(finished);
                if !place.host_writes {
                    continue;
                }
                let host = Actor { when: When::Frame(frame), what: What::Host };
                let resource = ResourceId(index as u32);
                let running = cell.reads.iter().filter(|read| !finished(read.actor));
                let overtaken: Vec<Conflict> = running.map(Read::overtaken).collect();
                cell.record_write(Write {
                    actor: host,
                    resource,
                    time,
                    stage: Stages::empty(),
                    access: Accesses::empty(),
                    ordered: Stages::all(),
                    chain: Stages::all(),
                    visible: Pairs::ALL,
                    visible_through_own: Pairs::NONE,
                });
                cell.contents = Contents { state: State::Written(resource), by: Some(host) };
                self.conflict(overtaken, host, resource, number);
            }
        }
    }

    /// Reports the conflicts of an access to a cell.
    fn conflict(
        &mut self,
        conflicts: impl IntoIterator<Item = Conflict>,
        second: Actor,
        resource: ResourceId,
        cell: usize,
    ) {
        for (kind, first, through, missing) in conflicts {
            self.findings.add(Violation {
                kind,
                first: Some(first),
                second,
                resource,
                through: Some(through).filter(|through| *through != resource),
                range: self.trace.cells[cell].clone(),
                missing,
                plan: 0,
            });
        }
    }

    fn step(&mut self, call: &[Barrier], pass: PassId, when: When) {
        self.call(call, when, Some(pass));
        self.pass(pass, when);
    }

    /// Checks the layout changes of one call, and applies its barriers.
    fn call(&mut self, barriers: &[Barrier], when: When, before: Option<PassId>) {
        if barriers.is_empty() {
            return;
        }
        self.time += 1;
        let scopes: Vec<Scope> = barriers.iter().map(Scope::new).collect();
        let change = |image| Actor { when, what: What::Transition { image, before } };

        for (index, scope) in scopes.iter().enumerate() {
            let Some(image) = scope.image else { continue };
            let actor = change(image.image);
            self.check_layout(image.image, image.old, actor, true);
            if scope.transition().is_some() {
                self.check_transition(scope, image, actor);
                for other in scopes[..index].iter().filter_map(Scope::transition) {
                    self.check_siblings(change(other.image), other, actor, image);
                }
            }
        }
        self.calls.add(barriers);
        for scope in &scopes {
            if let Some(image) = scope.transition() {
                self.transition(scope, image, change(image.image));
            }
        }
    }

    fn check_transition(&mut self, scope: &Scope, image: Transition, actor: Actor) {
        for number in self.trace.resource(image.image).cells(0) {
            let rules = self.rules;
            let conflicts = self.cell(number).check_transition(scope, rules, actor.when);
            self.conflict(conflicts, actor, image.image, number);
        }
    }

    /// Reports two layout changes of one call that share memory: within a call, nothing orders them.
    fn check_siblings(&mut self, first: Actor, other: Transition, actor: Actor, image: Transition) {
        let [own, cells] = [image, other].map(|change| self.trace.resource(change.image).cells(0));
        for number in own.start.max(cells.start)..own.end.min(cells.end) {
            let conflict = (ViolationKind::WriteAfterWrite, first, other.image, Missing::Order);
            self.conflict([conflict], actor, image.image, number);
        }
    }

    fn transition(&mut self, scope: &Scope, change: Transition, actor: Actor) {
        let time = self.time;
        for number in self.trace.resource(change.image).cells(0) {
            let cell = self.cell(number);
            cell.record_write(Write {
                actor,
                resource: change.image,
                time,
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
        self.spoil_layouts(change.image);
    }

    /// Invalidates the layouts of images that alias a written resource.
    fn spoil_layouts(&mut self, written: ResourceId) {
        for image in &self.trace.resource(written).alias_images {
            self.layouts[image.index()] = Layout::Undefined;
        }
    }

    fn check_layout(&mut self, image: ResourceId, needed: Layout, actor: Actor, change: bool) {
        let found = self.layouts[image.index()];
        if found == needed || change && needed == Layout::Undefined {
            return;
        }
        let cells = &self.trace.cells[self.trace.resource(image).cells(0)];
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

    fn pass(&mut self, pass: PassId, when: When) {
        self.time += 1;
        let actions = self.trace.actions(pass);
        let actor = Actor { when, what: What::Pass(pass) };
        let copy = self.copy(when);
        for (image, layout) in &actions.layouts {
            self.check_layout(*image, *layout, actor, false);
        }
        for access in &actions.accesses {
            self.check(access, actor, copy);
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
                self.conflict([conflict], actor, second.resource, number);
            }
        }
        // Writes come first: they remove older records, but the pass's own reads must stay.
        for access in actions.accesses.iter().filter(|access| access.writes()) {
            self.record_write(access, actor, copy);
        }
        for access in actions.accesses.iter().filter(|access| !access.writes()) {
            let time = self.time;
            for number in access.cells(copy) {
                self.cell(number).record_read(Read {
                    actor,
                    resource: access.resource,
                    time,
                    stage: access.stage,
                    named_by: access.named_by,
                    ordered: Stages::empty(),
                });
            }
        }
    }

    fn check(&mut self, access: &Access, actor: Actor, copy: u32) {
        let Access { resource, stage, access: bit, needs_contents, .. } = *access;
        let fresh = self.trace.resource(resource).fresh.then_some(actor.when);
        let rules = self.rules;
        for number in access.cells(copy) {
            let cell = self.cell(number);
            let conflicts = if access.writes() {
                cell.check_write(stage, bit, resource, rules)
            } else {
                cell.check_read(stage, bit, resource)
            };
            let contents = cell.contents;
            self.conflict(conflicts, actor, resource, number);
            if needs_contents && !contents.hold(resource, fresh) {
                let through = match contents.state {
                    State::Never => resource,
                    State::Written(by) | State::Discarded(by) => by,
                };
                self.findings.add(Violation {
                    kind: ViolationKind::Unwritten,
                    first: contents.by,
                    second: actor,
                    resource,
                    through: Some(through).filter(|through| *through != resource),
                    range: self.trace.cells[number].clone(),
                    missing: Missing::Contents,
                    plan: 0,
                });
            }
        }
    }

    fn record_write(&mut self, access: &Access, actor: Actor, copy: u32) {
        let time = self.time;
        for number in access.cells(copy) {
            let cell = self.cell(number);
            cell.record_write(Write {
                actor,
                resource: access.resource,
                time,
                stage: access.stage,
                access: access.access,
                ordered: Stages::empty(),
                chain: Stages::empty(),
                visible: Pairs::NONE,
                visible_through_own: Pairs::NONE,
            });
            cell.contents = Contents { state: State::Written(access.resource), by: Some(actor) };
        }
        self.spoil_layouts(access.resource);
    }
}

/// Returns true if the prologue writes a resource other than by clearing it. The plan then starts its history anew.
fn writes_once(plan: &Plan, id: ResourceId) -> bool {
    let passes = plan.prologue.iter().map(|pass| plan.pass(*pass));
    let writers = passes.filter(|pass| !matches!(pass.work, Work::ClearHistory { .. }));
    writers.flat_map(|pass| &pass.uses).any(|touch| touch.resource == id && touch.accesses.writes())
}
