//! Defines the graph as written: the typed tree that serde builds from a RON file.
//!
//! Nothing is resolved here: numbers may be expressions ([`Number`]), and names may be wrong. Lowering resolves them.

mod expression;

use indexmap::IndexMap;
use ron::extensions::Extensions;
use serde::Deserialize;
use serde::de::{Deserializer, Error, SeqAccess, Visitor};
use std::fmt;

pub use expression::{Expression, Part, Reference, ResourceName, folded, is_choice};

use crate::ir::{Blend, DepthAccess, Load, Run, Topology, Value};

/// The version of the graph language that this framework reads.
pub const GRAPH_VERSION: u32 = 1;

/// The contents of a graph file, such as those in `pipelines/`.
// A document is short-lived, so the sizes of the variants do not matter.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, Deserialize)]
pub enum Document {
    /// A graph with passes of its own.
    Graph(Graph),
    /// Another graph with other defaults.
    Preset(Preset),
    /// Graphs in order of preference.
    Choice(GraphChoice),
}

impl Document {
    /// Parses the text of a graph file.
    ///
    /// # Errors
    /// Syntax errors and mismatches with these types, with line and column.
    pub fn parse(text: &str) -> Result<Document, ron::error::SpannedError> {
        let options = ron::Options::default()
            .with_default_extension(Extensions::UNWRAP_VARIANT_NEWTYPES | Extensions::IMPLICIT_SOME);
        options.from_str(text)
    }
}

/// A preset: a graph with other defaults.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preset {
    /// The graph, preset or choice that this preset is based on.
    pub graph: String,
    /// One line that describes the preset.
    pub summary: String,
    /// Values for parameters of the graph, by parameter name.
    pub set: IndexMap<String, Number>,
    /// Requirements in addition to those of the graph.
    #[serde(default)]
    pub require: Vec<(Expression, String)>,
}

/// A choice: graphs in order of preference. The first whose requirements hold is drawn.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Choice")]
pub struct GraphChoice {
    /// One line that describes the choice.
    pub summary: String,
    /// The graphs, in order of preference.
    pub of: Vec<Candidate>,
}

/// A graph of a choice.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// The graph, a preset or another choice.
    pub graph: String,
    /// Requirements that the choice adds to the graph's own.
    #[serde(default)]
    pub require: Vec<(Expression, String)>,
}

/// A graph: the body of `Graph(...)`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    /// The version of the language, [`GRAPH_VERSION`].
    pub version: u32,
    /// One line that describes the renderer.
    pub summary: String,
    /// Requirements of the graph: conditions over facts, each with a description.
    #[serde(default)]
    pub require: Vec<(Expression, String)>,
    /// Parameters, in the order in which panels show them. They may use constant ones, but not in a cycle.
    #[serde(default)]
    pub params: IndexMap<String, ParamDecl>,
    /// Named expressions over constant parameters, facts and earlier entries.
    #[serde(default, rename = "let")]
    pub lets: IndexMap<String, Number>,
    /// Imported data of the scene and the host.
    #[serde(default)]
    pub imports: IndexMap<String, Import>,
    /// Resources that an includer supplies.
    #[serde(default)]
    pub ports: IndexMap<String, Port>,
    /// Buffers and images. An includer refers to `r` as `include.r`, where `include` is the include's name.
    #[serde(default)]
    pub resources: IndexMap<String, ResourceDecl>,
    /// Passes, in order.
    pub passes: Vec<PassDecl>,
    /// 32-bit words to read back after each frame, each as a buffer and a byte offset, a multiple of 4. An includer
    /// inherits them under the same names.
    #[serde(default)]
    pub stats: IndexMap<String, (Reference, Number)>,
    /// The output image; an includer refers to it as `include.picture`. A graph made only for includes needs none.
    #[serde(default)]
    pub output: Option<Reference>,
    /// More images of a frame, by name, produced on request: see [`crate::ir::OUTPUTS`].
    #[serde(default)]
    pub outputs: IndexMap<String, Reference>,
}

/// A number or a bool, or an expression in quotes.
#[derive(Clone, Debug, PartialEq)]
pub enum Number {
    /// A literal number or bool.
    Literal(Value),
    /// An expression in quotes.
    Expression(Expression),
}

impl Number {
    /// Returns the expression; `None` for a literal.
    pub fn expression(&self) -> Option<&Expression> {
        match self {
            Number::Literal(_) => None,
            Number::Expression(expression) => Some(expression),
        }
    }
}

fn no() -> Number {
    Number::Literal(Value::Bool(false))
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl Visitor<'_> for Any {
            type Value = Number;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a number, true, false, or an expression in quotes")
            }
            fn visit_bool<E: Error>(self, v: bool) -> Result<Number, E> {
                Ok(Number::Literal(Value::Bool(v)))
            }
            fn visit_i64<E: Error>(self, v: i64) -> Result<Number, E> {
                Ok(Number::Literal(Value::Int(v)))
            }
            fn visit_u64<E: Error>(self, v: u64) -> Result<Number, E> {
                i64::try_from(v)
                    .map(|v| Number::Literal(Value::Int(v)))
                    .map_err(|_| E::custom(format!("{v} does not fit in a signed 64-bit integer")))
            }
            fn visit_f64<E: Error>(self, v: f64) -> Result<Number, E> {
                if !v.is_finite() {
                    return Err(E::custom(format!("expected a finite number, found {v}")));
                }
                Ok(Number::Literal(Value::Float(v)))
            }
            fn visit_str<E: Error>(self, v: &str) -> Result<Number, E> {
                Ok(Number::Expression(v.to_string().into()))
            }
        }
        deserializer.deserialize_any(Any)
    }
}

/// A parameter's declaration.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename = "Param")]
pub enum ParamDecl {
    /// A constant: a change rebuilds the plan.
    Const(ParamKind),
    /// A live parameter: a change writes one uniform.
    Live(ParamKind),
}

impl ParamDecl {
    /// Returns the type, range and texts.
    pub fn kind(&self) -> &ParamKind {
        let (ParamDecl::Const(kind) | ParamDecl::Live(kind)) = self;
        kind
    }
}

/// The type, range and texts of a parameter.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Type")]
pub enum ParamKind {
    /// A parameter that is true or false.
    Bool {
        /// Default: a value, or an expression over other parameters and facts.
        default: Number,
        /// Value at which the result is exact.
        #[serde(default)]
        exact: Option<Number>,
        /// Short text for the control; empty by default.
        #[serde(default)]
        label: String,
        /// Longer explanation for the user; empty by default.
        #[serde(default)]
        help: String,
    },
    /// An integer. Its range must fit into 32 bits.
    Int {
        /// Default: a value, or an expression over other parameters and facts.
        default: Number,
        /// Minimum and maximum, inclusive.
        range: (Number, Number),
        /// Value at which the result is exact.
        #[serde(default)]
        exact: Option<Number>,
        /// Statistic that this capacity must cover, if any: the value is raised to it. Only for `Const`.
        #[serde(default)]
        grows: Option<String>,
        /// Short text for the control; empty by default.
        #[serde(default)]
        label: String,
        /// Longer explanation for the user; empty by default.
        #[serde(default)]
        help: String,
    },
    /// A floating-point number; 32 bits in shaders.
    Float {
        /// Default: a value, or an expression over other parameters and facts.
        default: Number,
        /// Minimum and maximum, inclusive.
        range: (Number, Number),
        /// The step of the slider; a hundredth of the range by default.
        #[serde(default)]
        step: Option<Number>,
        /// Value at which the result is exact.
        #[serde(default)]
        exact: Option<Number>,
        /// Short text for the control; empty by default.
        #[serde(default)]
        label: String,
        /// Longer explanation for the user; empty by default.
        #[serde(default)]
        help: String,
    },
    /// One of several names.
    Choice {
        /// One of the names, or an expression with such a value.
        default: Expression,
        /// Names to choose from; their indices are the values in shaders.
        of: Vec<String>,
        /// Option at which the result is exact.
        #[serde(default)]
        exact: Option<Expression>,
        /// Short text for the control; empty by default.
        #[serde(default)]
        label: String,
        /// Longer explanation for the user; empty by default.
        #[serde(default)]
        help: String,
    },
}

impl ParamKind {
    /// Returns the default as written.
    pub fn default(&self) -> Number {
        match self {
            ParamKind::Bool { default, .. }
            | ParamKind::Int { default, .. }
            | ParamKind::Float { default, .. } => default.clone(),
            ParamKind::Choice { default, .. } => Number::Expression(default.clone()),
        }
    }

    /// Returns the value at which the result is exact, as written; `None` if the graph names none.
    pub fn exact(&self) -> Option<Number> {
        match self {
            ParamKind::Bool { exact, .. } | ParamKind::Int { exact, .. } | ParamKind::Float { exact, .. } => {
                exact.clone()
            }
            ParamKind::Choice { exact, .. } => exact.clone().map(Number::Expression),
        }
    }
}

/// An import of data from the scene or the host.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Import {
    /// Full name of the data, such as `scene.position` or `frame.camera`.
    pub from: String,
    /// Number of planes to bind as an array of blocks; 1 by default.
    #[serde(default)]
    pub planes: Option<Number>,
}

/// A resource that the includer supplies.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Port {
    /// A buffer of the including graph.
    Buffer {
        /// Bytes per element.
        stride: Number,
        /// True to take both halves of a ping-pong buffer; otherwise only the front.
        #[serde(default)]
        ping_pong: bool,
    },
    /// An image of the including graph.
    Image {
        /// Required format; any by default.
        #[serde(default)]
        format: Option<Expression>,
    },
}

/// The parameters of an included graph that become the includer's.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Expose {
    /// Every parameter that is not in `set`.
    All,
    /// These parameters. A value in `set` replaces a parameter's default.
    Only(Vec<String>),
}

/// A resource's declaration.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Resource")]
pub enum ResourceDecl {
    /// A buffer of equal elements.
    Buffer {
        /// Bytes per element, a multiple of 4.
        stride: Number,
        /// Number of elements.
        count: Number,
        /// True for a pair of buffers, front and back, which `Swap` exchanges. Each frame starts with the same front.
        #[serde(default)]
        ping_pong: bool,
        /// Keeps the contents from frame to frame: `last(name)` reads the previous frame's. Initially zeros.
        #[serde(default = "no")]
        history: Number,
    },
    /// A two-dimensional image.
    Image {
        /// A format: its name in GLSL (`rgba16f`), `depth32f`, or an expression with such a value.
        format: Expression,
        /// Width and height in pixels, 1 to 32768.
        size: (Number, Number),
        /// True to keep the contents from frame to frame, as for buffers. After a change of size, the first frame reads
        /// zeros.
        #[serde(default = "no")]
        history: Number,
    },
}

// As for `Document`, the sizes of the variants do not matter.
/// A pass, or a construct that generates passes.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Pass")]
pub enum PassDecl {
    /// Runs a compute shader.
    Dispatch {
        /// Unique name of the pass.
        name: String,
        /// Group under which the pass's GPU time is summed; the pass's name by default.
        #[serde(default)]
        phase: Option<String>,
        /// Runs in every frame by default, or once after a change of plan or scene.
        #[serde(default = "every_frame")]
        run: Run,
        /// Removes the pass if false.
        #[serde(default)]
        when: Option<Number>,
        /// File name of the compute shader, or an expression that chooses one.
        shader: Expression,
        /// Number of invocations or workgroups.
        size: Size,
        /// Resource for each GLSL block or image variable, by its name.
        #[serde(default)]
        bind: IndexMap<String, Reference>,
        /// Value for each member of the push-constant block, by its name.
        #[serde(default)]
        push: IndexMap<String, Number>,
    },
    /// Draws primitives to colour attachments, and tests them against the depth attachment, if any.
    Draw {
        /// Unique name of the pass.
        name: String,
        /// Group under which the pass's GPU time is summed; the pass's name by default.
        #[serde(default)]
        phase: Option<String>,
        /// Removes the pass if false.
        #[serde(default)]
        when: Option<Number>,
        /// File name of the vertex shader, or an expression that chooses one.
        vertex: Expression,
        /// File name of the fragment shader, or an expression that chooses one.
        fragment: Expression,
        /// Primitive type that the vertices form.
        topology: Topology,
        /// Number of vertices and instances.
        call: Call,
        /// Resource for each GLSL block or image variable, by its name.
        #[serde(default)]
        bind: IndexMap<String, Reference>,
        /// Value for each member of the push-constant block, by its name.
        #[serde(default)]
        push: IndexMap<String, Number>,
        /// Colour attachments, in the order of output locations.
        targets: Vec<TargetDecl>,
        /// Depth attachment; without one, every fragment passes.
        #[serde(default)]
        depth: Option<DepthDecl>,
    },
    /// Sets every 32-bit word of the buffer to `value`.
    Fill {
        /// Unique name of the pass.
        name: String,
        /// Group under which the pass's GPU time is summed; the pass's name by default.
        #[serde(default)]
        phase: Option<String>,
        /// Removes the pass if false.
        #[serde(default)]
        when: Option<Number>,
        /// Buffer to fill.
        buffer: Reference,
        /// 32-bit word to fill with.
        value: Number,
    },
    /// Repeats the body `count` times, with `var` counting from 0.
    Repeat {
        /// Name of the counter in expressions of the body.
        var: String,
        /// Number of iterations.
        count: Number,
        /// Passes of one iteration.
        body: Vec<PassDecl>,
    },
    /// Exchanges the front and the back of a resource for the passes that follow.
    Swap(String),
    /// Includes the passes of another graph, with its ports bound to resources of this one.
    Include {
        /// Name of the included graph, preset or choice.
        graph: String,
        /// Prefix for the names of the included graph's passes and resources.
        name: String,
        /// Removes the passes and resources of the included graph if false.
        #[serde(default)]
        when: Option<Number>,
        /// Resource of this graph for each port, by the port's name.
        #[serde(default)]
        with: IndexMap<String, Reference>,
        /// Values for parameters of the included graph, by parameter name.
        #[serde(default)]
        set: IndexMap<String, Number>,
        /// Parameters of the included graph that become this graph's; none by default.
        #[serde(default = "nothing")]
        expose: Expose,
    },
}

impl PassDecl {
    /// Returns the condition of a pass. `Repeat` and `Swap` have none.
    pub fn when(&self) -> Option<&Number> {
        match self {
            PassDecl::Dispatch { when, .. }
            | PassDecl::Draw { when, .. }
            | PassDecl::Fill { when, .. }
            | PassDecl::Include { when, .. } => when.as_ref(),
            PassDecl::Repeat { .. } | PassDecl::Swap(_) => None,
        }
    }
}

fn nothing() -> Expose {
    Expose::Only(Vec::new())
}

fn every_frame() -> Run {
    Run::Frame
}

// As for `Document`, the sizes of the variants do not matter.
/// The size of a dispatch, in invocations or workgroups.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, Deserialize)]
pub enum Size {
    /// Enough workgroups for this many invocations.
    Threads(Extent),
    /// This many workgroups.
    Groups(Extent),
    /// Three 32-bit words of a buffer, at a byte offset (a multiple of 4): workgroups in x, y and z.
    Indirect(Reference, Number),
}

/// A count in one to three dimensions: `(n)`, `(x, y)` or `(x, y, z)`.
///
/// A single dimension is folded into y if it exceeds the limit in x.
#[derive(Clone, Debug, PartialEq)]
pub struct Extent(pub Vec<Number>);

impl<'de> Deserialize<'de> for Extent {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Dimensions;
        impl<'de> Visitor<'de> for Dimensions {
            type Value = Extent;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("one to three numbers")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut numbers: A) -> Result<Extent, A::Error> {
                let mut found = Vec::new();
                while found.len() < 3 {
                    match numbers.next_element()? {
                        Some(number) => found.push(number),
                        None => break,
                    }
                }
                if found.is_empty() { Err(A::Error::invalid_length(0, &self)) } else { Ok(Extent(found)) }
            }
        }
        deserializer.deserialize_tuple(3, Dimensions)
    }
}

/// The numbers of vertices and instances of a draw.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Call {
    /// The numbers are known when the plan is built.
    Direct {
        /// Number of vertices per instance.
        vertices: Number,
        /// Number of instances.
        instances: Number,
    },
    /// Four 32-bit words of a buffer, at a byte offset (a multiple of 4): vertices, instances, first vertex, first
    /// instance. The last must be 0 on a device without Vulkan's `drawIndirectFirstInstance`.
    Indirect(Reference, Number),
}

/// A colour attachment.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Target")]
pub struct TargetDecl {
    /// Image to draw into.
    pub image: Reference,
    /// Contents of the target before the draw.
    pub load: Load,
    /// Blend equation of a fragment's colour and the target's.
    pub blend: Blend,
    /// Removes the attachment if false.
    #[serde(default)]
    pub when: Option<Number>,
}

/// The declaration of a depth attachment.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Depth")]
pub struct DepthDecl {
    /// The image, of the format `depth32f`.
    pub image: Reference,
    /// Use of the image by the draw: clear, test and write; test and write; or only test.
    pub access: DepthAccess,
    /// Removes the attachment if false.
    #[serde(default)]
    pub when: Option<Number>,
}
