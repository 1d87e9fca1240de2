//! Tests that the viewer submits frames only for changes, and that a slow picture does not block it.

use super::script::{GRAPH, Script, arranged};
use crate::view::events::{Event, RendererId};
use crate::view::navigation::Input;
use egui::{Key, Modifiers};
use splatgraph_api::BufferContents;
use splatgraph_assets::Camera;
use splatgraph_framework::ir::Value;
use splatgraph_null::Config;

/// Opens a viewer that draws only on changes, and is at rest.
fn resting() -> Script {
    let mut script = Script::open(&Config::default());
    script.viewer().continuous = false;
    script.settle();
    script.rest();
    script.submissions();
    script
}

fn submitted(script: &mut Script) -> usize {
    script.rest();
    script.submissions()
}

#[test]
fn nothing_is_submitted_while_nothing_changes() {
    let mut script = resting();
    for _ in 0..100 {
        let frame = script.frame(false).expect("the device is not lost");
        assert!(!frame.drawn && frame.next.is_none());
    }
    assert_eq!(script.submissions(), 0);
    script.close(&[]);
}

#[test]
fn a_frame_that_the_window_did_not_show_is_drawn_again_until_it_is_shown() {
    let mut script = resting();
    let size = script.shell.window().size();
    // The window's surface has no pixels.
    script.resize_swapchain((0, 0));
    for _ in 0..3 {
        let frame = script.redraw().expect("the device is not lost");
        assert!(frame.drawn && frame.next.is_some());
        script.submissions();
    }
    script.resize(size);
    assert_eq!(submitted(&mut script), 1);
    script.close(&[]);
}

#[test]
fn a_plan_with_a_prologue_is_drawn_once_more_so_that_it_has_times() {
    let mut script = resting();
    let history = |script: &mut Script| {
        let history = &script.viewer().a.history;
        (history.frames(), history.steady_frames(), history.table().len())
    };
    let (frames, steady, rows) = history(&mut script);
    assert!(steady == 1 && rows > 0, "{frames} frames, {steady} without the prologue, {rows} rows");
    script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
    script.settle();
    script.rest();
    let (after, steady, _) = history(&mut script);
    assert_eq!((after - frames, steady), (2, 1));
    script.close(&[]);
}

#[test]
fn a_picture_and_the_window_are_submitted_after_each_change_of_the_picture() {
    let mut script = resting();
    script.viewer().a.renderer.set_param("shade", Some(Value::Float(0.25)));
    assert_eq!(submitted(&mut script), 2, "a live parameter");
    let orbit = Input { orbit: [-1.0, 0.0], seconds: 0.1, ..Input::default() };
    assert!(script.viewer().navigation.update(&orbit));
    assert_eq!(submitted(&mut script), 2, "the camera");
    script.viewer().background = [0.5; 3];
    assert_eq!(submitted(&mut script), 2, "the background");
    script.resize((200, 100));
    let frames = submitted(&mut script);
    assert!((2..10).contains(&frames), "{frames} frames for a new size");
    script.viewer().a.want_picture();
    assert_eq!(submitted(&mut script), 2, "a picture to save");
    assert!(script.viewer().a.take_picture().is_some_and(|picture| picture.is_ok()));
    script.viewer().a.look_at("keys", "key");
    assert!(submitted(&mut script) > 0);
    let inspection = script.viewer().a.inspection.take().expect("there is an inspection");
    assert!(matches!(inspection.found, Some(Ok(_))));
    script.close(&[]);
}

#[test]
fn what_is_inspected_is_read_again_in_each_new_plan_and_is_an_error_without_its_resource() {
    let mut script = resting();
    let found = |script: &mut Script| {
        script.settle();
        assert!(!script.viewer().a.lacks_finding());
        script.viewer().a.inspection.as_ref().and_then(|i| i.found.clone()).expect("a finding")
    };
    script.viewer().a.look_at("table", "once");
    assert_eq!(found(&mut script).expect("contents").shape, [1024]);
    script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
    assert_eq!(found(&mut script).expect("contents").shape, [2048]);
    let save = |script: &mut Script, text: &str| {
        let swaps = |script: &Script| {
            script.events.iter().filter(|event| matches!(event, Event::Swapped { .. })).count()
        };
        let before = swaps(script);
        script.write("graph.ron", text);
        script.until("the file", |script| swaps(script) > before);
    };
    save(&mut script, &GRAPH.replace("\"table\"", "\"list\""));
    script.until("an error", |script| {
        let found = script.viewer().a.inspection.as_ref().and_then(|i| i.found.as_ref());
        matches!(found, Some(Err(error)) if error.contains("no resource `table`"))
    });
    save(&mut script, GRAPH);
    assert_eq!(found(&mut script).expect("contents").shape, [2048]);
    script.close(&[]);
}

#[test]
fn undoing_brings_removed_views_back_with_their_names_and_keys_of_the_path() {
    let mut script = resting();
    for name in ["front", "side"] {
        script.viewer().save_view(name);
        script.frame(false);
    }
    script.viewer().views.remove(0);
    script.frame(false);
    script.press(Key::Z, Modifiers::COMMAND);
    let names = |script: &mut Script| {
        script.viewer().views.list().iter().map(|view| view.img_name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(names(&mut script), ["front", "side"]);
    script.press(Key::Z, Modifiers::COMMAND);
    assert_eq!(names(&mut script), ["front"]);
    // The same for the camera path.
    for _ in 0..2 {
        let viewer = script.viewer();
        viewer.record_key().expect("a sound camera");
        viewer.navigate(&Input { orbit: [1.0, 0.0], seconds: 0.5, ..Input::default() });
        script.frame(false);
    }
    let path = |script: &mut Script| {
        let path = &script.viewer().path;
        (path.keys().to_vec(), path.is_closed(), path.seconds(), path.at(1.0))
    };
    let two = path(&mut script);
    for change in 0..4 {
        let viewer = script.viewer();
        match change {
            0 => viewer.path.remove(0),
            1 => viewer.path.reorder(0, 1),
            2 => viewer.path.set_closed(true),
            _ => viewer.path.set_seconds(3.0),
        }
        let changed = path(&mut script);
        script.frame(false);
        script.press(Key::Z, Modifiers::COMMAND);
        assert_eq!(path(&mut script), two, "{change}");
        script.press(Key::Z, Modifiers::COMMAND | Modifiers::SHIFT);
        assert_eq!(path(&mut script), changed, "{change}");
        script.press(Key::Z, Modifiers::COMMAND);
    }
    script.press(Key::Z, Modifiers::COMMAND);
    assert_eq!(path(&mut script).0, two.0[..1]);
    script.close(&[]);
}

#[test]
fn undoing_skips_a_parameter_that_the_file_no_longer_declares() {
    let mut script = resting();
    script.viewer().background = [0.5; 3];
    script.rest();
    script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
    script.settle();
    assert_eq!(script.panels().undo_steps(), 2);
    let text = GRAPH.replace("\"digits\"", "\"numbers\"").replace("<< digits", "<< numbers");
    script.write("graph.ron", text);
    script.until("the file", |script| script.has_event(|event| matches!(event, Event::Dropped { .. })));
    script.settle();
    script.press(Key::Z, Modifiers::COMMAND);
    assert_eq!(script.viewer().background, [0.0; 3]);
    assert_eq!(script.panels().undo_steps(), 0);
    script.close(&[]);
}

#[test]
fn a_setting_that_an_edit_excludes_is_dropped_with_the_reason_once_the_graph_builds_and_restored_with_it() {
    let mut script = resting();
    let digits = |script: &mut Script| {
        let renderer = &script.viewer().a.renderer;
        let param = renderer.plan().expect("a plan").params[0].clone();
        (param.value.to_string(), renderer.set().get("digits").cloned())
    };
    script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
    script.viewer().a.renderer.set_param("shade", Some(Value::Float(0.25)));
    script.settle();
    // Renaming a declaration without its uses is an error; the former plan keeps its setting.
    let save = |script: &mut Script, from: &str, to: &str| {
        script.events.clear();
        script.write("graph.ron", GRAPH.replace(from, to));
        script.until("the save", |script| {
            script.has_event(|event| matches!(event, Event::Swapped { .. } | Event::Failed { .. }))
        });
        script.settle_in_part();
        let text = |event: &Event| match event {
            Event::Dropped { .. } | Event::Restored { .. } => Some(event.to_string()),
            _ => None,
        };
        script.events.iter().filter_map(text).collect::<Vec<_>>()
    };
    assert!(save(&mut script, "\"digits\"", "\"numbers\"").is_empty());
    assert!(script.viewer().a.renderer.failure().is_some());
    assert_eq!(digits(&mut script), ("5".to_owned(), Some("5".to_owned())));
    assert!(save(&mut script, "digits", "digits").is_empty());
    assert_eq!(digits(&mut script), ("5".to_owned(), Some("5".to_owned())));
    // A range that excludes the setting is no error.
    let excluded = save(&mut script, "default: 4, range: (1, 8)", "default: 2, range: (1, 3)");
    assert_eq!(excluded, ["A: digits is now 2: expected an integer from 1 to 3, found 5"]);
    assert_eq!(digits(&mut script), ("2".to_owned(), None));
    assert_eq!(script.panels().undo_steps(), 1);
    assert_eq!(save(&mut script, "digits", "digits"), ["A: digits is 5 again"]);
    assert_eq!(digits(&mut script), ("5".to_owned(), Some("5".to_owned())));
    assert_eq!(
        save(&mut script, "digits", "figures"),
        ["A: this graph has no parameter digits, which was 5"]
    );
    assert_eq!(script.viewer().a.renderer.set()["shade"], "0.25", "other settings stay");
    // A later mistake in a declaration is reported alone.
    assert!(
        save(&mut script, "\"digits\": Const(Int(default: 4", "\"figures\": Const(Int(default: 9").is_empty()
    );
    let failure = script.viewer().a.renderer.failure().expect("an error").text(false);
    assert!(failure.contains("figures") && !failure.contains("--set"), "{failure}");
    // A reset overrides the setting that was dropped earlier, which is not restored.
    script.viewer().a.renderer.reset_params();
    assert!(save(&mut script, "digits", "digits").is_empty());
    assert_eq!(digits(&mut script), ("4".to_owned(), None));
    script.close(&[]);
}

#[test]
fn a_parameter_that_a_preset_sets_can_have_its_default_and_returns_to_the_presets_value() {
    let mut script = resting();
    let preset = script.path("preset.ron");
    let text = r#"Preset(graph: "graph.ron", summary: "", set: { "digits": 6, "shade": 0.25 })"#;
    script.write("preset.ron", text);
    script.viewer().a.renderer.choose(&preset.to_string_lossy(), Default::default());
    script.settle();
    for (value, expected) in [(Some(Value::Int(4)), "4"), (Some(Value::Int(6)), "6"), (None, "6")] {
        script.viewer().a.renderer.set_param("digits", value);
        script.settle();
        let plan = script.viewer().a.renderer.plan().expect("a plan").clone();
        assert_eq!(plan.params[0].value.to_string(), expected);
    }
    let renderer = &mut script.viewer().a.renderer;
    renderer.set_param("shade", Some(Value::Float(0.5)));
    assert_eq!(renderer.set()["shade"], "0.5");
    renderer.reset_params();
    let shade = |script: &mut Script| script.viewer().a.renderer.controls()[2].param.value.clone();
    assert!(renderer.set().is_empty());
    assert_eq!(shade(&mut script), Value::Float(0.25));
    // A live parameter that is reset during a build stays reset.
    script.viewer().a.renderer.set_param("shade", Some(Value::Float(0.5)));
    script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
    script.frame(false);
    assert!(script.viewer().a.renderer.busy());
    script.viewer().a.renderer.set_param("shade", None);
    script.settle();
    assert_eq!(shade(&mut script), Value::Float(0.25));
    script.close(&[]);
}

#[test]
fn the_window_alone_is_submitted_after_a_change_of_the_window() {
    let mut script = resting();
    script.panels().hidden = false;
    script.rest();
    script.submissions();
    script.panels().help = true;
    assert!(submitted(&mut script) > 0);
    let drawn = script.viewer().a.renderer.submitted();
    script.panels().help = false;
    assert!(submitted(&mut script) > 0);
    assert_eq!(script.viewer().a.renderer.submitted(), drawn, "the scene is drawn for the window's sake");
    let frame = script.redraw().expect("the device is not lost");
    assert!(frame.drawn);
    assert_eq!(submitted(&mut script), 1);
    script.close(&[]);
}

#[test]
fn a_key_after_a_rest_moves_the_camera_by_one_frame_and_on_while_it_is_held() {
    let mut script = resting();
    let angle = |script: &mut Script, from: &Camera| {
        let [one, other] = [from, &script.viewer().navigation.camera(64, 36)].map(|camera| camera.axes()[2]);
        one.iter().zip(other).map(|(a, b)| a * b).sum::<f64>().clamp(-1.0, 1.0).acos()
    };
    let key = |pressed| vec![super::key(Key::ArrowLeft, pressed, Modifiers::NONE)];
    let start = script.viewer().navigation.camera(64, 36);
    script.sleep(100);
    script.input = key(true);
    let next = script.frame(false).expect("the device is not lost").next;
    let first = angle(&mut script, &start);
    assert!((0.001..0.03).contains(&first), "{first} radians in a frame");
    assert!(next.is_some(), "a key that is held goes on");
    for _ in 0..9 {
        script.frame(false);
    }
    let ten = angle(&mut script, &start);
    assert!((5.0 * first..15.0 * first).contains(&ten), "{ten} radians in ten frames, {first} in the first");
    script.input = key(false);
    script.rest();
    let end = script.viewer().navigation.camera(64, 36);
    for _ in 0..10 {
        script.frame(false);
    }
    assert_eq!(script.viewer().navigation.camera(64, 36), end);
    script.close(&[]);
}

#[test]
fn the_first_plan_has_the_size_of_the_view_beside_the_panels() {
    let mut script = Script::open(&Config::default());
    script.panels().hidden = false;
    script.resize((1200, 700));
    script.settle();
    let (_, events, _) = script.close(&[]);
    let causes = |event: &Event| match event {
        Event::Swapped { renderer: RendererId::A, swap } => Some(swap.causes.to_string()),
        _ => None,
    };
    assert_eq!(events.iter().filter_map(causes).collect::<Vec<_>>(), ["start"]);
}

#[test]
fn a_graph_with_a_history_is_drawn_all_the_time() {
    let mut script = resting();
    let keys = "\"keys\": Buffer(stride: 4, count: \"max(n, entries)\"";
    assert!(GRAPH.contains(keys));
    script.write("graph.ron", GRAPH.replace(keys, &format!("{keys}, history: true")));
    script.until("the history", |script| {
        let plan = script.viewer().a.renderer.plan().expect("a plan");
        plan.resources.iter().any(|resource| resource.history.is_some())
    });
    script.settle();
    script.submissions();
    let frames = 20;
    for _ in 0..frames {
        let frame = script.frame(false).expect("the device is not lost");
        assert!(frame.next.is_some());
    }
    assert_eq!(script.submissions(), 2 * frames);
    script.close(&[]);
}

#[test]
fn the_window_is_drawn_while_a_device_of_the_scene_hangs() {
    let mut script = Script::open_in(arranged(), &Config::default(), true);
    script.viewer().continuous = false;
    script.settle();
    script.rest();
    let (shown, _) = script.viewer().pictures()[0].clone().expect("a picture");
    assert!(matches!(shown.pixels, BufferContents::Bytes(_)), "the window's device cannot read the scene's");
    script.set_hanging(true);
    script.viewer().a.renderer.set_param("shade", Some(Value::Float(0.25)));
    script.until("the frame that hangs", |script| script.shell.in_flight().is_some());
    // Another change waits for the end of the slow picture; the window does not.
    script.viewer().a.renderer.set_param("shade", Some(Value::Float(0.75)));
    let drawn = script.viewer().a.renderer.submitted();
    for hidden in [false, true] {
        script.panels().hidden = hidden;
        let drawn = |script: &mut Script| script.frame(false).is_some_and(|frame| frame.drawn);
        assert!((0..50).any(|_| drawn(&mut script)), "the window shows its tools, or none");
    }
    script.resize((200, 100));
    script.until("the new size", |script| script.shell.window().size() == (200, 100));
    script.until("the name of the frame", |script| script.shell.stalled().is_some());
    assert!(script.viewer().a.renderer.submitted() <= drawn + 1);
    assert!(script.shell.in_flight().is_some());
    script.set_hanging(false);
    script.rest();
    assert!(script.viewer().a.renderer.submitted() > drawn);
    script.close(&[]);
}

#[test]
fn the_window_does_not_queue_up_behind_a_picture_that_hangs() {
    let mut script = resting();
    script.panels().hidden = false;
    script.rest();
    script.set_hanging(true);
    script.viewer().a.renderer.set_param("shade", Some(Value::Float(0.25)));
    script.until("the frame that hangs", |script| script.shell.in_flight().is_some());
    std::thread::sleep(std::time::Duration::from_millis(200));
    script.submissions();
    script.panels().help = true;
    for _ in 0..20 {
        let frame = script.frame(false).expect("the device is not lost");
        assert!(!frame.drawn, "{:?}", script.shell.stalled());
    }
    assert_eq!(script.submissions(), 0);
    assert!(script.shell.stalled().is_some_and(|running| running.place.contains("of `")));
    script.set_hanging(false);
    script.rest();
    assert!(script.submissions() > 0);
    script.close(&[]);
}
