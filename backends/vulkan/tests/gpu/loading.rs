//! Loading: uploads, resources kept between plans, and refusals.

use crate::build::*;
use splatgraph_api::{Device, FrameInputs, Progress};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::{Options, Vulkan};

/// Returns a plan that outputs the scene's attribute `numbers`, plus a constant.
fn numbers(count: u64, constant: u32) -> Plan {
    let mut build = Build::new();
    let source = build.scene("numbers", 2, 4, count);
    let target = build.words("sum", count);
    let shader = build.shader(
        "sum.comp",
        &format!(
            "layout(set = 0, binding = 0) readonly buffer Source {{ uint source[]; }};
layout(set = 0, binding = 1) writeonly buffer Target {{ uint target[]; }};
void main() {{ uint i = gl_WorkGroupID.x; target[i] = source[i] + {constant}; }}"
        ),
    );
    build.dispatch(Run::Once, "sum", shader, count as u32, &[(source, 0, READ), (target, 1, WRITE)]);
    show(build, target)
}

fn scene(identity: u64, values: &[u32]) -> Scene {
    Scene::new(identity, "numbers", 2, values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

#[test]
fn another_plan_may_be_loaded_while_frames_are_in_flight_and_keeps_the_scenes_planes() {
    let first = scene(1, &[5, 6, 7]);
    let mut vulkan = open();
    vulkan.load(numbers(3, 100), &first, &mut |_| {}).unwrap();
    let pending = [vulkan.submit(&with_output()).unwrap(), vulkan.submit(&with_output()).unwrap()];
    vulkan
        .load(numbers(3, 200), &first, &mut |progress| {
            assert!(!matches!(progress, Progress::Upload { .. }), "nothing is uploaded twice");
        })
        .unwrap();
    assert_eq!(shown(&mut vulkan), [205, 206, 207]);
    assert_eq!(first.asked(), 1);
    for frame in pending {
        assert_eq!(row(&mut vulkan, frame), [105, 106, 107]);
    }
    let second = scene(2, &[8, 8, 8]);
    vulkan.load(numbers(3, 200), &second, &mut |_| {}).unwrap();
    assert_eq!(shown(&mut vulkan), [208, 208, 208]);
    assert_eq!(second.asked(), 1);
    finish(vulkan);
}

#[test]
fn a_large_attribute_arrives_whole_and_tells_its_progress() {
    // More than two chunks, and not a whole number of chunks.
    let values: Vec<u32> = (0..10_000_000u32).map(|i| i.wrapping_mul(2_654_435_761)).collect();
    let large = scene(1, &values);
    let mut build = Build::new();
    let source = build.scene("numbers", 2, 4, values.len() as u64);
    let fold = build.words("fold", 1);
    build.fill(Run::Frame, "clear", fold, 0);
    let shader = build.shader(
        "fold.comp",
        "layout(local_size_x = 64) in;
layout(set = 0, binding = 0) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 1) buffer Fold { uint fold; };
void main() {
    uint sum = 0;
    for (uint i = gl_GlobalInvocationID.x; i < source.length(); i += 64 * 64) sum += source[i] ^ i;
    atomicAdd(fold, sum);
}",
    );
    build.dispatch(Run::Frame, "fold", shader, 64, &[(source, 0, READ), (fold, 1, BOTH)]);
    let plan = show(build, fold);
    let mut vulkan = open();
    let mut told = Vec::new();
    vulkan
        .load(plan, &large, &mut |progress| {
            if let Progress::Upload { done_bytes, of_bytes } = progress {
                told.push((done_bytes, of_bytes));
            }
        })
        .unwrap();
    let expected = values.iter().enumerate().fold(0u32, |sum, (i, v)| sum.wrapping_add(v ^ i as u32));
    assert_eq!(shown(&mut vulkan), [expected]);
    assert_eq!(told.first(), Some(&(0, 40_000_000)));
    assert_eq!(told.last(), Some(&(40_000_000, 40_000_000)));
    assert!(told.len() > 2 && told.is_sorted(), "{told:?}");
    finish(vulkan);
}

#[test]
fn memory_lists_the_plans_resources_then_the_scenes_planes_then_the_backends_own() {
    let mut vulkan = open();
    assert_eq!(vulkan.memory(), []);
    vulkan.load(numbers(4, 0), &scene(1, &[0; 4]), &mut |_| {}).unwrap();
    let listed = |vulkan: &Vulkan| -> Vec<String> {
        let memory = vulkan.memory();
        assert!(memory.iter().all(|&(_, bytes)| bytes >= 16), "{memory:?}");
        memory.into_iter().map(|(name, _)| name).collect()
    };
    assert_eq!(listed(&vulkan), ["sum", "row", "numbers"]);
    frame(&mut vulkan, &with_output());
    // The plane is freed, because only the prologue reads it.
    assert_eq!(listed(&vulkan), ["sum", "row", "output readback"]);
    finish(vulkan);
}

#[test]
fn devices_are_listed_with_the_facts_that_graphs_can_use() {
    let devices = Vulkan::devices().unwrap();
    let fit = devices.iter().find(|device| device.unfit.is_none()).expect("a device that can run plans");
    let sound =
        |fact: &Value| matches!(fact, Value::Bool(_)) || matches!(fact, Value::Int(value) if *value > 0);
    assert!(fit.facts.named().iter().all(|(_, fact)| sound(fact)), "{fit:?}");
    let absent = Options { device: Some("no such device".to_string()), ..Options::default() };
    assert!(error_of(Vulkan::open(&absent)).contains(&fit.name));
}

#[test]
fn a_plan_without_validation_runs_too() {
    let options = Options { device: Some("0".to_string()), ..Options::default() };
    let mut vulkan = Vulkan::open(&options).unwrap();
    vulkan.load(numbers(2, 1), &scene(1, &[1, 2]), &mut |_| {}).unwrap();
    assert_eq!(shown(&mut vulkan), [2, 3]);
    vulkan.submit(&FrameInputs::default()).unwrap();
    // The device is dropped with a frame in flight.
}
