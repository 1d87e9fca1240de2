//! The plan: the input of a backend, as plain data.
//!
//! A [`Plan`] names every resource with its size and its memory, every pass with its bindings, and two sequences of steps:
//! the prologue, which runs once after the plan or the scene changed, and the frame, which runs every time.
//!
//! The order of passes is a list of [`Dependency`]s; changes of image layouts are a list of [`LayoutChange`]s. `solve`
//! makes both from the accesses of the passes, and nothing else looks for conflicts. Each API makes its commands of these lists:
//!
//! - Vulkan's barriers are made by `barriers`. A [`Step`] holds those that are recorded just before its pass, in one call; the
//!   [handover](Plan::handover) is one more call, between the prologue and the first frame. Every frame records the same barriers.
//! - Metal's encoders, fences and barriers are made by its backend, which ignores Vulkan's.
//!
//! Stages and accesses have the names of Vulkan's synchronization2, the finer of the models. Metal maps them to the two stages of a
//! draw.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::ir::{
    Accesses, BlockId, Culled, Domain, Effect, Fallback, Hazard, Layout, Origin, Param, ParamBinding, Pass,
    PassId, Reason, ResourceId, Shader, ShaderId, Shape, Source, Stages, Stat, Usage, Value,
};
use crate::source::Diagnostic;

/// Holds everything that a backend executes. See the module's documentation.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The requested name: a preset's name or a path.
    pub name: String,
    /// One line that describes the graph.
    pub summary: String,
    /// The graphs and presets that it is based on, the graph last; empty for a graph.
    pub based_on: Vec<String>,
    /// The graphs of a choice that are passed over, in order; the last one's fallback is this plan's graph.
    pub fallbacks: Vec<Fallback>,
    /// The facts of the scene, the device and the viewport that the plan was built from.
    pub facts: BTreeMap<String, Value>,
    /// Parameters, in the order of the file.
    pub params: Vec<Param>,
    /// What each parameter does, in the same order.
    pub effects: Vec<Effect>,
    /// Buffers and images, indexed by [`ResourceId`].
    pub resources: Vec<Resource>,
    /// Compiled shaders, indexed by [`ShaderId`].
    pub shaders: Vec<Shader>,
    /// Passes, indexed by [`PassId`].
    pub passes: Vec<Pass>,
    /// The memory of the transient resources. Each stands in one block, alone or with others that are never alive at the
    /// same time.
    pub blocks: Vec<Block>,
    /// Pairs of passes that must run in order, sorted by the ids of the later passes: see [`Plan::dependencies_of`].
    pub dependencies: Vec<Dependency>,
    /// Layout changes of images: in the prologue, the handover, and the frame.
    pub layout_changes: Vec<LayoutChange>,
    /// Runs once after the plan or the scene changed.
    pub prologue: Vec<Step>,
    /// Recorded once, as one call, between the prologue and the first frame: shows the frames what the prologue wrote, and
    /// brings images into the layouts that they are in between frames.
    pub handover: Vec<Barrier>,
    /// Runs every frame, after the handover or after the frame before.
    pub frame: Vec<Step>,
    /// Passes of the file that are not in the plan because nothing reads what they write, or their `when` is false.
    pub culled: Vec<Culled>,
    /// What is allowed in the graph, and probably not meant.
    pub warnings: Vec<Warning>,
    /// The image that is shown or saved. A [`Work::Export`](crate::ir::Work::Export) pass at the end of the frame leaves it in
    /// [`Layout::TransferSource`], readable by [`Stages::COPY`].
    pub output: ResourceId,
    /// Numbers that the GPU computes and people want to see: 32-bit words of buffers. The export copies them to the resource
    /// with [`Source::Readback`], one after another, and the frame's last step, [`Work::Host`](crate::ir::Work::Host), is the host reading them there.
    /// A plan without any has neither.
    pub stats: Vec<Stat>,
}

impl Plan {
    /// Returns the resource of an id.
    pub fn resource(&self, id: ResourceId) -> &Resource {
        &self.resources[id.index()]
    }

    /// Returns the pass of an id.
    pub fn pass(&self, id: PassId) -> &Pass {
        &self.passes[id.index()]
    }

    /// Returns the shader of an id.
    pub fn shader(&self, id: ShaderId) -> &Shader {
        &self.shaders[id.index()]
    }

    /// Finds a resource by name, for instance `"keys#0"`.
    pub fn find_resource(&self, name: &str) -> Option<ResourceId> {
        self.resources.iter().position(|r| r.name == name).map(|i| ResourceId(i as u32))
    }

    /// Returns the name of the graph or preset that is drawn.
    ///
    /// It is the requested one, or what stands in for it.
    pub fn drawn(&self) -> &str {
        self.fallbacks.last().map_or(&self.name, |fallback| &fallback.taken)
    }

    /// Lists the choices that facts made: `rasteriser = serial and sorter = serial, because device.subgroup_size = 8`.
    ///
    /// They are the constant choices and bools whose value an expression over facts gave; those of the same facts share a line.
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

    /// Returns what a parameter does in the plan; `None` for a name that the graph does not have.
    pub fn effect(&self, parameter: &str) -> Option<&Effect> {
        self.effects.get(self.params.iter().position(|param| param.name == parameter)?)
    }

    /// Returns the reason why a parameter has no effect, a phrase; `None` if it has one, or is unknown.
    pub fn no_effect(&self, parameter: &str) -> Option<&str> {
        self.effect(parameter)?.none.as_deref()
    }

    /// Lists the phases of the passes that depend on a parameter, each once.
    pub fn affected_phases(&self, parameter: &str) -> Vec<&str> {
        let mut phases: Vec<&str> = Vec::new();
        for id in self.effect(parameter).iter().flat_map(|effect| &effect.passes) {
            let phase = self.pass(*id).phase.as_str();
            if !phases.contains(&phase) {
                phases.push(phase);
            }
        }
        phases
    }

    /// Says in a sentence what a parameter does: which passes depend on it, or why it has no effect.
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

    /// Encodes the live uniform block from the plan's own values; empty if no pass reads it. A choice is the index of its
    /// name, a bool 0 or 1.
    pub fn live_bytes(&self) -> Vec<u8> {
        self.live_bytes_of(&self.params)
    }

    /// Encodes the live uniform block from `params`: the plan's own, with other values of live ones.
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

    /// Sums the bytes of the memory blocks. A device may round images up.
    pub fn transient_bytes(&self) -> u64 {
        let largest = |block: &Block| block.aliases.iter().map(|id| self.resource(*id).bytes()).max();
        self.blocks.iter().filter_map(largest).sum()
    }

    /// Sums the bytes of the transient resources as if none shared memory.
    pub fn unshared_bytes(&self) -> u64 {
        self.resources.iter().filter(|r| r.source == Source::Transient).map(Resource::bytes).sum()
    }

    /// Lists the dependencies whose later pass this is.
    pub fn dependencies_of(&self, pass: PassId) -> &[Dependency] {
        let from = self.dependencies.partition_point(|dependency| dependency.second < pass);
        let count = self.dependencies[from..].partition_point(|dependency| dependency.second == pass);
        &self.dependencies[from..from + count]
    }

    /// Lists the other resources in the same memory.
    pub fn aliases(&self, id: ResourceId) -> impl Iterator<Item = ResourceId> + '_ {
        let block = self.resource(id).block.map(|block| &self.blocks[block.index()]);
        block.into_iter().flat_map(|block| &block.aliases).copied().filter(move |other| *other != id)
    }
}

/// Points out something in a graph that is allowed, and probably not meant.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// The message, with its places in the files that the plan was built from.
    pub diagnostic: Diagnostic,
    /// The place that it is about.
    pub origin: Origin,
}

/// Describes a buffer or an image. Ping-pong resources appear as two, named `keys#0` and `keys#1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Resource {
    /// Unique in the plan.
    pub name: String,
    /// Size, and format of an image.
    pub shape: Shape,
    /// Uses over all passes.
    pub usage: Usage,
    /// Owner of the memory.
    pub source: Source,
    /// The memory of a transient resource; `None` for all others.
    pub block: Option<BlockId>,
    /// The name under which its contents are kept from frame to frame, and from one plan to the next that has a history of the
    /// same name and shape, unless a pass of the prologue writes it: then each plan starts it anew. (Of a ping-pong resource, only the half that the frame ends with as its front has it.)
    pub history: Option<String>,
    /// The declaration.
    pub origin: Origin,
}

/// Describes a piece of memory, as large as its largest resource.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// Resources at the block's start. Of several, only one is alive at any time: from its first use in a frame,
    /// before which its contents are undefined, to its last.
    pub aliases: Vec<ResourceId>,
}

impl Resource {
    /// Returns the size in bytes, without any padding of a device.
    pub fn bytes(&self) -> u64 {
        self.shape.bytes()
    }
}

/// Holds a pass, and Vulkan's barriers before it, which are recorded as one call.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// At most one on all memory, which comes first, and one for each image that changes its layout. Those of one call do not
    /// form chains with each other.
    pub barriers: Vec<Barrier>,
    /// The pass.
    pub pass: PassId,
}

/// Orders earlier commands, at the source, before later ones, at the target, and their memory accesses with them.
///
/// The meaning is Vulkan's. Everything that the source stages and the stages before them did happens before
/// everything that the target stages and the stages after them will do, for all resources, and barriers whose scopes meet
/// form chains. Of the writes of the source stages themselves, those of the source accesses are made available; what is
/// available by then (from here, or from earlier in the chain) becomes visible to the target accesses of the target stages
/// themselves. Without an image this memory part holds for all memory, with one for accesses through that image only.
/// (Vulkan 1.3, chapter 7, "Synchronization and Cache Control".)
#[derive(Clone, Debug, PartialEq)]
pub struct Barrier {
    /// The image whose layout changes. The change is a write that happens between source and target, and is visible to the
    /// target.
    pub image: Option<Transition>,
    /// Stages to wait for.
    pub source_stages: Stages,
    /// Writes to make available.
    pub source_accesses: Accesses,
    /// Stages that wait.
    pub target_stages: Stages,
    /// Accesses that the writes become visible to.
    pub target_accesses: Accesses,
    /// The conflicts that it resolves, one entry per resource: never empty.
    pub causes: Vec<Cause>,
}

/// Orders an access of a later pass after one of an earlier pass, and shows it what that wrote.
///
/// Only accesses next to each other in time are listed. A read comes after the last write. A write comes after all reads since the last
/// write, or after that write if nothing has read it. All other order follows from chains of these.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependency {
    /// The kind of conflict; [`Hazard::LayoutChange`] where only the change of an image's layout waits, and not the pass itself.
    pub hazard: Hazard,
    /// The earlier pass.
    pub first: PassId,
    /// The later pass.
    pub second: PassId,
    /// Tells which run of the earlier pass it is.
    pub since: Since,
    /// The resource that the later pass accesses.
    pub resource: ResourceId,
    /// The resource that the earlier pass accessed, where it is another one in the same memory.
    pub alias: Option<ResourceId>,
    /// The smallest range of the resource that holds all bytes of the conflict.
    pub bytes: Range<u64>,
    /// The earlier accesses.
    pub source: Scope,
    /// The later accesses.
    pub target: Scope,
    /// The later pass finds the image in another layout, and the change of it waits for the earlier accesses.
    pub changes_layout: bool,
}

/// Lists stages of a pass, and accesses at these.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scope {
    /// The stages.
    pub stages: Stages,
    /// The accesses.
    pub accesses: Accesses,
}

/// Tells which run of the earlier pass a later one depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Since {
    /// Both run in the prologue, or in one frame.
    Same,
    /// The earlier pass runs in the prologue, the later one in the first frame.
    Prologue,
    /// The earlier pass runs in the frame before that of the later one.
    PreviousFrame,
}

/// Says that a pass needs an image in another layout than the passes before it left.
///
/// APIs without layouts ignore it. The change counts as a write of the whole image just before the pass. [`Dependency::changes_layout`] lists what it waits for, and
/// nothing where the image was never touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayoutChange {
    /// The image.
    pub image: ResourceId,
    /// The layout before; [`Layout::Undefined`] where the contents are not needed.
    pub old: Layout,
    /// The layout after.
    pub new: Layout,
    /// The pass that needs it.
    pub before: PassId,
    /// It happens once, between the prologue and the first frame, and brings the image to where a frame leaves it; `before` is the
    /// first pass of the frame that touches the image.
    pub handover: bool,
}

/// Changes an image's layout. `old` is [`Layout::Undefined`] where the contents are not needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Transition {
    /// The image.
    pub image: ResourceId,
    /// The layout before.
    pub old: Layout,
    /// The layout after.
    pub new: Layout,
}

/// Gives one reason for a barrier: the accesses of `after` conflict with those of `before`.
#[derive(Clone, Debug, PartialEq)]
pub struct Cause {
    /// The kind of conflict.
    pub hazard: Hazard,
    /// The pass that needs it: that of the step, or a later one that would otherwise need a call of its own. (It may be one at
    /// the start of the next frame, whose needs the last call of this one meets.)
    pub before: PassId,
    /// The resource that it accesses.
    pub resource: ResourceId,
    /// The passes that are waited for, the latest of each kind. Empty where an image was never touched.
    pub after: Vec<PassId>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they touched, where it is another one in the same memory.
    pub alias: Option<ResourceId>,
    /// The stages that this reason alone waits for.
    pub source_stages: Stages,
    /// Its writes to make available.
    pub source_accesses: Accesses,
    /// Its stages that wait.
    pub target_stages: Stages,
    /// Its accesses that the writes become visible to.
    pub target_accesses: Accesses,
}
