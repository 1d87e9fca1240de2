//! Thousands of frames of the whole viewer under constant change.
//!
//! A seeded generator acts every few frames: it edits, breaks and mends files, changes parameters, graphs and scenes,
//! resizes the window, compares and inspects pictures, and moves and clicks the mouse. At intervals everything is
//! restored to the same reference state, which must be as before: equal pictures, and no more memory.
//!
//! These must hold:
//!
//! - The validation layers, including synchronization validation, report nothing, and no thread panics.
//! - **No frame is lost.** Every requested frame draws one of A once A has a plan, and one of B if B is shown and has a
//!   plan, whatever is being built, broken or resized meanwhile. This includes windows of size 0: the pictures keep
//!   their former size.
//! - In the reference state, the pictures have the same pixels each time.
//! - The memory of the device and of the process, its open files and its threads do not grow: see [`check_growth`].
//!
//! `SPLATGRAPH_LONG` runs 10,000 frames, and the test prints each reference state.
//! `SPLATGRAPH_SOAK_BARE` leaves the validation layers out, and so their memory.

mod deeds;
mod process;

use super::whole::{PATIENCE, TestShell};
use crate::common;
use crate::numbers::Random;
use deeds::{DEEDS, GRAPHS};
use egui::Event as Input;
use indexmap::IndexMap;
use process::{resident, settled};
use splatgraph::draw::backend::Validation;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::navigation::Navigation;
use splatgraph::view::paint::Mode;
use splatgraph::view::renderer::Renderer;
use splatgraph_api::Device;
use splatgraph_api::DeviceMemory;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// The window size in the reference state.
const SIZE: (u32, u32) = (400, 225);
/// Pixels of the picture per pixel of the window in the reference state: the picture has 64 x 36 pixels.
const SCALE: f32 = 0.16;
const SPLATS: u32 = 2_000;

struct Length {
    frames: u64,
    /// Frames from one reference state to the next.
    cycle: u64,
    /// Tolerated growth of the resident memory from the middle third to the last, in bytes.
    noise: u64,
}

/// A short run. The driver, the validation layers and the shader compilers are still filling their caches, so the
/// resident memory shows only a leak in every frame. The device's memory is exact.
const SHORT: Length = Length { frames: 600, cycle: 60, noise: 96 << 20 };
/// A long run. The tolerance covers freed memory that allocators keep, and the caches of the shader compilers.
const LONG: Length = Length { frames: 10_000, cycle: 500, noise: 24 << 20 };

/// Tolerance for the device's memory. Its allocator counts alignment gaps as part of the next allocation, and the gaps
/// depend on earlier allocations.
const PADDING_BYTES: u64 = 4 << 10;

/// Maximum bytes of texels: a buffer per frame in flight, with a power of two bytes. egui packs its glyphs into at most
/// 2048 x 2048 texels.
const MAX_TEXELS: u64 = 2 * (32 << 20);

/// Tolerated growth of the resident memory per frame, in bytes: allocators keep freed memory.
const FRAME_NOISE: u64 = 64 << 10;

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

/// Draws the window with its default tools. Compositions of A alone and of A and B have different draws, whose memory
/// must not grow either: a driver may keep something of each.
#[test]
fn frames_of_a_window_of_usual_size_leave_no_memory_behind() {
    common::alone("view::soak::frames_of_a_window_of_usual_size_leave_no_memory_behind", || {
        let mut viewer = TestShell::open(Validation::Off, ("demo", SPLATS), GRAPHS[0], &[], (900, 560));
        viewer.pixels_per_point = 1.0;
        viewer.shell.viewer.scale = SCALE;
        for mode in [Mode::A, Mode::Split] {
            viewer.shell.viewer.set_compare(mode).unwrap_or_else(|error| panic!("{error}"));
            viewer.settle();
            viewer.frames(60);
            let before = resident();
            viewer.frames(120);
            let grown = resident().saturating_sub(before) / 120;
            println!("{mode:?}: {grown} bytes per frame");
            assert!(grown <= FRAME_NOISE, "{mode:?}: the resident memory grew by {grown} bytes per frame");
        }
        viewer.close();
    });
}

fn soak(length: Length) {
    let mut soak = Soak::begin();
    let mut references = Vec::new();
    while soak.viewer.calls < length.frames {
        let cycle = references.len() as u64 + 1;
        soak.disturb(cycle * length.cycle);
        soak.restore(cycle);
        let reference = soak.reference();
        println!("{reference:?}");
        references.push(reference);
    }
    let Soak { viewer, begun, deeds, plans, failures, .. } = &soak;
    let (frames, seconds) = (viewer.calls, begun.elapsed().as_secs());
    println!("{frames} frames in {seconds} s: {deeds} deeds, {plans} plans, {failures} failures");
    assert_eq!(PANICS.load(Ordering::Relaxed), 0, "something panicked");
    check_growth(&references, length.noise);
    soak.viewer.close();
}

/// Fails if the median of the resident memory grows by over `noise` bytes from the middle third to the last. The first
/// third of the run fills caches. After the first third, open files, threads and the listed bytes must stay the same,
/// and the device's memory except for padding and egui's textures.
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
            "what A, B and the window list: {reference:?}, and once {warm:?}"
        );
        assert!(reference.texels <= MAX_TEXELS, "{reference:?}");
        let other = |reference: &Reference| reference.device.used - reference.texels;
        let more = other(reference).abs_diff(other(warm));
        assert!(more <= PADDING_BYTES, "{reference:?}, and once {warm:?}");
        assert!(reference.device.reserved <= warm.device.reserved, "{reference:?}, and once {warm:?}");
        assert_eq!(reference.files, warm.files, "open files");
        assert_eq!(reference.threads, warm.threads, "threads, at {reference:?}");
    }
}

/// Measurements in the reference state.
#[derive(Clone, Debug, PartialEq)]
struct Reference {
    call: u64,
    /// Bytes that A, B and the window list, without egui's texels.
    listed: [u64; 3],
    /// Bytes of egui's textures. They grow when a glyph is drawn for the first time, until egui repacks them.
    texels: u64,
    /// Bytes of the device, with the texels.
    device: DeviceMemory,
    rss: u64,
    files: usize,
    threads: Vec<String>,
}

fn device_memory(viewer: &TestShell) -> DeviceMemory {
    let shell = &viewer.shell;
    let of = |renderer: &Renderer| renderer.device().expect("the device is not lost").device_memory();
    let (window, scene) = (of(shell.window()), of(&shell.viewer.a.renderer));
    DeviceMemory { used: window.used + scene.used, reserved: window.reserved + scene.reserved }
}

struct Soak {
    viewer: TestShell,
    dice: Random,
    begun: Instant,
    /// The camera of the reference state.
    start: Navigation,
    /// Files that differ from the shipped ones.
    edited: BTreeSet<String>,
    /// Counter that makes texts differ.
    number: u64,
    deeds: u64,
    plans: u64,
    failures: u64,
    /// Pictures of the reference state, A and the window; `None` before the first.
    shown: Option<[Image; 2]>,
    scenes: [&'static str; 3],
}

impl Soak {
    /// Opens a viewer and draws frames until nothing is being built.
    fn begin() -> Soak {
        let bare = std::env::var_os("SPLATGRAPH_SOAK_BARE").is_some();
        let validation = if bare { Validation::Off } else { Validation::Synchronization };
        let viewer = TestShell::open(validation, ("demo", SPLATS), GRAPHS[0], &[], SIZE);
        let scenes = ["scene.ply", "smaller.ply", "larger.ply"];
        for (name, generator, splats) in [(scenes[1], "uniform", 700), (scenes[2], "demo", 3_100)] {
            viewer.place.scene(name, generator, splats, 1);
        }
        let start = viewer.shell.viewer.navigation.clone();
        let mut soak = Soak {
            viewer,
            dice: Random(1),
            begun: Instant::now(),
            start,
            edited: BTreeSet::new(),
            number: 0,
            deeds: 0,
            plans: 0,
            failures: 0,
            shown: None,
            scenes,
        };
        soak.viewer.settle();
        soak
    }

    /// Performs a random action every 1 to 5 frames, at least up to frame `end`.
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

    /// Takes the viewer's events; counts new plans and errors. Fails on an internal error.
    fn note(&mut self) {
        for event in std::mem::take(&mut self.viewer.events) {
            match event {
                Event::Swapped { .. } => self.plans += 1,
                Event::Failed { text, .. } => {
                    assert!(!text.contains("internal error"), "{text}");
                    self.failures += 1;
                }
                _ => {}
            }
        }
    }

    /// Waits for frames in flight. Returns the number of due frames of A, B and the window that were not drawn.
    fn lost(&mut self) -> u64 {
        let drawn = self.viewer.drawn();
        assert!(drawn <= self.viewer.due, "{drawn} frames were drawn, and {} were due", self.viewer.due);
        self.viewer.due - drawn + self.viewer.undrawn_windows
    }

    /// Draws frames until the planned input was delivered and the reference state is restored. `cycle` must differ in
    /// every call.
    fn restore(&mut self, cycle: u64) {
        let input_is_over = |viewer: &mut TestShell| viewer.input.is_empty();
        self.viewer.until("the end of the input", input_is_over);
        self.viewer.plan([Input::PointerGone]);
        self.viewer.size = SIZE;
        self.viewer.frame();
        self.edited.clear();
        self.viewer.shell.panels.hidden = true;
        // The display of times would differ every time.
        self.viewer.shell.panels.hud = false;
        self.viewer.shell.panels.help = false;
        let scene = self.viewer.place.at(self.scenes[0]);
        let is_loaded = |viewer: &mut TestShell| viewer.shell.viewer.loading(RendererId::A).is_none();
        self.viewer.until("the end of loading", is_loaded);
        if self.viewer.shell.viewer.scene_path() != scene {
            self.viewer.shell.viewer.open(&scene);
            self.viewer.until("the scene", is_loaded);
        }
        let graph = self.viewer.place.at(GRAPHS[0]);
        let viewer = &mut self.viewer.shell.viewer;
        // Shows B as well, so that it is rebuilt, too.
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
        // Notifications fade out.
        self.viewer.frames(30);
        // Buffers that grow on demand are recreated with a new plan. A new size causes one.
        for size in [(SIZE.0 + 2, SIZE.1 + 2), SIZE] {
            self.viewer.size = size;
            self.viewer.settle();
        }
        self.viewer.shell.viewer.set_compare(Mode::A).unwrap_or_else(|error| panic!("{error}"));
        self.viewer.frames(4);
        self.note();
    }

    /// Measures the reference state. Fails if a frame was lost, or if a picture differs from that of the first call.
    ///
    /// Afterwards the panels and the display of times are shown again.
    fn reference(&mut self) -> Reference {
        assert_eq!(self.lost(), 0, "frames were lost");
        self.viewer.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        let shell = &self.viewer.shell;
        let b = shell.viewer.b.as_ref().and_then(|b| b.renderer.device());
        let lists = [
            shell.viewer.a.renderer.device().map(Device::memory).unwrap_or_default(),
            b.map(|b| b.memory()).unwrap_or_default(),
            shell.window().device().map(Device::memory).unwrap_or_default(),
        ];
        let is_texels = |name: &str| name == "ui_texels";
        let sum = |list: &[(String, u64)], wanted: &dyn Fn(&str) -> bool| {
            list.iter().filter(|(name, _)| wanted(name)).map(|(_, bytes)| bytes).sum::<u64>()
        };
        let (files, threads) = settled();
        let reference = Reference {
            call: self.viewer.calls,
            listed: [0, 1, 2].map(|i: usize| sum(&lists[i], &|name| !is_texels(name))),
            texels: sum(&lists[2], &is_texels),
            device: device_memory(&self.viewer),
            rss: resident(),
            files,
            threads,
        };
        let shown = [self.viewer.picture(RendererId::A), self.viewer.window()];
        let before = self.shown.get_or_insert_with(|| shown.clone());
        for ((now, before), what) in shown.iter().zip(before.iter()).zip(["A", "the window"]) {
            let differ = now.rgb.iter().zip(&before.rgb).filter(|(now, before)| now != before).count();
            assert!(now.rgb == before.rgb, "{what} does not look as before: {differ} pixels differ");
        }
        self.viewer.shell.panels.hidden = false;
        self.viewer.shell.panels.hud = true;
        reference
    }
}
