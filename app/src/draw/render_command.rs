//! Formats the `splatgraph render` command that reproduces a picture.
//!
//! The command contains the camera as JSON, in world coordinates, with all digits.

use crate::draw::planner;
use crate::io::load::LoadOptions;
use crate::io::output::shell_word;
use splatgraph_assets::Camera;
use std::path::Path;

/// Formats the command for a POSIX shell.
///
/// `load` are the options with which the scene was loaded. `camera` is in world coordinates and has the size of the
/// picture. `graph` is the name of a built-in graph, or a path; `set` has its parameter values, as pairs of name and
/// value. `background` is display-encoded. The command writes the picture to `output`.
pub fn line<'a>(
    (scene, load): (&Path, &LoadOptions),
    camera: &Camera,
    graph: &str,
    set: impl IntoIterator<Item = (&'a str, &'a str)>,
    background: [f32; 3],
    output: &Path,
) -> String {
    // `cameras.json` is a list.
    let camera_json = serde_json::to_string(&[camera]).unwrap_or_default();
    let mut words = vec!["splatgraph".to_owned(), "render".to_owned(), file(scene)];
    words.extend(load.words());
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

/// Formats a path so that it cannot be mistaken for an option.
fn file(path: &Path) -> String {
    let name = path.display().to_string();
    if name.starts_with('-') { format!("./{name}") } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::load::FileOptions;

    #[test]
    fn every_input_of_the_picture_is_in_the_command_and_words_are_quoted() {
        let camera = Camera {
            img_name: "it's".into(),
            ..Camera::looking_at([0.1, 0.2, 0.3], [1.0, 2.0, 3.0], 60.0, (64, 48))
        };
        let set = [("cutoff", "3.0"), ("mode", "a b")];
        let [scene, output] = ["-a scene.ply", "picture.png"].map(Path::new);
        let condition = Some("x < 2".parse().unwrap());
        let properties = vec!["label".to_owned()];
        let load =
            LoadOptions { file: FileOptions { ignore_tags: true, level: Some(1), properties }, condition };
        let line = line((scene, &load), &camera, "tiled", set, [0.25, 0.1, 1.0], output);
        let words = format!("printf '%s\\n' {}", line.strip_prefix("splatgraph render ").unwrap());
        let output = std::process::Command::new("sh").args(["-c", &words]).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let words: Vec<&str> = text.lines().collect();
        let json = serde_json::to_string(&[&camera]).unwrap();
        assert_eq!(
            words,
            [
                "./-a scene.ply",
                "--ignore-tags",
                "--level",
                "1",
                "--property",
                "label",
                "--where",
                "x < 2",
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
