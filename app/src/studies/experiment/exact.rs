//! Draws with every parameter at its exact value, except for the parameters that an experiment changes.

use crate::draw::capture::{self, Capture};
use crate::draw::session::{Session, SessionError};
use crate::studies::measurement::settings;
use crate::studies::study::StudyError;
use splatgraph_assets::Camera;

/// Name of the graph that the experiments draw.
pub const GRAPH: &str = "splat";

/// Gain of difference pictures: errors above 0.25 saturate.
pub const GAIN: f32 = 4.0;

/// Names and values of parameters, as `--set` takes them.
pub type Set = Vec<(String, String)>;

/// Sets the session's graph to [`GRAPH`], and lists the exact values of its parameters.
///
/// # Errors
/// The graph cannot be read, or a requirement is not met.
pub fn values(session: &mut Session, size: (u32, u32)) -> Result<Set, SessionError> {
    session.set_graph(GRAPH, &[]);
    let controls = session.controls(size)?;
    let all = settings::list(GRAPH, &controls, &[]);
    Ok(all.into_iter().find(|setting| setting.name == settings::EXACT).map_or_else(Set::new, |s| s.set))
}

pub(super) fn draw(
    session: &mut Session,
    exact: &Set,
    changes: &[(&str, &str)],
    camera: &Camera,
) -> Result<Capture, StudyError> {
    let kept = exact.iter().filter(|(name, _)| changes.iter().all(|(changed, _)| name != changed)).cloned();
    let changed = changes.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
    let set: Set = kept.chain(changed).collect();
    session.set_graph(GRAPH, &set);
    session.prepare((camera.width, camera.height), &mut |_| {})?;
    Ok(capture::take(session, camera)?)
}

/// Formats decibels; `None`, equal pictures, gives `inf`.
pub(super) fn decibels(psnr_db: Option<f64>) -> String {
    format!("{:.1}", psnr_db.unwrap_or(f64::INFINITY))
}
