//! Defines the exceptions, and converts the library's errors to them.

use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyList;
use serde_json::{Value as Json, json};
use splatgraph::draw::planner::{GraphErrors, PlainDiagnostic};
use splatgraph::draw::projection::ProjectionError;
use splatgraph::draw::session::SessionError;
use splatgraph::studies::study::StudyError;
use splatgraph_api::BackendError;

create_exception!(splatgraph, Error, PyRuntimeError, "Base class of splatgraph's errors.");
create_exception!(
    splatgraph,
    SceneError,
    Error,
    "A scene or camera file cannot be read or written, or a scene has no splats."
);
create_exception!(splatgraph, DeviceError, Error, "No suitable device was found, or the device failed.");
create_exception!(
    splatgraph,
    GraphError,
    Error,
    "A graph or its shaders have errors.

Attributes:
    file (str): path of the file with the first error, as it was given; `params` or `pipeline` if it is in that argument.
    line (int): line of the first error, from 1.
    column (int): column of the first error, from 1, in characters.
    text (str): all errors, rendered with the source text.
    errors (list[dict]): the errors, each with file, line, column, end_line, end_column, severity, message, label, help."
);

/// Converts an error of a session to an exception.
pub fn session(py: Python<'_>, error: &SessionError) -> PyErr {
    match error {
        SessionError::Graph(errors) => graph(py, errors),
        SessionError::Backend(error) => device(error),
        SessionError::Projection(ProjectionError { graph, camera }) if !camera.is_pinhole() => {
            Error::new_err(format!(
                "expected a graph for {camera} cameras, found one for {graph} cameras: use Renderer(scene, \"{camera}\")"
            ))
        }
        SessionError::NoSplats { .. } => SceneError::new_err(error.to_string()),
        error => Error::new_err(error.to_string()),
    }
}

/// Converts an error of a study: a session's as [`session`] does, invalid input to `ValueError`, others to `Error`.
///
/// The error of one setting or view keeps its type and attributes; its text begins with the name.
pub fn study(py: Python<'_>, error: &StudyError) -> PyErr {
    match error {
        StudyError::Session(error) => session(py, error),
        StudyError::Of { name, error } => {
            let exception = study(py, error);
            let value = exception.value(py);
            match value.setattr("args", (format!("{name}: {value}"),)) {
                Ok(()) => exception,
                Err(error) => error,
            }
        }
        StudyError::Input(_) | StudyError::UnknownSetting { .. } | StudyError::Metric(_) => {
            PyValueError::new_err(error.to_string())
        }
        error => Error::new_err(error.to_string()),
    }
}

pub fn device(error: &BackendError) -> PyErr {
    DeviceError::new_err(error.to_string())
}

/// The file names that the framework gives to command-line arguments, with the Python arguments that replace them.
const ARGUMENTS: [(&str, &str); 2] = [("--set", "params"), ("command line", "pipeline")];

fn in_python(file: &str) -> &str {
    ARGUMENTS.iter().find(|(source, _)| *source == file).map_or(file, |(_, argument)| argument)
}

/// Converts a graph's errors to an exception, with their source locations.
pub fn graph(py: Python<'_>, errors: &GraphErrors) -> PyErr {
    let mut text = errors.text(false).trim_end().to_owned();
    for (source, argument) in ARGUMENTS {
        text = text.replace(&format!("--> {source}:"), &format!("--> {argument}:"));
    }
    let exception = GraphError::new_err(text.clone());
    let value = exception.value(py);
    let attach = || -> PyResult<()> {
        let list = PyList::empty(py);
        for found in &errors.found {
            list.append(diagnostic(py, found)?)?;
        }
        if let Some(first) = errors.found.first() {
            value.setattr("file", in_python(&first.file))?;
            value.setattr("line", first.line)?;
            value.setattr("column", first.column)?;
        }
        value.setattr("text", text)?;
        value.setattr("errors", list)
    };
    match attach() {
        Ok(()) => exception,
        Err(error) => error,
    }
}

fn diagnostic<'py>(py: Python<'py>, found: &PlainDiagnostic) -> PyResult<Bound<'py, PyAny>> {
    let dict = to_python(py, &json!(found))?;
    dict.set_item("file", in_python(&found.file))?;
    Ok(dict)
}

/// Converts JSON to Python's own types, such as dicts, lists and numbers.
pub fn to_python<'py>(py: Python<'py>, value: &Json) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}
