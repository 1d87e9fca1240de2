//! The outputs of the real program: complete or missing files, refusals, exit codes, and text without terminal escapes.

mod drivers;
mod full;
mod kills;
mod lines;
mod refusals;
mod system;
mod terminal;
pub mod words;

use splatgraph_assets::{Camera, Scene, synth};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// Size of the pictures that are drawn here, in pixels.
const SIZE: (u32, u32) = (64, 48);

/// A folder to run the program in.
pub struct Place(tempfile::TempDir);

impl Place {
    /// Makes a folder with a small scene.
    pub fn new() -> Place {
        let place = Place(tempfile::tempdir().expect("a folder"));
        scene().write_ply(place.at("scene.ply")).expect("the scene is written");
        place
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes `cameras.json` with a camera of each name.
    pub fn cameras(&self, names: &[&str]) {
        let demo = synth::generators().iter().find(|generator| generator.name == "demo");
        let first = demo.map(|demo| (demo.cameras)()).expect("it has cameras").swap_remove(0);
        let named = |name: &&str| Camera { img_name: (*name).into(), ..first.resized(SIZE.0, SIZE.1) };
        let all: Vec<Camera> = names.iter().map(named).collect();
        Camera::save(&all, self.at("cameras.json")).expect("cameras are written");
    }

    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        fs::write(self.at(name), text).unwrap_or_else(|error| panic!("{name}: {error}"));
    }

    /// The program in this folder, without a display.
    pub fn program(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_splatgraph"));
        command.args(args).current_dir(self.0.path()).stdin(Stdio::null());
        for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
            command.env_remove(name);
        }
        command
    }

    pub fn run(&self, args: &[&str]) -> Output {
        self.program(args).output().expect("the program runs")
    }

    /// Runs the program and returns its exit code and standard error.
    pub fn code(&self, args: &[&str]) -> (Option<i32>, String) {
        let output = self.run(args);
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    }

    /// Lists the files below a folder, with their contents.
    pub fn files(&self, below: &str) -> BTreeMap<String, Vec<u8>> {
        let mut found = BTreeMap::new();
        collect(&self.at(below), Path::new(below), &mut found);
        found
    }
}

fn collect(folder: &Path, name: &Path, found: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("an entry").path();
        let name = name.join(path.file_name().expect("a name"));
        if path.is_dir() {
            collect(&path, &name, found);
        } else {
            found.insert(name.display().to_string(), fs::read(&path).expect("a file"));
        }
    }
}

/// Returns a scene that is quick to draw.
pub fn scene() -> Scene {
    synth::generate("demo", 200, 0).expect("the scene is generated")
}

/// The arguments of a quick rendering of all cameras into `out`.
pub const DRAW: [&str; 10] = [
    "render",
    "scene.ply",
    "--cameras",
    "cameras.json",
    "--pipeline",
    "unsorted",
    "--device",
    "llvmpipe",
    "-o",
    "out",
];
