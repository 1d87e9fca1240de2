//! Defines `splatgraph._native`, the extension module of the Python package `splatgraph`.
//!
//! It wraps the application's library in a few classes; the package beside it (`splatgraph/*.py`) is the public
//! interface. Loading, drawing and studies run on their own threads ([`wait`]): they release the interpreter's lock,
//! and Ctrl-C ends the call.

use pyo3::prelude::*;
use splatgraph::draw::planner;
use splatgraph::draw::shader_cache::ShaderCache;
use splatgraph_framework::shader::{Worker, serve_if_asked};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

mod arrays;
mod camera;
mod engine;
mod errors;
mod job;
mod pictures;
mod plan;
mod scene;
mod studies;
mod wait;

/// Paths of the interpreter and of this module.
static PROCESS: OnceLock<(PathBuf, PathBuf)> = OnceLock::new();

/// Python code that loads the extension module by its path, so that the process serves as the shader compiler.
const SERVE: &str = "import sys, importlib.util as u
s = u.spec_from_file_location('_native', sys.argv[1])
s.loader.exec_module(u.module_from_spec(s))";

/// Returns the program that compiles shaders: the interpreter with this module. `None` if Python is embedded in another
/// program.
fn worker() -> Option<Worker> {
    let (python, module) = PROCESS.get()?;
    let arguments = ["-I", "-S", "-c", SERVE].map(OsString::from).into_iter().chain([module.into()]);
    Some(Worker { arguments: arguments.collect(), ..Worker::new(python) })
}

fn shader_cache() -> Option<ShaderCache> {
    PROCESS.get().and_then(|(_, module)| ShaderCache::of_user(module))
}

/// Sets up planners. Called before the first plan, not at import: the command line has its own settings.
fn configure() {
    let store = shader_cache().map(|cache| Arc::new(cache) as Arc<_>);
    planner::configure(planner::Settings { worker: worker(), store, include_roots: Vec::new() });
}

#[pymodule]
mod _native {
    use super::*;

    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::engine::{Engine, Pending};
    #[pymodule_export]
    use super::errors::{DeviceError, Error, GraphError, SceneError};
    #[pymodule_export]
    use super::job::Job;
    #[pymodule_export]
    use super::pictures::{compare, png};
    #[pymodule_export]
    use super::plan::{Plan, plan};
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::studies::{_join_studies, advise, trade};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // In a process that was started to compile shaders, this call does not return.
        serve_if_asked();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }

    /// Sets the paths of the interpreter and of this module, with which other processes are started.
    #[pyfunction]
    fn _set_process(python: PathBuf, module: PathBuf) {
        splatgraph::io::program::set(module.clone());
        // After a second import in one process, the paths are already set, to the same values.
        let _ = PROCESS.set((python, module));
    }

    /// Runs the command line; returns the exit code.
    #[pyfunction]
    fn run(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
        py.detach(|| splatgraph::cli::run(arguments, worker(), shader_cache()))
    }
}
