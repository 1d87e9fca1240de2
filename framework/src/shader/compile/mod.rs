//! Compiles GLSL to SPIR-V with glslang, Khronos' compiler, which is linked in.
//!
//! A shader is compiled in four steps:
//!
//! 1. *gather* ([`Sources`]): find and scan the shader and everything that it includes, directly or not. This shows
//!    which of the graph's defines they mention; a parameter that a shader does not mention does not cause
//!    another compilation;
//! 2. *look up*: texts, defines and stage together are the key of a cache;
//!    a [`SpirvStore`] holds the SPIR-V of earlier runs under the same key;
//! 3. *compile* ([`generate`]): glslang preprocesses (requesting only the included texts in active branches of `#if`s),
//!    parses, links and generates;
//! 4. *reflect*: see [`reflect`].
//!
//! glslang is C++, and some texts crash it. Its input is bounded: ASCII without zeros, [`MOST_BYTES`] of text, [`MOST_DEPTH`]
//! nested includes, a large stack (its passes recurse). It stops at the first error: if told to continue, it crashes on about one
//! broken shader in ten thousand, and otherwise on far fewer. For untrusted texts it runs in a separate
//! process: see [`worker`].

mod generate;
mod log;
mod reached;
mod scan;
mod serve;
#[cfg(test)]
mod tests;
mod worker;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::sync::Arc;

use generate::{Failure, IncludeFailure, IncludeProblem, Key};
use reached::Reached;
pub use serve::serve_if_asked;
pub use worker::{Limits, Worker};

use super::{CANCELLED, Cancel, Compiled, ShaderCompiler, ShaderRequest, SpirvStore, reflect};
use crate::ir::{FileId, Span};
use crate::source::{Diagnostic, Kind, NotFound, SourceMap, nearest};

/// Maximum bytes of GLSL in all files of one shader.
const MOST_BYTES: usize = 256 << 10;
/// Maximum bytes of GLSL after includes, where a file can occur more than once.
const MOST_INCLUDED_BYTES: usize = 4 << 20;
/// Bytes that each include counts in addition to its text, which bounds the number of small includes.
const INCLUDE_BYTES: usize = 256;
/// Maximum nesting of includes.
const MOST_DEPTH: usize = 32;
/// Maximum number of files of one shader.
const MOST_FILES: usize = 256;
/// Maximum number of cached shaders. Beyond it all are dropped: only sweeps over parameters make that many.
const MOST_CACHED: usize = 1024;
/// Maximum number of diagnostics of one compilation.
const MOST_DIAGNOSTICS: usize = 10;

/// The GLSL compiler: GLSL 4.60 to SPIR-V 1.6 for Vulkan 1.3, and a cache in memory.
///
/// `#include` needs `#extension GL_GOOGLE_include_directive : require`, as in any GLSL. A file may be included
/// twice; endless recursion is an error.
///
/// [`Glslang::new`] compiles in this process, which a broken shader can end, so it is for trusted texts. [`Glslang::in_worker`]
/// compiles in another process.
#[derive(Debug, Default)]
pub struct Glslang {
    cache: HashMap<Arc<Key>, Compiled>,
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

    /// Returns a compiler with an empty cache that runs in a separate process, which contains crashes and limits memory and
    /// time. The process starts with the first compilation and ends when this value is dropped.
    pub fn in_worker(worker: Worker) -> Self {
        Glslang { worker: Some(worker::Parent::new(worker)), ..Glslang::default() }
    }

    /// Makes compilations, and builds that use this compiler, end early when `cancel` asks for it.
    pub fn set_cancel(&mut self, cancel: Cancel) {
        self.cancel = cancel;
    }

    /// Looks shaders up in `store` before compiling, and stores compiled ones.
    pub fn with_store(self, store: Arc<dyn SpirvStore>) -> Self {
        Glslang { store: Some(store), ..self }
    }

    /// Returns the number of compilations that neither cache nor store avoided.
    pub fn compiled_count(&self) -> usize {
        self.compiled
    }
}

impl ShaderCompiler for Glslang {
    /// Fails with at least one diagnostic, each at its place in the shader or an included file.
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let sources = Sources::gather(files, request)?;
        if let Some(diagnostic) =
            sources.taken_name(files, request).or_else(|| sources.too_large(files, request))
        {
            return Err(vec![diagnostic]);
        }
        let defines = request.defines.iter().filter(|(name, _)| sources.identifiers.contains(name));
        let defines: Vec<(String, String)> = defines.cloned().collect();
        let includes = sources.units.iter().map(|u| {
            u.includes
                .iter()
                .map(|(name, include)| (name.clone(), include.target.as_ref().ok().copied()))
                .collect()
        });
        let key = Arc::new(Key {
            stage: request.stage,
            defines,
            texts: sources.units.iter().map(|u| scan::to_ascii(&u.text)).collect(),
            includes: includes.collect(),
        });
        if let Some(compiled) = self.cache.get(&key) {
            return Ok(compiled.clone());
        }
        let followed = sources.follow(&key.defines);
        if let Some((unit, place)) = followed.as_ref().and_then(|followed| followed.undefined.clone()) {
            return Err(vec![sources.undefined(files, request, unit, place)]);
        }
        let spirv = self.stored_or_generated(&key).map_err(|failure| match failure {
            Failure::Cancelled => {
                let span = Span { file: request.file, start: 0, end: 0 };
                vec![Diagnostic::new(CANCELLED, span, "")]
            }
            Failure::Log(log) => log::diagnose(files, request, &sources, &log),
            Failure::Includes(failures) => {
                failures.iter().take(MOST_DIAGNOSTICS).map(|f| f.diagnose(files, request, &sources)).collect()
            }
        })?;
        let reflection = reflect(&spirv).map_err(|problem| {
            let span = log::find_quoted(files, request, &sources, &problem);
            vec![Diagnostic::new(problem, span, "")]
        })?;
        let reached = Arc::new(followed.map_or(sources.identifiers, |followed| followed.names));
        let declared = Arc::new(sources.bindings);
        let defines = key.defines.clone();
        let compiled = Compiled { spirv: Arc::new(spirv), defines, reached, reflection, declared };
        if self.cache.len() >= MOST_CACHED {
            self.cache.clear();
        }
        self.cache.insert(key, compiled.clone());
        Ok(compiled)
    }

    fn identifiers(&mut self, files: &mut SourceMap, request: &ShaderRequest) -> BTreeSet<String> {
        Sources::gather(files, request).map(|sources| sources.identifiers).unwrap_or_default()
    }

    fn is_cancelled(&self) -> bool {
        self.cancel.is_asked()
    }
}

impl Glslang {
    fn stored_or_generated(&mut self, key: &Key) -> Result<Vec<u32>, Failure> {
        // A key that cannot be serialised is not stored.
        let stored = self.store.clone().and_then(|store| Some((store, serde_json::to_vec(key).ok()?)));
        if let Some(spirv) = stored.as_ref().and_then(|(store, bytes)| store.load(bytes)) {
            return Ok(spirv);
        }
        self.compiled += 1;
        let spirv = self.generate(key)?;
        if let Some((store, bytes)) = stored {
            store.store(&bytes, &spirv);
        }
        Ok(spirv)
    }

    fn generate(&mut self, key: &Key) -> Result<Vec<u32>, Failure> {
        match &mut self.worker {
            Some(worker) => worker.generate(key, &self.cancel),
            None => serve::on_large_stack(|| generate::generate(key))
                .unwrap_or_else(|| Err(Failure::Log("ERROR: cannot start a thread to compile on".into()))),
        }
    }
}

/// Holds a shader and all files that it includes, scanned.
struct Sources {
    /// The shader itself comes first.
    units: Vec<Unit>,
    /// Every identifier of every unit.
    identifiers: BTreeSet<String>,
    /// The names that the units `#define`.
    macros: BTreeSet<String>,
    /// The names in their `#if`s.
    conditions: BTreeSet<String>,
    /// The names of the blocks and images that the units declare.
    bindings: BTreeSet<String>,
}

/// One file.
struct Unit {
    origin: UnitOrigin,
    text: String,
    /// Included files, by the name in the `#include`.
    includes: BTreeMap<String, Include>,
    /// Names that follow the name of a type, as in declarations.
    declared: Vec<(String, Range<usize>)>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum UnitOrigin {
    File(FileId),
    /// Index in [`ShaderRequest::generated`].
    Generated(usize),
}

struct Include {
    /// Place of the name in the including file.
    place: Range<usize>,
    /// The unit that it names.
    target: Result<usize, NotFound>,
}

impl Sources {
    /// Finds and scans everything. A file that cannot be found is no error yet: an `#if` may hide its `#include`.
    fn gather(files: &mut SourceMap, request: &ShaderRequest) -> Result<Sources, Vec<Diagnostic>> {
        let mut sources = Sources {
            units: Vec::new(),
            identifiers: BTreeSet::new(),
            macros: BTreeSet::new(),
            conditions: BTreeSet::new(),
            bindings: BTreeSet::new(),
        };
        let mut origins = vec![UnitOrigin::File(request.file)];
        let mut bytes = 0;
        while let Some(&origin) = origins.get(sources.units.len()) {
            let text = match origin {
                UnitOrigin::File(file) => files.text(file).to_string(),
                UnitOrigin::Generated(index) => request.generated[index].1.clone(),
            };
            let span_of = |place: Range<usize>, files: &mut SourceMap| {
                let file = origin.file(files, request);
                Span { file, start: place.start, end: place.end }
            };
            bytes += text.len();
            if bytes > MOST_BYTES || sources.units.len() >= MOST_FILES {
                let span = span_of(0..0, files);
                let message = format!(
                    "a shader and its includes can have {MOST_FILES} files and {} KiB of text, and this is more",
                    MOST_BYTES >> 10
                );
                return Err(vec![Diagnostic::new(message, span, "the limit is passed with this file")]);
            }
            let scan = scan::scan(&text);
            if let Some(place) = scan.foreign {
                let span = span_of(place, files);
                return Err(vec![Diagnostic::new(
                    "GLSL has only ASCII characters outside of comments",
                    span,
                    "not allowed",
                )]);
            }
            if sources.units.is_empty() {
                let place = match &scan.version {
                    Some((_, true)) => None,
                    Some((place, false)) => Some(place.clone()),
                    None => Some(log::first_line(&text)),
                };
                if let Some(place) = place {
                    let span = span_of(place, files);
                    let diagnostic = Diagnostic::new("the shader is not declared to be GLSL 4.60", span, "");
                    return Err(vec![diagnostic.with_help("its first line should be `#version 460`")]);
                }
            }
            sources.identifiers.extend(scan.identifiers.iter().map(|name| name.to_string()));
            sources.macros.extend(scan.macros.iter().map(|name| name.to_string()));
            sources.conditions.extend(scan.conditions.iter().map(|name| name.to_string()));
            sources.bindings.extend(scan.bindings.iter().map(|name| name.to_string()));
            let mut includes = BTreeMap::new();
            for (name, place) in scan.includes {
                if includes.contains_key(name) {
                    continue;
                }
                let found = match request.generated.iter().position(|g| g.0 == name) {
                    Some(index) => Ok(UnitOrigin::Generated(index)),
                    None => {
                        // Includes of a generated text are resolved as if they were the shader's own.
                        let from = if let UnitOrigin::File(file) = origin { file } else { request.file };
                        let found = files.find(Some(from), name, Kind::Shader).map(UnitOrigin::File);
                        found.map_err(|mut not_found| {
                            let generated = request.generated.iter().map(|g| g.0.as_str());
                            let near = nearest(name, generated).map(str::to_string);
                            not_found.nearest = near.or(not_found.nearest.take());
                            not_found
                        })
                    }
                };
                let target = found.map(|origin| {
                    origins.iter().position(|known| *known == origin).unwrap_or_else(|| {
                        origins.push(origin);
                        origins.len() - 1
                    })
                });
                includes.insert(name.to_string(), Include { place, target });
            }
            let declared = scan.declared.into_iter().map(|(name, place)| (name.to_string(), place)).collect();
            sources.units.push(Unit { origin, text, includes, declared });
        }
        Ok(sources)
    }

    /// Reports a constant of the graph that the shader declares as well. The preprocessor would replace the name by the
    /// number, and the compiler would report something else.
    fn taken_name(&self, files: &mut SourceMap, request: &ShaderRequest) -> Option<Diagnostic> {
        for unit in &self.units {
            for (name, place) in &unit.declared {
                let Some((_, value)) = request.defines.iter().find(|(define, _)| define == name) else {
                    continue;
                };
                let span =
                    Span { file: unit.origin.file(files, request), start: place.start, end: place.end };
                let graph = name.to_lowercase();
                return Some(
                    Diagnostic::new(
                        format!("`{name}` is a constant of the graph"),
                        span,
                        "declared again here",
                    )
                    .with_help(format!(
                        "the graph gives it as a define, {value}: use that, or rename `{graph}` in the graph"
                    )),
                );
            }
        }
        None
    }
}

impl Sources {
    /// Follows the preprocessor; `None` where the texts cannot be followed.
    fn follow(&self, defines: &[(String, String)]) -> Option<Reached> {
        let texts: Vec<reached::Text> = self.units.iter().map(Unit::followed).collect();
        reached::reached(&texts, defines)
    }

    /// Makes the error for an undefined name in an `#if`. The compiler would take it for 0.
    fn undefined(
        &self,
        files: &mut SourceMap,
        request: &ShaderRequest,
        unit: usize,
        place: Range<usize>,
    ) -> Diagnostic {
        let Unit { origin, text, .. } = &self.units[unit];
        let name = &text[place.clone()];
        let span = Span { file: origin.file(files, request), start: place.start, end: place.end };
        let error =
            Diagnostic::new(format!("`{name}` is not defined"), span, "would count as 0 in this `#if`");
        let defined = request.defines.iter().map(|(name, _)| name).chain(&self.macros).map(String::as_str);
        error.with_nearest(name, defined, format!("`defined({name})` asks whether it is"))
    }

    /// Reports a constant that the shader mentions and that does not fit: shaders have numbers of 32 bits, and `#if`
    /// signed numbers of 32 bits.
    fn too_large(&self, files: &mut SourceMap, request: &ShaderRequest) -> Option<Diagnostic> {
        let unfit = request.unfit.iter().find(|(name, _)| self.identifiers.contains(name));
        let (name, value, limit) = match unfit {
            Some((name, value)) => (name, value.as_str(), "a number of 32 bits"),
            None => {
                let unsigned = |(name, value): &&(String, String)| {
                    value.ends_with('u') && self.conditions.contains(name)
                };
                let (name, value) = request.defines.iter().find(unsigned)?;
                (name, value.trim_end_matches('u'), "the `int` of an `#if`")
            }
        };
        let span = log::find_quoted(files, request, self, &format!("`{name}`"));
        let message = format!("`{name}` is {value} in the graph, which does not fit {limit}");
        Some(Diagnostic::new(message, span, "used here"))
    }
}

impl Unit {
    /// Returns the text and the includes that were found.
    fn followed(&self) -> reached::Text<'_> {
        let found =
            self.includes.iter().filter_map(|(name, i)| Some((name.as_str(), *i.target.as_ref().ok()?)));
        reached::Text { text: &self.text, includes: found.collect() }
    }
}

impl UnitOrigin {
    /// Returns the file to show a diagnostic in. A generated text becomes a file when first needed.
    fn file(self, files: &mut SourceMap, request: &ShaderRequest) -> FileId {
        match self {
            UnitOrigin::File(file) => file,
            UnitOrigin::Generated(index) => {
                let (name, text) = &request.generated[index];
                let path = format!("{name} (generated)");
                let known =
                    files.opened().find(|(file, known, _)| *known == path && files.text(*file) == text);
                match known.map(|(file, ..)| file) {
                    Some(file) => file,
                    None => files.add(path, text),
                }
            }
        }
    }
}

impl IncludeFailure {
    fn diagnose(&self, files: &mut SourceMap, request: &ShaderRequest, sources: &Sources) -> Diagnostic {
        let unit = &sources.units[self.unit];
        let file = unit.origin.file(files, request);
        let include = unit.includes.get(&self.name);
        let place = include.map_or(0..0, |include| include.place.clone());
        let span = Span { file, start: place.start, end: place.end };
        match &self.why {
            IncludeProblem::Missing => match include.map(|i| &i.target) {
                Some(Err(not_found)) => not_found.at(span),
                _ => Diagnostic::new(format!("the include of `{}` is not understood", self.name), span, ""),
            },
            IncludeProblem::TooDeep(chain) => {
                let target = include.and_then(|i| i.target.as_ref().ok());
                let since = chain.iter().rposition(|unit| Some(unit) == target);
                let Some(since) = since else {
                    let message = format!("includes are nested deeper than {MOST_DEPTH}");
                    return Diagnostic::new(message, span, "the limit is passed here");
                };
                let mut names: Vec<String> = Vec::new();
                for unit in chain[since..].iter().chain(target) {
                    let file = sources.units[*unit].origin.file(files, request);
                    names.push(format!("`{}`", files.path(file)));
                }
                let message = format!("{} includes itself", names[0]);
                Diagnostic::new(message, span, "included again here")
                    .with_help(format!("it goes round: {}", names.join(" includes ")))
                    .with_help("an include guard (`#ifndef`, `#define`, `#endif`) ends it")
            }
            IncludeProblem::TooMuch => {
                let message =
                    format!("the included files together are more than {} MiB", MOST_INCLUDED_BYTES >> 20);
                Diagnostic::new(message, span, "the limit is passed here")
            }
        }
    }
}
