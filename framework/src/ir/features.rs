//! Defines the optional features of a device that shaders can use.

use bitflags::bitflags;
use std::fmt;

/// Defines [`Features`] from a table of flags with their descriptions.
macro_rules! features {
    ($($(#[doc = $doc:literal])* $name:ident = $bit:expr, $words:literal;)*) => {
        bitflags! {
            /// Optional features that a shader uses, or that a device was opened with.
            ///
            /// Excludes features that every Vulkan 1.3 device has (except `SUBGROUP_BASIC`), and features that no
            /// backend enables; a shader that needs one of the latter fails to compile.
            #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
            pub struct Features: u64 {
                $($(#[doc = $doc])* const $name = $bit;)*
            }
        }

        impl Features {
            /// Lists each feature with a description.
            pub const LIST: &[(Features, &str)] = &[$((Features::$name, $words)),*];
        }
    };
}

features! {
    /// `int16_t` and `uint16_t` in shaders.
    INT16 = 1, "16-bit integers";
    /// `int64_t` and `uint64_t` in shaders.
    INT64 = 1 << 1, "64-bit integers";
    /// `int8_t` and `uint8_t` in shaders.
    INT8 = 1 << 2, "8-bit integers";
    /// `float16_t` in shaders.
    FLOAT16 = 1 << 3, "16-bit floats";
    /// `double` in shaders.
    FLOAT64 = 1 << 4, "64-bit floats";
    /// 16-bit members of storage blocks.
    STORAGE_16 = 1 << 5, "16-bit members of storage blocks";
    /// 16-bit members of uniform blocks.
    UNIFORM_16 = 1 << 6, "16-bit members of uniform blocks";
    /// 8-bit members of storage blocks.
    STORAGE_8 = 1 << 7, "8-bit members of storage blocks";
    /// 8-bit members of uniform blocks.
    UNIFORM_8 = 1 << 8, "8-bit members of uniform blocks";
    /// Blocks with `layout(scalar)`.
    SCALAR_LAYOUT = 1 << 9, "blocks of scalar layout";
    /// Atomic operations on 64-bit integers in storage blocks.
    BUFFER_INT64_ATOMICS = 1 << 10, "64-bit atomics in buffers";
    /// Atomic operations on 64-bit integers in shared memory.
    SHARED_INT64_ATOMICS = 1 << 11, "64-bit atomics in shared memory";
    /// Atomic loads, stores and exchanges of floats in storage blocks.
    BUFFER_FLOAT_ATOMICS = 1 << 12, "atomic floats in buffers";
    /// Atomic additions to floats in storage blocks.
    BUFFER_FLOAT_ATOMIC_ADD = 1 << 13, "atomic float additions in buffers";
    /// Atomic loads, stores and exchanges of floats in shared memory.
    SHARED_FLOAT_ATOMICS = 1 << 14, "atomic floats in shared memory";
    /// Atomic additions to floats in shared memory.
    SHARED_FLOAT_ATOMIC_ADD = 1 << 15, "atomic float additions in shared memory";
    /// Atomic loads, stores and exchanges of pixels of `r32f` images.
    IMAGE_FLOAT_ATOMICS = 1 << 16, "atomic floats in images";
    /// Atomic additions to pixels of `r32f` images.
    IMAGE_FLOAT_ATOMIC_ADD = 1 << 17, "atomic float additions in images";
    /// Reads of storage images without a format in the shader.
    IMAGE_READ_WITHOUT_FORMAT = 1 << 18, "reads of images without a format";
    /// Writes to storage images without a format in the shader.
    IMAGE_WRITE_WITHOUT_FORMAT = 1 << 19, "writes to images without a format";
    /// Storage images in the formats of Vulkan's `shaderStorageImageExtendedFormats`.
    IMAGE_EXTENDED_FORMATS = 1 << 20, "storage images of extended formats";
    /// Dynamically uniform indices into arrays of storage blocks.
    STORAGE_BUFFER_INDEXING = 1 << 21, "variable indices into arrays of storage blocks";
    /// Dynamically uniform indices into arrays of uniform blocks.
    UNIFORM_BUFFER_INDEXING = 1 << 22, "variable indices into arrays of uniform blocks";
    /// Dynamically uniform indices into arrays of storage images.
    STORAGE_IMAGE_INDEXING = 1 << 23, "variable indices into arrays of storage images";
    /// Indices into arrays of storage blocks that differ between the invocations of a subgroup.
    STORAGE_BUFFER_NONUNIFORM = 1 << 24, "non-uniform indices into arrays of storage blocks";
    /// Indices into arrays of uniform blocks that differ between the invocations of a subgroup.
    UNIFORM_BUFFER_NONUNIFORM = 1 << 25, "non-uniform indices into arrays of uniform blocks";
    /// Indices into arrays of storage images that differ between the invocations of a subgroup.
    STORAGE_IMAGE_NONUNIFORM = 1 << 26, "non-uniform indices into arrays of storage images";
    /// Vertex shaders that write to storage blocks or images.
    VERTEX_STORES = 1 << 27, "vertex shaders that write";
    /// Fragment shaders that write to storage blocks or images.
    FRAGMENT_STORES = 1 << 28, "fragment shaders that write";
    /// `gl_DrawID`, `gl_BaseVertex`, `gl_BaseInstance`
    DRAW_PARAMETERS = 1 << 29, "parameters of draws";
    /// `gl_ClipDistance`
    CLIP_DISTANCE = 1 << 30, "clip distances";
    /// `gl_CullDistance`
    CULL_DISTANCE = 1 << 31, "cull distances";
    /// `sample` inputs, `gl_SampleID`, and functions such as `interpolateAtSample`.
    SAMPLE_SHADING = 1 << 32, "shading per sample";
    /// Basic subgroup operations, such as `subgroupElect`.
    SUBGROUP_BASIC = 1 << 33, "subgroups";
    /// Subgroup votes, such as `subgroupAll`.
    SUBGROUP_VOTE = 1 << 34, "votes of subgroups";
    /// Subgroup reductions and scans, such as `subgroupAdd`.
    SUBGROUP_ARITHMETIC = 1 << 35, "arithmetic of subgroups";
    /// Subgroup ballots, such as `subgroupBallot`.
    SUBGROUP_BALLOT = 1 << 36, "ballots of subgroups";
    /// Subgroup shuffles: `subgroupShuffle` and `subgroupShuffleXor`.
    SUBGROUP_SHUFFLE = 1 << 37, "shuffles of subgroups";
    /// Relative subgroup shuffles: `subgroupShuffleUp` and `subgroupShuffleDown`.
    SUBGROUP_SHUFFLE_RELATIVE = 1 << 38, "relative shuffles of subgroups";
    /// Clustered subgroup reductions, such as `subgroupClusteredAdd`.
    SUBGROUP_CLUSTERED = 1 << 39, "clustered operations of subgroups";
    /// Subgroup quad operations, such as `subgroupQuadBroadcast`.
    SUBGROUP_QUAD = 1 << 40, "quad operations of subgroups";
    /// Subgroup operations in vertex shaders.
    SUBGROUPS_IN_VERTEX = 1 << 41, "subgroup operations in vertex shaders";
    /// Subgroup operations in fragment shaders.
    SUBGROUPS_IN_FRAGMENT = 1 << 42, "subgroup operations in fragment shaders";
    /// Subgroups that reconverge after control flow that is uniform in the subgroup, not only in the workgroup.
    SUBGROUP_UNIFORM_CONTROL_FLOW = 1 << 43, "uniform control flow of subgroups";
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
    fn each_feature_has_its_own_bit_and_words() {
        assert_eq!(Features::LIST.len(), Features::all().bits().count_ones() as usize);
        let two = Features::FLOAT64 | Features::SUBGROUP_VOTE;
        assert_eq!(two.to_string(), "64-bit floats, votes of subgroups");
    }
}
