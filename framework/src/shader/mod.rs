//! Compiles GLSL to SPIR-V, and reflects the result.
//!
//! The graph names a shader file; this module compiles it with the defines that the graph's constants give, resolves
//! its `#include`s, and reads the SPIR-V back: bindings by block name, array strides, push constants, workgroup size,
//! and which bindings the code really loads from and stores to. `link` holds the graph against that.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::ir::{FileId, Reflection, ShaderStage};
use crate::source::{Diagnostic, SourceMap};

#[cfg(feature = "glslang")]
mod compile;
#[cfg(feature = "glslang")]
mod reflect;
#[cfg(feature = "glslang")]
pub use compile::{Glslang, Limits, Worker, serve_if_asked};
#[cfg(feature = "glslang")]
pub use reflect::reflect;

/// Names a shader and the constants to compile it with.
#[derive(Clone, Debug)]
pub struct ShaderRequest<'a> {
    /// The shader's own file, already in the source map.
    pub file: FileId,
    /// The stage of the shader.
    pub stage: ShaderStage,
    /// Every define that the graph offers, name and value. Only those whose name occurs as an identifier in the
    /// shader or its includes are used, and only these are in [`Compiled::defines`].
    pub defines: &'a [(String, String)],
    /// Names and values of constants of the graph that are numbers beyond 32 bits and so have no define. A shader that mentions
    /// one is in error.
    pub unfit: &'a [(String, String)],
    /// Files that exist only in memory, found by `#include` before anything else: name and text (`live.glsl`).
    pub generated: &'a [(String, String)],
}

/// Holds a compiled shader.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// SPIR-V words.
    pub spirv: Arc<Vec<u32>>,
    /// The defines that occur in the text, name and value.
    pub defines: Vec<(String, String)>,
    /// Identifiers that the compiled text depends on: those of the lines that its `#if`s let through, and of the conditions.
    ///
    /// The value of a define that is not among them changes nothing in the SPIR-V.
    pub reached: Arc<BTreeSet<String>>,
    /// Declarations and accesses.
    pub reflection: Reflection,
    /// Names of the blocks and images that the texts declare, in every branch of an `#if`. [`Reflection::bindings`] has those
    /// that the code uses.
    pub declared: Arc<BTreeSet<String>>,
}

/// Compiles shaders, and caches the results. `Glslang` (feature `glslang`) is the only implementation; tests of the rest
/// of the framework use reflections made by hand.
pub trait ShaderCompiler {
    /// Compiles a shader, or returns it if it was compiled before.
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>>;

    /// Lists the identifiers in the texts of a shader without compiling it, as far as they can be read.
    ///
    /// The default lists none.
    fn identifiers(&mut self, files: &mut SourceMap, request: &ShaderRequest) -> BTreeSet<String> {
        let _ = (files, request);
        BTreeSet::new()
    }

    /// Returns true if nobody waits for the build any more.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Keeps SPIR-V from one run of a program to the next.
///
/// What it returns is trusted: a store answers only with what it was given under the same key, by the same build of the program.
pub trait SpirvStore: Send + Sync + std::fmt::Debug {
    /// Returns the words that were stored under a key, if they are still there and whole.
    fn load(&self, key: &[u8]) -> Option<Vec<u32>>;

    /// Stores the words of a key. A store that cannot does nothing.
    fn store(&self, key: &[u8], spirv: &[u32]);
}

/// The message of a build that ended early because nobody waited for it.
pub const CANCELLED: &str = "the build was cancelled";

/// Asks whether a build should end early. The default never does.
#[derive(Clone, Default)]
pub struct Cancel(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl Cancel {
    /// Asks `wanted_no_more`, often and from any thread.
    pub fn new(wanted_no_more: impl Fn() -> bool + Send + Sync + 'static) -> Cancel {
        Cancel(Some(Arc::new(wanted_no_more)))
    }

    /// Returns true if the build should end.
    pub fn is_asked(&self) -> bool {
        self.0.as_ref().is_some_and(|asked| asked())
    }
}

impl std::fmt::Debug for Cancel {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("Cancel")
    }
}
