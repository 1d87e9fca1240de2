//! Creates transient resources that share memory.
//!
//! The members of a block are never alive at once. If the device allows it, all of them are bound to the start of one
//! allocation, as large as the largest member. Aliasing is optional: if the members have no type of device-local memory
//! in common, or one needs a dedicated allocation, each gets its own.

use crate::gpu::{Buffer, BufferDesc, Gpu, Image, ImageDesc, Location, Memory, MemoryKind, Requirements};
use splatgraph_api::BackendError;
use std::sync::Arc;

pub(crate) enum Member<'a> {
    Buffer(BufferDesc<'a>),
    Image(ImageDesc<'a>),
}

/// A transient resource with its memory. Several plans can share it.
pub(crate) enum Transient<G: Gpu> {
    Buffer(Arc<Buffer<G>>),
    Image(Arc<Image<G>>),
}

impl<G: Gpu> Clone for Transient<G> {
    fn clone(&self) -> Self {
        match self {
            Transient::Buffer(buffer) => Transient::Buffer(buffer.clone()),
            Transient::Image(image) => Transient::Image(image.clone()),
        }
    }
}

impl<G: Gpu> Transient<G> {
    pub fn memory(&self) -> &Arc<G::Memory> {
        match self {
            Transient::Buffer(buffer) => &buffer.memory,
            Transient::Image(image) => &image.memory,
        }
    }
}

/// Binds a created resource to memory.
type Bind<'a, G> = Box<dyn FnOnce(Arc<<G as Gpu>::Memory>) -> Result<Transient<G>, BackendError> + 'a>;

impl Member<'_> {
    fn name(&self) -> &str {
        match self {
            Member::Buffer(desc) => desc.name,
            Member::Image(desc) => desc.name,
        }
    }

    fn create<'a, G: Gpu>(&'a self, gpu: &'a Arc<G>) -> Result<(Bind<'a, G>, Requirements), BackendError> {
        Ok(match self {
            Member::Buffer(desc) => {
                let (buffer, requirements) = gpu.create_buffer(desc)?;
                let bound = |memory| Ok(Arc::new(Buffer::bind(gpu, desc, buffer, memory)?));
                (Box::new(|memory| bound(memory).map(Transient::Buffer)), requirements)
            }
            Member::Image(desc) => {
                let (image, requirements) = gpu.create_image(desc)?;
                let bound = |memory| Ok(Arc::new(Image::bind(gpu, desc, image, memory)?));
                (Box::new(|memory| bound(memory).map(Transient::Image)), requirements)
            }
        })
    }
}

pub(crate) fn create_block<G: Gpu>(
    gpu: &Arc<G>,
    members: &[Member],
) -> Result<Vec<Transient<G>>, BackendError> {
    let created = members.iter().map(|member| member.create(gpu)).collect::<Result<Vec<_>, _>>()?;
    let requirements: Vec<_> = created.iter().map(|(_, requirements)| *requirements).collect();
    let limits = &gpu.common().limits;
    let shared = match combine(&requirements, limits.device_memory_types, limits.buffer_image_granularity) {
        Some(requirements) => {
            let names: Vec<&str> = members.iter().map(Member::name).collect();
            Some(Arc::new(G::Memory::allocate(gpu, &names.join(" + "), &requirements, Location::Device)?))
        }
        None => None,
    };
    members
        .iter()
        .zip(created)
        .map(|(member, (bind, requirements))| {
            bind(match &shared {
                Some(memory) => memory.clone(),
                None => Arc::new(G::Memory::allocate(gpu, member.name(), &requirements, Location::Device)?),
            })
        })
        .collect()
}

/// Merges the requirements of members that share memory; `None` if they cannot. `device_types` are the device-local
/// memory types.
///
/// A block with both buffers and images fills whole pages of `granularity` bytes
/// (`VkPhysicalDeviceLimits::bufferImageGranularity`), so that its neighbours are unaffected.
fn combine(members: &[Requirements], device_types: u32, granularity: u64) -> Option<Requirements> {
    let (first, rest) = members.split_first()?;
    if rest.is_empty() {
        return Some(*first);
    }
    let mut all = *first;
    for next in rest {
        all.size = all.size.max(next.size);
        // Alignments are powers of two.
        all.alignment = all.alignment.max(next.alignment);
        all.types &= next.types;
        if all.kind != next.kind {
            all.kind = MemoryKind::Optimal;
        }
    }
    let plain = |needs: &Requirements| matches!(needs.kind, MemoryKind::Linear | MemoryKind::Optimal);
    if all.types & device_types == 0 || !members.iter().all(plain) {
        return None;
    }
    if members.iter().any(|needs| needs.kind != all.kind) {
        all.alignment = all.alignment.max(granularity);
        all.size = all.size.next_multiple_of(granularity.max(1));
    }
    Some(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUFFER: Requirements =
        Requirements { size: 1000, alignment: 16, types: 0b0111, kind: MemoryKind::Linear };
    const IMAGE: Requirements =
        Requirements { size: 700, alignment: 256, types: 0b0110, kind: MemoryKind::Optimal };
    const ON_DEVICE: u32 = 0b0011;

    #[test]
    fn members_together_need_the_most_that_any_of_them_needs() {
        let larger = Requirements { size: 3000, types: 0b1101, ..BUFFER };
        let together = Requirements { size: 3000, types: 0b0101, ..BUFFER };
        assert_eq!(combine(&[BUFFER, larger], ON_DEVICE, 1024), Some(together));
        assert_eq!(combine(&[larger, BUFFER, BUFFER], ON_DEVICE, 1024), Some(together));
    }

    #[test]
    fn a_block_of_buffers_and_images_fills_whole_pages() {
        let together = Requirements { size: 1024, alignment: 1024, types: 0b0110, kind: MemoryKind::Optimal };
        assert_eq!(combine(&[BUFFER, IMAGE], ON_DEVICE, 1024), Some(together));
        assert_eq!(combine(&[IMAGE, BUFFER], ON_DEVICE, 1024), Some(together));
        let fine = Requirements { size: 1000, alignment: 256, ..together };
        assert_eq!(combine(&[IMAGE, BUFFER], ON_DEVICE, 1), Some(fine));
    }

    #[test]
    fn members_without_a_type_of_device_memory_in_common_do_not_share() {
        let other = Requirements { types: 0b1000, ..IMAGE };
        assert_eq!(combine(&[BUFFER, other], ON_DEVICE, 1), None);
        // The only common type is host memory.
        assert_eq!(combine(&[BUFFER, Requirements { types: 0b0100, ..IMAGE }], ON_DEVICE, 1), None);
        assert_eq!(combine(&[other], ON_DEVICE, 1), Some(other));
    }

    #[test]
    fn a_member_that_needs_a_dedicated_allocation_does_not_share() {
        let alone = Requirements { kind: MemoryKind::DedicatedImage(1), ..IMAGE };
        assert_eq!(combine(&[BUFFER, alone], ON_DEVICE, 1), None);
        assert_eq!(combine(&[alone, alone], ON_DEVICE, 1), None);
        assert_eq!(combine(&[alone], ON_DEVICE, 1), Some(alone));
    }
}
