//! Draws one setting of one view, and measures its time, memory and error.

use super::error::{self, Error};
use super::noise::{self, Share};
use super::plans;
use super::settings::{EXACT, Setting};
use crate::draw::capture::{self, CaptureError};
use crate::draw::interleaved::{self, Effort, Figure, Timed, Timestamps};
use crate::draw::session::{Session, SessionError};
use crate::draw::stats::{CameraStats, median};
use crate::draw::truth::Truth;
use crate::io::image::Image;
use serde::{Deserialize, Serialize};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Rules, depth_order};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

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
///
/// All milliseconds are shares of one time of the exact settings, [`Time::exact_ms`]: a device's clock may change between two settings, and
/// concerns both sides of a share alike.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Milliseconds on the GPU: `share` of `exact_ms`.
    pub gpu_ms: f64,
    /// Difference between the largest and the smallest of the rounds' shares, in milliseconds.
    pub spread_ms: f64,
    /// The share of the exact settings' time in the same rounds.
    pub share: Share,
    /// Milliseconds of the exact settings, of a warm device: the median of the rounds' medians.
    pub exact_ms: f64,
    /// Rounds that were drawn.
    pub rounds: u32,
    /// The share of the host's time of a frame in which the device drew, 1 at most: between frames it rests.
    pub busy: f64,
    /// Milliseconds per phase: the median of the rounds' medians.
    pub phases: BTreeMap<String, f64>,
    /// Difference between the largest and the smallest of a phase's rounds, in milliseconds.
    pub phase_spreads: BTreeMap<String, f64>,
}

/// A line of the ledger: a setting in a view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The setting's name.
    pub setting: String,
    /// A hash of its plans; `None` if one cannot be built.
    pub plan: Option<u64>,
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
    /// True if the picture is drawn from what was kept of the previous frame, which costs nothing that a still view shows.
    pub of_last_frame: bool,
    /// Bytes of memory on the device.
    pub gpu_bytes: u64,
}

/// The exact settings, which others are measured against.
pub struct Baseline<'a, D> {
    /// The session that draws them, prepared in the view's size.
    pub session: &'a mut Session<D>,
    /// The milliseconds that shares are of; `None` for those of the same rounds.
    pub ms: Option<f64>,
}

/// Longest time of a setting's rounds, however wide the range: on a busy machine it may never become narrow.
pub const LONGEST: Duration = Duration::from_secs(8);

/// Factor of the most rounds for the exact settings against themselves: all rows depend on the noise that these show.
const ROUNDS_OF_EXACT: u32 = 4;

/// Measures a setting. `exact` takes turns with `session`.
///
/// # Errors
/// The device fails. A setting that cannot be drawn is a row that says why.
pub fn measure<D: Device>(
    session: &mut Session<D>,
    exact: Baseline<D>,
    (setting, plan): (&Setting, Option<u64>),
    view: &View,
    effort: Effort,
) -> Result<Row, SessionError> {
    let found = match measured(session, exact, setting, view, effort) {
        Ok(found) => found,
        Err(SessionError::Graph(errors)) => Err(errors.text(false).trim().to_owned()),
        Err(error @ (SessionError::Full { .. } | SessionError::NoRoom { .. })) => Err(error.to_string()),
        Err(error) => return Err(error),
    };
    Ok(Row { setting: setting.name.clone(), plan, camera: view.camera.img_name.clone(), found })
}

fn measured<D: Device>(
    session: &mut Session<D>,
    exact: Baseline<D>,
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
    let more = if setting.name == EXACT && effort.rounds > 1 { ROUNDS_OF_EXACT } else { 1 };
    let effort = Effort { rounds: more * effort.rounds, ..effort };
    let time = time_in_turns(session, exact, &view.camera, effort, more * LONGEST)?;
    let gpu_bytes = session.device().memory().iter().map(|(_, bytes)| bytes).sum();
    let of_last_frame = session.plan().is_some_and(plans::uses_last_frame);
    Ok(Ok(Measured { time, error: drawn.error, inversions: drawn.inversions, of_last_frame, gpu_bytes }))
}

/// Measures the time of a frame of `session`, interleaved with frames of `exact`; `None` without timestamps.
///
/// Both are prepared in the camera's size, and draw for a while before any frame counts. Rounds end when the share is known well
/// enough ([`noise::enough`]), with `effort.rounds` at the latest, or when they have taken `longest` and have a range.
///
/// # Errors
/// The device fails.
pub fn time_in_turns<D: Device>(
    session: &mut Session<D>,
    exact: Baseline<D>,
    camera: &Camera,
    effort: Effort,
    longest: Duration,
) -> Result<Option<Time>, SessionError> {
    // A single round is a glance: nothing is told from it, and two frames side by side are as warm as each other.
    if effort.rounds > 1 {
        interleaved::warm_up(&mut [&mut *exact.session, &mut *session], camera)?;
    }
    let begun = Instant::now();
    let one = Effort { rounds: 1, ..effort };
    let mut rounds = Vec::new();
    for _ in 0..effort.rounds {
        let sessions = &mut [&mut *exact.session, &mut *session];
        let mut of_each =
            interleaved::rounds(sessions, camera, one, Timestamps::Passes)?.into_iter().flatten();
        let (of_exact, own) = (of_each.next().unwrap_or_default(), of_each.next().unwrap_or_default());
        let busy = interleaved::busy(&own);
        let of_exact = stats(exact.session, camera, of_exact)?.gpu_ms;
        rounds.push(Round { stats: stats(session, camera, own)?, exact_ms: of_exact, busy });
        let late = rounds.len() >= noise::LEAST_ROUNDS && begun.elapsed() >= longest;
        if late || shares(&rounds).is_some_and(|shares| noise::enough(&shares)) {
            break;
        }
    }
    Ok(time(&rounds, exact.ms))
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
    if effort.rounds > 1 {
        interleaved::warm_up(&mut [&mut *session], camera)?;
    }
    let mut rounds = Vec::new();
    for round in
        interleaved::rounds(&mut [&mut *session], camera, effort, Timestamps::Passes)?.into_iter().flatten()
    {
        let busy = interleaved::busy(&round);
        let stats = stats(session, camera, round)?;
        rounds.push(Round { exact_ms: stats.gpu_ms, stats, busy });
    }
    Ok(time(&rounds, None))
}

/// A round of frames of a setting, and of the exact settings.
struct Round {
    stats: CameraStats,
    exact_ms: Option<f64>,
    busy: Option<f64>,
}

/// Lists the shares of the rounds; `None` without timestamps.
fn shares(rounds: &[Round]) -> Option<Vec<f64>> {
    rounds.iter().map(|round| Some(round.stats.gpu_ms? / round.exact_ms?)).collect()
}

/// Summarises the rounds; `None` without timestamps.
fn time(rounds: &[Round], exact_ms: Option<f64>) -> Option<Time> {
    let shares = shares(rounds)?;
    let share = Share::of(&shares)?;
    let over = |of: fn(&Round) -> Option<f64>| median(rounds.iter().map(of).collect::<Option<_>>()?);
    let own_ms = over(|round| round.stats.gpu_ms)?;
    let exact_of_rounds = over(|round| round.exact_ms)?;
    let exact_ms = exact_ms.unwrap_or(exact_of_rounds);
    let gpu_ms = share.median * exact_ms;
    // What a phase took in these rounds, at the clock of the exact settings' time.
    let scale = if own_ms > 0.0 { gpu_ms / own_ms } else { 1.0 };
    let of = |stats: &CameraStats, name: &String| stats.phases.get(name)?.as_f64().map(|ms| scale * ms);
    let figure = |name: &String| {
        let figure = Figure::of(rounds.iter().map(|round| vec![of(&round.stats, name)]));
        figure.map(|figure| (name.clone(), figure))
    };
    let phases: Vec<(String, Figure)> = rounds.first()?.stats.phases.keys().filter_map(figure).collect();
    let each =
        |of: fn(&Figure) -> f64| phases.iter().map(|(name, figure)| (name.clone(), of(figure))).collect();
    Some(Time {
        gpu_ms,
        spread_ms: spread(&shares) * exact_ms,
        share,
        exact_ms,
        rounds: rounds.len() as u32,
        busy: over(|round| round.busy)?,
        phases: each(|figure| figure.median),
        phase_spreads: each(|figure| figure.spread),
    })
}

/// Computes the difference between the largest and the smallest value.
fn spread(values: &[f64]) -> f64 {
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most - values.iter().copied().fold(f64::INFINITY, f64::min)
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
    interleaved::frame(session, &view.camera)?;
    let capture = match capture::take(session, &view.camera) {
        Ok(capture) => capture,
        Err(CaptureError::Session(error)) => return Err(error),
        Err(error) => return Ok(Err(error.to_string())),
    };
    let error = match error::measure(&capture.image, &view.picture, &view.covered) {
        Ok(error) => error,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let order = capture.order.filter(|_| !view.order.is_empty());
    let inversions = order.and_then(|order| capture::wrong_pairs(&view.order, &order));
    Ok(Ok(Drawn { picture: capture.image, error, inversions, counts: capture.counts }))
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

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;
    use splatgraph_null::{Call, Config, Null, open};

    #[test]
    fn milliseconds_are_shares_of_one_time_of_the_exact_settings_on_a_warm_device() {
        let (device, journal) = open(&Config::default());
        let scene = synth::generate("demo", 50, 0).expect("a small scene");
        let camera = Camera::framing(&scene, 32, 24);
        let mut session: Session<Null> =
            Session::new(device.expect("no fault is set"), scene, "unsorted", &[]);
        let mut exact = session.beside("splat", &[]).expect("a context");
        for session in [&mut session, &mut exact] {
            session.prepare((32, 24), &mut |_| {}).expect("it is prepared");
            interleaved::frame(session, &camera).expect("the prologue's frame");
        }
        let mut timed = |ms, effort| {
            journal.take();
            let baseline = Baseline { session: &mut exact, ms };
            let time = time_in_turns(&mut session, baseline, &camera, effort, LONGEST)
                .expect("frames")
                .expect("timestamps");
            let submits =
                journal.take().into_iter().filter(|call| matches!(call, Call::Submit { .. })).count();
            (time, submits)
        };
        // The null device's passes take as long in every frame, so that eight rounds are enough.
        let effort = Effort { rounds: 16, frames: 2 };
        let (own, submits) = timed(None, effort);
        assert_eq!((own.rounds, own.share.range), (8, Some((own.share.median, own.share.median))));
        assert!(submits >= 2 * 2 + 8 * 2 * 2, "two turns of a warm-up at least, and eight rounds: {submits}");
        assert!(own.share.median < 1.0 && own.busy <= 1.0, "{own:?}");
        let (other, _) = timed(Some(100.0), effort);
        assert_eq!((other.share, other.exact_ms), (own.share, 100.0));
        assert!((other.gpu_ms - 100.0 * own.share.median).abs() < 1e-9, "{other:?}");
        let phase = |time: &Time| time.phases["draw"] / time.gpu_ms;
        assert!((phase(&other) - phase(&own)).abs() < 1e-9, "phases are of the same time: {own:?} {other:?}");
        // One round is a glance: no warm-up, and no range.
        let (glance, submits) = timed(None, Effort { rounds: 1, frames: 1 });
        assert_eq!((glance.rounds, glance.share.range, submits), (1, None, 2));
    }
}
