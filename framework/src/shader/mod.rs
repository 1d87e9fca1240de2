//! Compiles GLSL to SPIR-V, and reflects the result.
//!
//! This module compiles a shader file with defines for the graph's constants, resolves its `#include`s, and reflects
//! the SPIR-V: bindings by block name, array strides, push constants, workgroup size, and the bindings that the code
//! loads from and stores to. `link` checks the graph against this.

#[cfg(feature = "glslang")]
mod compile;
mod compiler;
#[cfg(feature = "glslang")]
mod reflect;
#[cfg(feature = "glslang")]
pub use compile::{Glslang, Limits, Worker, serve_if_asked};
pub use compiler::{CANCELLED, Cancel, Compiled, ShaderCompiler, ShaderRequest, SpirvStore};
#[cfg(feature = "glslang")]
pub use reflect::reflect;
