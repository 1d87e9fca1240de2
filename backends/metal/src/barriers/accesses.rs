//! Lists what each pass touches, by its bytes and by the stages of Metal.
//!
//! Memory is cut into cells at every boundary of an access, so that the copy of one word of a buffer does not concern its other words,
//! and an alias of a block nothing beyond its own end. Memory of which each frame in flight has its own copy is not in here: no pass
//! writes what the host prepares, and of what the host reads it waits for the whole frame.

use super::{MemoryBarrier, RenderStages};
use splatgraph_framework::{ir::*, plan::*};
use std::collections::BTreeSet;
use std::ops::Range;

/// Describes what a pass does to some bytes.
#[derive(Clone, Debug)]
pub(super) struct Access {
    pub resource: ResourceId,
    /// The stage at which it starts: the first one for what has no stages, like a dispatch.
    pub from: RenderStages,
    /// The stage at whose end it is over: the last one for what has no stages.
    pub to: RenderStages,
    pub reads: bool,
    pub writes: bool,
    /// As a target of a draw: in order with those of other draws in the encoder.
    pub target: bool,
    /// Buffer or texture.
    pub scope: MemoryBarrier,
    pub cells: Range<usize>,
}

impl Access {
    /// Returns true if one of the two must wait for the other.
    pub fn conflicts(&self, other: &Access) -> bool {
        (self.writes || other.writes)
            && self.cells.start.max(other.cells.start) < self.cells.end.min(other.cells.end)
    }

    /// Returns true if an encoder keeps the two in order by itself.
    pub fn in_order(&self, other: &Access) -> bool {
        self.target && other.target && self.resource == other.resource
    }
}

/// Holds the accesses of all passes of a plan.
pub(super) struct Footprints {
    /// By pass.
    pub passes: Vec<Vec<Access>>,
    /// Number of cells.
    pub cells: usize,
}

/// Describes an access before memory is cut.
struct Extent {
    access: Access,
    bytes: Range<u64>,
}

impl Footprints {
    pub fn of(plan: &Plan) -> Footprints {
        let extents: Vec<Vec<Extent>> = plan.passes.iter().map(|pass| extents(plan, pass)).collect();

        // A piece of memory for each block, and one for each resource in none.
        let mut pieces = plan.blocks.len();
        let piece: Vec<usize> = (plan.resources.iter())
            .map(|resource| match resource.block {
                Some(block) => block.index(),
                None => {
                    pieces += 1;
                    pieces - 1
                }
            })
            .collect();
        let mut cuts: Vec<BTreeSet<u64>> = vec![BTreeSet::new(); pieces];
        for extent in extents.iter().flatten() {
            cuts[piece[extent.access.resource.index()]].extend([extent.bytes.start, extent.bytes.end]);
        }
        let cuts: Vec<Vec<u64>> = cuts.into_iter().map(|cuts| cuts.into_iter().collect()).collect();
        let mut cells = 0;
        let first: Vec<usize> = (cuts.iter())
            .map(|cuts| {
                cells += cuts.len().saturating_sub(1);
                cells - cuts.len().saturating_sub(1)
            })
            .collect();

        let placed = |Extent { access, bytes }: Extent| {
            let piece = piece[access.resource.index()];
            let at = |byte| first[piece] + cuts[piece].partition_point(|cut| *cut < byte);
            Access { cells: at(bytes.start)..at(bytes.end), ..access }
        };
        let passes = extents.into_iter().map(|of| of.into_iter().map(placed).collect()).collect();
        Footprints { passes, cells }
    }

    pub fn pass(&self, id: PassId) -> &[Access] {
        &self.passes[id.index()]
    }
}

fn extents(plan: &Plan, pass: &Pass) -> Vec<Extent> {
    const COLOR: Accesses = Accesses::COLOR_READ.union(Accesses::COLOR_WRITE);
    use RenderStages::{Fragment, Vertex};
    let mut extents = Vec::new();
    for touch in &pass.uses {
        let resource = plan.resource(touch.resource);
        if resource.source.is_per_frame() {
            continue;
        }
        let texture = matches!(resource.shape, Shape::Image { .. });
        let scope = MemoryBarrier { buffers: !texture, textures: texture };
        let whole = 0..resource.bytes();
        let mut add = |(from, to), accesses: Accesses, bytes: Range<u64>| {
            if !accesses.is_empty() && !bytes.is_empty() {
                let (writes, target) = (accesses.writes(), accesses.intersects(COLOR));
                let reads = accesses.reads() && !touch.discards;
                let access =
                    Access { resource: touch.resource, from, to, reads, writes, target, scope, cells: 0..0 };
                extents.push(Extent { access, bytes });
            }
        };
        let arguments = touch.accesses & Accesses::INDIRECT_READ;
        let others = touch.accesses - arguments;
        match &pass.work {
            Work::Draw { call, .. } => {
                if let DrawCall::Indirect { buffer, offset } = *call
                    && buffer == touch.resource
                {
                    add((Vertex, Vertex), arguments, offset..offset + 16);
                }
                for (stage, at, accesses) in [
                    (Stages::VERTEX, Vertex, others - COLOR),
                    (Stages::FRAGMENT, Fragment, others - COLOR),
                    (Stages::COLOR_OUTPUT, Fragment, others & COLOR),
                ] {
                    if touch.stages.contains(stage) {
                        add((at, at), accesses, whole.clone());
                    }
                }
            }
            Work::Dispatch { groups, .. } => {
                if let Groups::Indirect { buffer, offset } = *groups
                    && buffer == touch.resource
                {
                    add((Vertex, Fragment), arguments, offset..offset + 12);
                }
                add((Vertex, Fragment), others, whole);
            }
            // The words of statistics; the output is none, and copied whole.
            Work::Export if plan.stats.iter().any(|stat| stat.buffer == touch.resource) => {
                for stat in plan.stats.iter().filter(|stat| stat.buffer == touch.resource) {
                    add((Vertex, Fragment), others, stat.offset..stat.offset + 4);
                }
            }
            Work::Fill { .. } | Work::ClearHistory { .. } | Work::Export => {
                add((Vertex, Fragment), others, whole)
            }
            Work::Host => {}
        }
    }
    extents
}
