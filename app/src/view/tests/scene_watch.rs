//! Tests scenes whose files change while the viewer shows them.

use super::script::Script;
use crate::draw::splat_set::SplatSet;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::Input;
use crate::view::viewer::Marks;
use egui::{Key, Modifiers};
use splatgraph_assets::{QUIET, Scene, Similarity, synth};
use splatgraph_framework::reload::{Content, Wanted};
use splatgraph_null::Config;
use std::fs;
use std::time::{Duration, Instant};

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
        let error = script.viewer().scene_error(RendererId::A).map(str::to_owned);
        error.is_some_and(|error| error.contains("both.ron:2:"))
    });
    script.sleep(60);
    script.frame(false);
    assert!(script.find("mistakes:edit").is_some(), "the error stays");
    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the mended file", |script| script.viewer().scene().count() == 200);
    assert_eq!(script.viewer().scene_error(RendererId::A), None);
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
    let tells = |script: &Script, expected: &str| {
        script.has_event(|event| matches!(event, Event::Problem { text } if text.contains(expected)))
    };
    let told = tells(&script, "second.ply changed: its hidden splats are shown again, and none is selected");
    assert!(told, "{:#?}", script.events);

    write("Scenes([Scene(file: \"second.ply\")])");
    script.until("the shorter list", |script| script.viewer().scene().count() == 200);
    let lost = "first.ply is no longer in the list; its selection and its hidden splats went with it";
    assert!(tells(&script, lost), "{:#?}", script.events);
    assert!(script.viewer().marks(RendererId::A).is_empty());
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
    let is_told = |script: &mut Script| script.viewer().scene_error(RendererId::A).is_some();
    script.until("the mistake", is_told);
    script.settle();
    write("Scenes([Scene(fil: \"second.ply\")])");
    script.until("the other mistake", |script| {
        script.viewer().scene_error(RendererId::A).is_some_and(|error| error.contains("fil"))
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
    let before = loads(&script);
    let stale = Wanted { path: script.path("both.ron"), content: Content::Missing };
    script.viewer().set_files_read(vec![stale]);
    script.until("the other load", |script| loads(script) > before);
    script.close(&[]);
}

fn loads(script: &Script) -> usize {
    script.events.iter().filter(|event| matches!(event, Event::Scene { .. })).count()
}

/// Waits for a new load of A's scene, and returns its number of splats.
fn loaded(script: &mut Script) -> u32 {
    let before = loads(script);
    script.until("the load", |script| loads(script) > before);
    script.viewer().loaded(RendererId::A).count()
}

#[test]
fn a_scene_whose_file_is_replaced_is_loaded_again_and_stays_with_an_error_while_the_file_is_broken() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let path = script.path("first.ply");
    let home = script.viewer().world_camera();
    assert!(script.viewer().navigate(&drag()));
    let camera = script.viewer().world_camera();
    let set = |indices: &[u32]| SplatSet::from_iter(indices.iter().copied()).into();
    script.viewer().set_marks(RendererId::A, Marks { selected: set(&[3]), ..Marks::default() });
    script.settle();

    // The same splats elsewhere, as in the next frame of a moving scene.
    let scene = synth::generate("uniform", 100, 0).expect("generated");
    let moved = Similarity { scale: 1.25, translation: [0.5, 0.0, 0.0].into(), ..Similarity::IDENTITY };
    scene.transformed(&moved).expect("moved").write_ply(&path).expect("written");
    assert_eq!(loaded(&mut script), 100);
    assert_eq!(script.viewer().marks(RendererId::A).selected, set(&[3]), "the same splats stay selected");
    assert_eq!(script.viewer().world_camera(), camera);
    script.settle();

    let other = synth::generate("uniform", 100, 1).expect("generated");
    other.write_ply(&path).expect("written");
    loaded(&mut script);
    assert!(script.viewer().marks(RendererId::A).is_empty());
    let text = "first.ply changed: none of its splats is selected any more";
    let tells = |event: &Event| matches!(event, Event::Problem { text: told } if told.ends_with(text));
    assert!(script.has_event(tells), "{:#?}", script.events);
    // Earlier marks cannot be restored for other splats.
    for marks in [Marks { selected: set(&[4]), ..Marks::default() }, Marks::default()] {
        script.viewer().set_marks(RendererId::A, marks);
        script.settle();
    }
    synth::generate("uniform", 100, 2).expect("generated").write_ply(&path).expect("written");
    loaded(&mut script);
    script.settle();
    script.press(Key::Z, Modifiers::COMMAND);
    assert!(script.viewer().marks(RendererId::A).is_empty());
    let identity = script.viewer().loaded(RendererId::A).identity();
    assert_eq!(identity, Scene::load(&path, QUIET).expect("loaded").identity());

    let bytes = fs::read(script.path("second.ply")).expect("read");
    fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
    script.until("the half", |script| script.viewer().scene_error(RendererId::A).is_some());
    let error = script.viewer().scene_error(RendererId::A).expect("an error").to_owned();
    assert!(error.contains("first.ply") && error.contains("truncated") && !error.contains("-->"), "{error}");
    assert_eq!(script.viewer().loaded(RendererId::A).identity(), identity, "the last scene stays");
    fs::write(&path, &bytes).expect("written");
    assert_eq!(loaded(&mut script), 200);
    assert_eq!(script.viewer().scene_error(RendererId::A), None);
    fs::remove_file(&path).expect("removed");
    script.until("the missing file", |script| script.viewer().scene_error(RendererId::A).is_some());
    fs::write(&path, &bytes).expect("written");
    loaded(&mut script);
    assert_eq!(script.viewer().world_camera(), camera);

    assert!(script.viewer().navigate(&Input { home: true, moved: [0.0; 2], ..drag() }));
    let after = script.viewer().world_camera();
    assert_eq!((after.position, after.rotation), (home.position, home.rotation), "Home is the first view");
    script.close(&[]);
}

#[test]
fn hidden_splats_return_with_their_file_and_so_do_the_steps_that_hid_them() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let set = |indices: &[u32]| SplatSet::from_iter(indices.iter().copied()).into();
    let selected = Marks { selected: set(&[3, 7]), ..Marks::default() };
    let hidden = Marks { hidden: set(&[3, 7]), ..Marks::default() };
    for marks in [&selected, &hidden] {
        script.viewer().set_marks(RendererId::A, marks.clone());
        script.settle();
    }
    let path = script.path("first.ply");
    let bytes = fs::read(&path).expect("read");
    let replace = |script: &mut Script, bytes: &[u8]| {
        script.events.clear();
        fs::write(&path, bytes).expect("written");
        script.until("the load", |script| loads(script) > 0);
        script.settle();
        let counts = |event: &Event| match event {
            Event::Marked { selected, hidden } => Some((*selected, *hidden)),
            _ => None,
        };
        script.events.iter().filter_map(counts).collect::<Vec<_>>()
    };
    let mut replaced = |bytes: &[u8]| {
        let counts = replace(&mut script, bytes);
        (counts, script.viewer().marks(RendererId::A).clone())
    };
    let second = fs::read(path.with_file_name("second.ply")).expect("read");
    assert_eq!(replaced(&second), (vec![(0, 0)], Marks::default()));
    assert_eq!(replaced(&bytes), (vec![(0, 2)], hidden.clone()));
    let mut step = |redo: bool| {
        script.press(Key::Z, if redo { Modifiers::COMMAND | Modifiers::SHIFT } else { Modifiers::COMMAND });
        script.viewer().marks(RendererId::A).clone()
    };
    assert_eq!([step(false), step(false)], [selected.clone(), Marks::default()]);
    assert_eq!([step(true), step(true)], [selected, hidden]);
    script.close(&[]);
}

#[test]
fn each_file_of_a_list_gets_its_hidden_splats_back_with_its_splats() {
    let (mut script, _) = opened("Scenes([Scene(file: \"first.ply\"), Scene(file: \"second.ply\")])");
    script.until("both scenes", |script| script.viewer().scene().count() == 300);
    let set = |indices: &[u32]| SplatSet::from_iter(indices.iter().copied()).into();
    let hidden = |indices: &[u32]| Marks { hidden: set(indices), ..Marks::default() };
    script.viewer().set_marks(RendererId::A, hidden(&[7, 100, 299]));
    script.settle();
    let second = script.path("second.ply");
    let bytes = fs::read(&second).expect("read");
    synth::generate("uniform", 200, 1).expect("generated").write_ply(&second).expect("written");
    loaded(&mut script);
    assert_eq!(*script.viewer().marks(RendererId::A), hidden(&[7]));
    script.viewer().set_marks(RendererId::A, hidden(&[9]));
    fs::write(&second, &bytes).expect("written");
    loaded(&mut script);
    assert_eq!(*script.viewer().marks(RendererId::A), hidden(&[9, 100, 299]));
    script.close(&[]);
}

#[test]
fn undo_marks_no_splats_of_a_file_that_changed_while_another_was_shown() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let hidden = SplatSet::from_iter([7]).into();
    script.viewer().set_marks(RendererId::A, Marks { hidden, ..Marks::default() });
    script.settle();
    let (first, second) = (script.path("first.ply"), script.path("second.ply"));
    script.viewer().open(&second);
    script.until("the other scene", |script| script.viewer().scene_path() == second);
    script.settle();
    synth::generate("uniform", 100, 1).expect("generated").write_ply(&first).expect("written");
    script.press(Key::Z, Modifiers::COMMAND);
    script.until("the first scene", |script| script.viewer().scene_path() == first);
    assert!(script.viewer().marks(RendererId::A).is_empty());
    let text = "first.ply changed: its hidden splats are shown again";
    let tells = |event: &Event| matches!(event, Event::Problem { text: told } if told.ends_with(text));
    script.frame(false);
    assert!(script.has_event(tells), "{:#?}", script.events);
    script.close(&[]);
}

#[test]
fn a_mistake_in_a_list_is_told_once() {
    let list = "Scenes([Scene(file: \"first.ply\"), Scene(file: \"second.ply\")])";
    let (mut script, write) = opened(list);
    script.until("both scenes", |script| script.viewer().scene().count() == 300);
    let failures = |script: &Script| {
        script.events.iter().filter(|event| matches!(event, Event::SceneFailed { .. })).count()
    };
    write(&list[..list.len() - 3]);
    script.until("the mistake", |script| failures(script) > 0);
    let begun = Instant::now();
    script.until("time for another load", |_| begun.elapsed() > Duration::from_millis(600));
    assert_eq!(failures(&script), 1, "{:#?}", script.events);
    write(list);
    assert_eq!(loaded(&mut script), 300);
    script.close(&[]);
}

#[test]
fn viewports_that_loaded_one_file_each_stay_apart_when_it_changes() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let second = script.path("second.ply");
    for id in [RendererId::B, RendererId::A] {
        script.viewer().open_scene_in(id, &second);
        script.until("the scene", |script| script.viewer().scene_path_of(id) == second);
    }
    let hidden = SplatSet::from_iter([7]).into();
    script.viewer().set_marks(RendererId::B, Marks { hidden, ..Marks::default() });
    script.settle();
    let before = loads(&script);
    let moved = Similarity { scale: 1.25, ..Similarity::IDENTITY };
    let scene = Scene::load(&second, QUIET).expect("loaded");
    scene.transformed(&moved).expect("moved").write_ply(&second).expect("written");
    script.until("both loads", |script| loads(script) == before + 2);
    assert!(script.viewer().has_two_scenes());
    let hidden = |script: &mut Script, id| script.viewer().marks(id).hidden.len();
    assert_eq!((hidden(&mut script, RendererId::A), hidden(&mut script, RendererId::B)), (0, 1));
    script.close(&[]);
}

#[test]
fn the_files_that_a_list_names_are_followed_also_those_that_are_missing_or_half_written() {
    let list = "Scenes([\n  Scene(file: \"first.ply\"),\n  Scene(file: \"third.ply\"),\n])";
    let (mut script, _) = opened(list);
    let error = |script: &mut Script| script.viewer().scene_error(RendererId::A).map(str::to_owned);
    script.until("the missing file", |script| error(script).is_some());
    let text = error(&mut script).expect("an error");
    assert!(text.contains("third.ply") && text.ends_with("both.ron:3:9"), "{text}");
    let bytes = fs::read(script.path("second.ply")).expect("read");
    let third = script.path("third.ply");
    fs::write(&third, &bytes[..bytes.len() - 9]).expect("written");
    script.until("the half", |script| error(script).is_some_and(|text| text.contains("truncated")));
    fs::write(&third, &bytes).expect("written");
    assert_eq!(loaded(&mut script), 300);
    assert_eq!(error(&mut script), None);

    let mut damaged = bytes.clone();
    damaged[header(&bytes)..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&third, &damaged).expect("written");
    assert_eq!(loaded(&mut script), 299);
    let notes = |event: &Event| matches!(event, Event::SceneNotes { path, notes } if path.ends_with("both.ron") && notes[0].starts_with("1 splat dropped"));
    assert!(script.has_event(notes), "{:#?}", script.events);
    script.close(&[]);
}

/// Returns the length of a PLY file's header, in bytes.
fn header(ply: &[u8]) -> usize {
    let end = b"end_header\n";
    ply.windows(end.len()).position(|window| window == end).expect("a header") + end.len()
}
