//! Defines the class `Job`, which runs a command's views on the workers of a cluster.

use crate::errors::Error;
use crate::wait;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use splatgraph::cli;
use std::ffi::OsString;
use std::sync::{Arc, Mutex, PoisonError};

/// Indices of the views done now, indices of the views done before, and failed views with the reason.
type Ran = (Vec<usize>, Vec<usize>, Vec<(usize, String)>);

/// The views of a command line: `render`, `trade`, `sweep` or `evaluate` with its arguments.
///
/// The first views load the scene and open the device; later views reuse both, unless a view fails.
#[pyclass(frozen, module = "splatgraph._native")]
pub struct Job {
    /// The job; `None` once closed.
    job: Arc<Mutex<Option<cli::Job>>>,
    /// Names of the views, for messages.
    #[pyo3(get)]
    views: Vec<String>,
}

#[pymethods]
impl Job {
    #[new]
    fn new(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Job> {
        crate::configure();
        let job = wait::run(py, move || cli::job(&arguments))?;
        let job = job.map_err(|error| PyValueError::new_err(format!("{error:#}")))?;
        Ok(Job { views: job.views().to_vec(), job: Arc::new(Mutex::new(Some(job))) })
    }

    /// Processes the views with these indices, except for views with complete results of the same inputs.
    ///
    /// Returns: The indices done now, the indices done before, and the failed indices with the reason. After Ctrl-C,
    /// the views are finished in the background.
    fn run(&self, py: Python<'_>, views: Vec<usize>) -> PyResult<Ran> {
        if let Some(view) = views.iter().find(|view| **view >= self.views.len()) {
            return Err(PyValueError::new_err(format!(
                "views: expected indices below {}, found {view}",
                self.views.len()
            )));
        }
        let job = Arc::clone(&self.job);
        let ran = wait::run(py, move || {
            let mut job = job.lock().unwrap_or_else(PoisonError::into_inner);
            job.as_mut().map(|job| job.run(&views))
        })?;
        let ran = ran.ok_or_else(|| Error::new_err("the job is closed"))?;
        let cli::Ran { done, kept, failed } = ran.map_err(|error| Error::new_err(format!("{error:#}")))?;
        Ok((done, kept, failed))
    }

    /// Waits for a call of `run` in progress, and closes the device. Later calls of `run` fail.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let job = Arc::clone(&self.job);
        wait::run(py, move || {
            let job = job.lock().unwrap_or_else(PoisonError::into_inner).take();
            job.map(|mut job| job.close())
        })?;
        Ok(())
    }
}
