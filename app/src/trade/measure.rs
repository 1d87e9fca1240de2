//! Draws one setting of one view, and measures its time, memory and error.

use super::error::{self, Error};
use super::settings::Setting;
use crate::image::Image;
use crate::session::{Session, SessionError};
use crate::shot::{self, ShotError};
use crate::stats::CameraStats;
use crate::truth::Truth;
use crate::turns::{self, Effort, Figure, Timed, Timestamps};
use serde::{Deserialize, Serialize};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Rules, depth_order};
use std::collections::BTreeMap;

/// A camera with the truth about its picture.
pub struct View {
    /// The camera, in the size of the pictures.
    pub camera: Camera,
    /// The true picture.
    pub picture: Image,
    /// True for each pixel that a splat shows in.
    pub covered: Vec<bool>,
    /// The splats beyond the near plane, near to far; empty if their order is not to be compared.
    pub order: Vec<u32>,
}

impl View {
    /// Draws the exact picture by the published rules as the truth, with progress. The order is not compared.
    pub fn exact(scene: &Scene, camera: &Camera) -> View {
        let truth = Truth::draw(scene, camera, [0.0; 3], &Rules::PUBLISHED);
        View {
            camera: camera.clone(),
            picture: truth.image(),
            covered: truth.picture.transmittance.iter().map(|share| *share < 1.0).collect(),
            order: Vec::new(),
        }
    }

    /// Adds the order of the splats.
    pub fn with_order(self, scene: &Scene) -> View {
        View { order: depth_order(scene, &self.camera, &Rules::PUBLISHED), ..self }
    }
}

/// The time of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Milliseconds on the GPU: the median of the rounds' medians.
    pub gpu_ms: f64,
    /// The largest of the rounds' medians without the smallest, in milliseconds.
    pub spread_ms: f64,
    /// The share of the exact settings' time, measured in the same rounds: the median of the rounds.
    pub of_exact: f64,
    /// Milliseconds per phase: the median of the rounds' medians.
    pub phases: BTreeMap<String, f64>,
    /// The largest of a phase's rounds without the smallest, in milliseconds.
    pub phase_spreads: BTreeMap<String, f64>,
}

/// A line of the ledger: a setting in a view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The setting's name.
    pub setting: String,
    /// The camera's name.
    pub camera: String,
    /// The measurements, or the reason that the setting cannot be drawn.
    pub found: Result<Measured, String>,
}

/// The measurements of a setting in a view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The time of a frame; `None` if the device has no timestamps.
    pub time: Option<Time>,
    /// The error of the picture.
    pub error: Error,
    /// Pairs of visible splats that are drawn in another order than that of their depth; `None` if the graph has no order.
    pub inversions: Option<u64>,
    /// Bytes of memory on the device.
    pub gpu_bytes: u64,
}

/// Measures a setting. `exact` is prepared with the exact settings in the view's size, and takes turns with `session`.
///
/// # Errors
/// The device fails. A setting that cannot be drawn is a row that says why.
pub fn measure<D: Device>(
    session: &mut Session<D>,
    exact: &mut Session<D>,
    setting: &Setting,
    view: &View,
    effort: Effort,
) -> Result<Row, SessionError> {
    let found = match measured(session, exact, setting, view, effort) {
        Ok(found) => found,
        Err(SessionError::Graph(errors)) => Err(errors.text(false).trim().to_owned()),
        Err(error @ (SessionError::Full { .. } | SessionError::NoRoom { .. })) => Err(error.to_string()),
        Err(error) => return Err(error),
    };
    Ok(Row { setting: setting.name.clone(), camera: view.camera.img_name.clone(), found })
}

fn measured<D: Device>(
    session: &mut Session<D>,
    exact: &mut Session<D>,
    setting: &Setting,
    view: &View,
    effort: Effort,
) -> Result<Result<Measured, String>, SessionError> {
    session.set_graph(&setting.pipeline, &setting.set);
    session.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
    let drawn = match draw(session, view)? {
        Ok(drawn) => drawn,
        Err(text) => return Ok(Err(text)),
    };
    let time = time_in_turns(session, exact, &view.camera, effort)?;
    let gpu_bytes = session.device().memory().iter().map(|(_, bytes)| bytes).sum();
    Ok(Ok(Measured { time, error: drawn.error, inversions: drawn.inversions, gpu_bytes }))
}

/// Measures the time of a frame of `session`, in turns with frames of `baseline`; `None` without timestamps.
///
/// Both are prepared in the camera's size.
///
/// # Errors
/// The device fails.
pub fn time_in_turns<D: Device>(
    session: &mut Session<D>,
    baseline: &mut Session<D>,
    camera: &Camera,
    effort: Effort,
) -> Result<Option<Time>, SessionError> {
    let mut of_each =
        turns::in_turns(&mut [&mut *baseline, &mut *session], camera, effort, Timestamps::Passes)?
            .into_iter();
    let (of_baseline, of_session) = (of_each.next().unwrap_or_default(), of_each.next().unwrap_or_default());
    let mut rounds = Vec::new();
    for (of_baseline, of_session) in of_baseline.into_iter().zip(of_session) {
        rounds.push((stats(session, camera, of_session)?, stats(baseline, camera, of_baseline)?.gpu_ms));
    }
    Ok(time(&mut rounds))
}

/// Measures the time of a frame of a prepared session, which is its own baseline; `None` without timestamps.
///
/// # Errors
/// The device fails.
pub fn time_alone<D: Device>(
    session: &mut Session<D>,
    camera: &Camera,
    effort: Effort,
) -> Result<Option<Time>, SessionError> {
    let mut rounds = Vec::new();
    for round in
        turns::in_turns(&mut [&mut *session], camera, effort, Timestamps::Passes)?.into_iter().flatten()
    {
        let stats = stats(session, camera, round)?;
        let baseline = stats.gpu_ms;
        rounds.push((stats, baseline));
    }
    Ok(time(&mut rounds))
}

/// Summarises the rounds; `None` without timestamps.
fn time(rounds: &mut [(CameraStats, Option<f64>)]) -> Option<Time> {
    let mut shares =
        rounds.iter().map(|(stats, exact)| Some(stats.gpu_ms? / (*exact)?)).collect::<Option<Vec<f64>>>()?;
    shares.sort_by(f64::total_cmp);
    let ms = |stats: &CameraStats| stats.gpu_ms.unwrap_or(f64::INFINITY);
    rounds.sort_by(|(a, _), (b, _)| ms(a).total_cmp(&ms(b)));
    let (middle, _) = rounds.get(rounds.len() / 2)?;
    let (first, last) = (&rounds.first()?.0, &rounds.last()?.0);
    let figure = |name: &String| {
        let of = |(stats, _): &(CameraStats, Option<f64>)| stats.phases.get(name).and_then(|ms| ms.as_f64());
        Figure::of(rounds.iter().map(|round| vec![of(round)])).map(|figure| (name.clone(), figure))
    };
    let phases: Vec<(String, Figure)> = middle.phases.keys().filter_map(figure).collect();
    let each =
        |of: fn(&Figure) -> f64| phases.iter().map(|(name, figure)| (name.clone(), of(figure))).collect();
    Some(Time {
        gpu_ms: ms(middle),
        spread_ms: ms(last) - ms(first),
        of_exact: shares[shares.len() / 2],
        phases: each(|figure| figure.median),
        phase_spreads: each(|figure| figure.spread),
    })
}

/// A picture with what is known of it.
pub struct Drawn {
    /// The picture.
    pub picture: Image,
    /// Its error.
    pub error: Error,
    /// As [`Measured::inversions`].
    pub inversions: Option<u64>,
    /// The graph's counts, such as `visible` and `drawn`.
    pub counts: Vec<(String, u32)>,
}

/// Draws a picture with a prepared session, and compares it and the order of its splats with the truth.
///
/// # Errors
/// The device fails. The inner error says why the picture cannot be compared.
pub fn draw<D: Device>(session: &mut Session<D>, view: &View) -> Result<Result<Drawn, String>, SessionError> {
    // The second frame: one with the order of the last frame has one.
    turns::frame(session, &view.camera)?;
    let shot = match shot::take(session, &view.camera) {
        Ok(shot) => shot,
        Err(ShotError::Session(error)) => return Err(error),
        Err(error) => return Ok(Err(error.to_string())),
    };
    let error = match error::measure(&shot.image, &view.picture, &view.covered) {
        Ok(error) => error,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let order = shot.order.filter(|_| !view.order.is_empty());
    let inversions = order.and_then(|order| shot::wrong_pairs(&view.order, &order));
    Ok(Ok(Drawn { picture: shot.image, error, inversions, counts: shot.counts }))
}

fn stats<D: Device>(
    session: &mut Session<D>,
    camera: &Camera,
    round: Vec<Timed>,
) -> Result<CameraStats, SessionError> {
    let frames: Vec<_> = round.into_iter().map(|frame| frame.result).collect();
    let loaded = session.scene().count().into();
    let camera = (camera.img_name.as_str(), (camera.width, camera.height));
    let info = session.device().info().clone();
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    Ok(CameraStats::new(camera, plan, &info, loaded, &frames, Vec::new()))
}
