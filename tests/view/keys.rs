//! Keys, windows of odd sizes and opened scenes in the whole viewer.

use super::whole::TestShell;
use egui::{Key, Modifiers};
use splatgraph::view::events::{Cause, Event, RendererId};
use std::sync::Arc;

fn viewer(size: (u32, u32)) -> TestShell {
    let mut viewer = TestShell::new(("demo", 500), "pipelines/splat.ron", size);
    viewer.settle();
    viewer
}

#[test]
fn the_key_that_hides_the_panels_gives_no_control_the_focus() {
    let mut viewer = viewer((320, 180));
    for hidden in [true, false, true, false] {
        // Focus moves at the end of a frame.
        viewer.press(Key::H, Modifiers::NONE);
        assert_eq!(viewer.shell.panels.hidden, hidden);
        assert!(!viewer.shell.context().egui_wants_keyboard_input());
    }
    viewer.press(Key::F1, Modifiers::NONE);
    assert!(viewer.shell.panels.help, "the keys are the viewer's");
    viewer.close();
}

#[test]
fn with_a_mistake_windows_of_whatever_size_are_drawn() {
    let mut viewer = viewer((320, 180));
    viewer.place.write("pipelines/splat.ron", "Graph(");
    viewer.until("the mistake", |viewer| viewer.shell.viewer.a.renderer.failure().is_some());
    for size in [(0, 0), (1, 1), (5, 180), (320, 3), (320, 180)] {
        viewer.size = size;
        viewer.frames(3);
    }
    assert_eq!(viewer.undrawn_windows, 0);
    viewer.close();
}

#[test]
fn an_opened_scene_is_drawn_without_a_new_plan_for_the_window() {
    let mut viewer = viewer((320, 180));
    let before = viewer.shell.window().plan().expect("the window has a plan").clone();
    let path = viewer.place.at("other.ply");
    viewer.place.scene("other.ply", "uniform", 300, 0);
    viewer.events.clear();
    viewer.shell.viewer.open(&path);
    viewer.event(
        "the other scene",
        |event| matches!(event, Event::Swapped { renderer: RendererId::A, swap, .. } if swap.causes.contains(&Cause::Scene)),
    );
    viewer.settle();
    let after = viewer.shell.window().plan().expect("the window has a plan");
    assert!(Arc::ptr_eq(&before, after), "the window has another plan");
    let window = |event: &&Event| matches!(event, Event::Swapped { renderer: RendererId::Window, .. });
    assert_eq!(viewer.events.iter().find(window), None);
    viewer.close();
}
