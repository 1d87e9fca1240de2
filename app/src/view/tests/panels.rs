//! Tests the bars and tools by clicks and keys.

use super::script::{GRAPH, Script};
use crate::draw::camera::mean_up;
use crate::view::events::Event;
use crate::view::navigation::Input;
use crate::view::paint::Mode;
use crate::view::panels::Tool;
use crate::view::panels::selection::Selection;
use egui::{Key, Modifiers, PointerButton, Pos2, pos2};
use splatgraph_assets::synth;
use splatgraph_framework::ir::Value;
use splatgraph_null::Config;

/// Opens a window with these tools, at rest.
pub fn window(tools: &[Tool]) -> Script {
    let mut script = Script::open(&Config::default());
    script.viewer().continuous = false;
    script.resize((1280, 800));
    (script.panels().hidden, script.panels().hud) = (false, true);
    script.panels().open_tools(tools);
    script.settle();
    script
}

fn button(pos: Pos2, pressed: bool) -> egui::Event {
    let (button, modifiers) = (PointerButton::Primary, Modifiers::NONE);
    egui::Event::PointerButton { pos, button, pressed, modifiers }
}

fn click_at(script: &mut Script, pos: Pos2) {
    let [press, release] = [true, false].map(|pressed| button(pos, pressed));
    for events in [vec![egui::Event::PointerMoved(pos)], vec![press], vec![release], vec![]] {
        script.input = events;
        script.frame(false);
    }
}

/// Clicks a control; returns its position.
pub fn click(script: &mut Script, name: &str) -> Pos2 {
    let place = script.find(name).unwrap_or_else(|| panic!("{name} is not shown")).center();
    click_at(script, place);
    place
}

fn search(script: &mut Script, list: &str, text: &str) {
    click(script, list);
    script.frame(false);
    script.input = vec![egui::Event::Text(text.to_owned())];
    script.frame(false);
    script.press(Key::Enter, Modifiers::NONE);
}

#[test]
fn a_second_click_on_a_button_that_adds_a_view_adds_another() {
    let mut script = window(&[Tool::Cameras]);
    for button in ["save_view", "record_key"] {
        let place = click(&mut script, button);
        click_at(&mut script, place);
    }
    assert_eq!((script.viewer().views.list().len(), script.viewer().path.keys().len()), (2, 2));
    script.close(&[]);
}

#[test]
fn the_view_menu_turns_the_scene_upright() {
    let mut script = window(&[]);
    script.viewer().set_cameras(synth::demo_cameras());
    click(&mut script, "menu");
    script.frame(false);
    click(&mut script, "up:+z");
    script.until("the flight", |script| !script.viewer().is_moving());
    let viewer = script.viewer();
    assert_eq!(viewer.navigation.up().to_array(), [0.0, 0.0, 1.0]);
    let [_, down, forward] = viewer.picture_camera().axes();
    assert!(down[2] < -0.9 && forward[2] < -0.1, "upright, from above: {down:?} {forward:?}");
    let opened = mean_up(&synth::demo_cameras()).expect("an up direction");
    click(&mut script, "up:reset");
    assert!(script.viewer().navigation.up().abs_diff_eq(opened, 1e-12));
    script.close(&[]);
}

#[test]
fn the_background_is_picked_in_the_view_menu() {
    let mut script = window(&[]);
    assert_eq!(script.viewer().background, [0.0; 3]);
    click(&mut script, "menu");
    script.frame(false);
    click(&mut script, "background");
    script.frame(false);
    let colours = script.find("background:colours").expect("the menu of colours is open");
    // The square of saturation and brightness is at the bottom, and black is its lower edge.
    click_at(&mut script, pos2(colours.left() + 20.0, colours.bottom() - 100.0));
    assert_ne!(script.viewer().background, [0.0; 3], "{colours}");
    assert!(script.find("background:colours").is_some(), "the menus stay open");
    script.close(&[]);
}

#[test]
fn a_second_click_on_a_button_of_a_menu_closes_it_in_a_small_window() {
    let mut script = window(&[]);
    script.resize((640, 300));
    (0..3).for_each(|_| drop(script.frame(false)));
    let place = click(&mut script, "menu");
    assert!(script.find("fit").is_some_and(|fit| !fit.contains(place)));
    click_at(&mut script, place);
    assert_eq!(script.find("fit"), None);
    script.close(&[]);
}

#[test]
fn a_single_key_with_ctrl_or_alt_is_another_shortcut() {
    let mut script = window(&[]);
    script.viewer().navigate(&Input { orbit: [1.0, 0.0], seconds: 0.5, ..Input::default() });
    let before = script.viewer().navigation.camera(64, 36);
    for key in [Key::F, Key::Home, Key::H] {
        for modifiers in [Modifiers::CTRL | Modifiers::COMMAND, Modifiers::ALT] {
            script.press(key, modifiers);
        }
    }
    assert_eq!(script.viewer().navigation.camera(64, 36), before);
    assert!(!script.panels().hidden);
    script.press(Key::F, Modifiers::NONE);
    assert_ne!(script.viewer().navigation.camera(64, 36), before);
    script.close(&[]);
}

/// Returns the control that has the keyboard focus.
pub fn focused(script: &Script) -> Option<egui::Response> {
    let ctx = script.shell.context();
    ctx.memory(|memory| memory.focused()).and_then(|id| ctx.read_response(id))
}

#[test]
fn the_keyboard_focus_returns_to_a_button_whose_list_closes() {
    let mut script = window(&[]);
    script.press(Key::Tab, Modifiers::NONE);
    let scene = focused(&script).expect("a control").id;
    script.press(Key::Enter, Modifiers::NONE);
    assert!(script.find("scene_search").is_some());
    script.press(Key::Escape, Modifiers::NONE);
    assert_eq!(script.find("scene_search"), None);
    assert_eq!(focused(&script).map(|control| control.id), Some(scene));
    script.close(&[]);
}

#[test]
fn a_tool_scrolls_to_the_control_that_has_the_keyboard_focus() {
    for (tool, start) in [(Tool::Parameters, "param:"), (Tool::Inspector, "look:")] {
        let mut script = window(&[tool]);
        script.resize((1280, 240));
        if tool == Tool::Inspector {
            script.panels().select(Selection::Pass("key".to_owned()));
        }
        (0..3).for_each(|_| drop(script.frame(false)));
        let mut seen = 0;
        for _ in 0..60 {
            script.press(Key::Tab, Modifiers::NONE);
            (0..30).for_each(|_| drop(script.frame(false)));
            let Some(control) = focused(&script) else { continue };
            let named = |(name, rect): (&str, egui::Rect)| name.starts_with(start) && rect == control.rect;
            if script.panels().controls.iter().any(named) {
                seen += 1;
                assert!(control.interact_rect.height() > 0.9 * control.rect.height(), "{control:?}");
            }
        }
        assert!(seen >= 3, "{tool:?}: {seen}");
        script.close(&[]);
    }
}

#[test]
fn a_path_plays_on_while_the_split_line_is_dragged() {
    let mut script = window(&[]);
    script.viewer().choose_compare(Mode::Split);
    script.settle();
    let viewer = script.viewer();
    for _ in 0..2 {
        viewer.record_key().expect("a sound camera");
        viewer.navigate(&Input { orbit: [1.0, 0.0], seconds: 0.5, ..Input::default() });
    }
    viewer.seek_path(0.0);
    viewer.play.play(&viewer.path);
    let view = script.find("view").expect("the view");
    let at = |part: f32| view.lerp_inside(egui::vec2(part, 0.5));
    let before = script.viewer().play.position();
    script.input = vec![egui::Event::PointerMoved(at(0.5))];
    script.frame(false);
    script.input = vec![button(at(0.5), true)];
    for part in [0.5, 0.55, 0.6, 0.7] {
        script.input.push(egui::Event::PointerMoved(at(part)));
        script.frame(false);
    }
    let viewer = script.viewer();
    let (offset, position) = (viewer.scene().offset(), viewer.play.position());
    assert!((viewer.split - 0.7).abs() < 1e-3, "{}", viewer.split);
    assert!(viewer.play.is_playing() && position > before + 0.06, "{before} to {position}");
    let expected = viewer.path.at(position).expect("a camera").relative_to(offset);
    let shown = viewer.navigation.camera(expected.width, expected.height);
    assert_eq!(shown, expected, "the drag does not orbit");
    script.input = vec![button(at(0.7), false)];
    script.frame(false);
    assert!(script.viewer().play.is_playing());
    script.viewer().play.pause();
    script.close(&[]);
}

#[test]
fn enter_chooses_the_graph_camera_or_scene_whose_name_was_typed() {
    let mut script = window(&[]);
    script.viewer().set_cameras(synth::demo_cameras());
    script.frame(false);
    search(&mut script, "camera", &synth::demo_cameras()[2].img_name);
    assert_eq!(script.viewer().shown_camera(), Some(2));
    // The summaries of other graphs contain the word, too.
    for _ in 0..2 {
        search(&mut script, "graph", "splat");
        assert_eq!(script.viewer().a.renderer.graph(), "splat");
    }
    let second = script.path("second.ply");
    script.viewer().open(&second);
    script.until("the scene", |script| script.has_event(|event| matches!(event, Event::Scene { .. })));
    search(&mut script, "scene", "first");
    let first = script.path("first.ply");
    script.until("the first scene", |script| script.viewer().scene_path() == first);
}

#[test]
fn a_search_that_finds_nothing_says_so_and_is_gone_when_the_list_opens_again() {
    let mut script = window(&[]);
    script.viewer().set_cameras(synth::demo_cameras());
    script.frame(false);
    let find = |script: &Script, name: &str| script.find(name).is_some();
    let scene = format!("scene:{}", script.path("first.ply").display());
    for (list, item) in [("graph", "preset:splat"), ("camera", "camera:2"), ("scene", &scene)] {
        search(&mut script, list, "zzzz");
        assert_eq!(["nothing_matches", item].map(|name| find(&mut script, name)), [true, false], "{list}");
        // Enter has left the field, so one press closes the list.
        script.press(Key::Escape, Modifiers::NONE);
        assert!(!find(&mut script, &format!("{list}_search")));
        click(&mut script, list);
        assert_eq!(["nothing_matches", item].map(|name| find(&mut script, name)), [false, true], "{list}");
        for _ in 0..2 {
            script.press(Key::Escape, Modifiers::NONE);
        }
    }
    script.close(&[]);
}

#[test]
fn a_camera_is_named_only_while_its_view_is_shown() {
    let mut script = window(&[]);
    script.viewer().set_cameras(synth::demo_cameras());
    assert_eq!(script.viewer().shown_camera(), Some(0));
    script.viewer().look_through(2);
    assert_eq!(script.viewer().shown_camera(), Some(2));
    let orbit = Input { orbit: [-1.0, 0.0], seconds: 0.1, ..Input::default() };
    script.viewer().navigate(&orbit);
    assert_eq!((script.viewer().shown_camera(), script.viewer().camera), (None, Some(2)));
    script.viewer().navigation.home();
    assert_eq!(script.viewer().shown_camera(), Some(0));
    script.close(&[]);
}

#[test]
fn the_frame_rate_disappears_at_rest_and_with_another_plan() {
    let mut script = window(&[]);
    let draw = |script: &mut Script| {
        script.viewer().continuous = true;
        script.until("frames", |script| script.panels().interval().is_some());
        script.viewer().continuous = false;
    };
    draw(&mut script);
    script.rest();
    assert_eq!(script.panels().interval(), None);
    draw(&mut script);
    script.write("graph.ron", GRAPH.to_owned() + "\n");
    script.events.clear();
    script.until("the plan", |script| script.has_event(|event| matches!(event, Event::Swapped { .. })));
    assert_eq!(script.panels().interval(), None);
    script.close(&[]);
}

#[test]
fn another_graph_keeps_the_settings_that_it_has_and_reports_the_others() {
    let mut script = window(&[]);
    let other = GRAPH.replace("\"digits\"", "\"numbers\"").replace("<< digits", "<< numbers");
    script.write("other.ron", other);
    script.write("preset.ron", r#"Preset(graph: "graph.ron", summary: "five", set: { "digits": 5 })"#);
    for (name, reason) in
        [("other.ron", "this graph has no parameter digits, which was 6"), ("preset.ron", "sets it itself")]
    {
        let renderer = &mut script.viewer().a.renderer;
        renderer.set_param("digits", Some(Value::Int(6)));
        renderer.set_param("shade", Some(Value::Float(0.25)));
        script.settle();
        script.events.clear();
        let path = script.path(name);
        script.viewer().open(&path);
        script.until("the graph", |script| script.has_event(|event| matches!(event, Event::Swapped { .. })));
        let set: Vec<(&str, &str)> = script
            .viewer()
            .a
            .renderer
            .set()
            .iter()
            .map(|(name, value)| (name.as_str(), value.as_str()))
            .collect();
        assert_eq!(set, [("shade", "0.25")], "{name}");
        let text = script.events.iter().find(|event| matches!(event, Event::Dropped { .. }));
        let text = text.expect("the dropped setting is reported").to_string();
        assert!(text.contains(reason), "{text}");
        assert!(script.panels().toasts().contains(&text.as_str()), "{text}");
        script.press(Key::Z, Modifiers::COMMAND);
        assert!(!script.panels().toasts().contains(&text.as_str()), "another graph has other reasons");
        script.settle();
        let renderer = &script.viewer().a.renderer;
        assert!(renderer.graph().ends_with("graph.ron"));
        assert_eq!(renderer.set()["digits"], "6", "the graph comes back with its parameters");
    }
    script.close(&[]);
}

#[test]
fn a_key_of_a_tool_shows_it_while_the_tools_are_hidden() {
    let mut script = window(&[Tool::Parameters]);
    script.panels().hidden = true;
    script.press(Key::Num1, Modifiers::NONE);
    assert!(!script.panels().hidden && script.find("tool:Parameters").is_some());
    script.press(Key::Num1, Modifiers::NONE);
    assert_eq!(script.find("tool:Parameters"), None);
    script.close(&[]);
}

#[test]
fn actions_without_another_effect_on_the_window_are_confirmed() {
    let mut script = window(&[Tool::Cameras]);
    script.until("no toast", |script| script.find("toast").is_none());
    click(&mut script, "copy_camera");
    assert!(script.find("toast").is_some());
    // Also without times and messages on the picture, but no other toast.
    script.panels().hud = false;
    script.frame(false);
    assert!(script.find("toast").is_some());
    script.until("no toast", |script| script.find("toast").is_none());
    script.panels().log_event(&Event::Problem { text: "a problem".to_owned() });
    script.frame(false);
    assert!(script.find("toast").is_none());
    script.close(&[]);
}

#[test]
fn typing_goes_on_in_the_same_parameter_when_a_reload_adds_one_above() {
    let mut script = window(&[Tool::Parameters]);
    click(&mut script, "param:shade#");
    let write = |script: &mut Script, text: &str| {
        script.input = vec![egui::Event::Text(text.to_owned())];
        script.frame(false);
    };
    write(&mut script, "0.1");
    let gamma = "\"gamma\": Const(Int(default: 64, range: (1, 64))),\n    \"shade\": Live";
    let text = GRAPH.replace("\"shade\": Live", gamma).replace("Threads(64)", "Threads(\"gamma\")");
    script.write("graph.ron", text);
    script.until("the new row", |script| script.find("param:gamma#").is_some());
    let row = |script: &mut Script, name: &str| script.find(name).unwrap().top();
    assert!(row(&mut script, "param:gamma#") < row(&mut script, "param:shade#"));
    write(&mut script, "5");
    script.press(Key::Enter, Modifiers::NONE);
    script.frame(false);
    let set = script.viewer().a.renderer.set();
    assert_eq!(set.iter().collect::<Vec<_>>(), [(&"shade".to_owned(), &"0.15".to_owned())]);
    script.close(&[]);
}

#[test]
fn the_card_of_errors_has_room_for_longer_errors_than_its_first() {
    let height = |script: &mut Script, wrong: &str, text: &str| {
        script.write("graph.ron", text);
        let is_shown = |script: &mut Script| {
            let problem = script.viewer().a.renderer.problem(true);
            problem.is_some_and(|problem| problem.contains(wrong))
        };
        script.until(wrong, is_shown);
        (0..3).for_each(|_| drop(script.frame(false)));
        script.find("mistakes").expect("the card is shown").height()
    };
    let mut script = window(&[]);
    let one = GRAPH.replace("shade.comp", "shad.comp");
    let two = one.replace("key.comp", "kei.comp");
    let (short, long) = (height(&mut script, "shad.comp", &one), height(&mut script, "kei.comp", &two));
    let at_once = height(&mut window(&[]), "kei.comp", &two);
    assert!(short < long && long == at_once, "{short}, {long}, in a new window {at_once}");
}

#[test]
fn headings_follow_the_saved_graph_and_stay_in_the_order_of_its_parameters() {
    let mut script = window(&[Tool::Parameters]);
    let top = |script: &mut Script, name: &str| script.find(name).map(|rect| rect.top());
    assert!(top(&mut script, "group:shade") > top(&mut script, "param:digits#"));
    let text = GRAPH.replace("name: \"shade\",", "name: \"shade\", phase: \"brush\",");
    script.write("graph.ron", &text);
    script.until("the phase", |script| script.find("group:brush").is_some());
    assert_eq!(top(&mut script, "group:shade"), None);
    let wide = "params: {\n    \"wide\": Const(Int(default: 64, range: (1, 64))),";
    let text = text.replace("params: {", wide).replace("Threads(64)", "Threads(\"wide\")");
    script.write("graph.ron", text);
    script.until("the new row", |script| script.find("param:wide#").is_some());
    assert!(
        top(&mut script, "group:brush") < top(&mut script, "param:digits#"),
        "the first parameter's group"
    );
}

#[test]
fn the_list_of_graphs_has_files_that_are_saved_beside_the_graph() {
    let mut script = window(&[]);
    let mine = script.path("mine.ron");
    std::fs::copy(script.path("graph.ron"), &mine).unwrap();
    click(&mut script, "graph");
    click(&mut script, &format!("preset:{}", mine.display()));
    assert_eq!(script.viewer().a.renderer.graph(), mine.to_string_lossy());
    script.close(&[]);
}

#[test]
fn the_status_line_is_silent_about_a_hidden_b() {
    let mut script = window(&[]);
    script.viewer().choose_compare(Mode::Split);
    script.settle();
    script.write("graph.ron", "Graph(");
    script.until("the error", |script| script.find("problem:B").is_some());
    script.viewer().choose_compare(Mode::A);
    script.until("A alone", |script| script.find("problem:B").is_none());
    assert!(script.find("problem:A").is_some());
}

#[test]
fn the_size_of_texts_is_there_again_at_the_next_start() {
    let zoom = |script: &mut Script| script.shell.context().zoom_factor();
    let mut script = window(&[]);
    script.press(Key::Equals, Modifiers::COMMAND);
    let larger = zoom(&mut script);
    assert!(larger > 1.0);
    let mut next = window(&[]);
    let (before, after) = (script.shell.context().clone(), next.shell.context().clone());
    assert!(next.panels().restore(script.panels().arrangement(&before), &after));
    for _ in 0..3 {
        next.frame(false);
    }
    assert_eq!(zoom(&mut next), larger);
}
