//! Allocates the memory of buffers and images. `gpu-allocator` suballocates it, and it is freed on drop.

use crate::gpu::{Owned, VulkanGpu};
use ash::vk::{self, Handle};
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use splatgraph_api::BackendError;
use splatgraph_runtime::{Location, MemoryKind, Requirements, lock};
use std::sync::Arc;

/// A device memory allocation.
pub struct Memory {
    // An `Option` so that `drop` can move it out.
    allocation: Option<Allocation>,
    gpu: Arc<VulkanGpu>,
}

impl Memory {
    /// Returns the memory handle, and the offset at which to bind objects.
    pub(crate) fn handle_and_offset(&self) -> (vk::DeviceMemory, u64) {
        // SAFETY: the handle is used only to bind objects, and their owner keeps this allocation alive.
        self.allocation.as_ref().map_or_else(Default::default, |a| (unsafe { a.memory() }, a.offset()))
    }
}

impl splatgraph_runtime::Memory<VulkanGpu> for Memory {
    fn allocate(
        gpu: &Arc<VulkanGpu>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Memory, BackendError> {
        let describe = AllocationCreateDesc {
            name,
            requirements: vk::MemoryRequirements {
                size: requirements.size,
                alignment: requirements.alignment,
                memory_type_bits: requirements.types,
            },
            location: match location {
                Location::Device => MemoryLocation::GpuOnly,
                Location::Upload => MemoryLocation::CpuToGpu,
                // Not `CpuToGpu`, which may be device memory: slow for the host to write.
                Location::Staging | Location::Readback | Location::Host => MemoryLocation::GpuToCpu,
            },
            linear: matches!(requirements.kind, MemoryKind::Linear | MemoryKind::DedicatedBuffer(_)),
            allocation_scheme: match requirements.kind {
                MemoryKind::Linear | MemoryKind::Optimal => AllocationScheme::GpuAllocatorManaged,
                MemoryKind::DedicatedBuffer(buffer) => {
                    AllocationScheme::DedicatedBuffer(vk::Buffer::from_raw(buffer))
                }
                MemoryKind::DedicatedImage(image) => {
                    AllocationScheme::DedicatedImage(vk::Image::from_raw(image))
                }
            },
        };
        let out_of_memory = |reason: String| BackendError::OutOfMemory {
            name: name.to_string(),
            bytes: requirements.size,
            reason,
        };
        let mut allocator = lock(&gpu.allocator);
        let allocator =
            allocator.as_mut().ok_or_else(|| out_of_memory("the device is closed".to_string()))?;
        let allocation = allocator.allocate(&describe).map_err(|error| out_of_memory(error.to_string()))?;
        Ok(Memory { allocation: Some(allocation), gpu: gpu.clone() })
    }

    fn bytes(&self) -> u64 {
        self.allocation.as_ref().map_or(0, Allocation::size)
    }

    fn mapped(&self) -> &[u8] {
        self.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or_default()
    }

    fn mapped_mut(&mut self) -> &mut [u8] {
        self.allocation.as_mut().and_then(Allocation::mapped_slice_mut).unwrap_or_default()
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        let Some(allocation) = self.allocation.take() else { return };
        let mut allocator = lock(&self.gpu.allocator);
        if let Some(allocator) = allocator.as_mut() {
            // It fails only for an allocation of another allocator.
            let _ = allocator.free(allocation);
        }
    }
}

/// An image and a view of it.
pub struct Image {
    pub(crate) view: Owned<vk::ImageView>,
    // Dropped after the view.
    pub(crate) raw: Owned<vk::Image>,
}

/// Returns the requirements that `query` writes. The kind is `alone` if the driver requires a dedicated allocation.
pub(crate) fn requirements(
    [shared, alone]: [MemoryKind; 2],
    query: impl FnOnce(&mut vk::MemoryRequirements2),
) -> Requirements {
    let mut dedicated = vk::MemoryDedicatedRequirements::default();
    let mut answer = vk::MemoryRequirements2::default().push_next(&mut dedicated);
    query(&mut answer);
    let vk::MemoryRequirements { size, alignment, memory_type_bits: types } = answer.memory_requirements;
    let must_be_alone = dedicated.requires_dedicated_allocation == vk::TRUE;
    Requirements { size, alignment, types, kind: if must_be_alone { alone } else { shared } }
}
