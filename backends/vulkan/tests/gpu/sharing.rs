//! Blocks: resources that are never alive at once and share memory.

use crate::build::*;
use splatgraph_api::{Device, FrameInputs, Inspect};
use splatgraph_framework::ir::*;

const COPY: &str = "layout(set = 0, binding = 0) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 1) writeonly buffer Target { uint target[]; };
void main() { uint i = gl_WorkGroupID.x; target[i] = source[i] + 1; }";

const TO_IMAGE: &str = "layout(set = 0, binding = 0) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D target;
void main() { uint i = gl_WorkGroupID.x; imageStore(target, ivec2(i, 0), uvec4(source[i] + 10)); }";

const FROM_IMAGE: &str = "layout(set = 0, binding = 0, r32ui) readonly uniform uimage2D source;
layout(set = 0, binding = 1) writeonly buffer Target { uint target[]; };
void main() { uint i = gl_WorkGroupID.x; target[i] = imageLoad(source, ivec2(i, 0)).x; }";

/// A plan that fills `first`, and copies it through the other aliases to the output, `kept`. The copies go to `kept`,
/// `second`, `kept`, the image `third`, and back to `kept`. Copies between buffers add 1, the copy to the image adds
/// 10.
struct Aliases {
    build: Build,
    aliases: [ResourceId; 3],
    kept: ResourceId,
}

const COUNT: u64 = 4096;

fn aliases() -> Aliases {
    let mut build = Build::new();
    let [first, second, kept] = ["first", "second", "kept"].map(|name| build.words(name, COUNT));
    let third = build.image("third", Format::R32Uint, COUNT as u32, 1, Usage::STORAGE);
    let copy = build.shader("copy.comp", COPY);
    let to_image = build.shader("to_image.comp", TO_IMAGE);
    let from_image = build.shader("from_image.comp", FROM_IMAGE);
    let mut dispatch = |name: &str, shader, source, target| {
        build.dispatch(Run::Frame, name, shader, COUNT as u32, &[(source, 0, READ), (target, 1, WRITE)]);
    };
    dispatch("first to kept", copy, first, kept);
    dispatch("kept to second", copy, kept, second);
    dispatch("second to kept", copy, second, kept);
    dispatch("kept to third", to_image, kept, third);
    dispatch("third to kept", from_image, third, kept);
    // The fill is declared last, then moved to the front of the frame.
    build.fill(Run::Frame, "fill", first, 5);
    build.plan.passes.rotate_right(1);
    Aliases { build, aliases: [first, second, third], kept }
}

fn bytes(vulkan: &impl Device) -> u64 {
    vulkan.memory().iter().map(|(_, bytes)| bytes).sum()
}

#[test]
fn tenants_of_a_block_all_work_and_the_memory_shows_what_is_saved() {
    let run = |shared: bool| {
        let mut aliases = aliases();
        if shared {
            aliases.build.share(&aliases.aliases);
        }
        let mut vulkan = open_with(show(aliases.build, aliases.kept));
        for _ in 0..3 {
            let shown = shown(&mut vulkan);
            assert_eq!(shown, vec![5 + 3 + 10; COUNT as usize]);
        }
        let memory = vulkan.memory();
        let sum = bytes(&vulkan);
        finish(vulkan);
        (memory, sum)
    };
    let (apart, sum_apart) = run(false);
    let (together, sum_together) = run(true);
    let names: Vec<&str> = together.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["first + second + third", "kept", "row", "output readback"]);
    // The block is as large as its largest alias; the memory of the other two is saved. (Drivers round image sizes up.)
    let bytes_of = |name: &str| apart.iter().find(|(n, _)| n == name).map(|(_, bytes)| *bytes).unwrap();
    let mut aliases = [bytes_of("first"), bytes_of("second"), bytes_of("third")];
    aliases.sort();
    assert!(aliases[0] >= 4 * COUNT, "{apart:?}");
    assert_eq!(together[0].1, aliases[2]);
    assert_eq!(sum_apart - sum_together, aliases[0] + aliases[1]);
}

#[test]
fn tenants_of_a_block_stand_in_the_same_memory() {
    // Writing one alias changes the other. (A solved plan never reads the other then: its lifetime is over.)
    let mut build = Build::new();
    let [one, other, copied] = ["one", "other", "copied"].map(|name| build.words(name, 4));
    build.share(&[one, other]);
    build.fill(Run::Frame, "fill one", one, 7);
    build.fill(Run::Frame, "fill other", other, 40);
    let copy = build.shader("copy.comp", COPY);
    build.dispatch(Run::Frame, "copy", copy, 4, &[(one, 0, READ), (copied, 1, WRITE)]);
    let mut vulkan = open_with(show(build, copied));
    assert_eq!(shown(&mut vulkan), [41; 4]);
    finish(vulkan);
}

#[test]
fn a_tenant_is_inspected_only_while_the_memory_is_its_own() {
    let mut aliases = aliases();
    let [first, second, third] = aliases.aliases;
    aliases.build.share(&aliases.aliases);
    let plan = show(aliases.build, aliases.kept);
    let after = |name: &str| {
        let index = plan.passes.iter().position(|pass| pass.name == name).unwrap();
        PassId(index as u32)
    };
    let [fill, kept_to_second, kept_to_third] = ["fill", "kept to second", "kept to third"].map(after);
    let inputs =
        |resource, after| FrameInputs { inspect: vec![Inspect { resource, after }], ..Default::default() };
    let mut vulkan = open_with(plan);
    for _ in 0..2 {
        for (resource, after, expected) in
            [(first, fill, 5), (second, kept_to_second, 7), (third, kept_to_third, 18)]
        {
            let inspected = frame(&mut vulkan, &inputs(resource, after)).inspected;
            assert_eq!(words(&inspected[0]), vec![expected; COUNT as usize]);
        }
        let error = error_of(vulkan.submit(&inputs(third, kept_to_second)));
        assert!(error.contains("`third`") && error.contains("holds `second` then"), "{error}");
        let error = error_of(vulkan.submit(&inputs(first, kept_to_third)));
        assert!(error.contains("`first`") && error.contains("holds `third` then"), "{error}");
    }
    finish(vulkan);
}
