//! Tests that mutations cover every barrier, and that minimal barriers have no needless bit.

use super::memory_state::At;
use super::mutate::{Mutation, apply, mutations, needless};
use super::*;
use splatgraph_framework::ir::Layout::{ColorTarget, General, TransferSource, Undefined};

/// Returns a plan whose barriers have no needless bit. The prologue fills and changes a table. In a frame, a dispatch
/// writes a buffer and an image, a draw reads the buffer, and the image is exported.
fn minimal() -> Sketch {
    let mut sketch = Sketch::new();
    let (table, keys, image) = (sketch.buffer("table"), sketch.buffer("keys"), sketch.image("image"));
    let color = sketch.image("color");
    let output = (Stages::COLOR_OUTPUT, Accesses::COLOR_WRITE);
    let transfer = (COPY, Accesses::TRANSFER_READ);
    sketch.once("fill", &[], &[fills(table)]);
    sketch.once(
        "load",
        &[barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, BOTH))],
        &[touch(table, COMPUTE, BOTH)],
    );
    sketch.barriers.handover = vec![compute_to_compute()];
    // In the previous frame, the draw reads the keys, and the export reads the image.
    let again = change(image, (Undefined, General), (COPY, NO_ACCESS), (COMPUTE, WRITE));
    sketch.frame(
        "key",
        &[order(VERTEX, COMPUTE), again],
        &[reads(table), writes(keys), in_general(image, WRITE)],
    );
    let target = Use { layout: Some(ColorTarget), discards: true, ..touch(color, output.0, output.1) };
    let ready = change(color, (Undefined, ColorTarget), output, output);
    sketch.frame(
        "draw",
        &[barrier((COMPUTE, WRITE), (VERTEX, READ)), ready],
        &[touch(keys, VERTEX, READ), target],
    );
    let exported = Use { layout: Some(TransferSource), ..touch(image, transfer.0, transfer.1) };
    let shown = change(image, (General, TransferSource), (COMPUTE, WRITE), transfer);
    sketch.frame_work("export", &[shown], Work::Export, &[exported]);
    sketch
}

#[test]
fn a_minimal_plan_is_sufficient_and_nothing_in_it_is_needless() {
    let sketch = minimal();
    assert_eq!(sketch.found_in(4), NOTHING);
    let Sketch { barriers, .. } = &sketch;
    let describe = |mutation: &Mutation| mutation.describe(&sketch.plan, barriers);
    let needless: Vec<_> = needless(&sketch.plan, barriers).iter().map(describe).collect();
    assert_eq!(needless, NOTHING);
    for mutation in mutations(&sketch.plan, barriers) {
        assert!(
            has_violation(&sketch.plan, &apply(barriers, &mutation), Rules::HAZARDS),
            "{}",
            describe(&mutation)
        );
    }
}

#[test]
fn a_trial_leaves_the_replay_as_it_was() {
    let sketch = minimal();
    // Without the frame's layout changes, most positions give violations.
    let mut worse = minimal();
    worse.barriers.before[2..].iter_mut().for_each(|call| call.retain(|barrier| barrier.image.is_none()));
    let trace = Trace::new(&sketch.plan, 2);
    let mut memory = MemoryState::new(&sketch.plan, &trace, Replay::default(), Rules::HAZARDS, true);
    let mut next = Some(memory.start());
    let mut trials = 0;
    while let Some(at) = next {
        // Late in the last frame, the remaining steps may give none.
        let found = memory.trial(&worse.barriers, at);
        assert!(found || at == At::Frame(3, 0) || trials > 3, "{at:?}");
        assert_eq!(memory.findings.violations, []);
        trials += 1;
        next = memory.advance(&sketch.barriers, at);
    }
    assert_eq!(memory.findings.violations, [], "the plan has none, whatever was tried in between");
    assert!(trials > 12);
}

#[test]
fn every_barrier_and_every_bit_is_tried() {
    let sketch = minimal();
    let all = mutations(&sketch.plan, &sketch.barriers);
    assert_eq!(sketch.barriers.calls(&sketch.plan).flat_map(|(_, call)| call).count(), 7);
    assert_eq!(all.iter().filter(|m| m.clear.is_none()).count(), 7);
    // Stage and access bits: 5 in the prologue, 4 in the handover, 2 + 3, 4 + 4 and 4 in the frame.
    assert_eq!(all.len(), 7 + 5 + 4 + 5 + 8 + 4);
    for mutation in &all {
        assert_ne!(apply(&sketch.barriers, mutation), sketch.barriers);
    }
}

#[test]
fn a_bit_too_much_is_found_needless() {
    let at = Some(minimal().plan.frame[1]);
    for bit in [
        Masks { source_stages: COPY, ..Masks::default() },
        Masks { source_accesses: Accesses::TRANSFER_WRITE, ..Masks::default() },
        Masks { target_stages: FRAGMENT, ..Masks::default() },
        Masks { target_accesses: Accesses::UNIFORM_READ, ..Masks::default() },
    ] {
        let mut sketch = minimal();
        sketch.before(1)[0].masks.add(bit);
        assert_eq!(sketch.found_in(4), NOTHING);
        let expected = [Mutation { at, barrier: 0, clear: Some(bit) }];
        assert_eq!(needless(&sketch.plan, &sketch.barriers), expected);
    }
}

#[test]
fn a_barrier_too_much_is_found_needless_with_all_its_bits() {
    let mut sketch = minimal();
    sketch.barriers.handover.push(order(CLEAR, COPY));
    let at = None;
    let expected = vec![
        Mutation { at, barrier: 1, clear: None },
        Mutation { at, barrier: 1, clear: Some(Masks { source_stages: CLEAR, ..Masks::default() }) },
        Mutation { at, barrier: 1, clear: Some(Masks { target_stages: COPY, ..Masks::default() }) },
    ];
    assert_eq!(needless(&sketch.plan, &sketch.barriers), expected);
    assert!(sketch.before_once(1)[0] == minimal().before_once(1)[0]);
}

#[test]
fn removing_takes_the_layout_change_away_and_clearing_one_bit() {
    let sketch = minimal();
    let pass = |name: &str| sketch.plan.passes.iter().position(|p| p.name == name).map(|i| PassId(i as u32));
    let removed = apply(&sketch.barriers, &Mutation { at: pass("key"), barrier: 1, clear: None });
    assert_eq!(*removed.at(pass("key")), [order(VERTEX, COMPUTE)]);
    let clear = Mutation {
        at: pass("load"),
        barrier: 0,
        clear: Some(Masks { target_accesses: READ, ..Masks::default() }),
    };
    let cleared = apply(&sketch.barriers, &clear);
    let expected = barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, WRITE));
    assert_eq!(*cleared.at(pass("load")), [expected]);
}

#[test]
fn a_mutation_says_what_and_where() {
    let sketch = minimal();
    let describe = |mutation: Mutation| mutation.describe(&sketch.plan, &sketch.barriers);
    let frame = |place: usize| Some(sketch.plan.frame[place]);
    let clear = Mutation {
        at: frame(1),
        barrier: 0,
        clear: Some(Masks { target_stages: VERTEX, ..Masks::default() }),
    };
    assert_eq!(describe(clear), "target stage VERTEX of barrier 0 (all memory) before `draw` in the frame");
    let remove = Mutation { at: frame(2), barrier: 0, clear: None };
    assert_eq!(
        describe(remove),
        "barrier 0 (`image`, General to TransferSource) before `export` in the frame"
    );
    let clear =
        Mutation { at: None, barrier: 0, clear: Some(Masks { source_accesses: WRITE, ..Masks::default() }) };
    assert_eq!(describe(clear), "source access STORAGE_WRITE of barrier 0 (all memory) in the handover");
}
