//! Finds the part of a picture whose colour depends most on the viewing direction.
//!
//! A band's mean square over all directions is the sum of its squared coefficients over 4 pi, because the real
//! spherical harmonics are orthonormal. The exact renderer draws the energy of each band in place of the colour. Each
//! splat is thereby weighted by its opacity, its area in pixels, and its occlusion by nearer splats.

use crate::studies::advise::harmonics::energy;
use splatgraph_assets::harmonics::basis;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Gaussian, Picture, Rules, Splats, render};

/// Ratio of the picture's width and height to the window's.
pub const SHARE: u32 = 3;

/// A scene with other values in place of its colours.
struct Painted<'a, F> {
    scene: &'a Scene,
    color: F,
}

impl<F: Fn(&Gaussian) -> [f64; 3] + Sync> Splats for Painted<'_, F> {
    fn count(&self) -> usize {
        Splats::count(self.scene)
    }

    fn get(&self, index: usize) -> Gaussian {
        let splat = Splats::get(self.scene, index);
        let mut sh = [[0.0; 3]; 16];
        // The renderer's colour is 0.5 plus this coefficient times its basis function.
        sh[0] = (self.color)(&splat).map(|channel| (channel - 0.5) / basis([0.0, 0.0, 1.0])[0]);
        Gaussian { sh, ..splat }
    }
}

/// A rectangular part of a picture, with the energy of the harmonics in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// First column and row, in pixels.
    pub corner: [u32; 2],
    /// Number of columns and rows.
    pub size: [u32; 2],
    /// Centroid of the part's energy, in the scene's coordinates.
    pub point: [f64; 3],
    /// Mean energy of bands 1, 2 and 3 in the part, weighted by each splat's contribution to the pixels.
    pub within: [f64; 3],
    /// Mean energy of bands 1, 2 and 3 in the whole picture.
    pub whole: [f64; 3],
}

/// Finds the window with the most energy in bands 1 to 3. Its sides are a third of the picture's.
///
/// Draws exact pictures, which must fit in memory; see [`splatgraph_reference::check_memory`]. Returns the first of
/// equal windows, by rows. `None` if nothing in the picture depends on the direction.
pub fn find(scene: &Scene, camera: &Camera) -> Option<Part> {
    let draw = |color: &(dyn Fn(&Gaussian) -> [f64; 3] + Sync)| -> Picture {
        let rules = Rules { color_floor: None, sh_degree: 0, ..Rules::PUBLISHED };
        render(&Painted { scene, color }, camera, [0.0; 3], &rules, &|_, _| {})
    };
    let bands = |splat: &Gaussian| {
        let [_, bands @ ..] = energy(&splat.sh);
        bands
    };
    let energies = draw(&bands).color;
    let total = |pixel: &[f64; 3]| pixel.iter().sum::<f64>();
    let (width, height) = (camera.width as usize, camera.height as usize);
    let size = [width.div_ceil(SHARE as usize), height.div_ceil(SHARE as usize)];
    let corner = richest(&energies.iter().map(total).collect::<Vec<_>>(), [width, height], size)?;

    let depths = draw(&|splat| {
        let energy: f64 = bands(splat).iter().sum();
        [energy * camera.to_view(splat.position)[2], 0.0, 0.0]
    });
    let mut sums = [0.0; 4];
    let mut within = [0.0; 3];
    for y in corner[1]..corner[1] + size[1] {
        for x in corner[0]..corner[0] + size[0] {
            let at = y * width + x;
            let energy = total(&energies[at]);
            let terms = [energy, energy * x as f64, energy * y as f64, depths.color[at][0]];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            within.iter_mut().zip(energies[at]).for_each(|(sum, band)| *sum += band);
        }
    }
    let [energy, x, y, depth] = sums;
    let (x, y, depth) = (x / energy, y / energy, depth / energy);
    let mean = |sums: [f64; 3], pixels: usize| sums.map(|sum| sum / pixels as f64);
    let all = energies.iter().fold([0.0; 3], |sums, pixel| std::array::from_fn(|i| sums[i] + pixel[i]));
    Some(Part {
        corner: corner.map(|v| v as u32),
        size: size.map(|v| v as u32),
        point: unprojected(camera, x, y, depth),
        within: mean(within, size[0] * size[1]),
        whole: mean(all, width * height),
    })
}

/// Finds the top left corner of the window of this size with the largest sum; `None` if all sums are 0.
fn richest(values: &[f64], [width, height]: [usize; 2], size: [usize; 2]) -> Option<[usize; 2]> {
    // A summed-area table.
    let mut sums = vec![0.0; (width + 1) * (height + 1)];
    for y in 0..height {
        for x in 0..width {
            let at = |x: usize, y: usize| y * (width + 1) + x;
            sums[at(x + 1, y + 1)] =
                values[y * width + x] + sums[at(x, y + 1)] + sums[at(x + 1, y)] - sums[at(x, y)];
        }
    }
    let sum = |x: usize, y: usize| {
        let at = |x: usize, y: usize| sums[y * (width + 1) + x];
        at(x + size[0], y + size[1]) - at(x, y + size[1]) - at(x + size[0], y) + at(x, y)
    };
    let corners =
        (0..=height - size[1]).flat_map(|y| (0..=width - size[0]).map(move |x| ([x, y], sum(x, y))));
    let best = corners.fold(None, |best: Option<([usize; 2], f64)>, (corner, sum)| match best {
        Some((_, most)) if most >= sum => best,
        _ => Some((corner, sum)),
    });
    best.filter(|(_, most)| *most > 0.0).map(|(corner, _)| corner)
}

fn unprojected(camera: &Camera, x: f64, y: f64, depth: f64) -> [f64; 3] {
    let [cx, cy] = camera.principal_point().map(|v| v - 0.5);
    let view = [(x - cx) / camera.fx * depth, (y - cy) / camera.fy * depth, depth];
    let axes = camera.axes();
    std::array::from_fn(|i| camera.position[i] + (0..3).map(|axis| axes[axis][i] * view[axis]).sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Splat;

    fn splat(position: [f32; 3], sh: &[(usize, f32)]) -> Splat {
        let mut all = [0.0; 48];
        sh.iter().for_each(|(at, value)| all[*at] = *value);
        Splat { position, scale: [0.1; 3], rotation: [1.0, 0.0, 0.0, 0.0], opacity: 0.9, sh: all }
    }

    #[test]
    fn the_part_is_around_the_splat_that_changes_with_the_direction_and_hidden_ones_do_not_count() {
        // A plain splat on the left, a glossy one on the right, and a glossier one hidden behind the plain one.
        let list = [
            splat([-1.0, 0.0, 4.0], &[(0, 1.0)]),
            splat([1.0, 0.3, 4.0], &[(3, 0.3), (12, 0.2)]),
            splat([-2.0, 0.0, 8.0], &[(3, 0.4)]),
        ];
        let scene = Scene::generate(3, 3, |index| {
            let hide = if index == 0 { 8.0 } else { 1.0 };
            Splat { scale: [0.1 * hide; 3], ..list[index] }
        });
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (90, 60));
        let part = find(&scene, &camera).expect("something is glossy");
        let [x, y] = [0, 1].map(|i| part.corner[i]..part.corner[i] + part.size[i]);
        assert!(x.contains(&64) && y.contains(&35), "{part:?}");
        assert!((0..3).all(|i| (part.point[i] - f64::from(list[1].position[i])).abs() < 0.05), "{part:?}");
        assert!(part.within[0] > 0.0 && part.within[1] > 0.0 && part.within[2] == 0.0, "{part:?}");
        let plain = Scene::generate(1, 3, |_| list[0]);
        assert_eq!(find(&plain, &camera), None);
    }
}
