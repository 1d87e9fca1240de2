//! Measures how much each band of spherical harmonics contributes to the colours.
//!
//! The basis is orthonormal on the sphere, so the mean square of a band over all directions is the sum of its squared
//! coefficients over 4 pi (Parseval; Ramamoorthi and Hanrahan 2001, "An Efficient Representation for Irradiance
//! Environment Maps"). Splats are weighted by opacity times area; splats below the alpha floor have no weight.

use crate::studies::sweep::choice::world_area;
use rayon::prelude::*;
use serde::Serialize;
use splatgraph_assets::Scene;
use splatgraph_reference::Splats;
use std::f64::consts::PI;

/// The contribution of a band of spherical harmonics to a scene's colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Band {
    /// Degree of the band, 0 to 3.
    pub band: u32,
    /// Root mean square over directions, channels and weighted splats, for colours of 0 to 1.
    pub rms: f64,
    /// Share of the energy of bands 1 to 3; 0 for band 0, and in scenes without view-dependent colours.
    pub share: f64,
}

/// Energy of each band, 0 to 3: the mean square of its contribution to a colour channel, over the sphere.
pub type Energy = [f64; 4];

/// Computes the energy of each band of a splat, averaged over the channels.
pub fn energy(sh: &[[f64; 3]; 16]) -> Energy {
    std::array::from_fn(|band| {
        let of_band = &sh[band * band..(band + 1) * (band + 1)];
        of_band.as_flattened().iter().map(|c| c * c).sum::<f64>() / (3.0 * 4.0 * PI)
    })
}

/// Measures the contribution of each band that a scene stores.
pub fn bands(scene: &Scene) -> Vec<Band> {
    let of_splat = |index: usize| {
        let weight = f64::from(scene.opacities()[index]) * world_area(scene, index);
        let weight = if scene.can_show(index) { weight } else { 0.0 };
        // Products of finite f32 values are finite in f64; only a splat of infinite size has its weight dropped.
        let weight = if weight.is_finite() { weight } else { 0.0 };
        let [a, b, c, d] = energy(&Splats::get(scene, index).sh).map(|energy| weight * energy);
        [a, b, c, d, weight]
    };
    let add = |a: [f64; 5], b: [f64; 5]| std::array::from_fn(|i| a[i] + b[i]);
    // Chunks of a fixed size, added in order: with any threads, sums are rounded alike.
    let of_chunks =
        (0..Splats::count(scene)).into_par_iter().map(of_splat).fold_chunks(4096, || [0.0; 5], add);
    let sum = of_chunks.collect::<Vec<_>>().into_iter().fold([0.0; 5], add);
    let directional: f64 = sum[1..4].iter().sum();
    (0..=scene.stored_degree())
        .map(|band| {
            let energy = sum[band as usize];
            let share = if band == 0 || directional <= 0.0 { 0.0 } else { energy / directional };
            let rms = if sum[4] > 0.0 { (energy / sum[4]).sqrt() } else { 0.0 };
            Band { band, rms, share }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Splat;
    use splatgraph_assets::harmonics::basis;

    fn scene(sh: impl Fn(usize) -> f32 + Sync) -> Scene {
        Scene::generate(3, 3, |i| Splat {
            position: [0.0; 3],
            scale: [1.0, 2.0, 0.5],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: if i == 2 { 0.0039 } else { 0.5 },
            // Splat 2 is below the alpha floor, so its large coefficients do not count.
            sh: std::array::from_fn(|at| if i == 2 { 9.0 } else { sh(at) }),
        })
    }

    #[test]
    fn the_energy_of_a_band_is_its_mean_square_over_all_directions() {
        let sh = |at: usize| 0.3 - 0.05 * (at / 3) as f32 + 0.1 * (at % 3) as f32;
        let bands = bands(&scene(sh));
        // Directions spread evenly: a Fibonacci lattice.
        let count = 20_000;
        let squares = |i: i32| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let angle = PI * (3.0 - 5f64.sqrt()) * f64::from(i);
            let r = (1.0 - z * z).sqrt();
            let weights = basis([r * angle.cos(), r * angle.sin(), z]);
            [0, 1, 2, 3].map(|band: usize| {
                let added = |channel: usize| {
                    let used = band * band..(band + 1) * (band + 1);
                    used.map(|k| weights[k] * f64::from(sh(3 * k + channel))).sum::<f64>()
                };
                (0..3).map(|channel| added(channel).powi(2)).sum::<f64>() / 3.0
            })
        };
        let sums = (0..count).map(squares).fold([0.0; 4], |a, b| std::array::from_fn(|i| a[i] + b[i]));
        let energies: [f64; 4] = sums.map(|sum| sum / f64::from(count));
        for (band, energy) in bands.iter().zip(energies) {
            assert!((band.rms.powi(2) / energy - 1.0).abs() < 1e-4, "{band:?}, expected {energy}");
        }
        let share = energies[2] / energies[1..].iter().sum::<f64>();
        assert!((bands[2].share - share).abs() < 1e-4 && bands[0].share == 0.0, "{bands:?}");
    }

    #[test]
    fn sums_are_equal_for_any_number_of_threads() {
        let scene = Scene::generate(20_000, 3, |i| Splat {
            position: [0.0; 3],
            scale: [1.0, 2.0, 0.1 + (i as f32).sin().abs()],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: 0.5,
            sh: std::array::from_fn(|at| (i as f32 * 0.7 + at as f32).cos()),
        });
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| bands(&scene))
        };
        assert_eq!(with(1), with(4));
    }

    #[test]
    fn a_scene_without_view_dependence_has_no_energy_but_in_band_0() {
        let bands = bands(&scene(|at| if at < 3 { 0.3 } else { 0.0 }));
        assert!(bands[0].rms > 0.0);
        assert!(bands[1..].iter().all(|band| band.rms == 0.0 && band.share == 0.0), "{bands:?}");
    }
}
