//! The whole viewer without its window: pictures, panels and the window's own graph, driven by events like a window
//! system's.

use crate::common::{self, settings};
use crate::place::Place;
#[cfg(target_os = "linux")]
use crate::place::shipped;
use egui::{
    Event as Input, Key, Modifiers, MouseWheelSource, MouseWheelUnit, PointerButton, Pos2, RawInput, Rect,
    TouchPhase, Vec2, ViewportId, ViewportInfo,
};
use splatgraph::draw::backend::{Backend, Validation};
#[cfg(target_os = "linux")]
use splatgraph::draw::builtin;
use splatgraph::draw::session::image_of;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::shell::{Frame, FrameRequest, Shell};
use splatgraph::view::viewer::Viewer;
use splatgraph_assets::Scene;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Time limit of every wait, generous for slow machines.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Longest wait between frames while other threads report nothing.
const REST: Duration = Duration::from_millis(20);

/// Few pixels per point: panels have as much room as on a display, and a frame is cheap.
pub const PIXELS_PER_POINT: f32 = 0.4;

/// A viewer over its own copy of graphs and shaders, which can be edited.
pub struct TestShell {
    pub shell: Shell,
    /// Folder with the scene, the graphs and the shaders.
    pub place: Place,
    /// Events that the test has not taken yet.
    pub events: Vec<Event>,
    /// Size of the window, in pixels.
    pub size: (u32, u32),
    pub pixels_per_point: f32,
    /// Calls of [`TestShell::frame`] so far.
    pub calls: u64,
    /// Frames due so far. Each call has one of A once A has a plan of the scene, and one of B if B is shown and has
    /// one.
    pub due: u64,
    /// Due frames of the window that were not drawn.
    pub undrawn_windows: u64,
    /// Planned input, one list per frame.
    pub input: VecDeque<Vec<Input>>,
    /// Signalled when another thread has something new.
    woken: Receiver<()>,
}

impl TestShell {
    /// Opens a viewer that draws `scene` (generator, number of splats) with `graph`, under synchronization validation.
    ///
    /// Both `graph` and the window's graph are from a copy of all shipped files.
    pub fn new(scene: (&str, u32), graph: &str, size: (u32, u32)) -> TestShell {
        TestShell::open(Validation::Synchronization, scene, graph, &[], size)
    }

    /// Opens a viewer like `new`, with another validation and with parameters.
    pub fn open(
        validation: Validation,
        scene: (&str, u32),
        graph: &str,
        set: &[(&str, &str)],
        size: (u32, u32),
    ) -> TestShell {
        let options = common::options(validation);
        let canvas = common::open(&options);
        let device = canvas.open_beside(&options).expect("a device for the scene");
        TestShell::on([canvas, device], scene, graph, set, size)
    }

    /// Opens a viewer that draws the window on one device, and the scene on another.
    pub fn on(
        [canvas, device]: [Backend; 2],
        scene: (&str, u32),
        graph: &str,
        set: &[(&str, &str)],
        size: (u32, u32),
    ) -> TestShell {
        common::share_shaders();
        let place = Place::shipped();
        place.scene("scene.ply", scene.0, scene.1, 0);
        // Read from the file, which rounds, so that reopening the file gives an equal scene.
        let path = place.at("scene.ply");
        let scene = Scene::load(&path, splatgraph_assets::QUIET).expect("the scene is loaded");
        let (sender, woken) = channel();
        let wake = || {
            let sender = sender.clone();
            // A dropped viewer needs no waking.
            Arc::new(move || _ = sender.send(()))
        };
        let mut viewer = Viewer::new(device, (scene, path), &place.named(graph), &settings(set), wake())
            .unwrap_or_else(|error| panic!("the viewer opens: {error}"));
        viewer.navigation.flight_seconds = 0.0;
        viewer.folder = place.at("");
        // Draw every frame, even an unchanged one, however slow the machine is.
        viewer.continuous = true;
        viewer.a.renderer.patience = PATIENCE;
        let mut shell = Shell::new(viewer, canvas, &place.named("pipelines/view/window.ron"), wake())
            .unwrap_or_else(|error| panic!("the shell opens: {error}"));
        shell.window_mut().patience = PATIENCE;
        TestShell {
            shell,
            place,
            events: Vec::new(),
            size,
            pixels_per_point: PIXELS_PER_POINT,
            calls: 0,
            due: 0,
            undrawn_windows: 0,
            input: VecDeque::new(),
            woken,
        }
    }

    /// Closes the viewer; fails on validation messages and if a device is lost.
    pub fn close(mut self) {
        self.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let devices = self.shell.into_devices();
        assert_eq!(devices.len(), 2, "a device is lost");
        let messages: Vec<String> = devices.into_iter().flat_map(Backend::close).collect();
        assert!(messages.is_empty(), "{}", messages.join("\n"));
    }

    /// Plans events, one per frame.
    pub fn plan(&mut self, events: impl IntoIterator<Item = Input>) {
        self.input.extend(events.into_iter().map(|event| vec![event]));
    }

    /// Plans a drag: a press at the first place, moves over the others, and a release at the last.
    pub fn drag(&mut self, button: PointerButton, places: &[Pos2]) {
        let press = |pos, pressed| Input::PointerButton { pos, button, pressed, modifiers: Modifiers::NONE };
        let (first, last) = (places[0], places[places.len() - 1]);
        self.plan([Input::PointerMoved(first), press(first, true)]);
        self.plan(places[1..].iter().map(|at| Input::PointerMoved(*at)));
        self.plan([press(last, false)]);
    }

    /// Plans a click on a control; returns false if it is not shown.
    pub fn click(&mut self, name: &str) -> bool {
        let at = self.shell.panels.controls.find(name).map(|rect| rect.center());
        at.inspect(|at| self.drag(PointerButton::Primary, &[*at])).is_some()
    }

    /// Plans a turn of the wheel at a place, by a distance in points.
    pub fn scroll(&mut self, at: Pos2, points: f32) {
        let wheel = Input::MouseWheel {
            unit: MouseWheelUnit::Point,
            delta: Vec2::new(0.0, points),
            phase: TouchPhase::Move,
            source: MouseWheelSource::Wheel,
            modifiers: Modifiers::NONE,
        };
        self.plan([Input::PointerMoved(at), wheel]);
    }

    /// Plans a press and release of a key.
    pub fn key(&mut self, key: Key, modifiers: Modifiers) {
        let event = |pressed| Input::Key { key, physical_key: None, pressed, repeat: false, modifiers };
        self.plan([true, false].map(event));
    }

    /// Draws frames until all planned input was delivered, and one more.
    pub fn act(&mut self) {
        while !self.input.is_empty() {
            self.frame();
        }
        self.frame();
    }

    /// Clicks a control, which must be shown, and draws the result.
    pub fn push(&mut self, name: &str) {
        assert!(self.click(name), "{name} is not shown");
        self.act();
    }

    /// Presses and releases a key, and draws the result.
    pub fn press(&mut self, key: Key, modifiers: Modifiers) {
        self.key(key, modifiers);
        self.act();
    }

    /// Draws a frame with the next planned input, and collects its events. Fails on validation messages, and if a
    /// device is lost or a renderer cannot draw.
    pub fn frame(&mut self) {
        self.draw(false);
    }

    pub fn frames(&mut self, count: usize) {
        (0..count).for_each(|_| self.frame());
    }

    fn draw(&mut self, read: bool) -> Frame {
        let (width, height) = self.size;
        let pixels_per_point = self.pixels_per_point;
        let points = Vec2::new(width as f32, height as f32) / pixels_per_point;
        let viewport =
            ViewportInfo { native_pixels_per_point: Some(pixels_per_point), ..ViewportInfo::default() };
        let input = RawInput {
            viewports: [(ViewportId::ROOT, viewport)].into_iter().collect(),
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, points)),
            // Fixed frame times, so that drags and fades take the same number of frames on every machine.
            time: Some(self.calls as f64 / 60.0),
            events: self.input.pop_front().unwrap_or_default(),
            focused: true,
            ..RawInput::default()
        };
        self.calls += 1;
        let window = self.shell.window().plan().is_some();
        let request = FrameRequest { size: self.size, read, ..FrameRequest::default() };
        let frame = self.shell.frame(input, request);
        assert!(frame.lost.is_none(), "{:?}", frame.lost);
        let renderers = self.shell.viewer.viewports().map(|viewport| &viewport.renderer);
        for renderer in renderers.chain([self.shell.window()]) {
            assert!(renderer.trouble().is_none(), "a frame is drawn: {:?}", renderer.trouble());
        }
        self.undrawn_windows += u64::from(window && !frame.drawn);
        let viewer = &self.shell.viewer;
        self.due += viewer.shown().filter(|shown| shown.renderer.draws(viewer.scene())).count() as u64;
        self.events.extend(self.shell.take_events());
        let scene = self.shell.viewer.a.renderer.device_mut().expect("the device is not lost");
        common::assert_silent(scene, "a frame");
        common::assert_silent(
            self.shell.window_mut().device_mut().expect("the device is not lost"),
            "a frame",
        );
        frame
    }

    /// Waits for frames in flight; returns the number of frames of A and B so far.
    pub fn drawn(&mut self) -> u64 {
        self.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        self.shell.viewer.viewports().map(|viewport| viewport.history.frames()).sum()
    }

    /// Draws frames until `is_so`; fails after [`PATIENCE`]. Between frames, waits up to [`REST`] for news from other
    /// threads.
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

    /// Draws frames until a new event satisfies `is_it`; returns the event.
    pub fn event(&mut self, what: &str, is_it: impl Fn(&Event) -> bool) -> Event {
        let (seen, mut found) = (self.events.len(), None);
        self.until(what, |viewer| {
            found = viewer.events[seen..].iter().find(|event| is_it(event)).cloned();
            found.is_some()
        });
        found.expect("the event ended the wait")
    }

    /// Draws frames until nothing is being built and the window's plan has the window's size.
    pub fn settle(&mut self) {
        // The first frame requests what later frames show.
        self.frame();
        self.until("the end of all building", |viewer| !viewer.busy());
    }

    pub fn busy(&self) -> bool {
        let TestShell { shell, .. } = self;
        shell.viewer.busy() || shell.window().busy() || shell.window().size() != self.size
    }

    /// Restores all shipped files, and draws frames until every plan shown, and the window's, is built from them.
    ///
    /// All viewports must show `splat`. Its file and the window's are written last, with `number` before their
    /// summaries: a plan whose summary begins with the number of this call was built from the restored files.
    #[cfg(target_os = "linux")]
    pub fn restore(&mut self, number: u64) {
        let marked = ["pipelines/splat.ron", "pipelines/view/window.ron"];
        for (name, text) in builtin::FILES.iter().filter(|(name, _)| !marked.contains(name)) {
            self.place.write(name, text);
        }
        for name in marked {
            let summary = "summary: \"";
            let text = shipped(name).replacen(summary, &format!("{summary}{number}. "), 1);
            self.place.write(name, text);
        }
        let mark = format!("{number}. ");
        self.until("the files as they are shipped", |viewer| {
            let shell = &viewer.shell;
            let shown = shell.viewer.shown().map(|viewport| &viewport.renderer);
            shown.chain([shell.window()]).all(|renderer| {
                renderer.failure().is_none()
                    && renderer.plan().is_some_and(|plan| plan.summary.starts_with(&mark))
            })
        });
        self.settle();
    }

    /// Draws a frame and waits for it; returns the picture of a viewport, which must exist.
    pub fn picture(&mut self, who: RendererId) -> Image {
        self.shell.viewer.viewport(who).expect("there is such a viewport").want_picture();
        self.frame();
        self.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let pixels = self.shell.viewer.viewport(who).and_then(|viewport| viewport.take_picture());
        let pixels = pixels.expect("the picture is there");
        let pixels = pixels.unwrap_or_else(|error| panic!("the picture is read: {error}"));
        image_of(&pixels).expect("it has colours")
    }

    pub fn window(&mut self) -> Image {
        let pixels = self.draw(true).picture.expect("the window's picture is there");
        image_of(&pixels).expect("it has colours")
    }
}
