//! Tests which keys reach the viewer, and what they do in lists and fields.

use super::key;
use super::panels::{click, focused, window};
use super::script::{GRAPH, Script};
use crate::view::events::{Event, RendererId};
use crate::view::paint::Mode;
use crate::view::panels::Tool;
use egui::{Event::Text, Key, Modifiers};
use splatgraph_assets::Camera;
use splatgraph_framework::ir::Value;

/// Presses a key, holds it for some frames, and releases it.
fn hold(script: &mut Script, held: Key, modifiers: Modifiers) {
    script.input = vec![key(held, true, modifiers)];
    (0..5).for_each(|_| drop(script.frame(false)));
    script.input = vec![key(held, false, Modifiers::NONE)];
    script.frame(false);
}

/// Presses Tab until the control `name` has the focus.
fn tab_to(script: &mut Script, name: &str) {
    for _ in 0..80 {
        script.press(Key::Tab, Modifiers::NONE);
        let place = script.find(name);
        if focused(script).is_some_and(|control| Some(control.rect) == place) {
            return;
        }
    }
    panic!("Tab never reaches {name}");
}

fn camera(script: &mut Script) -> Camera {
    script.viewer().navigation.camera(640, 360)
}

/// Returns cameras side by side whose fields of view have more digits than are shown.
fn cameras(script: &mut Script, count: u32) -> Vec<Camera> {
    let first = Camera::framing(script.viewer().scene(), 640, 360);
    let camera = |index: u32| {
        let mut camera = first.clone();
        camera.img_name = format!("{index:06}_camera_front_left.png");
        camera.position[0] += 0.01 * f64::from(index);
        (camera.fx, camera.fy) = (412.345_678, 412.345_678);
        camera
    };
    (0..count).map(camera).collect()
}

#[test]
fn tab_through_the_field_of_view_leaves_the_camera_and_a_comma_is_a_decimal_point() {
    let mut script = window(&[Tool::Cameras]);
    let cameras = cameras(&mut script, 1);
    script.viewer().set_cameras(cameras);
    script.frame(false);
    let before = camera(&mut script);
    tab_to(&mut script, "field_of_view#");
    (0..3).for_each(|_| script.press(Key::Tab, Modifiers::NONE));
    assert_eq!(camera(&mut script), before);
    assert_eq!(script.viewer().shown_camera(), Some(0));
    for (text, degrees, told) in [("52,5", 52.5, false), ("x", 52.5, true), ("500", 150.0, true)] {
        script.until("no toast", |script| script.find("toast").is_none());
        click(&mut script, "field_of_view#");
        script.input = vec![Text(text.to_owned())];
        script.frame(false);
        script.press(Key::Enter, Modifiers::NONE);
        script.frame(false);
        assert!((script.viewer().navigation.field_of_view() - degrees).abs() < 1e-9, "{text}");
        assert_eq!(script.find("toast").is_some(), told, "{text}");
        script.sleep(20);
    }
    script.close(&[]);
}

#[test]
fn a_button_that_its_own_click_disables_or_hides_keeps_the_keys() {
    for (button, next) in [("reset_all", true), ("reset:digits", false)] {
        let mut script = window(&[Tool::Parameters]);
        script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
        script.settle();
        script.viewer().continuous = false;
        tab_to(&mut script, button);
        let id = focused(&script).expect("the button").id;
        script.press(Key::Enter, Modifiers::NONE);
        assert!(script.viewer().a.renderer.set().is_empty(), "{button}");
        (0..3).for_each(|_| drop(script.frame(false)));
        assert_eq!(focused(&script).map(|control| control.id), Some(id), "{button}");
        let before = camera(&mut script);
        script.press(Key::Tab, Modifiers::NONE);
        let after = focused(&script).expect("the next control");
        assert!(after.id != id && after.enabled(), "{button}");
        script.press(Key::Tab, Modifiers { shift: true, ..Modifiers::NONE });
        hold(&mut script, Key::ArrowDown, Modifiers::NONE);
        if next {
            assert_eq!(camera(&mut script), before, "{button}");
        }
        script.close(&[]);
    }
}

#[test]
fn escape_in_a_control_gives_the_keys_back_and_only_the_next_one_clears_the_selection() {
    let mut script = window(&[]);
    for name in ["splats:path", "splats:clear", "scene"] {
        script.viewer().select_all(RendererId::A);
        script.frame(false);
        tab_to(&mut script, name);
        for cleared in [false, true] {
            script.press(Key::Escape, Modifiers::NONE);
            assert_eq!(focused(&script).map(|control| control.id), None, "{name}");
            assert_eq!(script.viewer().marks(RendererId::A).selected.is_empty(), cleared, "{name}");
        }
    }
    script.close(&[]);
}

#[test]
fn a_held_key_clicks_a_button_once() {
    let mut script = window(&[Tool::Cameras]);
    tab_to(&mut script, "save_view");
    for (held, views) in [(Key::Enter, 1), (Key::Space, 2)] {
        for pressed in [true, true, true, false] {
            script.input = vec![key(held, pressed, Modifiers::NONE)];
            script.frame(false);
        }
        assert_eq!(script.viewer().views.list().len(), views, "{held:?}");
    }
    script.close(&[]);
}

#[test]
fn after_enter_a_field_keeps_the_keys_if_tab_led_to_it() {
    let mut script = window(&[Tool::Parameters]);
    let field = "param:shade#";
    let enter = |script: &mut Script, text: &str| {
        script.input = vec![Text(text.to_owned())];
        script.frame(false);
        script.press(Key::Enter, Modifiers::NONE);
        assert_eq!(script.viewer().a.renderer.set()["shade"], text);
        focused(script).map(|control| control.rect)
    };
    tab_to(&mut script, field);
    for text in ["0.25", "0.75"] {
        assert_eq!(enter(&mut script, text), script.find(field), "{text}");
    }
    script.press(Key::Tab, Modifiers::NONE);
    assert_eq!(focused(&script).map(|control| control.rect), script.find("reset:shade"));
    click(&mut script, field);
    assert_eq!(enter(&mut script, "0.125"), None, "the keys move the camera again");
    script.close(&[]);
}

#[test]
fn the_keys_of_a_removed_row_go_to_the_row_before_it() {
    let mut script = window(&[Tool::Cameras]);
    for _ in 0..3 {
        script.viewer().record_key().expect("a sound camera");
    }
    script.frame(false);
    tab_to(&mut script, "key:2");
    // From "Earlier" to "Remove": the last keyframe cannot be later.
    (0..2).for_each(|_| script.press(Key::Tab, Modifiers::NONE));
    for left in [2, 1] {
        script.press(Key::Enter, Modifiers::NONE);
        script.frame(false);
        assert_eq!(script.viewer().path.keys().len(), left);
        let row = script.find(&format!("key:{}", left - 1)).expect("the row before");
        let control = focused(&script).expect("a control").rect;
        assert!((control.center().y - row.center().y).abs() < 4.0, "{control} beside {row}");
    }
    script.close(&[]);
}

#[test]
fn enter_in_the_name_of_a_file_saves_the_selection() {
    let mut script = window(&[]);
    script.viewer().select_all(RendererId::A);
    script.frame(false);
    tab_to(&mut script, "splats:path");
    let file = script.path("part.ply");
    script.press(Key::A, Modifiers::CTRL | Modifiers::COMMAND);
    script.input = vec![Text(file.display().to_string())];
    script.frame(false);
    script.press(Key::Enter, Modifiers::NONE);
    script.until("the file", |script| script.has_event(|event| matches!(event, Event::Exported { .. })));
    assert!(file.is_file());
    (0..3).for_each(|_| drop(script.frame(false)));
    assert_eq!(focused(&script).map(|control| control.rect), script.find("splats:path"));
    script.close(&[]);
}

#[test]
fn page_keys_scroll_the_tool_or_the_card_that_has_the_keys() {
    let scrolls = |script: &mut Script, control: &str, text: &str| {
        (0..3).for_each(|_| drop(script.frame(false)));
        tab_to(script, control);
        let (before, first) = (camera(script), script.find(text).expect("it is shown"));
        for (key, moves) in
            [(Key::PageDown, true), (Key::PageUp, false), (Key::End, true), (Key::Home, false)]
        {
            hold(script, key, Modifiers::NONE);
            (0..30).for_each(|_| drop(script.frame(false)));
            assert_eq!(script.find(text) != Some(first), moves, "{control}, {key:?}");
        }
        assert_eq!(camera(script), before);
    };
    let mut script = window(&[Tool::Cameras]);
    script.resize((1280, 240));
    scrolls(&mut script, "tab:Cameras", "copy_camera");
    script.resize((640, 300));
    script.panels().open_tools(&[]);
    script.write("graph.ron", GRAPH.replace("shade.comp", "shad.comp").replace("key.comp", "kei.comp"));
    script.until("the errors", |script| script.find("mistakes:text").is_some());
    scrolls(&mut script, "mistakes:close", "mistakes:text");
}

#[test]
fn the_buttons_of_an_error_can_be_seen_in_a_tiny_window() {
    let mut script = window(&[]);
    script.resize((320, 200));
    script.write("graph.ron", GRAPH.replace("shade.comp", "shad.comp").replace("key.comp", "kei.comp"));
    script.until("the errors", |script| script.find("mistakes:text").is_some());
    (0..3).for_each(|_| drop(script.frame(false)));
    let [view, card] = ["view", "mistakes"].map(|name| script.find(name).expect("it is shown"));
    assert!(view.expand(1.0).contains_rect(card), "{card} in {view}");
    for name in ["mistakes:edit", "mistakes:close"] {
        tab_to(&mut script, name);
        (0..30).for_each(|_| drop(script.frame(false)));
        let button = focused(&script).expect("the button");
        assert!(button.interact_rect.height() > 0.9 * button.rect.height(), "{name}: {button:?}");
        assert!(view.contains_rect(button.interact_rect), "{name}: {button:?} in {view}");
    }
}

#[test]
fn the_list_of_keys_uses_the_window_scrolls_by_keys_and_closes_with_escape() {
    let mut script = window(&[]);
    script.resize((900, 500));
    script.settle();
    script.viewer().select_all(RendererId::A);
    let before = camera(&mut script);
    script.press(Key::Tab, Modifiers::NONE);
    script.press(Key::F1, Modifiers::NONE);
    (0..10).for_each(|_| drop(script.frame(false)));
    let find = |script: &Script, name: &str| script.find(name);
    let (shown, all) = (find(&mut script, "keys").expect("the list"), find(&mut script, "keys:all").unwrap());
    assert!(shown.height() > 400.0 && shown.bottom() <= 500.0, "{shown}");
    assert!(all.bottom() > shown.bottom(), "{all} in {shown}");
    hold(&mut script, Key::End, Modifiers::NONE);
    let end = find(&mut script, "keys:all").unwrap();
    assert!(end.top() < all.top() - 100.0 && end.bottom() <= shown.bottom(), "{all} to {end}");
    for key in [Key::ArrowUp, Key::PageUp, Key::Home] {
        hold(&mut script, key, Modifiers::NONE);
    }
    assert_eq!(find(&mut script, "keys:all"), Some(all));
    assert_eq!(camera(&mut script), before);
    script.press(Key::Escape, Modifiers::NONE);
    assert!(!script.panels().help && !script.viewer().marks(RendererId::A).selected.is_empty());
    script.press(Key::Escape, Modifiers::NONE);
    assert!(script.viewer().marks(RendererId::A).selected.is_empty());
    script.close(&[]);
}

#[test]
fn the_list_of_keys_opens_over_errors_and_messages() {
    let mut script = window(&[]);
    script.write("graph.ron", GRAPH.replace("shade.comp", "shad.comp").replace("key.comp", "kei.comp"));
    script.until("the errors", |script| script.find("mistakes").is_some());
    script.panels().log_event(&Event::Problem { text: "a problem ".repeat(60) });
    (0..3).for_each(|_| drop(script.frame(false)));
    script.press(Key::F1, Modifiers::NONE);
    (0..10).for_each(|_| drop(script.frame(false)));
    let list = script.find("keys").expect("the list");
    for name in ["mistakes", "toast"] {
        let both = script.find(name).expect("it is shown").intersect(list);
        assert!(both.is_positive(), "{name}");
        let top = script.shell.context().layer_id_at(both.center()).expect("a layer");
        assert_eq!(top.id, egui::Id::unique(Some("Keys and mouse")), "{name}");
    }
}

#[test]
fn a_wide_window_shows_all_keys_at_once() {
    let mut script = window(&[]);
    script.press(Key::F1, Modifiers::NONE);
    (0..10).for_each(|_| drop(script.frame(false)));
    let [shown, all] = ["keys", "keys:all"].map(|name| script.find(name).unwrap());
    assert!(shown.contains_rect(all), "{all} in {shown}");
    script.close(&[]);
}

#[test]
fn a_key_that_was_pressed_with_ctrl_moves_no_camera_after_ctrl_is_released() {
    let mut script = window(&[]);
    let before = camera(&mut script);
    for held in [Key::Equals, Key::Minus, Key::ArrowLeft] {
        hold(&mut script, held, Modifiers::CTRL | Modifiers::COMMAND);
    }
    assert_eq!(camera(&mut script), before);
    hold(&mut script, Key::Equals, Modifiers::NONE);
    assert_ne!(camera(&mut script), before);
    script.close(&[]);
}

#[test]
fn a_plus_ends_with_its_release_though_shift_was_released_before() {
    let mut script = window(&[]);
    let event = |key, pressed, modifiers| {
        let physical_key = Some(Key::Equals);
        vec![egui::Event::Key { key, physical_key, pressed, repeat: false, modifiers }]
    };
    // A key that seems to be held would not act at its next press.
    for round in ["first", "second"] {
        let before = camera(&mut script);
        script.input = event(Key::Plus, true, Modifiers::SHIFT);
        (0..5).for_each(|_| drop(script.frame(false)));
        // The system repeats the held key.
        for pressed in [true, false] {
            script.input = event(Key::Equals, pressed, Modifiers::NONE);
            script.frame(false);
        }
        let after = camera(&mut script);
        assert_ne!(before, after, "{round}");
        (0..5).for_each(|_| drop(script.frame(false)));
        assert_eq!(camera(&mut script), after, "{round}");
    }
    script.close(&[]);
}

#[test]
fn shortcuts_with_ctrl_and_function_keys_act_while_a_control_has_the_focus() {
    let mut script = window(&[Tool::Parameters]);
    let undo = Modifiers::CTRL | Modifiers::COMMAND;
    tab_to(&mut script, "param:shade");
    script.press(Key::ArrowRight, Modifiers::NONE);
    assert!(!script.viewer().a.renderer.set().is_empty());
    script.press(Key::Z, undo);
    script.frame(false);
    assert!(script.viewer().a.renderer.set().is_empty());
    script.press(Key::H, Modifiers::NONE);
    assert!(!script.panels().hidden, "a single key belongs to the control");
    script.press(Key::ArrowRight, Modifiers::NONE);
    tab_to(&mut script, "param:shade#");
    script.press(Key::Z, undo);
    script.frame(false);
    assert!(!script.viewer().a.renderer.set().is_empty(), "a text field undoes its text");
    script.press(Key::F1, Modifiers::NONE);
    assert!(script.panels().help);
    script.close(&[]);
}

#[test]
fn a_list_opens_at_its_current_item_and_down_enters_it_there() {
    let mut script = window(&[]);
    let cameras = cameras(&mut script, 200);
    script.viewer().set_cameras(cameras);
    script.frame(false);
    // The system repeats a held key.
    script.input = vec![key(Key::CloseBracket, true, Modifiers::NONE)];
    for _ in 0..150 {
        script.frame(false);
        script.input = vec![key(Key::CloseBracket, true, Modifiers::NONE)];
    }
    script.input = vec![key(Key::CloseBracket, false, Modifiers::NONE)];
    script.frame(false);
    assert_eq!(script.viewer().camera, Some(150));
    click(&mut script, "camera");
    (0..10).for_each(|_| drop(script.frame(false)));
    let [field, row] = ["camera_search", "camera:150"].map(|name| script.find(name).expect("it is open"));
    assert!(row.top() > field.bottom() && row.bottom() < 800.0, "{row} below {field}");
    script.press(Key::ArrowDown, Modifiers::NONE);
    let row = script.find("camera:150");
    assert_eq!(focused(&script).map(|control| control.rect), row);
    script.press(Key::ArrowDown, Modifiers::NONE);
    script.press(Key::Enter, Modifiers::NONE);
    assert_eq!(script.viewer().camera, Some(151));
    script.close(&[]);
}

#[test]
fn the_card_of_a_comparison_is_in_its_place_in_the_first_frame_of_the_result() {
    let mut script = window(&[]);
    script.viewer().choose_compare(Mode::Split);
    script.settle();
    script.viewer().measure();
    let mut cards = Vec::new();
    script.until("the result", |script| {
        let find = |name: &str| script.find(name);
        cards.extend(find("comparison").zip(find("view")));
        script.has_event(|event| matches!(event, Event::Compared { .. }))
    });
    script.frame(false);
    let found = ["comparison", "view", "worst"].map(|name| script.find(name));
    let [Some(card), Some(view), Some(worst)] = found else { panic!("the card has the result: {found:?}") };
    // The card's rectangle is that of the next frame, its button's that of this one.
    assert!(card.contains_rect(worst), "{worst} in {card}");
    cards.push((card, view));
    for (card, view) in cards {
        assert!(view.contains_rect(card), "{card} in {view}");
        assert!((card.center().x - view.center().x).abs() < 1.0, "{card} in {view}");
    }
    script.close(&[]);
}

#[test]
fn the_card_of_a_comparison_is_above_that_of_a_selection() {
    let mut script = window(&[]);
    script.viewer().choose_compare(Mode::Split);
    script.viewer().select_all(RendererId::A);
    script.settle();
    script.viewer().measure();
    script.until("the result", |script| script.has_event(|event| matches!(event, Event::Compared { .. })));
    for size in [(1280, 800), (640, 320)] {
        script.resize(size);
        (0..5).for_each(|_| drop(script.frame(false)));
        let found = ["view", "comparison", "splats"].map(|name| script.find(name));
        let [Some(view), Some(comparison), Some(splats)] = found else { panic!("both cards: {found:?}") };
        assert!(comparison.bottom() < splats.top() && view.contains_rect(comparison), "{found:?}");
    }
    script.close(&[]);
}

#[test]
fn settings_can_be_reset_before_the_first_plan() {
    let folder = super::script::arranged();
    std::fs::write(folder.path().join("graph.ron"), "Graph(").expect("it is written");
    let mut script = Script::open_in(folder, &splatgraph_null::Config::default(), false);
    script.until("the error", |script| script.viewer().a.renderer.failure().is_some());
    let renderer = &mut script.viewer().a.renderer;
    let set = [("digits".to_owned(), "6".to_owned())].into_iter().collect();
    renderer.replace_set(&set);
    assert_eq!(*renderer.set(), set, "Undo restores settings");
    renderer.reset_params();
    assert!(renderer.set().is_empty());
}
