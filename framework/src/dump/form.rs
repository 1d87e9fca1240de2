//! The types of a dump: the plan with names in place of numbers.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use crate::ir::{
    Blend, DescriptorKind, Fallback, Hazard, Layout, Load, Origin, Reason, Run, Shape, Topology, Value,
};
use crate::plan::Since;

/// Numbers the JSON form; raised when a field changes its meaning or is removed.
pub const DUMP_VERSION: u32 = 4;

/// Holds a plan with names in place of numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dump {
    /// Version of the form, [`DUMP_VERSION`].
    pub version: u32,
    /// The name that the graph was requested by.
    pub graph: String,
    /// One line that describes the graph.
    pub summary: String,
    /// The graphs and presets that it is based on, as these name each other.
    ///
    /// The graph is last; empty for a graph.
    #[serde(default)]
    pub based_on: Vec<String>,
    /// The graphs of a choice that are passed over, in order.
    #[serde(default)]
    pub fallbacks: Vec<Fallback>,
    /// In the order of the file.
    pub parameters: Vec<DumpParameter>,
    /// Facts of the scene, the device and the viewport.
    pub facts: BTreeMap<String, Value>,
    /// Sums over the whole plan.
    pub totals: Totals,
    /// The memory of the transient resources.
    pub blocks: Vec<DumpBlock>,
    /// Buffers and images.
    pub resources: Vec<DumpResource>,
    /// In the order in which each comes first.
    pub phases: Vec<DumpPhase>,
    /// Passes that one repeat of the graph made, and that run one after another.
    pub repeats: Vec<DumpRepeat>,
    /// The prologue's passes, then the frame's, as they run.
    pub passes: Vec<DumpPass>,
    /// Recorded once, as one call, between the prologue and the first frame.
    pub handover: Vec<DumpBarrier>,
    /// Passes of the graph that are not in the plan.
    pub left_out: Vec<DumpLeftOut>,
    /// What is allowed in the graph, and probably not meant.
    pub warnings: Vec<DumpWarning>,
    /// The image that is shown or saved.
    pub output: String,
    /// The images that were asked for besides it, by the names of these outputs.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub outputs: BTreeMap<String, String>,
    /// Numbers that the host reads after each frame.
    pub stats: Vec<DumpStat>,
    /// Milliseconds that the frame's passes take on the GPU, in sum. Filled in by [`Dump::with_times`].
    pub gpu_ms: Option<f64>,
    /// The encoders of an API that has these. Filled in by its backend.
    #[serde(default)]
    pub encoders: Option<DumpEncoders>,
}

/// A parameter of the graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpParameter {
    /// Name in the graph.
    pub name: String,
    /// Value in use.
    pub value: Value,
    /// Value in use if none is set.
    pub default: Value,
    /// Why it has the value, where an expression of a file gave it: the default's, or that of a preset.
    pub reason: Option<Reason>,
    /// The value that costs no accuracy, where the graph names one.
    pub exact: Option<Value>,
    /// The statistic that the value grows with: a frame whose statistic exceeds the value was incomplete.
    pub grows: Option<String>,
    /// It can be changed between frames; others are baked into the plan.
    pub live: bool,
    /// The passes that depend on it, in the order of [`Dump::passes`].
    #[serde(default)]
    pub affects: Vec<String>,
    /// It decides which passes there are: a condition, the count of a repeat or a swap depends on it.
    #[serde(default)]
    pub shape: bool,
    /// The reason, where nothing in the plan depends on it: a phrase.
    #[serde(default)]
    pub no_effect: Option<String>,
    /// Position of its declaration.
    pub declared: Origin,
}

/// Sums over a plan.
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
    /// Bytes of the memory blocks, which the plan itself owns.
    pub transient_bytes: u64,
    /// Bytes of the same resources without sharing.
    pub unshared_bytes: u64,
    /// The difference.
    pub saved_bytes: u64,
    /// Bytes of the scene's attributes that the plan reads.
    pub scene_bytes: u64,
    /// Bytes of attributes and of memory blocks that are freed once the prologue has run.
    #[serde(default)]
    pub freed_bytes: u64,
    /// Bytes that the host writes or reads, for each frame in flight.
    pub host_bytes: u64,
}

/// Counts the barriers of one part of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BarrierTotals {
    /// Barriers that are recorded together are one call.
    pub calls: usize,
    /// Number of all barriers.
    pub barriers: usize,
    /// Number of barriers on all memory.
    pub memory_barriers: usize,
    /// Number of layout changes of one image.
    pub image_barriers: usize,
    /// Number of dependencies that the barriers enforce.
    pub dependencies: usize,
}

/// A piece of memory, as large as its largest alias.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpBlock {
    /// Number that [`DumpResource::block`] refers to.
    pub id: u32,
    /// Size in bytes.
    pub bytes: u64,
    /// Resources that stand in it, of which only one is alive at any time.
    pub aliases: Vec<String>,
}

/// A buffer or an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpResource {
    /// Name in the plan; the halves of a ping-pong buffer `keys` are `keys#0` and `keys#1`.
    pub name: String,
    /// `transient`, `scene`, `frame`, `live` or `readback`.
    pub source: String,
    /// The scene's attribute, or the uniform block or buffer that comes with every frame.
    pub from: Option<String>,
    /// For buffers `count x stride`, for images `width x height format`.
    pub shape: String,
    /// The same, for programs.
    pub dimensions: Shape,
    /// Size in bytes.
    pub bytes: u64,
    /// For instance `STORAGE`, `INDIRECT`.
    pub usage: Vec<String>,
    /// The block that a transient resource stands in, which names the others in it.
    pub block: Option<u32>,
    /// `None` for what lives longer than a frame.
    pub lifetime: Option<Lifetime>,
    /// Passes that run once alone use it: it is freed after them.
    #[serde(default)]
    pub freed: bool,
    /// Name under which its contents are kept from frame to frame and from plan to plan.
    pub history: Option<String>,
    /// Position of its declaration.
    pub declared: Origin,
}

/// Indices into [`Dump::passes`]. Before the first of them the contents are undefined, after the last they are not read.
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
    /// Name in the graph.
    pub name: String,
    /// A phase with passes in the prologue and in the frame appears twice.
    pub run: Run,
    /// Number of passes.
    pub passes: usize,
    /// Milliseconds, in sum; `None` where a pass has no time.
    pub gpu_ms: Option<f64>,
}

/// A run of passes that a repeat made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpRepeat {
    /// Common prefix of the passes' names, or the first pass's name if there is none; unique.
    pub name: String,
    /// Runs of the body, multiplied over nested repeats.
    pub iterations: usize,
    /// Index into [`Dump::passes`].
    pub first: usize,
    /// Number of passes.
    pub passes: usize,
}

/// A dispatch, a draw, a fill, or a step of the plan itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpPass {
    /// Unique name in the plan.
    pub name: String,
    /// Group that its time is summed in.
    pub phase: String,
    /// Runs once, in the prologue, or in every frame.
    pub run: Run,
    /// `dispatch`, `draw`, `fill`, `start`, `export` or `host`.
    pub kind: String,
    /// Its position in a repeat.
    pub repeat: Option<Iteration>,
    /// Shaders: one for a dispatch, the vertex and the fragment shader for a draw.
    pub shaders: Vec<DumpShader>,
    /// Workgroups, vertices or bytes, or the place of the indirect arguments.
    pub size: String,
    /// Primitive topology of a draw.
    pub topology: Option<Topology>,
    /// Color targets of a draw.
    pub targets: Vec<DumpTarget>,
    /// Resources that it reads.
    pub reads: Vec<DumpTouch>,
    /// Resources that it writes.
    pub writes: Vec<DumpTouch>,
    /// Descriptors that are bound.
    pub bindings: Vec<DumpBinding>,
    /// Push constants.
    pub push: Vec<DumpPush>,
    /// Its dependencies: the passes that it comes after, and why.
    #[serde(default)]
    pub dependencies: Vec<DumpDependency>,
    /// Recorded as one call before the pass.
    pub barriers: Vec<DumpBarrier>,
    /// Milliseconds on the GPU. Filled in by [`Dump::with_times`].
    pub gpu_ms: Option<f64>,
    /// Position of its declaration.
    pub declared: Origin,
}

/// Locates a pass in a repeat.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Iteration {
    /// The [repeat](DumpRepeat::name).
    pub group: String,
    /// The pass's name without indices: the same in every iteration.
    pub member: String,
    /// The indices, outermost first.
    pub index: Vec<u32>,
}

/// A compiled shader of a pass.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpShader {
    /// File name, as in the graph.
    pub file: String,
    /// Preprocessor defines that it is compiled with.
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

/// A colour attachment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpTarget {
    /// Name of the image resource.
    pub image: String,
    /// Contents before the draw: kept or cleared.
    pub load: Load,
    /// Blending of the fragments with the target.
    pub blend: Blend,
}

/// Describes one access of a pass to a resource.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpTouch {
    /// Name of the resource.
    pub resource: String,
    /// Stages by name, after Vulkan's synchronization2.
    pub stages: Vec<String>,
    /// Accesses by name, after Vulkan's synchronization2.
    pub accesses: Vec<String>,
    /// The layout that an image must be in.
    pub layout: Option<Layout>,
    /// Nothing of the previous contents is needed.
    pub discards: bool,
}

/// A descriptor of set 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpBinding {
    /// Name of the GLSL block or image.
    pub name: String,
    /// Binding number in the set.
    pub binding: u32,
    /// Index in an array of descriptors, 0 if there is none.
    pub element: u32,
    /// Type of the descriptor.
    pub kind: DescriptorKind,
    /// Name of the bound resource.
    pub resource: String,
}

/// A push constant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpPush {
    /// Name of the member, if the shader has one here.
    pub name: Option<String>,
    /// Bytes.
    pub offset: usize,
    /// The number, as the shader reads it.
    pub value: Value,
}

/// A resource or a pass, and where the graph declares it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Declared {
    /// Name of the resource or pass, as in the dump.
    pub name: String,
    /// Position of its declaration.
    pub declared: Origin,
}

/// Something that a pass comes after: an access of an earlier pass to the same memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpDependency {
    /// Kind of conflict; [`Hazard::LayoutChange`] where only the change of the image's layout waits.
    pub hazard: Hazard,
    /// The earlier pass.
    pub pass: Declared,
    /// Which run of it: in the same frame, the prologue or the frame before.
    pub since: Since,
    /// The resource that the later pass accesses.
    pub resource: Declared,
    /// The resource that the earlier pass accessed, where it is another one in the same memory.
    pub alias: Option<Declared>,
    /// First byte of the resource in the conflict.
    pub start: u64,
    /// End of these bytes, exclusive.
    pub end: u64,
    /// The layout of the image changes between the two.
    pub changes_layout: bool,
    /// Stages and accesses of both passes.
    #[serde(flatten)]
    pub masks: Masks,
}

/// Order and memory between what came before and what comes after, with Vulkan's meaning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpBarrier {
    /// Counts from 1 in the order of recording: prologue, handover, frame.
    pub id: u32,
    /// The pass that follows it; `None` in the handover.
    pub before: Option<Declared>,
    /// The image that changes its layout; `None` for a barrier on all memory.
    pub image: Option<DumpTransition>,
    /// Stages and accesses: the union over all dependencies.
    #[serde(flatten)]
    pub masks: Masks,
    /// Hazards that it prevents.
    pub dependencies: Vec<DumpCause>,
}

/// A change of an image's layout.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpTransition {
    /// Name of the image resource.
    pub image: String,
    /// Layout before; undefined if the contents are not needed.
    pub old: Layout,
    /// Layout after.
    pub new: Layout,
}

/// Stages and accesses by name, after Vulkan's synchronization2.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Masks {
    /// Stages that are waited for.
    pub source_stages: Vec<String>,
    /// Accesses whose writes are made available.
    pub source_accesses: Vec<String>,
    /// Stages that wait.
    pub target_stages: Vec<String>,
    /// Accesses that see the writes.
    pub target_accesses: Vec<String>,
}

/// One reason for a barrier.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpCause {
    /// Kind of conflict.
    pub hazard: Hazard,
    /// The pass that needs it: the one after the barrier, or a later one that would otherwise need its own call. (It may
    /// be one at the start of the next frame that depends on the last call of this one.)
    pub before: Declared,
    /// The resource that this pass accesses.
    pub resource: Declared,
    /// The passes that are waited for. Empty where an image was never touched.
    pub after: Vec<Declared>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they accessed, if it is another one in the same memory.
    pub alias: Option<Declared>,
    /// Masks that this reason alone requires.
    #[serde(flatten)]
    pub masks: Masks,
}

/// A pass of the graph that is not in the plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpLeftOut {
    /// Name of the pass.
    pub pass: String,
    /// Reason for its absence.
    pub why: String,
    /// Position of its declaration.
    pub declared: Origin,
}

/// Something in the graph that is allowed, and probably not meant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpWarning {
    /// A sentence.
    pub message: String,
    /// What to do about it.
    pub help: Vec<String>,
    /// Position of what it is about.
    pub declared: Origin,
}

/// A number that the GPU computes: a 32-bit word of a buffer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpStat {
    /// Name in the graph.
    pub name: String,
    /// Name of the buffer that holds the word.
    pub buffer: String,
    /// Bytes.
    pub offset: u64,
}

/// The encoders of a plan, for an API that has encoders, fences and barriers within them (Metal).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpEncoders {
    /// Encoders that run once.
    pub prologue: Vec<DumpEncoder>,
    /// Reasons for the event between the prologue and the first frame; there is none without any.
    pub handover: Vec<DumpReason>,
    /// Encoders that run every frame.
    pub frame: Vec<DumpEncoder>,
    /// Sums over the prologue.
    pub prologue_totals: EncoderTotals,
    /// Sums over a frame.
    pub frame_totals: EncoderTotals,
    /// Sums over a frame where each pass has its own encoder, as it must to have its own time.
    pub timed_totals: EncoderTotals,
}

/// Commands of one kind that are encoded together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpEncoder {
    /// `compute`, `render` or `blit`.
    pub kind: String,
    /// Fences that it waits for at its beginning.
    pub waits: Vec<DumpWait>,
    /// Its passes, in order.
    pub passes: Vec<EncodedPass>,
    /// Fences that it updates at its end.
    pub updates: Vec<DumpUpdate>,
}

/// A fence that an encoder waits for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpWait {
    /// Number of the fence.
    pub fence: u32,
    /// The stage of draws that waits: `vertex` (and so all) or `fragment`.
    pub stage: Option<String>,
    /// The conflicts behind it.
    pub reasons: Vec<DumpReason>,
}

/// A fence that an encoder updates.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DumpUpdate {
    /// Number of the fence.
    pub fence: u32,
    /// The stage of draws after which it is updated: `vertex` or `fragment` (and so all).
    pub stage: Option<String>,
}

/// A pass in an encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncodedPass {
    /// Name of the pass.
    pub pass: String,
    /// The barrier before it.
    pub barrier: Option<EncoderBarrier>,
}

/// A barrier within an encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncoderBarrier {
    /// The kinds of resources that it is for: `buffers`, `textures`.
    pub scope: Vec<String>,
    /// The conflicts behind it.
    pub reasons: Vec<DumpReason>,
}

/// One reason for a wait, a barrier or an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpReason {
    /// Kind of conflict.
    pub hazard: Hazard,
    /// The pass that waits.
    pub before: Declared,
    /// The resource that it accesses.
    pub resource: Declared,
    /// The passes that are waited for.
    pub after: Vec<Declared>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they accessed, if it is another one in the same memory.
    pub alias: Option<Declared>,
}

/// Counts what orders the passes of a part of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EncoderTotals {
    /// Number of encoders.
    pub encoders: usize,
    /// Number of different fences.
    pub fences: usize,
    /// Number of waits for fences.
    pub waits: usize,
    /// Number of updates of fences.
    pub updates: usize,
    /// Number of barriers within encoders.
    pub barriers: usize,
}

impl Dump {
    /// Adds the times of a run, in milliseconds by pass name, and returns the number of passes that got one. Unknown names are
    /// ignored.
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

    /// Adds the barriers of an API that has them: a call before each pass in their order, with the handover between the prologue's
    /// passes and the frame's. Their ids are counted here.
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

    /// Iterates over all barriers, in the order of their ids.
    pub fn barriers(&self) -> impl Iterator<Item = &DumpBarrier> {
        let of = |run| self.passes.iter().filter(move |p| p.run == run).flat_map(|p| &p.barriers);
        of(Run::Once).chain(&self.handover).chain(of(Run::Frame))
    }

    /// Finds the pass of this name.
    pub fn pass(&self, name: &str) -> Option<&DumpPass> {
        self.passes.iter().find(|p| p.name == name)
    }
}

impl DumpPass {
    /// Returns true if a run may have no time for it: no work on the device, or work that a backend may skip.
    pub fn needs_no_time(&self) -> bool {
        matches!(self.kind.as_str(), "export" | "host" | "start")
    }
}

/// Returns the sum of their times, if there is something to add and no time is missing.
fn sum<'a>(passes: impl Iterator<Item = &'a DumpPass>) -> Option<f64> {
    let times = passes.filter(|p| p.gpu_ms.is_some() || !p.needs_no_time()).map(|p| p.gpu_ms);
    times.reduce(|a, b| Some(a? + b?)).flatten()
}
