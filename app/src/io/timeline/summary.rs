//! Summarises a recording as text: the main thread's time, the work of other threads, and the device's passes.
//!
//! A span's own time excludes the spans within it, so the main thread's lines add up to the whole.

use super::record::{Recording, Span};
use super::trace::ms;
use std::fmt::Write;

/// Share of the whole time below which rows are combined into one line.
const MIN_SHARE: f64 = 0.005;

struct Row {
    name: String,
    ms: f64,
    times: usize,
}

/// Formats the summary, without a line break at the end.
pub fn text(recording: &Recording) -> String {
    let all = ms(recording.end);
    let (main, others): (Vec<_>, Vec<_>) = recording.spans.iter().partition(|span| span.thread == 0);
    let mut rows = own_times(main);
    let outside = all - rows.iter().map(|row| row.ms).sum::<f64>();
    rows.push(Row { name: "outside of spans".to_owned(), ms: outside, times: 1 });
    let mut out = format!("timeline: {} from the command to the end", seconds(all));
    let _ = write!(out, "\n  main thread{}", lines(rows, all));
    if !others.is_empty() {
        let _ = write!(out, "\n  other threads, meanwhile{}", lines(own_times(others), all));
    }
    let measured = recording.frames.iter().filter(|frame| !frame.submission.warm_up);
    let count = measured.clone().count();
    let passes = measured.flat_map(|frame| &frame.passes);
    let passes = sums(passes.map(|pass| (pass.name.clone(), pass.ms)));
    if !passes.is_empty() {
        let frames = if count == 1 { "1 frame".to_owned() } else { format!("{count} frames") };
        let warm_up = match recording.frames.len() - count {
            0 => String::new(),
            others => format!(" (without {others} of the warm-up)"),
        };
        let _ = write!(out, "\n  GPU, {frames}{warm_up}{}", lines(passes, all));
    }
    out
}

fn seconds(ms: f64) -> String {
    format!("{:.3} s", ms / 1e3)
}

/// Formats rows in descending order of time. Rows below [`MIN_SHARE`] of `all` milliseconds are combined.
fn lines(mut rows: Vec<Row>, all: f64) -> String {
    rows.sort_by(|a, b| b.ms.total_cmp(&a.ms));
    let shown = rows.iter().take_while(|row| row.ms >= MIN_SHARE * all).count();
    let rest: f64 = rows[shown..].iter().map(|row| row.ms).sum();
    let mut out = String::new();
    for Row { name, ms, times } in &rows[..shown] {
        let times = if *times > 1 { format!(" ({times} times)") } else { String::new() };
        let _ = write!(out, "\n    {:>9}  {:>4.1} %  {name}{times}", seconds(*ms), 100.0 * ms / all);
    }
    if shown < rows.len() {
        let count = rows.len() - shown;
        let name = if count == 1 { "1 other" } else { "others" };
        let count = if count == 1 { String::new() } else { format!("{count} ") };
        let _ = write!(out, "\n    {:>9}  {:>4.1} %  {count}{name}", seconds(rest), 100.0 * rest / all);
    }
    out
}

fn own_times(mut spans: Vec<&Span>) -> Vec<Row> {
    spans.sort_by(|a, b| (a.thread, a.begin).cmp(&(b.thread, b.begin)).then(b.end.cmp(&a.end)));
    let mut own: Vec<f64> = spans.iter().map(|span| ms(span.end - span.begin)).collect();
    // The open spans around the current one.
    let mut around: Vec<usize> = Vec::new();
    for (index, span) in spans.iter().enumerate() {
        while around.last().is_some_and(|&at| spans[at].thread != span.thread || spans[at].end <= span.begin)
        {
            around.pop();
        }
        if let Some(&outer) = around.last() {
            own[outer] -= ms(span.end - span.begin);
        }
        around.push(index);
    }
    sums(spans.iter().zip(own).map(|(span, own)| (span.name.to_owned(), own)))
}

fn sums(times: impl Iterator<Item = (String, f64)>) -> Vec<Row> {
    let mut rows: indexmap::IndexMap<String, (f64, usize)> = indexmap::IndexMap::new();
    for (name, ms) in times {
        let row = rows.entry(name).or_default();
        *row = (row.0 + ms, row.1 + 1);
    }
    rows.into_iter().map(|(name, (ms, times))| Row { name, ms, times }).collect()
}

#[cfg(test)]
mod tests {
    use super::super::record::{Frame, Pass, Submission};
    use super::super::trace;
    use super::*;
    use std::time::Duration;

    fn span(thread: usize, name: &'static str, begin: u64, end: u64) -> Span {
        let [begin, end] = [begin, end].map(Duration::from_millis);
        Span { thread, name, details: Vec::new(), begin, end }
    }

    fn frame(number: u64, (submitted, seen): (u64, u64), start_ms: f64) -> Frame {
        let [begun, seen] = [submitted, seen].map(Duration::from_millis);
        let submission = Submission { begun, camera: "front".to_owned(), warm_up: false };
        let pass = |name: &str, start_ms, ms| Pass { name: name.to_owned(), start_ms, ms };
        let passes = vec![pass("sort", 0.0, 4.0), pass("draw", 3.0, 7.0)];
        Frame { number, submission, seen, start_ms: Some(start_ms), total_ms: Some(10.0), passes }
    }

    fn recording() -> Recording {
        Recording {
            threads: vec!["main".into(), "pipelines".into()],
            spans: vec![
                span(0, "solve", 20, 50),
                span(0, "build the plan", 10, 60),
                span(1, "make a pipeline", 60, 90),
                span(1, "make a pipeline", 90, 95),
                span(0, "draw", 60, 98),
            ],
            frames: vec![frame(0, (60, 80), 500.0), frame(1, (62, 92), 512.0)],
            end: Duration::from_millis(100),
        }
    }

    #[test]
    fn the_lines_of_the_main_thread_sum_to_the_whole_and_a_spans_own_time_is_without_those_in_it() {
        assert_eq!(
            text(&recording()),
            "timeline: 0.100 s from the command to the end
  main thread
      0.038 s  38.0 %  draw
      0.030 s  30.0 %  solve
      0.020 s  20.0 %  build the plan
      0.012 s  12.0 %  outside of spans
  other threads, meanwhile
      0.035 s  35.0 %  make a pipeline (2 times)
  GPU, 2 frames
      0.014 s  14.0 %  draw (2 times)
      0.008 s   8.0 %  sort (2 times)"
        );
        let mut warm = recording();
        warm.frames[0].submission.warm_up = true;
        assert!(
            text(&warm).contains("  GPU, 1 frame (without 1 of the warm-up)\n      0.007 s   7.0 %  draw\n")
        );
    }

    #[test]
    fn frames_start_as_late_as_the_frame_that_was_noticed_soonest_allows() {
        // The first two frames bound the offset by 80 - 510 and by 92 - 522, which are equal. The third is noticed
        // late.
        let mut frames = recording().frames;
        assert_eq!(trace::starts(&frames), [Some(70.0), Some(82.0)]);
        frames.push(frame(2, (90, 200), 530.0));
        assert_eq!(trace::starts(&frames), [Some(70.0), Some(82.0), Some(100.0)]);
        // The device's clock wrapped.
        frames.push(frame(3, (200, 230), 1.0));
        assert_eq!(trace::starts(&frames)[3], Some(220.0));
        assert_eq!(trace::starts(&[Frame { start_ms: None, ..frame(0, (1, 2), 0.0) }]), [None]);
    }

    #[test]
    fn the_trace_has_a_track_for_each_thread_the_gpu_and_each_frame_in_flight() {
        let trace = trace::json(&recording(), "splatgraph render");
        let events = trace["traceEvents"].as_array().unwrap();
        let names = |track: &str| -> Vec<&str> {
            let is_track = |e: &&serde_json::Value| e["name"] == "thread_name" && e["args"]["name"] == track;
            let id = &events.iter().find(is_track).expect("the track")["tid"];
            let on = events.iter().filter(|e| e["ph"] == "X" && e["tid"] == *id);
            on.filter_map(|e| e["name"].as_str()).collect()
        };
        assert_eq!(names("main"), ["build the plan", "solve", "draw"]);
        assert_eq!(names("pipelines"), ["make a pipeline"; 2]);
        assert_eq!(names("GPU"), ["frame 0", "sort", "draw", "frame 1", "sort", "draw"]);
        assert_eq!((names("in flight 1"), names("in flight 2")), (vec!["frame 0"], vec!["frame 1"]));
        let sort = events.iter().find(|e| e["name"] == "sort").unwrap();
        // The pass overlaps the next one by 1 ms, so its event is cut.
        assert_eq!(
            (&sort["ts"], &sort["dur"], &sort["args"]["ms"]),
            (&70_000.0.into(), &3_000.0.into(), &4.0.into())
        );
    }
}
