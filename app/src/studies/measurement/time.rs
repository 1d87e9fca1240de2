//! Measures the time of a frame as a share of a baseline's time. Frames of both are drawn interleaved.

use super::noise::{self, Share};
use crate::draw::interleaved::{self, Effort, Figure, Timed, Timestamps, WARM_UP};
use crate::draw::session::{Session, SessionError};
use crate::draw::stats::median;
use serde::{Deserialize, Serialize};
use splatgraph_assets::Camera;
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// The time of a frame, relative to the exact settings.
///
/// Milliseconds are shares times the exact settings' time, [`Time::exact_ms`]: the device's clock may change between
/// two settings, but it affects both sides of a share alike.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Milliseconds on the GPU: `share` of `exact_ms`.
    pub gpu_ms: f64,
    /// Difference between the largest and the smallest share of the rounds, in milliseconds.
    pub spread_ms: f64,
    /// The frame time divided by the exact settings' time in the same turns.
    pub share: Share,
    /// Milliseconds of the exact settings on a warm device: the median of the rounds' medians.
    pub exact_ms: f64,
    /// Number of rounds that were drawn.
    pub rounds: u32,
    /// Share of the host's frame time that the device spends drawing, at most 1. It idles for the rest.
    pub busy: f64,
    /// Milliseconds per phase: the median of the rounds' medians.
    pub phases: BTreeMap<String, f64>,
    /// Difference between a phase's largest and smallest time over the rounds, in milliseconds.
    pub phase_spreads: BTreeMap<String, f64>,
}

/// The session with which all others are interleaved.
pub struct Baseline<'a> {
    /// Session that draws the exact settings, prepared at the view's size.
    pub session: &'a mut Session,
    /// Frame time by which shares are multiplied, in milliseconds; `None` uses the baseline's time in the same rounds.
    pub ms: Option<f64>,
}

/// Divisor of [`interleaved::Frames::choose`]: a round of shares needs fewer frames than a round of milliseconds.
pub const FRAMES_DIVISOR: u32 = 10;

/// Maximum duration of a setting's rounds, because on a busy machine the range may never become narrow.
pub const MAX_DURATION: Duration = Duration::from_secs(8);

/// Measures the time of a frame of `session`, interleaved with frames of `exact`; `None` without timestamps.
///
/// Both sessions must be prepared at the camera's size. They warm up first if `effort` is enough for a range; see
/// [`has_range`]. Rounds end when the range of all turns is narrow enough ([`noise::enough`]), after `effort.rounds`,
/// or after `longest` if there is a range.
///
/// # Errors
/// See [`interleaved::rounds`].
pub fn time_in_turns(
    session: &mut Session,
    exact: Baseline,
    camera: &Camera,
    effort: Effort,
    longest: Duration,
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
    let mut rounds = Vec::new();
    for _ in 0..effort.rounds {
        let sessions = &mut [&mut *exact.session, &mut *session];
        let mut of_each =
            interleaved::rounds(sessions, camera, one, Timestamps::Passes)?.into_iter().flatten();
        let (of_exact, own) = (of_each.next().unwrap_or_default(), of_each.next().unwrap_or_default());
        let plan = session.plan().ok_or(SessionError::NotPrepared)?;
        rounds.push(Round::new(plan, &own, &of_exact));
        let shares = turns(&rounds);
        let late = begun.elapsed() >= longest;
        let is_done = |shares: Vec<f64>| noise::enough(&shares) || late && shares.len() >= noise::MIN_TURNS;
        // One round has no spread.
        if rounds.len() > 1 && shares.is_some_and(is_done) {
            break;
        }
    }
    Ok(time(&rounds, exact.ms))
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
    let frames = interleaved::rounds(&mut [&mut *session], camera, effort, Timestamps::Passes)?;
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    let round = |own: Vec<Timed>| Round::new(plan, &own, &own);
    let rounds: Vec<Round> = frames.into_iter().flatten().map(round).collect();
    Ok(time(&rounds, None).map(|time| alone(time, &rounds)))
}

/// Corrects a time that was measured against its own frames. All shares are 1, so their spread is 0: the spread of the
/// rounds' times replaces it, and the share has no range.
fn alone(time: Time, rounds: &[Round]) -> Time {
    let own: Vec<f64> = rounds.iter().filter_map(|round| round.own_ms).collect();
    Time { spread_ms: spread(&own), share: Share { median: 1.0, range: None }, ..time }
}

struct Round {
    own_ms: Option<f64>,
    exact_ms: Option<f64>,
    /// The share of each turn; `None` without timestamps.
    turns: Option<Vec<f64>>,
    busy: Option<f64>,
    phases: Vec<(String, Option<f64>)>,
}

impl Round {
    fn new(plan: &Plan, own: &[Timed], exact: &[Timed]) -> Round {
        let passes = own.first().map(|frame| interleaved::timed_passes(plan, frame)).unwrap_or_default();
        let ms = |phase: &str| {
            let of_phase = |id| plan.pass(id).phase == phase && passes.contains(&id);
            interleaved::median_of(own, |frame| frame.passes_ms(of_phase))
        };
        let phases = interleaved::phases(plan, &passes).into_iter();
        Round {
            own_ms: interleaved::gpu_ms(own),
            exact_ms: interleaved::gpu_ms(exact),
            turns: own
                .iter()
                .zip(exact)
                .map(|(a, b)| Some(a.result.total_ms? / b.result.total_ms?))
                .collect(),
            busy: interleaved::busy(own),
            phases: phases.map(|phase| (phase.to_owned(), ms(phase))).collect(),
        }
    }

    fn phase_ms(&self, name: &str) -> Option<f64> {
        self.phases.iter().find(|(own, _)| own == name)?.1
    }
}

fn turns(rounds: &[Round]) -> Option<Vec<f64>> {
    Some(rounds.iter().map(|round| round.turns.as_deref()).collect::<Option<Vec<_>>>()?.concat())
}

fn time(rounds: &[Round], exact_ms: Option<f64>) -> Option<Time> {
    let share = Share::of(&turns(rounds)?)?;
    let shares: Vec<f64> =
        rounds.iter().map(|round| Some(round.own_ms? / round.exact_ms?)).collect::<Option<_>>()?;
    let over = |of: fn(&Round) -> Option<f64>| median(rounds.iter().map(of).collect::<Option<_>>()?);
    let own_ms = over(|round| round.own_ms)?;
    let exact_of_rounds = over(|round| round.exact_ms)?;
    let exact_ms = exact_ms.unwrap_or(exact_of_rounds);
    let gpu_ms = share.median * exact_ms;
    // Converts a phase's times in these rounds to the clock speed of `exact_ms`.
    let scale = if own_ms > 0.0 { gpu_ms / own_ms } else { 1.0 };
    let figure = |(name, _): &(String, Option<f64>)| {
        let ms = |round: &Round| vec![round.phase_ms(name).map(|ms| scale * ms)];
        Some((name.clone(), Figure::of(rounds.iter().map(ms))?))
    };
    let phases: Vec<(String, Figure)> = rounds.first()?.phases.iter().filter_map(figure).collect();
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

fn spread(values: &[f64]) -> f64 {
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most - values.iter().copied().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::backend::Backend;
    use splatgraph_assets::synth;
    use splatgraph_null::{Call, Config, open};

    #[test]
    fn without_a_baseline_the_spread_is_that_of_the_rounds_times() {
        let round = |ms| Round {
            own_ms: Some(ms),
            exact_ms: Some(ms),
            turns: Some(vec![1.0; 4]),
            busy: Some(1.0),
            phases: Vec::new(),
        };
        let rounds = [3.0, 9.0, 4.0].map(round);
        let found = alone(time(&rounds, None).expect("timestamps"), &rounds);
        assert_eq!((found.gpu_ms, found.spread_ms), (4.0, 6.0));
        assert_eq!(found.share, Share { median: 1.0, range: None });
    }

    #[test]
    fn milliseconds_are_shares_of_one_time_of_the_exact_settings_on_a_warm_device() {
        let (device, journal) = open(&Config::default());
        let scene = synth::generate("demo", 50, 0).expect("a small scene");
        let camera = Camera::framing(&scene, 32, 24);
        let device = Backend::Null(device.expect("no fault is set"));
        let mut session = Session::new(device, scene, "unsorted", &[]);
        let mut exact = session.beside("splat", &[]).expect("a context");
        for session in [&mut session, &mut exact] {
            session.prepare((32, 24), &mut |_| {}).expect("it is prepared");
            interleaved::frame(session, &camera).expect("the prologue's frame");
        }
        let mut timed = |ms, effort| {
            journal.take();
            let baseline = Baseline { session: &mut exact, ms };
            let time = time_in_turns(&mut session, baseline, &camera, effort, MAX_DURATION)
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
        assert!(submits >= 2 * 2 + 8 * 2, "two turns of a warm-up at least, and eight turns: {submits}");
        assert!(own.share.median < 1.0 && own.busy <= 1.0, "{own:?}");
        let (other, _) = timed(Some(100.0), effort);
        assert_eq!((other.share, other.exact_ms), (own.share, 100.0));
        assert!((other.gpu_ms - 100.0 * own.share.median).abs() < 1e-9, "{other:?}");
        let phase = |time: &Time| time.phases["draw"] / time.gpu_ms;
        assert!((phase(&other) - phase(&own)).abs() < 1e-9, "phases are of the same time: {own:?} {other:?}");
        let (glance, submits) = timed(None, Effort { rounds: 1, frames: 1 });
        assert_eq!((glance.rounds, glance.share.range, submits), (1, None, 2));
    }
}
