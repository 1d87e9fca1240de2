//! Dispatches, fills and indirect arguments on one buffer, or on two that alias.

use super::*;

fn aliased(first: Action, second: Action) -> Case {
    let mut build = Build::new();
    let aliases = [build.words("alias", 4), build.words("other alias", 4)];
    build.share(&aliases);
    first(&mut build, "first", aliases[0]);
    second(&mut build, "second", aliases[1]);
    case(build)
}

fn indirect() -> Case {
    let mut build = Build::new();
    let args = build.words("args", 4);
    build.writes("first", args);
    let sink = build.words("sink", 4);
    let shader = build.shader("add.comp", &add(1));
    build.dispatch_indirect("second", shader, (args, 0), &[(sink, 0, BOTH)]);
    case(build).between("second", COMPUTE_WRITES, (Stages::INDIRECT, Accesses::INDIRECT_READ))
}

fn uniform() -> Case {
    let mut build = Build::new();
    let (words, sink) = (build.words("words", 4), build.words("sink", 4));
    build.plan.resources[words.index()].usage |= Usage::UNIFORM;
    build.writes("first", words);
    let shader = build.shader(
        "uniform.comp",
        "layout(set = 0, binding = 0) uniform Source { uvec4 source; };
layout(set = 0, binding = 1) writeonly buffer Sink { uvec4 sink; };
void main() { sink = source; }",
    );
    build.dispatch(Run::Frame, "second", shader, 1, &[(words, 0, UNIFORM), (sink, 1, WRITE)]);
    case(build).between("second", COMPUTE_WRITES, (Stages::COMPUTE, UNIFORM))
}

#[test]
fn a_hazard_names_the_resource_and_the_pass() {
    let said = two(fills, Build::changes).said(removed("second"));
    let hazard = said.iter().find(|text| text.contains("SYNC-HAZARD"));
    let hazard = hazard.unwrap_or_else(|| panic!("no hazard was seen in {said:?}"));
    assert!(hazard.contains("[words]") && hazard.contains("[second]"), "{hazard}");
}

#[test]
fn read_after_write_without_a_barrier_is_caught() {
    two(Build::writes, Build::reads).caught(removed("second"), RAW);
    two(Build::changes, Build::reads).caught(removed("second"), RAW);
    two(fills, Build::reads).caught(removed("second"), RAW);
    uniform().caught(removed("second"), RAW);
    indirect().caught(removed("second"), RAW);
}

#[test]
fn every_bit_missing_from_a_barrier_for_read_after_write_is_caught() {
    let reads = (Stages::INDIRECT, Accesses::INDIRECT_READ);
    for (exact, source, target) in [
        (two(Build::writes, Build::reads), COMPUTE_WRITES, COMPUTE_READS),
        (two(fills, Build::reads), FILLS, COMPUTE_READS),
        (uniform(), COMPUTE_WRITES, (Stages::COMPUTE, UNIFORM)),
        (indirect(), COMPUTE_WRITES, reads),
    ] {
        let exact = exact.between("second", source, target);
        exact.caught(cleared("second", access(source.1), NOTHING), RAW);
        exact.caught(cleared("second", NOTHING, access(target.1)), RAW);
        // Clears the access together with its stage: an access that no stage of the mask supports is another kind of
        // error.
        exact.caught(cleared("second", source, NOTHING), RAW);
        exact.caught(cleared("second", NOTHING, target), RAW);
    }
}

#[test]
fn a_barrier_for_another_kind_of_read_is_caught() {
    let another = |case: &mut Case| case.before("second")[0].masks.target_accesses = READ;
    uniform().caught(another, RAW);
    let elsewhere = |case: &mut Case| case.before("second")[0] = barrier(COMPUTE_WRITES, COMPUTE_READS);
    indirect().caught(elsewhere, RAW);
}

#[test]
fn write_after_read_without_a_barrier_is_caught() {
    two(Build::reads, Build::writes).caught(removed("second"), WAR);
    two(Build::reads, Build::changes).caught(removed("second"), WAR);
    two(Build::reads, fills).caught(removed("second"), WAR);
}

#[test]
fn every_stage_missing_from_a_barrier_for_write_after_read_is_caught() {
    let exact = two(Build::reads, fills).between("second", stage(Stages::COMPUTE), stage(Stages::CLEAR));
    exact.caught(cleared("second", stage(Stages::COMPUTE), NOTHING), WAR);
    exact.caught(cleared("second", NOTHING, stage(Stages::CLEAR)), WAR);
}

#[test]
fn write_after_read_of_indirect_arguments_is_caught() {
    let mut build = Build::new();
    let (args, sink) = (build.words("args", 4), build.words("sink", 4));
    let shader = build.shader("add.comp", &add(1));
    build.fill(Run::Frame, "fill", args, 1);
    build.dispatch_indirect("first", shader, (args, 0), &[(sink, 0, BOTH)]);
    build.writes("second", args);
    let exact = case(build).between("second", stage(Stages::INDIRECT), stage(Stages::COMPUTE));
    exact.caught(removed("second"), WAR);
    exact.caught(cleared("second", stage(Stages::INDIRECT), NOTHING), WAR);
}

#[test]
fn write_after_write_is_caught_where_one_of_the_two_is_a_fill() {
    two(fills, fills).caught(removed("second"), WAW);
    for exact in [
        two(fills, Build::writes).between("second", FILLS, COMPUTE_WRITES),
        two(Build::writes, fills).between("second", COMPUTE_WRITES, FILLS),
    ] {
        exact.caught(removed("second"), WAW);
        exact.caught(cleared("second", access(Accesses::WRITES), NOTHING), WAW);
        exact.caught(cleared("second", NOTHING, access(Accesses::WRITES)), WAW);
    }
}

#[test]
fn write_after_write_between_dispatches_is_not_seen() {
    two(Build::writes, Build::writes).not_seen(removed("second"));
    // This holds even if the second pass reads the first one's data before it overwrites it.
    two(Build::writes, Build::changes).not_seen(removed("second"));
    two(Build::changes, Build::writes).not_seen(removed("second"));
    two(Build::changes, Build::changes).not_seen(removed("second"));
}

#[test]
fn a_binding_that_is_read_and_stored_to_counts_as_a_write_alone() {
    let exact = two(fills, Build::changes).between("second", FILLS, COMPUTE_DOES_BOTH);
    exact.not_seen(cleared("second", NOTHING, access(READ)));
    exact.caught(cleared("second", NOTHING, access(WRITE)), WAW);
}

#[test]
fn a_binding_with_atomics_alone_counts_as_a_read() {
    let exact = two(fills, Build::counts).between("second", FILLS, COMPUTE_DOES_BOTH);
    exact.caught(removed("second"), RAW);
    exact.caught(cleared("second", NOTHING, access(READ)), RAW);
    exact.not_seen(cleared("second", NOTHING, access(WRITE)));
    two(Build::writes, Build::counts).caught(removed("second"), RAW);
    two(Build::changes, Build::counts).caught(removed("second"), RAW);
    // The layer never sees an atomic as the writer...
    two(Build::counts, Build::reads).not_seen(removed("second"));
    two(Build::reads, Build::counts).not_seen(removed("second"));
    two(Build::counts, Build::counts).not_seen(removed("second"));
    // ... so a later pass must wait for it, but needs no memory dependency.
    let exact = two(Build::counts, fills).between("second", COMPUTE_DOES_BOTH, FILLS);
    exact.caught(removed("second"), WAR);
    exact.not_seen(cleared("second", access(WRITE), NOTHING));
}

#[test]
fn read_after_write_and_write_after_read_in_shared_memory_are_caught() {
    let exact = aliased(Build::writes, Build::reads).between("second", COMPUTE_WRITES, COMPUTE_READS);
    exact.caught(removed("second"), RAW);
    exact.caught(cleared("second", access(WRITE), NOTHING), RAW);
    exact.caught(cleared("second", NOTHING, access(READ)), RAW);
    aliased(Build::reads, Build::writes).caught(removed("second"), WAR);
}

#[test]
fn write_after_write_in_shared_memory_is_caught_only_where_one_of_the_two_is_a_fill() {
    aliased(fills, Build::writes).caught(removed("second"), WAW);
    aliased(Build::writes, fills).caught(removed("second"), WAW);
    aliased(Build::writes, Build::writes).not_seen(removed("second"));
}
