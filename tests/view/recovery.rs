//! Things are broken and repaired repeatedly: picture and memory afterwards must be as before.
//!
//! Each cycle breaks one thing of every kind: a graph, a shader, a scene, a size, an inspection, and the device itself,
//! which is closed and reopened as after its loss. `SPLATGRAPH_LONG` runs more cycles. `SPLATGRAPH_RECOVERY=FILE.csv`
//! writes a row after each step, for a plot.

use super::soak::process::resident;
use super::whole::{PATIENCE, TestShell};
use crate::common;
use crate::place::shipped;
use splatgraph::draw::backend::Validation;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph_api::Device;
use std::fs::File;
use std::io::Write;
use std::process::Command;
use std::time::Instant;

const SIZE: (u32, u32) = (400, 225);
const SPLATS: u32 = 2_000;

/// The graph and one of its shaders.
const GRAPH: &str = "pipelines/splat.ron";
const SHADER: &str = "shaders/project.comp";

/// A graph that the graph includes, and a file that the shader includes.
const INCLUDE: &str = "pipelines/parts/sort.ron";
const HEADER: &str = "shaders/camera.glsl";

/// Tolerance for sums of memory. As in the soak test, the allocator's padding depends on earlier allocations.
const PADDING_BYTES: u64 = 4 << 10;

struct Cycles {
    viewer: TestShell,
    begun: Instant,
    table: Option<File>,
    /// A's picture and memory after the first repair, which every later repair must restore.
    sound: Option<(Image, Vec<(String, u64)>)>,
}

#[test]
fn whatever_is_broken_and_mended_the_picture_and_the_memory_are_those_from_before() {
    common::alone(
        "view::recovery::whatever_is_broken_and_mended_the_picture_and_the_memory_are_those_from_before",
        || {
            let mut cycles = Cycles::begin();
            for cycle in 0..if common::long() { 40 } else { 2 } {
                cycles.run(cycle);
            }
            cycles.viewer.close();
        },
    );
}

impl Cycles {
    fn begin() -> Cycles {
        let mut viewer = TestShell::new(&common::options(Validation::Off), ("demo", SPLATS), GRAPH, SIZE);
        viewer.shell.panels.hidden = true;
        viewer.settle();
        let table = std::env::var_os("SPLATGRAPH_RECOVERY").map(|path| {
            let mut table = File::create(path).expect("the table can be written");
            writeln!(table, "cycle,kind,state,seconds,mended_ms,gpu_bytes,rss_bytes").expect("it is written");
            table
        });
        Cycles { viewer, begun: Instant::now(), table, sound: None }
    }

    fn run(&mut self, cycle: u32) {
        self.broken_file(cycle, "graph", GRAPH, "Graph(");
        let shader = shipped(SHADER).replacen("void main() {", "void main() {\n    int i = undeclared;", 1);
        self.broken_file(cycle, "shader", SHADER, &shader);
        for (kind, name) in
            [("graph", GRAPH), ("include", INCLUDE), ("shader", SHADER), ("shader's include", HEADER)]
        {
            self.no_file(cycle, kind, name);
        }
        self.broken_scene(cycle);
        self.broken_inspection(cycle);
        self.odd_sizes(cycle);
        self.lost_device(cycle);
    }

    fn device_memory(&self) -> u64 {
        let shell = &self.viewer.shell;
        let devices = [shell.window().device(), shell.viewer.a.renderer.device()];
        devices.into_iter().flatten().map(|device| device.device_memory().used).sum()
    }

    fn note(&mut self, cycle: u32, kind: &str, state: &str, mended: Option<Instant>) {
        let memory = self.device_memory();
        let mended =
            mended.map_or(String::new(), |since| format!("{:.0}", since.elapsed().as_secs_f64() * 1e3));
        if let Some(table) = &mut self.table {
            let seconds = self.begun.elapsed().as_secs_f64();
            let rss = resident();
            writeln!(table, "{cycle},{kind},{state},{seconds:.3},{mended},{memory},{rss}")
                .expect("it is written");
        }
    }

    fn check(&mut self, kind: &str) {
        self.viewer.settle();
        let picture = self.viewer.picture(RendererId::A);
        // Leaves out readback buffers, which are recreated with a new plan.
        let device = self.viewer.shell.viewer.a.renderer.device().expect("the device is there");
        let memory: Vec<(String, u64)> =
            device.memory().into_iter().filter(|(name, _)| !name.contains("readback")).collect();
        match &self.sound {
            None => self.sound = Some((picture, memory)),
            Some((sound, before)) => {
                assert!(picture.rgb == sound.rgb, "another picture after {kind}");
                let sum = |list: &[(String, u64)]| list.iter().map(|(_, bytes)| bytes).sum::<u64>();
                assert!(
                    sum(&memory).abs_diff(sum(before)) <= PADDING_BYTES,
                    "after {kind}: {memory:#?}, and before {before:#?}"
                );
            }
        }
    }

    fn broken_file(&mut self, cycle: u32, kind: &str, name: &str, text: &str) {
        let shipped = shipped(name);
        self.viewer.place.write(name, text);
        self.viewer.until("the mistake", |viewer| viewer.shell.viewer.a.renderer.failure().is_some());
        self.note(cycle, kind, "broken", None);
        let since = Instant::now();
        self.viewer.place.write(name, shipped);
        self.viewer.until("the mending", |viewer| viewer.shell.viewer.a.renderer.failure().is_none());
        self.note(cycle, kind, "mended", Some(since));
        self.check(kind);
    }

    /// Replaces a file with a named pipe, which would block a reader, and restores the file.
    fn no_file(&mut self, cycle: u32, kind: &str, name: &str) {
        let (shipped, path) = (shipped(name), self.viewer.place.at(name));
        std::fs::remove_file(&path).expect("it is removed");
        assert!(Command::new("mkfifo").arg(&path).status().expect("mkfifo runs").success());
        self.viewer.until("the pipe", |viewer| {
            let failure = viewer.shell.viewer.a.renderer.failure();
            failure.is_some_and(|failure| failure.text(false).contains("is a pipe, not a file"))
        });
        self.note(cycle, &format!("pipe for the {kind}"), "broken", None);
        let since = Instant::now();
        std::fs::remove_file(&path).expect("it is removed");
        self.viewer.place.write(name, shipped);
        self.viewer.until("the mending", |viewer| viewer.shell.viewer.a.renderer.failure().is_none());
        self.note(cycle, &format!("pipe for the {kind}"), "mended", Some(since));
        self.check("a pipe");
    }

    fn broken_scene(&mut self, cycle: u32) {
        self.viewer.place.write("broken.ply", "ply\nformat ascii 1.0\nelement vertex 3\n");
        let (broken, whole) = (self.viewer.place.at("broken.ply"), self.viewer.place.at("scene.ply"));
        let seen = self.viewer.events.len();
        self.viewer.shell.viewer.open(&broken);
        self.viewer.until("the error", |viewer| {
            viewer.events[seen..].iter().any(|event| matches!(event, Event::SceneFailed { .. }))
        });
        self.note(cycle, "scene", "broken", None);
        let since = Instant::now();
        let navigation = self.viewer.shell.viewer.navigation.clone();
        self.viewer.shell.viewer.open(&whole);
        self.viewer.until("the scene", |viewer| {
            viewer.events[seen..].iter().any(|event| matches!(event, Event::Scene { .. }))
        });
        self.note(cycle, "scene", "mended", Some(since));
        self.viewer.shell.viewer.navigation = navigation;
        self.check("a broken scene");
    }

    fn broken_inspection(&mut self, cycle: u32) {
        self.viewer.shell.viewer.a.look_at("nothing", "nowhere");
        self.viewer.settle();
        self.note(cycle, "inspection", "broken", None);
        let since = Instant::now();
        self.viewer.shell.viewer.a.inspection = None;
        self.viewer.settle();
        self.note(cycle, "inspection", "mended", Some(since));
        self.check("an inspection");
    }

    fn odd_sizes(&mut self, cycle: u32) {
        for size in [(0, 0), (1, 1), (1200, 16)] {
            self.viewer.size = size;
            for _ in 0..3 {
                self.viewer.frame();
            }
        }
        self.viewer.settle();
        self.note(cycle, "size", "broken", None);
        let since = Instant::now();
        self.viewer.size = SIZE;
        self.viewer.settle();
        self.note(cycle, "size", "mended", Some(since));
        self.check("odd sizes");
    }

    fn lost_device(&mut self, cycle: u32) {
        self.viewer.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        self.viewer.shell.release();
        let begun = Instant::now();
        while !self.viewer.shell.is_released() {
            assert!(begun.elapsed() < PATIENCE, "a build holds the device");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        self.note(cycle, "device", "broken", None);
        let since = Instant::now();
        let canvas = common::open(&common::options(Validation::Off));
        let options = common::options(Validation::Off);
        let device = canvas.open_beside(&options).expect("a device for the scene");
        self.viewer.shell.give(canvas, device).expect("there is no B");
        self.viewer.until("a picture", |viewer| viewer.shell.viewer.pictures()[0].is_some());
        self.note(cycle, "device", "mended", Some(since));
        self.check("the loss of the device");
    }
}
