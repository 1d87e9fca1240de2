//! Determines the limits and shader features of an Apple GPU.
//!
//! Metal reports only a few limits. The others are the same for whole families of GPUs: they are from Apple's "Metal
//! Feature Set Tables" for family Apple 7, the first on Macs (M1). Later families only exceed them.

use splatgraph_framework::ir::{DeviceFacts, Features, Format, Msl};
use splatgraph_runtime::{FormatSupport, Limits, SubgroupLimits};

/// The limits that a device reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReportedLimits {
    /// Metal's `maxBufferLength`, in bytes.
    pub max_buffer_bytes: u64,
    /// Metal's `maxThreadgroupMemoryLength`, in bytes.
    pub threadgroup_bytes: u32,
    /// Metal's `maxThreadsPerThreadgroup`, in x, y and z.
    pub max_threads: [u32; 3],
    /// Metal's `recommendedMaxWorkingSetSize`, in bytes.
    pub working_set: u64,
    /// Metal's `supports32BitFloatFiltering`.
    pub filters_floats: bool,
}

impl ReportedLimits {
    /// Assumed limits of a small Mac of family Apple 7, for tests.
    pub const APPLE_7: ReportedLimits = ReportedLimits {
        max_buffer_bytes: 4 << 30,
        threadgroup_bytes: 32 << 10,
        max_threads: [1024; 3],
        working_set: 5 << 30,
        filters_floats: false,
    };
}

/// Number of lanes of a SIMD group. Compute pipelines with subgroup operations are checked to have it.
pub const LANES: u32 = 32;

/// Returns the limits that plans are checked against, for a device that reports `reported`.
pub fn limits(reported: &ReportedLimits) -> Limits {
    // Push constants and the buffer sizes take one entry each.
    let buffers = Msl::MAX_BUFFERS - 2;
    Limits {
        facts: DeviceFacts {
            subgroup_size: LANES,
            // Metal documents no limit. Linking folds larger counts in x into y, for every backend.
            max_groups: [65535; 3],
            // Shaders receive the sizes of buffers as 32-bit words.
            max_storage_bytes: reported.max_buffer_bytes.min(u64::from(u32::MAX)),
            max_push_bytes: Msl::MAX_PUSH_BYTES,
            max_invocations: reported.max_threads[0],
            shared_bytes: reported.threadgroup_bytes,
            max_image_size: 16384,
            max_targets: 8,
            // Not documented; docs/metal-mac.md says how to measure it. A plan built for `false` is correct on every
            // device.
            rounds_half: false,
            fused_fma: true,
            features: features(),
        },
        max_uniform_bytes: 64 << 10,
        max_buffer_bytes: reported.max_buffer_bytes,
        max_local_size: reported.max_threads,
        max_storage_buffers: buffers,
        max_uniform_buffers: buffers,
        max_storage_images: Msl::MAX_TEXTURES,
        heap_bytes: reported.working_set,
        device_memory_types: 1,
        // Buffers and images have no granularity beyond their own alignment.
        buffer_image_granularity: 1,
        independent_blend: true,
        subgroup: SubgroupLimits {
            min_size: LANES,
            max_size: LANES,
            selectable: false,
            max_per_group: reported.max_threads[0] / LANES,
        },
        timestamp_bits: 64,
        // Samples can be resolved only after their command buffer has completed.
        live_timestamps: false,
        // Apple's GPUs count nanoseconds.
        timestamp_period: 1.0,
    }
}

/// Returns the shader features of Metal Shading Language 2.4 on family Apple 7.
///
/// Excludes features that the language lacks, and float atomics and 64-bit atomics, which need later versions or
/// families.
pub fn features() -> Features {
    Features::INT16
        | Features::INT64
        | Features::INT8
        | Features::FLOAT16
        | Features::STORAGE_16
        | Features::UNIFORM_16
        | Features::STORAGE_8
        | Features::UNIFORM_8
        | Features::SCALAR_LAYOUT
        | Features::IMAGE_READ_WITHOUT_FORMAT
        | Features::IMAGE_WRITE_WITHOUT_FORMAT
        | Features::IMAGE_EXTENDED_FORMATS
        | Features::STORAGE_BUFFER_INDEXING
        | Features::UNIFORM_BUFFER_INDEXING
        | Features::STORAGE_IMAGE_INDEXING
        | Features::VERTEX_STORES
        | Features::FRAGMENT_STORES
        | Features::DRAW_PARAMETERS
        | Features::CLIP_DISTANCE
        | Features::SAMPLE_SHADING
        | Features::SUBGROUP_BASIC
        | Features::SUBGROUP_VOTE
        | Features::SUBGROUP_ARITHMETIC
        | Features::SUBGROUP_BALLOT
        | Features::SUBGROUP_SHUFFLE
        | Features::SUBGROUP_SHUFFLE_RELATIVE
        | Features::SUBGROUP_QUAD
        | Features::SUBGROUPS_IN_FRAGMENT
}

/// Returns the uses that images of a format support. Formats of 32-bit floats count as blendable if they can be
/// filtered (MoltenVK issue 2301).
pub fn format_support(format: Format, filters_floats: bool) -> FormatSupport {
    let integers = format == Format::R32Uint;
    let floats = matches!(format, Format::R32Float | Format::Rgba32Float);
    let depths = format == Format::Depth32Float;
    FormatSupport {
        storage: !depths,
        target: true,
        blend: !integers && !depths && (!floats || filters_floats),
        blit: !integers && !depths,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn graphs_are_told_of_simd_groups_of_32_lanes_and_32_kib() {
        let facts = limits(&ReportedLimits::APPLE_7).facts;
        assert_eq!((facts.subgroup_size, facts.shared_bytes, facts.max_invocations), (32, 32768, 1024));
        assert!(facts.features.contains(Features::SUBGROUP_BALLOT | Features::SUBGROUP_SHUFFLE));
        assert!(!facts.features.intersects(Features::FLOAT64 | Features::BUFFER_INT64_ATOMICS));
    }

    #[test]
    fn a_binding_is_never_longer_than_the_word_that_tells_its_size() {
        let reported = ReportedLimits { max_buffer_bytes: 64 << 30, ..ReportedLimits::APPLE_7 };
        assert_eq!(limits(&reported).facts.max_storage_bytes, u64::from(u32::MAX));
        assert_eq!(limits(&reported).max_buffer_bytes, 64 << 30);
    }

    #[test]
    fn workgroups_run_in_simd_groups_of_the_known_size_for_certain() {
        let limits = limits(&ReportedLimits::APPLE_7);
        assert!(limits.has_certain_size([256, 1, 1]) && limits.has_certain_size([16, 16, 1]));
        assert!(!limits.can_request_size([256, 1, 1]));
    }

    #[test]
    fn integers_are_not_blended_and_not_shown() {
        let support = format_support(Format::R32Uint, true);
        assert!(support.storage && support.target && !support.blend && !support.blit);
        assert!(format_support(Format::Rgba16Float, false).blend);
        assert!(
            format_support(Format::Rgba32Float, true).blend
                && !format_support(Format::Rgba32Float, false).blend
        );
    }
}
