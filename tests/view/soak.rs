//! Thousands of frames of the whole viewer while everything about it changes all the time.
//!
//! A seeded generator does something every few frames: files are edited, broken, emptied, replaced and mended; parameters, graphs
//! and scenes are changed; the window is resized and minimised; pictures are compared, exchanged and inspected; and the mouse
//! moves the camera and clicks on the panels. Every so often all of it is brought back to the same reference state, and that
//! has to be what it was: the same pictures, and no more memory.
//!
//! What must hold:
//!
//! - the validation layers, synchronization validation among them, have nothing to say, and nothing panics on whatever thread;
//! - **no frame is lost**: every frame that is asked for draws one of A once A has a plan, and one of B if B is shown and has
//!   one, whatever is being built, broken or resized meanwhile. That holds for a window of size 0 as well: the pictures keep
//!   the size that they had. There are no exceptions but these: before the first plan of a viewport there is nothing to draw, and
//!   B is not drawn while it is not shown;
//! - in the reference state, the device's memory has the same bytes each time, and the pictures the same pixels;
//! - the process's memory does not grow: see [`check_growth`];
//! - nor do the numbers of its open files and of its threads.
//!
//! `SPLATGRAPH_LONG` runs 10,000 frames. `SPLATGRAPH_SOAK=FILE.csv` writes a row per [`ROW`] frames, for a plot.
//! `SPLATGRAPH_SOAK_BARE` leaves the validation layers out, whose own memory is then not in the numbers.

use super::dice::Dice;
use super::whole::TestShell;
use crate::common;
use egui::{Event as Input, Key, Modifiers, MouseWheelUnit, PointerButton, Pos2, TouchPhase, Vec2};
use indexmap::IndexMap;
use splatgraph::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::navigation::Navigation;
use splatgraph::view::paint::Mode;
use splatgraph_api::Device;
use splatgraph_assets::synth;
use splatgraph_framework::ir::{Domain, ParamBinding, Value};
use splatgraph_vulkan::{DeviceMemory, Validation};
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// The window in the reference state.
const SIZE: (u32, u32) = (400, 225);
/// Pixels of the picture per pixel of the window, then: 64 x 36 of them.
const SCALE: f32 = 0.16;
const SPLATS: u32 = 2_000;

/// Frames per row of the table.
const ROW: u64 = 25;

/// How long it runs.
struct Length {
    frames: u64,
    /// Frames from one reference state to the next.
    cycle: u64,
    /// Bytes that the resident memory may be larger by in the last third than in the middle one.
    noise: u64,
}

/// Caches are still filling all the time: the driver's, the validation layers', those of compiled shaders. Only what is lost in
/// every frame shows in the resident memory; the device's is exact.
const SHORT: Length = Length { frames: 900, cycle: 100, noise: 96 << 20 };
/// What is left is what allocators keep of what was freed, here and there, and some 10 KiB for every text of a shader that was
/// compiled: of these each compiler remembers the last thousand.
const LONG: Length = Length { frames: 10_000, cycle: 500, noise: 24 << 20 };

/// The allocator of the device's memory counts what it leaves free before a piece for the sake of its alignment as a part of
/// that piece. This depends on what stood before it, so that the sum is never quite the same.
const PADDING_BYTES: u64 = 4 << 10;

/// Bytes of texels: egui packs its letters into 2048 x 2048 of them at most, buffers are powers of two, and there is one per
/// frame in flight.
const MOST_TEXELS: u64 = 2 * (32 << 20);

/// Panics on whatever thread.
static PANICS: AtomicUsize = AtomicUsize::new(0);

#[test]
fn whatever_happens_for_thousands_of_frames_no_frame_is_lost_and_no_memory() {
    common::alone(
        "view::soak::whatever_happens_for_thousands_of_frames_no_frame_is_lost_and_no_memory",
        || {
            let before = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                PANICS.fetch_add(1, Ordering::Relaxed);
                before(panic);
            }));
            soak(if common::long() { LONG } else { SHORT });
        },
    );
}

fn soak(length: Length) {
    let mut soak = Soak::begin();
    let mut references = Vec::new();
    while soak.viewer.calls < length.frames {
        let cycle = references.len() as u64 + 1;
        soak.disturb(cycle * length.cycle);
        soak.restore(cycle);
        let reference = soak.reference();
        println!("{reference}");
        references.push(reference);
    }
    println!("{soak}");
    assert_eq!(PANICS.load(Ordering::Relaxed), 0, "something panicked");
    check_growth(&references, length.noise);
    soak.viewer.close();
}

/// The first third is for everything to have happened once: caches fill. Of what is left, the second half must not have more than
/// the first.
fn check_growth(references: &[Reference], noise: u64) {
    let third = references.len() / 3;
    assert!(third >= 3, "{} reference states are too few to tell", references.len());
    let middle = &references[third..references.len() - third];
    let last = &references[references.len() - third..];
    let median = |of: &[Reference]| {
        let mut rss: Vec<u64> = of.iter().map(|r| r.rss).collect();
        rss.sort_unstable();
        rss[rss.len() / 2]
    };
    let (before, after) = (median(middle), median(last));
    let grown = after.saturating_sub(before);
    assert!(grown <= noise, "the resident memory grew from {before} to {after} bytes, by more than {noise}");
    let warm = &references[third];
    for reference in &references[third..] {
        assert_eq!(
            reference.listed, warm.listed,
            "what A, B and the window list: {reference}, and once {warm}"
        );
        assert!(reference.texels <= MOST_TEXELS, "{reference}");
        let other = |reference: &Reference| reference.device.used - reference.texels;
        let more = other(reference).abs_diff(other(warm));
        assert!(more <= PADDING_BYTES, "{reference}, and once {warm}");
        assert!(reference.device.reserved <= warm.device.reserved, "{reference}, and once {warm}");
        assert_eq!(reference.files, warm.files, "open files");
        assert_eq!(reference.threads, warm.threads, "threads, at {reference}");
    }
}

/// What there is in the reference state.
#[derive(Clone, Debug, PartialEq)]
struct Reference {
    call: u64,
    /// Of A, B and the window, as each lists it, but for the texels.
    listed: [u64; 3],
    /// Egui's textures. They grow when a letter is drawn for the first time, and until egui packs them anew.
    texels: u64,
    /// Of all, the texels among them.
    device: DeviceMemory,
    rss: u64,
    files: usize,
    /// By their names.
    threads: Vec<String>,
}

impl std::fmt::Display for Reference {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Reference { call, listed, texels, device, rss, files, threads } = self;
        let DeviceMemory { used, reserved } = device;
        write!(
            f,
            "frame {call}: device {used} bytes of {reserved} (A, B, window: {listed:?}; texels: {texels}), {} KiB resident, \
             {files} files, {} threads",
            rss >> 10,
            threads.len()
        )
    }
}

/// The graphs that are drawn with; the first is that of the reference state.
const GRAPHS: [&str; 8] = [
    "pipelines/splat.ron",
    "pipelines/digit4.ron",
    "pipelines/digit11.ron",
    "pipelines/unsorted.ron",
    "pipelines/key16.ron",
    "pipelines/stale_order.ron",
    "pipelines/front_to_back.ron",
    "pipelines/front_to_back_naive.ron",
];

/// What is edited, and how: a text in it, and what takes its place. All of them build.
const CONSTANTS: [(&str, &str, &str); 6] = [
    ("shaders/compose.comp", "transmittance * camera", "0.5 * transmittance * camera"),
    ("shaders/splat.frag", "min(0.99,", "min(0.5,"),
    ("shaders/window/compose.frag", "shown = vec4(colour, 1.0)", "shown = vec4(0.5 * colour, 1.0)"),
    ("pipelines/splat.ron", "Int(default: 8, range: (1, 11)", "Int(default: 6, range: (1, 11)"),
    ("pipelines/splat.ron", "Float(default: 3.33,", "Float(default: 2.5,"),
    ("pipelines/view/window.ron", "Clear(0, 0, 0, 1)", "Clear(0.5, 0, 0, 1)"),
];

/// What does not build.
const MISTAKES: [(&str, &str, &str); 5] = [
    ("shaders/project.comp", "void main() {", "void main() {\n    int i = undeclared;"),
    ("shaders/camera.glsl", "uniform", "uniförm"),
    ("shaders/window/ui.frag", "void main() {", "void main() { return 1;"),
    ("pipelines/splat.ron", "\"Splats\": \"splats\"", "\"Splats\": \"splatz\""),
    ("pipelines/view/window.ron", "phase: \"ui\",", "phase: ,"),
];

/// Files to which comments are added.
const COMMENTED: [&str; 8] = [
    "shaders/compose.comp",
    "shaders/splat.vert",
    "shaders/covariance.comp",
    "shaders/camera.glsl",
    "shaders/sort/serial_scatter.comp",
    "shaders/window/ui.vert",
    "pipelines/splat.ron",
    "pipelines/view/window.ron",
];

/// Something to do.
#[derive(Clone, Copy, Debug)]
enum Deed {
    Comment,
    Constant,
    Mistake,
    Cut,
    Empty,
    Replace,
    Mend,
    Param(ParamBindingKind),
    Graph,
    Resize,
    Minimise,
    Scale,
    Compare,
    Exchange,
    Measure,
    Inspect,
    InspectNothing,
    Scene,
    Drag,
    Scroll,
    Key,
    Panel,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ParamBindingKind {
    Const,
    Live,
}

const DEEDS: [(usize, Deed); 23] = [
    (10, Deed::Comment),
    (6, Deed::Constant),
    (5, Deed::Mistake),
    (2, Deed::Cut),
    (1, Deed::Empty),
    (4, Deed::Replace),
    (12, Deed::Mend),
    (8, Deed::Param(ParamBindingKind::Const)),
    (12, Deed::Param(ParamBindingKind::Live)),
    (4, Deed::Graph),
    (4, Deed::Resize),
    (2, Deed::Minimise),
    (2, Deed::Scale),
    (4, Deed::Compare),
    (3, Deed::Exchange),
    (2, Deed::Measure),
    (4, Deed::Inspect),
    (3, Deed::InspectNothing),
    (1, Deed::Scene),
    (12, Deed::Drag),
    (8, Deed::Scroll),
    (6, Deed::Key),
    (8, Deed::Panel),
];

struct Soak {
    viewer: TestShell,
    dice: Dice,
    begun: Instant,
    /// Where the scene is seen from in the reference state.
    start: Navigation,
    /// The files that are not as they are shipped.
    edited: BTreeSet<String>,
    /// Numbers what must differ.
    number: u64,
    deeds: u64,
    plans: u64,
    failures: u64,
    /// What the reference state shows: A, and the window.
    shown: Option<[Image; 2]>,
    table: Option<fs::File>,
    /// Of the table, so far: some are left out where it is brought back to the reference state.
    rows: u64,
    scenes: [&'static str; 3],
}

impl std::fmt::Display for Soak {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(
            f,
            "{} frames in {:.1} s: {} deeds, {} plans, {} failures",
            self.viewer.calls,
            self.begun.elapsed().as_secs_f64(),
            self.deeds,
            self.plans,
            self.failures
        )
    }
}

impl Soak {
    /// A viewer, once it shows something.
    fn begin() -> Soak {
        let bare = std::env::var_os("SPLATGRAPH_SOAK_BARE").is_some();
        let validation = if bare { Validation::Off } else { Validation::Synchronization };
        let viewer = TestShell::new(&common::options(validation), ("demo", SPLATS), GRAPHS[0], SIZE);
        let scenes = ["scene.ply", "smaller.ply", "larger.ply"];
        for (name, generator, splats) in [(scenes[1], "uniform", 700), (scenes[2], "demo", 3_100)] {
            let scene = synth::generate(generator, splats, 1).expect("the scene is generated");
            scene.write_ply(viewer.path(name)).expect("the scene is written");
        }
        let table = std::env::var_os("SPLATGRAPH_SOAK").map(|path| {
            let mut table = fs::File::create(path).expect("the table can be written");
            let head = "frame,seconds,gpu_bytes,rss_bytes,files,threads,plans,failures,lost";
            writeln!(table, "{head}").expect("the table is written");
            table
        });
        let start = viewer.shell.viewer.navigation.clone();
        let mut soak = Soak {
            viewer,
            dice: Dice::new(1),
            begun: Instant::now(),
            start,
            edited: BTreeSet::new(),
            number: 0,
            deeds: 0,
            plans: 0,
            failures: 0,
            shown: None,
            table,
            rows: 0,
            scenes,
        };
        soak.viewer.settle();
        soak
    }

    /// Does something every few frames, up to the frame of this number.
    fn disturb(&mut self, end: u64) {
        while self.viewer.calls < end {
            let deed = self.dice.weighted(&DEEDS);
            self.deeds += 1;
            self.act(deed);
            for _ in 0..1 + self.dice.below(5) {
                self.frame();
            }
        }
    }

    fn frame(&mut self) {
        self.viewer.frame();
        self.note();
    }

    /// Counts what happened, and looks whether a frame was lost.
    fn note(&mut self) {
        for event in std::mem::take(&mut self.viewer.events) {
            match event {
                Event::Swapped { .. } => self.plans += 1,
                Event::Failed { text, .. } => {
                    assert!(!text.contains("mistake of its own"), "{text}");
                    self.failures += 1;
                }
                _ => {}
            }
        }
        if self.viewer.calls / ROW > self.rows {
            self.rows = self.viewer.calls / ROW;
            let lost = self.lost();
            let (files, threads) = (open_files(), threads().len());
            let memory = self.viewer.shell.window().device().device_memory().used;
            if let Some(table) = &mut self.table {
                let seconds = self.begun.elapsed().as_secs_f64();
                let (calls, plans, failures) = (self.viewer.calls, self.plans, self.failures);
                let rss = resident();
                writeln!(
                    table,
                    "{calls},{seconds:.3},{memory},{rss},{files},{threads},{plans},{failures},{lost}"
                )
                .expect("the table is written");
            }
            assert_eq!(lost, 0, "frames were lost");
        }
    }

    /// Frames that were due and are not drawn.
    fn lost(&mut self) -> u64 {
        let drawn = self.viewer.drawn();
        assert!(drawn <= self.viewer.due, "{drawn} frames were drawn, and {} were due", self.viewer.due);
        self.viewer.due - drawn + self.viewer.undrawn_windows
    }

    fn act(&mut self, deed: Deed) {
        let who = if self.dice.below(3) == 0 { RendererId::B } else { RendererId::A };
        match deed {
            Deed::Comment => {
                let name = *self.dice.of(&COMMENTED);
                self.number += 1;
                let text = format!("{}\n// Number {}.\n", self.viewer.shipped[name], self.number);
                self.edit(name, text);
            }
            Deed::Constant => {
                let edit = *self.dice.of(&CONSTANTS);
                self.exchange_text(edit);
            }
            Deed::Mistake => {
                let edit = *self.dice.of(&MISTAKES);
                self.exchange_text(edit);
            }
            Deed::Cut => {
                let name = *self.dice.of(&COMMENTED);
                let text = &self.viewer.shipped[name];
                let text = text[..text.floor_char_boundary(text.len() / 2)].to_owned();
                self.edit(name, text);
            }
            Deed::Empty => {
                let name = *self.dice.of(&COMMENTED);
                self.edit(name, String::new());
            }
            Deed::Replace => {
                // As many editors save: a new file takes the place of the old one.
                let name = *self.dice.of(&COMMENTED);
                self.number += 1;
                let text = format!("{}\n// Replaced, number {}.\n", self.viewer.shipped[name], self.number);
                self.viewer.write("new", text);
                fs::rename(self.viewer.path("new"), self.viewer.path(name)).expect("the file is replaced");
                self.edited.insert(name.to_owned());
            }
            Deed::Mend => {
                for name in std::mem::take(&mut self.edited) {
                    self.viewer.write(&name, &self.viewer.shipped[&name]);
                }
            }
            Deed::Param(kind) => self.set_param(who, kind),
            Deed::Graph => {
                let graph = self.viewer.path(self.dice.of::<&str>(&GRAPHS));
                if let Some(viewport) = self.viewer.shell.viewer.viewport(who) {
                    viewport.renderer.choose(&graph.to_string_lossy(), IndexMap::new());
                }
            }
            Deed::Resize => {
                self.viewer.size = *self.dice.of(&[SIZE, (320, 200), (500, 180), (401, 226), (350, 350)])
            }
            Deed::Minimise => {
                let size = std::mem::take(&mut self.viewer.size);
                for _ in 0..1 + self.dice.below(5) {
                    self.frame();
                }
                self.viewer.size = size;
            }
            Deed::Scale => self.viewer.shell.viewer.scale = *self.dice.of(&[SCALE, 0.1, 0.2, 0.25]),
            Deed::Compare => {
                let mode = *self.dice.of(&["compare:off", "compare:split", "compare:difference"]);
                self.click(mode);
            }
            Deed::Exchange => self.viewer.shell.viewer.exchange(),
            Deed::Measure => self.click("measure"),
            Deed::Inspect => self.inspect(who),
            Deed::InspectNothing => {
                if let Some(viewport) = self.viewer.shell.viewer.viewport(who) {
                    viewport.inspection = None;
                }
            }
            Deed::Scene => {
                let path = self.viewer.path(self.dice.of::<&str>(&self.scenes));
                self.viewer.shell.viewer.open(&path);
            }
            Deed::Drag => self.drag(),
            Deed::Scroll => {
                let delta = Vec2::new(0.0, if self.dice.below(2) == 0 { 50.0 } else { -50.0 });
                let Some(at) = self.somewhere() else { return };
                let wheel = Input::MouseWheel {
                    unit: MouseWheelUnit::Point,
                    delta,
                    phase: TouchPhase::Move,
                    source: egui::MouseWheelSource::Wheel,
                    modifiers: Modifiers::NONE,
                };
                self.viewer.plan_input(vec![Input::PointerMoved(at)]);
                self.viewer.plan_input(vec![wheel]);
            }
            Deed::Key => {
                let key =
                    *self.dice.of(&[Key::F, Key::Home, Key::ArrowLeft, Key::ArrowUp, Key::F1, Key::Tab]);
                for pressed in [true, false] {
                    self.viewer.plan_input(vec![Input::Key {
                        key,
                        physical_key: None,
                        pressed,
                        repeat: false,
                        modifiers: Modifiers::NONE,
                    }]);
                }
            }
            Deed::Panel => {
                let panel = *self.dice.of(&[
                    "panel:Settings",
                    "panel:Performance",
                    "panel:Graph",
                    "viewport:B",
                    "keys_sorted",
                ]);
                self.click(panel);
            }
        }
    }

    fn edit(&mut self, name: &str, text: String) {
        self.viewer.write(name, text);
        self.edited.insert(name.to_owned());
    }

    fn exchange_text(&mut self, (name, from, to): (&str, &str, &str)) {
        let text = &self.viewer.shipped[name];
        assert!(text.contains(from), "{name} has no `{from}`");
        let text = text.replacen(from, to, 1);
        self.edit(name, text);
    }

    /// Another value for a parameter of the plan, whichever it has; sometimes the default.
    fn set_param(&mut self, who: RendererId, kind: ParamBindingKind) {
        let Some(viewport) = self.viewer.shell.viewer.viewport(who) else { return };
        let is_const = |binding| binding == ParamBinding::Const;
        let wanted = kind == ParamBindingKind::Const;
        let params = viewport
            .renderer
            .controls()
            .iter()
            .map(|c| &c.param)
            .filter(|param| is_const(param.binding) == wanted);
        let params: Vec<_> = params.cloned().collect();
        if params.is_empty() {
            return;
        }
        let param = self.dice.of(&params).clone();
        let share = self.dice.share();
        let value = match &param.domain {
            _ if self.dice.below(4) == 0 => None,
            Domain::Bool => Some(Value::Bool(share < 0.5)),
            Domain::Int { min, max } => Some(Value::Int(min + ((max - min) as f64 * share).round() as i64)),
            Domain::Float { min, max, .. } => Some(Value::Float(min + (max - min) * share)),
            Domain::Choice(choices) => Some(Value::Text(self.dice.of(choices).clone())),
        };
        viewport.renderer.set_param(&param.name, value);
    }

    /// Looks at something that a pass touches, in every frame or once.
    fn inspect(&mut self, who: RendererId) {
        let Some(viewport) = self.viewer.shell.viewer.viewport(who) else { return };
        let Some(plan) = viewport.renderer.plan().cloned() else { return };
        let steps: Vec<_> = plan.prologue.iter().chain(&plan.frame).collect();
        let pass = plan.pass(self.dice.of(&steps).pass);
        if pass.uses.is_empty() {
            return;
        }
        let resource = &plan.resource(self.dice.of(&pass.uses).resource).name;
        viewport.look_at(resource, &pass.name);
        if let Some(inspection) = &mut viewport.inspection {
            inspection.follow = self.dice.below(2) == 0;
        }
    }

    /// Somewhere over the picture, in points.
    fn somewhere(&mut self) -> Option<Pos2> {
        let view = self.viewer.shell.panels.controls.find("view")?;
        let (x, y) = (self.dice.share() as f32, self.dice.share() as f32);
        Some(view.min + Vec2::new(x * view.width(), y * view.height()))
    }

    fn drag(&mut self) {
        let (Some(from), Some(to)) = (self.somewhere(), self.somewhere()) else { return };
        let button =
            *self.dice.of(&[PointerButton::Primary, PointerButton::Middle, PointerButton::Secondary]);
        let press = |pos, pressed| Input::PointerButton { pos, button, pressed, modifiers: Modifiers::NONE };
        self.viewer.plan_input(vec![Input::PointerMoved(from)]);
        self.viewer.plan_input(vec![press(from, true)]);
        for step in 1..=4 {
            self.viewer.plan_input(vec![Input::PointerMoved(from + (to - from) * (step as f32 / 4.0))]);
        }
        self.viewer.plan_input(vec![press(to, false)]);
    }

    /// Clicks on a control, if it is there now.
    fn click(&mut self, name: &str) {
        let Some(at) = self.viewer.shell.panels.controls.find(name).map(|rect| rect.center()) else { return };
        let button = PointerButton::Primary;
        let press = |pressed| Input::PointerButton { pos: at, button, pressed, modifiers: Modifiers::NONE };
        self.viewer.plan_input(vec![Input::PointerMoved(at)]);
        self.viewer.plan_input(vec![press(true)]);
        self.viewer.plan_input(vec![press(false)]);
    }

    /// Brings everything back to the reference state, for the time of this number.
    fn restore(&mut self, cycle: u64) {
        let input_is_over = |viewer: &mut TestShell| viewer.is_idle();
        self.viewer.until("the end of the input", input_is_over);
        self.viewer.plan_input(vec![Input::PointerGone]);
        self.viewer.size = SIZE;
        self.viewer.frame();
        self.edited.clear();
        self.viewer.shell.panels.hidden = true;
        self.viewer.shell.panels.help = false;
        let scene = self.viewer.path(self.scenes[0]);
        let is_loaded = |viewer: &mut TestShell| viewer.shell.viewer.loading().is_none();
        self.viewer.until("the end of loading", is_loaded);
        if self.viewer.shell.viewer.scene_path() != scene {
            self.viewer.shell.viewer.open(&scene);
            self.viewer.until("the scene", is_loaded);
        }
        let graph = self.viewer.path(GRAPHS[0]);
        let viewer = &mut self.viewer.shell.viewer;
        // B is drawn, too, so that it gets there.
        viewer.set_compare(Mode::Split).unwrap_or_else(|error| panic!("{error}"));
        viewer.navigation = self.start.clone();
        (viewer.split, viewer.gain, viewer.scale) = (0.5, 8.0, SCALE);
        for who in [RendererId::A, RendererId::B] {
            if let Some(viewport) = viewer.viewport(who) {
                viewport.renderer.choose(&graph.to_string_lossy(), IndexMap::new());
                viewport.inspection = None;
            }
        }
        self.viewer.restore(cycle);
        // What is shown fades out.
        for _ in 0..30 {
            self.viewer.frame();
        }
        // What grows as frames need it is new with a new plan, and a new size is one.
        for size in [(SIZE.0 + 2, SIZE.1 + 2), SIZE] {
            self.viewer.size = size;
            self.viewer.settle();
        }
        self.viewer.shell.viewer.set_compare(Mode::A).unwrap_or_else(|error| panic!("{error}"));
        for _ in 0..4 {
            self.viewer.frame();
        }
        self.note();
    }

    /// What there is now, in the reference state, which must look as it always does.
    fn reference(&mut self) -> Reference {
        self.viewer.shell.finish().unwrap_or_else(|error| panic!("the frames end: {error}"));
        let shell = &self.viewer.shell;
        let b = shell.viewer.b.as_ref().map(|b| b.renderer.device());
        let lists = [
            shell.viewer.a.renderer.device().memory(),
            b.map(|b| b.memory()).unwrap_or_default(),
            shell.window().device().memory(),
        ];
        let is_texels = |name: &str| name == "ui_texels";
        let sum = |list: &[(String, u64)], wanted: &dyn Fn(&str) -> bool| {
            list.iter().filter(|(name, _)| wanted(name)).map(|(_, bytes)| bytes).sum::<u64>()
        };
        let reference = Reference {
            call: self.viewer.calls,
            listed: [0, 1, 2].map(|i: usize| sum(&lists[i], &|name| !is_texels(name))),
            texels: sum(&lists[2], &is_texels),
            device: shell.window().device().device_memory(),
            rss: resident(),
            files: open_files(),
            threads: settled_threads(),
        };
        let shown = [self.viewer.picture(RendererId::A), self.viewer.window()];
        let before = self.shown.get_or_insert_with(|| shown.clone());
        for ((now, before), what) in shown.iter().zip(before.iter()).zip(["A", "the window"]) {
            assert!(now.rgb == before.rgb, "{what} does not look as before: {}", difference(now, before));
        }
        self.viewer.shell.panels.hidden = false;
        reference
    }
}

/// Bytes of memory that this process has in RAM.
fn resident() -> u64 {
    let text = fs::read_to_string("/proc/self/statm").expect("there is a /proc");
    let pages: u64 = text.split(' ').nth(1).and_then(|pages| pages.parse().ok()).expect("a number of pages");
    pages * 4096
}

fn open_files() -> usize {
    fs::read_dir("/proc/self/fd").expect("there is a /proc").count()
}

/// The names of the threads, sorted. Mesa writes its cache of shaders on disk with up to four threads, which it starts when it has
/// much to write: these are left out.
fn threads() -> Vec<String> {
    let tasks = fs::read_dir("/proc/self/task").expect("there is a /proc");
    // One that ends meanwhile has no name any more.
    let name = |task: std::io::Result<fs::DirEntry>| fs::read_to_string(task.ok()?.path().join("comm")).ok();
    let names = tasks.filter_map(name).map(|name| name.trim_end().to_owned());
    let mut names: Vec<String> = names.filter(|name| !name.contains(":disk$")).collect();
    names.sort();
    names
}

/// The threads, once those that are done are gone.
fn settled_threads() -> Vec<String> {
    let mut least = threads();
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_millis(50) {
        std::thread::sleep(Duration::from_millis(5));
        let now = threads();
        if now.len() < least.len() {
            least = now;
        }
    }
    least
}

/// In which pixels two pictures differ, in words.
fn difference(now: &Image, before: &Image) -> String {
    if (now.width, now.height) != (before.width, before.height) {
        return format!("{} x {}, and was {} x {}", now.width, now.height, before.width, before.height);
    }
    let differ: Vec<usize> = (0..now.rgb.len()).filter(|i| now.rgb[*i] != before.rgb[*i]).collect();
    let range = |of: &dyn Fn(usize) -> usize| {
        let all = || differ.iter().map(|i| of(*i));
        (all().min().unwrap_or(0), all().max().unwrap_or(0))
    };
    let (x, y) = (range(&|i| i % now.width), range(&|i| i / now.width));
    format!("{} pixels differ, from {} to {} across and {} to {} down", differ.len(), x.0, x.1, y.0, y.1)
}
