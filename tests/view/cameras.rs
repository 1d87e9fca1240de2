//! The command that redraws the window's picture, and cameras far from the world's origin.

use super::whole::TestShell;
use crate::common;
use splatgraph::draw::backend::Validation;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::navigation::Input;
use splatgraph::view::panels::Tool;
use splatgraph_assets::synth;
use std::path::Path;
use std::process::Command;

const SIZE: (u32, u32) = (96, 54);

/// Runs a shell command line, which must succeed; `splatgraph` in it is the program under test.
fn run(line: &str, folder: &Path) {
    let program = Path::new(env!("CARGO_BIN_EXE_splatgraph"));
    let found = std::env::var_os("PATH").unwrap_or_default();
    let folders =
        std::iter::once(program.parent().expect("a folder").to_owned()).chain(std::env::split_paths(&found));
    let output = Command::new("sh")
        .args(["-c", line])
        .current_dir(folder)
        .env("PATH", std::env::join_paths(folders).expect("a list of folders"))
        .output()
        .expect("a shell");
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_command_of_a_picture_draws_the_same_picture_near_the_origin_and_far_from_it() {
    let set = [("cutoff", "2.5")];
    let mut viewer =
        TestShell::open(Validation::Synchronization, ("demo", 100), "pipelines/splat.ron", &set, SIZE);
    (viewer.shell.panels.hidden, viewer.shell.panels.hud) = (true, false);
    for (name, offset) in
        [("near scene.ply", [0.0; 3]), ("far scene.ply", [512_345.1, -4_000_000.7, 1_000.3])]
    {
        let path = viewer.place.at(name);
        let scene = synth::generate("uniform", 3_000, 0).expect("the scene is generated").with_offset(offset);
        scene.write_ply(&path).expect("the scene is written");
        viewer.shell.viewer.open(&path);
        viewer.event("the scene", |event| matches!(event, Event::Scene { path, .. } if path.ends_with(name)));
        viewer.settle();
        let drag = Input {
            size: [f64::from(SIZE.0), f64::from(SIZE.1)],
            moved: [-71.0, 23.0],
            drags: true,
            ..Input::default()
        };
        assert!(viewer.shell.viewer.navigate(&drag));
        viewer.shell.viewer.navigation.set_field_of_view(37.3);
        viewer.shell.viewer.background = [0.1, 0.25, 0.7];
        viewer.frame();
        let shown = viewer.picture(RendererId::A);
        let line =
            viewer.shell.viewer.render_command(RendererId::A, Path::new("again.npy")).expect("A is there");
        let folder = path.parent().expect("a folder").to_owned();
        run(&format!("{line} {}", common::device_option().unwrap_or_default()), &folder);
        let again = Image::load(&folder.join("again.npy")).expect("the picture is read");
        assert_eq!((again.width, again.height), (SIZE.0 as usize, SIZE.1 as usize));
        assert!(shown.rgb == again.rgb, "{name}: other pixels by\n{line}");
        let [r, g, b] = shown.rgb[shown.rgb.len() / 2 + shown.width / 2];
        assert!((r - 0.1).abs() + (g - 0.25).abs() + (b - 0.7).abs() > 0.05, "{name}: only background");
    }
    viewer.close();
}

#[test]
fn a_panorama_has_no_field_of_view_to_set() {
    for (graph, is_panorama) in [("splat", false), ("equirectangular", true)] {
        let mut viewer = TestShell::new(("demo", 100), &format!("pipelines/{graph}.ron"), (640, 360));
        viewer.shell.panels.open_tools(&[Tool::Cameras]);
        viewer.settle();
        viewer.frame();
        let slider = viewer.shell.panels.controls.find("field_of_view");
        assert_eq!(slider.is_none(), is_panorama, "{graph}");
        viewer.close();
    }
}
