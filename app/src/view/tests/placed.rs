//! Tests editing a list of scenes while the viewer shows its scenes.

use super::script::Script;
use crate::draw::splat_set::SplatSet;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::Input;
use crate::view::viewer::Marks;
use splatgraph_assets::synth;
use splatgraph_framework::reload::Content;
use splatgraph_null::Config;
use std::fs;
use std::time::Duration;

fn drag() -> Input {
    Input { size: [320.0, 180.0], seconds: 0.01, moved: [90.0, 20.0], drags: true, ..Input::default() }
}

/// Starts to open a list of scenes in a viewer that shows `first.ply`. Returns the viewer, and a function that replaces
/// the list.
fn opened(list: &str) -> (Script, impl Fn(&str)) {
    let mut script = Script::open(&Config::default());
    let file = script.path("both.ron");
    fs::write(&file, list).expect("written");
    script.settle();
    script.viewer().open(&file);
    (script, move |text: &str| fs::write(&file, text).expect("written"))
}

#[test]
fn a_changed_file_of_scenes_is_shown_from_where_the_camera_is_and_a_mistake_keeps_the_former() {
    let (mut script, write) = opened("Scenes([Scene(file: \"first.ply\")])");
    let first = script.viewer().scene().count();
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
    write("Scenes([\n  Scene(fil: \"second.ply\"),\n])");
    script.until("the other mistake", |script| {
        let error = script.viewer().list_error(RendererId::A).map(str::to_owned);
        error.is_some_and(|error| error.contains("both.ron:2:"))
    });
    script.sleep(60);
    script.frame(false);
    assert!(script.panels().controls.find("mistakes:edit").is_some(), "the error stays");
    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the mended file", |script| script.viewer().scene().count() == 200);
    assert_eq!(script.viewer().list_error(RendererId::A), None);
    let (_, events, _) = script.close(&[]);
    let scenes = events.iter().filter(|event| matches!(event, Event::Scene { .. })).count();
    assert_eq!(scenes, 3);
}

#[test]
fn splats_of_an_unchanged_scene_stay_hidden_when_its_list_is_loaded_again_and_a_changed_one_is_told() {
    let (mut script, write) = opened("Scenes([Scene(file: \"first.ply\"), Scene(file: \"second.ply\")])");
    script.until("both scenes", |script| script.viewer().scene().count() == 300);
    let set = |indices: &[u32]| SplatSet::from_iter(indices.iter().copied()).into();
    let marks = Marks { hidden: set(&[0, 7, 100, 299]), selected: set(&[8, 101]) };
    script.viewer().set_marks(RendererId::A, marks);
    script.until("the rest", |script| script.viewer().scene().count() == 296);
    script.settle();
    let steps = script.panels().undo_steps();

    // The new list is reordered, has one more scene, and moves one of the scenes.
    write(
        "Scenes([Scene(file: \"second.ply\", scale: 0.5, translate: (0, 1, 0), rotate: (axis: (1, 2, 3), degrees: 40)), \
         Scene(file: \"first.ply\"), Scene(file: \"first.ply\", translate: (3, 0, 0))])",
    );
    script.until("three scenes", |script| script.viewer().scene().count() == 396);
    let marks = script.viewer().marks(RendererId::A).clone();
    assert_eq!(marks, Marks { hidden: set(&[200, 207, 0, 199]), selected: set(&[208, 1]) });
    assert!(!script.has_event(|event| matches!(event, Event::Problem { .. })), "{:#?}", script.events);
    script.settle();
    assert_eq!(script.panels().undo_steps(), steps, "the program's own change is no step");

    let other = synth::generate("uniform", 200, 1).expect("the scene is generated");
    other.write_ply(script.path("second.ply")).expect("the scene is written");
    write("Scenes([Scene(file: \"first.ply\"), Scene(file: \"second.ply\")])");
    script.until("the changed scene", |script| script.viewer().scene().count() == 298);
    let marks = script.viewer().marks(RendererId::A).clone();
    assert_eq!(marks, Marks { hidden: set(&[0, 7]), selected: set(&[8]) });
    let is_told = |event: &Event| matches!(event, Event::Problem { text } if text.contains("second.ply changed: its hidden splats are shown again"));
    assert!(script.has_event(is_told), "{:#?}", script.events);
    script.close(&[]);
}

#[test]
fn a_file_of_scenes_that_was_missing_or_began_with_a_mistake_is_shown_again_from_where_the_camera_is() {
    let (mut script, write) = opened("Scenes([Scene(file: \"first.ply\")])");
    script.until("the file", |script| script.viewer().scene_path().ends_with("both.ron"));
    assert!(script.viewer().navigate(&drag()));
    let camera = script.viewer().world_camera();
    let failures = |script: &Script| {
        script.events.iter().filter(|event| matches!(event, Event::SceneFailed { .. })).count()
    };

    fs::remove_file(script.path("both.ron")).expect("removed");
    script.until("the missing file", |script| failures(script) == 1);
    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the file that came back", |script| script.viewer().scene().count() == 200);
    write("Scens([Scene(file: \"first.ply\")])");
    script.until("the mistake", |script| failures(script) == 2);
    write("Scenes([Scene(file: \"first.ply\")])");
    script.until("the mended file", |script| script.viewer().scene().count() == 100);
    let after = script.viewer().world_camera();
    assert!((0..3).all(|axis| (after.position[axis] - camera.position[axis]).abs() < 1e-9), "{after:?}");
    script.close(&[]);
}

#[test]
fn a_file_of_scenes_is_followed_while_it_is_on_the_screen_although_another_scene_was_opened_and_failed() {
    let (mut script, write) = opened("Scenes([Scene(file: \"first.ply\")])");
    script.until("the file", |script| script.viewer().scene_path().ends_with("both.ron"));
    let missing = script.path("missing.ply");
    script.viewer().open(&missing);
    script.until("the failure", |script| {
        script.has_event(
            |event| matches!(event, Event::SceneFailed { path, .. } if path.ends_with("missing.ply")),
        )
    });
    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the changed file", |script| script.viewer().scene().count() == 200);

    // Once another scene is shown, the list no longer matters.
    let first = script.path("first.ply");
    script.viewer().open(&first);
    script.until("the other scene", |script| script.viewer().scene_path().ends_with("first.ply"));
    write("Scenes([Scene(file: \"second.ply\"), Scene(file: \"second.ply\")])");
    std::thread::sleep(Duration::from_millis(300));
    script.settle();
    assert_eq!(script.viewer().scene().count(), 100);
    script.close(&[]);
}

#[test]
fn a_file_of_scenes_that_was_opened_with_a_mistake_is_loaded_once_it_is_mended() {
    let (mut script, write) = opened("Scenes([");
    let is_told = |script: &mut Script| script.viewer().list_error(RendererId::A).is_some();
    script.until("the mistake", is_told);
    script.settle();
    write("Scenes([Scene(fil: \"second.ply\")])");
    script.until("the other mistake", |script| {
        script.viewer().list_error(RendererId::A).is_some_and(|error| error.contains("fil"))
    });
    // The error stays while another file fails, and so does the watch.
    let missing = script.path("missing.ply");
    script.viewer().open(&missing);
    script.until("the failure", |script| script.viewer().loading(RendererId::A).is_none());
    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the mended file", |script| script.viewer().scene().count() == 200);
    assert!(!is_told(&mut script));

    // Once another scene is shown, a list that failed no longer matters.
    write("Scens([])");
    script.until("the mistake", is_told);
    let first = script.path("first.ply");
    script.viewer().open(&first);
    script.until("the other scene", |script| script.viewer().scene_path().ends_with("first.ply"));
    write("Scenes([Scene(file: \"second.ply\")])");
    std::thread::sleep(Duration::from_millis(300));
    script.settle();
    assert_eq!(script.viewer().scene().count(), 100);
    script.close(&[]);
}

#[test]
fn a_file_of_scenes_that_was_saved_after_it_was_read_and_before_it_was_watched_is_loaded_again() {
    let (mut script, _) = opened("Scenes([Scene(file: \"first.ply\")])");
    script.until("the file", |script| script.viewer().scene_path().ends_with("both.ron"));
    let loads =
        |script: &Script| script.events.iter().filter(|event| matches!(event, Event::Scene { .. })).count();
    let before = loads(&script);
    script.viewer().set_list_read(Content::of(b"Scenes([Scene(file: \"second.ply\")])"));
    script.until("the other load", |script| loads(script) > before);
    script.close(&[]);
}

#[test]
fn a_file_of_scenes_that_is_saved_while_it_is_loaded_is_loaded_again() {
    let (mut script, write) = opened("Scenes([Scene(file: \"first.ply\")])");
    write("Scenes([Scene(file: \"second.ply\")])");
    // The load has ended and the change was noticed before the next frame.
    std::thread::sleep(Duration::from_millis(300));
    script.until("the saved file", |script| script.viewer().scene().count() == 200);
    script.close(&[]);
}
