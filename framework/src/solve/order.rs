//! Orders passes by the resources that they read and write.
//!
//! If one pass writes a resource, it runs before the readers, wherever they are in the file. If several passes write a
//! resource, all its users keep the order of the file. `Once` passes precede all others. The result is a directed
//! graph; a cycle is an error that names its passes.

use petgraph::Direction;
use petgraph::algo::kosaraju_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::EdgeRef;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use crate::ir::{Accesses, Culled, Format, ResourceId, Run, Shape, Source, Work};
use crate::link::LinkedPass;
use crate::lower::{Lowered, LoweredPass, RemovedUse};
use crate::source::Diagnostic;

/// The order of the passes: `once` and `frame` are indices into the list of passes, in execution order.
pub(super) struct Order {
    pub once: Vec<usize>,
    pub frame: Vec<usize>,
    pub culled: Vec<Culled>,
    /// One flag per pass: true if it is in the plan.
    pub live: Vec<bool>,
    /// Passes that read and write a resource whose contents are undefined before them, with the resource.
    pub unwritten: Vec<(usize, ResourceId)>,
}

/// A graph of passes; each edge has the resource that orders its passes.
type Needs = DiGraph<usize, ResourceId>;

/// Orders the passes, and finds those that the results need. The last passes of the list, the export and the host
/// pass, are the roots of this search. Fails on reads that nothing can satisfy, and on cycles.
pub(super) fn order(passes: &[LinkedPass], lowered: &Lowered) -> Result<Order, Vec<Diagnostic>> {
    let mut errors = Vec::new();
    let users = users(passes, lowered.plan.resources.len());
    let mut unwritten = Vec::new();
    let needs = needs(passes, lowered, &users, &mut errors, &mut unwritten);
    if !errors.is_empty() {
        // Each iteration of a repeat makes the same mistake at the same place: report only the first.
        let mut told = HashMap::new();
        errors.retain(|(pass, error)| {
            *told.entry((error.primary.clone(), error.secondary.clone())).or_insert(*pass) == *pass
        });
        return Err(errors.into_iter().map(|(_, error)| error).collect());
    }
    if let Some(cycle) = cycle(&needs) {
        return Err(vec![describe_cycle(&cycle, &needs, passes, lowered)]);
    }

    let live = live(passes, &users, lowered);
    let culled = (0..passes.len())
        .filter(|i| !live[*i])
        .map(|i| Culled {
            pass: passes[i].pass.name.clone(),
            why: Culled::UNREAD.into(),
            origin: passes[i].pass.origin.clone(),
        })
        .collect();

    // Culled passes take part in the sort: they still separate the passes before and after them.
    let sorted = sort(&needs, passes).into_iter().filter(|i| live[*i]);
    let (once, frame) = sorted.partition(|i| passes[*i].pass.run == Run::Once);
    Ok(Order { once, frame, culled, live, unwritten })
}

#[derive(Clone, Copy)]
struct User {
    pass: usize,
    accesses: Accesses,
}

/// Lists the users of each resource: `Once` passes first, then the frame's, in file order.
fn users(passes: &[LinkedPass], resources: usize) -> Vec<Vec<User>> {
    let mut users: Vec<Vec<User>> = vec![Vec::new(); resources];
    let of_run = |run| (0..passes.len()).filter(move |i| passes[*i].pass.run == run);
    for pass in of_run(Run::Once).chain(of_run(Run::Frame)) {
        for touch in &passes[pass].pass.uses {
            let users = &mut users[touch.resource.index()];
            match users.last_mut().filter(|user| user.pass == pass) {
                Some(user) => user.accesses |= touch.accesses,
                None => users.push(User { pass, accesses: touch.accesses }),
            }
        }
    }
    users
}

/// Returns the edges, from earlier to later passes.
///
/// Adds to `errors` the reads that nothing can satisfy, with the index of the reading pass; to `unwritten`, the passes
/// that modify undefined contents.
fn needs(
    passes: &[LinkedPass],
    lowered: &Lowered,
    users: &[Vec<User>],
    errors: &mut Vec<(usize, Diagnostic)>,
    unwritten: &mut Vec<(usize, ResourceId)>,
) -> Needs {
    let mut graph = Needs::with_capacity(passes.len(), passes.len() * 4);
    for i in 0..passes.len() {
        graph.add_node(i);
    }
    for (resource, users) in users.iter().enumerate() {
        let id = ResourceId(resource as u32);
        let written = matches!(lowered.plan.resources[resource].source, Source::Transient | Source::Readback);
        if !written || lowered.declaration(id).previous_frame_of.is_some() {
            continue;
        }
        let writers: Vec<usize> = users.iter().filter(|u| u.accesses.writes()).map(|u| u.pass).collect();
        let mut edge = |from: usize, to: usize| {
            graph.add_edge(NodeIndex::new(from), NodeIndex::new(to), id);
        };
        let writes_once = writers.iter().any(|w| passes[*w].pass.run == Run::Once);
        if let Some(writer) = writers.iter().find(|w| passes[**w].pass.run == Run::Frame) {
            for early in users.iter().filter(|u| !writes_once && passes[u.pass].pass.run == Run::Once) {
                let error = Diagnostic::new(
                    format!("`{}` runs once, before any frame", passes[early.pass].pass.name),
                    passes[early.pass].span,
                    format!("reads `{}`", lowered.plan.resources[resource].name),
                )
                .with_label(passes[*writer].span, "which is written here, in every frame");
                errors.push((early.pass, error));
            }
        }
        let history = lowered.plan.resources[resource].history.is_some();
        if let [writer] = writers[..] {
            for user in users {
                if user.pass != writer {
                    edge(writer, user.pass);
                } else if keeps_contents(user.accesses) && !history {
                    errors.push((writer, never_written(writer, id, &[], passes, lowered)));
                } else if user.accesses.reads() && !history {
                    unwritten.push((writer, id));
                }
            }
            continue;
        }
        // Every pass waits for the last write, and thus for all earlier writes.
        let mut written: Option<usize> = None;
        let mut read: Vec<usize> = Vec::new();
        for User { pass, accesses } in users {
            if accesses.reads() {
                // A shader that also writes may read only its own writes; a kept target is read first.
                let needs_contents = !accesses.writes() || keeps_contents(*accesses);
                // A history starts from zeros, and keeps data written by plans with other settings. It is still a
                // mistake if no pass of the graph ever writes it.
                let left_out = || lowered.unwritten.iter().any(|removed| removed.resource == id);
                let found = written.is_some() || history && (!writers.is_empty() || left_out());
                // A `Once` pass that reads data written only in frames was rejected above.
                let early = passes[*pass].pass.run == Run::Once && !writers.is_empty() && !writes_once;
                if !found && needs_contents && !early {
                    errors.push((*pass, never_written(*pass, id, &writers, passes, lowered)));
                } else if !found && !needs_contents {
                    unwritten.push((*pass, id));
                }
                written.iter().for_each(|w| edge(*w, *pass));
            }
            if accesses.writes() {
                read.drain(..).for_each(|r| edge(r, *pass));
                if !accesses.reads() {
                    written.iter().for_each(|w| edge(*w, *pass));
                }
                written = Some(*pass);
            } else {
                read.push(*pass);
            }
        }
    }
    // The previous frame's contents are read before this frame overwrites them. A `Once` pass reads zeros, before any
    // other pass of the prologue overwrites them.
    for (readers, declaration) in users.iter().zip(&lowered.declarations) {
        let Some(real) = declaration.previous_frame_of else { continue };
        if let (Some(reader), false) =
            (readers.first(), users[real.index()].iter().any(|u| u.accesses.writes()))
        {
            errors.push((reader.pass, never_written(reader.pass, real, &[], passes, lowered)));
        }
        let run = |user: &User| passes[user.pass].pass.run;
        for reader in readers {
            let later = |u: &&User| run(u) == Run::Frame || run(reader) == Run::Once;
            let writers = users[real.index()].iter().filter(|u| u.accesses.writes() && u.pass != reader.pass);
            for writer in writers.filter(later) {
                graph.add_edge(NodeIndex::new(reader.pass), NodeIndex::new(writer.pass), real);
            }
        }
    }
    graph
}

/// Returns true for an attachment that is read before it is written.
fn keeps_contents(accesses: Accesses) -> bool {
    [Accesses::COLOR_READ, Accesses::DEPTH_READ | Accesses::DEPTH_WRITE]
        .iter()
        .any(|kept| accesses.contains(*kept))
}

fn never_written(
    reader: usize,
    resource: ResourceId,
    writers: &[usize],
    passes: &[LinkedPass],
    lowered: &Lowered,
) -> Diagnostic {
    let name = &lowered.plan.resources[resource.index()].name;
    // The export copies all outputs and statistics: the error names the one and its place.
    let plan = &lowered.plan;
    let stats = plan.stats.iter().zip(&lowered.stat_spans).filter(|(stat, _)| stat.buffer == resource);
    let mut results = stats.map(|(stat, span)| (format!("the statistic `{}`", stat.name), *span));
    let outputs = plan.outputs.iter().zip(&lowered.more_output_spans);
    let mut outputs = outputs.filter(|(output, _)| output.image == resource && resource != plan.output);
    let output = || outputs.next().map(|(output, span)| (format!("the output `{}`", output.name), *span));
    let result = (passes[reader].pass.work == Work::Export).then(|| results.next().or_else(output)).flatten();
    let keeps_it = |pass: usize| {
        let mut uses = passes[pass].pass.uses.iter();
        uses.any(|u| u.resource == resource && keeps_contents(u.accesses))
    };
    let keeps = keeps_it(reader);
    // A pass that keeps a target also writes it, but cannot provide contents for another pass to keep.
    let first = writers.iter().find(|writer| !(keeps && keeps_it(**writer)));
    let (reader, span) =
        result.unwrap_or_else(|| (format!("`{}`", passes[reader].pass.name), passes[reader].span));
    // The reader is in a repeat, and a later iteration finds contents.
    let comes_again = first.is_some_and(|first| passes[*first..].iter().any(|pass| pass.span == span));
    let is_half = lowered.ping_pongs.iter().any(|halves| halves.contains(&resource));
    let (message, label) = match first {
        _ if keeps => (
            format!("{reader} keeps the contents of `{name}`, which nothing has written before"),
            "finds nothing to keep",
        ),
        None => (format!("{reader} reads `{name}`, which no pass writes"), "is never written"),
        Some(_) => (
            format!("{reader} reads `{name}` before any pass has written it"),
            if comes_again {
                "nothing is written when this first runs"
            } else {
                "is not written before this pass"
            },
        ),
    };
    let mut diagnostic = Diagnostic::new(message, span, label);
    if keeps {
        let is_depth =
            matches!(plan.resource(resource).shape, Shape::Image { format: Format::Depth32Float, .. });
        diagnostic = diagnostic.with_help(match is_depth {
            true => "`access: Write` clears it",
            false => "`load: Clear(0, 0, 0, 1)` starts from a colour",
        });
    }
    if let Some(first) = first {
        if passes[*first].span != span {
            diagnostic = diagnostic.with_label(passes[*first].span, "the first to write it");
        }
        diagnostic = diagnostic.with_help(match (comes_again, is_half) {
            (true, true) => {
                "write this half in a pass before the repeat, or exchange the halves that passes bind, or move the `Swap`"
            }
            (true, false) => "write it in a pass before the repeat",
            (false, _) => "if several passes write a resource, they keep the order of the file: move the reader down",
        });
    }
    let mut diagnostic = diagnostic.with_label(lowered.declaration(resource).span, "declared here");
    let is_unused = |pass: &&LoweredPass| {
        let linked = passes.iter().find(|linked| linked.pass.name == pass.pass.name);
        linked.is_some_and(|linked| linked.pass.uses.iter().all(|touch| touch.resource != resource))
    };
    let mut bound = lowered.passes.iter().filter(|_| writers.is_empty()).flat_map(|pass| {
        let binds = pass.bind.iter().filter(|bind| bind.resources.contains(&resource));
        binds.map(move |bind| (pass, bind))
    });
    let is_written = |half: &&ResourceId| {
        let mut uses = passes.iter().flat_map(|linked| &linked.pass.uses);
        uses.any(|touch| touch.resource == **half && touch.accesses.writes())
    };
    let mut halves = lowered.ping_pongs.iter().filter(|halves| halves.contains(&resource)).flatten();
    if let Some((pass, bind)) = bound.find(|(pass, _)| is_unused(pass)) {
        let text = format!("`{}` binds it, and its shader does not use it", pass.pass.name);
        diagnostic = diagnostic.with_label(bind.block_span, text);
    } else if writers.is_empty()
        && let Some(other) = halves.find(is_written)
    {
        diagnostic = diagnostic.with_help(format!(
            "passes write only the other half, `{}`: write this half, too, or add or remove a `Swap`",
            lowered.plan.resources[other.index()].name
        ));
    }
    let diagnostic = with_removed(diagnostic, resource, lowered);
    match lowered.offered.iter().find(|(image, _)| writers.is_empty() && *image == resource) {
        None => diagnostic,
        Some((_, output)) => diagnostic.with_help(format!(
            "`{output}` is an output of the included graph, which draws it only on request: give the pass \
             `when: \"outputs.{output}\"`, or draw it with another graph"
        )),
    }
}

/// Adds the conditions of the removed passes that would use `resource`.
fn with_removed(diagnostic: Diagnostic, resource: ResourceId, lowered: &Lowered) -> Diagnostic {
    let removed = lowered.unwritten.iter().filter(|removed| removed.resource == resource);
    removed.fold(diagnostic, |diagnostic, removed| {
        let RemovedUse { pass, value, .. } = removed;
        let text = format!("`{pass}` uses it, but is left out because this is {value}");
        diagnostic.with_label(removed.when, text)
    })
}

/// Returns one flag per pass: true if the export or the host pass depends on it, directly or indirectly.
fn live(passes: &[LinkedPass], users: &[Vec<User>], lowered: &Lowered) -> Vec<bool> {
    // For each resource, the writers whose data can reach a reader.
    let mut sources: Vec<Sources> = users.iter().map(|users| Sources::of(users, passes)).collect();
    for (sources, resource) in sources.iter_mut().zip(&lowered.plan.resources) {
        sources.carried |= resource.history.is_some();
    }
    let mut live = vec![false; passes.len()];
    let mut open: Vec<usize> =
        (0..passes.len()).filter(|i| matches!(passes[*i].pass.work, Work::Export | Work::Host)).collect();
    while let Some(pass) = open.pop() {
        if std::mem::replace(&mut live[pass], true) {
            continue;
        }
        for touch in passes[pass].pass.uses.iter().filter(|t| t.accesses.reads()) {
            let (resource, last) = match lowered.declaration(touch.resource).previous_frame_of {
                Some(real) => (real.index(), true),
                None => (touch.resource.index(), false),
            };
            sources[resource].found_by(pass, last, &users[resource], passes, &mut open);
        }
    }
    live
}

/// The writers of one resource, with the state of the search.
struct Sources {
    /// Indices of the writers in the list of the resource's users, ascending.
    writers: Vec<usize>,
    /// True if contents persist to the next frame, until the search has followed them. They do if a `Once` pass wrote
    /// them, or if there is a history.
    carried: bool,
    /// One flag per writer: true once the search has visited it and the writers before it.
    followed: Vec<bool>,
}

impl Sources {
    fn of(users: &[User], passes: &[LinkedPass]) -> Sources {
        let writers: Vec<usize> = (0..users.len()).filter(|i| users[*i].accesses.writes()).collect();
        let carried = writers.iter().any(|w| passes[users[*w].pass].pass.run == Run::Once);
        let followed = vec![false; writers.len()];
        Sources { writers, carried, followed }
    }

    /// Adds to `open` the writers whose data `pass` reads, in this frame or, if `last`, in the previous one.
    fn found_by(
        &mut self,
        pass: usize,
        last: bool,
        users: &[User],
        passes: &[LinkedPass],
        open: &mut Vec<usize>,
    ) {
        let place = |pass: usize| (passes[pass].pass.run == Run::Frame, pass);
        let at = users.binary_search_by_key(&place(pass), |u| place(u.pass)).ok();
        let at = at.filter(|_| self.writers.len() > 1 && !last);
        let mut before = match at {
            Some(at) => self.writers.partition_point(|w| *w < at),
            // A single writer runs before all readers, wherever they are in the file. `last` reads what all writers
            // left.
            None => self.writers.len(),
        };
        // Every earlier write may contribute: two passes may fill two halves of a buffer.
        while before > 0 && !std::mem::replace(&mut self.followed[before - 1], true) {
            before -= 1;
            let writer = users[self.writers[before]];
            open.push(writer.pass);
            if writer.accesses.reads() {
                // This writer modifies earlier contents: the search continues from its own reads.
                break;
            }
        }
        if self.carried && (last || passes[pass].pass.run == Run::Frame) {
            // Contents left by the previous frame's passes, wherever they are in the file.
            let writers = self.writers.iter().map(|w| users[*w].pass);
            open.extend(writers.filter(|w| passes[*w].pass.run == Run::Frame));
            self.carried = false;
        }
    }
}

/// Sorts by Kahn's algorithm. Ties: `Once` passes first, then the order of the file.
fn sort(needs: &Needs, passes: &[LinkedPass]) -> Vec<usize> {
    let place = |i: usize| Reverse((passes[i].pass.run == Run::Frame, i));
    let mut waiting: Vec<usize> =
        needs.node_indices().map(|n| needs.edges_directed(n, Direction::Incoming).count()).collect();
    let mut ready: BinaryHeap<Reverse<(bool, usize)>> =
        (0..waiting.len()).filter(|i| waiting[*i] == 0).map(place).collect();
    let mut sorted = Vec::with_capacity(waiting.len());
    while let Some(Reverse((_, i))) = ready.pop() {
        sorted.push(i);
        for edge in needs.edges(NodeIndex::new(i)) {
            let next = edge.target().index();
            waiting[next] -= 1;
            if waiting[next] == 0 {
                ready.push(place(next));
            }
        }
    }
    sorted
}

/// Returns a cycle of passes, if any: each needs the previous one, and the first needs the last.
fn cycle(needs: &Needs) -> Option<Vec<NodeIndex>> {
    let component =
        kosaraju_scc(needs).into_iter().filter(|c| c.len() > 1).min_by_key(|c| c.iter().min().copied())?;
    // The shortest cycle through its first pass, inside the component.
    let start = *component.iter().min()?;
    let mut from = std::collections::BTreeMap::new();
    let mut queue = std::collections::VecDeque::from([start]);
    while let Some(node) = queue.pop_front() {
        for edge in needs.edges(node) {
            let next = edge.target();
            if next == start {
                let mut cycle = vec![node];
                while let Some(before) = from.get(cycle.last()?) {
                    cycle.push(*before);
                }
                cycle.reverse();
                return Some(cycle);
            }
            if component.contains(&next) && !from.contains_key(&next) {
                from.insert(next, node);
                queue.push_back(next);
            }
        }
    }
    None
}

fn describe_cycle(
    cycle: &[NodeIndex],
    needs: &Needs,
    passes: &[LinkedPass],
    lowered: &Lowered,
) -> Diagnostic {
    let name = |node: NodeIndex| format!("`{}`", passes[node.index()].pass.name);
    let all: Vec<String> = cycle.iter().map(|n| name(*n)).collect();
    let edge = |i: usize| {
        let (from, to) = (cycle[(i + cycle.len() - 1) % cycle.len()], cycle[i]);
        (from, to, needs.find_edge(from, to).map(|edge| needs[edge]))
    };
    let resource_name = |id: ResourceId| &lowered.plan.resources[id.index()].name;
    let reason = |i: usize| {
        let (from, to, resource) = edge(i);
        let resource = resource.map_or("?", |id| resource_name(id));
        format!("{} needs {} first, for `{resource}`", name(to), name(from))
    };
    let message = format!("these passes wait for each other: {}", all.join(", "));
    let mut diagnostic = Diagnostic::new(message, passes[cycle[0].index()].span, reason(0));
    for i in 1..cycle.len() {
        diagnostic = diagnostic.with_label(passes[cycle[i].index()].span, reason(i));
    }
    // A half that is read before its only writer: the ping-pong buffer has no contents at the start.
    let mut early = (0..cycle.len()).filter_map(|i| {
        let (writer, reader, half) = edge(i);
        let half = half.filter(|_| reader < writer)?;
        let halves = lowered.ping_pongs.iter().find(|halves| halves.contains(&half))?;
        let mut uses = passes[writer.index()].pass.uses.iter();
        uses.any(|u| u.resource == half && u.accesses.writes()).then_some((reader, half, halves))
    });
    let Some((reader, half, halves)) = early.next() else {
        return diagnostic.with_help(
            "a resource with one writer is written before it is read; use a second resource to break the cycle",
        );
    };
    let history = halves.iter().find_map(|half| lowered.plan.resources[half.index()].history.as_ref());
    let last = history.map_or_else(String::new, |name| format!(", or read `last({name})` there"));
    with_removed(diagnostic, half, lowered).with_help(format!(
        "no pass writes `{}` before {} reads it: write this half in an earlier pass{last}",
        resource_name(half),
        name(reader)
    ))
}
