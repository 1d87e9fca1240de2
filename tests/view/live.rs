//! Graphs, shaders and parameters that change while frames are drawn.

use super::twin::{Twin, shows_something};
use crate::common;
use splatgraph::view::events::{Event, RendererId};
use splatgraph::view::paint::Mode;
use splatgraph_assets::Camera;
use splatgraph_framework::ir::Value;

const SPLATS: u32 = 3_000;

#[test]
fn an_edited_shader_is_shown_and_no_frame_is_lost_on_the_way() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    let before = twin.picture(RendererId::A);
    assert!(shows_something(&before));
    let camera = twin.viewer.navigation.camera(96, 54);
    let (drawn, mut asked) = (twin.drawn(), 0);
    twin.place.edit(
        "shaders/compose.comp",
        "void main() {",
        "void main() {\n    // another text, the same code\n",
    );
    let seen = twin.events.len();
    while twin.events[seen..].iter().all(|event| !matches!(event, Event::Swapped { .. })) {
        twin.frame();
        asked += 1;
        assert!(asked < 100_000, "{:#?}", twin.events);
    }
    assert_eq!(twin.drawn() - drawn, asked, "every frame that was asked for was drawn");
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    assert_eq!(twin.viewer.navigation.camera(96, 54), camera);

    // An edit that changes the picture.
    let frag = twin.place.text("shaders/splat.frag");
    let output = frag
        .lines()
        .find(|line| line.contains("blended = "))
        .expect("the shader writes its colour")
        .to_owned();
    twin.place.write(
        "shaders/splat.frag",
        frag.replace(&output, &format!("{output}\n    blended.rg = vec2(0.0);")),
    );
    let Event::Swapped { swap, .. } = twin.next_plan() else { unreachable!() };
    assert_eq!(swap.causes.to_string(), "splat.frag");
    let blue = twin.picture(RendererId::A);
    assert!(blue.rgb.iter().all(|[r, g, _]| *r == 0.0 && *g == 0.0) && shows_something(&blue));
    twin.close();
}

#[test]
fn a_mistake_in_a_graph_is_told_at_its_place_and_the_last_good_picture_stays_until_it_is_mended() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    let before = twin.picture(RendererId::A);
    let good = twin.place.text("pipelines/splat.ron");
    twin.place.write("pipelines/splat.ron", good.replace("\"Splats\": \"splats\"", "\"Splats\": \"splatz\""));
    let text = twin.next_failure();
    assert!(
        text.contains("there is no resource `splatz`") && text.contains("pipelines/splat.ron:"),
        "{text}"
    );
    assert!(text.contains("^^^^^^ not declared") && text.contains("did you mean `splats`?"), "{text}");
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    twin.place.write("pipelines/splat.ron", good);
    twin.until("the mending", |event| matches!(event, Event::Mended { renderer: RendererId::A }));
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    twin.close();
}

#[test]
fn a_mistake_in_a_shader_is_told_at_its_place_too() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    let before = twin.picture(RendererId::A);
    twin.place.edit("shaders/project.comp", "void main() {", "void main() {\n    int i = undeclared;");
    let text = twin.next_failure();
    assert!(text.contains("undeclared") && text.contains("shaders/project.comp:"), "{text}");
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    twin.place.edit("shaders/project.comp", "\n    int i = undeclared;", "");
    twin.until("the mending", |event| matches!(event, Event::Mended { renderer: RendererId::A }));
    twin.close();
}

#[test]
fn the_digit_width_changes_while_it_runs_and_the_picture_does_not_flicker() {
    let mut twin = Twin::drawing("splat", SPLATS, &[("sorter", "serial"), ("key_bits", "32")]);
    let before = twin.picture(RendererId::A);
    let passes = twin.passes();
    for (bits, fewer) in [(4, false), (11, true), (8, false)] {
        twin.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(bits)));
        // Checks every frame until the swap, and the first three after it.
        let seen = twin.events.len();
        let mut after = 0;
        while after < 3 {
            assert_eq!(twin.picture(RendererId::A).rgb, before.rgb, "with digits of {bits} bits");
            after +=
                usize::from(twin.events[seen..].iter().any(|event| matches!(event, Event::Swapped { .. })));
        }
        match bits {
            8 => assert_eq!(twin.passes(), passes),
            _ => assert_eq!(
                twin.passes() < passes,
                fewer,
                "{} passes, and {passes} with 8 bits",
                twin.passes()
            ),
        }
    }
    // 8 bits are the default for 32-bit keys, so the command line need not mention them.
    assert_eq!(twin.viewer.a.renderer.set().keys().collect::<Vec<_>>(), ["sorter", "key_bits"]);
    twin.close();
}

#[test]
fn a_live_parameter_changes_the_next_picture_without_a_new_plan() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    let before = twin.picture(RendererId::A);
    let plans =
        |twin: &Twin| twin.events.iter().filter(|event| matches!(event, Event::Swapped { .. })).count();
    let built = plans(&twin);
    twin.viewer.a.renderer.set_param("budget", Some(Value::Float(0.25)));
    assert_ne!(twin.picture(RendererId::A).rgb, before.rgb);
    // A plan that is rebuilt for another reason keeps the live value.
    let dimmed = twin.picture(RendererId::A);
    twin.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(4)));
    twin.next_plan();
    assert_eq!(twin.picture(RendererId::A).rgb, dimmed.rgb);
    twin.viewer.a.renderer.set_param("budget", None);
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    assert_eq!(plans(&twin), built + 1);
    twin.close();
}

#[test]
fn parameters_that_a_file_no_longer_declares_are_forgotten_and_the_others_stay() {
    let mut twin = Twin::drawing("splat", SPLATS, &[("digit_bits", "4"), ("budget", "0.5")]);
    let graph = twin.place.text("pipelines/parts/depth_order.ron");
    let from = graph.find("    \"budget\": Live").expect("it is declared");
    let end = from + graph[from..].find("    )),\n").expect("its end") + "    )),\n".len();
    twin.place.write("pipelines/parts/depth_order.ron", format!("{}{}", &graph[..from], &graph[end..]));
    // The shader that reads the parameter must stop reading it: settings are dropped only once a plan is drawn without them.
    let shader = twin.place.text("shaders/scan_blocks.comp");
    twin.place.write("shaders/scan_blocks.comp", shader.replace("budget", "1.0"));
    twin.until(
        "the parameter to be dropped",
        |event| matches!(event, Event::Dropped { parameters, .. } if parameters == &["budget"]),
    );
    assert_eq!(twin.viewer.a.renderer.set().get("digit_bits").map(String::as_str), Some("4"));
    assert!(!twin.viewer.a.renderer.set().contains_key("budget"));
    twin.close();
}

#[test]
fn a_setting_that_the_graph_does_not_know_is_a_mistake_at_the_start() {
    let mut twin = Twin::new("splat", SPLATS, &[("digit_bit", "4")]);
    let text = twin.next_failure();
    assert!(text.contains("digit_bit") && text.contains("digit_bits"), "{text}");
    twin.close();
}

#[test]
fn another_graph_and_a_second_one_beside_it_share_the_camera() {
    let mut twin = Twin::drawing("digit8", SPLATS, &[]);
    twin.viewer.set_compare(Mode::Split).unwrap_or_else(|error| panic!("{error}"));
    twin.settle();
    let choose = |twin: &mut Twin, graph: &str| {
        let path = twin.place.named(&format!("pipelines/{graph}.ron"));
        twin.viewer.viewport(RendererId::B).expect("there is a B").renderer.choose(&path, Default::default());
        twin.until(
            "the plan of B",
            |event| matches!(event, Event::Swapped { renderer: RendererId::B, swap, .. } if swap.graph.contains(graph)),
        );
    };
    choose(&mut twin, "digit4");
    assert_eq!(twin.picture(RendererId::A).rgb, twin.picture(RendererId::B).rgb, "two widths of the digits");
    twin.viewer.measure();
    let compared = twin.until("the comparison", |event| matches!(event, Event::Compared { .. }));
    assert!(
        matches!(compared, Event::Compared { psnr, worst, identical: true, .. } if psnr.is_infinite() && worst == 0.0),
        "{compared:?}"
    );
    assert!(compared.to_string().ends_with(": identical"), "{compared}");

    choose(&mut twin, "unsorted");
    twin.viewer.measure();
    let compared = twin.until("the comparison", |event| matches!(event, Event::Compared { .. }));
    assert!(
        matches!(compared, Event::Compared { psnr, identical: false, .. } if psnr < 40.0),
        "{compared:?}"
    );
    twin.close();
}

#[test]
fn a_window_that_is_resized_minimised_and_opened_again_shows_the_picture_in_its_size() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    for size in [(120, 80), (33, 97), (1, 1), (96, 54)] {
        twin.size = size;
        twin.settle();
        let picture = twin.picture(RendererId::A);
        assert_eq!((picture.width, picture.height), (size.0 as usize, size.1 as usize));
    }
    let before = twin.picture(RendererId::A);
    twin.size = (0, 0);
    twin.frames(5);
    twin.size = (96, 54);
    twin.settle();
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    twin.close();
}

#[test]
fn files_that_are_dropped_are_opened_and_bad_ones_lose_nothing() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    let before = twin.picture(RendererId::A);
    for (name, text) in
        [("bad.ply", "ply\nformat sideways 1.0\n"), ("bad.json", "[{"), ("notes.txt", "hello")]
    {
        twin.place.write(name, text);
        let path = twin.place.at(name);
        twin.viewer.open(&path);
        twin.until("the complaint", |event| {
            matches!(event, Event::SceneFailed { .. } | Event::FileFailed { .. })
        });
        assert_eq!(twin.picture(RendererId::A).rgb, before.rgb, "after {name}");
    }
    twin.place.scene("other.ply", "uniform", 2_000, 0);
    let path = twin.place.at("other.ply");
    twin.viewer.open(&path);
    twin.until("the scene", |event| matches!(event, Event::Scene { splats: 2_000, .. }));
    twin.settle();
    let ball = twin.picture(RendererId::A);
    assert!(shows_something(&ball) && ball.rgb != before.rgb);
    let graph = twin.place.at("pipelines/unsorted.ron");
    twin.viewer.open(&graph);
    twin.until(
        "the graph",
        |event| matches!(event, Event::Swapped { swap, .. } if swap.graph.contains("unsorted")),
    );
    twin.close();
}

/// Camera files are in world coordinates, the viewer's cameras in the coordinates of its scene.
#[test]
fn cameras_follow_the_scene_to_its_origin_whichever_is_read_first() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    let (scene, cameras) = (twin.place.at("far.ply"), twin.place.at("views.json"));
    let place = [4_096_000.0, -1_024_000.0, 0.0];
    let ball = splatgraph_assets::synth::generate("uniform", 2_000, 0).expect("it is generated");
    ball.with_offset(place).write_ply(&scene).expect("it is written");
    let local = Camera::looking_at([0.25, -0.5, -2.5], [0.0; 3], 60.0, (96, 54));
    Camera::save(&[local.relative_to(place.map(|v| -v))], &cameras).expect("they are written");
    twin.viewer.open(&scene);
    twin.viewer.open(&cameras);
    let (mut scenes, mut views) = (0, 0);
    while scenes == 0 || views == 0 {
        twin.until("the scene and the cameras", |event| {
            matches!(event, Event::Scene { .. } | Event::Cameras { .. })
        });
        let count = |is_it: fn(&Event) -> bool| twin.events.iter().filter(|event| is_it(event)).count();
        scenes = count(|event| matches!(event, Event::Scene { splats: 2_000, .. }));
        views = count(|event| matches!(event, Event::Cameras { .. }));
    }
    assert_eq!(twin.viewer.scene().offset(), place);
    assert_eq!(twin.viewer.cameras[0].position, local.position);
    twin.settle();
    assert!(shows_something(&twin.picture(RendererId::A)));

    // Back to a scene at the origin: cameras that are opened then are not moved.
    let near = twin.place.at("near.ply");
    twin.place.scene("near.ply", "uniform", 1_000, 0);
    Camera::save(std::slice::from_ref(&local), &cameras).expect("they are written");
    twin.viewer.open(&near);
    twin.until("the scene", |event| matches!(event, Event::Scene { splats: 1_000, .. }));
    twin.viewer.open(&cameras);
    twin.until("the cameras", |event| matches!(event, Event::Cameras { .. }));
    assert_eq!(twin.viewer.cameras[0].position, local.position);
    twin.close();
}

#[test]
fn what_the_last_frame_left_lives_on_when_a_shader_is_reloaded() {
    let mut twin = Twin::drawing("stale_order", SPLATS, &[]);
    twin.frames(3);
    let before = twin.picture(RendererId::A);
    assert!(shows_something(&before));
    twin.place.edit("shaders/compose.comp", "void main() {", "void main() {\n    // another text\n");
    let seen = twin.events.len();
    // The graph draws in the order of the previous frame. If the order were lost, a frame would be black.
    while twin.events[seen..].iter().all(|event| !matches!(event, Event::Swapped { .. })) {
        assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    }
    assert_eq!(twin.picture(RendererId::A).rgb, before.rgb);
    twin.close();
}

#[test]
fn sorted_keys_are_found_sorted_and_the_prologue_can_be_looked_at() {
    let mut twin = Twin::drawing("splat", SPLATS, &[]);
    twin.viewer.a.look_at("keys", "scatter");
    twin.settle();
    twin.frames(3);
    let found = |twin: &Twin| {
        let inspection = twin.viewer.a.inspection.as_ref().expect("something is looked at");
        inspection.found.clone().expect("it was read").unwrap_or_else(|error| panic!("{error}"))
    };
    let order = found(&twin).order.expect("keys have an order");
    assert!(order.ascending && order.keys > 100, "{order:?}");
    twin.viewer.a.look_at("keys", "compact");
    twin.settle();
    twin.frames(3);
    assert!(!found(&twin).order.expect("keys have an order").ascending);
    // `covariance` is a `Once` pass; inspecting it runs it again.
    twin.viewer.a.look_at("covariances", "covariance");
    twin.settle();
    twin.frames(3);
    assert_eq!(found(&twin).pass, "scene.covariance");
    twin.viewer.a.look_at("color", "back_to_front");
    twin.settle();
    twin.frames(3);
    let picture = found(&twin);
    assert!(picture.is_image && picture.words.picture(&picture.shape).is_some());
    twin.viewer.a.look_at("nothing", "scatter");
    twin.frames(3);
    let inspection = twin.viewer.a.inspection.as_ref().expect("something is looked at");
    assert!(matches!(&inspection.found, Some(Err(error)) if error.contains("no resource `nothing`")));
    common::assert_silent(twin.device(), "inspection");
    twin.close();
}
