//! The state of memory during the walk: each cell's last write and later reads, each image's layout.

use super::extents::{Access, Extents, Group};
use super::needs::{self, Reason, Requirement};
use super::scopes::{Masks, ORIGINS, Origin, Scopes, Time, with_later, write_access};
use crate::ir::{Accesses, Hazard, Layout, PassId, ResourceId, Source, Stages, Work};
use crate::plan::{Barrier, Plan, Step, Transition};
use std::ops::Range;

/// Inputs of the walk that do not change.
pub(super) struct Inputs<'a> {
    pub plan: &'a Plan,
    pub extents: Extents,
    /// One flag per resource: a frame needs its previous contents, from a `Once` pass or a history.
    pub kept: Vec<bool>,
    /// One flag per resource: other resources share its memory.
    pub shared: Vec<bool>,
}

impl Inputs<'_> {
    fn groups(&self, pass: PassId) -> &[Group] {
        &self.extents.passes[pass.index()]
    }

    /// The cells of a whole resource.
    fn cells(&self, resource: ResourceId) -> Range<usize> {
        self.extents.resources[resource.index()].clone()
    }
}

/// The past of the next pass.
#[derive(Clone, Debug)]
pub(super) struct World {
    scopes: Scopes,
    now: Time,
    frame_start: Time,
    cells: Vec<Cell>,
    layouts: Vec<Layout>,
    /// The time of the last use of each resource.
    touched: Vec<Time>,
    /// The last call.
    call: Option<Call>,
    /// Passes at the start of a frame whose needs a call at the end of the frame before has to meet: that call's step, and the
    /// pass.
    ahead: Vec<(usize, PassId)>,
}

/// A call, which later passes may still add to.
#[derive(Clone, Debug)]
struct Call {
    /// Position in the list of steps.
    step: usize,
    /// The time of the pass that follows the call.
    time: Time,
    /// The scopes before the call.
    before: Scopes,
    /// Everything that it has to meet, once each.
    needs: Vec<Requirement>,
    /// The requirements that only this call meets.
    reasons: Vec<Requirement>,
    /// The barrier on all memory.
    memory: Masks,
    images: Vec<Barrier>,
}

impl Call {
    fn new(world: &World, step: usize, needs: Vec<Requirement>, changes: &[Change]) -> Call {
        let mut call = Call {
            step,
            time: world.now,
            before: world.scopes.clone(),
            needs: Vec::new(),
            reasons: Vec::new(),
            memory: Masks::default(),
            images: changes.iter().map(Change::barrier).collect(),
        };
        call.meet(needs);
        call
    }

    /// The latest time of what it waits for.
    fn covers(&self) -> Time {
        self.time - 2
    }

    /// Takes on more needs; says whether the call had to change for them.
    fn meet(&mut self, needs: Vec<Requirement>) -> bool {
        let order = |need: &Requirement| self.images.iter().any(|b| need.is_met_by_order(&Masks::of(b)));
        let needs: Vec<Requirement> = needs.into_iter().filter(|need| !order(need)).collect();
        let open = needs.iter().filter(|need| !need.is_met_by(&self.memory));
        let reasons: Vec<Requirement> = open.copied().collect();
        for need in needs {
            if !self.needs.iter().any(|known| known.asks_the_same_as(&need)) {
                self.needs.push(need);
            }
        }
        if reasons.is_empty() {
            return false;
        }
        self.reasons.extend(reasons);
        self.memory = needs::memory_barrier(&self.needs);
        true
    }

    fn barriers(&self) -> Vec<Barrier> {
        let dependencies = needs::dependencies(&self.reasons);
        let memory = (!dependencies.is_empty()).then(|| needs::barrier(self.memory, None, dependencies));
        memory.into_iter().chain(self.images.iter().cloned()).collect()
    }
}

/// The last write to one piece of memory, and the reads since.
#[derive(Clone, Debug, Default)]
struct Cell {
    write: Option<Write>,
    /// The latest read at each origin.
    reads: [Option<Event>; ORIGINS],
}

#[derive(Clone, Copy, Debug)]
struct Event {
    pass: PassId,
    resource: ResourceId,
    time: Time,
}

#[derive(Clone, Copy, Debug)]
struct Write {
    event: Event,
    by: Writer,
}

#[derive(Clone, Copy, Debug)]
enum Writer {
    /// A pass, in these stages.
    Pass(Stages),
    /// A barrier that changed the layout; visible to its target.
    Change { stages: Stages, accesses: Accesses },
}

/// A change of layout that a pass needs, and what it has to wait for.
struct Change {
    transition: Transition,
    before: PassId,
    needs: Vec<Requirement>,
    target: Masks,
}

impl World {
    pub fn new(inputs: &Inputs) -> World {
        World {
            scopes: Scopes::new(),
            now: 0,
            frame_start: 0,
            cells: vec![Cell::default(); inputs.extents.cells],
            layouts: vec![Layout::Undefined; inputs.plan.resources.len()],
            touched: vec![0; inputs.plan.resources.len()],
            call: None,
            ahead: Vec::new(),
        }
    }

    pub fn layout(&self, image: ResourceId) -> Layout {
        self.layouts[image.index()]
    }

    pub fn start_frame(&mut self, inputs: &Inputs) {
        self.frame_start = self.now + 1;
        // Every frame has its own copy of what the host reads.
        for (resource, cells) in inputs.plan.resources.iter().zip(&inputs.extents.resources) {
            if resource.source == Source::Readback {
                self.cells[cells.clone()].fill(Cell::default());
            }
        }
    }

    /// Lets the pass happen, and adds it to `steps` with the barriers that it needs; or, where the last call can give them, adds
    /// them to that.
    pub fn place(&mut self, id: PassId, steps: &mut Vec<Step>, inputs: &Inputs) {
        let groups = inputs.groups(id);
        self.now += 2;
        let mut changes = Vec::new();
        let mut needs = Vec::new();
        for group in groups {
            match self.change(group, id, inputs) {
                Some(change) => changes.push(change),
                None => self.needs(group, id, &self.scopes, &mut needs),
            }
        }
        let ahead = std::mem::take(&mut self.ahead);
        for next in ahead.iter().filter(|(at, _)| *at == steps.len()).map(|(_, next)| *next) {
            needs.extend(self.needs_of_next_frame(next, inputs));
        }
        self.ahead = ahead;

        let mut barriers = Vec::new();
        if changes.is_empty() && self.can_join_last_call(&needs) {
            self.join_last_call(id, groups, steps);
        } else if !changes.is_empty() || !needs.is_empty() {
            let call = Call::new(self, steps.len(), needs, &changes);
            self.apply(&call.barriers(), id, inputs);
            barriers = call.barriers();
            self.call = Some(call);
        }
        // A pass that may be left out must not carry the needs of others.
        if matches!(inputs.plan.pass(id).work, Work::ClearHistory { .. }) {
            self.call = None;
        }
        groups.iter().for_each(|group| self.record(group, id));
        steps.push(Step { barriers, pass: id });
    }

    /// Returns whether the last call, with more bits, could meet these requirements: their causes all precede it.
    fn can_join_last_call(&self, needs: &[Requirement]) -> bool {
        self.call.as_ref().is_some_and(|call| needs.iter().all(|need| need.reason.time <= call.covers()))
    }

    /// Lets the last call meet the needs of this pass as well. Also notes what the pass found met already, so that the call
    /// goes on meeting it.
    fn join_last_call(&mut self, id: PassId, groups: &[Group], steps: &mut [Step]) {
        let Some(mut call) = self.call.take() else { return };
        let mut needs = Vec::new();
        groups.iter().for_each(|group| self.needs(group, id, &call.before, &mut needs));
        needs.retain(|need| need.reason.time <= call.covers());
        if call.meet(needs) {
            self.scopes = call.before.clone();
            let barriers = call.barriers();
            self.scopes.apply(barriers.iter().map(|b| (Masks::of(b), b.image.is_none())), call.covers());
            if call.time < self.frame_start {
                self.ahead.push((call.step, id));
            } else {
                steps[call.step].barriers = barriers;
            }
        }
        self.call = Some(call);
    }

    /// Lists the requirements of a pass at the start of the next frame.
    fn needs_of_next_frame(&self, id: PassId, inputs: &Inputs) -> Vec<Requirement> {
        let mut needs = Vec::new();
        for group in inputs.groups(id) {
            self.needs(group, id, &self.scopes, &mut needs);
        }
        needs.iter_mut().for_each(|need| need.reason.previous_frame = true);
        needs
    }

    /// Applies the barriers and the pass, and returns the requirements that the barriers leave unmet.
    ///
    /// A requirement of a layout change has the source stages of the change as its target.
    pub fn replay(&mut self, id: PassId, barriers: &[Barrier], inputs: &Inputs) -> Vec<Requirement> {
        let groups = inputs.groups(id);
        self.now += 2;
        let mut missing = Vec::new();
        for group in groups {
            let change = barriers.iter().find(|b| b.image.is_some_and(|t| t.image == group.resource));
            let mut needs = Vec::new();
            match change {
                Some(barrier) => {
                    let masks = Masks::of(barrier);
                    self.change_needs(group.resource, id, inputs, false, &mut needs);
                    needs.retain(|need| !need.source_is_met_by(&masks));
                    // The change waits for its source stages: what comes before these comes before it.
                    if let Some(stage) = barrier.source_stages.iter().next() {
                        needs.iter_mut().for_each(|n| (n.to, n.access) = (stage, Accesses::empty()));
                    }
                }
                None => {
                    self.needs(group, id, &self.scopes, &mut needs);
                    let met = |need: &Requirement| {
                        barriers.iter().any(|b| {
                            (b.image.is_none() || need.access.is_empty()) && need.is_met_by(&Masks::of(b))
                        })
                    };
                    needs.retain(|need| !met(need));
                }
            }
            missing.append(&mut needs);
        }
        self.apply(barriers, id, inputs);
        groups.iter().for_each(|group| self.record(group, id));
        missing
    }

    /// Lets a call happen that stands before no pass of its own; `pass` stands for it where reasons are given.
    pub fn call(&mut self, barriers: &[Barrier], pass: PassId, inputs: &Inputs) {
        self.now += 2;
        self.apply(barriers, pass, inputs);
    }

    /// The change of layout that has to come before the pass's touches, if one has to.
    fn change(&self, group: &Group, id: PassId, inputs: &Inputs) -> Option<Change> {
        let uses = || group.accesses.iter().map(|access| &access.touch);
        let new = uses().next()?.layout?;
        let at = group.resource.index();
        let current = self.layouts[at];
        let first = self.touched[at] < self.frame_start;
        let fresh = first && !inputs.kept[at] || uses().any(|t| t.discards);
        // A use of an alias since then has left it without a layout.
        let lost = first && inputs.shared[at] && !inputs.kept[at];
        if new == current && !lost {
            return None;
        }
        let old = if fresh { Layout::Undefined } else { current };
        let mut target = Masks::default();
        for touch in uses() {
            target.target_stages |= touch.stages;
            target.target_accesses |= touch.accesses;
        }
        let mut needs = Vec::new();
        self.change_needs(group.resource, id, inputs, true, &mut needs);
        let hazard = needs.first().map_or(Hazard::LayoutChange, |need| {
            match (target.target_accesses.reads() && !fresh, need.reason.hazard) {
                // The change itself writes; what the pass does says what it is for.
                (true, Hazard::WriteAfterWrite) => Hazard::ReadAfterWrite,
                (true, _) if !target.target_accesses.writes() => Hazard::LayoutChange,
                (_, hazard) => hazard,
            }
        });
        needs.iter_mut().for_each(|n| n.reason.hazard = hazard);
        let transition = Transition { image: group.resource, old, new };
        Some(Change { transition, before: id, needs, target })
    }

    /// Lists the requirements of a change of this image's layout. Targets are left empty.
    pub fn change_needs_of(&self, image: ResourceId, before: PassId, inputs: &Inputs) -> Vec<Requirement> {
        let mut needs = Vec::new();
        self.change_needs(image, before, inputs, true, &mut needs);
        needs
    }

    /// Adds the requirements of a layout change, which counts as a write. Targets are left empty. If `named`, a chain with an earlier
    /// barrier does not do for a write: the change names it.
    fn change_needs(
        &self,
        image: ResourceId,
        id: PassId,
        inputs: &Inputs,
        named: bool,
        needs: &mut Vec<Requirement>,
    ) {
        let at = At { pass: id, resource: image, scopes: &self.scopes };
        let to = (Stages::empty(), Accesses::empty());
        for cell in &self.cells[inputs.cells(image)] {
            // After the reads of the last write it is after the write as well.
            if let Some(write) = cell.write.filter(|_| !cell.is_read()) {
                let known = needs.len();
                self.memory(at, Hazard::WriteAfterWrite, write, to, needs);
                // An earlier barrier may have made the write available, and a chain with it would do. The change names the write all
                // the same, because validation layers look for it there (docs/barriers.md).
                let writes = needs[known..].iter_mut().filter(|need| named && !need.flush.is_empty());
                writes.for_each(|need| need.via = Stages::empty());
            }
            for (origin, read) in cell.reads() {
                add(needs, self.order(at, origin, read, to.0));
            }
        }
    }

    /// Adds the requirements of the uses that `scopes` does not meet.
    fn needs(&self, group: &Group, id: PassId, scopes: &Scopes, needs: &mut Vec<Requirement>) {
        let at = At { pass: id, resource: group.resource, scopes };
        for Access { touch, cells } in &group.accesses {
            for cell in cells.iter().flat_map(|cells| &self.cells[cells.clone()]) {
                let write = |writes: bool| cell.write.filter(|_| !(writes && cell.is_read()));
                for (to, access) in
                    touch.stages.iter().flat_map(|to| touch.accesses.iter().map(move |access| (to, access)))
                {
                    let writes = access.writes();
                    if let Some(write) = write(writes) {
                        let hazard = if writes { Hazard::WriteAfterWrite } else { Hazard::ReadAfterWrite };
                        self.memory(at, hazard, write, (to, access), needs);
                    }
                    for (origin, read) in cell.reads().filter(|_| writes) {
                        if !scopes.is_ordered(origin, read.time, to) {
                            add(needs, self.order(at, origin, read, to));
                        }
                    }
                }
            }
        }
    }

    /// Adds what it takes for a write to be seen by an access of `to`, or (with empty ones) to be available.
    fn memory(
        &self,
        at: At,
        hazard: Hazard,
        write: Write,
        (to, access): (Stages, Accesses),
        needs: &mut Vec<Requirement>,
    ) {
        let time = write.event.time;
        let reason = self.reason(at, hazard, write.event);
        let scopes = at.scopes;
        match write.by {
            Writer::Pass(stages) => {
                for from in stages.iter() {
                    if !to.is_empty() && scopes.is_visible(from, time, to, access) {
                        continue;
                    }
                    let (flush, via) = (write_access(from), scopes.available(from, time));
                    add(needs, Requirement { reason, from, flush, via, to, access });
                }
            }
            Writer::Change { stages, accesses } => {
                let reached = with_later(stages);
                let seen = stages.contains(to) && accesses.contains(access)
                    || scopes.is_shown(reached, time, to, access);
                if to.is_empty() || !seen {
                    let via = reached
                        .iter()
                        .fold(reached, |via, stage| via | scopes.after(Origin::new(stage, false), time));
                    let from = stages.iter().next().unwrap_or(Stages::empty());
                    add(needs, Requirement { reason, from, flush: Accesses::empty(), via, to, access });
                }
            }
        }
    }

    /// That `to` comes after a read.
    fn order(&self, at: At, origin: Origin, read: Event, to: Stages) -> Requirement {
        let reason = self.reason(at, Hazard::WriteAfterRead, read);
        let via = at.scopes.after(origin, read.time);
        Requirement {
            reason,
            from: origin.stage(),
            flush: Accesses::empty(),
            via,
            to,
            access: Accesses::empty(),
        }
    }

    fn reason(&self, at: At, hazard: Hazard, event: Event) -> Reason {
        Reason {
            hazard,
            resource: at.resource,
            alias: Some(event.resource).filter(|other| *other != at.resource),
            after: event.pass,
            previous_frame: event.time < self.frame_start,
            before: at.pass,
            time: event.time,
        }
    }

    fn apply(&mut self, barriers: &[Barrier], id: PassId, inputs: &Inputs) {
        let call = barriers.iter().map(|b| (Masks::of(b), b.image.is_none()));
        self.scopes.apply(call, self.now - 2);
        for (barrier, transition) in barriers.iter().filter_map(|b| Some((b, b.image?))) {
            let resource = transition.image;
            self.layouts[resource.index()] = transition.new;
            let event = Event { pass: id, resource, time: self.now - 1 };
            let by = Writer::Change { stages: barrier.target_stages, accesses: barrier.target_accesses };
            let cell = Cell { write: Some(Write { event, by }), reads: Default::default() };
            self.cells[inputs.cells(resource)].fill(cell);
        }
    }

    /// Notes what the pass did.
    fn record(&mut self, group: &Group, id: PassId) {
        let event = Event { pass: id, resource: group.resource, time: self.now };
        self.touched[group.resource.index()] = self.now;
        let stages: Stages = group.accesses(true).map(|access| access.touch.stages).collect();
        for cells in group.accesses(true).flat_map(|access| &access.cells) {
            let by = Writer::Pass(stages);
            let cell = Cell { write: Some(Write { event, by }), reads: Default::default() };
            self.cells[cells.clone()].fill(cell);
        }
        for Access { touch, cells } in group.accesses(false) {
            for cell in cells.clone().into_iter().flatten() {
                for stage in touch.stages.iter() {
                    self.cells[cell].reads[Origin::new(stage, group.dispatch).index()] = Some(event);
                }
            }
        }
    }
}

/// Adds a need that is not among them yet: the cells of a resource mostly ask for the same.
fn add(needs: &mut Vec<Requirement>, need: Requirement) {
    if !needs.contains(&need) {
        needs.push(need);
    }
}

/// The pass and resource of a requirement, and the scopes that apply so far.
#[derive(Clone, Copy)]
struct At<'a> {
    pass: PassId,
    resource: ResourceId,
    scopes: &'a Scopes,
}

impl Change {
    fn barrier(&self) -> Barrier {
        let mut masks = needs::least_source(&self.needs);
        masks.add(self.target);
        let mut dependencies = needs::dependencies(&self.needs);
        if dependencies.is_empty() {
            let first = needs::dependency(Hazard::LayoutChange, self.before, self.transition.image);
            dependencies.push(first);
        }
        for dependency in &mut dependencies {
            dependency.target_stages = self.target.target_stages;
            dependency.target_accesses = self.target.target_accesses;
        }
        needs::barrier(masks, Some(self.transition), dependencies)
    }
}

impl Cell {
    /// Returns whether the last write has been read.
    fn is_read(&self) -> bool {
        self.write.is_some_and(|w| self.reads().any(|(_, read)| read.time > w.event.time))
    }

    fn reads(&self) -> impl Iterator<Item = (Origin, Event)> + '_ {
        Origin::all().zip(&self.reads).filter_map(|(origin, read)| Some((origin, (*read)?)))
    }
}
