//! Models Metal's rules: replays the encoders of a plan, and reports dependencies that they do not enforce.
//!
//! The model submits the prologue and a few frames, encoder by encoder, and records which encoders are complete when
//! each begins. An update stores this set in a fence, and a wait adds the stored set. Otherwise encoders and frames may
//! overlap. The model then checks every dependency in every frame: in different encoders, the earlier pass must be
//! complete; in one encoder, a barrier must separate the two passes. The framework's
//! [`oracle`](splatgraph_framework::oracle) checks that the dependencies are complete. The model shares no code with
//! the lowering, so a mistake goes unnoticed only if it is made twice.
//!
//! The rules are listed in [`crate::sync`]. Where they leave a choice, the model assumes the worst:
//!
//! - copies of one encoder may run at the same time;
//! - a barrier orders only accesses to the kinds of resources in its scope: buffers, textures or both;
//! - a wait refers to the last update submitted before it, not to earlier updates of the fence; without an update, it
//!   blocks nothing;
//! - an update may overtake a wait for the previous update, unless its encoder comes after the encoder that waits;
//! - the vertices of a draw wait only for fences before vertices, and an update after vertices does not include
//!   fragments;
//! - draws of one encoder are ordered only by their blending into its targets.
//!
//! [`mutate`] removes or weakens one wait, update or barrier at a time, or removes the handover: the model must object
//! each time.
//!
//! # Limits of the model
//!
//! It has no caches: in Metal, order implies visibility. It does not check that memory was written before it is read;
//! the model of the Vulkan backend does. It does not cover an executor's commands outside of the plan (inspection,
//! the copy of the output for another plan, the window).

use crate::sync::*;
use splatgraph_framework::{ir::*, plan::*};
use std::fmt;

pub mod mutate;
#[cfg(test)]
mod tests;

/// Number of frames to replay. The third is the first whose predecessor also follows a frame, not the prologue.
const FRAMES: u32 = 3;

/// A mistake in a list of encoders.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Objection {
    /// Two accesses may run at the same time.
    Unordered {
        /// The access of the pass submitted first.
        first: Actor,
        /// The access that does not wait for `first`.
        second: Actor,
        /// The resource of the second access.
        resource: ResourceId,
        /// The resource of the first access, if it is an alias of `resource`.
        through: Option<ResourceId>,
    },
    /// The encoders are malformed. They do not match the plan or are inconsistent, a fence is waited for without an
    /// update, or an update may overtake a wait. The text says which.
    Malformed(String),
}

/// A pass in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Actor {
    /// The pass of the plan.
    pub pass: PassId,
    /// The frame, from 0; `None` in the prologue.
    pub frame: Option<u32>,
}

impl Objection {
    /// Describes the mistake in a sentence.
    pub fn describe(&self, plan: &Plan) -> String {
        let name = |actor: &Actor| format!("`{}` ({actor})", plan.pass(actor.pass).name);
        match self {
            Objection::Malformed(text) => text.clone(),
            Objection::Unordered { first, second, resource, through } => {
                let through = through.map_or(String::new(), |id| {
                    format!(" as `{}` in the same memory", plan.resource(id).name)
                });
                format!(
                    "{} touches `{}` without waiting for {}, which touched it{through}",
                    name(second),
                    plan.resource(*resource).name,
                    name(first),
                )
            }
        }
    }

    /// Returns true if both are the same objection, ignoring frames and aliases.
    fn recurs_as(&self, other: &Objection) -> bool {
        match (self, other) {
            (
                Objection::Unordered { first, second, resource, .. },
                Objection::Unordered { first: other_first, second: other_second, resource: other, .. },
            ) => (first.pass, second.pass, resource) == (other_first.pass, other_second.pass, other),
            _ => self == other,
        }
    }
}

impl fmt::Display for Actor {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.frame {
            None => write!(f, "prologue"),
            Some(frame) => write!(f, "frame {frame}"),
        }
    }
}

/// A part of a pass. Draws have two parts; other passes have only `Rest`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Part {
    /// The vertex stage of a draw, with the reads of its arguments.
    Vertices,
    /// The fragment stage and targets of a draw, or the whole of another pass.
    Rest,
}

struct Pair<'a> {
    dependency: &'a Dependency,
    parts: [Part; 2],
    /// Scope that a barrier between the two needs, if they are in one encoder of dispatches.
    scope: MemoryBarrier,
    /// True if both access an attachment directly, not through an alias: draws of one encoder blend in order.
    blend: bool,
}

/// The model of a plan, which checks lists of encoders against the plan's dependencies.
pub struct Model<'a> {
    plan: &'a Plan,
    pairs: Vec<Pair<'a>>,
}

struct Submitted<'a> {
    encoding: &'a Encoding,
    frame: Option<u32>,
    /// Bit sets of the parts that are complete when the encoder's vertices begin, then when the rest begins.
    over: [Vec<u64>; 2],
}

impl<'a> Model<'a> {
    /// Creates the model: lists the pairs of parts that the plan's dependencies order.
    pub fn new(plan: &'a Plan) -> Model<'a> {
        let mut pairs = Vec::new();
        for dependency in &plan.dependencies {
            let Dependency { first, second, masks, resource, alias, .. } = dependency;
            if dependency.hazard == Hazard::LayoutChange || plan.pass(*second).work == Work::Host {
                continue;
            }
            let scope = scope(plan, *resource).union(scope(plan, alias.unwrap_or(*resource)));
            let attached = Stages::COLOR_OUTPUT | Stages::DEPTH_TESTS;
            let targets = attached.contains(masks.source_stages | masks.target_stages);
            for one in parts(plan, *first, masks.source_stages) {
                for other in parts(plan, *second, masks.target_stages) {
                    let (parts, blend) = ([one, other], targets && alias.is_none());
                    pairs.push(Pair { dependency, parts, scope, blend });
                }
            }
        }
        Model { plan, pairs }
    }

    /// Lists all mistakes in a list of encoders. A mistake that recurs in other frames is listed once.
    pub fn objections(&self, encoders: &Encoders) -> Vec<Objection> {
        let mut found = self.malformed(encoders);
        self.replay(encoders, |objection| {
            if !found.iter().any(|known| known.recurs_as(&objection)) {
                found.push(objection);
            }
            true
        });
        found
    }

    /// Returns true if any two accesses that depend on each other may run at the same time.
    pub fn finds_unordered(&self, encoders: &Encoders) -> bool {
        let mut found = false;
        self.replay(encoders, |_| {
            found = true;
            false
        });
        found
    }

    /// Submits all encoders and checks all dependencies. Stops once `found` returns false.
    fn replay(&self, encoders: &Encoders, mut found: impl FnMut(Objection) -> bool) {
        let submitted = submit(encoders);
        // For each pass, the encoders that contain it, and its index in each.
        let mut places: Vec<Vec<(usize, usize)>> = vec![Vec::new(); self.plan.passes.len()];
        for (instance, encoder) in submitted.iter().enumerate() {
            for (position, pass) in encoder.encoding.passes.iter().enumerate() {
                places[pass.pass.index()].push((instance, position));
            }
        }
        for pair in &self.pairs {
            let Dependency { first, second, since, resource, alias, .. } = *pair.dependency;
            for later in &places[second.index()] {
                let frame = submitted[later.0].frame;
                let waited_for = match since {
                    Since::Same => Some(frame),
                    Since::Prologue => Some(None),
                    Since::PreviousFrame => frame.and_then(|frame| frame.checked_sub(1)).map(Some),
                };
                let earlier =
                    places[first.index()].iter().find(|at| Some(submitted[at.0].frame) == waited_for);
                let Some(earlier) = earlier else { continue };
                if in_order(pair, &submitted, *earlier, *later) {
                    continue;
                }
                let objection = Objection::Unordered {
                    first: Actor { pass: first, frame: submitted[earlier.0].frame },
                    second: Actor { pass: second, frame },
                    resource,
                    through: alias,
                };
                if !found(objection) {
                    return;
                }
            }
        }
    }

    /// Lists encoders that do not match the plan or are inconsistent, and waits for fences without an update. If there
    /// are none, lists updates that may overtake a wait.
    fn malformed(&self, encoders: &Encoders) -> Vec<Objection> {
        let plan = self.plan;
        let mut found = Vec::new();
        let mut say = |text: String| found.push(Objection::Malformed(text));
        for (what, encodings, passes) in [
            ("the prologue", &encoders.prologue, &plan.prologue),
            ("the frame", &encoders.frame, &plan.frame),
        ] {
            let encoded = encodings.iter().flat_map(|encoding| &encoding.passes).map(|pass| pass.pass);
            let wanted = passes.iter().copied().filter(|id| plan.pass(*id).work != Work::Host);
            if !encoded.eq(wanted) {
                say(format!("{what} has other passes than the plan, or in another order"));
            }
            for (index, encoding) in encodings.iter().enumerate() {
                malformed(plan, encoding, encoders.fences, |text| {
                    say(format!("encoder {index} of {what} {text}"))
                });
            }
        }
        // Waits of the second frame follow every update of the first.
        let of_frame = encoders.frame.iter();
        let updated: Vec<u32> = of_frame.flat_map(|e| &e.updates).map(|fence| fence.fence).collect();
        for wait in encoders.frame.iter().flat_map(|encoding| &encoding.waits) {
            if !updated.contains(&wait.fence) {
                say(format!("fence {} is waited for in the frame and never updated in it", wait.fence));
            }
        }
        let mut updated = Vec::new();
        for encoding in &encoders.prologue {
            for wait in encoding.waits.iter().filter(|wait| !updated.contains(&wait.fence)) {
                say(format!("fence {} is waited for in the prologue before it is updated", wait.fence));
            }
            updated.extend(encoding.updates.iter().map(|fence| fence.fence));
        }
        if found.is_empty() {
            found.extend(overtaking(plan, encoders).into_iter().map(Objection::Malformed));
        }
        found
    }
}

/// Lists fence updates that may overtake a wait for the previous update, because nothing orders them.
fn overtaking(plan: &Plan, encoders: &Encoders) -> Vec<String> {
    let submitted = submit(encoders);
    let name = |instance: usize| &plan.pass(submitted[instance].encoding.passes[0].pass).name;
    let mut waiting: Vec<Vec<(usize, Part)>> = vec![Vec::new(); encoders.fences as usize];
    let mut found = Vec::new();
    for (instance, Submitted { encoding, over, .. }) in submitted.iter().enumerate() {
        for wait in &encoding.waits {
            waiting[wait.fence as usize].push((instance, part(wait)));
        }
        for update in &encoding.updates {
            let (fence, end) = (update.fence, part(update));
            // `malformed` checks that an encoder waits before it updates.
            let early = |(waiter, begin): &(usize, Part)| {
                *waiter != instance && !has(&over[end as usize], *waiter, *begin)
            };
            let waiters = std::mem::take(&mut waiting[fence as usize]);
            for (waiter, _) in waiters.into_iter().filter(early) {
                let (updater, waiter) = (name(instance), name(waiter));
                found.push(format!(
                    "the encoder of `{updater}` updates fence {fence}, for which the encoder of `{waiter}` may be waiting"
                ));
            }
        }
    }
    found.sort();
    found.dedup();
    found
}

fn in_order(pair: &Pair, submitted: &[Submitted], first: (usize, usize), second: (usize, usize)) -> bool {
    let (encoder, later) = (&submitted[first.0], &submitted[second.0]);
    if first.0 != second.0 {
        return has(&later.over[pair.parts[1] as usize], first.0, pair.parts[0]);
    }
    match encoder.encoding.kind {
        EncoderKind::Compute => (encoder.encoding.passes.iter().take(second.1 + 1).skip(first.1 + 1))
            .any(|pass| pass.barrier.is_some_and(|barrier| barrier.contains(pair.scope))),
        EncoderKind::Render => pair.blend,
        EncoderKind::Blit => false,
    }
}

/// Replays the prologue and [`FRAMES`] frames; records which parts are complete when each encoder begins.
fn submit(encoders: &Encoders) -> Vec<Submitted<'_>> {
    let frames =
        (0..FRAMES).flat_map(|frame| encoders.frame.iter().map(move |encoding| (encoding, Some(frame))));
    let all: Vec<_> = encoders.prologue.iter().map(|encoding| (encoding, None)).chain(frames).collect();
    let words = (2 * all.len()).div_ceil(64);
    let mut fences: Vec<Option<Vec<u64>>> = vec![None; encoders.fences as usize];
    let mut everyone_knows = vec![0; words];
    let mut submitted: Vec<Submitted> = Vec::with_capacity(all.len());
    for (instance, (encoding, frame)) in all.into_iter().enumerate() {
        if instance == encoders.prologue.len() && encoders.handover {
            for earlier in 0..instance {
                set(&mut everyone_knows, earlier, Part::Vertices);
                set(&mut everyone_knows, earlier, Part::Rest);
            }
        }
        let mut over = [everyone_knows.clone(), everyone_knows.clone()];
        for wait in &encoding.waits {
            let Some(Some(known)) = fences.get(wait.fence as usize) else { continue };
            // A wait before vertices delays fragments too.
            if wait.stages != Some(RenderStages::Fragment) {
                add(&mut over[Part::Vertices as usize], known);
            }
            add(&mut over[Part::Rest as usize], known);
        }
        for update in &encoding.updates {
            let after_vertices = update.stages == Some(RenderStages::Vertex);
            let mut known = over[if after_vertices { Part::Vertices } else { Part::Rest } as usize].clone();
            set(&mut known, instance, Part::Vertices);
            if !after_vertices {
                set(&mut known, instance, Part::Rest);
            }
            if let Some(fence) = fences.get_mut(update.fence as usize) {
                *fence = Some(known);
            }
        }
        submitted.push(Submitted { encoding, frame, over });
    }
    submitted
}

fn part(fence: &FenceUse) -> Part {
    if fence.stages == Some(RenderStages::Vertex) { Part::Vertices } else { Part::Rest }
}

fn bit(instance: usize, part: Part) -> (usize, u64) {
    let bit = 2 * instance + part as usize;
    (bit / 64, 1 << (bit % 64))
}

fn set(known: &mut [u64], instance: usize, part: Part) {
    let (word, bit) = bit(instance, part);
    known[word] |= bit;
}

fn has(known: &[u64], instance: usize, part: Part) -> bool {
    let (word, bit) = bit(instance, part);
    known[word] & bit != 0
}

fn add(known: &mut [u64], more: &[u64]) {
    known.iter_mut().zip(more).for_each(|(known, more)| *known |= more);
}

fn parts(plan: &Plan, pass: PassId, stages: Stages) -> Vec<Part> {
    let draws = matches!(plan.pass(pass).work, Work::Draw { .. });
    let early = Stages::INDIRECT | Stages::VERTEX;
    let vertices = (draws && stages.intersects(early)).then_some(Part::Vertices);
    let rest = (!draws || stages.intersects(!early)).then_some(Part::Rest);
    vertices.into_iter().chain(rest).collect()
}

fn scope(plan: &Plan, resource: ResourceId) -> MemoryBarrier {
    let textures = matches!(plan.resource(resource).shape, Shape::Image { .. });
    MemoryBarrier { buffers: !textures, textures }
}

fn malformed(plan: &Plan, encoding: &Encoding, fences: u32, mut say: impl FnMut(String)) {
    let Encoding { kind, waits, passes, updates } = encoding;
    if passes.is_empty() {
        say("holds no pass".into());
    }
    let mut targets: Option<Vec<ResourceId>> = None;
    for (position, EncodedPass { barrier, pass }) in passes.iter().enumerate() {
        let pass = plan.pass(*pass);
        let fits = match pass.work {
            Work::Dispatch { .. } | Work::Fill { .. } | Work::ClearHistory { .. } => {
                *kind == EncoderKind::Compute
            }
            Work::Draw { .. } => *kind == EncoderKind::Render,
            Work::Export => *kind == EncoderKind::Blit,
            Work::Host => false,
        };
        if !fits {
            say(format!("is of the kind {kind:?}, which `{}` is not", pass.name));
        }
        if let Some(MemoryBarrier { buffers, textures }) = barrier {
            if *kind != EncoderKind::Compute || position == 0 {
                say(format!("has a barrier before `{}`, where none can be", pass.name));
            }
            if !buffers && !textures {
                say(format!("has a barrier for nothing before `{}`", pass.name));
            }
        }
        if let Work::Draw { targets: of, depth, .. } = &pass.work {
            let mut images: Vec<ResourceId> = of.iter().map(|target| target.image).collect();
            images.extend(depth.map(|depth| depth.image));
            let clears = of.iter().any(|target| target.load != Load::Keep)
                || depth.is_some_and(|depth| depth.access == DepthAccess::Write);
            match &targets {
                Some(first) if *first != images || clears => {
                    say(format!("holds `{}`, which needs targets of its own", pass.name));
                }
                _ => targets = Some(images),
            }
        }
    }
    for (what, uses) in [("waits for", waits), ("updates", updates)] {
        for (index, FenceUse { fence, stages }) in uses.iter().enumerate() {
            if *fence >= fences {
                say(format!("{what} fence {fence} of {fences}"));
            }
            if stages.is_some() != (*kind == EncoderKind::Render) {
                say(format!("{what} fence {fence} at stages that it does not have"));
            }
            if uses[..index].iter().any(|other| other.fence == *fence) {
                say(format!("{what} fence {fence} twice"));
            }
        }
    }
    for wait in waits {
        let too_late = |update: &&FenceUse| update.fence == wait.fence && update.stages < wait.stages;
        if updates.iter().any(|update| too_late(&update)) {
            say(format!("updates fence {} before it waits for it", wait.fence));
        }
    }
}
