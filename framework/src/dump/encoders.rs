//! Formats the encoders that a backend added to a dump, beside the plan's own barriers.
//!
//! The framework only shows them: a backend that divides plans into encoders (Metal's) fills them in.

use serde::{Deserialize, Serialize};
use std::fmt::{self, Write};

use super::text::hazard_words;
use super::{BarrierTotals, Declared, Dump, DumpBarrier, DumpPass};
use crate::ir::{Hazard, Run};

/// The encoders of a plan, for an API that has encoders, fences and barriers within them (Metal).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpEncoders {
    /// Encoders that run once.
    pub prologue: Vec<DumpEncoder>,
    /// Reasons for the event between the prologue and the first frame; there is none without any.
    pub handover: Vec<DumpReason>,
    /// Encoders that run every frame.
    pub frame: Vec<DumpEncoder>,
    /// Sums over the prologue.
    pub prologue_totals: EncoderTotals,
    /// Sums over a frame.
    pub frame_totals: EncoderTotals,
    /// Sums over a frame where each pass has its own encoder, as it must to have its own time.
    pub timed_totals: EncoderTotals,
}

/// Commands of one kind that are encoded together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpEncoder {
    /// `compute`, `render` or `blit`.
    pub kind: String,
    /// Fences that it waits for at its beginning.
    pub waits: Vec<DumpWait>,
    /// Its passes, in order.
    pub passes: Vec<EncodedPass>,
    /// Fences that it updates at its end.
    pub updates: Vec<DumpUpdate>,
}

/// A fence that an encoder waits for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpWait {
    /// Number of the fence.
    pub fence: u32,
    /// The stage of draws that waits: `vertex` (and so all) or `fragment`.
    pub stage: Option<String>,
    /// The conflicts behind it.
    pub reasons: Vec<DumpReason>,
}

/// A fence that an encoder updates.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpUpdate {
    /// Number of the fence.
    pub fence: u32,
    /// The stage of draws after which it is updated: `vertex` or `fragment` (and so all).
    pub stage: Option<String>,
}

/// A pass in an encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncodedPass {
    /// Name of the pass.
    pub pass: String,
    /// The barrier before it.
    pub barrier: Option<EncoderBarrier>,
}

/// A barrier within an encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncoderBarrier {
    /// The kinds of resources that it is for: `buffers`, `textures`.
    pub scope: Vec<String>,
    /// The conflicts behind it.
    pub reasons: Vec<DumpReason>,
}

/// One reason for a wait, a barrier or an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpReason {
    /// Kind of conflict.
    pub hazard: Hazard,
    /// The pass that waits.
    pub before: Declared,
    /// The resource that it accesses.
    pub resource: Declared,
    /// The passes that are waited for.
    pub after: Vec<Declared>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they accessed, if it is another one in the same memory.
    pub alias: Option<Declared>,
}

/// Counts what orders the passes of a part of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EncoderTotals {
    /// Number of encoders.
    pub encoders: usize,
    /// Number of different fences.
    pub fences: usize,
    /// Number of waits for fences.
    pub waits: usize,
    /// Number of updates of fences.
    pub updates: usize,
    /// Number of barriers within encoders.
    pub barriers: usize,
}

/// Writes the encoders of a dump, with their reasons, beside the plan's own barriers, which are Vulkan's.
///
/// Returns `None` if it has no encoders.
pub fn encoders_text(dump: &Dump) -> Option<String> {
    let encoders = dump.encoders.as_ref()?;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, dump, encoders);
    Some(out)
}

/// Columns of the passes and of the encoders.
const COLUMNS: (usize, usize) = (26, 44);

fn row(out: &mut String, pass: &str, encoder: &str, plan: &str) -> fmt::Result {
    let (first, second) = COLUMNS;
    writeln!(out, "{}", format!("{pass:first$} {encoder:second$} {plan}").trim_end())
}

fn write_all(out: &mut String, dump: &Dump, encoders: &DumpEncoders) -> fmt::Result {
    writeln!(out, "{}: {}\n", dump.graph, dump.summary)?;
    row(out, "", "Metal", "Vulkan")?;
    let mut reasons = String::new();
    if !encoders.prologue.is_empty() {
        write_encoders(out, &mut reasons, dump, Run::Once, &encoders.prologue)?;
        let event = if encoders.handover.is_empty() { "" } else { "event: all that follows waits for all" };
        writeln!(out)?;
        row(out, "handover", event, &plan_barriers(&dump.handover))?;
        write_reasons(&mut reasons, "handover", "event", &encoders.handover)?;
    }
    write_encoders(out, &mut reasons, dump, Run::Frame, &encoders.frame)?;
    write!(out, "\nreasons\n{reasons}\n")?;
    write_counts(out, dump, encoders)
}

fn write_encoders(
    out: &mut String,
    reasons: &mut String,
    dump: &Dump,
    run: Run,
    encoders: &[DumpEncoder],
) -> fmt::Result {
    let title = if run == Run::Once { "once" } else { "every frame" };
    writeln!(out, "\n{title}")?;
    let mut encoded: Vec<&str> = Vec::new();
    for (index, encoder) in encoders.iter().enumerate() {
        let heading = format!("encoder {} ({})", index + 1, encoder.kind);
        row(out, "", &heading, "")?;
        for DumpWait { fence, stage, reasons: of } in &encoder.waits {
            let before = stage.as_ref().map_or(String::new(), |stage| format!(" before {stage} stage"));
            row(out, "", &format!("  wait for fence {fence}{before}"), "")?;
            write_reasons(reasons, title, &format!("encoder {}, fence {fence}{before}", index + 1), of)?;
        }
        for EncodedPass { pass, barrier } in &encoder.passes {
            encoded.push(pass);
            let own =
                barrier.as_ref().map_or(String::new(), |b| format!("  barrier: {}", b.scope.join(", ")));
            row(
                out,
                pass,
                &own,
                &dump.pass(pass).map_or(String::new(), |pass| plan_barriers(&pass.barriers)),
            )?;
            if let Some(barrier) = barrier {
                write_reasons(reasons, title, &format!("barrier before {pass}"), &barrier.reasons)?;
            }
        }
        for DumpUpdate { fence, stage } in &encoder.updates {
            let after = stage.as_ref().map_or(String::new(), |stage| format!(" after {stage} stage"));
            row(out, "", &format!("  update fence {fence}{after}"), "")?;
        }
    }
    let others = |pass: &&DumpPass| pass.run == run && !encoded.contains(&pass.name.as_str());
    dump.passes.iter().filter(others).try_for_each(|pass| {
        row(out, &pass.name, "(completion of the command buffer)", &plan_barriers(&pass.barriers))
    })
}

/// `barriers 28 on all memory, 29 on image color`, of one call.
fn plan_barriers(barriers: &[DumpBarrier]) -> String {
    let one = |barrier: &DumpBarrier| match &barrier.image {
        Some(change) => format!("{} on image {}", barrier.id, change.image),
        None => format!("{} on all memory", barrier.id),
    };
    let all: Vec<String> = barriers.iter().map(one).collect();
    match all.len() {
        0 => String::new(),
        1 => format!("barrier {}", all[0]),
        _ => format!("barriers {}", all.join(", ")),
    }
}

fn write_reasons(out: &mut String, title: &str, what: &str, reasons: &[DumpReason]) -> fmt::Result {
    if reasons.is_empty() {
        return Ok(());
    }
    let title = if title == "handover" { String::new() } else { format!("{title}, ") };
    writeln!(out, "  {title}{what}")?;
    for reason in reasons {
        let mut line = format!("{} on {}", hazard_words(reason.hazard), reason.resource.name);
        if let Some(alias) = &reason.alias {
            line += &format!(" in the memory of {}", alias.name);
        }
        let after: Vec<&str> = reason.after.iter().map(|place| place.name.as_str()).collect();
        let frame = if reason.previous_frame { " of the frame before" } else { "" };
        writeln!(out, "      {line}, after {}{frame}, for {}", after.join(", "), reason.before.name)?;
    }
    Ok(())
}

fn write_counts(out: &mut String, dump: &Dump, encoders: &DumpEncoders) -> fmt::Result {
    let totals = &dump.totals;
    let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let metal = |of: &EncoderTotals| {
        let EncoderTotals { encoders, fences, waits, barriers, .. } = *of;
        [(encoders, "encoder"), (fences, "fence"), (waits, "wait"), (barriers, "barrier")]
            .map(|(n, what)| count(n, what))
            .join(", ")
    };
    let vulkan = |of: &BarrierTotals| {
        let memory = count(of.memory_barriers, "barrier");
        format!("{} ({memory} on memory, {} on images)", count(of.calls, "call"), of.image_barriers)
    };
    writeln!(out, "counts")?;
    row(out, "once", &metal(&encoders.prologue_totals), &vulkan(&totals.prologue))?;
    let events = if encoders.handover.is_empty() { "no event" } else { "1 event" };
    row(out, "handover", events, &vulkan(&totals.handover))?;
    row(out, "every frame", &metal(&encoders.frame_totals), &vulkan(&totals.frame))?;
    row(out, "every frame, passes timed", &metal(&encoders.timed_totals), &vulkan(&totals.frame))
}
