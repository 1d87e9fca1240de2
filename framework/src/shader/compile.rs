//! GLSL to SPIR-V with glslang, Khronos' own compiler, linked in.
//!
//! A shader is compiled in four steps:
//!
//! 1. *gather* ([`Sources`]): the shader and everything that it includes, directly or not, are found and scanned. That
//!    tells which of the graph's defines they mention at all; a parameter that a shader does not mention does not make
//!    it compile again;
//! 2. *look up*: texts, defines and stage together are the key of a cache;
//! 3. *compile*: glslang preprocesses (asking for the included texts again, this time only for those that its `#if`s let
//!    through), parses, links and generates, on a thread of its own;
//! 4. *reflect*: see [`reflect`].
//!
//! glslang is C++, and some texts crash it. Its input is bounded: ASCII without zeros, [`MOST_BYTES`]
//! of text, [`MOST_DEPTH`] nested includes, a large stack ([`STACK_BYTES`]: its passes recurse). It is left at its default
//! to stop at the first error: set to go on, it crashes on one broken shader in some ten thousand, otherwise on far
//! fewer. Those crashes are caught: see [`guard`].

mod guard;
mod log;
mod scan;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::sync::Arc;

use glslang::error::GlslangError;
use glslang::include::{IncludeHandler, IncludeResult, IncludeType};
use glslang::{
    Compiler, CompilerOptions, GlslProfile, Shader, ShaderInput, ShaderMessage, ShaderSource, SourceLanguage,
    SpirvVersion, Target, VulkanVersion,
};

use guard::Lost;

use super::{Compiled, ShaderCompiler, ShaderRequest, ShaderStage, reflect};
use crate::ir::{FileId, Span};
use crate::source::{Diagnostic, Kind, NotFound, SourceMap, nearest};

/// Bytes of GLSL in all files of one shader.
const MOST_BYTES: usize = 256 << 10;
/// Bytes of GLSL after includes, which can bring the same file more than once.
const MOST_INCLUDED_BYTES: usize = 4 << 20;
/// Counts for each include beside its text, so that the number of small ones is bounded too.
const INCLUDE_BYTES: usize = 256;
/// Files inside of files inside of files.
const MOST_DEPTH: usize = 32;
/// Files that one shader can include.
const MOST_FILES: usize = 256;
/// Stack of the compiler's thread. glslang recurses once per operand of a sum: this holds for [`MOST_BYTES`] of it. Only
/// what is used takes memory.
const STACK_BYTES: usize = 256 << 20;
/// Limits the cached shaders. Beyond, all are dropped: that many come only from sweeps over parameters.
const MOST_CACHED: usize = 1024;
/// Diagnostics that one compilation gives.
const MOST_DIAGNOSTICS: usize = 10;

/// The GLSL compiler: GLSL 4.60 to SPIR-V 1.6 for Vulkan 1.3, and a cache in memory.
///
/// `#include` needs `#extension GL_GOOGLE_include_directive : require`, as in any GLSL, and is allowed to bring a file
/// twice; a file that brings itself without end is an error.
#[derive(Debug, Default)]
pub struct Glslang {
    cache: HashMap<Arc<Key>, Compiled>,
    compiled: usize,
}

/// Identifies a compilation by all its inputs.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Key {
    stage: ShaderStage,
    defines: Vec<(String, String)>,
    /// In the order in which they were first named, the shader itself first; as the compiler gets them.
    texts: Vec<String>,
    /// Per text, the names that it includes and which texts these are.
    includes: Vec<BTreeMap<String, Option<usize>>>,
}

impl Glslang {
    /// Returns a compiler with an empty cache.
    pub fn new() -> Self {
        Glslang::default()
    }

    /// Returns the number of compilations that were run: those that the cache did not hold.
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
        if let Some(diagnostic) = sources.taken_name(files, request) {
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
        self.compiled += 1;
        let spirv = generate(key.clone()).map_err(|failure| match failure {
            Failure::Log(log) => log::diagnose(files, request, &sources, &log),
            Failure::Includes(failures) => {
                failures.iter().take(MOST_DIAGNOSTICS).map(|f| f.diagnose(files, request, &sources)).collect()
            }
        })?;
        let reflection = reflect(&spirv).map_err(|problem| {
            let span = log::find_quoted(files, request, &sources, &problem);
            vec![Diagnostic::new(problem, span, "")]
        })?;
        let declared = Arc::new(sources.bindings);
        let compiled =
            Compiled { spirv: Arc::new(spirv), defines: key.defines.clone(), reflection, declared };
        if self.cache.len() >= MOST_CACHED {
            self.cache.clear();
        }
        self.cache.insert(key, compiled.clone());
        Ok(compiled)
    }
}

/// Holds a shader and all files that it includes, scanned.
struct Sources {
    /// The shader itself is the first.
    units: Vec<Unit>,
    /// Every identifier of every unit.
    identifiers: BTreeSet<String>,
    /// The names that the units `#define`.
    macros: BTreeSet<String>,
    /// The names of the blocks and images that the units declare.
    bindings: BTreeSet<String>,
}

/// One file.
struct Unit {
    origin: UnitOrigin,
    text: String,
    /// Included files, by the name in the `#include`.
    includes: BTreeMap<String, Include>,
    /// Names that follow the name of a type, as those of declarations do.
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
            sources.bindings.extend(scan.bindings.iter().map(|name| name.to_string()));
            let mut includes = BTreeMap::new();
            for (name, place) in scan.includes {
                if includes.contains_key(name) {
                    continue;
                }
                let found = match request.generated.iter().position(|g| g.0 == name) {
                    Some(index) => Ok(UnitOrigin::Generated(index)),
                    None => {
                        // What a generated text includes is found as if the shader itself had.
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

    /// A constant of the graph that the shader declares as well. The preprocessor would put the number in the place of the
    /// name, and the compiler would complain of something else.
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

impl UnitOrigin {
    /// The file to show a diagnostic in. A generated text becomes one when it is first needed.
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

/// Explains why there is no SPIR-V.
enum Failure {
    /// The log of glslang.
    Log(String),
    /// Includes that cannot be followed.
    Includes(Vec<IncludeFailure>),
}

/// An include that cannot be followed.
#[derive(Clone, PartialEq)]
struct IncludeFailure {
    /// The unit that includes.
    unit: usize,
    /// The name that it gives.
    name: String,
    why: IncludeProblem,
}

#[derive(Clone, PartialEq)]
enum IncludeProblem {
    Missing,
    /// The units that were being included when the depth ran out, from the shader itself to the last.
    TooDeep(Vec<usize>),
    TooMuch,
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

/// Gives glslang the included texts. Units are named by their number, so that the log is easy to read back.
struct Includes<'a> {
    key: &'a Key,
    /// The units that are being included now, the shader itself first.
    chain: Vec<usize>,
    bytes: usize,
    failures: Vec<IncludeFailure>,
}

impl IncludeHandler for Includes<'_> {
    fn include(&mut self, _: IncludeType, name: &str, includer: &str, depth: usize) -> Option<IncludeResult> {
        // glslang calls the shader itself "".
        let unit = if includer.is_empty() { 0 } else { includer.parse().ok()? };
        self.chain.truncate(depth);
        let failure = |why| IncludeFailure { unit, name: name.to_string(), why };
        let target = self.key.includes.get(unit).and_then(|names| names.get(name)).copied().flatten();
        let why = match target {
            None => Some(IncludeProblem::Missing),
            Some(_) if depth > MOST_DEPTH => Some(IncludeProblem::TooDeep(self.chain.clone())),
            Some(target) => {
                self.bytes += self.key.texts[target].len() + INCLUDE_BYTES;
                (self.bytes > MOST_INCLUDED_BYTES).then_some(IncludeProblem::TooMuch)
            }
        };
        if let Some(why) = why {
            // A name in quotes that is refused is asked for again as if it stood in angle brackets.
            let failure = failure(why);
            if !self.failures.contains(&failure) {
                self.failures.push(failure);
            }
            return None;
        }
        let target = target?;
        self.chain.push(target);
        Some(IncludeResult { name: target.to_string(), data: self.key.texts[target].clone() })
    }
}

/// Runs glslang, guarded, on a thread with a large stack.
fn generate(key: Arc<Key>) -> Result<Vec<u32>, Failure> {
    guard::run(STACK_BYTES, move || generate_here(&key)).unwrap_or_else(|lost| {
        let why = match lost {
            Lost::NotStarted => "cannot start a thread to compile on",
            Lost::Panicked | Lost::Crashed => {
                "the compiler crashed on this shader (a name that is declared twice does that)"
            }
            Lost::TookTooLong => {
                "the compiler does not come to an end with this shader (macros that grow do that)"
            }
        };
        Err(Failure::Log(format!("ERROR: {why}")))
    })
}

fn generate_here(key: &Key) -> Result<Vec<u32>, Failure> {
    let failed = |error: GlslangError| match error {
        GlslangError::PreprocessError(log)
        | GlslangError::ParseError(log)
        | GlslangError::MapIoError(log)
        | GlslangError::LinkError(log) => Failure::Log(log.log),
        other => Failure::Log(format!("ERROR: {other}")),
    };
    let compiler = Compiler::acquire().ok_or_else(|| Failure::Log("ERROR: glslang does not start".into()))?;
    let stage = match key.stage {
        ShaderStage::Vertex => glslang::ShaderStage::Vertex,
        ShaderStage::Fragment => glslang::ShaderStage::Fragment,
        ShaderStage::Compute => glslang::ShaderStage::Compute,
    };
    let options = CompilerOptions {
        source_language: SourceLanguage::GLSL,
        target: Target::Vulkan { version: VulkanVersion::Vulkan1_3, spirv_version: SpirvVersion::SPIRV1_6 },
        version_profile: Some((460, GlslProfile::None)),
        messages: ShaderMessage::SPV_RULES
            | ShaderMessage::VULKAN_RULES
            | ShaderMessage::SUPPRESS_WARNINGS
            | ShaderMessage::DISPLAY_ERROR_COLUMN,
    };
    let source = ShaderSource::from(key.texts[0].as_str());
    let mut includes = Includes { key, chain: vec![0], bytes: 0, failures: Vec::new() };
    let input =
        ShaderInput::new(&source, stage, &options, None::<&[(&str, Option<&str>)]>, Some(&mut includes))
            .map_err(failed)?;
    let mut builder = Shader::new(compiler, input);
    // The preamble is a text of its own before the shader, so lines keep their numbers.
    let preamble: String =
        key.defines.iter().map(|(name, value)| format!("#define {name} {value}\n")).collect();
    builder.preamble(&preamble);
    let spirv = builder.parse().and_then(|shader| shader.compile());
    if !includes.failures.is_empty() {
        return Err(Failure::Includes(includes.failures));
    }
    spirv.map_err(failed)
}
