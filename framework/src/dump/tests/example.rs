//! A hand-made plan with most constructs that a plan can have, and its dump with barriers as an API could place them.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::dump::{Declared, Dump, DumpBarrier, DumpCause};
use crate::ir::{Member, MemberKind, PushBlock, Reflection, ShaderStage};
use crate::source::Diagnostic;
use crate::{ir::*, plan::*};

struct Maker {
    resources: Vec<Resource>,
    shaders: Vec<Shader>,
    passes: Vec<Pass>,
    blocks: Vec<Block>,
}

const COMPUTE_READ: (Stages, Accesses) = (Stages::COMPUTE, Accesses::STORAGE_READ);
const COMPUTE_WRITE: (Stages, Accesses) = (Stages::COMPUTE, Accesses::STORAGE_WRITE);

fn both() -> (Stages, Accesses) {
    (Stages::COMPUTE, Accesses::STORAGE_READ | Accesses::STORAGE_WRITE)
}

fn origin(line: u32) -> Origin {
    Origin { file: "pipelines/splat.ron".into(), line, column: 5 }
}

/// Returns a plan with `digits` iterations of the sort, over `count` splats.
pub fn splat(digits: u32, count: u64) -> Plan {
    let mut m = Maker { resources: vec![], shaders: vec![], passes: vec![], blocks: vec![] };
    let scene = |name: &str, plane| Source::Scene { attribute: format!("scene.{name}"), plane };
    let position = m.buffer("position", 12, count, scene("position", 0));
    let scale = m.buffer("scale", 12, count, scene("scale", 0));
    let sh: Vec<_> = (0..6).map(|i| m.buffer(&format!("sh[{i}]"), 16, count, scene("sh", i))).collect();
    let camera = m.buffer("camera", 256, 1, Source::Frame { uniform: "frame.camera".into() });
    let live = m.buffer("Live", 16, 1, Source::Live);
    let covariances = m.own("covariances", 24, count);
    let splats = m.own("splats", 48, count);
    let depth = m.own("depth", 4, count);
    let visible = m.own("visible", 4, count.div_ceil(256));
    let args = m.own("args", 4, 9);
    let keys = [m.own("keys#0", 4, count), m.own("keys#1", 4, count)];
    let order = [m.own("order#0", 4, count), m.own("order#1", 4, count)];
    let table = m.own("sort.table", 4, count.div_ceil(2048) << (32 / digits));
    let totals = m.own("sort.totals", 4, 8 << (32 / digits));
    let shape = Shape::Image { format: Format::Rgba16Float, width: 960, height: 540 };
    let color = m.resource("color", shape, Source::Transient);
    let shape = Shape::Image { format: Format::Rgba32Float, width: 960, height: 540 };
    let last = m.resource("final", shape, Source::Transient);
    let exposure = m.own("exposure", 4, 256);
    m.resources[exposure.index()].history = Some("exposure".into());
    let readback = m.buffer("readback", 4, 2, Source::Readback);
    for alone in
        [covariances, splats, visible, args, keys[0], keys[1], order[0], order[1], totals, last, exposure]
    {
        m.block(&[alone]);
    }
    m.block(&[depth, table, color]);

    let one = Groups::Direct([1, 1, 1]);
    let wide = Groups::Direct([(count.div_ceil(256)) as u32, 1, 1]);
    let indirect = Groups::Indirect { buffer: args, offset: 0 };
    let uniform = (Stages::COMPUTE, Accesses::UNIFORM_READ);
    m.add(
        "start.exposure",
        "load",
        Run::Once,
        Work::ClearHistory { resource: exposure },
        &[(exposure, (Stages::CLEAR, Accesses::TRANSFER_WRITE))],
    );
    m.dispatch("covariance", "load", wide, &[(scale, COMPUTE_READ), (covariances, COMPUTE_WRITE)]);
    m.passes.last_mut().unwrap().run = Run::Once;
    let mut uses = vec![(camera, uniform), (position, COMPUTE_READ), (covariances, COMPUTE_READ)];
    uses.extend(sh.iter().map(|plane| (*plane, COMPUTE_READ)));
    uses.extend([splats, depth, visible].map(|id| (id, COMPUTE_WRITE)));
    m.dispatch("project", "project", wide, &uses);
    m.dispatch("scan_blocks", "key", one, &[(live, uniform), (visible, both()), (args, COMPUTE_WRITE)]);
    let made = [(keys[0], COMPUTE_WRITE), (order[0], COMPUTE_WRITE)];
    let read = [(depth, COMPUTE_READ), (visible, COMPUTE_READ)];
    m.dispatch("compact", "key", wide, &[&read[..], &made[..]].concat());
    let clear = (Stages::CLEAR, Accesses::TRANSFER_WRITE);
    m.add("sort.clear", "sort", Run::Frame, Work::Fill { buffer: totals, value: 0 }, &[(totals, clear)]);
    let arguments = (args, (Stages::INDIRECT, Accesses::INDIRECT_READ));
    for i in 0..digits {
        let (front, back) = ((i % 2) as usize, ((i + 1) % 2) as usize);
        let head = [arguments, (keys[front], COMPUTE_READ)];
        let of = |name: &str| format!("sort.{name}[{i}]");
        m.dispatch(
            &of("histogram"),
            "sort",
            indirect,
            &[&head[..], &[(table, COMPUTE_WRITE), (totals, both())]].concat(),
        );
        m.dispatch(&of("scan"), "sort", wide, &[(table, both()), (totals, COMPUTE_READ)]);
        let rest = [
            (order[front], COMPUTE_READ),
            (table, COMPUTE_READ),
            (keys[back], COMPUTE_WRITE),
            (order[back], COMPUTE_WRITE),
        ];
        m.dispatch(&of("scatter"), "sort", indirect, &[&head[..], &rest[..]].concat());
        for pass in m.passes.iter_mut().rev().take(3) {
            pass.push = (i * 32 / digits).to_le_bytes().to_vec();
        }
    }
    m.draw(
        [arguments, (order[digits as usize % 2], (Stages::VERTEX, Accesses::STORAGE_READ))],
        splats,
        color,
    );
    let uses = [(live, uniform), (color, COMPUTE_READ), (last, COMPUTE_WRITE), (exposure, both())];
    m.dispatch("compose", "compose", wide, &uses);
    let copy = (Stages::COPY, Accesses::TRANSFER_READ);
    let copied = (Stages::COPY, Accesses::TRANSFER_WRITE);
    m.add("export", "export", Run::Frame, Work::Export, &[(last, copy), (args, copy), (readback, copied)]);
    let host = (Stages::HOST, Accesses::HOST_READ);
    m.add("host", "export", Run::Frame, Work::Host, &[(readback, host)]);
    m.finish(last, args, digits)
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

impl Maker {
    fn resource(&mut self, name: &str, shape: Shape, source: Source) -> ResourceId {
        let origin = origin(40 + self.resources.len() as u32);
        let usage = Usage::STORAGE;
        let (block, history) = (None, None);
        self.resources.push(Resource { name: name.into(), shape, usage, source, block, history, origin });
        ResourceId(self.resources.len() as u32 - 1)
    }

    fn buffer(&mut self, name: &str, stride: u64, count: u64, source: Source) -> ResourceId {
        self.resource(name, Shape::Buffer { stride, count }, source)
    }

    fn own(&mut self, name: &str, stride: u64, count: u64) -> ResourceId {
        self.buffer(name, stride, count, Source::Transient)
    }

    fn block(&mut self, aliases: &[ResourceId]) {
        let id = BlockId(self.blocks.len() as u32);
        aliases.iter().for_each(|t| self.resources[t.index()].block = Some(id));
        self.blocks.push(Block { aliases: aliases.to_vec() });
    }

    fn shader(&mut self, file: &str, stage: ShaderStage) -> ShaderId {
        let member = Member { name: "shift".into(), offset: 0, kind: MemberKind::Uint, used: true };
        let reflection = Reflection {
            stage,
            local_size: [256, 1, 1],
            shared_bytes: 1024,
            bindings: vec![],
            push: Some(PushBlock { bytes: 4, members: vec![member] }),
            inputs: vec![],
            outputs: vec![],
            uses_position: true,
            features: Features::empty(),
        };
        let defines = vec![("DIGIT_BITS".into(), "4".into())];
        self.shaders.push(Shader {
            name: file.into(),
            defines,
            spirv: Arc::default(),
            reflection,
            msl: None,
        });
        ShaderId(self.shaders.len() as u32 - 1)
    }

    fn dispatch(
        &mut self,
        name: &str,
        phase: &str,
        groups: Groups,
        uses: &[(ResourceId, (Stages, Accesses))],
    ) {
        let file = name.split('[').next().unwrap_or(name).replace('.', "/") + ".comp";
        let shader = self.shader(&file, ShaderStage::Compute);
        self.add(name, phase, Run::Frame, Work::Dispatch { shader, groups }, uses);
    }

    fn draw(&mut self, read: [(ResourceId, (Stages, Accesses)); 2], splats: ResourceId, image: ResourceId) {
        let vertex = self.shader("splat.vert", ShaderStage::Vertex);
        let fragment = self.shader("splat.frag", ShaderStage::Fragment);
        let target = Target { image, load: Load::Clear(0.0, 0.0, 0.0, 0.0), blend: Blend::PremultipliedOver };
        let call = DrawCall::Indirect { buffer: read[0].0, offset: 16 };
        let topology = Topology::TriangleStrip;
        let work = Work::Draw { vertex, fragment, topology, call, targets: vec![target], depth: None };
        let blended = (Stages::COLOR_OUTPUT, Accesses::COLOR_READ | Accesses::COLOR_WRITE);
        let vertex = (Stages::VERTEX, Accesses::STORAGE_READ);
        let uses = [read[0], read[1], (splats, vertex), (image, blended)];
        self.add("back_to_front", "draw", Run::Frame, work, &uses);
    }

    fn add(
        &mut self,
        name: &str,
        phase: &str,
        run: Run,
        work: Work,
        uses: &[(ResourceId, (Stages, Accesses))],
    ) {
        let is_image = |id: ResourceId| matches!(self.resources[id.index()].shape, Shape::Image { .. });
        let layout = |accesses: Accesses| match accesses {
            a if a.intersects(Accesses::COLOR_WRITE) => Layout::ColorTarget,
            a if a.intersects(Accesses::TRANSFER_READ) => Layout::TransferSource,
            _ => Layout::General,
        };
        let touch = |&(resource, (stages, accesses)): &(ResourceId, (Stages, Accesses))| Use {
            resource,
            stages,
            accesses,
            layout: is_image(resource).then(|| layout(accesses)),
            discards: accesses.intersects(Accesses::COLOR_WRITE),
        };
        let uses: Vec<Use> = uses.iter().map(touch).collect();
        let bound = |t: &&Use| t.accesses.intersects(both().1 | Accesses::UNIFORM_READ);
        let binding = |(i, t): (usize, &Use)| Binding {
            name: self.resources[t.resource.index()].name.to_uppercase(),
            binding: i as u32,
            element: 0,
            kind: DescriptorKind::StorageBuffer,
            resource: t.resource,
        };
        let bindings = uses.iter().filter(bound).enumerate().map(binding).collect();
        let origin = origin(70 + self.passes.len() as u32);
        let (name, phase, push) = (name.into(), phase.into(), vec![]);
        self.passes.push(Pass { name, phase, run, work, bindings, push, uses, origin });
    }

    fn finish(self, output: ResourceId, args: ResourceId, digits: u32) -> Plan {
        let param = |name: &str, value: Value, binding| Param {
            name: name.into(),
            default: value.clone(),
            reason: (name == "digit_bits").then(|| Reason {
                expression: "scene.count < 5000 ? 8 : 11".into(),
                values: [("scene.count".into(), Value::Int(1000))].into(),
            }),
            exact: Some(value.clone()),
            grows: (name == "digit_bits").then(|| "visible".into()),
            value,
            domain: Domain::Bool,
            binding,
            origin: origin(6),
        };
        let mut plan = Plan {
            effects: vec![
                Effect { passes: vec![PassId(1), PassId(2)], shape: true, none: None },
                Effect { none: Some("nothing in this plan depends on it".into()), ..Effect::default() },
                Effect { passes: vec![PassId(1)], ..Effect::default() },
            ],
            name: "example".into(),
            summary: "Depth-sorted quads, made by hand".into(),
            based_on: vec!["splat".into()],
            fallbacks: vec![Fallback {
                wanted: "example".into(),
                preference: false,
                taken: "digits".into(),
                unmet: vec![Unmet {
                    needs: "many splats".into(),
                    reason: Reason {
                        expression: "scene.count > 5000".into(),
                        values: [("scene.count".into(), Value::Int(1000))].into(),
                    },
                }],
            }],
            facts: BTreeMap::from([("scene.count".into(), Value::Int(1000))]),
            params: vec![
                param("digit_bits", Value::Int((32 / digits).into()), ParamBinding::Const),
                param("cutoff", Value::Float(3.33), ParamBinding::Live { offset: 0 }),
                param("blend", Value::Text("back_to_front".into()), ParamBinding::Const),
            ],
            resources: self.resources,
            shaders: self.shaders,
            passes: self.passes,
            blocks: self.blocks,
            prologue: vec![],
            dependencies: vec![],
            layout_changes: vec![],
            frame: vec![],
            culled: vec![Culled {
                pass: "front_to_back".into(),
                why: "its `when` is false".into(),
                origin: origin(99),
            }],
            warnings: vec![Warning {
                diagnostic: Diagnostic::new(
                    "`key` reads and writes `table`, which nothing has written before it",
                    Span { file: FileId(0), start: 0, end: 1 },
                    "",
                )
                .with_help("fill it in an earlier pass"),
                origin: origin(98),
            }],
            outputs: vec![Output { name: "picture".into(), image: output }],
            offered: Vec::new(),
            output,
            stats: vec![Stat { name: "visible".into(), buffer: args, offset: 12 }],
        };
        let ids = (0..plan.passes.len() as u32).map(PassId);
        let (once, frame): (Vec<_>, Vec<_>) = ids.partition(|id| plan.pass(*id).run == Run::Once);
        (plan.prologue, plan.frame) = (once, frame);
        crate::solve::add_dependencies(&mut plan);
        plan
    }
}
