//! Defines the optional features of a device that shaders can use.

use bitflags::bitflags;
use std::fmt;

bitflags! {
    /// Optional features that a shader uses, or that a device was opened with.
    ///
    /// Excludes features that every Vulkan 1.3 device has (except `SUBGROUP_BASIC`), and features that no backend
    /// enables; a shader that needs one of the latter fails to compile.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Features: u64 {
        /// `int16_t` and `uint16_t` in shaders.
        const INT16 = 1;
        /// `int64_t` and `uint64_t` in shaders.
        const INT64 = 1 << 1;
        /// `int8_t` and `uint8_t` in shaders.
        const INT8 = 1 << 2;
        /// `float16_t` in shaders.
        const FLOAT16 = 1 << 3;
        /// `double` in shaders.
        const FLOAT64 = 1 << 4;
        /// 16-bit members of storage blocks.
        const STORAGE_16 = 1 << 5;
        /// 16-bit members of uniform blocks.
        const UNIFORM_16 = 1 << 6;
        /// 8-bit members of storage blocks.
        const STORAGE_8 = 1 << 7;
        /// 8-bit members of uniform blocks.
        const UNIFORM_8 = 1 << 8;
        /// Blocks with `layout(scalar)`.
        const SCALAR_LAYOUT = 1 << 9;
        /// Atomic operations on 64-bit integers in storage blocks.
        const BUFFER_INT64_ATOMICS = 1 << 10;
        /// Atomic operations on 64-bit integers in shared memory.
        const SHARED_INT64_ATOMICS = 1 << 11;
        /// Atomic loads, stores and exchanges of floats in storage blocks.
        const BUFFER_FLOAT_ATOMICS = 1 << 12;
        /// Atomic additions to floats in storage blocks.
        const BUFFER_FLOAT_ATOMIC_ADD = 1 << 13;
        /// Atomic loads, stores and exchanges of floats in shared memory.
        const SHARED_FLOAT_ATOMICS = 1 << 14;
        /// Atomic additions to floats in shared memory.
        const SHARED_FLOAT_ATOMIC_ADD = 1 << 15;
        /// Atomic loads, stores and exchanges of pixels of `r32f` images.
        const IMAGE_FLOAT_ATOMICS = 1 << 16;
        /// Atomic additions to pixels of `r32f` images.
        const IMAGE_FLOAT_ATOMIC_ADD = 1 << 17;
        /// Reads of storage images without a format in the shader.
        const IMAGE_READ_WITHOUT_FORMAT = 1 << 18;
        /// Writes to storage images without a format in the shader.
        const IMAGE_WRITE_WITHOUT_FORMAT = 1 << 19;
        /// Storage images in the formats of Vulkan's `shaderStorageImageExtendedFormats`.
        const IMAGE_EXTENDED_FORMATS = 1 << 20;
        /// Dynamically uniform indices into arrays of storage blocks.
        const STORAGE_BUFFER_INDEXING = 1 << 21;
        /// Dynamically uniform indices into arrays of uniform blocks.
        const UNIFORM_BUFFER_INDEXING = 1 << 22;
        /// Dynamically uniform indices into arrays of storage images.
        const STORAGE_IMAGE_INDEXING = 1 << 23;
        /// Indices into arrays of storage blocks that differ between the invocations of a subgroup.
        const STORAGE_BUFFER_NONUNIFORM = 1 << 24;
        /// Indices into arrays of uniform blocks that differ between the invocations of a subgroup.
        const UNIFORM_BUFFER_NONUNIFORM = 1 << 25;
        /// Indices into arrays of storage images that differ between the invocations of a subgroup.
        const STORAGE_IMAGE_NONUNIFORM = 1 << 26;
        /// Vertex shaders that write to storage blocks or images.
        const VERTEX_STORES = 1 << 27;
        /// Fragment shaders that write to storage blocks or images.
        const FRAGMENT_STORES = 1 << 28;
        /// `gl_DrawID`, `gl_BaseVertex`, `gl_BaseInstance`
        const DRAW_PARAMETERS = 1 << 29;
        /// `gl_ClipDistance`
        const CLIP_DISTANCE = 1 << 30;
        /// `gl_CullDistance`
        const CULL_DISTANCE = 1 << 31;
        /// `sample` inputs, `gl_SampleID`
        const SAMPLE_SHADING = 1 << 32;
        /// Basic subgroup operations, such as `subgroupElect`, in compute shaders.
        const SUBGROUP_BASIC = 1 << 33;
        /// Subgroup votes, such as `subgroupAll`.
        const SUBGROUP_VOTE = 1 << 34;
        /// Subgroup reductions and scans, such as `subgroupAdd`.
        const SUBGROUP_ARITHMETIC = 1 << 35;
        /// Subgroup ballots, such as `subgroupBallot`.
        const SUBGROUP_BALLOT = 1 << 36;
        /// Subgroup shuffles: `subgroupShuffle` and `subgroupShuffleXor`.
        const SUBGROUP_SHUFFLE = 1 << 37;
        /// Relative subgroup shuffles: `subgroupShuffleUp` and `subgroupShuffleDown`.
        const SUBGROUP_SHUFFLE_RELATIVE = 1 << 38;
        /// Clustered subgroup reductions, such as `subgroupClusteredAdd`.
        const SUBGROUP_CLUSTERED = 1 << 39;
        /// Subgroup quad operations, such as `subgroupQuadBroadcast`.
        const SUBGROUP_QUAD = 1 << 40;
        /// Subgroup operations in vertex shaders.
        const SUBGROUPS_IN_VERTEX = 1 << 41;
        /// Subgroup operations in fragment shaders.
        const SUBGROUPS_IN_FRAGMENT = 1 << 42;
        /// Subgroups that reconverge after control flow that is uniform in the subgroup, not only in the workgroup.
        const SUBGROUP_UNIFORM_CONTROL_FLOW = 1 << 43;
    }
}

impl Features {
    /// All kinds of subgroup operations. A module with any of them has subgroups.
    pub const SUBGROUP_OPERATIONS: Features = Features::SUBGROUP_BASIC
        .union(Features::SUBGROUP_VOTE)
        .union(Features::SUBGROUP_ARITHMETIC)
        .union(Features::SUBGROUP_BALLOT)
        .union(Features::SUBGROUP_SHUFFLE)
        .union(Features::SUBGROUP_SHUFFLE_RELATIVE)
        .union(Features::SUBGROUP_CLUSTERED)
        .union(Features::SUBGROUP_QUAD);

    /// Lists each feature with a description.
    #[rustfmt::skip]
    pub const LIST: [(Features, &str); 44] = [
        (Features::INT16, "16-bit integers"),
        (Features::INT64, "64-bit integers"),
        (Features::INT8, "8-bit integers"),
        (Features::FLOAT16, "16-bit floats"),
        (Features::FLOAT64, "64-bit floats"),
        (Features::STORAGE_16, "16-bit members of storage blocks"),
        (Features::UNIFORM_16, "16-bit members of uniform blocks"),
        (Features::STORAGE_8, "8-bit members of storage blocks"),
        (Features::UNIFORM_8, "8-bit members of uniform blocks"),
        (Features::SCALAR_LAYOUT, "blocks of scalar layout"),
        (Features::BUFFER_INT64_ATOMICS, "64-bit atomics in buffers"),
        (Features::SHARED_INT64_ATOMICS, "64-bit atomics in shared memory"),
        (Features::BUFFER_FLOAT_ATOMICS, "atomic floats in buffers"),
        (Features::BUFFER_FLOAT_ATOMIC_ADD, "atomic float additions in buffers"),
        (Features::SHARED_FLOAT_ATOMICS, "atomic floats in shared memory"),
        (Features::SHARED_FLOAT_ATOMIC_ADD, "atomic float additions in shared memory"),
        (Features::IMAGE_FLOAT_ATOMICS, "atomic floats in images"),
        (Features::IMAGE_FLOAT_ATOMIC_ADD, "atomic float additions in images"),
        (Features::IMAGE_READ_WITHOUT_FORMAT, "reads of images without a format"),
        (Features::IMAGE_WRITE_WITHOUT_FORMAT, "writes to images without a format"),
        (Features::IMAGE_EXTENDED_FORMATS, "storage images of extended formats"),
        (Features::STORAGE_BUFFER_INDEXING, "variable indices into arrays of storage blocks"),
        (Features::UNIFORM_BUFFER_INDEXING, "variable indices into arrays of uniform blocks"),
        (Features::STORAGE_IMAGE_INDEXING, "variable indices into arrays of storage images"),
        (Features::STORAGE_BUFFER_NONUNIFORM, "non-uniform indices into arrays of storage blocks"),
        (Features::UNIFORM_BUFFER_NONUNIFORM, "non-uniform indices into arrays of uniform blocks"),
        (Features::STORAGE_IMAGE_NONUNIFORM, "non-uniform indices into arrays of storage images"),
        (Features::VERTEX_STORES, "vertex shaders that write"),
        (Features::FRAGMENT_STORES, "fragment shaders that write"),
        (Features::DRAW_PARAMETERS, "parameters of draws"),
        (Features::CLIP_DISTANCE, "clip distances"),
        (Features::CULL_DISTANCE, "cull distances"),
        (Features::SAMPLE_SHADING, "shading per sample"),
        (Features::SUBGROUP_BASIC, "subgroups"),
        (Features::SUBGROUP_VOTE, "votes of subgroups"),
        (Features::SUBGROUP_ARITHMETIC, "arithmetic of subgroups"),
        (Features::SUBGROUP_BALLOT, "ballots of subgroups"),
        (Features::SUBGROUP_SHUFFLE, "shuffles of subgroups"),
        (Features::SUBGROUP_SHUFFLE_RELATIVE, "relative shuffles of subgroups"),
        (Features::SUBGROUP_CLUSTERED, "clustered operations of subgroups"),
        (Features::SUBGROUP_QUAD, "quad operations of subgroups"),
        (Features::SUBGROUPS_IN_VERTEX, "subgroup operations in vertex shaders"),
        (Features::SUBGROUPS_IN_FRAGMENT, "subgroup operations in fragment shaders"),
        (Features::SUBGROUP_UNIFORM_CONTROL_FLOW, "uniform control flow of subgroups"),
    ];
}

impl fmt::Display for Features {
    /// Writes a list such as `64-bit floats, votes of subgroups`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let listed = Features::LIST.iter().filter(|(feature, _)| self.contains(*feature));
        for (index, (_, words)) in listed.enumerate() {
            write!(f, "{}{words}", if index == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_is_in_the_list_once_and_has_words() {
        let mut seen = Features::empty();
        for (feature, words) in Features::LIST {
            assert!(!seen.intersects(feature), "{words} is listed twice");
            assert!(!words.is_empty());
            seen |= feature;
        }
        assert_eq!(seen, Features::all());
        let two = Features::FLOAT64 | Features::SUBGROUP_VOTE;
        assert_eq!(two.to_string(), "64-bit floats, votes of subgroups");
    }
}
