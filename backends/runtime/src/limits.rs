//! The limits of a device that plans can run into.

use splatgraph_framework::ir::{DeviceFacts, Features};

/// The limits of a device.
#[derive(Clone, Debug, Default)]
pub struct Limits {
    /// Bytes of a storage binding.
    pub max_storage_bytes: u64,
    /// Bytes of a uniform block.
    pub max_uniform_bytes: u64,
    /// Bytes of a buffer.
    pub max_buffer_bytes: u64,
    /// Bytes of push constants.
    pub max_push_bytes: u32,
    /// Workgroups of a dispatch in x, y and z.
    pub max_groups: [u32; 3],
    /// Invocations of a workgroup in x, y and z.
    pub max_local_size: [u32; 3],
    /// Invocations of a workgroup in all.
    pub max_invocations: u32,
    /// Bytes of shared memory of a workgroup.
    pub shared_bytes: u32,
    /// Pixels of an image in x and in y.
    pub max_image_size: u32,
    /// Colour targets of a draw.
    pub max_targets: u32,
    /// Storage buffers that one shader stage may see.
    pub max_storage_buffers: u32,
    /// Uniform blocks that one shader stage may see.
    pub max_uniform_buffers: u32,
    /// Storage images that one shader stage may see.
    pub max_storage_images: u32,
    /// Bytes of the largest device-local heap.
    pub heap_bytes: u64,
    /// A bit for each memory type that is device-local.
    pub device_memory_types: u32,
    /// Bytes that buffers and images next to each other in memory keep apart.
    pub buffer_image_granularity: u64,
    /// Targets of one draw may blend differently.
    pub independent_blend: bool,
    /// The limits of subgroups.
    pub subgroup: SubgroupLimits,
    /// Blending rounds its results in half-float images to nearest.
    pub rounds_half: bool,
    /// Shaders' `fma` rounds once.
    pub fused_fma: bool,
    /// Optional features of shaders that are enabled.
    pub features: Features,
    /// Bits that count in a timestamp; 0 where the queue has no timer.
    pub timestamp_bits: u32,
    /// Timestamps can be read while the device runs, without waiting for it.
    pub live_timestamps: bool,
    /// Nanoseconds per tick of a timestamp.
    pub timestamp_period: f32,
}

/// The limits of a device's subgroups.
#[derive(Clone, Copy, Debug, Default)]
pub struct SubgroupLimits {
    /// Lanes that compute shaders run with.
    pub size: u32,
    /// The fewest lanes that the driver may choose where a pipeline does not ask.
    pub min_size: u32,
    /// The most lanes that it may choose.
    pub max_size: u32,
    /// A compute pipeline may ask for a size.
    pub selectable: bool,
    /// Subgroups of a workgroup, where a size is requested.
    pub max_per_group: u32,
}

impl SubgroupLimits {
    /// Returns true if a compute pipeline with workgroups of this size can ask for subgroups of [`SubgroupLimits::size`] lanes.
    pub fn can_ask(&self, local_size: [u32; 3]) -> bool {
        let invocations: u64 = local_size.iter().map(|&n| u64::from(n)).product();
        self.selectable
            && self.size > 0
            && local_size[0].is_multiple_of(self.size)
            && invocations <= u64::from(self.size) * u64::from(self.max_per_group)
    }

    /// Returns true if workgroups of this size run in subgroups of [`SubgroupLimits::size`] lanes for certain.
    pub fn is_certain(&self, local_size: [u32; 3]) -> bool {
        let only_one = self.min_size == self.max_size && self.size == self.max_size;
        only_one || self.can_ask(local_size)
    }
}

impl Limits {
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
            rounds_half: self.rounds_half,
            fused_fma: self.fused_fma,
            features: self.features,
        }
    }
}
