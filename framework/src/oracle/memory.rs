//! Records of accesses to a few bytes, and what barriers do to them.
//!
//! A [`Cell`] is a run of bytes that are always touched together. It remembers the accesses that a later one may
//! still conflict with: the writes of the last pass that wrote, and the reads since. Each record carries the stages
//! that are ordered after it, and a write also how far its memory has come. A barrier adds to these sets; an access
//! looks whether it is in them.
//!
//! What is forgotten is implied by what is kept. A write that is properly ordered after an older access stands for
//! it: any chain that starts at the newer one extends the older one's. So does a read for an older read at the same
//! stage. (If it was not properly ordered, the oracle has already objected.)

use super::objection::{Actor, Kind, Missing, When};
use super::stages::{Pairs, with_earlier, with_later};
use crate::ir::{Accesses, ResourceId, Stages};
use crate::plan::{Barrier, Transition};

/// A barrier with its masks spelt out.
pub struct Scope {
    pub image: Option<Transition>,
    /// Source stages that are named, which count for memory, and those with all before them, which count for order.
    source: Stages,
    source_reach: Stages,
    source_accesses: Accesses,
    pub target_reach: Stages,
    pub target: Pairs,
}

impl Scope {
    pub fn new(barrier: &Barrier) -> Scope {
        Scope {
            image: barrier.image,
            source: barrier.source_stages,
            source_reach: with_earlier(barrier.source_stages),
            source_accesses: barrier.source_accesses,
            target_reach: with_later(barrier.target_stages),
            target: Pairs::of(barrier.target_stages, barrier.target_accesses),
        }
    }

    /// The image that really changes its layout.
    pub fn transition(&self) -> Option<Transition> {
        self.image.filter(|image| image.old != image.new)
    }

    /// An access at `stage` that is ordered before `ordered` is in the source scope: itself, or by a chain.
    fn waits_for(&self, stage: Stages, ordered: Stages) -> bool {
        self.source_reach.intersects(stage | ordered)
    }

    /// The memory part is for all memory, or for accesses through one image.
    fn concerns(&self, resource: ResourceId) -> bool {
        self.image.is_none_or(|transition| transition.image == resource)
    }

    /// Whether the write is available by the time that the target starts: made so here, or before in the chain.
    fn finds_available(&self, write: &Write) -> bool {
        let here = self.concerns(write.resource)
            && self.source.intersects(write.stage)
            && self.source_accesses.intersects(write.access);
        here || self.source_reach.intersects(write.chain)
    }
}

/// A read at one stage.
#[derive(Clone)]
pub struct Read {
    pub actor: Actor,
    pub resource: ResourceId,
    pub time: u32,
    pub stage: Stages,
    /// What happens at these stages from now on is ordered after it.
    pub ordered: Stages,
}

impl Read {
    fn pass_through(&mut self, scopes: &[Scope]) {
        let ordered = self.ordered;
        for scope in scopes {
            if scope.waits_for(self.stage, ordered) {
                self.ordered |= scope.target_reach;
            }
        }
    }
}

/// A write of one kind at one stage, or a layout change, or the host's.
#[derive(Clone)]
pub struct Write {
    pub actor: Actor,
    pub resource: ResourceId,
    pub time: u32,
    /// Empty for what no source mask can name: a layout change, a write of the host.
    pub stage: Stages,
    pub access: Accesses,
    /// As in [`Read`].
    pub ordered: Stages,
    /// What happens at these stages from now on is ordered after the write became available. Empty until then.
    pub chain: Stages,
    /// Who sees it, through whichever resource, and through the resource that it was written through.
    pub visible: Pairs,
    pub visible_through_own: Pairs,
}

impl Write {
    fn pass_through(&mut self, scopes: &[Scope]) {
        // Barriers of one call do not chain: all of them see the record as it was before the call.
        let before = self.clone();
        for scope in scopes {
            if scope.waits_for(before.stage, before.ordered) {
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
    }

    /// What an access needs of this write and does not have.
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

/// What the bytes hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contents {
    pub state: State,
    /// Who brought them into this state; `None` before the first frame's prologue.
    pub by: Option<Actor>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum State {
    Never,
    Written(ResourceId),
    /// An image's contents were given up with a change from [`Undefined`](crate::ir::Layout::Undefined).
    Discarded(ResourceId),
}

impl Contents {
    pub const NEVER: Contents = Contents { state: State::Never, by: None };

    /// Whether a read through `resource` finds what was written through it, in frame `fresh` if there is one.
    pub fn hold(&self, resource: ResourceId, fresh: Option<When>) -> bool {
        let now = fresh.is_none_or(|when| self.by.is_some_and(|by| by.when() == when));
        self.state == State::Written(resource) && now
    }
}

/// A conflict of a new access with a record: its kind, the record's actor and resource, what is missing.
pub type Conflict = (Kind, Actor, ResourceId, Missing);

#[derive(Clone)]
pub struct Cell {
    pub reads: Vec<Read>,
    pub writes: Vec<Write>,
    pub contents: Contents,
}

impl Cell {
    pub const FRESH: Cell = Cell { reads: Vec::new(), writes: Vec::new(), contents: Contents::NEVER };

    pub fn reset(&mut self) {
        self.reads.clear();
        self.writes.clear();
        self.contents = Contents::NEVER;
    }

    /// Barriers that are recorded in one call.
    pub fn pass_through(&mut self, scopes: &[Scope]) {
        self.reads.iter_mut().for_each(|read| read.pass_through(scopes));
        self.writes.iter_mut().for_each(|write| write.pass_through(scopes));
    }

    pub fn check_read(
        &self,
        stage: Stages,
        access: Accesses,
        through: ResourceId,
        mut conflict: impl FnMut(Conflict),
    ) {
        for write in &self.writes {
            if let Some(missing) = write.lacks(stage, access, through) {
                conflict((Kind::ReadAfterWrite, write.actor, write.resource, missing));
            }
        }
    }

    pub fn check_write(
        &self,
        stage: Stages,
        access: Accesses,
        through: ResourceId,
        mut conflict: impl FnMut(Conflict),
    ) {
        for read in &self.reads {
            if !read.ordered.contains(stage) {
                conflict((Kind::WriteAfterRead, read.actor, read.resource, Missing::Order));
            }
        }
        for write in &self.writes {
            // Who has seen the older write has settled its memory for those who wait for them.
            let settled =
                self.reads.iter().any(|read| read.time > write.time && read.ordered.contains(stage));
            match write.lacks(stage, access, through) {
                Some(Missing::Visibility(..)) if settled => {}
                Some(missing) => conflict((Kind::WriteAfterWrite, write.actor, write.resource, missing)),
                None => {}
            }
        }
    }

    /// A layout change happens between a barrier's two scopes. It sees whatever is available.
    pub fn check_transition(&self, scope: &Scope, mut conflict: impl FnMut(Conflict)) {
        for read in &self.reads {
            if !scope.waits_for(read.stage, read.ordered) {
                conflict((Kind::WriteAfterRead, read.actor, read.resource, Missing::Order));
            }
        }
        for write in &self.writes {
            let missing = if !scope.waits_for(write.stage, write.ordered) {
                Missing::Order
            } else if !scope.finds_available(write) {
                Missing::Availability
            } else {
                continue;
            };
            conflict((Kind::WriteAfterWrite, write.actor, write.resource, missing));
        }
    }

    /// Older records give way to a write; those of the same pass stay with it.
    pub fn record_write(&mut self, write: Write) {
        if self.writes.first().is_none_or(|old| old.time != write.time) {
            self.reads.clear();
            self.writes.clear();
        }
        self.writes.push(write);
    }

    pub fn record_read(&mut self, read: Read) {
        match self.reads.iter_mut().find(|old| old.stage == read.stage) {
            Some(old) => *old = read,
            None => self.reads.push(read),
        }
    }

    /// A fence was waited for: what these frames did is finished. (Visible it is not.)
    pub fn fence(&mut self, finished: impl Fn(Actor) -> bool) {
        for read in self.reads.iter_mut().filter(|read| finished(read.actor)) {
            read.ordered = Stages::all();
        }
        for write in self.writes.iter_mut().filter(|write| finished(write.actor)) {
            write.ordered = Stages::all();
        }
    }
}
