//! Tests uploads of the scene: once per device, in chunks, through two halves of the staging memory.

use crate::common::*;
use crate::histories::started;
use crate::testing::{SPLATS, plan};
use splatgraph_api::{BackendError, Device, Loader as _, Progress, SceneData};
use splatgraph_framework::ir::Shape;
use splatgraph_null::{Call, Config, Null};
use std::sync::Barrier;
use std::time::Duration;

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
    let scene = Zeros::default();
    null.load(large, &scene, &mut |progress| {
        if let Progress::Upload { done_bytes, .. } = progress {
            told.push(done_bytes);
        }
    })
    .expect("the plan loads");
    let calls = journal.take();
    assert_eq!(copies(&calls), [(0, CHUNK), (CHUNK, CHUNK), (2 * CHUNK, 40_000_000 - 2 * CHUNK)]);
    assert_eq!(told, [0, CHUNK, 2 * CHUNK, 40_000_000]);
    assert_eq!(scene.largest.into_inner() as u64, CHUNK);
    // Submissions and waits alternate: two chunks are in flight, then the first is waited for.
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
fn a_chunk_has_whole_entries_of_its_plane() {
    let (mut null, journal) = device();
    let mut large = plan();
    large.resources[SPLATS.index()].shape = Shape::Buffer { stride: 12, count: 2_000_000 };
    null.load(large, &Zeros::default(), &mut |_| {}).expect("the plan loads");
    let chunk = (16 << 20) / 12 * 12;
    assert_eq!(copies(&journal.take()), [(0, chunk), (chunk, 24_000_000 - chunk)]);
    finish(null, &journal);
}

#[test]
fn a_plan_beyond_the_budget_is_refused_before_anything_is_made_and_the_former_goes_on() {
    let config = Config { budget: Some(30 << 20), ..Config::default() };
    let (mut null, journal) = opened(&config);
    load(&mut null, plan());
    let before = submit(&mut null);
    let _ = journal.take();
    let mut large = plan();
    large.resources[SPLATS.index()].shape = Shape::Buffer { stride: 16, count: 2_000_000 };
    let scene = Zeros { identity: 7, ..Zeros::default() };
    let error = error_of(null.load(large, &scene, &mut |_| {}));
    let text = error.to_string();
    assert!(matches!(&error, BackendError::OutOfMemory { .. }), "{text}");
    assert!(
        text.contains("out of memory for the plan `test` (30.5 MiB)")
            && text.contains("expected at most 30.0 MiB of the device"),
        "{text}"
    );
    let made = |call: &Call| matches!(call, Call::Create { object: splatgraph_null::Object::Memory, .. });
    assert!(!journal.take().iter().any(made), "nothing was allocated");
    assert_eq!(scene.asked(), 0);
    null.wait(before).expect("the frame is done");
    frame(&mut null, &inputs());
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
    let lists = |null: &Null| null.memory().iter().any(|(name, _)| name == "splats");
    assert!(lists(&null) && lists(&other), "both read it");
    drop(null);
    other.load(plan(), &scene, &mut |_| {}).expect("the plan loads");
    assert_eq!(scene.asked(), 1);
    other.load(with_host_buffer(), &scene, &mut |_| {}).expect("the plan loads");
    other.load(plan(), &scene, &mut |_| {}).expect("the plan loads");
    assert_eq!(scene.asked(), 2);
    finish(other, &journal);
}

/// Zeros, of which each piece takes 50 ms.
#[derive(Default)]
struct Slow(Zeros);

impl SceneData for Slow {
    fn write(&self, name: &str, plane: u32, offset: u64, target: &mut [u8]) -> Result<(), String> {
        std::thread::sleep(Duration::from_millis(50));
        self.0.write(name, plane, offset, target)
    }

    fn identity(&self) -> u64 {
        self.0.identity()
    }
}

#[test]
fn plans_that_are_made_ready_at_the_same_time_upload_what_they_share_once() {
    const THREADS: usize = 4;
    let (null, journal) = device();
    let (scene, meeting) = (Slow::default(), Barrier::new(THREADS));
    let ready: Vec<_> = std::thread::scope(|scope| {
        let prepare = |_| {
            let (loader, scene, meeting) = (null.loader(), &scene, &meeting);
            scope.spawn(move || {
                meeting.wait();
                loader.prepare(plan(), scene, &mut |_| {}).expect("it is made ready")
            })
        };
        let threads: Vec<_> = (0..THREADS).map(prepare).collect();
        threads.into_iter().map(|thread| thread.join().expect("it ends well")).collect()
    });
    assert_eq!((scene.0.asked(), copies(&journal.take()).len()), (1, 1));
    drop(ready);
    finish(null, &journal);
}

/// Scene data that fails at every request, with an error or a panic.
struct Broken {
    panics: bool,
}

impl SceneData for Broken {
    fn write(&self, _: &str, _: u32, _: u64, _: &mut [u8]) -> Result<(), String> {
        assert!(!self.panics, "the scene breaks on purpose");
        Err("it has none".to_string())
    }

    fn identity(&self) -> u64 {
        9
    }
}

#[test]
fn a_scene_without_the_attribute_is_named_and_the_former_plan_and_its_histories_go_on() {
    let (mut null, journal) = device();
    load(&mut null, histories());
    let before = submit(&mut null);
    let error = error_of(null.load(histories(), &Broken { panics: false }, &mut |_| {}));
    let scene = BackendError::Scene {
        attribute: "scene.sh".to_string(),
        plane: 0,
        reason: "it has none".to_string(),
    };
    assert_eq!(error, scene);
    let loader = null.loader();
    let broken = move || drop(loader.prepare(histories(), &Broken { panics: true }, &mut |_| {}));
    assert!(std::thread::spawn(broken).join().is_err(), "the thread panics");
    null.wait(before).expect("the frame is done");
    frame(&mut null, &inputs());
    load(&mut null, histories());
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), Vec::<&str>::new());
    // The scene's identity is the same, but nothing of the failed attempts is reused.
    let whole = Zeros { identity: 9, ..Zeros::default() };
    null.load(plan(), &whole, &mut |_| {}).expect("the plan loads");
    assert_eq!(whole.asked(), 1);
    frame(&mut null, &inputs());
    finish(null, &journal);
}
