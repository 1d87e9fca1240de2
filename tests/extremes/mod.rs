//! Scenes at the extremes: every number of a scene, of a camera and of a picture's size taken to where formulas fail.
//!
//! [`cases`] is the table: a scene, a camera, and bounds on the error. Each case is drawn once by the exact renderer and then by
//! every preset, and no picture may hold a value that is not finite. The exact renderer follows the rules of quads here
//! (`extent=unbounded`, `stop=none`: neither tiles nor an early stop), so that the errors are those of arithmetic, of order
//! and of the target's format. The errors are printed as rows of the table in docs/accuracy.md.

mod cases;
mod surveyed;

use crate::common;
use cases::{Bounds, Case};
use splatgraph::image::Image;
use splatgraph::session::{FrameOptions, Session, image_of};
use splatgraph::{builtin, metrics, truth};
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Rules, Splats, render};
use splatgraph_vulkan::Vulkan;

/// Behind everything, so that transmittance shows.
const BACKGROUND: [f32; 3] = [0.2, 0.3, 0.4];

/// The difference of a picture from the truth.
#[derive(Clone, Copy, Debug)]
struct Error {
    /// PSNR in dB.
    db: f64,
    /// The largest difference of a channel, as a share of the truth where that is brighter than white.
    worst: f64,
}

impl Error {
    /// Compares a picture; one with NaN or an infinite value is a failure.
    fn of(what: &str, image: &Image, truth: &Image) -> Error {
        let db = metrics::compare(image, truth).unwrap_or_else(|error| panic!("{what}: {error}")).psnr();
        let channels = image.rgb.as_flattened().iter().zip(truth.rgb.as_flattened());
        let share = |(found, exact): (&f32, &f32)| f64::from((found - exact).abs()) / f64::from(exact.abs().max(1.0));
        Error { db, worst: channels.map(share).fold(0.0, f64::max) }
    }

    /// The larger of two errors.
    fn or(self, other: Error) -> Error {
        Error { db: self.db.min(other.db), worst: self.worst.max(other.worst) }
    }
}

/// Draws exactly, by the rules of quads.
fn exact(splats: &(impl Splats + ?Sized), camera: &Camera, depth: &str) -> Image {
    let mut rules = Rules::PUBLISHED;
    for (name, value) in [("extent", "unbounded"), ("stop", "none"), ("depth", depth)] {
        rules.set(name, value).expect("a rule");
    }
    let picture = render(splats, camera, BACKGROUND.map(f64::from), &rules, &|_, _| {});
    assert!(picture.color.iter().flatten().all(|v| v.is_finite()), "the exact picture has values that are not finite");
    assert!(picture.transmittance.iter().all(|t| (0.0..=1.0).contains(t)), "the exact transmittance is no share");
    truth::image_of(&picture)
}

/// A way to draw, with the bound that it is held to.
struct Way {
    preset: &'static str,
    set: Vec<(String, String)>,
    bound: fn(&Bounds) -> f64,
}

impl Way {
    fn new(preset: &'static str, set: &[(&str, &str)], bound: fn(&Bounds) -> f64) -> Way {
        Way { preset, set: set.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect(), bound }
    }

    /// Every preset, blending in 32-bit floats; then the other formats of `splat`.
    fn all() -> Vec<Way> {
        let full = [("target", "rgba32f")];
        let preset = |preset: &'static str| match preset {
            "unsorted" => Way::new(preset, &full, |bounds| bounds.unsorted),
            "front_to_back_naive" => Way::new(preset, &full, |bounds| bounds.naive),
            "key16" => Way::new(preset, &full, |bounds| bounds.key16),
            _ => Way::new(preset, &full, |bounds| bounds.exact),
        };
        let mut all: Vec<Way> = builtin::names().into_iter().map(preset).collect();
        all.push(Way::new("splat", &[("target", "rgba32f"), ("covariance", "factored")], |bounds| bounds.exact));
        all.push(Way::new("splat", &[("target", "rgba16f")], |bounds| bounds.half));
        all.push(Way::new("front_to_back", &[("target", "rgba16f")], |bounds| bounds.half));
        all.push(Way::new("splat", &[("target", "rgba8")], |bounds| bounds.bytes));
        all
    }

    fn name(&self) -> String {
        let set: String = self.set.iter().map(|(name, value)| format!(" {name}={value}")).collect();
        format!("{}{set}", self.preset)
    }
}

/// Draws a case in every way and holds the errors to its bounds.
fn hold(name: &str) {
    let case: &Case = cases::find(name);
    let (scene, camera) = (case.scene)();
    let exact = exact(&scene, &camera, "f32");
    let splats = scene.count();
    let mut session: Session<Vulkan> = Session::new(common::device(), scene, "splat", &[]);
    let request = FrameOptions { background: BACKGROUND, read_output: true, inspect: Vec::new() };
    let mut failures = Vec::new();
    let mut errors = Vec::new();
    for way in Way::all() {
        session.set_graph(way.preset, &way.set);
        session.prepare((camera.width, camera.height), &mut |_| {}).unwrap_or_else(|e| panic!("{}: {e}", way.name()));
        // A preset may draw in the order of the frame before.
        let mut last = None;
        for _ in 0..if way.preset == "stale_order" { 2 } else { 1 } {
            let frame = session.submit(&camera, &request).expect("submitted");
            last = session.wait(frame).expect("drawn").output;
        }
        let image = image_of(&last.expect("asked for")).expect("colours");
        let error = Error::of(&format!("{name}, {}", way.name()), &image, &exact);
        let bound = (way.bound)(&case.bounds);
        println!("{name}: {}: {:.1} dB, worst pixel {:.5}", way.name(), error.db, error.worst);
        if error.db < bound {
            failures.push(format!("{}: {:.1} dB, expected {bound} or more", way.name(), error.db));
        }
        errors.push((way, error));
    }
    common::assert_silent(session.device(), name);
    let messages = session.into_device().close();
    assert!(messages.is_empty(), "{name}: closing the device\n{}", messages.join("\n"));

    let of = |wanted: fn(&Way) -> bool| {
        let found = errors.iter().filter(|(way, _)| wanted(way)).map(|(_, error)| *error);
        found.reduce(Error::or).expect("a way of this kind")
    };
    let full = of(|way| way.set[0].1 == "rgba32f" && !["unsorted", "front_to_back_naive", "key16"].contains(&way.preset));
    let (half, bytes) = (of(|way| way.set[0].1 == "rgba16f"), of(|way| way.set[0].1 == "rgba8"));
    let (key16, worst) = (of(|way| way.preset == "key16"), of(|way| way.set[0].1 == "rgba32f"));
    println!(
        "| `{name}` | {splats} | {:.1} ({:.5}) | {:.1} | {:.1} | {:.1} | {:.1} |",
        full.db, full.worst, half.db, bytes.db, key16.db, worst.db
    );
    if full.worst > case.bounds.worst {
        failures.push(format!("worst pixel {:.5}, expected {} or less", full.worst, case.bounds.worst));
    }
    assert!(failures.is_empty(), "{name}:\n{}", failures.join("\n"));
}

/// Makes a sentence a test that holds cases to their bounds.
macro_rules! held {
    ($($sentence:ident: $($case:literal),+;)+) => {
        /// The cases that a test holds to their bounds.
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
    fields_of_view_from_1_to_170_degrees_are_drawn: "fov-1", "fov-170";
    pictures_of_one_pixel_and_of_one_row_are_drawn: "one-pixel", "one-row";
    layers_that_are_nearly_opaque_show_the_first: "layers-opaque";
    layers_that_are_nearly_transparent_add_up: "layers-faint";
    harmonics_of_ten_thousand_stay_finite: "harmonics";
    one_splat_can_cover_everything: "cover", "huge";
    splats_at_the_floor_of_alpha_are_drawn_or_not: "faint";
    a_view_of_nothing_is_the_background: "empty-view";
}

#[test]
fn every_case_of_the_table_is_held_to_its_bounds() {
    let missing: Vec<_> = cases::CASES.iter().map(|case| case.name).filter(|name| !HELD.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

/// Numbers near the end of f32, where sums overflow and no bound on the error makes sense: the picture is finite all the same.
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
    exact(&scene, &camera, "f32");
    let mut session: Session<Vulkan> = Session::new(common::device(), scene, "splat", &[]);
    let request = FrameOptions { background: BACKGROUND, read_output: true, inspect: Vec::new() };
    for way in Way::all() {
        session.set_graph(way.preset, &way.set);
        session.prepare((camera.width, camera.height), &mut |_| {}).unwrap_or_else(|e| panic!("{}: {e}", way.name()));
        for _ in 0..2 {
            let frame = session.submit(&camera, &request).expect("submitted");
            let output = session.wait(frame).expect("drawn").output.expect("asked for");
            let image = image_of(&output).expect("colours");
            let wrong = image.rgb.as_flattened().iter().filter(|v| !v.is_finite()).count();
            assert_eq!(wrong, 0, "{}: values that are not finite", way.name());
        }
    }
    common::assert_silent(session.device(), "the end of f32");
}
