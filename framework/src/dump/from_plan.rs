//! Converts a plan to its dump: replaces numbers by names, and computes sums and lifetimes.

use super::form::{
    DUMP_VERSION, Declared, Define, Dump, DumpBlock, DumpParameter, DumpPass, DumpPhase, DumpPush,
    DumpResource, DumpShader, DumpWarning, Lifetime, Totals,
};
use super::repeats;
use crate::ir::{
    Accesses, Domain, DrawCall, Groups, MemberKind, ParamBinding, Pass, PassId, ResourceId, Run, ShaderId,
    Shape, Source, Use, Value, Work,
};
use crate::plan::{Cause, Dependency, LayoutChange, Plan, Warning, distinct_bytes};
use crate::solve;
use indexmap::{IndexMap, IndexSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;

/// Returns the plan with names in place of numbers, and without barriers. A backend adds those of its API with
/// [`Dump::with_barriers`].
pub fn dump(plan: &Plan) -> Dump {
    let mut passes: Vec<DumpPass> = plan.order().map(|id| pass_of(plan, id)).collect();
    let repeats = repeats::find(&mut passes);
    let name = |id: &ResourceId| plan.resource(*id).name.clone();
    let lifetimes = lifetimes(plan);
    let used_once = plan.used_once();
    let resources = (0..plan.resources.len() as u32).map(ResourceId);
    let resources = resources.map(|id| resource_of(plan, id, &lifetimes, used_once.contains(&id)));
    let resources = resources.collect();
    Dump {
        version: DUMP_VERSION,
        graph: plan.name.clone(),
        summary: plan.summary.clone(),
        based_on: plan.based_on.clone(),
        fallbacks: plan.fallbacks.clone(),
        parameters: plan.params.iter().map(|param| parameter_of(plan, param)).collect(),
        facts: plan.facts.clone(),
        totals: totals(plan),
        blocks: blocks(plan),
        resources,
        phases: phases(&passes),
        repeats,
        passes,
        handover: Vec::new(),
        layout_changes: plan.layout_changes.iter().map(|change| layout_change_of(plan, change)).collect(),
        left_out: plan.culled.clone(),
        warnings: plan.warnings.iter().map(warning_of).collect(),
        // An empty plan has no output.
        output: plan.resources.get(plan.output.index()).map(|image| image.name.clone()).unwrap_or_default(),
        outputs: plan.outputs.iter().map(|output| (output.name.clone(), name(&output.image))).collect(),
        stats: plan.stats.iter().map(|stat| stat.map(name)).collect(),
        gpu_ms: None,
        frame_ms: None,
        encoders: None,
    }
}

/// Converts a dump to the canonical JSON form.
pub fn json(dump: &Dump) -> serde_json::Value {
    serde_json::to_value(dump).expect("a dump is plain data with string keys")
}

fn warning_of(warning: &Warning) -> DumpWarning {
    let Warning { diagnostic, origin } = warning;
    DumpWarning {
        message: diagnostic.message.clone(),
        help: diagnostic.help.clone(),
        declared: origin.clone(),
    }
}

fn layout_change_of(plan: &Plan, change: &LayoutChange) -> LayoutChange<Declared, String> {
    let LayoutChange { image, old, new, before, handover } = *change;
    let image = plan.resource(image).name.clone();
    LayoutChange { image, old, new, before: Declared::pass(plan, before), handover }
}

fn parameter_of(plan: &Plan, param: &crate::ir::Param) -> DumpParameter {
    let effect = plan.effect(&param.name).cloned().unwrap_or_default();
    let offset = match param.binding {
        ParamBinding::Live { offset } => Some(offset),
        _ => None,
    };
    DumpParameter {
        name: param.name.clone(),
        value: param.value.clone(),
        default: param.default.clone(),
        reason: param.reason.clone(),
        exact: param.exact.clone(),
        grows: param.grows.clone(),
        live: offset.is_some(),
        offset,
        kind: offset.map(|_| param.domain.glsl().into()),
        choices: match &param.domain {
            Domain::Choice(of) => of.clone(),
            _ => Vec::new(),
        },
        affects: effect.passes.iter().map(|id| plan.pass(*id).name.clone()).collect(),
        shape: effect.shape,
        no_effect: effect.none,
        declared: param.origin.clone(),
    }
}

fn totals(plan: &Plan) -> Totals {
    let (transient_bytes, unshared_bytes) = (plan.transient_bytes(), plan.unshared_bytes());
    Totals {
        passes: plan.prologue.len() + plan.frame.len(),
        prologue_passes: plan.prologue.len(),
        frame_passes: plan.frame.len(),
        transient_bytes,
        unshared_bytes,
        saved_bytes: unshared_bytes.saturating_sub(transient_bytes),
        scene_bytes: distinct_bytes(
            plan.resources.iter().filter(|r| matches!(r.source, Source::Scene { .. })),
        ),
        freed_bytes: distinct_bytes(plan.used_once().into_iter().map(|id| plan.resource(id))),
        host_bytes: plan.resources.iter().filter(|r| r.source.is_per_frame()).map(|r| r.bytes()).sum(),
        ..Totals::default()
    }
}

fn blocks(plan: &Plan) -> Vec<DumpBlock> {
    let block = |(id, block): (usize, &crate::plan::Block)| DumpBlock {
        id: id as u32,
        bytes: block.aliases.iter().map(|t| plan.resource(*t).bytes()).max().unwrap_or(0),
        aliases: block.aliases.iter().map(|t| plan.resource(*t).name.clone()).collect(),
    };
    plan.blocks.iter().enumerate().map(block).collect()
}

fn phases(passes: &[DumpPass]) -> Vec<DumpPhase> {
    let mut phases: IndexMap<(&str, bool), DumpPhase> = IndexMap::new();
    for pass in passes {
        let new = || DumpPhase { name: pass.phase.clone(), run: pass.run, passes: 0, gpu_ms: None };
        phases.entry((&pass.phase, pass.run == Run::Once)).or_insert_with(new).passes += 1;
    }
    phases.into_values().collect()
}

fn resource_of(plan: &Plan, id: ResourceId, lifetimes: &[Option<Lifetime>], freed: bool) -> DumpResource {
    let resource = plan.resource(id);
    let (source, from) = match &resource.source {
        Source::Transient => ("transient", None),
        Source::Scene { attribute, .. } => ("scene", Some(attribute)),
        Source::Frame { uniform } => ("frame", Some(uniform)),
        Source::HostBuffer { buffer } => ("given", Some(buffer)),
        Source::Live => ("live", None),
        Source::Readback => ("readback", None),
    };
    DumpResource {
        name: resource.name.clone(),
        source: source.into(),
        from: from.cloned(),
        shape: match resource.shape {
            Shape::Buffer { stride, count } => format!("{count} x {stride}"),
            Shape::Image { format, width, height } => format!("{width} x {height} {}", format.name()),
        },
        dimensions: resource.shape,
        bytes: resource.bytes(),
        usage: resource.usage,
        block: resource.block.map(|b| b.0),
        lifetime: lifetimes[id.index()],
        freed,
        history: resource.history.clone(),
        declared: resource.origin.clone(),
    }
}

/// Returns each resource's first and last pass in the dump, where the prologue's passes come first.
fn lifetimes(plan: &Plan) -> Vec<Option<Lifetime>> {
    let prologue = plan.prologue.len();
    let lifetime =
        |life: Range<usize>| Lifetime { first: prologue + life.start, last: prologue + life.end - 1 };
    solve::lifetimes(plan).map(|life| life.map(lifetime)).collect()
}

fn pass_of(plan: &Plan, id: PassId) -> DumpPass {
    let pass = plan.pass(id);
    let name = |id: &ResourceId| plan.resource(*id).name.clone();
    let (kind, size) = kind_and_size(plan, &pass.work);
    let shaders: Vec<ShaderId> = pass.work.shaders().into_iter().copied().collect();
    let (topology, targets, depth) = match &pass.work {
        Work::Draw { topology, targets, depth, .. } => (Some(*topology), targets.as_slice(), *depth),
        _ => (None, &[][..], None),
    };
    DumpPass {
        name: pass.name.clone(),
        phase: pass.phase.clone(),
        run: pass.run,
        kind: kind.into(),
        repeat: None,
        size,
        topology,
        targets: targets.iter().map(|target| target.map(name)).collect(),
        depth: depth.map(|depth| depth.map(name)),
        reads: touched(plan, pass, Accesses::WRITES.complement()),
        writes: touched(plan, pass, Accesses::WRITES),
        bindings: pass.bindings.iter().map(|binding| binding.map(name)).collect(),
        push: push(plan, pass, &shaders),
        shaders: shaders.iter().map(|id| shader_of(plan, *id)).collect(),
        dependencies: plan.dependencies_of(id).iter().map(|d| dependency_of(plan, d)).collect(),
        barriers: Vec::new(),
        gpu_ms: None,
        declared: pass.origin.clone(),
    }
}

fn kind_and_size(plan: &Plan, work: &Work) -> (&'static str, String) {
    let name = |id: &ResourceId| &plan.resource(*id).name;
    let argument = |buffer, offset: &u64| format!("from {}+{offset}", name(buffer));
    let bytes = |id: &ResourceId| plan.resource(*id).bytes();
    match work {
        Work::Dispatch { groups, .. } => (
            "dispatch",
            match groups {
                Groups::Direct([1, 1, 1]) => "1 group".into(),
                Groups::Direct([x, 1, 1]) => format!("{x} groups"),
                Groups::Direct([x, y, z]) => format!("{x} x {y} x {z} groups"),
                Groups::Indirect { buffer, offset } => argument(buffer, offset),
            },
        ),
        Work::Draw { call, .. } => (
            "draw",
            match call {
                DrawCall::Direct { vertices, instances } => format!("{vertices} vertices x {instances}"),
                DrawCall::Indirect { buffer, offset } => argument(buffer, offset),
            },
        ),
        Work::Fill { buffer, value } => ("fill", format!("{} bytes with {value:#010x}", bytes(buffer))),
        Work::ClearHistory { resource } => ("start", format!("{} bytes with zeros", bytes(resource))),
        Work::Export => ("export", String::new()),
        Work::Host => ("host", String::new()),
    }
}

fn shader_of(plan: &Plan, id: ShaderId) -> DumpShader {
    let shader = plan.shader(id);
    let define = |(name, value): &(String, String)| Define { name: name.clone(), value: value.clone() };
    let mut code = DefaultHasher::new();
    shader.spirv.hash(&mut code);
    DumpShader {
        file: shader.name.clone(),
        path: shader.path.clone(),
        code: format!("{:016x}", code.finish()),
        defines: shader.defines.iter().map(define).collect(),
        local_size: shader.reflection.local_size,
        shared_bytes: shader.reflection.shared_bytes,
    }
}

fn touched(plan: &Plan, pass: &Pass, wanted: Accesses) -> Vec<Use<String>> {
    let reduced = |touch: &Use| Use { accesses: touch.accesses & wanted, ..*touch };
    let uses = pass.uses.iter().map(reduced).filter(|touch| !touch.accesses.is_empty());
    uses.map(|touch| touch.map(|id| plan.resource(*id).name.clone())).collect()
}

fn push(plan: &Plan, pass: &Pass, shaders: &[ShaderId]) -> Vec<DumpPush> {
    let blocks = shaders.iter().filter_map(|id| plan.shader(*id).reflection.push.as_ref());
    let members: Vec<_> = blocks.flat_map(|block| &block.members).collect();
    let word = |(i, bytes): (usize, &[u8])| {
        let offset = 4 * i;
        let word = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let member = members.iter().find(|m| m.offset as usize == offset);
        let (kind, value) = match member.map(|m| m.kind) {
            // JSON cannot represent infinities and NaN.
            Some(MemberKind::Float) if f32::from_bits(word).is_finite() => {
                ("float", Value::Float(f32::from_bits(word).into()))
            }
            Some(MemberKind::Int) => ("int", Value::Int((word as i32).into())),
            _ => ("uint", Value::Int(word.into())),
        };
        DumpPush { name: member.map(|m| m.name.clone()), offset, value, kind: kind.into() }
    };
    pass.push.chunks_exact(4).enumerate().map(word).collect()
}

fn dependency_of(plan: &Plan, dependency: &Dependency) -> Dependency<Declared, Declared> {
    let Dependency { hazard, since, bytes, changes_layout, masks, .. } = dependency.clone();
    Dependency {
        hazard,
        first: Declared::pass(plan, dependency.first),
        // Left empty: the dependency is listed under this pass.
        second: Declared::default(),
        since,
        resource: Declared::resource(plan, dependency.resource),
        alias: dependency.alias.map(|id| Declared::resource(plan, id)),
        bytes,
        changes_layout,
        masks,
    }
}

impl Declared {
    /// Replaces the ids of a conflict's passes and resources by names and declarations.
    pub fn cause(plan: &Plan, cause: &Cause) -> Cause<Declared, Declared> {
        cause.map(|id| Declared::pass(plan, id), |id| Declared::resource(plan, id))
    }

    /// Returns the name and the declaration of a pass.
    pub fn pass(plan: &Plan, id: PassId) -> Declared {
        Declared { name: plan.pass(id).name.clone(), declared: plan.pass(id).origin.clone() }
    }

    /// Returns the name and the declaration of a resource.
    pub fn resource(plan: &Plan, id: ResourceId) -> Declared {
        Declared { name: plan.resource(id).name.clone(), declared: plan.resource(id).origin.clone() }
    }
}

impl DumpPass {
    /// Lists the names of the resources that a pass reads, each once.
    pub fn read_names(&self) -> Vec<&str> {
        names(&self.reads)
    }

    /// Lists the names of the resources that a pass writes, each once.
    pub fn written_names(&self) -> Vec<&str> {
        names(&self.writes)
    }
}

fn names(uses: &[Use<String>]) -> Vec<&str> {
    let names: IndexSet<&str> = uses.iter().map(|touch| touch.resource.as_str()).collect();
    names.into_iter().collect()
}
