//! Measures the time of a frame as a share of a baseline's time. Frames of both are drawn interleaved.

use super::error::mean;
use super::noise::{self, Share};
use crate::draw::interleaved::{self, Effort, Figure, Rounds, Timestamps, WARM_UP};
use crate::draw::session::{Session, SessionError};
use crate::draw::stats::median;
use indexmap::{IndexMap, IndexSet};
use serde::{Deserialize, Serialize};
use splatgraph_assets::Camera;
use splatgraph_framework::plan::Plan;
use std::time::{Duration, Instant};

/// The time of a frame, relative to a baseline: the exact settings, or in a sweep, the frame with all splats.
///
/// Milliseconds are shares times the baseline's time, [`Time::exact_ms`]: the device's clock may change between two
/// settings, but it affects both sides of a share alike.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Milliseconds on the GPU: `share` of `exact_ms`.
    pub gpu_ms: f64,
    /// Difference between the largest and the smallest share of the rounds, or without a baseline, between their times;
    /// in milliseconds. `None` with one round.
    pub spread_ms: Option<f64>,
    /// The frame time divided by the baseline's time in the same turns; 1 without a baseline.
    pub share: Share,
    /// Milliseconds of the baseline: [`Baseline::ms`], or the median of the rounds' medians.
    pub exact_ms: f64,
    /// Difference between the largest and the smallest time of the baseline in these rounds, in milliseconds; `None`
    /// with one round.
    pub exact_spread_ms: Option<f64>,
    /// The share of each turn, in order; without a baseline, there are none.
    pub turns: Vec<f64>,
    /// Number of rounds that were drawn.
    pub rounds: u32,
    /// Share of the host's frame time that the device spends drawing, at most 1. It idles for the rest.
    pub busy: f64,
    /// Milliseconds per phase, in order of execution. They are medians of the frames with timestamps of passes, scaled
    /// like `gpu_ms` to the clock of `exact_ms`. These timestamps take time, so the phases may add up to more than
    /// `gpu_ms`.
    pub phases: IndexMap<String, f64>,
    /// Difference between a phase's largest and smallest time in these frames, in milliseconds, scaled like `phases`;
    /// `None` with one frame.
    pub phase_spreads: IndexMap<String, Option<f64>>,
}

/// The session with which all others are interleaved.
pub struct Baseline<'a> {
    /// Session that draws the exact settings, or in a sweep, all splats; prepared at the view's size.
    pub session: &'a mut Session,
    /// Frame time by which shares are multiplied, in milliseconds; `None` uses the baseline's time in the same rounds.
    pub ms: Option<f64>,
}

/// Divisor of [`interleaved::Frames::choose`]: a round of shares needs fewer frames than a round of milliseconds.
pub const FRAMES_DIVISOR: u32 = 10;

/// Conditions that end rounds before the maximum of an [`Effort`].
#[derive(Clone, Copy, Debug)]
pub struct Until {
    /// Number of views over whose mean the range must be narrow. With more views, the range of each may be wider.
    pub views: usize,
    /// Duration after which rounds end once there is a range: on a busy machine, it may never become narrow.
    pub longest: Duration,
}

impl Until {
    /// Ends when the range of the mean over `views` is narrow, or if there is a range, after eight seconds in a view.
    pub fn narrow(views: usize) -> Until {
        Until { views, longest: Duration::from_secs(8) }
    }
}

/// Measures the time of a frame of `session`, interleaved with frames of `exact`; `None` without timestamps.
///
/// Both sessions must be prepared at the camera's size. They warm up first if `effort` is enough for a range; see
/// [`has_range`]. Rounds end after `effort.rounds`. From the second on, they end earlier if the range of all turns is
/// narrow enough ([`noise::enough`]), or after `until.longest` if there is a range.
///
/// # Errors
/// See [`interleaved::rounds`].
pub fn time_in_turns(
    session: &mut Session,
    exact: Baseline,
    camera: &Camera,
    effort: Effort,
    until: Until,
) -> Result<Option<Time>, SessionError> {
    // Without a range, the precision of a warm device is not needed.
    if has_range(effort) {
        // Shares hardly depend on the clock. Once the baseline's milliseconds are known, the warm-up is only as long as
        // the device was idle.
        let idle = [exact.session.idle(), session.idle()].into_iter().flatten().min();
        let least = idle.filter(|_| exact.ms.is_some()).map_or(WARM_UP, |idle| idle.min(WARM_UP));
        interleaved::warm_up(&mut [&mut *exact.session, &mut *session], camera, least)?;
    }
    let begun = Instant::now();
    let one = Effort { rounds: 1, ..effort };
    let (mut of_exact, mut own) = (Rounds::new(), Rounds::new());
    for _ in 0..effort.rounds {
        let sessions = &mut [&mut *exact.session, &mut *session];
        let round = interleaved::rounds(sessions, camera, one, Timestamps::Frame)?;
        for (rounds, round) in [&mut of_exact, &mut own].into_iter().zip(round) {
            rounds.extend(round);
        }
        let shares = turns(&own, &of_exact);
        let late = begun.elapsed() >= until.longest;
        let is_done = |shares: Vec<f64>| {
            noise::enough(&shares, until.views) || late && shares.len() >= noise::MIN_TURNS
        };
        // One round has no spread.
        if own.len() > 1 && shares.is_some_and(is_done) {
            break;
        }
    }
    let sessions = &mut [&mut *exact.session, &mut *session];
    let profiled = interleaved::profile(sessions, camera, own.len() as u32)?.pop().unwrap_or_default();
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    Ok(time(plan, &own, &profiled, (&of_exact, exact.ms)))
}

/// Returns true if `effort` has at least [`noise::MIN_TURNS`] frames, enough for a range.
pub fn has_range(effort: Effort) -> bool {
    effort.rounds.saturating_mul(effort.frames) as usize >= noise::MIN_TURNS
}

/// Measures the time of a frame of a prepared session without a baseline; `None` without timestamps. The share is 1,
/// without a range.
///
/// # Errors
/// See [`interleaved::rounds`].
pub fn time_alone(
    session: &mut Session,
    camera: &Camera,
    effort: Effort,
) -> Result<Option<Time>, SessionError> {
    if effort.rounds > 1 {
        interleaved::warm_up(&mut [&mut *session], camera, WARM_UP)?;
    }
    let rounds = interleaved::rounds(&mut [&mut *session], camera, effort, Timestamps::Frame)?;
    let profiled = interleaved::profile(&mut [&mut *session], camera, effort.rounds)?;
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    Ok(rounds.first().zip(profiled.first()).and_then(|(rounds, profiled)| alone(plan, rounds, profiled)))
}

/// Summarises the rounds as shares of themselves. All shares are 1, so their spread is 0: the spread of the rounds'
/// times replaces it, and the share has no range.
fn alone(plan: &Plan, rounds: &Rounds, profiled: &Rounds) -> Option<Time> {
    let time = time(plan, rounds, profiled, (rounds, None))?;
    let (share, turns) = (Share { median: 1.0, range: None }, Vec::new());
    Some(Time { spread_ms: gpu_ms(rounds)?.spread, share, turns, ..time })
}

fn gpu_ms(rounds: &Rounds) -> Option<Figure> {
    Figure::of_frames(rounds, |frame| frame.result.total_ms)
}

/// Computes the share of each turn; `None` without timestamps.
fn turns(own: &Rounds, exact: &Rounds) -> Option<Vec<f64>> {
    let turns = own.iter().flatten().zip(exact.iter().flatten());
    turns.map(|(own, exact)| Some(own.result.total_ms? / exact.result.total_ms?)).collect()
}

/// Summarises rounds, whose frames have no timestamps of passes, and `profiled` frames, which have; `None` without
/// timestamps.
fn time(
    plan: &Plan,
    own: &Rounds,
    profiled: &Rounds,
    (exact, exact_ms): (&Rounds, Option<f64>),
) -> Option<Time> {
    let turns = turns(own, exact)?;
    let share = Share::of(&turns)?;
    let of_round = |(own, exact): (&Vec<_>, &Vec<_>)| {
        vec![interleaved::gpu_ms(own).zip(interleaved::gpu_ms(exact)).map(|(own, exact)| own / exact)]
    };
    let spread = Figure::of(own.iter().zip(exact).map(of_round))?.spread;
    let of_exact = gpu_ms(exact)?;
    let exact_ms = exact_ms.unwrap_or(of_exact.median);
    let (own_ms, gpu_ms) = (gpu_ms(own)?.median, share.median * exact_ms);
    // Converts a phase's times in these rounds to the clock speed of `exact_ms`.
    let scale = if own_ms > 0.0 { gpu_ms / own_ms } else { 1.0 };
    let passes = interleaved::timed_passes(plan, profiled.first()?.first()?);
    let figures = interleaved::phase_figures(plan, &passes, profiled);
    let phases = || figures.iter().filter_map(|(name, figure)| Some(((*name).to_owned(), (*figure)?)));
    Some(Time {
        gpu_ms,
        spread_ms: spread.map(|spread| spread * exact_ms),
        share,
        exact_ms,
        exact_spread_ms: of_exact.spread,
        turns,
        rounds: own.len() as u32,
        busy: median(own.iter().map(|round| interleaved::busy(round)).collect::<Option<_>>()?)?,
        phases: phases().map(|(name, figure)| (name, scale * figure.median)).collect(),
        phase_spreads: phases().map(|(name, figure)| (name, figure.spread.map(|ms| scale * ms))).collect(),
    })
}

/// Lists the phases of several views: name, mean milliseconds and largest spread. A view without the phase counts as 0.
///
/// The spread is `None` if each view has a single frame with timestamps of passes.
pub fn phases(times: &[&Time]) -> Vec<(String, f64, Option<f64>)> {
    let names: IndexSet<&String> = times.iter().flat_map(|time| time.phases.keys()).collect();
    let of = |name: &String| {
        let ms = mean(times.iter().map(|time| time.phases.get(name).copied().unwrap_or(0.0)));
        let spreads = times.iter().filter_map(|time| time.phase_spreads.get(name).copied().flatten());
        (name.clone(), ms, spreads.reduce(f64::max))
    };
    names.into_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::backend::Backend;
    use crate::draw::interleaved::Timed;
    use splatgraph_api::FrameResult;
    use splatgraph_assets::synth;
    use splatgraph_null::{Call, Config, Journal, open};

    fn unsorted() -> (Session, Camera, Journal) {
        let (device, journal) = open(&Config::default());
        let scene = synth::generate("demo", 50, 0).expect("a small scene");
        let camera = Camera::framing(&scene, 32, 24);
        let device = Backend::Null(device.expect("no fault is set"));
        let mut session = Session::new(device, scene, "unsorted", &[]);
        session.prepare((32, 24), &mut |_| {}).expect("it is prepared");
        (session, camera, journal)
    }

    #[test]
    fn without_a_baseline_the_spread_is_that_of_the_rounds_times() {
        let result = |ms| FrameResult { total_ms: Some(ms), ..FrameResult::default() };
        let round = |ms| vec![Timed { result: result(ms), submit_ms: 0.0, wall_ms: ms }];
        let (session, ..) = unsorted();
        let plan = session.plan().expect("it is prepared");
        let rounds = [3.0, 9.0, 4.0].map(round).into();
        let found = alone(plan, &rounds, &rounds).expect("timestamps");
        assert_eq!((found.gpu_ms, found.spread_ms, found.exact_spread_ms), (4.0, Some(6.0), Some(6.0)));
        assert!(found.turns.is_empty(), "{found:?}");
        assert_eq!(found.share, Share { median: 1.0, range: None });
    }

    #[test]
    fn milliseconds_are_shares_of_one_time_of_the_exact_settings_on_a_warm_device() {
        let (mut session, camera, journal) = unsorted();
        let mut exact = session.beside("splat", &[]).expect("a context");
        exact.prepare((32, 24), &mut |_| {}).expect("it is prepared");
        for session in [&mut session, &mut exact] {
            interleaved::frame(session, &camera).expect("the prologue's frame");
        }
        let mut timed = |ms, effort| {
            journal.take();
            let baseline = Baseline { session: &mut exact, ms };
            let time = time_in_turns(&mut session, baseline, &camera, effort, Until::narrow(1))
                .expect("frames")
                .expect("timestamps");
            let submits =
                journal.take().into_iter().filter(|call| matches!(call, Call::Submit { .. })).count();
            (time, submits)
        };
        // The null device's times are constant, so eight turns are enough.
        let effort = Effort { rounds: 16, frames: 2 };
        let (own, submits) = timed(None, effort);
        assert_eq!((own.rounds, own.share.range), (4, Some((own.share.median, own.share.median))));
        assert_eq!(Share::of(&own.turns), Some(own.share));
        assert!(own.turns.len() == 8 && own.exact_spread_ms == Some(0.0), "{own:?}");
        assert!(submits >= 2 * 2 + 8 * 2, "two turns of a warm-up at least, and eight turns: {submits}");
        // Each timestamp is one tick, so a frame takes one tick unless its passes have timestamps, too.
        assert!(own.share.median == 1.0 && own.busy <= 1.0, "{own:?}");
        assert!(own.phases.values().sum::<f64>() > own.gpu_ms, "per-pass timestamps take time: {own:?}");
        let (other, _) = timed(Some(100.0), effort);
        assert_eq!((other.share, other.exact_ms), (own.share, 100.0));
        assert!((other.gpu_ms - 100.0 * own.share.median).abs() < 1e-9, "{other:?}");
        let phase = |time: &Time| time.phases["draw"] / time.gpu_ms;
        assert!((phase(&other) - phase(&own)).abs() < 1e-9, "phases are of the same time: {own:?} {other:?}");
        let (glance, submits) = timed(None, Effort { rounds: 1, frames: 1 });
        // A turn without timestamps of passes, and one with them.
        assert_eq!((glance.rounds, glance.share.range, glance.spread_ms, submits), (1, None, None, 4));
        assert!(glance.phase_spreads.values().all(Option::is_none), "{glance:?}");
    }
}
