//! The whole viewer without its window: pictures, panels and the window's own graph, driven by events like a window
//! system's.

use super::twin::copy_of_shipped_files;
use crate::common;
use egui::{
    Event as Input, Key, Modifiers, PointerButton, Pos2, RawInput, Rect, Vec2, ViewportId, ViewportInfo,
};
use splatgraph::draw::backend::{Backend, Options};
use splatgraph::draw::session::image_of;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::paint::Mode;
use splatgraph::view::shell::{Frame, FrameRequest, Shell};
use splatgraph::view::viewer::Viewer;
use splatgraph_assets::{Scene, synth};
use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Time limit for anything, on any machine.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Interval between frames while nothing is new.
const REST: Duration = Duration::from_millis(20);

/// Few pixels per point: panels have as much room as on a display, and a frame is cheap.
pub const PIXELS_PER_POINT: f32 = 0.4;

/// A viewer over its own copy of graphs and shaders, which can be edited.
pub struct TestShell {
    pub shell: Shell<Backend>,
    /// Events that were not taken yet.
    pub events: Vec<Event>,
    /// Size of the window, in pixels.
    pub size: (u32, u32),
    /// Calls of [`TestShell::frame`] so far.
    pub calls: u64,
    /// Frames due so far: one of A for each call once it has a plan of the scene, and one of B if it is shown and has
    /// one.
    pub due: u64,
    /// Due frames of the window that were not drawn.
    pub undrawn_windows: u64,
    /// Input of the frames to come.
    input: VecDeque<Vec<Input>>,
    /// The files as they are shipped.
    pub shipped: BTreeMap<String, String>,
    /// Signalled when other threads have something new.
    woken: Receiver<()>,
    folder: tempfile::TempDir,
}

impl TestShell {
    /// Draws `scene` (generator and number of splats) with `graph`, and the window with its own, of a copy of all shipped
    /// files.
    pub fn new(options: &Options, scene: (&str, u32), graph: &str, size: (u32, u32)) -> TestShell {
        let folder = copy_of_shipped_files();
        let path = folder.path().join("scene.ply");
        let scene = synth::generate(scene.0, scene.1, 0).expect("the scene is generated");
        scene.write_ply(&path).expect("the scene is written");
        // Rounded as in the file, so that reopening the file gives an equal scene.
        let scene = Scene::load(&path, splatgraph_assets::QUIET).expect("the scene is loaded");
        let graph = folder.path().join(graph);
        let window = folder.path().join("pipelines/view/window.ron");
        let canvas = common::open(options);
        let device = canvas.open_beside(options).expect("a device for the scene");
        let (sender, woken) = channel();
        let wake = || {
            let sender = sender.clone();
            // A dropped viewer needs no waking.
            Arc::new(move || _ = sender.send(()))
        };
        let mut viewer = Viewer::new(device, (scene, path), &graph.to_string_lossy(), &[], wake())
            .unwrap_or_else(|error| panic!("the viewer opens: {error}"));
        viewer.navigation.set_animated(false);
        viewer.folder = folder.path().to_owned();
        // Draw every frame, even an unchanged one, however slow the machine is.
        viewer.continuous = true;
        viewer.a.renderer.patience = PATIENCE;
        let mut shell = Shell::with_graph(viewer, canvas, &window.to_string_lossy(), wake())
            .unwrap_or_else(|error| panic!("the shell opens: {error}"));
        shell.window_mut().patience = PATIENCE;
        let shipped =
            splatgraph::draw::builtin::FILES.iter().map(|(name, text)| (name.to_string(), text.to_string()));
        TestShell {
            shell,
            events: Vec::new(),
            size,
            calls: 0,
            due: 0,
            undrawn_windows: 0,
            input: VecDeque::new(),
            shipped: shipped.collect(),
            woken,
            folder,
        }
    }

    /// A file of the copy.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The folder of the copy.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        fs::write(self.path(name), text).unwrap_or_else(|error| panic!("{name}: {error}"));
    }

    /// Plans input for a coming frame, after the input planned before.
    pub fn plan_input(&mut self, input: Vec<Input>) {
        self.input.push_back(input);
    }

    /// Plans a click on a control; returns false if it is not shown.
    pub fn click(&mut self, name: &str) -> bool {
        let Some(at) = self.shell.panels.controls.find(name).map(|rect| rect.center()) else { return false };
        let button = PointerButton::Primary;
        let press = |pressed| Input::PointerButton { pos: at, button, pressed, modifiers: Modifiers::NONE };
        self.plan_input(vec![Input::PointerMoved(at)]);
        self.plan_input(vec![press(true)]);
        self.plan_input(vec![press(false)]);
        true
    }

    /// Plans a key that is pressed and released.
    pub fn key(&mut self, key: Key, modifiers: Modifiers) {
        for pressed in [true, false] {
            self.plan_input(vec![Input::Key { key, physical_key: None, pressed, repeat: false, modifiers }]);
        }
    }

    /// Draws frames until all planned input was delivered, and one more.
    pub fn act(&mut self) {
        while !self.input.is_empty() {
            self.frame();
        }
        self.frame();
    }

    /// Returns true if all planned input was delivered.
    #[cfg(target_os = "linux")]
    pub fn is_idle(&self) -> bool {
        self.input.is_empty()
    }

    /// Draws a frame, and collects what happened.
    pub fn frame(&mut self) {
        self.draw(false);
    }

    fn draw(&mut self, read: bool) -> Frame {
        let (width, height) = self.size;
        let points = Vec2::new(width as f32, height as f32) / PIXELS_PER_POINT;
        let viewport =
            ViewportInfo { native_pixels_per_point: Some(PIXELS_PER_POINT), ..ViewportInfo::default() };
        let input = RawInput {
            viewports: [(ViewportId::ROOT, viewport)].into_iter().collect(),
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, points)),
            // Fixed frame times: what takes time (a drag, a fade) takes as many frames on every machine.
            time: Some(self.calls as f64 / 60.0),
            events: self.input.pop_front().unwrap_or_default(),
            focused: true,
            ..RawInput::default()
        };
        self.calls += 1;
        let window = self.shell.window().plan().is_some();
        let ask = FrameRequest {
            size: self.size,
            pixels_per_point: PIXELS_PER_POINT,
            read,
            ..FrameRequest::default()
        };
        let frame = self.shell.frame(input, ask);
        assert!(frame.lost.is_none(), "{:?}", frame.lost);
        let viewports = [Some(&self.shell.viewer.a), self.shell.viewer.b.as_ref()].into_iter().flatten();
        for renderer in viewports.map(|viewport| &viewport.renderer).chain([self.shell.window()]) {
            assert!(renderer.trouble().is_none(), "a frame is drawn: {:?}", renderer.trouble());
        }
        self.undrawn_windows += u64::from(window && !frame.drawn);
        let viewer = &self.shell.viewer;
        let shown_b = viewer.b.as_ref().filter(|_| viewer.compare != Mode::A);
        let viewports = [Some(&viewer.a), shown_b].into_iter().flatten();
        self.due += viewports.filter(|viewport| viewport.renderer.draws(viewer.scene())).count() as u64;
        self.events.extend(self.shell.take_events());
        let scene = self.shell.viewer.a.renderer.device_mut().expect("the device is not lost");
        common::assert_silent(scene, "a frame");
        common::assert_silent(self.shell.canvas_mut().expect("the device is not lost"), "a frame");
        frame
    }

    /// Frames of A and B that were drawn and are done.
    #[cfg(target_os = "linux")]
    pub fn drawn(&mut self) -> u64 {
        self.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let viewer = &self.shell.viewer;
        [Some(&viewer.a), viewer.b.as_ref()]
            .into_iter()
            .flatten()
            .map(|viewport| viewport.history.frames())
            .sum()
    }

    /// Draws frames until `is_so`. Between them it waits a little for other threads to have something new.
    pub fn until(&mut self, what: &str, mut is_so: impl FnMut(&mut TestShell) -> bool) {
        let begun = Instant::now();
        loop {
            self.frame();
            if is_so(self) {
                return;
            }
            assert!(begun.elapsed() < PATIENCE, "waiting for {what}; so far: {:#?}", self.events);
            if self.woken.recv_timeout(REST).is_ok() {
                self.woken.try_iter().for_each(drop);
            }
        }
    }

    /// Draws frames until nothing is being built and the pictures have the size that the window asks for.
    pub fn settle(&mut self) {
        // The first frame asks for what the second is to show.
        self.frame();
        self.until("the end of all building", |viewer| !viewer.busy());
    }

    fn busy(&self) -> bool {
        let TestShell { shell, .. } = self;
        shell.viewer.busy() || shell.window().busy() || shell.window().size() != self.size
    }

    /// Has all that is shown drawn from the files as they are shipped now, but for a number in the graphs' summaries, which tells
    /// when that is so: whatever was changed in the files before, it was built after that.
    #[cfg(target_os = "linux")]
    pub fn restore(&mut self, number: u64) {
        let marked = ["pipelines/splat.ron", "pipelines/view/window.ron"];
        for (name, text) in &self.shipped {
            if !marked.contains(&name.as_str()) {
                self.write(name, text);
            }
        }
        for name in marked {
            let summary = "summary: \"";
            let text = self.shipped[name].replacen(summary, &format!("{summary}{number}. "), 1);
            self.write(name, text);
        }
        let mark = format!("{number}. ");
        self.until("the files as they are shipped", |viewer| {
            let shell = &viewer.shell;
            let b = shell.viewer.b.as_ref().filter(|_| shell.viewer.compare != Mode::A);
            let all = [Some(&shell.viewer.a.renderer), b.map(|b| &b.renderer), Some(shell.window())];
            all.into_iter().flatten().all(|renderer| {
                renderer.failure().is_none()
                    && renderer.plan().is_some_and(|plan| plan.summary.starts_with(&mark))
            })
        });
        self.settle();
    }

    /// Returns the picture of a viewport's next frame.
    pub fn picture(&mut self, who: RendererId) -> Image {
        self.shell.viewer.viewport(who).expect("there is such a viewport").want_picture();
        self.frame();
        self.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let pixels = self.shell.viewer.viewport(who).and_then(|viewport| viewport.take_picture());
        let pixels = pixels.expect("the picture is there");
        let pixels = pixels.unwrap_or_else(|error| panic!("the picture is read: {error}"));
        image_of(&pixels).expect("it has colours")
    }

    /// Returns the picture of the window's next frame.
    pub fn window(&mut self) -> Image {
        let pixels = self.draw(true).picture.expect("the window's picture is there");
        image_of(&pixels).expect("it has colours")
    }

    /// Closes it; fails on validation messages.
    pub fn close(mut self) {
        self.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let devices = self.shell.into_devices();
        assert_eq!(devices.len(), 2, "a device is lost");
        let messages: Vec<String> = devices.into_iter().flat_map(Backend::close).collect();
        assert!(messages.is_empty(), "{}", messages.join("\n"));
    }
}
