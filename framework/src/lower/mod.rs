//! Lowering: turns the tree of a graph file into a flat list of passes.
//!
//! A graph may be a preset of another, include sub-graphs, repeat passes, omit some and swap ping-pong resources. Lowering
//! walks the tree once, in the order of the file, and resolves all of these: the result ([`Lowered`]) has only dispatches,
//! draws and fills over numbered resources, every expression has a value, and `front(keys)` is one definite buffer. Lowering
//! does not look at shaders; whether the names under `bind` exist is checked by linking.
//!
//! Files: `document` loads files and follows presets and choices; `require` takes the first graph of a choice whose needs hold;
//! `declared` lists a graph's parameters, `params` gives them values, and `defines` turns them into preprocessor defines; `scope`
//! evaluates expressions; `resources` numbers buffers and images; `passes` walks the passes, `conditions` leaves some of them out,
//! and `include` lowers included graphs; `results` finds the output and the statistics.

mod conditions;
mod declared;
mod defines;
mod document;
mod include;
mod params;
mod passes;
mod require;
mod resources;
mod results;
mod scope;

use std::collections::BTreeMap;
use std::rc::Rc;

pub use params::parse_value;

use declared::Declared;
use require::Choices;
use scope::Place;

use crate::expr::Expr;
use crate::ir::{
    Culled, DrawCall, Fallback, FileId, Param, ParamSet, Reason, Request, Run, Shape, Source, Span, Stat,
    Target, Topology, Unmet, Value,
};
use crate::schema::folded;
use crate::source::{Diagnostic, Path, SourceMap};

/// Holds a graph without its constructs. Passes are in the order of the file.
#[derive(Clone, Debug)]
pub struct Lowered {
    /// The name that the graph was asked for by.
    pub name: String,
    /// One line about it, of the outermost preset or the graph.
    pub summary: String,
    /// The graphs and presets that it is based on, the graph last; empty for a graph.
    pub based_on: Vec<String>,
    /// The graphs that a choice passed over, in order; the last one's fallback is this graph.
    pub fallbacks: Vec<Fallback>,
    /// Known values of scene, device and viewport.
    pub facts: BTreeMap<String, Value>,
    /// The parameters of the graph that was asked for.
    pub params: Vec<Param>,
    /// Buffers and images, those that stand for the previous frame's contents among them.
    pub resources: Vec<LoweredResource>,
    /// Dispatches, draws and fills.
    pub passes: Vec<LoweredPass>,
    /// Passes that a `when` removed.
    pub culled: Vec<Culled>,
    /// The same passes, with the parameters that they would use.
    pub removed: Vec<RemovedPass>,
    /// Uses of parameters in expressions that were not evaluated.
    pub skipped: Vec<SkippedUse>,
    /// Uses that a `when` removed together with their pass.
    pub unwritten: Vec<RemovedUse>,
    /// Graphs that were included, those that include others before these.
    pub includes: Vec<LoweredInclude>,
    /// The image that is shown.
    pub output: ResourceHandle,
    /// The output's name in the file.
    pub output_span: Span,
    /// The words that are read back.
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

/// Describes a `let` or a parameter whose expression names parameters that its evaluation did not reach.
#[derive(Clone, Debug)]
pub struct SkippedUse {
    /// The parameters.
    pub params: ParamSet,
    /// The name that has the expression.
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

    /// Returns the handle whose memory `handle` names: another one for the previous frame's contents.
    pub fn real(&self, handle: ResourceHandle) -> ResourceHandle {
        self.resource(handle).previous_frame_of.unwrap_or(handle)
    }
}

/// Indexes [`Lowered::resources`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ResourceHandle(pub u32);

impl ResourceHandle {
    /// Returns the position in the list.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Describes a buffer or an image. Each half of a ping-pong resource is one, named `keys#0` and `keys#1`.
#[derive(Clone, Debug)]
pub struct LoweredResource {
    /// Unique in the graph.
    pub name: String,
    /// The size.
    pub shape: Shape,
    /// The owner and writer.
    pub source: Source,
    /// The name under which its contents are kept from frame to frame.
    pub history: Option<String>,
    /// Set for `last(name)`, whose readers run before the writers of this frame: the resource itself; of a ping-pong resource,
    /// the half that is the front when the frame ends.
    pub previous_frame_of: Option<ResourceHandle>,
    /// The declaration.
    pub span: Span,
    /// Parameters that the declaration depends on.
    pub params: ParamSet,
}

/// Describes a graph that was included.
#[derive(Clone, Debug)]
pub struct LoweredInclude {
    /// Unique in the graph.
    pub name: String,
    /// Its `name` in the file.
    pub span: Span,
    /// The include that it stands in, as an index into [`Lowered::includes`].
    pub parent: Option<usize>,
    /// What its ports are given: the name, and the resources that it stands for; both halves of a ping-pong buffer.
    pub given: Vec<(String, Vec<ResourceHandle>)>,
}

/// Names a use that went with its pass.
#[derive(Clone, Debug)]
pub struct RemovedUse {
    /// The resource.
    pub resource: ResourceHandle,
    /// The removed pass.
    pub pass: String,
    /// Its `when`.
    pub when: Span,
}

/// Describes a pass that a `when` removed, or an include, or a pass of a repeat.
#[derive(Clone, Debug)]
pub struct RemovedPass {
    /// Its `when`, or that of its repeat.
    pub condition: String,
    /// The condition in the file.
    pub when: Span,
    /// Why it is false; none for one without names.
    pub reason: Option<Reason>,
    /// Parameters that the condition depends on.
    pub decided: ParamSet,
    /// Parameters behind the names in the pass's expressions.
    pub named: ParamSet,
    /// The graph file that declares it.
    pub file: FileId,
    /// File names of its shaders.
    pub shaders: Vec<String>,
    /// As for a pass that is there.
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

/// Describes one dispatch, draw or fill; its shaders are names.
#[derive(Clone, Debug)]
pub struct LoweredPass {
    /// Unique in the graph.
    pub name: String,
    /// The group that its time is summed under.
    pub phase: String,
    /// Prologue or frame.
    pub run: Run,
    /// The graph file that declares it: shaders are looked for beside it.
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
    /// Names, as defines would have them, and values of the constants of the scope that are numbers beyond 32 bits.
    pub unfit: Rc<Vec<(String, String)>>,
    /// Parameters that decide that the pass exists, and which resources it uses.
    pub decided: ParamSet,
    /// Parameters that its numbers depend on: size, push constants, offsets, the word of a fill.
    pub read: ParamSet,
    /// Parameters behind the names that shaders can have of constants.
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

/// Holds a shader's name as written.
#[derive(Clone, Debug)]
pub struct ShaderName {
    /// The name.
    pub name: String,
    /// The name in the file.
    pub span: Span,
}

/// Describes the command of a pass.
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

/// Sizes a dispatch.
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

/// Counts something in x, y and z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The numbers; 1 in the dimensions that are not given.
    pub size: [u64; 3],
    /// The number of dimensions that are given, 1 to 3.
    ///
    /// With one, what does not fit in x may continue in y.
    pub dimensions: usize,
}

/// Binds resources to a block: one for each element of its array, or a single one.
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

/// Gives a push constant its value.
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

/// Describes a parameter together with its texts for people.
#[derive(Clone, Debug, PartialEq)]
pub struct Control {
    /// The parameter.
    pub param: Param,
    /// A short name.
    pub label: String,
    /// A sentence, or nothing.
    pub help: String,
    /// The title of the part that it is exposed of; none for the graph's own.
    pub part: Option<String>,
}

/// Lowers the graph that `request` names.
pub fn lower(request: &Request, files: &mut SourceMap) -> Result<Lowered, Vec<Diagnostic>> {
    passes::Lowering::new(request, files).run()
}

/// Reads a graph's summary and parameters, without lowering its passes: for lists, help and controls.
pub fn controls(request: &Request, files: &mut SourceMap) -> Result<(String, Vec<Control>), Vec<Diagnostic>> {
    let mut choices = Choices::new(request);
    let chosen = choices.root(files)?;
    let parameters = declared::parameters(&chosen.opened, &mut choices, files, &mut Default::default())?;
    let mut errors = Vec::new();
    let resolved = params::resolve(&chosen.opened, &parameters, request, files, &mut errors);
    if !errors.is_empty() {
        return Err(require::explained(errors, &chosen.fallbacks));
    }
    let control = |(param, declared): (Param, &Declared)| {
        let (label, help) = params::texts(declared.declaration());
        let label = if label.is_empty() { param.name.replace('_', " ") } else { folded(label) };
        Control {
            label,
            help: folded(help),
            part: declared.part.as_ref().map(|part| part.replace('_', " ")),
            param,
        }
    };
    let controls = resolved.params.into_iter().zip(&parameters.all).map(control).collect();
    Ok((folded(&chosen.opened.summary), controls))
}

/// Holds the names that a graph's expressions can use, with their values: facts, constant parameters and `let`s.
#[derive(Clone, Debug, Default)]
pub struct ExpressionNames(Values);

impl ExpressionNames {
    /// Returns the value of a name.
    pub fn get(&self, name: &str) -> Option<&Value> {
        self.0.get(name)
    }

    /// Lists the names with their values, in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(name, value)| (name.as_str(), value))
    }

    /// Evaluates an expression; `None` if it is none, or uses another name, such as the variable of a repeat.
    pub fn evaluate(&self, expression: &str) -> Option<Value> {
        Expr::parse(expression).ok()?.eval(&self.0).ok()
    }
}

/// Evaluates a graph's parameters and `let`s, without lowering its passes: for editors. A `let` in error is left out.
///
/// # Errors
/// Those of the graph's file, its parameters, and the files that it leads to.
pub fn expression_names(
    request: &Request,
    files: &mut SourceMap,
) -> Result<ExpressionNames, Vec<Diagnostic>> {
    let mut choices = Choices::new(request);
    let chosen = choices.root(files)?;
    let opened = &chosen.opened;
    let parameters = declared::parameters(opened, &mut choices, files, &mut Default::default())?;
    let mut errors = Vec::new();
    let mut names = params::resolve(opened, &parameters, request, files, &mut errors).names;
    if !errors.is_empty() {
        return Err(require::explained(errors, &chosen.fallbacks));
    }
    for (name, number) in &opened.graph.lets {
        let place = Place::new(&opened.outline, Path::root().field("let").key(name));
        if let Ok(value) = names.evaluate(number, &place) {
            names.define(name, value, ParamSet::new());
        }
    }
    Ok(ExpressionNames(names.values))
}

/// Says which graph a device is given for the one that a request names.
#[derive(Clone, Debug, PartialEq)]
pub struct Standing {
    /// The graphs of a choice that are passed over, in order.
    pub fallbacks: Vec<Fallback>,
    /// The needs of the last of them (or of the graph) that do not hold.
    ///
    /// There are some where nothing suits the device.
    pub unmet: Vec<Unmet>,
}

/// Holds a graph's `require` against the facts, without lowering it.
///
/// # Errors
/// Those of the graph's file, of its `require`, and of the files that it leads to.
pub fn standing(request: &Request, files: &mut SourceMap) -> Result<Standing, Vec<Diagnostic>> {
    let chosen = Choices::new(request).standing(files)?;
    Ok(Standing { fallbacks: chosen.fallbacks.clone(), unmet: chosen.unmet.clone() })
}

/// Values by name.
pub(crate) type Values = BTreeMap<String, Value>;

#[cfg(test)]
mod tests;
