//! The plan: what a backend executes, as plain data.
//!
//! A [`Plan`] names every resource with its size and its memory, every pass with its bindings, and two sequences of steps:
//! the prologue, which runs once after the plan or the scene changed, and the frame, which runs every time. A step is a
//! pass and the barriers that must be recorded just before it, in one call; the [handover](Plan::handover) is one more
//! call, between the prologue and the first frame. Every frame records the same barriers.
//!
//! Nothing in here belongs to one graphics API: the stages and access bits are named after Vulkan's synchronization2, which
//! is the finer of the two models, and a Metal backend maps them down.

use bitflags::bitflags;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use crate::shader::Reflection;

/// Version of the plan's serialised form. Raised when a field changes its meaning.
pub const PLAN_VERSION: u32 = 2;

/// A value that a parameter, a fact or an expression can have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Value::Bool(v) => write!(f, "{v}"),
            Value::Int(v) => write!(f, "{v}"),
            Value::Float(v) => write!(f, "{v:?}"),
            Value::Text(v) => write!(f, "{v}"),
        }
    }
}

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub struct $name(pub u32);
        impl $name {
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    };
}
id!(/// Index into [`Plan::resources`].
    ResourceId);
id!(/// Index into [`Plan::passes`].
    PassId);
id!(/// Index into [`Plan::shaders`].
    ShaderId);
id!(/// Index into [`Plan::blocks`].
    BlockId);

/// Where in a graph file something was declared. Lines and columns count from 1; columns count characters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origin {
    pub file: String,
    pub line: u32,
    pub column: u32,
}

/// What a backend executes. See the module's documentation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    pub version: u32,
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
    pub fn live_bytes_of(&self, params: &[Param]) -> Vec<u8> {
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

/// A parameter that the graph declared, with the value that this plan was built with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Param {
    pub name: String,
    pub label: String,
    pub help: String,
    pub value: Value,
    pub default: Value,
    /// The value that costs no accuracy, where the graph names one.
    pub exact: Option<Value>,
    pub domain: Domain,
    /// A constant is baked into the plan and the shaders; a live parameter is a member of the live uniform block.
    pub binding: ParamBinding,
    pub origin: Origin,
}

/// The values that a parameter may take. Ranges are inclusive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Domain {
    Bool,
    Int { min: i64, max: i64 },
    Float { min: f64, max: f64, step: f64 },
    Choice(Vec<String>),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ParamBinding {
    Const,
    /// Byte offset in the live uniform block (every member is 4 bytes: float, int, or uint for a bool).
    Live {
        offset: u32,
    },
}

/// A buffer or an image. Ping-pong resources appear as two, named `keys#0` and `keys#1`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Block {
    /// Resources that stand at the block's start. Of several, only one is alive at any time: from its first use in a frame,
    /// before which its contents are undefined, to its last.
    pub tenants: Vec<ResourceId>,
}

impl Resource {
    pub fn bytes(&self) -> u64 {
        match self.shape {
            Shape::Buffer { stride, count } => stride * count,
            Shape::Image { format, width, height } => {
                format.bytes_per_pixel() as u64 * width as u64 * height as u64
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// `stride` is bytes per element. `stride * count` is never 0.
    Buffer {
        stride: u64,
        count: u64,
    },
    Image {
        format: Format,
        width: u32,
        height: u32,
    },
}

/// Who owns the memory behind a resource, and who fills it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// Owned by the plan, written by its passes. One copy, whatever the number of frames in flight.
    Transient,
    /// An attribute of the scene, uploaded before the prologue runs and never written by a pass. Attributes larger
    /// than a storage binding may be are split into planes.
    Scene { attribute: String, plane: u32 },
    /// A uniform block that the host writes for every frame, one copy per frame in flight.
    Frame { uniform: String },
    /// A storage buffer that comes with every frame and is as long as that frame makes it: words of the host, or the picture
    /// that another plan drew on the same device. No pass writes it. Its shape is the least that it holds.
    Given { buffer: String },
    /// The uniform block of the live parameters; like `Frame`, laid out by [`Plan::params`].
    Live,
    /// Host memory that the export writes and the host reads when the frame is done, one copy per frame in flight: the
    /// words of [`Plan::stats`].
    Readback,
}

impl Source {
    /// Whether there is a copy for each frame in flight.
    pub fn is_per_frame(&self) -> bool {
        matches!(self, Source::Frame { .. } | Source::Given { .. } | Source::Live | Source::Readback)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Format {
    Rgba8Unorm,
    Rgba16Float,
    Rgba32Float,
    R32Uint,
    R32Float,
}

impl Format {
    pub const ALL: [Format; 5] =
        [Format::Rgba8Unorm, Format::Rgba16Float, Format::Rgba32Float, Format::R32Uint, Format::R32Float];

    /// The name that GLSL has for it, which is also what graphs write.
    pub fn name(self) -> &'static str {
        match self {
            Format::Rgba8Unorm => "rgba8",
            Format::Rgba16Float => "rgba16f",
            Format::Rgba32Float => "rgba32f",
            Format::R32Uint => "r32ui",
            Format::R32Float => "r32f",
        }
    }

    pub fn bytes_per_pixel(self) -> u32 {
        match self {
            Format::Rgba8Unorm | Format::R32Uint | Format::R32Float => 4,
            Format::Rgba16Float => 8,
            Format::Rgba32Float => 16,
        }
    }
}

bitflags! {
    /// What a resource is used for: the union over the plan's passes.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    pub struct Usage: u32 {
        const STORAGE = 1;
        const UNIFORM = 1 << 1;
        const INDIRECT = 1 << 2;
        const COPY_SOURCE = 1 << 3;
        const COPY_TARGET = 1 << 4;
        const COLOR_TARGET = 1 << 5;
    }

    /// Pipeline stages, after VkPipelineStageFlagBits2.
    ///
    /// Some follow each other within a command, and barriers know it: `INDIRECT`, `VERTEX`, `FRAGMENT`, `COLOR_OUTPUT` for
    /// draws, and `INDIRECT`, `COMPUTE` for dispatches. `COPY`, `CLEAR` and `HOST` stand alone. See [`Barrier`].
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
    pub struct Stages: u32 {
        const INDIRECT = 1;
        const VERTEX = 1 << 1;
        const FRAGMENT = 1 << 2;
        const COLOR_OUTPUT = 1 << 3;
        const COMPUTE = 1 << 4;
        const COPY = 1 << 5;
        const CLEAR = 1 << 6;
        const HOST = 1 << 7;
    }

    /// Kinds of memory access, after VkAccessFlagBits2.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
    pub struct Accesses: u32 {
        const INDIRECT_READ = 1;
        const UNIFORM_READ = 1 << 1;
        const STORAGE_READ = 1 << 2;
        const STORAGE_WRITE = 1 << 3;
        const COLOR_READ = 1 << 4;
        const COLOR_WRITE = 1 << 5;
        const TRANSFER_READ = 1 << 6;
        const TRANSFER_WRITE = 1 << 7;
        const HOST_READ = 1 << 8;
    }
}

impl Accesses {
    pub const WRITES: Accesses =
        Accesses::STORAGE_WRITE.union(Accesses::COLOR_WRITE).union(Accesses::TRANSFER_WRITE);

    pub fn writes(self) -> bool {
        self.intersects(Self::WRITES)
    }

    pub fn reads(self) -> bool {
        !self.difference(Self::WRITES).is_empty()
    }
}

/// The layout of an image at one point of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Layout {
    /// Contents need not be kept.
    Undefined,
    /// Storage image.
    General,
    ColorTarget,
    TransferSource,
    TransferTarget,
}

/// A compiled shader module with the defines it was compiled with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shader {
    /// Path as the graph names it, for instance `sort/scatter.comp`.
    pub name: String,
    pub defines: Vec<(String, String)>,
    /// SPIR-V words. Left out of dumps.
    #[serde(skip)]
    pub spirv: Arc<Vec<u32>>,
    pub reflection: Reflection,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Run {
    /// In the prologue.
    Once,
    /// In every frame.
    Frame,
}

/// One dispatch, draw, fill or export.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pass {
    /// Unique in the plan, for instance `sort.histogram[2]`.
    pub name: String,
    /// The group under which its time is summed: `key`, `sort`, `draw`, ...
    pub phase: String,
    pub run: Run,
    pub work: Work,
    /// What is bound in descriptor set 0.
    pub bindings: Vec<Binding>,
    /// Push constant bytes, complete, little-endian; empty if the shaders take none.
    pub push: Vec<u8>,
    /// What the pass touches, one entry per resource and stage.
    pub touches: Vec<Touch>,
    pub origin: Origin,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Work {
    Dispatch {
        shader: ShaderId,
        groups: Groups,
    },
    /// Draws into `targets` (all of the same size, full-size viewport and scissor, no depth, no culling of faces).
    Draw {
        vertex: ShaderId,
        fragment: ShaderId,
        topology: Topology,
        call: DrawCall,
        targets: Vec<Target>,
    },
    /// Writes `value` to every 32-bit word of a buffer.
    Fill {
        buffer: ResourceId,
        value: u32,
    },
    /// Zeros for a resource with a history, in the prologue: what its first frame finds. Where the history of a former plan lives
    /// on, a backend leaves this pass out together with the barrier on its image (not the others of its step), and brings the
    /// image into the layout that the pass would have left it in.
    Start {
        resource: ResourceId,
    },
    /// The output and the statistics become readable by copies; the statistics are copied.
    Export,
    /// Nothing on the device: the host reads the statistics.
    Host,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Groups {
    /// Workgroups in x, y, z, within the device's limits. More than fit in x are folded into y: shaders compute
    /// their index as `gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x` and ignore what is beyond the end.
    Direct([u32; 3]),
    /// Three words at a byte offset of a buffer.
    Indirect { buffer: ResourceId, offset: u64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DrawCall {
    Direct {
        vertices: u32,
        instances: u32,
    },
    /// Four words at a byte offset of a buffer: vertices, instances, first vertex, first instance.
    Indirect {
        buffer: ResourceId,
        offset: u64,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Topology {
    TriangleList,
    TriangleStrip,
}

/// A colour attachment, in the order of the fragment shader's output locations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target {
    pub image: ResourceId,
    pub load: Load,
    pub blend: Blend,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Load {
    Clear(f32, f32, f32, f32),
    Keep,
}

/// How a fragment is combined with what is there. `s` is the shader's output, `d` the attachment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Blend {
    /// `d = s`
    Replace,
    /// Back to front, `s` premultiplied: `d = s + (1 - s.a) d`.
    PremultipliedOver,
    /// Front to back, `s` premultiplied, `d.a` holds the transmittance (cleared to 1):
    /// `d.rgb = d.a s.rgb + d.rgb`, `d.a = (1 - s.a) d.a`.
    TransmittanceUnder,
}

/// One descriptor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Binding {
    /// The name of the GLSL block or image.
    pub name: String,
    pub binding: u32,
    /// Index in an array of descriptors, 0 where there is none.
    pub element: u32,
    pub kind: DescriptorKind,
    pub resource: ResourceId,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DescriptorKind {
    StorageBuffer,
    UniformBuffer,
    StorageImage,
}

/// How a pass touches a resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Touch {
    pub resource: ResourceId,
    pub stages: Stages,
    pub accesses: Accesses,
    /// The layout that an image must be in; `None` for buffers.
    pub layout: Option<Layout>,
    /// True where nothing of the former contents is needed (an attachment that is cleared).
    pub discards: bool,
}

/// Barriers, recorded together as one call, and then a pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    pub image: ResourceId,
    pub old: Layout,
    pub new: Layout,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Hazard {
    ReadAfterWrite,
    WriteAfterRead,
    WriteAfterWrite,
    /// Only the image's layout changes.
    LayoutChange,
}

/// One reason for a barrier: what `after` did, and what `before` is about to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    pub pass: String,
    pub why: String,
    pub origin: Origin,
}

/// A 32-bit word of a buffer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stat {
    pub name: String,
    pub buffer: ResourceId,
    /// Byte offset.
    pub offset: u64,
}
