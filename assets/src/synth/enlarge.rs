//! Enlarges a scene, for measurements at sizes beyond any capture.
//!
//! Copies lie inside their original splats, spread with the same standard deviations, and all splats shrink so that the
//! covered area is preserved.

use super::random::splitmix64;
use crate::memory::SceneMemoryError;
use crate::scene::Scene;

/// Generates a scene of `n` splats from another.
///
/// Splat `k` is copy `k / count` of splat `k % count`. Copy 0 stays in place. A further copy moves by `R (s * u)`, with
/// the splat's rotation R and its scales s. Each component of u is uniform in -sqrt(3) to sqrt(3), which has deviation
/// 1, from the top 24 bits of `splitmix64(3 k + axis)`. All scales are multiplied by `sqrt(count / n)`. An `n` below
/// the count takes the first `n` splats, and a scene without splats stays empty. The tags and the offset are copied;
/// the mesh is not.
///
/// # Errors
/// The new scene does not fit in memory.
pub fn enlarge(scene: &Scene, n: u32) -> Result<Scene, SceneMemoryError> {
    let count = scene.count() as usize;
    let n = if count == 0 { 0 } else { n };
    let shrink = (count as f64 / f64::from(n)).sqrt();
    let copy = |k: usize| {
        let mut splat = scene.splat(k % count);
        let mut position = scene.position(k % count);
        if k >= count {
            let offset: [f64; 3] = std::array::from_fn(|axis| {
                let t = (splitmix64(3 * k as u64 + axis as u64) >> 40) as f64 / (1u64 << 24) as f64;
                f64::from(splat.scale[axis]) * (2.0 * t - 1.0) * 3f64.sqrt()
            });
            let [w, x, y, z] = splat.rotation.map(f64::from);
            let turned = glam::DQuat::from_xyzw(x, y, z, w) * glam::DVec3::from(offset);
            position = std::array::from_fn(|axis| position[axis] + turned[axis]);
            splat.position = position.map(|v| v as f32);
        }
        splat.scale = splat.scale.map(|s| (f64::from(s) * shrink) as f32);
        (splat, position)
    };
    Ok(scene.derived(n, scene.stored_degree(), |k| k % count, copy)?.with_mesh(None))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{FileNotes, Filter, SortKey};
    use crate::testing::splat;

    #[test]
    fn the_first_copy_stays_and_the_others_scatter_inside_their_splat() {
        let base = Scene::generate(50, 3, splat);
        let large = enlarge(&base, 175).unwrap();
        assert_eq!(large.count(), 175);
        assert_eq!(large.positions()[..50], base.positions()[..]);
        for k in 0..175 {
            let (copy, original) = (large.splat(k), base.splat(k % 50));
            let ratio = copy.scale[1] / original.scale[1];
            assert!((ratio - (50f32 / 175.0).sqrt()).abs() < 1e-6);
            assert_eq!((copy.sh, copy.opacity), (original.sh, original.opacity));
            let moved: f32 = copy.position.iter().zip(original.position).map(|(a, b)| (a - b).powi(2)).sum();
            let reach: f32 = 3.0 * original.scale.iter().map(|s| s * s).sum::<f32>();
            assert!(moved <= reach * 1.001 && (k < 50) == (moved == 0.0));
        }
    }

    #[test]
    fn tags_and_wide_positions_stay_and_an_empty_scene_stays_empty() {
        let notes = FileNotes {
            low_pass: Filter::Mip,
            key_of: SortKey::Distance,
            up: Some([0.0, 0.0, 1.0]),
            ..FileNotes::default()
        };
        let far = |i: usize| [1e7 * (i % 2) as f64 + 0.001 * i as f64, 0.0, 0.0];
        let base = Scene::try_generate_at(20, 0, true, |i| {
            let mut splat = splat(i);
            (splat.scale, splat.rotation) = ([0.01; 3], [1.0, 0.0, 0.0, 0.0]);
            (splat, far(i))
        });
        let base = base.unwrap().with_notes(notes);
        let large = enlarge(&base, 50).unwrap();
        assert!(base.is_wide() && large.is_wide());
        assert_eq!(large.notes(), notes);
        for k in 0..50 {
            let moved = large.position(k)[0] - base.position(k % 20)[0];
            assert!(moved.abs() <= 0.01 * 1.7321 && (k < 20) == (moved == 0.0), "{k}: {moved}");
        }
        assert_eq!(enlarge(&Scene::generate(0, 1, splat), 5).unwrap().count(), 0);
    }

    #[test]
    fn offsets_turn_with_the_splat_and_follow_its_scales() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let turned = Scene::generate(1, 0, |i| {
            let mut s = splat(i);
            // A quarter turn about z: x becomes y, and y becomes -x.
            (s.position, s.scale, s.rotation) = ([10.0, 20.0, 30.0], [3.0, 2.0, 0.5], [half, 0.0, 0.0, half]);
            s
        });
        let large = enlarge(&turned, 3).unwrap();
        // The top 24 bits of splitmix64(6), (7) and (8), computed with another program.
        let u = [12_412_069u32, 6_540_257u32, 10_376_785u32]
            .map(|bits| (2.0 * f64::from(bits) / 16_777_216.0 - 1.0) * 3f64.sqrt());
        let expected = [10.0 - 2.0 * u[1], 20.0 + 3.0 * u[0], 30.0 + 0.5 * u[2]];
        for (found, expected) in large.positions()[2].iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() < 1e-5, "{:?} {expected}", large.positions()[2]);
        }
    }

    #[test]
    fn the_covered_area_stays() {
        let base = Scene::generate(40, 0, splat);
        let area =
            |scene: &Scene| scene.scales().iter().map(|s| f64::from(s[0]) * f64::from(s[1])).sum::<f64>();
        // Whole copies: each splat occurs equally often.
        for copies in [2, 5, 32] {
            let ratio = area(&enlarge(&base, 40 * copies).unwrap()) / area(&base);
            assert!((ratio - 1.0).abs() < 1e-6, "{copies} copies cover {ratio} of the area");
        }
    }
}
