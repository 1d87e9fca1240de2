//! Warns about constructs that are allowed but probably unintended.
//!
//! - A pass modifies a resource in place, but nothing wrote it before: its contents are undefined.
//! - Culled passes of an include write to a port whose resource is read outside. Either they write the half of a
//!   ping-pong buffer that no pass reads, or the reader comes first in the file. The reader gets the contents from
//!   before the include.
//! - A dispatch or a draw has a constant size of 0.
//! - The workgroups of a dispatch are folded into y, and its shader cannot tell the rows apart.
//! - The iterations of a repeat read the same half of a ping-pong buffer and write the other: a `Swap` is missing.
//! - A `Once` pass fills a ping-pong buffer, and each frame changes it in an odd number of steps: the next frame does
//!   not start with the result.

use super::order::Order;
use crate::ir::{Accesses, ResourceId, Shader, Span, Use};
use crate::link::LinkedPass;
use crate::lower::{Lowered, Unswapped};
use crate::plan::Warning;
use crate::source::{Diagnostic, SourceMap};
use std::collections::{HashMap, HashSet};

pub(super) fn warnings(
    passes: &[LinkedPass],
    order: &Order,
    lowered: &Lowered,
    files: &SourceMap,
) -> Vec<Warning> {
    let unwritten = order.unwritten.iter().filter(|(pass, resource)| {
        order.live[*pass] && !writes_first(&passes[*pass], *resource, &lowered.plan.shaders)
    });
    let mut found: Vec<Diagnostic> = Vec::new();
    let mut spans = HashSet::new();
    for (pass, resource) in unwritten {
        // Warn once for all iterations of a repeat.
        if spans.insert(passes[*pass].span) {
            found.push(first_touch(&passes[*pass], *resource, lowered));
        }
    }
    found.extend(idle_includes(passes, &order.live, lowered));
    found.extend(unswapped(passes, &order.live, lowered));
    found.extend(lost_steps(passes, order, lowered));
    found.extend(Diagnostic::distinct(lowered.sizes.clone()));
    let warning =
        |diagnostic: Diagnostic| Warning { origin: files.origin(diagnostic.primary.span), diagnostic };
    found.into_iter().map(warning).collect()
}

/// Returns true if the pass's shaders store to the resource before they load from it.
fn writes_first(pass: &LinkedPass, resource: ResourceId, shaders: &[Shader]) -> bool {
    let bound = |number: u32| {
        pass.pass.bindings.iter().any(|bound| bound.binding == number && bound.resource == resource)
    };
    let used = pass.pass.work.shaders().into_iter();
    let mut blocks = used
        .flat_map(|shader| &shaders[shader.index()].reflection.bindings)
        .filter(|block| bound(block.binding))
        .peekable();
    blocks.peek().is_some() && blocks.all(|block| block.writes_first)
}

/// Returns the warning for a pass that modifies undefined contents in place.
fn first_touch(pass: &LinkedPass, resource: ResourceId, lowered: &Lowered) -> Diagnostic {
    let declared = lowered.declaration(resource).span;
    let message = format!(
        "`{}` reads and writes `{}`, which nothing has written before it",
        pass.pass.name,
        lowered.plan.resource(resource).name
    );
    Diagnostic::new(message, pass.span, "finds undefined contents, unless its shader writes them first")
        .with_label(declared, "declared here")
        .with_help(
            "fill it in an earlier pass, or declare it with `history: true` to go on from the previous frame",
        )
}

/// Returns a warning for each repeat that seems to lack a `Swap` of a ping-pong buffer. In all iterations, a pass reads
/// the same half and writes the other, and one of these conditions holds: the iterations do the same work, nothing reads
/// what they write, or the graph never swaps the buffer.
///
/// Excludes iterations that each write a part of the other half, before a `Swap` below the repeat.
fn unswapped(passes: &[LinkedPass], live: &[bool], lowered: &Lowered) -> Vec<Diagnostic> {
    let mut found: Vec<Diagnostic> = Vec::new();
    for Unswapped { pair, front, back, swaps, passes: [first, second] } in &lowered.unswapped {
        // Passes in both directions, or in place, need no swap.
        let one_way = |pass: &LinkedPass| !accesses(pass, *front).writes() && !accesses(pass, *back).reads();
        let steps = |pass: &LinkedPass| accesses(pass, *front).reads() && accesses(pass, *back).writes();
        let in_place = |pass: &LinkedPass| {
            pass.pass
                .uses
                .iter()
                .any(|touch| touch.accesses.reads() && accesses(pass, touch.resource).writes())
        };
        let repeats = |number: usize| {
            let Some(again) = passes[second.clone()].get(number - first.start) else { return false };
            let [one, two] = [&passes[number].pass, &again.pass];
            let same = (&one.work, &one.bindings, &one.push) == (&two.work, &two.bindings, &two.push);
            same && !in_place(&passes[number])
        };
        let read = |touch: &Use| touch.accesses.reads() && lowered.real(touch.resource) == *back;
        let is_read = || passes.iter().any(|pass| pass.pass.uses.iter().any(read));
        let is_useless = lowered.swaps[*pair] == *swaps || !is_read();
        let mut both = first.start..second.end;
        let step = both.find(|pass| steps(&passes[*pass]) && (is_useless || !live[*pass] || repeats(*pass)));
        let Some(step) = step.filter(|_| passes[first.start..second.end].iter().all(one_way)) else {
            continue;
        };
        let span = passes[step].span;
        // Culled passes of includes are left to `idle_includes`.
        let told = passes[step].include.is_some() && !live[step];
        if told || found.iter().any(|other| other.primary.span == span) {
            continue;
        }
        let resource = &lowered.plan.resource(*back).name;
        let resource = resource.split('#').next().unwrap_or(resource);
        let message = format!("every iteration reads and writes the same halves of `{resource}`");
        found.push(
            Diagnostic::new(message, span, "no iteration gets the results of the one before")
                .with_label(lowered.declaration(*back).span, "declared here")
                .with_help("is a `Swap` missing at the end of the repeat, or written twice?"),
        );
    }
    found
}

/// Returns a warning for each ping-pong buffer whose last result in a frame is lost to the next frame. A `Once` pass
/// fills the buffer, iterations of one pass change it there and back in each frame, and the last iteration writes the
/// half that the frame did not start with.
///
/// Excludes the values of a sort. Its iterations also move keys, another ping-pong buffer, which each frame writes
/// anew, so any permutation of the values is as good a start.
fn lost_steps(passes: &[LinkedPass], order: &Order, lowered: &Lowered) -> Vec<Diagnostic> {
    let lost = |&[start, other]: &[ResourceId; 2]| {
        let name = lowered.plan.resource(start).name.trim_end_matches("#0");
        let made = order.once.iter().find(|pass| accesses(&passes[**pass], start).writes())?;
        let of_frame = || order.frame.iter().map(|pass| &passes[*pass]);
        let changes: Vec<&LinkedPass> = of_frame()
            .filter(|pass| [start, other].iter().any(|half| accesses(pass, *half).writes()))
            .collect();
        let (first, last) = (*changes.first()?, *changes.last()?);
        let back = |pass: &LinkedPass| accesses(pass, start).writes();
        let forth = |pass: &LinkedPass| accesses(pass, start).reads() && !back(pass);
        // A different last pass may show the state, and use the other half as memory.
        let is_lost = forth(first) && forth(last) && first.span == last.span;
        let are_keys = |keys: ResourceId| {
            let (iterations, others): (Vec<_>, Vec<_>) = of_frame()
                .filter(|pass| accesses(pass, keys).writes())
                .partition(|pass| pass.span == first.span);
            let are_new = others.iter().any(|pass| !accesses(pass, keys).reads());
            accesses(first, keys).reads() && !iterations.is_empty() && are_new
        };
        let pairs = lowered.ping_pongs.iter().filter(|pair| **pair != [start, other]);
        let sorts = pairs.flatten().any(|half| are_keys(*half));
        (is_lost && !sorts && changes.iter().any(|pass| back(pass))).then(|| {
            let message = format!("the next frame does not start with the result of `{}`", last.pass.name);
            Diagnostic::new(message, last.span, format!("writes the other half of `{name}`"))
                .with_label(passes[*made].span, "fills the half with which every frame starts")
                .with_help("make the number of swaps in a frame even, or copy the result to the other half")
        })
    };
    lowered.ping_pongs.iter().filter_map(lost).collect()
}

fn accesses(pass: &LinkedPass, resource: ResourceId) -> Accesses {
    let uses = pass.pass.uses.iter().filter(|touch| touch.resource == resource);
    uses.fold(Accesses::empty(), |all, touch| all | touch.accesses)
}

/// Returns a warning for each include in which culled passes write to a port, although a pass outside reads its
/// resource.
fn idle_includes(passes: &[LinkedPass], live: &[bool], lowered: &Lowered) -> Vec<Diagnostic> {
    // For each include, its culled passes, including those of nested includes.
    let mut idle: Vec<Vec<usize>> = vec![Vec::new(); lowered.includes.len()];
    // For each resource, the passes of the plan that read it.
    let mut readers: HashMap<ResourceId, Vec<usize>> = HashMap::new();
    for (number, pass) in passes.iter().enumerate() {
        if live[number] {
            let reads = pass.pass.uses.iter().filter(|touch| touch.accesses.reads());
            reads.for_each(|t| readers.entry(lowered.real(t.resource)).or_default().push(number));
        } else {
            includes_of(pass, lowered).for_each(|include| idle[include].push(number));
        }
    }
    let mut found = Vec::new();
    let mut told: HashSet<usize> = HashSet::new();
    for (number, include) in lowered.includes.iter().enumerate() {
        // For nested includes, report the outermost.
        if idle[number].is_empty() || idle[number].iter().all(|pass| told.contains(pass)) {
            continue;
        }
        let writes = |given: &[ResourceId]| {
            let uses = idle[number].iter().flat_map(|pass| &passes[*pass].pass.uses);
            uses.filter(|t| t.accesses.writes()).any(|t| given.contains(&lowered.real(t.resource)))
        };
        let outside = |pass: &&usize| includes_of(&passes[**pass], lowered).all(|include| include != number);
        let asked = include.given.iter().find_map(|(name, given)| {
            let reader = given.iter().flat_map(|id| readers.get(id).into_iter().flatten()).find(outside)?;
            writes(given).then_some((name, given, *reader))
        });
        let Some((name, given, reader)) = asked else { continue };
        told.extend(&idle[number]);
        let reader_span: Span = passes[reader].span;
        let count = match idle[number].len() {
            1 => "a pass is".to_string(),
            count => format!("{count} passes are"),
        };
        let diagnostic = Diagnostic::new(
            format!("{count} left out of the include `{}`: nothing reads the results", include.name),
            include.span,
            format!("`{name}` is given to it"),
        )
        .with_label(reader_span, format!("reads `{name}` anyway"));
        found.push(diagnostic.with_help(match given.len() {
            2 => "they write the half that is not read: is a `Swap` missing?",
            _ => "if several passes write a resource, they keep the order of the file: is the reader above them?",
        }));
    }
    found
}

/// Returns the include that a pass comes from, and the includes around it.
fn includes_of(pass: &LinkedPass, lowered: &Lowered) -> impl Iterator<Item = usize> {
    std::iter::successors(pass.include, |include| lowered.includes[*include].parent)
}
