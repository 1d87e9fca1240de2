//! Lowers barriers to Vulkan's structures, as plain data.
//!
//! The barriers of one call become one `VkDependencyInfo`. Nothing here calls the API.

use super::barrier::Barrier;
use crate::lower::{WHOLE, flags};
use ash::vk;
use splatgraph_framework::ir::*;
use splatgraph_framework::plan::Transition;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scope {
    pub stages: vk::PipelineStageFlags2,
    pub accesses: vk::AccessFlags2,
}

pub(crate) const ANYTHING: Scope = Scope {
    stages: vk::PipelineStageFlags2::ALL_COMMANDS,
    accesses: vk::AccessFlags2::from_raw(
        vk::AccessFlags2::MEMORY_READ.as_raw() | vk::AccessFlags2::MEMORY_WRITE.as_raw(),
    ),
};

pub(crate) const COPIES: Scope =
    Scope { stages: vk::PipelineStageFlags2::COPY, accesses: vk::AccessFlags2::TRANSFER_WRITE };

/// Target scope of the barrier after copies into a buffer: all commands of the queue, with all reads.
pub(crate) const READERS: Scope =
    Scope { stages: vk::PipelineStageFlags2::ALL_COMMANDS, accesses: vk::AccessFlags2::MEMORY_READ };

pub(crate) const HOST: Scope =
    Scope { stages: vk::PipelineStageFlags2::HOST, accesses: vk::AccessFlags2::HOST_READ };

pub(crate) fn memory_barrier(source: Scope, target: Scope) -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(source.stages)
        .src_access_mask(source.accesses)
        .dst_stage_mask(target.stages)
        .dst_access_mask(target.accesses)
}

pub(crate) fn image_barrier(
    (image, aspect): (vk::Image, vk::ImageAspectFlags),
    [old, new]: [vk::ImageLayout; 2],
    source: Scope,
    target: Scope,
) -> vk::ImageMemoryBarrier2<'static> {
    vk::ImageMemoryBarrier2::default()
        .src_stage_mask(source.stages)
        .src_access_mask(source.accesses)
        .dst_stage_mask(target.stages)
        .dst_access_mask(target.accesses)
        .old_layout(old)
        .new_layout(new)
        .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .image(image)
        .subresource_range(vk::ImageSubresourceRange { aspect_mask: aspect, ..WHOLE })
}

/// The contents of one `vkCmdPipelineBarrier2` call, in a reusable allocation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Dependency {
    pub memory: Vec<vk::MemoryBarrier2<'static>>,
    pub images: Vec<vk::ImageMemoryBarrier2<'static>>,
    /// The execution dependencies of image barriers, repeated as barriers on all memory without accesses.
    orders: Vec<vk::MemoryBarrier2<'static>>,
}

impl Dependency {
    pub fn clear(&mut self) {
        self.memory.clear();
        self.images.clear();
        self.orders.clear();
    }

    /// Lowers the barriers of one call. An image barrier without its image keeps its execution dependency, but changes
    /// no layout.
    ///
    /// The execution dependency of an image barrier applies to everything, not only to the image (Vulkan 1.3, chapter
    /// 7), and plans rely on that. Older validation layers (1.3.239) apply it only to the image. For them it is
    /// repeated in barriers on all memory without accesses, unless the call already has a barrier on all memory that
    /// covers it.
    pub fn lower<'a>(
        &mut self,
        barriers: impl Iterator<Item = (&'a Barrier, Option<(vk::Image, vk::ImageAspectFlags)>)>,
    ) {
        self.clear();
        for (barrier, image) in barriers {
            let Masks { source_stages, source_accesses, target_stages, target_accesses } = barrier.masks;
            let source = Scope { stages: stages(source_stages), accesses: accesses(source_accesses) };
            let target = Scope { stages: stages(target_stages), accesses: accesses(target_accesses) };
            let Some(Transition { old, new, .. }) = barrier.image else {
                self.memory.push(memory_barrier(source, target));
                continue;
            };
            if let Some(image) = image {
                self.images.push(image_barrier(image, [old, new].map(layout), source, target));
            }
            let order = |scope: Scope| Scope { accesses: vk::AccessFlags2::NONE, ..scope };
            self.orders.push(memory_barrier(order(source), order(target)));
        }
        for order in &self.orders {
            let has = |b: &vk::MemoryBarrier2| {
                b.src_stage_mask.contains(order.src_stage_mask)
                    && b.dst_stage_mask.contains(order.dst_stage_mask)
            };
            if !order.src_stage_mask.is_empty() && !self.memory.iter().any(has) {
                self.memory.push(*order);
            }
        }
    }
}

/// Lowers stages. `CLEAR`, the stage of fills, becomes both `CLEAR` and `COPY`: the specification counts
/// `vkCmdFillBuffer` among the clear commands, validation layers before 1.3.280 counted it among the copies.
pub(crate) fn stages(stages: Stages) -> vk::PipelineStageFlags2 {
    const TABLE: [(Stages, vk::PipelineStageFlags2); 10] = [
        (Stages::INDIRECT, vk::PipelineStageFlags2::DRAW_INDIRECT),
        (Stages::VERTEX, vk::PipelineStageFlags2::VERTEX_SHADER),
        (Stages::EARLY_TESTS, vk::PipelineStageFlags2::EARLY_FRAGMENT_TESTS),
        (Stages::FRAGMENT, vk::PipelineStageFlags2::FRAGMENT_SHADER),
        (Stages::LATE_TESTS, vk::PipelineStageFlags2::LATE_FRAGMENT_TESTS),
        (Stages::COLOR_OUTPUT, vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT),
        (Stages::COMPUTE, vk::PipelineStageFlags2::COMPUTE_SHADER),
        (Stages::COPY, vk::PipelineStageFlags2::COPY),
        (Stages::CLEAR, FILL),
        (Stages::HOST, vk::PipelineStageFlags2::HOST),
    ];
    const FILL: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::CLEAR.as_raw() | vk::PipelineStageFlags2::COPY.as_raw(),
    );
    flags(&TABLE, |stage| stages.contains(stage))
}

pub(crate) fn accesses(accesses: Accesses) -> vk::AccessFlags2 {
    const TABLE: [(Accesses, vk::AccessFlags2); 11] = [
        (Accesses::INDIRECT_READ, vk::AccessFlags2::INDIRECT_COMMAND_READ),
        (Accesses::UNIFORM_READ, vk::AccessFlags2::UNIFORM_READ),
        (Accesses::STORAGE_READ, vk::AccessFlags2::SHADER_STORAGE_READ),
        (Accesses::STORAGE_WRITE, vk::AccessFlags2::SHADER_STORAGE_WRITE),
        (Accesses::COLOR_READ, vk::AccessFlags2::COLOR_ATTACHMENT_READ),
        (Accesses::COLOR_WRITE, vk::AccessFlags2::COLOR_ATTACHMENT_WRITE),
        (Accesses::DEPTH_READ, vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_READ),
        (Accesses::DEPTH_WRITE, vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_WRITE),
        (Accesses::TRANSFER_READ, vk::AccessFlags2::TRANSFER_READ),
        (Accesses::TRANSFER_WRITE, vk::AccessFlags2::TRANSFER_WRITE),
        (Accesses::HOST_READ, vk::AccessFlags2::HOST_READ),
    ];
    flags(&TABLE, |access| accesses.contains(access))
}

pub(crate) fn layout(layout: Layout) -> vk::ImageLayout {
    match layout {
        Layout::Undefined => vk::ImageLayout::UNDEFINED,
        Layout::General => vk::ImageLayout::GENERAL,
        Layout::ColorTarget => vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        Layout::DepthTarget => vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL,
        Layout::TransferSource => vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
        Layout::TransferTarget => vk::ImageLayout::TRANSFER_DST_OPTIMAL,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use vk::{AccessFlags2 as A, PipelineStageFlags2 as S};

    fn on_memory(source: (Stages, Accesses), target: (Stages, Accesses)) -> Barrier {
        Barrier { image: None, masks: Masks::new(source, target), causes: Vec::new() }
    }

    fn on_image(change: Transition, source: (Stages, Accesses), target: (Stages, Accesses)) -> Barrier {
        Barrier { image: Some(change), ..on_memory(source, target) }
    }

    const WROTE: (Stages, Accesses) = (Stages::COMPUTE, Accesses::STORAGE_WRITE);
    const READS: (Stages, Accesses) =
        (Stages::COMPUTE.union(Stages::INDIRECT), Accesses::STORAGE_READ.union(Accesses::INDIRECT_READ));
    const COPIED: (Stages, Accesses) = (Stages::COPY, Accesses::TRANSFER_READ);
    const DRAWS: (Stages, Accesses) =
        (Stages::COLOR_OUTPUT, Accesses::COLOR_READ.union(Accesses::COLOR_WRITE));
    const IMAGE: vk::Image = vk::Image::null();
    const COLOR_ASPECT: vk::ImageAspectFlags = vk::ImageAspectFlags::COLOR;
    const ANEW: Transition = Transition { image: COLOR, old: Layout::Undefined, new: Layout::ColorTarget };

    fn dependency(barriers: &[Barrier]) -> Dependency {
        let mut dependency = Dependency::default();
        dependency
            .lower(barriers.iter().map(|barrier| (barrier, barrier.image.map(|_| (IMAGE, COLOR_ASPECT)))));
        dependency
    }

    fn scopes(dependency: &Dependency) -> Vec<[Scope; 2]> {
        let source = |b: &vk::MemoryBarrier2| Scope { stages: b.src_stage_mask, accesses: b.src_access_mask };
        let target = |b: &vk::MemoryBarrier2| Scope { stages: b.dst_stage_mask, accesses: b.dst_access_mask };
        dependency.memory.iter().map(|barrier| [source(barrier), target(barrier)]).collect()
    }

    #[test]
    fn every_stage_and_access_has_its_vulkan_counterpart() {
        let of_stages: Vec<S> = Stages::all().iter().map(stages).collect();
        assert_eq!(of_stages.len(), 10);
        assert!(of_stages.iter().all(|flags| !flags.is_empty()));
        assert_eq!(
            stages(Stages::all()),
            S::DRAW_INDIRECT
                | S::VERTEX_SHADER
                | S::EARLY_FRAGMENT_TESTS
                | S::FRAGMENT_SHADER
                | S::LATE_FRAGMENT_TESTS
                | S::COLOR_ATTACHMENT_OUTPUT
                | S::COMPUTE_SHADER
                | S::COPY
                | S::CLEAR
                | S::HOST
        );
        let of_accesses: Vec<A> = Accesses::all().iter().map(accesses).collect();
        assert!(of_accesses.iter().all(|flags| flags.as_raw().count_ones() == 1));
        assert_eq!(accesses(Accesses::all()).as_raw().count_ones() as usize, of_accesses.len());
    }

    #[test]
    fn nothing_lowers_to_nothing() {
        assert_eq!(stages(Stages::empty()), S::NONE);
        assert_eq!(accesses(Accesses::empty()), A::NONE);
        assert!(dependency(&[]).memory.is_empty() && dependency(&[]).images.is_empty());
    }

    #[test]
    fn the_barriers_of_a_call_become_one_dependency_with_the_same_masks_and_layouts() {
        let lowered = dependency(&[on_memory(WROTE, READS), on_image(ANEW, COPIED, DRAWS)]);
        let (reads, wrote) = (A::SHADER_STORAGE_READ | A::INDIRECT_COMMAND_READ, A::SHADER_STORAGE_WRITE);
        let scope = |stages, accesses| Scope { stages, accesses };
        let memory = [
            [scope(S::COMPUTE_SHADER, wrote), scope(S::COMPUTE_SHADER | S::DRAW_INDIRECT, reads)],
            // The execution dependency of the image barrier, repeated for all memory.
            [scope(S::COPY, A::NONE), scope(S::COLOR_ATTACHMENT_OUTPUT, A::NONE)],
        ];
        assert_eq!(scopes(&lowered), memory);
        let [image] = lowered.images[..] else { panic!("{:?}", lowered.images) };
        assert_eq!((image.src_stage_mask, image.src_access_mask), (S::COPY, A::TRANSFER_READ));
        let draws = A::COLOR_ATTACHMENT_READ | A::COLOR_ATTACHMENT_WRITE;
        assert_eq!((image.dst_stage_mask, image.dst_access_mask), (S::COLOR_ATTACHMENT_OUTPUT, draws));
        let layouts = (vk::ImageLayout::UNDEFINED, vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL);
        assert_eq!((image.old_layout, image.new_layout), layouts);
        assert_eq!((image.image, image.subresource_range.aspect_mask), (IMAGE, COLOR_ASPECT));
    }

    #[test]
    fn an_images_order_is_not_repeated_where_the_call_or_another_image_has_it() {
        let wide = on_memory((Stages::COPY | Stages::COMPUTE, WROTE.1), (Stages::all(), READS.1));
        let lowered = dependency(&[wide, on_image(ANEW, COPIED, DRAWS)]);
        assert_eq!((lowered.memory.len(), lowered.images.len()), (1, 1));
        let twice = dependency(&[on_image(ANEW, COPIED, DRAWS), on_image(ANEW, COPIED, DRAWS)]);
        assert_eq!((twice.memory.len(), twice.images.len()), (1, 2));
        // An image barrier without source stages has no execution dependency.
        let nothing = (Stages::empty(), Accesses::empty());
        assert!(dependency(&[on_image(ANEW, nothing, DRAWS)]).memory.is_empty());
    }

    #[test]
    fn an_image_barrier_without_its_image_keeps_its_order_alone() {
        let barrier = on_image(ANEW, COPIED, DRAWS);
        let mut lowered = Dependency::default();
        lowered.lower([(&barrier, None)].into_iter());
        assert_eq!(scopes(&lowered), scopes(&dependency(&[barrier])));
        assert!(lowered.memory.len() == 1 && lowered.images.is_empty());
    }
}
