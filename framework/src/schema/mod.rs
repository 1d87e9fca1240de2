//! The graph as written: the typed tree that serde builds from a RON file.
//!
//! Nothing is resolved here. Numbers may still be expressions ([`Number`]), names may still be wrong, an included
//! graph is still a name. What a field means is said here; what it is worth is found in [`crate::lower`].

use indexmap::IndexMap;
use serde::Deserialize;
use serde::de::{Deserializer, Error, Visitor};
use std::fmt;

use crate::ir::{Blend, Load, Run, Topology, Value};

/// The version of the graph language that this framework reads.
pub const GRAPH_VERSION: u32 = 1;

/// What a `.ron` file of `pipelines/` holds.
// A tree of a few kilobytes that lives for a moment: the size of its variants does not matter.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, Deserialize)]
pub enum Document {
    Graph(Graph),
    Preset(Preset),
}

/// A graph under other defaults.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preset {
    /// The graph or preset that this one is based on.
    pub graph: String,
    pub summary: String,
    pub set: IndexMap<String, Number>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    pub version: u32,
    /// One line that says what this renderer does.
    pub summary: String,
    #[serde(default)]
    pub params: IndexMap<String, ParamDecl>,
    /// Named expressions over parameters, facts and the entries before.
    #[serde(default, rename = "let")]
    pub lets: IndexMap<String, Number>,
    /// What the scene and the host give.
    #[serde(default)]
    pub imports: IndexMap<String, Import>,
    /// In a graph made to be included: the resources that the includer gives.
    #[serde(default)]
    pub ports: IndexMap<String, Port>,
    #[serde(default)]
    pub resources: IndexMap<String, ResourceDecl>,
    pub passes: Vec<PassDecl>,
    /// 32-bit words to read back after each frame: buffer, byte offset.
    #[serde(default)]
    pub stats: IndexMap<String, (String, Number)>,
    /// The image that is shown. Every graph has one, but for those made to be included.
    #[serde(default)]
    pub output: Option<String>,
}

/// A number, a bool or a text; as a string, an expression.
#[derive(Clone, Debug, PartialEq)]
pub enum Number {
    Literal(Value),
    Expression(String),
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
                    .map_err(|_| E::custom(format!("{v} does not fit 64 bits with a sign")))
            }
            fn visit_f64<E: Error>(self, v: f64) -> Result<Number, E> {
                Ok(Number::Literal(Value::Float(v)))
            }
            fn visit_str<E: Error>(self, v: &str) -> Result<Number, E> {
                Ok(Number::Expression(v.into()))
            }
        }
        deserializer.deserialize_any(Any)
    }
}

#[derive(Clone, Debug, Deserialize)]
pub enum ParamDecl {
    /// A change rebuilds the plan.
    Const(ParamKind),
    /// A change writes one uniform.
    Live(ParamKind),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ParamKind {
    Bool {
        default: Number,
        #[serde(default)]
        exact: Option<Number>,
        #[serde(default)]
        label: String,
        #[serde(default)]
        help: String,
    },
    Int {
        default: Number,
        /// Inclusive.
        range: (Number, Number),
        #[serde(default)]
        exact: Option<Number>,
        #[serde(default)]
        label: String,
        #[serde(default)]
        help: String,
    },
    Float {
        default: Number,
        /// Inclusive.
        range: (Number, Number),
        /// Of the slider; a hundredth of the range where nothing is said.
        #[serde(default)]
        step: Option<Number>,
        #[serde(default)]
        exact: Option<Number>,
        #[serde(default)]
        label: String,
        #[serde(default)]
        help: String,
    },
    Choice {
        /// One of the names, or an expression that comes to one.
        default: String,
        of: Vec<String>,
        #[serde(default)]
        exact: Option<String>,
        #[serde(default)]
        label: String,
        #[serde(default)]
        help: String,
    },
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Import {
    /// `scene.*` or `frame.*`.
    pub from: String,
    /// Number of planes to bind as an array of blocks.
    #[serde(default)]
    pub planes: Option<Number>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Port {
    Buffer {
        stride: Number,
        #[serde(default)]
        ping_pong: bool,
    },
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ResourceDecl {
    Buffer {
        /// Bytes per element.
        stride: Number,
        count: Number,
        /// Two buffers, of which one is the front; `Swap` exchanges them. Each frame starts at the same front.
        #[serde(default)]
        ping_pong: bool,
        /// Contents live on: `last(name)` is what the frame before left. Zeros at first.
        #[serde(default)]
        history: bool,
    },
    Image {
        /// GLSL's name of a format (`rgba16f`), or an expression that comes to one.
        format: String,
        /// Width and height in pixels.
        size: (Number, Number),
        /// As for buffers. An image of another size starts from zeros again.
        #[serde(default)]
        history: bool,
    },
}

// See `Document` for why.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum PassDecl {
    Dispatch {
        name: String,
        /// The group that its time is counted under; its name where nothing is said.
        #[serde(default)]
        phase: Option<String>,
        #[serde(default = "every_frame")]
        run: Run,
        /// Removes the pass where it is false.
        #[serde(default)]
        when: Option<Number>,
        shader: String,
        size: Size,
        #[serde(default)]
        bind: IndexMap<String, String>,
        #[serde(default)]
        push: IndexMap<String, Number>,
        #[serde(default)]
        define: IndexMap<String, Number>,
    },
    Draw {
        name: String,
        #[serde(default)]
        phase: Option<String>,
        #[serde(default)]
        when: Option<Number>,
        vertex: String,
        fragment: String,
        topology: Topology,
        call: Call,
        #[serde(default)]
        bind: IndexMap<String, String>,
        #[serde(default)]
        push: IndexMap<String, Number>,
        #[serde(default)]
        define: IndexMap<String, Number>,
        targets: Vec<TargetDecl>,
    },
    /// Every 32-bit word of the buffer becomes `value`.
    Fill {
        name: String,
        #[serde(default)]
        phase: Option<String>,
        #[serde(default)]
        when: Option<Number>,
        buffer: String,
        value: Number,
    },
    /// The body, `count` times, with `var` counting from 0.
    Repeat { var: String, count: Number, body: Vec<PassDecl> },
    /// From here on the resource's front is its back, and the other way round.
    Swap(String),
    /// The passes of another graph, with its ports bound to resources of this one.
    Include {
        graph: String,
        /// Goes in front of the names of its passes and resources.
        name: String,
        #[serde(default)]
        when: Option<Number>,
        with: IndexMap<String, String>,
        #[serde(default)]
        set: IndexMap<String, Number>,
    },
}

fn every_frame() -> Run {
    Run::Frame
}

/// How many workgroups a dispatch has.
#[derive(Clone, Debug, Deserialize)]
pub enum Size {
    /// Enough workgroups for this many invocations; those that do not fit in x are folded into y.
    Threads(Number),
    /// Workgroups in x.
    Groups(Number),
    /// Three words of a buffer, at a byte offset.
    Indirect(String, Number),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Call {
    Direct {
        vertices: Number,
        instances: Number,
    },
    /// Four words of a buffer, at a byte offset: vertices, instances, first vertex, first instance.
    Indirect(String, Number),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Target")]
pub struct TargetDecl {
    pub image: String,
    pub load: Load,
    pub blend: Blend,
}
