//! Defines passes: one dispatch, draw, fill or export each.
//!
//! A lowered pass has names of shaders (`S`), and numbers of invocations or workgroups (`G`). Linking replaces them by
//! the defaults: ids of shaders, and numbers of workgroups. A dump has names in place of ids of resources (`R`).

use serde::{Deserialize, Serialize};

use super::{Accesses, Blend, DepthAccess, Layout, Load, Origin, ResourceId, ShaderId, Stages, Topology};

/// Name of the pass at the end of a frame that makes the output readable by copies.
pub const EXPORT: &str = "export";

/// Name of the pass after the frame in which the host reads the statistics.
pub const HOST: &str = "host";

/// The frequency of a pass: once, or in every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Run {
    /// Once, in the prologue.
    Once,
    /// In every frame.
    Frame,
}

/// One dispatch, draw, fill or export.
#[derive(Clone, Debug, PartialEq)]
pub struct Pass<S = ShaderId, G = Groups> {
    /// Name, unique in the plan, for instance `sort.histogram[2]`.
    pub name: String,
    /// Group under which the pass's GPU time is summed: `key`, `sort`, `draw`, ...
    pub phase: String,
    /// Prologue or frame.
    pub run: Run,
    /// Command that the pass executes.
    pub work: Work<S, G>,
    /// The descriptors of set 0.
    pub bindings: Vec<Binding>,
    /// Push constant bytes, complete, little-endian; empty if the shaders take none.
    pub push: Vec<u8>,
    /// The accesses, one entry per resource and stage.
    pub uses: Vec<Use>,
    /// Position of the pass's declaration.
    pub origin: Origin,
}

impl Pass {
    /// Lists the resources that the pass names, some more than once.
    pub fn resources(&self) -> Vec<ResourceId> {
        let mut found = Vec::new();
        self.clone().visit(|id| found.push(*id), |_| {});
        found
    }

    /// Visits every resource and every shader that the pass names.
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
    /// Draws into `targets` and `depth`, all of one size, with a full-size viewport and scissor, without face culling.
    Draw {
        /// The vertex shader.
        vertex: S,
        /// The fragment shader.
        fragment: S,
        /// Primitives that the vertices form.
        topology: Topology,
        /// The number of vertices and instances.
        call: DrawCall,
        /// The colour attachments, in the order of the fragment shader's output locations.
        targets: Vec<Target>,
        /// The depth attachment; without one, every fragment passes.
        depth: Option<DepthTarget>,
    },
    /// Writes `value` to every 32-bit word of a buffer.
    Fill {
        /// Buffer to fill.
        buffer: ResourceId,
        /// Value of each word.
        value: u32,
    },
    /// Zeroes a resource with a history, in the prologue, so that the first frame finds zeros.
    ///
    /// If the history of an earlier plan continues, a backend omits this pass and the barrier on its image (but not its
    /// other barriers), and transitions the image to the layout that the pass would have left.
    ClearHistory {
        /// Buffer or image to zero.
        resource: ResourceId,
    },
    /// Copies the statistics, and makes the output readable by copies.
    Export,
    /// Represents the host's reading of the statistics; does nothing on the device.
    Host,
}

/// The number of workgroups of a dispatch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Groups {
    /// Workgroups in x, y, z, within the device's limits.
    ///
    /// An excess in x is folded into y: shaders compute their index as `gl_WorkGroupID.y * gl_NumWorkGroups.x +
    /// gl_WorkGroupID.x` and ignore indices beyond the end.
    Direct([u32; 3]),
    /// The numbers of workgroups in x, y and z are three words of a buffer.
    Indirect {
        /// Buffer that contains the words.
        buffer: ResourceId,
        /// Byte offset of the first word.
        offset: u64,
    },
}

/// The numbers of vertices and instances of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawCall {
    /// Numbers known when the plan is built.
    Direct {
        /// Number of vertices per instance.
        vertices: u32,
        /// Number of instances.
        instances: u32,
    },
    /// The numbers are four words of a buffer: vertices, instances, first vertex, first instance.
    Indirect {
        /// Buffer that contains the words.
        buffer: ResourceId,
        /// Byte offset of the first word.
        offset: u64,
    },
}

/// A colour attachment of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target<R = ResourceId> {
    /// Image that is drawn to.
    pub image: R,
    /// Contents of the target before the draw.
    pub load: Load,
    /// The blend mode.
    pub blend: Blend,
}

/// A depth attachment of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DepthTarget<R = ResourceId> {
    /// The image, of the format [`Format::Depth32Float`](super::Format::Depth32Float).
    pub image: R,
    /// Use of the image by the draw: test and write, or only test.
    pub access: DepthAccess,
}

impl<R> DepthTarget<R> {
    /// Returns the attachment with another kind of reference to the image.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> DepthTarget<T> {
        DepthTarget { image: resource(&self.image), access: self.access }
    }
}

impl<R> Target<R> {
    /// Returns the target with another kind of reference to the image.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> Target<T> {
        Target { image: resource(&self.image), load: self.load, blend: self.blend }
    }
}

/// A resource bound to a shader's block or image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Binding<R = ResourceId> {
    /// The name of the GLSL block or image.
    pub name: String,
    /// The binding number in set 0.
    pub binding: u32,
    /// Index in an array of descriptors, else 0.
    pub element: u32,
    /// The type of the descriptor.
    pub kind: DescriptorKind,
    /// Buffer or image that is bound.
    pub resource: R,
}

impl<R> Binding<R> {
    /// Returns the binding with another kind of reference to the resource.
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

/// A pass's accesses to a resource in one set of stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Use<R = ResourceId> {
    /// Buffer or image that is accessed.
    pub resource: R,
    /// The pipeline stages that access the resource.
    pub stages: Stages,
    /// The kinds of access.
    pub accesses: Accesses,
    /// The layout that an image must be in; `None` for buffers.
    pub layout: Option<Layout>,
    /// True if the earlier contents are not needed (a cleared attachment).
    pub discards: bool,
}

impl<R> Use<R> {
    /// Returns the use with another kind of reference to the resource.
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

/// A pass of the graph that is not in the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Culled {
    /// The pass's name.
    pub pass: String,
    /// The reason: the pass's `when` is false, or nothing reads its results.
    pub why: String,
    /// Position of the pass's declaration.
    #[serde(rename = "declared")]
    pub origin: Origin,
}

/// An image that a frame produces besides the picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// The name for users: `depth`.
    pub name: String,
    /// Image that contains the output.
    pub image: ResourceId,
}

/// A 32-bit word of a buffer that is read back after each frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stat<R = ResourceId> {
    /// Name of the statistic.
    pub name: String,
    /// Buffer that contains the word.
    pub buffer: R,
    /// Byte offset of the word.
    pub offset: u64,
}

impl<R> Stat<R> {
    /// Returns the statistic with another kind of reference to the buffer.
    pub fn map<T>(&self, resource: impl FnOnce(&R) -> T) -> Stat<T> {
        Stat { buffer: resource(&self.buffer), name: self.name.clone(), offset: self.offset }
    }
}
