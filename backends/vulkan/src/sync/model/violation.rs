//! Defines violations: accesses whose result Vulkan does not define.

use std::fmt;
use std::ops::Range;

use splatgraph_framework::ir::{Accesses, Layout, PassId, ResourceId, Stages};
use splatgraph_framework::plan::Plan;

/// An access whose result Vulkan does not define, and the access that it conflicts with.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// Kind of conflict.
    pub kind: ViolationKind,
    /// The earlier access. `None` for a wrong layout, and for bytes that were never written in the replay.
    pub first: Option<Actor>,
    /// The later access, whose result is undefined.
    pub second: Actor,
    /// The resource that `second` accesses.
    pub resource: ResourceId,
    /// The resource that `first` accessed, if it is an alias of `resource`.
    pub through: Option<ResourceId>,
    /// Range of bytes in `resource`.
    pub range: Range<u64>,
    /// The guarantee that `second` lacks.
    pub missing: Missing,
    /// Index of the plan in [`replay_swap`](super::replay_swap); otherwise 0.
    pub plan: usize,
}

/// The kind of a violation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViolationKind {
    /// A read of bytes without synchronization with their earlier write.
    ReadAfterWrite,
    /// A write to bytes that an earlier read may not have finished reading.
    WriteAfterRead,
    /// A write to bytes without synchronization with their earlier write.
    WriteAfterWrite,
    /// An access or a layout change that expects a layout other than the image's current one.
    Layout,
    /// A read of bytes without contents of the resource, or with an earlier frame's contents that do not persist.
    Unwritten,
}

/// The guarantee that the later access lacks. It is the layout, the contents, or the first missing one of order,
/// availability and visibility.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// The earlier access may still be running.
    Order,
    /// The earlier write may still be in a cache of its stage.
    Availability,
    /// The earlier write may not have reached this access at this stage.
    Visibility(Stages, Accesses),
    /// The image is not in the layout that the access needs.
    Layout {
        /// Layout that the image is in.
        found: Layout,
        /// Layout that the access needs.
        needed: Layout,
    },
    /// The bytes hold no contents of the resource, or none that are still valid in this frame.
    Contents,
}

/// A part of the replay. The prologue and the handover are submitted with frame 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// The passes that run once, before the handover.
    Prologue,
    /// The barriers between the prologue and the first frame.
    Handover,
    /// The frame of this number, from 0.
    Frame(u32),
}

impl When {
    /// Returns the number of the frame with which this part is submitted.
    pub fn frame(self) -> u32 {
        match self {
            When::Prologue | When::Handover => 0,
            When::Frame(n) => n,
        }
    }
}

/// The source of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Actor {
    /// The part of the replay that it belongs to; for the host, the frame that it prepares.
    pub when: When,
    /// The pass, layout change or host.
    pub what: What,
}

/// A pass, a layout change or the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// A pass of the plan.
    Pass(PassId),
    /// The layout change of an image, in the barriers before a pass or in the handover.
    Transition {
        /// The image whose layout changes.
        image: ResourceId,
        /// Pass that follows the barrier; `None` in the handover.
        before: Option<PassId>,
    },
    /// The host, writing a uniform block or a host buffer for a frame.
    Host,
}

impl Actor {
    fn describe(self, plan: &Plan) -> String {
        let when = self.when;
        match self.what {
            What::Pass(pass) => format!("`{}` ({when})", plan.pass(pass).name),
            What::Transition { image, before: Some(pass) } => {
                let (image, pass) = (&plan.resource(image).name, &plan.pass(pass).name);
                format!("the layout change of `{image}` before `{pass}` ({when})")
            }
            What::Transition { image, before: None } => {
                format!("the layout change of `{}` ({when})", plan.resource(image).name)
            }
            What::Host => format!("the host, preparing {when},"),
        }
    }
}

impl fmt::Display for When {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            When::Prologue => write!(f, "prologue"),
            When::Handover => write!(f, "handover"),
            When::Frame(n) => write!(f, "frame {n}"),
        }
    }
}

impl Violation {
    /// Returns true if both have the same kind, resource and actors. The frame, the bytes, the alias and the missing
    /// guarantee may differ.
    fn recurs_as(&self, other: &Violation) -> bool {
        let recurring = |v: &Violation| (v.kind, v.resource, v.first.map(|a| a.what), v.second.what);
        recurring(self) == recurring(other)
    }

    /// Formats the violation as a sentence. `plan` is the replayed plan.
    pub fn describe(&self, plan: &Plan) -> String {
        let second = self.second.describe(plan);
        let Range { start, end } = self.range;
        let what = format!("`{}`, bytes {start}..{end}", plan.resource(self.resource).name);
        let first = self.first.map_or("none".to_string(), |first| first.describe(plan));
        let through = match self.through {
            Some(alias) => format!(" through `{}` in the same memory", plan.resource(alias).name),
            None => String::new(),
        };
        let verb = if self.kind == ViolationKind::ReadAfterWrite { "reads" } else { "writes" };
        let did = if self.kind == ViolationKind::WriteAfterRead { "read" } else { "wrote" };
        match self.missing {
            Missing::Order => {
                format!("{second} {verb} {what}, without waiting for {first}, which {did} them{through}")
            }
            Missing::Availability => {
                format!(
                    "{second} {verb} {what}, but what {first} wrote there{through} was not made available"
                )
            }
            Missing::Visibility(stage, access) => {
                format!(
                    "{second} {verb} {what}, but what {first} wrote there{through} is not visible to {access} at {stage}"
                )
            }
            Missing::Layout { found, needed } => {
                format!("{second} needs {what} in the layout {needed:?}, but it is in {found:?}")
            }
            Missing::Contents if self.first.is_none() => {
                format!("{second} reads {what}, which were never written")
            }
            Missing::Contents => {
                format!("{second} reads {what}, which hold only what {first} left there{through}")
            }
        }
    }
}

pub(super) struct Findings {
    pub violations: Vec<Violation>,
    pub first_only: bool,
}

impl Findings {
    pub fn add(&mut self, new: Violation) {
        match self.violations.iter_mut().find(|old| old.recurs_as(&new)) {
            None => self.violations.push(new),
            // The same two accesses conflict on the bytes that follow: extends the earlier report.
            Some(old)
                if (old.first, old.second, old.missing) == (new.first, new.second, new.missing)
                    && old.range.end == new.range.start =>
            {
                old.range.end = new.range.end;
            }
            Some(_) => {}
        }
    }

    pub fn enough(&self) -> bool {
        self.first_only && !self.violations.is_empty()
    }
}
