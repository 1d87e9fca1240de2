//! Uploads of the scene: once per device, in chunks, through two halves.

use crate::common::*;
use crate::testing::{SPLATS, plan};
use splatgraph_api::{BackendError, Device, Progress, SceneData};
use splatgraph_framework::ir::Shape;
use splatgraph_null::Call;

/// The offsets and sizes of the copies to a plane.
fn copies(calls: &[Call]) -> Vec<(u64, u64)> {
    let copy = |call: &Call| match call {
        Call::CopyBuffer { source, target, bytes } if source.0 == "staging" => Some((target.1, *bytes)),
        _ => None,
    };
    calls.iter().filter_map(copy).collect()
}

#[test]
fn a_plane_larger_than_a_chunk_goes_in_chunks_and_each_half_is_waited_for_before_it_is_used_again() {
    const CHUNK: u64 = 16 << 20;
    let (mut null, journal) = device();
    let mut large = plan();
    large.resources[SPLATS.index()].shape = Shape::Buffer { stride: 4, count: 10_000_000 };
    let mut told = Vec::new();
    null.load(large, &Zeros::default(), &mut |progress| {
        if let Progress::Upload { done_bytes, .. } = progress {
            told.push(done_bytes);
        }
    })
    .expect("the plan loads");
    let calls = journal.take();
    assert_eq!(copies(&calls), [(0, CHUNK), (CHUNK, CHUNK), (2 * CHUNK, 40_000_000 - 2 * CHUNK)]);
    assert_eq!(told, [0, CHUNK, 2 * CHUNK, 40_000_000]);
    // Submissions and waits by turns: two chunks are on their way, then the first is waited for.
    let order: String = calls
        .iter()
        .filter_map(|call| match call {
            Call::Submit { .. } => Some('s'),
            Call::Wait { .. } => Some('w'),
            _ => None,
        })
        .collect();
    assert_eq!(order, "sswsww");
    finish(null, &journal);
}

#[test]
fn a_plane_is_uploaded_once_for_all_executors_as_long_as_some_plan_has_it() {
    let (mut null, journal) = device();
    let scene = Zeros::default();
    let mut other = null.new_context().expect("there can be another");
    null.load(plan(), &scene, &mut |_| {}).expect("the plan loads");
    other.load(plan(), &scene, &mut |_| {}).expect("the plan loads");
    assert_eq!((scene.asked(), copies(&journal.take()).len()), (1, 1));
    drop(null);
    other.load(plan(), &scene, &mut |_| {}).expect("the plan loads");
    assert_eq!(scene.asked(), 1);
    other.load(with_host_buffer(), &scene, &mut |_| {}).expect("the plan loads");
    other.load(plan(), &scene, &mut |_| {}).expect("the plan loads");
    assert_eq!(scene.asked(), 2);
    finish(other, &journal);
}

#[test]
fn a_scene_without_the_attribute_is_named_and_the_former_plan_goes_on() {
    struct Bare;
    impl SceneData for Bare {
        fn write(&self, _: &str, _: u32, _: &mut [u8]) -> Result<(), String> {
            Err("it has none".to_string())
        }
        fn identity(&self) -> u64 {
            9
        }
    }
    let (mut null, journal) = device();
    load(&mut null, plan());
    let before = submit(&mut null);
    let error = error_of(null.load(plan(), &Bare, &mut |_| {}));
    let scene = BackendError::Scene {
        attribute: "scene.sh".to_string(),
        plane: 0,
        reason: "it has none".to_string(),
    };
    assert_eq!(error, scene);
    null.wait(before).expect("the frame is done");
    frame(&mut null, &inputs());
    finish(null, &journal);
}
