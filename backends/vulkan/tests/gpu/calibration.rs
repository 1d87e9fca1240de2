//! What the validation layer sees and what it does not, tried with barriers taken out: without this, "no message" would
//! mean nothing.

use crate::build::*;
use splatgraph_framework::plan::*;

/// Fill, dispatch (reads and writes), dispatch into an image, export: with all their barriers.
fn plan() -> Plan {
    let mut build = Build::new();
    let words_ = build.words("words", 4);
    build.fill(Run::Frame, "fill", words_, 7);
    let shader = build.shader("add.comp", &add(1));
    build.dispatch(Run::Frame, "add", shader, 4, &[(words_, 0, BOTH)]);
    show(build, words_)
}

/// The messages of one frame of an altered plan, its output read.
fn messages(alter: impl FnOnce(&mut Plan)) -> Vec<String> {
    let mut plan = plan();
    alter(&mut plan);
    let mut vulkan = open();
    load(&mut vulkan, plan);
    frame(&mut vulkan, &with_output());
    vulkan.close()
}

/// The words' barrier of a step.
fn barrier(plan: &mut Plan, step: usize) -> &mut Barrier {
    plan.frame[step].barriers.iter_mut().find(|b| b.layouts.is_none()).expect("a buffer's barrier")
}

#[test]
fn the_plan_as_it_is_gives_no_message() {
    assert_eq!(messages(|_| {}), Vec::<String>::new());
}

#[test]
fn a_missing_barrier_after_a_fill_is_a_message_that_names_the_resource_and_the_pass() {
    let said = messages(|plan| plan.frame[1].barriers.clear());
    let hazard = said.iter().find(|text| text.contains("SYNC-HAZARD"));
    let hazard = hazard.unwrap_or_else(|| panic!("no hazard was seen in {said:?}"));
    assert!(hazard.contains("[words]") && hazard.contains("[add]"), "{hazard}");
}

#[test]
fn a_missing_barrier_between_dispatches_is_a_message() {
    let said = messages(|plan| plan.frame[2].barriers.retain(|barrier| barrier.layouts.is_some()));
    assert!(said.iter().any(|text| text.contains("SYNC-HAZARD-READ-AFTER-WRITE")), "{said:?}");
}

// The layer looks at a binding that is read and written as at a write, so that a read access left out of the barrier
// before `add` would not be seen. The binding of `show` is only read.
#[test]
fn a_barrier_without_its_read_access_is_a_message() {
    let said = messages(|plan| barrier(plan, 2).target_accesses = Accesses::empty());
    assert!(said.iter().any(|text| text.contains("SYNC-HAZARD-READ-AFTER-WRITE")), "{said:?}");
}

#[test]
fn a_barrier_without_its_write_access_is_a_message() {
    let said = messages(|plan| barrier(plan, 2).source_accesses = Accesses::STORAGE_READ);
    assert!(said.iter().any(|text| text.contains("SYNC-HAZARD-READ-AFTER-WRITE")), "{said:?}");
}

#[test]
fn a_missing_layout_change_is_a_message() {
    let said = messages(|plan| plan.frame[3].barriers.clear());
    assert!(said.iter().any(|text| text.contains("LAYOUT")), "{said:?}");
}
