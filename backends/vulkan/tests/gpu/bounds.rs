//! Tests out-of-range accesses to buffers and images.

use crate::build::*;
use splatgraph_api::{Bounds, Device, FrameInputs, Inspect};
use splatgraph_framework::ir::*;

/// Shader that accesses a buffer of four words near and far beyond its end. It also accesses an image of 2 x 2 pixels
/// outside its bounds. Each invocation uses another offset.
const STRAY: &str = "layout(local_size_x = 64) in;
layout(set = 0, binding = 0) buffer Words { uint words[]; };
layout(set = 0, binding = 1, r32ui) uniform uimage2D image;
layout(set = 0, binding = 2) buffer Seen { uint seen[]; };
void main() {
    uint i = gl_GlobalInvocationID.x;
    uint near = 4u + i, far = 4u + i * 1048573u;
    seen[i] = words[near] | words[far] | imageLoad(image, ivec2(2 + i, 1)).x | imageLoad(image, ivec2(-1, -int(i) - 1)).x;
    words[near] = 0xdeadu;
    words[far] = 0xdeadu;
    imageStore(image, ivec2(2 + i, 0), uvec4(0xdeadu));
    imageStore(image, ivec2(0, 2 + int(i) * 65521), uvec4(0xdeadu));
    imageStore(image, ivec2(-1 - int(i), -1), uvec4(0xdeadu));
}";

#[test]
fn accesses_beyond_the_ends_of_buffers_and_images_leave_their_neighbours_alone() {
    let mut build = Build::new();
    let names = ["before", "victim", "after", "seen"];
    let [before, victim, after, seen] = names.map(|name| {
        let count = if name == "victim" { 4 } else { 1024 };
        build.words(name, count)
    });
    let usage = Usage::STORAGE | Usage::COPY_TARGET;
    let image = build.image("image", Format::R32Uint, 2, 2, usage);
    for (buffer, value) in [(before, 1), (victim, 2), (after, 3), (seen, 4)] {
        build.fill(Run::Frame, "fill", buffer, value);
    }
    let clear = build.shader("clear.comp", &image_shader("uvec4(5u)"));
    build.dispatch(Run::Frame, "clear", clear, 1, &[(image, 0, WRITE)]);
    let shader = build.shader("stray.comp", STRAY);
    let binds = [(victim, 0, BOTH), (image, 1, BOTH), (seen, 2, BOTH)];
    let stray = build.dispatch(Run::Frame, "stray", shader, 16, &binds);
    let plan = show(build, after);

    let mut vulkan = open_with(plan);
    let inspect = [before, victim, after, seen].map(|resource| Inspect { resource, after: stray }).to_vec();
    let result = frame(&mut vulkan, &FrameInputs { inspect, ..FrameInputs::default() });
    let found: Vec<Vec<u32>> = result.inspected.iter().map(|bytes| words(bytes)).collect();
    assert!(found[0].iter().all(|&word| word == 1), "the buffer before has changed");
    assert!(found[2].iter().all(|&word| word == 3), "the buffer after has changed");
    let robustness = vulkan.info().robustness;
    println!("{robustness}");
    assert_ne!(robustness.buffers, Bounds::None);
    if robustness.buffers == Bounds::Exact {
        assert_eq!(found[1], [2; 4]);
        if robustness.images == Bounds::Exact {
            assert!(found[3].iter().all(|&word| word == 0), "{:?}", &found[3][..8]);
        }
    }
    assert!(frame(&mut vulkan, &with_output()).output.is_some());
    finish(vulkan);
}
