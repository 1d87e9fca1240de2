//! Plots the time of candidates against the number of splats, and against the size of the picture.

use super::report::{Report, Row, size_text};
use crate::io::report::plot::{Axis, Plot, Series};
use indexmap::IndexSet;
use splatgraph_assets::grouped;

/// Picture sizes of a run; `None` for the size of each camera.
type Sizes<'a> = &'a [Option<(u32, u32)>];

/// Returns the file names of a scene's plots, without extension, in the order of [`plots`].
///
/// With several numbers of splats, there is one plot for each size; with several sizes, one for each number of splats.
/// `stem` identifies the scene.
pub fn names(stem: &str, splats: &[u32], sizes: Sizes) -> Vec<String> {
    let size_name = |size: &Option<(u32, u32)>| size.map_or("own".into(), |(w, h)| format!("{w}x{h}"));
    let mut names = Vec::new();
    if splats.len() > 1 {
        names.extend(sizes.iter().map(|size| format!("splats-{stem}-{}", size_name(size))));
    }
    if sizes.len() > 1 {
        let counts = if splats.is_empty() {
            vec!["all".to_owned()]
        } else {
            splats.iter().map(u32::to_string).collect()
        };
        names.extend(counts.iter().map(|count| format!("sizes-{stem}-{count}")));
    }
    names
}

/// Returns true for a name that [`names`] returns for some scene, sizes and numbers of splats.
pub fn is_name(name: &str) -> bool {
    let end =
        |start: &str| name.strip_prefix(start).and_then(|rest| rest.rsplit_once('-')).map(|(_, end)| end);
    let is_number = |text: &str| text.parse::<u32>().is_ok();
    let is_size = |text: &str| {
        text.split_once('x').is_some_and(|(width, height)| is_number(width) && is_number(height))
    };
    end("splats-").is_some_and(|size| size == "own" || is_size(size))
        || end("sizes-").is_some_and(|count| count == "all" || is_number(count))
}

/// Plots the times of a scene. `splats` are the requested numbers of splats; empty if the scene keeps its own.
///
/// Plots over sizes have no points for the cameras' own sizes.
pub fn plots(report: &Report, scene: &str, splats: &[u32], sizes: Sizes) -> Vec<Plot> {
    let rows: Vec<&Row> = report.rows.iter().filter(|row| row.scene == scene).collect();
    let counts: IndexSet<u32> = rows.iter().map(|row| row.splats).collect();
    let mut plots = Vec::new();
    let title = |of: String| format!("{}, {of}, {}", report.name_of(scene), report.origin.title());
    if splats.len() > 1 {
        plots.extend(sizes.iter().map(|size| {
            let own = rows.iter().copied().filter(|row| row.size == *size);
            let x = Axis { label: "splats".into(), logarithmic: true };
            let title = title(size_text(*size));
            plot(report, title, x, &own.collect::<Vec<_>>(), |row| Some(f64::from(row.splats)))
        }));
    }
    if sizes.len() > 1 {
        plots.extend(counts.into_iter().map(|count| {
            let own = rows.iter().copied().filter(|row| row.splats == count);
            let x = Axis { label: "pixels".into(), logarithmic: true };
            let title = title(format!("{} splats", grouped(count.into())));
            let pixels = |row: &Row| row.size.map(|(width, height)| f64::from(width) * f64::from(height));
            plot(report, title, x, &own.collect::<Vec<_>>(), pixels)
        }));
    }
    plots
}

/// Plots the GPU time of a frame, or the host's time if a candidate of the report has no GPU times. Each graph has a
/// line.
fn plot(
    report: &Report,
    title: String,
    x: Axis,
    rows: &[&Row],
    position: impl Fn(&Row) -> Option<f64>,
) -> Plot {
    let on_gpu = report.drawn().all(|found| found.mean.gpu_ms.is_some());
    let names: IndexSet<&str> = rows.iter().map(|row| row.pipeline.as_str()).collect();
    let point = |row: &&Row| {
        let mean = &row.found.as_ref().ok()?.mean;
        let figure = if on_gpu { mean.gpu_ms } else { mean.wall_ms };
        Some((position(row)?, figure?.median))
    };
    let series = |name: &&str| {
        let mut points: Vec<(f64, f64)> =
            rows.iter().filter(|row| row.pipeline == **name).filter_map(point).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series::line(name, points)
    };
    let time = if on_gpu { "GPU time of a frame, ms" } else { "time of a frame on the host's clock, ms" };
    let y = Axis { label: time.into(), logarithmic: true };
    Plot { bars: Vec::new(), title, x, y, series: names.iter().map(series).collect() }
}

#[cfg(test)]
mod tests {
    use super::super::measure::testing::found;
    use super::super::report::testing::report;
    use super::*;

    const SIZES: [Option<(u32, u32)>; 2] = [Some((64, 48)), Some((128, 96))];

    #[test]
    fn there_is_a_curve_where_something_varies_and_a_name_for_each() {
        assert!(names("a", &[], &[None]).is_empty() && names("a", &[5], &SIZES[..1]).is_empty());
        assert_eq!(names("a", &[1, 2], &[None]), ["splats-a-own"]);
        assert_eq!(names("a", &[], &SIZES), ["sizes-a-all"]);
        let of_both = ["splats-a-64x48", "splats-a-128x96", "sizes-a-1", "sizes-a-2"];
        assert_eq!(names("a", &[1, 2], &SIZES), of_both);
        let all = of_both.into_iter().chain(["splats-a-own", "sizes-a-b-all"]);
        assert!(
            all.into_iter().all(is_name) && !["sizes-a", "splats-a-wide", "a-1"].into_iter().any(is_name)
        );
    }

    #[test]
    fn a_graph_is_a_line_from_few_splats_to_many_without_those_that_were_not_drawn() {
        let rows = vec![
            ("one", 2000, Ok(found(Some(3.0)))),
            ("two", 2000, Err("no".into())),
            ("one", 1000, Ok(found(Some(2.0)))),
            ("two", 1000, Ok(found(Some(1.0)))),
        ];
        let mut report = report(rows);
        report.origin.set = vec![("k".into(), "8".into())];
        let plots = plots(&report, "scenes/a.ply", &[2000, 1000], &SIZES[..1]);
        assert_eq!((plots.len(), plots[0].title.as_str()), (1, "a, 64x48, k=8, none"));
        let points = |at: usize| plots[0].series[at].points.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>();
        assert_eq!((points(0), points(1)), (vec![(1000.0, 2.0), (2000.0, 3.0)], vec![(1000.0, 1.0)]));
        assert_eq!(
            (plots[0].series[1].name.as_str(), plots[0].y.label.as_str()),
            ("two", "GPU time of a frame, ms")
        );
    }

    #[test]
    fn without_timestamps_the_hosts_time_is_drawn() {
        let rows = vec![("one", 1000, Ok(found(None))), ("one", 2000, Ok(found(None)))];
        let plots = plots(&report(rows), "scenes/a.ply", &[1000, 2000], &SIZES[..1]);
        assert!(
            plots[0].y.label.contains("host") && plots[0].series[0].points.iter().all(|point| point.y == 5.0)
        );
    }
}
