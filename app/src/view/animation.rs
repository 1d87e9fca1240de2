//! Finds the plans whose frames may differ although their inputs do not: those that keep a history, or read the number of the frame.
//!
//! The number is one component of a vector in the block `Camera`, which shaders read for other reasons, too. So the SPIR-V is searched
//! for accesses to that component. A use of the vector that cannot be followed counts as one.

use crate::camera::{CAMERA, FRAME_NUMBER};
use splatgraph_framework::ir::{Pass, Source, Work};
use splatgraph_framework::plan::Plan;
use std::collections::{HashMap, HashSet};

/// Byte offset of the vector in the block, and the component that is the number.
const VECTOR: u32 = FRAME_NUMBER.0;
const COMPONENT: u32 = FRAME_NUMBER.1;

/// Returns true if frames of a plan may differ although their inputs do not.
pub fn is_animated(plan: &Plan) -> bool {
    plan.resources.iter().any(|resource| resource.history.is_some()) || reads_frame_number(plan)
}

/// Returns true if a shader of a frame reads the number of the frame.
fn reads_frame_number(plan: &Plan) -> bool {
    plan.frame.iter().map(|step| plan.pass(step.pass)).any(|pass| {
        let camera = bindings_of_camera(plan, pass);
        let reads = |id| camera.iter().any(|binding| reads(&plan.shader(id).spirv, *binding));
        match pass.work {
            Work::Dispatch { shader, .. } => reads(shader),
            Work::Draw { vertex, fragment, .. } => reads(vertex) || reads(fragment),
            Work::Fill { .. } | Work::Start { .. } | Work::Export | Work::Host => false,
        }
    })
}

/// Lists the binding numbers of the block `Camera` in a pass.
fn bindings_of_camera(plan: &Plan, pass: &Pass) -> Vec<u32> {
    let is_camera = |source: &Source| matches!(source, Source::Frame { uniform } if uniform == CAMERA);
    let bindings = pass.bindings.iter().filter(|binding| is_camera(&plan.resource(binding.resource).source));
    bindings.map(|binding| binding.binding).collect()
}

/// Instructions and decorations of SPIR-V, by their numbers in the specification.
mod op {
    pub const TYPE_POINTER: u32 = 32;
    pub const CONSTANT: u32 = 43;
    pub const FUNCTION_CALL: u32 = 57;
    pub const VARIABLE: u32 = 59;
    pub const LOAD: u32 = 61;
    pub const ACCESS_CHAIN: u32 = 65;
    pub const IN_BOUNDS_ACCESS_CHAIN: u32 = 66;
    pub const DECORATE: u32 = 71;
    pub const MEMBER_DECORATE: u32 = 72;
    pub const VECTOR_SHUFFLE: u32 = 79;
    pub const COMPOSITE_EXTRACT: u32 = 81;
    pub const BINDING: u32 = 33;
    pub const OFFSET: u32 = 35;
}

/// Words of the header, before the first instruction.
const HEADER: usize = 5;

/// Splits a module into instructions: opcode and operands.
fn instructions(spirv: &[u32]) -> impl Iterator<Item = (u32, &[u32])> {
    let mut rest = spirv.get(HEADER..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (&first, _) = rest.split_first()?;
        let (words, opcode) = ((first >> 16) as usize, first & 0xffff);
        let instruction = rest.get(1..words)?;
        rest = &rest[words..];
        Some((opcode, instruction))
    })
}

/// Returns true if a module reads the number from the block at this binding.
fn reads(spirv: &[u32], binding: u32) -> bool {
    // Everything is declared before it is used, so that one walk finds all.
    let mut variables: HashSet<u32> = HashSet::new();
    let mut pointees: HashMap<u32, u32> = HashMap::new();
    let mut constants: HashMap<u32, u32> = HashMap::new();
    // The index of the vector, by the type of the block.
    let mut members: HashMap<u32, u32> = HashMap::new();
    // Blocks by their variables, and values and pointers that hold the whole vector.
    let mut blocks: HashMap<u32, u32> = HashMap::new();
    let mut wholes: HashSet<u32> = HashSet::new();
    for (opcode, operands) in instructions(spirv) {
        match (opcode, operands) {
            (op::DECORATE, &[target, op::BINDING, number]) if number == binding => {
                _ = variables.insert(target)
            }
            (op::MEMBER_DECORATE, &[block, member, op::OFFSET, VECTOR]) => _ = members.insert(block, member),
            (op::TYPE_POINTER, &[result, _, pointee]) => _ = pointees.insert(result, pointee),
            (op::CONSTANT, &[_, result, value]) => _ = constants.insert(result, value),
            (op::VARIABLE, &[pointer, result, ..]) if variables.contains(&result) => {
                let member = pointees.get(&pointer).and_then(|block| members.get(block));
                blocks.extend(member.map(|member| (result, *member)));
            }
            (op::ACCESS_CHAIN | op::IN_BOUNDS_ACCESS_CHAIN, &[_, result, base, ref path @ ..])
                if blocks.contains_key(&base) =>
            {
                let index = |at: usize| path.get(at).map(|id| constants.get(id).copied());
                if index(0) == Some(Some(blocks[&base])) {
                    match index(1) {
                        None => _ = wholes.insert(result),
                        Some(component) if component.is_none_or(|it| it == COMPONENT) => return true,
                        Some(_) => {}
                    }
                }
            }
            (op::LOAD, &[_, result, pointer, ..]) if wholes.contains(&pointer) => _ = wholes.insert(result),
            (op::VECTOR_SHUFFLE, &[_, _, one, other, ref components @ ..])
                if wholes.contains(&one) || wholes.contains(&other) =>
            {
                // Components of the second vector are counted on from those of the first, of which there are four.
                let of = |vector: u32, first: u32| {
                    wholes.contains(&vector) && components.contains(&(first + COMPONENT))
                };
                if of(one, 0) || of(other, 4) {
                    return true;
                }
            }
            (op::COMPOSITE_EXTRACT, &[_, _, composite, COMPONENT]) if wholes.contains(&composite) => {
                return true;
            }
            (op::COMPOSITE_EXTRACT, &[_, _, composite, _]) if wholes.contains(&composite) => {}
            // The whole block, or the vector in a way that is not followed.
            (op::LOAD | op::FUNCTION_CALL, _) if operands.iter().any(|id| blocks.contains_key(id)) => {
                return true;
            }
            (op::DECORATE..=op::MEMBER_DECORATE, _) => {}
            _ if operands.iter().any(|id| wholes.contains(id)) => return true,
            _ => {}
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::{self, SceneFacts};
    use crate::planner::Planner;
    use splatgraph_assets::synth;

    fn plan(graph: &str) -> Plan {
        let scene = synth::generate("uniform", 10, 0).expect("a scene");
        let facts = facts::facts(&SceneFacts::of(&scene), &splatgraph_null::limits().facts(), (64, 36));
        let planner = &mut Planner::default();
        let plan = planner.plan(graph, &[], &facts, &facts::catalog(&scene));
        plan.unwrap_or_else(|errors| panic!("{}", errors.text(false)))
    }

    /// Returns the answer for a pass that computes a number from the block.
    fn of(expression: &str) -> bool {
        let folder = tempfile::tempdir().expect("a folder");
        let shader = format!(
            "#version 460\n#extension GL_GOOGLE_include_directive : require\n#include \"camera.glsl\"\n\
             layout(local_size_x = 1) in;\n\
             layout(set = 0, binding = 7, std430) writeonly buffer Out {{ float result; }};\n\
             float third(vec4 v) {{ return v.z; }}\n\
             void main() {{ result = {expression}; }}\n"
        );
        std::fs::write(folder.path().join("number.comp"), shader).expect("a shader");
        let graph = folder.path().join("graph.ron");
        let text = r#"Graph(version: 1, summary: "", output: "color",
            imports: { "camera": Import(from: "frame.camera") },
            resources: {
              "out": Buffer(stride: 4, count: 1),
              "color": Image(format: "rgba8", size: (1, 1)),
            },
            passes: [
              Dispatch(name: "n", shader: "number.comp", size: Groups(1), bind: { "Camera": "camera", "Out": "out" }),
              Dispatch(name: "show", shader: "show.comp", size: Groups(1), bind: { "Out": "out", "color": "color" }),
            ])"#;
        let show = "#version 460\nlayout(local_size_x = 1) in;\n\
            layout(set = 0, binding = 0, std430) readonly buffer Out { float result; };\n\
            layout(set = 0, binding = 1, rgba8) writeonly uniform image2D color;\n\
            void main() { imageStore(color, ivec2(0), vec4(result)); }\n";
        std::fs::write(folder.path().join("show.comp"), show).expect("a shader");
        std::fs::write(&graph, text).expect("a graph");
        reads_frame_number(&plan(&graph.to_string_lossy()))
    }

    #[test]
    fn a_shader_that_reads_the_number_of_the_frame_is_told_from_others_of_the_block() {
        for expression in [
            "camera.depth.w",
            "camera.depth.zw.y",
            "camera.depth[3]",
            "camera.depth[int(camera.focal.x)]",
            "dot(camera.depth, vec4(1.0))",
            "third(camera.depth)",
        ] {
            assert!(of(expression), "{expression}");
        }
        for expression in
            ["1.0", "camera.depth.y", "camera.depth.yz.x", "camera.focal.w", "camera.position.w"]
        {
            assert!(!of(expression), "{expression}");
        }
    }

    #[test]
    fn of_the_shipped_graphs_only_the_one_with_a_history_is_animated() {
        for graph in crate::builtin::presets() {
            assert_eq!(is_animated(&plan(graph.name)), graph.name == "stale_order", "{}", graph.name);
        }
    }
}
