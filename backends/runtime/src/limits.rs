//! Defines the device limits that plans can exceed.

use splatgraph_framework::ir::DeviceFacts;

/// The limits of a device.
#[derive(Clone, Debug, Default)]
pub struct Limits {
    /// The limits and features that graphs and the linker use.
    pub facts: DeviceFacts,
    /// Maximum size of a uniform block, in bytes.
    pub max_uniform_bytes: u64,
    /// Maximum size of a buffer, in bytes.
    pub max_buffer_bytes: u64,
    /// Maximum number of invocations of a workgroup in x, y and z.
    pub max_local_size: [u32; 3],
    /// Maximum number of storage buffers per shader stage.
    pub max_storage_buffers: u32,
    /// Maximum number of uniform blocks per shader stage.
    pub max_uniform_buffers: u32,
    /// Maximum number of storage images per shader stage.
    pub max_storage_images: u32,
    /// Size of the largest device-local heap, in bytes.
    pub heap_bytes: u64,
    /// A bit for each memory type that is device-local; 0 if objects cannot share memory.
    pub device_memory_types: u32,
    /// Size in bytes of the pages that a buffer and an image in one allocation must not share.
    pub buffer_image_granularity: u64,
    /// True if targets of one draw may blend differently.
    pub independent_blend: bool,
    /// The limits of subgroups.
    pub subgroup: SubgroupLimits,
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
    /// Minimum subgroup size that the driver may choose if a pipeline does not request one.
    pub min_size: u32,
    /// Maximum subgroup size that the driver may choose.
    pub max_size: u32,
    /// True if a compute pipeline can request a subgroup size.
    pub selectable: bool,
    /// Maximum number of subgroups per workgroup if a size is requested.
    pub max_per_group: u32,
}

impl Limits {
    /// Returns true if a compute pipeline with this workgroup size can request [`DeviceFacts::subgroup_size`] lanes.
    pub fn can_request_size(&self, local_size: [u32; 3]) -> bool {
        let (lanes, invocations) =
            (self.facts.subgroup_size, local_size.iter().map(|&n| u64::from(n)).product::<u64>());
        self.subgroup.selectable
            && lanes > 0
            && local_size[0].is_multiple_of(lanes)
            && invocations <= u64::from(lanes) * u64::from(self.subgroup.max_per_group)
    }

    /// Returns true if workgroups of this size always run in subgroups of [`DeviceFacts::subgroup_size`] lanes.
    ///
    /// This holds if a pipeline can request the size, or if the device has no other size.
    pub fn has_certain_size(&self, local_size: [u32; 3]) -> bool {
        let SubgroupLimits { min_size, max_size, .. } = self.subgroup;
        let only_one = [min_size, max_size] == [self.facts.subgroup_size; 2];
        only_one || self.can_request_size(local_size)
    }

    /// Returns limits similar to those of a desktop GPU, for a device that executes nothing, and for tests.
    pub fn desktop() -> Limits {
        Limits {
            facts: DeviceFacts {
                max_storage_bytes: 1 << 30,
                max_push_bytes: 128,
                max_image_size: 16384,
                ..DeviceFacts::typical(32)
            },
            max_uniform_bytes: 65536,
            max_buffer_bytes: 2 << 30,
            max_local_size: [1024; 3],
            max_storage_buffers: 32,
            max_uniform_buffers: 16,
            max_storage_images: 16,
            heap_bytes: 16 << 30,
            device_memory_types: 1,
            buffer_image_granularity: 64,
            independent_blend: true,
            subgroup: SubgroupLimits { min_size: 32, max_size: 32, selectable: true, max_per_group: 32 },
            timestamp_bits: 64,
            live_timestamps: true,
            timestamp_period: 1.0,
        }
    }
}
