//! Allocates buffers, images and their memory.
//!
//! Device memory is a placement heap. Its objects (several if the plan lets them alias) are at offset 0 of the heap.
//! Any other memory is a single buffer, which is itself the only object in it. All resources are untracked.

use crate::apple::gpu::{MetalGpu, private};
use crate::apple::objc;
use crate::error::no_object;
use crate::lower;
use metal::*;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::Format;
use splatgraph_runtime::{BufferDesc, ImageDesc, Location, MemoryKind, Requirements};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// A memory allocation.
pub struct Memory {
    backing: Backing,
    bytes: u64,
    gpu: Arc<MetalGpu>,
}

enum Backing {
    /// A heap, for [`Location::Device`].
    Heap(Heap),
    /// A buffer, for every other location.
    Buffer(Buffer),
}

impl splatgraph_runtime::Memory<MetalGpu> for Memory {
    fn allocate(
        gpu: &Arc<MetalGpu>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Memory, BackendError> {
        let bytes = requirements.size;
        let shared = MTLResourceOptions::StorageModeShared | MTLResourceOptions::HazardTrackingModeUntracked;
        let backing = objc::pool(|| match location {
            Location::Device => {
                let descriptor = HeapDescriptor::new();
                descriptor.set_size(bytes);
                descriptor.set_storage_mode(MTLStorageMode::Private);
                descriptor.set_hazard_tracking_mode(MTLHazardTrackingMode::Untracked);
                descriptor.set_heap_type(MTLHeapType::Placement);
                objc::new_heap(&gpu.device, &descriptor).map(|heap| {
                    heap.set_label(name);
                    Backing::Heap(heap)
                })
            }
            // The host writes it sequentially, and never reads it.
            Location::Upload | Location::Staging => {
                let options = shared | MTLResourceOptions::CPUCacheModeWriteCombined;
                objc::new_buffer(&gpu.device, bytes, options).map(Backing::Buffer)
            }
            Location::Readback | Location::Host => {
                objc::new_buffer(&gpu.device, bytes, shared).map(Backing::Buffer)
            }
        });
        let Some(backing) = backing else {
            let reason = "Metal created no object".to_string();
            return Err(BackendError::OutOfMemory { name: name.to_string(), bytes, reason });
        };
        gpu.allocated.fetch_add(bytes, Ordering::Relaxed);
        Ok(Memory { backing, bytes, gpu: gpu.clone() })
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn mapped(&self) -> &[u8] {
        let Backing::Buffer(buffer) = &self.backing else { return &[] };
        // SAFETY: the contents of a shared buffer have this length and live as long as the buffer. The runtime reads
        // them only while no submission writes them.
        unsafe { std::slice::from_raw_parts(buffer.contents().cast(), self.bytes as usize) }
    }

    fn mapped_mut(&mut self) -> &mut [u8] {
        let Backing::Buffer(buffer) = &self.backing else { return &mut [] };
        // SAFETY: as above. Only this object gives the host access to the contents, and it is borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(buffer.contents().cast(), self.bytes as usize) }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        self.gpu.allocated.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// Returns a buffer's length in bytes. It is rounded up, because shaders and fills access whole words, and Metal's
/// validation expects the size of a function's struct, which is a multiple of its largest member's alignment, up to 16.
fn length(desc: &BufferDesc) -> u64 {
    desc.bytes.next_multiple_of(16)
}

pub(crate) fn buffer_requirements(gpu: &MetalGpu, desc: &BufferDesc) -> Requirements {
    let needed = gpu.device.heap_buffer_size_and_align(length(desc), private());
    requirements(needed, MemoryKind::Linear)
}

pub(crate) fn create_image(gpu: &MetalGpu, desc: &ImageDesc) -> (TextureDescriptor, Requirements) {
    let descriptor = TextureDescriptor::new();
    descriptor.set_texture_type(MTLTextureType::D2);
    descriptor.set_pixel_format(format(desc.format));
    descriptor.set_width(desc.size.0.into());
    descriptor.set_height(desc.size.1.into());
    descriptor.set_resource_options(private());
    descriptor.set_usage(usage(lower::image_usage(desc.usage)));
    let needed = gpu.device.heap_texture_size_and_align(&descriptor);
    (descriptor, requirements(needed, MemoryKind::Optimal))
}

pub(crate) fn bind_buffer(desc: &BufferDesc, memory: &Memory) -> Result<Buffer, BackendError> {
    let raw = match &memory.backing {
        Backing::Heap(heap) => heap
            .new_buffer_with_offset(length(desc), private(), 0)
            .ok_or_else(|| no_object("newBufferWithLength:options:offset:"))?,
        Backing::Buffer(own) => own.clone(),
    };
    raw.set_label(desc.name);
    Ok(raw)
}

pub(crate) fn bind_image(
    name: &str,
    image: &TextureDescriptorRef,
    memory: &Memory,
) -> Result<Texture, BackendError> {
    let raw = match &memory.backing {
        Backing::Heap(heap) => heap.new_texture_with_offset(image, 0),
        Backing::Buffer(_) => None,
    };
    let raw = raw.ok_or_else(|| no_object("newTextureWithDescriptor:offset:"))?;
    raw.set_label(name);
    Ok(raw)
}

fn requirements(needed: MTLSizeAndAlign, kind: MemoryKind) -> Requirements {
    // There is a single memory type.
    Requirements {
        size: needed.size.next_multiple_of(needed.align.max(1)),
        alignment: needed.align,
        types: 1,
        kind,
    }
}

pub(crate) fn format(format: Format) -> MTLPixelFormat {
    match format {
        Format::Rgba8Unorm => MTLPixelFormat::RGBA8Unorm,
        Format::Rgba16Float => MTLPixelFormat::RGBA16Float,
        Format::Rgba32Float => MTLPixelFormat::RGBA32Float,
        Format::R32Uint => MTLPixelFormat::R32Uint,
        Format::R32Float => MTLPixelFormat::R32Float,
        Format::Depth32Float => MTLPixelFormat::Depth32Float,
    }
}

fn usage(usage: lower::TextureUsage) -> MTLTextureUsage {
    let table = [
        (usage.shader_read, MTLTextureUsage::ShaderRead),
        (usage.shader_write, MTLTextureUsage::ShaderWrite),
        (usage.render_target, MTLTextureUsage::RenderTarget),
    ];
    let wanted = table.into_iter().filter(|(wanted, _)| *wanted);
    wanted.fold(MTLTextureUsage::Unknown, |all, (_, usage)| all | usage)
}
