//! Draws a picture and compares it with the truth, and times its frames.

use super::error::{self, Error};
use super::time::{Baseline, Time, Until, time_in_turns};
use crate::draw::capture::{self, Capture};
use crate::draw::interleaved::{self, Effort};
use crate::draw::session::{Session, SessionError};
use crate::draw::truth::Truth;
use crate::io::image::Image;
use serde::{Deserialize, Serialize};
use splatgraph_api::{BackendError, Device, OUTPUT_READBACK};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::plan::Plan;
use splatgraph_reference::metrics::flip::Seen;
use splatgraph_reference::{PictureMemoryError, Rules, depth_order};
use std::panic::resume_unwind;
use std::thread::{Builder, Scope, ScopedJoinHandle};

/// A camera with the true picture and the true order of the splats.
pub struct View {
    /// The camera, with the size of the pictures.
    pub camera: Camera,
    /// The true picture: the exact renderer's, or a given one.
    picture: Image,
    /// True for each pixel that a splat contributes to.
    pub covered: Vec<bool>,
    /// The true picture in 8 bits, after the filters of FLIP.
    seen: Seen,
    /// Indices of the splats beyond the near plane, near to far; empty if orders are not compared.
    pub order: Vec<u32>,
}

impl View {
    /// Draws the exact picture by the scene's rules, and shows the progress. The order stays empty.
    ///
    /// # Errors
    /// The picture does not fit in memory.
    pub fn exact(scene: &Scene, camera: &Camera) -> Result<View, PictureMemoryError> {
        let truth = Truth::draw(scene, camera, [0.0; 3], &Rules::of_view(scene, camera))?;
        let picture = truth.image();
        Ok(View {
            camera: camera.clone(),
            covered: truth.picture.transmittance.iter().map(|share| *share < 1.0).collect(),
            seen: Seen::of_8_bits((&picture).into()),
            order: Vec::new(),
            picture,
        })
    }

    /// Replaces the true picture. `covered` and `order` stay those of the exact picture.
    pub fn with_picture(self, picture: Image) -> View {
        View { seen: Seen::of_8_bits((&picture).into()), picture, ..self }
    }

    /// Returns the true picture.
    pub fn picture(&self) -> &Image {
        &self.picture
    }

    /// Adds the true order of the splats.
    pub fn with_order(self, scene: &Scene) -> View {
        View { order: depth_order(scene, &self.camera, &Rules::of_view(scene, &self.camera)), ..self }
    }
}

/// The measurements of a session in a view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The time of a frame; `None` if the device has no timestamps.
    pub time: Option<Time>,
    /// The error of the picture.
    pub error: Error,
    /// Number of pairs of visible splats that are drawn out of depth order. `None` if the graph has no readable order,
    /// if the order repeats a splat or has one that [`View::order`] lacks, or if orders are not compared. An empty
    /// order always gives 0.
    pub inversions: Option<u64>,
    /// True if the plan reads the previous frame: a still view then hides the lag behind a moving camera.
    pub of_last_frame: bool,
    /// Bytes of memory on the device, without the buffer that reads the picture back.
    pub gpu_bytes: u64,
}

/// A measurement whose comparison may still run, on a thread of the scope.
pub struct Measuring<'scope> {
    /// The time of a frame; `None` without timestamps, or if the comparison had failed before the time was measured.
    pub time: Option<Time>,
    of_last_frame: bool,
    gpu_bytes: u64,
    comparison: Comparison<'scope>,
}

enum Comparison<'scope> {
    Running(ScopedJoinHandle<'scope, Result<Drawn, String>>),
    Done(Result<Drawn, String>),
}

impl Measuring<'_> {
    /// Waits for the comparison. Also returns the picture with its counts.
    ///
    /// # Errors
    /// The reason that the picture cannot be compared.
    pub fn finish(self) -> Result<(Measured, Drawn), String> {
        let drawn = match self.comparison {
            Comparison::Running(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
            Comparison::Done(drawn) => drawn,
        }?;
        let Measuring { time, of_last_frame, gpu_bytes, .. } = self;
        let (error, inversions) = (drawn.error.clone(), drawn.inversions);
        Ok((Measured { time, error, inversions, of_last_frame, gpu_bytes }, drawn))
    }
}

/// Starts a thread of a scope.
///
/// # Errors
/// The thread cannot be started, for example at a limit of processes.
pub fn start<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() -> T + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, T>, SessionError> {
    let failed = |error: std::io::Error| BackendError::Api {
        call: "the start of a thread",
        answer: error.to_string(),
    };
    Ok(Builder::new().spawn_scoped(scope, work).map_err(failed)?)
}

/// Draws a view with a prepared session, and measures its time, interleaved with a baseline.
///
/// The picture is compared with the truth on another thread; on a device that is a CPU, before the time is measured.
/// A picture whose comparison has failed by then gets no time.
///
/// # Errors
/// The session fails. A picture that cannot be compared is an error of [`Measuring::finish`].
pub fn measure<'scope>(
    scope: &'scope Scope<'scope, '_>,
    session: &mut Session,
    baseline: Baseline,
    view: &'scope View,
    effort: Effort,
    until: Until,
) -> Result<Measuring<'scope>, SessionError> {
    let comparison = match capture(session, view)? {
        // The frames run on the same cores, which a comparison would slow down.
        Ok(capture) if session.device().info().is_cpu() => Comparison::Done(compare(capture, view)),
        Ok(capture) => Comparison::Running(start(scope, || compare(capture, view))?),
        Err(text) => Comparison::Done(Err(text)),
    };
    let time = match comparison {
        Comparison::Done(Err(_)) => None,
        _ => time_in_turns(session, baseline, &view.camera, effort, until)?,
    };
    let memory = session.device().memory();
    Ok(Measuring {
        time,
        of_last_frame: session.plan().is_some_and(Plan::carries_state),
        // Only the capture reads the picture back.
        gpu_bytes: memory.iter().filter(|(name, _)| name != OUTPUT_READBACK).map(|(_, bytes)| bytes).sum(),
        comparison,
    })
}

/// A picture, with its error and counts.
pub struct Drawn {
    /// Picture that the device drew.
    pub picture: Image,
    /// Error of the picture against the truth.
    pub error: Error,
    /// Number of pairs of splats in the wrong order; see [`Measured::inversions`].
    pub inversions: Option<u64>,
    /// The graph's counts, such as `visible` and `drawn`.
    pub counts: Vec<(String, u32)>,
}

/// Number of frames of a still view, of which the last is measured. A graph that reuses the previous frame's order
/// needs a frame before it. Histories begin with the first of these frames.
pub const MEASURED_FRAME: u32 = 2;

/// Says what a measurement does not show of a graph that reads the previous frame.
pub fn of_last_frame() -> String {
    format!(
        "Its picture is frame {MEASURED_FRAME} of a still view, without the errors of a moving camera (`popping` measures them); an average over frames has not converged"
    )
}

fn capture(session: &mut Session, view: &View) -> Result<Result<Capture, String>, SessionError> {
    session.restart()?;
    for _ in 1..MEASURED_FRAME {
        interleaved::frame(session, &view.camera)?;
    }
    match capture::take(session, &view.camera) {
        Ok(capture) => Ok(Ok(capture)),
        Err(error @ SessionError::Pixels(_)) => Ok(Err(error.to_string())),
        Err(error) => Err(error),
    }
}

fn compare(capture: Capture, view: &View) -> Result<Drawn, String> {
    let Capture { image, order, counts } = capture;
    // An empty `view.order` means that orders are not compared, unless the drawn order is empty, too: then no pair is
    // wrong.
    let order = order.filter(|order| order.is_empty() || !view.order.is_empty());
    let (error, inversions) = rayon::join(
        || {
            error::measure(&image, &view.picture, &view.covered, &view.seen)
                .map_err(|error| error.to_string())
        },
        || order.and_then(|order| capture::wrong_pairs(&view.order, &order)),
    );
    Ok(Drawn { error: error?, picture: image, inversions, counts })
}
