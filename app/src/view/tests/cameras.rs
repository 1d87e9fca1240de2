//! Tests picking, playback of a path, and saved views, on the null device.

use super::script::{GRAPH, Script, arranged};
use crate::draw::pick;
use crate::draw::splat_set::Masked;
use crate::view::cameras::write;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::Input;
use crate::view::opening::CameraRole;
use crate::view::viewer::Viewer;
use splatgraph_assets::{Camera, Projection, synth};
use splatgraph_null::Config;
use std::path::Path;

/// Origin with coordinates that are not short binary fractions, so that conversion to world coordinates rounds a
/// camera.
const FAR: [f64; 3] = [512_345.1, -4_000_000.7, 1_000.3];

/// Runs `steps` on a viewer that has drawn its scene. `change` may first edit the files in its folder.
fn visit(change: impl FnOnce(&Path), steps: impl FnOnce(&mut Script)) -> Vec<Event> {
    let folder = arranged();
    change(folder.path());
    let mut script = Script::open_in(folder, &Config::default(), false);
    script.settle();
    steps(&mut script);
    let (_, events, _) = script.close(&[]);
    events
}

fn wait(seconds: f64) -> Input {
    Input { size: [320.0, 180.0], seconds, ..Input::default() }
}

fn drag(x: f64, y: f64) -> Input {
    Input { moved: [x, y], drags: true, ..wait(0.01) }
}

/// Records three keys of an orbit, and returns to the first.
fn record(viewer: &mut Viewer) {
    for _ in 0..3 {
        viewer.record_key().expect("a sound camera");
        viewer.navigate(&drag(120.0, 15.0));
    }
    viewer.seek_path(0.0);
}

#[test]
fn splats_are_picked_in_the_last_picture_until_another_scene_is_shown() {
    visit(
        |_| {},
        |script| {
            assert!(script.viewer().picked.is_none());
            script.viewer().pick(RendererId::A, [160.7, 90.2]);
            assert!(script.viewer().is_picking());
            script.until("the splats", |script| script.viewer().picked.is_some());
            let viewer = script.viewer();
            let camera = viewer.picture_camera();
            assert_eq!((camera.width, camera.height), (320, 180));
            let expected = pick::pick(&Masked::whole(viewer.scene()), &camera, [160, 90], &|| false);
            assert_eq!(viewer.picked, expected);
            assert!(viewer.picked.as_ref().is_some_and(|picked| picked.splats.len() > 1));
            for outside in [[320.0, 0.0], [0.0, 180.0], [-0.1, 5.0], [f32::NAN, 5.0]] {
                viewer.pick(RendererId::A, [160.7, 90.2]);
                viewer.pick(RendererId::A, outside);
                assert!(viewer.picked.is_none() && !viewer.is_picking(), "{outside:?}");
            }
            // The distance from the last pick is that of the selected splats, and outlives a pick of the background.
            let picked = |script: &mut Script, at: [f32; 2]| {
                script.viewer().pick(RendererId::A, at);
                script.until("the splats", |script| !script.viewer().busy());
                script.viewer().picked.as_ref().and_then(|picked| picked.splat()).map(|s| s.gaussian.position)
            };
            let first = picked(script, [160.7, 90.2]).expect("a splat");
            assert_eq!(script.viewer().picked_distance(), None);
            assert_eq!(picked(script, [0.0, 0.0]), None);
            let other = picked(script, [140.0, 100.0]).expect("a splat");
            let expected = (0..3).map(|i| (first[i] - other[i]).powi(2)).sum::<f64>().sqrt();
            let found = script.viewer().picked_distance().expect("two splats");
            assert!((found - expected).abs() < 1e-12 && found > 0.0, "{found}");
            let viewer = script.viewer();
            viewer.pick(RendererId::A, [160.7, 90.2]);
            let second = script.path("second.ply");
            script.viewer().open(&second);
            script.until("the scene", |script| script.viewer().scene().count() == 200);
            assert!(script.viewer().picked.is_none() && script.viewer().picked_distance().is_none());
        },
    );
}

#[test]
fn the_wheel_enlarges_the_view_of_an_orthographic_graph_without_moving_the_eye() {
    visit(orthographic, |script| {
        script.frame(false);
        let viewer = script.viewer();
        let before = viewer.picture_camera();
        viewer.navigate(&Input { scroll: 20.0, ..wait(0.01) });
        let after = viewer.picture_camera();
        assert_eq!(after.position, before.position);
        assert!(after.fy > 10.0 * before.fy);
        assert!((viewer.navigation.height() * after.fy / f64::from(after.height) - 1.0).abs() < 1e-12);
        // The camera as saved or as copied draws the same picture.
        let camera = viewer.world_camera().projected(Projection::Orthographic, viewer.scene());
        assert_eq!(camera, after);
    });
}

#[test]
fn another_up_turns_the_scene_upright_unless_it_has_cameras() {
    visit(
        |_| {},
        |script| {
            let viewer = script.viewer();
            let eye = |viewer: &Viewer| viewer.picture_camera().axes()[1];
            viewer.set_up([0.0, 0.0, 1.0]);
            assert!(eye(viewer)[2] < -0.9, "{:?}", eye(viewer));
            viewer.navigate(&Input { home: true, ..drag(50.0, 0.0) });
            assert!(eye(viewer)[2] < -0.9, "the first view is upright, too");
            let camera = Camera::framing(viewer.scene(), 320, 180);
            viewer.set_cameras(vec![camera.clone()]);
            viewer.set_up([0.0, 0.0, 1.0]);
            assert_eq!(viewer.navigation.camera(320, 180), camera);
            assert_eq!(viewer.navigation.up().to_array(), [0.0, 0.0, 1.0]);
        },
    );
}

fn orthographic(folder: &Path) {
    let parameter = "params: {\n    \"projection\": Const(Choice(default: \"orthographic\", of: [\"pinhole\", \"orthographic\"])),";
    std::fs::write(folder.join("graph.ron"), GRAPH.replace("params: {", parameter)).expect("it is written");
}

#[test]
fn keys_recorded_before_and_after_a_move_have_the_projection_of_the_camera() {
    for projection in [Projection::Fisheye, Projection::Orthographic] {
        visit(orthographic, |script| {
            let viewer = script.viewer();
            let camera = Camera::framing(viewer.scene(), 320, 180);
            let center = viewer.scene().robust_bounds().center();
            viewer.set_cameras(vec![camera.with_projection(projection, center)]);
            record(viewer);
            let keys = viewer.path.keys().to_vec();
            assert_eq!(keys.len(), 3);
            assert!(keys.iter().all(|key| key.projection == projection), "{keys:#?}");
            assert!(keys[0] != keys[1]);
            // An orthographic graph draws an orthographic picture from any camera, and its command names that
            // projection.
            script.frame(false);
            let viewer = script.viewer();
            assert_eq!(viewer.picture_camera().projection, Projection::Orthographic);
            let line = viewer.render_command(RendererId::A, Path::new("picture.png")).expect("A is there");
            assert!(line.contains("\"projection\":\"orthographic\""), "{line}");
        });
    }
}

#[test]
fn a_path_moves_the_camera_until_the_user_does() {
    let events = visit(
        |folder| {
            let scene = synth::generate("uniform", 100, 0).expect("the scene is generated").with_offset(FAR);
            scene.write_ply(folder.join("first.ply")).expect("the scene is written");
        },
        |script| {
            let viewer = script.viewer();
            record(viewer);
            let offset = viewer.scene().offset();
            assert!(offset.iter().all(|v| v.abs() > 100.0), "{offset:?}");
            let shown = |viewer: &Viewer, seconds: f64| {
                let expected = viewer.path.at(seconds).expect("a camera").relative_to(offset);
                viewer.navigation.camera(320, 180) == expected
            };
            assert!(shown(viewer, 0.0) && !viewer.is_moving());
            viewer.play.play(&viewer.path);
            assert!(viewer.is_moving());
            assert!(viewer.navigate(&wait(60.0)) && shown(viewer, 0.0));
            assert!(viewer.navigate(&wait(2.0)) && shown(viewer, 2.0));
            viewer.navigate(&wait(1.0));
            assert!(shown(viewer, 3.0));
            // The user continues from the path's current camera.
            assert!(viewer.navigate(&drag(1.0, 0.0)));
            assert!(!viewer.play.is_playing() && viewer.play.position() > 3.0);
            let near = viewer.path.at(3.01).expect("a camera").relative_to(offset);
            let now = viewer.navigation.camera(320, 180);
            let away = (0..3).map(|i| (near.position[i] - now.position[i]).abs()).fold(0.0, f64::max);
            assert!(away < 0.1 && !viewer.navigate(&wait(1.0)), "{away}");
            // Anything else that moves the camera ends playback as well: a button, a selected camera, a file.
            for other in 0..3 {
                viewer.play.play(&viewer.path);
                viewer.navigate(&wait(0.0));
                viewer.navigate(&wait(0.5));
                assert!(viewer.play.is_playing());
                match other {
                    0 => viewer.navigation.home(),
                    1 => viewer.navigation.set_field_of_view(33.0),
                    _ => viewer.set_cameras(vec![Camera::framing(viewer.scene(), 64, 36)]),
                }
                let moved = viewer.navigation.camera(320, 180);
                viewer.navigate(&wait(0.5));
                assert!(!viewer.play.is_playing(), "{other}");
                assert_eq!(viewer.navigation.camera(320, 180), moved, "{other}");
            }
            // Seeking moves the camera, and playback continues.
            viewer.play.play(&viewer.path);
            viewer.navigate(&wait(0.0));
            viewer.seek_path(7.0);
            assert!(shown(viewer, 7.0));
            viewer.navigate(&wait(0.25));
            assert!(viewer.play.is_playing() && shown(viewer, 7.25));
            viewer.navigate(&wait(99.0));
            assert!(!viewer.play.is_playing() && shown(viewer, 10.0));
        },
    );
    assert!(!events.iter().any(|event| matches!(event, Event::Problem { .. })), "{events:#?}");
}

#[test]
fn views_and_paths_come_back_from_their_files_and_show_the_same_picture() {
    for offset in [[0.0; 3], FAR] {
        visit(
            |folder| {
                let scene =
                    synth::generate("uniform", 100, 0).expect("the scene is generated").with_offset(offset);
                scene.write_ply(folder.join("first.ply")).expect("the scene is written");
            },
            |script| {
                let folder = script.path("");
                let viewer = script.viewer();
                record(viewer);
                let keys = viewer.path.keys().to_vec();
                viewer.navigate(&drag(33.0, -7.0));
                assert_eq!(viewer.save_view("front"), 0);
                let picture = viewer.picture_camera();
                viewer.navigate(&drag(-200.0, 3.0));
                viewer.save_view("front");
                let file = write(viewer.views.list(), &folder, "views").expect("views are written");
                let path = write(viewer.path.keys(), &folder, "path").expect("the path is written");
                viewer.look_through_view(0);
                let named = Camera { img_name: "front".into(), ..picture.clone() };
                assert_eq!(viewer.picture_camera(), named, "to the bit");
                viewer.path.set_keys(Vec::new()).expect("no key is unusable");
                viewer.open_cameras_as(CameraRole::Views, &file);
                viewer.open_cameras_as(CameraRole::Path, &path);
                script.until("the files", |script| {
                    !script.viewer().busy() && !script.viewer().path.keys().is_empty()
                });
                let viewer = script.viewer();
                let numbered = (0..).zip(keys).map(|(id, key)| Camera { id, ..key });
                assert_eq!(viewer.path.keys(), numbered.collect::<Vec<_>>());
                let names: Vec<&str> =
                    viewer.views.list().iter().map(|view| view.img_name.as_str()).collect();
                assert_eq!(names, ["front", "front 2", "front 3", "front 2 2"]);
                assert_eq!(viewer.views.list()[2].position, viewer.views.list()[0].position);
                viewer.look_through_view(2);
                let named = Camera { img_name: "front 3".into(), ..picture };
                assert_eq!(viewer.picture_camera(), named, "to the bit, from the file");
                // Saved views do not count as the scene's cameras.
                assert!(viewer.cameras().is_empty());
            },
        );
    }
}

#[test]
fn a_file_that_is_no_list_of_cameras_changes_no_view_and_no_path() {
    let events = visit(
        |folder| std::fs::write(folder.join("bad.json"), "[{}]").expect("it is written"),
        |script| {
            let file = script.path("bad.json");
            record(script.viewer());
            script.viewer().save_view("own");
            script.viewer().open_cameras_as(CameraRole::Views, &file);
            script.viewer().open_cameras_as(CameraRole::Path, &file);
            script.until("both errors", |script| {
                let failed = |event: &&Event| matches!(event, Event::FileFailed { .. });
                script.events.iter().filter(failed).count() == 2
            });
            assert_eq!((script.viewer().views.list().len(), script.viewer().path.keys().len()), (1, 3));
        },
    );
    let text = events.iter().find(|event| matches!(event, Event::FileFailed { .. })).map(ToString::to_string);
    assert!(text.is_some_and(|text| text.contains("camera 0: missing field")), "{events:#?}");
}
