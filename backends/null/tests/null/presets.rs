//! Runs the plan of every built-in graph through the runtime, without a GPU.

use crate::common::{Zeros, opened};
use crate::nominal::{self, CAMERA_BYTES};
use splatgraph_api::{Device, FrameInputs, Inspect};
use splatgraph_assets::{ATTRIBUTES, MESH_ATTRIBUTES};
use splatgraph_framework::build;
use splatgraph_framework::ir::{Attribute, Facts, Layout, Request, ResourceId, Work};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::source::{Library, SourceMap, render};
use splatgraph_null::{Call, Config, Journal, Null, limits};
use std::path::Path;
use std::time::Instant;

const COUNT: u32 = 2_000;

/// Builds the plans of all built-in presets, and graphs with an output, for a small scene, with or without aliasing.
fn plans(share_memory: bool) -> Vec<Plan> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines");
    let scene = splatgraph_assets::synth::generate("demo", COUNT, 1).expect("a generator");
    let facts = Facts { device: limits().facts, ..nominal::facts(COUNT, (64, 36)) };
    let catalog = nominal::catalog(COUNT);
    let attributes = ATTRIBUTES.into_iter().chain(MESH_ATTRIBUTES).map(|name| {
        let info = scene.attribute(name).expect("a scene has it");
        (name.to_string(), Attribute { stride: info.stride, count: info.count, planes: info.planes })
    });
    assert_eq!(catalog.attributes, attributes.collect(), "the attributes of a scene");
    let mut graphs: Vec<_> = std::fs::read_dir(folder)
        .expect("the built-in graphs")
        .map(|entry| entry.expect("a file").path())
        .filter(|path| path.extension().is_some_and(|e| e == "ron"))
        // Graphs that exist only to be included have no output.
        .filter(|path| {
            let text = std::fs::read_to_string(path).expect("a text");
            text.contains("output:") || text.contains("Preset(")
        })
        .collect();
    graphs.sort();
    assert!(graphs.len() >= 9, "{graphs:?}");
    let (mut files, mut compiler) = (SourceMap::new(Library::default()), Glslang::default());
    let mut plan = |path: std::path::PathBuf| {
        let graph = path.to_str().expect("a plain path");
        let request = Request { share_memory, ..Request::new(graph, &facts, &catalog) };
        build(&request, &mut files, &mut compiler).unwrap_or_else(|e| panic!("{}", render(&files, &e, false)))
    };
    graphs.into_iter().map(&mut plan).collect()
}

fn device() -> (Null, Journal) {
    opened(&Config { window: Some((64, 36)), ..Config::default() })
}

fn inputs(plan: &Plan) -> FrameInputs {
    FrameInputs {
        uniforms: [("frame.camera".to_string(), vec![0; CAMERA_BYTES as usize])].into(),
        live: plan.live_bytes(),
        present: true,
        read_output: true,
        ..FrameInputs::default()
    }
}

fn works(calls: &[Call]) -> [usize; 3] {
    let count = |is: fn(&Call) -> bool| calls.iter().filter(|call| is(call)).count();
    [
        count(|call| matches!(call, Call::Dispatch(_) | Call::DispatchIndirect { .. })),
        count(|call| matches!(call, Call::Draw { .. } | Call::DrawIndirect { .. })),
        count(|call| matches!(call, Call::Synchronize { .. })),
    ]
}

#[test]
fn every_preset_runs_through_the_runtime_call_by_call_as_its_plan_says() {
    let (mut device, journal) = device();
    let plans = plans(true);
    for plan in &plans {
        let started = Instant::now();
        device
            .load(plan.clone(), &Zeros::default(), &mut |_| {})
            .unwrap_or_else(|e| panic!("{}: {e}", plan.name));
        for _ in 0..3 {
            journal.take();
            let frame = device.submit(&inputs(plan)).unwrap_or_else(|e| panic!("{}: {e}", plan.name));
            let result = device.wait(frame).expect("the frame is done");
            assert_eq!(result.stats.len(), plan.stats.len());
        }
        let work = |is: fn(&Work) -> bool| plan.frame.iter().filter(|s| is(&plan.pass(**s).work)).count();
        let expected = [
            work(|work| matches!(work, Work::Dispatch { .. })),
            work(|work| matches!(work, Work::Draw { .. })),
            plan.frame.iter().filter(|pass| !plan.dependencies_of(**pass).is_empty()).count(),
        ];
        assert_eq!(works(&journal.take()), expected, "{}", plan.name);
        let took = started.elapsed();
        assert!(took.as_millis() < 1000, "{} took {took:?}", plan.name);
    }
    for plan in plans.iter().chain(plans.iter().rev()) {
        device.load(plan.clone(), &Zeros::default(), &mut |_| {}).expect("the plan loads");
        device.submit(&inputs(plan)).expect("the frame is submitted");
    }
    assert_eq!(device.close(), Vec::<String>::new());
    assert_eq!(journal.alive(), Default::default());
}

#[test]
fn every_resource_of_every_preset_can_be_inspected_after_the_last_pass() {
    let (mut device, journal) = device();
    for plan in plans(false) {
        let after = *plan.frame.last().expect("a frame has passes");
        let ids = (0..plan.resources.len() as u32).map(ResourceId);
        let inspect: Vec<Inspect> = ids.map(|resource| Inspect { resource, after }).collect();
        device.load(plan.clone(), &Zeros::default(), &mut |_| {}).expect("the plan loads");
        device.submit(&inputs(&plan)).expect("the frame is submitted");
        let frame = device.submit(&FrameInputs { inspect, ..inputs(&plan) });
        let result = device.wait(frame.unwrap_or_else(|e| panic!("{}: {e}", plan.name))).expect("it is done");
        let sizes: Vec<u64> = result.inspected.iter().map(|bytes| bytes.len() as u64).collect();
        assert_eq!(sizes, plan.resources.iter().map(|r| r.bytes()).collect::<Vec<_>>(), "{}", plan.name);
        // Full barriers return images to the layout that the plan expects.
        for call in journal.take() {
            let Call::FullBarrier { images } = call else { continue };
            assert!(images.iter().all(|(_, _, new)| *new != Layout::Undefined), "{}: {images:?}", plan.name);
        }
    }
    assert_eq!(device.close(), Vec::<String>::new());
}
