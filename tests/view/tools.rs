//! The tools around the picture: what they show is true, and only a person changes anything.

use super::whole::{PIXELS_PER_POINT, TestShell};
use crate::common;
use egui::{Key, Modifiers, Vec2};
use splatgraph::backend::Validation;
use splatgraph::builtin;
use splatgraph::view::events::Event;
use splatgraph::view::panels::Tool;
use splatgraph::view::panels::selection::Selection;
use splatgraph_framework::ir::Value;
use std::sync::Arc;

/// Size of a window of 1600 x 900 points, in pixels.
const SIZE: (u32, u32) = (640, 360);

/// Opens a viewer of a small scene with all tools.
fn viewer(graph: &str) -> TestShell {
    let mut viewer =
        TestShell::new(&common::options(Validation::Synchronization), ("demo", 500), graph, SIZE);
    // The one opened last is in front of its tabs.
    let tools = [Tool::Cameras, Tool::Inspector, Tool::Times, Tool::Timeline, Tool::Parameters];
    viewer.shell.panels.open_tools(&tools);
    viewer.settle();
    viewer
}

fn passes(viewer: &TestShell) -> usize {
    viewer.shell.viewer.a.renderer.plan().expect("there is a plan").frame.len()
}

/// Draws every frame until the next plan is measured, with all tools looking on.
fn until_measured(viewer: &mut TestShell) {
    viewer.settle();
    viewer.until("times of the plan", |viewer| {
        let viewport = &viewer.shell.viewer.a;
        viewport.renderer.plan().is_some_and(|plan| viewport.history.is_of(plan))
    });
}

#[test]
fn a_plan_with_fewer_passes_leaves_the_open_tools_alone() {
    let mut viewer = viewer("pipelines/splat.ron");
    viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(4)));
    until_measured(&mut viewer);
    let many = passes(&viewer);
    viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(11)));
    until_measured(&mut viewer);
    assert!(passes(&viewer) < many, "{} passes after {many}", passes(&viewer));
    for graph in ["digit4", "digit8", "splat", "unsorted"] {
        let graph = viewer.path(&format!("pipelines/{graph}.ron"));
        viewer.shell.viewer.a.renderer.choose(&graph.to_string_lossy(), Default::default());
        until_measured(&mut viewer);
    }
    viewer.close();
}

#[test]
fn the_picture_keeps_its_place_while_plans_are_built() {
    let mut viewer = viewer("pipelines/splat.ron");
    let place = |viewer: &TestShell| viewer.shell.panels.controls.find("view").expect("there is a picture");
    let before = place(&viewer);
    let mut building = 0;
    for bits in [4, 8, 11] {
        viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(bits)));
        let former = viewer.shell.viewer.a.renderer.plan().cloned();
        // One frame after another, as while the pointer moves.
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
    viewer.close();
}

#[test]
fn nothing_is_changed_by_looking_at_it() {
    let mut viewer = viewer("pipelines/splat.ron");
    for preset in builtin::names() {
        let graph = viewer.path(&format!("pipelines/{preset}.ron"));
        viewer.shell.viewer.a.renderer.choose(&graph.to_string_lossy(), Default::default());
        viewer.settle();
        let values = |viewer: &TestShell| {
            let controls = viewer.shell.viewer.a.renderer.controls().iter().map(|control| &control.param);
            controls
                .filter(|param| param.grows.is_none())
                .map(|p| (p.name.clone(), p.value.clone()))
                .collect::<Vec<_>>()
        };
        let before = values(&viewer);
        for _ in 0..100 {
            viewer.frame();
        }
        assert_eq!(values(&viewer), before, "{preset}");
        let renderer = &viewer.shell.viewer.a.renderer;
        assert!(renderer.failure().is_none(), "{preset}: {:?}", renderer.problem(false));
        assert!(renderer.set().is_empty(), "{preset}: {:?}", renderer.set());
    }
    viewer.close();
}

#[test]
fn a_step_is_undone_and_done_again() {
    let mut viewer = viewer("pipelines/splat.ron");
    viewer.frame();
    let set = |viewer: &TestShell| viewer.shell.viewer.a.renderer.set().get("digit_bits").cloned();
    viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(4)));
    viewer.settle();
    viewer.shell.viewer.a.renderer.set_param("budget", Some(Value::Float(0.5)));
    viewer.frame();
    let undo = |viewer: &mut TestShell, modifiers| {
        viewer.key(Key::Z, modifiers);
        viewer.act();
    };
    undo(&mut viewer, Modifiers::COMMAND);
    assert!(!viewer.shell.viewer.a.renderer.set().contains_key("budget"));
    assert_eq!(set(&viewer).as_deref(), Some("4"));
    undo(&mut viewer, Modifiers::COMMAND);
    assert_eq!(set(&viewer), None);
    undo(&mut viewer, Modifiers::COMMAND | Modifiers::SHIFT);
    assert_eq!(set(&viewer).as_deref(), Some("4"));
    let unsorted = viewer.path("pipelines/unsorted.ron");
    viewer.shell.viewer.a.renderer.choose(&unsorted.to_string_lossy(), Default::default());
    viewer.settle();
    undo(&mut viewer, Modifiers::COMMAND);
    viewer.settle();
    assert!(viewer.shell.viewer.a.renderer.graph().ends_with("splat.ron"));
    assert_eq!(set(&viewer).as_deref(), Some("4"), "the graph comes back with its parameters");
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
    // Passes are as wide as their times, which the first frames still change before the pointer is there.
    for _ in 0..20 {
        assert!(viewer.click(&scatter));
        viewer.act();
        if viewer.shell.panels.selection() == Some(&Selection::Pass(pass.clone())) {
            break;
        }
    }
    assert_eq!(viewer.shell.panels.selection(), Some(&Selection::Pass(pass.clone())));
    // The inspector lists what the pass reads and writes.
    let touched = names(&viewer, &format!("@{pass}"));
    assert!(touched.len() > 2, "{touched:?}");
    assert!(viewer.click("barrier:8"), "the timeline shows the barrier");
    viewer.act();
    assert_eq!(viewer.shell.panels.selection(), Some(&Selection::Barrier(8)));
    viewer.key(Key::Escape, Modifiers::NONE);
    viewer.act();
    assert_eq!(viewer.shell.panels.selection(), None);
    viewer.close();
}

#[test]
fn a_comparison_shows_its_result_on_a_card_and_the_worst_pixel() {
    let mut viewer = viewer("pipelines/splat.ron");
    assert!(viewer.click("compare:split"));
    viewer.act();
    viewer.settle();
    let unsorted = viewer.path("pipelines/unsorted.ron");
    let b = viewer.shell.viewer.b.as_mut().expect("there is a B");
    b.renderer.choose(&unsorted.to_string_lossy(), Default::default());
    viewer.settle();
    assert_eq!(viewer.shell.panels.controls.find("comparison"), None, "nothing is measured yet");
    assert!(viewer.click("measure"));
    viewer.act();
    viewer.until("the result", |viewer| viewer.shell.viewer.comparison().is_some());
    viewer.frame();
    let found = viewer.shell.viewer.comparison().expect("it is there").clone();
    assert!(found.psnr < 40.0 && found.worst > 0.0, "{found:?}");
    assert!(viewer.events.iter().any(|event| matches!(event, Event::Compared { .. })));
    assert!(viewer.shell.panels.controls.find("comparison").is_some());
    assert!(viewer.click("worst"));
    viewer.act();
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
fn tools_leave_the_picture_its_room_in_windows_of_every_size() {
    let mut viewer = viewer("pipelines/splat.ron");
    for points in [(1600.0, 900.0), (1200.0, 800.0), (600.0, 500.0), (500.0, 400.0), (340.0, 300.0)] {
        viewer.size = ((points.0 * PIXELS_PER_POINT) as u32, (points.1 * PIXELS_PER_POINT) as u32);
        for _ in 0..4 {
            viewer.frame();
        }
        let view = viewer.shell.panels.controls.find("view").expect("there is a picture");
        let least = Vec2::new(320.0_f32.min(points.0 - 1.0), 0.0);
        assert!(view.width() >= least.x - 3.0, "{view:?} in a window of {points:?} points");
    }
    viewer.close();
}
