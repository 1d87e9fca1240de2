//! Formats the `splatgraph render` command that reproduces a picture.
//!
//! The command contains the camera as JSON, in world coordinates, with all digits.

use crate::draw::planner;
use crate::io::output::shell_word;
use splatgraph_assets::Camera;
use std::path::Path;

/// Inputs of a picture.
#[derive(Clone, Copy, Debug)]
pub struct RenderCommand<'a, S> {
    /// Path of the scene file.
    pub scene: &'a Path,
    /// Camera in world coordinates, with the size of the picture.
    pub camera: &'a Camera,
    /// Graph: the name of a built-in graph, or a path.
    pub graph: &'a str,
    /// Parameter values, as pairs of name and value.
    pub set: S,
    /// Background colour, display-encoded.
    pub background: [f32; 3],
    /// File to which the command writes the picture.
    pub output: &'a Path,
}

impl<'a, S: IntoIterator<Item = (&'a str, &'a str)>> RenderCommand<'a, S> {
    /// Formats the command for a POSIX shell.
    pub fn line(self) -> String {
        let RenderCommand { scene, camera, graph, set, background, output } = self;
        // `cameras.json` is a list.
        let camera_json = serde_json::to_string(&[camera]).unwrap_or_default();
        let mut words = vec!["splatgraph".to_owned(), "render".to_owned(), file(scene)];
        let mut add = |option: &str, value: String| words.extend([option.to_owned(), value]);
        add("--cameras", camera_json);
        // Redundant, because the camera has this size, but easier to edit than the JSON.
        add("--size", format!("{}x{}", camera.width, camera.height));
        add("--pipeline", graph.to_owned());
        set.into_iter().for_each(|(name, value)| add("--set", format!("{name}={value}")));
        if background != [0.0; 3] {
            add("--background", background.map(|channel| channel.to_string()).join(","));
        }
        planner::settings().include_roots.iter().for_each(|root| add("--include-root", file(root)));
        add("--output", file(output));
        words.iter().map(|word| shell_word(word)).collect::<Vec<_>>().join(" ")
    }
}

/// Formats a path so that it cannot be mistaken for an option.
fn file(path: &Path) -> String {
    let name = path.display().to_string();
    if name.starts_with('-') { format!("./{name}") } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_input_of_the_picture_is_in_the_command_and_words_are_quoted() {
        let camera = Camera {
            img_name: "it's".into(),
            ..Camera::looking_at([0.1, 0.2, 0.3], [1.0, 2.0, 3.0], 60.0, (64, 48))
        };
        let command = RenderCommand {
            scene: Path::new("-a scene.ply"),
            camera: &camera,
            graph: "tiled",
            set: [("cutoff", "3.0"), ("mode", "a b")],
            background: [0.25, 0.1, 1.0],
            output: Path::new("picture.png"),
        };
        let line = command.line();
        let words = format!("printf '%s\\n' {}", line.strip_prefix("splatgraph render ").unwrap());
        let output = std::process::Command::new("sh").args(["-c", &words]).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let words: Vec<&str> = text.lines().collect();
        let json = serde_json::to_string(&[&camera]).unwrap();
        assert_eq!(
            words,
            [
                "./-a scene.ply",
                "--cameras",
                &json,
                "--size",
                "64x48",
                "--pipeline",
                "tiled",
                "--set",
                "cutoff=3.0",
                "--set",
                "mode=a b",
                "--background",
                "0.25,0.1,1",
                "--output",
                "picture.png"
            ]
        );
    }
}
