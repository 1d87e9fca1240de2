//! Scenes at the extremes: numbers of a scene, a camera and a picture's size at which formulas fail.
//!
//! [`cases`] is the table: a scene, a camera, and bounds on the error. Each case is drawn by the exact renderer and
//! then by every pinhole preset, and no picture may contain a non-finite value. The truth follows the rules of quads
//! (`extent=unbounded`, `stop=none`: neither tiles nor an early stop), so that the errors come from arithmetic, from
//! order and from the target's format. For comparison, the exact renderer also draws by the published rules. The errors
//! are printed for the table in docs/accuracy-tables.md.

mod cases;
mod surveyed;

use crate::common::{OPEN, OPEN_TILES};
use crate::place::Place;
use crate::{common, images};
use cases::{Bounds, Case};
use splatgraph::draw::{builtin, session::Session, truth};
use splatgraph::io::image::Image;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, Splat};
use splatgraph_reference::metrics;
use splatgraph_reference::{Rules, Splats, render};

/// A background, so that the transmittance is visible.
const BACKGROUND: [f32; 3] = [0.2, 0.3, 0.4];

#[derive(Clone, Copy, Debug)]
struct Error {
    /// PSNR in dB.
    db: f64,
    /// The largest difference of a channel, relative to the exact value if that is brighter than white.
    worst: f64,
}

impl Error {
    /// Compares a picture with the truth; fails on NaN and infinite values.
    fn of(what: &str, image: &Image, truth: &Image) -> Error {
        let db = metrics::compare(image.into(), truth.into())
            .unwrap_or_else(|error| panic!("{what}: {error}"))
            .psnr();
        let channels = image.rgb.as_flattened().iter().zip(truth.rgb.as_flattened());
        let share =
            |(found, exact): (&f32, &f32)| f64::from((found - exact).abs()) / f64::from(exact.abs().max(1.0));
        Error { db, worst: channels.map(share).fold(0.0, f64::max) }
    }

    fn or(self, other: Error) -> Error {
        Error { db: self.db.min(other.db), worst: self.worst.max(other.worst) }
    }
}

/// Draws with the exact renderer and changed rules; fails on non-finite colours and on a transmittance outside 0 to 1.
fn exact(splats: &(impl Splats + ?Sized), camera: &Camera, changes: &[(&str, &str)]) -> Image {
    let mut rules = Rules::PUBLISHED;
    for (name, value) in changes {
        rules.set(name, value).expect("a rule");
    }
    let picture = render(splats, camera, BACKGROUND.map(f64::from), &rules, &|_, _| {});
    assert!(picture.color.iter().flatten().all(|v| v.is_finite()), "exact, {changes:?}: not finite");
    assert!(picture.transmittance.iter().all(|t| (0.0..=1.0).contains(t)), "exact, {changes:?}: no share");
    truth::image_of(&picture)
}

struct Way {
    preset: &'static str,
    set: Vec<(String, String)>,
    bound: fn(&Bounds) -> f64,
}

impl Way {
    fn new(preset: &'static str, set: &[(&str, &str)], bound: fn(&Bounds) -> f64) -> Way {
        Way { preset, set: common::settings(set), bound }
    }

    /// Lists the pinhole presets, then variants of `splat`, `tiled` and `front_to_back`.
    ///
    /// In presets, quads blend in 32-bit floats, and tiles do not stop early. The variants also have half-float
    /// targets; `factored` adds the factored covariance, and `bytes` an 8-bit target.
    fn all(factored: bool, bytes: bool) -> Vec<Way> {
        let full = [("target", "rgba32f")];
        let preset = |preset: &'static str| match preset {
            "unsorted" => Way::new(preset, &full, |bounds| bounds.unsorted),
            "front_to_back_naive" => Way::new(preset, &full, |bounds| bounds.naive),
            "key16" => Way::new(preset, &full, |bounds| bounds.key16),
            "auto" | "mesh" | "tiled_cpu" => Way::new(preset, &[("stop", "0.0")], |bounds| bounds.tiled),
            // `auto` chooses these tiles on GPUs only. Their packed records composite segments in half floats, which
            // costs dB.
            "tiled" => Way::new(preset, &[("stop", "0.0")], |bounds| bounds.tiled - 10.0),
            // Its order is another one: only that all values are finite is tested.
            "pixel_order" => Way::new(preset, &[("stop", "0.0")], |_| f64::NEG_INFINITY),
            "tiled_exact" => Way::new(preset, &OPEN_TILES, |bounds| bounds.tiled_exact),
            _ => Way::new(preset, &full, |bounds| bounds.exact),
        };
        // The cases and their bounds are for pinhole cameras.
        let other = ["orthographic", "fisheye", "equirectangular"];
        let pinholes = builtin::names().into_iter().filter(|name| !other.contains(name));
        let mut all: Vec<Way> = pinholes.map(preset).collect();
        if factored {
            let set = [("target", "rgba32f"), ("covariance", "factored")];
            all.push(Way::new("splat", &set, |bounds| bounds.exact));
        }
        let exact = common::with(common::EXACT_TILES[0], &OPEN_TILES);
        all.push(Way::new("tiled", &exact, |bounds| bounds.tiled_exact));
        all.push(Way::new("splat", &[("target", "rgba16f")], |bounds| bounds.half));
        all.push(Way::new("front_to_back", &[("target", "rgba16f")], |bounds| bounds.half));
        if bytes {
            all.push(Way::new("splat", &[("target", "rgba8")], |bounds| {
                bounds.bytes.unwrap_or(f64::INFINITY)
            }));
        }
        all
    }

    /// Returns true if splats are blended in the order of exact depths.
    fn is_right(&self) -> bool {
        let exact = self.set.iter().any(|(name, value)| (name.as_str(), value.as_str()) == ("record", "f32"));
        exact
            || ![
                "unsorted",
                "front_to_back_naive",
                "key16",
                "auto",
                "mesh",
                "tiled",
                "tiled_cpu",
                "pixel_order",
            ]
            .contains(&self.preset)
    }

    fn name(&self) -> String {
        let set: String = self.set.iter().map(|(name, value)| format!(" {name}={value}")).collect();
        format!("{}{set}", self.preset)
    }
}

fn draw(scene: Scene, camera: &Camera, ways: Vec<Way>) -> Vec<(Way, Image)> {
    let mut session = images::session(scene, "splat", &[]);
    let drawn = draw_with(&mut session, camera, ways);
    images::close(session, "the extremes");
    drawn
}

fn draw_with(session: &mut Session, camera: &Camera, ways: Vec<Way>) -> Vec<(Way, Image)> {
    let mut drawn = Vec::new();
    for way in ways {
        session.set_graph(way.preset, &way.set);
        let mut image = None;
        // `stale_order` draws in the order of the previous frame.
        for _ in 0..if way.preset == "stale_order" { 2 } else { 1 } {
            let found = images::picture(session, camera, BACKGROUND);
            let wrong = found.rgb.as_flattened().iter().filter(|v| !v.is_finite()).count();
            assert_eq!(wrong, 0, "{}: values that are not finite", way.name());
            image = Some(found);
        }
        drawn.push((way, image.expect("a frame was drawn")));
    }
    drawn
}

fn hold(name: &str) {
    let Case { scene, factored, bounds, .. } = cases::find(name);
    let (scene, camera) = scene();
    let quads = exact(&scene, &camera, &OPEN);
    let published = Error::of("the published rules", &exact(&scene, &camera, &[]), &quads);
    let splats = scene.count();
    let errors: Vec<(Way, Error)> = draw(scene, &camera, Way::all(*factored, bounds.bytes.is_some()))
        .into_iter()
        .map(|(way, image)| {
            let error = Error::of(&way.name(), &image, &quads);
            (way, error)
        })
        .collect();

    let mut failures = Vec::new();
    for (way, error) in &errors {
        println!("{name}: {}: {:.1} dB, worst pixel {:.1e}", way.name(), error.db, error.worst);
        let bound = (way.bound)(bounds);
        if error.db < bound {
            failures.push(format!("{}: {:.1} dB, expected {bound} or more", way.name(), error.db));
        }
    }
    let of = |wanted: fn(&Way) -> bool| {
        errors.iter().filter(|(way, _)| wanted(way)).map(|(_, error)| *error).reduce(Error::or)
    };
    let right = of(|way| way.is_right() && way.set[0].1 == "rgba32f").expect("presets");
    let shown = |error: Option<Error>| error.map_or("".into(), |error| format!("{:.1}", error.db));
    println!(
        "| `{name}` | {splats} | {:.1} ({:.0e}) | {} | {} | {} | {} | {} | {:.1} |",
        right.db,
        right.worst,
        shown(of(|way| way.preset == "splat" && way.set[0].1 == "rgba16f")),
        shown(of(|way| way.preset == "front_to_back" && way.set[0].1 == "rgba16f")),
        shown(of(|way| way.set[0].1 == "rgba8")),
        shown(of(|way| way.preset == "key16")),
        shown(of(|way| !way.is_right() && way.preset != "key16")),
        published.db,
    );
    if right.worst > bounds.worst {
        failures.push(format!("worst pixel {:.1e}, expected {:e} or less", right.worst, bounds.worst));
    }
    assert!(failures.is_empty(), "{name}:\n{}", failures.join("\n"));
}

/// Turns a sentence into a test that checks cases against their bounds.
macro_rules! held {
    ($($sentence:ident: $($case:literal),+;)+) => {
        const HELD: &[&str] = &[$($($case),+),+];
        $(#[test] fn $sentence() { $(hold($case);)+ })+
    };
}

held! {
    scales_from_the_least_to_the_largest_are_drawn_together: "giants";
    a_needle_keeps_its_width_and_a_plate_its_thinness: "needles";
    a_quaternion_of_any_length_is_a_rotation: "quaternions";
    opacities_of_0_and_1_and_their_logits_are_drawn_as_they_are: "logits";
    splats_at_one_place_are_blended_in_their_order: "coincident";
    splats_of_one_depth_are_blended_in_their_order: "ties";
    splats_at_the_near_plane_and_around_the_camera_are_drawn_or_culled: "near-plane";
    outliers_take_nothing_from_the_rest: "far";
    a_scene_far_from_the_origin_is_as_exact_as_its_positions: "remote";
    clouds_ten_million_units_apart_are_drawn_as_exactly_as_one: "two-clouds";
    a_telephoto_view_is_as_exact_as_one_from_nearby: "telephoto", "millionth";
    depths_that_differ_by_rounding_alone_have_the_published_order: "askew";
    fields_of_view_from_1_to_170_degrees_are_drawn: "fov-1", "fov-170";
    pictures_of_one_pixel_and_of_one_row_are_drawn: "one-pixel", "one-row";
    layers_that_are_nearly_opaque_show_the_first: "layers-opaque";
    layers_that_are_nearly_transparent_add_up: "layers-faint";
    harmonics_of_ten_thousand_stay_finite: "harmonics";
    one_splat_can_cover_everything: "cover", "huge";
    splats_at_the_floor_of_alpha_are_drawn_or_not: "faint";
    layers_at_the_floor_of_alpha_are_kept_by_all_renderers_or_by_none: "floor";
    what_covers_a_background_leaves_none_of_it: "layers-dark";
    colours_beyond_half_floats_are_not_stored_in_them: "bright";
    splats_that_cross_in_an_unusual_view_are_in_the_right_order: "crossing";
    a_view_of_nothing_is_the_background: "empty-view";
}

#[test]
fn every_case_of_the_table_is_held_to_its_bounds() {
    let missing: Vec<_> =
        cases::CASES.iter().map(|case| case.name).filter(|name| !HELD.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

/// Draws the largest and the smallest normal numbers of f32. Sums overflow, so no error bound applies, but the picture
/// must be finite.
#[test]
fn numbers_at_the_end_of_their_range_leave_no_value_that_is_not_finite() {
    let camera = cases::small(Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 79.0, (64, 36)));
    let ends = [f32::MAX, -f32::MAX, f32::MIN_POSITIVE, 1e30, 0.5, 0.0];
    let scene = Scene::generate(600, 3, |i| {
        let end = |stride: usize| ends[(i / stride) % ends.len()];
        let mut splat = cases::plain(i);
        splat.position = match i % 3 {
            0 => splat.position,
            1 => [end(3), end(18), splat.position[2]],
            _ => [splat.position[0], end(7), end(3).abs()],
        };
        splat.scale = [end(5).abs(), end(11).abs(), end(2).abs()];
        splat.sh = std::array::from_fn(|k| end(1 + k % 4));
        splat
    });
    exact(&scene, &camera, &OPEN);
    exact(&scene, &camera, &[]);
    let mut ways = Way::all(true, true);
    for set in [
        ("position_storage", "fixed16"),
        ("sh_storage", "q8"),
        ("key_map", "equalised"),
        ("cull_margin", "0.0"),
    ] {
        let set = [set, ("key_bits", "20")];
        ways.extend(["splat", "tiled_exact"].map(|preset| Way::new(preset, &set, |_| 0.0)));
    }
    draw(scene, &camera, ways);
}

/// Runs a shader in `width` workgroups of one invocation; it writes the image `color` of `width` x 1 pixels. Returns
/// the session and the pixels. `shader` is the text after the declarations.
fn computed(shader: &str, width: u32) -> (Session, Vec<[f32; 3]>) {
    let place = Place::empty();
    let declarations = "#version 460\n#extension GL_GOOGLE_include_directive : require\n#include \"camera.glsl\"\n\
        layout(local_size_x = 1) in;\n\
        layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D color;\n";
    let graph = r#"Graph(version: 1, summary: "", output: "color",
        imports: { "camera": Import(from: "frame.camera") },
        resources: { "color": Image(format: "rgba32f", size: (WIDTH, 1)) },
        passes: [Dispatch(name: "n", shader: "fma.comp", size: Groups(WIDTH), bind: { "Camera": "camera", "color": "color" })])"#;
    place.write("fma.comp", format!("{declarations}{shader}"));
    place.write("graph.ron", graph.replace("WIDTH", &width.to_string()));
    let scene = Scene::generate(1, 0, cases::plain);
    let camera = Camera::framing(&scene, width, 1);
    let mut session = images::session(scene, &place.named("graph.ron"), &[]);
    let pixels = images::picture(&mut session, &camera, [0.0; 3]).rgb;
    (session, pixels)
}

#[test]
fn a_device_that_says_that_its_fma_rounds_once_says_so_truly() {
    // The exact square of 1 + 2^-12 has one bit more than a float: 2^-24. Only a fused fma() keeps it.
    let shader = "void main() {\n\
            float a = uintBitsToFloat(0x3f800800u + min(camera.frame, 0u));\n\
            float rest = fma(a, a, -(1.0 + 1.0 / 2048.0)) * 16777216.0;\n\
            imageStore(color, ivec2(0), vec4(vec3(rest), 1.0));\n\
        }\n";
    let (mut session, found) = computed(shader, 1);
    let rest = found[0][0];
    assert!(rest == 0.0 || rest == 1.0, "{rest}");
    assert!(!session.device().info().facts.fused_fma || rest == 1.0);
}

#[test]
fn without_a_fused_fma_and_without_doubles_a_product_and_a_sum_are_rounded_once() {
    let shader = "#undef DEVICE_FUSED_FMA\n#define DEVICE_FUSED_FMA 0\n#undef DEVICE_FLOAT64\n#define DEVICE_FLOAT64 0\n\
        #include \"exact_fma.glsl\"\n\
        float number(uint seed) { return uintBitsToFloat(0x3f000000u + (seed * 2654435769u >> 8)); }\n\
        void main() {\n\
            uint i = gl_WorkGroupID.x + min(camera.frame, 0u);\n\
            float a = number(3u * i);\n\
            float b = -number(3u * i + 1u);\n\
            precise float rounded = a * b;\n\
            float c = number(3u * i + 2u);\n\
            precise vec3 found = vec3(exact_fma(a, b, c), exact_fma(a, b, -rounded), exact_fma(a, b, c * 1e-6));\n\
            imageStore(color, ivec2(i, 0), vec4(found, 1.0));\n\
        }\n";
    let (session, found) = computed(shader, 4096);
    let number = |seed: u32| f32::from_bits(0x3f00_0000 + (seed.wrapping_mul(2_654_435_769) >> 8));
    for (i, found) in (0..).zip(&found) {
        let (a, b, c) = (number(3 * i), -number(3 * i + 1), number(3 * i + 2));
        let exact = [c, -(a * b), c * 1e-6].map(|c| a.mul_add(b, c));
        assert_eq!(*found, exact, "{a} * {b} + {c}");
    }
    images::close(session, "exact_fma");
}

/// Draws layers whose opacity is a few floats from the alpha floor, with no or little falloff.
#[test]
fn a_splat_some_floats_from_the_floor_is_kept_by_all_renderers_or_by_none() {
    let (layers, camera) = (cases::find("floor").scene)();
    let floor = (1.0f32 / 255.0).to_bits();
    let mut session = images::session(Scene::generate(1, 0, cases::plain), "splat", &[]);
    for (steps, scale) in [(-1, 1e6), (0, 1e6), (1, 1e6), (2, 1e6), (8, 1e6), (8, 2e4), (600, 200.0)] {
        let splat = |index: usize| Splat {
            opacity: f32::from_bits(floor.saturating_add_signed(steps)),
            scale: [scale, scale, 0.01],
            ..layers.splat(index)
        };
        let scene = Scene::generate(400, 0, splat);
        let truth = exact(&scene, &camera, &OPEN);
        let shows = truth.rgb.iter().any(|pixel| *pixel != BACKGROUND);
        assert_eq!(shows, steps > 0, "{steps} floats from the floor, exact");
        let exact = common::with(common::EXACT_TILES[0], &OPEN_TILES);
        let ways = vec![
            Way::new("splat", &[("target", "rgba32f")], |_| 110.0),
            // `tiled`, which `auto` chooses with 16 lanes, composites two segments in half floats.
            Way::new("auto", &[("stop", "0.0")], |_| if common::lanes_are_usual() { 90.0 } else { 74.0 }),
            Way::new("tiled", &[("stop", "0.0")], |_| 74.0),
            Way::new("tiled_exact", &OPEN_TILES, |_| 110.0),
            Way::new("tiled", &exact, |_| 110.0),
        ];
        session.set_scene(scene);
        for (way, image) in draw_with(&mut session, &camera, ways) {
            let what = format!("{steps} floats from the floor, scale {scale}, {}", way.name());
            let error = Error::of(&what, &image, &truth);
            println!("{what}: {:.1} dB", error.db);
            let bound = (way.bound)(&cases::find("floor").bounds);
            assert!(error.db >= bound, "{what}: {:.1} dB, expected {bound} or more", error.db);
        }
    }
    images::close(session, "the extremes");
    if common::lanes_are_usual() {
        for bits in [128, 512] {
            common::again_with_vectors_of(
                bits,
                "extremes::a_splat_some_floats_from_the_floor_is_kept_by_all_renderers_or_by_none",
            );
        }
    }
}
