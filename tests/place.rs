//! A folder in which tests run the program as a user would.

use crate::common;
use serde_json::Value;
use splatgraph::draw::builtin;
use splatgraph::io::image::Image;
#[cfg(target_os = "linux")]
use splatgraph_assets::Camera;
use splatgraph_assets::{Scene, synth};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// Size of the pictures of [`Place::cameras`], in pixels.
#[cfg(target_os = "linux")]
pub const SIZE: (u32, u32) = (64, 48);

/// Command line that draws all cameras with a cheap preset. The output path must be appended.
#[cfg(target_os = "linux")]
pub const DRAW: &str = "render scene.ply --cameras cameras.json --pipeline unsorted --device llvmpipe -o";

/// A command line: a list of words, or a text that is split at spaces outside single quotes.
pub trait Line {
    fn words(&self) -> Vec<&str>;
}

impl Line for str {
    fn words(&self) -> Vec<&str> {
        let mut words = Vec::new();
        for (index, part) in self.split('\'').enumerate() {
            match index % 2 {
                1 => words.push(part),
                _ => words.extend(part.split(' ').filter(|word| !word.is_empty())),
            }
        }
        words
    }
}

impl Line for String {
    fn words(&self) -> Vec<&str> {
        self.as_str().words()
    }
}

impl<S: AsRef<str>> Line for [S] {
    fn words(&self) -> Vec<&str> {
        self.iter().map(AsRef::as_ref).collect()
    }
}

impl<S: AsRef<str>, const N: usize> Line for [S; N] {
    fn words(&self) -> Vec<&str> {
        self.as_slice().words()
    }
}

impl<S: AsRef<str>> Line for Vec<S> {
    fn words(&self) -> Vec<&str> {
        self.as_slice().words()
    }
}

pub struct Place(tempfile::TempDir);

impl Place {
    pub fn empty() -> Place {
        Place(tempfile::tempdir().expect("a folder"))
    }

    /// Makes a folder with `pipelines/` and `shaders/` as they are shipped.
    pub fn shipped() -> Place {
        let place = Place::empty();
        builtin::FILES.iter().for_each(|(name, text)| place.write(name, text));
        place
    }

    /// Makes a folder with a small scene, `scene.ply`.
    #[cfg(target_os = "linux")]
    pub fn new() -> Place {
        let place = Place::empty();
        scene().write_ply(place.at("scene.ply")).expect("the scene is written");
        place
    }

    /// Makes a folder with the demo scene and its cameras: `scene.ply`, `cameras.json`.
    pub fn demo(splats: u32) -> Place {
        let place = Place::empty();
        place.done(&format!("synth demo --count {splats} -o scene.ply --cameras cameras.json"));
        place
    }

    /// Writes `mean.ron`, which averages the pictures of `auto` over frames, and `again.ron`, an equal preset.
    pub fn average(&self) {
        let bind = r#"{ "picture": "scene.picture", "mean": "mean", "shown": "shown" }"#;
        let size = r#"size: ("viewport.width", "viewport.height")"#;
        self.write(
            "mean.ron",
            format!(
                r#"Graph(version: 1, summary: "an average over frames",
                params: {{ "keep": Live(Float(default: 0.5, range: (0.0, 1.0), label: "keep")) }},
                resources: {{
                    "mean": Image(format: "rgba32f", {size}, history: true), "shown": Image(format: "rgba32f", {size}),
                }},
                passes: [
                    Include(graph: "auto", name: "scene", expose: All),
                    Dispatch(name: "mean", shader: "mean.comp", size: Threads("viewport.width", "viewport.height"), bind: {bind}),
                ],
                output: "shown")"#
            ),
        );
        self.write(
            "mean.comp",
            "#version 460
            #extension GL_GOOGLE_include_directive : require
            #include \"live.glsl\"
            layout(local_size_x = 8, local_size_y = 8) in;
            layout(set = 0, binding = 0, rgba32f) readonly uniform image2D picture;
            layout(set = 0, binding = 1, rgba32f) uniform image2D mean;
            layout(set = 0, binding = 2, rgba32f) writeonly uniform image2D shown;
            void main() {
                ivec2 at = ivec2(gl_GlobalInvocationID.xy);
                if (any(greaterThanEqual(at, imageSize(picture)))) return;
                vec4 m = mix(imageLoad(picture, at), imageLoad(mean, at), keep);
                imageStore(mean, at, m);
                imageStore(shown, at, m);
            }",
        );
        self.write("again.ron", r#"Preset(graph: "mean.ron", summary: "equal", set: { "keep": 0.5 })"#);
    }

    pub fn at(&self, name: impl AsRef<Path>) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn named(&self, name: &str) -> String {
        self.at(name).to_string_lossy().into_owned()
    }

    pub fn scene(&self, name: &str, generator: &str, splats: u32, seed: u64) -> Scene {
        let scene = synth::generate(generator, splats, seed).expect("the scene is generated");
        scene.write_ply(self.at(name)).expect("the scene is written");
        scene
    }

    /// Writes `cameras.json`: copies of one camera with the given names.
    #[cfg(target_os = "linux")]
    pub fn cameras(&self, names: &[&str]) {
        let first = synth::demo_cameras().swap_remove(0);
        let named = |name: &&str| Camera { img_name: (*name).into(), ..first.resized(SIZE.0, SIZE.1) };
        let all: Vec<Camera> = names.iter().map(named).collect();
        Camera::save(&all, self.at("cameras.json")).expect("cameras are written");
    }

    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        let path = self.at(name);
        fs::create_dir_all(path.parent().expect("a folder"))
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        fs::write(path, text).unwrap_or_else(|error| panic!("{name}: {error}"));
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.at(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn text(&self, name: &str) -> String {
        fs::read_to_string(self.at(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Replaces the first `from` in a file; fails if there is none. Returns the file's former text.
    pub fn edit(&self, name: &str, from: &str, to: &str) -> String {
        let text = self.text(name);
        assert!(text.contains(from), "{name} has no `{from}`");
        self.write(name, text.replacen(from, to, 1));
        text
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.bytes(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn image(&self, name: &str) -> Image {
        Image::load(&self.at(name)).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Returns the program as a command that runs in this folder, without a display and with empty standard input.
    pub fn program(&self, line: &(impl Line + ?Sized)) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_splatgraph"));
        command.args(line.words()).current_dir(self.0.path()).stdin(Stdio::null());
        for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
            command.env_remove(name);
        }
        command
    }

    /// Runs the program. `render` and `video` use the tests' device, unless the line names a device or a backend.
    pub fn run(&self, line: &(impl Line + ?Sized)) -> Output {
        let words = line.words();
        let draws = matches!(words.first(), Some(&("render" | "video")));
        let device =
            common::device_option().filter(|_| draws && !words.iter().any(|word| names_device(word)));
        self.program(&words).args(device).output().expect("the program runs")
    }

    pub fn code(&self, line: &(impl Line + ?Sized)) -> (Option<i32>, String) {
        let output = self.run(line);
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    }

    /// Runs the program, which must succeed; returns standard output and standard error.
    pub fn said(&self, line: &(impl Line + ?Sized)) -> (String, String) {
        let output = self.run(line);
        let [text, errors] =
            [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        assert_eq!(output.status.code(), Some(0), "splatgraph {}: {text}{errors}", line.words().join(" "));
        (text, errors)
    }

    pub fn done(&self, line: &(impl Line + ?Sized)) -> String {
        self.said(line).0
    }

    pub fn told(&self, line: &(impl Line + ?Sized)) -> Value {
        serde_json::from_str(&self.done(line))
            .unwrap_or_else(|error| panic!("{}: {error}", line.words().join(" ")))
    }

    pub fn fails(&self, line: &(impl Line + ?Sized), code: i32) -> String {
        let (found, errors) = self.code(line);
        assert_eq!(found, Some(code), "splatgraph {}: {errors}", line.words().join(" "));
        errors
    }

    /// Runs lines that must fail without changing a file. A case is the rest of the line, the exit code and the reason.
    pub fn refuses(&self, begin: &str, cases: &[(&str, i32, &str)]) {
        let before = self.files(".");
        for (more, code, why) in cases {
            let line = format!("{begin} {more}");
            let errors = self.fails(&line, *code);
            assert!(errors.contains(why), "{line}: {errors}");
            assert!(self.files(".") == before, "{line} changes files");
        }
    }

    /// Lists the files below a folder, with their contents. The names begin with `below`.
    pub fn files(&self, below: &str) -> BTreeMap<String, Vec<u8>> {
        let mut found = BTreeMap::new();
        collect(&self.at(below), Path::new(below), &mut found);
        found
    }
}

pub fn shipped(name: &str) -> &'static str {
    builtin::FILES.iter().find(|(file, _)| *file == name).expect("it is shipped").1
}

fn names_device(word: &str) -> bool {
    word.starts_with("--device") || word.starts_with("--backend")
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

/// Generates a scene of 200 splats, which draws quickly.
#[cfg(target_os = "linux")]
pub fn scene() -> Scene {
    synth::generate("demo", 200, 0).expect("the scene is generated")
}
