//! The dump as text, to read in a terminal or to compare in a test.

use std::fmt::Write;

use super::{Dump, DumpBarrier, DumpPass};
use crate::plan::Run;

/// Bytes with a unit, three significant digits.
pub fn bytes(n: u64) -> String {
    match n {
        0..1024 => format!("{n} B"),
        1024..1_048_576 => format!("{:.1} KiB", n as f64 / 1024.0),
        1_048_576..1_073_741_824 => format!("{:.1} MiB", n as f64 / 1_048_576.0),
        _ => format!("{:.2} GiB", n as f64 / 1_073_741_824.0),
    }
}

/// The whole dump: resources, passes in order with their barriers, and what was left out.
pub fn text(dump: &Dump) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, dump);
    out
}

fn write_text(out: &mut String, dump: &Dump) -> std::fmt::Result {
    writeln!(out, "{}: {}", dump.graph, dump.summary)?;
    let parameters: Vec<String> = dump.parameters.iter().map(|(k, v)| format!("{k}={v}")).collect();
    writeln!(out, "parameters: {}", parameters.join(" "))?;
    let totals = &dump.totals;
    writeln!(
        out,
        "{} passes once, {} every frame; {} barriers in {} calls; {} of its own, {} of the scene's",
        totals.prologue_passes,
        totals.frame_passes,
        totals.frame_barriers,
        totals.frame_barrier_calls,
        bytes(totals.transient_bytes),
        bytes(totals.scene_bytes),
    )?;
    writeln!(out, "\nresources")?;
    for r in &dump.resources {
        writeln!(
            out,
            "  {:<20} {:>10}  {:<24} {:<10} {}",
            r.name,
            bytes(r.bytes),
            r.shape,
            r.source,
            r.usage
        )?;
    }
    for (run, title) in [(Run::Once, "once"), (Run::Frame, "every frame")] {
        if dump.passes.iter().any(|p| p.run == run) {
            writeln!(out, "\n{title}")?;
            dump.passes.iter().filter(|p| p.run == run).try_for_each(|p| write_pass(out, p))?;
        }
    }
    if !dump.left_out.is_empty() {
        writeln!(out, "\nleft out")?;
        for l in &dump.left_out {
            writeln!(out, "  {:<20} {} ({}:{})", l.pass, l.why, l.declared.file, l.declared.line)?;
        }
    }
    writeln!(out, "\noutput: {}", dump.output)?;
    for (name, place) in &dump.stats {
        writeln!(out, "stat {name}: {place}")?;
    }
    Ok(())
}

fn write_pass(out: &mut String, pass: &DumpPass) -> std::fmt::Result {
    for barrier in &pass.barriers {
        writeln!(out, "    | {}", barrier_line(barrier))?;
    }
    let shaders: Vec<&str> = pass.shaders.iter().map(|s| s.file.as_str()).collect();
    writeln!(
        out,
        "  {:<24} [{}] {} {} {} ({}:{})",
        pass.name,
        pass.phase,
        pass.kind,
        shaders.join(" + "),
        pass.size,
        pass.declared.file,
        pass.declared.line
    )?;
    if !pass.reads.is_empty() {
        writeln!(out, "      reads  {}", pass.reads.join(", "))?;
    }
    if !pass.writes.is_empty() {
        writeln!(out, "      writes {}", pass.writes.join(", "))?;
    }
    Ok(())
}

/// `read after write on keys#1, after sort.scatter[0]: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ`.
pub fn barrier_line(b: &DumpBarrier) -> String {
    let hazard = match b.hazard.as_str() {
        "ReadAfterWrite" => "read after write",
        "WriteAfterRead" => "write after read",
        "WriteAfterWrite" => "write after write",
        _ => "layout change",
    };
    let mut line = format!("{hazard} on {}", b.resource);
    if !b.after.is_empty() {
        let frame = if b.across_frames { " of the frame before" } else { "" };
        line += &format!(", after {}{frame}", b.after.join(", "));
    }
    let accesses = |stages: &str, accesses: &str| match accesses {
        "NONE" => stages.to_string(),
        _ => format!("{stages} {accesses}"),
    };
    line += &format!(
        ": {} -> {}",
        accesses(&b.source_stages, &b.source_accesses),
        accesses(&b.target_stages, &b.target_accesses)
    );
    if let Some((old, new)) = b.layouts {
        line += &format!(", {old:?} -> {new:?}");
    }
    line
}
