//! The Metal backend's walk over a plan's encoders creates exactly the encoders that the model of Metal's rules
//! accepts.
//!
//! The part of the backend that calls Metal follows the walk, one call per move. These tests walk a few frames of every
//! built-in graph, rebuild the encoders from the moves, and compare them with the lowered ones.

use crate::encoders::PLANS;
use splatgraph_framework::ir::PassId;
use splatgraph_metal::sync::{Division, EncodedPass, Encoders, Encoding};
use splatgraph_metal::walk::{Move, Walk, Walked};

/// Walks a frame of `passes` and marks it as submitted.
///
/// Returns its encoders, and the number of encoders before the prologue was handed over; `None` if it was not.
fn walked_frame(walked: &mut Walked, passes: &[PassId], timed: bool) -> (Vec<Encoding>, Option<usize>) {
    let (mut walk, mut found, mut handover) = (Walk::default(), Vec::new(), None);
    let mut open: Option<Encoding> = None;
    walk.begin();
    let mut follow = |moves: &mut Vec<Move>, pass: Option<PassId>| {
        let mut barrier = None;
        for step in moves.drain(..) {
            let encoding = open.as_mut();
            match (step, encoding) {
                (Move::Open(kind), None) => {
                    open = Some(Encoding { kind, waits: vec![], passes: vec![], updates: vec![] });
                }
                (Move::Wait(fence), Some(encoding)) => encoding.waits.push(fence),
                (Move::Barrier(memory), Some(_)) => barrier = Some(memory),
                (Move::Update(fence), Some(encoding)) => encoding.updates.push(fence),
                (Move::Close, Some(_)) => found.extend(open.take()),
                (Move::HandOver, None) => handover = Some(found.len()),
                (step, _) => panic!("{step:?} after {found:?}"),
            }
        }
        if let (Some(pass), Some(encoding)) = (pass, &mut open) {
            encoding.passes.push(EncodedPass { barrier, pass });
        }
    };
    let mut moves = Vec::new();
    for id in passes {
        walk.pass(walked, *id, timed, &mut moves);
        // A host pass makes no moves and is in no encoder.
        let encoders = walked.encoders(if timed { Division::Passes } else { Division::Merged });
        let all = encoders.prologue.iter().chain(&encoders.frame).flat_map(|encoding| &encoding.passes);
        let encoded = all.map(|pass| pass.pass).any(|pass| pass == *id);
        follow(&mut moves, encoded.then_some(*id));
    }
    walk.interrupt(walked, &mut moves);
    follow(&mut moves, None);
    walked.submitted(&walk);
    (found, handover)
}

/// Returns the encoders without waits for fences that were not updated before. `updated` has a flag per fence, which is
/// kept from frame to frame.
fn expected(encodings: &[Encoding], updated: &mut [bool]) -> Vec<Encoding> {
    let mut all = encodings.to_vec();
    for encoding in &mut all {
        encoding.waits.retain(|wait| updated[wait.fence as usize]);
        encoding.updates.iter().for_each(|update| updated[update.fence as usize] = true);
    }
    all
}

#[test]
fn the_walk_over_every_built_in_graph_makes_the_encoders_that_were_proven() {
    for plan in &*PLANS {
        for (division, timed) in [(Division::Merged, false), (Division::Passes, true)] {
            let mut walked = Walked::new(plan);
            let Encoders { prologue, frame, handover, fences } = walked.encoders(division).clone();
            let mut updated = vec![false; fences as usize];
            let (first, frames): (Vec<PassId>, _) = (plan.order().collect(), &plan.frame);
            let (found, handed_over) = walked_frame(&mut walked, &first, timed);
            let wanted = expected(&[&prologue[..], &frame[..]].concat(), &mut updated);
            assert_eq!(found, wanted, "{}, {division:?}: the first frame", plan.name);
            let hands_over = handover && !prologue.is_empty();
            assert_eq!(handed_over, hands_over.then_some(prologue.len()), "{}, {division:?}", plan.name);
            for number in 2..4 {
                let (found, handed_over) = walked_frame(&mut walked, frames, timed);
                let wanted = expected(&frame, &mut updated);
                assert_eq!(found, wanted, "{}, {division:?}: frame {number}", plan.name);
                assert_eq!(handed_over, None);
            }
            // Every fence of the frame has been updated by now, so no wait is omitted.
            assert_eq!(walked_frame(&mut walked, frames, timed).0, frame, "{}, {division:?}", plan.name);
        }
    }
}
