//! Blends the sorted ellipses at every pixel, front to back.

use crate::gaussian::Splats;
use crate::mesh::{Surface, Surfaces};
use crate::order;
use crate::project::{Ellipse, Projector, TILE};
use crate::rules::{Order, Rules};
use rayon::prelude::*;
use splatgraph_assets::Camera;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Progress callback, called from any thread with the number of finished rows of tiles and their total.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// An exact picture, with further data for each pixel. Arrays have `width * height` entries, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Red, green and blue as blended: display-encoded as trained, not clamped.
    pub color: Vec<[f64; 3]>,
    /// The remaining transmittance, 0 to 1.
    pub transmittance: Vec<f64>,
    /// Number of splats blended.
    pub contributors: Vec<u32>,
    /// Sum of the splats' depths, each times its weight (alpha times transmittance). A depth is the sort key, see
    /// [`Rules::key_of`].
    pub depth: Vec<f64>,
    /// Depth of the splat that brings the transmittance to one half or below, else of the last splat. 0 without splats.
    pub median_depth: Vec<f64>,
    /// Sum of the splats' normals, each times its weight. A splat's normal is the unit vector along its shortest axis,
    /// in world space, towards the camera.
    pub normal: Vec<[f64; 3]>,
    /// Index of the splat with the largest weight (the nearest one among equals); `u32::MAX` without splats.
    pub index: Vec<u32>,
}

impl Picture {
    /// Computes the mean depth of each pixel: the sum of weighted depths over the sum of weights, 0 without splats.
    pub fn expected_depth(&self) -> Vec<f64> {
        let mean = |(depth, light): (&f64, &f64)| depth / (1.0 - light).max(1e-10);
        self.depth.iter().zip(&self.transmittance).map(mean).collect()
    }
}

/// A splat that may be visible in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Visible {
    /// Index among the splats.
    pub index: u32,
    /// The value to sort by, view depth or distance: see [`Rules::key_of`].
    pub depth: f64,
    /// Tiles of 16 x 16 pixels that the splat touches: first column and row, then end column and row (exclusive).
    pub tiles: [u32; 4],
}

/// Lists the splats that touch a tile of the image, near to far. Also returns the number of tiles across and down.
pub fn visible(splats: &(impl Splats + ?Sized), camera: &Camera, rules: &Rules) -> (Vec<Visible>, [u32; 2]) {
    let projector = Projector::new(camera, rules, splats.is_wide());
    let of = |ellipse: Ellipse| Visible { index: ellipse.index, depth: ellipse.depth, tiles: ellipse.tiles };
    let mut visible: Vec<Visible> = (0..splats.count())
        .into_par_iter()
        .filter_map(|index| projector.project(index as u32, &splats.get(index)).map(of))
        .collect();
    order::sort(&mut visible, rules, |splat| (splat.depth, splat.index));
    (visible, projector.grid)
}

#[derive(Clone, Copy)]
struct Pixel {
    color: [f64; 3],
    transmittance: f64,
    contributors: u32,
    depth: f64,
    median_depth: f64,
    normal: [f64; 3],
    /// The largest weight so far, with the index of its splat.
    most: (f64, u32),
}

impl Pixel {
    const EMPTY: Pixel = Pixel {
        color: [0.0; 3],
        transmittance: 1.0,
        contributors: 0,
        depth: 0.0,
        median_depth: 0.0,
        normal: [0.0; 3],
        most: (0.0, u32::MAX),
    };

    /// Adds a splat to the sums. `transmittance` is that of all nearer splats together.
    fn add(&mut self, splat: &Ellipse, alpha: f64, transmittance: f64) {
        let weight = alpha * transmittance;
        self.color.iter_mut().zip(splat.footprint.color).for_each(|(sum, c)| *sum += weight * c);
        self.normal.iter_mut().zip(splat.normal).for_each(|(sum, n)| *sum += weight * n);
        self.depth += weight * splat.depth;
        self.contributors += 1;
        if transmittance > 0.5 {
            self.median_depth = splat.depth;
        }
        if weight > self.most.0 {
            self.most = (weight, splat.index);
        }
    }
}

/// Bytes per pixel that [`render`] needs without a mesh: a [`Pixel`], and an entry of each list of [`Picture`].
pub(crate) const PIXEL_BYTES: usize =
    size_of::<Pixel>() + 2 * size_of::<[f64; 3]>() + 3 * size_of::<f64>() + 2 * size_of::<u32>();

/// Renders splats over `background`, a display-encoded colour, by the given rules. A mesh hides the background and the
/// splats behind it; only pinhole cameras draw it. The result does not depend on the number of threads.
///
/// A picture that does not fit in memory ends the process: see [`check_memory`](crate::check_memory).
pub fn render(
    splats: &(impl Splats + ?Sized),
    camera: &Camera,
    background: [f64; 3],
    rules: &Rules,
    progress: Progress,
) -> Picture {
    let projector = Projector::new(camera, rules, splats.is_wide());
    let never = &|| false;
    let area = [0, 0, camera.width, camera.height];
    let (Some(ellipses), Some(surfaces)) =
        (projector.sorted(splats, |_| true, never), Surfaces::find(splats, camera, rules, area, never))
    else {
        unreachable!("nothing cancels it")
    };
    let width = camera.width as usize;
    let mut pixels = vec![Pixel::EMPTY; width * camera.height as usize];
    let done = AtomicUsize::new(0);
    let rows = projector.grid[1] as usize;
    pixels.par_chunks_mut((width * TILE as usize).max(1)).enumerate().for_each(|(row, pixels)| {
        tile_row(&ellipses, &projector, row as u32, 0..projector.grid[0], pixels, rules, &surfaces);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, rows);
    });
    Picture {
        width: camera.width,
        height: camera.height,
        color: pixels
            .iter()
            .enumerate()
            .map(|(at, p)| {
                let behind =
                    surfaces.at([at % width, at / width]).map_or(background, |Surface { color, .. }| color);
                std::array::from_fn(|c| p.color[c] + p.transmittance * behind[c])
            })
            .collect(),
        transmittance: pixels.iter().map(|p| p.transmittance).collect(),
        contributors: pixels.iter().map(|p| p.contributors).collect(),
        depth: pixels.iter().map(|p| p.depth).collect(),
        median_depth: pixels.iter().map(|p| p.median_depth).collect(),
        normal: pixels.iter().map(|p| p.normal).collect(),
        index: pixels.iter().map(|p| p.most.1).collect(),
    }
}

/// Finds the splat with the largest weight at each pixel of a rectangle, as [`Picture::index`] does for the image.
///
/// `area` is left, top, right and bottom, in pixels inside the image, right and bottom exclusive. Rows of the result
/// are as wide as the rectangle. `None` once `cancelled`, which several threads call, returns true.
pub fn largest(
    splats: &(impl Splats + ?Sized),
    camera: &Camera,
    area: [u32; 4],
    rules: &Rules,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<u32>> {
    let [left, top, right, bottom] = area;
    if left >= right || top >= bottom {
        return Some(Vec::new());
    }
    let projector = Projector::new(camera, rules, splats.is_wide());
    let (columns, rows) = (left / TILE..right.div_ceil(TILE), top / TILE..bottom.div_ceil(TILE));
    let touches = |[x0, y0, x1, y1]: [u32; 4]| {
        x0 < columns.end && columns.start < x1 && y0 < rows.end && rows.start < y1
    };
    let ellipses = projector.sorted(splats, touches, cancelled)?;
    let surfaces = Surfaces::find(splats, camera, rules, area, cancelled)?;
    let width = projector.width();
    let row = |row: u32| -> Option<Vec<u32>> {
        if cancelled() {
            return None;
        }
        let height = TILE.min(camera.height - row * TILE);
        let mut pixels = vec![Pixel::EMPTY; width * height as usize];
        tile_row(&ellipses, &projector, row, columns.clone(), &mut pixels, rules, &surfaces);
        let lines = pixels.chunks(width).zip(row * TILE..).filter(|(_, y)| (top..bottom).contains(y));
        Some(lines.flat_map(|(line, _)| &line[left as usize..right as usize]).map(|p| p.most.1).collect())
    };
    let found: Option<Vec<Vec<u32>>> = rows.clone().into_par_iter().map(row).collect();
    Some(found?.concat())
}

/// Blends the tiles of a row in these columns, down to the surfaces. `pixels` are the image's pixels in this row.
fn tile_row(
    ellipses: &[Ellipse],
    projector: &Projector,
    row: u32,
    columns: Range<u32>,
    pixels: &mut [Pixel],
    rules: &Rules,
    surfaces: &Surfaces,
) {
    let mut lists: Vec<Vec<u32>> = vec![Vec::new(); columns.len()];
    for (at, ellipse) in ellipses.iter().enumerate() {
        let [x0, y0, x1, y1] = ellipse.tiles;
        if (y0..y1).contains(&row) {
            let touched = x0.max(columns.start)..x1.min(columns.end);
            touched.for_each(|column| lists[(column - columns.start) as usize].push(at as u32));
        }
    }
    let width = projector.width();
    for (column, list) in columns.zip(&lists) {
        let splats: Vec<&Ellipse> = list.iter().map(|at| &ellipses[*at as usize]).collect();
        let first = (column * TILE) as usize;
        for (line_number, line) in pixels.chunks_mut(width).enumerate() {
            let y = (row * TILE) as usize + line_number;
            let end = width.min(first + TILE as usize);
            for (x, pixel) in line[first..end].iter_mut().enumerate() {
                let mut blended = Pixel::EMPTY;
                let pixel_at = [first + x, y];
                let limit = surfaces.limit(pixel_at);
                blended.transmittance = blend(
                    splats.iter().copied(),
                    pixel_at.map(|v| v as f64),
                    limit,
                    rules,
                    |splat, alpha, transmittance| {
                        blended.add(splat, alpha, transmittance);
                    },
                );
                *pixel = blended;
            }
        }
    }
}

/// Blends splats, near to far, at one pixel (`renderCUDA` in forward.cu). Returns the remaining transmittance.
/// Calls `fragment` for each blended splat with the splat, its alpha, and the transmittance before it. Under
/// [`Order::Pixel`], sorts them by their depth there first. Splats at the depth `limit` or behind it are hidden.
#[inline(always)]
pub(crate) fn blend<'a>(
    splats: impl IntoIterator<Item = &'a Ellipse>,
    [x, y]: [f64; 2],
    limit: f64,
    rules: &Rules,
    fragment: impl FnMut(&'a Ellipse, f64, f64),
) -> f64 {
    let with_alpha = |splat: &'a Ellipse| Some((splat, splat.footprint.alpha(x, y, rules)?));
    let splats = splats.into_iter();
    if rules.order == Order::Centre {
        return accumulate(
            splats.take_while(|splat| splat.depth < limit).filter_map(with_alpha),
            rules,
            fragment,
        );
    }
    let fragments = splats.filter_map(with_alpha).map(|(splat, alpha)| (splat.depth_at(x, y), splat, alpha));
    let mut fragments: Vec<_> = fragments.filter(|(depth, ..)| *depth < limit).collect();
    fragments.sort_by(|(a, ..), (b, ..)| a.total_cmp(b));
    accumulate(fragments.into_iter().map(|(_, splat, alpha)| (splat, alpha)), rules, fragment)
}

/// Blends fragments in this order; see [`blend`].
#[inline(always)]
fn accumulate<'a>(
    fragments: impl Iterator<Item = (&'a Ellipse, f64)>,
    rules: &Rules,
    mut fragment: impl FnMut(&'a Ellipse, f64, f64),
) -> f64 {
    let mut transmittance = 1.0;
    for (splat, alpha) in fragments {
        let left = transmittance * (1.0 - alpha);
        if rules.stop.is_some_and(|stop| left < stop) {
            break;
        }
        fragment(splat, alpha, transmittance);
        transmittance = left;
    }
    transmittance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Gaussian;

    const QUIET: Progress = &|_, _| {};

    /// Returns a camera that looks along +z from the origin; the axis meets the image at pixel (32, 24).
    fn camera() -> Camera {
        Camera {
            width: 65,
            height: 49,
            fx: 50.0,
            fy: 50.0,
            ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (65, 49))
        }
    }

    /// Returns a white sphere on the axis.
    fn ball(z: f64, deviation: f64, opacity: f64) -> Gaussian {
        let mut sh = [[0.0; 3]; 16];
        sh[0] = [0.5 / 0.28209479177387814; 3];
        Gaussian {
            position: [0.0, 0.0, z],
            scale: [deviation; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity,
            sh,
        }
    }

    fn draw(splats: &[Gaussian], rules: &Rules) -> Picture {
        render(splats, &camera(), [0.0; 3], rules, QUIET)
    }

    fn at(picture: &Picture, x: usize, y: usize) -> f64 {
        picture.color[y * picture.width as usize + x][0]
    }

    #[test]
    fn a_ball_on_the_axis_falls_off_as_its_projected_gaussian_does() {
        let picture = draw(&[ball(5.0, 0.4, 0.8)], &Rules::PUBLISHED);
        // Standard deviation 0.4 * 50 / 5 = 4 pixels, widened by the low-pass filter.
        let variance = 16.0 + f64::from(0.3f32);
        for offset in 0..12 {
            let expected = 0.8 * (-0.5 * f64::from(offset).powi(2) / variance).exp();
            let found = at(&picture, 32 + offset as usize, 24);
            assert!(
                (found - expected).abs() < 1e-12,
                "{offset} pixels from the centre: {found}, expected {expected}"
            );
        }
    }

    #[test]
    fn opacity_is_capped_and_the_nearer_of_two_splats_covers_the_other() {
        let mut far = ball(6.0, 0.4, 1.0);
        far.sh[0] = [0.0; 3];
        let picture = draw(&[far, ball(5.0, 0.4, 1.0)], &Rules::PUBLISHED);
        // 0.99 of white, then 0.99 of grey at the remaining transmittance of 0.01.
        let stopped = f64::from(0.99f32);
        let left = 1.0 - stopped;
        assert!((at(&picture, 32, 24) - stopped).abs() < 1e-12, "the second would leave less than 1e-4");
        let open = Rules { stop: None, ..Rules::PUBLISHED };
        let picture = draw(&[far, ball(5.0, 0.4, 1.0)], &open);
        assert!((at(&picture, 32, 24) - (stopped + left * stopped * 0.5)).abs() < 1e-12);
        assert_eq!(picture.contributors[24 * 65 + 32], 2);
        assert!((picture.transmittance[24 * 65 + 32] - left * left).abs() < 1e-15);
    }

    #[test]
    fn splats_at_the_near_plane_are_culled_and_those_just_beyond_are_not() {
        let beyond = f64::from(0.2f32.next_up());
        assert_eq!(at(&draw(&[ball(f64::from(0.2f32), 0.01, 0.9)], &Rules::PUBLISHED), 32, 24), 0.0);
        assert!(at(&draw(&[ball(beyond, 0.01, 0.9)], &Rules::PUBLISHED), 32, 24) > 0.89);
    }

    /// Renders a needle of axis ratio 1e12 across the image. In f64, `a c - b^2` has no correct digit. The falloff
    /// across the needle must still come from the low-pass filter.
    #[test]
    fn a_needle_is_as_thin_as_the_low_pass_filter_makes_it() {
        let half = std::f64::consts::FRAC_PI_8;
        let mut needle = ball(5.0, 1e-3, 0.9);
        needle.scale[0] = 1e9;
        // The longest axis lies along the diagonal of the image.
        needle.rotation = [half.cos(), 0.0, 0.0, half.sin()];
        let picture = draw(&[needle], &Rules::PUBLISHED);
        for (x, y) in [(32, 24), (42, 34), (22, 14)] {
            assert!(
                (at(&picture, x, y) - 0.9).abs() < 1e-6,
                "on the needle, at ({x}, {y}): {}",
                at(&picture, x, y)
            );
        }
        // One pixel to the right of the line, the distance to it is sqrt(1/2) pixels. The variance is 0.3 plus the
        // needle's 1e-4.
        let expected = 0.9 * (-0.5 * 0.5 / 0.3001f64).exp();
        let found = at(&picture, 33, 24);
        assert!((found - expected).abs() < 1e-3, "beside the needle: {found}, expected {expected}");
    }

    /// Returns two plates that lean against each other and cross in the column of pixel 32. The first one is white and
    /// in front to the left; the second one is black.
    fn crossing(first_z: f64) -> [Gaussian; 2] {
        let half = std::f64::consts::FRAC_PI_8;
        [(first_z, 0.5, half), (5.0, -0.5, -half)].map(|(z, light, half)| {
            let mut plate = ball(z, 0.6, 0.9);
            plate.scale[2] = 1e-3;
            plate.rotation = [half.cos(), 0.0, half.sin(), 0.0];
            plate.sh[0] = [light / 0.28209479177387814; 3];
            plate
        })
    }

    #[test]
    fn crossing_plates_change_places_within_the_picture_by_the_order_of_each_pixel_only() {
        let columns = |rules: &Rules| {
            let picture = draw(&crossing(5.0), rules);
            [30, 34].map(|x| at(&picture, x, 24))
        };
        let [left, right] = columns(&Rules::PUBLISHED);
        assert!(left > 0.8 && (left - right).abs() < 0.01, "one order: {left}, {right}");
        let [left, right] = columns(&Rules { order: Order::Pixel, ..Rules::PUBLISHED });
        assert!(left.min(right) < 0.2 && left.max(right) > 0.8, "two orders: {left}, {right}");
    }

    #[test]
    fn by_the_order_of_each_pixel_a_plate_that_passes_another_changes_no_pixel_suddenly() {
        let change = |order: Order| {
            let rules = Rules { order, ..Rules::PUBLISHED };
            let [before, after] = [4.999_999, 5.000_001].map(|z| draw(&crossing(z), &rules));
            let changes = before.color.iter().zip(&after.color).map(|(a, b)| (a[0] - b[0]).abs());
            changes.enumerate().filter(|(at, _)| at % 65 != 32).map(|(_, change)| change).fold(0.0, f64::max)
        };
        assert!(change(Order::Centre) > 0.7, "they change places everywhere at once");
        assert!(change(Order::Pixel) < 1e-4, "{}", change(Order::Pixel));
    }

    #[test]
    fn the_largest_weights_of_a_rectangle_are_the_picture_s() {
        let camera = camera();
        let splats: Vec<Gaussian> = (0..40)
            .map(|i| {
                let [x, y, z] =
                    [f64::from(i * 7 % 13) - 6.0, f64::from(i * 5 % 11) - 5.0, f64::from(6 + i % 9)];
                Gaussian { position: [0.6 * x, 0.5 * y, z], ..ball(z, 0.2 + 0.02 * f64::from(i), 0.7) }
            })
            .collect();
        let picture = draw(&splats, &Rules::PUBLISHED);
        let never = &|| false;
        for [left, top, right, bottom] in
            [[0, 0, 65, 49], [17, 3, 40, 33], [15, 15, 16, 17], [64, 48, 65, 49]]
        {
            let area = [left, top, right, bottom];
            let found = largest(splats.as_slice(), &camera, area, &Rules::PUBLISHED, never);
            let expected = (top..bottom).flat_map(|y| (left..right).map(move |x| y * 65 + x));
            let expected: Vec<u32> = expected.map(|at| picture.index[at as usize]).collect();
            assert_eq!(found, Some(expected), "{area:?}");
        }
        assert!(picture.index.iter().filter(|index| **index != u32::MAX).count() > 1000);
        let none = largest(splats.as_slice(), &camera, [5, 5, 5, 9], &Rules::PUBLISHED, never);
        assert_eq!(none, Some(Vec::new()));
    }

    #[test]
    fn extreme_splats_leave_no_value_that_is_not_finite() {
        let scales = [(-30f64).exp(), 1e-3, 1.0, 20f64.exp()];
        let mut splats = Vec::new();
        for (i, a) in scales.iter().enumerate() {
            for b in scales {
                for opacity in [0.0, 1.0 / 255.0, 1.0] {
                    let angle = i as f64;
                    let mut splat = ball(0.21 + splats.len() as f64 * 0.1, *a, opacity);
                    splat.scale = [*a, b, 1e-2];
                    splat.rotation = [angle.cos(), angle.sin(), 0.0, 0.0];
                    splat.sh[3] = [1e4, -1e4, 0.0];
                    splats.push(splat);
                }
            }
        }
        for (rule, value) in [
            ("near", "0.2"),
            ("low_pass", "none"),
            ("low_pass", "0.3*compensated"),
            ("alpha_floor", "0"),
            ("order", "pixel"),
        ] {
            let mut rules = Rules::PUBLISHED;
            rules.set(rule, value).unwrap();
            let picture = draw(&splats, &rules);
            assert!(picture.color.iter().flatten().all(|v| v.is_finite()), "{rule} = {value}");
            assert!(picture.transmittance.iter().all(|t| (0.0..=1.0).contains(t)), "{rule} = {value}");
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let splats: Vec<Gaussian> = (0..300)
            .map(|i| {
                let t = f64::from(i);
                let mut splat = ball(3.0 + (t * 0.7).sin(), 0.05 + 0.1 * (t * 1.3).cos().abs(), 0.4);
                (splat.position[0], splat.position[1]) = ((t * 0.37).sin(), (t * 0.91).cos());
                splat
            })
            .collect();
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| draw(&splats, &Rules::PUBLISHED))
        };
        assert_eq!(with(1), with(3));
    }
}
