//! Writes a sketch as text: `graph.ron` and its shaders.
//!
//! Shaders compute pure functions of their inputs: words are mixed with a hash, drawn images get integers that floats
//! represent exactly, and no invocation reads data that another one of its pass writes. (Draws write buffers by
//! `atomicMax`, whose result does not depend on the order.) So if two runs differ in a byte, the cause is their
//! barriers.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::recipe::{Content, Count, Half, Kind, Role, Stage, Stands, When};
use super::sketch::{Bind, Node, Pass, Ref, Sketch, Target};

pub struct Files {
    pub graph: String,
    /// Name and text.
    pub shaders: Vec<(String, String)>,
    /// Name and text of the graphs that this one includes.
    pub parts: Vec<(String, String)>,
}

/// Variations of the text: naming, and additional passes or includes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Style {
    /// True for other names of equal length, which sort in reverse.
    pub other_names: bool,
    /// True to add passes without readers, each after another pass.
    pub idle_passes: bool,
    /// True to move passes into included graphs.
    pub includes: bool,
    /// Depth of the include that is being written.
    pub depth: usize,
}

pub fn render(sketch: &Sketch, style: Style) -> Files {
    let mut writer = Writer {
        sketch,
        style,
        shaders: BTreeMap::new(),
        passes: String::new(),
        idle: 0,
        idle_runs: false,
        idle_shaders: Vec::new(),
        parts: Vec::new(),
    };
    writer.nodes(&sketch.nodes, false);
    let Writer { shaders, passes, idle, idle_shaders, parts, .. } = writer;

    let mut resources = String::new();
    let flags = |flags: &[(&str, bool)]| -> String {
        flags.iter().filter(|(_, on)| *on).map(|(name, _)| format!(", {name}: true")).collect()
    };
    for (at, buffer) in sketch.buffers.iter().enumerate() {
        let (name, stride) = (style.resource(Target::Buffer(at)), sketch.stride(at));
        let flags = flags(&[("ping_pong", buffer.role == Role::PingPong), ("history", buffer.history)]);
        let count = buffer.words * 4 / stride;
        let _ = writeln!(resources, "    \"{name}\": Buffer(stride: {stride}, count: {count}{flags}),");
    }
    for (at, image) in sketch.images.iter().enumerate() {
        let (width, height) = sketch.size(at);
        let (name, format) = (style.resource(Target::Image(at)), format(sketch, at));
        let flags = flags(&[("history", image.history)]);
        let _ = writeln!(
            resources,
            "    \"{name}\": Image(format: \"{format}\", size: ({width}, {height}){flags}),"
        );
    }
    for at in 0..idle {
        let _ = writeln!(resources, "    \"idle{at}\": Buffer(stride: 4, count: 16),");
    }
    let stats: String = (sketch.stats.iter().enumerate())
        .map(|(at, (what, offset))| format!("\"s{at}\": (\"{}\", {offset}), ", style.resource(what.of)))
        .collect();
    let [settings, _] = sketch.settings;
    let grows = if stats.is_empty() { "" } else { ", grows: \"s0\"" };
    let graph = format!(
        r#"Graph(
  version: 1, summary: "at random",
  params: {{
    "flag": Const(Bool(default: {})),
    "steps": Const(Int(default: {}, range: (0, 4){grows})),
  }},
  resources: {{
{resources}  }},
  passes: [
{passes}  ],
  stats: {{ {stats}}},
  output: "{}",
)
"#,
        settings.flag,
        settings.steps,
        style.resource(Target::Image(sketch.output())),
    );
    let shaders = shaders.into_iter().map(|(text, name)| (name, text)).chain(idle_shaders).collect();
    Files { graph, shaders, parts }
}

impl Style {
    fn number(self, at: usize) -> usize {
        if self.other_names { 99 - at } else { at }
    }

    fn resource(self, of: Target) -> String {
        let letters = if self.other_names { ["y", "x"] } else { ["b", "i"] };
        // The ports of an included graph have their own names.
        let port = "p".repeat(self.depth);
        match of {
            Target::Buffer(at) => format!("{port}{}{:02}", letters[0], self.number(at)),
            Target::Image(at) => format!("{port}{}{:02}", letters[1], self.number(at)),
        }
    }

    fn named(self, what: Ref) -> String {
        let name = self.resource(what.of);
        match what.half {
            Half::Front => name,
            Half::Back => format!("back({name})"),
            Half::Last => format!("last({name})"),
        }
    }

    fn pass(self, at: usize) -> String {
        format!("{}{:02}", if self.other_names { 'q' } else { 'p' }, self.number(at))
    }
}

fn format(sketch: &Sketch, image: usize) -> &'static str {
    match sketch.images[image].content {
        Content::Color => "rgba32f",
        Content::Word => "r32ui",
        Content::Depth => "depth32f",
    }
}

fn is_color(sketch: &Sketch, image: usize) -> bool {
    sketch.images[image].content == Content::Color
}

struct Writer<'a> {
    sketch: &'a Sketch,
    style: Style,
    /// Names of shaders by their text.
    shaders: BTreeMap<String, String>,
    passes: String,
    /// Number of idle passes so far.
    idle: usize,
    /// True if the next idle pass may read the last one. It may if the last one runs under all settings and reads no
    /// idle pass.
    idle_runs: bool,
    idle_shaders: Vec<(String, String)>,
    parts: Vec<(String, String)>,
}

/// Maximum depth of nested includes.
const MAX_DEPTH: usize = 3;

impl Writer<'_> {
    fn nodes(&mut self, mut nodes: &[Node], repeated: bool) {
        while let Some((first, rest)) = nodes.split_first() {
            let run = nodes.iter().take_while(|node| self.fits_a_part(node)).count();
            if self.style.includes && self.style.depth < MAX_DEPTH && run > 0 {
                self.part(&nodes[..run], repeated);
                nodes = &nodes[run..];
            } else {
                self.node(first, repeated);
                nodes = rest;
            }
        }
    }

    /// Returns true if a node belongs into an included graph. Half of the passes with images stay outside, to test both.
    fn fits_a_part(&self, node: &Node) -> bool {
        match node {
            Node::Pass(at) => {
                let pass = &self.sketch.passes[*at];
                pass.salt.is_multiple_of(2)
                    || pass.uses().all(|(what, _)| matches!(what.of, Target::Buffer(_)))
            }
            Node::Swap(..) => true,
            Node::Repeat(_, body) => body.iter().all(|node| self.fits_a_part(node)),
        }
    }

    /// Writes `nodes` as an included graph, and the line that includes it. The graph has the first node itself; the
    /// others go to a graph that it includes, or at [`MAX_DEPTH`] follow the first.
    fn part(&mut self, nodes: &[Node], repeated: bool) {
        let name = format!("part{}", self.parts.len());
        // Reserves the graph's entry, before those of the graphs that it includes.
        self.parts.push((format!("{name}.ron"), String::new()));
        let place = self.parts.len() - 1;
        let outer = self.style;
        let around = std::mem::take(&mut self.passes);
        self.style.depth += 1;
        self.node(&nodes[0], repeated);
        self.nodes(&nodes[1..], repeated);
        let passes = std::mem::replace(&mut self.passes, around);

        let mut all = BTreeMap::new();
        touched(nodes, self.sketch, &mut all);
        let (mut ports, mut with) = (String::new(), String::new());
        for (of, both) in all {
            let inner = self.style.resource(of);
            let port = match of {
                Target::Buffer(at) => {
                    let pair = both && self.sketch.buffers[at].role == Role::PingPong;
                    let pair = if pair { ", ping_pong: true" } else { "" };
                    format!("Buffer(stride: {}{pair})", self.sketch.stride(at))
                }
                Target::Image(at) => format!("Image(format: \"{}\")", format(self.sketch, at)),
            };
            let _ = writeln!(ports, "    \"{inner}\": {port},");
            with += &format!("\"{inner}\": \"{}\", ", outer.resource(of));
        }
        // Declares the constants that conditions, counts and push constants may name.
        let (mut params, mut set) = (String::new(), String::new());
        let ranges = [("steps", "Int(default: 0, range: (0, 4))"), ("flag", "Bool(default: false)")];
        let index = [("i", "Int(default: 0, range: (0, 9))")];
        for (param, kind) in ranges.iter().chain(index.iter().filter(|_| repeated)) {
            params += &format!("\"{param}\": Const({kind}), ");
            set += &format!("\"{param}\": \"{param}\", ");
        }
        self.style = outer;
        self.parts[place].1 = format!(
            "Graph(\n  version: 1, summary: \"a part\",\n  params: {{ {params}}},\n  ports: {{\n{ports}  }},\n  passes: [\n{passes}  ],\n)\n"
        );
        self.line(&format!(
            "Include(graph: \"{name}\", name: \"{name}\", with: {{ {with}}}, set: {{ {set}}}),"
        ));
    }

    fn node(&mut self, node: &Node, repeated: bool) {
        match node {
            Node::Pass(at) => {
                self.pass(*at, repeated);
                let in_place = self.sketch.passes[*at].stands == Stands::InPlace;
                if self.style.idle_passes && !repeated && in_place {
                    self.idle_pass(*at);
                }
            }
            Node::Swap(at) => {
                let name = self.style.resource(Target::Buffer(*at));
                self.line(&format!("Swap(\"{name}\"),"));
            }
            Node::Repeat(count, body) => {
                let count = match count {
                    Count::Literal(n) => n.to_string(),
                    Count::Steps => "\"steps\"".into(),
                    Count::StepsLeft => "\"4 - steps\"".into(),
                };
                self.line(&format!("Repeat(var: \"i\", count: {count}, body: ["));
                self.nodes(body, true);
                self.line("]),");
            }
        }
    }

    fn line(&mut self, text: &str) {
        self.passes += "    ";
        self.passes += text;
        self.passes += "\n";
    }

    /// Returns the name of the shader with this text, and adds it if it is new.
    fn shader(&mut self, text: String, ending: &str) -> String {
        let number = self.style.number(self.shaders.len());
        let letter = if self.style.other_names { 't' } else { 'k' };
        self.shaders.entry(text).or_insert_with(|| format!("{letter}{number:02}.{ending}")).clone()
    }

    fn pass(&mut self, at: usize, repeated: bool) {
        let (sketch, style) = (self.sketch, self.style);
        let pass = &sketch.passes[at];
        let name = style.pass(at);
        let (mut ins, mut outs) = (0, 0);
        let slots: Vec<Slot> = pass
            .binds
            .iter()
            .enumerate()
            .map(|(number, bind)| {
                let counter = if bind.writes { &mut outs } else { &mut ins };
                let (word, var) = if bind.writes { ("Out", "out_") } else { ("In", "in_") };
                *counter += 1;
                let digit = *counter - 1;
                Slot { number, bind: *bind, block: format!("{word}{digit}"), var: format!("{var}{digit}") }
            })
            .collect();
        let bind: String = slots
            .iter()
            .map(|slot| format!("\"{}\": \"{}\", ", slot.block, style.named(slot.bind.what)))
            .collect();
        let when = condition(pass.when);
        let push = match (pass.push, repeated) {
            (false, _) => String::new(),
            (true, false) => format!(" push: {{ \"c\": {} }},", pass.salt),
            (true, true) => format!(" push: {{ \"c\": \"i * 7 + {}\" }},", pass.salt),
        };
        let indirect =
            pass.indirect.map(|(what, offset)| format!("Indirect(\"{}\", {offset})", style.named(what)));
        let shows = at + 1 == sketch.passes.len();
        match &pass.work {
            Kind::Fill { value } => {
                let buffer = style.named(pass.binds[0].what);
                self.line(&format!("Fill(name: \"{name}\",{when} buffer: \"{buffer}\", value: {value}),"));
            }
            Kind::Dispatch { once, local } => {
                let text = compute(sketch, pass, &slots, *local, shows);
                let shader = self.shader(text, "comp");
                let size = indirect.unwrap_or_else(|| {
                    let largest = slots.iter().filter(|s| s.bind.writes).map(|s| elements(sketch, s)).max();
                    // Sizes of one, two or three dimensions; all but x are 1.
                    let others = ["", ", 1", ", 1, 1"][pass.salt as usize % 3];
                    format!("Threads({}{others})", largest.unwrap_or(1))
                });
                let run = if *once { " run: Once," } else { "" };
                self.line(&format!(
                    "Dispatch(name: \"{name}\",{when}{run} shader: \"{shader}\", size: {size}, bind: {{ {bind}}},{push}),"
                ));
            }
            Kind::Draw { targets, depth, adds, strip } => {
                let [vertex, fragment] = draw(sketch, pass, (targets, depth.is_some()), &slots, shows);
                let (vertex, fragment) = (self.shader(vertex, "vert"), self.shader(fragment, "frag"));
                let topology = if *strip { "TriangleStrip" } else { "TriangleList" };
                let call = indirect.unwrap_or_else(|| "Direct(vertices: 3, instances: 1)".into());
                let targets: String = targets
                    .iter()
                    .map(|(image, keep)| {
                        let load = if *keep { "Keep" } else { "Clear(1, 2, 3, 4)" };
                        let image = style.resource(Target::Image(*image));
                        let blend = if *adds { "Add" } else { "Replace" };
                        format!("Target(image: \"{image}\", load: {load}, blend: {blend}), ")
                    })
                    .collect();
                let depth = depth.map_or(String::new(), |(image, access)| {
                    let image = style.resource(Target::Image(image));
                    format!(", depth: Depth(image: \"{image}\", access: {access:?})")
                });
                self.line(&format!(
                    "Draw(name: \"{name}\",{when} vertex: \"{vertex}\", fragment: \"{fragment}\", topology: {topology}, call: {call}, bind: {{ {bind}}},{push} targets: [{targets}]{depth}),"
                ));
            }
        }
    }

    /// Writes an idle pass, whose output at most another idle pass reads. It reads what pass `after` binds, or what the
    /// last idle pass wrote.
    fn idle_pass(&mut self, after: usize) {
        let (sketch, style) = (self.sketch, self.style);
        let pass = &sketch.passes[after];
        let mut text = String::from("layout(local_size_x = 16) in;\n");
        let mut bind = String::new();
        if std::mem::replace(&mut self.idle_runs, false) && !pass.once() {
            text += "layout(set = 0, binding = 0, std430) readonly buffer In0 { uint in_0[]; };\n";
            bind = format!("\"In0\": \"idle{}\", ", self.idle - 1);
        } else {
            for (number, of) in pass.binds.iter().enumerate() {
                let bound = Bind { reads: of.reads || of.writes, writes: false, ..*of };
                let slot =
                    Slot { number, bind: bound, block: format!("In{number}"), var: format!("in_{number}") };
                text += &declaration(sketch, &slot);
                bind += &format!("\"{}\": \"{}\", ", slot.block, style.named(of.what));
            }
            self.idle_runs = pass.when == When::Always;
        }
        text += "layout(set = 0, binding = 31, std430) writeonly buffer Idle { uint idle[]; };\n";
        let shader = format!("idle{}.comp", self.idle);
        self.idle_shaders.push((shader.clone(), text));
        let when = condition(pass.when);
        let run = if pass.once() { " run: Once," } else { "" };
        let number = self.idle;
        self.line(&format!(
            "Dispatch(name: \"idle{number}\",{when}{run} shader: \"{shader}\", size: Threads(16), bind: {{ {bind}\"Idle\": \"idle{number}\" }}),"
        ));
        self.idle += 1;
    }
}

/// Collects the resources that nodes access, with true if they are swapped or if more than the front is used.
fn touched(nodes: &[Node], sketch: &Sketch, all: &mut BTreeMap<Target, bool>) {
    for node in nodes {
        match node {
            Node::Pass(pass) => {
                for (what, _) in sketch.passes[*pass].uses() {
                    *all.entry(what.of).or_default() |= what.half != Half::Front;
                }
            }
            Node::Swap(at) => *all.entry(Target::Buffer(*at)).or_default() = true,
            Node::Repeat(_, body) => touched(body, sketch, all),
        }
    }
}

fn condition(when: When) -> &'static str {
    match when {
        When::Always => "",
        When::Flag => " when: \"flag\",",
        When::NotFlag => " when: \"!flag\",",
        When::OddSteps => " when: \"steps % 2 == 1\",",
    }
}

struct Slot {
    number: usize,
    bind: Bind,
    block: String,
    var: String,
}

/// Returns the number of elements of a buffer, or of pixels of an image.
fn elements(sketch: &Sketch, slot: &Slot) -> u32 {
    match slot.bind.what.of {
        Target::Buffer(at) => sketch.buffers[at].words * 4 / sketch.stride(at),
        Target::Image(at) => {
            let (width, height) = sketch.size(at);
            width * height
        }
    }
}

fn declaration(sketch: &Sketch, slot: &Slot) -> String {
    let Slot { number, bind, block, var, .. } = slot;
    let qualifier = match (bind.reads, bind.writes) {
        (true, true) => "",
        (true, false) => "readonly ",
        (false, true) => "writeonly ",
        (false, false) => "readonly writeonly ",
    };
    match bind.what.of {
        Target::Buffer(at) => {
            let element = if sketch.stride(at) == 16 { "uvec4" } else { "uint" };
            format!(
                "layout(set = 0, binding = {number}, std430) {qualifier}buffer {block} {{ {element} {var}[]; }};\n"
            )
        }
        Target::Image(at) => {
            let (format, kind) =
                (format(sketch, at), if is_color(sketch, at) { "image2D" } else { "uimage2D" });
            format!("layout(set = 0, binding = {number}, {format}) uniform {qualifier}{kind} {block};\n")
        }
    }
}

/// Returns an expression that reads element `at` as one word; the components of vectors are mixed.
fn load(sketch: &Sketch, slot: &Slot, at: &str) -> String {
    match slot.bind.what.of {
        Target::Buffer(buffer) if sketch.stride(buffer) == 16 => format!("fold({}[{at}])", slot.var),
        Target::Buffer(_) => format!("{}[{at}]", slot.var),
        Target::Image(image) => {
            let (width, _) = sketch.size(image);
            let load = format!("imageLoad({}, ivec2(({at}) % {width}u, ({at}) / {width}u))", slot.block);
            if is_color(sketch, image) { format!("fold(uvec4({load}))") } else { format!("{load}.x") }
        }
    }
}

/// Returns an expression of the length of a buffer, or of the width of an image.
fn size(slot: &Slot) -> String {
    match slot.bind.what.of {
        Target::Buffer(_) => format!("uint({}.length())", slot.var),
        Target::Image(_) => format!("uint(imageSize({}).x)", slot.block),
    }
}

const FUNCTIONS: &str = "
uint mixed(uint a, uint b) {
    a ^= b * 0x9E3779B9u;
    a = (a ^ (a >> 15)) * 0x85EBCA6Bu;
    return a ^ (a >> 13);
}
uint fold(uvec4 v) { return v.x ^ (v.y * 3u) ^ (v.z * 5u) ^ (v.w * 7u); }
";

/// Returns the beginning of a shader: version, declarations and functions.
fn head(sketch: &Sketch, pass: &Pass, slots: &[&Slot], mut body: String) -> String {
    slots.iter().for_each(|slot| body += &declaration(sketch, slot));
    if pass.push {
        body += "layout(push_constant) uniform Push { uint c; };\n";
    } else {
        let _ = writeln!(body, "const uint c = {}u;", pass.salt);
    }
    format!("#version 460\n{body}{FUNCTIONS}")
}

/// Returns statements that mix the pass's inputs into `h`.
///
/// They read one element of each input, which depends on `index` and the shader's `c`; with `all`, every 128th element
/// from `index` on.
fn mix_reads(sketch: &Sketch, slots: &[&Slot], index: &str, all: bool) -> String {
    let mut text = String::new();
    for slot in slots.iter().filter(|slot| !slot.bind.writes) {
        let count = elements(sketch, slot);
        if !slot.bind.reads {
            let _ = writeln!(text, "        h = mixed(h, {});", size(slot));
        } else if all {
            let read = load(sketch, slot, "k");
            let _ = writeln!(
                text,
                "        for (uint k = {index}; k < {count}u; k += 128u) h = mixed(h, {read});"
            );
        } else {
            let read = load(sketch, slot, &format!("({index} * 5u + c) % {count}u"));
            let _ = writeln!(text, "        h = mixed(h, {read});");
        }
    }
    text
}

fn compute(sketch: &Sketch, pass: &Pass, slots: &[Slot], local: u32, all: bool) -> String {
    let slots: Vec<&Slot> = slots.iter().collect();
    let mut text = head(sketch, pass, &slots, format!("layout(local_size_x = {local}) in;\n"));
    // The loops write every element for any number of workgroups.
    let _ = write!(
        text,
        "void main() {{
    uvec3 groups = gl_NumWorkGroups;
    uint group = (gl_WorkGroupID.z * groups.y + gl_WorkGroupID.y) * groups.x + gl_WorkGroupID.x;
    uint first = group * {local}u + gl_LocalInvocationID.x;
    uint stride = groups.x * groups.y * groups.z * {local}u;
"
    );
    for slot in slots.iter().filter(|slot| slot.bind.writes) {
        let count = elements(sketch, slot);
        let _ = writeln!(text, "    for (uint i = first; i < {count}u; i += stride) {{");
        let _ = writeln!(text, "        uint h = mixed(c + {}u, i);", slot.number);
        text += &mix_reads(sketch, &slots, "i", all);
        if slot.bind.reads {
            let _ = writeln!(text, "        h = mixed(h, {});", load(sketch, slot, "i"));
        }
        let _ = writeln!(text, "        {}", store(sketch, slot));
        text += "    }\n";
    }
    text + "}\n"
}

fn store(sketch: &Sketch, slot: &Slot) -> String {
    let var = &slot.var;
    match slot.bind.what.of {
        // Arguments are small: vertices, instances and the first vertex, or workgroups in x, y and z. The first
        // instance is 0.
        Target::Buffer(at) if sketch.buffers[at].role == Role::Args => {
            format!("{var}[i] = i % 4u == 0u ? 3u + (h & 1u) : i % 4u == 3u ? 0u : 1u + (h & 1u);")
        }
        Target::Buffer(at) if sketch.stride(at) == 16 => {
            format!("{var}[i] = uvec4(h, h + 1u, h ^ c, i);")
        }
        Target::Buffer(_) => format!("{var}[i] = h;"),
        Target::Image(at) => {
            let (width, _) = sketch.size(at);
            let value = if is_color(sketch, at) { COLOR } else { "uvec4(h, 0u, 0u, 0u)" };
            format!("imageStore({}, ivec2(i % {width}u, i / {width}u), {value});", slot.block)
        }
    }
}

/// Expression of a colour from the hash `h`: integers that floats represent exactly.
const COLOR: &str = "vec4(h & 0xffffu, h >> 16, h & 0xffu, (h >> 8) & 0xffffffu)";

/// Returns the vertex and the fragment shader of a draw. `has_depth` is true if it has a depth attachment.
fn draw(
    sketch: &Sketch,
    pass: &Pass,
    (targets, has_depth): (&[(usize, bool)], bool),
    slots: &[Slot],
    all: bool,
) -> [String; 2] {
    let of = |stages: [Stage; 2]| -> Vec<&Slot> {
        slots.iter().filter(|slot| stages.contains(&slot.bind.stage)).collect()
    };
    let atomics = |slots: &[&Slot], index: &str| -> String {
        (slots.iter().filter(|slot| slot.bind.writes))
            .map(|slot| {
                let count = elements(sketch, slot);
                let at = format!("{index} % {count}u");
                let (name, place) = match slot.bind.what.of {
                    Target::Buffer(_) => ("atomicMax", format!("{}[{at}]", slot.var)),
                    Target::Image(image) => {
                        let (width, _) = sketch.size(image);
                        let place = format!("ivec2(({at}) % {width}u, ({at}) / {width}u)");
                        ("imageAtomicMax", format!("{}, {place}", slot.block))
                    }
                };
                format!("    {name}({place}, mixed(h, {}u));\n", slot.number)
            })
            .collect()
    };

    let inside = of([Stage::Vertex, Stage::Both]);
    let mut vertex = head(sketch, pass, &inside, "layout(location = 0) flat out uint tone;\n".into());
    // The triangle covers the whole target, or half of it if contents are kept, so that they stay visible.
    let kept = targets.iter().any(|(_, keep)| *keep);
    let far = if kept { "1.0" } else { "3.0" };
    // The planes of two draws cross.
    let z = if has_depth { "float(h % 8u) / 8.0" } else { "0.0" };
    let _ = write!(
        vertex,
        "void main() {{
        uint v = uint(gl_VertexIndex);
        uint h = mixed(c, v);
{}{}        tone = h;
        gl_Position = vec4(v % 3u == 1u ? {far} : -1.0, v % 3u == 2u ? {far} : -1.0, {z}, 1.0);
}}
",
        mix_reads(sketch, &inside, "v", false),
        atomics(&inside, "v"),
    );

    let inside = of([Stage::Fragment, Stage::Both]);
    let mut body = String::from("layout(location = 0) flat in uint tone;\n");
    let mut stores = String::new();
    for (at, _) in targets.iter().enumerate() {
        let _ = writeln!(body, "layout(location = {at}) out vec4 color{at};");
        let _ = writeln!(stores, "        h += {at}u;\n        color{at} = {COLOR};");
    }
    let (width, _) = sketch.size(targets[0].0);
    let mut fragment = head(sketch, pass, &inside, body);
    let _ = write!(
        fragment,
        "void main() {{
        uint p = uint(gl_FragCoord.y) * {width}u + uint(gl_FragCoord.x);
        uint h = mixed(c ^ tone, p);
{}{}{stores}}}
",
        mix_reads(sketch, &inside, "p", all),
        atomics(&inside, "p"),
    );
    [vertex, fragment]
}
