//! Random graphs on the tests' device, with synchronization validation. A plan gives equal bytes for every order of its
//! passes, with and without shared memory, and with maximal barriers.

use splatgraph::draw::backend::Backend;
use splatgraph_api::{Device, FrameInputs, Inspect, Loader, SceneData};
use splatgraph_framework::ir::{Accesses, Masks, PassId, ResourceId, Source, Stages};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::solve::reorder;
use splatgraph_vulkan::sync::{Barrier, Barriers};
use std::collections::BTreeMap;
use std::sync::Mutex;

use super::builds::{Case, accepted, barriers, for_cases, plan_with, shown};
use super::orders::orders;
use super::recipe::{LARGE, Limits, SMALL, Settings};
use super::render::Files;
use crate::again;
use crate::common::{self, long};

pub struct Bench {
    device: Backend,
    compiler: Glslang,
    /// Number of the run, which identifies the scene. Histories persist from plan to plan within a run.
    run: u64,
}

/// A scene without data. Its identity is the run: histories belong to a scene.
struct NoScene(u64);

impl SceneData for NoScene {
    fn write(&self, attribute: &str, _: u32, _: u64, _: &mut [u8]) -> Result<(), String> {
        Err(format!("no {attribute}"))
    }

    fn identity(&self) -> u64 {
        self.0
    }
}

/// Results of a frame: the output, the statistics, and the inspected resources by name.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    pub output: Vec<u8>,
    stats: Vec<(String, u32)>,
    contents: BTreeMap<String, Vec<u8>>,
}

/// The time at which the host waits for frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// After each frame, before it submits the next.
    Waits,
    /// After all frames: two are in flight, possibly of two plans.
    InFlight,
}

impl Bench {
    pub fn new() -> Bench {
        Bench { device: common::device(), compiler: Glslang::default(), run: 0 }
    }

    pub fn plan(&mut self, files: &Files, settings: Settings, share_memory: bool) -> Result<Plan, String> {
        plan_with(files, settings, share_memory, &mut self.compiler)
    }

    /// Loads plans one after another and draws the given number of frames with each.
    ///
    /// The very last frame also reads back every transient resource that it wrote. Other frames do not, because reading
    /// back adds barriers. Messages of the validation layers are an error.
    pub fn run(&mut self, plans: &[(&Plan, u32)], pace: Pace) -> Result<Vec<Outcome>, String> {
        self.run_with(plans, pace, None)
    }

    /// Runs plans like [`Self::run`]; on Vulkan, `barriers` replace those of the first plan.
    fn run_with(
        &mut self,
        plans: &[(&Plan, u32)],
        pace: Pace,
        mut barriers: Option<Barriers>,
    ) -> Result<Vec<Outcome>, String> {
        self.run += 1;
        let mut waiting = Vec::new();
        let mut outcomes = Vec::new();
        let mut wait = |device: &mut Backend, (frame, names): (_, Vec<String>)| -> Result<(), String> {
            let result = device.wait(frame).map_err(|e| e.to_string())?;
            let output = result.output.ok_or("no output")?.bytes.to_vec();
            let contents = names.into_iter().zip(result.inspected).collect();
            outcomes.push(Outcome { output, stats: result.stats, contents });
            Ok(())
        };
        for (number, (plan, frames)) in plans.iter().enumerate() {
            let scene = NoScene(self.run);
            let loaded = match (&mut self.device, barriers.take()) {
                (Backend::Vulkan(device), Some(barriers)) => {
                    let loader = device.loader().synchronized_by(barriers);
                    loader.prepare((*plan).clone(), &scene, &mut |_| {}).and_then(|ready| device.swap(ready))
                }
                (device, _) => device.load((*plan).clone(), &scene, &mut |_| {}),
            };
            loaded.map_err(|e| e.to_string())?;
            for frame in 0..*frames {
                let last = number + 1 == plans.len() && frame + 1 == *frames;
                let inspect = if last { inspections(plan) } else { Vec::new() };
                let names = inspect.iter().map(|i| plan.resource(i.resource).name.clone()).collect();
                let inputs = FrameInputs { read_output: true, inspect, ..FrameInputs::default() };
                let submitted = (self.device.submit(&inputs).map_err(|e| e.to_string())?, names);
                match pace {
                    Pace::Waits => wait(&mut self.device, submitted)?,
                    Pace::InFlight => waiting.push(submitted),
                }
            }
        }
        waiting.into_iter().try_for_each(|submitted| wait(&mut self.device, submitted))?;
        let mut messages = self.device.take_messages();
        messages.retain(|message| !is_too_strict(message));
        if messages.is_empty() { Ok(outcomes) } else { Err(messages.join("\n")) }
    }

    fn frames(&mut self, plan: &Plan) -> Result<Vec<Outcome>, String> {
        self.frames_with(plan, None)
    }

    fn frames_with(&mut self, plan: &Plan, barriers: Option<Barriers>) -> Result<Vec<Outcome>, String> {
        self.run_with(&[(plan, 3)], Pace::InFlight, barriers)
    }
}

/// Returns true if the layer reports a write after write where the specification has no hazard:
///
/// - A layout change after a write that an earlier barrier made available. The layer expects the write's stage and
///   access in the source of the layout change itself; by the specification, the chain of dependencies is enough. Plans
///   name them there, except for writes of the prologue.
/// - A write after a write of another submission, if a read between the two waits for the first and the second waits
///   for the read. When the layer compares submissions, it ignores that read.
fn is_too_strict(message: &str) -> bool {
    let change = message.contains("usage: SYNC_IMAGE_LAYOUT_TRANSITION, ")
        && message.contains("prior_usage: SYNC_COMPUTE_SHADER_SHADER_STORAGE_WRITE");
    message.contains("SYNC-HAZARD-WRITE-AFTER-WRITE") && (change || message.contains("vkQueueSubmit2"))
}

/// Returns an inspection of every transient buffer and image that the frame writes, after its last writer.
fn inspections(plan: &Plan) -> Vec<Inspect> {
    let ids = (0..plan.resources.len() as u32).map(ResourceId);
    let own = ids.filter(|id| plan.resource(*id).source == Source::Transient);
    own.filter_map(|resource| {
        let writes = |pass: &PassId| {
            let uses = &plan.pass(*pass).uses;
            uses.iter().any(|t| t.resource == resource && t.accesses.writes())
        };
        let after = plan.frame.iter().copied().rfind(writes)?;
        Some(Inspect { resource, after })
    })
    .collect()
}

/// Returns barriers that make every pass wait for all earlier ones. Layout changes stay where they are.
fn full_barriers(plan: &Plan) -> Barriers {
    let mut all = barriers(plan);
    let everything = (Stages::all(), Accesses::all());
    let masks = Masks::new(everything, everything);
    let widen = |barriers: &mut Vec<Barrier>| {
        barriers.retain(|barrier| barrier.image.is_some());
        barriers.insert(0, Barrier { image: None, masks, causes: Vec::new() });
        barriers.iter_mut().for_each(|barrier| barrier.masks = masks);
    };
    all.before.iter_mut().chain([&mut all.handover]).for_each(widen);
    all
}

/// Fails if two runs differ, and names the first frame and the resources that do.
fn same(one: &[Outcome], other: &[Outcome], plan: &Plan, what: &str) -> Result<(), String> {
    if one == other {
        return Ok(());
    }
    let differs = one.iter().zip(other).position(|(a, b)| a != b).unwrap_or(one.len().min(other.len()));
    let names: Vec<&String> = match (one.get(differs), other.get(differs)) {
        (Some(a), Some(b)) => {
            a.contents.keys().filter(|name| a.contents.get(*name) != b.contents.get(*name)).collect()
        }
        _ => Vec::new(),
    };
    Err(format!("other bytes {what}, in frame {differs} (counted from 0), {names:?}\n{}", shown(plan)))
}

/// Returns true if this process compares submissions. Otherwise runs `test` in a process that does; it must pass there.
pub fn compares_submissions(test: &str) -> bool {
    again::again_comparing_submissions(test);
    again::compares_submissions()
}

/// Runs `property` on `cases` random graphs with full validation, on one device. A long run has 20 times as many
/// graphs. `test` is the name of the test.
fn on_device(
    test: &str,
    limits: Limits,
    cases: u32,
    property: impl Fn(&mut Bench, &Case, &Plan) -> Result<(), String> + Sync,
) {
    if !compares_submissions(&format!("random::gpu::{test}")) {
        return;
    }
    let bench = Mutex::new(Bench::new());
    let cases = if long() { 20 * cases } else { cases };
    for_cases(test, Limits { runs: true, ..limits }, cases, |case| {
        let mut bench = bench.lock().map_err(|_| "another graph panics")?;
        let plan = accepted(bench.plan(&case.files, case.sketch.settings[0], true))?;
        plan.map_or(Ok(()), |plan| property(&mut bench, case, &plan))
    });
}

#[test]
fn up_to_12_orders_of_a_frame_give_the_same_bytes() {
    const MAX_ORDERS: usize = 12;
    on_device("up_to_12_orders_of_a_frame_give_the_same_bytes", SMALL, 300, |bench, _, plan| {
        let expected = bench.frames(plan)?;
        for (number, order) in orders(plan, MAX_ORDERS).into_iter().enumerate() {
            let share_memory = number % 2 == 0;
            let other = reorder(plan, &order, share_memory);
            let found = bench.frames(&other).map_err(|e| format!("{e}\n{}", shown(&other)))?;
            same(&expected, &found, &other, "in another order")?;
        }
        Ok(())
    });
}

#[test]
fn full_barriers_and_memory_apart_give_the_same_bytes() {
    on_device("full_barriers_and_memory_apart_give_the_same_bytes", LARGE, 150, |bench, case, plan| {
        let found = bench.frames(plan).map_err(|e| format!("{e}\n{}", shown(plan)))?;
        let expected = bench.frames_with(plan, Some(full_barriers(plan)))?;
        same(&expected, &found, plan, "than with full barriers")?;
        let Some(apart) = accepted(bench.plan(&case.files, case.sketch.settings[0], false))? else {
            return Ok(());
        };
        let found = bench.frames(&apart).map_err(|e| format!("{e}\n{}", shown(&apart)))?;
        same(&expected, &found, &apart, "with memory apart")
    });
}

#[test]
fn plans_that_follow_each_other_in_flight_give_the_bytes_of_a_patient_host() {
    let test = "plans_that_follow_each_other_in_flight_give_the_bytes_of_a_patient_host";
    on_device(test, LARGE, 100, |bench, case, one| {
        let Some(two) = accepted(bench.plan(&case.files, case.sketch.settings[1], true))? else {
            return Ok(());
        };
        let plans = [(one, 2), (&two, 1), (one, 1), (&two, 3)];
        let found = bench.run(&plans, Pace::InFlight)?;
        let expected = bench.run(&plans, Pace::Waits)?;
        same(&expected, &found, &two, "with two frames in flight")
    });
}
