//! Draws frames with a device, a scene and a plan.
//!
//! A [`Session`] owns all three. [`Session::prepare`] builds the plan for a picture size and loads it with the scene.
//! [`Session::submit`] draws a frame from a camera, and [`Session::wait`] returns its results. Up to
//! [`FRAMES_IN_FLIGHT`](splatgraph_api::FRAMES_IN_FLIGHT) frames may be in flight.
//!
//! All results are of complete frames. If a list overflowed in a frame (see [`capacity`](crate::draw::capacity)),
//! [`Session::wait`] builds a plan with more capacity and draws the frame again with the same inputs. The later frames
//! in flight are repeated when they are waited for. The larger capacity is kept for pictures of all sizes, unless the
//! default for another size is larger, until [`Session::set_graph`] or [`Session::set_scene`].
//!
//! A repeated frame starts with the state ([`Plan::is_state`]) that the graph had before it. Therefore, if a graph has
//! both growing lists and state, the state is copied before each frame, and each frame is complete before the next is
//! submitted.

use crate::draw::animation::background_note;
use crate::draw::backend::Backend;
use crate::draw::capacity::Capacities;
use crate::draw::fit;
use crate::draw::inspect::InspectError;
use crate::draw::planner::{self, GraphErrors, Planner};
use crate::draw::projection::ProjectionError;
use crate::draw::storage::{Choice, StorageError};
use crate::io::output::say;
use splatgraph_api::{BackendError, Device, FrameId, FrameResult, Inspect, Loader, Progress, SceneData};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::{Fallback, Source};
use splatgraph_framework::lower::Control;
use splatgraph_framework::plan::{Plan, Warning};
use splatgraph_framework::reload::Wanted;
use splatgraph_framework::shader::Cancel;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::sync::Arc;
use std::time::Instant;
use tracing::info_span;

mod early;
mod flight;
mod pixels;

pub use early::EarlyPlan;
pub use pixels::{PixelsError, image_of};

/// Error of a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The graph or its shaders have errors.
    #[error(transparent)]
    Graph(#[from] GraphErrors),
    /// The device rejected the plan, or failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The camera is not a pinhole, and its projection differs from the graph's.
    #[error(transparent)]
    Projection(#[from] ProjectionError),
    /// The scene has no splats, and the plan cannot be built.
    #[error(
        "expected a scene with splats, found one without ({dropped} dropped), which the graph cannot draw:\n{errors}"
    )]
    NoSplats {
        /// Number of splats in the file or the arrays that were dropped because they cannot be drawn.
        dropped: u64,
        /// Errors of the graph. Their text is part of this error's message, so they are not a `source`.
        errors: GraphErrors,
    },
    /// No plan is loaded: [`Session::prepare`] was not called, or not after a change of graph, scene or outputs.
    #[error("no plan: `prepare` must be called before `submit`")]
    NotPrepared,
    /// The camera has another size than the pictures for which the plan was prepared.
    #[error(
        "expected a camera of {} x {} pixels, the prepared size, found one of {} x {}",
        prepared.0, prepared.1, found.0, found.1
    )]
    OtherSize {
        /// Width and height in pixels, as given to [`Session::prepare`].
        prepared: (u32, u32),
        /// Width and height of the camera.
        found: (u32, u32),
    },
    /// The camera is unusable; see [`Camera::fault`].
    #[error("{0}")]
    Camera(String),
    /// A value in [`FrameOptions::live`] has no live parameter, or is not in its range.
    #[error("{0}")]
    Live(String),
    /// A frame needs more capacity than the parameter's range allows.
    #[error(
        "expected a frame that needs at most {most} {parameter}, the end of the parameter's range, found one that needs {needed}"
    )]
    Full {
        /// Name of the parameter that cannot grow.
        parameter: String,
        /// Maximum of the parameter's range.
        most: i64,
        /// Number of entries that the frame needs.
        needed: i64,
    },
    /// A frame needs more capacity, but the larger plan cannot be built or loaded.
    #[error(
        "expected a device with room for the {needed} {parameter} that a frame needs, found none:\n{error}"
    )]
    NoRoom {
        /// Name of the parameter that grows.
        parameter: String,
        /// Number of entries that the frame needs.
        needed: i64,
        /// Error of the larger plan. Its text is part of this error's message, so it is not a `source`.
        error: Box<SessionError>,
    },
    /// The device returned no picture, or one that cannot be converted to an image.
    #[error(transparent)]
    Pixels(#[from] PixelsError),
    /// A frame must be repeated, but the larger plan lacks the inspected resource or pass.
    #[error(transparent)]
    Inspect(#[from] InspectError),
}

/// Plans of a graph for picture sizes, with the default capacities; see [`Session::plan_of`].
pub type Built = Arc<Vec<((u32, u32), Plan)>>;

/// A device, a scene and a plan, which draw frames; see the [module documentation](self).
///
/// Shaders are compiled in this process, which an invalid shader can crash. For graphs of others, a program first calls
/// [`planner::configure`] with a [`worker`](planner::Settings::worker).
pub struct Session {
    device: Backend,
    scene: Arc<Scene>,
    pipeline: String,
    set: Vec<(String, String)>,
    planner: Planner,
    /// Warnings of plans that were printed.
    told_warnings: Vec<Warning>,
    /// Fallbacks of the last report.
    told: Vec<Fallback>,
    /// Settings without an effect, and graphs in place of files, that were reported.
    told_settings: BTreeSet<String>,
    loaded: Option<(Arc<Plan>, (u32, u32))>,
    /// Result of [`saves_state`] for the loaded plan: every frame asks for it.
    saves_state: bool,
    /// Plans of the current graph, settings and scene; empty if none were given. See [`Session::set_planned`].
    built: Built,
    /// Plan for a picture size that this planner built ahead, with the default capacities; see [`Session::with_plan`].
    early: Option<((u32, u32), Plan)>,
    frame: u32,
    /// Frames in flight of plans whose lists can grow, in the order of submission, with the inputs to repeat them.
    flying: Vec<Flight>,
    /// Results of frames that were completed before they were waited for; see [`Session::submit`].
    finished: BTreeMap<FrameId, Result<FrameResult, SessionError>>,
    growths: u32,
    /// Time at which the last frame was known to be complete; `None` before the first.
    completed: Option<Instant>,
    /// Cancels builds and loads; see [`Session::set_cancel`].
    cancel: Cancel,
}

/// A submitted frame without a result yet.
struct Flight {
    id: FrameId,
    camera: Camera,
    request: FrameOptions,
    number: u32,
    plan: Arc<Plan>,
    growths: u32,
}

/// Options of a frame: background, results to read back, and timestamps.
#[derive(Clone, Debug, Default)]
pub struct FrameOptions {
    /// Background colour, display-encoded.
    pub background: [f32; 3],
    /// True to read back the picture.
    pub read_output: bool,
    /// Values of live parameters in this frame, as texts; the others have the plan's values.
    pub live: Vec<(String, String)>,
    /// Resources to read back, each after a pass.
    pub inspect: Vec<Inspect>,
    /// True to omit the timestamps of passes; see [`untimed_passes`](splatgraph_api::FrameInputs::untimed_passes).
    pub untimed_passes: bool,
    /// True if the frame is not measured. The timeline marks such frames.
    pub warm_up: bool,
}

impl Session {
    /// Creates a session that draws `scene` with a graph. No plan is built yet.
    ///
    /// `pipeline` is a preset's name or a path; `set` are the graph's parameters.
    pub fn new(
        device: Backend,
        scene: impl Into<Arc<Scene>>,
        pipeline: &str,
        set: &[(String, String)],
    ) -> Session {
        Session {
            device,
            scene: scene.into(),
            pipeline: pipeline.to_owned(),
            set: set.to_vec(),
            planner: Planner::default(),
            told_warnings: Vec::new(),
            told: Vec::new(),
            told_settings: BTreeSet::new(),
            loaded: None,
            saves_state: false,
            built: Built::default(),
            early: None,
            frame: 0,
            flying: Vec::new(),
            finished: BTreeMap::new(),
            growths: 0,
            completed: None,
            cancel: Cancel::default(),
        }
    }

    /// Gives a new session its planner: with its own settings, or with texts in place of files.
    pub fn with_planner(self, planner: Planner) -> Session {
        Session { planner, ..self }
    }

    /// Gives a new session its first plan, which [`Session::prepare`] only loads if the size is the plan's.
    ///
    /// The plan must be of the session's graph, parameters, scene and device. It is discarded like a loaded one. The
    /// outputs for which it was built are requested from then on.
    pub fn with_plan(self, early: EarlyPlan) -> Session {
        let EarlyPlan { planner, size, plan } = early;
        Session { planner, early: Some((size, plan)), ..self }
    }

    /// Opens another session on the same device and scene, with another graph.
    ///
    /// # Errors
    /// The device cannot open another context, for example because its memory is full.
    pub fn beside(&self, pipeline: &str, set: &[(String, String)]) -> Result<Session, SessionError> {
        self.beside_with(self.scene.clone(), pipeline, set)
    }

    /// Opens another session on the same device, with its own scene, graph and parameters.
    ///
    /// # Errors
    /// The device cannot open another context, for example because its memory is full.
    pub fn beside_with(
        &self,
        scene: impl Into<Arc<Scene>>,
        pipeline: &str,
        set: &[(String, String)],
    ) -> Result<Session, SessionError> {
        Ok(Session::new(self.device.new_context()?, scene, pipeline, set))
    }

    /// Gives every resource its own memory from the next [`Session::prepare`], so that its contents can be read after
    /// any pass. Discards the plan and frames in flight.
    pub fn keep_contents(&mut self) {
        self.planner.share_memory = false;
        self.forget_plan();
    }

    /// Requests outputs of the graph besides its picture, such as `depth`, from the next [`Session::prepare`]. If the
    /// names change, discards the plan and frames in flight.
    ///
    /// [`outputs::draw`](crate::draw::outputs::draw) reads them.
    pub fn set_outputs(&mut self, names: &[String]) {
        if self.planner.outputs != names {
            self.planner.outputs = names.to_vec();
            self.forget_plan();
        }
    }

    /// Returns the names of the requested outputs.
    pub fn outputs(&self) -> &[String] {
        &self.planner.outputs
    }

    /// Changes the graph and its parameters from the next [`Session::prepare`].
    ///
    /// Discards the plan and frames in flight, and resets growing parameters to their defaults, so that a measurement
    /// does not depend on earlier ones. Files that were read before are not read again; see [`Session::forget_files`].
    pub fn set_graph(&mut self, pipeline: &str, set: &[(String, String)]) {
        self.pipeline = pipeline.to_owned();
        self.set = set.to_vec();
        self.forget_plan();
        self.planner.capacities = Capacities::default();
    }

    /// Changes the graph like [`Session::set_graph`], to one whose plans are already built.
    ///
    /// [`Session::prepare`] uses the plan of `built` for its size, unless the plan has warnings, outputs are requested,
    /// contents are kept or a list grew. The plans must come from [`Session::plan_of`] with the same graph and
    /// parameters, of a session with the same device and scene.
    pub fn set_planned(&mut self, pipeline: &str, set: &[(String, String)], built: &Built) {
        self.set_graph(pipeline, set);
        self.built = built.clone();
    }

    /// Changes the graph like [`Session::set_graph`], after checking it and its parameters for pictures of this size.
    /// Reads its files again.
    ///
    /// # Errors
    /// The graph cannot be read, a value is invalid, or a requirement is not met. The loaded plan then stays.
    pub fn change_graph(
        &mut self,
        pipeline: &str,
        set: &[(String, String)],
        size: (u32, u32),
    ) -> Result<(), SessionError> {
        self.planner.forget_files();
        self.controls_of(pipeline, set, size)?;
        self.set_graph(pipeline, set);
        Ok(())
    }

    /// Changes the scene from the next [`Session::prepare`].
    ///
    /// Discards the plan and frames in flight, and resets growing parameters to their defaults.
    pub fn set_scene(&mut self, scene: impl Into<Arc<Scene>>) {
        self.scene = scene.into();
        self.forget_plan();
        self.planner.capacities = Capacities::default();
    }

    /// Reads graphs and shaders again from the next [`Session::prepare`]. Discards the plan and frames in flight.
    pub fn forget_files(&mut self) {
        self.planner.forget_files();
        self.forget_plan();
    }

    /// Sets the token that cancels later builds and loads. They fail soon after another thread has set it.
    pub fn set_cancel(&mut self, cancel: Cancel) {
        self.planner.set_cancel(cancel.clone());
        self.cancel = cancel;
    }

    fn forget_plan(&mut self) {
        self.loaded = None;
        self.early = None;
        self.built = Built::default();
        self.flying.clear();
        self.finished.clear();
    }

    /// Lists the graph's parameters with their values for a picture size.
    ///
    /// # Errors
    /// The graph cannot be read, a value is invalid, or a requirement is not met.
    pub fn controls(&mut self, size: (u32, u32)) -> Result<Vec<Control>, SessionError> {
        let (pipeline, set) = (self.pipeline.clone(), self.set.clone());
        self.controls_of(&pipeline, &set, size)
    }

    fn controls_of(
        &mut self,
        pipeline: &str,
        set: &[(String, String)],
        size: (u32, u32),
    ) -> Result<Vec<Control>, SessionError> {
        let (facts, catalog) = early::facts_of(&self.scene, &self.device.info().facts, size);
        Ok(self.planner.controls(pipeline, set, &facts, &catalog)?)
    }

    /// Builds the plan for a picture size, without loading it. Growing parameters have their defaults.
    ///
    /// # Errors
    /// See [`Planner::plan`].
    pub fn plan_for(&mut self, size: (u32, u32)) -> Result<Plan, SessionError> {
        let (pipeline, set) = (self.pipeline.clone(), self.set.clone());
        Ok(self.plan_of(&pipeline, &set, size)?)
    }

    /// Builds the plan of another graph for a picture size, without loading it. Growing parameters have their defaults.
    ///
    /// # Errors
    /// See [`Planner::plan`].
    pub fn plan_of(
        &mut self,
        pipeline: &str,
        set: &[(String, String)],
        size: (u32, u32),
    ) -> Result<Plan, GraphErrors> {
        let device = &self.device.info().facts;
        let capacities = std::mem::take(&mut self.planner.capacities);
        let plan = early::plan_on(&mut self.planner, (pipeline, set), &self.scene, device, size);
        self.planner.capacities = capacities;
        plan
    }

    /// Chooses the most accurate storage that fits in the device's memory and in `limit` bytes.
    ///
    /// The choice is for pictures of this size, and is set like [`Session::set_graph`]. Returns `None` like
    /// [`Choice::within`], and if there is no limit and the scene is small for the device. The storage is then
    /// unchanged.
    ///
    /// # Errors
    /// There is a limit, and the graph has errors, or no storage fits.
    pub fn choose_storage(
        &mut self,
        limit: Option<u64>,
        size: (u32, u32),
    ) -> Result<Option<Choice>, StorageError> {
        let (count, heap) = (self.scene.count().into(), self.device.heap());
        if limit.is_none() && !fit::may_exceed(count, size, &self.device.info().facts, &heap) {
            return Ok(None);
        }
        let (pipeline, mut set) = (self.pipeline.clone(), self.set.clone());
        let choice = Choice::within(limit, &heap, &set, |set| self.plan_of(&pipeline, set, size))?;
        let choice = choice.map(|(choice, _)| choice);
        if let Some(chosen) = choice.as_ref().and_then(|choice| choice.set.clone()) {
            set.push(chosen);
            self.set_graph(&pipeline, &set);
        }
        Ok(choice)
    }

    /// Returns the graph's name or path, and its parameters.
    pub fn graph(&self) -> (&str, &[(String, String)]) {
        (&self.pipeline, &self.set)
    }

    /// Returns the device, with the loaded plan.
    ///
    /// Take the results of a session's frames with [`Session::wait`] or [`Session::try_wait`], not from the device:
    /// incomplete frames would not be noticed.
    pub fn device(&mut self) -> &mut Backend {
        &mut self.device
    }

    /// Returns the device, so that it can be closed.
    pub fn into_device(self) -> Backend {
        self.device
    }

    /// Returns the scene that the session draws.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns a shared reference to the scene, for another session.
    pub fn shared_scene(&self) -> Arc<Scene> {
        self.scene.clone()
    }

    /// Lists the files from which the plans were built.
    pub fn files(&self) -> Vec<Wanted> {
        self.planner.wanted()
    }

    /// Returns the loaded plan; `None` before [`Session::prepare`], also after a change of graph, scene or outputs.
    pub fn plan(&self) -> Option<&Plan> {
        self.loaded.as_ref().map(|(plan, _)| plan.as_ref())
    }

    /// Returns how often a plan was rebuilt with more capacity. Later measurements are of another plan.
    pub fn growths(&self) -> u32 {
        self.growths
    }

    /// Returns true if [`Session::prepare`] has nothing to do for pictures of this size.
    pub fn is_prepared(&self, size: (u32, u32)) -> bool {
        self.loaded.as_ref().is_some_and(|(_, loaded)| *loaded == size)
    }

    /// Builds and loads the plan for pictures of this size, unless it is already loaded.
    ///
    /// Returns true if it loaded a plan; the next frame then runs the prologue. Prints to standard error each warning
    /// about a plan once, and the graphs of a choice that the device cannot run, whenever that list changes.
    ///
    /// # Errors
    /// The plan cannot be built (see [`Planner::plan`]), also because the scene has no splats; or the device rejects
    /// the plan, or fails.
    pub fn prepare(
        &mut self,
        size: (u32, u32),
        progress: &mut dyn FnMut(Progress),
    ) -> Result<bool, SessionError> {
        if self.is_prepared(size) {
            return Ok(false);
        }
        self.load(size, Former::Histories, progress)?;
        Ok(true)
    }

    /// Restarts the frames at number 0, so that a measurement does not depend on the frames before it.
    ///
    /// A plan with state is built and loaded again: histories are zero, and the next frame runs the prologue.
    ///
    /// # Errors
    /// See [`Session::prepare`].
    pub fn restart(&mut self) -> Result<(), SessionError> {
        self.frame = 0;
        match &self.loaded {
            Some((plan, size)) if plan.carries_state() => self.load(*size, Former::Nothing, &mut |_| {}),
            _ => Ok(()),
        }
    }

    /// Builds and loads the plan. Prints new warnings and fallbacks; see [`Session::prepare`].
    fn load(
        &mut self,
        size: (u32, u32),
        former: Former,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), SessionError> {
        let built = self.built.iter().find(|(of, _)| *of == size).map(|(_, plan)| plan);
        // The places of warnings are known only to the planner that built the plan.
        let is_usable = |plan: &&Plan| {
            let planner = &self.planner;
            plan.warnings.is_empty()
                && planner.share_memory
                && planner.outputs.is_empty()
                && planner.capacities == Capacities::default()
        };
        let plan = match built.filter(is_usable) {
            Some(plan) => plan.clone(),
            None => self.build(size)?,
        };
        let warnings = planner::new_warnings(&plan, &mut self.told_warnings);
        let _ = std::io::stderr().write_all(self.planner.warnings(&warnings, false).as_bytes());
        let is_file = self.pipeline.ends_with(".ron");
        if is_file
            && self.planner.is_built_in(&self.pipeline)
            && self.told_settings.insert(self.pipeline.clone())
        {
            say(format!("warning: {}", planner::replaced(&self.pipeline)));
        }
        if plan.fallbacks != self.told {
            self.told.clone_from(&plan.fallbacks);
            Fallback::lacking(&plan.fallbacks).for_each(say);
        }
        info_span!("load the plan").in_scope(|| {
            let loader = self.device.loader().cancelled_by(self.cancel.clone());
            let loader = match former {
                Former::Nothing => loader.clearing_histories(),
                Former::Histories => loader,
                Former::Frame { shares_results: false } => loader.restoring_histories(),
                Former::Frame { shares_results: true } => loader.restoring_histories().sharing_results(),
            };
            let ready = loader.prepare(plan.clone(), &Upload(Some(&self.scene)), progress)?;
            self.device.swap(ready)
        })?;
        self.saves_state = saves_state(&plan);
        self.loaded = Some((Arc::new(plan), size));
        Ok(())
    }

    fn build(&mut self, size: (u32, u32)) -> Result<Plan, SessionError> {
        if let Some((of, plan)) = self.early.take()
            && of == size
            && self.planner.capacities == Capacities::default()
        {
            return Ok(plan);
        }
        let graph = (self.pipeline.as_str(), self.set.as_slice());
        let plan = early::plan_on(&mut self.planner, graph, &self.scene, &self.device.info().facts, size);
        plan.map_err(|errors| match self.scene.count() {
            0 => SessionError::NoSplats { dropped: self.scene.dropped().total(), errors },
            _ => errors.into(),
        })
    }

    /// Lists the settings that have no effect in the current plan, as lines with reasons; empty without a plan. Each
    /// setting is listed once per session.
    ///
    /// An unused mesh is listed as well. Call this for settings of the user: measurements set parameters regardless of
    /// their effect.
    pub fn settings_without_effect(&mut self) -> Vec<String> {
        let Some((plan, _)) = &self.loaded else { return Vec::new() };
        let found = planner::without_effect(plan, &self.set).into_iter();
        let drawn = draws_mesh(plan);
        let asked = self.set.iter().any(|(name, _)| name == "mesh");
        let mesh = (self.scene.mesh().is_some() && !drawn && !asked).then(|| {
            ("the scene's mesh".to_owned(), "the graph draws no mesh, and the scene has one".to_owned())
        });
        let new = found.chain(mesh).filter(|(name, _)| self.told_settings.insert(name.clone()));
        new.map(|(_, text)| format!("{}: {text}", self.pipeline)).collect()
    }

    /// Returns a note for a background that the current plan ignores, once per session; see [`background_note`]. `None`
    /// without a plan.
    pub fn background_note(&mut self, background: [f32; 3]) -> Option<String> {
        let (plan, _) = self.loaded.as_ref()?;
        background_note(plan, background).filter(|_| self.told_settings.insert("--background".to_owned()))
    }
}

/// Returns true if frames of the plan may have to be repeated with more capacity.
fn can_grow(plan: &Plan) -> bool {
    plan.params.iter().any(|param| param.grows.is_some())
}

/// Returns true if the state is copied before each frame of the plan. A repeated frame then starts with the copy.
fn saves_state(plan: &Plan) -> bool {
    can_grow(plan) && plan.carries_state()
}

/// State that a plan takes over from the current one.
#[derive(Clone, Copy)]
enum Former {
    Nothing,
    Histories,
    /// State as it was before the last frame, which is repeated; and, if true, the results of `Once` passes.
    Frame {
        shares_results: bool,
    },
}

/// Returns true if a plan draws the scene's mesh.
pub fn draws_mesh(plan: &Plan) -> bool {
    let is_mesh =
        |source: &Source| matches!(source, Source::Scene { attribute, .. } if attribute.starts_with("mesh."));
    plan.resources.iter().any(|resource| is_mesh(&resource.source))
}

/// A scene, whose attributes a [`Device`] uploads; `None` for a graph that draws without a scene.
pub struct Upload<'a>(pub Option<&'a Scene>);

impl SceneData for Upload<'_> {
    fn write(&self, attribute: &str, plane: u32, offset: u64, target: &mut [u8]) -> Result<(), String> {
        match self.0 {
            Some(scene) => scene.write_attribute(attribute, plane, offset, target),
            None => Err(format!("expected a scene with `{attribute}`, found none")),
        }
    }

    fn identity(&self) -> u64 {
        self.0.map_or(0, Scene::identity)
    }
}

#[cfg(test)]
mod tests;
