//! Draws: exact results of blending, and pixel positions.
//!
//! All colours are small sums of powers of two, so the expected pixels are exact in 32-bit floats.

use crate::build::*;
use splatgraph_api::{Device, FrameInputs, FrameResult, Inspect};
use splatgraph_framework::{ir::*, plan::Plan};

const SIZE: u32 = 4;

/// A triangle over the upper left half. Its hypotenuse passes through no pixel centre. Each instance has its own
/// colour, whose alpha is also its depth.
const TRIANGLE: &str = "layout(set = 0, binding = 0) readonly buffer Colors { vec4 colors[]; };
layout(location = 0) flat out vec4 color;
void main() {
    const vec2 corners[3] = vec2[](vec2(-1, -1), vec2(0.75, -1), vec2(-1, 0.75));
    color = colors[gl_InstanceIndex];
    gl_Position = vec4(corners[gl_VertexIndex], color.a, 1);
}";

const COLOR: &str = "layout(location = 0) flat in vec4 color;
layout(location = 0) out vec4 result;
void main() { result = color; }";

/// Draws two frames with planes of these colours, and returns the second, which starts from the first one's contents.
fn drawn(plan: Plan, planes: &[&[[f32; 4]]], inspect: Vec<Inspect>) -> FrameResult {
    let mut scene = Scene { identity: 1, ..Scene::default() };
    for (plane, colors) in (0..).zip(planes) {
        let mut bytes: Vec<u8> = colors.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        // The scene's planes must not be empty.
        bytes.resize(bytes.len().max(16), 0);
        scene = scene.and("colors", plane, bytes);
    }
    let mut vulkan = open();
    vulkan.load(plan, &scene, &mut |_| {}).expect("the plan loads");
    let inputs = FrameInputs { inspect, ..with_output() };
    frame(&mut vulkan, &inputs);
    let result = frame(&mut vulkan, &inputs);
    finish(vulkan);
    result
}

/// Draws two coincident triangles. Checks which pixels they cover, and returns the colour of these pixels.
fn two_triangles(blend: Blend, clear: [f32; 4], indirect: bool) -> [f32; 4] {
    let mut build = Build::new();
    let colors = build.scene("colors", 0, 16, 2);
    let args = build.words("args", 5);
    let write = build.shader(
        "args.comp",
        "layout(set = 0, binding = 0) writeonly buffer Args { uint args[]; };
void main() { args[1] = 3; args[2] = 2; args[3] = 0; args[4] = 0; }",
    );
    build.dispatch(Run::Frame, "args", write, 1, &[(args, 0, WRITE)]);
    let image = build.image("color", Format::Rgba32Float, SIZE, SIZE, Usage::COLOR_TARGET);
    let shaders = [build.shader("triangle.vert", TRIANGLE), build.shader("color.frag", COLOR)];
    let [r, g, b, a] = clear;
    let target = Target { image, load: Load::Clear(r, g, b, a), blend };
    let call = if indirect {
        DrawCall::Indirect { buffer: args, offset: 4 }
    } else {
        DrawCall::Direct { vertices: 3, instances: 2 }
    };
    build.draw("triangles", shaders, call, &[target], &[(colors, 0, READ)]);
    let result = drawn(build.export(image), &[&[FIRST, SECOND]], Vec::new());
    let pixels = floats(&result.output.expect("the output was asked for").bytes);
    let pixels: Vec<[f32; 4]> = pixels.chunks_exact(4).map(|p| p.try_into().unwrap()).collect();
    for y in 0..SIZE as usize {
        for x in 0..SIZE as usize {
            let inside = x + y < 3;
            let expected = if inside { pixels[0] } else { clear };
            assert_eq!(pixels[y * SIZE as usize + x], expected, "pixel {x}, {y} (y counts down)");
        }
    }
    pixels[0]
}

/// Premultiplied colours of the two triangles.
const FIRST: [f32; 4] = [0.5, 0.25, 0.0, 0.5];
const SECOND: [f32; 4] = [0.0, 0.125, 0.25, 0.25];

#[test]
fn replace_keeps_the_last_fragment() {
    assert_eq!(two_triangles(Blend::Replace, [1.0, 2.0, 3.0, 4.0], false), SECOND);
}

#[test]
fn premultiplied_over_puts_the_later_fragment_in_front() {
    // Over (0.25, 0.5, 1, 1): the first gives (0.5 + 0.125, 0.25 + 0.25, 0.5, 1); the second adds to 3/4 of that.
    let pixel = two_triangles(Blend::PremultipliedOver, [0.25, 0.5, 1.0, 1.0], false);
    assert_eq!(pixel, [0.46875, 0.125 + 0.375, 0.25 + 0.375, 1.0]);
}

#[test]
fn transmittance_over_puts_the_later_fragment_in_front() {
    // Colours as above; alpha is the transmittance: 1, then 1/2, then 3/8.
    let pixel = two_triangles(Blend::TransmittanceOver, [0.25, 0.5, 1.0, 1.0], false);
    assert_eq!(pixel, [0.46875, 0.125 + 0.375, 0.25 + 0.375, 0.375]);
}

#[test]
fn transmittance_under_puts_the_later_fragment_behind() {
    // Alpha is the transmittance: 1, then 1/2 (which weights the second), then 3/8.
    let pixel = two_triangles(Blend::TransmittanceUnder, [0.0, 0.0, 0.0, 1.0], false);
    assert_eq!(pixel, [0.5, 0.25 + 0.0625, 0.125, 0.375]);
}

#[test]
fn add_sums_all_four_channels() {
    assert_eq!(two_triangles(Blend::Add, [0.25, 0.5, 1.0, 1.0], false), [0.75, 0.875, 1.25, 1.75]);
}

#[test]
fn a_draw_takes_its_counts_from_words_that_an_earlier_pass_wrote() {
    let direct = two_triangles(Blend::TransmittanceUnder, [0.0, 0.0, 0.0, 1.0], false);
    assert_eq!(two_triangles(Blend::TransmittanceUnder, [0.0, 0.0, 0.0, 1.0], true), direct);
}

#[test]
fn a_kept_target_goes_on_from_the_draw_before_and_targets_may_blend_differently() {
    let mut build = Build::new();
    let colors = build.scene("colors", 0, 16, 1);
    let over = build.image("over", Format::Rgba32Float, SIZE, SIZE, Usage::COLOR_TARGET);
    let last = build.image("last", Format::Rgba8Unorm, SIZE, SIZE, Usage::COLOR_TARGET);
    let two = "layout(location = 0) flat in vec4 color;
layout(location = 0) out vec4 first;
layout(location = 1) out vec4 second;
void main() { first = color; second = vec4(1, 0, 0.2, 1); }";
    let shaders = [build.shader("triangle.vert", TRIANGLE), build.shader("two.frag", two)];
    for (index, load) in [Load::Clear(0.0, 0.0, 0.0, 0.0), Load::Keep].into_iter().enumerate() {
        let targets = [
            Target { image: over, load, blend: Blend::PremultipliedOver },
            Target { image: last, load, blend: Blend::Replace },
        ];
        let call = DrawCall::Direct { vertices: 3, instances: 1 };
        build.draw(&format!("draw[{index}]"), shaders, call, &targets, &[(colors, 0, READ)]);
    }
    let inspect = vec![Inspect { resource: last, after: PassId(1) }];
    let result = drawn(build.export(over), &[&[FIRST]], inspect);
    assert_eq!(floats(&result.output.unwrap().bytes)[..4], [0.75, 0.375, 0.0, 0.75]);
    assert_eq!(result.inspected[0][..4], [255, 0, 51, 255]);
    assert_eq!(result.inspected[0][60..], [0, 0, 0, 0]);
}

/// Draws triangles of these colours, with depths in alpha. The first `written` write their depths; a second draw tests
/// the others against these depths, and writes none.
///
/// Returns the colour inside the triangles, and the depths inside and outside.
fn tested(colors: &[[f32; 4]], written: usize) -> ([f32; 4], [f32; 2]) {
    drawn_behind(colors, written, DepthAccess::Test)
}

/// Draws triangles as [`tested`] does. The second draw uses the depths by `access`.
fn drawn_behind(colors: &[[f32; 4]], written: usize, access: DepthAccess) -> ([f32; 4], [f32; 2]) {
    let mut build = Build::new();
    let parts = [&colors[..written], &colors[written..]];
    let image = build.image("color", Format::Rgba32Float, SIZE, SIZE, Usage::COLOR_TARGET);
    let depth =
        build.image("depth", Format::Depth32Float, SIZE, SIZE, Usage::DEPTH_TARGET | Usage::COPY_SOURCE);
    let shaders = [build.shader("triangle.vert", TRIANGLE), build.shader("color.frag", COLOR)];
    let planes: Vec<ResourceId> = (0..2)
        .map(|part| build.scene("colors", part, 16, parts[part as usize].len().max(1) as u64))
        .collect();
    for (part, access) in [(0, DepthAccess::Write), (1, access)] {
        let load = if part == 0 { Load::Clear(0.0, 0.0, 0.0, 0.0) } else { Load::Keep };
        let target = Target { image, load, blend: Blend::Replace };
        let call = DrawCall::Direct { vertices: 3, instances: parts[part].len() as u32 };
        build.draw(&format!("draw[{part}]"), shaders, call, &[target], &[(planes[part], 0, READ)]);
        build.depth(depth, access);
    }
    let inspect = vec![Inspect { resource: depth, after: PassId(1) }];
    let result = drawn(build.export(image), &parts, inspect);
    let pixels = floats(&result.output.expect("the output was asked for").bytes);
    let depths = floats(&result.inspected[0]);
    ([pixels[0], pixels[1], pixels[2], pixels[3]], [depths[0], depths[15]])
}

#[test]
fn of_two_fragments_the_one_with_the_greater_depth_stays_whatever_their_order() {
    let (near, far) = ([1.0, 0.0, 0.0, 0.75], [0.0, 1.0, 0.0, 0.25]);
    assert_eq!(tested(&[near, far], 2), (near, [0.75, 0.0]));
    assert_eq!(tested(&[far, near], 2), (near, [0.75, 0.0]));
    // An equal depth does not pass, and depth 0 is infinitely far.
    assert_eq!(tested(&[near, [0.0, 0.0, 1.0, 0.75]], 2).0, near);
    assert_eq!(tested(&[[0.0, 0.0, 1.0, 0.0]], 1), ([0.0; 4], [0.0, 0.0]));
}

#[test]
fn a_draw_that_only_tests_is_hidden_by_what_is_nearer_and_leaves_the_depths() {
    let wall = [1.0, 0.0, 0.0, 0.5];
    let (behind, before) = ([0.0, 1.0, 0.0, 0.25], [0.0, 0.0, 1.0, 0.75]);
    assert_eq!(tested(&[wall, behind], 1), (wall, [0.5, 0.0]));
    assert_eq!(tested(&[wall, before], 1), (before, [0.5, 0.0]));
    // A depth test alone writes no depth, so a farther fragment drawn later still passes.
    let between = [1.0, 1.0, 0.0, 0.625];
    assert_eq!(tested(&[wall, before, between], 1), (between, [0.5, 0.0]));
}

#[test]
fn a_second_draw_that_tests_and_writes_is_hidden_by_what_is_nearer_and_leaves_its_own_depths() {
    let second = |colors: &[[f32; 4]]| drawn_behind(colors, 1, DepthAccess::TestAndWrite);
    let wall = [1.0, 0.0, 0.0, 0.5];
    let (behind, before) = ([0.0, 1.0, 0.0, 0.25], [0.0, 0.0, 1.0, 0.75]);
    assert_eq!(second(&[wall, behind]), (wall, [0.5, 0.0]));
    assert_eq!(second(&[wall, before]), (before, [0.75, 0.0]));
    assert_eq!(second(&[wall, before, [1.0, 1.0, 0.0, 0.625]]), (before, [0.75, 0.0]));
}
