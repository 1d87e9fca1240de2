//! Formats a dump as text, for a terminal or a test.

use indexmap::{IndexMap, IndexSet};
use std::fmt::{self, Write};

use super::form::{BarrierTotals, Declared, Dump, DumpBarrier, DumpCause, DumpPass, DumpResource, Lifetime};
use crate::ir::{Hazard, Run, Stat, bytes};
use crate::plan::{Cause, Dependency, Since};

/// Formats a dump, except its encoders. The text has sections such as the resources, the passes in execution order with
/// their barriers, and the culled passes.
pub fn text(dump: &Dump) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, dump);
    out
}

fn write_text(out: &mut String, dump: &Dump) -> fmt::Result {
    writeln!(out, "{}: {}", dump.graph, dump.summary)?;
    if !dump.based_on.is_empty() {
        writeln!(out, "based on {}", dump.based_on.join(", "))?;
    }
    dump.fallbacks.iter().try_for_each(|fallback| writeln!(out, "{fallback}"))?;
    let parameters: Vec<String> = dump.parameters.iter().map(|p| format!("{}={}", p.name, p.value)).collect();
    writeln!(out, "parameters: {}", parameters.join(" "))?;
    for p in &dump.parameters {
        let Some(reason) = &p.reason else { continue };
        writeln!(out, "parameter {}={}, because {reason} ({})", p.name, p.value, reason.expression)?;
    }
    for Stat { name, grows, .. } in &dump.stats {
        for parameter in grows {
            writeln!(out, "parameter {parameter} grows with stat {name}")?;
        }
    }
    for p in &dump.parameters {
        let Some(why) = &p.no_effect else { continue };
        writeln!(out, "parameter {} has no effect: {why}", p.name)?;
    }
    let totals = &dump.totals;
    // There are no counts before a backend has added its barriers.
    let barriers = match dump.barriers().next() {
        Some(_) => format!("; {}", barrier_counts(&totals.frame)),
        None => String::new(),
    };
    writeln!(
        out,
        "{} once, {} every frame{}",
        counted(totals.prologue_passes, "pass", "passes"),
        totals.frame_passes,
        barriers
    )?;
    let freed = match totals.freed_bytes {
        0 => String::new(),
        freed => format!("; {} of these are freed after the prologue", bytes(freed)),
    };
    writeln!(
        out,
        "{} of its own ({} if nothing were shared), {} of the scene's{freed}",
        bytes(totals.transient_bytes),
        bytes(totals.unshared_bytes),
        bytes(totals.scene_bytes),
    )?;
    if let Some(ms) = dump.gpu_ms {
        let phases = dump.phases.iter().filter(|p| p.run == Run::Frame);
        let phases = phases.filter_map(|p| Some(format!("{} {:.3}", p.name, p.gpu_ms?)));
        let rest = dump.unattributed_ms().map(|rest| format!("unattributed {rest:.3}"));
        let parts: Vec<String> = phases.chain(rest).collect();
        writeln!(out, "{:.3} ms on the GPU: {}", dump.frame_ms.unwrap_or(ms), parts.join(", "))?;
    }
    if !dump.left_out.is_empty() {
        writeln!(out, "{}", left_out_counts(dump))?;
    }
    for warning in &dump.warnings {
        let origin = &warning.declared;
        writeln!(out, "warning: {} ({}:{})", warning.message, origin.file, origin.line)?;
        warning.help.iter().try_for_each(|help| writeln!(out, "  {help}"))?;
    }
    writeln!(out, "\nresources")?;
    dump.resources.iter().try_for_each(|r| write_resource(out, dump, r))?;
    let shared: Vec<_> = dump.blocks.iter().filter(|b| b.aliases.len() > 1).collect();
    if !shared.is_empty() {
        writeln!(out, "\nmemory that is shared")?;
        for block in shared {
            writeln!(
                out,
                "  block {:<3} {:>10}  {}",
                block.id,
                bytes(block.bytes),
                block.aliases.join(", ")
            )?;
        }
    }
    write_passes(out, dump, Run::Once, "once")?;
    if !dump.handover.is_empty() {
        writeln!(out, "\nbefore the first frame")?;
        dump.handover.iter().try_for_each(|b| write_barrier(out, b))?;
    }
    write_passes(out, dump, Run::Frame, "every frame")?;
    if !dump.left_out.is_empty() {
        writeln!(out, "\nleft out")?;
        for l in &dump.left_out {
            writeln!(out, "  {:<20} {} ({}:{})", l.pass, l.why, l.origin.file, l.origin.line)?;
        }
    }
    let shaders = dump.passes.iter().flat_map(|pass| &pass.shaders).filter(|shader| !shader.path.is_empty());
    let files: IndexSet<(&str, &str)> = shaders.map(|shader| (&*shader.file, &*shader.path)).collect();
    if !files.is_empty() {
        writeln!(out, "\nshaders")?;
        files.iter().try_for_each(|(file, path)| writeln!(out, "  {file:<24} {path}"))?;
    }
    writeln!(out, "\noutput: {}", dump.output)?;
    dump.outputs.iter().try_for_each(|(name, image)| writeln!(out, "output {name}: {image}"))?;
    dump.stats.iter().try_for_each(|s| writeln!(out, "stat {}: {}+{}", s.name, s.buffer, s.offset))
}

fn write_resource(out: &mut String, dump: &Dump, r: &DumpResource) -> fmt::Result {
    let size = bytes(r.bytes);
    let mut notes = r.usage.to_string();
    if let Some(block) = r.block {
        notes += &format!(", block {block}");
    }
    if let Some(Lifetime { first, last }) = r.lifetime {
        let name = |i: usize| dump.passes.get(i).map_or("?", |p| p.name.as_str());
        notes += &format!(", {} to {}", name(first), name(last));
    }
    if r.freed {
        notes += ", freed after the prologue";
    }
    if let Some(history) = &r.history {
        notes += &format!(", history {history}");
    }
    writeln!(out, "  {:<20} {size:>10}  {:<24} {:<10} {notes}", r.name, r.shape, r.source)
}

fn write_passes(out: &mut String, dump: &Dump, run: Run, title: &str) -> fmt::Result {
    let passes: Vec<&DumpPass> = dump.passes.iter().filter(|p| p.run == run).collect();
    if !passes.is_empty() {
        writeln!(out, "\n{title}")?;
    }
    passes.into_iter().try_for_each(|p| write_pass(out, p))
}

fn write_pass(out: &mut String, pass: &DumpPass) -> fmt::Result {
    pass.barriers.iter().try_for_each(|b| write_barrier(out, b))?;
    let mut words = vec![format!("[{}]", pass.phase), pass.kind.clone()];
    words.extend((!pass.shaders.is_empty()).then(|| shader_files(pass)));
    words.extend((!pass.size.is_empty()).then(|| pass.size.clone()));
    words.extend(pass.gpu_ms.map(|ms| format!("{ms:.3} ms")));
    writeln!(out, "  {:<24} {} ({}:{})", pass.name, words.join(" "), pass.declared.file, pass.declared.line)?;
    for (title, names) in [("reads ", pass.read_names()), ("writes", pass.written_names())] {
        if !names.is_empty() {
            writeln!(out, "      {title} {}", names.join(", "))?;
        }
    }
    if !pass.dependencies.is_empty() {
        writeln!(out, "      after  {}", comes_after(pass))?;
    }
    Ok(())
}

/// Formats the passes that a pass waits for: `project (visible, splats), draw and export of the previous frame (color
/// in the memory of depth)`.
pub(super) fn comes_after(pass: &DumpPass) -> String {
    let mut passes: IndexMap<(&str, Since), IndexSet<String>> = IndexMap::new();
    for dependency in &pass.dependencies {
        let earlier = (dependency.first.name.as_str(), dependency.since);
        passes.entry(earlier).or_default().insert(subject_of(dependency));
    }
    let mut groups: IndexMap<(Since, Vec<String>), Vec<&str>> = IndexMap::new();
    for ((name, since), resources) in passes {
        groups.entry((since, resources.into_iter().collect())).or_default().push(name);
    }
    let group = |((since, resources), names): (&(Since, Vec<String>), &Vec<&str>)| {
        let names = match names.split_last() {
            Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
            _ => names.join(", "),
        };
        format!("{names}{} ({})", when(*since), resources.join(", "))
    };
    groups.iter().map(group).collect::<Vec<_>>().join(", ")
}

fn when(since: Since) -> &'static str {
    match since {
        Since::Same => "",
        Since::Prologue => " of the prologue",
        Since::PreviousFrame => " of the previous frame",
    }
}

/// Formats the resource of a dependency: `color`, or `color in the memory of depth` for an alias.
fn subject_of(dependency: &Dependency<Declared, Declared>) -> String {
    let alias = dependency.alias.as_ref().map(|alias| format!(" in the memory of {}", alias.name));
    format!("{}{}", dependency.resource.name, alias.unwrap_or_default())
}

/// Formats a dependency: `write after read on color in the memory of depth, after compose of the previous frame:
/// COMPUTE STORAGE_READ -> ...`.
pub fn dependency_line(dependency: &Dependency<Declared, Declared>) -> String {
    let Dependency { hazard, first, since, masks, .. } = dependency;
    let (hazard, resource) = (hazard_words(*hazard), subject_of(dependency));
    format!("{hazard} on {resource}, after {}{}: {masks}", first.name, when(*since))
}

pub(super) fn shader_files(pass: &DumpPass) -> String {
    let files: Vec<&str> = pass.shaders.iter().map(|s| s.file.as_str()).collect();
    files.join(" + ")
}

fn write_barrier(out: &mut String, barrier: &DumpBarrier) -> fmt::Result {
    writeln!(out, "    | {}", barrier_line(barrier))?;
    barrier.dependencies.iter().try_for_each(|d| writeln!(out, "    |   {}", cause_line(barrier, d)))
}

/// Counts the culled passes and includes (at least one) by reason: `15 passes left out: 13 (nothing reads what it
/// writes), 2 (its condition is false)`. A single reason has no count of its own.
pub fn left_out_counts(dump: &Dump) -> String {
    let mut reasons: IndexMap<&str, usize> = IndexMap::new();
    for left_out in &dump.left_out {
        // Group by kind of reason: after the colon comes the condition itself.
        *reasons.entry(left_out.why.split(": ").next().unwrap_or_default()).or_default() += 1;
    }
    let alone = reasons.len() == 1;
    let reason = |(why, n): (&&str, &usize)| if alone { why.to_string() } else { format!("{n} ({why})") };
    let reasons: Vec<String> = reasons.iter().map(reason).collect();
    format!("{} left out: {}", counted(dump.left_out.len(), "pass", "passes"), reasons.join(", "))
}

/// Formats the counts: `14 barriers (12 on all memory, 2 on images) in 12 calls, for 20 reasons`.
pub(super) fn barrier_counts(t: &BarrierTotals) -> String {
    format!(
        "{} ({} on all memory, {} on images) in {}, for {}",
        counted(t.barriers, "barrier", "barriers"),
        t.memory_barriers,
        t.image_barriers,
        counted(t.calls, "call", "calls"),
        counted(t.dependencies, "reason", "reasons"),
    )
}

fn counted(count: usize, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}

/// Formats a barrier: `barrier 3 on all memory: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ`, or `barrier 9 on image
/// color, General -> ColorTarget: ...`.
pub fn barrier_line(b: &DumpBarrier) -> String {
    format!("barrier {} {}: {}", b.id, subject(b), b.masks)
}

/// Formats what a barrier applies to: `on all memory`, or `on image color, General -> ColorTarget`.
pub(super) fn subject(b: &DumpBarrier) -> String {
    match &b.image {
        Some(t) => format!("on image {}, {:?} -> {:?}", t.image, t.old, t.new),
        None => "on all memory".into(),
    }
}

/// Formats a reason: `read after write on keys#1, after sort.scatter[0]: COMPUTE STORAGE_WRITE -> ...`. Names the
/// waiting pass, unless it is the one right after the barrier.
pub fn cause_line(barrier: &DumpBarrier, cause: &DumpCause) -> String {
    let DumpCause { conflict, masks } = cause;
    let mut line = conflict_line(conflict);
    if barrier.before.as_ref().is_none_or(|before| before.name != conflict.before.name) {
        line += &format!(", for {}", conflict.before.name);
    }
    format!("{line}: {masks}")
}

/// Formats a conflict: `read after write on keys#1, after sort.scatter[0] of the previous frame`.
pub(super) fn conflict_line(conflict: &Cause<Declared, Declared>) -> String {
    let mut line = format!("{} on {}", hazard_words(conflict.hazard), conflict.resource.name);
    if let Some(alias) = &conflict.alias {
        line += &format!(" in the memory of {}", alias.name);
    }
    if !conflict.after.is_empty() {
        let after: Vec<&str> = conflict.after.iter().map(|Declared { name, .. }| name.as_str()).collect();
        let frame = if conflict.previous_frame { " of the previous frame" } else { "" };
        line += &format!(", after {}{frame}", after.join(", "));
    }
    line
}

fn hazard_words(hazard: Hazard) -> &'static str {
    match hazard {
        Hazard::ReadAfterWrite => "read after write",
        Hazard::WriteAfterRead => "write after read",
        Hazard::WriteAfterWrite => "write after write",
        Hazard::LayoutChange => "layout change",
    }
}
