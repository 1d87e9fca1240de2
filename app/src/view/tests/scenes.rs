//! Tests the scenes of A and B, on the null device.

use super::script::Script;
use crate::draw::splat_set::SplatSet;
use crate::view::events::{Event, RendererId};
use crate::view::paint::Mode;
use crate::view::viewer::Marks;
use splatgraph_null::Config;
use std::path::PathBuf;

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
    script.until("the requested state", |script| script.is_settled());
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
