//! Formats a ledger as a table and as CSV.

use super::ledger::{Ledger, Line, Origin, phase_names};
use crate::draw::stats::BUSY;
use crate::io::report::text;
use crate::studies::measurement::noise::{MIN_SAVING, MIN_TURNS, Mark};
use crate::studies::measurement::settings::EXACT;
use crate::studies::measurement::view::of_last_frame;

/// Titles of the table's columns, each with its meaning.
pub(super) const COLUMNS: [(&str, &str); 13] = [
    (
        "setting",
        "`exact` has every parameter at its exact value; `NAME = VALUE` is one parameter away from it; `defaults` are the graph's. \
         `*` marks the Pareto front, the fastest setting of each accuracy: every more accurate one on the front takes 2 % longer or more, beyond the noise. \
         `?`: it may be on the front",
    ),
    (
        "GPU ms",
        "milliseconds of a frame on the GPU: `of exact` times the exact settings' time on a warm device",
    ),
    (
        "spread",
        "maximum minus minimum of the rounds, in milliseconds; the largest of the views; `-` with one round. It grows with the number of rounds",
    ),
    (
        "of exact",
        "share of the exact settings' time, frame by frame: median of the frames, mean of the views, ± the farther end of its range with \
         99 % confidence (ledger.csv has both ends). For `exact`, the distance from 100 % is the noise, which every other range contains",
    ),
    ("PSNR dB", "decibels of the mean squared error of all views, over all pixels; `inf` for equal pictures"),
    ("covered", "PSNR over the pixels that a splat covers"),
    ("SSIM", "structural similarity, the lowest of the views; 1 is equal"),
    ("FLIP", "NVIDIA's FLIP, mean; 0 is equal"),
    ("worst", "largest difference of a channel (range 0 to 1)"),
    ("off", "pixels that differ by more than 1/255"),
    (
        "inversions",
        "pairs of visible splats in the wrong order in the sorted list, from either end of which a graph can blend",
    ),
    ("MiB", "memory on the device"),
    (
        "note",
        "why a setting is not judged, or only likely; the settings with the same plan, which are not measured",
    ),
];

pub(super) fn cells(line: &Line) -> [String; COLUMNS.len()] {
    [
        line.setting.clone(),
        text::number(line.gpu_ms, 3),
        text::number(line.spread_ms, 3),
        line.share.map_or("-".into(), |share| share.to_string()),
        format!("{:.1}", line.psnr_db),
        format!("{:.1}", line.covered_psnr_db),
        text::number(line.ssim, 5),
        format!("{:.4}", line.flip),
        format!("{:.4}", line.worst),
        format!("{:.2} %", 100.0 * line.off),
        line.inversions.map_or("-".into(), |count| count.to_string()),
        format!("{:.1}", line.gpu_bytes as f64 / f64::from(1 << 20)),
        note(line),
    ]
}

fn note(line: &Line) -> String {
    let mark = match line.mark {
        Mark::Best | Mark::Beaten => None,
        Mark::Likely | Mark::Unlikely => Some("too noisy to tell".to_owned()),
        Mark::Hidden => Some("reads the previous frame".to_owned()),
    };
    let same = (!line.same_plan.is_empty()).then(|| format!("same plan: {}", line.same_plan.join(", ")));
    mark.into_iter().chain(same).collect::<Vec<_>>().join("; ")
}

/// Returns the symbol of a mark: `*` on the Pareto front, `?` possibly on it, otherwise a space.
pub(super) fn sign(mark: Mark) -> &'static str {
    match mark {
        Mark::Best => "*",
        Mark::Likely => "?",
        Mark::Unlikely | Mark::Beaten | Mark::Hidden => " ",
    }
}

/// Explains the marks of a table except for `*`, states the noise, and warns if the device was often idle.
pub fn notes(lines: &[Line]) -> Vec<String> {
    let names = |mark: Mark| -> Vec<&str> {
        lines.iter().filter(|line| line.mark == mark).map(|line| line.setting.as_str()).collect()
    };
    let mut notes = Vec::new();
    let (likely, unlikely) = (names(Mark::Likely), names(Mark::Unlikely));
    let exact = lines.iter().find(|line| line.setting == EXACT).and_then(|line| line.share);
    if !likely.is_empty() || !unlikely.is_empty() {
        let noise = match exact.and_then(|share| Some((share.median, share.range?))) {
            Some((median, (low, high))) => format!(
                "the exact settings took {:.1} % of their own time ({:.1} to {:.1} %)",
                100.0 * median,
                100.0 * low,
                100.0 * high
            ),
            None => format!("a range needs at least {MIN_TURNS} frames"),
        };
        let of = likely.len() + unlikely.len();
        notes.push(format!(
            "too noisy to tell whether {of} of {} settings save {:.0} % or more ({}): {noise}",
            lines.len(),
            100.0 * MIN_SAVING,
            match likely.len() {
                0 => "by their medians, none is on the front".to_owned(),
                1 => "by their medians, 1 is on the front, marked `?`".to_owned(),
                count => format!("by their medians, {count} are on the front, marked `?`"),
            }
        ));
    }
    if let Some(busy) = lines.iter().filter_map(|line| line.busy).reduce(f64::min)
        && busy < BUSY
    {
        notes.push(format!(
            "the device is idle for {:.0} % of the time when frames are drawn alone: its clock may be lower than under load, \
             and milliseconds higher; shares compare interleaved frames and are not affected",
            100.0 * (1.0 - busy)
        ));
    }
    let hidden = match names(Mark::Hidden)[..] {
        [] => None,
        [name] => Some(format!("`{name}` is not judged: it reads the previous frame")),
        ref all if all.len() == lines.len() => {
            Some("no setting is judged: all read the previous frame".into())
        }
        // A column marks them.
        ref several => {
            Some(format!("{} settings are not judged: they read the previous frame", several.len()))
        }
    };
    notes.extend(hidden.map(|hidden| format!("{hidden}. {}", of_last_frame())));
    notes
}

/// Formats lines as a table for a terminal; `*` marks the Pareto front, `?` lines that may be on it.
pub fn table(lines: &[Line]) -> String {
    let marked = |mark: &str, mut row: Vec<String>| {
        row[0].insert_str(0, mark);
        row
    };
    let header = marked("  ", COLUMNS.map(|(column, _)| column.to_owned()).to_vec());
    let row = |line: &Line| marked(&format!("{} ", sign(line.mark)), cells(line).to_vec());
    text::table(header, lines.iter().map(row))
}

/// Formats lines as CSV (RFC 4180), with all digits; missing values are empty, and an infinite PSNR is `inf`.
pub fn csv(ledger: &Ledger, lines: &[Line]) -> String {
    let mut header = String::from(
        "setting,gpu_ms,spread_ms,of_exact,of_exact_low,of_exact_high,psnr_db,covered_psnr_db,ssim,flip,worst,off,inversions,gpu_bytes,pareto,by_medians,same_plan",
    );
    let phases = phase_names(lines);
    phases.iter().for_each(|name| header += &format!(",{name}_ms,{name}_spread_ms"));
    let line = |line: &Line| {
        let range = line.share.and_then(|share| share.range);
        let mut cells = vec![
            text::quoted(&line.setting),
            text::optional(line.gpu_ms),
            text::optional(line.spread_ms),
            text::optional(line.share.map(|share| share.median)),
            text::optional(range.map(|(low, _)| low)),
            text::optional(range.map(|(_, high)| high)),
            line.psnr_db.to_string(),
            line.covered_psnr_db.to_string(),
            text::optional(line.ssim),
            line.flip.to_string(),
            line.worst.to_string(),
            line.off.to_string(),
            text::optional(line.inversions),
            line.gpu_bytes.to_string(),
            text::quoted(match line.mark {
                Mark::Best => "true",
                Mark::Beaten => "false",
                Mark::Likely | Mark::Unlikely => "too noisy to tell",
                Mark::Hidden => "not judged",
            }),
            text::optional(match line.mark {
                Mark::Best | Mark::Likely => Some(true),
                Mark::Beaten | Mark::Unlikely => Some(false),
                Mark::Hidden => None,
            }),
            text::quoted(&line.same_plan.join(", ")),
        ];
        for name in &phases {
            let phase = line.phases.iter().find(|(own, ..)| own == name);
            cells.push(text::optional(phase.map(|(_, ms, _)| *ms)));
            cells.push(text::optional(phase.and_then(|(.., spread)| *spread)));
        }
        cells.join(",")
    };
    let Origin { provenance, pipeline, set, .. } = &ledger.origin;
    let views = provenance.cameras.len() - ledger.missing().len();
    let more = [
        ("pipeline", text::quoted(pipeline)),
        ("set", text::quoted(&text::parameters(set))),
        ("views", views.to_string()),
    ];
    provenance.csv(&header, lines.iter().map(line), &more)
}

#[cfg(test)]
mod tests {
    use super::super::ledger::testing::{self, ledger, line};
    use super::*;
    use crate::studies::measurement::noise::Share;

    #[test]
    fn a_table_marks_the_front_and_says_in_the_row_why_others_are_not_judged() {
        let lines = [
            line("exact", 4.0, f64::INFINITY, Mark::Best),
            line("fast", 1.0, 40.0, Mark::Likely),
            line("bad", 3.0, 30.0, Mark::Beaten),
            Line { same_plan: vec!["other".into()], ..line("stale", 2.0, 50.0, Mark::Hidden) },
        ];
        let text = table(&lines);
        let row = |name: &str| text.lines().find(|line| line[2..].starts_with(name)).expect("a row");
        assert!(row("exact").starts_with('*') && row("exact").contains(" inf "), "{text}");
        assert!(row("exact").contains("100.0 ± 1.0 %"), "{text}");
        assert!(row("fast").starts_with('?') && row("fast").ends_with("too noisy to tell"), "{text}");
        assert!(row("bad").starts_with(' ') && row("bad").ends_with("1.0"), "{text}");
        assert!(
            row("stale").starts_with(' ')
                && row("stale").ends_with("reads the previous frame; same plan: other"),
            "{text}"
        );
        let notes = notes(&lines).join("\n");
        assert!(
            notes.contains("whether 1 of 4 settings")
                && notes.contains("took 100.0 % of their own time (99.0 to 101.0 %)"),
            "{notes}"
        );
        assert!(
            notes.contains("`stale` is not judged") && notes.contains("frame 2 of a still view"),
            "{notes}"
        );
        let hidden = [&lines[..], &lines[3..]].concat();
        let said = |lines: &[Line]| super::notes(lines).pop().unwrap_or_default();
        assert!(said(&hidden).starts_with("2 settings are not judged: they read the previous frame. Its "));
        assert!(said(&hidden[3..]).starts_with("no setting is judged: all read the previous frame. Its "));
        assert_eq!(super::notes(&lines[..1]), [""; 0]);
        let rests = [Line { busy: Some(0.25), ..lines[0].clone() }];
        assert!(super::notes(&rests)[0].starts_with("the device is idle for 75 % of the time"));
        let mut ledger = ledger(vec![testing::row("exact", "", Err("no".into()))]);
        ledger.origin.set = vec![("k".into(), "8".into())];
        let csv = csv(&ledger, &lines);
        assert_eq!(csv.lines().count(), 5);
        assert!(
            csv.starts_with("setting,gpu_ms")
                && csv.contains(
                    ",draw_ms,draw_spread_ms,scene,width,height,pipeline,set,views,device,program\n"
                ),
            "{csv}"
        );
        assert!(
            csv.contains(",\"not judged\",,\"other\",")
                && csv.contains(",\"too noisy to tell\",true,")
                && csv.contains(",0.25,0.24,0.26,40,"),
            "{csv}"
        );
        assert!(csv.contains(",\"a.ply\",32,24,\"splat\",\"k=8\",1,\"none\",\"1\"\n"), "{csv}");
        assert_eq!(ledger.title(), "a, splat, k=8");
    }

    #[test]
    fn without_enough_rounds_nothing_is_told_of_time() {
        let unknown = Share { median: 0.5, range: None };
        let exact = Line { share: Some(unknown), ..line("exact", 4.0, 90.0, Mark::Best) };
        let lines = [exact, Line { share: Some(unknown), ..line("fast", 2.0, 80.0, Mark::Unlikely) }];
        assert!(table(&lines).contains("50.0 ± ? %"), "{}", table(&lines));
        assert!(notes(&lines)[0].ends_with("a range needs at least 8 frames"), "{:?}", notes(&lines));
    }
}
