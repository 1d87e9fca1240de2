//! Histories: contents that graphs declare to keep. Also the contents of a presented output.

use splatgraph_framework::ir::{
    Accesses, Layout, Load, Masks, Pass, PassId, ResourceId, Run, Stages, Use, Work as PlanWork,
};
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::sync::model::{Replay, Rules, has_violation, replay};
use splatgraph_vulkan::sync::{Barrier, Barriers};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use super::builds::{barriers, for_all, shown};
use super::recipe::{Half, Kind, LARGE, Role};
use super::sketch::{Pass as Sketched, Target};
use crate::common::say;

/// Returns true if the frame's first pass that uses a resource fills it or clears it as a target.
fn starts_anew(plan: &Plan, id: ResourceId) -> bool {
    let uses = |pass: &&Pass| pass.uses.iter().any(|touch| touch.resource == id);
    let Some(first) = plan.frame.iter().map(|pass| plan.pass(*pass)).find(uses) else { return false };
    match &first.work {
        PlanWork::Fill { buffer, .. } => *buffer == id,
        PlanWork::Draw { targets, .. } => {
            targets.iter().any(|target| target.image == id && matches!(target.load, Load::Clear(..)))
        }
        _ => false,
    }
}

#[test]
fn a_declared_history_is_kept_unless_every_frame_starts_by_writing_over_it() {
    let (kept, dropped, shared) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
    for_all("histories", LARGE, 1000, |case| {
        let (plan, sketch) = (&case.plan, &case.sketch);
        let buffers = sketch.buffers.iter().enumerate().map(|(at, b)| (Target::Buffer(at), b.history));
        let images = sketch.images.iter().enumerate().map(|(at, i)| (Target::Image(at), i.history));
        for (of, _) in buffers.chain(images).filter(|(_, history)| *history) {
            let names = match of {
                Target::Buffer(at) if sketch.buffers[at].role == Role::PingPong => {
                    vec![format!("b{at:02}#0"), format!("b{at:02}#1")]
                }
                Target::Buffer(at) => vec![format!("b{at:02}")],
                Target::Image(at) => vec![format!("i{at:02}")],
            };
            // The sketch shows whether a pass reads the previous frame's contents; the plan does not.
            let reads_last = sketch
                .passes
                .iter()
                .any(|pass| pass.uses().any(|(what, _)| what.of == of && what.half == Half::Last));
            // Nor does it show which passes only ask for a size, which needs no contents.
            let binds =
                || sketch.passes.iter().flat_map(|pass| &pass.binds).filter(|bind| bind.what.of == of);
            let sized = binds().any(|bind| !bind.reads && !bind.writes);
            let keeps = |pass: &Sketched| match &pass.work {
                Kind::Draw { targets, .. } => {
                    targets.iter().any(|(at, keep)| *keep && Target::Image(*at) == of)
                }
                _ => false,
            };
            let read = binds().any(|bind| bind.reads) || sketch.passes.iter().any(keeps);
            let overwrites = |id: &ResourceId| {
                let uses = |pass: &Pass| pass.uses.iter().any(|touch| touch.resource == *id);
                plan.passes.iter().any(|pass| uses(pass) && pass.overwrites(*id))
            };
            let once = |id: &ResourceId| {
                let passes = plan.prologue.iter().map(|pass| plan.pass(*pass));
                let passes = passes.filter(|pass| !matches!(pass.work, PlanWork::ClearHistory { .. }));
                passes.flat_map(|pass| &pass.uses).any(|touch| touch.resource == *id)
            };
            let halves: Vec<ResourceId> = names.iter().filter_map(|name| plan.find_resource(name)).collect();
            let live = halves.iter().filter(|id| plan.resource(**id).history.is_some()).count();
            // If no pass reads a resource, its contents do not matter, and the fill or clear at its start is culled.
            let unread = |id: &ResourceId| {
                let mut uses = plan.passes.iter().flat_map(|pass| &pass.uses);
                !uses.any(|touch| touch.resource == *id && touch.accesses.reads())
            };
            // Of a ping-pong buffer, the half in front at the end of the frame is kept. It may be unused.
            let free = halves.iter().all(|id| (starts_anew(plan, *id) || unread(id)) && !once(id))
                || halves.len() < names.len();
            match live {
                0 if halves.is_empty() => {}
                0 if names.len() == 2 && halves.iter().any(|id| starts_anew(plan, *id) && !once(id)) => {}
                0 if free => _ = dropped.fetch_add(1, Relaxed),
                0 if sized && (!read || halves.iter().all(overwrites)) => {}
                0 => return Err(format!("`{}` is not kept in\n{}", names[0], shown(plan))),
                _ => {
                    let id = *halves.iter().find(|id| plan.resource(**id).history.is_some()).expect("live");
                    if starts_anew(plan, id) && !reads_last && !once(&id) {
                        return Err(format!("`{}` is kept for nothing in\n{}", names[0], shown(plan)));
                    }
                    if plan.aliases(id).next().is_some() {
                        return Err(format!("`{}` is kept and shares memory in\n{}", names[0], shown(plan)));
                    }
                    let starts = |pass: &Pass| pass.work == PlanWork::ClearHistory { resource: id };
                    if !plan.prologue.iter().any(|pass| starts(plan.pass(*pass))) {
                        return Err(format!("`{}` does not start from zeros in\n{}", names[0], shown(plan)));
                    }
                    kept.fetch_add(1, Relaxed);
                }
            }
            shared.fetch_add(halves.iter().filter(|id| plan.aliases(**id).next().is_some()).count(), Relaxed);
        }
        Ok(())
    });
    let [kept, dropped, shared] = [kept, dropped, shared].map(AtomicUsize::into_inner);
    say(&format!(
        "random graphs: {kept} histories kept, {dropped} not, {shared} resources share their memory"
    ));
    assert!(kept > 200 && dropped > 5, "too few histories");
}

/// Adds a blit of the output to the end of the frame, as the runtime submits it.
///
/// The blit is a read at the copy stage, followed by a call that makes `waiting` wait for it.
fn presented(plan: &Plan, mut barriers: Barriers, waiting: Stages) -> (Plan, Barriers) {
    let mut plan = plan.clone();
    let pass = |name: &str, uses| Pass {
        name: name.into(),
        phase: "window".into(),
        run: Run::Frame,
        work: PlanWork::Export,
        bindings: Vec::new(),
        push: Vec::new(),
        uses,
        origin: plan.passes[0].origin.clone(),
    };
    let read = Use {
        resource: plan.output,
        stages: Stages::COPY,
        accesses: Accesses::TRANSFER_READ,
        layout: Some(Layout::TransferSource),
        discards: false,
    };
    let (blit, after) = (pass("blit", vec![read]), pass("after", Vec::new()));
    let waits = Barrier {
        image: None,
        masks: Masks { source_stages: Stages::COPY, target_stages: waiting, ..Masks::default() },
        causes: Vec::new(),
    };
    for (pass, call) in [(blit, Vec::new()), (after, vec![waits])] {
        plan.frame.push(PassId(plan.passes.len() as u32));
        plan.passes.push(pass);
        barriers.before.push(call);
    }
    (plan, barriers)
}

#[test]
fn a_plan_with_statistics_can_be_presented() {
    let (held, needed) = (AtomicUsize::new(0), AtomicUsize::new(0));
    for_all("presented", LARGE, 500, |case| {
        let own = barriers(&case.plan);
        let waiting = own.waiting_for_copies(&case.plan);
        let (plan, barriers) = presented(&case.plan, own.clone(), waiting);
        if let Some(violation) = replay(&plan, &barriers, &Replay::default()).first() {
            return Err(format!("{}\n{}", violation.describe(&plan), shown(&plan)));
        }
        held.fetch_add(1, Relaxed);
        // Only `COPY` waits for the blit here. The plan's own wait for copies may come before the blit.
        let (plan, barriers) = presented(&case.plan, own, Stages::COPY);
        needed.fetch_add(usize::from(has_violation(&plan, &barriers, Rules::HAZARDS)), Relaxed);
        Ok(())
    });
    let [held, needed] = [held, needed].map(AtomicUsize::into_inner);
    say(&format!("random graphs: {held} presented, {needed} need more than a wait for copies"));
    assert!(needed > 10, "too few plans whose own wait comes before the blit");
}
