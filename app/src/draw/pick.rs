//! Finds the splats that contribute to a pixel, and outlines a splat on the picture.
//!
//! [`pick`] lists every splat that is blended at a pixel, near to far, with its share of the colour.
//! [`Picked::selected`] is first the splat with the largest share; [`Picked::step`] then selects its neighbours in
//! depth.
//!
//! Whichever graph draws, the rules are those of [`Rules::of_view`], in f64: the published rasteriser's, adapted to the
//! tags of the scene's file and to the projection. A graph with other rules (another `low_pass`, a `cutoff`, culling,
//! an inexact order) draws a different picture, so its shares differ.
//!
//! Positions on the picture are in pixels from its top left corner, right and down. The middle of the first pixel is
//! (0.5, 0.5).

use super::splat_set::Masked;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Fragment, Gaussian, Projected, Rules, Splats, fragments, project};

/// Ellipse on which a splat's alpha falls to the alpha floor, 1/255. The splat has fragments only inside it.
///
/// Its semi-axes are `sqrt(2 ln(255 opacity))` standard deviations long, 3.3 for an opaque splat. The rasteriser
/// evaluates a splat only in the tiles within 3 deviations, so the rest may be cut off at the border of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Centre, in pixels from the picture's top left corner; may be outside the picture.
    pub center: [f64; 2],
    /// Half the length of the longer and the shorter axis, in pixels.
    pub half_axes: [f64; 2],
    /// Angle from the picture's right to the longer axis, in radians, from -pi/2 to pi/2. Positive angles turn down.
    pub angle: f64,
}

impl Outline {
    /// Computes a point of the ellipse, in pixels. `at` is the angle parameter, in radians from the longer axis.
    pub fn point(&self, at: f64) -> [f64; 2] {
        let (sin, cos) = self.angle.sin_cos();
        let [x, y] = [self.half_axes[0] * at.cos(), self.half_axes[1] * at.sin()];
        [self.center[0] + cos * x - sin * y, self.center[1] + sin * x + cos * y]
    }

    fn of(splat: &Projected, rules: &Rules) -> Option<Outline> {
        let radius = (2.0 * (splat.opacity / rules.alpha_floor).ln()).sqrt();
        // NaN if even the centre is below the alpha floor.
        if !(radius > 0.0 && radius.is_finite()) {
            return None;
        }
        let [xx, xy, yy] = splat.covariance;
        let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
        let longer = middle + half;
        // For a needle, `middle - half` would lose all digits.
        let shorter = splat.determinant / longer;
        Some(Outline {
            center: splat.center.map(|v| v + 0.5),
            half_axes: [longer, shorter].map(|variance| radius * variance.sqrt()),
            angle: 0.5 * (2.0 * xy).atan2(xx - yy),
        })
    }
}

/// A splat that is blended at a picked pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PickedSplat {
    /// Contribution to the pixel. Its index counts the scene's splats, without those that were dropped on load.
    pub fragment: Fragment,
    /// The splat as in the file: centre in world coordinates, opacity without a low-pass filter's compensation.
    pub gaussian: Gaussian,
}

/// The splats that are blended at a pixel, and the selected one.
#[derive(Clone, Debug, PartialEq)]
pub struct Picked {
    /// Column and row of the pixel.
    pub pixel: [u32; 2],
    /// Splats, near to far.
    pub splats: Vec<PickedSplat>,
    /// Share of the pixel that is left for the background or the mesh.
    pub transmittance: f64,
    /// Mean of [`Fragment::depth`], weighted by the splats' shares; `None` without splats.
    pub depth: Option<f64>,
    /// Index of the selected splat in `splats`; `None` without splats.
    pub selected: Option<usize>,
}

impl Picked {
    /// Returns the selected splat; `None` without splats.
    pub fn splat(&self) -> Option<&PickedSplat> {
        self.splats.get(self.selected?)
    }

    /// Moves the selection by `places` splats: farther if positive, nearer if negative. It wraps around.
    pub fn step(&mut self, places: i64) {
        if let Some(selected) = &mut self.selected {
            *selected = (*selected as i64 + places).rem_euclid(self.splats.len() as i64) as usize;
        }
    }
}

/// Lists the splats that are blended at a pixel, and selects the one with the largest share.
///
/// Hidden splats count as absent. `camera` is in the scene's coordinates, with the size of the picture. `cancelled` is
/// called from several threads. Returns `None` for a pixel outside the picture, or once `cancelled` returns true.
pub fn pick(
    masked: &Masked,
    camera: &Camera,
    pixel: [u32; 2],
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Picked> {
    let scene = masked.scene;
    let rules = &Rules::of_view(scene, camera);
    let found = fragments(masked, camera, pixel, rules, cancelled)?;
    let offset = scene.offset();
    let of = |fragment: Fragment| {
        let mut gaussian = scene.get(fragment.index as usize);
        gaussian.position.iter_mut().zip(offset).for_each(|(own, offset)| *own += offset);
        PickedSplat { fragment, gaussian }
    };
    let (transmittance, depth) = (found.transmittance, found.depth());
    let splats: Vec<PickedSplat> = found.list.into_iter().map(of).collect();
    let weight = |index: &usize| splats[*index].fragment.weight();
    let selected = (0..splats.len()).rev().max_by(|a, b| weight(a).total_cmp(&weight(b)));
    Some(Picked { pixel, splats, transmittance, depth, selected })
}

/// Computes the outline of a splat. `camera` is in the scene's coordinates.
///
/// `None` for a splat that is culled, fainter than 1/255, outside the picture or not in the scene.
pub fn outline(scene: &Scene, camera: &Camera, index: u32) -> Option<Outline> {
    if index >= scene.count() {
        return None;
    }
    let rules = &Rules::of_view(scene, camera);
    Outline::of(&project(scene, index, camera, rules)?, rules)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::splat_set::SplatSet;
    use splatgraph_assets::{Splat, synth};
    use splatgraph_reference::render;

    fn picked(scene: &Scene, camera: &Camera, pixel: [u32; 2]) -> Option<Picked> {
        pick(&Masked::whole(scene), camera, pixel, &|| false)
    }

    /// Makes a scene of one oblique splat in front of [`ahead`], so faint that its tiles contain its outline.
    fn needle() -> Scene {
        let mut sh = [0.0; 48];
        sh[..3].copy_from_slice(&[1.0, 0.5, -0.5]);
        let splat = Splat {
            position: [0.3, -0.2, 5.0],
            scale: [0.9, 0.1, 0.3],
            rotation: [0.9, 0.2, -0.3, 0.25],
            opacity: 0.3,
            sh,
        };
        Scene::generate(1, 0, |_| splat)
    }

    fn ahead() -> Camera {
        Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (201, 151))
    }

    #[test]
    fn the_shares_of_a_pixel_make_its_color_in_the_exact_picture() {
        let background = [0.2, 0.3, 0.4];
        for name in ["demo", "uniform", "needles"] {
            let scene = synth::generate(name, 2000, 3).unwrap();
            let camera = Camera::framing(&scene, 80, 60);
            let picture = render(&scene, &camera, background, &Rules::PUBLISHED, &|_, _| {});
            for at in (0..80 * 60).step_by(97) {
                let found = picked(&scene, &camera, [at % 80, at / 80]).unwrap();
                for (channel, expected) in picture.color[at as usize].into_iter().enumerate() {
                    let sum: f64 =
                        found.splats.iter().map(|s| s.fragment.weight() * s.fragment.color[channel]).sum();
                    let color = sum + found.transmittance * background[channel];
                    assert!((color - expected).abs() < 1e-9, "{name}, pixel {at}: {color}, not {expected}");
                }
                assert_eq!(found.splats.len() as u32, picture.contributors[at as usize]);
                let shares = found.splats.iter().map(|splat| splat.fragment.weight());
                let largest = shares.fold(0.0, f64::max);
                assert!(found.splat().is_none_or(|splat| splat.fragment.weight() == largest));
            }
        }
    }

    #[test]
    fn a_picked_splat_has_the_numbers_of_the_scene_in_the_world() {
        let offset = [500_000.0, -4_000_000.0, 100.0];
        let scene = synth::generate("uniform", 300, 0).unwrap().with_offset(offset);
        let camera = Camera::framing(&scene, 64, 48);
        let found = picked(&scene, &camera, [32, 24]).unwrap();
        assert!(found.splats.len() > 3);
        for PickedSplat { fragment, gaussian: splat } in &found.splats {
            let own = scene.splat(fragment.index as usize);
            assert_eq!(splat.opacity, f64::from(own.opacity));
            assert_eq!(splat.scale, own.scale.map(f64::from));
            assert_eq!(splat.rotation, own.rotation.map(f64::from));
            let axes = (0..3).all(|i| splat.position[i] == f64::from(own.position[i]) + offset[i]);
            assert!(axes, "{splat:?}");
            let depth = camera.to_view(own.position.map(f64::from))[2];
            assert!((fragment.depth - depth).abs() < 1e-5, "{} and {depth}", fragment.depth);
        }
    }

    #[test]
    fn a_hidden_splat_is_not_picked_and_the_others_keep_their_indices() {
        let scene = synth::generate("uniform", 300, 0).unwrap();
        let camera = Camera::framing(&scene, 64, 48);
        let all = picked(&scene, &camera, [32, 24]).unwrap();
        let hidden: SplatSet = [all.splat().unwrap().fragment.index].into_iter().collect();
        let masked = Masked { scene: &scene, hidden: &hidden };
        let rest = pick(&masked, &camera, [32, 24], &|| false).unwrap();
        let indices =
            |picked: &Picked| picked.splats.iter().map(|splat| splat.fragment.index).collect::<Vec<_>>();
        let expected: Vec<u32> = indices(&all).into_iter().filter(|index| !hidden.contains(*index)).collect();
        // Splats behind the hidden one may now reach the pixel.
        assert!(indices(&rest).starts_with(&expected) && !expected.is_empty());
    }

    #[test]
    fn steps_go_round_the_list_in_the_order_of_depth() {
        let scene = synth::generate("uniform", 300, 0).unwrap();
        let mut found = picked(&scene, &Camera::framing(&scene, 64, 48), [32, 24]).unwrap();
        let (first, count) = (found.selected, found.splats.len());
        let mut seen = Vec::new();
        for _ in 0..count {
            seen.push(found.splat().unwrap().fragment.depth);
            found.step(1);
        }
        assert_eq!(found.selected, first, "all the way round");
        seen.push(found.splat().unwrap().fragment.depth);
        assert_eq!(seen.windows(2).filter(|pair| pair[0] > pair[1]).count(), 1, "from the last to the first");
        found.step(-1);
        found.step(1 + 5 * count as i64);
        assert_eq!(found.selected, first);
    }

    #[test]
    fn empty_pixels_and_scenes_select_nothing_and_pixels_outside_are_not_picked() {
        let (scene, camera) = (needle(), ahead());
        let nothing = synth::generate("uniform", 0, 0).unwrap();
        for (scene, pixel) in [(&scene, [0, 0]), (&nothing, [100, 75])] {
            let mut found = picked(scene, &camera, pixel).unwrap();
            found.step(1);
            assert_eq!((found.splats.len(), found.selected, found.splat()), (0, None, None));
            assert_eq!((found.transmittance, found.depth), (1.0, None));
        }
        assert_eq!(picked(&scene, &camera, [201, 0]), None);
        assert_eq!(picked(&scene, &camera, [0, 151]), None);
        assert_eq!(pick(&Masked::whole(&scene), &camera, [100, 75], &|| true), None);
        assert_eq!((outline(&scene, &camera, 1), outline(&nothing, &camera, 0)), (None, None));
    }

    #[test]
    fn the_pixels_inside_of_an_outline_are_those_that_show_the_splat() {
        let (scene, camera) = (needle(), ahead());
        let picture = render(&scene, &camera, [0.0; 3], &Rules::PUBLISHED, &|_, _| {});
        let outline = outline(&scene, &camera, 0).unwrap();
        let [longer, shorter] = outline.half_axes;
        assert!(longer > 2.0 * shorter && outline.angle.abs() > 0.1, "{outline:?}");
        let (sin, cos) = outline.angle.sin_cos();
        let mut inside = 0;
        for (at, count) in picture.contributors.iter().enumerate() {
            let middle = [(at % 201) as f64 + 0.5, (at / 201) as f64 + 0.5];
            let [x, y] = std::array::from_fn(|i| middle[i] - outline.center[i]);
            let (along, across) = ((cos * x + sin * y) / longer, (cos * y - sin * x) / shorter);
            let within = along * along + across * across <= 1.0;
            assert_eq!(within, *count == 1, "pixel {middle:?}");
            inside += u32::from(within);
        }
        assert!(inside > 300, "{inside} pixels");
    }

    #[test]
    fn the_alpha_on_an_outline_is_the_alpha_floor() {
        let (scene, camera) = (needle(), ahead());
        let found = picked(&scene, &camera, [108, 68]).unwrap();
        let splat = found.splat().expect("the needle").gaussian;
        let outline = outline(&scene, &camera, 0).unwrap();
        let [xx, xy, yy] = project(&scene, 0, &camera, &Rules::PUBLISHED).unwrap().covariance;
        for step in 0..32 {
            let point = outline.point(f64::from(step) * std::f64::consts::TAU / 32.0);
            let [x, y]: [f64; 2] = std::array::from_fn(|i| point[i] - outline.center[i]);
            let square = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
            let alpha = splat.opacity * (-0.5 * square).exp();
            assert!((alpha - f64::from(1.0f32 / 255.0)).abs() < 1e-12, "{alpha}");
        }
    }

    #[test]
    fn a_splat_without_fragments_has_no_outline_and_a_thin_one_has_the_width_of_the_low_pass_filter() {
        let (scene, camera) = (needle(), ahead());
        let changed = |change: &(dyn Fn(&mut Splat) + Sync)| {
            let mut splat = scene.splat(0);
            change(&mut splat);
            outline(&Scene::generate(1, 0, |_| splat), &camera, 0)
        };
        assert_eq!(changed(&|splat| splat.opacity = 0.003), None, "too faint");
        assert_eq!(changed(&|splat| splat.opacity = 0.0), None);
        assert_eq!(changed(&|splat| splat.position[2] = -5.0), None, "behind");
        assert_eq!(changed(&|splat| splat.position[0] = 50.0), None, "beside");
        let thin = changed(&|splat| splat.scale = [1e7, 1e-6, 1e-6]).unwrap();
        let expected = (2.0 * (0.3 * 255.0f64).ln() * f64::from(0.3f32)).sqrt();
        assert!((thin.half_axes[1] - expected).abs() < 1e-5, "{thin:?}, not {expected}");
    }
}
