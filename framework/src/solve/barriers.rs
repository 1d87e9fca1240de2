//! Where barriers go: a walk over the passes with a model of what each resource has been through.
//!
//! The model follows Vulkan's. A barrier does two things. It **orders**: what the source stages did before it happens
//! before what the target stages do after it ([`World::ordered`] remembers, for each pair of stages, up to when; chains of
//! barriers order too). And for its resource it makes writes **available** (source accesses) and **visible** to certain
//! stages and accesses (target). A read needs the last write visible to it; a write needs the write before it visible as
//! well, unless reads came between; a write after reads needs only order. An image must further be in the right
//! layout, and changing it is a write by the barrier itself.
//!
//! The same list of barriers is recorded every frame, but the first frame follows the prologue and the others follow
//! a frame. So the frame is walked in several [`World`]s in step, one for each past that it can have; a barrier is placed
//! where any of them needs it, and acts in all. The walk is repeated until the pasts no longer change it.

use crate::plan::{Accesses, Barrier, Hazard, Layout, Pass, PassId, ResourceId, Run, Stages, Step, Touch};

/// Number of stages that [`Stages`] names.
const STAGES: usize = Stages::all().bits().count_ones() as usize;

/// `ordered[to][from]`: work of stage `from` up to this time happens before what stage `to` does from now on.
type Ordered = [[Time; STAGES]; STAGES];

/// Rises by one with every pass walked; 0 is before everything. The barriers before a pass and the pass itself have the
/// same time.
type Time = u32;

pub(super) struct Solved {
    pub prologue: Vec<Step>,
    pub frame: Vec<Step>,
}

/// Rounds after which the walk must have settled; three have been enough for every graph so far.
const MOST_ROUNDS: usize = 16;

/// Places the barriers of the prologue and of the frame, for `resources` resources. `None` if the walk did not settle.
pub(super) fn place(
    passes: &[Pass],
    prologue: &[PassId],
    frame: &[PassId],
    resources: usize,
) -> Option<Solved> {
    let mut start = World::new(resources);
    let prologue = walk(passes, prologue, std::slice::from_mut(&mut start));
    for history in &mut start.resources {
        history.kept = history.touched;
    }
    let mut pasts = vec![start.clone()];
    let mut last: Option<Vec<Step>> = None;
    for _ in 0..MOST_ROUNDS {
        let mut worlds = pasts.clone();
        worlds.iter_mut().for_each(World::start_frame);
        let steps = walk(passes, frame, &mut worlds);
        // Every frame does the same to every resource, so what frames leave behind settles after the first. Once the list
        // did not change, these pasts are the true ones: they were made with this list.
        if last.as_ref() == Some(&steps) && pasts.len() > 2 {
            return Some(Solved { prologue, frame: steps });
        }
        last = Some(steps);
        pasts = std::iter::once(start.clone()).chain(worlds).take(3).collect();
    }
    None
}

/// What has happened so far, in one of the pasts that a frame can have.
#[derive(Clone, Debug)]
struct World {
    now: Time,
    frame_start: Time,
    ordered: Ordered,
    resources: Vec<History>,
}

/// What one resource has been through since its last write.
#[derive(Clone, Debug, Default)]
struct History {
    write: Option<Write>,
    reads: Vec<Event>,
    layout: Option<Layout>,
    /// Touched in this frame: from then on its contents matter.
    touched: bool,
    /// Written by the prologue: its contents matter from the start of every frame.
    kept: bool,
}

#[derive(Clone, Debug)]
struct Event {
    stages: Stages,
    pass: PassId,
    time: Time,
}

/// The last write: by a pass, or by a barrier that changed the layout (which is available at once, to its target stages).
#[derive(Clone, Debug)]
struct Write {
    event: Event,
    accesses: Accesses,
    /// Stages before which the write was made available, and when.
    available: Vec<(Stages, Time)>,
    /// Accesses to which it is visible, by stage.
    visible: [Accesses; STAGES],
}

/// What a resource's barrier must do, in one world or merged over all.
#[derive(Clone, Debug)]
struct Demand {
    hazard: Hazard,
    after: Vec<PassId>,
    across_frames: bool,
    source_stages: Stages,
    source_accesses: Accesses,
    target_stages: Stages,
    target_accesses: Accesses,
    layouts: Option<(Layout, Layout)>,
}

fn index(stage: Stages) -> usize {
    stage.bits().trailing_zeros() as usize
}

/// Walks the passes in all worlds at once.
fn walk(passes: &[Pass], ids: &[PassId], worlds: &mut [World]) -> Vec<Step> {
    let mut steps = Vec::with_capacity(ids.len());
    for id in ids {
        let touches = by_resource(&passes[id.index()].touches);
        worlds.iter_mut().for_each(|w| w.now += 1);
        let mut demands: Vec<(ResourceId, Demand)> = Vec::new();
        for (resource, touches) in &touches {
            // Where one world changes the layout, the same barrier does in all, and must wait for what each has been through.
            let changes = worlds.iter().any(|w| w.changes_layout(*resource, touches));
            let merged = worlds
                .iter()
                .filter_map(|w| match changes {
                    true => Some(w.layout_demand(*resource, touches)),
                    false => w.memory_demand(*resource, touches),
                })
                .reduce(merge);
            demands.extend(merged.map(|demand| (*resource, demand)));
        }
        // Barriers of one call do not chain with each other: each sees the order from before the call.
        let before: Vec<Ordered> = worlds.iter().map(|w| w.ordered).collect();
        for (world, before) in worlds.iter_mut().zip(&before) {
            world.apply(&demands, *id, before);
        }
        // What is left are writes after reads that the barriers so far do not happen to order.
        for (resource, touches) in &touches {
            for world in 0..worlds.len() {
                let Some(demand) = worlds[world].order_demand(*resource, touches) else { continue };
                worlds.iter_mut().zip(&before).for_each(|(w, before)| w.order(&demand, before));
                match demands.iter_mut().find(|(r, _)| r == resource) {
                    Some((_, existing)) => *existing = merge(existing.clone(), demand),
                    None => demands.push((*resource, demand)),
                }
            }
        }
        for world in worlds.iter_mut() {
            touches.iter().for_each(|(resource, touches)| world.record(*resource, touches, *id));
        }
        let barriers =
            demands.into_iter().map(|(resource, demand)| demand.barrier(resource, passes)).collect();
        steps.push(Step { barriers, pass: *id });
    }
    steps
}

/// Whether a barrier whose source is `stage` comes after the write was made available.
fn available_to(ordered: &Ordered, write: &Write, stage: Stages) -> bool {
    write.available.iter().any(|(before, time)| {
        before.contains(stage) || before.iter().any(|b| ordered[index(stage)][index(b)] >= *time)
    })
}

/// A pass's touches, grouped, in the order of first appearance.
fn by_resource(touches: &[Touch]) -> Vec<(ResourceId, Vec<Touch>)> {
    let mut groups: Vec<(ResourceId, Vec<Touch>)> = Vec::new();
    for touch in touches {
        // Uniform blocks are written by the host before the frame is submitted, which needs no barrier.
        if touch.accesses == Accesses::UNIFORM_READ {
            continue;
        }
        match groups.iter_mut().find(|(r, _)| *r == touch.resource) {
            Some((_, group)) => group.push(*touch),
            None => groups.push((touch.resource, vec![*touch])),
        }
    }
    groups
}

/// One barrier that does what both do. Of two old layouts it names that of the later world, which is the steady frame's.
fn merge(mut merged: Demand, demand: Demand) -> Demand {
    merged.layouts = demand.layouts.or(merged.layouts);
    if merged.hazard == Hazard::LayoutChange {
        merged.hazard = demand.hazard;
    }
    merged.source_stages |= demand.source_stages;
    merged.source_accesses |= demand.source_accesses;
    merged.target_stages |= demand.target_stages;
    merged.target_accesses |= demand.target_accesses;
    merged.across_frames |= demand.across_frames;
    merged.after.extend(demand.after);
    merged.after.sort();
    merged.after.dedup();
    merged
}

impl Demand {
    /// Waits for nothing yet.
    fn new(hazard: Hazard, layouts: Option<(Layout, Layout)>) -> Demand {
        Demand {
            hazard,
            after: Vec::new(),
            across_frames: false,
            source_stages: Stages::empty(),
            source_accesses: Accesses::empty(),
            target_stages: Stages::empty(),
            target_accesses: Accesses::empty(),
            layouts,
        }
    }

    fn barrier(self, resource: ResourceId, passes: &[Pass]) -> Barrier {
        // What the prologue did is before the frame, but of no frame.
        let framed = self.after.iter().any(|pass| passes[pass.index()].run == Run::Frame);
        Barrier {
            resource,
            hazard: self.hazard,
            after: self.after,
            across_frames: self.across_frames && framed,
            source_stages: self.source_stages,
            source_accesses: self.source_accesses,
            target_stages: self.target_stages,
            target_accesses: self.target_accesses,
            layouts: self.layouts,
        }
    }
}

impl World {
    fn new(resources: usize) -> World {
        World {
            now: 0,
            frame_start: 0,
            ordered: Default::default(),
            resources: vec![History::default(); resources],
        }
    }

    fn start_frame(&mut self) {
        self.frame_start = self.now + 1;
        self.resources.iter_mut().for_each(|h| h.touched = false);
    }

    /// Whether the image must first be brought into another layout.
    fn changes_layout(&self, resource: ResourceId, touches: &[Touch]) -> bool {
        touches[0].layout.is_some() && touches[0].layout != self.resources[resource.index()].layout
    }

    /// What the touches need of memory: nothing of mere order.
    fn memory_demand(&self, resource: ResourceId, touches: &[Touch]) -> Option<Demand> {
        let history = &self.resources[resource.index()];
        let write = history.write.as_ref()?;
        let read_since = history.reads.iter().any(|r| r.time > write.event.time);
        let (mut reads, mut target_stages, mut target_accesses) = (false, Stages::empty(), Accesses::empty());
        for touch in touches {
            let mut needed = touch.accesses;
            if read_since {
                needed -= Accesses::WRITES;
            }
            let unseen = touch
                .stages
                .iter()
                .fold(Accesses::empty(), |unseen, stage| unseen | (needed - write.visible[index(stage)]));
            if !unseen.is_empty() {
                reads |= unseen.reads();
                target_stages |= touch.stages;
                target_accesses |= unseen;
            }
        }
        if target_accesses.is_empty() {
            return None;
        }
        let (source_stages, source_accesses) = self.source(write);
        Some(Demand {
            hazard: if reads { Hazard::ReadAfterWrite } else { Hazard::WriteAfterWrite },
            after: vec![write.event.pass],
            across_frames: write.event.time < self.frame_start,
            source_stages,
            source_accesses,
            target_stages,
            target_accesses,
            layouts: touches[0].layout.map(|layout| (layout, layout)),
        })
    }

    /// The source half of a barrier after `write`. A write that is available already, before a stage that a barrier can
    /// wait for, needs no source access again: the two barriers are a chain.
    fn source(&self, write: &Write) -> (Stages, Accesses) {
        let chained = write.event.stages.iter().find(|stage| available_to(&self.ordered, write, *stage));
        match chained {
            Some(stage) => (stage, Accesses::empty()),
            None => (write.event.stages, write.accesses),
        }
    }

    /// What a change of layout needs, which is a write by the barrier: all that touched the image before is done.
    fn layout_demand(&self, resource: ResourceId, touches: &[Touch]) -> Demand {
        let history = &self.resources[resource.index()];
        let fresh = !history.touched && !history.kept || touches.iter().any(|t| t.discards);
        let old = if fresh { Layout::Undefined } else { history.layout.unwrap_or(Layout::Undefined) };
        let new = touches[0].layout.unwrap_or(Layout::Undefined);
        let mut demand = Demand::new(Hazard::LayoutChange, Some((old, new)));
        for touch in touches {
            demand.target_stages |= touch.stages;
            demand.target_accesses |= touch.accesses;
        }
        let written = history.write.as_ref();
        let since: Vec<&Event> =
            history.reads.iter().filter(|r| written.is_none_or(|w| r.time > w.event.time)).collect();
        // The change of layout comes after the reads; or, where there were none, after the write.
        if since.is_empty() {
            if let Some(write) = written {
                (demand.source_stages, demand.source_accesses) = self.source(write);
                demand.after.push(write.event.pass);
                demand.across_frames = write.event.time < self.frame_start;
                let reads = demand.target_accesses.reads();
                demand.hazard =
                    if reads && !fresh { Hazard::ReadAfterWrite } else { Hazard::WriteAfterWrite };
            }
        } else {
            for read in since {
                demand.source_stages |= read.stages;
                demand.after.push(read.pass);
                demand.across_frames |= read.time < self.frame_start;
            }
            demand.after.sort();
            demand.after.dedup();
            if demand.target_accesses.writes() {
                demand.hazard = Hazard::WriteAfterRead;
            }
        }
        demand
    }

    /// What a write still needs of order after the reads before it.
    fn order_demand(&self, resource: ResourceId, touches: &[Touch]) -> Option<Demand> {
        let history = &self.resources[resource.index()];
        let mut demand: Option<Demand> = None;
        for touch in touches.iter().filter(|t| t.accesses.writes()) {
            for read in &history.reads {
                for (stage, target) in
                    read.stages.iter().flat_map(|s| touch.stages.iter().map(move |t| (s, t)))
                {
                    if self.ordered[index(target)][index(stage)] >= read.time {
                        continue;
                    }
                    let layouts = touch.layout.map(|layout| (layout, layout));
                    let demand = demand.get_or_insert_with(|| Demand::new(Hazard::WriteAfterRead, layouts));
                    demand.source_stages |= stage;
                    demand.target_stages |= target;
                    demand.across_frames |= read.time < self.frame_start;
                    if !demand.after.contains(&read.pass) {
                        demand.after.push(read.pass);
                    }
                }
            }
        }
        demand
    }

    /// Lets the barriers of one call act, on top of the order from before it.
    fn apply(&mut self, demands: &[(ResourceId, Demand)], pass: PassId, before: &Ordered) {
        for (resource, demand) in demands {
            self.order(demand, before);
            let now = self.now;
            let history = &mut self.resources[resource.index()];
            let mut visible = [Accesses::empty(); STAGES];
            for stage in demand.target_stages.iter() {
                visible[index(stage)] = demand.target_accesses;
            }
            let changed =
                |(old, new): &(Layout, Layout)| *old == Layout::Undefined || history.layout != Some(*new);
            if let Some((_, new)) = demand.layouts.filter(changed) {
                history.layout = Some(new);
                history.reads.clear();
                history.write = Some(Write {
                    // Just before the pass, whose reads count as reads since.
                    event: Event { stages: demand.target_stages, pass, time: now - 1 },
                    accesses: Accesses::empty(),
                    available: vec![(demand.target_stages, now)],
                    visible,
                });
            } else if let Some(write) = &mut history.write {
                // Another world may have asked for this barrier, after another write than the one of this world.
                let fresh = demand.source_stages.contains(write.event.stages)
                    && demand.source_accesses.contains(write.accesses);
                if fresh || demand.source_stages.iter().any(|s| available_to(before, write, s)) {
                    write.available.push((demand.target_stages, now));
                    for (seen, new) in write.visible.iter_mut().zip(visible) {
                        *seen |= new;
                    }
                }
            }
        }
    }

    fn order(&mut self, demand: &Demand, before: &Ordered) {
        for (to, from) in demand
            .target_stages
            .iter()
            .flat_map(|t| demand.source_stages.iter().map(move |s| (index(t), index(s))))
        {
            self.ordered[to][from] = self.ordered[to][from].max(self.now - 1);
            for (known, earlier) in self.ordered[to].iter_mut().zip(before[from]) {
                *known = (*known).max(earlier);
            }
        }
    }

    /// Notes what the pass did.
    fn record(&mut self, resource: ResourceId, touches: &[Touch], pass: PassId) {
        let now = self.now;
        let history = &mut self.resources[resource.index()];
        history.touched = true;
        let (mut stages, mut accesses) = (Stages::empty(), Accesses::empty());
        for touch in touches.iter().filter(|t| t.accesses.writes()) {
            stages |= touch.stages;
            accesses |= touch.accesses & Accesses::WRITES;
        }
        if !stages.is_empty() {
            history.reads.clear();
            history.write = Some(Write {
                event: Event { stages, pass, time: now },
                accesses,
                available: Vec::new(),
                visible: [Accesses::empty(); STAGES],
            });
        }
        for touch in touches.iter().filter(|t| !t.accesses.writes()) {
            history.reads.push(Event { stages: touch.stages, pass, time: now });
        }
    }
}
