//! Tracks the state of the walk: the effect of the barriers, the time of each pass, and pending layout changes.

use super::barrier::{Barrier, Step};
use super::needs::{self, Reason, Requirement};
use super::scopes::{Origin, Scopes, Time, with_later, write_access};
use splatgraph_framework::ir::{Accesses, Hazard, Layout, Masks, PassId, ResourceId, Stages, Work};
use splatgraph_framework::plan::{Dependency, LayoutChange, Plan, Transition};

#[derive(Clone)]
pub(super) struct SyncState<'a> {
    pub plan: &'a Plan,
    scopes: Scopes,
    now: Time,
    frame_start: Time,
    /// Time of the last run of each pass; 0 if it has not run.
    ran: Vec<Time>,
    /// The last layout change of each image, until a pass writes the image.
    changed: Vec<Option<Changed>>,
    /// The last barrier call, if later passes may extend it.
    call: Option<Call>,
    /// Passes at the start of a frame that rely on a call at the end of the previous frame. Each has the index of that
    /// call's step.
    ahead: Vec<(usize, PassId)>,
}

/// A barrier call (`vkCmdPipelineBarrier2`), which later passes may extend.
#[derive(Clone, Debug)]
struct Call {
    /// Index of the call's step in the list of steps.
    step: usize,
    /// The time of the pass that follows the call.
    time: Time,
    /// The scopes as they were before the call.
    before: Scopes,
    /// All requirements that the call must meet, without duplicates.
    needs: Vec<Requirement>,
    /// The requirements for which `memory` was created or extended.
    reasons: Vec<Requirement>,
    memory: Masks,
    images: Vec<Barrier>,
}

impl Call {
    fn new(state: &SyncState, step: usize, needs: Vec<Requirement>, changes: &[Change]) -> Call {
        let mut call = Call {
            step,
            time: state.now,
            before: state.scopes.clone(),
            needs: Vec::new(),
            reasons: Vec::new(),
            memory: Masks::default(),
            images: changes.iter().map(Change::barrier).collect(),
        };
        call.meet(needs);
        call
    }

    /// Returns the latest time whose accesses the call can cover: that of the pass before it.
    fn covers(&self) -> Time {
        self.time - 2
    }

    /// Adds requirements to the call. Returns true if the barrier on all memory changed.
    fn meet(&mut self, needs: Vec<Requirement>) -> bool {
        let order = |need: &Requirement| self.images.iter().any(|b| need.is_met_by_order(&b.masks));
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
        let causes = needs::causes(&self.reasons);
        let memory = (!causes.is_empty()).then_some(Barrier { image: None, masks: self.memory, causes });
        memory.into_iter().chain(self.images.iter().cloned()).collect()
    }
}

/// A completed layout change, which counts as a write that is visible to the barrier's target.
#[derive(Clone, Copy, Debug)]
struct Changed {
    time: Time,
    /// The pass that the change was placed before.
    pass: PassId,
    stages: Stages,
    accesses: Accesses,
    /// True if a pass has read the image since this change.
    is_read: bool,
}

struct Change {
    transition: Transition,
    before: PassId,
    needs: Vec<Requirement>,
    target: Masks,
}

impl<'a> SyncState<'a> {
    pub fn new(plan: &'a Plan) -> SyncState<'a> {
        SyncState {
            plan,
            scopes: Scopes::default(),
            now: 0,
            frame_start: 0,
            ran: vec![0; plan.passes.len()],
            changed: vec![None; plan.resources.len()],
            call: None,
            ahead: Vec::new(),
        }
    }

    pub fn start_frame(&mut self) {
        self.frame_start = self.now + 1;
    }

    /// Advances the walk by a pass, and appends its step. If the last call can meet the pass's requirements, it is
    /// extended; otherwise, the step gets its own call.
    pub fn place(&mut self, id: PassId, steps: &mut Vec<Step>) {
        self.now += 2;
        let changes = self.plan.layout_changes_at(Some(id));
        let changes: Vec<Change> = changes.map(|change| self.change(change)).collect();
        let mut needs = self.needs(id, &self.scopes);
        let ahead = std::mem::take(&mut self.ahead);
        for next in ahead.iter().filter(|(at, _)| *at == steps.len()).map(|(_, next)| *next) {
            needs.extend(self.needs_of_next_frame(next));
        }
        self.ahead = ahead;

        let mut barriers = Vec::new();
        if changes.is_empty() && self.can_join_last_call(&needs) {
            self.join_last_call(id, steps);
        } else if !changes.is_empty() || !needs.is_empty() {
            let call = Call::new(self, steps.len(), needs, &changes);
            self.apply(&call.barriers(), id);
            barriers = call.barriers();
            self.call = Some(call);
        }
        // A pass that may be omitted must not carry the barriers of others.
        if matches!(self.plan.pass(id).work, Work::ClearHistory { .. }) {
            self.call = None;
        }
        self.record(id);
        steps.push(Step { barriers, pass: id });
    }

    /// Returns true if the last call could meet these requirements with more bits: all their causes precede it.
    fn can_join_last_call(&self, needs: &[Requirement]) -> bool {
        self.call.as_ref().is_some_and(|call| needs.iter().all(|need| need.reason.time <= call.covers()))
    }

    /// Extends the last call to meet the requirements of this pass.
    ///
    /// Also records the requirements that the call already meets, so that later changes keep meeting them.
    fn join_last_call(&mut self, id: PassId, steps: &mut [Step]) {
        let Some(mut call) = self.call.take() else { return };
        let mut needs = self.needs(id, &call.before);
        needs.retain(|need| need.reason.time <= call.covers());
        if call.meet(needs) {
            self.scopes = call.before.clone();
            let barriers = call.barriers();
            self.scopes.apply(barriers.iter().map(|b| (b.masks, b.image.is_none())), call.covers());
            if call.time < self.frame_start {
                self.ahead.push((call.step, id));
            } else {
                steps[call.step].barriers = barriers;
            }
        }
        self.call = Some(call);
    }

    /// Lists the requirements of a pass at the start of the next frame, as seen from the current state.
    fn needs_of_next_frame(&self, id: PassId) -> Vec<Requirement> {
        let mut needs = self.needs(id, &self.scopes);
        needs.iter_mut().for_each(|need| need.reason.previous_frame = true);
        needs
    }

    /// Replays a pass with its barriers, and returns the requirements that they do not meet.
    ///
    /// An unmet requirement of a layout change has the first source stage of the change as its target, if there is one.
    pub fn replay(&mut self, id: PassId, barriers: &[Barrier]) -> Vec<Requirement> {
        self.now += 2;
        let mut missing = Vec::new();
        for change in self.plan.layout_changes_at(Some(id)) {
            let Some(barrier) = barriers.iter().find(|b| b.image.is_some_and(|t| t.image == change.image))
            else {
                continue;
            };
            let mut needs = self.change_needs(change, false);
            needs.retain(|need| !need.source_is_met_by(&barrier.masks));
            // The change waits for its source stages, and so for everything before them.
            if let Some(stage) = barrier.masks.source_stages.iter().next() {
                needs.iter_mut().for_each(|n| (n.to, n.access) = (stage, Accesses::empty()));
            }
            missing.append(&mut needs);
        }
        let met = |need: &Requirement| {
            barriers.iter().any(|b| (b.image.is_none() || need.access.is_empty()) && need.is_met_by(&b.masks))
        };
        missing.extend(self.needs(id, &self.scopes).into_iter().filter(|need| !met(need)));
        self.apply(barriers, id);
        self.record(id);
        missing
    }

    /// Applies a call outside the passes: the handover. Causes name `pass` in its place.
    pub fn call(&mut self, barriers: &[Barrier], pass: PassId) {
        self.now += 2;
        self.apply(barriers, pass);
    }

    fn change(&self, change: &LayoutChange) -> Change {
        let LayoutChange { image, old, before, .. } = *change;
        let mut target = Masks::default();
        for touch in self.plan.pass(before).uses.iter().filter(|touch| touch.resource == image) {
            target.target_stages |= touch.stages;
            target.target_accesses |= touch.accesses;
        }
        let mut needs = self.change_needs(change, true);
        let hazard = needs.first().map_or(Hazard::LayoutChange, |need| {
            match (target.target_accesses.reads() && old != Layout::Undefined, need.reason.hazard) {
                // The change itself is a write; the hazard follows from the pass's access.
                (true, Hazard::WriteAfterWrite) => Hazard::ReadAfterWrite,
                (true, _) if !target.target_accesses.writes() => Hazard::LayoutChange,
                (_, hazard) => hazard,
            }
        });
        needs.iter_mut().for_each(|n| n.reason.hazard = hazard);
        Change { transition: change.transition(), before, needs, target }
    }

    /// Lists the requirements of a layout change, with empty targets. The change counts as a write.
    ///
    /// If `named`, the source must name an earlier write, even if a chain would suffice.
    pub fn change_needs(&self, change: &LayoutChange, named: bool) -> Vec<Requirement> {
        let LayoutChange { image, before, .. } = *change;
        let to = (Stages::empty(), Accesses::empty());
        let mut needs = Vec::new();
        let dependencies = self.plan.dependencies_of(before).iter();
        for dependency in dependencies.filter(|d| d.changes_layout && d.resource == image) {
            let Some(time) = self.time(dependency) else { continue };
            if !dependency.masks.source_accesses.writes() {
                self.order(dependency, time, to.0, &self.scopes, &mut needs);
                continue;
            }
            let known = needs.len();
            self.memory((dependency, Hazard::WriteAfterWrite), time, to, &self.scopes, &mut needs);
            // A chain with the earlier barrier that made the write available would suffice. The change still names the
            // write, because validation layers look for it there (docs/barriers.md).
            let writes = needs[known..].iter_mut().filter(|need| named && !need.flush.is_empty());
            writes.for_each(|need| need.via = Stages::empty());
        }
        if let Some(changed) = self.changed[image.index()].filter(|changed| !changed.is_read) {
            self.after_change(
                &changed,
                (before, image, Hazard::WriteAfterWrite),
                to,
                &self.scopes,
                &mut needs,
            );
        }
        needs
    }

    /// Returns the time of a dependency's earlier pass. `None` if it has not run, or if a later layout change replaces
    /// it.
    fn time(&self, dependency: &Dependency) -> Option<Time> {
        let time = self.ran[dependency.first.index()];
        let touched = dependency.alias.unwrap_or(dependency.resource);
        let is_behind_change = self.changed[touched.index()].is_some_and(|changed| time < changed.time);
        (time > 0 && !is_behind_change).then_some(time)
    }

    /// Lists the requirements of a pass that `scopes` does not meet, except those of its layout changes.
    fn needs(&self, id: PassId, scopes: &Scopes) -> Vec<Requirement> {
        let changes: Vec<ResourceId> =
            self.plan.layout_changes_at(Some(id)).map(|change| change.image).collect();
        let mut needs = Vec::new();
        for dependency in self.plan.dependencies_of(id) {
            if dependency.hazard == Hazard::LayoutChange || changes.contains(&dependency.resource) {
                continue;
            }
            let Some(time) = self.time(dependency) else { continue };
            for to in dependency.masks.target_stages.iter() {
                if dependency.hazard == Hazard::WriteAfterRead {
                    self.order(dependency, time, to, scopes, &mut needs);
                    continue;
                }
                for access in dependency.masks.target_accesses.iter() {
                    let hazard =
                        if access.writes() { Hazard::WriteAfterWrite } else { Hazard::ReadAfterWrite };
                    self.memory((dependency, hazard), time, (to, access), scopes, &mut needs);
                }
            }
        }
        for touch in &self.plan.pass(id).uses {
            let Some(changed) = self.changed[touch.resource.index()] else { continue };
            if changes.contains(&touch.resource) {
                continue;
            }
            let both =
                touch.stages.iter().flat_map(|to| touch.accesses.iter().map(move |access| (to, access)));
            for (to, access) in both.filter(|(_, access)| !(access.writes() && changed.is_read)) {
                let hazard = if access.writes() { Hazard::WriteAfterWrite } else { Hazard::ReadAfterWrite };
                self.after_change(&changed, (id, touch.resource, hazard), (to, access), scopes, &mut needs);
            }
        }
        needs
    }

    /// Adds, for each source stage, the requirement that a write be visible to `access` at `to`, unless it already is.
    /// If `to` is empty, requires that the write be available.
    fn memory(
        &self,
        (dependency, hazard): (&Dependency, Hazard),
        time: Time,
        (to, access): (Stages, Accesses),
        scopes: &Scopes,
        needs: &mut Vec<Requirement>,
    ) {
        let reason = self.reason(dependency, hazard, time);
        for from in dependency.masks.source_stages.iter() {
            if !to.is_empty() && scopes.is_visible(from, time, to, access) {
                continue;
            }
            let (flush, via) = (write_access(from), scopes.available(from, time));
            add(needs, Requirement { reason, from, flush, via, to, access });
        }
    }

    /// Adds the requirement that a layout change be visible to `access` at `to`, unless it already is. If `to` is
    /// empty, requires that the change be complete.
    fn after_change(
        &self,
        changed: &Changed,
        (before, resource, hazard): (PassId, ResourceId, Hazard),
        (to, access): (Stages, Accesses),
        scopes: &Scopes,
        needs: &mut Vec<Requirement>,
    ) {
        let Changed { time, pass, stages, accesses, .. } = *changed;
        let reached = with_later(stages);
        let seen =
            stages.contains(to) && accesses.contains(access) || scopes.is_shown(reached, time, to, access);
        if seen && !to.is_empty() {
            return;
        }
        let previous_frame = time < self.frame_start;
        let reason = Reason { hazard, resource, alias: None, after: pass, previous_frame, before, time };
        let via =
            reached.iter().fold(reached, |via, stage| via | scopes.after(Origin::new(stage, false), time));
        let from = stages.iter().next().unwrap_or(Stages::empty());
        add(needs, Requirement { reason, from, flush: Accesses::empty(), via, to, access });
    }

    /// Adds, for each source stage, the requirement that `to` run after its reads, unless it already does. The
    /// requirement, a write after a read, is for execution only.
    fn order(
        &self,
        dependency: &Dependency,
        time: Time,
        to: Stages,
        scopes: &Scopes,
        needs: &mut Vec<Requirement>,
    ) {
        let dispatch = matches!(self.plan.pass(dependency.first).work, Work::Dispatch { .. });
        let reason = self.reason(dependency, Hazard::WriteAfterRead, time);
        for from in dependency.masks.source_stages.iter() {
            let origin = Origin::new(from, dispatch);
            if to.is_empty() || !scopes.is_ordered(origin, time, to) {
                let (flush, via, access) = (Accesses::empty(), scopes.after(origin, time), Accesses::empty());
                add(needs, Requirement { reason, from, flush, via, to, access });
            }
        }
    }

    fn reason(&self, dependency: &Dependency, hazard: Hazard, time: Time) -> Reason {
        Reason {
            hazard,
            resource: dependency.resource,
            alias: dependency.alias,
            after: dependency.first,
            previous_frame: time < self.frame_start,
            before: dependency.second,
            time,
        }
    }

    fn apply(&mut self, barriers: &[Barrier], pass: PassId) {
        let call = barriers.iter().map(|b| (b.masks, b.image.is_none()));
        self.scopes.apply(call, self.now - 2);
        for (barrier, transition) in barriers.iter().filter_map(|b| Some((b, b.image?))) {
            self.changed[transition.image.index()] = Some(Changed {
                time: self.now - 1,
                pass,
                stages: barrier.masks.target_stages,
                accesses: barrier.masks.target_accesses,
                is_read: false,
            });
        }
    }

    fn record(&mut self, id: PassId) {
        self.ran[id.index()] = self.now;
        for touch in &self.plan.pass(id).uses {
            let changed = &mut self.changed[touch.resource.index()];
            if touch.accesses.writes() {
                *changed = None;
            } else if let Some(changed) = changed {
                changed.is_read = true;
            }
        }
    }
}

fn add(needs: &mut Vec<Requirement>, need: Requirement) {
    if !needs.contains(&need) {
        needs.push(need);
    }
}

impl Change {
    fn barrier(&self) -> Barrier {
        let masks = needs::least_source(&self.needs).with(self.target);
        let mut causes = needs::causes(&self.needs);
        if causes.is_empty() {
            let first = needs::cause(Hazard::LayoutChange, self.before, self.transition.image);
            causes.push((first, Masks::default()));
        }
        causes.iter_mut().for_each(|(_, masks)| *masks = masks.source().with(self.target));
        Barrier { image: Some(self.transition), masks, causes }
    }
}
