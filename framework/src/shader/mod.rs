//! GLSL to SPIR-V, and what a compiled shader says of itself.
//!
//! The graph names a shader file; this module compiles it with the defines that the graph's constants give, resolves
//! its `#include`s, and reads the SPIR-V back: bindings by block name, array strides, push constants, workgroup size,
//! and which bindings the code really loads from and stores to. [`crate::check`] holds the graph against that.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

use crate::plan::Format;
use crate::source::{Diagnostic, FileId, SourceMap};

#[cfg(feature = "glslang")]
mod compile;
#[cfg(feature = "glslang")]
mod reflect;
#[cfg(feature = "glslang")]
pub use compile::Glslang;
#[cfg(feature = "glslang")]
pub use reflect::reflect;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ShaderStage {
    Vertex,
    Fragment,
    Compute,
}

impl ShaderStage {
    /// By the file's extension: `.comp`, `.vert`, `.frag`.
    pub fn of_file(name: &str) -> Option<ShaderStage> {
        match name.rsplit_once('.')?.1 {
            "vert" => Some(ShaderStage::Vertex),
            "frag" => Some(ShaderStage::Fragment),
            "comp" => Some(ShaderStage::Compute),
            _ => None,
        }
    }
}

/// What a SPIR-V module says of itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reflection {
    pub stage: ShaderStage,
    /// Invocations of a workgroup in x, y, z; `[1, 1, 1]` for what is not a compute shader.
    pub local_size: [u32; 3],
    /// Bytes of shared memory.
    pub shared_bytes: u32,
    /// Sorted by binding. Only what the entry point's code can reach.
    pub bindings: Vec<ReflectedBinding>,
    pub push: Option<PushBlock>,
    /// Stage inputs and outputs with a location, sorted by it.
    pub inputs: Vec<Varying>,
    pub outputs: Vec<Varying>,
    /// The module uses subgroup operations (any GroupNonUniform capability).
    pub subgroups: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReflectedBinding {
    /// Name of the block (`Keys` in `buffer Keys { uint keys[]; }`) or of the image variable.
    pub name: String,
    pub set: u32,
    pub binding: u32,
    /// Length of the descriptor array, 1 where there is none.
    pub count: u32,
    pub kind: ReflectedKind,
    /// The code loads from it (also through a function argument, also by an atomic).
    pub reads: bool,
    /// The code stores to it (likewise).
    pub writes: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ReflectedKind {
    /// `stride` is that of the runtime array at the block's end, if it has one; `fixed_bytes` is the size of what is
    /// before it (of the whole block where there is none).
    StorageBuffer {
        stride: Option<u32>,
        fixed_bytes: u32,
    },
    UniformBuffer {
        bytes: u32,
        members: Vec<Member>,
    },
    StorageImage {
        format: Option<Format>,
    },
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PushBlock {
    pub bytes: u32,
    pub members: Vec<Member>,
}

/// A member of a uniform or push-constant block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Member {
    pub name: String,
    pub offset: u32,
    pub kind: MemberKind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MemberKind {
    Uint,
    Int,
    Float,
    /// Vectors, matrices, structs, arrays.
    Other,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Varying {
    pub name: String,
    pub location: u32,
    /// For instance `vec4`, `uint`, `vec2`.
    pub glsl_type: String,
    pub flat: bool,
}

/// What to compile.
#[derive(Clone, Debug)]
pub struct ShaderRequest<'a> {
    /// The shader's own file, already in the source map.
    pub file: FileId,
    pub stage: ShaderStage,
    /// Every define that the graph offers, name and value. Only those whose name occurs as an identifier in the
    /// shader or its includes are used, and only these are in [`Compiled::defines`].
    pub defines: &'a [(String, String)],
    /// Files that exist only in memory, found by `#include` before anything else: name and text (`live.glsl`).
    pub generated: &'a [(String, String)],
}

#[derive(Clone, Debug)]
pub struct Compiled {
    pub spirv: Arc<Vec<u32>>,
    pub defines: Vec<(String, String)>,
    pub reflection: Reflection,
}

/// Compiles shaders, and remembers what it compiled. The one implementation is `Glslang` (feature `glslang`); tests
/// of the rest of the framework can stand in with reflections made by hand.
pub trait ShaderCompiler {
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>>;
}
