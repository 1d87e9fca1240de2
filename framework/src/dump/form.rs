//! Defines the types of a dump: the plan with names in place of numbers.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use crate::ir::{
    Binding, Culled, DepthTarget, Fallback, Masks, Origin, Reason, Run, Shape, Stat, Target, Topology, Usage,
    Use, Value,
};
use crate::plan::{Cause, Dependency, LayoutChange, Transition};

/// Version of the JSON form; raised when a field changes its meaning or is removed.
pub const DUMP_VERSION: u32 = 4;

/// A plan with names in place of numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dump {
    /// Version of the form, [`DUMP_VERSION`].
    pub version: u32,
    /// The name under which the graph was requested.
    pub graph: String,
    /// One line that describes the graph.
    pub summary: String,
    /// Names to which the requested preset or choice leads, in order, the graph's last; empty for a graph.
    #[serde(default)]
    pub based_on: Vec<String>,
    /// Graphs of a choice that were passed over, in order.
    #[serde(default)]
    pub fallbacks: Vec<Fallback>,
    /// Parameters, in the order of the file.
    pub parameters: Vec<DumpParameter>,
    /// Facts that the plan was built from, by full name, such as `scene.count`.
    pub facts: BTreeMap<String, Value>,
    /// Counts of passes and barriers, and sizes of memory, over the whole plan.
    pub totals: Totals,
    /// Memory blocks of the transient resources.
    pub blocks: Vec<DumpBlock>,
    /// Buffers and images.
    pub resources: Vec<DumpResource>,
    /// Phases, in the order of their first passes.
    pub phases: Vec<DumpPhase>,
    /// Runs of consecutive passes that come from one repeat of the graph.
    pub repeats: Vec<DumpRepeat>,
    /// The prologue's passes, then the frame's, in execution order.
    pub passes: Vec<DumpPass>,
    /// Barriers recorded in one call between the prologue and the first frame.
    pub handover: Vec<DumpBarrier>,
    /// Layout changes of images, for APIs with layouts: in the prologue, in the handover, and in the frame.
    #[serde(default)]
    pub layout_changes: Vec<LayoutChange<Declared, String>>,
    /// Passes and includes of the graph that are not in the plan.
    pub left_out: Vec<Culled>,
    /// Constructs of the graph that are allowed but probably unintended.
    pub warnings: Vec<DumpWarning>,
    /// The image that is shown or saved.
    pub output: String,
    /// The images requested besides the output, by output name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub outputs: BTreeMap<String, String>,
    /// Statistics: words that the host reads after each frame.
    pub stats: Vec<Stat<String>>,
    /// Total GPU milliseconds of the frame's passes, set by [`Dump::with_times`]; `None` if a needed time is missing.
    pub gpu_ms: Option<f64>,
    /// Measured GPU milliseconds of a frame, from its first command to its last. Set by the caller; `None` without a
    /// measurement. Exceeds `gpu_ms` if the device works between passes, or if its timestamps of passes are inaccurate.
    #[serde(default)]
    pub frame_ms: Option<f64>,
    /// The encoders, for an API that has them. Filled in by its backend.
    #[serde(default)]
    pub encoders: Option<DumpEncoders>,
}

/// A parameter of the graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpParameter {
    /// Name of the parameter, as in the graph file.
    pub name: String,
    /// The value that the plan was built with.
    pub value: Value,
    /// The value if neither a preset nor the request sets one.
    pub default: Value,
    /// Reason for the value; `None` unless it comes from an expression with names in the default or in a preset.
    pub reason: Option<Reason>,
    /// The value that costs no accuracy, if the graph names one.
    pub exact: Option<Value>,
    /// The statistic that this capacity must cover, if any. A frame whose statistic exceeds the value is incomplete. Of
    /// several statistics ([`Stat::grows`]), the first.
    pub grows: Option<String>,
    /// True if the parameter can be changed between frames; otherwise it is baked into the plan.
    pub live: bool,
    /// Offset in bytes in the uniform block of live parameters; `None` unless the parameter is live.
    #[serde(default)]
    pub offset: Option<u32>,
    /// GLSL type in the uniform block: `float`, `int`, or `uint` for a bool (0 or 1) and a choice (its index in
    /// `choices`); `None` unless the parameter is live.
    #[serde(default, rename = "type")]
    pub kind: Option<String>,
    /// Names of a choice, in the order of the file; empty for other parameters.
    #[serde(default)]
    pub choices: Vec<String>,
    /// The passes that depend on the parameter, in the order of [`Dump::passes`].
    #[serde(default)]
    pub affects: Vec<String>,
    /// True if the parameter decides which passes exist: a condition or the count of a repeat depends on it.
    #[serde(default)]
    pub shape: bool,
    /// The reason why nothing in the plan depends on the parameter, a phrase; `None` if something does.
    #[serde(default)]
    pub no_effect: Option<String>,
    /// Position of the parameter's declaration.
    pub declared: Origin,
}

/// Counts of passes and barriers, and sizes of memory, over a plan.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Number of all passes, in the prologue and in the frame.
    pub passes: usize,
    /// Number of passes that run once.
    pub prologue_passes: usize,
    /// Number of passes that run in every frame.
    pub frame_passes: usize,
    /// Barriers of the prologue.
    pub prologue: BarrierTotals,
    /// Barriers between the prologue and the first frame.
    pub handover: BarrierTotals,
    /// Barriers of each frame.
    pub frame: BarrierTotals,
    /// Bytes of the memory blocks, which the plan owns.
    pub transient_bytes: u64,
    /// Bytes of the transient resources, without sharing of memory.
    pub unshared_bytes: u64,
    /// Bytes saved by sharing: `unshared_bytes - transient_bytes`.
    pub saved_bytes: u64,
    /// Bytes of the scene's attributes that the plan reads; an attribute imported twice counts once.
    pub scene_bytes: u64,
    /// Bytes of attributes and of memory blocks that are freed once the prologue has run.
    #[serde(default)]
    pub freed_bytes: u64,
    /// Bytes that the host writes or reads, per frame in flight; host buffers count with their minimum length.
    pub host_bytes: u64,
}

/// Counts of the barriers in one part of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BarrierTotals {
    /// Number of calls; barriers recorded together are one call.
    pub calls: usize,
    /// Number of barriers of both kinds.
    pub barriers: usize,
    /// Number of memory barriers.
    pub memory_barriers: usize,
    /// Number of image barriers, which change a layout.
    pub image_barriers: usize,
    /// Number of reasons for the barriers: the entries of all [`DumpBarrier::dependencies`].
    pub dependencies: usize,
}

/// A memory block, as large as its largest alias.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpBlock {
    /// Number that [`DumpResource::block`] refers to.
    pub id: u32,
    /// Size in bytes.
    pub bytes: u64,
    /// Resources in the block. Only one is alive at any time.
    pub aliases: Vec<String>,
}

/// A buffer or an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpResource {
    /// Name in the plan; the halves of a ping-pong buffer `keys` are `keys#0` and `keys#1`.
    pub name: String,
    /// `transient`, `scene`, `frame`, `given`, `live` or `readback`; see [`Source`](crate::ir::Source).
    pub source: String,
    /// Name of the attribute (`scene`), uniform block (`frame`) or buffer (`given`); `None` for other sources.
    pub from: Option<String>,
    /// For buffers `count x stride`, for images `width x height format`.
    pub shape: String,
    /// Shape of the resource, as structured data.
    pub dimensions: Shape,
    /// Size in bytes.
    pub bytes: u64,
    /// Uses of the resource, for instance `STORAGE` and `INDIRECT`.
    pub usage: Usage,
    /// The [block](DumpBlock::id) of a transient resource; `None` for other sources.
    pub block: Option<u32>,
    /// First and last use in the frame. `None` if the resource is not transient, is not written in the frame, or has
    /// contents that outlive the frame.
    pub lifetime: Option<Lifetime>,
    /// True if the resource is freed once the prologue has run, because only the prologue needs it.
    #[serde(default)]
    pub freed: bool,
    /// Name of the history, whose contents persist from frame to frame and from plan to plan; `None` without one.
    pub history: Option<String>,
    /// Position of the resource's declaration.
    pub declared: Origin,
}

/// First and last use, as indices into [`Dump::passes`]; the contents are undefined before and not needed after.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lifetime {
    /// Index of the first pass that accesses the resource.
    pub first: usize,
    /// Index of the last pass that accesses the resource.
    pub last: usize,
}

/// A group of passes whose times are summed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpPhase {
    /// Name of the phase, as in the graph file.
    pub name: String,
    /// Part of the plan. A phase with passes in both parts appears twice.
    pub run: Run,
    /// Number of passes.
    pub passes: usize,
    /// Total GPU milliseconds. `None` if no pass has a time, or if one that [needs it](DumpPass::needs_no_time) has
    /// none.
    pub gpu_ms: Option<f64>,
}

/// A run of passes from one repeat.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpRepeat {
    /// Name of the include around the repeat, or the first pass's name without index; `sort (2)` if `sort` is taken.
    pub name: String,
    /// Number of distinct indices among the passes: for nested repeats, the iterations of the innermost body.
    pub iterations: usize,
    /// Index of the first pass in [`Dump::passes`].
    pub first: usize,
    /// Number of passes, in all iterations together.
    pub passes: usize,
}

/// A dispatch, a draw, a fill, or a step of the plan itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpPass {
    /// Unique name in the plan.
    pub name: String,
    /// Group under which the pass's GPU time is summed.
    pub phase: String,
    /// The part of the plan in which the pass runs: prologue or frame.
    pub run: Run,
    /// `dispatch`, `draw`, `fill`, `start`, `export` or `host`.
    pub kind: String,
    /// Position of the pass in a repeat; `None` outside of repeats.
    pub repeat: Option<Iteration>,
    /// Shaders: one for a dispatch, the vertex and the fragment shader for a draw.
    pub shaders: Vec<DumpShader>,
    /// Workgroups, vertices x instances or bytes, or the place of indirect arguments; empty for `export` and `host`.
    pub size: String,
    /// Primitive topology of a draw; `None` for other passes.
    pub topology: Option<Topology>,
    /// Colour targets of a draw; empty for other passes.
    pub targets: Vec<Target<String>>,
    /// Depth attachment of a draw; omitted if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<DepthTarget<String>>,
    /// Resources that the pass reads.
    pub reads: Vec<Use<String>>,
    /// Resources that the pass writes.
    pub writes: Vec<Use<String>>,
    /// Descriptors that the pass binds.
    pub bindings: Vec<Binding<String>>,
    /// Push constants, one per 32-bit word.
    pub push: Vec<DumpPush>,
    /// Dependencies on earlier passes. [`Dependency::second`], which is this pass, is left empty.
    #[serde(default)]
    pub dependencies: Vec<Dependency<Declared, Declared>>,
    /// Barriers recorded in one call before the pass.
    pub barriers: Vec<DumpBarrier>,
    /// GPU milliseconds. Filled in by [`Dump::with_times`].
    pub gpu_ms: Option<f64>,
    /// Position of the pass's declaration.
    pub declared: Origin,
}

/// The position of a pass in a repeat.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Iteration {
    /// Name of the repeat: [`DumpRepeat::name`].
    pub group: String,
    /// The pass's name without indices, equal in every iteration.
    pub member: String,
    /// Index in each repeat, outermost first.
    pub index: Vec<u32>,
}

/// A compiled shader of a pass.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpShader {
    /// File name, as in the graph.
    pub file: String,
    /// Path of the file that was found for the name, such as `shaders/splat.frag`, with ` (built in)` if it is.
    #[serde(default)]
    pub path: String,
    /// Hash of the SPIR-V, in hexadecimal. Comparable between dumps of the same version of the program.
    #[serde(default)]
    pub code: String,
    /// Preprocessor defines that the shader's text mentions.
    pub defines: Vec<Define>,
    /// Invocations of a workgroup in x, y, z.
    pub local_size: [u32; 3],
    /// Bytes of shared memory of a workgroup.
    pub shared_bytes: u32,
}

/// A preprocessor define.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Define {
    /// Name of the macro.
    pub name: String,
    /// Text that replaces the macro.
    pub value: String,
}

/// A push constant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpPush {
    /// Name of the member, if the shader has one at this offset.
    pub name: Option<String>,
    /// Offset in bytes.
    pub offset: usize,
    /// The word, in the type that the shader declares. An unsigned integer if it declares none, and for float words
    /// that are infinite or NaN.
    pub value: Value,
    /// Type of `value`: `float`, `int` or `uint`. Empty in dumps that lack it.
    #[serde(default, rename = "type")]
    pub kind: String,
}

/// A resource or a pass, with its declaration in the graph.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Declared {
    /// Name of the resource or pass, as in the dump.
    pub name: String,
    /// Position of the declaration of the resource or pass.
    pub declared: Origin,
}

/// A barrier between earlier and later commands, with the semantics of Vulkan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpBarrier {
    /// Number of the barrier, from 1 in recording order: prologue, handover, frame.
    pub id: u32,
    /// The pass that follows the barrier; `None` in the handover.
    pub before: Option<Declared>,
    /// The image whose layout changes; `None` for a memory barrier.
    pub image: Option<Transition<String>>,
    /// Stages and accesses: the union over all dependencies, without the bits that earlier barriers cover.
    #[serde(flatten)]
    pub masks: Masks,
    /// Hazards that the barrier prevents.
    pub dependencies: Vec<DumpCause>,
}

/// One of the reasons for a barrier. A barrier can serve several passes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpCause {
    /// The conflicting passes, with the resource and the hazard.
    #[serde(flatten)]
    pub conflict: Cause<Declared, Declared>,
    /// The part of the barrier's masks that this reason requires.
    #[serde(flatten)]
    pub masks: Masks,
}

/// A construct of the graph that is allowed but probably unintended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpWarning {
    /// The message, a sentence.
    pub message: String,
    /// Suggestions for a correction; may be empty.
    pub help: Vec<String>,
    /// Position of the construct.
    pub declared: Origin,
}

/// The encoders of a plan, for an API that has encoders, fences and barriers within them (Metal).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpEncoders {
    /// Encoders that run once.
    pub prologue: Vec<DumpEncoder>,
    /// Reasons for the event between the prologue and the first frame; empty if there is none.
    pub handover: Vec<Cause<Declared, Declared>>,
    /// Encoders that run every frame.
    pub frame: Vec<DumpEncoder>,
    /// Counts of the prologue.
    pub prologue_totals: EncoderTotals,
    /// Counts of a frame.
    pub frame_totals: EncoderTotals,
    /// Counts of a frame in which each pass has its own encoder, as timing requires.
    pub timed_totals: EncoderTotals,
}

/// Commands of one kind that are encoded together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpEncoder {
    /// `compute`, `render` or `blit`.
    pub kind: String,
    /// Fences that the encoder waits for at its beginning.
    pub waits: Vec<DumpWait>,
    /// Passes of the encoder, in order.
    pub passes: Vec<EncodedPass>,
    /// Fences that the encoder updates at its end.
    pub updates: Vec<DumpUpdate>,
}

/// A fence that an encoder waits for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpWait {
    /// Number of the fence.
    pub fence: u32,
    /// The stage of draws that waits: `vertex` (so both stages wait) or `fragment`; `None` in other encoders.
    pub stage: Option<String>,
    /// The conflicts that the wait resolves.
    pub reasons: Vec<Cause<Declared, Declared>>,
}

/// A fence that an encoder updates.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpUpdate {
    /// Number of the fence.
    pub fence: u32,
    /// Stage of draws after which the fence is updated: `vertex`, or `fragment` (after both); `None` in other encoders.
    pub stage: Option<String>,
}

/// A pass in an encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncodedPass {
    /// Name of the pass.
    pub pass: String,
    /// The barrier before the pass; `None` if it needs none.
    pub barrier: Option<EncoderBarrier>,
}

/// A barrier within an encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncoderBarrier {
    /// The kinds of resources that the barrier covers: `buffers`, `textures`.
    pub scope: Vec<String>,
    /// The conflicts that the barrier resolves.
    pub reasons: Vec<Cause<Declared, Declared>>,
}

/// Counts of the synchronisation in one part of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EncoderTotals {
    /// Number of encoders.
    pub encoders: usize,
    /// Number of distinct fences.
    pub fences: usize,
    /// Number of waits for fences.
    pub waits: usize,
    /// Number of updates of fences.
    pub updates: usize,
    /// Number of barriers within encoders.
    pub barriers: usize,
}

impl Dump {
    /// Replaces the GPU times of all passes by `times`: pass names and milliseconds. Unknown names are ignored.
    ///
    /// Sums the times of phases and of the frame again. Returns the dump and how many of its passes have a time.
    pub fn with_times(mut self, times: &[(String, f64)]) -> (Dump, usize) {
        let by_name: BTreeMap<&str, f64> = times.iter().map(|(name, ms)| (name.as_str(), *ms)).collect();
        for pass in &mut self.passes {
            pass.gpu_ms = by_name.get(pass.name.as_str()).copied();
        }
        let mut of_phase: BTreeMap<(&str, bool), Vec<&DumpPass>> = BTreeMap::new();
        for pass in &self.passes {
            of_phase.entry((&pass.phase, pass.run == Run::Once)).or_default().push(pass);
        }
        for phase in &mut self.phases {
            let passes = of_phase.get(&(phase.name.as_str(), phase.run == Run::Once));
            phase.gpu_ms = passes.and_then(|passes| sum(passes.iter().copied()));
        }
        self.gpu_ms = sum(self.passes.iter().filter(|p| p.run == Run::Frame));
        let found = self.passes.iter().filter(|p| p.gpu_ms.is_some()).count();
        (self, found)
    }

    /// Adds and numbers the barriers of an API; the dump must have none yet.
    ///
    /// `calls` has one list per pass, in execution order, and the handover's list between those of the prologue and
    /// those of the frame.
    pub fn with_barriers(mut self, calls: impl IntoIterator<Item = Vec<DumpBarrier>>) -> Dump {
        let Dump { passes, totals, handover, .. } = &mut self;
        let (mut calls, mut next) = (calls.into_iter(), 1);
        let mut take = |totals: &mut BarrierTotals| {
            let mut call = calls.next().unwrap_or_default();
            for barrier in &mut call {
                barrier.id = next;
                next += 1;
                totals.image_barriers += usize::from(barrier.image.is_some());
                totals.dependencies += barrier.dependencies.len();
            }
            totals.calls += usize::from(!call.is_empty());
            totals.barriers += call.len();
            totals.memory_barriers = totals.barriers - totals.image_barriers;
            call
        };
        let (prologue, frame) = passes.split_at_mut(totals.prologue_passes);
        prologue.iter_mut().for_each(|pass| pass.barriers = take(&mut totals.prologue));
        *handover = take(&mut totals.handover);
        frame.iter_mut().for_each(|pass| pass.barriers = take(&mut totals.frame));
        self
    }

    /// Computes the part of the measured frame that belongs to no pass, in milliseconds; `None` if unknown.
    pub fn unattributed_ms(&self) -> Option<f64> {
        Some((self.frame_ms? - self.gpu_ms?).max(0.0))
    }

    /// Iterates over all barriers, in the order of their ids.
    pub fn barriers(&self) -> impl Iterator<Item = &DumpBarrier> {
        let of = |run| self.passes.iter().filter(move |p| p.run == run).flat_map(|p| &p.barriers);
        of(Run::Once).chain(&self.handover).chain(of(Run::Frame))
    }

    /// Finds the pass with this name, if there is one.
    pub fn pass(&self, name: &str) -> Option<&DumpPass> {
        self.passes.iter().find(|p| p.name == name)
    }
}

impl DumpPass {
    /// Returns true if the time of the pass may be missing. Such a pass has little or no work, or a backend may skip
    /// it.
    pub fn needs_no_time(&self) -> bool {
        matches!(self.kind.as_str(), "export" | "host" | "start")
    }
}

/// Sums the passes' times; `None` if no pass has a time, or if a needed time is missing.
fn sum<'a>(passes: impl Iterator<Item = &'a DumpPass>) -> Option<f64> {
    let times = passes.filter(|p| p.gpu_ms.is_some() || !p.needs_no_time()).map(|p| p.gpu_ms);
    times.reduce(|a, b| Some(a? + b?)).flatten()
}
