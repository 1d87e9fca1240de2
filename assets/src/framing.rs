//! Creates cameras that frame a scene.

use crate::camera::Camera;
use crate::report::NEAR;
use crate::scene::{FileNotes, Scene};
use std::f64::consts::TAU;

impl Camera {
    /// Creates a camera that frames most of a scene; see [`Camera::framing_upright`].
    pub fn framing(scene: &Scene, width: u32, height: u32) -> Self {
        Self::framing_upright(scene, scene.up(), None, (width, height))
    }

    /// Creates a camera that frames most of a scene, upright with respect to the vector `up`, of any length. Its
    /// position is relative to [`Scene::offset`].
    ///
    /// It looks along +z and 12 degrees down (+y), rotated so that `up` is up, from a distance at which the box
    /// [`Scene::robust_bounds`] fits with a margin of 8 %, but at least 1 unit, or as near as the near plane allows if
    /// `fov` is given. `fov` is the horizontal field of view, in degrees below 180; `None` for 60 degrees across the
    /// longer side, or less for a scene that would be small at a distance of 1 unit.
    pub fn framing_upright(scene: &Scene, up: [f64; 3], fov: Option<f64>, size: (u32, u32)) -> Self {
        Self::framing_turns(scene, up, fov, size, 1)
    }

    /// Creates a camera like [`Camera::framing_upright`], but farther away if an orbit needs it. The box fits in every
    /// picture of an orbit around the axis `up`.
    pub fn framing_around(scene: &Scene, up: [f64; 3], fov: Option<f64>, size: (u32, u32)) -> Self {
        Self::framing_turns(scene, up, fov, size, 120)
    }

    /// Creates a camera far enough to show the scene at each of `turns` equal steps around the axis `up`.
    fn framing_turns(
        scene: &Scene,
        up: [f64; 3],
        fov: Option<f64>,
        (width, height): (u32, u32),
        turns: u32,
    ) -> Self {
        /// Downward slope of the view, in degrees.
        const PITCH: f64 = 12.0;
        /// Share of the image that the box may fill.
        const FILL: f64 = 0.92;
        /// Minimum distance without `fov`: the scene is then beyond the near plane, with room to move the camera.
        const CLOSEST: f64 = 1.0;
        /// Maximum enlargement of a scene at the minimum distance. Above it, positions are too coarse in f32.
        const MAX_ZOOM: f64 = 1e5;
        let (width, height) = (width.max(1), height.max(1));
        let bounds = scene.robust_bounds();
        let center = glam::DVec3::from(bounds.center());
        let focal = match fov {
            Some(fov) => 0.5 * f64::from(width) / (0.5 * fov).to_radians().tan(),
            None => 0.5 * f64::from(width.max(height)) / 30f64.to_radians().tan(),
        };
        let horizontal = 2.0 * (0.5 * f64::from(width) / focal).atan().to_degrees();
        let forward = glam::DVec3::new(0.0, PITCH.to_radians().sin(), PITCH.to_radians().cos());
        let forward = match glam::DVec3::from(up).try_normalize() {
            Some(up) if up != FileNotes::UP.into() => {
                glam::DQuat::from_rotation_arc(glam::DVec3::NEG_Y, up) * forward
            }
            _ => forward,
        };
        let mut camera = Self::looking_at_upright([0.0; 3], forward.into(), up, horizontal, (width, height));
        let [tan_x, tan_y] = [width, height].map(|side| FILL * 0.5 * f64::from(side) / focal);
        let axis = glam::DVec3::from(up).normalize_or(glam::DVec3::NEG_Y);
        let corners: Vec<[f64; 3]> = (0..turns)
            .map(|turn| glam::DQuat::from_axis_angle(axis, TAU * f64::from(turn) / f64::from(turns)))
            .flat_map(|turn| {
                bounds.corners().map(|corner| turn * (glam::DVec3::from(corner) - center)).map(Into::into)
            })
            .collect();
        // The smallest distance at which every corner is inside the view frustum.
        let distance = corners.iter().fold(0.0, |distance: f64, corner| {
            let v = camera.to_view(*corner);
            distance.max(v[0].abs() / tan_x - v[2]).max(v[1].abs() / tan_y - v[2])
        });
        let reach = corners.iter().map(|corner| -camera.to_view(*corner)[2]).fold(0.0, f64::max);
        let closest = if fov.is_some() { CLOSEST.min(1.1 * (NEAR + reach)) } else { CLOSEST };
        if distance < CLOSEST && fov.is_none() {
            // Splats can extend far beyond the box of their centres, so the box gets a margin of 3 standard deviations.
            let margin = 3.0 * f64::from(scene.median_size());
            let share = corners.iter().fold(0.0, |share: f64, corner| {
                let [x, y, z] = camera.to_view(*corner);
                share.max(((x.abs() + margin) / tan_x).max((y.abs() + margin) / tan_y) / (CLOSEST + z))
            });
            // A scene without any extent keeps the usual field of view.
            let zoom = if share > 0.0 { (1.0 / share).clamp(1.0, MAX_ZOOM) } else { 1.0 };
            (camera.fx, camera.fy) = (zoom * camera.fx, zoom * camera.fy);
        }
        camera.position = (center - forward * distance.max(closest)).into();
        camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Splat;
    use crate::testing::splat;

    #[test]
    fn a_small_scene_fills_the_framing_camera_from_beyond_the_near_plane() {
        let small = |size: f32, sigma: f32| {
            Scene::generate(500, 0, |i| Splat {
                position: splat(i).position.map(|v| size * v),
                scale: [sigma; 3],
                ..splat(i)
            })
        };
        let share = |scene: &Scene| {
            let camera = Camera::framing(scene, 96, 54);
            assert_eq!((camera.fault(), camera.fx), (None, camera.fy));
            scene.robust_bounds().corners().into_iter().fold(0.0, |share: f64, corner| {
                let [x, y, z] = camera.to_view(corner);
                assert!(z > 0.2);
                share.max((x / z * camera.fx / 48.0).abs()).max((y / z * camera.fy / 27.0).abs())
            })
        };
        for size in [10.0, 1.0, 0.1, 1e-3, 1e-4] {
            let found = share(&small(size, 0.0));
            assert!((0.91..0.93).contains(&found), "{size}: {found}");
        }
        let large_splats = small(0.001, 0.01);
        assert!(share(&large_splats) < 0.1, "the splats fit into the picture, not only their centres");
        let unit = 48.0 / 30f64.to_radians().tan();
        let huge_splats = Camera::framing(&small(0.001, 10.0), 96, 54);
        assert!((huge_splats.fx / unit - 1.0).abs() < 1e-12, "the view is never wider than 60 degrees");
    }

    #[test]
    fn the_framing_camera_sees_every_corner_of_the_bulk_and_looks_down_a_little() {
        let scene = Scene::generate(5000, 0, splat);
        for (width, height) in [(960, 540), (300, 700)] {
            let camera = Camera::framing(&scene, width, height);
            assert_eq!(camera.fault(), None);
            let mut widest = 0.0f64;
            for corner in scene.robust_bounds().corners() {
                let [x, y, z] = camera.to_view(corner);
                assert!(z > 0.2);
                let (x, y) = (
                    x / z * camera.fx / (0.5 * f64::from(width)),
                    y / z * camera.fy / (0.5 * f64::from(height)),
                );
                widest = widest.max(x.abs()).max(y.abs());
            }
            assert!((0.9..0.93).contains(&widest), "{widest}");
            let forward = camera.axes()[2];
            assert!(forward[2] > 0.9 && forward[1] > 0.1, "{forward:?}");
        }
        for up in [[0.0, 0.0, 3.0], [0.0, 0.5, 0.0], [-1.0, 0.0, 0.0]] {
            let camera = Camera::framing_upright(&scene, up, None, (960, 540));
            let [_, down, forward] = camera.axes().map(glam::DVec3::from);
            let up = glam::DVec3::from(up).normalize();
            assert!(down.dot(up) < -0.9 && forward.dot(up) < -0.1, "{up}: {down} {forward}");
        }
    }
}
