//! Draws candidates interleaved, and measures the time, the bytes and the memory of each.

use super::bytes;
use crate::draw::backend::Backend;
use crate::draw::interleaved::{self, Effort, Figure, Frames, Rounds, Timed, Timestamps, WARM_UP};
use crate::draw::session::{Session, SessionError};
use crate::draw::stats::{self, BufferSize};
use crate::studies::study::{Setting, Steps, StudyError, reason};
use serde::Serialize;
use serde_json::{Map, Value as Json};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::{Fallback, PassId, Reason, Run};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Time and bytes of a pass, or of all passes of a phase.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Part {
    /// Name of the pass or the phase in the plan.
    pub name: String,
    /// Phase that a pass belongs to; `None` for a phase.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase: Option<String>,
    /// Milliseconds on the GPU; `None` if the device has no timestamps.
    pub gpu_ms: Option<Figure>,
    /// Estimate of the bytes that the pass or phase moves; see [`bytes::of_pass`].
    pub bytes: u64,
    /// Bandwidth: `bytes` per GPU time, in 10^9 bytes per second. `None` if the time is unknown or 0.
    pub gb_per_s: Option<f64>,
    /// `gb_per_s` divided by the device's copy limit; `None` if either is unknown.
    pub of_copy: Option<f64>,
}

impl Part {
    fn new(
        name: String,
        phase: Option<String>,
        gpu_ms: Option<Figure>,
        bytes: u64,
        copy: Option<f64>,
    ) -> Part {
        let gb_per_s = gpu_ms.filter(|ms| ms.median > 0.0).map(|ms| bytes as f64 / ms.median * 1e-6);
        let of_copy = gb_per_s.zip(copy).map(|(found, limit)| found / limit);
        Part { name, phase, gpu_ms, bytes, gb_per_s, of_copy }
    }
}

/// The times of a candidate's frames, in one view or as the mean of several.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Milliseconds on the GPU from a frame's first command to its last; `None` if the device has no timestamps.
    pub gpu_ms: Option<Figure>,
    /// GPU milliseconds outside of passes, such as those of barriers; `None` without timestamps.
    ///
    /// Measured, like `phases` and `passes`, in frames with per-pass timestamps, which slow a frame down.
    pub between_ms: Option<Figure>,
    /// Host time until the frame is submitted, in milliseconds; `None` only without frames, like the other times of the
    /// host.
    pub submit_ms: Option<Figure>,
    /// Host time to record and submit the frame, in milliseconds; part of `submit_ms`.
    pub record_ms: Option<Figure>,
    /// Host time until the frame is done, in milliseconds.
    pub wall_ms: Option<Figure>,
    /// Sums over the passes of each phase, in order of execution.
    pub phases: Vec<Part>,
    /// The passes, in order of execution.
    pub passes: Vec<Part>,
}

/// The measurements of a candidate in a view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct View {
    /// The camera's name.
    pub camera: String,
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Number of frames per round.
    pub frames: u32,
    /// Median of each round's GPU milliseconds, of which `gpu_ms` is the median; `None` without timestamps.
    pub gpu_ms_of_rounds: Option<Vec<f64>>,
    /// The graph's counts in the last frame, such as `visible` and `drawn`.
    pub counts: BTreeMap<String, u32>,
    /// The times of the candidate's frames in this view.
    #[serde(flatten)]
    pub figures: Figures,
}

/// The measurements of a candidate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The graphs of a choice that were passed over because of unmet requirements, in order.
    pub fallbacks: Vec<Fallback>,
    /// All parameters of the graph with their values.
    pub parameters: Map<String, Json>,
    /// The reason for each parameter value that comes from an expression over facts or other parameters.
    pub reasons: BTreeMap<String, Reason>,
    /// The means of the views' medians, with the largest spread of a view.
    pub mean: Figures,
    /// The views, one per camera.
    pub views: Vec<View>,
    /// Passes that run once, in the first frame after the plan is loaded. Each has a single time.
    pub once: Vec<Part>,
    /// Device memory by name, in bytes. Candidates that read the same scene attributes share their memory.
    pub memory: Vec<BufferSize>,
    /// Total device memory, in bytes: the sum of `memory`.
    pub memory_bytes: u64,
}

/// Measurements of a candidate, or the reason that it cannot be drawn.
pub type Outcome = Result<Found, String>;

struct Runner {
    session: Session,
    views: Vec<View>,
    once: Vec<Part>,
}

/// A measurement of candidates on one scene.
pub struct Bench<'a> {
    /// Device on which the candidates draw.
    pub device: &'a Backend,
    /// Scene that the candidates draw.
    pub scene: Arc<Scene>,
    /// Numbers of frames and rounds.
    pub frames: Frames,
    /// The copy limit, in 10^9 bytes per second; `None` if it is unknown.
    pub copy: Option<f64>,
}

impl Bench<'_> {
    /// Measures candidates from each camera, interleaved. Each camera is one step of the task, named by `place`.
    ///
    /// A candidate that cannot be drawn gives the [reason]; the others are still measured.
    ///
    /// # Errors
    /// The device fails, or the listener cancels.
    pub fn measure(
        &self,
        candidates: &[Setting],
        cameras: &[Camera],
        steps: &mut Steps,
        place: &str,
    ) -> Result<Vec<Outcome>, StudyError> {
        let mut all: Vec<Result<Runner, String>> = Vec::new();
        for candidate in candidates {
            let context = self.device.new_context().map_err(SessionError::from);
            let session = context.map(|context| {
                Session::new(context, self.scene.clone(), &candidate.pipeline, &candidate.set)
            });
            all.push(match session {
                Ok(session) => Ok(Runner { session, views: Vec::new(), once: Vec::new() }),
                Err(error) => Err(reason(error)?),
            });
        }
        for camera in cameras {
            steps.next(place)?;
            for runner in &mut all {
                let Ok(candidate) = runner else { continue };
                if let Err(error) = self.prepare(candidate, camera) {
                    *runner = Err(reason(error)?);
                }
            }
            self.view(&mut all, camera)?;
        }
        let outcome = |runner: Result<Runner, String>| match runner {
            Ok(runner) => Ok(Ok(found(runner, self.copy)?)),
            Err(why) => Ok(Err(why)),
        };
        all.into_iter().map(outcome).collect()
    }

    /// Loads the plan for a camera, and draws a frame, in which the prologue may run and lists may grow. If a plan was
    /// loaded, keeps the times of the passes that run once.
    fn prepare(&self, runner: &mut Runner, camera: &Camera) -> Result<(), SessionError> {
        let session = &mut runner.session;
        let loaded = session.prepare((camera.width, camera.height), &mut |_| {})?;
        let first = interleaved::frame(session, camera)?;
        if !loaded {
            return Ok(());
        }
        let plan = session.plan().ok_or(SessionError::NotPrepared)?;
        let once = first.result.pass_ms.iter().filter(|(id, _)| plan.pass(*id).run == Run::Once);
        let part = |(id, ms): &(PassId, Option<f64>)| {
            let (pass, figure) = (plan.pass(*id), ms.map(|median| Figure { median, spread: None }));
            Part::new(
                pass.name.clone(),
                Some(pass.phase.clone()),
                figure,
                bytes::of_pass(plan, pass),
                self.copy,
            )
        };
        runner.once = once.map(part).collect();
        Ok(())
    }

    fn view(&self, all: &mut [Result<Runner, String>], camera: &Camera) -> Result<(), SessionError> {
        let mut sessions: Vec<&mut Session> =
            all.iter_mut().flatten().map(|runner| &mut runner.session).collect();
        if sessions.is_empty() {
            return Ok(());
        }
        let turn_ms = interleaved::warm_up(&mut sessions, camera, WARM_UP)?;
        let usual = || interleaved::frames_of(turn_ms / sessions.len() as f64);
        let effort = Effort { rounds: self.frames.rounds, frames: self.frames.frames.unwrap_or_else(usual) };
        let profiled = interleaved::rounds(&mut sessions, camera, effort, Timestamps::Passes)?;
        // One frame per round is the usual number for slow frames: the cost of per-pass timestamps is negligible.
        let mut whole = match effort.frames {
            1 => None,
            _ => Some(interleaved::rounds(&mut sessions, camera, effort, Timestamps::Frame)?.into_iter()),
        };
        for (runner, rounds) in all.iter_mut().flatten().zip(profiled) {
            let whole = whole.as_mut().and_then(Iterator::next);
            let whole = whole.as_ref().unwrap_or(&rounds);
            let plan = runner.session.plan().ok_or(SessionError::NotPrepared)?;
            let last = rounds.last().and_then(|round| round.last());
            runner.views.push(View {
                camera: camera.img_name.clone(),
                width: camera.width,
                height: camera.height,
                frames: effort.frames,
                counts: last.map(|frame| frame.result.stats.iter().cloned().collect()).unwrap_or_default(),
                gpu_ms_of_rounds: whole.iter().map(|round| interleaved::gpu_ms(round)).collect(),
                figures: figures(plan, &rounds, whole, self.copy),
            });
        }
        Ok(())
    }
}

/// Summarises a view's frames, without passes that run once. `rounds` have per-pass timestamps; `whole` may lack them.
fn figures(plan: &Plan, rounds: &Rounds, whole: &Rounds, copy: Option<f64>) -> Figures {
    let over_whole = |value: fn(&Timed) -> Option<f64>| Figure::of_frames(whole, value);
    let ids = rounds.first().and_then(|round| round.first());
    let ids = ids.map(|frame| interleaved::timed_passes(plan, frame)).unwrap_or_default();
    let pass = |id: PassId| {
        let pass = plan.pass(id);
        let figure = Figure::of_frames(rounds, |frame| frame.passes_ms(|other| other == id));
        Part::new(pass.name.clone(), Some(pass.phase.clone()), figure, bytes::of_pass(plan, pass), copy)
    };
    let phase = |(name, figure): (&str, Option<Figure>)| {
        let own = ids.iter().map(|id| plan.pass(*id)).filter(|pass| pass.phase == name);
        Part::new(name.to_owned(), None, figure, own.map(|pass| bytes::of_pass(plan, pass)).sum(), copy)
    };
    Figures {
        gpu_ms: over_whole(|frame| frame.result.total_ms),
        between_ms: Figure::of_frames(rounds, |frame| {
            Some(frame.result.total_ms? - frame.passes_ms(|_| true)?)
        }),
        submit_ms: over_whole(|frame| Some(frame.submit_ms)),
        record_ms: over_whole(|frame| Some(frame.result.record_ms)),
        wall_ms: over_whole(|frame| Some(frame.wall_ms)),
        phases: interleaved::phase_figures(plan, &ids, rounds).into_iter().map(phase).collect(),
        passes: ids.iter().copied().map(pass).collect(),
    }
}

fn found(mut runner: Runner, copy: Option<f64>) -> Result<Found, SessionError> {
    let plan = runner.session.plan().ok_or(SessionError::NotPrepared)?;
    let parameters =
        plan.params.iter().map(|param| (param.name.clone(), stats::json(&param.value))).collect();
    let (fallbacks, reasons) = (plan.fallbacks.clone(), stats::reasons(plan));
    let memory: Vec<BufferSize> = runner
        .session
        .device()
        .memory()
        .into_iter()
        .map(|(name, bytes)| BufferSize { name, bytes })
        .collect();
    Ok(Found {
        fallbacks,
        reasons,
        parameters,
        mean: mean(&runner.views, copy),
        views: runner.views,
        once: runner.once,
        memory_bytes: memory.iter().map(|size| size.bytes).sum(),
        memory,
    })
}

/// Averages the medians of the views, and takes the largest spread. A pass that only some views have is averaged over
/// these.
fn mean(views: &[View], copy: Option<f64>) -> Figures {
    let over = |of: fn(&Figures) -> Option<Figure>| Figure::mean(views.iter().map(|view| of(&view.figures)));
    let parts = |of: fn(&Figures) -> &Vec<Part>| {
        let mut names: Vec<&Part> = Vec::new();
        for part in views.iter().flat_map(|view| of(&view.figures)) {
            if !names.iter().any(|known| known.name == part.name) {
                names.push(part);
            }
        }
        let joined = |first: &Part| {
            let same =
                || views.iter().flat_map(|view| of(&view.figures)).filter(|part| part.name == first.name);
            let bytes = same().map(|part| part.bytes).sum::<u64>() / same().count().max(1) as u64;
            let figure = Figure::mean(same().map(|part| part.gpu_ms));
            Part::new(first.name.clone(), first.phase.clone(), figure, bytes, copy)
        };
        names.into_iter().map(joined).collect()
    };
    Figures {
        gpu_ms: over(|figures| figures.gpu_ms),
        between_ms: over(|figures| figures.between_ms),
        submit_ms: over(|figures| figures.submit_ms),
        record_ms: over(|figures| figures.record_ms),
        wall_ms: over(|figures| figures.wall_ms),
        phases: parts(|figures| &figures.phases),
        passes: parts(|figures| &figures.passes),
    }
}

#[cfg(test)]
pub(super) mod testing {
    use super::*;

    /// Returns measurements of two views, with one pass that takes `gpu_ms` in each.
    pub fn found(gpu_ms: Option<f64>) -> Found {
        let figure = |median| Figure { median, spread: Some(0.25) };
        let ms = gpu_ms.map(figure);
        let part = |phase| Part::new("draw".into(), phase, ms, 4_000_000, Some(2000.0));
        let figures = Figures {
            gpu_ms: ms,
            between_ms: ms.map(|_| figure(0.0)),
            submit_ms: Some(figure(1.0)),
            record_ms: Some(figure(0.5)),
            wall_ms: Some(figure(5.0)),
            phases: vec![part(None)],
            passes: vec![part(Some("draw".into()))],
        };
        let view = |camera: &str| View {
            camera: camera.into(),
            width: 64,
            height: 48,
            frames: 1,
            gpu_ms_of_rounds: None,
            counts: BTreeMap::new(),
            figures: figures.clone(),
        };
        let views = vec![view("one"), view("two")];
        let memory = vec![BufferSize { name: "color".into(), bytes: 1 << 20 }];
        let mean = mean(&views, Some(2000.0));
        Found {
            fallbacks: Vec::new(),
            parameters: Map::new(),
            reasons: BTreeMap::new(),
            mean,
            views,
            once: Vec::new(),
            memory,
            memory_bytes: 1 << 20,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::limit::GRAPH;
    use super::*;
    use crate::draw::planner::testing;
    use splatgraph_assets::synth;
    use splatgraph_null::{Call, Config, Journal, limits, open};

    const FRAMES: Frames = Frames { rounds: 2, frames: Some(3) };

    fn device(config: &Config) -> (Backend, Journal) {
        let (device, journal) = open(config);
        (Backend::Null(device.expect("no fault is set")), journal)
    }

    fn candidate(pipeline: &str, set: &[(&str, &str)]) -> Setting {
        Setting::of_graph(pipeline, &testing::set(set))
    }

    fn measured(device: &Backend, candidates: &[Setting], cameras: &[&str]) -> Vec<Outcome> {
        measured_in(FRAMES, device, candidates, cameras)
    }

    fn measured_in(
        frames: Frames,
        device: &Backend,
        candidates: &[Setting],
        cameras: &[&str],
    ) -> Vec<Outcome> {
        let scene = synth::generate("demo", 50, 0).expect("a small scene");
        let camera = |name: &&str| Camera { img_name: (*name).into(), ..Camera::framing(&scene, 32, 24) };
        let cameras: Vec<Camera> = cameras.iter().map(camera).collect();
        let bench = Bench { device, scene: scene.into(), frames, copy: Some(2.0) };
        bench
            .measure(candidates, &cameras, &mut Steps::new(&mut (), "", 1), "")
            .unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn candidates_draw_one_frame_each_in_turns() {
        let (device, journal) = device(&Config::default());
        let outcomes = measured(&device, &[candidate("unsorted", &[]), candidate(GRAPH, &[])], &["one"]);
        assert!(outcomes.iter().all(Result::is_ok), "{outcomes:?}");
        let drawn = |call: Call| match call {
            Call::BindPass { pass, .. } if ["compose", "copy"].contains(&pass.as_str()) => Some(pass),
            _ => None,
        };
        let drawn: Vec<String> = journal.take().into_iter().filter_map(drawn).collect();
        let counted = &drawn[drawn.len() - 2 * 2 * 3..];
        assert!(counted.chunks(2).all(|turn| turn == ["compose", "copy"]), "{counted:?}");
        assert!(
            drawn.len() >= counted.len() + 2 * 3,
            "a warm-up of two turns, and the prologue's: {drawn:?}"
        );
    }

    #[test]
    fn a_candidate_that_does_not_fit_says_why_and_the_others_are_measured() {
        // Every count of a frame is `read`.
        let (device, _) = device(&Config { read: u32::MAX, ..Config::default() });
        let outcomes = measured(
            &device,
            &[
                candidate(GRAPH, &[("mebibytes", "2000")]),
                candidate("tiled", &[]),
                candidate("unsorted", &[]),
            ],
            &["one", "two"],
        );
        let why = outcomes[0].as_ref().expect_err("a storage buffer has 1 GiB at most");
        assert!(why.contains("`from` has 1.95 GiB"), "{why}");
        let why = outcomes[1].as_ref().expect_err("no list has so many entries");
        assert!(why.contains("expected a frame that needs at most"), "{why}");
        let found = outcomes[2].as_ref().expect("it fits");
        assert_eq!(found.views[0].frames, 3);
        assert!(
            found.memory_bytes > 50 * (32 + 16)
                && found.memory.iter().any(|size| size.name.contains("splats"))
        );
    }

    #[test]
    fn the_mean_is_that_of_the_cameras_and_a_phase_is_the_sum_of_its_passes() {
        let (device, _) = device(&Config::default());
        let found = measured(&device, &[candidate("splat", &[])], &["one", "two", "three"]).remove(0);
        let found = found.expect("it is drawn");
        assert_eq!(
            found.views.iter().map(|view| view.camera.as_str()).collect::<Vec<_>>(),
            ["one", "two", "three"]
        );
        let median = |figures: &Figures| figures.gpu_ms.expect("the device has a timer").median;
        let mean = found.views.iter().map(|view| median(&view.figures)).sum::<f64>() / 3.0;
        assert!((median(&found.mean) - mean).abs() < 1e-12);
        let figures = &found.mean;
        for phase in &figures.phases {
            let passes = || figures.passes.iter().filter(|pass| pass.phase.as_deref() == Some(&phase.name));
            let sum: f64 = passes().map(|pass| pass.gpu_ms.expect("timed").median).sum();
            assert!((phase.gpu_ms.expect("timed").median - sum).abs() < 1e-12, "{phase:?}");
            assert_eq!(phase.bytes, passes().map(|pass| pass.bytes).sum::<u64>());
            let rate = phase.bytes as f64 / phase.gpu_ms.expect("timed").median * 1e-6;
            assert!((phase.gb_per_s.expect("timed") - rate).abs() <= 1e-9 * rate);
            assert!((phase.of_copy.expect("timed") - rate / 2.0).abs() <= 1e-9 * rate, "the limit is 2 GB/s");
        }
        let of_parts = |figures: &Figures| {
            let phases = figures.phases.iter().map(|phase| phase.gpu_ms.expect("timed").median);
            phases.sum::<f64>() + figures.between_ms.expect("timed").median
        };
        assert!(of_parts(figures) > median(figures), "per-pass timestamps take time, too");
        // With one frame per round, all times come from the same frames.
        let one = Frames { frames: Some(1), ..FRAMES };
        let one = measured_in(one, &device, &[candidate("splat", &[])], &["one"]).remove(0);
        let one = one.expect("it is drawn").mean;
        assert!((of_parts(&one) - median(&one)).abs() < 1e-12);
        assert_eq!(
            found.once.iter().map(|part| part.name.as_str()).collect::<Vec<_>>(),
            ["scene.covariance"]
        );
        assert!(
            figures.passes.iter().all(|pass| pass.name != "scene.covariance"),
            "what runs once is no part of a frame"
        );
    }

    #[test]
    fn without_timestamps_the_hosts_times_remain() {
        let config = Config {
            limits: splatgraph_runtime::Limits { timestamp_bits: 0, ..limits() },
            ..Config::default()
        };
        let (device, _) = device(&config);
        let found =
            measured(&device, &[candidate("unsorted", &[])], &["one"]).remove(0).expect("it is drawn");
        let figures = &found.mean;
        assert!(figures.gpu_ms.is_none() && figures.between_ms.is_none());
        assert!(figures.wall_ms.is_some_and(|wall| wall.median > 0.0) && figures.submit_ms.is_some());
        assert!(
            figures.passes.iter().any(|pass| pass.bytes > 0)
                && figures.phases.iter().all(|p| p.of_copy.is_none())
        );
    }
}
