//! Tests editing a placement file while the viewer shows its scenes.

use super::script::{Script, arrange};
use crate::view::events::Event;
use crate::view::navigation::{Buttons, Input};
use splatgraph_null::Config;
use std::fs;

fn drag() -> Input {
    let buttons = Buttons { left: true, ..Buttons::default() };
    Input { size: [320.0, 180.0], seconds: 0.01, moved: [90.0, 20.0], buttons, ..Input::default() }
}

#[test]
fn a_changed_file_of_scenes_is_shown_from_where_the_camera_is_and_a_mistake_keeps_the_former() {
    let folder = tempfile::tempdir().expect("a folder");
    arrange(folder.path());
    let file = folder.path().join("both.ron");
    let write = |text: &str| fs::write(&file, text).expect("written");
    write("Scenes([Scene(file: \"first.ply\")])");
    let mut script = Script::open(folder.path(), &Config::default());
    script.settle();
    let first = script.viewer().scene().count();
    script.viewer().open(&file);
    script.until("the file", |script| script.viewer().scene_path().ends_with("both.ron"));
    assert_eq!(script.viewer().scene().count(), first);
    assert!(script.viewer().navigate(&drag()));
    let camera = script.viewer().world_camera();

    write("Scenes([Scene(file: \"first.ply\"), Scene(file: \"second.ply\", translate: (0, 1, 0))])");
    script.until("both scenes", |script| script.viewer().scene().count() == first + 200);
    let after = script.viewer().world_camera();
    assert!((0..3).all(|axis| (after.position[axis] - camera.position[axis]).abs() < 1e-9), "{after:?}");

    write("Scenes([Scene(file: \"third.ply\")])");
    let is_failure =
        |event: &Event| matches!(event, Event::SceneFailed { error, .. } if error.contains("third.ply"));
    script.until("the mistake", |script| script.has_event(is_failure));
    assert_eq!(script.viewer().scene().count(), first + 200);
    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the mended file", |script| script.viewer().scene().count() == 200);
    let (_, events, _) = script.close(&[]);
    let scenes = events.iter().filter(|event| matches!(event, Event::Scene { .. })).count();
    assert_eq!(scenes, 3);
}
