//! `render --timeline`: the spans of the trace nest, and they cover nearly all of the main thread's time.

use crate::common;
use crate::place::Place;
use serde_json::Value;
use std::collections::BTreeMap;

/// A complete event of a trace, in microseconds.
struct Span {
    name: String,
    begin: f64,
    end: f64,
}

/// Largest rounding error of a time in a trace, in microseconds.
const ROUNDING: f64 = 0.01;

/// Returns each track's spans by the track's name, ordered by start. Of equal starts, the longer span is first. Fails
/// if a span is on no named track.
fn tracks(trace: &Value) -> BTreeMap<String, Vec<Span>> {
    let events = trace["traceEvents"].as_array().expect("events");
    let of_kind = |kind: &'static str| events.iter().filter(move |event| event["ph"] == kind);
    let mut tracks = BTreeMap::new();
    for track in of_kind("M").filter(|event| event["name"] == "thread_name") {
        let on = of_kind("X").filter(|event| event["tid"] == track["tid"] && event["pid"] == track["pid"]);
        let mut spans: Vec<Span> = on
            .map(|event| {
                let [begin, length] = ["ts", "dur"].map(|key| event[key].as_f64().expect("a time"));
                assert!(begin >= 0.0 && length >= 0.0, "{event}");
                let name = event["name"].as_str().expect("a name").to_owned();
                Span { name, begin, end: begin + length }
            })
            .collect();
        spans.sort_by(|a, b| a.begin.total_cmp(&b.begin).then(b.end.total_cmp(&a.end)));
        let name = track["args"]["name"].as_str().expect("a name");
        tracks.entry(name.to_owned()).or_insert_with(Vec::new).extend(spans);
    }
    let on_tracks: usize = tracks.values().map(Vec::len).sum();
    assert_eq!(on_tracks, of_kind("X").count(), "every span is on a track with a name of its own");
    tracks
}

/// Fails if spans of a track, sorted by their beginnings, overlap without nesting. Returns the total time of the
/// outermost spans.
fn nested_time(track: &str, spans: &[Span]) -> f64 {
    let mut around: Vec<&Span> = Vec::new();
    let mut time = 0.0;
    for span in spans {
        while around.last().is_some_and(|outer| outer.end <= span.begin + ROUNDING) {
            around.pop();
        }
        match around.last() {
            Some(outer) => assert!(
                span.end <= outer.end + ROUNDING,
                "{track}: `{}` begins within `{}` and ends after it",
                span.name,
                outer.name
            ),
            None => time += span.end - span.begin,
        }
        around.push(span);
    }
    time
}

#[test]
fn spans_nest_on_each_track_and_name_nine_tenths_of_the_main_threads_time() {
    let place = Place::empty();
    place.done("synth demo --count 4000 -o scene.ply --cameras four.json");
    let said = place.said("render scene.ply -c four.json --size 160x90 -o out --timeline trace.json").1;
    let trace = place.json("trace.json");
    let tracks = tracks(&trace);
    let times: BTreeMap<&str, f64> =
        tracks.iter().map(|(name, spans)| (name.as_str(), nested_time(name, spans))).collect();
    let total = 1e3 * trace["otherData"]["total_ms"].as_f64().expect("a time");
    assert!(times["main"] <= total && times["main"] >= 0.9 * total, "{} of {total} us", times["main"]);

    let count = |track: &str, name: &str| tracks[track].iter().filter(|span| span.name == name).count();
    assert_eq!(count("scene", "load the scene"), 1, "while the device opens");
    assert_eq!(count("scene", "build the plan"), 1, "while the device is created");
    for step in ["open the device", "load the plan", "close the device"] {
        assert_eq!(count("main", step), 1, "{step}");
    }
    assert!(said.contains("timeline: ") && said.contains("main thread"), "{said}");
    assert!(count("pipelines", "make a pipeline") > 5);
    let written = |track: &&String| track.starts_with("worker ");
    let written: usize = tracks.keys().filter(written).map(|track| count(track, "encode and write")).sum();
    assert_eq!(written, 4, "on the pool's threads");

    // Each of the four pictures is one frame in flight, with its passes on the GPU's track.
    let flown: usize =
        tracks.iter().filter(|(name, _)| name.starts_with("in flight")).map(|(_, s)| s.len()).sum();
    assert_eq!(flown, 4);
    assert!(tracks.contains_key("in flight 2") && !tracks.contains_key("in flight 3"));
    match tracks.get("GPU") {
        Some(gpu) => {
            let frames = gpu.iter().filter(|span| span.name.starts_with("frame ")).count();
            assert!(frames == 4 && gpu.len() > 8 * frames, "{frames} frames of {} spans", gpu.len());
        }
        None => common::not_run("the GPU's track of a timeline", "a device with timestamps"),
    }
}

#[test]
fn a_timeline_that_cannot_be_written_is_an_error_before_anything_is_drawn() {
    let place = Place::empty();
    place.done("synth demo --count 500 -o scene.ply");
    place.write("file", "text");
    for path in ["file/trace.json", "/proc/trace.json"] {
        let errors = place.fails(&format!("render scene.ply --size 32x32 -o out.png --timeline {path}"), 2);
        assert!(errors.contains(&format!("--timeline names {path}, which cannot be written")), "{errors}");
        assert!(!place.at("out.png").exists());
    }
    // A timeline that would overwrite an input is an invalid command line.
    let before = place.bytes("scene.ply");
    place.fails("render scene.ply --size 32x32 -o out.png --timeline scene.ply", 2);
    assert!(before == place.bytes("scene.ply") && !place.at("out.png").exists());
    // All shards would write the same timeline.
    let errors = place.fails("render scene.ply --shard 0/2 -o shared --timeline trace.json", 2);
    assert!(errors.contains("--timeline"), "{errors}");
}
