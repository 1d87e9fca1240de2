//! Formats the encoders that a backend (Metal's) added to a dump, next to its barriers.

use std::fmt::{self, Write};

use super::form::{
    BarrierTotals, Declared, Dump, DumpBarrier, DumpEncoder, DumpEncoders, DumpPass, DumpUpdate, DumpWait,
    EncodedPass, EncoderTotals,
};
use super::text::conflict_line;
use crate::ir::Run;
use crate::plan::Cause;

/// Formats a dump's encoders with their reasons, next to its barriers, which are Vulkan's; `None` without encoders.
pub fn encoders_text(dump: &Dump) -> Option<String> {
    let encoders = dump.encoders.as_ref()?;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, dump, encoders);
    Some(out)
}

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
        let event = if encoders.handover.is_empty() { "" } else { "event: all later work waits for earlier" };
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

/// Formats the barriers of one call: `barriers 28 on all memory, 29 on image color`. Empty if there are none.
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

fn write_reasons(
    out: &mut String,
    title: &str,
    what: &str,
    reasons: &[Cause<Declared, Declared>],
) -> fmt::Result {
    if reasons.is_empty() {
        return Ok(());
    }
    let title = if title == "handover" { String::new() } else { format!("{title}, ") };
    writeln!(out, "  {title}{what}")?;
    reasons
        .iter()
        .try_for_each(|reason| writeln!(out, "      {}, for {}", conflict_line(reason), reason.before.name))
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
