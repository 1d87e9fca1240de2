//! Defines compiled shaders, with their declarations and accesses.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Features, Format};

/// A compiled shader module, with its defines.
#[derive(Clone, Debug, PartialEq)]
pub struct Shader {
    /// Path, as in the graph: for instance `sort/scatter.comp`.
    pub name: String,
    /// Names and values of the defines that the shader's text mentions.
    pub defines: Vec<(String, String)>,
    /// SPIR-V code, in 32-bit words.
    pub spirv: Arc<Vec<u32>>,
    /// Declarations and accesses.
    pub reflection: Reflection,
    /// The shader in Metal's language; `None` until `msl::add_msl` translates the plan.
    pub msl: Option<Arc<Msl>>,
}

/// A shader in the Metal Shading Language, and the indices of its arguments.
///
/// Each stage has its own argument tables: one for buffers, one for textures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Msl {
    /// Source text of a library with a single function.
    pub source: String,
    /// The function's name.
    pub entry: String,
    /// Argument indices of the reachable bindings, sorted by binding and element.
    pub arguments: Vec<MslArgument>,
    /// Index in the table of buffers for the push constants; `None` if the shader has none.
    pub push: Option<u32>,
    /// Index in the table of buffers for the buffer sizes; `None` if the code queries no buffer's length.
    ///
    /// The sizes in bytes are 32-bit words, by buffer index.
    pub sizes: Option<u32>,
}

impl Msl {
    /// Maximum number of buffers of a function, including push constants and sizes.
    ///
    /// Apple, "Metal Feature Set Tables", "Maximum number of entries in the buffer argument table, per graphics or
    /// kernel function".
    pub const MOST_BUFFERS: u32 = 31;

    /// Maximum number of textures of a function.
    ///
    /// Apple, "Metal Feature Set Tables", "Maximum number of entries in the texture argument table, per graphics or
    /// kernel function".
    pub const MOST_TEXTURES: u32 = 128;

    /// Maximum bytes of push constants, which Metal copies with the command (`setBytes`).
    ///
    /// Apple, documentation of `setBytes:length:atIndex:`: "data smaller than 4 KB".
    pub const MOST_PUSH_BYTES: u32 = 4095;
}

/// Location of a binding in an argument table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MslArgument {
    /// Number of the binding in set 0.
    pub binding: u32,
    /// Index in an array of descriptors, else 0.
    pub element: u32,
    /// True for the table of textures (storage images), false for the table of buffers.
    pub texture: bool,
    /// Index in the table.
    pub index: u32,
}

/// The pipeline stage of a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ShaderStage {
    /// `.vert`
    Vertex,
    /// `.frag`
    Fragment,
    /// `.comp`
    Compute,
}

impl ShaderStage {
    /// Returns the stage that a file name's extension stands for; `None` for any other extension.
    pub fn of_file(name: &str) -> Option<ShaderStage> {
        match name.rsplit_once('.')?.1 {
            "vert" => Some(ShaderStage::Vertex),
            "frag" => Some(ShaderStage::Fragment),
            "comp" => Some(ShaderStage::Compute),
            _ => None,
        }
    }
}

/// The declarations and accesses of a SPIR-V module.
#[derive(Clone, Debug, PartialEq)]
pub struct Reflection {
    /// The stage of the module's entry point.
    pub stage: ShaderStage,
    /// Workgroup size in x, y, z; `[1, 1, 1]` for all but compute shaders.
    pub local_size: [u32; 3],
    /// Bytes of shared memory.
    pub shared_bytes: u32,
    /// The bindings that the entry point can reach, sorted by number.
    pub bindings: Vec<ReflectedBinding>,
    /// The push-constant block; `None` if the shader has none.
    pub push: Option<PushBlock>,
    /// Stage inputs with a location, sorted by location.
    pub inputs: Vec<Varying>,
    /// Stage outputs with a location, sorted by location.
    pub outputs: Vec<Varying>,
    /// True if the module uses subgroup operations (any GroupNonUniform capability).
    pub subgroups: bool,
    /// Optional features of a device that the module requires.
    pub features: Features,
}

/// A block or image that a shader binds.
#[derive(Clone, Debug, PartialEq)]
pub struct ReflectedBinding {
    /// Name of the block (`Keys` in `buffer Keys { uint keys[]; }`) or of the image variable.
    pub name: String,
    /// Number of the descriptor set.
    pub set: u32,
    /// Number of the binding in its set.
    pub binding: u32,
    /// Length of the descriptor array, else 1.
    pub count: u32,
    /// Type and layout.
    pub kind: ReflectedKind,
    /// True if the code loads from the binding, directly, through a function argument or by an atomic.
    pub reads: bool,
    /// True if the code stores to the binding, directly, through a function argument or by an atomic.
    pub writes: bool,
    /// True if every load and store is atomic, so that concurrent invocations do not race.
    pub atomics_only: bool,
    /// True if the first access in the code is a plain store. Example: a shader that clears counters before use.
    pub writes_first: bool,
}

/// The type and layout of a binding.
#[derive(Clone, Debug, PartialEq)]
pub enum ReflectedKind {
    /// A storage buffer.
    StorageBuffer {
        /// Bytes per element of the runtime array at the block's end, if there is one.
        stride: Option<u32>,
        /// Bytes before the runtime array; without one, bytes of the whole block.
        fixed_bytes: u32,
    },
    /// A uniform block.
    UniformBuffer {
        /// Size in bytes.
        bytes: u32,
        /// Members, in order.
        members: Vec<Member>,
    },
    /// A storage image.
    StorageImage {
        /// The format, if the shader declares one.
        format: Option<Format>,
    },
}

/// A push-constant block.
#[derive(Clone, Debug, PartialEq)]
pub struct PushBlock {
    /// Size in bytes.
    pub bytes: u32,
    /// Members, in order.
    pub members: Vec<Member>,
}

/// A member of a uniform or push-constant block.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Name of the member.
    pub name: String,
    /// Byte offset in the block.
    pub offset: u32,
    /// Type of the member.
    pub kind: MemberKind,
    /// True if the code may read the member.
    pub used: bool,
}

/// The type of a block's member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemberKind {
    /// `uint`
    Uint,
    /// `int`
    Int,
    /// `float`
    Float,
    /// A vector, a matrix, a struct or an array.
    Other,
}

/// An input or output of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Varying {
    /// Name of the variable.
    pub name: String,
    /// Number of the location.
    pub location: u32,
    /// GLSL type, for instance `vec4`, `uint` or `vec2`.
    pub glsl_type: String,
    /// True if the variable is not interpolated.
    pub flat: bool,
}
