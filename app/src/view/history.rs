//! Records the times of recent frames, for the rolling plot and the table of medians and 99th percentiles.
//!
//! The newest [`WINDOW`] frames are kept across changes of the plan, so that the plot shows the effect of a change. The
//! table covers only frames of the newest measured plan that did not run the prologue; the plan on the screen may be
//! newer.

use crate::draw::stats::quantile;
use splatgraph_api::FrameResult;
use splatgraph_framework::ir::{PassId, Run};
use splatgraph_framework::plan::Plan;
use std::collections::VecDeque;
use std::sync::Arc;

/// Maximum number of recorded frames.
pub const WINDOW: usize = 300;

#[derive(Clone, Debug)]
struct Sample {
    plan: Arc<Plan>,
    /// Number of the frame in this history, from 1.
    number: u64,
    prologue: bool,
    total_ms: Option<f64>,
    record_ms: f64,
    /// Milliseconds per phase, in order of execution, excluding passes of the prologue. `None` if a pass has no time.
    phases: Vec<(String, Option<f64>)>,
    passes: Vec<(PassId, Option<f64>)>,
}

/// Quantiles of a time over the frames that the table covers, in milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quantiles {
    /// Median, in milliseconds.
    pub median: f64,
    /// The 99th percentile; with fewer than 100 frames, the maximum.
    pub p99: f64,
}

impl Quantiles {
    fn of(values: impl Iterator<Item = f64>) -> Option<Quantiles> {
        let mut values: Vec<f64> = values.collect();
        values.sort_by(f64::total_cmp);
        Some(Quantiles { median: quantile(&values, 0.5)?, p99: quantile(&values, 0.99)? })
    }
}

/// A row of the table: a phase, or one of its passes.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the phase or of the pass.
    pub name: String,
    /// Phase that a pass belongs to; `None` if the row is a phase.
    pub phase: Option<String>,
    /// Times over the covered frames; `None` if no frame has a time for the row.
    pub ms: Option<Quantiles>,
}

/// A line of the plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name of the phase or the pass.
    pub name: String,
    /// Pairs of frame number and milliseconds; frames without a time are skipped.
    pub points: Vec<[f64; 2]>,
}

/// The recorded frames of one renderer.
#[derive(Clone, Debug, Default)]
pub struct History {
    samples: VecDeque<Sample>,
    frames: u64,
}

impl History {
    /// Records a frame of `plan`; drops the oldest if there are [`WINDOW`] frames.
    pub fn push(&mut self, plan: &Arc<Plan>, result: &FrameResult) {
        let mut phases: Vec<(String, Option<f64>)> = Vec::new();
        let mut prologue = false;
        for &(id, ms) in &result.pass_ms {
            let pass = plan.pass(id);
            if pass.run == Run::Once {
                prologue = true;
                continue;
            }
            match phases.iter_mut().find(|(phase, _)| *phase == pass.phase) {
                Some((_, sum)) => *sum = sum.zip(ms).map(|(a, b)| a + b),
                None => phases.push((pass.phase.clone(), ms)),
            }
        }
        if self.samples.len() == WINDOW {
            self.samples.pop_front();
        }
        self.frames += 1;
        self.samples.push_back(Sample {
            plan: plan.clone(),
            number: self.frames,
            prologue,
            total_ms: result.total_ms,
            record_ms: result.record_ms,
            phases,
            passes: result.pass_ms.clone(),
        });
    }

    /// Returns the number of frames so far, including frames that are no longer recorded.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Returns the plan of the newest recorded frame; `None` before the first frame.
    pub fn plan(&self) -> Option<&Arc<Plan>> {
        self.samples.back().map(|sample| &sample.plan)
    }

    /// Returns true if the newest recorded frame was drawn with `plan`.
    pub fn is_of(&self, plan: &Arc<Plan>) -> bool {
        self.plan().is_some_and(|measured| Arc::ptr_eq(measured, plan))
    }

    /// Returns the number of frames that the table covers; see [`History::table`].
    pub fn steady_frames(&self) -> usize {
        self.steady().count()
    }

    /// Computes the quantiles of GPU time from a frame's first command to its last. `None` without timestamps, and
    /// before the first frame that the table covers.
    pub fn total(&self) -> Option<Quantiles> {
        Quantiles::of(self.steady().filter_map(|s| s.total_ms))
    }

    /// Lists the GPU times of the newest `count` frames, in milliseconds, oldest first, across all plans. Frames
    /// without a time are skipped.
    pub fn recent(&self, count: usize) -> Vec<f64> {
        let skipped = self.samples.len().saturating_sub(count);
        self.samples.iter().skip(skipped).filter_map(|sample| sample.total_ms).collect()
    }

    /// Computes the median GPU time of a frame outside its passes, in milliseconds. `None` if no frame that the table
    /// covers has both its total time and the times of all its passes.
    pub fn unattributed(&self) -> Option<f64> {
        let rest = |sample: &Sample| {
            let passes: Option<f64> = sample.phases.iter().map(|(_, ms)| *ms).sum();
            Some((sample.total_ms? - passes?).max(0.0))
        };
        Quantiles::of(self.steady().filter_map(rest)).map(|rests| rests.median)
    }

    /// Returns true if passes account for less than half of the frame time, so that their times are unreliable. False
    /// if either is unknown.
    pub fn is_mostly_unattributed(&self) -> bool {
        match (self.unattributed(), self.total()) {
            (Some(rest), Some(total)) => rest > 0.5 * total.median,
            _ => false,
        }
    }

    /// Computes the quantiles of host time to record and submit a frame; `None` before the first frame of the table.
    pub fn record(&self) -> Option<Quantiles> {
        Quantiles::of(self.steady().map(|s| s.record_ms))
    }

    /// Lists the phases of the newest frame that the table covers, in execution order, each followed by its passes.
    /// Empty if the table covers no frame.
    pub fn table(&self) -> Vec<Row> {
        let Some(last) = self.steady().last() else { return Vec::new() };
        let mut rows = Vec::new();
        for (phase, _) in &last.phases {
            let of_phase =
                |s: &Sample| s.phases.iter().find(|(name, _)| name == phase).and_then(|(_, ms)| *ms);
            let ms = Quantiles::of(self.steady().filter_map(of_phase));
            rows.push(Row { name: phase.clone(), phase: None, ms });
            for (index, &(id, _)) in last.passes.iter().enumerate() {
                let pass = last.plan.pass(id);
                if pass.phase != *phase || pass.run == Run::Once {
                    continue;
                }
                // The covered frames run the same passes, so an index identifies a pass.
                let of_pass =
                    |s: &Sample| s.passes.get(index).filter(|(i, _)| *i == id).and_then(|(_, ms)| *ms);
                let ms = Quantiles::of(self.steady().filter_map(of_pass));
                rows.push(Row { name: pass.name.clone(), phase: Some(phase.clone()), ms });
            }
        }
        rows
    }

    /// Collects the milliseconds per phase over all recorded frames, in the order of first appearance.
    pub fn phase_series(&self) -> Vec<Series> {
        collect(&self.samples, |sample| sample.phases.clone())
    }

    /// Collects the milliseconds per pass of one phase over the frames that the table covers.
    pub fn pass_series(&self, phase: &str) -> Vec<Series> {
        let passes = |sample: &Sample| {
            let timed = sample.passes.iter().map(|(id, ms)| (sample.plan.pass(*id), *ms));
            let of_phase = timed.filter(|(pass, _)| pass.phase == phase && pass.run == Run::Frame);
            of_phase.map(|(pass, ms)| (pass.name.clone(), ms)).collect()
        };
        collect(self.steady(), passes)
    }

    /// Lists the numbers of the recorded frames whose plan differs from that of the frame before.
    pub fn changes(&self) -> Vec<f64> {
        let pairs = self.samples.iter().zip(self.samples.iter().skip(1));
        pairs.filter(|(a, b)| !Arc::ptr_eq(&a.plan, &b.plan)).map(|(_, b)| b.number as f64).collect()
    }

    /// Computes the median milliseconds per pass of `plan`, by name, without passes that have no time. Empty if the
    /// newest frame is from another plan.
    pub fn medians(&self, plan: &Arc<Plan>) -> Vec<(String, f64)> {
        if !self.is_of(plan) {
            return Vec::new();
        }
        let passes = self.table().into_iter().filter(|row| row.phase.is_some());
        passes.filter_map(|row| Some((row.name, row.ms?.median))).collect()
    }

    /// Iterates over the frames of the newest recorded plan, except frames that ran the prologue.
    fn steady(&self) -> impl DoubleEndedIterator<Item = &Sample> {
        let newest = self.plan();
        self.samples.iter().filter(move |sample| {
            !sample.prologue && newest.is_some_and(|plan| Arc::ptr_eq(plan, &sample.plan))
        })
    }
}

fn collect<'a>(
    samples: impl IntoIterator<Item = &'a Sample>,
    named: impl Fn(&Sample) -> Vec<(String, Option<f64>)>,
) -> Vec<Series> {
    let mut series: Vec<Series> = Vec::new();
    for sample in samples {
        for (name, ms) in named(sample) {
            let Some(ms) = ms else { continue };
            let point = [sample.number as f64, ms];
            match series.iter_mut().find(|series| series.name == name) {
                Some(series) => series.points.push(point),
                None => series.push(Series { name, points: vec![point] }),
            }
        }
    }
    series
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::tests;

    fn frame(times: &[f64]) -> FrameResult {
        FrameResult {
            pass_ms: times.iter().enumerate().map(|(i, ms)| (PassId(i as u32), Some(*ms))).collect(),
            total_ms: Some(times.iter().sum()),
            record_ms: 0.1,
            ..FrameResult::default()
        }
    }

    #[test]
    fn a_row_of_a_phase_is_followed_by_those_of_its_passes() {
        let plan = tests::plan(&[("key", "key"), ("scan[0]", "sort"), ("scan[1]", "sort")]);
        let mut history = History::default();
        for ms in [1.0, 3.0, 2.0] {
            history.push(&plan, &frame(&[ms, 10.0 * ms, 100.0]));
        }
        let table = history.table();
        let names: Vec<_> = table.iter().map(|row| (row.name.as_str(), row.ms.unwrap().median)).collect();
        assert_eq!(
            names,
            [("key", 2.0), ("key", 2.0), ("sort", 120.0), ("scan[0]", 20.0), ("scan[1]", 100.0)]
        );
        assert_eq!(table[2].ms.unwrap().p99, 130.0);
        let lines = history.pass_series("sort");
        let names: Vec<_> = lines.iter().map(|line| (line.name.as_str(), line.points.len())).collect();
        assert_eq!(names, [("scan[0]", 3), ("scan[1]", 3)]);
        assert_eq!(lines[0].points[1], [2.0, 30.0]);
        assert_eq!(history.total().unwrap().median, 122.0);
    }

    #[test]
    fn the_table_forgets_the_former_plan_and_the_plot_does_not() {
        let (former, plan) = (tests::plan(&[("a", "sort")]), tests::plan(&[("a", "sort")]));
        let mut history = History::default();
        history.push(&former, &frame(&[5.0]));
        assert!(history.medians(&plan).is_empty(), "no frame of this plan was measured yet");
        history.push(&plan, &frame(&[1.0]));
        assert_eq!(history.table()[0].ms.unwrap().p99, 1.0);
        assert_eq!(history.phase_series()[0].points, [[1.0, 5.0], [2.0, 1.0]]);
        assert_eq!(history.changes(), [2.0]);
    }

    #[test]
    fn times_keep_the_names_of_the_plan_that_they_were_measured_with() {
        let long = tests::plan(&[("a", "sort"), ("b", "sort"), ("c", "draw")]);
        let short = tests::plan(&[("x", "draw")]);
        let mut history = History::default();
        history.push(&long, &frame(&[1.0, 2.0, 3.0]));
        // The short plan is already on the screen, but none of its frames is finished.
        let names: Vec<String> = history.table().into_iter().map(|row| row.name).collect();
        assert_eq!(names, ["sort", "a", "b", "draw", "c"]);
        assert_eq!(history.pass_series("sort").len(), 2);
        assert!(history.medians(&short).is_empty());
        history.push(&short, &frame(&[4.0]));
        assert_eq!(history.medians(&short), [("x".to_owned(), 4.0)]);
        assert!(history.medians(&long).is_empty());
    }

    #[test]
    fn time_between_passes_is_unattributed() {
        let plan = tests::plan(&[("a", "sort"), ("b", "draw")]);
        let mut history = History::default();
        history.push(&plan, &FrameResult { total_ms: Some(325.0), ..frame(&[0.02, 0.03]) });
        assert!((history.unattributed().unwrap() - 324.95).abs() < 1e-9);
        assert!(history.is_mostly_unattributed());
        let mut history = History::default();
        history.push(&plan, &FrameResult { total_ms: Some(3.5), ..frame(&[1.0, 2.0]) });
        assert!(!history.is_mostly_unattributed());
    }

    #[test]
    fn no_more_than_the_window_is_kept() {
        let plan = tests::plan(&[("a", "sort")]);
        let mut history = History::default();
        for _ in 0..WINDOW + 10 {
            history.push(&plan, &frame(&[1.0]));
        }
        assert_eq!(history.phase_series()[0].points.len(), WINDOW);
        assert_eq!(history.frames(), WINDOW as u64 + 10);
        assert_eq!(history.recent(5).len(), 5);
    }

    #[test]
    fn a_phase_of_which_a_pass_has_no_time_has_none() {
        let plan = tests::plan(&[("a", "sort"), ("b", "sort")]);
        let mut history = History::default();
        let mut result = frame(&[1.0, 2.0]);
        result.pass_ms[1].1 = None;
        history.push(&plan, &result);
        let table = history.table();
        assert_eq!(table[0].ms, None);
        assert_eq!(table[1].ms.unwrap().median, 1.0);
        assert!(history.phase_series().is_empty());
    }
}
