//! Barriers in Vulkan's terms, as plain data.
//!
//! The barriers that a plan records as one call become the contents of one `VkDependencyInfo`: a barrier on all memory
//! a `VkMemoryBarrier2`, a barrier on an image a `VkImageMemoryBarrier2` with exactly the layouts that the plan names.
//! The backend's own barriers have the same form ([`take_over`]). Nothing here calls the API.

use ash::vk;
use splatgraph_framework::{ir::*, plan::*};

/// One side of a barrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scope {
    pub stages: vk::PipelineStageFlags2,
    pub accesses: vk::AccessFlags2,
}

/// Every command of the queue, and whatever it does to memory.
pub(crate) const ANYTHING: Scope = Scope {
    stages: vk::PipelineStageFlags2::ALL_COMMANDS,
    accesses: vk::AccessFlags2::from_raw(
        vk::AccessFlags2::MEMORY_READ.as_raw() | vk::AccessFlags2::MEMORY_WRITE.as_raw(),
    ),
};

/// Whatever the queue's commands wrote.
const WRITTEN: Scope =
    Scope { stages: vk::PipelineStageFlags2::ALL_COMMANDS, accesses: vk::AccessFlags2::MEMORY_WRITE };

/// A barrier on all memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MemoryBarrier {
    pub source: Scope,
    pub target: Scope,
}

/// A barrier on a whole image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ImageBarrier {
    pub resource: ResourceId,
    pub source: Scope,
    pub target: Scope,
    pub old: vk::ImageLayout,
    pub new: vk::ImageLayout,
}

/// What one `vkCmdPipelineBarrier2` waits for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Dependency {
    pub memory: Vec<MemoryBarrier>,
    pub images: Vec<ImageBarrier>,
}

impl Dependency {
    pub fn is_empty(&self) -> bool {
        self.memory.is_empty() && self.images.is_empty()
    }

    /// Some barrier on all memory orders these stages.
    fn orders(&self, source: vk::PipelineStageFlags2, target: vk::PipelineStageFlags2) -> bool {
        self.memory.iter().any(|b| b.source.stages.contains(source) && b.target.stages.contains(target))
    }

    /// What was copied before it, the host can read after it (once it knows that the frame is done).
    pub fn shows_copies_to_host(&self) -> bool {
        self.memory.iter().any(|b| {
            b.source.stages.contains(vk::PipelineStageFlags2::COPY)
                && b.source.accesses.contains(vk::AccessFlags2::TRANSFER_WRITE)
                && b.target.stages.contains(vk::PipelineStageFlags2::HOST)
                && b.target.accesses.contains(vk::AccessFlags2::HOST_READ)
        })
    }
}

/// Lowers the barriers of one call.
///
/// Those of image barriers order everything, not the image alone (Vulkan 1.3, chapter 7), and plans count on that. Validation
/// layers of old (1.3.239) follow such an order for the image alone, so that it is told to them once more, in barriers
/// without any access on all memory, unless the call's barrier on all memory has it already.
pub(crate) fn dependency(barriers: &[Barrier]) -> Dependency {
    let mut dependency = Dependency::default();
    for barrier in barriers {
        let source =
            Scope { stages: stages(barrier.source_stages), accesses: accesses(barrier.source_accesses) };
        let target =
            Scope { stages: stages(barrier.target_stages), accesses: accesses(barrier.target_accesses) };
        match barrier.image {
            None => dependency.memory.push(MemoryBarrier { source, target }),
            Some(Transition { image: resource, old, new }) => {
                let (old, new) = (layout(old), layout(new));
                dependency.images.push(ImageBarrier { resource, source, target, old, new });
            }
        }
    }
    for index in 0..dependency.images.len() {
        let ImageBarrier { source, target, .. } = dependency.images[index];
        if !source.stages.is_empty() && !dependency.orders(source.stages, target.stages) {
            let order = |scope: Scope| Scope { accesses: vk::AccessFlags2::NONE, ..scope };
            dependency.memory.push(MemoryBarrier { source: order(source), target: order(target) });
        }
    }
    dependency
}

/// What a plan's first frame begins with where it goes on from the histories of a former plan: everything that the former
/// plan's frames did, before everything that is to come. `images` are those taken over with the layouts that they were left
/// in; they come to the layout that [`Work::Start`] leaves an image in.
pub(crate) fn take_over(images: impl IntoIterator<Item = (ResourceId, vk::ImageLayout)>) -> Dependency {
    let image = |(resource, old)| ImageBarrier {
        resource,
        source: WRITTEN,
        target: ANYTHING,
        old,
        new: layout(Layout::TransferTarget),
    };
    Dependency {
        memory: vec![MemoryBarrier { source: WRITTEN, target: ANYTHING }],
        images: images.into_iter().map(image).collect(),
    }
}

/// What remains of a prologue's barriers where the histories of `carried` go on and are not zeroed: all but the changes of
/// layout that would lose their contents. (The others may stand for passes that do run.)
pub(crate) fn going_on(dependency: &Dependency, carried: &[ResourceId]) -> Dependency {
    let start = (layout(Layout::Undefined), layout(Layout::TransferTarget));
    let mut rest = dependency.clone();
    rest.images.retain(|b| !carried.contains(&b.resource) || (b.old, b.new) != start);
    rest
}

/// `CLEAR` stands for fills. The specification counts `vkCmdFillBuffer` among the clear commands; validation layers
/// before 1.3.280 counted it among the copies. Naming both stages costs nothing, as both run in the same place.
pub(crate) fn stages(stages: Stages) -> vk::PipelineStageFlags2 {
    const TABLE: [(Stages, vk::PipelineStageFlags2); 8] = [
        (Stages::INDIRECT, vk::PipelineStageFlags2::DRAW_INDIRECT),
        (Stages::VERTEX, vk::PipelineStageFlags2::VERTEX_SHADER),
        (Stages::FRAGMENT, vk::PipelineStageFlags2::FRAGMENT_SHADER),
        (Stages::COLOR_OUTPUT, vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT),
        (Stages::COMPUTE, vk::PipelineStageFlags2::COMPUTE_SHADER),
        (Stages::COPY, vk::PipelineStageFlags2::COPY),
        (Stages::CLEAR, FILL),
        (Stages::HOST, vk::PipelineStageFlags2::HOST),
    ];
    const FILL: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::CLEAR.as_raw() | vk::PipelineStageFlags2::COPY.as_raw(),
    );
    TABLE
        .iter()
        .filter(|(stage, _)| stages.contains(*stage))
        .fold(vk::PipelineStageFlags2::NONE, |all, (_, flag)| all | *flag)
}

pub(crate) fn accesses(accesses: Accesses) -> vk::AccessFlags2 {
    const TABLE: [(Accesses, vk::AccessFlags2); 9] = [
        (Accesses::INDIRECT_READ, vk::AccessFlags2::INDIRECT_COMMAND_READ),
        (Accesses::UNIFORM_READ, vk::AccessFlags2::UNIFORM_READ),
        (Accesses::STORAGE_READ, vk::AccessFlags2::SHADER_STORAGE_READ),
        (Accesses::STORAGE_WRITE, vk::AccessFlags2::SHADER_STORAGE_WRITE),
        (Accesses::COLOR_READ, vk::AccessFlags2::COLOR_ATTACHMENT_READ),
        (Accesses::COLOR_WRITE, vk::AccessFlags2::COLOR_ATTACHMENT_WRITE),
        (Accesses::TRANSFER_READ, vk::AccessFlags2::TRANSFER_READ),
        (Accesses::TRANSFER_WRITE, vk::AccessFlags2::TRANSFER_WRITE),
        (Accesses::HOST_READ, vk::AccessFlags2::HOST_READ),
    ];
    TABLE
        .iter()
        .filter(|(access, _)| accesses.contains(*access))
        .fold(vk::AccessFlags2::NONE, |all, (_, flag)| all | *flag)
}

pub(crate) fn layout(layout: Layout) -> vk::ImageLayout {
    match layout {
        Layout::Undefined => vk::ImageLayout::UNDEFINED,
        Layout::General => vk::ImageLayout::GENERAL,
        Layout::ColorTarget => vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        Layout::TransferSource => vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
        Layout::TransferTarget => vk::ImageLayout::TRANSFER_DST_OPTIMAL,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use vk::{AccessFlags2 as A, PipelineStageFlags2 as S};

    const WROTE: (Stages, Accesses) = (Stages::COMPUTE, Accesses::STORAGE_WRITE);
    const READS: (Stages, Accesses) =
        (Stages::COMPUTE.union(Stages::INDIRECT), Accesses::STORAGE_READ.union(Accesses::INDIRECT_READ));
    const COPIED: (Stages, Accesses) = (Stages::COPY, Accesses::TRANSFER_READ);
    const DRAWS: (Stages, Accesses) =
        (Stages::COLOR_OUTPUT, Accesses::COLOR_READ.union(Accesses::COLOR_WRITE));
    const ANEW: Transition = Transition { image: COLOR, old: Layout::Undefined, new: Layout::ColorTarget };

    #[test]
    fn every_stage_and_access_has_its_vulkan_counterpart() {
        let of_stages: Vec<S> = Stages::all().iter().map(stages).collect();
        assert_eq!(of_stages.len(), 8);
        assert!(of_stages.iter().all(|flags| !flags.is_empty()));
        assert_eq!(
            stages(Stages::all()),
            S::DRAW_INDIRECT
                | S::VERTEX_SHADER
                | S::FRAGMENT_SHADER
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
        assert!(dependency(&[]).is_empty());
    }

    #[test]
    fn the_barriers_of_a_call_become_one_dependency_with_the_same_masks_and_layouts() {
        let lowered = dependency(&[on_memory(WROTE, READS), on_image(ANEW, COPIED, DRAWS)]);
        let memory = [
            MemoryBarrier {
                source: Scope { stages: S::COMPUTE_SHADER, accesses: A::SHADER_STORAGE_WRITE },
                target: Scope {
                    stages: S::COMPUTE_SHADER | S::DRAW_INDIRECT,
                    accesses: A::SHADER_STORAGE_READ | A::INDIRECT_COMMAND_READ,
                },
            },
            // What the image's barrier orders, it orders for all memory.
            MemoryBarrier {
                source: Scope { stages: S::COPY, accesses: A::NONE },
                target: Scope { stages: S::COLOR_ATTACHMENT_OUTPUT, accesses: A::NONE },
            },
        ];
        let images = [ImageBarrier {
            resource: COLOR,
            source: Scope { stages: S::COPY, accesses: A::TRANSFER_READ },
            target: Scope {
                stages: S::COLOR_ATTACHMENT_OUTPUT,
                accesses: A::COLOR_ATTACHMENT_READ | A::COLOR_ATTACHMENT_WRITE,
            },
            old: vk::ImageLayout::UNDEFINED,
            new: vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        }];
        assert_eq!(lowered, Dependency { memory: memory.into(), images: images.into() });
    }

    #[test]
    fn an_images_order_is_not_repeated_where_the_call_or_another_image_has_it() {
        let wide = on_memory((Stages::COPY | Stages::COMPUTE, WROTE.1), (Stages::all(), READS.1));
        let lowered = dependency(&[wide, on_image(ANEW, COPIED, DRAWS)]);
        assert_eq!((lowered.memory.len(), lowered.images.len()), (1, 1));
        let twice = dependency(&[on_image(ANEW, COPIED, DRAWS), on_image(ANEW, COPIED, DRAWS)]);
        assert_eq!((twice.memory.len(), twice.images.len()), (1, 2));
        // An image that waits for nothing orders nothing.
        let nothing = (Stages::empty(), Accesses::empty());
        assert_eq!(dependency(&[on_image(ANEW, nothing, DRAWS)]).memory, []);
    }

    #[test]
    fn only_a_barrier_from_copies_to_the_hosts_reads_shows_copies_to_the_host() {
        let copies = (Stages::COPY, Accesses::TRANSFER_WRITE);
        let host = (Stages::HOST, Accesses::HOST_READ);
        let shows = |source, target| dependency(&[on_memory(source, target)]).shows_copies_to_host();
        assert!(shows(copies, host));
        assert!(shows((Stages::COPY | Stages::COMPUTE, Accesses::WRITES), host));
        assert!(!shows(WROTE, host));
        assert!(!shows((Stages::COPY, Accesses::TRANSFER_READ), host));
        assert!(!shows(copies, (Stages::HOST, Accesses::empty())));
        assert!(!shows(copies, READS));
        assert!(!Dependency::default().shows_copies_to_host());
    }

    #[test]
    fn a_take_over_waits_for_everything_and_leaves_images_as_a_start_would() {
        let lowered = take_over([(COLOR, vk::ImageLayout::GENERAL)]);
        let written = Scope { stages: S::ALL_COMMANDS, accesses: A::MEMORY_WRITE };
        let anything = Scope { stages: S::ALL_COMMANDS, accesses: A::MEMORY_READ | A::MEMORY_WRITE };
        assert_eq!(lowered.memory, [MemoryBarrier { source: written, target: anything }]);
        let [image] = lowered.images[..] else { panic!("one image was given") };
        assert_eq!((image.source, image.target), (written, anything));
        assert_eq!((image.old, image.new), (vk::ImageLayout::GENERAL, vk::ImageLayout::TRANSFER_DST_OPTIMAL));
    }

    #[test]
    fn of_a_history_that_goes_on_only_the_change_of_layout_before_its_start_is_left_out() {
        let start = Transition { image: COLOR, old: Layout::Undefined, new: Layout::TransferTarget };
        let nothing = (Stages::empty(), Accesses::empty());
        let fills = (Stages::CLEAR, Accesses::TRANSFER_WRITE);
        let all = dependency(&[
            on_memory(WROTE, READS),
            on_image(start, nothing, fills),
            on_image(Transition { image: WORDS, ..start }, nothing, fills),
            on_image(Transition { old: Layout::TransferTarget, new: Layout::General, ..start }, fills, READS),
        ]);
        let rest = going_on(&all, &[COLOR]);
        assert_eq!(rest.memory, all.memory);
        assert_eq!(rest.images, all.images[1..]);
        assert_eq!(going_on(&all, &[]), all);
    }
}
