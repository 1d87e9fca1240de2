//! Tests frames that need more capacity than their plan has. They are held back or shown incomplete until a larger plan
//! is built.

use super::script::{GRAPH, Script, arranged};
use crate::draw::backend::Backend;
use crate::view::events::{Event, RendererId};
use crate::view::renderer::{Choice, PlanInputs, Renderer};
use splatgraph_assets::Scene;
use splatgraph_framework::ir::Value;
use splatgraph_null::{Call, Config, Fault, Point, limits, open};
use splatgraph_runtime::Limits;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Runs a visit to a viewer whose frames all need `needed` entries; the scene's default capacity is 200.
fn visit(needed: u32, limits: Limits, steps: impl FnOnce(&mut Script)) -> Vec<Event> {
    let mut script = Script::open(&Config { read: needed, limits, ..Config::default() });
    steps(&mut script);
    let (_, events, _) = script.close(&[]);
    events
}

fn entries(script: &mut Script) -> Value {
    let a = &script.viewer().a.renderer;
    let planned = a.plan().expect("a plan").params[1].value.clone();
    let shown = a.controls().iter().find(|control| control.param.name == "entries").expect("a control");
    assert_eq!(shown.param.value, planned, "the control shows what the plan has");
    planned
}

fn causes(events: &[Event]) -> Vec<String> {
    let cause = |event: &Event| match event {
        Event::Swapped { swap, .. } if swap.graph.ends_with("graph.ron") => Some(swap.causes.to_string()),
        _ => None,
    };
    events.iter().filter_map(cause).collect()
}

/// Draws frames until `shown` is true, and checks that the window keeps its former picture until then.
fn held_back_until(script: &mut Script, what: &str, shown: impl Fn(&mut Script) -> bool) {
    let number = |script: &mut Script| script.viewer().pictures()[0].as_ref().map(|(_, number)| *number);
    let (former, before) = (number(script), script.viewer().a.history.frames());
    script.until(what, |script| {
        let is_new = number(script) != former;
        assert!(!is_new || shown(script), "a part is shown");
        assert_eq!(script.viewer().a.in_part(), None);
        is_new
    });
    assert!(script.viewer().a.history.frames() > before, "no frame was held back");
    script.settle();
}

#[test]
fn the_first_picture_of_a_scene_and_of_a_graph_is_whole() {
    for apart in [false, true] {
        let config = Config { read: 500, ..Config::default() };
        let mut script = Script::open_in(arranged(), &config, apart);
        script.viewer().continuous = false;
        let has_room = |script: &mut Script| entries(script) == Value::Int(625);
        held_back_until(&mut script, "the first picture", has_room);
        let second = script.path("second.ply");
        script.viewer().open(&second);
        held_back_until(&mut script, "the other scene", |script| {
            has_room(script) && script.viewer().scene_path().ends_with("second.ply")
        });
        let other = script.path("other.ron");
        std::fs::copy(script.path("graph.ron"), &other).expect("a graph");
        script.viewer().a.renderer.choose(&other.to_string_lossy(), Default::default());
        held_back_until(&mut script, "the other graph", |script| {
            has_room(script) && script.viewer().a.renderer.plan().expect("a plan").name.ends_with("other.ron")
        });
        let (_, events, _) = script.close(&[]);
        assert_eq!(events.iter().find(|event| matches!(event, Event::Failed { .. })), None);
    }
}

#[test]
fn b_starts_with_the_room_of_a() {
    visit(300, limits(), |script| {
        script.settle();
        script.viewer().choose_compare(crate::view::paint::Mode::Split);
        script.settle();
        let b = script.viewer().b.as_ref().expect("B");
        assert_eq!(b.renderer.plan().expect("a plan").params[1].value, Value::Int(375));
        assert_eq!(b.history.plan().map(|plan| plan.params[1].value.clone()), Some(Value::Int(375)));
    });
}

#[test]
fn a_frame_in_part_is_shown_and_said_until_a_plan_with_room_draws() {
    let events = visit(300, limits(), |script| {
        script.settle();
        assert_eq!((entries(script), script.viewer().a.in_part()), (Value::Int(375), None));
        // The capacity stays while other settings change.
        script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
        script.settle();
        assert_eq!(entries(script), Value::Int(375));
        script.resize((160, 90));
        script.settle();
        assert_eq!(entries(script), Value::Int(375));
        // Growth starts from a value that the user set.
        script.viewer().a.renderer.set_param("entries", Some(Value::Int(500)));
        script.settle();
        assert_eq!(entries(script), Value::Int(500));
        script.viewer().a.renderer.set_param("entries", Some(Value::Int(250)));
        script.until("a frame in part", |script| script.viewer().a.in_part().is_some());
        let text = script.viewer().a.in_part();
        assert_eq!(text.as_deref(), Some("partially drawn: 250 of 300 entries"));
        assert!(script.viewer().busy(), "a plan with room is on its way");
        script.settle();
        assert_eq!(entries(script), Value::Int(375));
        script.viewer().a.renderer.set_param("digits", None);
        script.settle();
        assert_eq!(entries(script), Value::Int(375), "though 250 is still asked for");
        assert_eq!(script.viewer().a.renderer.set()["entries"], "250");
        // Another scene starts from its own default capacity.
        script.viewer().a.renderer.set_param("entries", None);
        script.settle();
        let second = script.path("second.ply");
        script.viewer().open(&second);
        script.settle();
        assert_eq!(entries(script), Value::Int(400));
    });
    let expected = [
        "start",
        "growth of entries",
        "digits",
        "another size",
        "entries",
        "entries",
        "growth of entries",
        "digits",
        "entries",
        "growth of entries",
        "a change of the scene",
    ];
    assert_eq!(causes(&events), expected);
    let alarms = |event: &&Event| matches!(event, Event::Failed { .. } | Event::Problem { .. });
    assert_eq!(events.iter().find(alarms), None, "growth is no error");
}

#[test]
fn what_facts_chose_and_what_stands_in_for_a_graph_are_said_with_their_reasons() {
    let events = visit(0, limits(), |script| {
        script.settle();
        let a = &script.viewer().a;
        assert_eq!((a.fallback(), a.decisions()), (None, None), "the graph chooses nothing");
        let lanes = a.renderer.plan().expect("a plan").facts["device.subgroup_size"].clone();
        let choice = r#""narrow": Const(Bool(default: "device.subgroup_size < 4096")),"#;
        script.write("chosen.ron", GRAPH.replace("params: {", &format!("params: {{ {choice}")));
        let graph = script.path("wanted.ron");
        let needs = r#"require: [("device.subgroup_size > 4096", "wide subgroups")]"#;
        let wide = format!(r#"Preset(graph: "graph.ron", summary: "", set: {{}}, {needs})"#);
        script.write("wide.ron", wide);
        let choice = r#"Choice(summary: "", of: [(graph: "wide.ron"), (graph: "chosen.ron")])"#;
        script.write("wanted.ron", choice);
        script.viewer().a.renderer.choose(&graph.to_string_lossy(), Default::default());
        script.settle();
        let a = &script.viewer().a;
        let said = a.fallback().expect("a fallback");
        assert!(said.starts_with("`chosen.ron` is used instead of `wide.ron`, "), "{said}");
        assert!(
            said.ends_with(&format!("which needs wide subgroups (device.subgroup_size = {lanes})")),
            "{said}"
        );
        assert_eq!(
            a.decisions(),
            Some(format!("chosen.ron: narrow = true, because device.subgroup_size = {lanes}"))
        );
        script.viewer().a.renderer.set_param("narrow", Some(Value::Bool(false)));
        script.settle();
        assert_eq!(script.viewer().a.decisions(), None, "a person chose it");
    });
    assert_eq!(events.iter().find(|event| matches!(event, Event::Failed { .. })), None);
}

#[test]
fn where_the_device_refuses_more_room_frames_stay_in_part_and_the_viewer_says_why() {
    let mut small = limits();
    small.facts.max_storage_bytes = 1 << 20;
    let events = visit(1_000_000, small, |script| {
        script.until("the refusal", |script| script.viewer().a.renderer.crowded().is_some());
        for _ in 0..10 {
            script.settle_in_part();
        }
        assert_eq!(entries(script), Value::Int(200));
        let said = script.viewer().a.stays_in_part().expect("it stays");
        assert!(said.starts_with("the picture is partially drawn: 200 of 1,000,000 entries\n"), "{said}");
        assert!(said.contains("`keys` has 4.8 MiB"), "{said}");
        // The next change is drawn with the available capacity, and again requests more.
        script.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
        script.until("the second refusal", |script| script.viewer().a.renderer.crowded().is_some());
        script.settle_in_part();
        script.viewer().a.want_picture();
        script.until("a picture", |script| script.viewer().a.has_picture());
        let picture = script.viewer().a.take_picture().expect("it is there");
        assert!(picture.is_err_and(|error| error.contains("partially drawn")), "no file is written of it");
    });
    assert_eq!(causes(&events), ["start", "digits"]);
    assert_eq!(events.iter().find(|event| matches!(event, Event::Failed { .. })), None);
}

#[test]
fn a_simulation_that_a_once_pass_starts_goes_on_when_a_list_grows() {
    let folder = arranged();
    let shader = folder.path().join("key.comp");
    let text =
        std::fs::read_to_string(&shader).expect("a shader").replace("readonly buffer Table", "buffer Table");
    std::fs::write(&shader, text.replace("% 64u]", "% 64u]++")).expect("written");
    let mut script = Script::open_in(folder, &Config { read: 300, ..Config::default() }, false);
    let restored = |script: &mut Script| {
        script.settle();
        let is_copy =
            |call: &&Call| matches!(call, Call::CopyBuffer { target: (name, 0), .. } if name == "table");
        script.take_calls().iter().filter(is_copy).count()
    };
    assert_eq!((restored(&mut script), entries(&mut script)), (1, Value::Int(375)));
    // Another constant starts it anew.
    script.viewer().a.renderer.set_param("entries", Some(Value::Int(500)));
    assert_eq!((restored(&mut script), entries(&mut script)), (0, Value::Int(500)));
    script.close(&[]);
}

#[test]
fn at_the_end_of_the_range_frames_stay_in_part() {
    let events = visit(10_000_000, limits(), |script| {
        script.until("the end", |script| script.viewer().a.stays_in_part().is_some());
        script.settle_in_part();
        assert_eq!(entries(script), Value::Int(8_388_608));
        assert_eq!(
            script.viewer().a.stays_in_part().as_deref(),
            Some("the picture is partially drawn: 8,388,608 of 10,000,000 entries (the end of the range)")
        );
    });
    assert_eq!(causes(&events), ["start", "growth of entries"]);
}

#[test]
fn a_plan_that_never_fits_is_tried_less_and_less_often_until_something_changes() {
    let faults = (0..1000).map(|after| Fault { point: Point::Allocate, after }).collect();
    let device = open(&Config { faults, ..Config::default() }).0.expect("the device opens");
    let folder = arranged();
    let graph = folder.path().join("graph.ron");
    let scene = Scene::load(folder.path().join("first.ply"), splatgraph_assets::QUIET).expect("the scene");
    let inputs = PlanInputs { scene: Some(Arc::new(scene)), size: (64, 36), share_memory: true };
    let (device, path) = (Backend::Null(device), graph.to_string_lossy());
    let renderer = Renderer::new(RendererId::A, device, Choice::new(&path, &[]), Arc::new(|| {}));
    let (mut renderer, mut now) = (renderer.expect("a renderer"), Instant::now());
    // The clock is set to the time of each attempt, so nothing waits.
    let mut pauses = |renderer: &mut Renderer, count: usize| {
        let pause = |_| {
            renderer.poll(&inputs, now);
            while renderer.busy() {
                std::thread::sleep(Duration::from_millis(1));
                renderer.poll(&inputs, now);
            }
            let former = now;
            now = renderer.next().expect("another attempt");
            (now - former).as_millis()
        };
        (0..count).map(pause).collect::<Vec<_>>()
    };
    assert_eq!(pauses(&mut renderer, 8), [250, 500, 1000, 2000, 4000, 8000, 10_000, 10_000]);
    renderer.choose(&graph.to_string_lossy(), Default::default());
    assert_eq!(pauses(&mut renderer, 2), [250, 500]);
}
