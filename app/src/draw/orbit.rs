//! Moves cameras around a point, and turns cameras towards a point.
//!
//! [`turned`] rotates about the camera's own vertical axis, because the up direction of most captures is unknown.

use glam::{DMat3, DQuat, DVec3};
use splatgraph_assets::Camera;
use std::f64::consts::TAU;

/// Moves a camera around a point by an angle, about the camera's vertical axis.
///
/// The point stays at its position in the picture. A positive angle, in degrees, moves the camera to its left.
pub fn turned(camera: &Camera, around: [f64; 3], degrees: f64) -> Camera {
    let axis = DVec3::from(camera.axes()[1]).normalize_or(DVec3::Y);
    moved_by(camera, around, DQuat::from_axis_angle(axis, degrees.to_radians()))
}

fn moved_by(camera: &Camera, around: [f64; 3], turn: DQuat) -> Camera {
    let around = DVec3::from(around);
    let position = around + turn * (DVec3::from(camera.position) - around);
    with_axes(camera, position, camera.axes().map(|axis| turn * DVec3::from(axis)))
}

/// Turns a camera so that it looks along the horizon, upright with respect to `up`, and keeps its heading.
///
/// The heading of a view straight down is the picture's upward direction; that of a view straight up, the downward one.
pub fn levelled(camera: &Camera, up: [f64; 3]) -> Camera {
    let up = DVec3::from(up).normalize_or(DVec3::NEG_Y);
    let [_, down, forward] = camera.axes().map(DVec3::from);
    let heading = if forward.cross(up).length() > 1e-6 { forward } else { forward.dot(up) * down };
    let ahead = (heading - heading.dot(up) * up).normalize();
    with_axes(camera, camera.position.into(), [(-up).cross(ahead), -up, ahead])
}

/// Computes the angle of a camera's view above the horizon, in degrees; negative below it.
pub fn pitch(camera: &Camera, up: [f64; 3]) -> f64 {
    let up = DVec3::from(up).normalize_or(DVec3::NEG_Y);
    90.0 - DVec3::from(camera.axes()[2]).angle_between(up).to_degrees()
}

/// Computes the angle between the picture's upward direction and `up`, in degrees.
pub fn tilt(camera: &Camera, up: [f64; 3]) -> f64 {
    let up = DVec3::from(up).normalize_or(DVec3::NEG_Y);
    (-DVec3::from(camera.axes()[1])).angle_between(up).to_degrees()
}

/// A circular motion of a camera around an axis through a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Orbit {
    /// Camera at the start.
    pub start: Camera,
    /// Point on the axis. It stays at its position in the picture.
    pub around: [f64; 3],
    /// Direction of the axis, of any length. A zero vector means up, -y.
    pub axis: [f64; 3],
}

impl Orbit {
    /// Makes a circle of constant y that starts at `start`, around the point of its viewing axis nearest to `middle`.
    ///
    /// If `middle` is behind the camera, the circle is around `middle` itself.
    pub fn before(start: Camera, middle: [f64; 3]) -> Orbit {
        let (position, forward) = (DVec3::from(start.position), DVec3::from(start.axes()[2]));
        let ahead = (DVec3::from(middle) - position).dot(forward);
        let around = if ahead > 0.0 { (position + ahead * forward).into() } else { middle };
        Orbit { start, around, axis: [0.0, -1.0, 0.0] }
    }

    /// Computes the camera after `turns` turns about the axis, by the right-hand rule; 1 is a full circle.
    pub fn at(&self, turns: f64) -> Camera {
        let axis = DVec3::from(self.axis).normalize_or(DVec3::NEG_Y);
        moved_by(&self.start, self.around, DQuat::from_axis_angle(axis, TAU * turns))
    }
}

/// Computes the angle of the rotation between two cameras, in degrees from 0 to 180.
pub fn turn_between(from: &Camera, to: &Camera) -> f64 {
    let axes = |camera: &Camera| DMat3::from_cols_array_2d(&camera.axes());
    // Accurate for small angles, unlike an arc cosine.
    let turn = DQuat::from_mat3(&(axes(to) * axes(from).transpose()));
    2.0 * turn.xyz().length().atan2(turn.w.abs()).to_degrees()
}

/// Turns a camera towards a point, which is then in the middle of the picture, and zooms by a factor.
///
/// Keeps the roll. The size is that of the new picture, in pixels.
pub fn facing(camera: &Camera, target: [f64; 3], zoom: f64, (width, height): (u32, u32)) -> Camera {
    let [right, down, forward] = camera.axes().map(DVec3::from);
    let position = DVec3::from(camera.position);
    let forward = (DVec3::from(target) - position).normalize_or(forward);
    let right = down.cross(forward).normalize_or(right);
    let factor = zoom * f64::from(width) / f64::from(camera.width);
    let turned = with_axes(camera, position, [right, forward.cross(right), forward]);
    Camera {
        width,
        height,
        fx: camera.fx * factor,
        fy: camera.fy * factor,
        principal_offset: [0.0; 2],
        ..turned
    }
}

fn with_axes(camera: &Camera, position: DVec3, [right, down, forward]: [DVec3; 3]) -> Camera {
    let rotation = DMat3::from_cols(right, down, forward).transpose().to_cols_array_2d();
    Camera { position: position.into(), rotation, ..camera.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 3], b: [f64; 3]) -> bool {
        (0..3).all(|i| (a[i] - b[i]).abs() < 1e-12)
    }

    #[test]
    fn a_turned_camera_sees_the_point_in_the_same_place() {
        let camera = Camera::looking_at([1.0, -2.0, 3.0], [0.5, 0.0, 0.0], 60.0, (64, 48));
        let point = [0.2, 0.1, -0.3];
        let moved = turned(&camera, point, 30.0);
        assert_eq!(moved.fault(), None);
        assert!(close(camera.to_view(point), moved.to_view(point)), "{moved:?}");
        assert!(camera.to_view(moved.position)[0] < -1.0, "to the left: {moved:?}");
        let back = turned(&moved, point, -30.0);
        assert!(close(back.position, camera.position) && close(back.rotation[0], camera.rotation[0]));
    }

    #[test]
    fn a_circle_before_a_camera_keeps_its_height_and_what_it_looks_at() {
        let start = Camera::looking_at([0.0, -1.0, -4.0], [0.0, 0.0, 0.0], 60.0, (64, 48));
        let orbit = Orbit::before(start.clone(), [2.0, 0.0, 0.0]);
        assert!(close(orbit.around, [0.0; 3]), "{orbit:?}");
        assert!(close(orbit.at(0.5).position, [0.0, -1.0, 4.0]), "{:?}", orbit.at(0.5));
        assert_eq!(Orbit::before(start, [2.0, 0.0, -9.0]).around, [2.0, 0.0, -9.0]);
    }

    #[test]
    fn the_angle_between_two_cameras_is_that_of_the_turn_however_small_and_about_any_axis() {
        let camera = Camera::looking_at([1.0, -2.0, 3.0], [0.5, 0.0, 0.0], 60.0, (64, 48));
        for degrees in [0.0, 1e-4, 0.25, -30.0, 179.0] {
            let found = turn_between(&camera, &turned(&camera, [0.2, 0.1, -0.3], degrees));
            assert!((found - f64::abs(degrees)).abs() < 1e-9, "{degrees}: {found}");
        }
        let moved = Camera { position: [9.0; 3], ..camera.clone() };
        assert_eq!(turn_between(&camera, &moved), 0.0);
    }

    #[test]
    fn a_camera_that_faces_a_point_has_it_in_the_middle_and_larger() {
        let camera = Camera::looking_at([1.0, -2.0, 3.0], [0.5, 0.0, 0.0], 60.0, (64, 48));
        let facing = facing(&camera, [5.0, 1.0, 0.0], 3.0, (32, 24));
        assert_eq!(facing.fault(), None);
        let [x, y, z] = facing.to_view([5.0, 1.0, 0.0]);
        assert!(x.abs() < 1e-12 && y.abs() < 1e-12 && z > 0.0);
        assert!((facing.fx - 1.5 * camera.fx).abs() < 1e-12 && facing.height == 24);
    }
}
