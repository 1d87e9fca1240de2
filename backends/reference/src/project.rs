//! Projects a Gaussian in the world to a coloured ellipse on the image.
//!
//! The 2D covariance is `M M^T + l I`, with `M` the 2 x 3 product of Jacobian, view rotation, rotation and scales, and
//! `l` the low-pass variance. For needles and giants, the textbook forms of its determinant and exponent suffer from
//! cancellation. Two stable forms keep them exact:
//!
//! - the determinant is `|r0 x r1|^2 + l (|r0|^2 + |r1|^2) + l^2`, with `r0`, `r1` the rows of `M` (Cauchy-Binet), a
//!   sum of positive terms. `a c - b^2` is a small difference of large numbers;
//! - the exponent is minus half a sum of two squares, from the Cholesky factor of the covariance, so it is never
//!   positive. (The rasteriser skips exponents above 0: in exact arithmetic there are none.)

use crate::gaussian::{Gaussian, Splats};
use crate::harmonics;
use crate::lens::Lens;
use crate::order::{self, View};
use crate::rules::{Extent, KeyOf, LowPass, Order, Rules};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use splatgraph_assets::{Camera, Projection};

/// Side of a tile of the rasteriser, in pixels (`BLOCK_X` and `BLOCK_Y` of its config.h).
pub(crate) const TILE: u32 = 16;

/// Number of splats projected between checks for cancellation.
pub(crate) const CHUNK: usize = 4096;

#[derive(Clone, Debug)]
pub(crate) struct Ellipse {
    /// Index among the splats.
    pub index: u32,
    /// The sort key, view depth or distance: see [`Rules::key_of`].
    pub depth: f64,
    /// Tiles that the splat touches: first column and row, then end column and row (exclusive).
    pub tiles: [u32; 4],
    pub footprint: Footprint,
    /// The depth in the picture, under [`Order::Pixel`]: at the centre, and its change per pixel to the right and down.
    plane: [f64; 3],
    /// Unit vector along the shortest axis, in world space, towards the camera; the first axis if several are equally
    /// short.
    pub normal: [f64; 3],
}

/// Bytes per visible splat that [`Projector::sorted`] needs: an ellipse in a chunk's list, and one in the list of all.
pub(crate) const SPLAT_BYTES: usize = 2 * size_of::<Ellipse>();

/// Counts the splats that touch a tile of the image.
pub(crate) fn visible_count(splats: &(impl Splats + ?Sized), camera: &Camera, rules: &Rules) -> usize {
    let projector = Projector::new(camera, rules, splats.is_wide());
    let touches = |index: &usize| {
        let mut touches = false;
        projector.project_onto(*index as u32, &splats.get(*index), |_| {
            touches = true;
            // The colour is not needed.
            false
        });
        touches
    };
    (0..splats.count()).into_par_iter().filter(touches).count()
}

impl Ellipse {
    /// Returns the depth of the splat at a pixel where it has a fragment, under [`Order::Pixel`].
    pub(crate) fn depth_at(&self, x: f64, y: f64) -> f64 {
        let [depth, across, down] = self.plane;
        let dx = self.footprint.across(x).unwrap_or(0.0);
        depth + across * dx + down * (y - self.footprint.center[1])
    }
}

/// The falloff and the colour of a splat on the image.
#[derive(Clone, Debug)]
pub(crate) struct Footprint {
    /// Centre, in pixels; pixels are sampled at integer positions, the first at (0, 0).
    pub center: [f64; 2],
    /// Coefficients of the exponent `-0.5 ((u dx)^2 + (v (dy - s dx))^2)`, with `d` the offset from the centre.
    u: f64,
    s: f64,
    v: f64,
    /// Opacity at the centre, including the low-pass filter's compensation.
    pub opacity: f64,
    /// Minimum exponent of a fragment. Below it, alpha is under the floor or the pixel is outside the extent.
    cutoff: f64,
    /// The copies of the splat in a panorama, whose left and right edges meet; `None` for other cameras.
    turn: Option<Turn>,
    pub color: [f64; 3],
}

/// The copies of a splat in a panorama, a picture's width apart. A pixel sees the nearest one.
#[derive(Clone, Copy, Debug)]
struct Turn {
    /// Width of the picture, in pixels.
    width: f64,
    /// Half the width of the rectangle whose tiles a splat touches; infinite under [`Extent::Unbounded`].
    half: f64,
}

impl Turn {
    /// Returns the horizontal offset, in pixels, of a pixel at `x` from the nearest copy of a centre. `None` outside
    /// the copy's tiles.
    fn offset(self, x: f64, center: f64) -> Option<f64> {
        let center = center + self.width * ((x - center) / self.width).round();
        let tile = f64::from(TILE);
        let first = ((center - self.half) / tile).floor() * tile;
        let end = ((center + self.half + tile - 1.0) / tile).floor() * tile;
        (first <= x && x < end).then_some(x - center)
    }
}

impl Footprint {
    /// Returns the alpha at a pixel of the splat's tiles, after the cap; `None` if the splat has no fragment there.
    #[inline]
    pub(crate) fn alpha(&self, x: f64, y: f64, rules: &Rules) -> Option<f64> {
        let dx = self.across(x)?;
        let dy = y - self.center[1];
        let (p, q) = (self.u * dx, self.v * (dy - self.s * dx));
        let exponent = -0.5 * (p * p + q * q);
        // Outside the extent, or so far from the centre that the test below would fail: no exponential is needed.
        if exponent < self.cutoff {
            return None;
        }
        let alpha = (self.opacity * exponent.exp()).min(rules.alpha_cap);
        (alpha >= rules.alpha_floor).then_some(alpha)
    }

    /// Returns the horizontal offset of a pixel from the centre, or from its nearest copy; `None` outside its tiles.
    #[inline]
    fn across(&self, x: f64) -> Option<f64> {
        match self.turn {
            None => Some(x - self.center[0]),
            Some(turn) => turn.offset(x, self.center[0]),
        }
    }

    /// Returns the plane of [`Ellipse::depth_at`], from the depth of the centre and its covariances with the position in
    /// the picture: the mean depth of a Gaussian at given x and y is linear in them.
    fn plane(&self, depth: f64, [with_x, with_y]: [f64; 2]) -> [f64; 3] {
        let (p, q) = (self.u * with_x, self.v * (with_y - self.s * with_x));
        [depth, self.u * p - self.v * self.s * q, self.v * q]
    }

    /// Returns the 2D covariance: xx, xy, yy, in square pixels.
    pub(crate) fn covariance(&self) -> [f64; 3] {
        let xx = (self.u * self.u).recip();
        [xx, self.s * xx, (self.v * self.v).recip() + self.s * self.s * xx]
    }

    /// Returns the determinant of the 2D covariance, without cancellation.
    pub(crate) fn determinant(&self) -> f64 {
        (self.u * self.v).powi(-2)
    }
}

pub(crate) struct Projector<'a> {
    view: View,
    lens: Lens,
    camera: &'a Camera,
    rules: &'a Rules,
    /// Number of tiles across and down.
    pub grid: [u32; 2],
}

impl<'a> Projector<'a> {
    /// Prepares to project for a camera; `wide` is true if f32 is too coarse for the positions.
    pub(crate) fn new(camera: &'a Camera, rules: &'a Rules, wide: bool) -> Self {
        let grid = [camera.width, camera.height].map(|side| side.div_ceil(TILE));
        Self { view: View::new(camera, wide), lens: Lens::new(camera, rules), camera, rules, grid }
    }

    pub(crate) fn width(&self) -> usize {
        self.camera.width as usize
    }

    /// Projects all splats whose tiles are `wanted`, and sorts them, near to far. `None` once `cancelled` returns true;
    /// several threads call it, every few thousand splats.
    pub(crate) fn sorted(
        &self,
        splats: &(impl Splats + ?Sized),
        wanted: impl Fn([u32; 4]) -> bool + Sync,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Ellipse>> {
        let chunk = |chunk: usize| -> Option<Vec<Ellipse>> {
            if cancelled() {
                return None;
            }
            let end = splats.count().min((chunk + 1) * CHUNK);
            let project = |index: usize| self.project_onto(index as u32, &splats.get(index), &wanted);
            Some((chunk * CHUNK..end).filter_map(project).collect())
        };
        let chunks = (0..splats.count().div_ceil(CHUNK)).into_par_iter().map(chunk);
        let mut ellipses = chunks.collect::<Option<Vec<_>>>()?.concat();
        order::sort(&mut ellipses, self.rules, |ellipse| (ellipse.depth, ellipse.index));
        Some(ellipses)
    }

    /// Projects a splat; `None` if it is culled, degenerate or touches no tile.
    pub(crate) fn project(&self, index: u32, splat: &Gaussian) -> Option<Ellipse> {
        self.project_onto(index, splat, |_| true)
    }

    /// Projects a splat as [`Projector::project`] does. Also returns `None` if `wanted` rejects its tiles, without
    /// computing its colour.
    pub(crate) fn project_onto(
        &self,
        index: u32,
        splat: &Gaussian,
        wanted: impl FnOnce([u32; 4]) -> bool,
    ) -> Option<Ellipse> {
        let depth = self.view.key(splat.position, self.rules)?;
        let view = self.view.point(splat.position);
        let center = self.lens.pixel(view);
        let [r0, r1, r2] = self.axes(view, splat);
        let low_pass = self.rules.low_pass.variance();
        let (a0, b, c0) = (r0.length_squared(), r0.dot(r1), r1.length_squared());
        let (a, c) = (a0 + low_pass, c0 + low_pass);
        let sharp_det = r0.cross(r1).length_squared();
        let det = sharp_det + low_pass * (a0 + c0) + low_pass * low_pass;
        if !(det > 0.0 && det.is_finite() && center.iter().all(|v| v.is_finite())) {
            return None;
        }
        let opacity = match self.rules.low_pass {
            LowPass::None | LowPass::Dilate(_) => splat.opacity,
            LowPass::Compensated(_) => splat.opacity * (sharp_det / det).sqrt(),
        };
        // The exponent at which alpha falls below the floor; slightly lower, because the test on alpha decides.
        let floor = (self.rules.alpha_floor / opacity).ln() - 1e-9;
        let cutoff = match self.rules.extent {
            Extent::Tiles | Extent::Unbounded => floor,
            Extent::Sigma(sigma) => floor.max(-0.5 * sigma * sigma),
        };
        let tiles = self.tiles(center, a, c, det).filter(|tiles| wanted(*tiles))?;
        let footprint = Footprint {
            center,
            u: 1.0 / a.sqrt(),
            s: b / a,
            v: (a / det).sqrt(),
            opacity,
            cutoff,
            turn: self.lens.turn().map(|width| Turn { width, half: self.half_extent(a, c, det)[0] }),
            color: harmonics::color(&splat.sh, splat.position, self.camera.position, self.rules),
        };
        let plane = match self.rules.order {
            Order::Centre => [depth, 0.0, 0.0],
            Order::Pixel => footprint.plane(depth, [r0.dot(r2), r1.dot(r2)]),
        };
        Some(Ellipse { index, depth, tiles, footprint, plane, normal: self.normal(splat) })
    }

    fn normal(&self, splat: &Gaussian) -> [f64; 3] {
        let [a, b, c] = splat.scale;
        let shortest = if c < a.min(b) { 2 } else { usize::from(b < a) };
        let axis = rotation(splat).col(shortest);
        let from_camera = match self.camera.projection {
            Projection::Orthographic => self.view.rotation.row(2),
            _ => DVec3::from(splat.position) - DVec3::from(self.camera.position),
        };
        let towards_camera = if axis.dot(from_camera) > 0.0 { -axis } else { axis };
        towards_camera.into()
    }

    /// Returns the two rows of `M = J W R S`, whose columns are the splat's three axes on the image, in pixels, and the
    /// depths of these axes, by the derivative of the sort key. Source: `computeCov2D` and `computeCov3D` in
    /// forward.cu.
    fn axes(&self, view: [f64; 3], splat: &Gaussian) -> [DVec3; 3] {
        let rotation = rotation(splat);
        // The columns of W R S: the splat's axes in view space.
        let [x, y, z] = [0, 1, 2].map(|axis| self.view.rotation * (rotation.col(axis) * splat.scale[axis]));
        let axes = DMat3::from_cols(x, y, z).transpose();
        let [across, down] = self.lens.jacobian(view).map(DVec3::from);
        let away = match self.rules.key_of {
            KeyOf::Depth => DVec3::Z,
            KeyOf::Distance => DVec3::from(view).normalize(),
        };
        [across, down, away].map(|row| axes * row)
    }

    /// Returns half the width and height of the rectangle whose tiles the splat touches.
    fn half_extent(&self, a: f64, c: f64, det: f64) -> [f64; 2] {
        match self.rules.extent {
            // `preprocessCUDA` in forward.cu: the discriminant is floored at 0.1.
            Extent::Tiles => {
                let middle = 0.5 * (a + c);
                let largest = middle + (middle * middle - det).max(0.1).sqrt();
                [(3.0 * largest.sqrt()).ceil(); 2]
            }
            // The bounding box of the ellipse extends sigma standard deviations in each coordinate. One pixel more: the
            // rasteriser's rounding in `tiles` loses the last pixel of a half extent that is not a whole number.
            Extent::Sigma(sigma) => [a, c].map(|variance| sigma * variance.sqrt() + 1.0),
            Extent::Unbounded => [f64::INFINITY; 2],
        }
    }

    /// Returns the range of tiles that the splat may touch; `None` if it is empty. In a panorama, a splat within a tile
    /// of the left or right edge, or beyond it, gets all columns; each pixel then finds the copy that it sees.
    fn tiles(&self, center: [f64; 2], a: f64, c: f64, det: f64) -> Option<[u32; 4]> {
        let half = self.half_extent(a, c, det);
        let tile = f64::from(TILE);
        let edge =
            |value: f64, axis: usize| (value / tile).trunc().clamp(0.0, f64::from(self.grid[axis])) as u32;
        let mut first: [u32; 2] = std::array::from_fn(|i| edge(center[i] - half[i], i));
        let mut end: [u32; 2] = std::array::from_fn(|i| edge(center[i] + half[i] + tile - 1.0, i));
        if let Some(width) = self.lens.turn()
            && (center[0] - half[0] < tile || center[0] + half[0] > width - tile)
        {
            (first[0], end[0]) = (0, self.grid[0]);
        }
        (first[0] < end[0] && first[1] < end[1]).then_some([first[0], first[1], end[0], end[1]])
    }
}

fn rotation(splat: &Gaussian) -> DMat3 {
    let [w, x, y, z] = splat.rotation;
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w))
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Projection;

    #[test]
    fn every_pixel_within_the_extent_in_sigmas_has_a_fragment_wherever_the_tiles_end() {
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (48, 48));
        for projection in [Projection::Pinhole, Projection::Equirectangular] {
            let camera = Camera { projection, ..camera.clone() };
            for (step, sigma) in (0..400).flat_map(|step| [1.0, 1.5, 3.0].map(|sigma| (step, sigma))) {
                let rules = Rules { extent: Extent::Sigma(sigma), ..Rules::PUBLISHED };
                let projector = Projector::new(&camera, &rules, false);
                // Across the tiles' edges, in steps of a fraction of a pixel.
                let at = f64::from(step - 200) * 0.004;
                let splat = Gaussian {
                    position: [at, 0.7 * at, 2.0],
                    rotation: [1.0, 0.0, 0.0, 0.0],
                    scale: [1e-4; 3],
                    opacity: 1.0,
                    sh: [[0.0; 3]; 16],
                };
                let Some(ellipse) = projector.project(0, &splat) else { panic!("a splat in the picture") };
                let [x0, y0, x1, y1] = ellipse.tiles.map(|edge| edge * TILE);
                let reach = sigma * ellipse.footprint.covariance()[0].sqrt();
                for (x, y) in (0..48u32).flat_map(|y| (0..48u32).map(move |x| (x, y))) {
                    let [dx, dy] = [0, 1].map(|i| f64::from([x, y][i]) - ellipse.footprint.center[i]);
                    let listed = (x0..x1).contains(&x) && (y0..y1).contains(&y);
                    let drawn =
                        listed && ellipse.footprint.alpha(f64::from(x), f64::from(y), &rules).is_some();
                    assert_eq!(
                        drawn,
                        dx.hypot(dy) <= reach,
                        "{sigma} sigmas of {:?} at {x}, {y}",
                        ellipse.footprint.center
                    );
                }
            }
        }
    }
}
