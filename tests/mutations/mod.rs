//! Mutations of the built-in graphs. Each barrier of their plans is removed, and each bit of its masks cleared, one at
//! a time. The same is done to every dependency; the check of dependencies must notice.
//!
//! There are three judges. The longest [`chain`] of a frame is the minimum number of calls. The model of the Vulkan
//! backend must accept each plan and object to each mutant, so that nothing is missing or needless. The validation
//! layer, which knows neither, must be silent about the plan and report each mutant, unless the mistake is in one of
//! its blind spots ([`layer`]).

use splatgraph::draw::backend::{self, Api};
use splatgraph::draw::builtin;
use splatgraph::draw::camera;
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::Planner;
use splatgraph_api::{Device, FRAMES_IN_FLIGHT, FrameInputs, Loader};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::{DeviceFacts, Hazard, PassId, Stages, Work};
use splatgraph_framework::oracle::dependencies;
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::sync::model::mutate::{Mutation, apply, mutations, needless, needless_by};
use splatgraph_vulkan::sync::model::{Replay, Rules, replay};
use splatgraph_vulkan::sync::{Barrier, Barriers};
use splatgraph_vulkan::{Validation, Vulkan};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::LazyLock;
use std::time::Instant;

use crate::common::{self, Upload, say};
use crate::random::builds;
use crate::random::gpu::compares_submissions;
use layer::{Blind, Layer};

mod chain;
mod layer;

const SIZE: (u32, u32) = (64, 36);

/// Frames drawn with each mutant: one with the prologue and two more, so that per-frame copies are reused.
const FRAMES: u32 = 3;

fn scene() -> Scene {
    splatgraph_assets::synth::generate("demo", 500, 1).expect("a generator")
}

fn plans(scene: &Scene, device: &DeviceFacts) -> Vec<Plan> {
    let facts = facts::facts(&SceneFacts::of(scene), device, SIZE);
    let (catalog, mut planner) = (facts::catalog(scene), Planner::default());
    let plan = |name| planner.plan(name, &[], &facts, &catalog).unwrap_or_else(|e| panic!("{e}"));
    builtin::names().into_iter().map(plan).collect()
}

static PORTABLE: LazyLock<Vec<Plan>> =
    LazyLock::new(|| plans(&scene(), &facts::portable_device(facts::USUAL_SUBGROUP_SIZE)));

#[test]
fn no_barrier_of_a_preset_is_missing_or_needless_and_no_call_is_one_too_many() {
    say(
        "plans: preset, passes, barriers (memory + image), calls of a frame, links of its longest chain, links by data alone, mutants",
    );
    let mut wrong = Vec::new();
    for plan in &*PORTABLE {
        let barriers = builds::barriers(plan);
        let all: Vec<&Barrier> = barriers.calls(plan).flat_map(|(_, call)| call).collect();
        let images = all.iter().filter(|barrier| barrier.image.is_some()).count();
        let calls = chain::calls(plan, &barriers);
        let flow = chain::longest(plan, chain::reads_what_was_written).len() - 1;
        let bound = chain::least_calls(plan);
        say(&format!(
            "plans: {:22} {:3} {:3} + {:2} {:4} {:4} {:4} {:5}",
            plan.name,
            plan.passes.len(),
            all.len() - images,
            images,
            calls,
            bound,
            flow,
            mutations(plan, &barriers).len()
        ));
        for objection in dependencies(plan) {
            wrong.push(format!("{}: {}", plan.name, objection.describe(plan)));
        }
        for violation in replay(plan, &barriers, &Replay::default()) {
            wrong.push(format!("{}: {}", plan.name, violation.describe(plan)));
        }
        for mutation in needless(plan, &barriers) {
            wrong.push(format!("{}: needless: {}", plan.name, mutation.describe(plan, &barriers)));
        }
        // In `stale_order`, drawing does not wait for the sort. So `compose`, `export` and `host` could share the
        // sort's calls, but they are recorded after it, with one call each.
        let spare = if plan.name == "stale_order" { 3 } else { 0 };
        if calls < bound || calls > bound + spare {
            let chain = chain::longest(plan, chain::conflicts).join(", ");
            let shown = builds::shown(plan);
            wrong.push(format!(
                "{}: {calls} calls, expected {bound} for the links of {chain}\n{shown}",
                plan.name
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_table_of_barriers_has_the_counts_of_every_preset() {
    let page = include_str!("../../docs/barriers.md");
    let (_, table) = page.split_once("| preset | passes | memory barriers |").expect("the table is there");
    let mut counts = BTreeMap::new();
    for row in table.lines().skip(2).take_while(|line| line.starts_with('|')) {
        let (names, rest) = row[1..].split_once('|').expect("two cells");
        counts.extend(names.split('`').skip(1).step_by(2).map(|name| (name, rest)));
    }
    let (facts, catalog) =
        (common::facts_of(&facts::portable_device(facts::USUAL_SUBGROUP_SIZE)), common::catalog());
    let mut planner = Planner::default();
    let mut wrong = Vec::new();
    for name in builtin::names() {
        let plan = planner.plan(name, &[], &facts, &catalog).unwrap_or_else(|e| panic!("{e}"));
        let totals = backend::dump(&plan).totals;
        let (passes, frame, least) = (totals.frame_passes, totals.frame, chain::least_calls(&plan));
        let expected = format!(
            " {passes} | {} | {} | {} | {least} |",
            frame.memory_barriers, frame.image_barriers, frame.calls
        );
        if counts.remove(name) != Some(&expected) {
            wrong.push(format!("| `{name}` |{expected}"));
        }
    }
    assert!(wrong.is_empty(), "docs/barriers.md, last table: expected these rows:\n{}", wrong.join("\n"));
    assert!(counts.is_empty(), "docs/barriers.md, last table: no preset has one of these names: {counts:?}");
}

#[test]
fn a_dependency_of_a_preset_that_is_removed_or_has_a_bit_cleared_is_missed() {
    let (mut mutants, mut unnoticed) = (0, Vec::new());
    for plan in &*PORTABLE {
        let mut mutant = plan.clone();
        let mut missed = |mutant: &Plan, index: usize, what: &str| {
            mutants += 1;
            if dependencies(mutant).is_empty() {
                unnoticed.push(format!("{}: {what} of {:?}", plan.name, plan.dependencies[index]));
            }
        };
        for (index, whole) in plan.dependencies.iter().enumerate() {
            let removed = mutant.dependencies.remove(index);
            missed(&mutant, index, "all");
            mutant.dependencies.insert(index, removed);
            // If only the layout change waits, the dependency's target masks are not checked.
            let change_alone = whole.hazard == Hazard::LayoutChange;
            let masks = if change_alone { whole.masks.source() } else { whole.masks };
            for bit in masks.bits() {
                mutant.dependencies[index].masks = whole.masks.without(bit);
                missed(&mutant, index, &format!("{bit:?}"));
                mutant.dependencies[index] = whole.clone();
            }
            if whole.changes_layout {
                mutant.dependencies[index].changes_layout = false;
                missed(&mutant, index, "the layout change");
                mutant.dependencies[index] = whole.clone();
            }
        }
    }
    say(&format!("plans: {mutants} mutants of dependencies"));
    assert!(unnoticed.is_empty(), "{}", unnoticed.join("\n"));
}

#[test]
fn what_waits_for_the_arguments_of_a_draw_names_a_stage_of_drawing() {
    const DRAWING: Stages =
        Stages::INDIRECT.union(Stages::VERTEX).union(Stages::FRAGMENT).union(Stages::COLOR_OUTPUT);
    let scene = scene();
    let device = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
    let facts = facts::facts(&SceneFacts::of(&scene), &device, SIZE);
    let (catalog, mut planner) = (facts::catalog(&scene), Planner::default());
    let settings = [
        ("sort", "false"),
        ("order_of", "last_frame"),
        ("blend", "front_to_back"),
        ("blend", "front_to_back_naive"),
        ("blend", "back_to_front"),
    ];
    let mut waits = 0;
    for (name, value) in settings {
        let set = [(name.to_string(), value.to_string())];
        let plan = planner.plan("splat", &set, &facts, &catalog).unwrap_or_else(|e| panic!("{e}"));
        let draws = |id: &PassId| matches!(plan.pass(*id).work, Work::Draw { .. });
        let args = plan.find_resource("order.args").expect("the draw has arguments");
        let barriers = builds::barriers(&plan);
        for barrier in barriers.calls(&plan).flat_map(|(_, call)| call) {
            let after_draw = barrier.causes.iter().any(|(cause, _)| {
                cause.resource == args
                    && cause.hazard == Hazard::WriteAfterRead
                    && cause.after.iter().any(draws)
            });
            if after_draw {
                waits += 1;
                assert!(
                    barrier.masks.source_stages.intersects(DRAWING),
                    "{name}={value}\n{}",
                    builds::shown(&plan)
                );
            }
        }
        assert_eq!(replay(&plan, &barriers, &Replay::default()), [], "{name}={value}");
        assert_eq!(needless(&plan, &barriers), [], "{name}={value}");
    }
    assert!(waits > 0, "no barrier is for the arguments of a draw");
}

/// Counts the write accesses among the barriers' targets, and those removable if write-after-write needed only
/// availability.
pub fn target_writes(plan: &Plan) -> (usize, usize) {
    let barriers = builds::barriers(plan);
    let all = mutations(plan, &barriers).into_iter().filter(Mutation::clears_a_written_target).count();
    let spare = needless_by(plan, &barriers, Rules::AVAILABILITY);
    (all, spare.iter().filter(|mutation| mutation.clears_a_written_target()).count())
}

#[test]
fn target_writes_of_presets_that_could_go_by_availability_alone_are_counted() {
    say("availability: preset, target writes, could go");
    let (mut all, mut spare) = (0, 0);
    for plan in &*PORTABLE {
        let (here, could_go) = target_writes(plan);
        say(&format!("availability: {:22} {here:4} {could_go:4}", plan.name));
        (all, spare) = (all + here, spare + could_go);
    }
    say(&format!("availability: {:22} {all:4} {spare:4}", "all"));
    assert!(all > 0);
    assert_eq!(spare, all, "docs/barriers.md says that all could go");
}

struct Bench {
    device: Vulkan,
    scene: Scene,
    camera: Camera,
    loads: u64,
}

impl Bench {
    fn new() -> Bench {
        let scene = scene();
        let camera = Camera::framing(&scene, SIZE.0, SIZE.1);
        let device = Vulkan::open(&common::options(Validation::Synchronization))
            .unwrap_or_else(|error| panic!("the tests need lavapipe and the validation layers: {error}"));
        Bench { device, scene, camera, loads: 0 }
    }

    /// Draws [`FRAMES`] frames of a plan with these barriers and returns the layer's messages.
    fn messages(&mut self, plan: &Plan, barriers: Barriers) -> Vec<String> {
        self.loads += 1;
        // A new identity for every plan, so that no history continues and every prologue runs.
        let upload = Upload(&self.scene, self.loads);
        let loader = self.device.loader().synchronized_by(barriers);
        let ready = loader.prepare(plan.clone(), &upload, &mut |_| {}).expect("the plan is made ready");
        self.device.swap(ready).expect("the plan is loaded");
        let mut in_flight = VecDeque::new();
        for frame in 0..FRAMES {
            if in_flight.len() == FRAMES_IN_FLIGHT {
                self.device.wait(in_flight.pop_front().expect("a frame")).expect("drawn");
            }
            let inputs = FrameInputs {
                uniforms: camera::frame_uniforms(&self.camera, &self.scene.bounds(), [0.0; 3], frame),
                live: plan.live_bytes(),
                read_output: true,
                ..FrameInputs::default()
            };
            in_flight.push_back(self.device.submit(&inputs).expect("submitted"));
        }
        for frame in in_flight {
            self.device.wait(frame).expect("drawn");
        }
        self.device.take_messages()
    }
}

#[derive(Default)]
struct Tally {
    mutants: usize,
    /// Reported as a hazard or a wrong layout.
    caught: usize,
    /// Reported only because a mask has an access that none of its stages supports.
    masks: usize,
    blind: BTreeMap<Blind, usize>,
}

impl Tally {
    fn add(&mut self, other: &Tally) {
        self.mutants += other.mutants;
        self.caught += other.caught;
        self.masks += other.masks;
        for (blind, count) in &other.blind {
            *self.blind.entry(*blind).or_default() += count;
        }
    }

    fn line(&self, name: &str) -> String {
        let blind: Vec<String> = self.blind.iter().map(|(blind, count)| format!("{blind} {count}")).collect();
        let uncovered: usize = self.blind.values().sum();
        format!(
            "mutants: {name:22} {:5} {:6} {:5} {uncovered:5}  {}",
            self.mutants,
            self.caught,
            self.masks,
            blind.join(", ")
        )
    }
}

fn text(plan: &Plan, barriers: &Barriers, mutation: &Mutation) -> String {
    let masks = barriers.at(mutation.at)[mutation.barrier].masks;
    format!("{}: {masks}", mutation.describe(plan, barriers))
}

fn is_hazard_or_layout(message: &str) -> bool {
    ["SYNC-HAZARD", "ayout"].iter().any(|part| message.contains(part))
}

#[test]
fn the_validation_layer_catches_every_mutant_that_it_can_see() {
    if Api::default() != Api::Vulkan {
        return common::not_run(
            "the_validation_layer_catches_every_mutant_that_it_can_see",
            "Vulkan's layer, for which it was calibrated",
        );
    }
    if !compares_submissions("mutations::the_validation_layer_catches_every_mutant_that_it_can_see") {
        return;
    }
    let start = Instant::now();
    let mut bench = Bench::new();
    let plans = plans(&bench.scene, &bench.device.info().facts);
    say("mutants: preset, mutants, caught, masks refused, not covered (by what the layer does not see)");
    let (mut total, mut wrong) = (Tally::default(), Vec::new());
    let mut met = BTreeSet::new();
    for plan in &plans {
        let barriers = builds::barriers(plan);
        let sound = bench.messages(plan, barriers.clone());
        assert_eq!(sound, Vec::<String>::new(), "{}: the plan as it is", plan.name);
        let layer = Layer::new(plan);
        let mut tally = Tally::default();
        for mutation in mutations(plan, &barriers) {
            // Presets share most of their passes: a mutation that was already drawn is skipped, except in a long run.
            let fresh = met.insert(text(plan, &barriers, &mutation));
            if !fresh && !common::long() {
                continue;
            }
            let mutant = apply(&barriers, &mutation);
            let messages = bench.messages(plan, mutant.clone());
            tally.mutants += 1;
            if messages.iter().any(|message| is_hazard_or_layout(message)) {
                tally.caught += 1;
                continue;
            }
            match layer.ought_to_see(&mutant, FRAMES) {
                Err(_) if !messages.is_empty() => tally.masks += 1,
                Err(blind) => *tally.blind.entry(blind).or_default() += 1,
                Ok(()) => {
                    let violations = replay(plan, &mutant, &Replay { frames: FRAMES, ..Replay::default() });
                    let why: BTreeSet<String> = violations.iter().map(|o| o.describe(plan)).collect();
                    let why: Vec<String> = why.into_iter().collect();
                    wrong.push(format!(
                        "{}: {}\n    {}\n    said: {}",
                        plan.name,
                        mutation.describe(plan, &barriers),
                        why.join("\n    "),
                        messages.join("\n    ")
                    ));
                }
            }
        }
        say(&tally.line(&plan.name));
        total.add(&tally);
    }
    say(&total.line("all"));
    say(&format!("mutants: {:.1} s", start.elapsed().as_secs_f32()));
    let closing = bench.device.close();
    assert!(closing.is_empty(), "closing the device\n{}", closing.join("\n"));
    assert!(wrong.is_empty(), "{} should have been caught\n{}", wrong.len(), wrong.join("\n"));
}
