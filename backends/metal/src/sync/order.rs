//! Lowers dependencies to fences between encoders and barriers within them.
//!
//! The walk covers the prologue and two frames. The second frame follows a frame like itself, as every later frame
//! does, so its waits and barriers are sufficient in every frame.
//!
//! **Barriers.** A dependency within an encoder needs a barrier between its passes. Barriers are placed as late as
//! possible, before the first pass that needs one; no other placement has fewer. If an existing barrier lacks only a
//! part of the scope, the last such barrier is extended.
//!
//! **Fences.** An encoder waits for the encoders that it depends on, unless another wait implies it: the waits are the
//! transitive reduction, which is unique. Draws begin and end twice, for vertices and for fragments. Fragments wait for
//! everything that their vertices wait for, and a wait for fragments includes their vertices. Vertices can otherwise
//! run ahead.

use super::divide::{Group, ordering};
use super::encoding::*;
use super::fences::{self, Moment, Wait};
use splatgraph_framework::{ir::*, plan::*};

/// A dependency of a pass on a pass that has run, in the same encoder or an earlier one.
struct Need<'a> {
    dependency: &'a Dependency,
    /// Index of the earlier encoder in the walk, and of the earlier pass in that encoder.
    instance: usize,
    position: usize,
    /// The stage whose end is waited for, and the stage that waits.
    after: RenderStages,
    before: RenderStages,
    scope: MemoryBarrier,
}

/// A wait: stage `before` of an encoder waits for the end of stage `after` of an earlier encoder, `source`.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Edge {
    source: usize,
    after: RenderStages,
    before: RenderStages,
}

struct Walk<'a> {
    plan: &'a Plan,
    /// For each pass, the index of its last encoder in the walk, and of the pass in that encoder. `None` before the
    /// pass has run.
    places: Vec<Option<(usize, usize)>>,
    /// The waits of each encoder in the walk, which covers the prologue and two frames.
    waits: Vec<Vec<Edge>>,
}

/// The waits and barriers of one encoder, with their reasons.
struct Ordered<'a> {
    barriers: Vec<Option<MemoryBarrier>>,
    /// The dependencies that require waits, each with the wait's index. `inner` has those that require barriers, each
    /// with the barrier's position.
    waits: Vec<(usize, &'a Dependency)>,
    inner: Vec<(usize, &'a Dependency)>,
    handover: Vec<&'a Dependency>,
}

pub(super) fn order(plan: &Plan, prologue: Vec<Group>, frame: Vec<Group>) -> (Encoders, Vec<(At, Cause)>) {
    let mut walk = Walk { plan, places: vec![None; plan.passes.len()], waits: Vec::new() };
    let once: Vec<Ordered> = prologue.iter().map(|group| walk.encoder(group, 0)).collect();
    let start = once.len();
    let first: Vec<Ordered> = frame.iter().map(|group| walk.encoder(group, start)).collect();
    let second = start + first.len();
    let steady: Vec<Ordered> = frame.iter().map(|group| walk.encoder(group, start)).collect();

    let waits = |range: std::ops::Range<usize>, base: usize| -> Vec<Vec<Wait>> {
        let wait = |edge: &Edge| Wait {
            source: if edge.source < base { edge.source + frame.len() - base } else { edge.source - base },
            previous: edge.source < base,
            after: edge.after,
            before: edge.before,
        };
        walk.waits[range].iter().map(|edges| edges.iter().map(wait).collect()).collect()
    };
    let (once_waits, frame_waits) = (waits(0..start, 0), waits(second..second + frame.len(), second));
    let handover = first.iter().any(|encoder| !encoder.handover.is_empty());

    let mut reasons = Vec::new();
    for (index, encoder) in once.iter().enumerate() {
        add_reasons(&mut reasons, encoder, |point| At::Prologue(index, point));
    }
    let between = first.iter().flat_map(|encoder| &encoder.handover);
    between.for_each(|dependency| add_reason(&mut reasons, At::Handover, dependency));
    for (index, encoder) in steady.iter().enumerate() {
        add_reasons(&mut reasons, encoder, |point| At::Frame(index, point));
    }

    let (once_fences, once_count) = fences::number(&once_waits, None);
    let (mut frame_fences, frame_count) = fences::number(&frame_waits, Some(frame.len()));
    // Without the handover, the prologue may still use its fences when the frame begins.
    let first_fence = if handover { 0 } else { once_count };
    let both = frame_fences.iter_mut().flat_map(|(waits, updates)| waits.iter_mut().chain(updates));
    both.for_each(|(fence, _)| *fence += first_fence);
    let encoding = |(group, ordered): (Group, Ordered), (waits, updates): (Vec<_>, Vec<_>)| {
        let stages = |(fence, stages)| FenceUse {
            fence,
            stages: (group.kind == EncoderKind::Render).then_some(stages),
        };
        let passes = group.passes.iter().zip(ordered.barriers);
        Encoding {
            kind: group.kind,
            waits: waits.into_iter().map(stages).collect(),
            passes: passes.map(|(pass, barrier)| EncodedPass { barrier, pass: *pass }).collect(),
            updates: updates.into_iter().map(stages).collect(),
        }
    };
    let encodings = |groups: Vec<Group>, ordered: Vec<Ordered>, fences: Vec<_>| -> Vec<Encoding> {
        groups.into_iter().zip(ordered).zip(fences).map(|(one, fences)| encoding(one, fences)).collect()
    };
    let encoders = Encoders {
        prologue: encodings(prologue, once, once_fences),
        handover,
        frame: encodings(frame, steady, frame_fences),
        fences: once_count.max(first_fence + frame_count),
    };
    (encoders, reasons)
}

impl<'a> Walk<'a> {
    /// Walks over the next encoder, and returns its waits and barriers.
    ///
    /// `start` is the index of the frame's first encoder in the walk (0 for an encoder of the prologue): the handover
    /// orders the encoders before it.
    fn encoder(&mut self, group: &Group, start: usize) -> Ordered<'a> {
        let instance = self.waits.len();
        let mut ordered = Ordered {
            barriers: vec![None; group.passes.len()],
            waits: Vec::new(),
            inner: Vec::new(),
            handover: Vec::new(),
        };
        let mut outer = Vec::new();
        for (position, pass) in group.passes.iter().enumerate() {
            let mut inner = Vec::new();
            for need in self.needs(*pass) {
                match need.instance {
                    source if source == instance => inner.push(need),
                    source if source < start => ordered.handover.push(need.dependency),
                    _ => outer.push(need),
                }
            }
            if group.kind == EncoderKind::Compute {
                place(&mut ordered, position, inner);
            }
            self.places[pass.index()] = Some((instance, position));
        }
        self.waits.push(Vec::new());
        let edges = self.reduce(&outer, instance);
        for need in outer {
            let meets = |edge: &Edge| {
                edge.source == need.instance && need.after <= edge.after && edge.before <= need.before
            };
            if let Some(index) = edges.iter().position(meets) {
                ordered.waits.push((index, need.dependency));
            }
        }
        self.waits[instance] = edges;
        ordered
    }

    /// Lists the dependencies of a pass on passes that have already run in the walk.
    fn needs(&self, pass: PassId) -> Vec<Need<'a>> {
        let need = |dependency: &'a Dependency| {
            let (instance, position) = self.places[dependency.first.index()]?;
            let Dependency { first, second, masks, resource, alias, .. } = dependency;
            Some(Need {
                dependency,
                instance,
                position,
                after: RenderStages::last(self.plan.pass(*first), masks.source_stages),
                before: RenderStages::first(self.plan.pass(*second), masks.target_stages),
                scope: [Some(*resource), *alias]
                    .into_iter()
                    .flatten()
                    .fold(MemoryBarrier::default(), |scope, id| {
                        scope.union(MemoryBarrier::on(self.plan, id))
                    }),
            })
        };
        ordering(self.plan, pass).filter_map(need).collect()
    }

    /// Adds the waits that an encoder needs: one per need, except those that another wait implies. Returns them sorted.
    fn reduce(&mut self, needs: &[Need], instance: usize) -> Vec<Edge> {
        let edge = |need: &Need| Edge { source: need.instance, after: need.after, before: need.before };
        let mut all: Vec<Edge> = needs.iter().map(edge).collect();
        // An edge that implies another comes first: a later source, a later end, or an earlier beginning.
        all.sort_by_key(|edge| (std::cmp::Reverse((edge.source, edge.after)), edge.before));
        all.dedup();
        for edge in all {
            let mut kept = self.waits[instance].iter().filter(|other| other.before <= edge.before);
            if !kept.any(|other| self.reaches((edge.source, edge.after), (other.source, other.after))) {
                self.waits[instance].push(edge);
            }
        }
        let mut edges = self.waits[instance].clone();
        edges.sort_by_key(|edge| (edge.source, edge.after, edge.before));
        edges
    }

    fn reaches(&self, first: Moment, last: Moment) -> bool {
        fences::ends_before(first, last, |(instance, stage), open| {
            let before = self.waits[instance].iter().filter(|edge| edge.before <= stage);
            open.extend(before.map(|edge| (edge.source, edge.after)));
        })
    }
}

/// Places or extends barriers between the earlier passes of `needs` and the pass at `position` of an encoder. Skips the
/// needs that existing barriers meet.
fn place<'a>(ordered: &mut Ordered<'a>, position: usize, mut needs: Vec<Need<'a>>) {
    needs.retain(|need| {
        let covers = |barrier: &Option<MemoryBarrier>| barrier.is_some_and(|b| b.contains(need.scope));
        !ordered.barriers[need.position + 1..position].iter().rev().any(covers)
    });
    // Needs after the last barrier require a new one, which then serves all.
    needs.sort_by_key(|need| std::cmp::Reverse(need.position));
    for need in needs {
        let last = (need.position + 1..=position).rev().find(|at| ordered.barriers[*at].is_some());
        let at = last.unwrap_or(position);
        let barrier = ordered.barriers[at].get_or_insert_default();
        *barrier = barrier.union(need.scope);
        ordered.inner.push((at, need.dependency));
    }
}

fn add_reasons(reasons: &mut Vec<(At, Cause)>, encoder: &Ordered, at: impl Fn(Point) -> At) {
    let mut waits = encoder.waits.clone();
    waits.sort_by_key(|(wait, _)| *wait);
    for (wait, dependency) in waits {
        add_reason(reasons, at(Point::Wait(wait)), dependency);
    }
    let mut inner = encoder.inner.clone();
    inner.sort_by_key(|(position, _)| *position);
    for (position, dependency) in inner {
        add_reason(reasons, at(Point::Barrier(position)), dependency);
    }
}

/// Adds a dependency to the reasons of a wait or barrier. Merges it into a reason that differs only in the earlier
/// passes, or only in the hazard: read after write or write after write.
fn add_reason(reasons: &mut Vec<(At, Cause)>, at: At, dependency: &Dependency) {
    let Dependency { hazard, first, second, since, resource, alias, .. } = *dependency;
    let previous_frame = since == Since::PreviousFrame;
    let same = |(known_at, reason): &&mut (At, Cause)| {
        (*known_at, reason.before, reason.resource, reason.alias, reason.previous_frame)
            == (at, second, resource, alias, previous_frame)
    };
    // A pass that reads and writes can have either hazard; both count as the same reason.
    let read_first = |hazard| if hazard == Hazard::WriteAfterWrite { Hazard::ReadAfterWrite } else { hazard };
    let known = reasons.iter_mut().filter(same).find(|(_, r)| read_first(r.hazard) == read_first(hazard));
    match known {
        Some((_, reason)) => {
            reason.hazard = reason.hazard.min(hazard);
            if !reason.after.contains(&first) {
                reason.after.push(first);
            }
        }
        None => {
            let (before, after) = (second, vec![first]);
            reasons.push((at, Cause { hazard, before, resource, after, previous_frame, alias }));
        }
    }
}
