//! Computes the byte ranges of accesses.
//!
//! Memory is cut into cells at the boundaries of a block's aliases, of indirect arguments, and of the words of
//! statistics. Dependencies are found per cell, so exporting one word of a buffer does not affect its other words, and
//! a new buffer in a block does not affect bytes beyond its end. An image covers its whole block: only the device knows
//! the size of an image, which is at least that of its texels.

use std::collections::BTreeSet;
use std::ops::Range;

use crate::ir::{Accesses, DrawCall, Groups, Pass, ResourceId, Shape, Stages, Use, Work};
use crate::plan::{Plan, Resource};

pub(super) struct Access {
    pub touch: Use,
    pub cells: Vec<Range<usize>>,
}

pub(super) struct Group {
    pub resource: ResourceId,
    pub accesses: Vec<Access>,
}

pub(super) struct Extents {
    /// The accesses of each pass by resource, in the order of first appearance. Reads of uniform blocks are left out,
    /// as are buffers of which a shader only asks for the length.
    pub passes: Vec<Vec<Group>>,
    /// The cells of each resource, as indices into `cells`.
    pub resources: Vec<Range<usize>>,
    /// The bytes of each cell, from the start of its memory. All resources of a block start there.
    pub cells: Vec<Range<u64>>,
}

impl Extents {
    pub fn of(plan: &Plan) -> Extents {
        // One memory per block, and per resource without a block.
        let mut pieces = plan.blocks.len();
        let mut piece_of = |resource: &Resource| match resource.block {
            Some(block) => block.index(),
            None => {
                pieces += 1;
                pieces - 1
            }
        };
        let piece: Vec<usize> = plan.resources.iter().map(&mut piece_of).collect();

        let mut cuts: Vec<BTreeSet<u64>> = vec![BTreeSet::from([0]); pieces];
        for (resource, piece) in plan.resources.iter().zip(&piece) {
            cuts[*piece].insert(resource.bytes());
        }
        let whole = |id: ResourceId| {
            let resource = plan.resource(id);
            let aliases = || plan.aliases(id).map(|alias| plan.resource(alias).bytes());
            match resource.shape {
                Shape::Buffer { .. } => 0..resource.bytes(),
                Shape::Image { .. } => 0..aliases().fold(resource.bytes(), u64::max),
            }
        };
        let bytes =
            |pass: &Pass, touch: &Use| part(plan, pass, touch).unwrap_or_else(|| vec![whole(touch.resource)]);
        for pass in &plan.passes {
            for touch in &pass.uses {
                let bytes = bytes(pass, touch);
                cuts[piece[touch.resource.index()]].extend(bytes.iter().flat_map(|b| [b.start, b.end]));
            }
        }
        let cuts: Vec<Vec<u64>> = cuts.into_iter().map(|cuts| cuts.into_iter().collect()).collect();
        let mut first = vec![0; pieces];
        let mut cells = Vec::new();
        for (first, cuts) in first.iter_mut().zip(&cuts) {
            *first = cells.len();
            cells.extend(cuts.windows(2).map(|pair| pair[0]..pair[1]));
        }

        let cells_of = |resource: ResourceId, bytes: &Range<u64>| {
            let piece = piece[resource.index()];
            let at = |byte| first[piece] + cuts[piece].partition_point(|cut| *cut < byte);
            at(bytes.start)..at(bytes.end)
        };
        let group = |pass: &Pass| {
            let mut groups: Vec<Group> = Vec::new();
            for touch in &pass.uses {
                // The host writes uniform blocks before the frame is submitted, which needs no barrier.
                if touch.accesses == Accesses::UNIFORM_READ || touch.accesses.is_empty() {
                    continue;
                }
                let cells = bytes(pass, touch).iter().map(|b| cells_of(touch.resource, b)).collect();
                let access = Access { touch: *touch, cells };
                match groups.iter_mut().find(|group| group.resource == touch.resource) {
                    Some(group) => group.accesses.push(access),
                    None => groups.push(Group { resource: touch.resource, accesses: vec![access] }),
                }
            }
            groups
        };
        let resources = (0..plan.resources.len() as u32).map(ResourceId);
        Extents {
            passes: plan.passes.iter().map(group).collect(),
            resources: resources.map(|id| cells_of(id, &whole(id))).collect(),
            cells,
        }
    }
}

/// Returns the byte ranges of indirect arguments or of exported statistics; `None` if the access covers the whole
/// resource.
#[allow(clippy::single_range_in_vec_init)] // A list of one range is meant, not a list of its numbers.
fn part(plan: &Plan, pass: &Pass, touch: &Use) -> Option<Vec<Range<u64>>> {
    let arguments = |buffer: ResourceId, offset: u64, bytes: u64| {
        (buffer == touch.resource && touch.stages == Stages::INDIRECT).then(|| vec![offset..offset + bytes])
    };
    match pass.work {
        Work::Dispatch { groups: Groups::Indirect { buffer, offset }, .. } => arguments(buffer, offset, 12),
        Work::Draw { call: DrawCall::Indirect { buffer, offset }, .. } => arguments(buffer, offset, 16),
        Work::Export => {
            let words = plan.stats.iter().filter(|stat| stat.buffer == touch.resource);
            let words: Vec<_> = words.map(|stat| stat.offset..stat.offset + 4).collect();
            // The readback buffer and the outputs have no statistics: they are used whole.
            (!words.is_empty()).then_some(words)
        }
        Work::Dispatch { groups: Groups::Direct(_), .. }
        | Work::Draw { call: DrawCall::Direct { .. }, .. }
        | Work::Fill { .. }
        | Work::ClearHistory { .. }
        | Work::Host => None,
    }
}
