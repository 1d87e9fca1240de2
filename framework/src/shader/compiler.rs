//! Defines the shader compiler's interface for linking: requests, results and cancellation.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::ir::{FileId, Reflection, ShaderStage};
use crate::source::{Diagnostic, SourceMap};

/// A request to compile a shader with a graph's constants.
#[derive(Clone, Debug)]
pub struct ShaderRequest<'a> {
    /// The shader's file in the source map.
    pub file: FileId,
    /// The stage of the shader.
    pub stage: ShaderStage,
    /// Names and values of the graph's defines. The compiler uses only those that the shader or its includes mention.
    pub defines: &'a [(String, String)],
    /// Names and values of constants beyond 32 bits, which have no define. A shader that mentions one is an error.
    pub unfit: &'a [(String, String)],
    /// The generated file that `#include "live.glsl"` finds, before all others.
    pub live_glsl: Option<FileId>,
}

/// A compiled shader.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// SPIR-V code, in 32-bit words.
    pub spirv: Arc<Vec<u32>>,
    /// Names and values of the defines that the shader or its includes mention.
    pub defines: Vec<(String, String)>,
    /// Identifiers that the compiled text depends on: those in active branches of `#if`s, and in conditions. All
    /// identifiers, if the branches cannot be followed.
    pub reached: Arc<BTreeSet<String>>,
    /// Bindings, accesses, stage inputs and outputs, read from the SPIR-V.
    pub reflection: Reflection,
    /// Names of all blocks and images that the texts declare, in any branch of an `#if`. [`Reflection::bindings`] has
    /// only the used ones.
    pub declared: Arc<BTreeSet<String>>,
}

/// A compiler of shaders, with a cache of the results.
///
/// `reflect` (feature `reflect`) reads the reflection of [`Compiled`] from SPIR-V.
pub trait ShaderCompiler {
    /// Returns a compiled shader, from the cache if possible. Fails with at least one diagnostic.
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>>;

    /// Lists the identifiers in a shader and its includes without compiling it. Missing includes are skipped; after
    /// any other error, the list is empty. The default lists none.
    fn identifiers(&mut self, files: &mut SourceMap, request: &ShaderRequest) -> BTreeSet<String> {
        let _ = (files, request);
        BTreeSet::new()
    }

    /// Returns true if the build was cancelled.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// A store that keeps SPIR-V between runs of a program. It is trusted: it must return only words that the same build of
/// the program stored under the same key.
pub trait SpirvStore: Send + Sync + std::fmt::Debug {
    /// Returns the words stored under a key, if they are present and undamaged.
    fn load(&self, key: &[u8]) -> Option<Vec<u32>>;

    /// Stores words under a key. Does nothing on failure.
    fn store(&self, key: &[u8], spirv: &[u32]);
}

/// The message of a cancelled build.
pub const CANCELLED: &str = "the build was cancelled";

/// A condition for cancelling a build. The default never cancels.
#[derive(Clone, Default)]
pub struct Cancel(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl Cancel {
    /// Creates a cancellation from a function that returns true once the build should end. It is called often, from
    /// any thread.
    pub fn new(wanted_no_more: impl Fn() -> bool + Send + Sync + 'static) -> Cancel {
        Cancel(Some(Arc::new(wanted_no_more)))
    }

    /// Returns true if the build should end.
    pub fn is_requested(&self) -> bool {
        self.0.as_ref().is_some_and(|asked| asked())
    }
}

impl std::fmt::Debug for Cancel {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("Cancel")
    }
}
