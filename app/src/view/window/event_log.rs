//! Writes events as JSON lines, including changes of the window's size and of its controls' positions.

use crate::io::output::Log;
use crate::view::events::Event;
use crate::view::panels::Controls;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// A log entry that is not an [`Event`]: a frame, or a change of the window or its controls. Lengths are in pixels.
#[derive(Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Seen {
    /// The window's content has a new size or scale.
    Window { width: u32, height: u32, pixels_per_point: f32 },
    /// A control has a new position in the window.
    Control { name: String, left: f32, top: f32, right: f32, bottom: f32 },
    /// A control disappeared.
    ControlGone { name: String },
    /// The window shows a frame. `number` counts from 1. While a request is pending, such as a build, a load or a
    /// comparison, `busy` is true; the frame may then show the previous state.
    Frame { number: u64, busy: bool },
}

pub struct EventLog {
    out: Log,
    begun: Instant,
    window: Option<Seen>,
    controls: BTreeMap<String, [f32; 4]>,
}

#[derive(Serialize)]
struct Line<'a, E> {
    /// Seconds since the window was opened.
    time: f64,
    #[serde(flatten)]
    event: &'a E,
}

impl EventLog {
    pub fn new(out: Log) -> EventLog {
        EventLog { out, begun: Instant::now(), window: None, controls: BTreeMap::new() }
    }

    /// Writes the events of a frame, then the changes of the window and its controls, then `frame`.
    pub fn write(
        &mut self,
        events: &[Event],
        controls: &Controls,
        size: (u32, u32),
        pixels_per_point: f32,
        frame: Option<Seen>,
    ) {
        let changes = self.changes(controls, size, pixels_per_point);
        let time = self.begun.elapsed().as_secs_f64();
        // Serialising cannot fail: every event is a tree of named fields.
        let lines = events.iter().map(|event| serde_json::to_string(&Line { time, event }));
        let seen = changes.iter().chain(&frame).map(|event| serde_json::to_string(&Line { time, event }));
        lines.chain(seen).flatten().for_each(|line| self.out.line(&line));
        self.out.flush();
    }

    fn changes(
        &mut self,
        controls: &Controls,
        (width, height): (u32, u32),
        pixels_per_point: f32,
    ) -> Vec<Seen> {
        let mut all = Vec::new();
        let window = Seen::Window { width, height, pixels_per_point };
        if self.window.as_ref() != Some(&window) {
            self.window = Some(window.clone());
            all.push(window);
        }
        self.controls.retain(|name, _| {
            let there = controls.find(name).is_some();
            if !there {
                all.push(Seen::ControlGone { name: name.clone() });
            }
            there
        });
        for (name, rect) in controls.iter() {
            let place =
                [rect.min.x, rect.min.y, rect.max.x, rect.max.y].map(|v| (v * pixels_per_point).round());
            if self.controls.get(name) != Some(&place) {
                self.controls.insert(name.to_owned(), place);
                let [left, top, right, bottom] = place;
                all.push(Seen::Control { name: name.to_owned(), left, top, right, bottom });
            }
        }
        all
    }
}
