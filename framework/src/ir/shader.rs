//! Defines compiled shaders, with their declarations and accesses.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Features, Format};

/// A compiled shader module with its defines and reflection.
#[derive(Clone, Debug, PartialEq)]
pub struct Shader {
    /// Path as in the graph, for instance `sort/scatter.comp`.
    pub name: String,
    /// Path of the file that was found for the name, for messages: `shaders/sort/scatter.comp (built in)`.
    pub path: String,
    /// Names and values of the defines that the shader or its includes mention.
    pub defines: Vec<(String, String)>,
    /// SPIR-V code, in 32-bit words.
    pub spirv: Arc<Vec<u32>>,
    /// Declarations and accesses, reflected from the code.
    pub reflection: Reflection,
    /// The shader in the Metal Shading Language; `None` until `msl::add_msl` translates the plan.
    pub msl: Option<Arc<Msl>>,
}

/// A shader in the Metal Shading Language, with the indices of its bindings in the stage's argument tables. A stage has
/// one table for buffers and one for textures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Msl {
    /// Source text of a library with a single function.
    pub source: String,
    /// Name of the function in the source.
    pub entry: String,
    /// Argument indices of the bindings that the code can reach, sorted by binding and element.
    pub arguments: Vec<MslArgument>,
    /// Index of the push constants in the buffer table; `None` if the shader has none.
    pub push: Option<u32>,
    /// Index of the buffer sizes in the buffer table; `None` if the code queries no buffer's length. Each size is a
    /// 32-bit byte count, at the index that its buffer has in the table.
    pub sizes: Option<u32>,
}

impl Msl {
    /// Maximum number of buffers of a function, including push constants and sizes (Apple, "Metal Feature Set Tables").
    pub const MAX_BUFFERS: u32 = 31;

    /// Maximum number of textures of a function (Apple, "Metal Feature Set Tables").
    pub const MAX_TEXTURES: u32 = 128;
    /// Maximum number of textures in a function's arguments that it may both read and write, by Apple's compiler.
    pub const MAX_READ_WRITE_TEXTURES: u32 = 8;

    /// Maximum bytes of push constants, which Metal copies with the command: "smaller than 4 KB" (Apple, `setBytes`).
    pub const MAX_PUSH_BYTES: u32 = 4095;
}

/// Location of a binding in an argument table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MslArgument {
    /// Number of the binding in set 0.
    pub binding: u32,
    /// Index in an array of descriptors; 0 if the binding is not an array.
    pub element: u32,
    /// True for the table of textures (storage images), false for the table of buffers.
    pub texture: bool,
    /// Index in that table.
    pub index: u32,
}

/// The pipeline stage of a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ShaderStage {
    /// A vertex shader, `.vert`.
    Vertex,
    /// A fragment shader, `.frag`.
    Fragment,
    /// A compute shader, `.comp`.
    Compute,
}

impl ShaderStage {
    /// Returns the stage for a file name's extension, or `None` for an unknown extension.
    pub fn of_file(name: &str) -> Option<ShaderStage> {
        match name.rsplit_once('.')?.1 {
            "vert" => Some(ShaderStage::Vertex),
            "frag" => Some(ShaderStage::Fragment),
            "comp" => Some(ShaderStage::Compute),
            _ => None,
        }
    }
}

/// Declarations and accesses of a SPIR-V module, reflected from its code.
#[derive(Clone, Debug, PartialEq)]
pub struct Reflection {
    /// The stage of the module's entry point.
    pub stage: ShaderStage,
    /// Workgroup size in x, y, z; `[1, 1, 1]` for vertex and fragment shaders.
    pub local_size: [u32; 3],
    /// Bytes of shared memory that a workgroup declares.
    pub shared_bytes: u32,
    /// Bindings that the entry point can reach, sorted by set and number.
    pub bindings: Vec<ReflectedBinding>,
    /// The push-constant block; `None` if the shader has none.
    pub push: Option<PushBlock>,
    /// Stage inputs with a `location`, sorted by it.
    pub inputs: Vec<Varying>,
    /// Stage outputs with a `location`, sorted by it.
    pub outputs: Vec<Varying>,
    /// True if the code uses `gl_Position`. Without a position, what a vertex shader draws is undefined.
    pub uses_position: bool,
    /// True if the code uses `gl_WorkGroupID` or `gl_GlobalInvocationID`, and not `gl_NumWorkGroups`. It then cannot
    /// compute its index in a dispatch that is folded into y; see [`Groups::Direct`](super::Groups::Direct).
    pub ignores_rows: bool,
    /// Optional device features that the module requires.
    pub features: Features,
}

impl Reflection {
    /// Returns true if the module uses subgroup operations.
    pub fn has_subgroups(&self) -> bool {
        self.features.intersects(Features::SUBGROUP_OPERATIONS)
    }
}

/// A block or an image that a shader binds.
#[derive(Clone, Debug, PartialEq)]
pub struct ReflectedBinding {
    /// Name of the block (`Keys` in `buffer Keys { uint keys[]; }`) or of the image variable.
    pub name: String,
    /// Number of the descriptor set.
    pub set: u32,
    /// Number of the binding in its set.
    pub binding: u32,
    /// Length of a descriptor array; 1 if the binding is not an array.
    pub count: u32,
    /// Type and layout.
    pub kind: ReflectedKind,
    /// True if the code loads from the binding, also through a function argument, or uses atomics other than stores.
    pub reads: bool,
    /// True if the code stores to the binding, also through a function argument, or uses atomics other than loads.
    pub writes: bool,
    /// True if the code uses atomics on the binding.
    pub atomics: bool,
    /// True if every load and store is atomic, so that invocations do not race.
    pub atomics_only: bool,
    /// True if the first access in the code is a store without a read, such as one that clears counters.
    pub writes_first: bool,
    /// Type of a block's 32-bit scalars, also in vectors, matrices, arrays and structs. `Other` for images, and for
    /// blocks that contain scalars of several types or of another size.
    pub scalar: MemberKind,
    /// Words of a storage block, by offset: those before its runtime array, then those of one element. Padding has
    /// none. Empty for images, uniform blocks, and blocks with more than 64 words.
    pub words: Vec<Member>,
}

/// The type and layout of a binding.
#[derive(Clone, Debug, PartialEq)]
pub enum ReflectedKind {
    /// A storage buffer.
    StorageBuffer {
        /// Bytes per element of the runtime array at the end of the block; `None` without such an array.
        stride: Option<u32>,
        /// Bytes before the runtime array. Without one, the size of the whole block.
        fixed_bytes: u32,
    },
    /// A uniform block.
    UniformBuffer {
        /// Size of the block in bytes.
        bytes: u32,
        /// Members, in order of declaration.
        members: Vec<Member>,
    },
    /// A storage image.
    StorageImage {
        /// Pixel format; `None` if the shader declares none.
        format: Option<Format>,
    },
}

/// The push-constant block of a shader.
#[derive(Clone, Debug, PartialEq)]
pub struct PushBlock {
    /// Size of the block in bytes.
    pub bytes: u32,
    /// Members, in order of declaration.
    pub members: Vec<Member>,
}

impl PushBlock {
    /// Returns true if the blocks have the same members, whichever of them the code reads.
    pub fn has_layout_of(&self, other: &PushBlock) -> bool {
        let all = |block: &PushBlock| -> Vec<Member> {
            block.members.iter().map(|member| Member { used: true, ..member.clone() }).collect()
        };
        self.bytes == other.bytes && all(self) == all(other)
    }
}

/// A member of a uniform or push-constant block, or a 32-bit word of a storage block.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Name of the member in GLSL. For a word, its place in the block or in the array's element, such as `root.x`;
    /// empty for the elements of an array of scalars.
    pub name: String,
    /// Byte offset from the start of the block.
    pub offset: u32,
    /// 32-bit scalar type, or `Other`.
    pub kind: MemberKind,
    /// True if the code may read the member; always true for words.
    pub used: bool,
}

/// The type of a block member. Only 32-bit scalars can be set from a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemberKind {
    /// `uint`
    Uint,
    /// `int`
    Int,
    /// `float`
    Float,
    /// A vector, a matrix, a struct, an array, or a scalar of another size.
    Other,
}

/// A stage input or output that has a location.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Varying {
    /// Name of the variable in GLSL.
    pub name: String,
    /// Number of its `location`.
    pub location: u32,
    /// GLSL type, for instance `vec4`, `uint` or `vec2`.
    pub glsl_type: String,
}
