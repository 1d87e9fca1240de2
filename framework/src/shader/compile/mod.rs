//! Compiles GLSL to SPIR-V with glslang, Khronos' compiler, which is linked in.
//!
//! A shader is compiled in five steps:
//!
//! 1. *gather* ([`Sources`]): find and scan the shader and all its includes, direct or not. This shows which of the
//!    graph's defines they mention; a change of any other parameter does not recompile the shader;
//! 2. *look up*: texts, mentioned defines and stage together are the key of a cache of results;
//! 3. *follow* ([`reached`]): find the names that the result can depend on, and refuse undefined names in an `#if` and
//!    declarations of a define's name;
//! 4. *compile* ([`mod@generate`]), unless a [`SpirvStore`] has SPIR-V of an earlier run under the same key: glslang
//!    preprocesses (requesting only the included texts in active branches of `#if`s), parses, links and generates;
//! 5. *reflect*: see [`reflect`].
//!
//! glslang is C++, and some texts crash it. Its input is bounded: ASCII without NUL, [`sources::MAX_BYTES`] of text in
//! [`sources::MAX_FILES`] files, [`generate::MAX_INCLUDED_BYTES`] of expanded includes, and [`generate::MAX_DEPTH`]
//! nested ones. It gets a large stack, because its passes recurse. Its parser stops at the first error, because
//! continuing crashes it more often. For untrusted texts it runs in a separate process: see [`worker`].

mod generate;
mod log;
mod reached;
mod scan;
mod serve;
mod sources;
#[cfg(test)]
mod tests;
mod worker;

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use tracing::info_span;

use generate::{Failure, Key};
use scan::Scans;
pub use serve::serve_if_asked;
use sources::Sources;
pub use worker::{Limits, Worker};

use super::compiler::{CANCELLED, Cancel, Compiled, ShaderCompiler, ShaderRequest, SpirvStore};
use super::reflect;
use crate::ir::{ShaderStage, Span};
use crate::source::{Diagnostic, SourceMap};

/// Maximum number of cached shaders. A full cache is emptied.
const MAX_CACHED: usize = 1024;

/// The GLSL compiler: GLSL 4.60 to SPIR-V 1.6 for Vulkan 1.3, and a cache in memory.
///
/// `#include` needs `#extension GL_GOOGLE_include_directive : require`, as in any GLSL. A file may be included twice;
/// endless recursion is an error.
///
/// [`Glslang::new`] compiles in this process, which a broken shader can crash, so it is for trusted texts only.
#[derive(Debug, Default)]
pub struct Glslang {
    cache: HashMap<OwnKey, Result<Compiled, Failure>>,
    scans: Scans,
    store: Option<Arc<dyn SpirvStore>>,
    compiled: usize,
    worker: Option<worker::Parent>,
    cancel: Cancel,
}

impl Glslang {
    /// Returns a compiler with an empty cache that runs in this process.
    pub fn new() -> Self {
        Glslang::default()
    }

    /// Returns a compiler with an empty cache that runs in a separate process. This contains crashes, and limits memory
    /// and time. The process starts with the first compilation, and with the next after it ended; it ends at the latest
    /// when this value is dropped.
    pub fn in_worker(worker: Worker) -> Self {
        Glslang { worker: Some(worker::Parent::new(worker)), ..Glslang::default() }
    }

    /// Sets the cancellation: builds with this compiler, and compilations in a worker, end early when `cancel` requests
    /// it.
    pub fn set_cancel(&mut self, cancel: Cancel) {
        self.cancel = cancel;
    }

    /// Looks shaders up in `store` before compiling, and stores compiled ones.
    pub fn with_store(self, store: Arc<dyn SpirvStore>) -> Self {
        Glslang { store: Some(store), ..self }
    }

    /// Returns the number of compilations, failed ones included, without cache and store hits.
    pub fn compiled_count(&self) -> usize {
        self.compiled
    }
}

/// A [`Key`] within this process, which is faster to make and to hash: texts are numbers.
#[derive(Debug, PartialEq, Eq, Hash)]
struct OwnKey {
    stage: ShaderStage,
    defines: Vec<(String, String)>,
    /// [`scan::Scanned::id`] of each text.
    texts: Vec<u64>,
    /// For each text, the indices of the texts that it includes, in the order of their names. `None` for a missing
    /// file.
    includes: Vec<Vec<Option<usize>>>,
}

impl OwnKey {
    fn of(stage: ShaderStage, defines: &[(String, String)], sources: &Sources) -> OwnKey {
        let includes = |unit: &sources::Unit| {
            unit.includes.values().map(|include| include.target.as_ref().ok().copied()).collect()
        };
        OwnKey {
            stage,
            defines: defines.to_vec(),
            texts: sources.units.iter().map(|unit| unit.id).collect(),
            includes: sources.units.iter().map(includes).collect(),
        }
    }
}

impl ShaderCompiler for Glslang {
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let _span = info_span!("prepare a shader", shader = files.path(request.file)).entered();
        let sources =
            info_span!("read GLSL").in_scope(|| Sources::gather(files, request, &mut self.scans))?;
        let compiled = self.compile_sources(files, request, &sources);
        compiled.map_err(|errors| errors.into_iter().map(|error| sources.with_include(error)).collect())
    }

    fn identifiers(&mut self, files: &mut SourceMap, request: &ShaderRequest) -> BTreeSet<String> {
        let sources = Sources::gather(files, request, &mut self.scans);
        let names = sources.map(|sources| sources.identifiers().into_iter().map(str::to_owned).collect());
        names.unwrap_or_default()
    }

    fn is_cancelled(&self) -> bool {
        self.cancel.is_requested()
    }
}

impl Glslang {
    fn compile_sources(
        &mut self,
        files: &SourceMap,
        request: &ShaderRequest,
        sources: &Sources,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        if let Some(diagnostic) = sources.too_large(request) {
            return Err(vec![diagnostic]);
        }
        let defines = request.defines.iter().filter(|(name, _)| sources.mentions(name));
        let defines: Vec<(String, String)> = defines.cloned().collect();
        let own = OwnKey::of(request.stage, &defines, sources);
        match self.cache.get(&own) {
            Some(Ok(compiled)) => return Ok(compiled.clone()),
            Some(Err(failure)) => return Err(failure.diagnose(files, request, sources)),
            None => {}
        }
        let includes = sources.units.iter().map(|u| {
            u.includes
                .iter()
                .map(|(name, include)| (name.clone(), include.target.as_ref().ok().copied()))
                .collect()
        });
        let key = Key {
            stage: request.stage,
            defines,
            texts: sources.units.iter().map(|u| scan::to_ascii(&u.text)).collect(),
            includes: includes.collect(),
        };
        let followed = info_span!("follow the branches").in_scope(|| sources.follow(&key.defines));
        if let Some(place) = followed.as_ref().and_then(|followed| followed.redeclared.clone()) {
            return Err(vec![sources.redeclared(request, place)]);
        }
        if let Some(place) = followed.as_ref().and_then(|followed| followed.undefined.clone()) {
            return Err(vec![sources.undefined(files, request, place)]);
        }
        let spirv = match self.stored_or_generated(&key) {
            Ok(spirv) => spirv,
            Err(failure) => {
                let diagnostics = failure.diagnose(files, request, sources);
                // Reaching a limit takes seconds, so failures are cached too.
                if failure.is_lasting() {
                    self.remember(own, Err(failure));
                }
                return Err(diagnostics);
            }
        };
        let reflection = info_span!("reflect").in_scope(|| reflect(&spirv)).map_err(|problem| {
            let span = sources.find_quoted(&problem);
            vec![Diagnostic::new(problem, span, "")]
        })?;
        let all = || sources.identifiers().into_iter().map(str::to_owned).collect();
        let reached = Arc::new(followed.map_or_else(all, |followed| followed.names));
        let declared = Arc::new(sources.bindings());
        let compiled =
            Compiled { spirv: Arc::new(spirv), defines: key.defines, reached, reflection, declared };
        self.remember(own, Ok(compiled.clone()));
        Ok(compiled)
    }
}

impl Failure {
    /// Returns true if compiling the same texts again would fail again.
    fn is_lasting(&self) -> bool {
        matches!(self, Failure::Log(_) | Failure::Includes(_))
    }

    fn diagnose(&self, files: &SourceMap, request: &ShaderRequest, sources: &Sources) -> Vec<Diagnostic> {
        match self {
            Failure::Cancelled => {
                let span = Span::new(request.file, 0..0);
                vec![Diagnostic::new(CANCELLED, span, "")]
            }
            Failure::Log(log) | Failure::Crash(log) => log::diagnose(files, request, sources, log),
            Failure::Includes(failures) => {
                failures.iter().take(log::MAX_DIAGNOSTICS).map(|f| f.diagnose(files, sources)).collect()
            }
        }
    }
}

impl Glslang {
    fn remember(&mut self, key: OwnKey, outcome: Result<Compiled, Failure>) {
        if self.cache.len() >= MAX_CACHED {
            self.cache.clear();
        }
        self.cache.insert(key, outcome);
    }

    fn stored_or_generated(&mut self, key: &Key) -> Result<Vec<u32>, Failure> {
        let stored = self.store.clone().and_then(|store| Some((store, serde_json::to_vec(key).ok()?)));
        let found = info_span!("look up SPIR-V")
            .in_scope(|| stored.as_ref().and_then(|(store, bytes)| store.load(bytes)));
        if let Some(spirv) = found {
            return Ok(spirv);
        }
        self.compiled += 1;
        let spirv = info_span!("compile GLSL").in_scope(|| self.generate(key))?;
        if let Some((store, bytes)) = stored {
            store.store(&bytes, &spirv);
        }
        Ok(spirv)
    }

    fn generate(&mut self, key: &Key) -> Result<Vec<u32>, Failure> {
        match &mut self.worker {
            Some(worker) => worker.generate(key, &self.cancel),
            None => serve::on_large_stack(|| generate::generate(key))
                .unwrap_or_else(|| Err(Failure::Crash("ERROR: cannot start a thread to compile on".into()))),
        }
    }
}
