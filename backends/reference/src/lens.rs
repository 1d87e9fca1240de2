//! Projects points and their neighbourhood to the image: the camera's projection and its derivative.
//!
//! EWA splatting replaces the projection by its derivative at the splat's centre, the Jacobian. For a pinhole, it is
//! the rasteriser's Jacobian. The others follow from their definitions in [`Projection`].

use crate::rules::Rules;
use splatgraph_assets::{Camera, Projection};
use std::f64::consts::FRAC_PI_2;

/// Minimum of the sine of the angle from the axis in the Jacobian of a fisheye camera, beyond 90 degrees. Straight
/// behind the camera, a splat covers a ring in the picture, which no ellipse approximates: within 14.5 degrees of that
/// direction it is drawn narrower than it is.
const MIN_SINE: f64 = 0.25;

/// Minimum of the cosine of the latitude in the Jacobian of an equirectangular camera. A splat at a pole covers the
/// picture's whole width; the minimum keeps it from being infinitely wide.
const MIN_COSINE: f64 = 1e-3;

/// The map from view space to the image of one camera.
pub(crate) struct Lens {
    projection: Projection,
    /// Pixels per unit of x / z (pinhole), per world unit (orthographic) or per radian (others): [`Camera::focal`].
    focal: [f64; 2],
    size: [f64; 2],
    /// Principal point, in pixels right and down from the image's centre: [`Camera::principal_offset`].
    principal_offset: [f64; 2],
    /// Tangents of half the fields of view, for a pinhole.
    tan: [f64; 2],
    jacobian_clamp: Option<f64>,
    pixel_offset: f64,
}

impl Lens {
    pub(crate) fn new(camera: &Camera, rules: &Rules) -> Lens {
        let size = [camera.width, camera.height].map(f64::from);
        Lens {
            projection: camera.projection,
            focal: camera.focal(),
            size,
            principal_offset: camera.principal_offset,
            tan: [size[0] / camera.fx, size[1] / camera.fy].map(|v| 0.5 * v),
            jacobian_clamp: rules.jacobian_clamp,
            pixel_offset: rules.pixel_offset,
        }
    }

    /// Returns the width of the image, in pixels, if its left and right edges meet; otherwise `None`.
    pub(crate) fn turn(&self) -> Option<f64> {
        (self.projection == Projection::Equirectangular).then_some(self.size[0])
    }

    /// Returns the pixel position of a point in view space. For a pinhole, it is `((ndc + 1) size - 1) / 2` (`ndc2Pix`
    /// in auxiliary.h) plus [`Camera::principal_offset`] and [`Rules::pixel_offset`].
    pub(crate) fn pixel(&self, p: [f64; 3]) -> [f64; 2] {
        let [x, y, z] = p;
        let from_middle = match self.projection {
            Projection::Pinhole => {
                let ndc = [x / (self.tan[0] * z), y / (self.tan[1] * z)];
                return std::array::from_fn(|i| {
                    0.5 * ((ndc[i] + 1.0) * self.size[i] - 1.0) + self.principal_offset[i] + self.pixel_offset
                });
            }
            Projection::Orthographic => [x, y],
            Projection::Fisheye => {
                let Polar { angle, around, .. } = Polar::of(p);
                around.map(|v| angle * v)
            }
            Projection::Equirectangular => [x.atan2(z), y.atan2(x.hypot(z))],
        };
        std::array::from_fn(|i| {
            self.focal[i] * from_middle[i]
                + 0.5 * (self.size[i] - 1.0)
                + self.principal_offset[i]
                + self.pixel_offset
        })
    }

    /// Returns the rows of the Jacobian: the derivative of [`Lens::pixel`] with respect to the point.
    ///
    /// For a pinhole, `x / z` and `y / z` are clamped by [`Rules::jacobian_clamp`] (`computeCov2D` in forward.cu), as
    /// far beyond each edge of the picture as with the principal point in the middle.
    pub(crate) fn jacobian(&self, p: [f64; 3]) -> [[f64; 3]; 2] {
        let [x, y, z] = p;
        let [fx, fy] = self.focal;
        match self.projection {
            Projection::Pinhole => {
                let slope = |axis: usize| {
                    let (slope, middle) = (p[axis] / z, -self.principal_offset[axis] / self.focal[axis]);
                    match self.jacobian_clamp.map(|limit| limit * self.tan[axis]) {
                        Some(limit) => slope.clamp(middle - limit, middle + limit),
                        None => slope,
                    }
                };
                [[fx / z, 0.0, -fx * slope(0) / z], [0.0, fy / z, -fy * slope(1) / z]]
            }
            Projection::Orthographic => [[fx, 0.0, 0.0], [0.0, fy, 0.0]],
            Projection::Fisheye => {
                // The unit vectors of the polar angle and of the azimuth.
                let Polar { distance, angle, around: [c, s] } = Polar::of(p);
                let (sine, cosine) = angle.sin_cos();
                let outwards = [cosine * c, cosine * s, -sine].map(|v| v / distance);
                let stretch = match angle {
                    0.0 => 1.0,
                    _ if angle > FRAC_PI_2 => angle / sine.max(MIN_SINE),
                    _ => angle / sine,
                };
                let sideways = [-s, c, 0.0].map(|v| v * stretch / distance);
                [
                    std::array::from_fn(|i| fx * (c * outwards[i] - s * sideways[i])),
                    std::array::from_fn(|i| fy * (s * outwards[i] + c * sideways[i])),
                ]
            }
            Projection::Equirectangular => {
                // The unit vectors of longitude and latitude.
                let distance = length(p);
                let (sin_lon, cos_lon) = x.atan2(z).sin_cos();
                let (sin_lat, cos_lat) = y.atan2(x.hypot(z)).sin_cos();
                let across = fx / (distance * cos_lat.max(MIN_COSINE));
                [
                    [across * cos_lon, 0.0, -across * sin_lon],
                    [-sin_lat * sin_lon, cos_lat, -sin_lat * cos_lon].map(|v| fy * v / distance),
                ]
            }
        }
    }
}

/// A point in view space, in polar coordinates around the camera's axis.
struct Polar {
    distance: f64,
    /// Angle from the axis, 0 to pi.
    angle: f64,
    /// Unit vector in the picture from the axis towards the point; to the right for points on the axis.
    around: [f64; 2],
}

impl Polar {
    fn of(p: [f64; 3]) -> Polar {
        let [x, y, z] = p;
        let from_axis = x.hypot(y);
        let around = if from_axis > 0.0 { [x / from_axis, y / from_axis] } else { [1.0, 0.0] };
        Polar { distance: length(p), angle: from_axis.atan2(z), around }
    }
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    x.hypot(y).hypot(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens(projection: Projection) -> Lens {
        let camera = Camera {
            fx: 90.0,
            fy: 70.0,
            projection,
            ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (361, 181))
        };
        Lens::new(&camera, &Rules { jacobian_clamp: None, ..Rules::PUBLISHED })
    }

    #[test]
    fn points_are_where_each_projection_is_defined_to_put_them() {
        let at = |projection, p| lens(projection).pixel(p).map(|v| (v * 1e6).round() / 1e6);
        let half = std::f64::consts::FRAC_PI_2;
        let rounded = |v: f64| (v * 1e6).round() / 1e6;
        for projection in Projection::ALL {
            assert_eq!(
                at(projection, [0.0, 0.0, 3.0]),
                [180.0, 90.0],
                "{projection}: the axis is in the middle"
            );
        }
        assert_eq!(at(Projection::Orthographic, [1.0, -0.5, 7.0]), [270.0, 55.0], "at any depth");
        assert_eq!(at(Projection::Fisheye, [2.0, 0.0, 0.0]), [rounded(180.0 + 90.0 * half), 90.0]);
        assert_eq!(at(Projection::Fisheye, [0.0, 1.0, -1.0]), [180.0, rounded(90.0 + 70.0 * 1.5 * half)]);
        // A pixel is 360 / 361 degrees wide, and 180 / 181 high.
        assert_eq!(at(Projection::Equirectangular, [2.0, 0.0, 0.0]), [rounded(180.0 + 361.0 / 4.0), 90.0]);
        assert_eq!(
            at(Projection::Equirectangular, [0.0, -5.0, 0.0])[1],
            rounded(90.0 - 181.0 / 2.0),
            "the top"
        );
    }

    #[test]
    fn the_clamp_of_the_jacobian_reaches_as_far_beyond_each_edge_wherever_the_principal_point_is() {
        // gsplat's limits, for a picture of 200 pixels with a focal length of 100 and cx = 160.
        let camera = Camera {
            principal_offset: [60.0, 0.0],
            fx: 100.0,
            ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (200, 100))
        };
        let lens = Lens::new(&camera, &Rules::PUBLISHED);
        assert_eq!(lens.pixel([0.0, 0.0, 2.0]), [159.5, 49.5]);
        let held = |slope: f64| -lens.jacobian([slope, 0.0, 1.0])[0][2] / camera.fx;
        for (slope, expected) in [(-9.0, -1.6 - 0.3), (-1.8, -1.8), (0.6, 0.6), (9.0, 0.4 + 0.3)] {
            assert!((held(slope) - expected).abs() < 1e-7, "{slope}: {}", held(slope));
        }
    }

    proptest! {
        #[test]
        fn the_jacobian_is_the_derivative_of_the_pixel_position(
            direction in prop::array::uniform3(-1.0..1.0f64), distance in 0.3..50.0f64,
        ) {
            let norm = length(direction);
            prop_assume!(norm > 0.1);
            let p = direction.map(|v| v * distance / norm);
            for projection in Projection::ALL {
                let near_limit = match projection {
                    Projection::Pinhole => p[2] < 0.1 * distance,
                    // Longitude jumps behind the camera.
                    Projection::Equirectangular => {
                        p[0].hypot(p[2]) < 0.05 * distance || (p[2] < 0.0 && p[0].abs() < 0.01 * distance)
                    }
                    Projection::Fisheye => p[2] < 0.0 && p[0].hypot(p[1]) < 0.26 * distance,
                    Projection::Orthographic => false,
                };
                if near_limit {
                    continue;
                }
                let lens = lens(projection);
                let jacobian = lens.jacobian(p);
                let step = 1e-6 * distance;
                for axis in 0..3 {
                    let moved = |by: f64| lens.pixel(std::array::from_fn(|i| if i == axis { p[i] + by } else { p[i] }));
                    let (after, before) = (moved(step), moved(-step));
                    for row in 0..2 {
                        let slope = (after[row] - before[row]) / (2.0 * step);
                        let scale = 1e-5 * (1.0 + 500.0 / distance);
                        prop_assert!((slope - jacobian[row][axis]).abs() < scale, "{projection} at {p:?}, {row} {axis}: {slope} {jacobian:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_jacobian_stays_finite_on_the_axis_behind_the_camera_and_at_the_poles() {
        for (projection, p) in [
            (Projection::Fisheye, [0.0, 0.0, 2.0]),
            (Projection::Fisheye, [0.0, 0.0, -2.0]),
            (Projection::Equirectangular, [0.0, 2.0, 0.0]),
            (Projection::Equirectangular, [0.0, -2.0, 0.0]),
        ] {
            let found = lens(projection).jacobian(p);
            assert!(found.as_flattened().iter().all(|v| v.is_finite()), "{projection} at {p:?}: {found:?}");
            assert!(lens(projection).pixel(p).iter().all(|v| v.is_finite()));
        }
    }
}
