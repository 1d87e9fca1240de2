//! A handwritten plan for unit tests. Its shaders have no code that a device could run.

#![allow(dead_code, reason = "each backend crate that includes this file uses a part of it")]

use splatgraph_framework::ir::{Reflection, ShaderStage};
use splatgraph_framework::{ir::*, plan::*};
use std::sync::Arc;

pub(crate) const WORDS: ResourceId = ResourceId(0);
pub(crate) const ARGS: ResourceId = ResourceId(1);
pub(crate) const CAMERA: ResourceId = ResourceId(2);
pub(crate) const SPLATS: ResourceId = ResourceId(3);
pub(crate) const COLOR: ResourceId = ResourceId(4);
pub(crate) const READBACK: ResourceId = ResourceId(5);

/// Returns a plan in which each transient has its own block.
///
/// Prologue: `clear` fills `words`. Frame: `scan[0]` and `scan[1]` dispatch, `splat` draws into `color`, `export`,
/// `host`.
pub(crate) fn plan() -> Plan {
    let buffer = |count| Shape::Buffer { stride: 4, count };
    let color = Shape::Image { format: Format::Rgba16Float, width: 64, height: 32 };
    let any = Usage::STORAGE | Usage::INDIRECT | Usage::COPY_TARGET;
    let resource = |name: &str, shape, usage, source, block| Resource {
        name: name.to_string(),
        shape,
        usage,
        source,
        block,
        history: None,
        origin: origin(),
    };
    let scene = Source::Scene { attribute: "scene.sh".to_string(), plane: 0 };
    let dispatch = |groups| Work::Dispatch { shader: ShaderId(0), groups };
    let draw = Work::Draw {
        vertex: ShaderId(1),
        fragment: ShaderId(2),
        topology: Topology::TriangleStrip,
        call: DrawCall::Indirect { buffer: ARGS, offset: 16 },
        targets: vec![Target {
            image: COLOR,
            load: Load::Clear(0.0, 0.0, 0.0, 0.0),
            blend: Blend::PremultipliedOver,
        }],
        depth: None,
    };
    let scans = vec![binding(0, 0, WORDS, DescriptorKind::StorageBuffer)];
    let splats = vec![
        binding(1, 0, CAMERA, DescriptorKind::UniformBuffer),
        binding(0, 1, WORDS, DescriptorKind::StorageBuffer),
        binding(0, 0, SPLATS, DescriptorKind::StorageBuffer),
    ];
    Plan {
        name: "test".to_string(),
        resources: vec![
            resource("words", buffer(1024), any, Source::Transient, Some(BlockId(0))),
            resource("args", buffer(8), any, Source::Transient, Some(BlockId(1))),
            resource(
                "camera",
                buffer(64),
                Usage::UNIFORM,
                Source::Frame { uniform: "frame.camera".to_string() },
                None,
            ),
            resource("splats", buffer(4096), Usage::STORAGE, scene, None),
            resource(
                "color",
                color,
                Usage::COLOR_TARGET | Usage::COPY_SOURCE,
                Source::Transient,
                Some(BlockId(2)),
            ),
            resource("readback", buffer(1), Usage::COPY_TARGET, Source::Readback, None),
        ],
        shaders: vec![
            shader("scan.comp", ShaderStage::Compute),
            shader("splat.vert", ShaderStage::Vertex),
            shader("splat.frag", ShaderStage::Fragment),
        ],
        passes: vec![
            pass("clear", Run::Once, Work::Fill { buffer: WORDS, value: 0 }, Vec::new()),
            pass("scan[0]", Run::Frame, dispatch(Groups::Direct([4, 1, 1])), scans.clone()),
            pass("scan[1]", Run::Frame, dispatch(Groups::Indirect { buffer: ARGS, offset: 4 }), scans),
            pass("splat", Run::Frame, draw, splats),
            pass("export", Run::Frame, Work::Export, Vec::new()),
            pass("host", Run::Frame, Work::Host, Vec::new()),
        ],
        blocks: [WORDS, ARGS, COLOR].map(|id| Block { aliases: vec![id] }).into(),
        prologue: vec![PassId(0)],
        frame: (1..6).map(PassId).collect(),
        output: COLOR,
        stats: vec![Stat { name: "visible".to_string(), buffer: ARGS, offset: 20, grows: Vec::new() }],
        ..Plan::default()
    }
}

fn binding(binding: u32, element: u32, resource: ResourceId, kind: DescriptorKind) -> Binding {
    Binding { name: format!("Block{binding}"), binding, element, kind, resource }
}

fn pass(name: &str, run: Run, work: Work, bindings: Vec<Binding>) -> Pass {
    Pass {
        name: name.to_string(),
        phase: "test".to_string(),
        run,
        work,
        bindings,
        push: vec![0; 8],
        uses: Vec::new(),
        origin: origin(),
    }
}

fn shader(name: &str, stage: ShaderStage) -> Shader {
    Shader {
        name: name.to_string(),
        path: name.to_string(),
        defines: Vec::new(),
        spirv: Arc::new(vec![0x0723_0203]),
        reflection: reflection(stage, [64, 1, 1], Features::empty()),
        msl: None,
    }
}

pub(crate) fn reflection(stage: ShaderStage, local_size: [u32; 3], features: Features) -> Reflection {
    Reflection {
        stage,
        local_size,
        shared_bytes: 1024,
        bindings: Vec::new(),
        push: None,
        inputs: Vec::new(),
        outputs: Vec::new(),
        uses_position: true,
        ignores_rows: false,
        features,
    }
}

fn origin() -> Origin {
    Origin { file: "test.ron".to_string(), line: 1, column: 1 }
}
