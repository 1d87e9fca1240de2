//! Draws one setting of one view, and measures its time, memory and error.

use super::error::{self, Error};
use super::settings::Setting;
use crate::session::{FrameOptions, Session, SessionError};
use crate::shot::{self, ShotError};
use crate::stats::CameraStats;
use crate::truth::Truth;
use serde::{Deserialize, Serialize};
use splatgraph_api::{Device, FrameResult};
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Rules, depth_order};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Numbers of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Effort {
    /// Rounds, whose medians show the spread.
    pub rounds: u32,
    /// Frames of each in a round, in turns.
    pub frames: u32,
}

/// A camera with the truth about its picture.
pub struct View {
    /// The camera, in the size of the pictures.
    pub camera: Camera,
    /// The true picture.
    pub picture: crate::image::Image,
    /// True for each pixel that a splat shows in.
    pub covered: Vec<bool>,
    /// The splats beyond the near plane, near to far.
    pub order: Vec<u32>,
}

impl View {
    /// Takes an exact picture as the truth.
    pub fn exact(scene: &Scene, camera: &Camera, truth: &Truth, rules: &Rules) -> View {
        View {
            camera: camera.clone(),
            picture: truth.image(),
            covered: truth.picture.transmittance.iter().map(|share| *share < 1.0).collect(),
            order: depth_order(scene, camera, rules),
        }
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
    /// Milliseconds per phase, in the median round.
    pub phases: BTreeMap<String, f64>,
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
    let (error, inversions) = match drawn(session, view)? {
        Ok(drawn) => drawn,
        Err(text) => return Ok(Err(text)),
    };
    let mut rounds = Vec::new();
    for _ in 0..effort.rounds {
        let (mut of_exact, mut of_setting) = (Vec::new(), Vec::new());
        for _ in 0..effort.frames {
            of_exact.push(frame(exact, &view.camera)?);
            of_setting.push(frame(session, &view.camera)?);
        }
        rounds.push((stats(session, view, &of_setting)?, stats(exact, view, &of_exact)?.gpu_ms));
    }
    let gpu_bytes = session.device().memory().iter().map(|(_, bytes)| bytes).sum();
    Ok(Ok(Measured { time: time(&mut rounds), error, inversions, gpu_bytes }))
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
    let phase = |(name, ms): (&String, &serde_json::Value)| Some((name.clone(), ms.as_f64()?));
    Some(Time {
        gpu_ms: ms(middle),
        spread_ms: ms(last) - ms(first),
        of_exact: shares[shares.len() / 2],
        phases: middle.phases.iter().filter_map(phase).collect(),
    })
}

type Drawn = (Error, Option<u64>);

/// Draws a picture, and compares it and the order of its splats with the truth.
fn drawn<D: Device>(session: &mut Session<D>, view: &View) -> Result<Result<Drawn, String>, SessionError> {
    // The second frame: one with the order of the last frame has one.
    frame(session, &view.camera)?;
    let shot = match shot::take(session, &view.camera) {
        Ok(shot) => shot,
        Err(ShotError::Session(error)) => return Err(error),
        Err(error) => return Ok(Err(error.to_string())),
    };
    let error = match error::measure(&shot.image, &view.picture, &view.covered) {
        Ok(error) => error,
        Err(error) => return Ok(Err(error.to_string())),
    };
    Ok(Ok((error, shot.order.and_then(|order| shot::wrong_pairs(&view.order, &order)))))
}

/// Time that the frames of a round take together, about.
const ROUND: Duration = Duration::from_millis(200);

/// Chooses the number of frames in a round, by the time of one.
///
/// # Errors
/// The device fails.
pub fn suitable_frames<D: Device>(exact: &mut Session<D>, camera: &Camera) -> Result<u32, SessionError> {
    frame(exact, camera)?;
    let begun = Instant::now();
    frame(exact, camera)?;
    let frames = ROUND.as_secs_f64() / begun.elapsed().as_secs_f64();
    Ok((frames as u32).clamp(1, 30))
}

/// Draws a frame alone on the device.
fn frame<D: Device>(session: &mut Session<D>, camera: &Camera) -> Result<FrameResult, SessionError> {
    let frame = session.submit(camera, &FrameOptions::default())?;
    session.wait(frame)
}

fn stats<D: Device>(
    session: &mut Session<D>,
    view: &View,
    frames: &[FrameResult],
) -> Result<CameraStats, SessionError> {
    let loaded = session.scene().count().into();
    let camera = (view.camera.img_name.as_str(), (view.camera.width, view.camera.height));
    let info = session.device().info().clone();
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    Ok(CameraStats::new(camera, plan, &info, loaded, frames, Vec::new()))
}
