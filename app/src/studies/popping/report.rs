//! Formats scores as a table, as CSV, and as a plot.

use super::measure::Track;
use crate::io::report::plot::{Axis, Plot, Series};
use crate::io::report::text;
use crate::studies::provenance::Provenance;
use serde::Serialize;
use splatgraph_reference::metrics::WorstPixel;

/// The summary of a variant over the whole path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The variant's name.
    pub name: String,
    /// Mean angle by which the camera turns in a step, in degrees.
    pub step_degrees: f64,
    /// Mean pop over the steps.
    pub pop: f64,
    /// Sum of the pops divided by the sum of the degrees; `None` if the camera does not turn.
    pub pop_per_degree: Option<f64>,
    /// Mean excess over the steps.
    pub excess: f64,
    /// The largest pop of a step.
    pub worst_step: f64,
    /// Name of the camera at the end of the step with the largest pop.
    pub worst_camera: String,
    /// The pixel with the largest change of the error in any step, by the mean of its channels.
    pub worst: WorstPixel,
    /// Mean number of pairs of splats that swap places in a step; `None` without a readable order.
    pub order_changes: Option<f64>,
    /// Mean number of pairs of the drawn splats that swap places in a step, in the true order; `None` without a
    /// readable order.
    pub true_order_changes: Option<f64>,
}

/// Summarises the steps of a variant.
pub fn summary(track: &Track) -> Summary {
    let steps = &track.steps;
    let count = steps.len().max(1) as f64;
    let mean = |of: &dyn Fn(usize) -> f64| (0..steps.len()).map(of).sum::<f64>() / count;
    let step = steps.iter().max_by(|a, b| a.score.pop.total_cmp(&b.score.pop));
    let pixel = steps.iter().map(|step| step.score.worst);
    let changes = |of: &dyn Fn(usize) -> Option<u64>| {
        (0..steps.len()).map(of).sum::<Option<u64>>().map(|sum| sum as f64 / count)
    };
    let (pop, step_degrees) = (mean(&|at| steps[at].score.pop), mean(&|at| steps[at].degrees));
    Summary {
        name: track.variant.name.clone(),
        step_degrees,
        pop,
        pop_per_degree: (step_degrees > 0.0).then(|| pop / step_degrees),
        excess: mean(&|at| steps[at].score.excess),
        worst_step: step.map_or(0.0, |step| step.score.pop),
        worst_camera: step.map_or_else(String::new, |step| step.camera.clone()),
        worst: pixel.max_by(|a, b| a.difference.total_cmp(&b.difference)).unwrap_or(WorstPixel {
            difference: 0.0,
            x: 0,
            y: 0,
        }),
        order_changes: changes(&|at| steps[at].order_changes),
        true_order_changes: changes(&|at| steps[at].true_order_changes),
    }
}

/// Notes below the table.
pub const NOTES: &str = "\
pop: for steps of this many degrees (their mean). With another step, the ranking may change: an error that drifts \
shrinks with the step, one that jumps shrinks less.
per °: pop per degree of camera rotation. Compare only equal steps.
0 by definition: the published order, in which the exact renderer also draws. It sorts by the depth of centres \
(fisheyes and panoramas: by distance), and pops where two splats change places. These pops are counted only with \
`--rule order=pixel`: the true pictures then have the order of each pixel, and do not pop.
";

/// Formats summaries as a table for a terminal.
pub fn table(summaries: &[Summary]) -> String {
    let header = [
        "variant",
        "step",
        "pop",
        "per °",
        "excess",
        "worst step",
        "at",
        "worst pixel",
        "at",
        "order changes",
        "true changes",
    ];
    let rows = summaries.iter().map(|found| {
        vec![
            found.name.clone(),
            format!("{}°", shown_degrees(found.step_degrees)),
            format!("{:.3e}", found.pop),
            found.pop_per_degree.map_or("-".into(), |pop| format!("{pop:.3e}")),
            format!("{:.3e}", found.excess),
            format!("{:.3e}", found.worst_step),
            found.worst_camera.clone(),
            format!("{:.4}", found.worst.difference),
            format!("{},{}", found.worst.x, found.worst.y),
            text::number(found.order_changes, 0),
            text::number(found.true_order_changes, 0),
        ]
    });
    text::table(header, rows)
}

fn shown_degrees(degrees: f64) -> String {
    text::decimals(degrees, 4)
}

/// Formats every step of every variant as CSV (RFC 4180), with all digits; missing values are empty. `rules` are those
/// of [`study`](super::study).
pub fn csv(tracks: &[Track], rules: &[(String, String)], provenance: &Provenance) -> String {
    let header = "variant,step,camera,degrees,pop,excess,worst,worst_x,worst_y,change,true_change,order_changes,true_order_changes,pipeline,set,rules";
    let lines = tracks.iter().flat_map(|track| {
        track.steps.iter().enumerate().map(|(at, step)| {
            let cells = [
                text::quoted(&track.variant.name),
                (at + 1).to_string(),
                text::quoted(&step.camera),
                step.degrees.to_string(),
                step.score.pop.to_string(),
                step.score.excess.to_string(),
                step.score.worst.difference.to_string(),
                step.score.worst.x.to_string(),
                step.score.worst.y.to_string(),
                step.score.change.to_string(),
                step.score.true_change.to_string(),
                text::optional(step.order_changes),
                text::optional(step.true_order_changes),
                text::quoted(&track.variant.pipeline),
                text::quoted(&text::parameters(&track.variant.set)),
                text::quoted(&text::parameters(rules)),
            ];
            cells.join(",")
        })
    });
    provenance.csv(header, lines, &[])
}

/// Plots the pop of each step. Variants with equal pops share a line, labelled with all of their names.
pub fn plot(tracks: &[Track]) -> Plot {
    let mut lines: Vec<(String, Vec<f64>)> = Vec::new();
    for track in tracks {
        let pops: Vec<f64> = track.steps.iter().map(|step| step.score.pop).collect();
        match lines.iter_mut().find(|(_, other)| *other == pops) {
            Some((names, _)) => *names += &format!(", {}", track.variant.name),
            None => lines.push((track.variant.name.clone(), pops)),
        }
    }
    let line = |(names, pops): &(String, Vec<f64>)| {
        Series::line(names, pops.iter().enumerate().map(|(at, pop)| ((at + 1) as f64, *pop)))
    };
    let degrees = || tracks.iter().flat_map(|track| &track.steps).map(|step| step.degrees);
    let ends = degrees().min_by(f64::total_cmp).zip(degrees().max_by(f64::total_cmp));
    let of = ends.map_or(String::new(), |(least, most)| match [least, most].map(shown_degrees) {
        [least, most] if least == most => format!(", steps of {most}°"),
        [least, most] => format!(", steps of {least}° to {most}°"),
    });
    Plot {
        bars: Vec::new(),
        title: format!("Change of the error from frame to frame{of}"),
        x: Axis { label: "step of the path".into(), logarithmic: false },
        y: Axis { label: "pop: mean |E' - E| of a pixel".into(), logarithmic: true },
        series: lines.iter().map(line).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::Step;
    use super::super::score::Score;
    use super::*;
    use crate::studies::study::Setting;
    use crate::studies::trade::ledger::testing::origin;

    fn track() -> Track {
        let step = |camera: &str, pop: f64, changes: Option<u64>| Step {
            camera: camera.into(),
            degrees: 0.25,
            score: Score {
                pop,
                excess: 0.5 * pop,
                worst: WorstPixel { difference: 2.0 * pop, x: 3, y: 4 },
                change: 0.5,
                true_change: 0.25,
            },
            order_changes: changes,
            true_order_changes: Some(2),
        };
        let variant =
            Setting { name: "a \"b\"".into(), pipeline: "splat".into(), set: vec![("k".into(), "8".into())] };
        Track { variant, steps: vec![step("x", 0.1, Some(3)), step("y", 0.3, Some(4))] }
    }

    #[test]
    fn a_summary_has_the_means_and_the_worst() {
        let found = summary(&track());
        assert!((found.pop - 0.2).abs() < 1e-12 && (found.excess - 0.1).abs() < 1e-12, "{found:?}");
        assert_eq!((found.worst_step, found.worst_camera.as_str()), (0.3, "y"));
        assert_eq!((found.worst.difference, found.order_changes), (0.6, Some(3.5)));
        assert_eq!((found.step_degrees, found.pop_per_degree), (0.25, Some(found.pop / 0.25)));
        let mut still = track();
        still.steps.iter_mut().for_each(|step| step.degrees = 0.0);
        assert_eq!(summary(&still).pop_per_degree, None);
        let mut without = track();
        without.steps[0].order_changes = None;
        assert_eq!(summary(&without).order_changes, None);
    }

    #[test]
    fn tables_are_aligned_and_csv_has_a_line_for_each_step() {
        let text = table(&[summary(&track())]);
        let lines: Vec<&str> = text.lines().collect();
        let width = |line: &str| line.chars().count();
        assert!(lines.len() == 2 && width(lines[0]) == width(lines[1]), "{text}");
        assert!(lines[1].contains(" 0.25°  2.000e-1  8.000e-1 "), "{text}");
        assert_eq!(["0.25", "0", "12"].map(String::from), [0.25, 0.0, 12.0].map(shown_degrees));
        let text = csv(&[track()], &[("order".into(), "pixel".into())], &origin().provenance);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3, "{text}");
        assert!(lines[2].starts_with("\"a \"\"b\"\"\",2,\"y\",0.25,0.3,0.15,0.6,3,4,0.5,0.25,4,2,\"splat\",\"k=8\",\"order=pixel\",\"a.ply\",32,24,"), "{text}");
        let plotted = plot(&[track(), track()]);
        assert_eq!((plotted.series.len(), plotted.series[0].points.len()), (1, 2));
        assert_eq!(plotted.series[0].name, "a \"b\", a \"b\"");
        assert!(plotted.title.ends_with(", steps of 0.25°"), "{}", plotted.title);
        let mut uneven = track();
        uneven.steps[1].degrees = 80.0;
        let title = plot(&[uneven]).title;
        assert!(title.ends_with(", steps of 0.25° to 80°"), "{title}");
    }
}
