//! Tests the scenes of A and B, with their cameras and their picked, selected and hidden splats, on the null device.

use super::script::Script;
use crate::draw::backend::Backend;
use crate::draw::splat_set::SplatSet;
use crate::view::events::{Event, RendererId};
use crate::view::paint::Mode;
use crate::view::viewer::{Marks, Part};
use egui::{Key, Modifiers};
use splatgraph_assets::{Camera, Scene, Splat, synth};
use splatgraph_null::{Config, Fault, Point};
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[test]
fn a_scene_is_opened_by_its_contents_whatever_its_name() {
    let mut script = Script::open(&Config::default());
    script.settle();
    for name in ["capture", "capture.json"] {
        let file = script.path(name);
        std::fs::copy(script.path("second.ply"), &file).expect("the scene is copied");
        script.viewer().open(&file);
        script.until("the scene", |script| script.viewer().scene_path() == file);
    }
    // A folder is a SOG, or fails as one.
    let folder = script.path("folder.ron");
    std::fs::create_dir(&folder).expect("a folder");
    script.viewer().open(&folder);
    let fails =
        |event: &Event| matches!(event, Event::SceneFailed { path, .. } if path.ends_with("folder.ron"));
    script.until("the failure", |script| script.has_event(fails));
    script.close(&[]);
}

#[test]
fn a_scene_that_is_loaded_for_b_is_exchanged_with_its_graph() {
    let mut script = Script::open(&Config::default());
    script.settle();
    script.viewer().choose_compare(Mode::Split);
    script.settle();
    let (first, second) = (script.path("first.ply"), script.path("second.ply"));
    let marks = Marks { hidden: SplatSet::from_iter([7]).into(), ..Marks::default() };
    let viewer = script.viewer();
    viewer.set_marks(RendererId::A, marks.clone());
    viewer.open_scene_in(RendererId::B, &second);
    viewer.exchange();
    assert_eq!(viewer.loading(RendererId::A), Some(second.as_path()));
    assert_eq!(viewer.loading(RendererId::B), None);
    assert_eq!([RendererId::A, RendererId::B].map(|id| viewer.scene_path_of(id)), [&first, &first]);
    assert_eq!([RendererId::A, RendererId::B].map(|id| viewer.marks(id)), [&marks, &marks]);
    script.settle();
    let viewer = script.viewer();
    assert_eq!([RendererId::A, RendererId::B].map(|id| viewer.scene_path_of(id)), [&second, &first]);
    assert_eq!([RendererId::A, RendererId::B].map(|id| viewer.scene_of(id).count()), [200, 99]);
    script.close(&[]);
}

#[test]
fn b_shares_the_scene_of_a_however_its_path_is_written() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let here = std::env::current_dir().expect("the current folder");
    let up = here.ancestors().skip(1).map(|_| "..").collect::<PathBuf>();
    let first = script.path("first.ply");
    let relative = up.join(first.strip_prefix("/").expect("an absolute path"));
    script.viewer().open(&relative);
    script.until("the scene", |script| script.viewer().scene_path() == relative);
    script.viewer().choose_compare(Mode::Split);
    let second = script.path("second.ply");
    script.viewer().open_scene_in(RendererId::B, &second);
    script.until("B's scene", |script| script.viewer().has_two_scenes());
    let folder = first.parent().and_then(|folder| folder.file_name()).expect("a folder");
    let roundabout = script.path("..").join(folder).join("first.ply");
    for path in [here.join(&relative), roundabout.clone()] {
        script.viewer().open_scene_in(RendererId::B, &path);
        let viewer = script.viewer();
        assert_eq!((viewer.has_two_scenes(), viewer.loading(RendererId::B)), (false, None), "{path:?}");
    }
    // A's scene is the file that was read, not the link's present target.
    #[cfg(unix)]
    {
        let link = script.path("link.ply");
        std::os::unix::fs::symlink(&first, &link).expect("a link");
        script.viewer().open(&link);
        script.until("the linked scene", |script| script.viewer().scene_path() == link);
        std::fs::remove_file(&link).expect("the link is removed");
        std::os::unix::fs::symlink(&second, &link).expect("a link");
        script.viewer().open_scene_in(RendererId::B, &link);
        script.until("B's scene", |script| script.viewer().has_two_scenes());
        script.viewer().open_scene_in(RendererId::B, &roundabout);
        assert!(!script.viewer().has_two_scenes());
    }
    script.close(&[]);
}

#[test]
fn a_window_is_not_settled_before_the_splats_asked_for_at_the_start_are_picked_and_selected() {
    let mut script = Script::open(&Config::default());
    script.panels().pick_first([0.5, 0.5]);
    script.panels().select_first([0.0, 0.0, 1.0, 1.0]);
    script.frame(false);
    script.until("the requested state", |script| script.shell.is_settled());
    assert!(script.viewer().picked.is_some());
    assert!(!script.viewer().marks(RendererId::A).selected.is_empty());
    script.close(&[]);
}

#[test]
fn a_pick_in_another_viewport_drops_the_splat_of_the_former_at_once() {
    let mut script = Script::open(&Config::default());
    script.settle();
    script.viewer().choose_compare(Mode::Split);
    let second = script.path("second.ply");
    script.viewer().open_scene_in(RendererId::B, &second);
    script.settle();
    let center = [160.5, 90.5];
    script.viewer().pick(RendererId::A, center);
    script.until("A's splats", |script| script.viewer().picked.is_some());
    script.viewer().pick(RendererId::B, center);
    assert!(script.viewer().picked.is_none(), "an index into A's scene is not one into B's");
    script.until("B's splats", |script| script.viewer().picked.is_some());
    assert_eq!(script.viewer().picked_in(), RendererId::B);
    script.close(&[]);
}

#[test]
fn hidden_splats_of_a_scene_that_is_no_longer_shown_count_as_unsaved_until_undo_shows_them() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let marks = Marks { hidden: SplatSet::from_iter([7, 9]).into(), ..Marks::default() };
    script.viewer().set_marks(RendererId::A, marks.clone());
    script.settle();
    assert_eq!(script.viewer().unsaved().as_deref(), Some("2 hidden splats"));
    let (first, second) = (script.path("first.ply"), script.path("second.ply"));
    script.viewer().open(&second);
    script.until("the scene", |script| script.viewer().scene_path() == second);
    script.frame(false);
    let expected = format!("2 hidden splats of {}", first.display());
    assert_eq!(script.viewer().unsaved(), Some(expected.clone()));
    let told = |event: &Event| matches!(event, Event::Problem { text } if text.contains(&expected));
    assert!(script.has_event(told), "{:#?}", script.events);
    script.press(Key::Z, Modifiers::COMMAND);
    script.until("the first scene", |script| script.viewer().scene_path() == first);
    assert_eq!(script.viewer().marks(RendererId::A), &marks);
    assert_eq!(script.viewer().unsaved().as_deref(), Some("2 hidden splats"));
    script.close(&[]);
}

#[test]
fn a_file_that_cannot_be_finished_saves_no_hidden_splats_and_loses_none_that_another_file_saved() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let b = RendererId::B;
    // No .spz file has room for this coordinate, which is found while the file is written.
    let far = |at: usize| Splat {
        position: [if at == 0 { 1e7 } else { 0.0 }, 0.0, at as f32],
        ..synth::generate("demo", 1, 0).expect("a scene").splat(0)
    };
    let second = script.path("second.ply");
    Scene::generate(10, 0, far).write_ply(&second).expect("the scene is written");
    script.viewer().choose_compare(Mode::Split);
    script.viewer().open_scene_in(b, &second);
    script.settle();
    let set = |splats: &[u32]| Arc::new(splats.iter().copied().collect::<SplatSet>());
    let failed = |event: &Event| matches!(event, Event::FileFailed { .. });
    let export = |script: &mut Script, part: Part, name: &str| {
        let path = script.path(name);
        script.events.clear();
        assert!(script.viewer().export(b, part, &path), "{:#?}", script.events);
    };

    script.viewer().set_marks(b, Marks { selected: set(&[0]), hidden: set(&[7, 9]) });
    export(&mut script, Part::Rest, "rest.ply");
    assert_eq!(script.viewer().unsaved(), None, "closing waits for the file");
    script.until("the file", |script| script.has_event(|event| matches!(event, Event::Exported { .. })));
    assert_eq!(script.viewer().unsaved(), None);
    export(&mut script, Part::Selected, "selection.spz");
    script.until("the failure", |script| script.has_event(failed));
    assert_eq!(script.viewer().unsaved(), None, "the other file is still there");

    script.viewer().set_marks(b, Marks { hidden: set(&[7]), ..Marks::default() });
    export(&mut script, Part::Rest, "rest.spz");
    script.viewer().share_scene();
    assert_eq!(script.viewer().unsaved(), None, "the file is being written");
    script.until("the failure", |script| script.has_event(failed));
    let expected = format!("1 hidden splat of {}", second.display());
    assert_eq!(script.viewer().unsaved(), Some(expected));
    script.close(&[]);
}

#[test]
fn cameras_that_the_user_named_stay_with_other_scenes_and_undo_restores_replaced_ones() {
    let mut script = Script::open(&Config::default());
    let [first, second, third] = ["first.ply", "second.ply", "third.ply"].map(|name| script.path(name));
    std::fs::copy(&second, &third).expect("the scene is copied");
    std::fs::remove_file(script.path("cameras.json")).expect("they would be beside every scene");
    let mut beside = Camera::framing(script.viewer().scene(), 64, 36);
    let named: Vec<Camera> =
        ["a", "b"].into_iter().map(|name| Camera { img_name: name.to_owned(), ..beside.clone() }).collect();
    beside.img_name = "beside".to_owned();
    Camera::save(&[beside], script.path("third.cameras.json")).expect("cameras are written");
    script.viewer().set_cameras(named);
    script.viewer().look_through(1);
    script.settle();
    let names = |script: &mut Script| {
        let names = script.viewer().cameras().iter().map(|camera| camera.img_name.clone());
        names.collect::<Vec<_>>().join(" ")
    };
    let open = |script: &mut Script, path: &Path| {
        script.viewer().open(path);
        script.until("the scene", |script| script.viewer().scene_path() == path);
        script.frame(false);
    };
    let undo = |script: &mut Script, path: &Path| {
        script.press(Key::Z, Modifiers::COMMAND);
        script.until("the former scene", |script| script.viewer().scene_path() == path);
    };
    let before = script.viewer().navigation.camera(64, 36);
    open(&mut script, &second);
    assert_eq!(names(&mut script), "a b");
    assert_eq!(script.viewer().navigation.camera(64, 36), before, "another file of the capture");
    open(&mut script, &third);
    assert_eq!(names(&mut script), "beside");
    open(&mut script, &first);
    assert_eq!(names(&mut script), "", "cameras beside a scene go with it");
    undo(&mut script, &third);
    assert_eq!(names(&mut script), "beside");
    undo(&mut script, &second);
    assert_eq!(names(&mut script), "a b");
    undo(&mut script, &first);
    assert_eq!(names(&mut script), "a b");
    script.close(&[]);
}

#[test]
fn a_selection_file_that_is_opened_selects_its_splats_unless_it_is_of_another_scene() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let hidden: Arc<SplatSet> = SplatSet::from_iter([7]).into();
    script.viewer().set_marks(RendererId::A, Marks { hidden: hidden.clone(), ..Marks::default() });
    script.frame(false);
    let text = SplatSet::from_iter([3, 7, 99]).to_json(script.viewer().loaded(RendererId::A)).expect("JSON");
    script.write("some.json", text);
    let file = script.path("some.json");
    script.viewer().open(&file);
    let marks = Marks { selected: SplatSet::from_iter([3, 99]).into(), hidden };
    script.until("the selection", |script| *script.viewer().marks(RendererId::A) == marks);
    for (text, expected) in [
        ("{\"splats\": 200, \"indices\": [0]}", "expected a selection of 100 splats, found one of 200"),
        ("{\"splats\": 100, \"indices\": [0, 100]}", "indices: expected numbers below 100, found 100"),
    ] {
        script.write("some.json", text);
        script.viewer().open(&file);
        let told = |event: &Event| matches!(event, Event::Problem { text } if text.contains(expected));
        script.until(expected, |script| script.has_event(told));
    }
    assert_eq!(*script.viewer().marks(RendererId::A), marks);
    script.press(Key::Z, Modifiers::COMMAND);
    assert!(script.viewer().marks(RendererId::A).selected.is_empty());
    script.close(&[]);
}

#[test]
fn undo_restores_the_up_direction_also_with_a_replaced_scene() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let up = |script: &mut Script| {
        let viewer = script.viewer();
        (viewer.scene_settings(RendererId::A).up, viewer.navigation.up().to_array())
    };
    let opened = up(&mut script);
    let upright = (Some([0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]);
    assert!(opened.0.is_none() && opened.1 != upright.1);
    script.viewer().show_upright(upright.0);
    script.frame(false);
    let (first, second) = (script.path("first.ply"), script.path("second.ply"));
    script.viewer().open(&second);
    script.until("the scene", |script| script.viewer().scene_path() == second);
    script.frame(false);
    assert_eq!(up(&mut script).0, None);
    script.press(Key::Z, Modifiers::COMMAND);
    script.until("the first scene", |script| script.viewer().scene_path() == first);
    assert_eq!(up(&mut script), upright);
    script.press(Key::Z, Modifiers::COMMAND);
    assert_eq!(up(&mut script), opened);
    script.press(Key::Z, Modifiers::COMMAND | Modifiers::SHIFT);
    assert_eq!(up(&mut script), upright);
    script.close(&[]);
}

#[test]
fn the_up_direction_of_a_tag_has_priority_over_that_of_cameras() {
    let mut script = Script::open(&Config::default());
    script.settle();
    let mut tagged = std::fs::read(script.path("second.ply")).expect("a scene");
    tagged.splice(4..4, b"comment vertical axis: z\n".iter().copied());
    script.write("tagged.ply", tagged);
    let file = script.path("tagged.ply");
    script.viewer().open(&file);
    script.until("the scene", |script| script.viewer().scene_path() == file);
    let viewer = script.viewer();
    viewer.set_cameras(synth::demo_cameras());
    assert_eq!(viewer.navigation.up().to_array(), [0.0, 0.0, 1.0]);
    viewer.show_upright(Some([1.0, 0.0, 0.0]));
    viewer.show_upright(None);
    assert_eq!(viewer.navigation.up().to_array(), [0.0, 0.0, 1.0]);
    script.close(&[]);
}

#[test]
fn a_released_viewer_draws_no_scene_and_a_device_without_a_context_for_b_drops_its_scene() {
    let device = |faults| splatgraph_null::open(&Config { faults, ..Config::default() });
    let (first, journal) = device(Vec::new());
    drop(first);
    let last = Fault { point: Point::Create, after: journal.reached(Point::Create) };
    let mut script = Script::open(&Config::default());
    script.viewer().choose_compare(Mode::Split);
    let second = script.path("second.ply");
    script.viewer().open_scene_in(RendererId::B, &second);
    script.settle();
    let viewer = script.viewer();
    assert!(viewer.has_two_scenes() && viewer.a.renderer.draws(viewer.scene()));
    viewer.release();
    assert!(!viewer.a.renderer.draws(viewer.scene()));
    let device = Backend::Null(device(vec![last]).0.expect("the device opens"));
    viewer.give(device).expect_err("no context for B");
    assert!(viewer.b.is_none() && !viewer.has_two_scenes());
}
