//! Tests plan changes: nothing waits, histories continue, and objects live as long as the frames that use them.

use crate::common::*;
use crate::testing::{COLOR, WORDS, plan};
use splatgraph_api::{Device, FrameInputs, Inspect, Loader as _};
use splatgraph_framework::ir::*;
use splatgraph_null::{Call, Null, Object};

pub fn started(calls: &[Call]) -> Vec<&str> {
    fn name(call: &Call) -> Option<&str> {
        match call {
            Call::Fill { buffer: name, value: 0 } | Call::Clear { image: name } => Some(name),
            _ => None,
        }
    }
    last_frame(calls).iter().filter_map(name).collect()
}

#[test]
fn a_swap_waits_for_nothing_and_the_former_plan_goes_with_its_last_frame() {
    let (mut null, journal) = device();
    load(&mut null, histories());
    let frames = [submit(&mut null), submit(&mut null)];
    journal.take();
    load(&mut null, histories());
    let calls = journal.take();
    // The scene's planes are on the device: nothing is uploaded, and nothing waits.
    assert_eq!(waits(&calls), 0);
    assert_eq!(destroyed(&calls, Object::Pipelines), Vec::<&str>::new());
    null.wait(frames[1]).expect("the frame is done");
    assert_eq!(destroyed(&journal.take(), Object::Pipelines), Vec::<&str>::new());
    null.wait(frames[0]).expect("the frame is done");
    assert_eq!(destroyed(&journal.take(), Object::Pipelines), ["test"]);
    finish(null, &journal);
}

#[test]
fn histories_go_on_where_nothing_but_the_plan_changed() {
    let (mut null, journal) = device();
    load(&mut null, histories());
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), ["words", "color"]);
    load(&mut null, histories());
    frame(&mut null, &inputs());
    let calls = journal.take();
    assert_eq!(started(&calls), Vec::<&str>::new());
    // The barrier makes the frame wait for earlier frames. It moves the image to the layout in which its clear would
    // have left it.
    let images = vec![("color".to_string(), Layout::TransferSource, Layout::TransferTarget)];
    assert!(last_frame(&calls).contains(&Call::FullBarrier { images }));
    // Of the clear's layout change, only the execution dependency remains.
    assert!(last_frame(&calls).contains(&Call::Synchronize { dependencies: 0, images: Vec::new() }));
    assert_eq!(destroyed(&calls, Object::Image), ["color"]);
    let ready = null.loader().clearing_histories().prepare(histories(), &Zeros::default(), &mut |_| {});
    null.swap(ready.expect("it is prepared")).expect("it is swapped in");
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), ["words", "color"]);
    finish(null, &journal);
}

#[test]
fn a_plan_can_start_with_the_histories_before_the_last_frame_of_the_one_before() {
    let (mut null, journal) = device();
    let saving = FrameInputs { save_histories: true, ..inputs() };
    let position = |calls: &[Call], is: fn(&Call) -> bool| calls.iter().position(is);
    load(&mut null, histories());
    for first in [true, false] {
        frame(&mut null, &saving);
        let calls = journal.take();
        assert_eq!(started(&calls).is_empty(), !first);
        // The copies come after the passes that run once, and before those of the frame.
        let calls = last_frame(&calls);
        let cleared = position(calls, |call| matches!(call, Call::Clear { .. }));
        let copied =
            position(calls, |call| matches!(call, Call::CopyToImage { image, .. } if image == "color"));
        let words =
            |call: &Call| matches!(call, Call::CopyBuffer { target: (name, 0), .. } if name == "words");
        let drawn = position(calls, |call| matches!(call, Call::Draw { .. } | Call::DrawIndirect { .. }));
        assert!(cleared < copied && copied < drawn && position(calls, words).is_some(), "{calls:?}");
    }
    for _ in 0..2 {
        let ready = null.loader().restoring_histories().prepare(histories(), &Zeros::default(), &mut |_| {});
        null.swap(ready.expect("it is prepared")).expect("it is swapped in");
        frame(&mut null, &saving);
        let calls = journal.take();
        assert_eq!(started(&calls), ["words", "color"]);
        // The copies come back after the passes that run once, and are made again. That of the image is still in the
        // layout of a copy's target.
        let [source, target] = [Layout::TransferSource, Layout::TransferTarget];
        let images =
            [(target, source), (source, target)].map(|(old, new)| ("color".to_string(), old, new)).into();
        let back = position(last_frame(&calls), |call| matches!(call, Call::CopyToImage { .. }));
        let barrier = Call::FullBarrier { images };
        let barrier = last_frame(&calls).iter().position(|call| *call == barrier);
        assert!(barrier.is_some() && barrier < back, "{calls:?}");
        let copied = last_frame(&calls).iter().filter(|call| matches!(call, Call::CopyToImage { .. }));
        assert_eq!(copied.count(), 2);
        // The image of the plan before, and its copy.
        assert_eq!(destroyed(&calls, Object::Image), ["color", "color"]);
    }
    // Without a frame that saved them, there is nothing to restore.
    for _ in 0..2 {
        load(&mut null, histories());
        frame(&mut null, &inputs());
        assert_eq!(started(&journal.take()), Vec::<&str>::new());
    }
    let ready = null.loader().restoring_histories().prepare(histories(), &Zeros::default(), &mut |_| {});
    null.swap(ready.expect("it is prepared")).expect("it is swapped in");
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), ["words", "color"]);
    finish(null, &journal);
}

#[test]
fn a_frame_that_is_not_submitted_saves_no_histories() {
    let (mut null, journal) = device();
    load(&mut null, histories());
    let inspect = vec![Inspect { resource: WORDS, after: PassId(99) }];
    null.submit(&FrameInputs { save_histories: true, inspect, ..inputs() })
        .expect_err("there is no such pass");
    let ready = null.loader().restoring_histories().prepare(histories(), &Zeros::default(), &mut |_| {});
    null.swap(ready.expect("it is prepared")).expect("it is swapped in");
    frame(&mut null, &inputs());
    assert!(!journal.take().contains(&Call::PushLabel("restore state".to_string())));
    finish(null, &journal);
}

#[test]
fn a_history_starts_from_zeros_where_its_name_shape_scene_neighbours_or_uses_differ() {
    type Alteration = fn(&mut splatgraph_framework::plan::Plan);
    let cases: [(&str, &str, Alteration); 5] = [
        ("words", "name", |plan| plan.resources[WORDS.index()].history = Some("other".to_string())),
        ("words", "shape", |plan| {
            plan.resources[WORDS.index()].shape = Shape::Buffer { stride: 4, count: 1025 };
        }),
        ("color", "use", |plan| plan.resources[COLOR.index()].usage |= Usage::STORAGE),
        ("words", "neighbours", |plan| {
            // `args` moves into the block of `words`.
            plan.blocks[0].aliases.push(crate::testing::ARGS);
            plan.blocks[1].aliases.clear();
            plan.resources[crate::testing::ARGS.index()].block = Some(BlockId(0));
        }),
        ("words", "history", |plan| {
            plan.resources[WORDS.index()].history = None;
            plan.passes[0].work = Work::Fill { buffer: WORDS, value: 0 };
        }),
    ];
    for (name, what, alter) in cases {
        let (mut null, journal) = device();
        load(&mut null, histories());
        frame(&mut null, &inputs());
        let mut altered = histories();
        alter(&mut altered);
        load(&mut null, altered);
        frame(&mut null, &inputs());
        assert_eq!(started(&journal.take()), [name], "another {what}");
        load(&mut null, histories());
        frame(&mut null, &inputs());
        // An image that allows more than the plan needs continues.
        let back: &[&str] = if what == "use" { &[] } else { &[name] };
        assert_eq!(started(&journal.take()), back, "back from another {what}");
        finish(null, &journal);
    }
    let (mut null, journal) = device();
    load(&mut null, histories());
    frame(&mut null, &inputs());
    let scene = Zeros { identity: 1, ..Zeros::default() };
    null.load(histories(), &scene, &mut |_| {}).expect("the plan loads");
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), ["words", "color"], "another scene");
    finish(null, &journal);
}

#[test]
fn what_a_pass_writes_once_and_frames_change_starts_anew_unless_only_capacities_change() {
    let seeded = |history: bool| {
        let mut plan = histories();
        let write = Use {
            resource: WORDS,
            stages: Stages::CLEAR,
            accesses: Accesses::TRANSFER_WRITE,
            layout: None,
            discards: false,
        };
        plan.passes.push(Pass {
            name: "seed".to_string(),
            work: Work::Fill { buffer: WORDS, value: 7 },
            uses: vec![write],
            ..plan.passes[0].clone()
        });
        let pass = PassId(plan.passes.len() as u32 - 1);
        plan.prologue.push(pass);
        if !history {
            plan.resources[WORDS.index()].history = None;
            plan.passes[0].work = Work::Fill { buffer: WORDS, value: 0 };
            let scan = plan.frame[0];
            plan.passes[scan.index()].uses = plan.passes[pass.index()].uses.clone();
        }
        plan
    };
    for history in [true, false] {
        let (mut null, journal) = device();
        load(&mut null, seeded(history));
        assert_eq!(frame(&mut null, &inputs()).pass_ms.len(), 7);
        assert_eq!(started(&journal.take()), ["words", "color"]);
        load(&mut null, seeded(history));
        // The image's start is left out, and the rest of the prologue runs.
        assert_eq!(frame(&mut null, &inputs()).pass_ms.len(), 6);
        let calls = journal.take();
        assert_eq!(started(&calls), ["words"]);
        let seed = Call::Fill { buffer: "words".to_string(), value: 7 };
        let is_copy =
            |call: &Call| matches!(call, Call::CopyBuffer { target: (name, 0), .. } if name == "words");
        assert!(last_frame(&calls).contains(&seed) && !last_frame(&calls).iter().any(is_copy));
        // A plan that is replaced before its first frame hands on what it took over.
        for _ in 0..2 {
            let ready =
                null.loader().keeping_state().prepare(seeded(history), &Zeros::default(), &mut |_| {});
            null.swap(ready.expect("it is prepared")).expect("it is swapped in");
        }
        frame(&mut null, &inputs());
        let calls = journal.take();
        assert_eq!(started(&calls), ["words", "color"]);
        let at = |is: &dyn Fn(&Call) -> bool| last_frame(&calls).iter().position(is);
        assert!(at(&|call| *call == seed) < at(&is_copy) && at(&is_copy).is_some(), "{calls:?}");
        finish(null, &journal);
    }
}

#[test]
fn a_history_that_a_pass_reads_once_starts_from_zeros_with_each_plan() {
    let read = || {
        let mut plan = histories();
        let read = Use {
            resource: WORDS,
            stages: Stages::COMPUTE,
            accesses: Accesses::STORAGE_READ,
            layout: None,
            discards: false,
        };
        let peek = Pass { name: "peek".to_string(), uses: vec![read], ..plan.pass(plan.frame[0]).clone() };
        plan.passes.push(peek);
        let pass = PassId(plan.passes.len() as u32 - 1);
        plan.prologue.push(pass);
        plan
    };
    let (mut null, journal) = device();
    for started_anew in [vec!["words", "color"], vec!["words"]] {
        load(&mut null, read());
        frame(&mut null, &inputs());
        assert_eq!(started(&journal.take()), started_anew);
    }
    finish(null, &journal);
}

#[test]
fn a_plan_that_never_ran_hands_on_the_histories_that_it_took_over() {
    let (mut null, journal) = device();
    load(&mut null, histories());
    load(&mut null, histories());
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), ["words", "color"]);
    load(&mut null, histories());
    load(&mut null, histories());
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), Vec::<&str>::new());
    finish(null, &journal);
}

#[test]
fn a_plan_made_ready_on_another_thread_goes_on_from_the_one_that_is_current_when_it_is_swapped_in() {
    let (mut null, journal) = device();
    load(&mut null, plan());
    let loader = null.loader();
    let thread = std::thread::spawn(move || loader.prepare(histories(), &Zeros::default(), &mut |_| {}));
    let ready = thread.join().expect("it ends well").expect("it is made ready");
    load(&mut null, histories());
    submit(&mut null);
    journal.take();
    null.swap(ready).expect("it becomes the current plan");
    frame(&mut null, &inputs());
    assert_eq!(started(&journal.take()), Vec::<&str>::new());
    let ready = null.loader().prepare(plan(), &Zeros::default(), &mut |_| {}).expect("it is made ready");
    let mut other: Null = null.new_context().expect("there can be another");
    assert!(error_of(other.swap(ready)).to_string().contains("another executor"));
    drop(other);
    finish(null, &journal);
}

#[test]
fn many_swaps_leave_nothing_behind() {
    let (mut null, journal) = device();
    load(&mut null, histories());
    frame(&mut null, &inputs());
    let (objects, bytes) = (journal.alive(), null.device_memory().used);
    for _ in 0..100 {
        // A plan that is replaced before its first frame leaves nothing either.
        load(&mut null, plan());
        load(&mut null, histories());
        submit(&mut null);
        submit(&mut null);
        assert!(journal.alive()[&Object::Pipelines] <= 3, "two former plans have frames in flight");
    }
    frame(&mut null, &inputs());
    frame(&mut null, &inputs());
    assert_eq!((journal.alive(), null.device_memory().used), (objects, bytes));
    finish(null, &journal);
}
