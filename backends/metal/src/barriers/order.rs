//! Finds what has to wait for what, in a walk over prologue and frames with a state of all memory.
//!
//! For each cell the state has the last write and the reads since: what conflicts with an older access is ordered after it through
//! these. The walk takes the prologue and two frames. The second frame follows a frame like itself, as all later ones do, so its waits
//! and barriers are those of every frame.
//!
//! **Barriers.** Within an encoder, an access and a later one that conflicts with it need a barrier somewhere between them. One that is
//! placed as late as possible, before the first pass that needs it, serves as many as any: no other choice has fewer. A conflict that a
//! barrier could cover but for its scope adds to the last barrier's scope.
//!
//! **Fences.** An encoder has to wait for those that it conflicts with, but for those that another wait implies: what is left is
//! the transitive reduction, which is unique. Draws have two beginnings and two ends, of vertices and of fragments. Fragments wait for
//! whatever their vertices wait for, and who waits for fragments waits for their vertices, too; nothing else of the two is mixed, so
//! that vertices can run ahead.

use super::accesses::{Access, Footprints};
use super::divide::Group;
use super::fences::{self, Wait};
use super::*;

/// An access that later ones may conflict with.
#[derive(Clone, Debug)]
struct Mark {
    instance: usize,
    /// Index of the pass in its encoder.
    position: usize,
    pass: PassId,
    access: Access,
}

#[derive(Clone, Default)]
struct Cell {
    writes: Vec<Mark>,
    reads: Vec<Mark>,
}

/// An access that has to come after another.
struct Need {
    after: Mark,
    before: RenderStages,
    pass: PassId,
    resource: ResourceId,
    hazard: Hazard,
    scope: MemoryBarrier,
}

/// A wait: of the stage `before` of an encoder for the end of the stage `after` of an earlier one.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Edge {
    source: usize,
    after: RenderStages,
    before: RenderStages,
}

struct Walk<'a> {
    footprints: &'a Footprints,
    cells: Vec<Cell>,
    /// By instance of an encoder: in the prologue, the first frame and the second.
    waits: Vec<Vec<Edge>>,
    /// The last search that came by, for the end of each stage; and the number of searches.
    seen: Vec<u32>,
    searches: u32,
}

/// The outcome for one encoder.
struct Ordered {
    barriers: Vec<Option<MemoryBarrier>>,
    /// With the waits that they are reasons for, by index; of barriers, with positions.
    waits: Vec<(usize, Need)>,
    inner: Vec<(usize, Need)>,
    handover: Vec<Need>,
}

/// Orders the encoders of a plan.
pub(super) fn order(
    prologue: Vec<Group>,
    frame: Vec<Group>,
    footprints: &Footprints,
) -> (Encoders, Vec<Cause>) {
    let mut walk = Walk {
        footprints,
        cells: vec![Cell::default(); footprints.cells],
        waits: Vec::new(),
        seen: Vec::new(),
        searches: 0,
    };
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
        add_reasons(&mut reasons, encoder, |point| Place::Prologue(index, point), |_| false);
    }
    let between = first.iter().flat_map(|encoder| &encoder.handover);
    between.for_each(|need| add_reason(&mut reasons, Place::Handover, need, false));
    for (index, encoder) in steady.iter().enumerate() {
        let previous = |need: &Need| need.after.instance < second;
        add_reasons(&mut reasons, encoder, |point| Place::Frame(index, point), previous);
    }

    let (once_fences, once_count) = fences::number(&once_waits, None);
    let (frame_fences, frame_count) = fences::number(&frame_waits, Some(frame.len()));
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
        fences: once_count.max(frame_count),
    };
    (encoders, reasons)
}

impl Walk<'_> {
    /// Takes the passes of the next encoder. Those of instances before `start` are the prologue, which the handover is for.
    fn encoder(&mut self, group: &Group, start: usize) -> Ordered {
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
                match need.after.instance {
                    source if source == instance => inner.push(need),
                    source if source < start => ordered.handover.push(need),
                    _ => outer.push(need),
                }
            }
            if group.kind == EncoderKind::Compute {
                place(&mut ordered, position, inner);
            }
            self.record(*pass, instance, position);
        }
        self.waits.push(Vec::new());
        let edges = self.reduce(&outer, instance);
        for need in outer {
            let meets = |edge: &Edge| {
                edge.source == need.after.instance
                    && need.after.access.to <= edge.after
                    && edge.before <= need.before
            };
            if let Some(index) = edges.iter().position(meets) {
                ordered.waits.push((index, need));
            }
        }
        self.waits[instance] = edges;
        ordered
    }

    /// Lists what a pass has to come after.
    fn needs(&self, pass: PassId) -> Vec<Need> {
        let mut needs: Vec<Need> = Vec::new();
        for access in self.footprints.pass(pass) {
            for cell in &self.cells[access.cells.clone()] {
                let read = cell.reads.iter().filter(|_| access.writes).map(|mark| (mark, true));
                for (mark, was_read) in cell.writes.iter().map(|mark| (mark, false)).chain(read) {
                    let hazard = match (was_read, access.reads) {
                        (true, _) => Hazard::WriteAfterRead,
                        (false, true) => Hazard::ReadAfterWrite,
                        (false, false) => Hazard::WriteAfterWrite,
                    };
                    let need = Need {
                        after: mark.clone(),
                        before: access.from,
                        pass,
                        resource: access.resource,
                        hazard,
                        scope: access.scope.union(mark.access.scope),
                    };
                    // The cells of a resource mostly ask for the same.
                    if !needs.iter().any(|other| other.same(&need)) {
                        needs.push(need);
                    }
                }
            }
        }
        needs
    }

    /// Puts the accesses of a pass into the state.
    fn record(&mut self, pass: PassId, instance: usize, position: usize) {
        let accesses = self.footprints.pass(pass);
        let mark = |access: &Access| Mark { instance, position, pass, access: access.clone() };
        for access in accesses.iter().filter(|access| access.writes) {
            for cell in &mut self.cells[access.cells.clone()] {
                // A pass may write in two stages.
                let others = cell.writes.iter().any(|write| (write.instance, write.pass) != (instance, pass));
                if others || cell.writes.is_empty() {
                    *cell = Cell::default();
                }
                cell.writes.push(mark(access));
            }
        }
        for access in accesses.iter().filter(|access| !access.writes) {
            for cell in &mut self.cells[access.cells.clone()] {
                // A later read of the same kind in the same encoder stands for an earlier one.
                let stands_for = |old: &Mark| {
                    (old.instance, old.access.from, old.access.resource, old.access.target)
                        == (instance, access.from, access.resource, access.target)
                };
                cell.reads.retain(|old| !stands_for(old));
                cell.reads.push(mark(access));
            }
        }
    }

    /// Chooses the waits that an encoder needs, without those that others imply.
    fn reduce(&mut self, needs: &[Need], instance: usize) -> Vec<Edge> {
        let edge = |need: &Need| Edge {
            source: need.after.instance,
            after: need.after.access.to,
            before: need.before,
        };
        let mut all: Vec<Edge> = needs.iter().map(edge).collect();
        // What implies another comes first: what is later, ends later, or begins earlier.
        all.sort_by_key(|edge| (std::cmp::Reverse((edge.source, edge.after)), edge.before));
        all.dedup();
        for edge in all {
            let kept = self.waits[instance].clone();
            let mut implied = kept
                .iter()
                .filter(|other| other.before <= edge.before)
                .map(|other| (other.source, other.after));
            if !implied.any(|end| self.reaches((edge.source, edge.after), end)) {
                self.waits[instance].push(edge);
            }
        }
        let mut edges = self.waits[instance].clone();
        edges.sort_by_key(|edge| (edge.source, edge.after, edge.before));
        edges
    }

    /// Returns true if the end of a stage comes before the end of another, or is it.
    fn reaches(&mut self, first: (usize, RenderStages), last: (usize, RenderStages)) -> bool {
        self.searches += 1;
        self.seen.resize(2 * self.waits.len(), 0);
        let mut open = vec![last];
        while let Some((instance, stage)) = open.pop() {
            if instance == first.0 && first.1 <= stage {
                return true;
            }
            let seen = &mut self.seen[2 * instance + stage as usize];
            if instance <= first.0 || std::mem::replace(seen, self.searches) == self.searches {
                continue;
            }
            // A stage ends after it began, and after the stages before it.
            let before = self.waits[instance].iter().filter(|edge| edge.before <= stage);
            open.extend(before.map(|edge| (edge.source, edge.after)));
        }
        false
    }
}

impl Need {
    fn same(&self, other: &Need) -> bool {
        let key = |need: &Need| {
            let Mark { instance, position, pass, ref access } = need.after;
            (instance, position, pass, access.to, access.resource, need.before, need.resource, need.hazard)
        };
        key(self) == key(other)
    }
}

/// Sees to it that there is a barrier between each of these accesses and the pass at `position`.
fn place(ordered: &mut Ordered, position: usize, mut needs: Vec<Need>) {
    needs.retain(|need| {
        let covers = |barrier: &Option<MemoryBarrier>| barrier.is_some_and(|b| b.contains(need.scope));
        !ordered.barriers[need.after.position + 1..position].iter().rev().any(covers)
    });
    // Those after the last barrier need a new one, which then serves all.
    needs.sort_by_key(|need| std::cmp::Reverse(need.after.position));
    for need in needs {
        let last = (need.after.position + 1..=position).rev().find(|at| ordered.barriers[*at].is_some());
        let at = last.unwrap_or(position);
        let barrier = ordered.barriers[at].get_or_insert_default();
        *barrier = barrier.union(need.scope);
        ordered.inner.push((at, need));
    }
}

fn add_reasons(
    reasons: &mut Vec<Cause>,
    encoder: &Ordered,
    at: impl Fn(Point) -> Place,
    previous: impl Fn(&Need) -> bool,
) {
    let mut waits: Vec<&(usize, Need)> = encoder.waits.iter().collect();
    waits.sort_by_key(|(wait, _)| *wait);
    for (wait, need) in waits {
        add_reason(reasons, at(Point::Wait(*wait)), need, previous(need));
    }
    let mut inner: Vec<&(usize, Need)> = encoder.inner.iter().collect();
    inner.sort_by_key(|(position, _)| *position);
    for (position, need) in inner {
        add_reason(reasons, at(Point::Barrier(*position)), need, false);
    }
}

/// Adds a need to the reasons.
///
/// It joins one that differs in the passes that are waited for alone, if there is one.
fn add_reason(reasons: &mut Vec<Cause>, at: Place, need: &Need, previous_frame: bool) {
    let resource = need.resource;
    let alias = Some(need.after.access.resource).filter(|other| *other != resource);
    let same = |reason: &&mut Cause| {
        (reason.at, reason.before, reason.resource, reason.alias, reason.previous_frame)
            == (at, need.pass, resource, alias, previous_frame)
    };
    // A pass that reads and writes is ordered by either.
    let read_first = |hazard| if hazard == Hazard::WriteAfterWrite { Hazard::ReadAfterWrite } else { hazard };
    let known = reasons.iter_mut().filter(same).find(|r| read_first(r.hazard) == read_first(need.hazard));
    match known {
        Some(reason) => {
            reason.hazard = reason.hazard.min(need.hazard);
            if !reason.after.contains(&need.after.pass) {
                reason.after.push(need.after.pass);
            }
        }
        None => reasons.push(Cause {
            at,
            hazard: need.hazard,
            before: need.pass,
            resource,
            after: vec![need.after.pass],
            previous_frame,
            alias,
        }),
    }
}
