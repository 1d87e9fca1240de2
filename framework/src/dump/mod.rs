//! The plan for people and programs.
//!
//! [`Dump`] is the plan with names in place of numbers; as JSON ([`json`]) it is the canonical form, and [`text`] and
//! [`dot`] are drawn from it. It says what a reader asks: which passes run, in what order, what each touches, and for every
//! barrier which hazard it stands against, between which passes, at which line of the graph.

mod dot;
mod text;

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use crate::plan::{
    Accesses, Barrier, DrawCall, Groups, Layout, Origin, PassId, Plan, Run, Shape, Source, Stages, Step,
    Value, Work,
};

pub use dot::dot;
pub use text::{barrier_line, bytes, text};

/// The version of the JSON form. Raised when a field changes its meaning or goes.
pub const DUMP_VERSION: u32 = 1;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dump {
    pub version: u32,
    pub graph: String,
    pub summary: String,
    pub parameters: BTreeMap<String, Value>,
    pub facts: BTreeMap<String, Value>,
    pub totals: Totals,
    pub resources: Vec<DumpResource>,
    /// The prologue's passes, then the frame's, as they run.
    pub passes: Vec<DumpPass>,
    pub left_out: Vec<DumpLeftOut>,
    pub output: String,
    /// Name, and `buffer+offset`.
    pub stats: BTreeMap<String, String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    pub prologue_passes: usize,
    pub frame_passes: usize,
    /// Barriers of a frame, and the calls that they are recorded with.
    pub frame_barriers: usize,
    pub frame_barrier_calls: usize,
    /// Bytes of the plan's own buffers and images.
    pub transient_bytes: u64,
    /// Bytes of the scene's attributes that the plan reads.
    pub scene_bytes: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpResource {
    pub name: String,
    /// `transient`, `scene`, `frame` or `live`.
    pub source: String,
    /// For buffers `count x stride`, for images `width x height format`.
    pub shape: String,
    pub bytes: u64,
    /// For instance `STORAGE | INDIRECT`.
    pub usage: String,
    pub declared: Origin,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpPass {
    pub name: String,
    pub phase: String,
    pub run: Run,
    /// `dispatch`, `draw`, `fill` or `export`.
    pub kind: String,
    pub shaders: Vec<DumpShader>,
    /// How much: workgroups, vertices, or where the arguments are.
    pub size: String,
    pub reads: Vec<String>,
    pub writes: Vec<String>,
    /// Block or image, and resource.
    pub bindings: Vec<(String, String)>,
    /// Push constants as 32-bit words.
    pub push: Vec<u32>,
    pub barriers: Vec<DumpBarrier>,
    pub declared: Origin,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpShader {
    pub file: String,
    pub defines: Vec<(String, String)>,
    pub local_size: [u32; 3],
    pub shared_bytes: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpBarrier {
    pub resource: String,
    pub hazard: String,
    /// Passes waited for.
    pub after: Vec<String>,
    pub before: String,
    pub across_frames: bool,
    pub source_stages: String,
    pub source_accesses: String,
    pub target_stages: String,
    pub target_accesses: String,
    pub layouts: Option<(Layout, Layout)>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpLeftOut {
    pub pass: String,
    pub why: String,
    pub declared: Origin,
}

/// The plan with names in place of numbers.
pub fn dump(plan: &Plan) -> Dump {
    let calls = plan.frame.iter().filter(|s| !s.barriers.is_empty()).count();
    let scene = plan.resources.iter().filter(|r| matches!(r.source, Source::Scene { .. }));
    Dump {
        version: DUMP_VERSION,
        graph: plan.name.clone(),
        summary: plan.summary.clone(),
        parameters: plan.params.iter().map(|p| (p.name.clone(), p.value.clone())).collect(),
        facts: plan.facts.clone(),
        totals: Totals {
            prologue_passes: plan.prologue.len(),
            frame_passes: plan.frame.len(),
            frame_barriers: plan.frame.iter().map(|s| s.barriers.len()).sum(),
            frame_barrier_calls: calls,
            transient_bytes: plan.transient_bytes(),
            scene_bytes: scene.map(|r| r.bytes()).sum(),
        },
        resources: plan.resources.iter().map(resource).collect(),
        passes: plan.prologue.iter().chain(&plan.frame).map(|step| pass(plan, step)).collect(),
        left_out: plan
            .left_out
            .iter()
            .map(|l| DumpLeftOut { pass: l.pass.clone(), why: l.why.clone(), declared: l.origin.clone() })
            .collect(),
        output: plan.resource(plan.output).name.clone(),
        stats: plan
            .stats
            .iter()
            .map(|s| (s.name.clone(), format!("{}+{}", plan.resource(s.buffer).name, s.offset)))
            .collect(),
    }
}

/// The canonical form.
pub fn json(plan: &Plan) -> serde_json::Value {
    serde_json::to_value(dump(plan)).expect("a dump is plain data with string keys")
}

fn resource(resource: &crate::plan::Resource) -> DumpResource {
    DumpResource {
        name: resource.name.clone(),
        source: match &resource.source {
            Source::Transient => "transient".into(),
            Source::Scene { .. } => "scene".into(),
            Source::Frame { .. } => "frame".into(),
            Source::Live => "live".into(),
        },
        shape: match resource.shape {
            Shape::Buffer { stride, count } => format!("{count} x {stride}"),
            Shape::Image { format, width, height } => format!("{width} x {height} {format:?}"),
        },
        bytes: resource.bytes(),
        usage: flags(resource.usage.iter_names()),
        declared: resource.origin.clone(),
    }
}

fn pass(plan: &Plan, step: &Step) -> DumpPass {
    let pass = plan.pass(step.pass);
    let name = |id| plan.resource(id).name.clone();
    let argument = |buffer, offset: u64| format!("from {}+{offset}", name(buffer));
    let (kind, shaders, size) = match &pass.work {
        Work::Dispatch { shader, groups } => (
            "dispatch",
            vec![*shader],
            match groups {
                Groups::Direct([x, 1, 1]) => format!("{x} groups"),
                Groups::Direct([x, y, z]) => format!("{x} x {y} x {z} groups"),
                Groups::Indirect { buffer, offset } => argument(*buffer, *offset),
            },
        ),
        Work::Draw { vertex, fragment, call, .. } => (
            "draw",
            vec![*vertex, *fragment],
            match call {
                DrawCall::Direct { vertices, instances } => format!("{vertices} vertices x {instances}"),
                DrawCall::Indirect { buffer, offset } => argument(*buffer, *offset),
            },
        ),
        Work::Fill { buffer, value } => {
            ("fill", vec![], format!("{} bytes with {value:#010x}", plan.resource(*buffer).bytes()))
        }
        Work::Export => ("export", vec![], String::new()),
    };
    let touched = |wanted: fn(Accesses) -> bool| {
        let mut names: Vec<String> = Vec::new();
        for touch in pass.touches.iter().filter(|t| wanted(t.accesses)) {
            let name = name(touch.resource);
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    };
    DumpPass {
        name: pass.name.clone(),
        phase: pass.phase.clone(),
        run: pass.run,
        kind: kind.into(),
        shaders: shaders
            .into_iter()
            .map(|id| {
                let shader = plan.shader(id);
                DumpShader {
                    file: shader.name.clone(),
                    defines: shader.defines.clone(),
                    local_size: shader.reflection.local_size,
                    shared_bytes: shader.reflection.shared_bytes,
                }
            })
            .collect(),
        size,
        reads: touched(Accesses::reads),
        writes: touched(Accesses::writes),
        bindings: pass.bindings.iter().map(|b| (b.name.clone(), name(b.resource))).collect(),
        push: pass.push.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect(),
        barriers: step.barriers.iter().map(|b| barrier(plan, b, step.pass)).collect(),
        declared: pass.origin.clone(),
    }
}

fn barrier(plan: &Plan, barrier: &Barrier, before: PassId) -> DumpBarrier {
    let stages = |s: Stages| flags(s.iter_names());
    let accesses = |a: Accesses| flags(a.iter_names());
    DumpBarrier {
        resource: plan.resource(barrier.resource).name.clone(),
        hazard: format!("{:?}", barrier.hazard),
        after: barrier.after.iter().map(|id| plan.pass(*id).name.clone()).collect(),
        before: plan.pass(before).name.clone(),
        across_frames: barrier.across_frames,
        source_stages: stages(barrier.source_stages),
        source_accesses: accesses(barrier.source_accesses),
        target_stages: stages(barrier.target_stages),
        target_accesses: accesses(barrier.target_accesses),
        layouts: barrier.layouts,
    }
}

/// `A | B`, or `NONE`.
fn flags<T>(names: impl Iterator<Item = (&'static str, T)>) -> String {
    let names: Vec<&str> = names.map(|(name, _)| name).collect();
    if names.is_empty() { "NONE".into() } else { names.join(" | ") }
}
