//! Measures the sort alone, for several numbers of pairs and key widths, and checks every sorted pair.

use super::limit::no_scene;
use super::measure::{Bench, Found, Part};
use super::report::{Origin, summary};
use super::table::head;
use crate::draw::backend::Backend;
use crate::draw::interleaved::Figure;
use crate::io::report::plot::{Axis, Plot, Series};
use crate::io::report::text::{number, optional, quoted, table};
use crate::studies::study::{Listener, Setting, Steps, StudyError};
use serde::Serialize;
use splatgraph_assets::grouped;

/// Name of the graph that sorts random pairs.
pub const GRAPH: &str = "bench/pairs";
const PHASE: &str = "sort";
/// Statistic of [`GRAPH`]: the number of pairs that differ from a stable sort's.
const WRONG: &str = "wrong";

/// Key widths that are measured, in bits.
pub const KEY_BITS: [u32; 3] = [16, 24, 32];

/// Parameters of [`GRAPH`] that the study itself sets.
pub const OWN_PARAMETERS: [&str; 2] = ["pairs", "key_bits"];

/// Lists the default numbers of pairs: the powers of 4 from 64 Ki to 64 Mi.
pub fn usual_pairs() -> Vec<u32> {
    (8..=13).map(|power| 1 << (2 * power)).collect()
}

/// The measurements of a sort.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sorted {
    /// The sum of the sort's passes: their GPU time, and an estimate of the bytes that they move.
    pub phase: Part,
    /// Upper bound of the sort's GPU time, in milliseconds: its passes plus all time between the frame's passes.
    /// `None` without timestamps.
    pub at_most_ms: Option<f64>,
    /// Host time of the whole frame in milliseconds, including the generation of the pairs; see
    /// [`Figures::wall_ms`](super::measure::Figures::wall_ms).
    pub wall_ms: Option<Figure>,
    /// Pairs sorted per GPU time, in 10^9 per second; `None` if the time is unknown or 0.
    pub gkeys_per_s: Option<f64>,
    /// Passes of the sort, in order of execution.
    pub passes: Vec<Part>,
    /// Bytes of memory on the device.
    pub memory_bytes: u64,
}

impl Sorted {
    /// Extracts the measurements of the sort. Fails if a pair is in the wrong place, or if the sort's phase is missing.
    fn new(pairs: u32, found: Found) -> Result<Sorted, String> {
        let wrong: u32 = found.views.iter().filter_map(|view| view.counts.get(WRONG)).sum();
        if wrong > 0 {
            return Err(format!(
                "expected the order of a stable sort, found {} wrong pairs",
                grouped(wrong.into())
            ));
        }
        let mean = found.mean;
        let phase = mean.phases.into_iter().find(|phase| phase.name == PHASE);
        let phase = phase.ok_or(format!("it has no phase `{PHASE}`"))?;
        let ms = phase.gpu_ms.map(|ms| ms.median);
        Ok(Sorted {
            at_most_ms: ms.zip(mean.between_ms).map(|(ms, between)| ms + between.median),
            wall_ms: mean.wall_ms,
            gkeys_per_s: ms.filter(|ms| *ms > 0.0).map(|ms| f64::from(pairs) / ms * 1e-6),
            passes: mean.passes.into_iter().filter(|pass| pass.phase.as_deref() == Some(PHASE)).collect(),
            memory_bytes: found.memory_bytes,
            phase,
        })
    }
}

/// The measurements of sorting one number of pairs by keys of one width.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Number of pairs that are sorted.
    pub pairs: u32,
    /// Width of the keys, in bits.
    pub key_bits: u32,
    /// The measurements, or the error.
    pub found: Result<Sorted, String>,
}

/// The sorts of a run, with its origin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Program, device and settings of the run.
    #[serde(flatten)]
    pub origin: Origin,
    /// True once all numbers of pairs are measured; until then, the report is partial.
    pub complete: bool,
    /// The sorts, grouped by number of pairs.
    pub rows: Vec<Row>,
}

/// Measures sorts of each number of pairs, with the key widths interleaved. Calls `kept` before the first
/// number, so that no earlier file is taken for this run's, and after each.
///
/// # Errors
/// The device fails, `kept` fails, or the listener cancels. A sort that does not fit in memory, or that leaves pairs in
/// the wrong place, gives a row with the reason.
pub fn measure<E: From<StudyError>>(
    device: &Backend,
    pairs: &[u32],
    origin: Origin,
    kept: &mut dyn FnMut(&Report) -> Result<(), E>,
    listener: &mut dyn Listener,
) -> Result<Report, E> {
    let (scene, camera) = no_scene().map_err(StudyError::from)?;
    let copy = origin.copy.as_ref().map(|copy| copy.gb_per_s);
    let bench = Bench { device, scene: scene.into(), frames: origin.effort, copy };
    let mut steps = Steps::new(listener, "sorting", pairs.len());
    let mut report = Report { origin, complete: false, rows: Vec::new() };
    kept(&report)?;
    for pairs in pairs.iter().copied() {
        let candidate = |key_bits: u32| {
            let own = OWN_PARAMETERS.into_iter().zip([pairs, key_bits]);
            let own = own.map(|(name, value)| (name.to_owned(), value.to_string()));
            Setting::of_graph(GRAPH, &report.origin.set.iter().cloned().chain(own).collect::<Vec<_>>())
        };
        let place = format!("{} pairs", grouped(pairs.into()));
        let cameras = std::slice::from_ref(&camera);
        let outcomes = bench.measure(&KEY_BITS.map(candidate), cameras, &mut steps, &place)?;
        report.rows.extend(KEY_BITS.into_iter().zip(outcomes).map(|(key_bits, found)| Row {
            pairs,
            key_bits,
            found: found.and_then(|found| Sorted::new(pairs, found)),
        }));
        kept(&report)?;
    }
    report.complete = true;
    Ok(report)
}

impl Report {
    /// Returns true if no sort was measured.
    pub fn is_empty(&self) -> bool {
        self.rows.iter().all(|row| row.found.is_err())
    }

    /// Formats the rates and times as a table, with the reasons for missing sorts.
    pub fn table(&self) -> String {
        let header = ["pairs, key", "GKey/s", "GPU ms", "spread", "at most", "frame ms", "MB", "of copy"];
        let mut lines = Vec::new();
        let mut missing = String::new();
        for row in &self.rows {
            let name = format!("{}, {} bits", grouped(row.pairs.into()), row.key_bits);
            let sorted = match &row.found {
                Ok(sorted) => sorted,
                Err(why) => {
                    missing += &format!("{name}: not sorted: {}\n", summary(why));
                    continue;
                }
            };
            let ms = sorted.phase.gpu_ms;
            lines.push(vec![
                name,
                number(sorted.gkeys_per_s, 3),
                number(ms.map(|ms| ms.median), 3),
                number(ms.and_then(|ms| ms.spread), 3),
                number(sorted.at_most_ms, 3),
                number(sorted.wall_ms.map(|ms| ms.median), 3),
                format!("{:.1}", sorted.phase.bytes as f64 * 1e-6),
                sorted.phase.of_copy.map_or("-".into(), |share| format!("{:.0} %", 100.0 * share)),
            ]);
        }
        let timed = self.rows.iter().flat_map(|row| &row.found).all(|sorted| sorted.phase.gpu_ms.is_some());
        format!("{}\n{}{missing}", head(&self.origin, timed), table(header, lines))
    }

    /// Formats every sort as CSV (RFC 4180), one per line, with all digits; missing values are empty.
    pub fn csv(&self) -> String {
        let header = "pairs,key_bits,gkeys_per_s,gpu_ms,spread_ms,at_most_ms,wall_ms,bytes,gb_per_s,of_copy,memory_bytes,failed";
        let line = |Row { pairs, key_bits, found }: &Row| match found {
            Ok(sorted) => format!(
                "{pairs},{key_bits},{},{},{},{},{},{},{},{},{},",
                optional(sorted.gkeys_per_s),
                optional(sorted.phase.gpu_ms.map(|figure| figure.median)),
                optional(sorted.phase.gpu_ms.and_then(|figure| figure.spread)),
                optional(sorted.at_most_ms),
                optional(sorted.wall_ms.map(|figure| figure.median)),
                sorted.phase.bytes,
                optional(sorted.phase.gb_per_s),
                optional(sorted.phase.of_copy),
                sorted.memory_bytes
            ),
            Err(why) => format!("{pairs},{key_bits},,,,,,,,,,{}", quoted(&summary(why))),
        };
        self.origin.csv(header, self.rows.iter().map(line))
    }

    /// Plots the rate against the number of pairs, one line per key width; `None` without times.
    pub fn plot(&self) -> Option<Plot> {
        let series = |bits: u32| {
            let rows = self.rows.iter().filter(move |row| row.key_bits == bits);
            let points =
                rows.filter_map(|row| Some((f64::from(row.pairs), row.found.as_ref().ok()?.gkeys_per_s?)));
            Series::line(&format!("keys of {bits} bits"), points)
        };
        let series: Vec<Series> = KEY_BITS.into_iter().map(series).collect();
        series.iter().any(|series| !series.points.is_empty()).then(|| Plot {
            bars: Vec::new(),
            title: format!("The sort alone, {}", self.origin.title()),
            x: Axis { label: "pairs".into(), logarithmic: true },
            y: Axis { label: "10^9 pairs per second".into(), logarithmic: false },
            series,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::testing;
    use super::*;
    use crate::draw::interleaved::Frames;
    use splatgraph_api::Device;
    use splatgraph_null::{Config, open};

    #[test]
    fn each_number_of_pairs_is_kept_at_once_and_the_report_is_complete_after_the_last() {
        let device = Backend::Null(open(&Config::default()).0.expect("no fault is set"));
        let origin = Origin::new(device.info(), None, Frames { rounds: 1, frames: Some(1) }, &[]);
        let mut lengths = Vec::new();
        let mut kept = |report: &Report| {
            lengths.push((report.rows.len(), report.complete));
            Ok::<(), StudyError>(())
        };
        let report = measure(&device, &[100, 200], origin, &mut kept, &mut ()).expect("it is measured");
        assert_eq!((lengths, report.complete), (vec![(0, false), (3, false), (6, false)], true));
    }

    #[test]
    fn a_sort_with_wrong_pairs_has_no_times() {
        let with = |wrong: u32| {
            let mut found = testing::found(Some(1.0));
            found.mean.phases[0].name = PHASE.into();
            found.views[1].counts.insert(WRONG.into(), wrong);
            Sorted::new(1000, found)
        };
        assert_eq!(with(0).map(|sorted| sorted.gkeys_per_s), Ok(Some(1e-3)));
        let error = with(1234).expect_err("refused");
        assert_eq!(error, "expected the order of a stable sort, found 1,234 wrong pairs");
    }
}
