//! Presents a ledger as a plot of time against error, and as a page.

use super::ledger::{Ledger, Line, phase_names};
use super::pictures::Album;
use super::table::{COLUMNS, cells, notes, sign};
use crate::io::report::page::{Page, Row};
use crate::io::report::plot::{Axis, Bar, Form, Plot, PlotError, Point, Series};
use crate::studies::measurement::noise::Mark;

/// Settings that equal the truth are plotted this many decibels above the highest finite PSNR.
const ABOVE: f64 = 6.0;

/// Plots time against PSNR, with the Pareto front joined and dominated settings in grey; `None` without times.
///
/// Time is the share of the exact settings' time, frame by frame, from which the front is computed.
pub fn plot(ledger: &Ledger, lines: &[Line]) -> Option<Plot> {
    let finite = lines.iter().map(|line| line.psnr_db).filter(|db| db.is_finite());
    let top = finite.fold(0.0, f64::max) + ABOVE;
    let point = |line: &Line| {
        let equal = line.psnr_db.is_infinite();
        let name = if equal { format!("{} (inf)", line.setting) } else { line.setting.clone() };
        Some(Point { x: 100.0 * line.share?.median, y: line.psnr_db.min(top), name })
    };
    let points =
        |marks: &[Mark]| lines.iter().filter(|line| marks.contains(&line.mark)).filter_map(point).collect();
    let mut front: Vec<Point> = points(&[Mark::Best]);
    front.sort_by(|a, b| a.x.total_cmp(&b.x));
    let muted: Vec<Point> = points(&[Mark::Beaten, Mark::Unlikely, Mark::Hidden]);
    let likely: Vec<Point> = points(&[Mark::Likely]);
    let named =
        |name: &str, points: &[Point]| if points.is_empty() { String::new() } else { name.to_owned() };
    if [&front, &muted, &likely].iter().all(|points| points.is_empty()) {
        return None;
    }
    let bar = |line: &Line| {
        let (low, high) = line.share?.range?;
        Some(Bar { x: (100.0 * low, 100.0 * high), y: line.psnr_db.min(top) })
    };
    Some(Plot {
        bars: lines.iter().filter_map(bar).collect(),
        title: format!("{}: time and error of each setting", ledger.title()),
        x: Axis {
            label: "GPU time of a frame, % of the exact settings', frame by frame (bars: 99 % intervals)"
                .into(),
            logarithmic: true,
        },
        y: Axis { label: "PSNR against the truth, dB".into(), logarithmic: false },
        series: vec![
            Series {
                name: named("dominated, probably dominated, or not judged", &muted),
                form: Form::Muted,
                points: muted,
            },
            Series { name: named("Pareto front", &front), form: Form::Line, points: front },
            Series { name: named("too noisy to tell", &likely), form: Form::Points, points: likely },
        ],
    })
}

/// Makes the page of a ledger as HTML. `failed` lists the settings without a line, with the reasons.
///
/// # Errors
/// The plot cannot be drawn.
pub fn page(
    ledger: &Ledger,
    lines: &[Line],
    failed: &[(String, String)],
    album: &Album,
) -> Result<String, PlotError> {
    let origin = &ledger.origin;
    let mut page = Page::new(&format!("{}: what each setting saves and costs", ledger.title()));
    page.text(&format!(
        "{} The truth is {}.",
        origin.provenance.text(&ledger.missing()),
        if origin.truth == "reference" { "the exact renderer's" } else { origin.truth.as_str() },
    ));
    if !ledger.commands.is_empty() {
        page.text(match ledger.commands.len() {
            1 => "This command made the page:",
            _ => "These commands made the page, in this order:",
        });
        page.block(&ledger.commands.join("\n"));
    }
    if let Some(plot) = plot(ledger, lines) {
        page.plot(&plot, "Left is faster, up is closer to the truth. Bars are 99 % confidence intervals. For a dominated setting, another is at least as fast and as accurate.")?;
    }
    let row = |line: &Line| {
        let mut cells = cells(line).to_vec();
        cells[0] = format!("{} {}", cells[0], sign(line.mark)).trim_end().to_owned();
        Row { cells, pictures: album.of(ledger, &line.setting) }
    };
    page.sortable(&COLUMNS, &lines.iter().map(row).collect::<Vec<_>>());
    page.text(
        "Click a setting to see its picture in the view farthest from the truth, and a column to sort by it. Frames of a setting are drawn \
         interleaved with frames of `exact`, so that a change of the device's clock affects both. Settings whose plans are equal are measured once.",
    );
    notes(lines).iter().for_each(|note| page.text(note));
    let phases = phase_names(lines);
    if !phases.is_empty() {
        page.heading("Milliseconds of each phase");
        let header: Vec<&str> = std::iter::once("setting").chain(phases.iter().map(String::as_str)).collect();
        let row = |line: &Line| {
            let cell = |name: &String| {
                let phase = line.phases.iter().find(|(own, ..)| own == name);
                phase.map_or("-".into(), |(_, ms, spread)| match spread {
                    Some(spread) => format!("{ms:.3} ± {:.3}", 0.5 * spread),
                    None => format!("{ms:.3}"),
                })
            };
            std::iter::once(line.setting.clone()).chain(phases.iter().map(cell)).collect()
        };
        page.table(&header, &lines.iter().map(row).collect::<Vec<Vec<String>>>());
        page.text("The median of a few frames with timestamps at passes, mean of the views, ± half of the largest spread of a view. These timestamps take time.");
        if let Some(note) = origin.provenance.note() {
            page.text(note);
        }
    }
    for (setting, why) in failed {
        page.text(&format!("`{setting}` was not measured:"));
        page.block(why);
    }
    page.heading("The columns");
    COLUMNS.iter().for_each(|(column, about)| page.text(&format!("`{column}`: {about}.")));
    Ok(page.html())
}

#[cfg(test)]
mod tests {
    use super::super::ledger::testing::{ledger, line, row};
    use super::*;
    use std::path::Path;

    fn no_pictures() -> Album {
        Album::beside(Path::new("no/ledger.json"))
    }

    #[test]
    fn the_front_is_joined_from_fast_to_slow_and_the_dominated_are_grey() {
        let lines = [
            line("exact", 4.0, f64::INFINITY, Mark::Best),
            line("fast", 1.0, 40.0, Mark::Best),
            line("bad", 3.0, 30.0, Mark::Beaten),
        ];
        let ledger = ledger(vec![row("exact", "", Err("no".into()))]);
        let plot = plot(&ledger, &lines).unwrap();
        let names = |at: usize| plot.series[at].points.iter().map(|p| p.name.as_str()).collect::<Vec<_>>();
        assert_eq!((names(0), names(1)), (vec!["bad"], vec!["fast", "exact (inf)"]));
        assert_eq!((plot.series[0].form, plot.series[1].points[1].y), (Form::Muted, 46.0));
        assert_eq!(plot.bars[1], Bar { x: (24.0, 26.0), y: 40.0 });
        let hidden = super::plot(&ledger, &[line("exact", 4.0, 50.0, Mark::Hidden)]).unwrap();
        let unnamed: Vec<bool> = hidden.series.iter().map(|series| series.name.is_empty()).collect();
        assert_eq!(unnamed, [false, true, true], "there is a plot, with a legend of what it has");
        let ledger = Ledger { commands: vec!["splatgraph trade scene.ply".into()], ..ledger };
        let html = page(&ledger, &lines, &[("broken".into(), "error: no".into())], &no_pictures()).unwrap();
        let on_cpu = |is_cpu: bool| {
            let mut ledger = ledger.clone();
            ledger.origin.provenance.is_cpu = is_cpu;
            let html = page(&ledger, &lines, &[], &no_pictures()).unwrap();
            html.contains("only the GPU ms of whole frames are reliable")
        };
        assert!(on_cpu(true) && !on_cpu(false));
        for text in [
            "fast *",
            "<td>bad</td>",
            "This command made the page:",
            "splatgraph trade scene.ply",
            "<th title=\"memory on the device\"><button>MiB</button></th>",
            "<svg",
            "<code>broken</code>",
            "error: no",
            "one view",
            "4.000 ± 0.050",
        ] {
            assert!(html.contains(text), "{text}: {html}");
        }
    }

    #[test]
    fn without_times_there_is_a_table_and_no_plot() {
        let lines = [Line { gpu_ms: None, share: None, ..line("exact", 4.0, 50.0, Mark::Best) }];
        let ledger = ledger(Vec::new());
        assert_eq!(plot(&ledger, &lines), None);
        assert!(!page(&ledger, &lines, &[], &no_pictures()).unwrap().contains("<svg"));
    }
}
