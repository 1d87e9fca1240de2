//! Graphs, shaders and parameters that change while frames are drawn.

use super::whole::TestShell;
use splatgraph::draw::backend::Validation;
use splatgraph::io::image::Image;
use splatgraph::view::events::{Event, RendererId};
use splatgraph_assets::Camera;
use splatgraph_framework::ir::Value;

const SIZE: (u32, u32) = (96, 54);

/// Opens a viewer whose picture fills the window.
fn opened(graph: &str, set: &[(&str, &str)]) -> TestShell {
    let graph = format!("pipelines/{graph}.ron");
    let mut viewer = TestShell::open(Validation::Synchronization, ("demo", 3_000), &graph, set, SIZE);
    (viewer.shell.panels.hidden, viewer.shell.panels.hud) = (true, false);
    viewer
}

/// Opens a viewer, and draws until everything is built.
fn drawing(graph: &str, set: &[(&str, &str)]) -> TestShell {
    let mut viewer = opened(graph, set);
    viewer.settle();
    viewer
}

fn next_plan(viewer: &mut TestShell) -> Event {
    viewer.event("a new plan of A", |event| matches!(event, Event::Swapped { renderer: RendererId::A, .. }))
}

/// Draws frames until the next error; returns its text.
fn next_failure(viewer: &mut TestShell) -> String {
    match viewer.event("a mistake", |event| matches!(event, Event::Failed { .. })) {
        Event::Failed { text, .. } => text,
        other => unreachable!("{other:?}"),
    }
}

fn passes(viewer: &TestShell) -> usize {
    viewer.shell.viewer.a.renderer.plan().map_or(0, |plan| plan.frame.len())
}

fn shows_something(image: &Image) -> bool {
    image.rgb.iter().any(|pixel| pixel.iter().any(|v| *v > 0.1))
}

#[test]
fn an_edited_shader_is_shown_and_no_frame_is_lost_on_the_way() {
    let mut viewer = drawing("splat", &[]);
    let before = viewer.picture(RendererId::A);
    assert!(shows_something(&before));
    let camera = viewer.shell.viewer.navigation.camera(96, 54);
    let (drawn, mut asked) = (viewer.drawn(), 0);
    viewer.place.edit(
        "shaders/compose.comp",
        "void main() {",
        "void main() {\n    // another text, the same code\n",
    );
    let seen = viewer.events.len();
    while viewer.events[seen..].iter().all(|event| !matches!(event, Event::Swapped { .. })) {
        viewer.frame();
        asked += 1;
        assert!(asked < 100_000, "{:#?}", viewer.events);
    }
    assert_eq!(viewer.drawn() - drawn, asked, "every frame that was asked for was drawn");
    assert_eq!(viewer.picture(RendererId::A).rgb, before.rgb);
    assert_eq!(viewer.shell.viewer.navigation.camera(96, 54), camera);

    // An edit that changes the picture.
    let frag = viewer.place.text("shaders/splat.frag");
    let output = frag
        .lines()
        .find(|line| line.contains("blended = "))
        .expect("the shader writes its colour")
        .to_owned();
    viewer.place.write(
        "shaders/splat.frag",
        frag.replace(&output, &format!("{output}\n    blended.rg = vec2(0.0);")),
    );
    let Event::Swapped { swap, .. } = next_plan(&mut viewer) else { unreachable!() };
    assert_eq!(swap.causes.to_string(), "splat.frag");
    let blue = viewer.picture(RendererId::A);
    assert!(blue.rgb.iter().all(|[r, g, _]| *r == 0.0 && *g == 0.0) && shows_something(&blue));
    viewer.close();
}

#[test]
fn the_digit_width_changes_while_it_runs_and_the_picture_does_not_flicker() {
    let mut viewer = drawing("splat", &[("sorter", "serial"), ("key_bits", "32")]);
    let before = viewer.picture(RendererId::A);
    let usual = passes(&viewer);
    for (bits, fewer) in [(4, false), (11, true), (8, false)] {
        viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(bits)));
        // Checks every frame until the swap, and the first three after it.
        let seen = viewer.events.len();
        let mut after = 0;
        while after < 3 {
            assert_eq!(viewer.picture(RendererId::A).rgb, before.rgb, "with digits of {bits} bits");
            after +=
                usize::from(viewer.events[seen..].iter().any(|event| matches!(event, Event::Swapped { .. })));
        }
        match bits {
            8 => assert_eq!(passes(&viewer), usual),
            _ => assert_eq!(
                passes(&viewer) < usual,
                fewer,
                "{} passes, and {usual} with 8 bits",
                passes(&viewer)
            ),
        }
    }
    // 8 bits are the default for 32-bit keys, so the command line need not mention them.
    assert_eq!(viewer.shell.viewer.a.renderer.set().keys().collect::<Vec<_>>(), ["sorter", "key_bits"]);
    viewer.close();
}

#[test]
fn a_simulation_continues_after_an_edit_that_leaves_the_plan_as_it_is_and_starts_anew_after_another() {
    let mut viewer = drawing("unsorted", &[]);
    let shader = |name: &str, images: &str, code: &str| {
        let text = format!(
            "#version 460\nlayout(local_size_x = 8, local_size_y = 8) in;\n\
             layout(set = 0, binding = 0, std430) buffer Count {{ float count; }};\n{images}void main() {{ {code} }}\n"
        );
        (format!("shaders/{name}.comp"), text)
    };
    let image = "layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D picture;\n";
    let graph = "Graph(version: 1, summary: \"Counts frames\", output: \"picture\",
  resources: {
    \"count\": Buffer(stride: 4, count: 1),
    \"picture\": Image(format: \"rgba32f\", size: (\"viewport.width\", \"viewport.height\")),
  },
  passes: [
    Dispatch(name: \"start\", run: Once, shader: \"start.comp\", size: Groups(1), bind: { \"Count\": \"count\" }),
    Dispatch(name: \"step\", shader: \"step.comp\", size: Groups(1), bind: { \"Count\": \"count\" }),
    Dispatch(name: \"show\", shader: \"show.comp\", size: Threads(\"viewport.width\", \"viewport.height\"),
      bind: { \"Count\": \"count\", \"picture\": \"picture\" }),
  ],
)";
    let is_first = "if (gl_LocalInvocationIndex == 0) ";
    let show = "imageStore(picture, ivec2(gl_GlobalInvocationID.xy), vec4(count / 1024.0));";
    for (name, text) in [
        shader("start", "", &format!("{is_first}count = 0.0;")),
        shader("step", "", &format!("{is_first}count += 1.0;")),
        shader("show", image, show),
        ("pipelines/count.ron".to_owned(), graph.to_owned()),
    ] {
        viewer.place.write(&name, text);
    }
    let path = viewer.place.named("pipelines/count.ron");
    viewer.shell.viewer.a.renderer.choose(&path, Default::default());
    next_plan(&mut viewer);
    let count = |viewer: &mut TestShell| (viewer.picture(RendererId::A).rgb[0][0] * 1024.0).round() as u32;
    for _ in 0..60 {
        viewer.frame();
    }
    let line =
        |viewer: &TestShell| viewer.shell.viewer.a.renderer.plan().map(|plan| plan.passes[0].origin.line);
    let first = line(&viewer);
    for (file, from, to, same) in [
        ("pipelines/count.ron", "Graph", "// A comment.\nGraph", true),
        ("shaders/show.comp", "void", "// A comment.\nvoid", true),
        ("pipelines/count.ron", "size: Groups(1)", "size: Groups(2)", false),
    ] {
        let before = count(&mut viewer);
        assert!(before > 50, "{file}: {before} frames");
        let text = viewer.place.text(file).replacen(from, to, 1);
        viewer.place.write(file, text);
        assert_eq!(next_plan(&mut viewer).to_string().ends_with(": the same plan"), same, "{file}");
        let after = count(&mut viewer);
        assert_eq!(after > before, same, "{file}: {before} frames, then {after}");
    }
    assert_eq!(line(&viewer), first.map(|line| line + 1), "the plan has its new places in the file");
    viewer.close();
}

#[test]
fn a_live_parameter_changes_the_next_picture_without_a_new_plan() {
    let mut viewer = drawing("splat", &[]);
    let before = viewer.picture(RendererId::A);
    let plans = |viewer: &TestShell| {
        viewer.events.iter().filter(|event| matches!(event, Event::Swapped { .. })).count()
    };
    let built = plans(&viewer);
    viewer.shell.viewer.a.renderer.set_param("budget", Some(Value::Float(0.25)));
    assert_ne!(viewer.picture(RendererId::A).rgb, before.rgb);
    // A plan that is rebuilt for another reason keeps the live value.
    let dimmed = viewer.picture(RendererId::A);
    viewer.shell.viewer.a.renderer.set_param("digit_bits", Some(Value::Int(4)));
    next_plan(&mut viewer);
    assert_eq!(viewer.picture(RendererId::A).rgb, dimmed.rgb);
    viewer.shell.viewer.a.renderer.set_param("budget", None);
    assert_eq!(viewer.picture(RendererId::A).rgb, before.rgb);
    assert_eq!(plans(&viewer), built + 1);
    viewer.close();
}

#[test]
fn a_setting_that_the_graph_does_not_know_is_a_mistake_at_the_start() {
    let mut viewer = opened("splat", &[("digit_bit", "4")]);
    let text = next_failure(&mut viewer);
    assert!(text.contains("digit_bit") && text.contains("digit_bits"), "{text}");
    viewer.close();
}

#[test]
fn a_window_that_is_resized_minimised_and_opened_again_shows_the_picture_in_its_size() {
    let mut viewer = drawing("splat", &[]);
    for size in [(120, 80), (33, 97), (1, 1), (96, 54)] {
        viewer.size = size;
        viewer.settle();
        let picture = viewer.picture(RendererId::A);
        assert_eq!((picture.width, picture.height), (size.0 as usize, size.1 as usize));
    }
    let before = viewer.picture(RendererId::A);
    viewer.size = (0, 0);
    viewer.frames(5);
    viewer.size = (96, 54);
    viewer.settle();
    assert_eq!(viewer.picture(RendererId::A).rgb, before.rgb);
    viewer.close();
}

#[test]
fn a_window_whose_own_graph_has_a_mistake_is_drawn_whole_at_another_size() {
    let mut viewer = TestShell::new(("demo", 3_000), "pipelines/splat.ron", (400, 240));
    viewer.settle();
    viewer.place.edit("shaders/window/ui.frag", "void main() {", "void main() {\n    x");
    let is_of_window = |event: &Event| matches!(event, Event::Failed { renderer: RendererId::Window, .. });
    viewer.event("the mistake", is_of_window);
    viewer.size = (800, 480);
    // The picture of the scene gets its new size, and the window's changed parts have been drawn.
    viewer.until("the scene", |viewer| {
        let window = viewer.shell.viewer.a.renderer.size();
        !viewer.shell.viewer.busy() && window.0 > 400
    });
    viewer.frames(3);
    let stretched = viewer.window();
    assert_eq!((stretched.width, stretched.height), (400, 240), "the size of the last good plan");
    viewer.place.edit("shaders/window/ui.frag", "void main() {\n    x", "void main() {");
    viewer.settle();
    viewer.frames(3);
    let whole = viewer.window();
    assert_eq!((whole.width, whole.height), (800, 480));
    // Blocks of the interface, since the pixels of texts differ; without the status line, which shows the error.
    let mean = |image: &Image, [x, y]: [usize; 2], scale: usize| {
        let rows = image.rgb.chunks(image.width).skip(y * scale).take(12 * scale);
        let pixels = rows.flat_map(|row| &row[x * scale..(x + 8) * scale]);
        pixels.flatten().sum::<f32>() / (3 * 96 * scale * scale) as f32
    };
    let is_view = |[x, y]: [usize; 2]| (56..336).contains(&x) && y >= 12;
    let blocks = (0..19).flat_map(|y| (0..50).map(move |x| [8 * x, 12 * y]));
    for block in blocks.filter(|block| !is_view(*block)) {
        let [found, expected] = [mean(&stretched, block, 1), mean(&whole, block, 2)];
        assert!((found - expected).abs() < 0.1, "expected {expected}, found {found} at {block:?}");
    }
    viewer.close();
}

#[test]
fn files_that_are_dropped_are_opened_and_bad_ones_lose_nothing() {
    let mut viewer = drawing("splat", &[]);
    let before = viewer.picture(RendererId::A);
    for (name, text) in
        [("bad.ply", "ply\nformat sideways 1.0\n"), ("bad.json", "[{"), ("notes.txt", "hello")]
    {
        viewer.place.write(name, text);
        let path = viewer.place.at(name);
        viewer.shell.viewer.open(&path);
        viewer.event("the complaint", |event| {
            matches!(event, Event::SceneFailed { .. } | Event::FileFailed { .. })
        });
        assert_eq!(viewer.picture(RendererId::A).rgb, before.rgb, "after {name}");
    }
    viewer.place.scene("other.ply", "uniform", 2_000, 0);
    let path = viewer.place.at("other.ply");
    viewer.shell.viewer.open(&path);
    viewer.event("the scene", |event| matches!(event, Event::Scene { splats: 2_000, .. }));
    viewer.settle();
    let ball = viewer.picture(RendererId::A);
    assert!(shows_something(&ball) && ball.rgb != before.rgb);
    let graph = viewer.place.at("pipelines/unsorted.ron");
    viewer.shell.viewer.open(&graph);
    viewer.event(
        "the graph",
        |event| matches!(event, Event::Swapped { swap, .. } if swap.graph.contains("unsorted")),
    );
    viewer.close();
}

/// Opens a camera file, which is in world coordinates. The viewer's cameras are in the coordinates of its scene.
#[test]
fn cameras_follow_the_scene_to_its_origin_whichever_is_read_first() {
    let mut viewer = drawing("splat", &[]);
    let (scene, cameras) = (viewer.place.at("far.ply"), viewer.place.at("views.json"));
    let place = [4_096_000.0, -1_024_000.0, 0.0];
    let ball = splatgraph_assets::synth::generate("uniform", 2_000, 0).expect("it is generated");
    ball.with_offset(place).write_ply(&scene).expect("it is written");
    let local = Camera::looking_at([0.25, -0.5, -2.5], [0.0; 3], 60.0, (96, 54));
    Camera::save(&[local.relative_to(place.map(|v| -v))], &cameras).expect("they are written");
    viewer.shell.viewer.open(&scene);
    viewer.shell.viewer.open(&cameras);
    let (mut scenes, mut views) = (0, 0);
    while scenes == 0 || views == 0 {
        viewer.event("the scene and the cameras", |event| {
            matches!(event, Event::Scene { .. } | Event::Cameras { .. })
        });
        let count = |is_it: fn(&Event) -> bool| viewer.events.iter().filter(|event| is_it(event)).count();
        scenes = count(|event| matches!(event, Event::Scene { splats: 2_000, .. }));
        views = count(|event| matches!(event, Event::Cameras { .. }));
    }
    assert_eq!(viewer.shell.viewer.scene().offset(), place);
    assert_eq!(viewer.shell.viewer.navigation.camera(96, 54).position, local.position);
    viewer.settle();
    assert!(shows_something(&viewer.picture(RendererId::A)));

    // Back to a scene at the origin: cameras that are opened then are not moved.
    let near = viewer.place.at("near.ply");
    viewer.place.scene("near.ply", "uniform", 1_000, 0);
    Camera::save(std::slice::from_ref(&local), &cameras).expect("they are written");
    viewer.shell.viewer.open(&near);
    viewer.event("the scene", |event| matches!(event, Event::Scene { splats: 1_000, .. }));
    viewer.shell.viewer.open(&cameras);
    viewer.event("the cameras", |event| matches!(event, Event::Cameras { .. }));
    assert_eq!(viewer.shell.viewer.navigation.camera(96, 54).position, local.position);
    viewer.close();
}

#[test]
fn sorted_keys_are_found_sorted_and_the_prologue_can_be_looked_at() {
    let mut viewer = drawing("splat", &[]);
    viewer.shell.viewer.a.look_at("keys", "scatter");
    viewer.settle();
    viewer.frames(3);
    let found = |viewer: &TestShell| {
        let inspection = viewer.shell.viewer.a.inspection.as_ref().expect("something is looked at");
        inspection.found.clone().expect("it was read").unwrap_or_else(|error| panic!("{error}"))
    };
    let order = found(&viewer).order.expect("keys have an order");
    assert!(order.ascending && order.keys > 100, "{order:?}");
    viewer.shell.viewer.a.look_at("keys", "compact");
    viewer.settle();
    viewer.frames(3);
    assert!(!found(&viewer).order.expect("keys have an order").ascending);
    // `covariance` is a `Once` pass; inspecting it runs it again.
    viewer.shell.viewer.a.look_at("covariances", "covariance");
    viewer.settle();
    viewer.frames(3);
    assert_eq!(found(&viewer).pass, "scene.covariance");
    viewer.shell.viewer.a.look_at("color", "back_to_front");
    viewer.settle();
    viewer.frames(3);
    let picture = found(&viewer);
    assert!(picture.is_image && picture.words.picture(&picture.shape).is_some());
    viewer.shell.viewer.a.look_at("nothing", "scatter");
    viewer.frames(3);
    let inspection = viewer.shell.viewer.a.inspection.as_ref().expect("something is looked at");
    assert!(matches!(&inspection.found, Some(Err(error)) if error.contains("no resource `nothing`")));
    viewer.close();
}
