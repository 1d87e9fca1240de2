//! Lists the splats that one pixel blends ([`fragments`]), exactly as [`render`](crate::render) blends them. Also
//! returns a splat's Gaussian on the image ([`project`]), to draw its outline.

use crate::gaussian::Splats;
use crate::mesh::Surfaces;
use crate::project::{Ellipse, Projector, TILE};
use crate::raster;
use crate::rules::Rules;
use splatgraph_assets::Camera;

/// A splat blended at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Index among the splats.
    pub index: u32,
    /// The value to sort by, view depth or distance: see [`Rules::key_of`].
    pub depth: f64,
    /// Alpha at the pixel, after the cap.
    pub alpha: f64,
    /// Transmittance of all nearer splats together, before this one.
    pub transmittance: f64,
    /// View-dependent colour, display-encoded.
    pub color: [f64; 3],
}

impl Fragment {
    /// Computes the splat's weight in the pixel: alpha times transmittance.
    pub fn weight(&self) -> f64 {
        self.alpha * self.transmittance
    }
}

/// The splats that a pixel blends, near to far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fragments {
    /// The blended splats. Splats behind the early stop, or behind the mesh, are not included.
    pub list: Vec<Fragment>,
    /// The transmittance left for the background or the mesh.
    pub transmittance: f64,
}

impl Fragments {
    /// Blends the colours over a background, as [`render`](crate::render) does. Where the pixel shows a mesh,
    /// `background` must be the mesh's colour.
    pub fn color(&self, background: [f64; 3]) -> [f64; 3] {
        let mut color = [0.0; 3];
        for fragment in &self.list {
            let weight = fragment.weight();
            color.iter_mut().zip(fragment.color).for_each(|(sum, c)| *sum += weight * c);
        }
        std::array::from_fn(|c| color[c] + self.transmittance * background[c])
    }

    /// Computes the mean depth, weighted by the splats' weights; `None` if no splat is blended.
    pub fn depth(&self) -> Option<f64> {
        let total: f64 = self.list.iter().map(Fragment::weight).sum();
        let sum: f64 = self.list.iter().map(|fragment| fragment.weight() * fragment.depth).sum();
        (total > 0.0).then(|| sum / total)
    }
}

/// Lists the splats blended at a pixel, given as column and row, down to the mesh. `None` for a pixel outside the
/// image, or once `cancelled`, which several threads call, returns true.
pub fn fragments(
    splats: &(impl Splats + ?Sized),
    camera: &Camera,
    [x, y]: [u32; 2],
    rules: &Rules,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Fragments> {
    if x >= camera.width || y >= camera.height {
        return None;
    }
    let projector = Projector::new(camera, rules, splats.is_wide());
    let tile = [x / TILE, y / TILE];
    let touches = |[x0, y0, x1, y1]: [u32; 4]| (x0..x1).contains(&tile[0]) && (y0..y1).contains(&tile[1]);
    let ellipses = projector.sorted(splats, touches, cancelled)?;
    let surfaces = Surfaces::find(splats, camera, rules, [x, y, x + 1, y + 1], cancelled)?;
    let limit = surfaces.limit([x as usize, y as usize]);
    let mut list = Vec::new();
    let transmittance = raster::blend(
        &ellipses,
        [x.into(), y.into()],
        limit,
        rules,
        |Ellipse { index, depth, footprint, .. }, alpha, transmittance| {
            let color = footprint.color;
            list.push(Fragment { index: *index, depth: *depth, alpha, transmittance, color });
        },
    );
    Some(Fragments { list, transmittance })
}

/// A splat's Gaussian on the image. Lengths are pixels; pixel (0, 0) is sampled at (0, 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected {
    /// The value to sort by, view depth or distance: see [`Rules::key_of`].
    pub depth: f64,
    /// Centre, in pixels from the left and the top.
    pub center: [f64; 2],
    /// 2D covariance with the low-pass filter, as xx, xy, yy, in square pixels.
    pub covariance: [f64; 3],
    /// Determinant of the covariance, from a stable form: for needles, `xx yy - xy^2` would cancel completely.
    pub determinant: f64,
    /// Opacity at the centre, including the low-pass filter's compensation.
    pub opacity: f64,
    /// View-dependent colour, display-encoded.
    pub color: [f64; 3],
}

/// Projects splat `index`, which must be below [`Splats::count`]. `None` if it is culled or degenerate, or touches no
/// tile of the image.
pub fn project(
    splats: &(impl Splats + ?Sized),
    index: u32,
    camera: &Camera,
    rules: &Rules,
) -> Option<Projected> {
    let projector = Projector::new(camera, rules, splats.is_wide());
    let Ellipse { depth, footprint, .. } = projector.project(index, &splats.get(index as usize))?;
    Some(Projected {
        depth,
        center: footprint.center,
        covariance: footprint.covariance(),
        determinant: footprint.determinant(),
        opacity: footprint.opacity,
        color: footprint.color,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Gaussian;
    use crate::project::CHUNK;
    use crate::raster::{largest, render};
    use proptest::prelude::*;
    use splatgraph_assets::{Scene, synth};
    use std::sync::atomic::{AtomicUsize, Ordering};

    const GOES_ON: &(dyn Fn() -> bool + Sync) = &|| false;

    fn changed(changes: &[(&str, &str)]) -> Rules {
        let mut rules = Rules::PUBLISHED;
        changes.iter().for_each(|(name, value)| rules.set(name, value).unwrap());
        rules
    }

    fn camera(name: &str, scene: &Scene, size: (u32, u32)) -> Camera {
        let generator = synth::generators().iter().find(|generator| generator.name == name).unwrap();
        let own = (generator.cameras)().into_iter().next();
        own.unwrap_or_else(|| Camera::framing(scene, size.0, size.1)).resized(size.0, size.1)
    }

    #[test]
    fn the_fragments_of_every_pixel_sum_up_to_the_picture_bit_by_bit() {
        let background = [0.25, 0.5, 1.0];
        let rules = [
            Rules::PUBLISHED,
            changed(&[("extent", "2.5"), ("ties", "descending"), ("low_pass", "0.3*compensated")]),
            changed(&[("extent", "unbounded"), ("stop", "none"), ("alpha_floor", "0"), ("depth", "f64")]),
            changed(&[("order", "pixel")]),
        ];
        let mut most = 0;
        for name in ["uniform", "needles", "giants", "ties", "near-plane", "demo"] {
            let scene = synth::generate(name, 400, 1).unwrap();
            let camera = camera(name, &scene, (37, 21));
            for rules in &rules {
                let picture = render(&scene, &camera, background, rules, &|_, _| {});
                for (at, color) in picture.color.iter().enumerate() {
                    let pixel = [at as u32 % 37, at as u32 / 37];
                    let found = fragments(&scene, &camera, pixel, rules, GOES_ON).unwrap();
                    assert_eq!(found.color(background), *color, "{name}, pixel {pixel:?}");
                    assert_eq!(found.transmittance, picture.transmittance[at], "{name}, pixel {pixel:?}");
                    assert_eq!(found.list.len() as u32, picture.contributors[at], "{name}, pixel {pixel:?}");
                    most = most.max(found.list.len());
                }
            }
        }
        assert!(most > 20, "at most {most} splats are blended at a pixel");
    }

    #[test]
    fn fragments_stand_in_the_order_of_their_depths_and_their_shares_sum_up_to_1() {
        let scene = synth::generate("ties", 3000, 0).unwrap();
        let camera = camera("ties", &scene, (64, 48));
        for (rules, ascending) in [(Rules::PUBLISHED, true), (changed(&[("ties", "descending")]), false)] {
            let found = fragments(&scene, &camera, [32, 24], &rules, GOES_ON).unwrap();
            let mut equal = 0;
            for pair in found.list.windows(2) {
                assert!(pair[0].depth <= pair[1].depth, "{pair:?}");
                assert_eq!(pair[1].transmittance, pair[0].transmittance * (1.0 - pair[0].alpha));
                if pair[0].depth == pair[1].depth {
                    equal += 1;
                    assert_eq!(pair[0].index < pair[1].index, ascending, "{pair:?}");
                }
            }
            assert!(equal > 0, "no two depths are equal");
            let shares: f64 = found.list.iter().map(Fragment::weight).sum();
            assert!((shares + found.transmittance - 1.0).abs() < 1e-12);
            let (near, far) = (found.list[0].depth, found.list[found.list.len() - 1].depth);
            assert!((near..=far).contains(&found.depth().unwrap()));
        }
    }

    #[test]
    fn empty_pixels_have_no_fragments_and_pixels_outside_have_no_list() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        let mut camera = Camera::framing(&scene, 64, 48);
        let empty = Fragments { list: Vec::new(), transmittance: 1.0 };
        assert!(!fragments(&scene, &camera, [32, 24], &Rules::PUBLISHED, GOES_ON).unwrap().list.is_empty());
        assert_eq!(fragments(&scene, &camera, [0, 0], &Rules::PUBLISHED, GOES_ON), Some(empty.clone()));
        for outside in [[64, 0], [0, 48], [u32::MAX; 2]] {
            assert_eq!(fragments(&scene, &camera, outside, &Rules::PUBLISHED, GOES_ON), None);
        }
        let nothing = synth::generate("uniform", 0, 0).unwrap();
        assert_eq!(fragments(&nothing, &camera, [32, 24], &Rules::PUBLISHED, GOES_ON), Some(empty.clone()));
        assert_eq!((empty.color([0.5; 3]), empty.depth()), ([0.5; 3], None));
        camera.width = 0;
        assert_eq!(fragments(&scene, &camera, [0, 0], &Rules::PUBLISHED, GOES_ON), None);
    }

    #[test]
    fn a_cancelled_search_ends_after_the_chunks_in_work() {
        let scene = synth::generate("uniform", 40 * CHUNK as u32, 0).unwrap();
        let camera = Camera::framing(&scene, 64, 48);
        let rules = &Rules::PUBLISHED;
        type Cancelled<'a> = &'a (dyn Fn() -> bool + Sync);
        type Ends<'a> = &'a dyn Fn(Cancelled) -> bool;
        let searches: [(&str, Ends); 2] = [
            ("fragments", &|cancelled| fragments(&scene, &camera, [32, 24], rules, cancelled).is_none()),
            ("largest", &|cancelled| largest(&scene, &camera, [8, 8, 9, 9], rules, cancelled).is_none()),
        ];
        for (name, ends) in searches {
            let looks = AtomicUsize::new(0);
            assert!(ends(&|| looks.fetch_add(1, Ordering::Relaxed) >= 3), "{name}");
            assert!(looks.into_inner() < 40, "{name}: all chunks were begun");
        }
    }

    /// Checks that [`project`] and [`fragments`] use the same precision for the depths of a wide scene.
    #[test]
    fn a_splat_is_as_deep_as_its_fragment_however_precise_its_scene_is() {
        struct Wide(Vec<Gaussian>);

        impl Splats for Wide {
            fn count(&self) -> usize {
                self.0.len()
            }

            fn get(&self, index: usize) -> Gaussian {
                self.0[index]
            }

            fn is_wide(&self) -> bool {
                true
            }
        }

        let scene = synth::generate("uniform", 400, 1).unwrap();
        let wide = Wide((0..Splats::count(&scene)).map(|index| Splats::get(&scene, index)).collect());
        let camera = Camera::framing(&scene, 64, 48);
        let found = fragments(&wide, &camera, [32, 24], &Rules::PUBLISHED, GOES_ON).unwrap();
        let deep = |splats: &dyn Fn(u32) -> Option<Projected>| -> Vec<f64> {
            found.list.iter().map(|fragment| splats(fragment.index).unwrap().depth).collect()
        };
        let depths: Vec<f64> = found.list.iter().map(|fragment| fragment.depth).collect();
        assert_eq!(deep(&|index| project(&wide, index, &camera, &Rules::PUBLISHED)), depths);
        assert_ne!(deep(&|index| project(&scene, index, &camera, &Rules::PUBLISHED)), depths);
    }

    proptest! {
        /// Checks that the covariance from the stable factors equals `M M^T + l I`, the textbook form.
        #[test]
        fn the_projected_covariance_is_the_textbooks(
            position in prop::array::uniform3(-1.0..1.0f64), logs in prop::array::uniform3(-3.0..0.0f64),
            rotation in prop::array::uniform4(-1.0..1.0f64),
        ) {
            let length = rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
            prop_assume!(length > 0.1);
            let splat = Gaussian {
                position: [position[0], position[1], 4.0 + position[2]],
                scale: logs.map(f64::exp),
                rotation: rotation.map(|v| v / length),
                opacity: 0.7,
                sh: [[0.0; 3]; 16],
            };
            let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (200, 160));
            let found = project(&[splat] as &[Gaussian], 0, &camera, &Rules::PUBLISHED).expect("it is in the picture");
            // Rotates and projects each axis by itself, without the products of matrices.
            let [w, x, y, z] = splat.rotation;
            let rotate = glam::DQuat::from_xyzw(x, y, z, w);
            let axes = [glam::DVec3::X, glam::DVec3::Y, glam::DVec3::Z];
            let (px, py, pz) = (splat.position[0], splat.position[1], splat.position[2]);
            let mut sums = [f64::from(0.3f32), 0.0, f64::from(0.3f32)];
            for (axis, scale) in axes.into_iter().zip(splat.scale) {
                let a = rotate * axis * scale;
                let u = camera.fx * (a.x / pz - px / (pz * pz) * a.z);
                let v = camera.fy * (a.y / pz - py / (pz * pz) * a.z);
                [u * u, u * v, v * v].iter().zip(&mut sums).for_each(|(product, sum)| *sum += product);
            }
            for (found, expected) in found.covariance.iter().zip(sums) {
                prop_assert!((found - expected).abs() < 1e-9 * (sums[0] + sums[2]), "{found}, expected {expected}");
            }
            let determinant = sums[0] * sums[2] - sums[1] * sums[1];
            prop_assert!((found.determinant - determinant).abs() < 1e-9 * sums[0] * sums[2]);
            prop_assert!((found.center[0] - (99.5 + camera.fx * px / pz)).abs() < 1e-9);
            prop_assert!((found.center[1] - (79.5 + camera.fy * py / pz)).abs() < 1e-9);
            prop_assert_eq!((found.depth, found.opacity), (f64::from(pz as f32), 0.7));
        }
    }
}
