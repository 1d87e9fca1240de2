//! The tools around the picture: they show true values, and only the user changes settings.

use super::whole::{PIXELS_PER_POINT, TestShell};
use egui::{Key, Modifiers, Vec2};
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::panels::Tool;
use splatgraph::view::panels::selection::Selection;
use splatgraph_assets::synth;
use splatgraph_framework::ir::Value;
use std::sync::Arc;

/// Size of a window of 1600 x 900 points, in pixels.
const SIZE: (u32, u32) = (640, 360);

/// Opens a viewer of a small scene with all tools.
fn viewer(graph: &str) -> TestShell {
    let mut viewer = TestShell::new(("demo", 500), graph, SIZE);
    // The tool that is opened last is the front tab.
    let tools = [Tool::Cameras, Tool::Inspector, Tool::Times, Tool::Timeline, Tool::Parameters];
    viewer.shell.panels.open_tools(&tools);
    viewer.settle();
    viewer
}

fn choose(viewer: &mut TestShell, who: RendererId, graph: &str) {
    let path = viewer.place.named(&format!("pipelines/{graph}.ron"));
    let viewport = viewer.shell.viewer.viewport(who).expect("there is such a viewport");
    viewport.renderer.choose(&path, Default::default());
}

/// Draws frames until nothing is being built and times of A's plan are measured.
fn until_measured(viewer: &mut TestShell) {
    viewer.settle();
    viewer.until("times of the plan", |viewer| {
        let viewport = &viewer.shell.viewer.a;
        viewport.renderer.plan().is_some_and(|plan| viewport.history.is_of(plan))
    });
}

#[test]
fn the_picture_keeps_its_place_while_plans_are_built() {
    let mut viewer = viewer("pipelines/tiled.ron");
    let place = |viewer: &TestShell| viewer.shell.panels.controls.find("view").expect("there is a picture");
    let before = place(&viewer);
    let mut building = 0;
    // Every segment length needs another rasteriser, whose compilation takes the driver longer than a frame.
    for (changes, entries) in (3001..).take(12).enumerate() {
        // A busy machine may build a plan within one frame, which shows nothing.
        if changes >= 3 && building > 0 {
            break;
        }
        viewer.shell.viewer.a.renderer.set_param("segment", Some(Value::Int(entries)));
        let former = viewer.shell.viewer.a.renderer.plan().cloned();
        // Draws without pauses, as while the pointer moves.
        while viewer.shell.viewer.a.renderer.plan().map(Arc::as_ptr) == former.as_ref().map(Arc::as_ptr) {
            viewer.frame();
            assert_eq!(place(&viewer), before);
            building += usize::from(!viewer.shell.viewer.a.renderer.progress().is_empty());
        }
    }
    assert!(building > 0, "no frame was drawn while a plan was being built");
    viewer.close();
}

#[test]
fn a_change_of_the_digit_width_says_what_it_did_to_the_plan() {
    let mut viewer = viewer("pipelines/splat.ron");
    assert_eq!(viewer.shell.panels.controls.find("effect:digit_bits"), None);
    viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(4)));
    until_measured(&mut viewer);
    viewer.frame();
    assert!(viewer.shell.panels.controls.find("effect:digit_bits").is_some());
    let effect = |event: &Event| match event {
        Event::Swapped { renderer: RendererId::A, swap } => swap.effect.clone(),
        _ => None,
    };
    let effect = viewer.events.iter().find_map(effect).expect("the sort has other passes");
    assert!(effect.contains(" passes: sort "), "{effect}");
    let renderer = &mut viewer.shell.viewer.a.renderer;
    renderer.set_param("cull_margin", Some(Value::Float(0.5)));
    renderer.reset_params();
    until_measured(&mut viewer);
    viewer.frame();
    assert_eq!(viewer.shell.panels.controls.find("effect:digit_bits"), None, "the plan is another one");
    viewer.close();
}

#[test]
fn one_selection_runs_through_timeline_and_inspector() {
    let mut viewer = viewer("pipelines/splat.ron");
    viewer.frame();
    let names = |viewer: &TestShell, what: &str| {
        let controls = viewer.shell.panels.controls.iter().map(|(name, _)| name.to_owned());
        controls.filter(|name| name.contains(what)).collect::<Vec<_>>()
    };
    let scatter = names(&viewer, "scatter").into_iter().find(|name| name.starts_with("pass:"));
    let scatter = scatter.expect("the timeline shows a pass that scatters");
    let pass = scatter.strip_prefix("pass:").expect("a name").to_owned();
    // Pass widths follow their times, which still vary in the first frames.
    for _ in 0..20 {
        viewer.push(&scatter);
        if viewer.shell.panels.selection() == Some(&Selection::Pass(pass.clone())) {
            break;
        }
    }
    assert_eq!(viewer.shell.panels.selection(), Some(&Selection::Pass(pass.clone())));
    // The inspector lists what the pass reads and writes.
    let touched = names(&viewer, &format!("@{pass}"));
    assert!(touched.len() > 2, "{touched:?}");
    viewer.push("barrier:8");
    assert_eq!(viewer.shell.panels.selection(), Some(&Selection::Barrier(8)));
    viewer.press(Key::Escape, Modifiers::NONE);
    assert_eq!(viewer.shell.panels.selection(), None);
    viewer.close();
}

#[test]
fn a_comparison_shows_its_result_on_a_card_and_the_worst_pixel() {
    let mut viewer = viewer("pipelines/splat.ron");
    viewer.push("compare:split");
    viewer.settle();
    choose(&mut viewer, RendererId::B, "unsorted");
    viewer.settle();
    assert_eq!(viewer.shell.panels.controls.find("comparison"), None, "nothing is measured yet");
    viewer.push("measure");
    viewer.until("the result", |viewer| viewer.shell.viewer.comparison().is_some());
    viewer.frame();
    let (found, _) = viewer.shell.viewer.comparison().expect("it is there");
    assert!(found.psnr() < 40.0 && found.worst.difference > 0.0, "{found:?}");
    assert!(viewer.events.iter().any(|event| matches!(event, Event::Compared { .. })));
    assert!(viewer.shell.panels.controls.find("comparison").is_some());
    assert!(viewer.shell.viewer.comparison_is_current(), "at once, and not only after a while");
    viewer.push("worst");
    assert!(viewer.shell.viewer.comparison_is_current());
    // A comparison requested together with a change is measured after the change.
    choose(&mut viewer, RendererId::B, "splat");
    viewer.shell.viewer.measure();
    viewer.until("the next result", |viewer| !viewer.shell.viewer.is_comparing());
    let (found, _) = viewer.shell.viewer.comparison().expect("it is there");
    assert_eq!((found.psnr_db, found.worst.difference), (None, 0.0), "the same graph twice: {found:?}");
    let identical = |event: &Event| matches!(event, Event::Compared { identical: true, .. });
    let told = viewer.events.iter().find(|event| identical(event)).map(ToString::to_string);
    assert!(told.is_some_and(|told| told.ends_with(": identical")), "{:#?}", viewer.events);
    assert!(viewer.shell.viewer.comparison_is_current());
    viewer.shell.viewer.navigation.set_camera(&splatgraph_assets::Camera::looking_at(
        [0.0, -1.0, -4.0],
        [0.0; 3],
        60.0,
        (64, 36),
    ));
    viewer.frame();
    assert!(!viewer.shell.viewer.comparison_is_current(), "the camera moved");
    viewer.close();
}

#[test]
fn b_draws_another_scene_from_the_same_place_of_the_world() {
    let mut viewer = viewer("pipelines/splat.ron");
    let far = synth::generate("demo", 300, 7).expect("the scene is generated").with_offset([3.0, -2.0, 1.0]);
    let (first, other) = (viewer.place.at("scene.ply"), viewer.place.at("other.ply"));
    far.write_ply(&other).expect("the scene is written");
    viewer.push("compare:split");
    viewer.settle();
    viewer.shell.viewer.measure();
    viewer.until("a result", |viewer| !viewer.shell.viewer.is_comparing());
    let psnr = |viewer: &TestShell| viewer.shell.viewer.comparison().expect("it is there").0.psnr();
    assert!(psnr(&viewer).is_infinite(), "B starts as a copy of A");
    let camera = viewer.shell.viewer.world_camera();
    viewer.shell.viewer.open_scene_in(RendererId::B, &other);
    viewer.shell.viewer.measure();
    viewer.until("the next result", |viewer| !viewer.shell.viewer.is_comparing());
    assert!(psnr(&viewer) < 40.0, "{} dB", psnr(&viewer));
    assert_eq!(viewer.shell.viewer.world_camera(), camera);
    assert_eq!(viewer.shell.viewer.scene_path(), first);
    assert_eq!(viewer.shell.viewer.scene_of(RendererId::B).count(), 300);
    let command = viewer.shell.viewer.render_command(RendererId::B, "b.png".as_ref()).expect("there is a B");
    assert!(command.contains("other.ply"), "{command}");
    // The exchange swaps the scenes as well, and reads no file again.
    viewer.shell.viewer.exchange();
    viewer.settle();
    assert_eq!(viewer.shell.viewer.scene_path(), other);
    assert_eq!(viewer.shell.viewer.scene_path_of(RendererId::B), first);
    let now = viewer.shell.viewer.world_camera();
    let away = now.position.iter().zip(camera.position).map(|(a, b)| (a - b).abs());
    assert!(away.fold(0.0, f64::max) < 1e-5, "the camera stays where it is");
    // After both steps are undone, B shares A's scene again.
    for _ in 0..2 {
        viewer.press(Key::Z, Modifiers::COMMAND);
        viewer.settle();
    }
    assert_eq!(viewer.shell.viewer.scene_path(), first);
    assert!(!viewer.shell.viewer.has_two_scenes());
    viewer.close();
}

#[test]
fn keys_act_on_nothing_else_while_a_menu_is_open() {
    let mut viewer = viewer("pipelines/splat.ron");
    let hidden = |viewer: &mut TestShell| {
        viewer.press(Key::H, Modifiers::NONE);
        std::mem::take(&mut viewer.shell.panels.hidden)
    };
    assert!(hidden(&mut viewer));
    viewer.frame();
    viewer.push("menu");
    assert!(!hidden(&mut viewer), "the menu has no field, and takes the keys all the same");
    viewer.press(Key::Escape, Modifiers::NONE);
    assert!(hidden(&mut viewer));
    viewer.close();
}

#[test]
fn a_pass_is_held_against_a_copy_of_its_bytes() {
    let mut viewer = viewer("pipelines/splat.ron");
    until_measured(&mut viewer);
    viewer.shell.panels.select(Selection::Pass("project".to_owned()));
    viewer.frame();
    viewer.frame();
    assert_eq!(viewer.shell.viewer.copy_limit(), None);
    let before = viewer.shell.viewer.a.history.frames();
    viewer.push("measure_copy");
    viewer.until("the rate", |viewer| viewer.shell.viewer.copy_limit().is_some());
    let rate = viewer.shell.viewer.copy_limit().expect("it is measured");
    assert!((0.01..100_000.0).contains(&rate), "{rate} GB/s");
    assert!(viewer.shell.viewer.a.history.frames() > before, "pictures went on");
    assert!(!viewer.shell.viewer.is_measuring_copy());
    viewer.close();
}

#[test]
fn tools_leave_the_picture_its_room_in_windows_of_every_size() {
    let mut viewer = viewer("pipelines/splat.ron");
    for points in [(1600.0, 900.0), (1200.0, 800.0), (600.0, 500.0), (500.0, 400.0), (340.0, 300.0)] {
        viewer.size = ((points.0 * PIXELS_PER_POINT) as u32, (points.1 * PIXELS_PER_POINT) as u32);
        viewer.frames(4);
        let view = viewer.shell.panels.controls.find("view").expect("there is a picture");
        let least = Vec2::new(320.0_f32.min(points.0 - 1.0), 0.0);
        assert!(view.width() >= least.x - 3.0, "{view:?} in a window of {points:?} points");
    }
    viewer.close();
}
