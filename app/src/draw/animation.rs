//! Detects plans whose frames may differ for equal inputs. These have state, or their shaders read the frame number.
//! Also detects plans that ignore the background.

use crate::draw::camera::{BACKGROUND, CAMERA, FRAME_NUMBER};
use splatgraph_framework::ir::{Pass, ReflectedKind, Shader, Source};
use splatgraph_framework::plan::Plan;

/// Returns true if the frames of a plan may differ for equal inputs.
pub fn is_animated(plan: &Plan) -> bool {
    plan.carries_state() || reads_camera(plan, FRAME_NUMBER)
}

/// Returns a note if the plan ignores `background`, unless it is black, to which pictures are usually cleared.
pub fn background_note(plan: &Plan, background: [f32; 3]) -> Option<String> {
    (background != [0.0; 3] && !reads_camera(plan, BACKGROUND)).then(|| {
        format!("{}: --background has no effect: no shader of the graph reads `camera.background`", plan.name)
    })
}

/// Returns true if a shader of the plan's frames may read the member at byte `offset` of the block `Camera`.
fn reads_camera(plan: &Plan, offset: u32) -> bool {
    let reads = |pass: &Pass| {
        pass.work.shaders().into_iter().any(|shader| reads(plan, pass, plan.shader(*shader), offset))
    };
    plan.frame.iter().any(|pass| reads(plan.pass(*pass)))
}

fn reads(plan: &Plan, pass: &Pass, shader: &Shader, offset: u32) -> bool {
    let is_camera = |source: &Source| matches!(source, Source::Frame { uniform } if uniform == CAMERA);
    let bound = pass.bindings.iter().filter(|binding| is_camera(&plan.resource(binding.resource).source));
    bound.map(|binding| binding.binding).any(|number| {
        let block = shader.reflection.bindings.iter().find(|binding| binding.binding == number);
        matches!(
            block.map(|block| &block.kind),
            Some(ReflectedKind::UniformBuffer { members, .. })
                if members.iter().any(|member| member.offset == offset && member.used)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing;

    /// Builds a graph whose shader computes `expression`. Returns true if the plan reads the frame number.
    fn of(expression: &str) -> bool {
        let folder = tempfile::tempdir().expect("a folder");
        let shader = format!(
            "#version 460\n#extension GL_GOOGLE_include_directive : require\n#include \"camera.glsl\"\n\
             layout(local_size_x = 1) in;\n\
             layout(set = 0, binding = 7, std430) writeonly buffer Out {{ float result; }};\n\
             uint next(uint n) {{ return n + 1; }}\n\
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
        reads_camera(&testing::plan(&graph.to_string_lossy(), &[], 8), FRAME_NUMBER)
    }

    #[test]
    fn a_shader_that_reads_the_number_of_the_frame_is_told_from_others_of_the_block() {
        for expression in
            ["float(camera.frame)", "float(next(camera.frame))", "camera.frame == 0 ? 1.0 : 0.0"]
        {
            assert!(of(expression), "{expression}");
        }
        for expression in ["1.0", "camera.depth.y", "camera.position_low.w", "camera.principal[0].x"] {
            assert!(!of(expression), "{expression}");
        }
    }

    #[test]
    fn of_the_shipped_graphs_only_the_one_with_a_history_is_animated() {
        for graph in crate::draw::builtin::presets() {
            let plan = testing::plan(graph.name, &[], 8);
            assert_eq!(is_animated(&plan), graph.name == "stale_order", "{}", graph.name);
            assert_eq!(background_note(&plan, [1.0; 3]), None, "{}", graph.name);
        }
    }
}
