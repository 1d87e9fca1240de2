//! Records accesses to a few bytes, and applies barriers to the records.
//!
//! A [`Cell`] is a range of bytes that are always accessed together. It records the accesses that a later one can still
//! conflict with: the writes of the last pass that wrote, and the reads since then. Each record has the stages that are
//! ordered after it; a write also has the stages to which its data is visible. A barrier adds stages to these sets. A
//! later access conflicts with a record unless its stage is in them.
//!
//! Records that newer ones imply are dropped. A write that is properly ordered after an older access replaces that
//! access, because a chain that starts at the write extends one that starts at the access. In the same way, a read
//! replaces an older read at the same stage. (If it was not properly ordered, the violation is already reported.)

use super::rules::Rules;
use super::stages::{Pairs, with_earlier, with_later};
use super::violation::{Actor, Missing, ViolationKind, When};
use crate::sync::barrier::Barrier;
use splatgraph_framework::ir::{Accesses, Masks, ResourceId, Stages};
use splatgraph_framework::plan::Transition;

/// A barrier with its stage masks expanded.
pub struct Scope {
    pub image: Option<Transition>,
    /// Source stages that the mask names, which the memory dependency covers.
    ///
    /// `source_reach` adds all earlier stages, which chains start from.
    source: Stages,
    source_reach: Stages,
    source_accesses: Accesses,
    pub target_reach: Stages,
    pub target: Pairs,
}

impl Scope {
    pub fn new(barrier: &Barrier) -> Scope {
        let Masks { source_stages, source_accesses, target_stages, target_accesses } = barrier.masks;
        Scope {
            image: barrier.image,
            source: source_stages,
            source_reach: with_earlier(source_stages),
            source_accesses,
            target_reach: with_later(target_stages),
            target: Pairs::of(target_stages, target_accesses),
        }
    }

    /// Returns the barrier's layout transition; `None` if it has none or its two layouts are equal.
    pub fn transition(&self) -> Option<Transition> {
        self.image.filter(|image| image.old != image.new)
    }

    /// Returns true if an access is in the source scope, directly or by a chain.
    ///
    /// `named_by` are the stages that cover it in a source mask; `ordered` are the stages ordered after it.
    fn waits_for(&self, named_by: Stages, ordered: Stages) -> bool {
        self.source.intersects(named_by) || self.source_reach.intersects(ordered)
    }

    fn concerns(&self, resource: ResourceId) -> bool {
        self.image.is_none_or(|transition| transition.image == resource)
    }

    /// Returns true if the source names the write's stage and access, and so makes the write available.
    fn names(&self, write: &Write) -> bool {
        self.concerns(write.resource)
            && self.source.intersects(write.stage)
            && self.source_accesses.intersects(write.access)
    }

    /// Returns true if the write is available before the target, through this barrier or an earlier one in the chain.
    fn finds_available(&self, write: &Write) -> bool {
        self.names(write) || self.source_reach.intersects(write.chain)
    }
}

#[derive(Clone)]
pub struct Read {
    pub actor: Actor,
    pub resource: ResourceId,
    pub time: u32,
    pub stage: Stages,
    /// Stages that cover the access if a source mask names them.
    pub named_by: Stages,
    /// Stages whose later accesses are ordered after this one.
    pub ordered: Stages,
}

impl Read {
    /// Applies the barriers of one call. Returns true if the record changed.
    fn pass_through(&mut self, scopes: &[Scope]) -> bool {
        let ordered = self.ordered;
        for scope in scopes {
            if scope.waits_for(self.named_by, ordered) {
                self.ordered |= scope.target_reach;
            }
        }
        self.ordered != ordered
    }

    /// Returns the conflict with a write that does not wait for this read.
    pub fn overtaken(&self) -> Conflict {
        (ViolationKind::WriteAfterRead, self.actor, self.resource, Missing::Order)
    }
}

/// A write of one kind at one stage, a layout change, or a write of the host.
#[derive(Clone)]
pub struct Write {
    pub actor: Actor,
    pub resource: ResourceId,
    pub time: u32,
    /// Stage of the write; empty for layout changes and writes of the host, which no source mask can name.
    pub stage: Stages,
    pub access: Accesses,
    /// Stages whose later accesses are ordered after this write.
    pub ordered: Stages,
    /// Stages ordered after the write became available; empty until then.
    pub chain: Stages,
    /// Accesses to which the write is visible through any resource. `visible_through_own` has those to which it is
    /// visible only through the resource that was written.
    pub visible: Pairs,
    pub visible_through_own: Pairs,
}

impl Write {
    fn pass_through(&mut self, scopes: &[Scope]) -> bool {
        // Barriers of one call do not chain: all of them see the record as it was before the call.
        let before = self.clone();
        for scope in scopes {
            if scope.waits_for(with_later(before.stage), before.ordered) {
                self.ordered |= scope.target_reach;
            }
            if scope.finds_available(&before) {
                self.chain |= scope.target_reach;
                if scope.image.is_none() {
                    self.visible = self.visible.union(scope.target);
                } else if scope.concerns(self.resource) {
                    self.visible_through_own = self.visible_through_own.union(scope.target);
                }
            }
        }
        (self.ordered, self.chain, self.visible, self.visible_through_own)
            != (before.ordered, before.chain, before.visible, before.visible_through_own)
    }

    /// Returns the first guarantee about this write that an access lacks; `None` if it lacks none.
    fn lacks(&self, stage: Stages, access: Accesses, through: ResourceId) -> Option<Missing> {
        let visible = self.visible.has(stage, access)
            || through == self.resource && self.visible_through_own.has(stage, access);
        if !self.ordered.contains(stage) {
            Some(Missing::Order)
        } else if self.chain.is_empty() {
            Some(Missing::Availability)
        } else if !visible {
            Some(Missing::Visibility(stage, access))
        } else {
            None
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contents {
    pub state: State,
    /// The access that caused this state; `None` if it dates from before the replay.
    pub by: Option<Actor>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum State {
    Never,
    Written(ResourceId),
    /// The image's contents were discarded by a transition from
    /// [`Undefined`](splatgraph_framework::ir::Layout::Undefined).
    Discarded(ResourceId),
}

impl Contents {
    pub const NEVER: Contents = Contents { state: State::Never, by: None };

    /// Returns true if the bytes were last written through `resource`; with `fresh`, in that part of the replay.
    pub fn hold(&self, resource: ResourceId, fresh: Option<When>) -> bool {
        let now = fresh.is_none_or(|when| self.by.is_some_and(|by| by.when == when));
        self.state == State::Written(resource) && now
    }
}

/// A conflict of a new access with a record: its kind, the record's actor and resource, and the missing guarantee.
pub type Conflict = (ViolationKind, Actor, ResourceId, Missing);

#[derive(Clone)]
pub struct Cell {
    pub reads: Vec<Read>,
    pub writes: Vec<Write>,
    pub contents: Contents,
}

impl Cell {
    pub const FRESH: Cell = Cell { reads: Vec::new(), writes: Vec::new(), contents: Contents::NEVER };

    pub fn pass_through(&mut self, scopes: &[Scope]) {
        for read in &mut self.reads {
            read.pass_through(scopes);
        }
        for write in &mut self.writes {
            write.pass_through(scopes);
        }
    }

    pub fn is_changed_by(&self, scopes: &[Scope]) -> bool {
        self.reads.iter().any(|read| read.clone().pass_through(scopes))
            || self.writes.iter().any(|write| write.clone().pass_through(scopes))
    }

    pub fn check_read(&self, stage: Stages, access: Accesses, through: ResourceId) -> Vec<Conflict> {
        let conflict = |write: &Write| {
            let missing = write.lacks(stage, access, through)?;
            Some((ViolationKind::ReadAfterWrite, write.actor, write.resource, missing))
        };
        self.writes.iter().filter_map(conflict).collect()
    }

    pub fn check_write(
        &self,
        stage: Stages,
        access: Accesses,
        through: ResourceId,
        rules: Rules,
    ) -> Vec<Conflict> {
        let overtaken = self.reads.iter().filter(|read| !read.ordered.contains(stage));
        let overwritten = |write: &Write| {
            // A stage that read the older write made its data visible to every stage that waits for the read.
            let settled =
                self.reads.iter().any(|read| read.time > write.time && read.ordered.contains(stage));
            let missing = match write.lacks(stage, access, through)? {
                Missing::Visibility(..) if settled => return None,
                Missing::Visibility(..) if !rules.writes_see_writes => {
                    if write.chain.contains(stage) {
                        return None;
                    }
                    Missing::Availability
                }
                missing => missing,
            };
            Some((ViolationKind::WriteAfterWrite, write.actor, write.resource, missing))
        };
        overtaken.map(Read::overtaken).chain(self.writes.iter().filter_map(overwritten)).collect()
    }

    /// Checks a layout change, which happens between the barrier's source and target, and sees all available data.
    ///
    /// The change need not name a write of the prologue: the same barrier is recorded in every frame, and only the
    /// first frame follows the prologue.
    pub fn check_transition(&self, scope: &Scope, rules: Rules, when: When) -> Vec<Conflict> {
        let overtaken = self.reads.iter().filter(|read| !scope.waits_for(read.named_by, read.ordered));
        let overwritten = |write: &Write| {
            let of_prologue = matches!(when, When::Frame(_)) && write.actor.when == When::Prologue;
            let must_be_named = rules.changes_name_writes
                && !write.stage.is_empty()
                && !of_prologue
                && self.reads.iter().all(|read| read.time <= write.time);
            let missing = if !scope.waits_for(with_later(write.stage), write.ordered) {
                Missing::Order
            } else if !scope.finds_available(write) || (must_be_named && !scope.names(write)) {
                Missing::Availability
            } else {
                return None;
            };
            Some((ViolationKind::WriteAfterWrite, write.actor, write.resource, missing))
        };
        overtaken.map(Read::overtaken).chain(self.writes.iter().filter_map(overwritten)).collect()
    }

    /// Records a write. It replaces older records, except those of the same pass.
    pub fn record_write(&mut self, write: Write) {
        if self.writes.first().is_none_or(|old| old.time != write.time) {
            self.reads.clear();
            self.writes.clear();
        }
        self.writes.push(write);
    }

    pub fn record_read(&mut self, read: Read) {
        let same = |old: &&mut Read| (old.stage, old.named_by) == (read.stage, read.named_by);
        match self.reads.iter_mut().find(same) {
            Some(old) => *old = read,
            None => self.reads.push(read),
        }
    }

    /// Marks accesses of finished frames as ordered before later work, after a wait for a fence. It makes nothing
    /// visible.
    pub fn fence(&mut self, finished: impl Fn(Actor) -> bool) {
        for read in self.reads.iter_mut().filter(|read| finished(read.actor)) {
            read.ordered = Stages::all();
        }
        for write in self.writes.iter_mut().filter(|write| finished(write.actor)) {
            write.ordered = Stages::all();
        }
    }
}
