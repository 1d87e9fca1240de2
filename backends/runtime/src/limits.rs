//! Defines the device limits that plans can exceed.

use splatgraph_framework::ir::{DeviceFacts, Features};

/// The limits of a device.
#[derive(Clone, Debug, Default)]
pub struct Limits {
    /// Maximum size of a storage binding, in bytes.
    pub max_storage_bytes: u64,
    /// Maximum size of a uniform block, in bytes.
    pub max_uniform_bytes: u64,
    /// Maximum size of a buffer, in bytes.
    pub max_buffer_bytes: u64,
    /// Maximum size of push constants, in bytes.
    pub max_push_bytes: u32,
    /// Maximum number of workgroups of a dispatch in x, y and z.
    pub max_groups: [u32; 3],
    /// Maximum number of invocations of a workgroup in x, y and z.
    pub max_local_size: [u32; 3],
    /// Maximum total number of invocations of a workgroup.
    pub max_invocations: u32,
    /// Maximum shared memory of a workgroup, in bytes.
    pub shared_bytes: u32,
    /// Maximum width and height of an image, in pixels.
    pub max_image_size: u32,
    /// Maximum number of colour targets of a draw.
    pub max_targets: u32,
    /// Maximum number of storage buffers per shader stage.
    pub max_storage_buffers: u32,
    /// Maximum number of uniform blocks per shader stage.
    pub max_uniform_buffers: u32,
    /// Maximum number of storage images per shader stage.
    pub max_storage_images: u32,
    /// Size of the largest device-local heap, in bytes.
    pub heap_bytes: u64,
    /// A bit for each memory type that is device-local.
    pub device_memory_types: u32,
    /// Size in bytes of the pages that a buffer and an image in one allocation must not share.
    pub buffer_image_granularity: u64,
    /// True if targets of one draw may blend differently.
    pub independent_blend: bool,
    /// The limits of subgroups.
    pub subgroup: SubgroupLimits,
    /// True if blending into half-float images is known to round to nearest, or if the device cannot blend into 32-bit
    /// floats.
    pub rounds_half: bool,
    /// True if `fma` in shaders rounds once.
    pub fused_fma: bool,
    /// Optional shader features that are enabled.
    pub features: Features,
    /// Number of valid bits in a timestamp; 0 if the queue has no timer.
    pub timestamp_bits: u32,
    /// True if timestamps can be read while the device runs, without waiting for it.
    pub live_timestamps: bool,
    /// Nanoseconds per tick of a timestamp.
    pub timestamp_period: f32,
}

/// The limits of a device's subgroups.
#[derive(Clone, Copy, Debug, Default)]
pub struct SubgroupLimits {
    /// Subgroup size of compute shaders, in lanes.
    pub size: u32,
    /// Minimum subgroup size that the driver may choose if a pipeline does not request one.
    pub min_size: u32,
    /// Maximum subgroup size that the driver may choose.
    pub max_size: u32,
    /// True if a compute pipeline can request a subgroup size.
    pub selectable: bool,
    /// Maximum number of subgroups per workgroup if a size is requested.
    pub max_per_group: u32,
}

impl SubgroupLimits {
    /// Returns true if a compute pipeline with this workgroup size can request [`SubgroupLimits::size`] lanes.
    pub fn can_request_size(&self, local_size: [u32; 3]) -> bool {
        let invocations: u64 = local_size.iter().map(|&n| u64::from(n)).product();
        self.selectable
            && self.size > 0
            && local_size[0].is_multiple_of(self.size)
            && invocations <= u64::from(self.size) * u64::from(self.max_per_group)
    }

    /// Returns true if workgroups of this size always run in subgroups of [`SubgroupLimits::size`] lanes.
    ///
    /// This holds if a pipeline can request the size, or if the device has no other size.
    pub fn has_certain_size(&self, local_size: [u32; 3]) -> bool {
        let only_one = self.min_size == self.max_size && self.size == self.max_size;
        only_one || self.can_request_size(local_size)
    }
}

impl Limits {
    /// Returns limits similar to those of a desktop GPU, for a device that executes nothing, and for tests.
    pub fn desktop() -> Limits {
        Limits {
            max_storage_bytes: 1 << 30,
            max_uniform_bytes: 65536,
            max_buffer_bytes: 2 << 30,
            max_push_bytes: 128,
            max_groups: [65535; 3],
            max_local_size: [1024; 3],
            max_invocations: 1024,
            shared_bytes: 32768,
            max_image_size: 16384,
            max_targets: 8,
            max_storage_buffers: 32,
            max_uniform_buffers: 16,
            max_storage_images: 16,
            heap_bytes: 16 << 30,
            device_memory_types: 1,
            buffer_image_granularity: 64,
            independent_blend: true,
            subgroup: SubgroupLimits {
                size: 32,
                min_size: 32,
                max_size: 32,
                selectable: true,
                max_per_group: 32,
            },
            rounds_half: true,
            fused_fma: true,
            features: Features::all(),
            timestamp_bits: 64,
            live_timestamps: true,
            timestamp_period: 1.0,
        }
    }

    /// Returns the device facts that graphs can use; see [`splatgraph_api::DeviceInfo::facts`].
    pub fn facts(&self) -> DeviceFacts {
        DeviceFacts {
            subgroup_size: self.subgroup.size,
            max_storage_bytes: self.max_storage_bytes,
            max_groups_x: self.max_groups[0],
            max_groups_y: self.max_groups[1],
            max_groups_z: self.max_groups[2],
            shared_bytes: self.shared_bytes,
            max_invocations: self.max_invocations,
            max_push_bytes: self.max_push_bytes,
            max_targets: self.max_targets,
            max_image_size: self.max_image_size,
            rounds_half: self.rounds_half,
            fused_fma: self.fused_fma,
            features: self.features,
        }
    }
}
