//! Random actions on the tools, on a device that executes nothing and on lavapipe.
//!
//! A seeded generator clicks and drags the controls that are shown, types numbers, changes graphs and parameters, edits
//! files, opens scenes, resizes the window, undoes and redoes. These must hold:
//!
//! - nothing panics, and no frame fails;
//! - an action that only looks (open a tool, select a pass, scroll, resize, change the theme) changes no setting;
//! - the picture stays within the window;
//! - at the end, on a device that draws, the picture has the bytes that `render` draws with the same settings.
//!
//! `SPLATGRAPH_LONG` runs 10,000 actions on every preset.

use super::whole::{PATIENCE, TestShell};
use crate::numbers::Random;
use crate::place::shipped;
use crate::{common, images};
use egui::{Event as Input, Key, Modifiers, PointerButton, Popup, Pos2, Rect, Vec2};
use splatgraph::draw::backend::{Api, Backend, Options, Validation};
use splatgraph::draw::builtin;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::panels::Tool;
use splatgraph::view::undo::Settings;
use splatgraph::view::viewer::Marks;
use splatgraph_api::Device;
use splatgraph_assets::Scene;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::available_parallelism;
use std::time::Instant;

/// Few pixels per point: tools have as much room as on a display, and a frame is cheap.
const PIXELS_PER_POINT: f32 = 0.25;
/// Sizes of the window, in pixels: 1600 x 900 points, 1280 x 800, 700 x 600, 500 x 400, 1200 x 340.
const SIZES: [(u32, u32); 5] = [(400, 225), (320, 200), (175, 150), (125, 100), (300, 85)];

struct Monkey {
    viewer: TestShell,
    dice: Random,
    /// The latest 12 actions, for messages.
    deeds: VecDeque<String>,
}

impl Drop for Monkey {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("after {:#?}", self.deeds);
        }
    }
}

impl Monkey {
    fn new(devices: [Backend; 2], graph: &str, seed: u64) -> Monkey {
        let graph = format!("pipelines/{graph}.ron");
        let mut viewer = TestShell::on(devices, ("demo", 300), &graph, &[], SIZES[0]);
        viewer.place.scene("other.ply", "demo", 200, 0);
        viewer.shell.viewer.continuous = false;
        viewer.pixels_per_point = PIXELS_PER_POINT;
        viewer.shell.panels.open_tools(&Tool::ALL);
        viewer.settle();
        Monkey { viewer, dice: Random(seed), deeds: VecDeque::new() }
    }

    fn window(&self) -> Rect {
        let (width, height) = self.viewer.size;
        Rect::from_min_size(Pos2::ZERO, Vec2::new(width as f32, height as f32) / PIXELS_PER_POINT)
    }

    fn frame(&mut self) {
        self.viewer.frame();
        if let Some(view) = self.viewer.shell.panels.controls.find("view") {
            assert!(view.is_finite() && self.window().expand(1.0).contains_rect(view), "{view:?}");
        }
    }

    /// Draws frames until all input was delivered, and one more.
    fn act(&mut self) {
        while !self.viewer.input.is_empty() {
            self.frame();
        }
        self.frame();
    }

    /// Performs a random action. An action that only looks must change no setting; unchecked while something is built
    /// or typed.
    fn something(&mut self) {
        let looks = self.dice.below(2) == 0;
        // While a number is being typed, a click elsewhere commits it, which changes a setting.
        let shell = &self.viewer.shell;
        let checked = looks && !shell.viewer.busy() && !shell.context().egui_wants_keyboard_input();
        if looks {
            // An open list over the tools would take the click.
            Popup::close_all(shell.context());
            self.frame();
        }
        // Marks are not compared: while splats are selected, Esc and a click with the brush change the selection.
        let before = Settings::of(&self.viewer.shell.viewer).without_marks();
        self.viewer.events.clear();
        let mut deed = if looks { self.look() } else { self.change() };
        if looks && self.hits_floating_tool() {
            // A click on something below a floating tool would hit one of the tool's controls.
            self.viewer.input.clear();
            deed += " is covered";
        }
        if self.deeds.len() == 12 {
            self.deeds.pop_front();
        }
        self.deeds.push_back(deed);
        self.act();
        let dropped = self.viewer.events.iter().any(|event| matches!(event, Event::Dropped { .. }));
        if checked && !dropped {
            assert_eq!(
                Settings::of(&self.viewer.shell.viewer).without_marks(),
                before,
                "looking changed a setting"
            );
        }
    }

    /// Returns true if a planned press or release of the pointer is within a tool that floats over others.
    fn hits_floating_tool(&self) -> bool {
        let floats = self.viewer.shell.panels.controls.iter().filter(|(name, _)| name.starts_with("float:"));
        let floats: Vec<Rect> = floats.map(|(_, rect)| rect).collect();
        self.viewer.input.iter().flatten().any(|input| match input {
            Input::PointerButton { pos, .. } => floats.iter().any(|rect| rect.contains(*pos)),
            _ => false,
        })
    }

    /// Plans or performs an action that must change no setting; returns its description.
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
                let view = self.viewer.shell.panels.controls.find("view").unwrap_or(Rect::ZERO);
                let at = self.dice.within(view);
                self.viewer.drag(PointerButton::Primary, &[at]);
                format!("pick at {at:?}")
            }
            5 => {
                self.viewer.size = *self.dice.of(&SIZES);
                format!("resize to {:?}", self.viewer.size)
            }
            6 => {
                let key =
                    *self.dice.of(&[Key::H, Key::F1, Key::T, Key::Escape, Key::F, Key::Num2, Key::Num3]);
                self.viewer.key(key, Modifiers::NONE);
                format!("press {key:?}")
            }
            7 => {
                let at = self.dice.within(self.window());
                self.viewer.scroll(at, if self.dice.below(2) == 0 { 60.0 } else { -60.0 });
                format!("scroll at {at:?}")
            }
            _ => {
                let at = self.dice.within(self.window());
                self.viewer.plan([Input::PointerMoved(at)]);
                self.viewer.input.extend(std::iter::repeat_n(Vec::new(), 10));
                format!("rest at {at:?}")
            }
        }
    }

    /// Plans or performs an action that may change settings; returns its description.
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
                    self.viewer.plan([Input::Text(text.to_owned())]);
                    self.viewer.key(Key::Enter, Modifiers::NONE);
                    format!("type `{text}` into {name}")
                }
                None => "nothing to type into".to_owned(),
            },
            6 => self.set_param(who),
            7 => {
                let graph = *self.dice.of(&builtin::names());
                let path = self.viewer.place.named(&format!("pipelines/{graph}.ron"));
                if let Some(viewport) = self.viewer.shell.viewer.viewport(who) {
                    viewport.renderer.choose(&path, Default::default());
                }
                format!("{who}: graph {graph}")
            }
            8 => {
                let shift = self.dice.below(2) == 0;
                let modifiers =
                    if shift { Modifiers::COMMAND | Modifiers::SHIFT } else { Modifiers::COMMAND };
                self.viewer.key(Key::Z, modifiers);
                if shift { "redo".to_owned() } else { "undo".to_owned() }
            }
            9 => {
                let mode =
                    *self.dice.of(&["compare:off", "compare:split", "compare:difference", "swap", "measure"]);
                self.click(mode)
            }
            10 => {
                let scene = *self.dice.of(&["scene.ply", "other.ply", "none.ply"]);
                let path = self.viewer.place.at(scene);
                self.viewer.shell.viewer.open(&path);
                format!("open {scene}")
            }
            _ => self.edit(),
        }
    }

    /// Writes a graph with another comment, broken, or as it is shipped.
    fn edit(&mut self) -> String {
        let name = format!("pipelines/{}.ron", self.dice.of(&builtin::names()));
        let text = shipped(&name);
        let text = match self.dice.below(3) {
            0 => format!("// {}\n{text}", self.viewer.calls),
            1 => text[..text.len() / 2].to_owned(),
            _ => text.to_owned(),
        };
        self.viewer.place.write(&name, text);
        format!("edit {name}")
    }

    fn set_param(&mut self, who: RendererId) -> String {
        let Some(viewport) = self.viewer.shell.viewer.viewport(who) else { return "no B".to_owned() };
        let params: Vec<_> =
            viewport.renderer.controls().iter().map(|control| control.param.clone()).collect();
        if params.is_empty() {
            return "no parameters".to_owned();
        }
        let digits =
            params.iter().find(|param| param.name == "digit_bits").filter(|_| self.dice.below(2) == 0);
        let param = digits.unwrap_or_else(|| self.dice.of(&params)).clone();
        // Large capacities would only cost memory.
        let value = self.dice.value(&param.domain, 4096);
        let text = format!("{who}: {} = {value}", param.name);
        viewport.renderer.set_param(&param.name, Some(value));
        text
    }

    /// Returns the name of a random control that `kind` accepts; `None` if none is shown.
    fn any(&mut self, kind: impl Fn(&str) -> bool) -> Option<String> {
        let names = self.viewer.shell.panels.controls.iter().map(|(name, _)| name);
        let names: Vec<String> = names.filter(|name| kind(name)).map(str::to_owned).collect();
        (!names.is_empty()).then(|| self.dice.of(&names).clone())
    }

    fn click(&mut self, name: &str) -> String {
        format!("{} {name}", if self.viewer.click(name) { "click" } else { "no" })
    }

    fn drag(&mut self, name: &str) -> String {
        let Some(rect) = self.viewer.shell.panels.controls.find(name) else { return format!("no {name}") };
        let places = [self.dice.within(rect), self.dice.within(rect)];
        self.viewer.drag(PointerButton::Primary, &places);
        format!("drag {name}")
    }

    fn play(&mut self, actions: usize) {
        for _ in 0..actions {
            self.something();
        }
        for preset in builtin::names() {
            let name = format!("pipelines/{preset}.ron");
            self.viewer.place.write(&name, shipped(&name));
        }
        self.viewer.settle();
    }
}

#[test]
fn random_actions_leave_the_tools_whole_on_every_preset() {
    let presets = builtin::names();
    let each = if common::long() { 10_000 } else { 1_000 / presets.len() + 1 };
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
    let canvas = Backend::open(Api::Null, &Options::default()).expect("the device opens");
    let device = canvas.new_context().expect("a second executor");
    let seed = 77 + builtin::names().iter().position(|name| *name == preset).expect("it is shipped") as u64;
    Monkey::new([canvas, device], preset, seed).play(actions);
}

#[test]
fn after_two_hundred_random_actions_the_picture_is_the_one_that_render_draws() {
    let canvas = common::open(&common::options(Validation::Synchronization));
    let device = canvas.new_context().expect("a second executor");
    let mut monkey = Monkey::new([canvas, device], "auto", 4);
    monkey.play(200);
    // The watcher reports a changed file with a delay.
    let begun = Instant::now();
    while monkey.viewer.shell.viewer.a.renderer.failure().is_some() && begun.elapsed() < PATIENCE {
        monkey.viewer.settle();
    }
    monkey.viewer.shell.viewer.set_marks(RendererId::A, Marks::default());
    monkey.viewer.settle();
    // A single picture has no previous frame with an order to use.
    let renderer = &mut monkey.viewer.shell.viewer.a.renderer;
    if renderer.set().contains_key("order_of") {
        renderer.set_param("order_of", None);
        monkey.viewer.settle();
    }
    let renderer = &monkey.viewer.shell.viewer.a.renderer;
    assert!(renderer.failure().is_none(), "{:?}", renderer.problem(false));
    monkey.viewer.shell.viewer.continuous = true;
    let shown = monkey.viewer.picture(RendererId::A);
    let viewer = &monkey.viewer.shell.viewer;
    let set: Vec<(&str, &str)> =
        viewer.a.renderer.set().iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    let camera = viewer.navigation.camera(shown.width as u32, shown.height as u32);
    let scene = Scene::load(viewer.scene_path(), splatgraph_assets::QUIET).expect("the scene is loaded");
    let graph = viewer.a.renderer.graph();
    let drawn = images::draw_scene(scene, &[camera], graph, viewer.background, &set);
    assert!(shown.rgb == drawn[0].rgb, "{graph} with {set:?}");
}
