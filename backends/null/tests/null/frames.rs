//! Tests frames: their commands, their slots, and their results.

use crate::common::*;
use crate::testing::{CAMERA, COLOR, WORDS, plan};
use splatgraph_api::{BackendError, BufferContents, Device, FrameInputs, Inspect};
use splatgraph_framework::ir::*;
use splatgraph_null::{Call, Config, Object};
use std::sync::Arc;

#[test]
fn a_frame_is_the_plans_passes_and_nothing_else() {
    let (mut null, journal) = device();
    load(&mut null, plan());
    frame(&mut null, &inputs());
    let calls = journal.take();
    let label = |name: &str| Call::PushLabel(name.to_string());
    let bind = |pass: &str| Call::BindPass { pass: pass.to_string(), slot: 0 };
    let at = |name: &str, offset| (name.to_string(), offset);
    let pass = |name: &str, query, work: Vec<Call>| {
        let mut calls = vec![label(name), Call::Timestamp { index: query }];
        calls.extend(work);
        calls.extend([Call::Timestamp { index: query + 1 }, Call::PopLabel]);
        calls
    };
    let draw =
        Call::DrawIndirect { targets: vec!["color".to_string()], arguments: "args".to_string(), offset: 16 };
    let copy = Call::CopyBuffer { source: at("args", 20), target: at("readback", 0), bytes: 4 };
    let indirect = Call::DispatchIndirect { arguments: "args".to_string(), offset: 4 };
    let expected = [
        vec![Call::Begin { encoder: "frame".to_string() }, label("frame 0")],
        vec![Call::ResetTimestamps { count: 14 }, Call::Timestamp { index: 0 }],
        pass("clear", 2, vec![Call::Fill { buffer: "words".to_string(), value: 0 }]),
        pass("scan[0]", 4, vec![bind("scan[0]"), Call::Dispatch([4, 1, 1])]),
        pass("scan[1]", 6, vec![bind("scan[1]"), indirect]),
        pass("splat", 8, vec![bind("splat"), draw]),
        pass("export", 10, vec![copy]),
        vec![label("host"), Call::PopLabel],
        vec![Call::Timestamp { index: 1 }, Call::PopLabel, Call::End],
        vec![Call::Submit { encoder: "frame".to_string(), show: None }],
    ];
    assert_eq!(last_frame(&calls), expected.concat());
    // The prologue runs once, and the second frame uses the other slot.
    frame(&mut null, &inputs());
    let calls = journal.take();
    assert!(!calls.iter().any(|call| matches!(call, Call::Fill { .. })));
    assert!(calls.contains(&Call::BindPass { pass: "splat".to_string(), slot: 1 }));
    finish(null, &journal);
}

#[test]
fn statistics_that_are_adjacent_in_their_order_are_copied_at_once() {
    let (mut null, journal) = device();
    let mut counted = plan();
    let first = counted.stats[0].clone();
    let stat = |offset| Stat { name: format!("at {offset}"), offset, ..first.clone() };
    counted.stats = [12, 16, 20, 4, 0].map(stat).into();
    let readback = counted.resources.iter_mut().find(|resource| resource.name == "readback");
    readback.expect("statistics are read back").shape = Shape::Buffer { stride: 4, count: 5 };
    load(&mut null, counted);
    frame(&mut null, &inputs());
    let copies: Vec<_> = journal
        .take()
        .into_iter()
        .filter_map(|call| match call {
            Call::CopyBuffer { source, target, bytes } if target.0 == "readback" => {
                Some((source.1, target.1, bytes))
            }
            _ => None,
        })
        .collect();
    assert_eq!(copies, [(12, 0, 12), (4, 12, 4), (0, 16, 4)]);
    finish(null, &journal);
}

#[test]
fn a_third_frame_waits_for_the_first_and_results_are_taken_in_any_order() {
    let (mut null, journal) = device();
    load(&mut null, plan());
    let first = [submit(&mut null), submit(&mut null)];
    journal.take();
    let third = submit(&mut null);
    let calls = journal.take();
    assert!(matches!(calls[0], Call::Wait { .. }), "{:?}", calls[0]);
    assert_eq!(waits(&calls), 1);
    let results = [third, first[0], first[1]].map(|frame| null.wait(frame).expect("the frame is done"));
    assert_eq!(results.map(|result| result.pass_ms.len()), [4, 5, 4]);
    assert!(matches!(error_of(null.wait(third)), BackendError::Invalid(_)));
    finish(null, &journal);
}

#[test]
fn a_frame_without_a_plan_or_with_uniform_blocks_that_do_not_fit_it_is_refused() {
    let (mut null, journal) = device();
    assert!(error_of(null.submit(&inputs())).to_string().contains("before a plan was loaded"));
    load(&mut null, plan());
    let missing = error_of(null.submit(&FrameInputs::default())).to_string();
    assert!(missing.contains("no contents for uniform block `frame.camera`"), "{missing}");
    let mut lively = plan();
    lively.resources[CAMERA.index()].source = Source::Live;
    lively.params = ["first", "second"]
        .into_iter()
        .zip([0, 4])
        .map(|(name, offset)| Param {
            name: name.to_string(),
            value: Value::Int(1),
            default: Value::Int(1),
            reason: None,
            exact: None,
            grows: None,
            domain: Domain::Int { min: 0, max: 9 },
            binding: ParamBinding::Live { offset },
            origin: lively.passes[0].origin.clone(),
        })
        .collect();
    let live = lively.live_bytes();
    load(&mut null, lively);
    let with = |live: &[u8]| FrameInputs { live: live.to_vec(), ..FrameInputs::default() };
    for short in [0, 4, 7] {
        let error = error_of(null.submit(&with(&live[..short]))).to_string();
        assert!(error.contains(&format!("expected at least 8 bytes, found {short}")), "{error}");
    }
    let long = error_of(null.submit(&with(&[0; 257]))).to_string();
    assert!(long.contains("uniform block `camera`: expected at most 256 bytes, found 257"), "{long}");
    frame(&mut null, &with(&live[..8]));
    frame(&mut null, &with(&live));
    finish(null, &journal);
}

#[test]
fn passes_are_timed_one_after_another() {
    let (mut null, journal) = device();
    load(&mut null, plan());
    let result = frame(&mut null, &inputs());
    // The timer ticks once per timestamp; a tick is a nanosecond.
    assert!(result.pass_ms.iter().all(|(_, ms)| *ms == Some(1e-6)), "{:?}", result.pass_ms);
    assert_eq!(result.total_ms, Some(11e-6));
    finish(null, &journal);
}

#[test]
fn reading_back_adds_the_copies_and_what_makes_them_visible_to_the_host() {
    let (mut null, journal) = device();
    load(&mut null, plan());
    // This plan's passes declare no accesses, so the image counts as written only after a frame.
    frame(&mut null, &inputs());
    let inspect =
        vec![Inspect { resource: WORDS, after: PassId(1) }, Inspect { resource: COLOR, after: PassId(3) }];
    let result = frame(&mut null, &FrameInputs { read_output: true, inspect, ..inputs() });
    let sizes: Vec<usize> = result.inspected.iter().map(Vec::len).collect();
    assert_eq!((sizes, result.output.expect("it was asked for").bytes.len()), (vec![4096, 16384], 16384));
    let calls = journal.take();
    let frame = last_frame(&calls);
    assert_eq!(frame.iter().filter(|call| matches!(call, Call::FullBarrier { .. })).count(), 4);
    assert_eq!(frame.iter().filter(|call| matches!(call, Call::CopyImage { .. })).count(), 2);
    assert_eq!(frame.iter().filter(|call| **call == Call::CopiesToHost).count(), 1);
    finish(null, &journal);
}

fn give(bytes: &Arc<Vec<u8>>) -> FrameInputs {
    let buffers = [("frame.words".to_string(), BufferContents::Bytes(bytes.clone()))].into();
    FrameInputs { buffers, ..inputs() }
}

#[test]
fn contents_of_a_host_buffer_beyond_a_binding_are_a_limit_and_the_next_frame_is_drawn() {
    let mut config = Config::default();
    config.limits.facts.max_storage_bytes = 1 << 16;
    let (mut null, journal) = opened(&config);
    load(&mut null, with_host_buffer());
    let error = error_of(null.submit(&give(&Arc::new(vec![0; (1 << 16) + 4]))));
    assert!(matches!(error, BackendError::Limit(_)), "{error:?}");
    frame(&mut null, &give(&Arc::new(vec![0; 1 << 16])));
    finish(null, &journal);
}

#[test]
fn bindings_of_a_host_buffer_are_written_where_it_moves_or_changes_its_length_and_not_otherwise() {
    let (mut null, journal) = device();
    load(&mut null, with_host_buffer());
    let missing = error_of(null.submit(&inputs())).to_string();
    assert!(missing.contains("no contents for host buffer `frame.words`"), "{missing}");
    assert!(null.memory().iter().all(|(name, _)| name != "splats"), "it has no memory before its contents");
    let writes = |calls: &[Call]| -> Vec<(usize, Option<u64>)> {
        let write = |call: &Call| match call {
            Call::WriteBinding { copy, bytes, .. } => Some((*copy, *bytes)),
            _ => None,
        };
        calls.iter().filter_map(write).collect()
    };
    journal.take();
    let four = Arc::new(vec![0; 4]);
    for slot in [0, 1] {
        frame(&mut null, &give(&four));
        assert_eq!(writes(&journal.take()), [(slot, Some(4))]);
    }
    frame(&mut null, &give(&four));
    frame(&mut null, &give(&Arc::new(vec![1; 4])));
    assert_eq!(writes(&journal.take()), []);
    // Longer contents need a new buffer, whose size is a power of two.
    frame(&mut null, &give(&Arc::new(vec![0; 12])));
    let calls = journal.take();
    assert_eq!(writes(&calls), [(0, Some(12))]);
    assert_eq!(destroyed(&calls, Object::Buffer), ["splats"]);
    let allocates = |call: &Call| matches!(call, Call::Allocate { bytes: 16, .. });
    assert!(calls.iter().any(allocates));
    finish(null, &journal);
}

#[test]
fn a_shared_output_is_copied_in_order_and_kept_until_its_readers_are_done() {
    let (mut null, journal) = device();
    let mut reader = null.new_context().expect("there can be another");
    load(&mut null, plan());
    load(&mut reader, with_host_buffer());
    let shown = null.submit(&FrameInputs { show: true, ..inputs() }).expect("the frame is submitted");
    let calls = journal.take();
    let target = "picture".to_string();
    let copy = [
        Call::FullBarrier { images: Vec::new() },
        Call::CopyImage { image: "color".to_string(), target: target.clone() },
        Call::AfterCopy { target, range: 0..16384 },
    ];
    assert!(calls.windows(3).any(|three| three == copy));
    let picture = null.picture().expect("it was shared");
    let buffers = [("frame.words".to_string(), BufferContents::Picture(picture))];
    let reads = FrameInputs { buffers: buffers.into(), ..inputs() };
    let read = reader.submit(&reads).expect("the frame is submitted");
    null.wait(shown).expect("the frame is done");
    drop(null);
    let calls = journal.take();
    assert!(!destroyed(&calls, Object::Buffer).contains(&"picture"));
    reader.wait(read).expect("the frame is done");
    assert_eq!(destroyed(&journal.take(), Object::Buffer), ["picture"]);
    assert!(matches!(error_of(reader.submit(&reads)), BackendError::Invalid(_)));
    finish(reader, &journal);
}
