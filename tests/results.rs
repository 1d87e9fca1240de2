//! Results of `Once` passes that a plan takes over from the previous plan. The picture is identical, on a real driver.

use crate::common::{self, Upload};
use splatgraph::draw::backend::Backend;
use splatgraph::draw::planner::Planner;
use splatgraph::{draw::camera, draw::facts};
use splatgraph_api::{Device, FrameInputs, FrameResult, Loader};
use splatgraph_assets::{Camera, Scene, synth};
use splatgraph_framework::ir::Run;
use splatgraph_framework::plan::Plan;

fn plan(device: &Backend, scene: &Scene, graph: &str, set: &[(&str, &str)], size: (u32, u32)) -> Plan {
    let facts = facts::facts(&facts::SceneFacts::of(scene), &device.info().facts, size);
    let plan = Planner::default().plan(graph, &common::settings(set), &facts, &facts::catalog(scene));
    plan.unwrap_or_else(|errors| panic!("{errors}"))
}

fn draw(device: &mut Backend, scene: &Scene, plan: Plan, camera: &Camera, sharing: bool) -> FrameResult {
    let loader = device.loader();
    let loader = if sharing { loader.sharing_results() } else { loader };
    let inputs = FrameInputs {
        uniforms: camera::frame_uniforms(camera, &scene.bounds(), [0.25, 0.5, 0.75], 0),
        live: plan.live_bytes(),
        read_output: true,
        ..FrameInputs::default()
    };
    let ready =
        loader.prepare(plan, &Upload(scene, scene.identity()), &mut |_| {}).expect("it is made ready");
    device.swap(ready).expect("it is swapped in");
    let frame = device.submit(&inputs).expect("submitted");
    device.wait(frame).expect("drawn")
}

fn once(plan: &Plan, result: &FrameResult) -> Vec<String> {
    let passes = result.pass_ms.iter().map(|(id, _)| plan.pass(*id));
    passes.filter(|pass| pass.run == Run::Once).map(|pass| pass.name.clone()).collect()
}

#[test]
fn a_resize_and_a_changed_constant_draw_the_same_bytes_with_results_that_are_taken_over() {
    let scene = synth::generate("demo", 3000, 0).expect("a scene");
    type Step<'a> = ((u32, u32), &'a [(&'a str, &'a str)], &'a [&'a str]);
    for (graph, part) in [("splat", "scene"), ("tiled", "splats.scene")] {
        let names = ["covariance", "pack_sh"].map(|name| format!("{part}.{name}"));
        let all = names.each_ref().map(String::as_str);
        let (halves, keys) = (("sh_storage", "f16"), ("key_bits", "16"));
        let steps: [Step; 5] = [
            ((64, 48), &[halves], &all),
            // Another size, then a constant of other passes: nothing is recomputed.
            ((80, 60), &[halves], &[]),
            ((80, 60), &[halves, keys], &[]),
            // A constant of `covariance`: only that pass runs again.
            ((80, 60), &[halves, keys, ("covariance", "half")], &all[..1]),
            ((64, 48), &[halves, ("covariance", "half")], &[]),
        ];
        let mut sharing = common::device();
        let mut apart = common::device();
        for (size, set, expected) in steps {
            let camera = Camera::framing(&scene, size.0, size.1);
            let plan = plan(&sharing, &scene, graph, set, size);
            let with = draw(&mut sharing, &scene, plan.clone(), &camera, true);
            let without = draw(&mut apart, &scene, plan.clone(), &camera, false);
            assert_eq!(once(&plan, &with), expected, "{graph} {size:?} {set:?}");
            assert_eq!(once(&plan, &without), all, "{graph} {size:?} {set:?}");
            let bytes = |result: FrameResult| result.output.expect("asked for").bytes;
            let (with, without) = (bytes(with), bytes(without));
            assert!(with == without, "{graph} {size:?} {set:?}: other bytes");
            assert!(with.iter().any(|byte| *byte != with[0]), "{graph} {size:?} {set:?}: an empty picture");
            assert_eq!(sharing.memory(), apart.memory(), "{graph} {size:?} {set:?}");
            common::assert_silent(&mut sharing, graph);
        }
        assert_eq!(sharing.close(), Vec::<String>::new());
        assert_eq!(apart.close(), Vec::<String>::new());
    }
}
