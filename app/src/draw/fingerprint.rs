//! Hashes plans, to find plans that do the same.

use splatgraph_framework::ir::Origin;
use splatgraph_framework::plan::Plan;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Hashes what determines a plan's commands: shaders, passes and resources with their names, memory, order, and live
/// values.
///
/// The graph's name, source locations, and parameters without an effect are left out.
pub fn fingerprint(plan: &Plan) -> u64 {
    let mut hash = DefaultHasher::new();
    commands(plan).hash(&mut hash);
    plan.live_bytes_of(plan.params.iter().filter(|param| plan.no_effect(&param.name).is_none()))
        .hash(&mut hash);
    hash.finish()
}

/// Hashes what determines a plan's commands, except for live values: see [`fingerprint`].
pub fn commands(plan: &Plan) -> u64 {
    let nowhere = || Origin { file: String::new(), line: 0, column: 0 };
    let mut hash = DefaultHasher::new();
    for shader in &plan.shaders {
        code(&shader.spirv).hash(&mut hash);
    }
    for pass in &plan.passes {
        let mut pass = pass.clone();
        pass.origin = nowhere();
        format!("{pass:?}").hash(&mut hash);
    }
    for resource in &plan.resources {
        let mut resource = resource.clone();
        resource.origin = nowhere();
        format!("{resource:?}").hash(&mut hash);
    }
    let order = (&plan.blocks, &plan.prologue, &plan.frame, plan.output, &plan.outputs, &plan.stats);
    format!("{order:?}").hash(&mut hash);
    hash.finish()
}

/// Returns SPIR-V without its debug instructions, which hold names, texts and lines.
pub fn code(spirv: &[u32]) -> Vec<u32> {
    // OpSourceContinued, OpSource, OpSourceExtension, OpName, OpMemberName, OpString, OpLine; OpNoLine;
    // OpModuleProcessed.
    let is_debug = |opcode: u32| matches!(opcode, 2..=8 | 317 | 330);
    let (header, mut rest) = spirv.split_at(spirv.len().min(5));
    let mut code = header.to_vec();
    while let Some(first) = rest.first() {
        let (instruction, others) = rest.split_at(((first >> 16) as usize).clamp(1, rest.len()));
        if !is_debug(first & 0xffff) {
            code.extend(instruction);
        }
        rest = others;
    }
    code
}
