//! Defines passes: the dispatches, draws and fills of a graph, and the steps that solving adds.
//!
//! The type parameters follow a pass through the steps. A lowered pass has shader names (`S`) and sizes in invocations
//! or workgroups (`G`); linking replaces them by ids and workgroup counts. A dump has names for resource ids (`R`).

use serde::{Deserialize, Serialize};

use super::{Accesses, Blend, DepthAccess, Layout, Load, Origin, ResourceId, ShaderId, Stages, Topology};

/// Name of the pass at the end of a frame that makes the output readable by copies.
pub const EXPORT: &str = "export";

/// Name of the last pass of a frame, in which the host reads the statistics.
pub const HOST: &str = "host";

/// When a pass runs: once, or every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Run {
    /// Once, in the prologue: after the plan or the scene changes.
    Once,
    /// Every frame.
    Frame,
}

/// A step of a plan: a command of the device, the export, or the host's read of the statistics.
#[derive(Clone, Debug, PartialEq)]
pub struct Pass<S = ShaderId, G = Groups> {
    /// Name, unique in the plan, for instance `sort.histogram[2]`.
    pub name: String,
    /// Label by which GPU times are summed: `key`, `sort`, `draw`, ...
    pub phase: String,
    /// When the pass runs: once, in the prologue, or every frame.
    pub run: Run,
    /// The command that the pass executes.
    pub work: Work<S, G>,
    /// Descriptors of set 0.
    pub bindings: Vec<Binding>,
    /// Push constant bytes, little-endian, filled in completely; empty if the shaders take none.
    pub push: Vec<u8>,
    /// Memory accesses, one entry per resource and set of stages.
    pub uses: Vec<Use>,
    /// Position of the pass's declaration.
    pub origin: Origin,
}

impl Pass {
    /// Lists the resources that the pass uses; some appear more than once.
    pub fn resources(&self) -> Vec<ResourceId> {
        let mut found = Vec::new();
        self.clone().visit(|id| found.push(*id), |_| {});
        found
    }

    /// Returns true if the pass, which uses a resource, is known to overwrite it completely, without reading it.
    ///
    /// A fill and a cleared target overwrite everything; a shader is never assumed to.
    pub fn overwrites(&self, resource: ResourceId) -> bool {
        let mut uses = self.uses.iter().filter(|touch| touch.resource == resource);
        let fills = matches!(self.work, Work::Fill { .. });
        uses.all(|touch| !touch.accesses.reads() && (fills || touch.discards))
    }

    /// Calls `resource` and `shader` with a mutable reference to every id in the pass.
    pub fn visit(
        &mut self,
        mut resource: impl FnMut(&mut ResourceId),
        mut shader: impl FnMut(&mut ShaderId),
    ) {
        self.uses.iter_mut().for_each(|used| resource(&mut used.resource));
        self.bindings.iter_mut().for_each(|binding| resource(&mut binding.resource));
        match &mut self.work {
            Work::Dispatch { shader: of, groups } => {
                shader(of);
                if let Groups::Indirect { buffer, .. } = groups {
                    resource(buffer);
                }
            }
            Work::Draw { vertex, fragment, call, targets, depth, .. } => {
                [vertex, fragment].into_iter().for_each(shader);
                if let DrawCall::Indirect { buffer, .. } = call {
                    resource(buffer);
                }
                targets.iter_mut().for_each(|target| resource(&mut target.image));
                depth.iter_mut().for_each(|depth| resource(&mut depth.image));
            }
            Work::Fill { buffer: id, .. } | Work::ClearHistory { resource: id } => resource(id),
            Work::Export | Work::Host => {}
        }
    }
}

/// The command of a pass.
#[derive(Clone, Debug, PartialEq)]
pub enum Work<S = ShaderId, G = Groups> {
    /// Runs a compute shader.
    Dispatch {
        /// The compute shader.
        shader: S,
        /// The number of workgroups.
        groups: G,
    },
    /// Draws into `targets` and `depth`, which all have one size. Viewport and scissor have this size, too. Faces are
    /// not culled.
    Draw {
        /// The vertex shader.
        vertex: S,
        /// The fragment shader.
        fragment: S,
        /// Primitives that the vertices form.
        topology: Topology,
        /// Vertex and instance counts.
        call: DrawCall,
        /// The colour attachments, in the order of the fragment shader's output locations.
        targets: Vec<Target>,
        /// The depth attachment. `None` disables the depth test: every fragment passes.
        depth: Option<DepthTarget>,
    },
    /// Writes `value` to every 32-bit word of a buffer.
    Fill {
        /// The buffer to fill.
        buffer: ResourceId,
        /// The value of each word.
        value: u32,
    },
    /// Zeroes a resource with a history, in the prologue, so that the first frame reads zeros.
    ///
    /// If the resource inherits the history of an earlier plan, the backend omits this pass and the barrier on its
    /// image, and transitions the image to the layout that the pass would have left. The pass's other barriers remain.
    ClearHistory {
        /// The buffer or image to zero.
        resource: ResourceId,
    },
    /// Copies the statistics to the readback buffer, and makes the output and the requested outputs readable by copies.
    Export,
    /// Marks the point where the host reads the statistics. No device command.
    Host,
}

impl<S, G> Work<S, G> {
    /// Lists the shaders that the command runs, in the order of their stages.
    pub fn shaders(&self) -> Vec<&S> {
        match self {
            Work::Dispatch { shader, .. } => vec![shader],
            Work::Draw { vertex, fragment, .. } => vec![vertex, fragment],
            Work::Fill { .. } | Work::ClearHistory { .. } | Work::Export | Work::Host => vec![],
        }
    }
}

/// The number of workgroups of a dispatch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Groups {
    /// Workgroup counts in x, y, z, within the device's limits.
    ///
    /// If a graph gives one dimension, a count beyond the limit in x is folded into y. The shader then computes its
    /// index as `gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x` and ignores indices beyond the end.
    Direct([u32; 3]),
    /// Workgroup counts in x, y and z, read by the GPU from three consecutive 32-bit words.
    Indirect {
        /// The buffer that contains the words.
        buffer: ResourceId,
        /// Byte offset of the first word.
        offset: u64,
    },
}

/// Vertex and instance counts of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawCall {
    /// Counts known when the plan is built.
    Direct {
        /// Number of vertices per instance.
        vertices: u32,
        /// Number of instances.
        instances: u32,
    },
    /// Counts read by the GPU from four 32-bit words: vertices, instances, first vertex, first instance. The last must
    /// be 0 on a device without Vulkan's `drawIndirectFirstInstance`.
    Indirect {
        /// The buffer that contains the words.
        buffer: ResourceId,
        /// Byte offset of the first word.
        offset: u64,
    },
}

/// A colour attachment of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target<R = ResourceId> {
    /// The image to draw into.
    pub image: R,
    /// Contents at the start of the draw.
    pub load: Load,
    /// Blending of fragments with the image.
    pub blend: Blend,
}

/// A depth attachment of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DepthTarget<R = ResourceId> {
    /// The image, of the format [`Format::Depth32Float`](super::Format::Depth32Float).
    pub image: R,
    /// Access of the draw to the depth image: clear and write, test and write, or test.
    pub access: DepthAccess,
}

impl<R> DepthTarget<R> {
    /// Maps the image reference, for instance from an id to a name.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> DepthTarget<T> {
        DepthTarget { image: resource(&self.image), access: self.access }
    }
}

impl<R> Target<R> {
    /// Maps the image reference, for instance from an id to a name.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> Target<T> {
        Target { image: resource(&self.image), load: self.load, blend: self.blend }
    }
}

/// A resource bound to a shader's block or image variable.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Binding<R = ResourceId> {
    /// The name of the GLSL block or image.
    pub name: String,
    /// The binding number in set 0.
    pub binding: u32,
    /// Index in an array of descriptors; 0 if the binding is not an array.
    pub element: u32,
    /// The type of the descriptor.
    pub kind: DescriptorKind,
    /// The bound buffer or image.
    pub resource: R,
}

impl<R> Binding<R> {
    /// Maps the resource reference, for instance from an id to a name.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> Binding<T> {
        Binding {
            resource: resource(&self.resource),
            name: self.name.clone(),
            binding: self.binding,
            element: self.element,
            kind: self.kind,
        }
    }
}

/// Type of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DescriptorKind {
    /// A storage buffer.
    StorageBuffer,
    /// A uniform block.
    UniformBuffer,
    /// A storage image.
    StorageImage,
}

/// The accesses of a pass to one resource, in one set of stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Use<R = ResourceId> {
    /// The accessed buffer or image.
    pub resource: R,
    /// The pipeline stages that access the resource.
    pub stages: Stages,
    /// The kinds of access.
    pub accesses: Accesses,
    /// The layout that an image must be in; `None` for buffers.
    pub layout: Option<Layout>,
    /// True if the pass clears the attachment or history first: earlier contents may be discarded. False for fills.
    pub discards: bool,
}

impl<R> Use<R> {
    /// Maps the resource reference, for instance from an id to a name.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> Use<T> {
        Use {
            resource: resource(&self.resource),
            stages: self.stages,
            accesses: self.accesses,
            layout: self.layout,
            discards: self.discards,
        }
    }
}

/// A pass or an include that the graph declares and the plan omits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Culled {
    /// Name of the pass or include.
    pub pass: String,
    /// The reason: a `when` is false, the count of a `Repeat` is 0, or nothing reads the pass's results.
    pub why: String,
    /// Position of the declaration.
    #[serde(rename = "declared")]
    pub origin: Origin,
}

impl Culled {
    /// Reason for a pass whose results nothing reads.
    pub const UNREAD: &str = "nothing reads what it writes";
}

/// An image that a frame produces besides the main one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// Name under which a user requests it, such as `depth`.
    pub name: String,
    /// The image that contains the output.
    pub image: ResourceId,
}

/// A 32-bit word of a buffer that is read back after each frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stat<R = ResourceId> {
    /// Name of the statistic, as declared by the graph. If an earlier statistic has this name, the name of the include
    /// is before it.
    pub name: String,
    /// The buffer that contains the word.
    pub buffer: R,
    /// Byte offset of the word.
    pub offset: u64,
    /// The parameters that grow with the statistic.
    #[serde(default)]
    pub grows: Vec<String>,
}

impl<R> Stat<R> {
    /// Maps the buffer reference, for instance from an id to a name.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> Stat<T> {
        Stat {
            buffer: resource(&self.buffer),
            name: self.name.clone(),
            offset: self.offset,
            grows: self.grows.clone(),
        }
    }
}
