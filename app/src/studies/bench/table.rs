//! Formats the numbers of a run as tables for a terminal.

use super::measure::{Found, Part};
use super::report::{Origin, Report, Row, size_text, summary};
use crate::draw::interleaved::Figure;
use crate::draw::stats::{BUSY, CPU_TIMES};
use crate::io::report::text::{number, table};
use indexmap::IndexSet;
use splatgraph_assets::grouped;
use std::iter;

/// Describes the device and its copy limit, explains the column `MB`, and warns of unreliable or missing times.
///
/// `timed` is false if times are missing.
pub fn head(origin: &Origin, timed: bool) -> String {
    let mut text = format!("{} ({})\n", origin.device, origin.driver);
    if let Some(copy) = &origin.copy {
        text += &format!(
            "copy limit: {:.0} GB/s ({} bytes read and written in {:.3} ms)\n",
            copy.gb_per_s,
            grouped(copy.bytes),
            copy.gpu_ms.median
        );
    }
    text += "MB: declared sizes of what a pass reads plus what it writes, each once; overestimates when splats are culled\n";
    if origin.is_cpu {
        text += CPU_TIMES;
        text.push('\n');
    }
    if origin.opened.no_robustness {
        text += "accesses of shaders are not checked (--no-robustness)\n";
    }
    if origin.opened.validate {
        text += "the API validates every call (--validate): times of the host are longer\n";
    }
    if !timed {
        text += "this device has no timestamps: times are those of the host\n";
    }
    text
}

/// Formats all tables of a report.
///
/// For each scene, number of splats and size, these are the passes of each candidate, the cameras if there are several,
/// and the candidates. Notes on idle devices and failures follow.
///
/// If there are several of these combinations, an overview of the candidates over all of them follows.
pub fn tables(report: &Report) -> String {
    let timed = report.drawn().all(|found| found.mean.gpu_ms.is_some());
    let mut text = head(&report.origin, timed);
    for rows in report.rows.chunk_by(|a, b| place(a) == place(b)) {
        let Some(first) = rows.first() else { continue };
        text += &format!("\n{}\n", heading(report, first));
        for (row, found) in drawn(rows) {
            text += &format!("\npasses of {}\n{}", row.pipeline, passes(found, report.origin.is_cpu));
        }
        if drawn(rows).any(|(_, found)| found.views.len() > 1) {
            text += &format!("\nGPU ms of each camera\n{}", cameras(rows));
        }
        text += &format!("\n{}", candidates(rows));
        for (row, found) in drawn(rows) {
            text += &resting(row, found);
        }
        for (row, why) in rows.iter().filter_map(|row| Some((row, row.found.as_ref().err()?))) {
            text += &format!("{}: not drawn: {}\n", row.pipeline, summary(why));
        }
    }
    let places = report.rows.chunk_by(|a, b| place(a) == place(b)).count();
    if places > 1 {
        text += &format!("\nGPU ms, mean of the cameras' medians\n{}", overview(report));
    }
    text
}

fn place(row: &Row) -> (&str, u32, Option<(u32, u32)>) {
    (&row.scene, row.splats, row.size)
}

fn drawn(rows: &[Row]) -> impl Iterator<Item = (&Row, &Found)> {
    rows.iter().filter_map(|row| Some((row, row.found.as_ref().ok()?)))
}

fn heading(report: &Report, row: &Row) -> String {
    let splats = grouped(row.splats.into());
    format!("{}, {splats} splats, {}", report.name_of(&row.scene), size_text(row.size))
}

fn ms(figure: Option<Figure>) -> String {
    number(figure.map(|figure| figure.median), 3)
}

fn spread(figure: Option<Figure>) -> String {
    number(figure.and_then(|figure| figure.spread), 3)
}

/// Formats the candidates of one scene, number of splats and size, one per line.
fn candidates(rows: &[Row]) -> String {
    let all = drawn(rows).flat_map(|(_, found)| &found.mean.phases);
    let phases: IndexSet<&str> = all.map(|part| part.name.as_str()).collect();
    let header = ["", "GPU ms", "spread"].into_iter().chain(phases.iter().copied());
    let header = header.chain(["between", "frame ms", "submit ms", "MiB"]);
    let line = |(row, found): (&Row, &Found)| {
        let mean = &found.mean;
        let mut line = vec![row.pipeline.clone(), ms(mean.gpu_ms), spread(mean.gpu_ms)];
        let of = |phase: &str| mean.phases.iter().find(|part| part.name == phase);
        line.extend(phases.iter().map(|phase| of(phase).map_or(String::new(), |part| ms(part.gpu_ms))));
        let mebibytes = found.memory_bytes as f64 / f64::from(1 << 20);
        // Per-pass timestamps can slow a frame so much that the time between passes exceeds a whole frame without them.
        let is_less = |between: &Figure| mean.gpu_ms.is_some_and(|whole| between.median <= whole.median);
        let between = mean.between_ms.filter(is_less);
        line.extend([ms(between), ms(mean.wall_ms), ms(mean.submit_ms), format!("{mebibytes:.1}")]);
        line
    };
    table(header, drawn(rows).map(line))
}

/// Returns a note if the device is idle for more than half of the frames' host time, else an empty string.
fn resting(row: &Row, found: &Found) -> String {
    let busy = found.mean.gpu_ms.zip(found.mean.wall_ms).map(|(gpu, wall)| gpu.median / wall.median);
    match busy.filter(|busy| *busy < BUSY) {
        Some(busy) => format!(
            "{}: the device is idle for {:.0} % of the time when frames are drawn alone: its clock may be lower than under load\n",
            row.pipeline,
            100.0 * (1.0 - busy)
        ),
        None => String::new(),
    }
}

/// Formats the passes of a candidate, followed by the passes that run once. On a CPU, bandwidths are left out.
fn passes(found: &Found, is_cpu: bool) -> String {
    let header = ["", "phase", "GPU ms", "spread", "MB", "GB/s", "of copy"];
    let line = |part: &Part| {
        let rate = number(part.gb_per_s.filter(|_| !is_cpu), 0);
        let share = part.of_copy.map_or("-".into(), |share| format!("{:.0} %", 100.0 * share));
        let phase = part.phase.clone().unwrap_or_default();
        let megabytes = format!("{:.2}", part.bytes as f64 * 1e-6);
        vec![part.name.clone(), phase, ms(part.gpu_ms), spread(part.gpu_ms), megabytes, rate, share]
    };
    let once = found.once.iter().map(|part| {
        let mut line = line(part);
        line[1] += " (once)";
        line[3] = "-".into();
        line
    });
    table(header, found.mean.passes.iter().map(line).chain(once))
}

/// Formats GPU times with a row per camera and a column per candidate, for one scene, number of splats and size.
fn cameras(rows: &[Row]) -> String {
    let header = iter::once("").chain(drawn(rows).map(|(row, _)| row.pipeline.as_str()));
    let names = drawn(rows).next().map_or(&[][..], |(_, found)| &found.views);
    let line = |(at, view): (usize, &super::measure::View)| {
        let of = |found: &Found| ms(found.views.get(at).and_then(|view| view.figures.gpu_ms));
        iter::once(view.camera.clone()).chain(drawn(rows).map(|(_, found)| of(found))).collect()
    };
    let mean = iter::once("mean".to_owned()).chain(drawn(rows).map(|(_, found)| ms(found.mean.gpu_ms)));
    table(header, names.iter().enumerate().map(line).chain([mean.collect()]))
}

type Line<'a> = (&'a str, Option<(u32, u32)>, &'a str);

fn line_of(row: &Row) -> Line<'_> {
    (&row.scene, row.size, &row.pipeline)
}

/// Formats GPU times with a row per scene, size and candidate, and a column per number of splats.
fn overview(report: &Report) -> String {
    let mut columns: Vec<u32> = report.rows.iter().map(|row| row.splats).collect();
    columns.sort_unstable();
    columns.dedup();
    let header = iter::once(String::new()).chain(columns.iter().map(|splats| grouped((*splats).into())));
    let mut lines = Vec::new();
    let mut done: Vec<Line> = Vec::new();
    for row in &report.rows {
        let key = line_of(row);
        if done.contains(&key) {
            continue;
        }
        done.push(key);
        let at = |splats: u32| {
            let same = |other: &&Row| line_of(other) == key && other.splats == splats;
            report.rows.iter().find(same).map_or(String::new(), |row| match &row.found {
                Ok(found) => ms(found.mean.gpu_ms),
                Err(_) => "not drawn".into(),
            })
        };
        let name = format!("{}, {}, {}", report.name_of(&row.scene), size_text(row.size), row.pipeline);
        lines.push(iter::once(name).chain(columns.iter().map(|splats| at(*splats))).collect());
    }
    table(header, lines)
}

#[cfg(test)]
mod tests {
    use super::super::measure::testing::found;
    use super::super::report::testing::report;
    use super::*;

    #[test]
    fn every_place_has_its_tables_and_the_last_one_compares_all() {
        let text = tables(&report(vec![
            ("splat", 1000, Ok(found(Some(2.0)))),
            ("nope", 1000, Err("error: there is none\n --> here".into())),
            ("splat", 2000, Ok(found(Some(3.5)))),
        ]));
        for line in [
            "copy limit: 2000 GB/s (1,000 bytes read and written in 0.500 ms)",
            "a, 1,000 splats, 64x48",
            "passes of splat",
            "draw draw 2.000 0.250 4.00 2 0 %",
            "GPU ms of each camera",
            "nope: not drawn: there is none",
            "a, 64x48, splat 2.000 3.500",
            "a, 64x48, nope not drawn",
        ] {
            let cells = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(text.lines().any(|found| cells(found) == line), "{line}:\n{text}");
        }
        assert!(!text.contains("no timestamps"), "{text}");
    }

    #[test]
    fn on_a_cpu_passes_have_no_rates_and_the_head_says_why() {
        let mut report = report(vec![("splat", 1000, Ok(found(Some(2.0))))]);
        report.origin.is_cpu = true;
        let text = tables(&report);
        assert!(text.contains("only the GPU ms of whole frames are reliable"), "{text}");
        let pass = text.lines().find(|line| line.starts_with("draw")).expect("a pass");
        let cells: Vec<&str> = pass.split_whitespace().collect();
        assert_eq!(cells[..6], ["draw", "draw", "2.000", "0.250", "4.00", "-"], "{text}");
    }

    #[test]
    fn a_device_without_timestamps_is_told_and_the_hosts_times_are_shown() {
        let text = tables(&report(vec![("splat", 1000, Ok(found(None)))]));
        assert!(text.contains("this device has no timestamps"), "{text}");
        let line = text.lines().find(|line| line.starts_with("splat")).expect("a line");
        assert_eq!(
            line.split_whitespace().collect::<Vec<_>>(),
            ["splat", "-", "-", "-", "-", "5.000", "1.000", "1.0"]
        );
    }
}
