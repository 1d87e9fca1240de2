//! Defines the Python class `Plan`, the result of building a graph, and the function that builds one.

use crate::errors;
use crate::scene::Scene;
use crate::wait;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use splatgraph::draw::backend;
use splatgraph::draw::facts::{self, DEFAULT_SIZE, SceneFacts, USUAL_SUBGROUP_SIZE};
use splatgraph::draw::planner::Planner;
use splatgraph_framework::dump;
use splatgraph_framework::plan as framework;

/// The plan of a graph: passes in order, their dependencies, memory and barriers.
#[pyclass(frozen, module = "splatgraph")]
pub struct Plan(pub framework::Plan);

#[pymethods]
impl Plan {
    /// The graph's name.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Names of the passes in execution order; passes that run once are first.
    #[getter]
    fn passes(&self) -> Vec<String> {
        self.0.passes.iter().map(|pass| pass.name.clone()).collect()
    }

    /// Returns the plan as JSON, with Vulkan's barriers; docs/dump.md documents the fields.
    fn to_json(&self) -> String {
        format!("{:#}", dump::json(&backend::dump(&self.0)))
    }

    /// Returns a page with a timeline, for any browser.
    fn html(&self) -> String {
        dump::html(&backend::dump(&self.0))
    }

    /// Returns the passes and dependencies as a Graphviz graph.
    fn dot(&self) -> String {
        dump::dot(&backend::dump(&self.0))
    }

    fn _repr_html_(&self) -> String {
        let page = self.html().replace('&', "&amp;").replace('"', "&quot;");
        format!("<iframe srcdoc=\"{page}\" style=\"width:100%;height:600px;border:0\"></iframe>")
    }

    // A plan never changes, so a copy is the plan itself.
    fn __copy__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __deepcopy__(this: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        this
    }

    fn __str__(&self) -> String {
        dump::text(&backend::dump(&self.0))
    }

    fn __repr__(&self) -> String {
        format!("<splatgraph.Plan of {}: {} passes>", self.0.name, self.0.passes.len())
    }
}

/// Builds the plan of a graph without opening a device, for the least capable device that is supported.
///
/// Args:
///     pipeline: name of a built-in graph, or a path.
///     params: names and values of parameters, as text.
///     scene: the scene whose facts the plan is for; without one, a million splats with harmonics of degree 3.
///     size: size of the pictures, in pixels.
///     subgroup_size: invocations per subgroup: 4, 8, 16, 32, 64 or 128. 32 on most GPUs, 64 or 128 on some, 4 to 16 on
///         CPUs.
///
/// Raises:
///     ValueError: `subgroup_size` is not one of these.
///     GraphError: the graph or a shader has errors.
#[pyfunction]
#[pyo3(signature = (pipeline, params, scene = None, size = DEFAULT_SIZE, subgroup_size = USUAL_SUBGROUP_SIZE))]
pub fn plan(
    py: Python<'_>,
    pipeline: String,
    params: Vec<(String, String)>,
    scene: Option<&Bound<'_, Scene>>,
    size: (u32, u32),
    subgroup_size: u32,
) -> PyResult<Plan> {
    if !facts::SUBGROUP_SIZES.contains(&subgroup_size) {
        return Err(PyValueError::new_err(format!(
            "subgroup_size: expected one of {:?}, found {subgroup_size}",
            facts::SUBGROUP_SIZES
        )));
    }
    crate::configure();
    let scene = scene.map(|scene| scene.get().0.clone());
    let built = wait::run(py, move || {
        let (scene, catalog) = match &scene {
            Some(scene) => (SceneFacts::of(scene), facts::catalog(scene)),
            None => (SceneFacts::NOMINAL, facts::nominal_catalog()),
        };
        let facts = facts::facts(&scene, &facts::portable_device(subgroup_size), size);
        Planner::default().plan(&pipeline, &params, &facts, &catalog)
    })?;
    built.map(Plan).map_err(|errors| errors::graph(py, &errors))
}
