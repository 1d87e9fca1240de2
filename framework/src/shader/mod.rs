//! Compiles GLSL to SPIR-V with defines for the graph's constants, and reflects the result.
//!
//! Reflection gives bindings by block name, array strides, push constants, the workgroup size, and the accesses of the
//! code. `link` checks the graph against it.

#[cfg(feature = "glslang")]
mod compile;
mod compiler;
#[cfg(feature = "reflect")]
mod reflect;
#[cfg(feature = "glslang")]
pub use compile::{Glslang, Limits, Worker, serve_if_asked};
pub use compiler::{CANCELLED, Cancel, Compiled, ShaderCompiler, ShaderRequest, SpirvStore};
#[cfg(feature = "reflect")]
pub use reflect::reflect;
