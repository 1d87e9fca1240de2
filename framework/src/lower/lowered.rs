//! Defines the result of lowering: numbered resources, and a flat list of passes with their places in the files.

use std::collections::BTreeMap;
use std::ops::Range;
use std::rc::Rc;

use crate::ir::{FileId, ParamSet, Pass, Reason, ResourceId, Span, Value};
use crate::plan::Plan;
use crate::source::Diagnostic;

/// A lowered graph: only dispatches, draws and fills, in the order of the file.
#[derive(Clone, Debug, Default)]
pub struct Lowered {
    /// The plan so far: names, parameters, resources and results. It has no passes and no shaders yet.
    pub plan: Plan,
    /// The declarations of the plan's resources, in the same order.
    pub declarations: Vec<Declaration>,
    /// The passes that were not removed, with `repeat`s unrolled.
    pub passes: Vec<LoweredPass>,
    /// The removed passes and includes, with the parameters that they would use.
    pub removed: Vec<RemovedPass>,
    /// The shaders of removed passes, with the files that name them.
    pub removed_shaders: Vec<(FileId, ShaderName)>,
    /// `let`s and parameters whose expressions name parameters that their evaluation did not read.
    pub skipped: Vec<SkippedUse>,
    /// Resources that the removed passes and includes would use.
    pub unwritten: Vec<RemovedUse>,
    /// Outputs besides the picture that included graphs draw on request: images, and names of the outputs.
    pub offered: Vec<(ResourceId, String)>,
    /// Included graphs, includers before their includes.
    pub includes: Vec<LoweredInclude>,
    /// The halves of each ping-pong buffer. The first is the front at the start of the graph.
    pub ping_pongs: Vec<[ResourceId; 2]>,
    /// For each ping-pong buffer, the number of its swaps.
    pub swaps: Vec<usize>,
    /// Ping-pong buffers that a repeat uses, and of which every iteration has the same half in front.
    pub unswapped: Vec<Unswapped>,
    /// Warnings about sizes of dispatches and draws. Either a size is 0 in every plan, or a dispatch was folded into
    /// rows and its shader cannot tell the rows apart.
    pub sizes: Vec<Diagnostic>,
    /// Place of the output's name in the file.
    pub output_span: Span,
    /// Places of the requested outputs besides the picture, in the order of the plan's.
    pub more_output_spans: Vec<Span>,
    /// Places of the plan's statistics in the file, in the same order.
    pub stat_spans: Vec<Span>,
    /// The uniform block of the live parameters.
    pub live: ResourceId,
    /// For each live parameter, the parameter itself and those that its value depends on.
    pub live_params: BTreeMap<String, ParamSet>,
    /// Parameters that decide which passes exist: those that conditions and counts of repeats depend on.
    pub shape: ParamSet,
    /// Parameters that the output and the statistics depend on.
    pub results: ParamSet,
}

/// A `let` or a parameter whose expression names parameters that its evaluation did not read.
#[derive(Clone, Debug)]
pub struct SkippedUse {
    /// The parameters that were not read.
    pub params: ParamSet,
    pub name: String,
    /// Place of the `let` or parameter in the file.
    pub span: Span,
    /// The parameters that were read.
    pub decided: ParamSet,
    /// The reason for the value; `None` if it uses no names.
    pub reason: Option<Reason>,
}

impl Lowered {
    pub fn declaration(&self, id: ResourceId) -> &Declaration {
        &self.declarations[id.index()]
    }

    /// Returns the resource that owns the memory of `id`: `id` itself, or for `last(name)` the resource `name`.
    pub fn real(&self, id: ResourceId) -> ResourceId {
        self.declaration(id).previous_frame_of.unwrap_or(id)
    }
}

#[derive(Clone, Debug)]
pub struct Declaration {
    pub span: Span,
    /// For `last(name)`, the resource `name`, or the half that is in front at the end of a frame; otherwise `None`.
    ///
    /// Readers of `last(name)` run before this frame's writers.
    pub previous_frame_of: Option<ResourceId>,
    /// Parameters that the declaration depends on.
    pub params: ParamSet,
}

#[derive(Clone, Debug)]
pub struct LoweredInclude {
    /// Name of the include, unique in the graph.
    pub name: String,
    /// Place of the include's `name` in the file.
    pub span: Span,
    /// The include that contains this one, as an index into [`Lowered::includes`]; `None` in the root graph.
    pub parent: Option<usize>,
    /// For each port, the includer's name of the bound resource, and its ids: both halves of a ping-pong buffer.
    pub given: Vec<(String, Vec<ResourceId>)>,
}

/// A ping-pong buffer of which a repeat uses both halves, with the same half in front at the start of its iterations.
#[derive(Clone, Debug)]
pub struct Unswapped {
    /// Index into [`Lowered::ping_pongs`].
    pub pair: usize,
    pub front: ResourceId,
    pub back: ResourceId,
    /// Number of swaps in the repeat.
    pub swaps: usize,
    /// Indices of the passes of the repeat's first two iterations.
    pub passes: [Range<usize>; 2],
}

/// A use that was removed with its pass or include.
#[derive(Clone, Debug)]
pub struct RemovedUse {
    pub resource: ResourceId,
    /// Name of the removed pass or include.
    pub pass: String,
    /// Place of the false `when` of the pass or include, or of the count of the repeat around it.
    pub when: Span,
    /// The value at that place: `false` or `0`.
    pub value: &'static str,
}

/// A pass or an include that was removed because its `when` is false, or because its repeat has a count of 0.
#[derive(Clone, Debug)]
pub struct RemovedPass {
    /// Condition under which the pass would exist, on one line: `` `n > 0` `` or `` `n` is above 0``.
    pub condition: String,
    /// Place of the `when` or the count in the file.
    pub when: Span,
    /// The reason for the value of the `when` or the count; `None` if it uses no names.
    pub reason: Option<Reason>,
    /// Parameters that the condition depends on.
    pub decided: ParamSet,
    /// Parameters that the names in the pass's expressions depend on. Linking adds those that its shaders mention.
    pub named: ParamSet,
    /// The graph file that declares the pass.
    pub file: FileId,
    /// File names of the pass's shaders.
    pub shaders: Vec<String>,
    /// Parameters that each constant depends on; see [`LoweredPass::constants`].
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

/// A dispatch, a draw or a fill, with its places in the file.
#[derive(Clone, Debug)]
pub struct LoweredPass {
    /// The pass. Linking adds its bindings, push constants and uses.
    pub pass: Pass<ShaderName, LoweredSize>,
    /// The graph file that declares the pass. Its shaders are looked up relative to this file.
    pub file: FileId,
    /// Place of the pass's `name` in the file.
    pub span: Span,
    /// The include that the pass comes from, as an index into [`Lowered::includes`]; `None` for the root graph's own.
    pub include: Option<usize>,
    /// Place of the `size`, of the `call`, or of a fill's `buffer`.
    pub size_span: Span,
    /// Places of the targets' names in the file, and then of the depth attachment's.
    pub target_spans: Vec<Span>,
    pub bind: Vec<LoweredBind>,
    pub push: Vec<LoweredPush>,
    /// Names and values of the defines: the constants of the scope.
    pub defines: Rc<Vec<(String, String)>>,
    /// Names (in capitals) and values of constants beyond 32 bits.
    pub unfit: Rc<Vec<(String, String)>>,
    /// The text of the generated include `live.glsl`.
    pub live_glsl: Rc<str>,
    /// Parameters that decide whether the pass exists, and which resources and shaders it uses.
    pub decided: ParamSet,
    /// Parameters that the pass's numbers depend on: size, push constants, offsets, fill word.
    pub read: ParamSet,
    /// Parameters that each constant depends on, by the constant's name in shaders.
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

/// A shader's file name, and its place in the graph.
#[derive(Clone, Debug)]
pub struct ShaderName {
    /// File name; the value of the expression if the graph has one.
    pub name: String,
    /// Place of the name in the file.
    pub span: Span,
}

/// The size of a dispatch.
#[derive(Clone, Copy, Debug)]
pub enum LoweredSize {
    /// Number of invocations.
    Threads(Extent),
    /// Number of workgroups.
    Groups(Extent),
    /// The numbers of workgroups in x, y and z are three words of a buffer.
    Indirect {
        buffer: ResourceId,
        /// Byte offset of the first word.
        offset: u64,
    },
}

/// Invocations or workgroups in x, y and z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The counts; 1 in dimensions that are not given.
    pub size: [u64; 3],
    /// The number of given dimensions, 1 to 3. Linking may fold a single dimension into x and y.
    pub dimensions: usize,
}

/// Resources for a block: one for each element of its array, or a single one.
#[derive(Clone, Debug)]
pub struct LoweredBind {
    pub block: String,
    pub block_span: Span,
    pub resources: Vec<ResourceId>,
    pub resource_span: Span,
}

/// The value of a push constant.
#[derive(Clone, Debug)]
pub struct LoweredPush {
    pub name: String,
    pub value: Value,
    pub name_span: Span,
    pub value_span: Span,
}
