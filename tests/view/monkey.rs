//! Random actions on the tools, on a device that executes nothing and on lavapipe.
//!
//! A seeded generator clicks and drags whatever is shown, types numbers, swaps graphs and digits, edits files, opens scenes,
//! resizes the window, undoes and redoes. These must hold:
//!
//! - nothing panics, and no frame fails;
//! - an action that only looks (open a tool, select a pass, scroll, resize, change the theme) changes no setting;
//! - the picture stays within the window;
//! - at the end, the picture has the bytes that `render` draws with the same settings.
//!
//! `SPLATGRAPH_LONG` runs 10,000 actions on every preset.

use super::twin::copy_of_shipped_files;
use crate::numbers::Random;
use crate::{common, images};
use egui::{
    Event as Input, Key, Modifiers, MouseWheelUnit, PointerButton, Popup, Pos2, RawInput, Rect, TouchPhase,
    Vec2,
};
use splatgraph::draw::backend::Validation;
use splatgraph::draw::builtin;
use splatgraph::draw::session::image_of;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::panels::Tool;
use splatgraph::view::shell::{FrameRequest, Shell};
use splatgraph::view::undo::Settings;
use splatgraph::view::viewer::Viewer;
use splatgraph_api::Device;
use splatgraph_assets::{Scene, synth};
use splatgraph_framework::ir::{Domain, Value};
use std::collections::VecDeque;
use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

/// Time limit for anything, on any machine.
const PATIENCE: Duration = Duration::from_secs(120);
/// Few pixels per point: tools have as much room as on a display, and a frame is cheap.
const PIXELS_PER_POINT: f32 = 0.25;
/// Sizes of the window, in points.
const SIZES: [(f32, f32); 5] =
    [(1600.0, 900.0), (1280.0, 800.0), (700.0, 600.0), (500.0, 400.0), (1200.0, 340.0)];

/// A viewer and a random user.
struct Monkey<D: Device> {
    shell: Shell<D>,
    dice: Random,
    /// Size of the window, in points.
    size: (f32, f32),
    calls: u64,
    input: VecDeque<Vec<Input>>,
    folder: tempfile::TempDir,
    /// The actions so far, for messages.
    deeds: VecDeque<String>,
    dropped: bool,
}

impl<D: Device> Monkey<D> {
    fn new(canvas: D, device: D, graph: &str, seed: u64) -> Monkey<D> {
        let folder = copy_of_shipped_files();
        for (name, splats) in [("scene.ply", 300), ("other.ply", 200)] {
            let scene = synth::generate("demo", splats, 0).expect("the scene is generated");
            scene.write_ply(folder.path().join(name)).expect("the scene is written");
        }
        let path = folder.path().join("scene.ply");
        let scene = Scene::load(&path, splatgraph_assets::QUIET).expect("the scene is loaded");
        let graph = folder.path().join(format!("pipelines/{graph}.ron"));
        let mut viewer = Viewer::new(device, (scene, path), &graph.to_string_lossy(), &[], Arc::new(|| {}))
            .unwrap_or_else(|error| panic!("the viewer opens: {error}"));
        viewer.navigation.set_animated(false);
        viewer.folder = folder.path().to_owned();
        viewer.a.renderer.patience = PATIENCE;
        let mut shell = Shell::new(viewer, canvas, Arc::new(|| {}))
            .unwrap_or_else(|error| panic!("the shell opens: {error}"));
        shell.window_mut().patience = PATIENCE;
        shell.panels.open_tools(&Tool::ALL);
        let dice = Random(seed);
        let (input, deeds) = (VecDeque::new(), VecDeque::new());
        let mut monkey =
            Monkey { shell, dice, size: SIZES[0], calls: 0, input, folder, deeds, dropped: false };
        monkey.settle();
        monkey
    }

    fn frame(&mut self) {
        let events = self.input.pop_front().unwrap_or_default();
        let size = Vec2::new(self.size.0, self.size.1);
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, size)),
            time: Some(self.calls as f64 / 60.0),
            events,
            focused: true,
            ..RawInput::default()
        };
        self.calls += 1;
        let pixels = size * PIXELS_PER_POINT;
        let request = FrameRequest {
            size: (pixels.x as u32, pixels.y as u32),
            pixels_per_point: PIXELS_PER_POINT,
            present: false,
            read: false,
            redraw: true,
        };
        let frame = self.shell.frame(input, request);
        assert!(frame.lost.is_none(), "{:?} after {:#?}", frame.lost, self.deeds);
        let viewer = &self.shell.viewer;
        for viewport in [Some(&viewer.a), viewer.b.as_ref()].into_iter().flatten() {
            let trouble = viewport.renderer.trouble();
            assert!(trouble.is_none(), "a frame is drawn: {trouble:?} after {:#?}", self.deeds);
        }
        let events = self.shell.take_events();
        self.dropped |= events.iter().any(|event| matches!(event, Event::Dropped { .. }));
        if let Some(view) = self.shell.panels.controls.find("view") {
            let window = Rect::from_min_size(Pos2::ZERO, size).expand(1.0);
            assert!(view.is_finite() && window.contains_rect(view), "{view:?} after {:#?}", self.deeds);
        }
    }

    /// Draws frames until all input was delivered.
    fn act(&mut self) {
        while !self.input.is_empty() {
            self.frame();
        }
        self.frame();
    }

    fn settle(&mut self) {
        let begun = Instant::now();
        self.act();
        loop {
            self.frame();
            let shell = &self.shell;
            if !shell.viewer.busy() && !shell.window().busy() {
                return;
            }
            assert!(begun.elapsed() < PATIENCE, "everything is built in time after {:#?}", self.deeds);
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn busy(&self) -> bool {
        self.shell.viewer.busy()
    }

    /// Does something, and checks that looking changes nothing.
    fn something(&mut self) {
        let looks = self.dice.below(2) == 0;
        // A number that is being typed becomes a change where the next click takes its focus.
        let checked = looks && !self.busy() && !self.shell.context().egui_wants_keyboard_input();
        if looks {
            // A list over the tools would take the click.
            Popup::close_all(self.shell.context());
            self.frame();
        }
        let before = Settings::of(&self.shell.viewer);
        self.dropped = false;
        let mut deed = if looks { self.look() } else { self.change() };
        if looks && self.hits_floating_tool() {
            // A click on something below a floating tool would hit one of the tool's controls.
            self.input.clear();
            deed += " is covered";
        }
        if self.deeds.len() == 12 {
            self.deeds.pop_front();
        }
        self.deeds.push_back(deed);
        self.act();
        if checked && !self.dropped {
            let after = Settings::of(&self.shell.viewer);
            assert_eq!(after, before, "looking changed a setting: {:#?}", self.deeds);
        }
    }

    /// Returns true if a planned press of the pointer is within a tool that floats over others.
    fn hits_floating_tool(&self) -> bool {
        let floats = self.shell.panels.controls.iter().filter(|(name, _)| name.starts_with("float:"));
        let floats: Vec<Rect> = floats.map(|(_, rect)| rect).collect();
        self.input.iter().flatten().any(|input| match input {
            Input::PointerButton { pos, .. } => floats.iter().any(|rect| rect.contains(*pos)),
            _ => false,
        })
    }

    /// Plans an action that must change no setting.
    fn look(&mut self) -> String {
        match self.dice.below(9) {
            0 | 1 => {
                let tool = self.dice.of(&Tool::ALL).title();
                self.click(&format!("panel:{tool}"))
            }
            2 | 3 => {
                let kinds = ["pass:", "barrier:", "resource:", "tab:", "splat:", "toast"];
                let kind = *self.dice.of(&kinds);
                match self.any(|name| name.starts_with(kind)) {
                    Some(name) => self.click(&name),
                    None => format!("no {kind}"),
                }
            }
            4 => {
                let view = self.shell.panels.controls.find("view").unwrap_or(Rect::ZERO);
                let at = self.within(view);
                self.click_at(at);
                format!("pick at {at:?}")
            }
            5 => {
                self.size = *self.dice.of(&SIZES);
                format!("resize to {:?}", self.size)
            }
            6 => {
                let key =
                    *self.dice.of(&[Key::H, Key::F1, Key::T, Key::Escape, Key::F, Key::Num2, Key::Num3]);
                self.key(key, Modifiers::NONE);
                format!("press {key:?}")
            }
            7 => {
                let at = self.within(Rect::from_min_size(Pos2::ZERO, self.size.into()));
                let delta = Vec2::new(0.0, if self.dice.below(2) == 0 { 60.0 } else { -60.0 });
                self.input.push_back(vec![Input::PointerMoved(at)]);
                self.input.push_back(vec![Input::MouseWheel {
                    unit: MouseWheelUnit::Point,
                    delta,
                    phase: TouchPhase::Move,
                    source: egui::MouseWheelSource::Wheel,
                    modifiers: Modifiers::NONE,
                }]);
                format!("scroll at {at:?}")
            }
            _ => {
                let at = self.within(Rect::from_min_size(Pos2::ZERO, self.size.into()));
                self.input.push_back(vec![Input::PointerMoved(at)]);
                self.input.extend(std::iter::repeat_n(Vec::new(), 10));
                format!("rest at {at:?}")
            }
        }
    }

    /// Plans an action that may change settings.
    fn change(&mut self) -> String {
        let who = if self.dice.below(3) == 0 { RendererId::B } else { RendererId::A };
        match self.dice.below(12) {
            0..=3 => match self.any(|_| true) {
                Some(name) => self.click(&name),
                None => "nothing to click".to_owned(),
            },
            4 => match self.any(|name| name.starts_with("param:")) {
                Some(name) => self.drag(&name),
                None => "nothing to drag".to_owned(),
            },
            5 => match self.any(|name| name.starts_with("param:") && name.ends_with('#')) {
                Some(name) => {
                    let text = *self.dice.of(&["0", "7", "0.3", "1e9", "-5", "nonsense", ""]);
                    self.click(&name);
                    self.input.push_back(vec![Input::Text(text.to_owned())]);
                    self.key(Key::Enter, Modifiers::NONE);
                    format!("type `{text}` into {name}")
                }
                None => "nothing to type into".to_owned(),
            },
            6 => self.set_param(who),
            7 => {
                let graph = *self.dice.of(&builtin::names());
                let path = self.folder.path().join(format!("pipelines/{graph}.ron"));
                if let Some(viewport) = self.shell.viewer.viewport(who) {
                    viewport.renderer.choose(&path.to_string_lossy(), Default::default());
                }
                format!("{who}: graph {graph}")
            }
            8 => {
                let shift = self.dice.below(2) == 0;
                let modifiers =
                    if shift { Modifiers::COMMAND | Modifiers::SHIFT } else { Modifiers::COMMAND };
                self.key(Key::Z, modifiers);
                if shift { "redo".to_owned() } else { "undo".to_owned() }
            }
            9 => {
                let mode =
                    *self.dice.of(&["compare:off", "compare:split", "compare:difference", "swap", "measure"]);
                self.click(mode)
            }
            10 => {
                let scene = *self.dice.of(&["scene.ply", "other.ply", "none.ply"]);
                let path = self.folder.path().join(scene);
                self.shell.viewer.open(&path);
                format!("open {scene}")
            }
            _ => self.edit(),
        }
    }

    /// Writes a graph again with another comment, broken, or as it is shipped.
    fn edit(&mut self) -> String {
        let name = format!("pipelines/{}.ron", self.dice.of(&builtin::names()));
        let (_, text) = builtin::FILES.iter().find(|(file, _)| *file == name).expect("it is shipped");
        let text = match self.dice.below(3) {
            0 => format!("// {}\n{text}", self.calls),
            1 => text[..text.len() / 2].to_owned(),
            _ => (*text).to_owned(),
        };
        fs::write(self.folder.path().join(&name), text).expect("the graph is written");
        format!("edit {name}")
    }

    fn set_param(&mut self, who: RendererId) -> String {
        let Some(viewport) = self.shell.viewer.viewport(who) else { return "no B".to_owned() };
        let params: Vec<_> =
            viewport.renderer.controls().iter().map(|control| control.param.clone()).collect();
        if params.is_empty() {
            return "no parameters".to_owned();
        }
        let digits =
            params.iter().find(|param| param.name == "digit_bits").filter(|_| self.dice.below(2) == 0);
        let param = digits.unwrap_or_else(|| self.dice.of(&params)).clone();
        let share = self.dice.below(1001) as f64 / 1000.0;
        let value = match &param.domain {
            Domain::Bool => Value::Bool(share < 0.5),
            Domain::Int { min, max } => {
                // Large lists cost memory, and nothing else.
                let max = (*max).min(min.saturating_add(4096));
                Value::Int(min + ((max - min) as f64 * share).round() as i64)
            }
            Domain::Float { min, max, .. } => Value::Float(min + (max - min) * share),
            Domain::Choice(choices) => Value::Text(self.dice.of(choices).clone()),
        };
        let text = format!("{who}: {} = {value}", param.name);
        viewport.renderer.set_param(&param.name, Some(value));
        text
    }

    /// Returns a random control of a kind, except those that open something outside of the window.
    fn any(&mut self, kind: impl Fn(&str) -> bool) -> Option<String> {
        let names = self.shell.panels.controls.iter().map(|(name, _)| name);
        let names: Vec<String> = names.filter(|name| kind(name)).map(str::to_owned).collect();
        (!names.is_empty()).then(|| self.dice.of(&names).clone())
    }

    fn within(&mut self, rect: Rect) -> Pos2 {
        let share = |dice: &mut Random| dice.below(1000) as f32 / 1000.0;
        rect.min + Vec2::new(share(&mut self.dice) * rect.width(), share(&mut self.dice) * rect.height())
    }

    fn click(&mut self, name: &str) -> String {
        let Some(rect) = self.shell.panels.controls.find(name) else { return format!("no {name}") };
        self.click_at(rect.center());
        format!("click {name}")
    }

    fn click_at(&mut self, at: Pos2) {
        self.input.push_back(vec![Input::PointerMoved(at)]);
        for pressed in [true, false] {
            let button = PointerButton::Primary;
            self.input.push_back(vec![Input::PointerButton {
                pos: at,
                button,
                pressed,
                modifiers: Modifiers::NONE,
            }]);
        }
    }

    fn drag(&mut self, name: &str) -> String {
        let Some(rect) = self.shell.panels.controls.find(name) else { return format!("no {name}") };
        let (from, to) = (self.within(rect), self.within(rect));
        let press = |pos, pressed| Input::PointerButton {
            pos,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        };
        self.input.push_back(vec![Input::PointerMoved(from)]);
        self.input.push_back(vec![press(from, true)]);
        self.input.push_back(vec![Input::PointerMoved(to)]);
        self.input.push_back(vec![press(to, false)]);
        format!("drag {name}")
    }

    fn key(&mut self, key: Key, modifiers: Modifiers) {
        for pressed in [true, false] {
            self.input.push_back(vec![Input::Key {
                key,
                physical_key: None,
                pressed,
                repeat: false,
                modifiers,
            }]);
        }
    }

    fn play(&mut self, actions: usize, mut after_each: impl FnMut()) {
        for _ in 0..actions {
            self.something();
            after_each();
        }
        for preset in builtin::names() {
            let name = format!("pipelines/{preset}.ron");
            let (_, text) = builtin::FILES.iter().find(|(file, _)| *file == name).expect("it is shipped");
            fs::write(self.folder.path().join(&name), text).expect("the graph is written");
        }
        self.settle();
    }
}

#[test]
fn random_actions_leave_the_tools_whole_on_every_preset() {
    let presets = builtin::names();
    let each = if common::long() { 10_000 } else { 2_000 / presets.len() + 1 };
    let turn = AtomicUsize::new(0);
    let walkers = if common::long() { available_parallelism().map_or(1, usize::from) } else { 1 };
    std::thread::scope(|scope| {
        for _ in 0..walkers {
            scope.spawn(|| {
                while let Some(preset) = presets.get(turn.fetch_add(1, Ordering::Relaxed)) {
                    walk_on_null(preset, each);
                    if common::long() {
                        eprintln!("{preset}: {each} actions");
                    }
                }
            });
        }
    });
}

fn walk_on_null(preset: &str, actions: usize) {
    let (canvas, journal) = splatgraph_null::open(&Default::default());
    let canvas = canvas.expect("the device opens");
    let device = canvas.new_context().expect("a second executor");
    let seed = 77 + builtin::names().iter().position(|name| *name == preset).expect("it is shipped") as u64;
    let mut monkey = Monkey::new(canvas, device, preset, seed);
    // The record of the calls is not looked at, and grows.
    monkey.play(actions, || _ = journal.take());
}

#[test]
fn after_five_hundred_random_actions_the_picture_is_the_one_that_render_draws() {
    let canvas = common::open(&common::options(Validation::Synchronization));
    let device = canvas.new_context().expect("a second executor");
    let mut monkey = Monkey::new(canvas, device, "auto", 4);
    monkey.play(500, || {});
    // A file's change is told some time after it was written.
    let begun = Instant::now();
    while monkey.shell.viewer.a.renderer.failure().is_some() && begun.elapsed() < PATIENCE {
        monkey.settle();
    }
    // A single picture has no previous frame with an order to use.
    if monkey.shell.viewer.a.renderer.set().contains_key("order_of") {
        monkey.shell.viewer.a.renderer.set_param("order_of", None);
        monkey.settle();
    }
    let viewport = &mut monkey.shell.viewer.a;
    assert!(viewport.renderer.failure().is_none(), "{:?}", viewport.renderer.problem(false));
    viewport.want_picture();
    let begun = Instant::now();
    let picture = loop {
        monkey.frame();
        monkey.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        if let Some(picture) = monkey.shell.viewer.a.take_picture() {
            break picture.unwrap_or_else(|error| panic!("the picture is read: {error}"));
        }
        assert!(begun.elapsed() < PATIENCE, "the picture is read in time");
    };
    let shown = image_of(&picture).expect("it has colours");
    let viewer = &monkey.shell.viewer;
    let set: Vec<(&str, &str)> =
        viewer.a.renderer.set().iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    let camera = viewer.navigation.camera(shown.width as u32, shown.height as u32);
    let scene = Scene::load(viewer.scene_path(), splatgraph_assets::QUIET).expect("the scene is loaded");
    let graph = viewer.a.renderer.graph();
    let drawn = images::draw_scene(scene, &[camera], graph, viewer.background, &set);
    assert!(shown.rgb == drawn[0].rgb, "{graph} with {set:?} after {:#?}", monkey.deeds);
}
