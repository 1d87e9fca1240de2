//! A stub shader compiler for tests: its shaders are lists of accesses.
//!
//! A shader's text has one line per block: `r Keys 4` (reads a storage buffer of 4-byte elements), `w`, `rw`, `rwa`
//! (read and write by atomics), `n` (neither: asks for its length), `uniform Camera 256`, `image r Color rgba16f`.
//! Further lines are `push shift`, `out color`, `live stop` (names of live parameters), and `local 8 4 1` (workgroup
//! size, by default 64 in x). Other lines declare nothing. Every word is a use of the define of that name. Lines that
//! begin with `#if 0` count as code that is not compiled.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use splatgraph_framework::build;
use splatgraph_framework::ir::{
    Attribute, Catalog, DeviceFacts, Facts, Features, Format, HostBuffer, LIVE_BINDING, LIVE_BLOCK, Member,
    MemberKind, PushBlock, ReflectedBinding, ReflectedKind, Reflection, Request, Value, Varying,
};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::{Compiled, ShaderCompiler, ShaderRequest};
use splatgraph_framework::source::{Diagnostic, Library, SourceMap, render};

pub struct ListCompiler;

impl ShaderCompiler for ListCompiler {
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let mut reflection = Reflection {
            stage: request.stage,
            local_size: [64, 1, 1],
            shared_bytes: 0,
            bindings: Vec::new(),
            push: None,
            inputs: Vec::new(),
            outputs: Vec::new(),
            uses_position: true,
            ignores_rows: false,
            features: Features::empty(),
        };
        let text = files.text(request.file).to_string();
        let words = |skipped: bool| -> BTreeSet<String> {
            let lines = text.lines().filter(|line| skipped || !line.starts_with("#if 0"));
            lines.flat_map(str::split_whitespace).map(str::to_string).collect()
        };
        // A draw's two stages share one set of bindings, so the fragment shader's are numbered from 16. `count.frag`
        // has the same bindings as `count.vert`.
        let path = files.path(request.file);
        let first = if path.ends_with(".frag") && !path.ends_with("count.frag") { 16 } else { 0 };
        for line in text.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let number = first + reflection.bindings.len() as u32;
            let mut bind = |name: &str, how: &str, kind, binding| {
                reflection.bindings.push(ReflectedBinding {
                    name: name.into(),
                    set: 0,
                    binding,
                    count: 1,
                    kind,
                    reads: how.contains('r'),
                    writes: how.contains('w'),
                    atomics: how.contains('a'),
                    atomics_only: how.contains('a'),
                    writes_first: !how.contains('r'),
                    scalar: MemberKind::Other,
                    words: vec![],
                });
            };
            match words[..] {
                [how @ ("r" | "w" | "rw" | "rwa" | "n"), name, stride] => {
                    let stride = stride.parse().ok();
                    bind(name, how, ReflectedKind::StorageBuffer { stride, fixed_bytes: 0 }, number);
                }
                ["uniform", name, bytes] => {
                    let kind =
                        ReflectedKind::UniformBuffer { bytes: bytes.parse().unwrap(), members: vec![] };
                    bind(name, "r", kind, number);
                }
                ["image", how, name, format] => {
                    let format = Format::ALL.into_iter().find(|f| f.name() == format).expect("a format");
                    bind(name, how, ReflectedKind::StorageImage { format: Some(format) }, number);
                }
                ["local", ref size @ ..] if size.len() == 3 => {
                    reflection.local_size = std::array::from_fn(|axis| size[axis].parse().unwrap());
                }
                ["push", name] => {
                    let block = reflection.push.get_or_insert(PushBlock { bytes: 0, members: vec![] });
                    block.members.push(Member {
                        name: name.into(),
                        offset: block.bytes,
                        kind: MemberKind::Uint,
                        used: true,
                    });
                    block.bytes += 4;
                }
                ["live", ref names @ ..] => {
                    let member = |(i, name): (usize, &&str)| Member {
                        name: name.to_string(),
                        offset: 4 * i as u32,
                        kind: MemberKind::Float,
                        used: true,
                    };
                    let members = names.iter().enumerate().map(member).collect();
                    let kind = ReflectedKind::UniformBuffer { bytes: 16, members };
                    bind(LIVE_BLOCK, "r", kind, LIVE_BINDING);
                }
                ["out", name] => {
                    let location = reflection.outputs.len() as u32;
                    let glsl_type = "vec4".into();
                    reflection.outputs.push(Varying { name: name.into(), location, glsl_type });
                }
                _ => {}
            }
        }
        Ok(Compiled {
            spirv: Arc::new(vec![]),
            defines: request
                .defines
                .iter()
                .filter(|define| words(true).contains(&define.0))
                .cloned()
                .collect(),
            reached: Arc::new(words(false)),
            reflection,
            declared: Arc::default(),
        })
    }
}

/// Returns the facts of a scene of 1000 splats and a viewport of 64 x 32. The device has subgroups of 8 lanes, and no
/// limits on the invocations and shared memory of a workgroup.
pub fn facts() -> Facts {
    let ints =
        [("scene.count", 1000), ("scene.sh_degree", 2), ("viewport.width", 64), ("viewport.height", 32)];
    let device = DeviceFacts {
        shared_bytes: u32::MAX,
        max_invocations: u32::MAX,
        rounds_half: false,
        ..DeviceFacts::typical(8)
    };
    Facts { host: ints.map(|(k, v)| (k.to_string(), Value::Int(v))).into(), ..device.into() }
}

pub fn catalog() -> Catalog {
    let attribute = |stride, planes| Attribute { stride, count: 1000, planes };
    Catalog {
        attributes: BTreeMap::from([
            ("scene.position".to_string(), attribute(12, 1)),
            ("scene.scale".to_string(), attribute(12, 1)),
            ("scene.sh".to_string(), attribute(16, 12)),
        ]),
        uniforms: BTreeMap::from([("frame.camera".to_string(), 256)]),
        buffers: BTreeMap::from([("frame.words".to_string(), HostBuffer { stride: 4, least: 4 })]),
        families: BTreeMap::new(),
    }
}

/// Builds `graph.ron` from [`SHADERS`] and `files`, pairs of a path and a text. Errors are rendered as for a user.
pub fn try_plan_of(files: &[(&str, &str)], set: &[(&str, &str)]) -> Result<Plan, String> {
    plan_with(files, set, &[], true)
}

/// Builds a plan as [`try_plan_of`] does; panics on errors.
pub fn plan_of(files: &[(&str, &str)], set: &[(&str, &str)]) -> Plan {
    try_plan_of(files, set).unwrap_or_else(|errors| panic!("{errors}"))
}

/// Builds a plan from the text of a graph that uses [`SHADERS`]; panics on errors.
pub fn plan(graph: &str, set: &[(&str, &str)]) -> Plan {
    plan_of(&[("graph.ron", graph)], set)
}

/// Builds a graph as [`plan`] does, with minimum values for growing parameters.
pub fn plan_with_capacities(graph: &str, set: &[(&str, &str)], capacities: &[(&str, i64)]) -> Plan {
    plan_with(&[("graph.ron", graph)], set, capacities, true).unwrap_or_else(|errors| panic!("{errors}"))
}

/// Builds a graph as [`plan`] does, but with every resource in its own memory.
pub fn apart(graph: &str) -> Plan {
    plan_with(&[("graph.ron", graph)], &[], &[], false).unwrap_or_else(|errors| panic!("{errors}"))
}

/// Builds a graph as [`plan`] does, and returns its errors; panics if there are none.
pub fn error_of(graph: &str) -> String {
    try_plan_of(&[("graph.ron", graph)], &[]).expect_err("the graph has a mistake")
}

fn plan_with(
    files: &[(&str, &str)],
    set: &[(&str, &str)],
    capacities: &[(&str, i64)],
    share_memory: bool,
) -> Result<Plan, String> {
    let files = SHADERS.iter().chain(files);
    let memory = files.map(|(k, v)| (k.to_string(), v.to_string())).collect();
    let mut map = SourceMap::new(Library { memory, ..Library::default() });
    let set: Vec<_> = set.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect();
    let capacities: Vec<_> = capacities.iter().map(|(name, least)| (name.to_string(), *least)).collect();
    let (facts, catalog) = (facts(), catalog());
    let request = Request {
        graph: "graph.ron",
        set: &set,
        capacities: &capacities,
        facts: &facts,
        catalog: &catalog,
        share_memory,
    };
    build(&request, &mut map, &mut ListCompiler).map_err(|e| render(&map, &e, false))
}

/// Returns a graph with the given parameters and passes. Its resources are the 32-bit buffers `a` to `f`, the
/// ping-pong buffer `keys`, and the images `color` and `image`.
pub fn graph(params: &str, passes: &str) -> String {
    let buffers: String = ('a'..='f').map(|c| format!("\"{c}\": Buffer(stride: 4, count: 64),\n")).collect();
    format!(
        r#"Graph(version: 1, summary: "a test", params: {{{params}}},
    resources: {{
        {buffers}
        "keys": Buffer(stride: 4, count: 64, ping_pong: true),
        "color": Image(format: "rgba16f", size: ("viewport.width", "viewport.height")),
        "image": Image(format: "rgba16f", size: ("viewport.width", "viewport.height")),
    }},
    passes: [
{passes}
    ],
    output: "image",
)"#
    )
}

/// Shaders for [`graph`], as texts for [`ListCompiler`].
pub const SHADERS: &[(&str, &str)] = &[
    ("make.comp", "w Out 4"),
    ("copy.comp", "r In 4\nw Out 4"),
    ("join.comp", "r In 4\nr In2 4\nw Out 4"),
    ("change.comp", "rw Out 4"),
    ("show.comp", "r In 4\nimage w Image rgba16f"),
    ("mix.comp", "r In 4\nimage rw Image rgba16f"),
    ("join_show.comp", "r In 4\nr In2 4\nimage w Image rgba16f"),
    ("filter.comp", "image r Color rgba16f\nimage w Image rgba16f"),
    ("pair.comp", "w Out 4\nw Out2 4"),
    ("paint.comp", "image w Color rgba16f"),
    ("camera.comp", "uniform Camera 256\nw Out 4"),
    ("count.vert", "rwa Count 4"),
    ("count.frag", "rwa Count 4\nout color"),
    ("push.comp", "w Out 4\npush shift"),
    ("length.comp", "n In 4\nw Out 4"),
    ("size.comp", "image n Color rgba16f\nw Out 4"),
    ("quad.vert", "r In 4"),
    ("quad.frag", "out color"),
];

pub fn dispatch(name: &str, shader: &str, bind: &str) -> String {
    format!(r#"        Dispatch(name: "{name}", shader: "{shader}", size: Threads(64), bind: {{{bind}}}),"#)
}

/// Returns a dispatch that writes the buffer `a`.
pub fn make() -> String {
    dispatch("make", "make.comp", r#""Out": "a""#)
}

/// Returns a dispatch that reads the buffer `a` and writes the output.
pub fn show() -> String {
    dispatch("show", "show.comp", r#""In": "a", "Image": "image""#)
}

/// Returns a draw of two quads into the image `color`. Its vertex shader reads the buffer `a`.
pub fn draw(name: &str, load: &str) -> String {
    format!(
        r#"Draw(name: "{name}", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {{"In": "a"}}, targets: [Target(image: "color", load: {load}, blend: PremultipliedOver)]),"#
    )
}

/// Returns the names of the passes of the frame, in order.
pub fn frame(plan: &Plan) -> Vec<&str> {
    plan.frame.iter().map(|id| plan.pass(*id).name.as_str()).collect()
}
