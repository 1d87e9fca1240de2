//! Tests the viewer on a device whose driver hangs while it compiles a pipeline.

use super::script::Script;
use crate::view::events::Event;
use splatgraph_framework::ir::Value;
use splatgraph_null::{Config, Fault, Point};
use std::time::Duration;

/// Opens a viewer that has drawn its first plan, on a device whose driver hangs in the next pipeline. Waits for that
/// pipeline time out after `patience`.
fn hanging(patience: Duration) -> Script {
    let mut made = None;
    loop {
        let faults = made.map(|after| Fault { point: Point::Compile, after }).into_iter().collect();
        let config = Config { faults, compile_patience: patience, ..Config::default() };
        let mut script = Script::open(&config);
        script.settle();
        if made.is_some() {
            return script;
        }
        made = Some(script.pipelines());
        script.close(&[]);
    }
}

fn digits(script: &mut Script) -> Value {
    script.viewer().a.renderer.plan().expect("a plan").params[0].value.clone()
}

fn set_digits(script: &mut Script, digits: i64) {
    script.viewer().a.renderer.set_param("digits", Some(Value::Int(digits)));
}

fn failures(events: &[Event]) -> Vec<&str> {
    let mut failures = Vec::new();
    for event in events {
        if let Event::Failed { text, .. } = event {
            failures.push(text.as_str());
        }
    }
    failures
}

#[test]
fn a_build_that_the_driver_does_not_end_makes_way_for_the_next_change() {
    let mut script = hanging(Duration::from_secs(600));
    let made = script.pipelines();
    set_digits(&mut script, 5);
    script.until("the compiler", |script| script.pipelines() > made);
    set_digits(&mut script, 6);
    script.settle();
    assert_eq!(digits(&mut script), Value::Int(6));
    let (_, events, _) = script.close(&[]);
    assert_eq!(failures(&events), Vec::<&str>::new(), "nobody waited for it");
}

#[test]
fn the_build_of_a_copy_measurement_counts_as_running() {
    let mut script = hanging(Duration::from_secs(600));
    let made = script.pipelines();
    assert!(script.viewer().is_idle());
    script.viewer().measure_copy();
    script.until("the compiler", |script| script.pipelines() > made);
    assert!(!script.viewer().is_idle(), "the driver compiles the copy");
    script.close(&[]);
}

#[test]
fn a_build_that_is_given_up_is_shown_with_its_pass_and_its_shader_and_the_last_plan_draws_on() {
    let mut script = hanging(Duration::from_millis(300));
    set_digits(&mut script, 5);
    script.until("the error", |script| script.viewer().a.renderer.failure().is_some());
    assert_eq!(digits(&mut script), Value::Int(4));
    assert!(script.draws(), "frames go on");
    // After the driver has returned, the plan is built again without a request.
    script.settle();
    assert_eq!(digits(&mut script), Value::Int(5));
    let (_, events, _) = script.close(&[]);
    let failures = failures(&events);
    assert_eq!(failures.len(), 1, "{failures:#?}");
    let text = "error: the driver has been compiling shader `once.comp` for pass `once` of `";
    assert!(failures[0].starts_with(text), "{failures:#?}");
}
