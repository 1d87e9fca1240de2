//! Tests the reference renderer against images of the published CUDA rasteriser, and that breaking any one rule fails
//! the bound. Also tests the GPU renderer against the reference.

use crate::common;
use crate::golden::Golden;
use crate::images;
use splatgraph::draw::truth::image_of;
use splatgraph_assets::{Camera, Scene, Splat};
use splatgraph_reference::metrics::Comparison;
use splatgraph_reference::{Gaussian, RULES, RuleInfo, Rules, Splats, render};

/// Minimum PSNR of every image, in dB over values clamped to 0..1.
const AGREEMENT: f64 = 95.0;
/// Maximum difference of a channel. A fragment at the alpha floor in f32 that is below it in f64 gives 0.0039.
const WORST: f64 = 0.005;

fn compare(
    golden: &Golden,
    image: &str,
    splats: &(impl Splats + ?Sized),
    camera: &Camera,
    background: [f64; 3],
    rules: &Rules,
) -> Comparison {
    let picture = render(splats, camera, background, rules, &|_, _| {});
    golden.compare(&image_of(&picture), image)
}

#[test]
fn the_reference_agrees_with_the_published_rasteriser_on_every_image() {
    for golden in Golden::all("the_reference_agrees_with_the_published_rasteriser_on_every_image") {
        let (name, scene) = (golden.name, golden.scene());
        for (index, camera) in golden.cameras().iter().enumerate() {
            let image = format!("camera{index}");
            let found = compare(&golden, &image, &*scene, camera, [0.0; 3], &Rules::PUBLISHED);
            println!("{name} {image}: {:.1} dB, worst pixel {:.5}", found.psnr(), found.worst.difference);
            assert!(found.psnr() >= AGREEMENT && found.worst.difference < WORST, "{name} {image}: {found:?}");
        }
    }
}

#[test]
fn the_reference_blends_over_a_background_as_the_published_rasteriser_does() {
    let Some(data) = common::data("the_reference_blends_over_a_background_as_the_published_rasteriser_does")
    else {
        return;
    };
    let golden = Golden::whole(&data, "playbot-31k");
    let (scene, cameras) = (golden.scene(), golden.cameras());
    let background = [1.0, 0.5, 0.25];
    let image = "camera0-background";
    let found = compare(&golden, image, &*scene, &cameras[0], background, &Rules::PUBLISHED);
    assert!(found.psnr() >= AGREEMENT && found.worst.difference < WORST, "{found:?}");
}

#[test]
fn each_rule_broken_on_purpose_fails_the_bound() {
    let golden = Golden::rules();
    let (scene, cameras) = (golden.scene(), golden.cameras());
    let broken = [
        ("extent", "3", 48.0),
        ("extent", "unbounded", 63.0),
        ("alpha_floor", "0", 34.0),
        ("alpha_cap", "1", 58.0),
        ("stop", "none", 70.0),
        ("near", "0.01", 25.0),
        ("jacobian_clamp", "none", 12.0),
        ("low_pass", "none", 31.0),
        ("low_pass", "0.3*compensated", 31.0),
        ("pixel_offset", "0.5", 34.0),
        ("sh_direction", "to_camera", 20.0),
        ("sh_degree", "0", 26.0),
        ("color_floor", "none", 37.0),
        ("color_ceiling", "1", 22.0),
        ("key_of", "distance", 24.0),
        ("ties", "descending", 40.0),
        ("order", "pixel", 25.0),
    ];
    // `depth` orders only splats whose depths f32 cannot tell apart.
    for RuleInfo { name, .. } in RULES.iter().filter(|rule| rule.name != "depth") {
        assert!(broken.iter().any(|(rule, ..)| rule == name), "{name} is not broken");
    }
    for (rule, value, bound) in broken {
        let mut rules = Rules::PUBLISHED;
        rules.set(rule, value).expect("a rule");
        let found = cameras.iter().enumerate().map(|(index, camera)| {
            compare(&golden, &format!("camera{index}"), &*scene, camera, [0.0; 3], &rules).psnr()
        });
        let worst = found.fold(f64::INFINITY, f64::min);
        println!("{rule} = {value}: {worst:.1} dB");
        assert!(worst < bound, "{rule} = {value}: {worst:.1} dB, expected less than {bound}");
    }
}

/// Draws a small cloud in front of one splat of scales exp(`logs`). Returns the PSNR against the exact renderer.
fn giant(logs: [f32; 3], covariance: &str) -> f64 {
    let size = (320, 180);
    let camera =
        Camera { img_name: "origin".into(), ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, size) };
    let scene = Scene::generate(9, 0, |i| {
        let angle = i as f32;
        let mut sh = [0.0; 48];
        sh[..3].copy_from_slice(&[0.4 * angle.sin(), 0.3, -0.5]);
        let cloud = Splat {
            position: [0.4 * angle.sin(), 0.3 * angle.cos(), 2.0 + 0.1 * angle],
            scale: [0.1, 0.15, 0.1],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: 0.6,
            sh,
        };
        if i > 0 {
            return cloud;
        }
        sh[..3].copy_from_slice(&[1.4, -0.4, -1.0]);
        let rotation = [0.9, 0.2, 0.1, 0.37];
        Splat { position: [0.3, 0.2, 4.0], scale: logs.map(f32::exp), rotation, opacity: 0.5, sh }
    });
    let exact = render(&scene, &camera, [0.0; 3], &Rules::PUBLISHED, &|_, _| {});
    let drawn = images::draw_one(scene, &camera, "splat", &[("covariance", covariance)]);
    images::psnr(&drawn, &image_of(&exact))
}

#[test]
fn splats_of_any_size_are_drawn_like_the_reference_draws_them() {
    let balls = [6.0, 12.0, 20.0, 30.0, 40.0].map(|log| [log, log, log - 0.5]);
    for logs in balls {
        for covariance in ["six", "factored"] {
            let db = giant(logs, covariance);
            println!("scales e^{logs:?}, {covariance}: {db:.1} dB");
            assert!(db > 70.0, "scales e^{logs:?}, {covariance}: {db:.1} dB");
        }
    }
    // For needles and plates of such ratios, only the factored form keeps the short axes.
    for logs in [[20.0, -4.0, -4.0], [25.0, 25.0, -3.0], [40.0, -3.0, -3.0]] {
        let db = giant(logs, "factored");
        println!("scales e^{logs:?}: {db:.1} dB");
        assert!(db > 40.0, "scales e^{logs:?}: {db:.1} dB");
    }
}

/// Quaternions are normalised on load, as the trainer does before it calls the rasteriser.
#[test]
fn quaternions_of_the_lengths_in_the_file_fail_the_bound() {
    let golden = Golden::rules();
    let (scene, cameras) = (golden.scene(), golden.cameras());
    let bytes = std::fs::read(golden.path()).expect("the file is read");
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|window| window == end).expect("a header") + end.len();
    let rows: Vec<&[u8]> = bytes[start..].chunks_exact(62 * 4).collect();
    assert_eq!(rows.len(), Splats::count(&*scene), "no splat was dropped on load");
    // The last four of the reference layout's 62 floats are the quaternion.
    let splats: Vec<Gaussian> = (rows.iter().enumerate())
        .map(|(index, row)| {
            let float =
                |i: usize| f32::from_le_bytes([row[4 * i], row[4 * i + 1], row[4 * i + 2], row[4 * i + 3]]);
            Gaussian { rotation: std::array::from_fn(|i| f64::from(float(58 + i))), ..scene.get(index) }
        })
        .collect();
    let found = compare(&golden, "camera0", splats.as_slice(), &cameras[0], [0.0; 3], &Rules::PUBLISHED);
    assert!(found.psnr() < 15.0, "{found:?}");
}
