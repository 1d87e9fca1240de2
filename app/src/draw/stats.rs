//! Summarises the times and counts of frames, in one [`CameraStats`] per camera.
//!
//! Times are medians over the camera's frames. A pass of the prologue, which runs in the first frame after a load, has
//! a single time.

use serde::Serialize;
use serde_json::{Map, Value as Json};
use splatgraph_api::{DeviceInfo, FrameResult};
use splatgraph_assets::grouped;
use splatgraph_framework::ir::{Fallback, PassId, Reason, Run, Source, Value};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;

/// Options with which a device was opened, and which affect times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Opened {
    /// True if the API validates every call, which takes time of the host.
    pub validate: bool,
    /// True if accesses of shaders are not checked.
    pub no_robustness: bool,
}

/// Statistics of one camera.
#[derive(Clone, Debug, Serialize)]
pub struct CameraStats {
    /// Name of the camera.
    pub camera: String,
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Name of the graph that was drawn.
    pub pipeline: String,
    /// Graphs and presets on which the pipeline is based, the graph last; empty if the pipeline is a graph itself.
    pub based_on: Vec<String>,
    /// Graphs of a choice whose requirements are not met, in the order of the choice.
    pub fallbacks: Vec<Fallback>,
    /// Name of the device.
    pub device: String,
    /// Driver of the device, with its version.
    pub driver: String,
    /// Options of the device.
    #[serde(flatten)]
    pub opened: Opened,
    /// Values of all parameters of the graph, in the order of the file.
    pub parameters: Map<String, Json>,
    /// Reasons of parameter values, by parameter; only for values of expressions over facts or other parameters.
    pub reasons: BTreeMap<String, Reason>,
    /// Counts by name: `loaded`, the scene's splats, and the last frame's statistics, such as `visible` and `drawn`. A
    /// statistic of the graph named `loaded` takes the place of the scene's splats.
    pub counts: Map<String, Json>,
    /// Times of the passes, in order of execution.
    pub passes: Vec<PassTime>,
    /// Milliseconds per phase, summed over its passes that run in every frame; `null` if one of them has no time.
    pub phases: Map<String, Json>,
    /// Milliseconds per phase of the passes that run once; `null` as in `phases`.
    pub once: Map<String, Json>,
    /// GPU time from a frame's first command to its last, without the passes that run once, in milliseconds; `None`
    /// without timestamps.
    pub gpu_ms: Option<f64>,
    /// Host time to record and submit a frame, in milliseconds.
    pub record_ms: f64,
    /// Fraction of time that the device spends drawing, at most 1; `None` if unknown.
    pub busy: Option<f64>,
    /// Number of frames whose times are summarised.
    pub frames: usize,
    /// Device memory by allocation.
    pub buffers: Vec<BufferSize>,
    /// Files of the camera, by output; `picture` is the picture. Empty if none was written.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
    /// Number of pixels that are NaN or infinite; `None` unless the picture's file cannot hold them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_finite: Option<usize>,
    /// Number of splats of the scene; `None` if the graph draws no scene.
    #[serde(skip)]
    pub(crate) loaded: Option<u64>,
    /// The last frame's statistics, in the order of the graph.
    #[serde(skip)]
    pub(crate) stats: Vec<(String, u32)>,
    /// Contents that `--inspect` read back.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub inspected: Vec<crate::draw::inspect::Finding>,
}

const VISIBLE: &str = "visible";

/// Statistics of the built-in graphs that draw a scene. Of these, [`CameraStats::line`] contains only the visible
/// splats, if they are counted.
const SHIPPED: [&str; 4] = [VISIBLE, "drawn", "entries_needed", "tied"];

/// Warning about the times of passes on a CPU.
pub(crate) const CPU_TIMES: &str = "this device is a CPU, whose driver may write a pass's timestamp before the pass ends: \
    only the GPU ms of whole frames are reliable";

/// Value of [`CameraStats::busy`] below which the device idles so much that its clock may fall.
pub const BUSY: f64 = 0.5;

/// Time of a pass.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassTime {
    /// Name of the pass, as in the plan's dump.
    pub name: String,
    /// Phase that the pass belongs to.
    pub phase: String,
    /// Median GPU time in milliseconds; `None` without timestamps.
    pub gpu_ms: Option<f64>,
    #[serde(skip)]
    run: Run,
}

/// An allocation of device memory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BufferSize {
    /// Name of the resource, or the purpose of a backend's own allocation.
    pub name: String,
    /// Size of the allocation, in bytes.
    pub bytes: u64,
}

impl CameraStats {
    /// Summarises the frames of a camera: at least one, in the order of submission.
    ///
    /// `loaded` is the scene's number of splats. [`CameraStats::opened`], `busy`, `files` and `inspected` stay empty.
    pub fn new(
        camera: (&str, (u32, u32)),
        plan: &Plan,
        device: &DeviceInfo,
        loaded: u64,
        frames: &[FrameResult],
        memory: Vec<(String, u64)>,
    ) -> CameraStats {
        let mut counts = Map::new();
        counts.insert("loaded".into(), loaded.into());
        let stats = frames.last().map(|frame| frame.stats.clone()).unwrap_or_default();
        for (name, value) in &stats {
            counts.insert(name.clone(), (*value).into());
        }
        let draws_scene = plan.resources.iter().any(|r| matches!(r.source, Source::Scene { .. }));
        let passes = pass_times(plan, frames);
        let (name, (width, height)) = camera;
        CameraStats {
            camera: name.to_owned(),
            width,
            height,
            pipeline: plan.name.clone(),
            based_on: plan.based_on.clone(),
            fallbacks: plan.fallbacks.clone(),
            device: device.name.clone(),
            driver: device.driver.clone(),
            opened: Opened::default(),
            parameters: plan.params.iter().map(|p| (p.name.clone(), json(&p.value))).collect(),
            reasons: reasons(plan),
            counts,
            phases: phase_times(&passes, Run::Frame),
            once: phase_times(&passes, Run::Once),
            passes,
            gpu_ms: total_time(plan, frames),
            record_ms: median(frames.iter().map(|f| f.record_ms).collect()).unwrap_or(0.0),
            busy: None,
            frames: frames.len(),
            buffers: memory.into_iter().map(|(name, bytes)| BufferSize { name, bytes }).collect(),
            files: BTreeMap::new(),
            not_finite: None,
            loaded: draws_scene.then_some(loaded),
            stats,
            inspected: Vec::new(),
        }
    }

    /// Returns the count named `name`; `None` if there is none.
    pub fn count(&self, name: &str) -> Option<u64> {
        self.counts.get(name)?.as_u64()
    }

    /// Returns true if the scene has splats and none was visible in the last frame. False if the graph does not count
    /// visible splats.
    pub fn sees_nothing(&self) -> bool {
        self.loaded.is_some_and(|loaded| loaded > 0) && is_blind(&self.stats)
    }

    /// Computes the part of [`CameraStats::gpu_ms`] that belongs to no phase; `None` if a time is unknown.
    fn unattributed_ms(&self) -> Option<f64> {
        Some(self.gpu_ms? - self.phases.values().map(Json::as_f64).sum::<Option<f64>>()?)
    }

    /// Formats a summary line: `153,746 of 200,000 splats visible, 1.234 ms on ... (key 0.2, sort 0.6, draw 0.4)`.
    ///
    /// Statistics of a user's graph follow the splats, such as `in_view 153,746`. Without a statistic `visible`, those
    /// of the built-in graphs are listed in the same way. The splats are omitted if the graph draws no scene. The
    /// phases are followed by the time that belongs to none.
    pub fn line(&self) -> String {
        let visible = self.stats.iter().find(|(name, _)| name == VISIBLE).filter(|_| self.loaded.is_some());
        let splats = self.loaded.map(|loaded| match visible {
            Some((_, visible)) => {
                format!("{} of {} splats visible", grouped((*visible).into()), grouped(loaded))
            }
            None => format!("{} splats", grouped(loaded)),
        });
        let hidden = |name: &str| visible.is_some() && SHIPPED.contains(&name);
        let own = self.stats.iter().filter(|(name, _)| !hidden(name));
        let own = own.map(|(name, count)| format!("{name} {}", grouped((*count).into())));
        let ms = self.gpu_ms.map(|ms| format!("{ms:.3} ms"));
        let parts: Vec<String> = splats.into_iter().chain(own).chain(ms).collect();
        let mut line = if parts.is_empty() { "drawn".to_owned() } else { parts.join(", ") };
        line += &format!(" on {}", self.device);
        if let Some(busy) = self.busy.filter(|busy| *busy < BUSY) {
            line += &format!(", which was idle for {:.0} % of the time", 100.0 * (1.0 - busy));
        }
        let phase = |(phase, ms): (&String, &Json)| Some(format!("{phase} {:.3}", ms.as_f64()?));
        let rest = self.unattributed_ms().filter(|ms| *ms >= 5e-4).map(|ms| format!("unattributed {ms:.3}"));
        let phases: Vec<String> = self.phases.iter().filter_map(phase).chain(rest).collect();
        if !phases.is_empty() {
            line += &format!(" ({})", phases.join(", "));
        }
        line
    }
}

/// Returns true if a frame's statistic `visible` is 0; false without this statistic.
pub(crate) fn is_blind(stats: &[(String, u32)]) -> bool {
    stats.iter().any(|(name, count)| name == VISIBLE && *count == 0)
}

pub(crate) fn reasons(plan: &Plan) -> BTreeMap<String, Reason> {
    plan.params.iter().filter_map(|param| Some((param.name.clone(), param.reason.clone()?))).collect()
}

pub(crate) fn json(value: &Value) -> Json {
    match value {
        Value::Bool(v) => (*v).into(),
        Value::Int(v) => (*v).into(),
        Value::Float(v) => (*v).into(),
        Value::Text(v) => v.as_str().into(),
    }
}

/// Computes the median, or the mean of the middle two of an even number of values. `None` without values.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => None,
        _ if n % 2 == 1 => Some(values[n / 2]),
        _ => Some(0.5 * (values[n / 2 - 1] + values[n / 2])),
    }
}

/// Computes a quantile of ascending values. It is the smallest value that is at least as large as a fraction `q` of
/// them. `None` without values.
#[cfg(feature = "window")]
pub(crate) fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let rank = (q * values.len() as f64).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied()
}

fn pass_times(plan: &Plan, frames: &[FrameResult]) -> Vec<PassTime> {
    let mut order: Vec<PassId> = Vec::new();
    let mut times: BTreeMap<PassId, Vec<f64>> = BTreeMap::new();
    for &(pass, ms) in frames.iter().flat_map(|f| &f.pass_ms) {
        let entry = times.entry(pass).or_insert_with(|| {
            order.push(pass);
            Vec::new()
        });
        entry.extend(ms);
    }
    let time = |id: PassId| {
        let pass = plan.pass(id);
        let gpu_ms = median(times.remove(&id).unwrap_or_default());
        PassTime { name: pass.name.clone(), phase: pass.phase.clone(), gpu_ms, run: pass.run }
    };
    order.into_iter().map(time).collect()
}

fn phase_times(passes: &[PassTime], run: Run) -> Map<String, Json> {
    let mut phases: Map<String, Json> = Map::new();
    for pass in passes.iter().filter(|pass| pass.run == run) {
        let sum = phases.entry(pass.phase.clone()).or_insert(0.0.into());
        *sum = match (sum.as_f64(), pass.gpu_ms) {
            (Some(sum), Some(ms)) => (sum + ms).into(),
            _ => Json::Null,
        };
    }
    phases
}

fn total_time(plan: &Plan, frames: &[FrameResult]) -> Option<f64> {
    let of_frame = |frame: &FrameResult| {
        let once = frame.pass_ms.iter().filter(|(pass, _)| plan.pass(*pass).run == Run::Once);
        let once: f64 = once.filter_map(|(_, ms)| *ms).sum();
        Some((frame.total_ms? - once).max(0.0))
    };
    median(frames.iter().filter_map(of_frame).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_api::Device;
    use splatgraph_framework::ir::{Origin, Shape, Usage};
    use splatgraph_framework::plan::Resource;

    #[test]
    fn the_median_of_an_even_number_is_between_the_middle_two() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 9.0]), Some(3.0));
    }

    #[test]
    fn a_line_has_the_statistics_of_a_users_graph_and_splats_only_if_the_graph_draws_them() {
        let line = |source: Option<Source>, stats: &[(&str, u32)]| {
            let resource = |source| Resource {
                name: "position".into(),
                shape: Shape::Buffer { stride: 12, count: 2000 },
                usage: Usage::STORAGE,
                source,
                block: None,
                history: None,
                origin: Origin::default(),
            };
            let plan = Plan { resources: source.into_iter().map(resource).collect(), ..Plan::default() };
            let stats = stats.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect();
            let frame = FrameResult { stats, ..FrameResult::default() };
            let device =
                splatgraph_null::open(&splatgraph_null::Config::default()).0.expect("no fault is set");
            let device = DeviceInfo { name: "device".into(), ..device.info().clone() };
            CameraStats::new(("0", (1, 1)), &plan, &device, 2000, &[frame], Vec::new()).line()
        };
        let scene = || Some(Source::Scene { attribute: "scene.position".into(), plane: 0 });
        assert_eq!(line(scene(), &[]), "2,000 splats on device");
        let usual = [("visible", 1500), ("drawn", 1400), ("tied", 3)];
        assert_eq!(line(scene(), &usual), "1,500 of 2,000 splats visible on device");
        let own = [("in_view", 1500), ("loaded", 2)];
        assert_eq!(line(scene(), &own), "2,000 splats, in_view 1,500, loaded 2 on device");
        assert_eq!(line(None, &own), "in_view 1,500, loaded 2 on device");
        assert_eq!(line(scene(), &usual[1..]), "2,000 splats, drawn 1,400, tied 3 on device");
        assert_eq!(line(None, &usual[..1]), "visible 1,500 on device");
        assert_eq!(line(None, &[]), "drawn on device");
    }

    #[test]
    fn a_phase_is_the_sum_of_its_passes_and_unknown_where_one_is() {
        let pass = |run, phase: &str, gpu_ms| PassTime { name: "x".into(), phase: phase.into(), gpu_ms, run };
        let of_frame = |phase, gpu_ms| pass(Run::Frame, phase, gpu_ms);
        let passes = [
            pass(Run::Once, "sort", Some(9.0)),
            of_frame("sort", Some(1.0)),
            of_frame("draw", None),
            of_frame("sort", Some(2.5)),
            of_frame("draw", Some(1.0)),
        ];
        let phases = |run| Json::Object(phase_times(&passes, run));
        assert_eq!(phases(Run::Frame), serde_json::json!({ "sort": 3.5, "draw": null }));
        assert_eq!(phases(Run::Once), serde_json::json!({ "sort": 9.0 }), "with a phase of the frame's");
    }
}
