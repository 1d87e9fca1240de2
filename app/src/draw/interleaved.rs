//! Draws frames of several sessions interleaved, and summarises their times.
//!
//! A device changes its clock with its temperature and its load. Therefore, sessions to compare draw one frame each in
//! turn, so that a drift affects all of them equally. The frames are divided into rounds; the medians of the rounds
//! show the noise. Only one frame is in flight at a time.

use crate::draw::session::{FrameOptions, Session, SessionError};
use crate::draw::stats::median;
use indexmap::IndexSet;
use serde::{Deserialize, Serialize};
use splatgraph_api::FrameResult;
use splatgraph_assets::Camera;
use splatgraph_framework::ir::PassId;
use splatgraph_framework::plan::Plan;
use std::time::{Duration, Instant};

/// Numbers of rounds and frames to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Effort {
    /// Number of rounds. The spread is computed from their medians, and needs two.
    pub rounds: u32,
    /// Frames of each session per round.
    pub frames: u32,
}

/// Numbers of rounds and frames that the user requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frames {
    /// Number of rounds. For a study that ends once the time is precise enough, the maximum.
    pub rounds: u32,
    /// Frames of each session per round; `None` chooses the number by the frame time.
    pub frames: Option<u32>,
}

impl Frames {
    /// Chooses the rounds and frames for a session that is prepared at the camera's size.
    ///
    /// If [`Frames::frames`] is `None`, draws two frames, passes the second one's `wall_ms` to [`frames_of`], and
    /// divides the result by `part`; the number of frames is at least 1.
    ///
    /// # Errors
    /// See [`Session::submit`] and [`Session::wait`].
    pub fn choose(self, session: &mut Session, camera: &Camera, part: u32) -> Result<Effort, SessionError> {
        let usual = || -> Result<u32, SessionError> {
            frame(session, camera)?;
            Ok((frames_of(frame(session, camera)?.wall_ms) / part).max(1))
        };
        Ok(Effort { rounds: self.rounds, frames: self.frames.map_or_else(usual, Ok)? })
    }
}

/// A frame, with its times on the host.
pub struct Timed {
    /// Results of the frame, from the device.
    pub result: FrameResult,
    /// Host time until the frame was submitted, in milliseconds.
    pub submit_ms: f64,
    /// Host time until the frame was done, in milliseconds.
    pub wall_ms: f64,
}

impl Timed {
    /// Sums the GPU milliseconds of the passes that `wanted` accepts; 0 if it accepts none, `None` without timestamps.
    pub fn passes_ms(&self, wanted: impl Fn(PassId) -> bool) -> Option<f64> {
        self.result.pass_ms.iter().filter(|(id, _)| wanted(*id)).map(|(_, ms)| *ms).sum()
    }
}

/// Lists the passes that a frame executed on the device, in order of execution. Passes that run once are omitted.
pub fn timed_passes(plan: &Plan, frame: &Timed) -> Vec<PassId> {
    let ran = |id: &PassId| frame.result.pass_ms.iter().any(|(pass, _)| pass == id);
    plan.frame.iter().copied().filter(ran).collect()
}

/// Lists the phases of passes without duplicates, in the order of the passes.
fn phases<'a>(plan: &'a Plan, passes: &[PassId]) -> Vec<&'a str> {
    let names: IndexSet<&str> = passes.iter().map(|id| plan.pass(*id).phase.as_str()).collect();
    names.into_iter().collect()
}

/// Computes the time of each phase of `passes`, in order of execution. `profiled` are frames with timestamps of passes;
/// a figure is `None` without timestamps.
pub fn phase_figures<'a>(
    plan: &'a Plan,
    passes: &[PassId],
    profiled: &Rounds,
) -> Vec<(&'a str, Option<Figure>)> {
    let figure = |name| {
        let of = |id| plan.pass(id).phase == name && passes.contains(&id);
        (name, Figure::of_frames(profiled, |frame| frame.passes_ms(of)))
    };
    phases(plan, passes).into_iter().map(figure).collect()
}

/// Computes the median GPU time of frames, in milliseconds; `None` without timestamps or without frames.
pub fn gpu_ms(frames: &[Timed]) -> Option<f64> {
    median(frames.iter().map(|frame| frame.result.total_ms).collect::<Option<_>>()?)
}

/// The frames of a session, grouped by round.
pub type Rounds = Vec<Vec<Timed>>;

/// Timestamps to record in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timestamps {
    /// Timestamps of the frame and of each pass.
    Passes,
    /// Timestamps of the frame only, because timestamps of passes take GPU time.
    Frame,
}

/// Draws a single frame, with timestamps of its passes.
///
/// # Errors
/// See [`Session::submit`] and [`Session::wait`].
pub fn frame(session: &mut Session, camera: &Camera) -> Result<Timed, SessionError> {
    draw(session, camera, Timestamps::Passes)
}

fn draw(session: &mut Session, camera: &Camera, timestamps: Timestamps) -> Result<Timed, SessionError> {
    let begun = Instant::now();
    let ms = || 1e3 * begun.elapsed().as_secs_f64();
    let options = FrameOptions { untimed_passes: timestamps == Timestamps::Frame, ..FrameOptions::default() };
    let frame = session.submit(camera, &options)?;
    let submit_ms = ms();
    let result = session.wait(frame)?;
    Ok(Timed { result, submit_ms, wall_ms: ms() })
}

/// Draws frames of several sessions interleaved, and returns the rounds of each session.
///
/// The sessions must be prepared at the camera's size.
///
/// # Errors
/// See [`Session::submit`] and [`Session::wait`].
pub fn rounds(
    sessions: &mut [&mut Session],
    camera: &Camera,
    effort: Effort,
    timestamps: Timestamps,
) -> Result<Vec<Rounds>, SessionError> {
    let mut all: Vec<Rounds> = sessions.iter().map(|_| Vec::new()).collect();
    for _ in 0..effort.rounds {
        all.iter_mut().for_each(|rounds| rounds.push(Vec::new()));
        for _ in 0..effort.frames {
            for (session, rounds) in sessions.iter_mut().zip(&mut all) {
                let frame = draw(session, camera, timestamps)?;
                rounds.last_mut().expect("a round was begun").push(frame);
            }
        }
    }
    Ok(all)
}

/// Maximum number of frames of a session with timestamps of passes, besides the frames that are measured as a whole.
pub const PROFILED: u32 = 3;

/// Draws interleaved frames with timestamps of passes, for the times of phases. Each session draws one frame per round,
/// at most [`PROFILED`].
///
/// # Errors
/// See [`rounds()`].
pub fn profile(
    sessions: &mut [&mut Session],
    camera: &Camera,
    rounds: u32,
) -> Result<Vec<Rounds>, SessionError> {
    let effort = Effort { rounds: rounds.min(PROFILED), frames: 1 };
    self::rounds(sessions, camera, effort, Timestamps::Passes)
}

/// Duration of a warm-up: an idle device may run at a lower clock.
pub const WARM_UP: Duration = Duration::from_millis(200);

/// Draws interleaved frames for at least `least`, and at least two frames of each session.
///
/// Returns the host time of the last turn, one frame of each session, in milliseconds.
///
/// # Errors
/// See [`Session::submit`] and [`Session::wait`].
pub fn warm_up(sessions: &mut [&mut Session], camera: &Camera, least: Duration) -> Result<f64, SessionError> {
    let begun = Instant::now();
    let turn = Effort { rounds: 1, frames: 1 };
    let mut turns = 0;
    loop {
        let turn_begun = Instant::now();
        rounds(sessions, camera, turn, Timestamps::Passes)?;
        turns += 1;
        // At least two turns: a graph may use the order of the previous frame.
        if turns >= 2 && begun.elapsed() >= least {
            return Ok(1e3 * turn_begun.elapsed().as_secs_f64());
        }
    }
}

/// Computes the GPU's utilisation: its time divided by the host time of the frames, at most 1; `None` without
/// timestamps or without frames.
pub fn busy(frames: &[Timed]) -> Option<f64> {
    let drawn = frames.iter().map(|frame| frame.result.total_ms).sum::<Option<f64>>()?;
    let all: f64 = frames.iter().map(|frame| frame.wall_ms).sum();
    (all > 0.0).then(|| (drawn / all).min(1.0))
}

/// Target length of a round.
const ROUND: Duration = Duration::from_millis(200);

/// Returns the number of frames of `wall_ms` milliseconds that fill a round, 1 to 30.
pub fn frames_of(wall_ms: f64) -> u32 {
    ((1e3 * ROUND.as_secs_f64() / wall_ms) as u32).clamp(1, 30)
}

/// A measured quantity with its spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Median of the rounds' medians; after [`Figure::mean`], the mean of several such medians.
    pub median: f64,
    /// Largest minus smallest of the rounds' medians; `None` with one round. After [`Figure::mean`], the largest of
    /// several.
    pub spread: Option<f64>,
}

impl Figure {
    /// Summarises rounds of values; `None` if there are no values or one is missing.
    pub fn of(rounds: impl IntoIterator<Item = Vec<Option<f64>>>) -> Option<Figure> {
        let medians = rounds.into_iter().map(|round| median(round.into_iter().collect::<Option<Vec<_>>>()?));
        let medians = medians.collect::<Option<Vec<f64>>>()?;
        let (least, most) =
            medians.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        let spread = (medians.len() > 1).then_some(most - least);
        Some(Figure { median: median(medians)?, spread })
    }

    /// Summarises a value of the frames; `None` without frames or if a frame lacks it.
    pub fn of_frames(rounds: &Rounds, value: impl Fn(&Timed) -> Option<f64>) -> Option<Figure> {
        Figure::of(rounds.iter().map(|round| round.iter().map(&value).collect()))
    }

    /// Averages the medians, and takes the largest spread, if all have one; `None` if there are no figures or one is
    /// missing.
    pub fn mean(figures: impl IntoIterator<Item = Option<Figure>>) -> Option<Figure> {
        let figures = figures.into_iter().collect::<Option<Vec<Figure>>>()?;
        let sum: f64 = figures.iter().map(|figure| figure.median).sum();
        let spreads = figures.iter().map(|figure| figure.spread);
        let spread = spreads.reduce(|a, b| a.zip(b).map(|(a, b)| a.max(b)))?;
        Some(Figure { median: sum / figures.len() as f64, spread })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round(values: &[f64]) -> Vec<Option<f64>> {
        values.iter().map(|value| Some(*value)).collect()
    }

    #[test]
    fn a_figure_is_the_median_of_the_rounds_medians_and_one_slow_frame_does_not_show() {
        let rounds = [round(&[1.0, 2.0, 90.0]), round(&[3.0, 3.0, 3.0]), round(&[2.5, 7.0, 1.0])];
        assert_eq!(Figure::of(rounds), Some(Figure { median: 2.5, spread: Some(1.0) }));
        assert_eq!(Figure::of([round(&[4.0, 2.0])]), Some(Figure { median: 3.0, spread: None }), "one round");
    }

    #[test]
    fn a_device_is_busy_for_the_share_of_the_time_in_which_it_draws() {
        let frame = |total_ms, wall_ms| Timed {
            result: FrameResult { total_ms, ..FrameResult::default() },
            submit_ms: 0.0,
            wall_ms,
        };
        assert_eq!(busy(&[frame(Some(1.0), 3.0), frame(Some(2.0), 3.0)]), Some(0.5));
        assert_eq!(busy(&[frame(Some(2.0), 1.0)]), Some(1.0));
        assert_eq!((busy(&[frame(None, 1.0)]), busy(&[])), (None, None));
    }

    #[test]
    fn a_figure_with_a_missing_value_is_none() {
        assert_eq!(Figure::of([vec![Some(1.0), None]]), None);
        assert_eq!(Figure::of([round(&[])]), None);
        assert_eq!(Figure::of([]), None);
        assert_eq!(Figure::mean([Some(Figure { median: 1.0, spread: Some(0.0) }), None]), None);
        assert_eq!(Figure::mean([]), None);
    }

    #[test]
    fn the_mean_over_views_has_the_largest_spread_of_one() {
        let figures = [(1.0, 0.25), (2.0, 0.5), (6.0, 0.0)]
            .map(|(median, spread)| Figure { median, spread: Some(spread) });
        assert_eq!(Figure::mean(figures.map(Some)), Some(Figure { median: 3.0, spread: Some(0.5) }));
        let one_round = figures.map(|figure| Some(Figure { spread: None, ..figure }));
        assert_eq!(Figure::mean(one_round), Some(Figure { median: 3.0, spread: None }));
    }

    #[test]
    fn a_round_has_as_many_frames_as_take_a_fifth_of_a_second_but_at_least_one() {
        assert_eq!([0.5, 10.0, 40.0, 5000.0].map(frames_of), [30, 20, 5, 1]);
    }
}
