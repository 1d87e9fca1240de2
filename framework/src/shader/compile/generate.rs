//! Runs glslang: compiles a shader's texts to SPIR-V.

use std::collections::BTreeMap;

use glslang::error::GlslangError;
use glslang::include::{IncludeHandler, IncludeResult, IncludeType};
use glslang::{
    Compiler, CompilerOptions, GlslProfile, Shader, ShaderInput, ShaderMessage, ShaderSource, SourceLanguage,
    SpirvVersion, Target, VulkanVersion,
};
use serde::{Deserialize, Serialize};

use crate::ir::ShaderStage;

/// Maximum bytes of included GLSL. A file counts as often as it is included.
pub(super) const MAX_INCLUDED_BYTES: usize = 4 << 20;
/// Bytes that each include adds to the count in addition to its text. This bounds the number of small includes.
pub(super) const INCLUDE_BYTES: usize = 256;
/// Maximum nesting of includes.
pub(super) const MAX_DEPTH: usize = 32;
const MAX_SPIRV_BYTES: usize = 8 << 20;

/// All inputs of a compilation, which identify it.
#[derive(Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Key {
    pub stage: ShaderStage,
    pub defines: Vec<(String, String)>,
    /// Texts in the order of first mention, the shader itself first, as passed to the compiler.
    pub texts: Vec<String>,
    /// For each text, the names that it includes, with the indices of their texts; `None` for a missing file.
    pub includes: Vec<BTreeMap<String, Option<usize>>>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Failure {
    /// The log of glslang, or the limit that it exceeded.
    Log(String),
    /// The compiler could not be started, crashed or gave no answer. A second attempt may succeed.
    Crash(String),
    Includes(Vec<IncludeFailure>),
    Cancelled,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct IncludeFailure {
    pub unit: usize,
    pub name: String,
    pub why: IncludeProblem,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum IncludeProblem {
    Missing,
    /// The chain of units that leads back to the shader or exceeds the maximum depth, the shader itself first.
    TooDeep(Vec<usize>),
    TooMuch,
}

/// The included texts, for glslang. Units are named by number, which makes the log easy to parse.
struct Includes<'a> {
    key: &'a Key,
    /// The stack of included units, the shader itself first.
    chain: Vec<usize>,
    bytes: usize,
    failures: Vec<IncludeFailure>,
}

impl IncludeHandler for Includes<'_> {
    fn include(&mut self, _: IncludeType, name: &str, includer: &str, depth: usize) -> Option<IncludeResult> {
        // glslang names the shader itself "".
        let unit = if includer.is_empty() { 0 } else { includer.parse().ok()? };
        self.chain.truncate(depth);
        let failure = |why| IncludeFailure { unit, name: name.to_string(), why };
        let target = self.key.includes.get(unit).and_then(|names| names.get(name)).copied().flatten();
        let why = match target {
            None => Some(IncludeProblem::Missing),
            // The shader begins with `#version`, so no guard can end this cycle.
            Some(0) => Some(IncludeProblem::TooDeep(self.chain.clone())),
            Some(_) if depth > MAX_DEPTH => Some(IncludeProblem::TooDeep(self.chain.clone())),
            Some(target) => {
                self.bytes += self.key.texts[target].len() + INCLUDE_BYTES;
                (self.bytes > MAX_INCLUDED_BYTES).then_some(IncludeProblem::TooMuch)
            }
        };
        if let Some(why) = why {
            // After a refusal, glslang asks again for a quoted name, as if it were in angle brackets.
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

pub(super) fn generate(key: &Key) -> Result<Vec<u32>, Failure> {
    let failed = |error: GlslangError| match error {
        GlslangError::PreprocessError(log)
        | GlslangError::ParseError(log)
        | GlslangError::MapIoError(log)
        | GlslangError::LinkError(log) => Failure::Log(log.log),
        other => Failure::Log(format!("ERROR: {other}")),
    };
    let compiler =
        Compiler::acquire().ok_or_else(|| Failure::Crash("ERROR: glslang does not start".into()))?;
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
    // The preamble is a separate text before the shader, so line numbers do not change.
    let preamble: String =
        key.defines.iter().map(|(name, value)| format!("#define {name} {value}\n")).collect();
    builder.preamble(&preamble);
    let spirv = builder.parse().and_then(|shader| shader.compile());
    if !includes.failures.is_empty() {
        return Err(Failure::Includes(includes.failures));
    }
    let spirv = spirv.map_err(failed)?;
    if spirv.len() * 4 > MAX_SPIRV_BYTES {
        let most = MAX_SPIRV_BYTES >> 20;
        return Err(Failure::Log(format!("ERROR: the shader compiles to more than {most} MiB of SPIR-V")));
    }
    Ok(spirv)
}
