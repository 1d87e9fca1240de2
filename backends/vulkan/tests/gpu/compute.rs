//! Fills, dispatches, push constants, subgroups, statistics and inspection.

use crate::build::*;
use splatgraph_api::{Device, FrameInputs, Inspect};
use splatgraph_framework::ir::*;

#[test]
fn a_fill_a_dispatch_and_an_export_give_the_expected_words() {
    let mut build = Build::new();
    let words_ = build.words("words", 5);
    build.fill(Run::Frame, "fill", words_, 7);
    let shader = build.shader("add.comp", &add(100));
    build.dispatch(Run::Frame, "add", shader, 5, &[(words_, 0, BOTH)]);
    let plan = show(build, words_);

    let mut vulkan = open_with(plan);
    let result = frame(&mut vulkan, &with_output());
    let output = result.output.expect("the output was asked for");
    assert_eq!((output.width, output.height, output.format), (5, 1, Format::R32Uint));
    assert_eq!(words(&output.bytes), [107, 108, 109, 110, 111]);
    assert!(frame(&mut vulkan, &FrameInputs::default()).output.is_none());
    finish(vulkan);
}

#[test]
fn every_pass_that_ran_is_timed_in_order() {
    let mut build = Build::new();
    let words_ = build.words("words", 5);
    let fill = build.fill(Run::Frame, "fill", words_, 7);
    let plan = show(build, words_);
    let mut vulkan = open_with(plan);
    let result = frame(&mut vulkan, &FrameInputs::default());
    let passes: Vec<PassId> = result.pass_ms.iter().map(|&(pass, _)| pass).collect();
    assert_eq!(passes, [fill, PassId(1), PassId(2)]);
    let times: Option<Vec<f64>> = result.pass_ms.iter().map(|&(_, ms)| ms).collect();
    let sum: f64 = times.expect("lavapipe and every GPU we know have timestamps").iter().sum();
    let total = result.total_ms.expect("as above");
    assert!(sum >= 0.0 && sum <= total * 1.001 + 1e-6, "{sum} of {total} ms");
    finish(vulkan);
}

#[test]
fn a_dispatch_takes_its_size_from_words_that_an_earlier_pass_wrote() {
    let mut build = Build::new();
    let words_ = build.words("words", 6);
    let args = build.words("args", 8);
    build.fill(Run::Frame, "fill", words_, 1);
    let write = build.shader(
        "args.comp",
        "layout(set = 0, binding = 0) writeonly buffer Args { uint args[]; };
void main() { args[4] = 3; args[5] = 1; args[6] = 1; }",
    );
    build.dispatch(Run::Frame, "args", write, 1, &[(args, 0, WRITE)]);
    let shader = build.shader("add.comp", &add(10));
    build.dispatch_indirect("add", shader, (args, 16), &[(words_, 0, BOTH)]);
    let plan = show(build, words_);

    let mut vulkan = open_with(plan);
    assert_eq!(shown(&mut vulkan), [11, 12, 13, 1, 1, 1]);
    finish(vulkan);
}

#[test]
fn equal_shaders_with_different_push_constants_are_different_dispatches() {
    let mut build = Build::new();
    let words_ = build.words("words", 2);
    let shader = build.shader(
        "push.comp",
        "layout(push_constant) uniform Push { uint index; uint value; };
layout(set = 0, binding = 3) writeonly buffer Words { uint words[]; };
void main() { words[index] = value; }",
    );
    for (index, value) in [(0u32, 40u32), (1, 50)] {
        let pass = build.dispatch(Run::Frame, &format!("push[{index}]"), shader, 1, &[(words_, 3, WRITE)]);
        build.plan.passes[pass.index()].push = [index.to_le_bytes(), value.to_le_bytes()].concat();
    }
    let plan = show(build, words_);
    let mut vulkan = open();
    let mut pipelines = Vec::new();
    vulkan
        .load(plan, &Scene::default(), &mut |progress| {
            if let splatgraph_api::Progress::Pipeline { of, .. } = progress {
                pipelines.push(of);
            }
        })
        .unwrap();
    // Two dispatches of one shader share a pipeline; the other pipeline copies the words to the output.
    assert_eq!(pipelines, [2, 2]);
    assert_eq!(shown(&mut vulkan), [40, 50]);
    finish(vulkan);
}

#[test]
fn subgroups_are_full_and_of_the_size_that_graphs_are_told() {
    let mut build = Build::new();
    let words_ = build.words("words", 2);
    let shader = build.shader(
        "size.comp",
        "#extension GL_KHR_shader_subgroup_arithmetic : require
layout(local_size_x = 128) in;
layout(set = 0, binding = 0) writeonly buffer Words { uint words[]; };
void main() {
    uint lanes = subgroupAdd(1u);
    if (gl_LocalInvocationIndex == 0) { words[0] = gl_SubgroupSize; words[1] = lanes; }
}",
    );
    build.dispatch(Run::Frame, "size", shader, 1, &[(words_, 0, WRITE)]);
    let plan = show(build, words_);
    let mut vulkan = open_with(plan);
    let size = vulkan.info().facts.subgroup_size;
    assert_eq!(shown(&mut vulkan), [size; 2]);
    finish(vulkan);
}

#[test]
fn statistics_are_words_at_their_offsets_in_the_plans_order() {
    let mut build = Build::new();
    let words_ = build.words("words", 4);
    build.fill(Run::Frame, "fill", words_, 20);
    let shader = build.shader("add.comp", &add(0));
    build.dispatch(Run::Frame, "add", shader, 4, &[(words_, 0, BOTH)]);
    build.stat("last", words_, 12);
    build.stat("first", words_, 0);
    let plan = show(build, words_);
    let mut vulkan = open_with(plan);
    let stats = frame(&mut vulkan, &FrameInputs::default()).stats;
    assert_eq!(stats, [("last".to_string(), 23), ("first".to_string(), 20)]);
    finish(vulkan);
}

#[test]
fn a_resource_is_inspected_as_it_is_right_after_the_pass() {
    let mut build = Build::new();
    let words_ = build.words("words", 3);
    let fill = build.fill(Run::Frame, "fill", words_, 5);
    let shader = build.shader("add.comp", &add(1));
    let first = build.dispatch(Run::Frame, "add[0]", shader, 3, &[(words_, 0, BOTH)]);
    build.dispatch(Run::Frame, "add[1]", shader, 3, &[(words_, 0, BOTH)]);
    let plan = show(build, words_);
    let (show_pass, row) = (PassId(3), plan.output);

    let mut vulkan = open_with(plan);
    let at = |resource, after| Inspect { resource, after };
    let inputs = FrameInputs {
        inspect: vec![at(words_, first), at(row, show_pass), at(words_, fill)],
        ..with_output()
    };
    let result = frame(&mut vulkan, &inputs);
    let inspected: Vec<Vec<u32>> = result.inspected.iter().map(|bytes| words(bytes)).collect();
    assert_eq!(inspected, [vec![6, 7, 8], vec![7, 9, 11], vec![5, 5, 5]]);
    assert_eq!(output(&result), [7, 9, 11]);

    let too_early = FrameInputs { inspect: vec![at(row, fill)], ..Default::default() };
    // In the first frame the image had no contents at that point; now it has the previous frame's.
    let result = frame(&mut vulkan, &too_early);
    assert_eq!(words(&result.inspected[0]), [7, 9, 11]);
    let absent = FrameInputs { inspect: vec![at(ResourceId(99), fill)], ..Default::default() };
    assert!(error_of(vulkan.submit(&absent)).contains("99"));
    finish(vulkan);
}

#[test]
fn an_image_that_nothing_has_written_cannot_be_inspected() {
    let mut build = Build::new();
    let words_ = build.words("words", 3);
    let fill = build.fill(Run::Once, "fill", words_, 5);
    let plan = show(build, words_);
    let row = plan.output;
    let mut vulkan = open_with(plan);
    let inputs = FrameInputs { inspect: vec![Inspect { resource: row, after: fill }], ..Default::default() };
    let error = error_of(vulkan.submit(&inputs));
    assert!(error.contains("`row` has no contents yet after pass `fill`"), "{error}");
    frame(&mut vulkan, &FrameInputs::default());
    let error = error_of(vulkan.submit(&inputs));
    assert!(error.contains("`fill`, which does not run in this frame"), "{error}");
    finish(vulkan);
}

#[test]
fn a_message_of_the_validation_layer_names_the_resource_and_the_pass() {
    let mut build = Build::new();
    let words = build.words("words", 4);
    let shader = build.shader("add.comp", &add(1));
    build.fill(Run::Frame, "first", words, 1);
    let second = build.dispatch(Run::Frame, "second", shader, 4, &[(words, 0, BOTH)]);
    let plan = show(build, words);
    let mut barriers = barriers_everywhere(&plan);
    barriers.at_mut(Some(second)).clear();
    let mut vulkan = open();
    load_with(&mut vulkan, plan, barriers);
    frame(&mut vulkan, &FrameInputs::default());
    let messages = vulkan.close();
    let hazard = messages.iter().find(|text| text.contains("SYNC-HAZARD"));
    let hazard = hazard.unwrap_or_else(|| panic!("no hazard was seen in {messages:?}"));
    assert!(hazard.contains("[words]") && hazard.contains("[second]"), "{hazard}");
}
