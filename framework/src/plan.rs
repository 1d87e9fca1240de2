//! Defines the plan: the input of a backend, as plain data.
//!
//! A [`Plan`] lists every resource with its size and memory, every pass with its bindings, and two sequences of passes:
//! the prologue runs once after the plan or the scene changes, and the frame runs for every rendered frame.
//!
//! Synchronisation is two lists: [`Dependency`]s between passes, and [`LayoutChange`]s of images. `solve` derives both
//! from the accesses of the passes, so a backend looks for no conflicts itself. Each backend lowers the lists to the
//! primitives of its API: barriers in Vulkan; encoders, fences and barriers in Metal.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::Range;

use indexmap::IndexSet;
use serde::{Deserialize, Serialize};

use crate::ir::{
    BlockId, Culled, Domain, Effect, Fallback, Hazard, Layout, Masks, Origin, Output, Param, ParamBinding,
    Pass, PassId, Reason, ResourceId, Shader, ShaderId, Shape, Source, Stat, Usage, Value,
};
use crate::source::Diagnostic;

/// The compiled form of a graph: everything that a backend needs to execute it. The default is an empty plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// The graph that was requested, by preset name or by path.
    pub name: String,
    /// One line that describes the graph.
    pub summary: String,
    /// Names to which the requested preset or choice leads, in order, the graph's last; empty for a graph.
    pub based_on: Vec<String>,
    /// Graphs of a choice that were rejected, in the order tried. The plan's graph is the last one's
    /// [`taken`](Fallback::taken).
    pub fallbacks: Vec<Fallback>,
    /// The facts that the plan was built from, by full name, such as `scene.count` or `outputs.depth`.
    pub facts: BTreeMap<String, Value>,
    /// Parameters: the graph's own, in the order of its file, then those that its includes expose.
    pub params: Vec<Param>,
    /// The effect of each parameter on the plan, in the order of [`Plan::params`].
    pub effects: Vec<Effect>,
    /// Buffers and images, indexed by [`ResourceId`].
    pub resources: Vec<Resource>,
    /// Compiled shaders, indexed by [`ShaderId`].
    pub shaders: Vec<Shader>,
    /// Passes, indexed by [`PassId`].
    pub passes: Vec<Pass>,
    /// Memory for the transient resources. Resources with disjoint lifetimes can share a block.
    pub blocks: Vec<Block>,
    /// Pairs of passes that must run in order, sorted by the ids of the later passes; see [`Plan::dependencies_of`].
    pub dependencies: Vec<Dependency>,
    /// Layout changes of images, in the prologue, in the handover and in the frame.
    pub layout_changes: Vec<LayoutChange>,
    /// Passes that run once after the plan or the scene changes, in order.
    pub prologue: Vec<PassId>,
    /// Passes that run every frame, in order. The first frame follows the prologue. Between the two is the *handover*,
    /// which brings images to the layouts that they have between frames.
    pub frame: Vec<PassId>,
    /// Passes and includes of the graph that are not in the plan, with the reason.
    pub culled: Vec<Culled>,
    /// Constructs of the graph that are allowed but probably unintended.
    pub warnings: Vec<Warning>,
    /// The image that is shown or saved. A [`Work::Export`](crate::ir::Work::Export) pass at the end of the frame
    /// leaves it in [`Layout::TransferSource`], readable by [`Stages::COPY`](crate::ir::Stages::COPY).
    pub output: ResourceId,
    /// Images requested besides the output. The export leaves them in the same layout as the output.
    pub outputs: Vec<Output>,
    /// Outputs of included graphs that a pass uses, by the includers' names for them, such as `scene.picture`.
    pub pictures: Vec<Output>,
    /// Names of the images that can be requested, in the order of the graph.
    pub offered: Vec<String>,
    /// Statistics: 32-bit words of buffers. The export copies them in order to the resource with [`Source::Readback`],
    /// where the host reads them in the last pass of the frame, [`Work::Host`](crate::ir::Work::Host). A plan without
    /// statistics has neither that resource nor that pass.
    pub stats: Vec<Stat>,
}

impl Plan {
    /// Returns the resource with this id.
    pub fn resource(&self, id: ResourceId) -> &Resource {
        &self.resources[id.index()]
    }

    /// Returns the pass with this id.
    pub fn pass(&self, id: PassId) -> &Pass {
        &self.passes[id.index()]
    }

    /// Returns the shader with this id.
    pub fn shader(&self, id: ShaderId) -> &Shader {
        &self.shaders[id.index()]
    }

    /// Finds a resource by its full name, for instance `"keys#0"`; `None` if there is none.
    pub fn find_resource(&self, name: &str) -> Option<ResourceId> {
        self.resources.iter().position(|r| r.name == name).map(|i| ResourceId(i as u32))
    }

    /// Lists the choices that follow from facts, for instance `rasteriser = serial and sorter = serial, because
    /// device.subgroup_size = 8`.
    ///
    /// Covers constant choices and bools with an expression over facts. Values with equal reasons share a line.
    pub fn decisions(&self) -> Vec<String> {
        let mut found: Vec<(&Reason, Vec<String>)> = Vec::new();
        for param in &self.params {
            let Some(reason) = param.reason.as_ref().filter(|reason| reason.has_fact()) else { continue };
            if param.binding != ParamBinding::Const
                || !matches!(param.domain, Domain::Choice(_) | Domain::Bool)
            {
                continue;
            }
            let text = format!("{} = {}", param.name, param.value);
            match found.iter_mut().find(|(other, _)| other.values == reason.values) {
                Some((_, all)) => all.push(text),
                None => found.push((reason, vec![text])),
            }
        }
        found.iter().map(|(reason, all)| format!("{}, because {reason}", all.join(" and "))).collect()
    }

    /// Returns the effect of a parameter; `None` for an unknown name.
    pub fn effect(&self, parameter: &str) -> Option<&Effect> {
        self.effects.get(self.params.iter().position(|param| param.name == parameter)?)
    }

    /// Returns why a parameter has no effect, as a phrase. `None` if it has an effect or is unknown.
    pub fn no_effect(&self, parameter: &str) -> Option<&str> {
        self.effect(parameter)?.none.as_deref()
    }

    /// Lists the phases that contain a pass affected by a parameter, each once. Empty for an unknown name.
    pub fn affected_phases(&self, parameter: &str) -> Vec<&str> {
        let passes = self.effect(parameter).into_iter().flat_map(|effect| &effect.passes);
        let phases: IndexSet<&str> = passes.map(|id| self.pass(*id).phase.as_str()).collect();
        phases.into_iter().collect()
    }

    /// Describes the effect of a parameter in a sentence. It says whether the parameter decides which passes there are,
    /// and the passes that it changes, or why it has no effect. `None` for an unknown name.
    pub fn effect_text(&self, parameter: &str) -> Option<String> {
        let effect = self.effect(parameter)?;
        if let Some(why) = &effect.none {
            return Some(format!("`{parameter}` has no effect: {why}"));
        }
        let shape = effect.shape.then(|| "decides which passes there are".to_string());
        let passes = (!effect.passes.is_empty()).then(|| match effect.passes.len() {
            1 => format!("changes the pass `{}`", self.pass(effect.passes[0]).name),
            n => format!("changes {n} passes of {}", self.affected_phases(parameter).join(", ")),
        });
        let parts: Vec<String> = shape.into_iter().chain(passes).collect();
        Some(format!("`{parameter}` {}", parts.join(" and ")))
    }

    /// Encodes the live uniform block from the plan's own values; empty if no pass reads the block. A choice is encoded
    /// as the index of its option, a bool as 0 or 1.
    pub fn live_bytes(&self) -> Vec<u8> {
        self.live_bytes_of(&self.params)
    }

    /// Encodes the live uniform block from `params`: the plan's parameters, with updated values for live ones.
    pub fn live_bytes_of<'a>(&self, params: impl IntoIterator<Item = &'a Param>) -> Vec<u8> {
        let size = self.resources.iter().find(|r| r.source == Source::Live).map_or(0, Resource::bytes);
        let mut bytes = vec![0; size as usize];
        for param in params {
            let ParamBinding::Live { offset } = param.binding else { continue };
            let word = match (&param.value, &param.domain) {
                (Value::Float(v), _) => (*v as f32).to_le_bytes(),
                (Value::Int(v), _) => (*v as i32).to_le_bytes(),
                (Value::Bool(v), _) => u32::from(*v).to_le_bytes(),
                (Value::Text(v), Domain::Choice(of)) => {
                    (of.iter().position(|o| o == v).unwrap_or(0) as u32).to_le_bytes()
                }
                (Value::Text(_), _) => [0; 4],
            };
            if let Some(target) = bytes.get_mut(offset as usize..offset as usize + 4) {
                target.copy_from_slice(&word);
            }
        }
        bytes
    }

    /// Returns the total size of the memory blocks in bytes. A device may need more, because it pads images.
    pub fn transient_bytes(&self) -> u64 {
        let largest = |block: &Block| block.aliases.iter().map(|id| self.resource(*id).bytes()).max();
        self.blocks.iter().filter_map(largest).sum()
    }

    /// Returns the total size of the transient resources in bytes, without sharing of memory.
    pub fn unshared_bytes(&self) -> u64 {
        self.resources.iter().filter(|r| r.source == Source::Transient).map(Resource::bytes).sum()
    }

    /// Lists the buffers that only the prologue uses: a device can free them once the prologue has run. They are planes
    /// of the scene, and buffers of the graph without a history, aliases or statistics.
    pub fn used_once(&self) -> BTreeSet<ResourceId> {
        let used = |passes: &[PassId]| -> BTreeSet<ResourceId> {
            passes.iter().flat_map(|pass| self.pass(*pass).resources()).collect()
        };
        let later = used(&self.frame);
        let ends = |id: &ResourceId| {
            let resource = self.resource(*id);
            let alone = match &resource.source {
                // Two includes can import the same plane, which then appears as two resources.
                Source::Scene { .. } => {
                    !later.iter().any(|other| self.resource(*other).source == resource.source)
                }
                Source::Transient => resource.history.is_none() && self.aliases(*id).next().is_none(),
                _ => false,
            };
            alone
                && matches!(resource.shape, Shape::Buffer { .. })
                && !later.contains(id)
                && !self.stats.iter().any(|stat| stat.buffer == *id)
        };
        used(&self.prologue).into_iter().filter(ends).collect()
    }

    /// Returns true if a resource's contents persist from frame to frame. It has a history, or both the prologue and
    /// frames write it, and frames do not first overwrite it completely.
    pub fn is_state(&self, id: ResourceId) -> bool {
        let touches = |pass: &PassId, writes: bool| {
            let mut uses = self.pass(*pass).uses.iter();
            uses.any(|touch| touch.resource == id && (touch.accesses.writes() || !writes))
        };
        let writes = |pass: &PassId| touches(pass, true);
        let first = || self.frame.iter().find(|pass| touches(pass, false));
        self.resource(id).history.is_some()
            || self.prologue.iter().any(writes)
                && self.frame.iter().any(writes)
                && !first().is_some_and(|pass| self.pass(*pass).overwrites(id))
    }

    /// Returns true if frames depend on the frames before them; see [`Plan::is_state`].
    pub fn carries_state(&self) -> bool {
        (0..self.resources.len() as u32).any(|id| self.is_state(ResourceId(id)))
    }

    /// Iterates over the prologue's passes, then the frame's.
    pub fn order(&self) -> impl DoubleEndedIterator<Item = PassId> + Clone + '_ {
        self.prologue.iter().chain(&self.frame).copied()
    }

    /// Iterates over the layout changes just before a pass, or in the handover for `None`.
    pub fn layout_changes_at(&self, at: Option<PassId>) -> impl Iterator<Item = &LayoutChange> + Clone + '_ {
        let is_here = move |change: &&LayoutChange| match at {
            Some(pass) => !change.handover && change.before == pass,
            None => change.handover,
        };
        self.layout_changes.iter().filter(is_here)
    }

    /// Lists the dependencies of a pass on passes before it: of the same frame, the prologue or the previous frame.
    pub fn dependencies_of(&self, pass: PassId) -> &[Dependency] {
        let from = self.dependencies.partition_point(|dependency| dependency.second < pass);
        let count = self.dependencies[from..].partition_point(|dependency| dependency.second == pass);
        &self.dependencies[from..from + count]
    }

    /// Lists the other resources that share the block of `id`.
    pub fn aliases(&self, id: ResourceId) -> impl Iterator<Item = ResourceId> + '_ {
        let block = self.resource(id).block.map(|block| &self.blocks[block.index()]);
        block.into_iter().flat_map(|block| &block.aliases).copied().filter(move |other| *other != id)
    }
}

/// Sums the bytes of resources. A plane of the scene that several includes import is one buffer, and counts once.
pub fn distinct_bytes<'a>(resources: impl Iterator<Item = &'a Resource>) -> u64 {
    let mut planes = HashSet::new();
    let is_new = |resource: &&'a Resource| match &resource.source {
        Source::Scene { attribute, plane } => planes.insert((attribute, *plane)),
        _ => true,
    };
    resources.filter(is_new).map(Resource::bytes).fold(0, u64::saturating_add)
}

/// A construct of a graph that is allowed but probably unintended.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// The message, with spans in the files that the plan was built from.
    pub diagnostic: Diagnostic,
    /// Path, line and column of the construct.
    pub origin: Origin,
}

/// A buffer or an image. A ping-pong resource appears as two entries, named `keys#0` and `keys#1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Resource {
    /// Name, unique in the plan, for instance `keys#0`.
    pub name: String,
    /// Dimensions of the resource, and the format of an image.
    pub shape: Shape,
    /// All uses of the resource, over the passes of the plan.
    pub usage: Usage,
    /// The owner of the memory and the writer of the contents.
    pub source: Source,
    /// The memory block of a transient resource; `None` for all others.
    pub block: Option<BlockId>,
    /// Name of the resource's history, whose contents persist across frames; `None` without a history. Of a ping-pong
    /// resource, only the half in front at the end of a frame has the name.
    ///
    /// The next plan of the same scene inherits the contents if it has a history of the same name and shape. It takes
    /// over the memory, so its history must have no use that this one lacks, and its prologue must only zero it. A plan
    /// that differs only in larger capacities copies the contents instead.
    pub history: Option<String>,
    /// Position of the resource's declaration in the graph's files.
    pub origin: Origin,
}

/// A memory block, as large as its largest resource.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// Resources that share this memory; all start at offset 0. If there are several, each is alive from its first use
    /// in a frame to its last, one at a time, and has undefined contents before its first use.
    pub aliases: Vec<ResourceId>,
}

impl Resource {
    /// Returns the size of the buffer or image in bytes, without padding.
    pub fn bytes(&self) -> u64 {
        self.shape.bytes()
    }
}

/// A requirement that an access of a later pass follows one of an earlier pass and sees its writes.
///
/// A read depends on the last write. A write depends on all reads since the last write, or on that write if there are
/// none. All other order follows from chains of dependencies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependency<P = PassId, R = ResourceId> {
    /// The kind of conflict; [`Hazard::LayoutChange`] if only the image's layout change waits, and not the pass itself.
    pub hazard: Hazard,
    /// The earlier pass.
    #[serde(rename = "pass")]
    pub first: P,
    /// The later pass.
    #[serde(skip)]
    pub second: P,
    /// When the earlier pass runs, relative to the later one.
    pub since: Since,
    /// The resource that the later pass accesses.
    pub resource: R,
    /// The resource that the earlier pass accessed, if it is an alias in the same block; otherwise `None`.
    pub alias: Option<R>,
    /// The smallest range of the memory, from the resource's start, that covers the conflict. An image may use any byte
    /// of its block.
    #[serde(flatten)]
    pub bytes: Range<u64>,
    /// True if the image changes layout between the passes. The change then waits for the earlier accesses. With
    /// [`Since::Prologue`], it is the image's change in the handover, if there is one, or else that before the later
    /// pass.
    pub changes_layout: bool,
    /// The conflicting stages and accesses of both passes.
    #[serde(flatten)]
    pub masks: Masks,
}

/// A reason for a synchronisation command: accesses of the pass `before` conflict with accesses of `after`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cause<P = PassId, R = ResourceId> {
    /// The kind of conflict.
    pub hazard: Hazard,
    /// The pass that waits. Other passes may run between the command and this pass.
    pub before: P,
    /// The resource that the waiting pass accesses.
    pub resource: R,
    /// The passes to wait for. Empty if the image of a layout change was never accessed.
    pub after: Vec<P>,
    /// True if the passes of `after` ran one frame before the pass `before`.
    pub previous_frame: bool,
    /// The resource that the passes of `after` accessed, if it is an alias in the same block; otherwise `None`.
    pub alias: Option<R>,
}

impl Cause {
    /// Maps the pass and resource ids, for instance to names.
    pub fn map<P, R>(&self, pass: impl Fn(PassId) -> P, resource: impl Fn(ResourceId) -> R) -> Cause<P, R> {
        Cause {
            hazard: self.hazard,
            before: pass(self.before),
            resource: resource(self.resource),
            after: self.after.iter().map(|id| pass(*id)).collect(),
            previous_frame: self.previous_frame,
            alias: self.alias.map(resource),
        }
    }
}

/// Relative timing of the two passes of a dependency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Since {
    /// Both run in the prologue, or in one frame.
    Same,
    /// The earlier pass runs in the prologue, the later one in the first frame.
    Prologue,
    /// The earlier pass runs in the previous frame.
    PreviousFrame,
}

/// A change of an image's layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Transition<R = ResourceId> {
    /// Image whose layout changes.
    pub image: R,
    /// The layout before the change; [`Layout::Undefined`] if the contents are not needed.
    pub old: Layout,
    /// The layout after the change.
    pub new: Layout,
}

impl<R> Transition<R> {
    /// Maps the image reference, for instance from an id to a name.
    pub fn map<T>(&self, image: impl FnOnce(&R) -> T) -> Transition<T> {
        Transition { image: image(&self.image), old: self.old, new: self.new }
    }
}

/// A change of an image's layout before a pass.
///
/// APIs without layouts ignore it. For others it is a write of the whole image just before the pass, or in the
/// handover. It waits for the dependencies with [`Dependency::changes_layout`]; there are none if the image was never
/// accessed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LayoutChange<P = PassId, R = ResourceId> {
    /// Image whose layout changes.
    pub image: R,
    /// The layout before the change; [`Layout::Undefined`] if the contents are not needed.
    pub old: Layout,
    /// The layout after the change.
    pub new: Layout,
    /// The pass that needs the new layout.
    pub before: P,
    /// True in the handover, which transitions the image to its layout between frames. `before` is then the first pass
    /// of the frame that accesses the image.
    pub handover: bool,
}

impl LayoutChange {
    /// Returns the image and its layouts.
    pub fn transition(&self) -> Transition {
        Transition { image: self.image, old: self.old, new: self.new }
    }
}
