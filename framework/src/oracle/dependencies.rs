//! Checks a plan's dependencies and layout changes against the accesses of its passes.
//!
//! The check walks the prologue and three frames. It pairs each access to a memory cell with the accesses that
//! immediately precede it. A dependency must cover every pair, and every stage and access of a dependency must be
//! required by a pair.

use super::trace::{Access, Trace};
use crate::ir::{Accesses, Hazard, Layout, Masks, PassId, ResourceId, Stages};
use crate::plan::{Dependency, LayoutChange, Plan, Since};
use std::collections::HashSet;

/// Number of frames to walk: enough that a frame's predecessor has a predecessor.
const FRAMES: u32 = 3;

/// A mistake in a plan's dependencies or layout changes.
#[derive(Clone, Debug, PartialEq)]
pub enum Objection {
    /// Two accesses conflict, and no dependency covers them.
    Missing {
        /// The kind of conflict.
        hazard: Hazard,
        /// The earlier pass.
        first: PassId,
        /// The later pass.
        second: PassId,
        /// The resource that the later pass accesses.
        resource: ResourceId,
        /// The earlier stage and access.
        source: (Stages, Accesses),
        /// The later stage and access; empty for a layout change.
        target: (Stages, Accesses),
    },
    /// A dependency, or a part of one, without a conflict.
    Needless {
        /// Index of the dependency in [`Plan::dependencies`].
        dependency: usize,
        /// The needless part: `the whole`, `the layout change`, or a side with a stage or an access, such as
        /// `target VERTEX`.
        what: String,
    },
    /// An image is not in the layout that a pass needs, or that a layout change assumes.
    Layout {
        /// Pass that accesses the image.
        pass: PassId,
        /// Image with the wrong layout.
        image: ResourceId,
        /// The layout that the image is in.
        found: Layout,
        /// The layout that the pass, or the layout change before it, expects.
        needed: Layout,
    },
    /// A layout change does not change the layout.
    NeedlessChange(LayoutChange),
}

impl Objection {
    /// Describes the mistake in a sentence. `plan` is the checked plan.
    pub fn describe(&self, plan: &Plan) -> String {
        let pass = |id: &PassId| &plan.pass(*id).name;
        let image = |id: &ResourceId| &plan.resource(*id).name;
        let side = |(stages, accesses): &(Stages, Accesses)| format!("{accesses} at {stages}");
        match self {
            Objection::Missing { hazard, first, second, resource, source, target } => {
                let resource = image(resource);
                let target = match target.0.is_empty() {
                    true => "the layout change".to_string(),
                    false => side(target),
                };
                format!(
                    "no dependency of `{}` on `{}` orders {target} after {} of `{resource}` ({hazard:?})",
                    pass(second),
                    pass(first),
                    side(source),
                )
            }
            Objection::Needless { dependency, what } => {
                let Dependency { first, second, resource, hazard, .. } = &plan.dependencies[*dependency];
                let (first, second, resource) = (pass(first), pass(second), image(resource));
                format!(
                    "needless: {what} of the dependency of `{second}` on `{first}` for `{resource}` ({hazard:?})"
                )
            }
            Objection::Layout { pass: id, image: of, found, needed } => {
                format!("`{}` expects `{}` in the layout {needed:?}, found {found:?}", pass(id), image(of))
            }
            Objection::NeedlessChange(change) => {
                let (of, before) = (image(&change.image), pass(&change.before));
                format!("needless: the change of `{of}` to {:?} before `{before}`", change.new)
            }
        }
    }
}

/// A pass in the prologue (`None`) or in a frame.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Occurrence {
    frame: Option<u32>,
    pass: PassId,
}

enum Event<'a> {
    Pass(Occurrence, Vec<&'a Access>),
    Change,
}

/// Two accesses that need a dependency.
#[derive(Clone, Copy)]
struct Pair<'a> {
    first: Occurrence,
    source: &'a Access,
    second: Occurrence,
    resource: ResourceId,
    /// The later access; `None` for a layout change.
    target: Option<&'a Access>,
}

struct Check<'a> {
    plan: &'a Plan,
    trace: &'a Trace,
    /// Events so far, by cell.
    cells: Vec<Vec<Event<'a>>>,
    layouts: Vec<Layout>,
    /// For each dependency, the stages and accesses that were needed, and true if its layout change was needed.
    used: Vec<(Masks, bool)>,
    found: Vec<Objection>,
    seen: HashSet<String>,
}

/// Lists the mistakes in a plan's dependencies and layout changes: missing parts, needless parts, and wrong layouts.
pub fn dependencies(plan: &Plan) -> Vec<Objection> {
    let trace = Trace::new(plan, 1);
    let mut check = Check {
        plan,
        trace: &trace,
        cells: trace.cells.iter().map(|_| Vec::new()).collect(),
        layouts: vec![Layout::Undefined; plan.resources.len()],
        used: vec![Default::default(); plan.dependencies.len()],
        found: Vec::new(),
        seen: HashSet::new(),
    };
    for pass in &plan.prologue {
        check.pass(Occurrence { frame: None, pass: *pass });
    }
    for frame in 0..FRAMES {
        for (place, cells) in trace.resources.iter().map(|place| (place, place.cells(0))) {
            if place.per_frame() {
                check.cells[cells].iter_mut().for_each(Vec::clear);
            }
        }
        for pass in &plan.frame {
            check.pass(Occurrence { frame: Some(frame), pass: *pass });
        }
    }
    check.needless();
    check.found
}

impl<'a> Check<'a> {
    fn pass(&mut self, now: Occurrence) {
        let (plan, trace) = (self.plan, self.trace);
        let actions = trace.actions(now.pass);
        for access in &actions.accesses {
            for cell in access.cells(0) {
                self.look_back(cell, now, access.resource, Some(access));
            }
        }
        for change in plan.layout_changes.iter().filter(|change| change.before == now.pass) {
            if !change.handover || now.frame == Some(0) {
                self.change(change, now);
            }
        }
        for (image, needed) in &actions.layouts {
            self.expect(now.pass, *image, *needed);
        }
        for access in &actions.accesses {
            for cell in access.cells(0) {
                match self.cells[cell].last_mut() {
                    Some(Event::Pass(last, accesses)) if *last == now => accesses.push(access),
                    _ => self.cells[cell].push(Event::Pass(now, vec![access])),
                }
            }
            if access.writes() {
                self.spoil_layouts(access.resource);
            }
        }
    }

    /// Invalidates the layouts of images that alias a resource with new contents or a new layout.
    fn spoil_layouts(&mut self, changed: ResourceId) {
        for image in &self.trace.resource(changed).alias_images {
            self.layouts[image.index()] = Layout::Undefined;
        }
    }

    /// Demands a dependency on the preceding accesses. A read depends on the last write; a write, on the reads since
    /// the last write, or on that write if there are none. A layout change (without a `target`) counts as a write, and
    /// depends on nothing before the last change.
    fn look_back(&mut self, cell: usize, now: Occurrence, resource: ResourceId, target: Option<&'a Access>) {
        let (is_read, is_change) = (target.is_some_and(|access| !access.writes()), target.is_none());
        let mut pairs = Vec::new();
        let events = self.cells[cell].iter().rev();
        let events = events.take_while(|event| !is_change || matches!(event, Event::Pass(..)));
        let passes = events.filter_map(|event| match event {
            Event::Pass(first, accesses) => Some((*first, accesses)),
            Event::Change => None,
        });
        for (back, (first, accesses)) in passes.enumerate() {
            let wanted = accesses.iter().filter(|access| match access.writes() {
                true => is_read || back == 0,
                false => !is_read && is_apart(access, accesses),
            });
            pairs.extend(wanted.map(|source| Pair { first, source, second: now, resource, target }));
            if accesses.iter().any(|access| access.writes()) {
                break;
            }
        }
        pairs.into_iter().for_each(|pair| self.demand(pair));
    }

    fn change(&mut self, change: &LayoutChange, now: Occurrence) {
        let LayoutChange { image, old, new, .. } = *change;
        let found = self.layouts[image.index()];
        if old != Layout::Undefined {
            self.expect(now.pass, image, old);
        }
        if found == new && self.seen.insert(format!("{change:?}")) {
            self.found.push(Objection::NeedlessChange(*change));
        }
        self.layouts[image.index()] = new;
        self.spoil_layouts(image);
        for cell in self.trace.resource(image).cells(0) {
            self.look_back(cell, now, image, None);
            self.cells[cell].push(Event::Change);
        }
    }

    /// Marks the dependencies that order two accesses; adds an objection if there is none.
    fn demand(&mut self, pair: Pair) {
        let Pair { first, source, second, resource, target } = pair;
        let since = match (first.frame, second.frame) {
            (before, after) if before == after => Some(Since::Same),
            (None, Some(_)) => Some(Since::Prologue),
            (Some(before), Some(after)) if before + 1 == after => Some(Since::PreviousFrame),
            _ => None,
        };
        let alias = Some(source.resource).filter(|other| *other != resource);
        let from = self.plan.dependencies.partition_point(|dependency| dependency.second < second.pass);
        let of = self.plan.dependencies_of(second.pass);
        let mut known = false;
        for (dependency, used) in of.iter().zip(&mut self.used[from..]) {
            let after_read = dependency.hazard == Hazard::WriteAfterRead;
            let fits = match target {
                None => dependency.changes_layout,
                Some(target) => {
                    dependency.hazard != Hazard::LayoutChange
                        && after_read != source.writes()
                        && dependency.masks.target_stages.contains(target.stage)
                        && dependency.masks.target_accesses.contains(target.access)
                }
            };
            let same = (dependency.first, Some(dependency.since), dependency.resource, dependency.alias)
                == (first.pass, since, resource, alias)
                && dependency.masks.source_stages.contains(source.stage)
                && dependency.masks.source_accesses.contains(source.access);
            if !(fits && same) {
                continue;
            }
            known = true;
            used.0.source_stages |= source.stage;
            used.0.source_accesses |= source.access;
            match target {
                None => used.1 = true,
                Some(target) => {
                    used.0.target_stages |= target.stage;
                    used.0.target_accesses |= target.access;
                }
            }
        }
        if known {
            return;
        }
        let hazard = match target {
            None => Hazard::LayoutChange,
            Some(_) if !source.writes() => Hazard::WriteAfterRead,
            Some(target) if target.writes() => Hazard::WriteAfterWrite,
            Some(_) => Hazard::ReadAfterWrite,
        };
        let objection = Objection::Missing {
            hazard,
            first: first.pass,
            second: second.pass,
            resource,
            source: (source.stage, source.access),
            target: target.map_or_else(Default::default, |target| (target.stage, target.access)),
        };
        if self.seen.insert(format!("{since:?} {objection:?}")) {
            self.found.push(objection);
        }
    }

    fn expect(&mut self, pass: PassId, image: ResourceId, needed: Layout) {
        let found = std::mem::replace(&mut self.layouts[image.index()], needed);
        let objection = Objection::Layout { pass, image, found, needed };
        if found != needed && self.seen.insert(format!("{objection:?}")) {
            self.found.push(objection);
        }
    }

    /// Objects to dependencies, and parts of them, that no pair of accesses requires.
    fn needless(&mut self) {
        for (index, (dependency, (used, change))) in self.plan.dependencies.iter().zip(&self.used).enumerate()
        {
            let mut say = |what: &str, names: String| {
                let what = if names.is_empty() { what.to_string() } else { format!("{what} {names}") };
                self.found.push(Objection::Needless { dependency: index, what });
            };
            if used.source_stages.is_empty() {
                say("the whole", String::new());
                continue;
            }
            if dependency.changes_layout && !change {
                say("the layout change", String::new());
            }
            // The pair of a layout change has no target access, so the target masks are not checked.
            let change_alone = dependency.hazard == Hazard::LayoutChange;
            let Masks { source_stages, source_accesses, target_stages, target_accesses } =
                dependency.masks.without(*used);
            let sides =
                [("source", source_stages, source_accesses), ("target", target_stages, target_accesses)];
            for (side, stages, accesses) in sides.into_iter().take(if change_alone { 1 } else { 2 }) {
                stages.iter().for_each(|stage| say(side, stage.to_string()));
                accesses.iter().for_each(|access| say(side, access.to_string()));
            }
        }
    }
}

/// Returns true unless the pass of a read also writes at that stage. The dependency on that write then covers the read.
fn is_apart(read: &Access, accesses: &[&Access]) -> bool {
    !accesses.iter().any(|other| other.writes() && other.stage == read.stage)
}
