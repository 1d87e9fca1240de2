//! Formats a comparison as text. Equal differences in many iterations of a repeat are listed once.

use indexmap::{IndexMap, IndexSet};
use std::fmt::{self, Write};

use super::diff::{Diff, NamedChange, PropertyChange, TotalChange};
use super::form::DumpBarrier;
use super::repeats::single_index;
use super::text::{cause_line, subject};
use crate::ir::bytes;

/// Maximum number of listed values of a property.
const MAX_VALUES: usize = 4;

/// Formats a comparison of two dumps as text.
pub fn diff_text(diff: &Diff) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_diff(&mut out, diff);
    out
}

fn write_diff(out: &mut String, diff: &Diff) -> fmt::Result {
    writeln!(out, "a: {}: {}", diff.a.graph, diff.a.summary)?;
    writeln!(out, "b: {}: {}", diff.b.graph, diff.b.summary)?;
    for (title, changes) in [
        ("parameters", &diff.parameters),
        ("facts", &diff.facts),
        ("statistics", &diff.stats),
        ("outputs", &diff.outputs),
    ] {
        if !changes.is_empty() {
            writeln!(out, "\n{title}")?;
        }
        for change in changes {
            writeln!(out, "  {:<20} {}", change.name, arrow(change))?;
        }
    }
    writeln!(out, "\n{:<30}{:>14}{:>14}{:>14}", "totals", "a", "b", "b - a")?;
    diff.totals.iter().try_for_each(|total| write_total(out, total))?;

    writeln!(out, "\npasses ({} the same)", diff.passes.same)?;
    write_only(out, "a", &diff.passes.only_a)?;
    write_only(out, "b", &diff.passes.only_b)?;
    write_changed(out, &diff.passes.changed)?;

    writeln!(out, "\nbarriers ({} the same)", diff.barriers.same)?;
    write_barriers(out, "a", &diff.barriers.only_a)?;
    write_barriers(out, "b", &diff.barriers.only_b)?;
    for change in &diff.barriers.changed {
        writeln!(out, "  {}", place(&change.a))?;
        let (a, b) = (lines(&change.a), lines(&change.b));
        for line in a.iter().filter(|line| !b.contains(line)) {
            writeln!(out, "    - {line}")?;
        }
        for line in b.iter().filter(|line| !a.contains(line)) {
            writeln!(out, "    + {line}")?;
        }
    }

    writeln!(out, "\nresources ({} the same)", diff.resources.same)?;
    for (side, only) in [("a", &diff.resources.only_a), ("b", &diff.resources.only_b)] {
        for r in only {
            writeln!(out, "  {:<20} only in {side}: {}, {}", r.name, r.shape, bytes(r.bytes))?;
        }
    }
    write_changed(out, &diff.resources.changed)
}

fn write_total(out: &mut String, total: &TotalChange) -> fmt::Result {
    let is_bytes = total.name.ends_with("bytes");
    let text = |n: u64| if is_bytes { bytes(n) } else { n.to_string() };
    let sign = if total.change < 0 { "-" } else { "+" };
    let change =
        if total.change == 0 { "0".into() } else { sign.to_owned() + &text(total.change.unsigned_abs()) };
    writeln!(out, "  {:<28}{:>14}{:>14}{change:>14}", total.name, text(total.a), text(total.b))
}

fn write_only(out: &mut String, side: &str, names: &[String]) -> fmt::Result {
    if names.is_empty() {
        return Ok(());
    }
    let count = names.len();
    writeln!(out, "  only in {side} ({count}): {}", ranges(names).join(", "))
}

/// Writes changed passes or resources, with one entry for all iterations that differ in the same properties.
fn write_changed(out: &mut String, changed: &[NamedChange]) -> fmt::Result {
    let mut lines: IndexMap<(String, Vec<&str>), Vec<&NamedChange>> = IndexMap::new();
    for change in changed {
        let member = single_index(&change.name).map_or(change.name.clone(), |(member, _)| member);
        let fields = change.changes.iter().map(|c| c.name.as_str()).collect();
        lines.entry((member, fields)).or_default().push(change);
    }
    for ((_, fields), changes) in lines {
        let names: Vec<String> = changes.iter().map(|c| c.name.clone()).collect();
        writeln!(out, "  {}", ranges(&names).join(", "))?;
        for (i, field) in fields.iter().enumerate() {
            let values: IndexSet<String> = changes.iter().map(|c| arrow(&c.changes[i])).collect();
            let mut values: Vec<String> = values.into_iter().collect();
            if values.len() > MAX_VALUES {
                values.truncate(MAX_VALUES);
                values.push("...".into());
            }
            writeln!(out, "    {field}: {}", values.join(", "))?;
        }
    }
    Ok(())
}

/// Lists barriers of one side. Barriers that differ only in iteration indices are one entry.
fn write_barriers(out: &mut String, side: &str, barriers: &[DumpBarrier]) -> fmt::Result {
    let mut entries: IndexMap<Vec<String>, Vec<&DumpBarrier>> = IndexMap::new();
    for barrier in barriers {
        let key = [place(barrier)].iter().chain(&lines(barrier)).map(|line| without_indices(line)).collect();
        entries.entry(key).or_default().push(barrier);
    }
    for (_, same) in entries {
        let names: Vec<String> =
            same.iter().filter_map(|b| b.before.as_ref()).map(|place| place.name.clone()).collect();
        let before = if names.is_empty() { "the first frame".into() } else { ranges(&names).join(", ") };
        writeln!(out, "  only in {side}: before {before}, {}", subject(same[0]))?;
        let what = if same.len() > 1 { " (the first of them)" } else { "" };
        for (i, line) in lines(same[0]).iter().enumerate() {
            writeln!(out, "    {line}{}", if i == 0 { what } else { "" })?;
        }
    }
    Ok(())
}

/// Formats a barrier's place: `before sort.scan[0], on all memory`, or `before the first frame, ...`.
fn place(barrier: &DumpBarrier) -> String {
    let before = barrier.before.as_ref().map_or("the first frame", |place| &place.name);
    format!("before {before}, {}", subject(barrier))
}

fn lines(barrier: &DumpBarrier) -> Vec<String> {
    let masks = barrier.masks.to_string();
    std::iter::once(masks).chain(barrier.dependencies.iter().map(|d| cause_line(barrier, d))).collect()
}

fn arrow(change: &PropertyChange) -> String {
    let text = |value: &Option<String>| match value.as_deref() {
        None => "none".to_owned(),
        Some("") => "nothing".into(),
        Some(value) => value.into(),
    };
    format!("{} -> {}", text(&change.a), text(&change.b))
}

/// Removes the iteration indices: `sort.scan[3]` becomes `sort.scan[]`.
fn without_indices(line: &str) -> String {
    let mut out = String::new();
    let mut inside = false;
    for c in line.chars() {
        inside = inside && c != ']';
        if !inside {
            out.push(c);
        }
        inside = inside || c == '[';
    }
    out
}

/// Lists names, with consecutive indices merged: `sort.scan[0..3]`. Names with several indices are not merged.
fn ranges(names: &[String]) -> Vec<String> {
    // For each run: the name with an empty index, and the first and last index so far.
    let mut runs: Vec<(String, u32, u32)> = Vec::new();
    let mut out: Vec<Option<String>> = Vec::new();
    for name in names {
        let Some((pattern, index)) = single_index(name) else {
            out.push(Some(name.clone()));
            continue;
        };
        match runs.iter_mut().find(|(p, _, last)| *p == pattern && *last + 1 == index) {
            Some((_, _, last)) => *last = index,
            None => {
                runs.push((pattern, index, index));
                out.push(None);
            }
        }
    }
    let mut runs = runs.into_iter().map(|(pattern, first, last)| {
        let index = if first == last { format!("[{first}]") } else { format!("[{first}..{last}]") };
        pattern.replacen("[]", &index, 1)
    });
    out.into_iter().filter_map(|name| name.or_else(|| runs.next())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_that_follow_each_other_are_a_range() {
        let names = ["a[0]", "b.c[0]", "a[1]", "clear", "b.c[1]", "a[2]", "a[4]", "n[0][1]"];
        let names: Vec<String> = names.map(String::from).to_vec();
        assert_eq!(ranges(&names), ["a[0..2]", "b.c[0..1]", "clear", "a[4]", "n[0][1]"]);
    }
}
