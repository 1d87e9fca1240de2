//! Collects the results of a camera's measured frames, and the times of the prologue.

use crate::draw::stats::CameraStats;
use splatgraph_api::{DeviceInfo, FrameResult, Pixels};
use splatgraph_framework::ir::Run;
use splatgraph_framework::plan::Plan;
use std::time::Instant;

#[derive(Default)]
pub struct Kept {
    /// Result of the frame that ran the prologue, if that frame is not measured.
    once: Option<FrameResult>,
    counted: Vec<FrameResult>,
    /// Completion times of the measured frames.
    done: Vec<Instant>,
}

impl Kept {
    /// Adds the next frame. If the frame is not measured, keeps only the times of the prologue's passes.
    pub fn add(&mut self, mut result: FrameResult, plan: &Plan, counts: bool) {
        if counts {
            // Only the last frame's statistics are reported.
            if let Some(former) = self.counted.last_mut() {
                former.stats = Vec::new();
            }
            self.counted.push(result);
            self.done.push(Instant::now());
            return;
        }
        result.pass_ms.retain(|(pass, _)| plan.pass(*pass).run == Run::Once);
        if !result.pass_ms.is_empty() {
            self.once =
                Some(FrameResult { total_ms: None, stats: Vec::new(), inspected: Vec::new(), ..result });
        }
    }

    pub fn output(&mut self) -> Option<Pixels> {
        self.counted.last_mut()?.output.take()
    }

    pub fn stats(
        self,
        camera: (&str, (u32, u32)),
        plan: &Plan,
        device: &DeviceInfo,
        loaded: u64,
        memory: Vec<(String, u64)>,
    ) -> CameraStats {
        let (busy, frames) = (self.busy(), self.counted.len());
        let record_ms: Vec<f64> = self.counted.iter().map(|frame| frame.record_ms).collect();
        let mut counted = self.counted;
        // Timestamps of passes take time: frames with them count as whole frames only if there are no others.
        let is_profiled = |frame: &FrameResult| frame.pass_ms.iter().any(|(_, ms)| ms.is_some());
        if !counted.iter().all(is_profiled) {
            counted.iter_mut().filter(|frame| is_profiled(frame)).for_each(|frame| frame.total_ms = None);
        }
        let all: Vec<FrameResult> = self.once.into_iter().chain(counted).collect();
        let stats = CameraStats::new(camera, plan, device, loaded, &all, memory);
        let record_ms = crate::draw::stats::median(record_ms).unwrap_or(stats.record_ms);
        CameraStats { busy, frames, record_ms, ..stats }
    }

    /// Computes the fraction of time that the device spends drawing, at most 1; `None` with fewer than four measured
    /// frames, or without timestamps.
    ///
    /// Measured from the end of the first frame to the end of the last but one: the last also reads the picture back.
    fn busy(&self) -> Option<f64> {
        let (between, times) = match (self.counted.as_slice(), self.done.as_slice()) {
            ([_, between @ .., _], [first, .., end, _]) if between.len() > 1 => (between, (*first, *end)),
            _ => return None,
        };
        let drawn = between.iter().map(|frame| frame.total_ms).sum::<Option<f64>>()?;
        let all = 1e3 * times.1.duration_since(times.0).as_secs_f64();
        (all > 0.0).then(|| (drawn / all).min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing;
    use splatgraph_framework::ir::PassId;
    use std::time::Duration;

    #[test]
    fn passes_are_timed_after_the_warm_up_and_a_device_that_rests_is_told() {
        let plan = testing::plan("splat", &[], 8);
        let id = |name: &str| {
            PassId(plan.passes.iter().position(|pass| pass.name == name).expect("a pass") as u32)
        };
        let frame = |ms: f64, prologue: bool| FrameResult {
            total_ms: Some(if prologue { ms + 7.0 } else { ms }),
            pass_ms: prologue
                .then(|| (id("scene.covariance"), Some(7.0)))
                .into_iter()
                .chain([(id("project"), Some(ms))])
                .collect(),
            record_ms: ms,
            ..FrameResult::default()
        };
        let mut kept = Kept::default();
        kept.add(frame(90.0, true), &plan, false);
        kept.add(frame(80.0, false), &plan, false);
        // Only the last measured frames have timestamps of passes.
        let whole = |ms| FrameResult { pass_ms: vec![(id("project"), None)], ..frame(ms, false) };
        let parts = |ms| FrameResult { pass_ms: vec![(id("project"), Some(ms))], ..whole(1.0) };
        let frames = [whole(1.0), whole(1.0), parts(2.0), parts(2.5)];
        frames.into_iter().for_each(|frame| kept.add(frame, &plan, true));
        let begun = Instant::now();
        kept.done = (0..4).map(|at| begun + Duration::from_millis(4 * at)).collect();
        let stats = kept.stats(
            ("a", (32, 24)),
            &plan,
            &DeviceInfo { name: "device".into(), ..info() },
            3,
            Vec::new(),
        );
        let times: Vec<_> = stats.passes.iter().map(|pass| (pass.name.as_str(), pass.gpu_ms)).collect();
        assert_eq!(times, [("scene.covariance", Some(7.0)), ("project", Some(2.25))]);
        assert_eq!(
            (stats.frames, stats.gpu_ms, stats.record_ms, stats.busy),
            (4, Some(1.0), 1.0, Some(0.25))
        );
        assert!(stats.line().contains("on device, which was idle for 75 % of the time"), "{}", stats.line());
        // Without a warm-up, the first frame and the last ones have timestamps of passes.
        let mut kept = Kept::default();
        let frames = [frame(9.0, true), whole(1.0), whole(1.0), frame(3.0, false)];
        frames.into_iter().for_each(|frame| kept.add(frame, &plan, true));
        let stats = kept.stats(("a", (32, 24)), &plan, &info(), 3, Vec::new());
        assert_eq!((stats.frames, stats.gpu_ms, stats.passes[1].gpu_ms), (4, Some(1.0), Some(6.0)));
        let mut kept = Kept::default();
        kept.add(frame(5.0, true), &plan, true);
        let stats = kept.stats(("a", (32, 24)), &plan, &info(), 3, Vec::new());
        // The frame took 12 ms, of which the prologue took 7.
        assert_eq!((stats.frames, stats.gpu_ms, stats.busy, stats.passes.len()), (1, Some(5.0), None, 2));
    }

    fn info() -> DeviceInfo {
        let device = splatgraph_null::open(&splatgraph_null::Config::default()).0.expect("no fault is set");
        splatgraph_api::Device::info(&device).clone()
    }
}
