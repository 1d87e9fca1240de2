//! Stores the barrier calls of a replay, which are applied to each cell lazily.
//!
//! A barrier applies to all memory, and a graph may have thousands of calls and cells. But most calls equal others, and
//! a call only ever adds stages to a record's sets, so few calls change a record. Equal calls are therefore grouped
//! into kinds. A cell that passes through many calls skips the calls that do not change it.

use std::collections::HashMap;

use super::cell::{Cell, Scope};
use crate::sync::barrier::Barrier;
use splatgraph_framework::ir::Masks;
use splatgraph_framework::plan::Transition;

/// The barriers of a call without their causes. Calls with equal keys are of one kind.
type Key = Vec<(Option<Transition>, Masks)>;

#[derive(Default)]
pub struct Calls {
    /// The kind of each call, an index into `kinds`.
    calls: Vec<u32>,
    kinds: Vec<Kind>,
    numbers: HashMap<Key, u32>,
}

struct Kind {
    scopes: Vec<Scope>,
    /// The numbers of the calls of this kind, ascending.
    calls: Vec<u32>,
}

/// Number of calls (or of kinds, if larger) up to which a cell passes through each call instead of searching.
const FEW: usize = 8;

impl Calls {
    pub fn len(&self) -> usize {
        self.calls.len()
    }

    pub fn add(&mut self, barriers: &[Barrier]) {
        let masks = |b: &Barrier| (b.image, b.masks);
        let kinds = &mut self.kinds;
        let kind = *self.numbers.entry(barriers.iter().map(masks).collect()).or_insert_with(|| {
            kinds.push(Kind { scopes: barriers.iter().map(Scope::new).collect(), calls: Vec::new() });
            kinds.len() as u32 - 1
        });
        self.kinds[kind as usize].calls.push(self.calls.len() as u32);
        self.calls.push(kind);
    }

    pub fn truncate(&mut self, len: usize) {
        for kind in self.calls.drain(len..) {
            self.kinds[kind as usize].calls.pop();
        }
    }

    /// Applies to a cell the calls from number `passed` on, and updates `passed`.
    pub fn pass(&self, cell: &mut Cell, passed: &mut u32) {
        let end = self.calls.len() as u32;
        if cell.reads.is_empty() && cell.writes.is_empty() {
            *passed = end;
        }
        while *passed < end {
            let left = (end - *passed) as usize;
            let next =
                if left <= FEW.max(self.kinds.len()) { Some(*passed) } else { self.change(cell, *passed) };
            let Some(next) = next else { break };
            cell.pass_through(&self.kinds[self.calls[next as usize] as usize].scopes);
            *passed = next + 1;
        }
        *passed = end;
    }

    /// Returns the first call, from number `passed` on, that changes the cell; `None` if none does.
    fn change(&self, cell: &Cell, passed: u32) -> Option<u32> {
        let kinds = self.kinds.iter().filter(|kind| cell.is_changed_by(&kind.scopes));
        let next = |kind: &Kind| kind.calls.get(kind.calls.partition_point(|call| *call < passed)).copied();
        kinds.filter_map(next).min()
    }
}
