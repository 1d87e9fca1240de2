//! Compaction: maps handles of the lowered graph to ids of the plan.
//!
//! Resources and shaders that no pass of the plan uses are dropped; the others keep their relative order. A handle for the
//! previous frame's contents maps to the resource itself: the order of the passes already accounts for the difference.

use crate::ir::{
    Binding, DrawCall, Groups, Output, Pass, ResourceId, ShaderId, Stat, Target, Usage, Use, Work,
};
use crate::link::{LinkedPass, ShaderHandle};
use crate::lower::{Lowered, ResourceHandle};
use crate::plan::{Plan, Resource};
use crate::source::SourceMap;

/// The plan's ids of the used resources and shaders.
struct Ids<'a> {
    lowered: &'a Lowered,
    /// Ids by handle; `None` for unused ones.
    resources: Vec<Option<ResourceId>>,
    shaders: Vec<Option<ShaderId>>,
}

impl Ids<'_> {
    fn resource(&self, handle: ResourceHandle) -> ResourceId {
        self.resources[self.lowered.real(handle).index()].expect("passes of the plan use it")
    }

    fn shader(&self, handle: ShaderHandle) -> ShaderId {
        self.shaders[handle.index()].expect("passes of the plan use it")
    }

    fn pass(&self, pass: &Pass<ResourceHandle, ShaderHandle>) -> Pass {
        let binding = |b: &Binding<_>| Binding {
            name: b.name.clone(),
            binding: b.binding,
            element: b.element,
            kind: b.kind,
            resource: self.resource(b.resource),
        };
        let touch = |t: &Use<_>| Use {
            resource: self.resource(t.resource),
            stages: t.stages,
            accesses: t.accesses,
            layout: t.layout,
            discards: t.discards,
        };
        Pass {
            name: pass.name.clone(),
            phase: pass.phase.clone(),
            run: pass.run,
            work: self.work(&pass.work),
            bindings: pass.bindings.iter().map(binding).collect(),
            push: pass.push.clone(),
            uses: pass.uses.iter().map(touch).collect(),
            origin: pass.origin.clone(),
        }
    }

    fn work(&self, work: &Work<ResourceHandle, ShaderHandle>) -> Work {
        match work {
            Work::Dispatch { shader, groups } => {
                let groups = match *groups {
                    Groups::Direct(groups) => Groups::Direct(groups),
                    Groups::Indirect { buffer, offset } => {
                        Groups::Indirect { buffer: self.resource(buffer), offset }
                    }
                };
                Work::Dispatch { shader: self.shader(*shader), groups }
            }
            Work::Draw { vertex, fragment, topology, call, targets } => {
                let call = match *call {
                    DrawCall::Direct { vertices, instances } => DrawCall::Direct { vertices, instances },
                    DrawCall::Indirect { buffer, offset } => {
                        DrawCall::Indirect { buffer: self.resource(buffer), offset }
                    }
                };
                let target =
                    |t: &Target<_>| Target { image: self.resource(t.image), load: t.load, blend: t.blend };
                Work::Draw {
                    vertex: self.shader(*vertex),
                    fragment: self.shader(*fragment),
                    topology: *topology,
                    call,
                    targets: targets.iter().map(target).collect(),
                }
            }
            Work::Fill { buffer, value } => Work::Fill { buffer: self.resource(*buffer), value: *value },
            Work::ClearHistory { resource } => Work::ClearHistory { resource: self.resource(*resource) },
            Work::Export => Work::Export,
            Work::Host => Work::Host,
        }
    }
}

/// Builds a plan of these passes, in this order, without memory, dependencies or usage yet.
pub(super) fn compact(
    lowered: Lowered,
    shaders: Vec<crate::ir::Shader>,
    passes: &[&LinkedPass],
    files: &SourceMap,
) -> Plan {
    let mut used = (vec![false; lowered.resources.len()], vec![false; shaders.len()]);
    for LinkedPass { pass, .. } in passes {
        pass.uses.iter().for_each(|touch| used.0[lowered.real(touch.resource).index()] = true);
        match &pass.work {
            Work::Dispatch { shader, .. } => used.1[shader.index()] = true,
            Work::Draw { vertex, fragment, .. } => {
                [vertex, fragment].into_iter().for_each(|shader| used.1[shader.index()] = true);
            }
            _ => {}
        }
    }
    let ids = Ids {
        lowered: &lowered,
        resources: number(&used.0).map(|id| id.map(ResourceId)).collect(),
        shaders: number(&used.1).map(|id| id.map(ShaderId)).collect(),
    };
    let kept = lowered.resources.iter().zip(&used.0).filter(|(_, used)| **used);
    let resource = |resource: &crate::lower::LoweredResource| Resource {
        name: resource.name.clone(),
        shape: resource.shape,
        usage: Usage::empty(),
        source: resource.source.clone(),
        block: None,
        history: resource.history.clone(),
        origin: files.origin(resource.span),
    };
    let stat = |stat: &Stat<ResourceHandle>| Stat {
        name: stat.name.clone(),
        buffer: ids.resource(stat.buffer),
        offset: stat.offset,
    };
    let image = |output: &Output<ResourceHandle>| Output {
        name: output.name.clone(),
        image: ids.resource(output.image),
    };
    let outputs = lowered.outputs.iter().map(image).collect();
    let (resources, stats) =
        (kept.map(|(r, _)| resource(r)).collect(), lowered.stats.iter().map(stat).collect());
    let (passes, output) = (passes.iter().map(|p| ids.pass(&p.pass)).collect(), ids.resource(lowered.output));
    Plan {
        resources,
        stats,
        passes,
        output,
        outputs,
        shaders: shaders.into_iter().zip(&used.1).filter(|(_, used)| **used).map(|(s, _)| s).collect(),
        name: lowered.name,
        summary: lowered.summary,
        based_on: lowered.based_on,
        fallbacks: lowered.fallbacks,
        facts: lowered.facts,
        params: lowered.params,
        effects: Vec::new(),
        blocks: Vec::new(),
        dependencies: Vec::new(),
        layout_changes: Vec::new(),
        prologue: Vec::new(),
        frame: Vec::new(),
        culled: lowered.culled,
        warnings: Vec::new(),
    }
}

/// Numbers the used ones consecutively.
fn number(used: &[bool]) -> impl Iterator<Item = Option<u32>> {
    let mut next = 0;
    used.iter().map(move |used| {
        let id = used.then_some(next);
        next += u32::from(*used);
        id
    })
}
