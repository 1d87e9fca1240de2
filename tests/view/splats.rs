//! Splats are selected on the picture, hidden and written to files.

use super::whole::TestShell;
use crate::images;
use egui::{Event as Input, Key, Modifiers, PointerButton, Pos2, Rect, Vec2};
use splatgraph::draw::select::{Reach, Region, select};
use splatgraph::draw::splat_set::{Masked, SplatSet};
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::viewer::{Combine, Marks, Part};
use splatgraph_assets::{QUIET, Scene};
use std::path::PathBuf;

const A: RendererId = RendererId::A;

fn viewer() -> TestShell {
    viewer_of("pipelines/splat.ron")
}

fn viewer_of(graph: &str) -> TestShell {
    let mut viewer = TestShell::new(("uniform", 2000), graph, (480, 270));
    viewer.shell.panels.open_tools(&[]);
    viewer.settle();
    viewer
}

fn marks(viewer: &TestShell) -> Marks {
    viewer.shell.viewer.marks(A).clone()
}

fn press(viewer: &mut TestShell, key: Key, modifiers: Modifiers) {
    viewer.press(key, modifiers);
    viewer.settle();
}

fn click(viewer: &mut TestShell, control: &str) {
    viewer.push(control);
    viewer.settle();
}

fn view(viewer: &TestShell) -> Rect {
    viewer.shell.panels.controls.find("view").expect("there is a picture")
}

/// Returns the place in the window, in points, of a point given as shares of the picture's width and height.
fn at(viewer: &TestShell, [x, y]: [f32; 2]) -> Pos2 {
    let view = view(viewer);
    view.min + Vec2::new(x * view.width(), y * view.height())
}

/// Drags the left button over points given as shares of the picture, with modifiers, and waits for all building.
fn drag(viewer: &mut TestShell, shares: &[[f32; 2]], modifiers: Modifiers) {
    let points: Vec<Pos2> = shares.iter().map(|share| at(viewer, *share)).collect();
    viewer.plan([Input::ModifiersChanged(modifiers)]);
    viewer.drag(PointerButton::Primary, &points);
    viewer.plan([Input::ModifiersChanged(Modifiers::NONE)]);
    viewer.act();
    viewer.settle();
}

/// Finds the splats in a region, in pixels of the picture, except those in `hidden`.
fn expected(viewer: &TestShell, hidden: &SplatSet, region: &Region, reach: Reach) -> SplatSet {
    let viewer = &viewer.shell.viewer;
    let masked = Masked { scene: viewer.loaded(A), hidden };
    select(&masked, &viewer.picture_camera(), region, reach, &|| false).expect("it is not cancelled")
}

/// Converts points of the picture, given as shares, to its pixels.
fn pixels(viewer: &TestShell, shares: &[[f32; 2]]) -> Vec<[f64; 2]> {
    let camera = viewer.shell.viewer.picture_camera();
    let (view, size) = (view(viewer), Vec2::new(camera.width as f32, camera.height as f32));
    let pixel = |share: &[f32; 2]| {
        let pixel = (at(viewer, *share) - view.min) * (size / view.size());
        [pixel.x, pixel.y].map(f64::from)
    };
    shares.iter().map(pixel).collect()
}

fn picture(viewer: &mut TestShell) -> Image {
    viewer.settle();
    viewer.picture(A)
}

/// Draws frames until an export has ended, and clears all events. Returns the file and its number of splats.
fn exported(viewer: &mut TestShell) -> (PathBuf, u32) {
    let find = |event: &Event| match event {
        Event::Exported { path, splats, .. } => Some((path.clone(), *splats)),
        _ => None,
    };
    viewer.until("the file", |viewer| viewer.events.iter().any(|event| find(event).is_some()));
    let found = viewer.events.iter().find_map(find).expect("there is a file");
    viewer.events.clear();
    found
}

const CORNERS: [[f32; 2]; 2] = [[0.3, 0.2], [0.55, 0.6]];

#[test]
fn a_box_selects_splats_which_are_hidden_and_written_and_come_back() {
    let mut viewer = viewer();
    let untouched = picture(&mut viewer);
    assert_eq!(viewer.shell.panels.controls.find("splats"), None, "no card without a selection");
    let camera = viewer.shell.viewer.world_camera();

    press(&mut viewer, Key::R, Modifiers::NONE);
    assert!(viewer.shell.panels.controls.find("splats").is_some());
    drag(&mut viewer, &CORNERS, Modifiers::NONE);
    assert_eq!(viewer.shell.viewer.world_camera(), camera, "the drag does not move the camera");
    let corners = pixels(&viewer, &CORNERS);
    let region = Region::Box([corners[0], corners[1]]);
    let found = expected(&viewer, &SplatSet::default(), &region, Reach::Through);
    let (some, all) = (found.len(), viewer.shell.viewer.loaded(A).count());
    assert!(some > 50 && some < all - 50, "{some} of {all}");
    assert_eq!(*marks(&viewer).selected, found);
    assert!(viewer.events.contains(&Event::Marked { selected: some, hidden: 0 }));
    let tinted = picture(&mut viewer);
    assert!(tinted.rgb != untouched.rgb, "the selection is visible");

    // Writes a list of the selection, for `convert`.
    let list = viewer.place.at("list.json");
    viewer.shell.viewer.export(A, Part::Selected, &list);
    assert_eq!(exported(&mut viewer), (list, some));

    press(&mut viewer, Key::X, Modifiers::NONE);
    assert_eq!(marks(&viewer), Marks { selected: Default::default(), hidden: found.clone().into() });
    assert_eq!(viewer.shell.viewer.scene().count(), all - some);
    let hidden = picture(&mut viewer);
    assert!(hidden.rgb != untouched.rgb && hidden.rgb != tinted.rgb);
    assert_eq!(viewer.shell.viewer.unsaved(), Some(format!("{some} hidden splats")));

    // The file of the rest equals what `convert` writes, and draws the picture without the hidden splats.
    click(&mut viewer, "splats:save_rest");
    let (rest, count) = exported(&mut viewer);
    assert_eq!(count, all - some);
    assert_eq!(rest, viewer.place.at("scene-part-1.ply"));
    assert_eq!(viewer.shell.viewer.unsaved(), None);
    viewer.shell.viewer.export(A, Part::Rest, &rest);
    viewer.event(
        "the refusal to replace it",
        |event| matches!(event, Event::FileFailed { error, .. } if error.contains("expected a new file")),
    );
    viewer.place.done("convert scene.ply removed.ply --remove list.json");
    viewer.place.done("convert scene.ply kept.ply --keep list.json");
    assert!(viewer.place.bytes("removed.ply") == viewer.place.bytes("scene-part-1.ply"));
    let kept = Scene::load(viewer.place.at("kept.ply"), QUIET).expect("the scene is loaded");
    assert_eq!(kept.count(), some);
    let scene = Scene::load(&rest, QUIET).expect("the scene is loaded");
    let own = viewer.shell.viewer.navigation.camera(hidden.width as u32, hidden.height as u32);
    let graph = viewer.shell.viewer.a.renderer.graph().to_owned();
    let drawn = images::draw_scene(scene, &[own], &graph, [0.0; 3], &[]);
    assert!(drawn[0].rgb == hidden.rgb, "the file has the picture of what is left");

    press(&mut viewer, Key::Z, Modifiers::COMMAND);
    assert_eq!(marks(&viewer), Marks { selected: found.clone().into(), hidden: Default::default() });
    assert!(picture(&mut viewer).rgb == tinted.rgb);
    press(&mut viewer, Key::Z, Modifiers::COMMAND);
    assert!(marks(&viewer).is_empty());
    assert!(picture(&mut viewer).rgb == untouched.rgb, "without marks, the picture is the same again");

    // Another scene starts without marks. Undo brings back the former scene, with the same splats hidden.
    for _ in 0..2 {
        press(&mut viewer, Key::Z, Modifiers::COMMAND | Modifiers::SHIFT);
    }
    assert_eq!(*marks(&viewer).hidden, found);
    viewer.shell.viewer.open(&rest);
    viewer.settle();
    viewer.frame();
    assert!(marks(&viewer).is_empty());
    // The file is named after the scene on the screen, and has the up direction that was chosen for it.
    viewer.shell.viewer.show_upright(Some([0.0, 1.0, 0.0]));
    click(&mut viewer, "splats:save_rest");
    let (upright, _) = exported(&mut viewer);
    assert_eq!(upright, viewer.place.at("scene-part-1-part-1.ply"));
    assert_eq!(Scene::load(&upright, QUIET).expect("the scene is loaded").up(), [0.0, 1.0, 0.0]);
    for _ in 0..2 {
        press(&mut viewer, Key::Z, Modifiers::COMMAND);
    }
    assert_eq!(viewer.shell.viewer.scene_path(), viewer.place.at("scene.ply"));
    assert_eq!(*marks(&viewer).hidden, found);
    assert_eq!(viewer.shell.viewer.scene().count(), all - some);
    viewer.close();
}

#[test]
fn hiding_splats_does_not_change_the_scale_of_an_orthographic_picture() {
    let mut viewer = viewer_of("pipelines/orthographic.ron");
    let camera = viewer.shell.viewer.picture_camera();
    let whole = viewer.shell.viewer.loaded(A);
    let middle = whole.robust_bounds().center()[0] as f32;
    let (left, right): (Vec<u32>, Vec<u32>) =
        (0..whole.count()).partition(|index| whole.positions()[*index as usize][0] < middle);
    let rest = whole.picked(&right).expect("it fits in memory");
    let hidden: SplatSet = left.into_iter().collect();
    viewer.shell.viewer.set_marks(A, Marks { hidden: hidden.into(), ..Marks::default() });
    let shown = picture(&mut viewer);
    assert_eq!(viewer.shell.viewer.picture_camera(), camera);
    let graph = viewer.shell.viewer.a.renderer.graph().to_owned();
    let drawn = images::draw_scene(rest, &[camera], &graph, [0.0; 3], &[]);
    assert!(drawn[0].rgb == shown.rgb, "the camera is the one of the whole scene");
    viewer.close();
}

#[test]
fn a_brush_adds_and_removes_splats_and_keys_change_the_selection() {
    let mut viewer = viewer();
    let all = viewer.shell.viewer.loaded(A).count();
    press(&mut viewer, Key::B, Modifiers::NONE);
    let (line, other) = ([[0.3, 0.4], [0.5, 0.4]], [[0.4, 0.6], [0.4, 0.3]]);
    // The brush's radius is 24 points of the window.
    let radius = 24.0 * f64::from(super::whole::PIXELS_PER_POINT);
    let brush = |viewer: &TestShell, line: &[[f32; 2]]| {
        let region = Region::Brush { line: pixels(viewer, line), radius };
        expected(viewer, &SplatSet::default(), &region, Reach::Through)
    };
    drag(&mut viewer, &line, Modifiers::NONE);
    let (first, second) = (brush(&viewer, &line), brush(&viewer, &other));
    assert!(!first.is_empty() && !second.is_empty() && first != second);
    assert_eq!(*marks(&viewer).selected, first);
    drag(&mut viewer, &other, Modifiers::SHIFT);
    assert_eq!(*marks(&viewer).selected, first.with(&second));
    drag(&mut viewer, &line, Modifiers::CTRL);
    assert_eq!(*marks(&viewer).selected, second.without(&first));

    // A search that adds to the selection does not cancel an earlier one.
    viewer.shell.viewer.clear_selection(A);
    for line in [&line, &other] {
        let region = Region::Brush { line: pixels(&viewer, line), radius };
        viewer.shell.viewer.select(A, region, Reach::Through, Combine::Add);
    }
    viewer.settle();
    assert_eq!(*marks(&viewer).selected, first.with(&second));

    // A click is a dab, and `+` makes it larger.
    let dab = |viewer: &mut TestShell| {
        drag(viewer, &[[0.4, 0.4]], Modifiers::NONE);
        marks(viewer).selected.len()
    };
    let small = dab(&mut viewer);
    for _ in 0..4 {
        press(&mut viewer, Key::Plus, Modifiers::NONE);
    }
    let large = dab(&mut viewer);
    assert!(small > 0 && large > small, "{small}, then {large}");

    // The brush finds fewer splats in front than through all depths.
    click(&mut viewer, "splats:front");
    let front = dab(&mut viewer);
    assert!(front > 0 && front < large, "{front} of {large}");

    press(&mut viewer, Key::I, Modifiers::NONE);
    assert_eq!(marks(&viewer).selected.len(), all - front);
    press(&mut viewer, Key::Escape, Modifiers::NONE);
    assert_eq!(marks(&viewer).selected.len(), all - front, "the first Esc leaves the brush");
    press(&mut viewer, Key::Escape, Modifiers::NONE);
    assert!(marks(&viewer).is_empty());
    assert_eq!(viewer.shell.panels.controls.find("splats"), None);

    // Hiding all splats is refused.
    press(&mut viewer, Key::A, Modifiers::COMMAND);
    assert_eq!(marks(&viewer).selected.len(), all);
    press(&mut viewer, Key::Delete, Modifiers::NONE);
    assert!(marks(&viewer).hidden.is_empty());
    let refused =
        |event: &Event| matches!(event, Event::Problem { text } if text.contains("nothing was hidden"));
    assert!(viewer.events.iter().any(refused), "{:#?}", viewer.events);

    // Hidden splats are neither selected nor inverted, until they are shown.
    drag(&mut viewer, &[[0.4, 0.4], [0.5, 0.5]], Modifiers::NONE);
    press(&mut viewer, Key::Escape, Modifiers::NONE);
    press(&mut viewer, Key::B, Modifiers::NONE);
    dab(&mut viewer);
    let Marks { selected, .. } = marks(&viewer);
    press(&mut viewer, Key::X, Modifiers::NONE);
    press(&mut viewer, Key::A, Modifiers::COMMAND);
    assert_eq!(marks(&viewer).selected.len(), all - selected.len());
    press(&mut viewer, Key::U, Modifiers::NONE);
    assert!(marks(&viewer).hidden.is_empty());
    viewer.close();
}

#[test]
fn the_left_button_moves_the_camera_unless_a_tool_selects() {
    let mut viewer = viewer();
    let camera = viewer.shell.viewer.world_camera();
    drag(&mut viewer, &CORNERS, Modifiers::NONE);
    assert!(viewer.shell.viewer.world_camera() != camera);
    assert!(marks(&viewer).is_empty());
    // With a tool active, the middle button moves the camera.
    press(&mut viewer, Key::R, Modifiers::NONE);
    let camera = viewer.shell.viewer.world_camera();
    let points = CORNERS.map(|share| at(&viewer, share));
    viewer.drag(PointerButton::Middle, &points);
    viewer.act();
    assert!(viewer.shell.viewer.world_camera() != camera);
    assert!(marks(&viewer).is_empty());
    viewer.close();
}
