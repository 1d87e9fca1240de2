//! Lists the accesses of each pass with their byte ranges, ignoring barriers.
//!
//! Memory is cut into cells at every boundary of an access, so that an access always covers whole cells. Blocks come
//! first, then the memory of the resources outside blocks. Resources that the host accesses have one set of cells per
//! copy. An image has no end: its texels may lie anywhere in its memory, and only the device knows how much that is.

use std::ops::Range;

use super::stages::{performed_by, stood_for_by};
use crate::ir::{
    Accesses, DrawCall, Groups, Layout, PassId, ReflectedBinding, ResourceId, Run, Shape, Source, Stages,
    Use, Work,
};
use crate::plan::{Plan, Resource};

/// One kind of access at one stage.
#[derive(Clone)]
pub struct Access {
    /// The accessed resource.
    pub resource: ResourceId,
    /// The pipeline stage, one bit.
    pub stage: Stages,
    /// Stages that cover the access in a source mask.
    pub named_by: Stages,
    /// The kind of access, one bit.
    pub access: Accesses,
    /// True if the access reads data written before the pass.
    pub needs_contents: bool,
    atomic: bool,
    /// The cells in the first copy.
    cells: Range<usize>,
    /// Cells from one copy to the next; 0 if the host does not access the resource.
    stride: usize,
}

impl Access {
    /// Returns the cells of the access in the copy with index `copy`.
    pub fn cells(&self, copy: u32) -> Range<usize> {
        let offset = self.stride * copy as usize;
        self.cells.start + offset..self.cells.end + offset
    }

    /// Returns true if the access writes.
    pub fn writes(&self) -> bool {
        self.access.writes()
    }
}

/// Two accesses of one pass to the same memory that no barrier can order. They are through different resources, or at
/// different stages.
#[derive(Clone)]
pub struct Clash {
    /// The earlier of the two in [`Actions::accesses`].
    pub first: Access,
    /// The later of the two.
    pub second: Access,
}

/// A pass's effects on memory.
#[derive(Default)]
pub struct Actions {
    /// Every access at every stage.
    pub accesses: Vec<Access>,
    /// The layouts in which the pass expects images.
    pub layouts: Vec<(ResourceId, Layout)>,
    /// Conflicts between accesses of the pass itself.
    pub clashes: Vec<Clash>,
}

/// The cells of a resource.
pub struct ResourceCells {
    /// All cells of the resource's memory in the first copy; `own` has only the resource's.
    all: Range<usize>,
    own: Range<usize>,
    stride: usize,
    /// Images that lose their layout when this resource is written.
    pub alias_images: Vec<ResourceId>,
    /// True if reads must find data of the same frame: the contents do not persist between frames.
    pub fresh: bool,
    /// True if the host writes the resource for every frame: uniform blocks, live parameters and host buffers.
    pub host_writes: bool,
    /// True for an attribute of the scene, which is filled before the prologue.
    pub uploaded: bool,
}

impl ResourceCells {
    /// Returns the resource's own cells in the copy with index `copy`.
    pub fn cells(&self, copy: u32) -> Range<usize> {
        let offset = self.stride * copy as usize;
        self.own.start + offset..self.own.end + offset
    }

    /// Returns true if each frame in flight has a copy.
    pub fn per_frame(&self) -> bool {
        self.stride != 0
    }
}

/// The accesses of all passes, and the cells of memory.
pub struct Trace {
    /// Effects of each pass, indexed by [`PassId`].
    pub passes: Vec<Actions>,
    /// Cells of each resource, indexed by [`ResourceId`].
    pub resources: Vec<ResourceCells>,
    /// Byte range of each cell, from the start of its memory.
    pub cells: Vec<Range<u64>>,
}

/// An access before memory is cut into cells.
struct Extent {
    pass: usize,
    resource: ResourceId,
    stage: Stages,
    access: Accesses,
    needs_contents: bool,
    bytes: Range<u64>,
}

impl Trace {
    /// Lists the accesses of a plan. `copies` is the number of copies of resources that the host accesses.
    pub fn new(plan: &Plan, copies: u32) -> Trace {
        let extents: Vec<Extent> =
            plan.passes.iter().enumerate().flat_map(|(index, _)| extents(plan, index)).collect();
        let (mut places, cells) = cut(plan, &extents, copies.max(1));

        // Data that the prologue writes can be read in every frame.
        for extent in extents.iter().filter(|extent| extent.access.writes()) {
            let place = &mut places[extent.resource.index()];
            place.fresh &= plan.passes[extent.pass].run != Run::Once;
        }

        let mut passes: Vec<Actions> = plan.passes.iter().map(|_| Actions::default()).collect();
        for extent in &extents {
            let place = &places[extent.resource.index()];
            passes[extent.pass].accesses.push(Access {
                resource: extent.resource,
                stage: extent.stage,
                named_by: stood_for_by(
                    extent.stage,
                    matches!(plan.passes[extent.pass].work, Work::Dispatch { .. }),
                ),
                access: extent.access,
                needs_contents: extent.needs_contents && !asks_size(plan, extent),
                atomic: is_atomic(plan, extent),
                cells: covered(&cells, &place.all, &extent.bytes),
                stride: place.stride,
            });
        }
        for (actions, pass) in passes.iter_mut().zip(&plan.passes) {
            actions.layouts =
                pass.uses.iter().filter_map(|t| t.layout.map(|layout| (t.resource, layout))).collect();
            actions.clashes = clashes(&actions.accesses);
        }
        Trace { passes, resources: places, cells }
    }

    /// Returns the actions of a pass.
    pub fn actions(&self, pass: PassId) -> &Actions {
        &self.passes[pass.index()]
    }

    /// Returns the cells of a resource.
    pub fn resource(&self, id: ResourceId) -> &ResourceCells {
        &self.resources[id.index()]
    }
}

/// Returns the cells in `of` that lie in `bytes`.
fn covered(cells: &[Range<u64>], of: &Range<usize>, bytes: &Range<u64>) -> Range<usize> {
    let own = &cells[of.clone()];
    let start = own.partition_point(|cell| cell.start < bytes.start);
    let end = own.partition_point(|cell| cell.start < bytes.end);
    of.start + start..of.start + end.max(start)
}

/// Returns the bytes that a resource may occupy from the start of its memory.
fn occupied(resource: &Resource) -> Range<u64> {
    match resource.shape {
        Shape::Buffer { .. } => 0..resource.bytes(),
        Shape::Image { .. } => 0..u64::MAX,
    }
}

/// Lists each stage and access of a pass with its bytes.
fn extents(plan: &Plan, index: usize) -> Vec<Extent> {
    let pass = &plan.passes[index];
    // A shader may read what its own pass writes. Ordering these accesses is the shader's task.
    let storage_written: Vec<ResourceId> = (pass.uses.iter())
        .filter(|touch| touch.accesses.contains(Accesses::STORAGE_WRITE))
        .map(|touch| touch.resource)
        .collect();
    let mut extents = Vec::new();
    for touch in &pass.uses {
        for stage in touch.stages.iter() {
            for access in (touch.accesses & performed_by(stage)).iter() {
                let cleared = touch.discards && access == Accesses::COLOR_READ;
                let own = storage_written.contains(&touch.resource);
                for bytes in ranges(plan, &pass.work, touch, access) {
                    extents.push(Extent {
                        pass: index,
                        resource: touch.resource,
                        stage,
                        access,
                        needs_contents: access.reads() && !cleared && !own,
                        bytes,
                    });
                }
            }
        }
    }
    extents
}

/// Returns the byte ranges that one access covers: the whole resource, unless the command uses only a part.
fn ranges(plan: &Plan, work: &Work, touch: &Use, access: Accesses) -> Vec<Range<u64>> {
    const WORD: u64 = 4;
    let words = |offset: u64, count: u64| offset..offset.saturating_add(WORD * count);
    let whole = occupied(plan.resource(touch.resource));
    let narrow: Vec<_> = match (work, access) {
        (Work::Dispatch { groups: Groups::Indirect { buffer, offset }, .. }, Accesses::INDIRECT_READ)
            if *buffer == touch.resource =>
        {
            vec![words(*offset, 3)]
        }
        (Work::Draw { call: DrawCall::Indirect { buffer, offset }, .. }, Accesses::INDIRECT_READ)
            if *buffer == touch.resource =>
        {
            vec![words(*offset, 4)]
        }
        (Work::Export, Accesses::TRANSFER_READ) => {
            let of_buffer = plan.stats.iter().filter(|stat| stat.buffer == touch.resource);
            of_buffer.map(|stat| words(stat.offset, 1)).collect()
        }
        (Work::Export, Accesses::TRANSFER_WRITE) | (Work::Host, Accesses::HOST_READ)
            if plan.resource(touch.resource).source == Source::Readback =>
        {
            vec![words(0, plan.stats.len() as u64)]
        }
        (
            Work::Dispatch { .. }
            | Work::Draw { .. }
            | Work::Fill { .. }
            | Work::ClearHistory { .. }
            | Work::Export
            | Work::Host,
            _,
        ) => vec![],
    };
    // All other accesses are of the whole resource.
    if narrow.is_empty() { vec![whole] } else { narrow }
}

/// Cuts all memory into cells, and locates each resource in them.
fn cut(plan: &Plan, extents: &[Extent], copies: u32) -> (Vec<ResourceCells>, Vec<Range<u64>>) {
    let mut memories = plan.blocks.len();
    let memory_of: Vec<usize> = (plan.resources.iter())
        .map(|resource| match resource.block {
            Some(block) => block.index(),
            None => {
                memories += 1;
                memories - 1
            }
        })
        .collect();
    let mut bounds: Vec<Vec<u64>> = vec![vec![0]; memories];
    for (resource, memory) in plan.resources.iter().zip(&memory_of) {
        bounds[*memory].push(resource.bytes());
    }
    for extent in extents {
        let memory = &mut bounds[memory_of[extent.resource.index()]];
        memory.extend([extent.bytes.start, extent.bytes.end].into_iter().filter(|byte| *byte != u64::MAX));
    }

    let mut cells: Vec<Range<u64>> = Vec::new();
    let mut starts = Vec::new();
    let mut tenants: Vec<Vec<usize>> = vec![Vec::new(); memories];
    memory_of.iter().enumerate().for_each(|(resource, memory)| tenants[*memory].push(resource));
    for (memory, bounds) in bounds.iter_mut().enumerate() {
        bounds.sort_unstable();
        bounds.dedup();
        starts.push(cells.len());
        let alone = tenants[memory].first().map(|i| &plan.resources[*i].source);
        let per_frame = alone.is_some_and(|source| source.is_per_frame());
        for _ in 0..if per_frame { copies } else { 1 } {
            cells.extend(bounds.windows(2).map(|pair| pair[0]..pair[1]));
        }
    }

    let places = (plan.resources.iter().enumerate())
        .map(|(index, resource)| {
            let memory = memory_of[index];
            let count = bounds[memory].len() - 1;
            let all = starts[memory]..starts[memory] + count;
            let image = |other: &usize| matches!(plan.resources[*other].shape, Shape::Image { .. });
            let others = tenants[memory].iter().copied().filter(|other| *other != index).filter(image);
            let per_frame = resource.source.is_per_frame();
            ResourceCells {
                own: covered(&cells, &all, &occupied(resource)),
                all,
                stride: if per_frame { count } else { 0 },
                alias_images: others.map(|other| ResourceId(other as u32)).collect(),
                fresh: resource.source == Source::Transient && resource.history.is_none()
                    || resource.source == Source::Readback,
                host_writes: resource.source.is_per_frame() && resource.source != Source::Readback,
                uploaded: matches!(resource.source, Source::Scene { .. }),
            }
        })
        .collect();
    (places, cells)
}

/// Returns true if the shader accesses the resource only by atomics, through every binding of it.
fn is_atomic(plan: &Plan, extent: &Extent) -> bool {
    blocks(plan, extent).is_some_and(|mut blocks| blocks.all(|block| block.atomics_only))
}

/// Returns true if the shader only asks for the size of an image, through every binding of it.
fn asks_size(plan: &Plan, extent: &Extent) -> bool {
    blocks(plan, extent).is_some_and(|mut blocks| blocks.all(|block| !block.reads && !block.writes))
}

/// Returns the shader's bindings of the accessed resource; `None` if no shader accesses it.
fn blocks<'a>(plan: &'a Plan, extent: &Extent) -> Option<impl Iterator<Item = &'a ReflectedBinding>> {
    let pass = &plan.passes[extent.pass];
    let shader = match (&pass.work, extent.stage) {
        (Work::Dispatch { shader, .. }, Stages::COMPUTE) => shader,
        (Work::Draw { vertex, .. }, Stages::VERTEX) => vertex,
        (Work::Draw { fragment, .. }, Stages::FRAGMENT) => fragment,
        _ => return None,
    };
    let shader = plan.shaders.get(shader.index())?;
    let resource = extent.resource;
    let bound = move |number: u32| {
        pass.bindings.iter().any(|bound| bound.binding == number && bound.resource == resource)
    };
    Some(shader.reflection.bindings.iter().filter(move |block| bound(block.binding)))
}

/// Finds conflicting accesses of one pass: through different resources, or at different stages. Within one resource,
/// two atomic accesses or two depth accesses do not conflict.
fn clashes(accesses: &[Access]) -> Vec<Clash> {
    let mut clashes = Vec::new();
    for (index, first) in accesses.iter().enumerate() {
        for second in &accesses[index + 1..] {
            let meet = first.cells.start.max(second.cells.start) < first.cells.end.min(second.cells.end);
            // Depth tests and depth writes of a draw follow rasterization order.
            let tests = Stages::DEPTH_TESTS.contains(first.stage | second.stage);
            let apart = first.stage != second.stage && !tests && !(first.atomic && second.atomic);
            if meet && (first.resource != second.resource || apart) && (first.writes() || second.writes()) {
                clashes.push(Clash { first: first.clone(), second: second.clone() });
            }
        }
    }
    clashes
}
