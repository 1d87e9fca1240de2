//! Writes events as JSON lines, including changes of the window's size and of its controls' positions.

use crate::io::output::Log;
use crate::view::events::Event;
use crate::view::panels::Controls;
use crate::view::shell::FrameRequest;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

pub struct EventLog {
    out: Log,
    begun: Instant,
    window: Option<Event>,
    controls: BTreeMap<String, [f32; 4]>,
}

#[derive(Serialize)]
struct Line<'a> {
    /// Seconds since the window was opened.
    time: f64,
    #[serde(flatten)]
    event: &'a Event,
}

impl EventLog {
    pub fn new(out: Log) -> EventLog {
        EventLog { out, begun: Instant::now(), window: None, controls: BTreeMap::new() }
    }

    /// Writes the events of a frame, followed by `frame`.
    pub fn write(
        &mut self,
        mut events: Vec<Event>,
        controls: &Controls,
        request: &FrameRequest,
        frame: Option<Event>,
    ) {
        self.add_changes(&mut events, controls, request);
        events.extend(frame);
        let time = self.begun.elapsed().as_secs_f64();
        for event in &events {
            // Serialising cannot fail: every event is a tree of named fields.
            if let Ok(line) = serde_json::to_string(&Line { time, event }) {
                self.out.line(&line);
            }
        }
        self.out.flush();
    }

    fn add_changes(&mut self, all: &mut Vec<Event>, controls: &Controls, request: &FrameRequest) {
        let FrameRequest { size: (width, height), pixels_per_point, .. } = *request;
        let window = Event::Window { width, height, pixels_per_point };
        if self.window.as_ref() != Some(&window) {
            self.window = Some(window.clone());
            all.push(window);
        }
        self.controls.retain(|name, _| {
            let there = controls.find(name).is_some();
            if !there {
                all.push(Event::ControlGone { name: name.clone() });
            }
            there
        });
        for (name, rect) in controls.iter() {
            let place =
                [rect.min.x, rect.min.y, rect.max.x, rect.max.y].map(|v| (v * pixels_per_point).round());
            if self.controls.get(name) != Some(&place) {
                self.controls.insert(name.to_owned(), place);
                let [left, top, right, bottom] = place;
                all.push(Event::Control { name: name.to_owned(), left, top, right, bottom });
            }
        }
    }
}
