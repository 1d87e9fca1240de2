//! The result of lowering: numbered resources, and a flat list of passes with their places in the files.

use std::collections::BTreeMap;
use std::rc::Rc;

use crate::ir::{
    Culled, DrawCall, Fallback, FileId, Output, Param, ParamSet, Reason, Run, Shape, Source, Span, Stat,
    Target, Topology, Value,
};

/// A lowered graph: only dispatches, draws and fills, in the order of the file.
#[derive(Clone, Debug)]
pub struct Lowered {
    /// The name under which the graph was requested.
    pub name: String,
    /// Summary of the outermost preset, or of the graph.
    pub summary: String,
    /// The chain of presets and choices that leads to it, the graph last; empty for a plain graph.
    pub based_on: Vec<String>,
    /// The graphs that a choice passed over, in order; the last one's fallback is this graph.
    pub fallbacks: Vec<Fallback>,
    /// Known values of scene, device and viewport.
    pub facts: BTreeMap<String, Value>,
    /// Parameters of the requested graph.
    pub params: Vec<Param>,
    /// Buffers and images, including those for the previous frame's contents.
    pub resources: Vec<LoweredResource>,
    /// Dispatches, draws and fills.
    pub passes: Vec<LoweredPass>,
    /// Passes that a `when` removed.
    pub culled: Vec<Culled>,
    /// The removed passes, with the parameters that they would use.
    pub removed: Vec<RemovedPass>,
    /// Uses of parameters in expressions that were not evaluated.
    pub skipped: Vec<SkippedUse>,
    /// Uses that a `when` removed together with their pass.
    pub unwritten: Vec<RemovedUse>,
    /// Included graphs, includers before their includes.
    pub includes: Vec<LoweredInclude>,
    /// The output image.
    pub output: ResourceHandle,
    /// The output's name in the file.
    pub output_span: Span,
    /// Images requested besides the output.
    pub outputs: Vec<Output<ResourceHandle>>,
    /// Words to read back.
    pub stats: Vec<Stat<ResourceHandle>>,
    /// The text of the generated include `live.glsl`.
    pub live_glsl: String,
    /// The uniform block of the live parameters.
    pub live: ResourceHandle,
    /// The parameters behind each live parameter: itself, and those that its default depends on.
    pub live_params: BTreeMap<String, ParamSet>,
    /// Parameters that conditions, counts of repeats and swaps depend on.
    pub shape: ParamSet,
    /// Parameters that the output and the statistics depend on.
    pub results: ParamSet,
}

/// A `let` or a parameter whose expression names parameters that its evaluation did not read.
#[derive(Clone, Debug)]
pub struct SkippedUse {
    /// The parameters that were not read.
    pub params: ParamSet,
    /// The name of the `let` or parameter.
    pub name: String,
    /// Its place in the file.
    pub span: Span,
    /// The parameters that were read.
    pub decided: ParamSet,
}

impl Lowered {
    /// Returns the resource behind a handle.
    pub fn resource(&self, handle: ResourceHandle) -> &LoweredResource {
        &self.resources[handle.index()]
    }

    /// Returns the handle that owns the memory: `handle` itself, unless it is a previous frame's contents.
    pub fn real(&self, handle: ResourceHandle) -> ResourceHandle {
        self.resource(handle).previous_frame_of.unwrap_or(handle)
    }
}

/// An index into [`Lowered::resources`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ResourceHandle(pub u32);

impl ResourceHandle {
    /// Returns the position in the list.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A buffer or an image. Each half of a ping-pong resource is one, named `keys#0` and `keys#1`.
#[derive(Clone, Debug)]
pub struct LoweredResource {
    /// Unique in the graph.
    pub name: String,
    /// The size.
    pub shape: Shape,
    /// The owner and writer.
    pub source: Source,
    /// The name under which its contents persist from frame to frame.
    pub history: Option<String>,
    /// For `last(name)`, the resource itself, or for a ping-pong resource the half in front at the end of the frame.
    /// Readers of `last(name)` run before this frame's writers.
    pub previous_frame_of: Option<ResourceHandle>,
    /// The declaration.
    pub span: Span,
    /// Parameters that the declaration depends on.
    pub params: ParamSet,
}

/// An included graph.
#[derive(Clone, Debug)]
pub struct LoweredInclude {
    /// Unique in the graph.
    pub name: String,
    /// Its `name` in the file.
    pub span: Span,
    /// The include that contains it, as an index into [`Lowered::includes`].
    pub parent: Option<usize>,
    /// The name of each port and its resources, both halves for a ping-pong buffer.
    pub given: Vec<(String, Vec<ResourceHandle>)>,
}

/// A use that was removed with its pass.
#[derive(Clone, Debug)]
pub struct RemovedUse {
    /// The resource.
    pub resource: ResourceHandle,
    /// The removed pass.
    pub pass: String,
    /// Its `when`.
    pub when: Span,
}

/// A removed pass, include, or pass of a repeat.
#[derive(Clone, Debug)]
pub struct RemovedPass {
    /// Its `when`, or its repeat's.
    pub condition: String,
    /// The condition in the file.
    pub when: Span,
    /// The reason why it is false; `None` if it uses no names.
    pub reason: Option<Reason>,
    /// Parameters that the condition depends on.
    pub decided: ParamSet,
    /// Parameters behind the names in its expressions.
    pub named: ParamSet,
    /// The graph file that declares it.
    pub file: FileId,
    /// File names of its shaders.
    pub shaders: Vec<String>,
    /// As in [`LoweredPass::constants`].
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

/// One dispatch, draw or fill; its shaders are names.
#[derive(Clone, Debug)]
pub struct LoweredPass {
    /// Unique in the graph.
    pub name: String,
    /// The group that its time is summed under.
    pub phase: String,
    /// Prologue or frame.
    pub run: Run,
    /// The graph file that declares it: shaders are searched beside it.
    pub file: FileId,
    /// Its `name` in the file.
    pub span: Span,
    /// The include that it comes from, as an index into [`Lowered::includes`].
    pub include: Option<usize>,
    /// The command.
    pub work: LoweredWork,
    /// The entries of `bind`.
    pub bind: Vec<LoweredBind>,
    /// The entries of `push`.
    pub push: Vec<LoweredPush>,
    /// Names and values of the defines: the constants of the scope.
    pub defines: Rc<Vec<(String, String)>>,
    /// Names (in capitals) and values of constants beyond 32 bits.
    pub unfit: Rc<Vec<(String, String)>>,
    /// Parameters that decide whether the pass exists, and which resources it uses.
    pub decided: ParamSet,
    /// Parameters that its numbers depend on: size, push constants, offsets, fill word.
    pub read: ParamSet,
    /// Parameters behind the constants that shaders can use.
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

/// A shader's name as written.
#[derive(Clone, Debug)]
pub struct ShaderName {
    /// The name.
    pub name: String,
    /// The name in the file.
    pub span: Span,
}

/// The command of a pass.
#[derive(Clone, Debug)]
pub enum LoweredWork {
    /// Runs a compute shader.
    Dispatch {
        /// The shader.
        shader: ShaderName,
        /// The number of invocations or workgroups.
        size: LoweredSize,
        /// The `size` in the file.
        size_span: Span,
    },
    /// Draws into images.
    Draw {
        /// The vertex shader.
        vertex: ShaderName,
        /// The fragment shader.
        fragment: ShaderName,
        /// The primitives.
        topology: Topology,
        /// The number of vertices and instances.
        call: DrawCall<ResourceHandle>,
        /// The `call` in the file.
        call_span: Span,
        /// The colour attachments, with their names in the file.
        targets: Vec<(Target<ResourceHandle>, Span)>,
    },
    /// Writes `value` to every 32-bit word of a buffer.
    Fill {
        /// The buffer.
        buffer: ResourceHandle,
        /// The word.
        value: u32,
    },
}

/// The size of a dispatch.
#[derive(Clone, Copy, Debug)]
pub enum LoweredSize {
    /// Invocations.
    Threads(Extent),
    /// Workgroups.
    Groups(Extent),
    /// Three words of a buffer.
    Indirect {
        /// The buffer.
        buffer: ResourceHandle,
        /// Byte offset of the first word.
        offset: u64,
    },
}

/// Counts in x, y and z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The counts; 1 in dimensions that are not given.
    pub size: [u64; 3],
    /// The number of given dimensions, 1 to 3.
    ///
    /// A single dimension may be folded into y.
    pub dimensions: usize,
}

/// Resources for a block: one for each element of its array, or a single one.
#[derive(Clone, Debug)]
pub struct LoweredBind {
    /// The block's name.
    pub block: String,
    /// The block's name in the file.
    pub block_span: Span,
    /// The resources.
    pub resources: Vec<ResourceHandle>,
    /// The resource's name in the file.
    pub resource_span: Span,
}

/// The value of a push constant.
#[derive(Clone, Debug)]
pub struct LoweredPush {
    /// The member's name.
    pub name: String,
    /// The value.
    pub value: Value,
    /// The name in the file.
    pub name_span: Span,
    /// The value in the file.
    pub value_span: Span,
}
