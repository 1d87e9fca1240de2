//! Tests buffers that only the prologue uses. They are freed after it, omitted if its results are reused, and in host
//! memory if device memory is short.

use crate::common::*;
use crate::results::{SUMS, folding, load_sharing};
use crate::testing::{SPLATS, WORDS, plan};
use splatgraph_api::{Device, FrameInputs, Inspect};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_null::{Call, Config, Null, Object, limits};
use splatgraph_runtime::{Limits, Location};

/// Size of `splats` in bytes. [`SUM_BYTES`] is the size of `sums`, and of the `table` computed from them. Only the
/// prologue uses `splats` and `sums` here.
const SPLAT_BYTES: u64 = 8 << 20;
const SUM_BYTES: u64 = 4 << 20;

/// Builds a plan that computes a table from the scene. Frames read neither the scene nor the intermediate sums.
pub fn packing() -> Plan {
    let mut plan = folding(64);
    plan.resources[SPLATS.index()].shape = Shape::Buffer { stride: 4, count: SPLAT_BYTES / 4 };
    for pass in &mut plan.passes[1..4] {
        pass.bindings.retain(|binding| binding.resource != SPLATS);
        pass.uses.retain(|used| used.resource != SUMS);
    }
    plan
}

/// Builds the plan of [`packing`] with a second import of the plane, for the same pass.
fn importing_twice() -> Plan {
    let mut plan = packing();
    let again = ResourceId(plan.resources.len() as u32);
    plan.resources.push(Resource { name: "again".to_string(), ..plan.resources[SPLATS.index()].clone() });
    let sum = &mut plan.passes[6];
    sum.bindings.push(Binding { binding: 2, resource: again, ..sum.bindings[0].clone() });
    sum.uses.push(Use { resource: again, ..sum.uses[0] });
    plan
}

fn listed(null: &Null) -> u64 {
    null.memory().iter().map(|(_, bytes)| bytes).sum()
}

fn lists(null: &Null, name: &str) -> bool {
    null.memory().iter().any(|(listed, _)| listed == name)
}

#[test]
fn what_only_the_prologue_uses_is_freed_when_its_frame_is_done_and_not_before() {
    let (mut null, journal) = device();
    load(&mut null, packing());
    let loaded = null.device_memory().used;
    assert_eq!(listed(&null), loaded);
    let first = submit(&mut null);
    let second = submit(&mut null);
    assert!(lists(&null, "splats") && lists(&null, "sums") && null.device_memory().used == loaded);
    null.wait(first).expect("the frame is done");
    assert_eq!(null.device_memory().used, loaded - SPLAT_BYTES - SUM_BYTES);
    assert_eq!(listed(&null), null.device_memory().used);
    assert!(!lists(&null, "splats") && !lists(&null, "sums") && lists(&null, "table"));
    let calls = journal.take();
    let freed = destroyed(&calls, Object::Memory);
    assert!(freed.contains(&"splats") && freed.contains(&"sums"), "{freed:?}");
    null.wait(second).expect("the frame is done");
    frame(&mut null, &inputs());
    finish(null, &journal);
}

#[test]
fn planes_that_frames_read_stay() {
    let (mut null, journal) = device();
    load(&mut null, plan());
    let loaded = null.device_memory().used;
    frame(&mut null, &inputs());
    assert_eq!(null.device_memory().used, loaded);
    assert!(plan().used_once().is_empty());
    let mut counted = packing();
    assert_eq!(counted.used_once().into_iter().collect::<Vec<_>>(), [SPLATS, SUMS]);
    counted.stats[0].buffer = SUMS;
    assert!(!counted.used_once().contains(&SUMS), "the export reads it in every frame");
    let mut kept = packing();
    kept.resources[SUMS.index()].history = Some("sums".to_string());
    assert!(!kept.used_once().contains(&SUMS), "the next plan may go on from it");
    finish(null, &journal);
}

#[test]
fn a_new_plan_uploads_again_unless_it_takes_over_all_that_was_made_of_the_scene() {
    let (mut null, journal) = device();
    let scene = Zeros::default();
    null.load(packing(), &scene, &mut |_| {}).expect("the plan loads");
    frame(&mut null, &inputs());
    let resident = null.device_memory().used;
    null.load(packing(), &scene, &mut |_| {}).expect("the plan loads");
    assert_eq!(scene.asked(), 2);
    let result = frame(&mut null, &inputs());
    let once = |(id, _): &&(PassId, Option<f64>)| packing().pass(*id).run == Run::Once;
    assert_eq!(result.pass_ms.iter().filter(once).count(), 3, "`clear`, `sum` and `fold` run");
    assert_eq!(null.device_memory().used, resident);
    load_sharing(&mut null, packing(), 0);
    let result = frame(&mut null, &inputs());
    assert_eq!(result.pass_ms.iter().filter(once).count(), 1, "`clear` alone runs");
    assert_eq!(null.device_memory().used, resident);
    let mut altered = packing();
    altered.passes[7].push[0] = 1;
    load_sharing(&mut null, altered, 0);
    let result = frame(&mut null, &inputs());
    assert_eq!(result.pass_ms.iter().filter(once).count(), 3, "the sums are gone");
    finish(null, &journal);
}

#[test]
fn what_is_freed_cannot_be_inspected_later() {
    let (mut null, journal) = device();
    load(&mut null, packing());
    let splats = |after| FrameInputs { inspect: vec![Inspect { resource: SPLATS, after }], ..inputs() };
    frame(&mut null, &splats(PassId(6)));
    let error = error_of(null.submit(&splats(PassId(1)))).to_string();
    assert!(error.contains("only passes that run once use it, and it is freed after them"), "{error}");
    frame(&mut null, &inputs());
    finish(null, &journal);
}

#[test]
fn without_room_for_what_is_freed_it_lies_in_the_memory_of_the_host() {
    let all = packing().transient_bytes() + SPLAT_BYTES;
    let budget = |room| Config { budget: Some(room), ..Config::default() };
    // Without a budget, the heap counts.
    let heap = |heap_bytes| Config { limits: Limits { heap_bytes, ..limits() }, ..Config::default() };
    for (config, plan, place) in [
        (budget(all), packing(), Location::Device),
        (budget(all), importing_twice(), Location::Device),
        (budget(all - 1), packing(), Location::Host),
        (budget(all - 1), importing_twice(), Location::Host),
        (heap(all), packing(), Location::Device),
        (heap(all - 1), importing_twice(), Location::Host),
    ] {
        let (mut null, journal) = opened(&config);
        load(&mut null, plan);
        let placed = |call: &Call| match call {
            Call::Allocate { name, location, .. } if name == "splats" => Some(*location),
            _ => None,
        };
        assert_eq!(journal.take().iter().filter_map(placed).collect::<Vec<_>>(), [place]);
        frame(&mut null, &inputs());
        // A plan that reads the plane in every frame must not find it in host memory.
        let (mut other, scene) = (null.new_context().expect("there can be another"), Zeros::default());
        let mut reads = self::plan();
        reads.resources[SPLATS.index()].shape = Shape::Buffer { stride: 4, count: 1 << 10 };
        other.load(reads, &scene, &mut |_| {}).expect("the plan loads");
        assert_eq!(scene.asked(), 1);
        drop(other);
        finish(null, &journal);
    }
    let needed = packing().transient_bytes();
    let (mut null, journal) = opened(&Config { budget: Some(needed - 1), ..Config::default() });
    let error = error_of(null.load(packing(), &Zeros::default(), &mut |_| {})).to_string();
    assert!(error.starts_with("out of memory for the plan `test`"), "{error}");
    finish(null, &journal);
    assert!(!packing().used_once().contains(&WORDS));
}
