//! The memory of a plan's blocks.
//!
//! The tenants of a block are never alive at the same time: where the device allows it, they are bound to the same piece
//! of memory, at its start, which is as large as the largest of them asks for. Sharing is a saving and never a must: where
//! tenants need different types of memory, or one wants an allocation for itself, each has its own.

use crate::gpu::Gpu;
use crate::memory::{Buffer, Image, Memory, MemoryKind, Needs, UnboundBuffer, UnboundImage};
use gpu_allocator::MemoryLocation;
use splatgraph_api::BackendError;
use std::sync::Arc;

/// A tenant without memory.
pub(crate) enum Unbound {
    Buffer(UnboundBuffer),
    Image(UnboundImage),
}

/// A tenant with memory. Plans may share it.
#[derive(Clone)]
pub(crate) enum Bound {
    Buffer(Arc<Buffer>),
    Image(Arc<Image>),
}

impl Unbound {
    fn needs(&self, gpu: &Gpu) -> Needs {
        match self {
            Unbound::Buffer(buffer) => buffer.needs(gpu),
            Unbound::Image(image) => image.needs(gpu),
        }
    }

    fn bind(self, gpu: &Arc<Gpu>, memory: Arc<Memory>) -> Result<Bound, BackendError> {
        Ok(match self {
            Unbound::Buffer(buffer) => Bound::Buffer(Arc::new(buffer.bind(gpu, memory)?)),
            Unbound::Image(image) => Bound::Image(Arc::new(image.bind(gpu, memory)?)),
        })
    }
}

impl Bound {
    pub fn memory(&self) -> &Arc<Memory> {
        match self {
            Bound::Buffer(buffer) => &buffer.memory,
            Bound::Image(image) => &image.memory,
        }
    }
}

/// Gives the tenants of a block their memory, each with the name it has in errors.
pub(crate) fn bind(gpu: &Arc<Gpu>, tenants: Vec<(&str, Unbound)>) -> Result<Vec<Bound>, BackendError> {
    let needs: Vec<Needs> = tenants.iter().map(|(_, tenant)| tenant.needs(gpu)).collect();
    let shared = match combine(&needs, gpu.limits.device_memory_types, gpu.limits.buffer_image_granularity) {
        Some(needs) => {
            let names: Vec<&str> = tenants.iter().map(|(name, _)| *name).collect();
            Some(Memory::new(gpu, &names.join(" + "), needs, MemoryLocation::GpuOnly)?)
        }
        None => None,
    };
    let bind = |((name, tenant), needs): ((&str, Unbound), Needs)| match &shared {
        Some(memory) => tenant.bind(gpu, memory.clone()),
        None => tenant.bind(gpu, Memory::new(gpu, name, needs, MemoryLocation::GpuOnly)?),
    };
    tenants.into_iter().zip(needs).map(bind).collect()
}

/// What tenants need together; none where they cannot share. `device_types` are the memory types on the device.
///
/// Where buffers and images share, the block fills whole pages of `granularity` bytes
/// (`VkPhysicalDeviceLimits::bufferImageGranularity`), so that it is in nobody's way whichever of them is alive.
fn combine(tenants: &[Needs], device_types: u32, granularity: u64) -> Option<Needs> {
    let (first, rest) = tenants.split_first()?;
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
    let plain = |needs: &Needs| matches!(needs.kind, MemoryKind::Linear | MemoryKind::Optimal);
    if all.types & device_types == 0 || !tenants.iter().all(plain) {
        return None;
    }
    if tenants.iter().any(|needs| needs.kind != all.kind) {
        all.alignment = all.alignment.max(granularity);
        all.size = all.size.next_multiple_of(granularity.max(1));
    }
    Some(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ash::vk;

    const BUFFER: Needs = Needs { size: 1000, alignment: 16, types: 0b0111, kind: MemoryKind::Linear };
    const IMAGE: Needs = Needs { size: 700, alignment: 256, types: 0b0110, kind: MemoryKind::Optimal };
    const ON_DEVICE: u32 = 0b0011;

    #[test]
    fn tenants_together_need_the_most_of_what_each_needs() {
        let larger = Needs { size: 3000, types: 0b1101, ..BUFFER };
        let together = Needs { size: 3000, types: 0b0101, ..BUFFER };
        assert_eq!(combine(&[BUFFER, larger], ON_DEVICE, 1024), Some(together));
        assert_eq!(combine(&[larger, BUFFER, BUFFER], ON_DEVICE, 1024), Some(together));
    }

    #[test]
    fn a_block_of_buffers_and_images_fills_whole_pages() {
        let together = Needs { size: 1024, alignment: 1024, types: 0b0110, kind: MemoryKind::Optimal };
        assert_eq!(combine(&[BUFFER, IMAGE], ON_DEVICE, 1024), Some(together));
        assert_eq!(combine(&[IMAGE, BUFFER], ON_DEVICE, 1024), Some(together));
        let fine = Needs { size: 1000, alignment: 256, ..together };
        assert_eq!(combine(&[IMAGE, BUFFER], ON_DEVICE, 1), Some(fine));
    }

    #[test]
    fn tenants_without_a_type_of_device_memory_in_common_do_not_share() {
        let other = Needs { types: 0b1000, ..IMAGE };
        assert_eq!(combine(&[BUFFER, other], ON_DEVICE, 1), None);
        // A type in common, which is the host's.
        assert_eq!(combine(&[BUFFER, Needs { types: 0b0100, ..IMAGE }], ON_DEVICE, 1), None);
        // Alone, a tenant gets what it asks for.
        assert_eq!(combine(&[other], ON_DEVICE, 1), Some(other));
    }

    #[test]
    fn a_tenant_that_wants_an_allocation_for_itself_does_not_share() {
        let alone = Needs { kind: MemoryKind::DedicatedImage(vk::Image::null()), ..IMAGE };
        assert_eq!(combine(&[BUFFER, alone], ON_DEVICE, 1), None);
        assert_eq!(combine(&[alone, alone], ON_DEVICE, 1), None);
        assert_eq!(combine(&[alone], ON_DEVICE, 1), Some(alone));
    }
}
