//! Adds the encoders of a plan to its dump, with names instead of numbers.

use crate::sync::{self, *};
use splatgraph_framework::dump::{self, Declared, Dump, DumpEncoder, DumpEncoders, EncoderTotals};
use splatgraph_framework::plan::{Cause, Plan};

type Reason = Cause<Declared, Declared>;

/// Adds the encoders of a plan to its dump, with their fences and barriers and the reasons for them.
pub fn add_encoders(dump: Dump, plan: &Plan) -> Dump {
    let (encoders, reasons) = explained(plan, Division::Merged);
    let at = |place: At| -> Vec<Reason> {
        let here = reasons.iter().filter(|(at, _)| *at == place);
        here.map(|(_, reason)| Declared::cause(plan, reason)).collect()
    };
    let list = |encodings: &[Encoding], place: fn(usize, Point) -> At| -> Vec<DumpEncoder> {
        let encoder = |(index, encoding)| encoder_of(plan, encoding, |point| at(place(index, point)));
        encodings.iter().enumerate().map(encoder).collect()
    };
    Dump {
        encoders: Some(DumpEncoders {
            prologue: list(&encoders.prologue, At::Prologue),
            handover: at(At::Handover),
            frame: list(&encoders.frame, At::Frame),
            prologue_totals: totals(&encoders.prologue),
            frame_totals: totals(&encoders.frame),
            timed_totals: totals(&sync::encoders(plan, Division::Passes).frame),
        }),
        ..dump
    }
}

fn encoder_of(plan: &Plan, encoding: &Encoding, reasons: impl Fn(Point) -> Vec<Reason>) -> DumpEncoder {
    let stage = |of: Option<RenderStages>| of.map(|stages| format!("{stages:?}").to_lowercase());
    let wait = |(index, wait): (usize, &FenceUse)| dump::DumpWait {
        fence: wait.fence,
        stage: stage(wait.stages),
        reasons: reasons(Point::Wait(index)),
    };
    let update = |update: &FenceUse| dump::DumpUpdate { fence: update.fence, stage: stage(update.stages) };
    let pass = |(index, of): (usize, &EncodedPass)| dump::EncodedPass {
        pass: plan.pass(of.pass).name.clone(),
        barrier: of.barrier.map(|MemoryBarrier { buffers, textures }| {
            let scope = [("buffers", buffers), ("textures", textures)].into_iter().filter(|(_, on)| *on);
            dump::EncoderBarrier {
                scope: scope.map(|(name, _)| name.to_string()).collect(),
                reasons: reasons(Point::Barrier(index)),
            }
        }),
    };
    DumpEncoder {
        kind: format!("{:?}", encoding.kind).to_lowercase(),
        waits: encoding.waits.iter().enumerate().map(wait).collect(),
        passes: encoding.passes.iter().enumerate().map(pass).collect(),
        updates: encoding.updates.iter().map(update).collect(),
    }
}

fn totals(encodings: &[Encoding]) -> EncoderTotals {
    let mut fences: Vec<u32> = encodings.iter().flat_map(|e| &e.updates).map(|update| update.fence).collect();
    fences.sort_unstable();
    fences.dedup();
    let passes = encodings.iter().flat_map(|encoding| &encoding.passes);
    EncoderTotals {
        encoders: encodings.len(),
        fences: fences.len(),
        waits: encodings.iter().map(|encoding| encoding.waits.len()).sum(),
        updates: encodings.iter().map(|encoding| encoding.updates.len()).sum(),
        barriers: passes.filter(|pass| pass.barrier.is_some()).count(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::handmade;
    use crate::testing::*;

    #[test]
    fn encoders_are_told_beside_the_barriers_of_the_plan_with_their_reasons_and_counts() {
        let mut s = chain();
        s.plan.shaders = handmade::plan().shaders;
        let dump = add_encoders(dump::dump(&s.plan), &s.plan);
        let text = dump::encoders_text(&dump).expect("they were added");
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        for line in [
            "encoder 1 (compute)",
            "change                       barrier: buffers",
            "wait for fence 0 before vertex stage",
            "update fence 1 after fragment stage",
            "write after read on x, after draw of the previous frame, for make",
            "read after write on x, after make, for change",
        ] {
            assert!(lines.contains(&line), "{line} is not in\n{text}");
        }
        let encoders = dump.encoders.expect("they were added");
        let compute = &encoders.frame[0];
        assert_eq!((compute.kind.as_str(), encoders.frame.len()), ("compute", 3));
        assert_eq!(compute.passes[1].barrier.as_ref().map(|barrier| barrier.reasons.len()), Some(1));
        assert_eq!(encoders.handover.len(), 1);
        assert_eq!(encoders.timed_totals.encoders, 4);
    }
}
