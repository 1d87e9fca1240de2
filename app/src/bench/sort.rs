//! Measures the sort alone, over numbers of pairs and widths of keys.

use super::limit::no_scene;
use super::measure::{Bench, Candidate, Found, Part};
use super::report::{Origin, optional};
use super::table::{first_line, head};
use crate::report::plot::{Axis, Plot, Series};
use crate::report::text::{quoted, table};
use crate::session::SessionError;
use crate::turns::Figure;
use serde::Serialize;
use splatgraph_api::Device;
use splatgraph_assets::{grouped, synth};

/// The graph that sorts random pairs.
pub const GRAPH: &str = "bench/pairs";
/// The phase that is measured.
const PHASE: &str = "sort";

/// The widths of keys, in bits.
pub const KEY_BITS: [u32; 3] = [16, 24, 32];

/// The parameters of [`GRAPH`] that a run sets by itself.
pub const OWN_PARAMETERS: [&str; 2] = ["pairs", "key_bits"];

/// Lists the usual numbers of pairs: 64 Ki to 64 Mi in powers of 4.
pub fn usual_pairs() -> Vec<u32> {
    (8..=13).map(|power| 1 << (2 * power)).collect()
}

/// The measurements of a sort.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sorted {
    /// Milliseconds on the GPU; `None` if the device has no timestamps.
    pub gpu_ms: Option<Figure>,
    /// Milliseconds on the host's clock for the whole frame, in which the pairs are also made.
    pub wall_ms: Option<Figure>,
    /// The pairs by the time on the GPU, in 10^9 per second.
    pub gkeys_per_s: Option<f64>,
    /// The passes.
    pub passes: Vec<Part>,
    /// Bytes of memory on the device.
    pub memory_bytes: u64,
}

impl Sorted {
    fn new(pairs: u32, found: Found) -> Sorted {
        let phase = found.mean.phases.iter().find(|phase| phase.name == PHASE);
        let gpu_ms = phase.and_then(|phase| phase.gpu_ms);
        Sorted {
            gpu_ms,
            wall_ms: found.mean.wall_ms,
            gkeys_per_s: gpu_ms.filter(|ms| ms.median > 0.0).map(|ms| f64::from(pairs) / ms.median * 1e-6),
            passes: found
                .mean
                .passes
                .into_iter()
                .filter(|pass| pass.phase.as_deref() == Some(PHASE))
                .collect(),
            memory_bytes: found.memory_bytes,
        }
    }
}

/// A number of pairs with keys of a width.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Number of pairs.
    pub pairs: u32,
    /// Width of the keys, in bits.
    pub key_bits: u32,
    /// The measurements, or the reason that there are none.
    pub found: Result<Sorted, String>,
}

/// The numbers of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The origin of the numbers.
    #[serde(flatten)]
    pub origin: Origin,
    /// The sorts: those of one number of pairs one after the other.
    pub rows: Vec<Row>,
}

/// An error of measuring sorts.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The device fails.
    // Not transparent: a graph's errors are found among the causes, and printed with their source text.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// There is no memory for the scene that stands for none.
    #[error(transparent)]
    Scene(#[from] synth::SynthError),
}

/// Measures sorts of each number of pairs, keys of different widths in turns; `each` is told of the number before each.
///
/// # Errors
/// The device fails. A sort that does not fit is a row that says why.
pub fn measure<D: Device>(
    device: &D,
    pairs: &[u32],
    origin: Origin,
    each: &mut dyn FnMut(u32),
) -> Result<Report, Error> {
    let (scene, camera) = no_scene()?;
    let copy = origin.copy.as_ref().map(|copy| copy.gb_per_s);
    let bench = Bench { device, scene: scene.into(), frames: origin.effort, copy };
    let mut rows = Vec::new();
    for pairs in pairs.iter().copied() {
        each(pairs);
        let candidate = |key_bits: u32| {
            let own = OWN_PARAMETERS.into_iter().zip([pairs, key_bits]);
            let own = own.map(|(name, value)| (name.to_owned(), value.to_string()));
            Candidate { pipeline: GRAPH.into(), set: origin.set.iter().cloned().chain(own).collect() }
        };
        let outcomes = bench.measure(&KEY_BITS.map(candidate), std::slice::from_ref(&camera), &mut |_| {})?;
        rows.extend(KEY_BITS.into_iter().zip(outcomes).map(|(key_bits, found)| Row {
            pairs,
            key_bits,
            found: found.map(|found| Sorted::new(pairs, found)),
        }));
    }
    Ok(Report { origin, rows })
}

impl Report {
    /// Returns the sort of so many pairs with keys of this width.
    fn find(&self, pairs: u32, key_bits: u32) -> Option<&Row> {
        self.rows.iter().find(|row| (row.pairs, row.key_bits) == (pairs, key_bits))
    }

    /// Says whether any sort was measured.
    pub fn is_empty(&self) -> bool {
        self.rows.iter().all(|row| row.found.is_err())
    }

    /// Sets the rates and times as a table, and says why sorts are missing.
    pub fn table(&self) -> String {
        let mut pairs: Vec<u32> = self.rows.iter().map(|row| row.pairs).collect();
        pairs.dedup();
        let header =
            KEY_BITS.iter().flat_map(|bits| [format!("{bits} bits: GKey/s"), "ms".into(), "spread".into()]);
        let mut lines: Vec<Vec<String>> = vec![std::iter::once("pairs".to_owned()).chain(header).collect()];
        let mut missing = String::new();
        let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.3}"));
        for pairs in pairs {
            let mut line = vec![grouped(pairs.into())];
            for row in KEY_BITS.iter().filter_map(|bits| self.find(pairs, *bits)) {
                let (rate, figure) = match &row.found {
                    // Without timestamps the frame's time on the host is all there is.
                    Ok(sorted) => (sorted.gkeys_per_s, sorted.gpu_ms.or(sorted.wall_ms)),
                    Err(why) => {
                        let (pairs, why) = (grouped(pairs.into()), first_line(why));
                        missing +=
                            &format!("{pairs} pairs with keys of {} bits: not sorted: {why}\n", row.key_bits);
                        (None, None)
                    }
                };
                line.extend([
                    number(rate),
                    number(figure.map(|f| f.median)),
                    number(figure.map(|f| f.spread)),
                ]);
            }
            lines.push(line);
        }
        format!("{}\n{}{missing}", head(&self.origin), table(&lines))
    }

    /// Writes every sort as CSV (RFC 4180), a line each, with all digits; what there is none of is empty.
    pub fn csv(&self) -> String {
        let mut text =
            String::from("pairs,key_bits,gkeys_per_s,gpu_ms,spread_ms,wall_ms,memory_bytes,failed\n");
        for Row { pairs, key_bits, found } in &self.rows {
            text += &match found {
                Ok(sorted) => format!(
                    "{pairs},{key_bits},{},{},{},{},{},\n",
                    optional(sorted.gkeys_per_s),
                    optional(sorted.gpu_ms.map(|figure| figure.median)),
                    optional(sorted.gpu_ms.map(|figure| figure.spread)),
                    optional(sorted.wall_ms.map(|figure| figure.median)),
                    sorted.memory_bytes
                ),
                Err(why) => format!("{pairs},{key_bits},,,,,,{}\n", quoted(why)),
            };
        }
        text
    }

    /// Plots the rate over the number of pairs, a line for each width; `None` without times.
    pub fn plot(&self) -> Option<Plot> {
        let series = |bits: u32| {
            let rows = self.rows.iter().filter(move |row| row.key_bits == bits);
            let points =
                rows.filter_map(|row| Some((f64::from(row.pairs), row.found.as_ref().ok()?.gkeys_per_s?)));
            Series::line(&format!("keys of {bits} bits"), points)
        };
        let series: Vec<Series> = KEY_BITS.into_iter().map(series).collect();
        series.iter().any(|series| !series.points.is_empty()).then(|| Plot {
            title: format!("The sort alone, {}", self.origin.device),
            x: Axis { label: "pairs".into(), logarithmic: true },
            y: Axis { label: "10^9 pairs per second".into(), logarithmic: false },
            series,
        })
    }
}
