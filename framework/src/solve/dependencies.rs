//! Finds the dependencies: pairs of accesses whose order matters.
//!
//! The module walks the prologue and two frames, and keeps for every memory cell the last pass that wrote it and all
//! reads since. A read depends on the last write; a write depends on the reads since the last write, or on that write
//! if there are none. The second frame follows a frame like itself, so its dependencies hold for every frame.
//!
//! Layouts come first, because they follow from the order of the passes. For an API with layouts, a layout change is a
//! write of the image; other APIs ignore it. Each dependency therefore says whether the change waits for it. If only
//! the change waits, and not the pass, the hazard is [`Hazard::LayoutChange`].

use super::extents::{Extents, Group};
use crate::ir::{Accesses, Hazard, Layout, Masks, PassId, ResourceId, Run, Source, Stages, Use};
use crate::plan::{Dependency, LayoutChange, Plan, Since};
use std::ops::Range;

/// Lists the layout changes and the dependencies of a plan that has resources, ordered passes, and blocks.
pub(super) fn dependencies(plan: &Plan) -> (Vec<LayoutChange>, Vec<Dependency>) {
    let (prologue, frame) = (&plan.prologue, &plan.frame);
    let extents = Extents::of(plan);
    let changes = layout_changes(plan, &extents, prologue, frame);
    let mut walk = Walk {
        cells: vec![Cell::default(); extents.cells.len()],
        extents: &extents,
        changes: Changes::new(&changes, plan.passes.len()),
        part: Part::Prologue,
        found: Vec::new(),
    };
    for (part, passes) in [(Part::Prologue, prologue), (Part::First, frame), (Part::Second, frame)] {
        walk.part = part;
        // Every frame in flight has its own copy of resources that the host reads.
        for (resource, cells) in plan.resources.iter().zip(&extents.resources) {
            if resource.source == Source::Readback {
                walk.cells[cells.clone()].fill(Cell::default());
            }
        }
        passes.iter().for_each(|pass| walk.pass(*pass));
    }
    let mut dependencies = walk.found;
    dependencies.sort_by_key(|dependency| dependency.second);
    (changes, dependencies)
}

fn layout_changes(
    plan: &Plan,
    extents: &Extents,
    prologue: &[PassId],
    frame: &[PassId],
) -> Vec<LayoutChange> {
    // Resources whose contents survive from frame to frame: written by a `Once` pass, or with a history.
    let mut kept: Vec<bool> = plan.resources.iter().map(|r| r.history.is_some()).collect();
    for touch in plan.passes.iter().filter(|p| p.run == Run::Once).flat_map(|p| &p.uses) {
        kept[touch.resource.index()] |= touch.accesses.writes();
    }
    let shared: Vec<bool> = (plan.resources.iter())
        .map(|r| r.block.is_some_and(|block| plan.blocks[block.index()].aliases.len() > 1))
        .collect();
    let walk = |layouts: &mut [Layout], passes: &[PassId]| -> Vec<LayoutChange> {
        let mut touched = vec![false; plan.resources.len()];
        let mut changes = Vec::new();
        for before in passes {
            for group in &extents.passes[before.index()] {
                let at = group.resource.index();
                let first = !std::mem::replace(&mut touched[at], true);
                let uses = || group.accesses.iter().map(|access| &access.touch);
                let Some(new) = uses().find_map(|touch| touch.layout) else { continue };
                // An alias may have used the memory since the image's last use, so the layout is lost.
                let lost = first && shared[at] && !kept[at];
                if new == layouts[at] && !lost {
                    continue;
                }
                let fresh = first && !kept[at] || uses().any(|touch| touch.discards);
                let old = if fresh { Layout::Undefined } else { layouts[at] };
                layouts[at] = new;
                changes.push(LayoutChange {
                    image: group.resource,
                    old,
                    new,
                    before: *before,
                    handover: false,
                });
            }
        }
        changes
    };

    let mut start = vec![Layout::Undefined; plan.resources.len()];
    let mut changes = walk(&mut start, prologue);
    let mut steady = vec![Layout::Undefined; plan.resources.len()];
    walk(&mut steady, frame);
    let of_frame = walk(&mut steady.clone(), frame);
    // A frame expects some images in the layout that the previous frame leaves. Before the first frame, the handover
    // changes them from the prologue's layout.
    let mut met = vec![false; plan.resources.len()];
    for before in frame {
        for group in &extents.passes[before.index()] {
            let image = group.resource;
            let has_layout = group.accesses.iter().any(|access| access.touch.layout.is_some());
            if !has_layout || std::mem::replace(&mut met[image.index()], true) {
                continue;
            }
            let change = of_frame.iter().find(|change| (change.image, change.before) == (image, *before));
            let (old, new) = (start[image.index()], steady[image.index()]);
            if old != new && change.is_none_or(|change| change.old != Layout::Undefined) {
                changes.push(LayoutChange { image, old, new, before: *before, handover: true });
            }
        }
    }
    changes.extend(of_frame);
    changes
}

/// The images whose layouts change, by the pass that needs the change: just before the pass, or in the handover.
struct Changes {
    by_pass: Vec<Vec<ResourceId>>,
    handover: Vec<Vec<ResourceId>>,
}

impl Changes {
    fn new(changes: &[LayoutChange], passes: usize) -> Changes {
        let mut all = Changes { by_pass: vec![Vec::new(); passes], handover: vec![Vec::new(); passes] };
        for change in changes {
            let list = if change.handover { &mut all.handover } else { &mut all.by_pass };
            list[change.before.index()].push(change.image);
        }
        all
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Prologue,
    First,
    Second,
}

/// An access that a later one may conflict with.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mark {
    part: Part,
    pass: PassId,
    touch: Use,
    /// True if the image's layout has changed since this access.
    settled: bool,
}

impl Mark {
    fn is_of(&self, other: &Mark) -> bool {
        (self.part, self.pass) == (other.part, other.pass)
    }
}

/// The last write to a cell, and the reads since.
#[derive(Clone, Debug, Default)]
struct Cell {
    /// Accesses of one pass, which may write in several stages.
    writes: Vec<Mark>,
    reads: Vec<Mark>,
}

struct Walk<'a> {
    cells: Vec<Cell>,
    extents: &'a Extents,
    changes: Changes,
    part: Part,
    found: Vec<Dependency>,
}

impl Walk<'_> {
    fn pass(&mut self, pass: PassId) {
        let mut found = Vec::new();
        for group in &self.extents.passes[pass.index()] {
            self.accesses(pass, group, &mut found);
            let image = group.resource;
            let handed_over =
                self.part == Part::First && self.changes.handover[pass.index()].contains(&image);
            if handed_over || self.changes.by_pass[pass.index()].contains(&image) {
                self.change(pass, group, &mut found);
            }
        }
        self.found.append(&mut found);
        // Record the accesses only now, so that the pass does not depend on itself.
        for group in &self.extents.passes[pass.index()] {
            self.record(pass, group);
        }
    }

    fn accesses(&self, pass: PassId, group: &Group, found: &mut Vec<Dependency>) {
        for access in &group.accesses {
            let (touch, write) = (access.touch, access.touch.accesses & Accesses::WRITES);
            let read = touch.accesses - Accesses::WRITES;
            for number in access.cells.iter().cloned().flatten() {
                let cell = &self.cells[number];
                let mut add = |hazard, first: &Mark, accesses| {
                    let target = (touch.stages, accesses);
                    self.add(found, hazard, first, (pass, group.resource), target, number, false);
                };
                // A write that waits for reads need not also wait for the write before them.
                let is_read = cell.writes.iter().any(|w| cell.reads.iter().any(|r| !r.is_of(w)));
                let seen = if is_read { read } else { touch.accesses };
                let hazard = match read.is_empty() || touch.discards {
                    true => Hazard::WriteAfterWrite,
                    false => Hazard::ReadAfterWrite,
                };
                for first in cell.writes.iter().filter(|_| !seen.is_empty()) {
                    add(hazard, first, seen);
                }
                for first in cell.reads.iter().filter(|_| !write.is_empty()) {
                    add(Hazard::WriteAfterRead, first, write);
                }
            }
        }
    }

    /// Adds the dependencies of the layout change before a pass. It depends on the reads since the last write or layout
    /// change, or without such reads on that write. A later change does not wait for these accesses again.
    fn change(&mut self, pass: PassId, group: &Group, found: &mut Vec<Dependency>) {
        let mut target = (Stages::empty(), Accesses::empty());
        for access in &group.accesses {
            target.0 |= access.touch.stages;
            target.1 |= access.touch.accesses;
        }
        let cells = self.extents.resources[group.resource.index()].clone();
        for number in cells.clone() {
            let cell = &self.cells[number];
            let reads = || cell.reads.iter().filter(|read| !read.settled);
            let unread = |write: &&Mark| !write.settled && !cell.reads.iter().any(|read| !read.is_of(write));
            for first in cell.writes.iter().filter(unread).chain(reads()) {
                let hazard = Hazard::LayoutChange;
                self.add(found, hazard, first, (pass, group.resource), target, number, true);
            }
        }
        for cell in &mut self.cells[cells] {
            cell.writes.iter_mut().chain(&mut cell.reads).for_each(|mark| mark.settled = true);
        }
    }

    /// Adds a dependency on an access to a cell, or adds the cell to a known dependency. Skips pairs that another part
    /// of the walk finds, too.
    #[expect(clippy::too_many_arguments)]
    fn add(
        &self,
        found: &mut Vec<Dependency>,
        hazard: Hazard,
        first: &Mark,
        (second, resource): (PassId, ResourceId),
        target: (Stages, Accesses),
        cell: usize,
        changes_layout: bool,
    ) {
        let since = match (first.part, self.part) {
            (Part::Prologue, Part::Prologue) | (Part::Second, Part::Second) => Since::Same,
            (Part::First, Part::Second) => Since::PreviousFrame,
            (Part::Prologue, Part::First) => Since::Prologue,
            // The walk finds the same dependency within the second frame, or from the prologue to the first.
            _ => return,
        };
        let accesses = match hazard {
            Hazard::WriteAfterRead => first.touch.accesses,
            _ if first.touch.accesses.writes() => first.touch.accesses & Accesses::WRITES,
            _ => first.touch.accesses,
        };
        let masks = Masks::new((first.touch.stages, accesses), target);
        let alias = Some(first.touch.resource).filter(|other| *other != resource);
        let bytes = self.extents.cells[cell].clone();
        let from = |d: &Dependency| {
            (d.first, d.since, d.resource, d.alias, d.masks.source())
                == (first.pass, since, resource, alias, masks.source())
        };
        // A change is part of its pass's dependency if both wait for the same accesses.
        let same = |d: &&mut Dependency| {
            from(d)
                && (changes_layout && d.hazard != Hazard::LayoutChange
                    || (d.hazard, d.masks) == (hazard, masks))
        };
        let mut known = false;
        for dependency in found.iter_mut().filter(|d| same(d)) {
            dependency.changes_layout |= changes_layout;
            dependency.bytes = hull(&dependency.bytes, &bytes);
            known = true;
        }
        if !known {
            found.push(Dependency {
                hazard,
                first: first.pass,
                second,
                since,
                resource,
                alias,
                bytes,
                changes_layout,
                masks,
            });
        }
    }

    fn record(&mut self, pass: PassId, group: &Group) {
        let mark = |touch| Mark { part: self.part, pass, touch, settled: false };
        let all = || group.accesses.iter().map(|access| (mark(access.touch), &access.cells));
        let writes = |mark: &Mark| mark.touch.accesses.writes();
        for (mark, cells) in all().filter(|(mark, _)| writes(mark)) {
            for cell in cells.iter().flat_map(|cells| cells.clone()) {
                let cell = &mut self.cells[cell];
                if cell.writes.first().is_none_or(|write| !write.is_of(&mark)) {
                    *cell = Cell::default();
                }
                cell.writes.push(mark);
            }
        }
        for (mark, cells) in all().filter(|(mark, _)| !writes(mark)) {
            for cell in cells.iter().flat_map(|cells| cells.clone()) {
                self.cells[cell].reads.push(mark);
            }
        }
    }
}

fn hull(one: &Range<u64>, other: &Range<u64>) -> Range<u64> {
    one.start.min(other.start)..one.end.max(other.end)
}
