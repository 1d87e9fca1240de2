//! The covariance pass against f64, in each of its three forms.
//!
//! The bound is relative to the largest element of each splat's covariance: f32 has 24 bits, and an element is a sum of
//! three products of sums, so a few units in the last place are lost.

use splatgraph_assets::{Camera, Scene};
use std::sync::Arc;

use crate::common;
use crate::golden::Golden;
use crate::images::inspected;

/// Computes the rows of R S in f64, from the values uploaded to the GPU.
fn factor(rotation: [f32; 4], scale: [f32; 3]) -> [[f64; 3]; 3] {
    let [w, x, y, z] = rotation.map(f64::from);
    let r = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    r.map(|row| [0, 1, 2].map(|c| row[c] * f64::from(scale[c])))
}

/// Returns the six unique elements xx, xy, xz, yy, yz, zz of M M^T.
fn six(m: [[f64; 3]; 3]) -> [f64; 6] {
    let dot = |a: usize, b: usize| (0..3).map(|c| m[a][c] * m[b][c]).sum();
    [dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)]
}

/// Returns the rows of the triangular factor; the signs of its diagonal encode which row of the covariance comes first.
fn triangle(l: &[f64]) -> [[f64; 3]; 3] {
    let rows = [[l[0].abs(), 0.0, 0.0], [l[1], l[3].abs(), 0.0], [l[2], l[4], l[5]]];
    let first = if l[0].is_sign_negative() { 1 } else { 2 * usize::from(l[3].is_sign_negative()) };
    [0, 1, 2].map(|row| rows[(row + 3 - first) % 3])
}

fn worst_error(scene: Arc<Scene>, camera: &Camera, form: &str) -> f64 {
    let exact: Vec<[f64; 6]> =
        (0..scene.count() as usize).map(|i| six(factor(scene.rotations()[i], scene.scales()[i]))).collect();
    let bytes = inspected(scene, camera, "splat", &[("covariance", form)], "covariances@covariance");
    let floats: Vec<f64> = match form {
        "half" => bytes.chunks_exact(2).map(|c| half::f16::from_le_bytes([c[0], c[1]]).to_f64()).collect(),
        _ => bytes.chunks_exact(4).map(|c| f64::from(f32::from_le_bytes([c[0], c[1], c[2], c[3]]))).collect(),
    };
    assert!(floats.iter().all(|v| v.is_finite()), "{form}: not a number");
    let per_splat = floats.len() / exact.len();
    assert_eq!(per_splat, if form == "factored" { 9 } else { 6 });
    exact.iter().zip(floats.chunks_exact(per_splat)).fold(0.0, |worst: f64, (exact, got)| {
        let got = match per_splat {
            6 => six(triangle(got)),
            // Checks the element order, too: for the transposed factor, M M^T would differ.
            _ => six([0, 1, 2].map(|row| [0, 1, 2].map(|column| got[3 * row + column]))),
        };
        let largest = exact.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let error = exact.iter().zip(got).fold(0.0, |m: f64, (e, g)| m.max((e - g).abs()));
        worst.max(error / largest)
    })
}

#[test]
fn covariances_are_within_a_few_units_in_the_last_place_of_f64() {
    let Some(data) = common::data("covariances_are_within_a_few_units_in_the_last_place_of_f64") else {
        return;
    };
    for name in ["biker", "playbot-31k"] {
        let golden = Golden::whole(&data, name);
        let camera = &golden.cameras()[0];
        // Half floats have 11 bits, and an element of the covariance is a sum of products of two half floats.
        for (form, bound) in [("six", 1e-6), ("factored", 1e-6), ("half", 2e-3)] {
            let worst = worst_error(golden.scene(), camera, form);
            println!("{name}, {form}: {worst:.2e} of the largest element");
            assert!(worst < bound, "{name}, {form}: {worst:.2e}");
        }
    }
}
