//! The viewer without its window, driven by a script: files are edited, parameters changed, and pictures read back.

use crate::common::{self, settings};
use crate::place::Place;
use splatgraph::draw::backend::Backend;
use splatgraph::draw::session::image_of;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::viewer::Viewer;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time limit of every wait, generous for slow machines.
const PATIENCE: Duration = Duration::from_secs(60);

/// Size of the pictures, in pixels.
pub const SIZE: (u32, u32) = (96, 54);

/// A viewer over its own copy of graphs and shaders, which can be edited.
pub struct Twin {
    pub viewer: Viewer,
    /// Events so far.
    pub events: Vec<Event>,
    /// Size of the view, in pixels.
    pub size: (u32, u32),
    /// Folder with the scene, the graphs and the shaders.
    pub place: Place,
}

impl Twin {
    /// Opens a viewer of a generated scene of `splats` splats, drawn with `graph` of a copy of all shipped files.
    pub fn new(graph: &str, splats: u32, set: &[(&str, &str)]) -> Twin {
        let place = Place::shipped();
        let scene = (place.scene("scene.ply", "demo", splats, 0), place.at("scene.ply"));
        let graph = place.named(&format!("pipelines/{graph}.ron"));
        let mut viewer = Viewer::new(common::device(), scene, &graph, &settings(set), Arc::new(|| {}))
            .unwrap_or_else(|error| panic!("the viewer opens: {error}"));
        viewer.navigation.set_animated(false);
        // Draw every frame, even an unchanged one, however slow the machine is.
        viewer.continuous = true;
        viewer.a.renderer.patience = PATIENCE;
        Twin { viewer, events: Vec::new(), size: SIZE, place }
    }

    /// Like `new`, after its first frame is drawn.
    pub fn drawing(graph: &str, splats: u32, set: &[(&str, &str)]) -> Twin {
        let mut twin = Twin::new(graph, splats, set);
        twin.until("the first plan", |event| matches!(event, Event::Swapped { renderer: RendererId::A, .. }));
        twin
    }

    pub fn frame(&mut self) {
        self.viewer.frame(self.size);
        for renderer in self.viewer.viewports().map(|viewport| &viewport.renderer) {
            assert!(renderer.lost().is_none(), "{:?}", renderer.lost());
            assert!(renderer.trouble().is_none(), "a frame is drawn: {:?}", renderer.trouble());
        }
        self.events.extend(self.viewer.take_events());
        common::assert_silent(self.device(), "a frame");
    }

    pub fn device(&mut self) -> &mut Backend {
        self.viewer.a.renderer.device_mut().expect("the device is not lost")
    }

    pub fn frames(&mut self, count: usize) {
        for _ in 0..count {
            self.frame();
        }
    }

    /// Draws frames until an event satisfies `is_it`, and returns it.
    pub fn until(&mut self, what: &str, is_it: impl Fn(&Event) -> bool) -> Event {
        let begun = Instant::now();
        let mut seen = self.events.len();
        loop {
            self.frame();
            for event in &self.events[seen..] {
                if is_it(event) {
                    return event.clone();
                }
            }
            seen = self.events.len();
            assert!(begun.elapsed() < PATIENCE, "waiting for {what}; so far: {:#?}", self.events);
        }
    }

    /// Draws frames until nothing is being built.
    pub fn settle(&mut self) {
        let begun = Instant::now();
        self.frame();
        while self.viewer.busy() {
            self.frame();
            assert!(begun.elapsed() < PATIENCE, "waiting for the end of it; so far: {:#?}", self.events);
        }
        self.frame();
    }

    pub fn next_plan(&mut self) -> Event {
        self.until("a new plan of A", |event| matches!(event, Event::Swapped { renderer: RendererId::A, .. }))
    }

    /// Waits for the next error; returns its text.
    pub fn next_failure(&mut self) -> String {
        match self.until("a mistake", |event| matches!(event, Event::Failed { .. })) {
            Event::Failed { text, .. } => text,
            other => unreachable!("{other:?}"),
        }
    }

    pub fn picture(&mut self, who: RendererId) -> Image {
        self.viewer.viewport(who).expect("there is such a viewport").want_picture();
        self.frame();
        self.viewer.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let pixels = self
            .viewer
            .viewport(who)
            .and_then(|viewport| viewport.take_picture())
            .expect("the picture is there")
            .unwrap_or_else(|error| panic!("the picture is read: {error}"));
        image_of(&pixels).expect("it has colours")
    }

    pub fn passes(&self) -> usize {
        self.viewer.a.renderer.plan().map_or(0, |plan| plan.frame.len())
    }

    /// Waits for frames in flight; returns the number of A's frames so far.
    pub fn drawn(&mut self) -> u64 {
        self.viewer.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        self.viewer.a.history.frames()
    }

    /// Closes the viewer; fails on validation messages.
    pub fn close(mut self) {
        self.viewer.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let messages = self.viewer.into_device().expect("the device is not lost").close();
        assert!(messages.is_empty(), "{}", messages.join("\n"));
    }
}

pub fn shows_something(image: &Image) -> bool {
    image.rgb.iter().any(|pixel| pixel.iter().any(|v| *v > 0.1))
}
