//! Defines the subject of studies, the listener that follows them, and their error.
//!
//! Most studies are a function `study`: it takes a [`Subject`], a request, and a [`Listener`], and returns its numbers.
//! Studies print the progress of exact pictures, and warnings about the plans of their sessions. Only `trade` writes
//! files: its ledger and the pictures beside it.

use crate::draw::backend::Backend;
use crate::draw::blind;
use crate::draw::session::{Session, SessionError};
use crate::io::image::ImageError;
use crate::io::output::OutputError;
use crate::io::report::plot::PlotError;
use serde::{Deserialize, Serialize};
use splatgraph_api::{BackendError, Device};
use splatgraph_assets::{Camera, Scene, synth::SynthError};
use splatgraph_framework::reload::Wanted;
use splatgraph_reference::{PictureMemoryError, metrics::MetricError};
use std::ops::ControlFlow;
use std::sync::Arc;

/// A graph with values for some of its parameters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setting {
    /// Short name, such as `splat`, `exact`, `defaults` or `key_bits = 16`.
    pub name: String,
    /// The graph, as `--pipeline` takes it.
    pub pipeline: String,
    /// Names and values of parameters, as `--set` takes them.
    pub set: Vec<(String, String)>,
}

impl Setting {
    /// Returns a setting with the graph's name as its own.
    pub fn of_graph(pipeline: &str, set: &[(String, String)]) -> Setting {
        Setting { name: pipeline.to_owned(), pipeline: pipeline.to_owned(), set: set.to_vec() }
    }
}

/// Returns the reason why a setting cannot be drawn.
///
/// Its graph has errors, the device rejects its plan, or a frame needs more capacity than the graph or the device
/// allows.
///
/// # Errors
/// Any other error, such as one of the device: no setting is then measured further.
pub fn reason(error: SessionError) -> Result<String, SessionError> {
    match error {
        SessionError::Graph(errors) => Ok(errors.text(false).trim().to_owned()),
        error if error.spares_device() => Ok(error.to_string()),
        error => Err(error),
    }
}

/// Follows a study: receives its progress and messages, and may cancel it.
pub trait Listener {
    /// Receives how many steps of a task are done, and the name of the next step. `Break` cancels the study.
    fn progress(&mut self, task: &str, done: u64, of: u64, step: &str) -> ControlFlow<()>;

    /// Receives a message for the user, such as the reason why a setting is not measured.
    fn say(&mut self, message: &str);
}

impl Listener for () {
    fn progress(&mut self, _: &str, _: u64, _: u64, _: &str) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn say(&mut self, _: &str) {}
}

/// The steps of a task, whose progress a listener receives.
pub struct Steps<'a> {
    listener: &'a mut dyn Listener,
    task: String,
    done: u64,
    of: u64,
}

impl<'a> Steps<'a> {
    /// Begins a task of `of` steps.
    pub fn new(listener: &'a mut dyn Listener, task: impl Into<String>, of: usize) -> Steps<'a> {
        Steps { listener, task: task.into(), done: 0, of: of as u64 }
    }

    /// Begins the next step.
    ///
    /// # Errors
    /// The listener cancels the study.
    pub fn next(&mut self, step: &str) -> Result<(), StudyError> {
        let flow = self.listener.progress(&self.task, self.done, self.of, step);
        self.done += 1;
        if flow.is_break() { Err(StudyError::Cancelled) } else { Ok(()) }
    }

    /// Counts skipped steps as done.
    pub fn skip(&mut self, steps: usize) {
        self.done += steps as u64;
    }
}

/// A device, and a scene with the cameras that look at it.
pub struct Subject {
    /// The device. A study draws with its own contexts.
    pub device: Backend,
    /// Name of the scene in results.
    pub name: String,
    /// Scene to draw.
    pub scene: Arc<Scene>,
    /// Cameras, with the size of their pictures; at least one. They are in the scene's coordinates:
    /// [`Camera::relative_to`] with [`Scene::offset`] converts the cameras of files.
    pub cameras: Vec<Camera>,
}

impl Subject {
    /// Returns the first camera.
    ///
    /// # Errors
    /// The subject has no camera.
    pub fn first(&self) -> Result<&Camera, StudyError> {
        self.cameras.first().ok_or(StudyError::NoCameras)
    }

    /// Creates a session that draws the scene with a graph.
    ///
    /// # Errors
    /// The device cannot create another context.
    pub fn session(&self, pipeline: &str, set: &[(String, String)]) -> Result<Session, StudyError> {
        Ok(Session::new(self.device.new_context()?, self.scene.clone(), pipeline, set))
    }

    /// Describes the device and its driver.
    pub fn device_name(&self) -> String {
        let info = self.device.info();
        format!("{} ({})", info.name, info.driver)
    }

    /// Reads the graphs, to report mistakes before anything is measured. Returns their [files](Subject::files). Errors
    /// of shaders are reported only when a graph is drawn.
    ///
    /// # Errors
    /// The subject has no camera, the device cannot create another context, a graph cannot be read, a value of a
    /// parameter is invalid, or a requirement of a graph is not met.
    pub fn check(&self, settings: &[Setting]) -> Result<Vec<Wanted>, StudyError> {
        let first = self.first()?;
        let mut session = self.session("", &[])?;
        for setting in settings {
            session.set_graph(&setting.pipeline, &setting.set);
            session.controls((first.width, first.height))?;
        }
        self.files_of(&mut session, settings)
    }

    /// Tells the listener how many cameras see no splat, if there are any. Does nothing for a scene without splats:
    /// drawing it is an error that says why it is empty.
    ///
    /// # Errors
    /// No camera sees a splat: all pictures would be equal, because they are empty. Or an exact picture does not fit in
    /// memory.
    pub fn check_views(&self, listener: &mut dyn Listener) -> Result<(), StudyError> {
        let note =
            blind::check(&self.scene, &self.blind()?, self.cameras.len()).map_err(StudyError::Input)?;
        let say = |note| listener.say(&format!("{note}; in their views, nothing has an error"));
        note.into_iter().for_each(say);
        Ok(())
    }

    /// Returns the cameras that see no splat; none for a scene without splats.
    ///
    /// # Errors
    /// An exact picture does not fit in memory.
    pub fn blind(&self) -> Result<Vec<Camera>, StudyError> {
        let mut blind = Vec::new();
        for camera in self.cameras.iter().filter(|_| self.scene.count() > 0) {
            if !blind::sees(&self.scene, camera)? {
                blind.push(camera.clone());
            }
        }
        Ok(blind)
    }

    /// Lists the files of graphs and their shaders. For a graph with errors, the list may be incomplete.
    ///
    /// # Errors
    /// The subject has no camera, or the device cannot create another context.
    pub fn files(&self, settings: &[Setting]) -> Result<Vec<Wanted>, StudyError> {
        self.files_of(&mut self.session("", &[])?, settings)
    }

    fn files_of(&self, session: &mut Session, settings: &[Setting]) -> Result<Vec<Wanted>, StudyError> {
        let first = self.first()?;
        for setting in settings {
            // Compiled shaders are shared, so the study does not compile them again.
            let _ = session.plan_of(&setting.pipeline, &setting.set, (first.width, first.height));
        }
        Ok(session.files())
    }
}

/// An error of a study.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A session failed, for example because a graph has errors.
    // Not transparent: a graph's errors are found among the causes, and printed with their source text.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// Two pictures cannot be compared.
    #[error("{0}")]
    Metric(#[from] MetricError),
    /// A picture cannot be encoded or written.
    #[error("{0}")]
    Image(#[from] ImageError),
    /// A plot cannot be drawn.
    #[error("{0}")]
    Plot(#[from] PlotError),
    /// An exact picture does not fit in memory.
    #[error("{0}")]
    Memory(#[from] PictureMemoryError),
    /// A scene cannot be generated.
    #[error("{0}")]
    Scene(#[from] SynthError),
    /// A file of results cannot be written.
    #[error("{0}")]
    Output(#[from] OutputError),
    /// One of several settings or views failed.
    #[error("{name}: {error}")]
    Of {
        /// The name of the setting or the view.
        name: String,
        /// Error of the setting or view.
        #[source]
        error: Box<StudyError>,
    },
    /// The inputs cannot be measured, for the given reason.
    #[error("{0}")]
    Input(String),
    /// No setting has a name that begins with the given text.
    #[error("expected a prefix of one of these settings' names: {}; found `{name}`", known.join(", "))]
    UnknownSetting {
        /// The text that was given.
        name: String,
        /// The names of all settings.
        known: Vec<String>,
    },
    /// The subject has no camera.
    #[error("expected at least one camera, found none")]
    NoCameras,
    /// The listener cancelled the study.
    #[error("the study was cancelled")]
    Cancelled,
}

impl StudyError {
    /// Returns a function that adds the name of a setting or a view to an error.
    pub fn of<E: Into<StudyError>>(name: &str) -> impl FnOnce(E) -> StudyError {
        move |error| StudyError::Of { name: name.to_owned(), error: Box::new(error.into()) }
    }
}

impl From<BackendError> for StudyError {
    fn from(error: BackendError) -> StudyError {
        StudyError::Session(error.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A listener that keeps its progress reports, and cancels at the report with the given number, counted from 1.
    struct Kept(Vec<String>, usize);

    impl Listener for Kept {
        fn progress(&mut self, task: &str, done: u64, of: u64, step: &str) -> ControlFlow<()> {
            self.0.push(format!("{task}: {done} of {of}, {step}"));
            if self.0.len() < self.1 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        }

        fn say(&mut self, _: &str) {}
    }

    #[test]
    fn steps_are_counted_and_a_listener_cancels_at_one_of_them() {
        let mut kept = Kept(Vec::new(), 2);
        let mut steps = Steps::new(&mut kept, "measuring", 5);
        assert!(steps.next("a").is_ok());
        steps.skip(2);
        assert!(matches!(steps.next("b"), Err(StudyError::Cancelled)));
        assert_eq!(kept.0, ["measuring: 0 of 5, a", "measuring: 3 of 5, b"]);
    }
}
