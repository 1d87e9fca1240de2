//! Tests results of `Once` passes that plans reuse from each other.

use crate::common::*;
use crate::testing::{ARGS, CAMERA, SPLATS, WORDS, plan};
use splatgraph_api::{Device, Inspect, Loader};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_null::{Call, Config, Journal, Null, Object};
use std::sync::Arc;

pub const SUMS: ResourceId = ResourceId(6);
const TABLE: ResourceId = ResourceId(7);

fn used(resource: ResourceId, accesses: Accesses) -> Use {
    Use { resource, stages: Stages::COMPUTE, accesses, layout: None, discards: false }
}

fn bound(name: &str, number: u32, resource: ResourceId) -> Binding {
    let kind = DescriptorKind::StorageBuffer;
    Binding { name: name.to_string(), binding: number, element: 0, kind, resource }
}

/// Builds the plan of the unit tests for an output that is `width` pixels wide, with two more prologue passes.
///
/// `sum` computes `sums` from the scene, and `fold` computes `table` from them. Frames read both.
pub fn folding(width: u32) -> Plan {
    let mut plan = plan();
    for (index, name) in ["sums", "table"].into_iter().enumerate() {
        let block = plan.blocks.len() as u32;
        plan.blocks.push(Block { aliases: vec![ResourceId(6 + index as u32)] });
        let mut resource = plan.resources[WORDS.index()].clone();
        resource.name = name.to_string();
        resource.shape = Shape::Buffer { stride: 4, count: 1 << 20 };
        resource.block = Some(BlockId(block));
        plan.resources.push(resource);
    }
    let mut fold = plan.shaders[0].clone();
    fold.spirv = Arc::new(vec![7; 5]);
    plan.shaders.push(fold);
    for (name, shader, from, to) in [("sum", 0, SPLATS, SUMS), ("fold", 3, SUMS, TABLE)] {
        let mut pass = plan.passes[1].clone();
        pass.name = name.to_string();
        pass.run = Run::Once;
        pass.work = Work::Dispatch { shader: ShaderId(shader), groups: Groups::Direct([64, 1, 1]) };
        pass.bindings = vec![bound("From", 0, from), bound("To", 1, to)];
        pass.uses = vec![used(from, Accesses::STORAGE_READ), used(to, Accesses::STORAGE_WRITE)];
        plan.prologue.push(PassId(plan.passes.len() as u32));
        plan.passes.push(pass);
    }
    // The frame writes the buffer that the prologue only clears.
    let read = Accesses::STORAGE_READ;
    plan.passes[1].uses = vec![used(WORDS, Accesses::STORAGE_WRITE), used(TABLE, read), used(SUMS, read)];
    let Shape::Image { width: pixels, .. } = &mut plan.resources[plan.output.index()].shape else {
        unreachable!("the output is an image")
    };
    *pixels = width;
    plan
}

pub fn load_sharing(null: &mut Null, plan: Plan, identity: u64) {
    let scene = Zeros { identity, ..Zeros::default() };
    let ready = null.loader().sharing_results().prepare(plan, &scene, &mut |_| {});
    null.swap(ready.expect("it is made ready")).expect("it is swapped in");
}

/// Runs the next frame. Returns the names of its prologue passes, and of the result buffers allocated since the last
/// call.
fn run(null: &mut Null, journal: &Journal) -> (Vec<String>, Vec<String>) {
    let former = journal.take();
    let allocated = former.iter().filter_map(|call| match call {
        Call::Allocate { name, .. } if ["sums", "table"].contains(&name.as_str()) => Some(name.clone()),
        _ => None,
    });
    let result = frame(null, &inputs());
    let plan = folding(64);
    let once = result.pass_ms.iter().map(|(id, _)| plan.pass(*id)).filter(|pass| pass.run == Run::Once);
    (once.map(|pass| pass.name.clone()).collect(), allocated.collect())
}

fn names<const N: usize>(names: [&str; N]) -> Vec<String> {
    names.map(str::to_string).into()
}

#[test]
fn a_resize_leaves_out_once_passes_whose_inputs_stayed_and_shares_their_buffers() {
    let (mut null, journal) = device();
    load_sharing(&mut null, folding(64), 1);
    let first = run(&mut null, &journal);
    assert_eq!(first, (names(["clear", "sum", "fold"]), names(["sums", "table"])));
    let alone = null.device_memory().used;
    // `clear` fills a buffer that the frame writes, so it runs again.
    load_sharing(&mut null, folding(65), 1);
    let (passes, allocated) = run(&mut null, &journal);
    assert_eq!((passes, allocated), (names(["clear"]), Vec::new()));
    // A full barrier comes first, because no barrier of this plan waits for the other plan.
    load_sharing(&mut null, folding(64), 1);
    journal.take();
    frame(&mut null, &inputs());
    let barrier = Call::FullBarrier { images: Vec::new() };
    assert!(last_frame(&journal.take()).contains(&barrier));
    // Later frames have no such barrier.
    frame(&mut null, &inputs());
    assert!(!last_frame(&journal.take()).contains(&barrier));
    assert_eq!(null.device_memory().used, alone, "one of each is left");
    let listed = null.memory();
    assert!(listed.contains(&("table".to_string(), 4 << 20)), "{listed:?}");
    finish(null, &journal);
}

#[test]
fn two_plans_at_a_time_take_the_memory_of_their_shared_results_once() {
    let (mut null, journal) = device();
    load_sharing(&mut null, folding(64), 1);
    frame(&mut null, &inputs());
    let before = null.device_memory().used;
    let ready = null.loader().sharing_results().prepare(folding(64), &zeros(1), &mut |_| {});
    let shared = null.device_memory().used - before;
    drop(ready);
    let ready = null.loader().prepare(folding(64), &zeros(1), &mut |_| {});
    assert_eq!(null.device_memory().used - before, shared + (8 << 20), "without sharing, both tables more");
    drop(ready);
    // The budget has room for one copy of each result, because shared results count once.
    let limit = before + shared + (1 << 20);
    let (mut tight, _) = opened(&Config { budget: Some(limit), ..Config::default() });
    load_sharing(&mut tight, folding(64), 1);
    frame(&mut tight, &inputs());
    load_sharing(&mut tight, folding(65), 1);
    let error = error_of(tight.loader().prepare(folding(64), &zeros(1), &mut |_| {}).map(drop));
    assert!(error.to_string().starts_with("out of memory"), "{error}");
    finish(null, &journal);
}

fn zeros(identity: u64) -> Zeros {
    Zeros { identity, ..Zeros::default() }
}

#[test]
fn contexts_of_one_device_share_results() {
    let (mut null, journal) = device();
    load_sharing(&mut null, folding(64), 1);
    frame(&mut null, &inputs());
    let mut beside = null.new_context().expect("there can be another");
    journal.take();
    load_sharing(&mut beside, folding(64), 1);
    assert_eq!(run(&mut beside, &journal), (names(["clear"]), Vec::new()));
    // The results outlive the plan that computed them.
    drop(null);
    load_sharing(&mut beside, folding(64), 1);
    assert_eq!(run(&mut beside, &journal), (names(["clear"]), Vec::new()));
    finish(beside, &journal);
}

#[test]
fn results_are_computed_again_where_anything_that_they_depend_on_differs() {
    type Alteration = fn(&mut Plan);
    let all: Vec<String> = names(["clear", "sum", "fold"]);
    let some: Vec<String> = names(["clear", "fold"]);
    let alterations: [(&str, Alteration, &[String]); 12] = [
        ("the code of the first pass", |plan| plan.shaders[0].spirv = Arc::new(vec![1]), &all),
        ("the code of the second pass", |plan| plan.shaders[3].spirv = Arc::new(vec![1]), &some),
        ("push constants", |plan| plan.passes[6].push[0] = 1, &all),
        (
            "the number of workgroups",
            |plan| {
                plan.passes[7].work =
                    Work::Dispatch { shader: ShaderId(3), groups: Groups::Direct([65, 1, 1]) };
            },
            &some,
        ),
        ("bindings", |plan| plan.passes[7].bindings[0].binding = 2, &some),
        (
            "the size of the result",
            |plan| plan.resources[TABLE.index()].shape = Shape::Buffer { stride: 4, count: 1 << 10 },
            &some,
        ),
        (
            "a use that it was not made for",
            |plan| plan.resources[TABLE.index()].usage |= Usage::UNIFORM,
            &some,
        ),
        ("a frame that writes it", |plan| plan.passes[1].uses[1].accesses |= Accesses::STORAGE_WRITE, &some),
        (
            "an input that the frame writes",
            |plan| plan.passes[1].uses[1] = used(SUMS, Accesses::STORAGE_WRITE),
            &names(["clear", "sum"]),
        ),
        (
            "an input that comes with each frame",
            |plan| plan.passes[7].bindings.push(bound("Camera", 2, CAMERA)),
            &some,
        ),
        ("an input without contents", |plan| plan.passes[7].bindings.push(bound("Args", 2, ARGS)), &some),
        ("a history", |plan| plan.resources[TABLE.index()].history = Some("table".to_string()), &some),
    ];
    for (what, alter, expected) in alterations {
        let (mut null, journal) = device();
        load_sharing(&mut null, folding(64), 1);
        frame(&mut null, &inputs());
        let mut altered = folding(64);
        alter(&mut altered);
        load_sharing(&mut null, altered, 1);
        assert_eq!(run(&mut null, &journal).0, expected, "{what}");
        finish(null, &journal);
    }
    let (mut null, journal) = device();
    load_sharing(&mut null, folding(64), 1);
    frame(&mut null, &inputs());
    load_sharing(&mut null, folding(64), 2);
    assert_eq!(run(&mut null, &journal).0, all, "another scene");
    load(&mut null, folding(64));
    assert_eq!(run(&mut null, &journal).0, all, "a measurement");
    finish(null, &journal);
}

#[test]
fn a_result_is_not_there_before_its_frame_was_submitted() {
    let (mut null, journal) = device();
    load_sharing(&mut null, folding(64), 1);
    load_sharing(&mut null, folding(64), 1);
    assert_eq!(run(&mut null, &journal).0, names(["clear", "sum", "fold"]));
    load_sharing(&mut null, folding(64), 1);
    let inspect = vec![Inspect { resource: TABLE, after: PassId(7) }];
    let error = error_of(null.submit(&splatgraph_api::FrameInputs { inspect, ..inputs() }));
    assert!(error.to_string().contains("does not run in this frame"), "{error}");
    assert!(journal.alive().contains_key(&Object::Buffer));
    finish(null, &journal);
}
