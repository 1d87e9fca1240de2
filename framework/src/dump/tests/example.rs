//! A plan with most constructs that a plan can have, and its dump with barriers as an API could place them.

use crate::dump::{Declared, Dump, DumpBarrier, DumpCause};
use crate::source::Diagnostic;
use crate::testing::plan_of;
use crate::{ir::*, plan::*};

const GRAPH: &str = r#"Graph(version: 1, summary: "Depth-sorted quads",
    params: {
        "digit_bits": Const(Int(default: 8, range: (1, 11))),
        "cutoff": Live(Float(default: 3.33, range: (1.0, 4.0))),
        "blend": Const(Choice(default: "back_to_front", of: ["back_to_front", "front_to_back"])),
    },
    imports: {
        "position": Import(from: "scene.position"), "scale": Import(from: "scene.scale"), "camera": Import(from: "frame.camera"),
    },
    resources: {
        "covariances": Buffer(stride: 24, count: 1000),
        "splats": Buffer(stride: 48, count: 1000),
        "depth": Buffer(stride: 4, count: 1000),
        "visible": Buffer(stride: 4, count: 4),
        "args": Buffer(stride: 4, count: 9),
        "keys": Buffer(stride: 4, count: 1000, ping_pong: true),
        "order": Buffer(stride: 4, count: 1000, ping_pong: true),
        "color": Image(format: "rgba16f", size: ("viewport.width", "viewport.height")),
        "final": Image(format: "rgba32f", size: ("viewport.width", "viewport.height")),
        "exposure": Buffer(stride: 4, count: 256, history: true),
    },
    passes: [
        Dispatch(name: "covariance", phase: "load", shader: "covariance.comp", size: Threads(1000), run: Once,
            bind: {"Scale": "scale", "Covariances": "covariances"}),
        Dispatch(name: "project", phase: "project", shader: "project.comp", size: Threads(1000), bind: {
            "Camera": "camera", "Position": "position", "Covariances": "covariances", "Splats": "splats", "Depth": "depth",
            "Visible": "visible",
        }),
        Dispatch(name: "scan_blocks", phase: "key", shader: "scan_blocks.comp", size: Groups(1),
            bind: {"Visible": "visible", "Args": "args"}),
        Dispatch(name: "compact", phase: "key", shader: "compact.comp", size: Threads(1000),
            bind: {"Depth": "depth", "Visible": "visible", "Keys": "keys", "Order": "order"}),
        Include(graph: "sort", name: "sort", with: {"keys": "keys", "order": "order", "args": "args"},
            set: {"digit_bits": "digit_bits"}),
        Draw(name: "back_to_front", phase: "draw", vertex: "splat.vert", fragment: "quad.frag", topology: TriangleStrip,
            call: Indirect("args", 16), bind: {"Order": "order", "Splats": "splats"},
            targets: [Target(image: "color", load: Clear(0, 0, 0, 0), blend: PremultipliedOver)]),
        Fill(name: "front_to_back", when: "blend == 'front_to_back'", buffer: "exposure", value: 0),
        Dispatch(name: "compose", phase: "compose", shader: "compose.comp", size: Threads("viewport.width"),
            bind: {"Color": "color", "Image": "final", "Exposure": "exposure"}),
    ],
    stats: {"visible": ("args", 12)},
    output: "final",
)"#;

const SORT: &str = r#"Graph(version: 1, summary: "Radix sort", params: {"digit_bits": Const(Int(default: 8, range: (1, 11)))},
    ports: {
        "keys": Buffer(stride: 4, ping_pong: true), "order": Buffer(stride: 4, ping_pong: true), "args": Buffer(stride: 4),
    },
    resources: {
        "table": Buffer(stride: 4, count: "1 << digit_bits"), "totals": Buffer(stride: 4, count: "8 << digit_bits"),
    },
    passes: [
        Fill(name: "clear", phase: "sort", buffer: "totals", value: 0),
        Repeat(var: "i", count: "32 / digit_bits", body: [
            Dispatch(name: "histogram", phase: "sort", shader: "histogram.comp", size: Indirect("args", 0),
                bind: {"Keys": "front(keys)", "Table": "table", "Totals": "totals"}, push: {"shift": "i * digit_bits"}),
            Dispatch(name: "scan", phase: "sort", shader: "scan.comp", size: Groups(4),
                bind: {"Table": "table", "Totals": "totals"}, push: {"shift": "i * digit_bits"}),
            Dispatch(name: "scatter", phase: "sort", shader: "scatter.comp", size: Indirect("args", 0), push: {"shift": "i * digit_bits"},
                bind: {
                    "Keys": "front(keys)", "Order": "front(order)", "Table": "table", "KeysOut": "back(keys)", "OrderOut": "back(order)",
                }),
            Swap("keys"),
            Swap("order"),
        ]),
    ],
)"#;

const SHADERS: [(&str, &str); 9] = [
    ("covariance.comp", "r Scale 12\nw Covariances 24"),
    (
        "project.comp",
        "uniform Camera 256\nr Position 12\nr Covariances 24\nw Splats 48\nw Depth 4\nw Visible 4\nDIGIT_BITS",
    ),
    ("scan_blocks.comp", "rw Visible 4\nw Args 4\nlive cutoff"),
    ("compact.comp", "r Depth 4\nr Visible 4\nw Keys 4\nw Order 4"),
    ("histogram.comp", "r Keys 4\nw Table 4\nrw Totals 4\npush shift"),
    ("scan.comp", "rw Table 4\nr Totals 4\npush shift"),
    ("scatter.comp", "r Keys 4\nr Order 4\nr Table 4\nw KeysOut 4\nw OrderOut 4\npush shift"),
    ("splat.vert", "r Order 4\nr Splats 48"),
    ("compose.comp", "image r Color rgba16f\nimage w Image rgba32f\nrw Exposure 4\nlive cutoff"),
];

/// Returns a plan with `digits` iterations of the sort.
pub fn splat(digits: u32) -> Plan {
    let files = [("graph.ron", GRAPH), ("sort.ron", SORT)];
    let bits = (32 / digits).to_string();
    let mut plan = plan_of(&[&files[..], &SHADERS].concat(), &[("digit_bits", &bits)]);
    let facts = [("scene.count".to_string(), Value::Int(1000))];
    plan.name = "example".into();
    plan.based_on = vec!["splat".into()];
    plan.facts = facts.clone().into();
    plan.effects = vec![
        Effect { passes: vec![PassId(1), PassId(2)], shape: true, none: None },
        Effect { none: Some("nothing in this plan depends on it".into()), ..Effect::default() },
        Effect { passes: vec![PassId(1)], ..Effect::default() },
    ];
    let reason = |expression: &str| Reason { expression: expression.into(), values: facts.clone().into() };
    plan.fallbacks = vec![Fallback {
        wanted: "example".into(),
        preference: false,
        taken: "digits".into(),
        unmet: vec![Unmet { needs: "many splats".into(), reason: reason("scene.count > 5000") }],
    }];
    let digit_bits = &mut plan.params[0];
    digit_bits.reason = Some(reason("scene.count < 5000 ? 8 : 11"));
    digit_bits.grows = Some("visible".into());
    plan.stats[0].grows.push(digit_bits.name.clone());
    for param in &mut plan.params {
        param.exact = Some(param.value.clone());
    }
    plan.outputs = vec![Output { name: "picture".into(), image: plan.output }];
    let said = "`key` reads and writes `table`, which nothing has written before it";
    let place = Span { file: FileId(0), start: 0, end: 1 };
    plan.warnings = vec![Warning {
        diagnostic: Diagnostic::new(said, place, "").with_help("fill it in an earlier pass"),
        origin: Origin { file: "pipelines/splat.ron".into(), line: 98, column: 5 },
    }];
    plan
}

/// Returns a plan's dump with barriers: before each pass one for its dependencies without a layout change, and one per
/// layout change.
pub fn dump(plan: &Plan) -> Dump {
    let ids = |ids: &[PassId]| ids.iter().copied().map(Some).collect::<Vec<_>>();
    let calls = [ids(&plan.prologue), vec![None], ids(&plan.frame)].concat();
    crate::dump::dump(plan).with_barriers(calls.into_iter().map(|at| call(plan, at)))
}

fn call(plan: &Plan, at: Option<PassId>) -> Vec<DumpBarrier> {
    let here = |d: &&Dependency| match at {
        Some(pass) => d.second == pass && d.since != Since::Prologue,
        None => d.since == Since::Prologue,
    };
    let barrier = |image: Option<&LayoutChange>, of: Vec<&Dependency>| DumpBarrier {
        id: 0,
        before: at.map(|pass| Declared::pass(plan, pass)),
        image: image.map(|change| change.transition().map(|id| plan.resource(*id).name.clone())),
        masks: of[0].masks,
        dependencies: of.iter().map(|dependency| cause(plan, dependency)).collect(),
    };
    let all: Vec<&Dependency> = plan.dependencies.iter().filter(here).collect();
    let memory: Vec<&Dependency> =
        all.iter().copied().filter(|d| d.hazard != Hazard::LayoutChange && !d.changes_layout).collect();
    let mut call = Vec::new();
    if !memory.is_empty() {
        call.push(barrier(None, memory));
    }
    for change in plan.layout_changes_at(at) {
        let of: Vec<_> =
            all.iter().copied().filter(|d| d.changes_layout && d.resource == change.image).collect();
        call.extend((!of.is_empty()).then(|| barrier(Some(change), of)));
    }
    call
}

fn cause(plan: &Plan, dependency: &Dependency) -> DumpCause {
    let conflict = Cause {
        hazard: dependency.hazard,
        before: dependency.second,
        resource: dependency.resource,
        after: vec![dependency.first],
        previous_frame: dependency.since == Since::PreviousFrame,
        alias: dependency.alias,
    };
    DumpCause { conflict: Declared::cause(plan, &conflict), masks: dependency.masks }
}
