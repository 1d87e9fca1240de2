//! Things are broken and repaired repeatedly: picture and memory afterwards must be as before.
//!
//! Each cycle breaks one thing of every kind: a graph, a shader, a scene, a size, an inspection, a file that a pipe
//! replaces, and the device itself, which is closed and reopened as after its loss. `SPLATGRAPH_LONG` runs more cycles.

use super::whole::{PATIENCE, TestShell};
use crate::common;
use crate::place::shipped;
use splatgraph::draw::backend::Validation;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph_api::Device;
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
    /// A's picture and memory after the first repair, which every later repair must restore.
    sound: Option<(Image, Vec<(String, u64)>)>,
}

#[test]
fn whatever_is_broken_and_mended_the_picture_and_the_memory_are_those_from_before() {
    common::alone(
        "view::recovery::whatever_is_broken_and_mended_the_picture_and_the_memory_are_those_from_before",
        || {
            let mut cycles = Cycles::begin();
            (0..if common::long() { 40 } else { 2 }).for_each(|_| cycles.run());
            cycles.viewer.close();
        },
    );
}

impl Cycles {
    fn begin() -> Cycles {
        let mut viewer = TestShell::open(Validation::Off, ("demo", SPLATS), GRAPH, &[], SIZE);
        viewer.shell.panels.hidden = true;
        viewer.settle();
        Cycles { viewer, sound: None }
    }

    fn run(&mut self) {
        self.broken_file(GRAPH, "Graph(");
        let shader = shipped(SHADER).replacen("void main() {", "void main() {\n    int i = undeclared;", 1);
        self.broken_file(SHADER, &shader);
        [GRAPH, INCLUDE, SHADER, HEADER].into_iter().for_each(|name| self.no_file(name));
        self.broken_scene();
        self.broken_inspection();
        self.odd_sizes();
        self.lost_device();
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

    fn broken_file(&mut self, name: &str, text: &str) {
        self.viewer.place.write(name, text);
        self.viewer.until("the mistake", |viewer| viewer.shell.viewer.a.renderer.failure().is_some());
        self.mend(name);
        self.check(&format!("a mistake in {name}"));
    }

    fn mend(&mut self, name: &str) {
        self.viewer.place.write(name, shipped(name));
        self.viewer.until("the mending", |viewer| viewer.shell.viewer.a.renderer.failure().is_none());
    }

    /// Replaces a file with a named pipe, which would block a reader, and restores the file.
    fn no_file(&mut self, name: &str) {
        let path = self.viewer.place.at(name);
        std::fs::remove_file(&path).expect("it is removed");
        assert!(Command::new("mkfifo").arg(&path).status().expect("mkfifo runs").success());
        self.viewer.until("the pipe", |viewer| {
            let failure = viewer.shell.viewer.a.renderer.failure();
            failure.is_some_and(|failure| failure.text(false).contains("is a pipe, not a file"))
        });
        std::fs::remove_file(&path).expect("it is removed");
        self.mend(name);
        self.check(&format!("a pipe for {name}"));
    }

    fn broken_scene(&mut self) {
        self.viewer.place.write("broken.ply", "ply\nformat ascii 1.0\nelement vertex 3\n");
        let (broken, whole) = (self.viewer.place.at("broken.ply"), self.viewer.place.at("scene.ply"));
        self.viewer.shell.viewer.open(&broken);
        self.viewer.event("the error", |event| matches!(event, Event::SceneFailed { .. }));
        let navigation = self.viewer.shell.viewer.navigation.clone();
        self.viewer.shell.viewer.open(&whole);
        self.viewer.event("the scene", |event| matches!(event, Event::Scene { .. }));
        self.viewer.shell.viewer.navigation = navigation;
        self.check("a broken scene");
    }

    fn broken_inspection(&mut self) {
        self.viewer.shell.viewer.a.look_at("nothing", "nowhere");
        self.viewer.settle();
        self.viewer.shell.viewer.a.inspection = None;
        self.check("an inspection");
    }

    fn odd_sizes(&mut self) {
        for size in [(0, 0), (1, 1), (1200, 16)] {
            self.viewer.size = size;
            self.viewer.frames(3);
        }
        self.viewer.settle();
        self.viewer.size = SIZE;
        self.check("odd sizes");
    }

    fn lost_device(&mut self) {
        self.viewer.shell.finish(PATIENCE).unwrap_or_else(|error| panic!("the frames end: {error}"));
        self.viewer.shell.release();
        let begun = Instant::now();
        while !self.viewer.shell.is_released() {
            assert!(begun.elapsed() < PATIENCE, "a build holds the device");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let options = common::options(Validation::Off);
        let canvas = common::open(&options);
        let device = canvas.open_beside(&options).expect("a device for the scene");
        self.viewer.shell.give(canvas, device).expect("there is no B");
        self.viewer.until("a picture", |viewer| viewer.shell.viewer.pictures()[0].is_some());
        self.check("the loss of the device");
    }
}
