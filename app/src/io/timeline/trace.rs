//! Converts a recording to a trace in Chrome's JSON format, which Perfetto opens.
//!
//! The events are those of the Trace Event Format: complete events (`ph: "X"`) with times in microseconds, and the
//! names of threads as metadata (`ph: "M"`). Frames have tracks after those of the threads: one for the passes on the
//! device, and the others for frames in flight.

use super::record::{Frame, Recording};
use serde_json::{Value as Json, json};
use std::time::Duration;

const PROCESS: u32 = 1;
/// Number of the first track that is not a thread's.
const FIRST_TRACK: usize = 1000;

/// Makes the trace of a recording. `command` is the command line, which names the process.
pub fn json(recording: &Recording, command: &str) -> Json {
    let mut events = vec![name("process_name", 0, command)];
    for (thread, text) in recording.threads.iter().enumerate() {
        events.push(name("thread_name", thread, text));
        events.push(sorted(thread));
    }
    let mut spans: Vec<_> = recording.spans.iter().collect();
    // Puts each span before the spans inside it.
    spans.sort_by(|a, b| a.begin.cmp(&b.begin).then(b.end.cmp(&a.end)));
    for span in spans {
        let details = span.details.iter().map(|(name, value)| ((*name).to_owned(), json!(value)));
        let times = (ms(span.begin), ms(span.end));
        events.push(complete(span.thread, span.name, "host", times, details.collect()));
    }
    events.extend(frames(&recording.frames));
    json!({
        "displayTimeUnit": "ms",
        "otherData": { "command": command, "total_ms": ms(recording.end) },
        "traceEvents": events,
    })
}

fn frames(frames: &[Frame]) -> Vec<Json> {
    let mut events = Vec::new();
    let track = |events: &mut Vec<Json>, index: usize, text: &str| {
        events.push(name("thread_name", FIRST_TRACK + index, text));
        events.push(sorted(FIRST_TRACK + index));
    };
    if frames.is_empty() {
        return events;
    }
    track(&mut events, 0, "GPU");
    // For each track of frames in flight, the end of its last frame.
    let mut ends: Vec<Duration> = Vec::new();
    for (frame, start) in frames.iter().zip(starts(frames)) {
        let number = format!("frame {}", frame.number);
        let details = json!({ "camera": frame.submission.camera, "warm_up": frame.submission.warm_up });
        if let (Some(start), Some(total)) = (start, frame.total_ms) {
            let passes = frame.passes.iter();
            // Passes may overlap on the device, but events of a track must nest: each is cut at the start of the next.
            let next = passes.clone().skip(1).map(|pass| pass.start_ms).chain([total]);
            events.push(complete(FIRST_TRACK, &number, "device", (start, start + total), details.clone()));
            for (pass, next) in passes.zip(next) {
                let end = (pass.start_ms + pass.ms).min(next.max(pass.start_ms)).min(total);
                let times = (start + pass.start_ms.min(total), start + end);
                events.push(complete(FIRST_TRACK, &pass.name, "device", times, json!({ "ms": pass.ms })));
            }
        }
        let free = ends.iter().position(|end| *end <= frame.submission.begun).unwrap_or(ends.len());
        if free == ends.len() {
            ends.push(Duration::ZERO);
            track(&mut events, 1 + free, &format!("in flight {}", 1 + free));
        }
        ends[free] = frame.seen;
        let times = (ms(frame.submission.begun), ms(frame.seen));
        events.push(complete(FIRST_TRACK + 1 + free, &number, "device", times, details));
    }
    events
}

/// Converts the starts of frames from the device's clock to the recording's, in ms. `None` without timestamps.
///
/// The clocks differ by an unknown offset. A frame ends before the host sees that it is complete, so each frame bounds
/// the offset from above, and the smallest bound is used. The results are late by the shortest time that the host took
/// to notice the end of a frame. If the device's clock wrapped, each frame is taken to end when the host saw it.
pub fn starts(frames: &[Frame]) -> Vec<Option<f64>> {
    let bound = |frame: &Frame| Some(ms(frame.seen) - frame.start_ms? - frame.total_ms?);
    let wrapped = frames.windows(2).any(|pair| pair[1].start_ms < pair[0].start_ms);
    let least = frames.iter().filter_map(bound).fold(f64::INFINITY, f64::min);
    let offset = |frame: &Frame| if wrapped { bound(frame) } else { Some(least) };
    frames.iter().map(|frame| Some(frame.start_ms? + offset(frame)?)).collect()
}

pub fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

fn complete(track: usize, name: &str, category: &str, (begin, end): (f64, f64), details: Json) -> Json {
    let (begin, duration) = (1e3 * begin, 1e3 * (end - begin).max(0.0));
    let mut event = json!({
        "ph": "X", "pid": PROCESS, "tid": track, "cat": category, "name": name, "ts": begin, "dur": duration,
    });
    if details.as_object().is_some_and(|details| !details.is_empty()) {
        event["args"] = details;
    }
    event
}

fn name(what: &str, track: usize, text: &str) -> Json {
    json!({ "ph": "M", "pid": PROCESS, "tid": track, "name": what, "args": { "name": text } })
}

/// Places a track in the order of the tracks' numbers.
fn sorted(track: usize) -> Json {
    json!({ "ph": "M", "pid": PROCESS, "tid": track, "name": "thread_sort_index", "args": { "sort_index": track } })
}
