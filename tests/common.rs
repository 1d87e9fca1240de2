//! Helpers that the tests share: devices, plans, graphs, the data folder, separate processes, and the choice of long
//! runs.

use crate::again::passes_again;
use crate::captures::captures;
pub use crate::captures::not_run;
use splatgraph::draw::backend::{Api, Backend, Options, Validation};
use splatgraph::draw::builtin;
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::{self, Settings};
use splatgraph::studies::bench;
use splatgraph::view::paint;
use splatgraph_api::{Device, SceneData};
use splatgraph_assets::Scene;
use splatgraph_framework::ir::{Catalog, DeviceFacts, Facts};
use splatgraph_framework::shader::{SpirvStore, Worker};
use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, Once, PoisonError};

/// Opens the machine's device with full validation: on Apple's systems the GPU, by Metal; elsewhere lavapipe, by
/// Vulkan. `SPLATGRAPH_TEST_DEVICE` names another device.
pub fn device() -> Backend {
    let device = open(&options(Validation::Synchronization));
    assert_lanes(&device);
    device
}

/// Fails if the driver does not use the vector width that [`again_with_vectors_of`] requests.
pub fn assert_lanes(device: &impl Device) {
    if let Ok(lanes) = std::env::var(EXPECTED_LANES) {
        let found = device.info().facts.subgroup_size;
        assert_eq!(found.to_string(), lanes, "the driver did not take the vector width");
    }
}

pub fn open(options: &Options) -> Backend {
    Backend::open(Api::default(), options).unwrap_or_else(|error| {
        panic!("the tests need lavapipe and the validation layers, or an Apple GPU and MTL_DEBUG_LAYER=1: {error}")
    })
}

pub fn options(validation: Validation) -> Options {
    share_shaders();
    let usual = if Api::default() == Api::Vulkan { Some("llvmpipe".into()) } else { None };
    let device = std::env::var("SPLATGRAPH_TEST_DEVICE").ok().or(usual);
    Options { device, validation, ..Options::default() }
}

/// Returns the `--device` argument that selects the tests' device; `None` if any device will do.
pub fn device_option() -> Option<String> {
    options(Validation::Off).device.map(|device| format!("--device={device}"))
}

fn is_lavapipe(device: &Backend) -> bool {
    matches!(device, Backend::Vulkan(_)) && device.info().name.contains("llvmpipe")
}

/// Environment variable set in the processes that [`again_with_vectors_of`] starts.
const EXPECTED_LANES: &str = "SPLATGRAPH_EXPECT_LANES";

/// Returns false in the processes that [`again_with_vectors_of`] starts.
pub fn lanes_are_usual() -> bool {
    std::env::var_os(EXPECTED_LANES).is_none()
}

pub fn assert_silent(device: &mut impl Device, what: &str) {
    let messages = device.take_messages();
    assert!(messages.is_empty(), "{what}: the validation layers say\n{}", messages.join("\n"));
}

/// Returns the folder with `scenes/` and `golden/`; `None`, with a report, if `SPLATGRAPH_DATA` is not set.
pub fn data(test: &str) -> Option<PathBuf> {
    captures(test)?.parent().map(PathBuf::from)
}

/// Writes a line to standard error, also in tests that pass, where the output of `eprintln!` is hidden.
pub fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Lists the built-in graphs, those of the benchmarks, and the window's.
pub fn graphs() -> Vec<&'static str> {
    builtin::names().into_iter().chain(bench::GRAPHS).chain([paint::GRAPH]).collect()
}

/// A cache of the SPIR-V of every shader that this process's planners compile, like the shader cache between runs.
#[derive(Debug, Default)]
struct Shaders(Mutex<HashMap<Vec<u8>, Vec<u32>>>);

impl SpirvStore for Shaders {
    fn load(&self, key: &[u8]) -> Option<Vec<u32>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(key).cloned()
    }

    fn store(&self, key: &[u8], spirv: &[u32]) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(key.to_vec(), spirv.to_vec());
    }
}

/// Lets the planners of all tests share their shaders: most tests draw the same graphs.
pub fn share_shaders() {
    static SHARED: Once = Once::new();
    SHARED.call_once(|| {
        let store = Some(Arc::<Shaders>::default() as Arc<_>);
        planner::configure(Settings { store, ..Settings::default() });
    });
}

/// Returns the catalog for plans of [`graphs`] without a scene.
pub fn catalog() -> Catalog {
    share_shaders();
    let mut catalog = facts::nominal_catalog();
    paint::offer(&mut catalog);
    catalog
}

/// Returns the facts for plans without a scene.
pub fn facts_of(device: &DeviceFacts) -> Facts {
    facts::facts(&SceneFacts::NOMINAL, device, facts::DEFAULT_SIZE)
}

pub fn worker() -> Worker {
    Worker::new(env!("CARGO_BIN_EXE_splatgraph"))
}

pub fn long() -> bool {
    std::env::var_os("SPLATGRAPH_LONG").is_some()
}

/// Runs a test of this binary again in its own process, with lavapipe vectors of this many bits. Reports it as not run
/// on other devices, whose width is fixed.
///
/// The driver reads `LP_NATIVE_VECTOR_WIDTH` once, when it is loaded.
pub fn again_with_vectors_of(bits: u32, test: &str) {
    if !is_lavapipe(&open(&options(Validation::Off))) {
        return not_run(&format!("{test} with {} lanes", bits / 32), "lavapipe's widths");
    }
    let (width, lanes) = (bits.to_string(), (bits / 32).to_string());
    let set = [("LP_NATIVE_VECTOR_WIDTH", width.as_str()), (EXPECTED_LANES, &lanes)];
    passes_again(&format!("with vectors of {bits} bits"), test, &set);
}

/// Environment variable set in the processes that [`alone`] starts, to the name of the test.
#[cfg(target_os = "linux")]
pub const ALONE: &str = "SPLATGRAPH_ALONE";

/// Runs `body` in a separate process. Process-wide state (memory, threads, open files, panics on any thread) then
/// belongs to the test. The process is this binary, running only `test`, the caller.
#[cfg(target_os = "linux")]
pub fn alone(test: &str, body: impl FnOnce()) {
    alone_with(test, &[], body);
}

/// Runs `body` like [`alone`], with more environment variables.
#[cfg(target_os = "linux")]
pub fn alone_with(test: &str, set: &[(&str, &str)], body: impl FnOnce()) {
    if std::env::var_os(ALONE).is_some_and(|name| name == test) {
        return body();
    }
    // Its output is hidden here unless requested, like any test's.
    print!("{}", passes_again("alone in a process", test, &[&[(ALONE, test)], set].concat()));
}

/// A graph's name, and its parameters as pairs of name and value.
pub type Graph = (&'static str, &'static [(&'static str, &'static str)]);

/// Quads that are blended in 32-bit floats.
pub const QUADS: Graph = ("splat", &[("target", "rgba32f")]);

/// The tile renderers for GPUs and for CPUs, both run on any device.
pub const FAST_TILES: [Graph; 2] = [("tiled", &[]), ("tiled_cpu", &[])];

/// Both tile renderers with the parameters of the preset `tiled_exact`.
pub const EXACT_TILES: [Graph; 2] = [
    (
        "tiled",
        &[
            ("record", "f32"),
            ("extent", "tiles"),
            ("sh_storage", "f32"),
            ("covariance", "six"),
            ("sorted", "pairs"),
            ("stop_after", "splat"),
            ("segment", "16384"),
        ],
    ),
    (
        "tiled_cpu",
        &[
            ("record", "f32"),
            ("extent", "tiles"),
            ("sh_storage", "f32"),
            ("covariance", "six"),
            ("stop_after", "splat"),
        ],
    ),
];

/// The rules of quads for the exact renderer: neither tiles nor an early stop. [`OPEN_TILES`] has the rules of tiles.
pub const OPEN: [(&str, &str); 2] = [("extent", "unbounded"), ("stop", "none")];
pub const OPEN_TILES: [(&str, &str); 2] = [("extent", "alpha"), ("stop", "0.0")];

pub fn settings(set: &[(&str, &str)]) -> Vec<(String, String)> {
    set.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
}

/// A scene's data for a loader. The second field is its identity: histories continue if it stays equal.
pub struct Upload<'a>(pub &'a Scene, pub u64);

impl SceneData for Upload<'_> {
    fn write(&self, attribute: &str, plane: u32, offset: u64, target: &mut [u8]) -> Result<(), String> {
        self.0.write_attribute(attribute, plane, offset, target)
    }

    fn identity(&self) -> u64 {
        self.1
    }
}

/// Returns the parameters of `graph`, followed by `more`, which override them.
pub fn with<'a>(graph: Graph, more: &[(&'a str, &'a str)]) -> Vec<(&'a str, &'a str)> {
    graph.1.iter().copied().chain(more.iter().copied()).collect()
}
