//! Tests driver compilers that hang.

use crate::common::*;
use crate::testing::plan;
use splatgraph_api::{BackendError, Device, Loader, Progress, Recovery};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
use splatgraph_null::{Config, Fault, Journal, Null, Object, Point};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Opens a device whose compiler hangs on these pipelines, numbered from 0.
fn hanging(pipelines: impl IntoIterator<Item = u64>) -> (Null, Journal) {
    let faults = pipelines.into_iter().map(|after| Fault { point: Point::Compile, after }).collect();
    opened(&Config { faults, compile_patience: Duration::from_millis(200), ..Config::default() })
}

/// Returns the plan of the unit tests under another name, which makes it a different plan.
fn named(name: &str) -> Plan {
    Plan { name: name.to_string(), ..plan() }
}

fn load_error(null: &mut Null, plan: Plan) -> BackendError {
    error_of(null.load(plan, &Zeros::default(), &mut |_| {}))
}

fn until_closed(journal: &Journal) {
    until(|| !journal.alive().contains_key(&Object::Device));
}

#[test]
fn a_pipeline_without_an_end_is_given_up_and_the_error_names_its_pass_and_shader() {
    // Pipelines 0 and 1 belong to the first plan, 2 and 3 (scan and draw) to the second. The last one hangs.
    let (mut null, journal) = hanging([3]);
    load(&mut null, plan());
    frame(&mut null, &inputs());
    let error = load_error(&mut null, named("other"));
    let BackendError::StuckCompiler { plan: name, pass, shader, .. } = &error else { panic!("{error}") };
    let other = plan();
    assert_eq!((name.as_str(), pass.as_str()), ("other", "splat"));
    assert!(other.shaders.iter().any(|known| known.name == *shader), "{shader}");
    assert_eq!(error.recovery(), Recovery::Retry);
    frame(&mut null, &inputs());
    // Every context refuses the same plan at once, and can load another.
    let reached = journal.reached(Point::Compile);
    assert_eq!(load_error(&mut null, named("other")), error);
    let mut beside = null.new_context().expect("there can be another");
    assert_eq!(load_error(&mut beside, named("other")), error);
    assert_eq!(journal.reached(Point::Compile), reached, "the compiler is not asked again");
    load(&mut beside, named("third"));
    frame(&mut beside, &inputs());
    journal.resume();
    until(|| {
        let loaded = null.load(named("other"), &Zeros::default(), &mut |_| {});
        assert!(loaded.is_ok() || loaded.as_ref() == Err(&error), "{loaded:?}");
        loaded.is_ok()
    });
    frame(&mut null, &inputs());
    drop(beside);
    finish(null, &journal);
}

/// Loads a plan, cancels the load at its first progress report, and checks that it ended there.
fn cancelled_at_once(null: &Null) {
    let wanted_no_more = Arc::new(AtomicBool::new(false));
    let cancel = Cancel::new({
        let asked = wanted_no_more.clone();
        move || asked.load(Ordering::Relaxed)
    });
    let mut seen = Vec::new();
    let mut progress = |step: Progress| {
        seen.push(format!("{step:?}"));
        wanted_no_more.store(true, Ordering::Relaxed);
    };
    let prepared = null.loader().cancelled_by(cancel).prepare(plan(), &Zeros::default(), &mut progress);
    assert_eq!(error_of(prepared), BackendError::Cancelled);
    assert_eq!(seen.len(), 1, "{seen:?}");
}

#[test]
fn a_load_that_nobody_wants_any_more_ends_in_the_compiler_and_between_pipelines() {
    let (null, journal) = hanging([0]);
    cancelled_at_once(&null);
    // The thread finishes that pipeline, and creates no other.
    journal.resume();
    let reached = journal.reached(Point::Compile);
    drop(null);
    until_closed(&journal);
    assert_eq!((journal.reached(Point::Compile), journal.alive()), (reached, Default::default()));
}

#[test]
fn a_load_that_nobody_wants_any_more_ends_between_quick_pipelines() {
    let (null, journal) = hanging([]);
    cancelled_at_once(&null);
    drop(null);
    until_closed(&journal);
}

#[test]
fn compilers_without_an_end_do_not_pile_up() {
    let (mut null, journal) = hanging(0..100);
    let mut errors = Vec::new();
    for index in 0..20 {
        errors.push(load_error(&mut null, named(&format!("plan {index}"))).to_string());
    }
    assert_eq!(journal.reached(Point::Compile), 8, "as many threads were tried");
    assert!(errors[7].contains("of `plan 7`"), "{}", errors[7]);
    assert!(errors[8..].iter().all(|error| error.contains("of `plan 0`")), "{errors:#?}");
    // Each pipeline of these plans hangs, so each thread must be resumed.
    drop(null);
    until(|| {
        journal.resume();
        journal.alive().is_empty()
    });
}

#[test]
fn builds_that_were_only_cancelled_end_by_themselves_and_the_next_one_waits_for_that() {
    let faults = (0..8).map(|after| Fault { point: Point::Compile, after }).collect();
    let config = Config { faults, compile_patience: Duration::from_secs(60), ..Config::default() };
    let (mut null, journal) = opened(&config);
    for index in 0..8 {
        // The load is cancelled as soon as its first pipeline is being compiled.
        let reached = journal.clone();
        let cancel = Cancel::new(move || reached.reached(Point::Compile) > index);
        let plan = named(&format!("plan {index}"));
        let prepared = null.loader().cancelled_by(cancel).prepare(plan, &Zeros::default(), &mut |_| {});
        assert_eq!(error_of(prepared), BackendError::Cancelled);
    }
    let driver = std::thread::spawn({
        let journal = journal.clone();
        move || {
            std::thread::sleep(Duration::from_millis(100));
            journal.resume();
        }
    });
    load(&mut null, named("wanted"));
    driver.join().expect("it ends");
    frame(&mut null, &inputs());
    assert_eq!(null.close(), Vec::<String>::new());
    // The thread of the last cancelled load may not have ended yet.
    until_closed(&journal);
    assert_eq!(journal.alive(), Default::default());
}
