//! Builds random graphs, and runs properties over many of them.

use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};
use splatgraph::draw::backend;
use splatgraph_framework::ir::{Catalog, DeviceFacts, Facts, Request, Value};
use splatgraph_framework::oracle;
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::ShaderCompiler;
use splatgraph_framework::source::{Library, SourceMap, render as explain};
use splatgraph_framework::{build, dump};
use splatgraph_vulkan::sync::Barriers;
use splatgraph_vulkan::sync::model::mutate::{mutations, needless};
use splatgraph_vulkan::sync::model::{Replay, replay};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::compiler::DeclarationCompiler;
use super::recipe::{LARGE, Limits, Recipe, Settings, recipes};
use super::render::{Files, Style, render};
use super::sketch::Sketch;
use crate::common::{self, long};

fn facts() -> Facts {
    let ints = [("scene.count", 1000), ("viewport.width", 16), ("viewport.height", 8)];
    let device = DeviceFacts { shared_bytes: u32::MAX, max_invocations: u32::MAX, ..DeviceFacts::typical(8) };
    Facts { host: ints.map(|(name, value)| (name.to_string(), Value::Int(value))).into(), ..device.into() }
}

/// Builds the graph of these files. Errors are formatted as for a user.
pub fn plan_with(
    files: &Files,
    settings: Settings,
    share_memory: bool,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Plan, String> {
    let mut library = Library::default();
    library.memory.extend(files.shaders.iter().chain(&files.parts).cloned());
    library.memory.insert("graph.ron".into(), files.graph.clone());
    let mut map = SourceMap::new(library);
    let set = [("flag".into(), settings.flag.to_string()), ("steps".into(), settings.steps.to_string())];
    let (facts, catalog) = (facts(), Catalog::default());
    let request = Request { set: &set, share_memory, ..Request::new("graph.ron", &facts, &catalog) };
    build(&request, &mut map, compiler).map_err(|errors| explain(&map, &errors, false))
}

pub fn plan(files: &Files, settings: Settings, share_memory: bool) -> Result<Plan, String> {
    plan_with(files, settings, share_memory, &mut DeclarationCompiler)
}

/// Returns the plan, or `None` if the builder refused the graph. A mistake of the solver is an error.
pub fn accepted(built: Result<Plan, String>) -> Result<Option<Plan>, String> {
    match built {
        Err(error) if error.contains("mistake of the solver") => Err(error),
        other => Ok(other.ok()),
    }
}

pub fn barriers(plan: &Plan) -> Barriers {
    splatgraph_vulkan::sync::barriers(plan).unwrap_or_else(|error| panic!("{error}"))
}

/// A graph that the builder accepts.
pub struct Graph {
    pub sketch: Sketch,
    pub files: Files,
    /// The plan under the recipe's first settings, with shared memory.
    pub plan: Plan,
}

impl Graph {
    /// Makes the graph of a recipe; `None` if the builder refuses it.
    fn of(recipe: &Recipe, limits: Limits) -> Result<Option<Graph>, String> {
        let sketch = Sketch::of(recipe, limits);
        let files = render(&sketch, Style::default());
        let plan = accepted(plan(&files, sketch.settings[0], true))?;
        Ok(plan.map(|plan| Graph { sketch, files, plan }))
    }
}

/// A graph whose mutants are counted.
pub struct Case<'a> {
    graph: &'a Graph,
    counts: &'a Counts,
}

impl Deref for Case<'_> {
    type Target = Graph;

    fn deref(&self) -> &Graph {
        self.graph
    }
}

impl Case<'_> {
    pub fn plan(&self, settings: Settings, share_memory: bool) -> Result<Plan, String> {
        plan(&self.files, settings, share_memory)
    }

    /// Fails with the first objection to a plan's dependencies or its barriers, if there is one.
    ///
    /// Also counts the plan's mutants. `what` names the plan in errors.
    pub fn judge(&self, plan: &Plan, what: &str) -> Result<(), String> {
        if let Some(objection) = oracle::dependencies(plan).first() {
            return Err(format!("{what}: {}\n{}", objection.describe(plan), shown(plan)));
        }
        let barriers = splatgraph_vulkan::sync::barriers(plan).map_err(|error| error.to_string())?;
        let violations = replay(plan, &barriers, &Replay::default());
        if let Some(violation) = violations.first() {
            return Err(format!("{what}: {}\n{}", violation.describe(plan), shown(plan)));
        }
        for (_, call) in barriers.calls(plan) {
            if call.iter().filter(|barrier| barrier.image.is_none()).count() > 1 {
                return Err(format!("{what}: two barriers on all memory in one call\n{}", shown(plan)));
            }
            if call.iter().any(|barrier| barrier.causes.is_empty()) {
                return Err(format!("{what}: a barrier without a reason\n{}", shown(plan)));
            }
        }
        self.counts.mutants.fetch_add(mutations(plan, &barriers).len() as u64, Relaxed);
        match needless(plan, &barriers).first() {
            Some(mutation) => {
                Err(format!("{what}: needless: {}\n{}", mutation.describe(plan, &barriers), shown(plan)))
            }
            None => Ok(()),
        }
    }
}

/// Formats a plan with its barriers, for messages.
pub fn shown(plan: &Plan) -> String {
    dump::text(&backend::dump(plan))
}

#[derive(Default)]
struct Counts {
    graphs: AtomicU64,
    refused: AtomicU64,
    mutants: AtomicU64,
}

/// Number of graphs in a long run.
const LONG: u32 = 100_000;

/// Graphs per random generator. Batches make the graphs independent of the number of threads.
const BATCH: u32 = 50;

/// Number of batches of [`LARGE`] graphs that are kept, because most properties are checked on them.
const KEPT: u32 = 40;

/// Returns the graphs of a batch. Fails if the solver makes a mistake in one of them.
fn kept(batch: u32) -> Result<Arc<Vec<Option<Graph>>>, String> {
    static GRAPHS: Mutex<BTreeMap<u32, Arc<Vec<Option<Graph>>>>> = Mutex::new(BTreeMap::new());
    let all = || GRAPHS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(graphs) = all().get(&batch) {
        return Ok(graphs.clone());
    }
    let made = RefCell::new(Vec::new());
    run_batch(batch, BATCH, LARGE, |recipe| {
        made.borrow_mut().push(Graph::of(recipe, LARGE)?);
        Ok(())
    })?;
    Ok(all().entry(batch).or_insert(Arc::new(made.into_inner())).clone())
}

/// Checks `property` on `quick` random graphs, or [`LONG`] in a long run, on all cores. Failures are shrunk.
///
/// # Panics
/// If the property fails, with the graph; or if the builder refuses more than one graph in ten.
pub fn for_all(
    name: &str,
    limits: Limits,
    quick: u32,
    property: impl Fn(&Case) -> Result<(), String> + Sync,
) {
    for_cases(name, limits, if long() { LONG } else { quick }, property);
}

/// Checks `property` on `cases` random graphs, as [`for_all`] does.
pub fn for_cases(
    name: &str,
    limits: Limits,
    cases: u32,
    property: impl Fn(&Case) -> Result<(), String> + Sync,
) {
    let counts = Counts::default();
    let batches = cases.div_ceil(BATCH);
    let (next, failure) = (AtomicU32::new(0), Mutex::new(None));
    let start = Instant::now();
    let say = |what: &str| {
        let number = |counter: &AtomicU64| counter.load(Relaxed);
        common::say(&format!(
            "random graphs: {name}: {what}{} graphs, {} refused, {} mutants, {:.1} s",
            number(&counts.graphs),
            number(&counts.refused),
            number(&counts.mutants),
            start.elapsed().as_secs_f32(),
        ));
    };
    let work = || {
        while failure.lock().is_ok_and(|failure| failure.is_none()) {
            let batch = next.fetch_add(1, Relaxed);
            if batch >= batches {
                break;
            }
            if batch > 0 && batch % 200 == 0 {
                say("so far ");
            }
            let check = |graph: Option<&Graph>| {
                counts.graphs.fetch_add(1, Relaxed);
                match graph {
                    Some(graph) => property(&Case { graph, counts: &counts }),
                    None => {
                        counts.refused.fetch_add(1, Relaxed);
                        Ok(())
                    }
                }
            };
            let shrunk =
                || run_batch(batch, BATCH, limits, |recipe| check(Graph::of(recipe, limits)?.as_ref()));
            let found = if limits == LARGE && batch < KEPT {
                let caught = |graph: &Option<Graph>| {
                    let found = catch_unwind(AssertUnwindSafe(|| check(graph.as_ref())));
                    found.unwrap_or_else(|_| Err("a panic".into()))
                };
                let found = kept(batch).and_then(|graphs| graphs.iter().try_for_each(caught));
                // A failure that is not repeated has no smaller graph, but is one.
                found.or_else(|text| shrunk().and(Err(text)))
            } else {
                shrunk()
            };
            if let (Err(text), Ok(mut failure)) = (found, failure.lock()) {
                failure.get_or_insert(text);
            }
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, |count| count.get());
        (0..threads).for_each(|_| drop(scope.spawn(work)));
    });
    if let Ok(Some(text)) = failure.into_inner() {
        panic!("{text}");
    }
    say("");
    let [graphs, refused] = [&counts.graphs, &counts.refused].map(|counter| counter.load(Relaxed));
    assert!(refused * 10 <= graphs, "{refused} of {graphs} random graphs are refused");
}

/// Checks `property` on `cases` recipes, which depend only on the number of the batch. The error shows the failing
/// graph, shrunk.
pub fn run_batch(
    batch: u32,
    cases: u32,
    limits: Limits,
    property: impl Fn(&Recipe) -> Result<(), String>,
) -> Result<(), String> {
    let config = Config {
        cases,
        failure_persistence: None,
        max_shrink_iters: 20_000,
        max_shrink_time: 60_000,
        ..Config::default()
    };
    let mut seed = [0x5A; 32];
    seed[..4].copy_from_slice(&batch.to_le_bytes());
    let random = TestRng::from_seed(RngAlgorithm::ChaCha, &seed);
    let mut runner = TestRunner::new_with_rng(config, random);
    let result = runner.run(&recipes(limits), |recipe| property(&recipe).map_err(TestCaseError::fail));
    result.map_err(|error| match error {
        TestError::Abort(reason) => reason.to_string(),
        TestError::Fail(reason, recipe) => {
            let sketch = Sketch::of(&recipe, limits);
            format!("{reason}\nof the graph (batch {batch})\n{}", render(&sketch, Style::default()).graph)
        }
    })
}
