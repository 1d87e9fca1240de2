//! Shows what an equation says on a scene, as a page that needs no other file.
//!
//! An experiment changes one thing, draws, and holds the pictures against the exact renderer's. [`order`] changes the order in
//! which splats are blended, with a worked example of [`two`] splats. [`sh`] leaves out bands of the spherical harmonics, on
//! the part of the picture that they matter most in, which [`gloss`] finds. Every number on a page is measured or computed
//! when the page is made. All else is at its exact value ([`exact`]), so that the one thing is the only cause.

pub mod gloss;
pub mod order;
pub mod sh;
pub mod two;

use crate::draw::capture::{self, Capture, CaptureError};
use crate::draw::session::{Session, SessionError};
use crate::io::image::ImageError;
use crate::io::report::plot::PlotError;
use crate::studies::metrics::MetricError;
use crate::studies::trade::settings;
use splatgraph_api::{BackendError, Device};
use splatgraph_assets::Camera;

/// The graph of the experiments.
pub const GRAPH: &str = "splat";

/// Amplification of the pictures of differences: a step of 8 bits is just visible, and a large error does not fill the picture.
pub const GAIN: f32 = 4.0;

/// An error of an experiment.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The graph has errors, or the device failed.
    // Not transparent: a graph's errors are found among the causes, and printed with their source text.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// A picture cannot be drawn.
    #[error("{0}")]
    Capture(#[from] CaptureError),
    /// Pictures cannot be compared.
    #[error("{0}")]
    Metric(#[from] MetricError),
    /// A picture cannot be encoded.
    #[error("{0}")]
    Image(#[from] ImageError),
    /// A plot cannot be drawn.
    #[error("{0}")]
    Plot(#[from] PlotError),
}

impl From<BackendError> for ExperimentError {
    fn from(error: BackendError) -> ExperimentError {
        ExperimentError::Session(error.into())
    }
}

/// Names and values of parameters, as `--set` takes them.
pub type Set = Vec<(String, String)>;

/// Lists the exact values of the graph's parameters for a picture size.
///
/// # Errors
/// The graph cannot be read.
pub fn exact<D: Device>(session: &mut Session<D>, size: (u32, u32)) -> Result<Set, SessionError> {
    session.set_graph(GRAPH, &[]);
    let controls = session.controls(size)?;
    let all = settings::list(GRAPH, &controls, &[]);
    Ok(all.into_iter().find(|setting| setting.name == settings::EXACT).map_or_else(Set::new, |s| s.set))
}

/// Draws with the exact values and some changes.
fn draw<D: Device>(
    session: &mut Session<D>,
    exact: &Set,
    changes: &[(&str, &str)],
    camera: &Camera,
) -> Result<Capture, ExperimentError> {
    let kept = exact.iter().filter(|(name, _)| changes.iter().all(|(changed, _)| name != changed)).cloned();
    let changed = changes.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
    let set: Set = kept.chain(changed).collect();
    session.set_graph(GRAPH, &set);
    session.prepare((camera.width, camera.height), &mut |_| {})?;
    Ok(capture::take(session, camera)?)
}

/// Formats decibels; no number for equal pictures.
fn decibels(psnr_db: Option<f64>) -> String {
    psnr_db.map_or_else(|| "equal".into(), |db| format!("{db:.1}"))
}
