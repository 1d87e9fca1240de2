//! Places transient resources with disjoint lifetimes in shared blocks of memory.
//!
//! A resource is alive from its first use in the frame to its last. A resource that outlives the frame (used by a
//! `Once` pass, or with a history) has its own block. Resources share whole blocks rather than offsets into one heap,
//! because only the device knows the size of an image.
//!
//! Sharing must not cost time. The next alias waits for the previous one, which would add a barrier call unless there
//! is one between the two anyway. An alias therefore only follows another if the other's last pass is on a lower level;
//! the level of a pass is the length of the longest chain of dependent passes before it.
//!
//! The packing is best fit by decreasing size: each resource goes into the smallest block that is free for its
//! lifetime.

use std::collections::BTreeMap;

use crate::ir::{BlockId, Pass, PassId, ResourceId, Run, Shape, Source, Use};
use crate::plan::{Block, Resource};

/// Maximum number of blocks tried per resource, from the smallest up; bounds the time of packing.
const MAX_TRIED: usize = 64;

/// First and last use within the frame, as positions in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Life {
    pub first: usize,
    pub last: usize,
    /// True if the last use is a write that no pass reads.
    ends_written: bool,
    /// Levels of the first pass, and of the last that reads or writes the contents.
    levels: (u32, u32),
}

/// Assigns a block to every transient resource that a pass uses, and returns the blocks. Without `share`, each
/// resource has its own.
pub(super) fn place(
    passes: &[Pass],
    frame: &[PassId],
    resources: &mut [Resource],
    share: bool,
) -> Vec<Block> {
    resources.iter_mut().for_each(|resource| resource.block = None);
    let lives = lives(passes, frame, resources);
    let mut touched = vec![false; resources.len()];
    passes.iter().flat_map(|p| &p.uses).for_each(|t| touched[t.resource.index()] = true);
    let mut by_size: Vec<usize> =
        (0..resources.len()).filter(|i| touched[*i] && resources[*i].source == Source::Transient).collect();
    by_size.sort_by_key(|i| (std::cmp::Reverse(resources[*i].bytes()), *i));

    let mut blocks: Vec<Block> = Vec::new();
    // Blocks that may be shared, each with the lifetimes of its aliases by first use, and true if it holds an image.
    let mut open: Vec<(BlockId, BTreeMap<usize, Life>, bool)> = Vec::new();
    for i in by_size {
        let image = matches!(resources[i].shape, Shape::Image { .. });
        let life = lives[i].filter(|_| share);
        // Blocks were created in descending size: the last are the smallest.
        let found = life.and_then(|life| {
            open.iter_mut().rev().take(MAX_TRIED).find(|(_, aliases, images)| {
                // A layout change cannot wait for writes through another resource. In a block with an image, the last
                // write of every alias must therefore be read.
                let written = life.ends_written || aliases.values().any(|l| l.ends_written);
                is_free(aliases, life) && !((image || *images) && written)
            })
        });
        let block = match (life, found) {
            (Some(life), Some((block, aliases, images))) => {
                aliases.insert(life.first, life);
                *images |= image;
                *block
            }
            (life, _) => {
                let block = BlockId(blocks.len() as u32);
                blocks.push(Block { aliases: Vec::new() });
                open.extend(life.map(|life| (block, BTreeMap::from([(life.first, life)]), image)));
                block
            }
        };
        blocks[block.index()].aliases.push(ResourceId(i as u32));
        resources[i].block = Some(block);
    }
    blocks
}

/// Returns the lifetimes within the frame. `None` for resources that are not transient, outlive a frame, or are not
/// written in it.
pub(super) fn lives(passes: &[Pass], frame: &[PassId], resources: &[Resource]) -> Vec<Option<Life>> {
    let mut lives: Vec<Option<Life>> = vec![None; resources.len()];
    let mut written = vec![false; resources.len()];
    let levels = levels(passes, frame, resources.len());
    for (position, id) in frame.iter().enumerate() {
        for touch in &passes[id.index()].uses {
            let writes = touch.accesses.writes();
            written[touch.resource.index()] |= writes;
            let life = lives[touch.resource.index()].get_or_insert(Life {
                first: position,
                last: position,
                ends_written: writes,
                levels: (levels[position], levels[position]),
            });
            // A shader that only asks for a buffer's length reads nothing that was written.
            if touch.accesses.is_empty() {
                life.last = position;
                continue;
            }
            // A pass may use a resource in several stages.
            life.ends_written = writes || life.last == position && life.ends_written;
            (life.last, life.levels.1) = (position, levels[position]);
        }
    }
    let once = passes.iter().filter(|p| p.run == Run::Once);
    once.flat_map(|p| &p.uses).for_each(|touch| lives[touch.resource.index()] = None);
    // Without a writer, shaders only ask for the size. An alias would have no access to wait for, and a shared image
    // would lose its layout.
    for ((life, resource), written) in lives.iter_mut().zip(resources).zip(written) {
        if resource.source != Source::Transient || resource.history.is_some() || !written {
            *life = None;
        }
    }
    lives
}

/// Computes the level of each position in the frame: the length of the longest chain of dependent passes before it.
fn levels(passes: &[Pass], frame: &[PassId], resources: usize) -> Vec<u32> {
    // Per resource, the lowest level at which it can be read, and the lowest at which it can be written.
    let mut ready = vec![(0, 0); resources];
    let level = |id: &PassId| {
        let uses = || passes[id.index()].uses.iter().filter(|touch| !touch.accesses.is_empty());
        let after = |touch: &Use| {
            let (read, written) = ready[touch.resource.index()];
            if touch.accesses.writes() { written } else { read }
        };
        let level = uses().map(after).max().unwrap_or(0);
        for touch in uses() {
            let (read, written) = &mut ready[touch.resource.index()];
            if touch.accesses.writes() {
                *read = level + 1;
            }
            *written = (*written).max(level + 1);
        }
        level
    };
    frame.iter().map(level).collect()
}

/// Returns true if no alias is alive during `life`, or so close to it that a pass would wait.
fn is_free(aliases: &BTreeMap<usize, Life>, life: Life) -> bool {
    // The aliases of a block are disjoint in time, so only the two neighbours can overlap `life`.
    let before = aliases.range(..=life.last).next_back();
    let after = aliases.range(life.last + 1..).next();
    before.is_none_or(|(_, other)| other.last < life.first && other.levels.1 < life.levels.0)
        && after.is_none_or(|(_, other)| life.levels.1 < other.levels.0)
}
