//! Finds and scans a shader and everything that it includes.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use super::reached::{self, Reached};
use super::scan::{self, Scan, Scanned, Scans, TokenKind};
use crate::ir::{FileId, Span};
use crate::shader::compiler::ShaderRequest;
use crate::source::{Diagnostic, Kind, NotFound, SourceMap, nearest};

/// Maximum bytes of GLSL in one shader with its includes.
pub(super) const MAX_BYTES: usize = 256 << 10;
pub(super) const MAX_FILES: usize = 256;

/// The name of the generated file with the live parameters.
const LIVE_GLSL: &str = "live.glsl";

pub(super) struct Sources {
    /// The files in the order of first mention, the shader itself first.
    pub units: Vec<Unit>,
}

/// A file of a shader.
pub(super) struct Unit {
    pub file: FileId,
    /// See [`Scanned::id`].
    pub id: u64,
    pub text: Arc<str>,
    pub scan: Arc<Scan>,
    /// Included files, by the name in the `#include`.
    pub includes: BTreeMap<String, Include>,
}

pub(super) struct Include {
    pub place: Range<usize>,
    /// Index of the included unit, or the error if the file is missing.
    pub target: Result<usize, NotFound>,
}

impl Sources {
    /// Finds and scans all texts. A missing file is not an error yet: an `#if` may disable its `#include`.
    ///
    /// Fails if the files exceed a limit, if one has a `#line`, or NUL or a non-ASCII character outside of comments, or
    /// if the shader is not declared GLSL 4.60.
    pub fn gather(
        files: &mut SourceMap,
        request: &ShaderRequest,
        scans: &mut Scans,
    ) -> Result<Sources, Vec<Diagnostic>> {
        let mut sources = Sources { units: Vec::new() };
        let mut found = vec![request.file];
        let mut bytes = 0;
        while let Some(&file) = found.get(sources.units.len()) {
            let text = files.text(file);
            bytes += text.len();
            let within = bytes <= MAX_BYTES && sources.units.len() < MAX_FILES;
            let error = |message: &str, place, label| Diagnostic::new(message, Span::new(file, place), label);
            let Some(Scanned { id, text, scan }) = within.then(|| scans.of(files.serial(file), text)) else {
                let message = format!(
                    "expected at most {MAX_FILES} files and {} KiB of text in a shader with its includes, found more",
                    MAX_BYTES >> 10
                );
                return Err(vec![error(&message, 0..0, "the limit is exceeded with this file")]);
            };
            if let Some(place) = scan.foreign.clone() {
                let message = "GLSL has only ASCII characters outside of comments";
                return Err(vec![error(message, place, "not allowed")]);
            }
            if let Some(place) = scan.line.clone() {
                let label = "would move errors to other lines";
                return Err(vec![error("`#line` is not supported", place, label)]);
            }
            if sources.units.is_empty() {
                let place = match &scan.version {
                    Some((_, true)) => None,
                    Some((place, false)) => Some(place.clone()),
                    None => Some(first_line(&text)),
                };
                if let Some(place) = place {
                    let is_empty = text.trim().is_empty();
                    let message = if is_empty {
                        "the file is empty"
                    } else {
                        "the shader is not declared to be GLSL 4.60"
                    };
                    let error = error(message, place, "");
                    return Err(vec![error.with_help("its first line should be `#version 460`")]);
                }
            }
            let mut includes = BTreeMap::new();
            for (name, place) in &scan.includes {
                if includes.contains_key(name) {
                    continue;
                }
                let target = match request.live_glsl.filter(|_| name == LIVE_GLSL) {
                    Some(file) => Ok(file),
                    None => files.find(Some(file), name, Kind::Shader).map_err(|mut not_found| {
                        let near = nearest(name, request.live_glsl.map(|_| LIVE_GLSL)).map(str::to_string);
                        not_found.nearest = near.or(not_found.nearest.take());
                        not_found
                    }),
                };
                let target = target.map(|file| {
                    found.iter().position(|known| *known == file).unwrap_or_else(|| {
                        found.push(file);
                        found.len() - 1
                    })
                });
                includes.insert(name.clone(), Include { place: place.clone(), target });
            }
            sources.units.push(Unit { file, id, text, scan, includes });
        }
        Ok(sources)
    }

    fn scans(&self) -> impl Iterator<Item = &Scan> {
        self.units.iter().map(|unit| &*unit.scan)
    }

    /// Returns true if a unit contains the identifier, in any branch.
    pub fn mentions(&self, name: &str) -> bool {
        self.scans().any(|scan| scan.identifiers.contains(name))
    }

    /// Lists every identifier of every unit, in any branch.
    pub fn identifiers(&self) -> BTreeSet<&str> {
        self.scans().flat_map(|scan| &scan.identifiers).map(String::as_str).collect()
    }

    /// Lists the identifiers, except those that only follow dots (fields and swizzles).
    pub fn names(&self) -> BTreeSet<&str> {
        self.units.iter().flat_map(|unit| scan::names(&unit.text)).collect()
    }

    /// Lists the macros that the units define.
    pub fn macros(&self) -> BTreeSet<&str> {
        self.scans().flat_map(|scan| &scan.macros).map(String::as_str).collect()
    }

    /// Lists the names of the blocks and images that the units declare, in any branch.
    pub fn bindings(&self) -> BTreeSet<String> {
        self.scans().flat_map(|scan| &scan.bindings).cloned().collect()
    }

    /// Finds the names that the shader reaches with `defines`; `None` if the branches cannot be followed.
    pub fn follow(&self, defines: &[(String, String)]) -> Option<Reached> {
        let texts: Vec<reached::Text> = self.units.iter().map(Unit::followed).collect();
        reached::reached(&texts, defines)
    }

    /// Returns the error for a constant of the graph that the shader also declares. The preprocessor would replace the
    /// name by the number, and cause a misleading compiler error.
    pub fn redeclared(&self, request: &ShaderRequest, (unit, place): (usize, Range<usize>)) -> Diagnostic {
        let name = &self.units[unit].text[place.clone()];
        let value = request.defines.iter().find(|(define, _)| define == name).map_or("", |(_, value)| value);
        let span = self.span(unit, place);
        Diagnostic::new(format!("`{name}` is a constant of the graph"), span, "declared again here")
            .with_help(format!("the graph defines it as {value}: use that, or another name here"))
    }

    /// Returns the error for an undefined name in an `#if`. The compiler would treat it as 0.
    pub fn undefined(
        &self,
        files: &SourceMap,
        request: &ShaderRequest,
        (unit, place): (usize, Range<usize>),
    ) -> Diagnostic {
        let name = &self.units[unit].text[place.clone()];
        let span = self.span(unit, place);
        let error =
            Diagnostic::new(format!("`{name}` is not defined"), span, "would count as 0 in this `#if`");
        if self.live_help(files, request, name).is_some() {
            return error.with_help(
                "a live parameter has no value when a shader is compiled: use `if`, or declare it `Const`",
            );
        }
        let defined = request.defines.iter().map(|(name, _)| name.as_str()).chain(self.macros());
        error.with_nearest(
            name,
            defined,
            format!(
                "`defined({name})` asks whether it is. A parameter of an include is defined here only if the include exposes it, and a `let` of an include never: declare that in this graph"
            ),
        )
    }

    /// Explains an undeclared name that refers to a live parameter, which only `live.glsl` declares; `None` for others.
    pub fn live_help(&self, files: &SourceMap, request: &ShaderRequest, name: &str) -> Option<String> {
        let (generated, members) = live_params(files, request)?;
        let member = members.into_iter().find(|member| {
            let option = name.strip_prefix(member.to_uppercase().as_str());
            *member == name || option.is_some_and(|rest| rest.is_empty() || rest.starts_with('_'))
        })?;
        let include = "`#include \"live.glsl\"` declares it";
        let is_included = self.units.iter().any(|unit| unit.file == generated);
        Some(match member == name {
            true => format!("`{name}` is a live parameter: {include}"),
            false if is_included => format!(
                "`{member}` is a live parameter, without constants: a live choice is the index of its value, from 0"
            ),
            false => format!("`{member}` is a live parameter, and a variable in shaders: {include}"),
        })
    }

    /// Returns the error for a mentioned constant that is too large, if any. Shaders have 32-bit numbers, and an `#if`
    /// has signed ones.
    pub fn too_large(&self, request: &ShaderRequest) -> Option<Diagnostic> {
        let unfit = request.unfit.iter().find(|(name, _)| self.mentions(name));
        let (name, value, limit) = match unfit {
            Some((name, value)) => (name, value.as_str(), "a number of 32 bits"),
            None => {
                let unsigned = |(name, value): &&(String, String)| {
                    value.ends_with('u') && self.scans().any(|scan| scan.conditions.contains(name))
                };
                let (name, value) = request.defines.iter().find(unsigned)?;
                (name, value.trim_end_matches('u'), "the `int` of an `#if`")
            }
        };
        let span = self.find_quoted(&format!("`{name}`"));
        let message = format!("`{name}` is {value} in the graph, which does not fit {limit}");
        Some(Diagnostic::new(message, span, "used here"))
    }

    /// Locates the first name that a message quotes (`` `so` ``) and a unit contains. Without one, returns the shader's
    /// first line.
    pub fn find_quoted(&self, message: &str) -> Span {
        for quoted in message.split('`').skip(1).step_by(2).filter(|quoted| !quoted.is_empty()) {
            for (index, unit) in self.units.iter().enumerate() {
                let tokens = scan::lex(&unit.text);
                if let Some(token) = tokens.iter().find(|t| t.of(&unit.text) == quoted) {
                    return self.span(index, token.range());
                }
            }
        }
        self.first_line()
    }

    /// Lists every `#include` that names a unit: the including unit, and the place of the name in it. For all units but
    /// the shader itself, the first is in an earlier unit.
    pub fn includes_of(&self, unit: usize) -> Vec<(usize, Range<usize>)> {
        let of = |(includer, other): (usize, &Unit)| {
            let targets = |name| other.includes.get(name).is_some_and(|include| include.target == Ok(unit));
            let all = other.scan.includes.iter().filter(|(name, _)| targets(name));
            all.map(|(_, place)| (includer, place.clone())).collect::<Vec<_>>()
        };
        self.units.iter().enumerate().flat_map(of).collect()
    }

    /// Adds to an error in an included file where the shader includes it. In other shaders, the file may be right.
    pub fn with_include(&self, error: Diagnostic) -> Diagnostic {
        let [shader, file] = [self.units[0].file, error.primary.span.file];
        let mut unit = self.units.iter().position(|unit| unit.file == file).unwrap_or(0);
        let mut place = None;
        while unit > 0 {
            let Some((includer, at)) = self.includes_of(unit).into_iter().next() else { return error };
            (unit, place) = (includer, Some(at));
        }
        match place.filter(|_| error.secondary.iter().all(|label| label.span.file != shader)) {
            Some(place) => error.with_label(Span::new(shader, place), "included here"),
            None => error,
        }
    }

    /// Adds both `#include`s to an error about a second declaration: the unit, or a unit around it, is included twice.
    pub fn with_second_include(&self, error: Diagnostic, mut unit: usize, files: &SourceMap) -> Diagnostic {
        while unit > 0 {
            let includes = self.includes_of(unit);
            if let [first, second, ..] = &includes[..] {
                let [first, second] = [first, second].map(|(unit, at)| self.span(*unit, at.clone()));
                let name = files.path(self.units[unit].file);
                return error
                    .with_label(first, "included here")
                    .with_label(second, "and again here")
                    .with_help(format!(
                        "`{name}` is included twice: remove one `#include`, or add an include guard (`#ifndef`, `#define`, `#endif`)"
                    ));
            }
            unit = includes.first().map_or(0, |(includer, _)| *includer);
        }
        error
    }

    /// Lists the declarations of `names` outside of the file `except`, outermost first.
    pub fn declarations<'n>(&self, names: &[&'n str], except: FileId) -> Vec<(&'n str, Span)> {
        let mut found = Vec::new();
        for unit in self.units.iter().filter(|unit| unit.file != except) {
            // A declaration has a type before the name, or the end of a block.
            let (mut depth, mut is_after_type) = (0, false);
            for token in scan::lex(&unit.text) {
                let text = token.of(&unit.text);
                if let Some(name) = names.iter().find(|name| is_after_type && **name == text) {
                    found.push((depth, (*name, Span::new(unit.file, token.range()))));
                }
                match text {
                    "{" | "(" => depth += 1,
                    "}" | ")" => depth -= 1,
                    _ => {}
                }
                let is_word = token.kind == TokenKind::Identifier && !["return", "else"].contains(&text);
                is_after_type = is_word || text == "}";
            }
        }
        found.sort_by_key(|(depth, _)| *depth);
        found.into_iter().map(|(_, found)| found).collect()
    }

    pub fn first_line(&self) -> Span {
        self.span(0, first_line(&self.units[0].text))
    }

    pub fn span(&self, unit: usize, place: Range<usize>) -> Span {
        Span::new(self.units[unit].file, place)
    }
}

/// Returns the generated `live.glsl`, and the names of its members; `None` if there is none.
pub(super) fn live_params<'f>(
    files: &'f SourceMap,
    request: &ShaderRequest,
) -> Option<(FileId, Vec<&'f str>)> {
    let file = request.live_glsl?;
    // Each member is an indented line that ends with its name, such as `    layout(offset = 0) float gain;`.
    let member = |line: &'f str| line.strip_prefix("    ")?.strip_suffix(';')?.rsplit(' ').next();
    Some((file, files.text(file).lines().filter_map(member).collect()))
}

fn first_line(text: &str) -> Range<usize> {
    0..text.find('\n').unwrap_or(text.len())
}

impl Unit {
    fn followed(&self) -> reached::Text<'_> {
        let found =
            self.includes.iter().filter_map(|(name, i)| Some((name.as_str(), *i.target.as_ref().ok()?)));
        reached::Text { text: &self.text, includes: found.collect() }
    }
}
