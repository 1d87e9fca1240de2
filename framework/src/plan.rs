//! The plan: what a backend executes, as plain data.
//!
//! A [`Plan`] names every resource with its size and its memory, every pass with its bindings, and two sequences of steps:
//! the prologue, which runs once after the plan or the scene changed, and the frame, which runs every time. A step is a
//! pass and the barriers that must be recorded just before it, in one call; the [handover](Plan::handover) is one more
//! call, between the prologue and the first frame. Every frame records the same barriers.
//!
//! Nothing in here belongs to one graphics API: the stages and access bits are named after Vulkan's synchronization2, which
//! is the finer of the two models, and a Metal backend maps them down.

use std::collections::BTreeMap;

use crate::ir::{
    Accesses, BlockId, Domain, Hazard, Layout, LeftOut, Origin, Param, ParamBinding, Pass, PassId,
    ResourceId, Shader, ShaderId, Shape, Source, Stages, Stat, Usage, Value,
};

/// What a backend executes. See the module's documentation.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The name that the graph was asked for by: a preset's name or a path.
    pub name: String,
    pub summary: String,
    /// The facts of the scene, the device and the viewport that the plan was built from.
    pub facts: BTreeMap<String, Value>,
    pub params: Vec<Param>,
    pub resources: Vec<Resource>,
    pub shaders: Vec<Shader>,
    pub passes: Vec<Pass>,
    /// The memory of the transient resources. Each stands in one block, alone or with others that are never alive at the
    /// same time.
    pub blocks: Vec<Block>,
    /// Runs once after the plan or the scene changed.
    pub prologue: Vec<Step>,
    /// Recorded once, as one call, between the prologue and the first frame: shows the frames what the prologue wrote, and
    /// brings images into the layouts that they are in between frames.
    pub handover: Vec<Barrier>,
    /// Runs every frame, after the handover or after the frame before.
    pub frame: Vec<Step>,
    /// Passes of the file that are not in the plan because nothing reads what they write, or their `when` is false.
    pub left_out: Vec<LeftOut>,
    /// The image that is shown or saved. A [`Work::Export`] pass at the end of the frame leaves it in
    /// [`Layout::TransferSource`], readable by [`Stages::COPY`].
    pub output: ResourceId,
    /// Numbers that the GPU computes and people want to see: 32-bit words of buffers. The export copies them to the resource
    /// with [`Source::Readback`], one after another, and the frame's last step, [`Work::Host`], is the host reading them there.
    /// A plan without any has neither.
    pub stats: Vec<Stat>,
}

impl Plan {
    pub fn resource(&self, id: ResourceId) -> &Resource {
        &self.resources[id.index()]
    }

    pub fn pass(&self, id: PassId) -> &Pass {
        &self.passes[id.index()]
    }

    pub fn shader(&self, id: ShaderId) -> &Shader {
        &self.shaders[id.index()]
    }

    /// The resource of this name, for instance `"keys#0"`.
    pub fn find_resource(&self, name: &str) -> Option<ResourceId> {
        self.resources.iter().position(|r| r.name == name).map(|i| ResourceId(i as u32))
    }

    /// The bytes of the live uniform block, from the parameters' values; empty where no pass reads it. A choice is the index of its
    /// name, a bool 0 or 1.
    pub fn live_bytes(&self) -> Vec<u8> {
        self.live_bytes_of(&self.params)
    }

    /// The same with other values: `params` are the plan's own, some of the live ones changed.
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

    /// Bytes of the memory blocks: what the plan itself owns, not the scene's. (A device may round images up.)
    pub fn transient_bytes(&self) -> u64 {
        let largest = |block: &Block| block.tenants.iter().map(|id| self.resource(*id).bytes()).max();
        self.blocks.iter().filter_map(largest).sum()
    }

    /// Bytes that the same resources would take if each had memory of its own.
    pub fn unshared_bytes(&self) -> u64 {
        self.resources.iter().filter(|r| r.source == Source::Transient).map(Resource::bytes).sum()
    }

    /// The resources that stand in the same memory as this one, itself left out.
    pub fn aliases(&self, id: ResourceId) -> impl Iterator<Item = ResourceId> + '_ {
        let block = self.resource(id).block.map(|block| &self.blocks[block.index()]);
        block.into_iter().flat_map(|block| &block.tenants).copied().filter(move |other| *other != id)
    }
}

/// A buffer or an image. Ping-pong resources appear as two, named `keys#0` and `keys#1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Resource {
    pub name: String,
    pub shape: Shape,
    pub usage: Usage,
    pub source: Source,
    /// Where a transient resource stands; `None` for all others.
    pub block: Option<BlockId>,
    /// The name under which its contents live on from frame to frame, and from one plan to the next that has a history of the
    /// same name and shape. (Of a ping-pong resource, only the half that the frame ends with as its front has it.)
    pub history: Option<String>,
    pub origin: Origin,
}

/// A piece of memory, as large as its largest tenant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// Resources that stand at the block's start. Of several, only one is alive at any time: from its first use in a frame,
    /// before which its contents are undefined, to its last.
    pub tenants: Vec<ResourceId>,
}

impl Resource {
    /// Returns the size in bytes, without any padding of a device.
    pub fn bytes(&self) -> u64 {
        self.shape.bytes()
    }
}

/// Barriers, recorded together as one call, and then a pass.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// At most one on all memory, which comes first, and one for each image that changes its layout. Those of one call do not
    /// form chains with each other.
    pub barriers: Vec<Barrier>,
    pub pass: PassId,
}

/// Order between what came before, at the source, and what comes after, at the target; and with it, memory.
///
/// It means what it means in Vulkan. Everything that the source stages and the stages before them did happens before
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
    pub source_stages: Stages,
    pub source_accesses: Accesses,
    pub target_stages: Stages,
    pub target_accesses: Accesses,
    /// What it stands against, one entry per resource: never empty.
    pub dependencies: Vec<Dependency>,
}

/// A change of an image's layout. `old` is [`Layout::Undefined`] where the contents are not needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    pub image: ResourceId,
    pub old: Layout,
    pub new: Layout,
}

/// One reason for a barrier: what `after` did, and what `before` is about to do.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependency {
    pub hazard: Hazard,
    /// The pass that needs it: that of the step, or a later one that would otherwise need a call of its own. (It may be one at
    /// the start of the next frame, whose needs the last call of this one meets.)
    pub before: PassId,
    /// What that pass touches.
    pub resource: ResourceId,
    /// The passes that are waited for, the latest of each kind. Empty where an image was never touched.
    pub after: Vec<PassId>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they touched, where it is another one in the same memory.
    pub alias: Option<ResourceId>,
    /// What this reason alone asks of the barrier.
    pub source_stages: Stages,
    pub source_accesses: Accesses,
    pub target_stages: Stages,
    pub target_accesses: Accesses,
}
