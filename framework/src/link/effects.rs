//! Finds the parameters that each pass, kept or removed, depends on through its shaders.

use std::collections::{BTreeMap, BTreeSet};

use super::linker::{self, LinkedPass, Linker, MAX_COMPILATIONS, PassParams};
use crate::ir::{FileId, LIVE_BLOCK, ParamSet, ReflectedKind, ShaderId, ShaderStage, Stages};
use crate::lower::{Lowered, LoweredPass, RemovedPass, ShaderName};
use crate::shader::{ShaderCompiler, ShaderRequest};
use crate::source::{Kind, SourceMap};

impl Linker<'_> {
    pub(super) fn params(&self, pass: &LoweredPass, stages: &[(ShaderId, Stages)]) -> PassParams {
        let mut structure = pass.decided.clone();
        let (mut live, mut skipped) = (ParamSet::new(), ParamSet::new());
        for (handle, _) in stages {
            let shader = &self.shaders[handle.index()];
            let reached = &self.reached[handle];
            structure.extend(behind(&pass.constants, reached));
            let mentioned = shader.defines.iter().filter(|(name, _)| !reached.contains(name));
            skipped.extend(mentioned.filter_map(|(name, _)| pass.constants.get(name)).flatten());
            let blocks = shader.reflection.bindings.iter().filter(|block| block.name == LIVE_BLOCK);
            for block in blocks {
                let ReflectedKind::UniformBuffer { members, .. } = &block.kind else { continue };
                let used = members.iter().filter(|member| member.used);
                live.extend(used.filter_map(|m| self.lowered.live_params.get(&m.name)).flatten());
            }
        }
        let all = structure.iter().chain(&pass.read).chain(&live).copied().collect();
        PassParams { all, structure, skipped }
    }
}

/// Returns the parameters that the constants in `names` depend on.
fn behind<'a>(
    constants: &'a BTreeMap<String, ParamSet>,
    names: &'a BTreeSet<String>,
) -> impl Iterator<Item = &'a usize> {
    constants.iter().filter(|(name, _)| names.contains(*name)).flat_map(|(_, params)| params)
}

/// Lists the shaders of removed passes that have no file, each once.
pub(super) fn missing<'a>(lowered: &'a Lowered, files: &mut SourceMap) -> Vec<&'a (FileId, ShaderName)> {
    let mut seen = BTreeSet::new();
    let distinct = lowered.removed_shaders.iter().filter(|(file, shader)| seen.insert((*file, &shader.name)));
    distinct.filter(|(file, shader)| files.find(Some(*file), &shader.name, Kind::Shader).is_err()).collect()
}

/// Lists, for each removed pass, the parameters that its shaders mention. Empty if every parameter has an effect,
/// because the list only explains parameters without one. Shaders after the first [`MAX_COMPILATIONS`] count as
/// mentioning none.
pub(super) fn mentioned(
    lowered: &Lowered,
    passes: &[LinkedPass],
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Vec<ParamSet> {
    let mut used: ParamSet = lowered.shape.union(&lowered.results).copied().collect();
    passes.iter().for_each(|pass| used.extend(&pass.params.all));
    if used.len() == lowered.plan.params.len() {
        return Vec::new();
    }
    // This stub of the generated file mentions the block, which shows that a shader includes it, but no parameter: only
    // parameters in the shader's own text count.
    let live_glsl = Some(linker::add_live_glsl(files, LIVE_BLOCK));
    let mut known: BTreeMap<_, BTreeSet<String>> = BTreeMap::new();
    let mut of_shader = |removed: &RemovedPass, name: &String| -> ParamSet {
        let key = (removed.file, name.clone());
        if known.len() == MAX_COMPILATIONS && !known.contains_key(&key) {
            return ParamSet::new();
        }
        let names = known.entry(key).or_insert_with(|| {
            // [`missing`] lists shaders without a file.
            let Ok(file) = files.find(Some(removed.file), name, Kind::Shader) else {
                return BTreeSet::new();
            };
            let stage = ShaderStage::of_file(name).unwrap_or(ShaderStage::Compute);
            let request = ShaderRequest { file, stage, defines: &[], unfit: &[], live_glsl };
            compiler.identifiers(files, &request)
        });
        let constants = behind(&removed.constants, names);
        let live = lowered.live_params.iter();
        let live = live.filter(|(name, _)| names.contains(LIVE_BLOCK) && names.contains(*name));
        constants.chain(live.flat_map(|(_, params)| params)).copied().collect()
    };
    let of_pass =
        |removed: &RemovedPass| removed.shaders.iter().flat_map(|name| of_shader(removed, name)).collect();
    lowered.removed.iter().map(of_pass).collect()
}
