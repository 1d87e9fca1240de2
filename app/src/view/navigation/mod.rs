//! Moves the viewer's camera by pointer and keys.
//!
//! [`Navigation`] takes the input since the last update ([`Input`]) and returns a camera ([`Navigation::camera`]). The
//! camera looks at its *pivot*, a point straight ahead at a stored distance:
//!
//! | input | effect |
//! |---|---|
//! | drag (left or middle button), arrow keys | orbit about the pivot, as on a turntable: the horizon keeps its tilt |
//! | Shift + drag | pan: points at the pivot's depth follow the pointer |
//! | scroll, Ctrl + drag up and down | zoom to or from the pivot, never through it; orthographic: change the scale |
//! | hold the right button | fly: look around; W A S D, E up, Q down; Shift faster, Ctrl slower, scroll for the speed |
//! | double click, F | frame the scene, seen from the same direction |
//! | Home | return to the first camera |
//!
//! Positions are in world units, in f64. The axes follow [`splatgraph_assets::Camera`]: x right, y down, z forward. The
//! camera stays finite and orthonormal for any input.

use glam::{DMat3, DQuat, DVec2, DVec3};
use splatgraph_assets::{Bounds, Camera, NEAR, Projection};
use std::ops::RangeInclusive;

#[cfg(test)]
mod tests;

/// Default up direction: in the camera convention of the 3DGS reference, y points down.
pub const DEFAULT_UP: DVec3 = DVec3::NEG_Y;

/// Range of the vertical field of view that can be set, in degrees.
pub const FIELDS_OF_VIEW: RangeInclusive<f64> = 5.0..=150.0;

/// Default of [`Navigation::flight_seconds`].
const FLIGHT_SECONDS: f64 = 0.35;
/// Rotation by a drag (orbiting or looking around), in radians per point of pointer motion.
const TURN_PER_POINT: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Angular speed of orbiting with the arrow keys, in radians per second.
const TURN_PER_SECOND: f64 = std::f64::consts::FRAC_PI_3;
/// Maximum elevation of orbiting and looking around, in radians; beyond the pole, left and right would be swapped.
const STEEPEST: f64 = 89.9 * std::f64::consts::PI / 180.0;
/// Zoom per notch of the wheel: it divides the distance by `e` to this power.
pub const ZOOM_PER_NOTCH: f64 = 0.15;
/// Zoom per point of a drag, as an exponent of `e`.
const ZOOM_PER_POINT: f64 = 0.01;
/// Limits of zooming: minimum and maximum distance to the pivot, or height of an orthographic view, in scene sizes.
const DISTANCES: (f64, f64) = (1e-6, 1e4);
/// Distance from the scene's centre beyond which input moves the camera no farther, in scene sizes.
const FARTHEST: f64 = 1e6;
/// Initial speed of flying, in scene sizes per second.
const FLY_SPEED: f64 = 0.2;
/// Factor by which one notch of the wheel changes the flying speed.
const SPEED_PER_NOTCH: f64 = 1.2;
/// Minimum and maximum of the factor on [`FLY_SPEED`] that the wheel sets.
const SPEEDS: (f64, f64) = (1e-3, 1e3);
/// Factor on the flying speed while Shift is held; its inverse applies while Ctrl is held.
const HURRY: f64 = 4.0;
/// A camera is upside down if the cosine between its down and the world's up exceeds this. The cosine is 0 for a
/// camera that looks straight up or down.
const UPSIDE_DOWN: f64 = 1e-3;
/// Share of the viewport that a framed scene may fill.
const FILL: f64 = 0.92;

/// The user's input since the last [`Navigation::update`], excluding drags that began on a panel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Width and height of the view, in points.
    pub size: [f64; 2],
    /// Motion of the pointer, in points: right and down.
    pub moved: [f64; 2],
    /// True while the pointer drags: it orbits, with Shift pans, with Ctrl zooms.
    pub drags: bool,
    /// True while the camera flies: the pointer looks around, and `fly` moves it.
    pub flies: bool,
    /// True while Shift is held.
    pub shift: bool,
    /// True while Ctrl is held.
    pub ctrl: bool,
    /// Notches of the wheel, positive away from the user.
    pub scroll: f64,
    /// Direction of the flying keys: to the right, up and forward, each from -1 to 1.
    pub fly: [f64; 3],
    /// Direction in which the orbiting keys move the camera: to the right and down, each from -1 to 1.
    pub orbit: [f64; 2],
    /// True to frame the scene (F, or a double click).
    pub frame: bool,
    /// True to return to the first camera (Home).
    pub home: bool,
    /// Seconds since the last update; more than 1 counts as 1.
    pub seconds: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    position: DVec3,
    /// Rotation from the camera's axes to the world's, as a unit quaternion.
    orientation: DQuat,
    /// Tangent of half the vertical field of view.
    tan_y: f64,
    /// Ratio of the horizontal focal length to the vertical one, in pixels: 1 for square pixels.
    stretch: f64,
    /// Offset of the principal point from the middle of the picture, relative to its height.
    principal_offset: DVec2,
    /// Distance to the pivot, in world units.
    distance: f64,
    /// Factor on the scale of the picture; 1 unless an orthographic view is moved or zoomed.
    magnification: f64,
    /// Projection of the camera. The other fields are those of the pinhole camera with the same view.
    projection: Projection,
}

impl Pose {
    fn right(&self) -> DVec3 {
        self.orientation * DVec3::X
    }

    fn down(&self) -> DVec3 {
        self.orientation * DVec3::Y
    }

    fn forward(&self) -> DVec3 {
        self.orientation * DVec3::Z
    }

    fn pivot(&self) -> DVec3 {
        self.position + self.distance * self.forward()
    }

    /// Turns the camera about its pivot if `about_pivot`, otherwise in place; keeps its roll against the horizon.
    ///
    /// `yaw` is about the world's up, positive to the left seen from above; `pitch` is upwards. Both are in radians.
    /// For an upside-down camera, left and up are relative to its image.
    fn turned(mut self, up: DVec3, yaw: f64, pitch: f64, about_pivot: bool) -> Pose {
        let sense = if self.down().dot(up) > UPSIDE_DOWN { -1.0 } else { 1.0 };
        let (yaw, pitch) = (sense * yaw, sense * pitch);
        let (pivot, forward) = (self.pivot(), self.forward());
        let elevation = forward.dot(up).clamp(-1.0, 1.0).asin();
        // Clamps the new elevation: a camera that starts beyond the limit moves back to it.
        let pitch = (elevation + pitch).clamp(-STEEPEST, STEEPEST) - elevation;
        // Axis to the right along the horizon. If the camera looks straight up or down, the image's right is used.
        let horizontal = forward.cross(up);
        let axis = if horizontal.length() > 1e-6 { horizontal } else { self.right() };
        let turn = DQuat::from_axis_angle(up, yaw) * DQuat::from_axis_angle(axis.normalize(), pitch);
        self.orientation = (turn * self.orientation).normalize();
        if about_pivot {
            self.position = pivot - self.distance * self.forward();
        }
        self
    }

    /// Multiplies the distance to the pivot by `e` to the power of `exponent`, within [`DISTANCES`] times `scale`. A
    /// distance outside these limits can only move towards them.
    fn zoomed(mut self, exponent: f64, scale: f64) -> Pose {
        let pivot = self.pivot();
        let (nearest, farthest) = (DISTANCES.0 * scale, DISTANCES.1 * scale);
        // If the camera is already farther away, zooming may not move it further.
        let farthest = farthest.max(self.distance);
        self.distance = (self.distance * exponent.exp()).clamp(nearest.min(self.distance), farthest);
        self.position = pivot - self.distance * self.forward();
        self
    }

    /// Interpolates from this pose at `t = 0` to another at `t = 1`, with the projection of `to`. The pivot moves in a
    /// straight line; the distance is interpolated geometrically.
    fn towards(&self, to: &Pose, t: f64) -> Pose {
        let geometric = |a: f64, b: f64| a * (b / a).powf(t);
        let pivot = self.pivot().lerp(to.pivot(), t);
        let orientation = self.orientation.slerp(to.orientation, t).normalize();
        let distance = geometric(self.distance, to.distance);
        Pose {
            position: pivot - distance * (orientation * DVec3::Z),
            orientation,
            tan_y: geometric(self.tan_y, to.tan_y),
            stretch: geometric(self.stretch, to.stretch),
            principal_offset: self.principal_offset.lerp(to.principal_offset, t),
            distance,
            magnification: geometric(self.magnification, to.magnification),
            projection: to.projection,
        }
    }
}

/// Destination of a flight. On arrival, `camera` is shown unchanged, if there is one.
#[derive(Clone, Debug, PartialEq)]
struct Goal {
    pose: Pose,
    camera: Option<Camera>,
}

#[derive(Clone, Debug)]
struct Flight {
    from: Pose,
    to: Goal,
    /// Seconds since the flight's first update; `None` before it, so that idle time does not count.
    seconds: Option<f64>,
}

/// The state of the viewer's camera; see the module's documentation.
#[derive(Clone, Debug)]
pub struct Navigation {
    pose: Pose,
    /// Camera that was set, until it is first moved, so that its picture uses exactly its numbers.
    unmoved: Option<Camera>,
    flight: Option<Flight>,
    start: Camera,
    /// True if the user set the field of view after the last camera was selected. `home` then keeps it.
    own_field_of_view: bool,
    up: DVec3,
    bounds: Bounds,
    /// Size of the scene, in world units. [`DISTANCES`], [`FARTHEST`] and [`FLY_SPEED`] are multiples of it.
    scale: f64,
    /// Factor on [`FLY_SPEED`], set by the wheel.
    speed: f64,
    /// Duration of a flight to another camera, in seconds; 0 to jump.
    pub flight_seconds: f64,
    /// True while the graph draws an orthographic view.
    orthographic: bool,
}

impl Navigation {
    /// Creates a navigation that starts at the camera `start`.
    ///
    /// `bounds` is the box around most of the scene's splats ([`splatgraph_assets::Scene::robust_bounds`]). `up` may
    /// have any length; [`DEFAULT_UP`] replaces a vector without a direction.
    pub fn new(bounds: &Bounds, start: &Camera, up: DVec3) -> Navigation {
        let (bounds, scale) = usable(bounds);
        let Goal { pose, camera } = goal_of(start, &bounds, scale);
        Navigation {
            pose,
            unmoved: camera,
            flight: None,
            start: start.clone(),
            own_field_of_view: false,
            up: up.try_normalize().unwrap_or(DEFAULT_UP),
            bounds,
            scale,
            speed: 1.0,
            flight_seconds: FLIGHT_SECONDS,
            orthographic: false,
        }
    }

    /// Returns the up direction, of length 1.
    pub fn up(&self) -> DVec3 {
        self.up
    }

    /// Sets the up direction; a vector without a direction is ignored. The camera stays in place.
    pub fn set_up(&mut self, up: DVec3) {
        self.up = up.try_normalize().unwrap_or(self.up);
    }

    /// Continues in another scene with the same view and first camera. `moved` is the motion of the scene's origin, in
    /// world units. The flying speed changes with the scene's size.
    ///
    /// `bounds` is as in [`Navigation::new`]. An orthographic view keeps its height.
    pub fn change_scene(&mut self, bounds: &Bounds, moved: DVec3) {
        let height = self.height();
        (self.bounds, self.scale) = usable(bounds);
        let move_goal = |goal: &mut Goal| {
            goal.pose.position -= moved;
            goal.camera = goal.camera.take().map(|camera| camera.relative_to(moved.into()));
        };
        if let Some(flight) = &mut self.flight {
            flight.from.position -= moved;
            move_goal(&mut flight.to);
        }
        let mut now = Goal { pose: self.pose, camera: self.unmoved.take() };
        move_goal(&mut now);
        (self.pose, self.unmoved) = (now.pose, now.camera);
        self.start = self.start.relative_to(moved.into());
        if self.orthographic {
            self.pose = self.scaled(self.pose, height);
        }
    }

    /// Sets whether the graph draws an orthographic view. Zooming then changes only the scale, because the near plane
    /// would cut into the scene if the camera moved closer; moving the camera keeps the scale.
    ///
    /// With false, a camera whose scale was changed moves to where the perspective picture has this scale at the pivot.
    pub fn set_orthographic(&mut self, orthographic: bool) {
        self.orthographic = orthographic;
        if !orthographic && self.pose.magnification != 1.0 {
            let exponent = -self.pose.magnification.ln();
            self.pose = Pose { magnification: 1.0, ..self.pose }.zoomed(exponent, self.scale);
        }
    }

    /// Returns the height of the orthographic view, in world units.
    pub fn height(&self) -> f64 {
        self.height_of(&self.pose)
    }

    /// Sets the height of the orthographic view, in world units, and ends a flight. The height is limited to
    /// `DISTANCES` times the scene's size; NaN is ignored.
    pub fn set_height(&mut self, height: f64) {
        if !height.is_nan() {
            (self.flight, self.unmoved) = (None, None);
            self.pose = self.scaled(self.pose, height);
        }
    }

    fn height_of(&self, pose: &Pose) -> f64 {
        let camera = self.camera_at(pose, 1, 1);
        1.0 / camera.with_projection(Projection::Orthographic, self.bounds.center()).fy
    }

    fn scaled(&self, pose: Pose, height: f64) -> Pose {
        let (least, most) = (DISTANCES.0 * self.scale, DISTANCES.1 * self.scale);
        let now = self.height();
        let height = height.clamp(least.min(now), most.max(now));
        Pose { magnification: pose.magnification * self.height_of(&pose) / height, ..pose }
    }

    /// Returns true during a flight: the next update moves the camera even without input.
    pub fn is_moving(&self) -> bool {
        self.flight.is_some()
    }

    /// Returns the flying speed without Shift and Ctrl, in world units per second.
    pub fn fly_speed(&self) -> f64 {
        FLY_SPEED * self.speed * self.scale
    }

    /// Returns the point that the camera orbits, in world units.
    pub fn pivot(&self) -> DVec3 {
        self.pose.pivot()
    }

    /// Returns the vertical field of view, in degrees.
    pub fn field_of_view(&self) -> f64 {
        2.0 * self.pose.tan_y.atan().to_degrees()
    }

    /// Sets the vertical field of view, in degrees, clamped to [`FIELDS_OF_VIEW`]; NaN is ignored. The camera stays in
    /// place.
    ///
    /// Framing the scene and returning to the first camera keep it; selecting a camera replaces it.
    pub fn set_field_of_view(&mut self, degrees: f64) {
        if degrees.is_nan() {
            return;
        }
        let degrees = degrees.clamp(*FIELDS_OF_VIEW.start(), *FIELDS_OF_VIEW.end());
        self.own_field_of_view = true;
        let tan_y = (0.5 * degrees.to_radians()).tan();
        if let Some(flight) = &mut self.flight {
            (flight.from.tan_y, flight.to.pose.tan_y, flight.to.camera) = (tan_y, tan_y, None);
        }
        (self.pose.tan_y, self.unmoved) = (tan_y, None);
    }

    /// Returns the current camera for a picture of this size; a length of 0 counts as 1.
    ///
    /// Until input moves it, a camera that was set is only [resized](Camera::resized): at its own size, it is
    /// bit-identical. A moved camera keeps its projection. If it is orthographic, its scale is that of
    /// [`Navigation::height`].
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        let (width, height) = (width.max(1), height.max(1));
        if let Some(camera) = &self.unmoved {
            return camera.resized(width, height);
        }
        self.camera_at(&self.pose, width, height)
    }

    fn camera_at(&self, pose: &Pose, width: u32, height: u32) -> Camera {
        let fy = 0.5 * f64::from(height) / pose.tan_y * pose.magnification;
        let pinhole = Camera {
            id: 0,
            img_name: String::new(),
            width,
            height,
            position: pose.position.into(),
            rotation: DMat3::from_quat(pose.orientation).transpose().to_cols_array_2d(),
            fx: fy * pose.stretch,
            fy,
            principal_offset: (pose.principal_offset * f64::from(height)).into(),
            projection: Projection::Pinhole,
        };
        pinhole.rounded().with_projection(pose.projection, self.bounds.center())
    }

    /// Flies to a camera, or jumps if flights are disabled, and takes over its vertical field of view. In a wider
    /// window, the view shows more at the sides. Invalid values of the camera are replaced by defaults.
    ///
    /// The pivot becomes the point of the camera's axis that is nearest to the scene's centre. If that is not ahead,
    /// the pivot is one scene size ahead.
    pub fn set_camera(&mut self, camera: &Camera) {
        self.own_field_of_view = false;
        let goal = self.goal_of(camera);
        self.go_to(goal);
    }

    /// Jumps to a camera, without a flight; otherwise as [`Navigation::set_camera`].
    pub fn jump_to(&mut self, camera: &Camera) {
        self.own_field_of_view = false;
        let goal = self.goal_of(camera);
        self.arrive(goal);
    }

    /// Returns true if the current view, or during a flight its destination, is this camera's view.
    pub fn shows(&self, camera: &Camera) -> bool {
        let pose = self.flight.as_ref().map_or(&self.pose, |flight| &flight.to.pose);
        // The distance to the pivot is not part of the view.
        Pose { distance: pose.distance, ..self.goal_of(camera).pose } == *pose
    }

    /// Frames the scene's bounds, with the same direction and field of view. `size` is the view's; only its aspect
    /// ratio matters.
    pub fn frame(&mut self, size: [f64; 2]) {
        let goal = Goal { pose: self.framing(size), camera: None };
        self.go_to(goal);
    }

    /// Flies to the first camera, with the field of view that the user set, if any.
    pub fn home(&mut self) {
        let mut goal = self.goal_of(&self.start);
        if self.own_field_of_view {
            // During a flight, its destination has the field of view that the user set.
            let tan_y = self.flight.as_ref().map_or(self.pose.tan_y, |flight| flight.to.pose.tan_y);
            (goal.pose.tan_y, goal.camera) = (tan_y, None);
        }
        self.go_to(goal);
    }

    /// Applies the input; returns true if the camera moved.
    ///
    /// A flight to another camera ends early if the input moves the camera.
    pub fn update(&mut self, input: &Input) -> bool {
        let before = (self.pose, self.unmoved.is_some());
        let input = Input {
            moved: input.moved.map(finite),
            scroll: finite(input.scroll),
            fly: input.fly.map(finite),
            orbit: input.orbit.map(finite),
            seconds: finite(input.seconds).clamp(0.0, 1.0),
            ..*input
        };
        if input.home {
            self.home();
        } else if input.frame {
            self.frame(input.size);
        }
        let pose = self.steered(&input);
        if pose != self.pose {
            self.flight = None;
            self.unmoved = None;
            let height = self.height() * self.pose.magnification / pose.magnification;
            let pose = self.confined(pose);
            self.pose = if self.orthographic { self.scaled(pose, height) } else { pose };
        } else {
            self.fly_on(input.seconds);
        }
        before != (self.pose, self.unmoved.is_some())
    }

    fn steered(&mut self, input: &Input) -> Pose {
        let (mut pose, up, scale) = (self.pose, self.up, self.scale);
        let [x, y] = input.moved;
        let mut zoom = 0.0;
        if input.flies {
            self.speed = (self.speed * SPEED_PER_NOTCH.powf(input.scroll)).clamp(SPEEDS.0, SPEEDS.1);
            if input.moved != [0.0; 2] {
                pose = pose.turned(up, -TURN_PER_POINT * x, -TURN_PER_POINT * y, false);
            }
            let [right, rise, ahead] = input.fly;
            let direction = ahead * pose.forward() + right * pose.right() + rise * up;
            let hurry = HURRY.powf(f64::from(input.shift) - f64::from(input.ctrl));
            pose.position += direction.normalize_or_zero() * (hurry * self.fly_speed() * input.seconds);
        } else {
            let drag = input.drags && input.moved != [0.0; 2];
            if drag && input.shift {
                // World units per point at the pivot's depth. A view without a height does not move the camera.
                let height = finite(input.size[1]);
                let shown = if self.orthographic { self.height() } else { 2.0 * pose.tan_y * pose.distance };
                let length = if height > 0.0 { shown / height } else { 0.0 };
                pose.position -= length * (x / pose.stretch * pose.right() + y * pose.down());
            } else if drag && input.ctrl {
                zoom += ZOOM_PER_POINT * y;
            } else if drag {
                pose = pose.turned(up, -TURN_PER_POINT * x, -TURN_PER_POINT * y, true);
            }
            zoom -= ZOOM_PER_NOTCH * input.scroll;
        }
        if self.orthographic {
            // Bounded, so that the view's height stays finite.
            pose.magnification *= (-zoom).clamp(-99.0, 99.0).exp();
        } else if zoom != 0.0 {
            pose = pose.zoomed(zoom, scale);
        }
        let [yaw, pitch] = input.orbit.map(|direction| direction * TURN_PER_SECOND * input.seconds);
        if yaw != 0.0 || pitch != 0.0 {
            pose = pose.turned(up, yaw, pitch, true);
        }
        pose
    }

    /// Limits the pose's distance from the scene, to preserve precision.
    fn confined(&self, mut pose: Pose) -> Pose {
        let middle = DVec3::from(self.bounds.center());
        let away = pose.position - middle;
        // Not the Euclidean length: the square of a very long vector would overflow.
        let longest = |vector: DVec3| vector.abs().max_element();
        let length = longest(away);
        let farthest = (FARTHEST * self.scale).max(longest(self.pose.position - middle));
        if !away.is_finite() {
            pose.position = self.pose.position;
        } else if length > farthest {
            pose.position = middle + away / length * farthest;
        }
        pose
    }

    fn goal_of(&self, camera: &Camera) -> Goal {
        goal_of(camera, &self.bounds, self.scale)
    }

    fn framing(&self, size: [f64; 2]) -> Pose {
        // During a flight, use the direction of its destination.
        let mut pose = self.flight.as_ref().map_or(self.pose, |flight| flight.to.pose);
        (pose.principal_offset, pose.magnification) = (DVec2::ZERO, 1.0);
        let [width, height] = size.map(|side| finite(side).clamp(1.0, 1e6));
        let tan_y = FILL * pose.tan_y;
        let tan_x = tan_y * width / height / pose.stretch;
        let middle = DVec3::from(self.bounds.center());
        // Distance at which every corner is inside the frustum and beyond the near plane.
        let far_enough = self.bounds.corners().into_iter().fold(0.0, |distance: f64, corner| {
            let corner = DVec3::from(corner) - middle;
            let (x, y, z) = (corner.dot(pose.right()), corner.dot(pose.down()), corner.dot(pose.forward()));
            distance.max(x.abs() / tan_x - z).max(y.abs() / tan_y - z).max(1.1 * NEAR - z)
        });
        pose.distance = far_enough;
        pose.position = middle - far_enough * pose.forward();
        pose
    }

    fn go_to(&mut self, to: Goal) {
        if self.flight_seconds > 0.0 && to.pose != self.pose {
            self.flight = Some(Flight { from: self.pose, to, seconds: None });
            self.unmoved = None;
        } else {
            self.arrive(to);
        }
    }

    fn fly_on(&mut self, seconds: f64) {
        let Some(flight) = &mut self.flight else { return };
        let passed = flight.seconds.map_or(0.0, |passed| passed + seconds);
        flight.seconds = Some(passed);
        let part = passed / self.flight_seconds;
        if part < 1.0 {
            // Cubic Hermite interpolation, with zero velocity at both ends.
            self.pose = flight.from.towards(&flight.to.pose, part * part * (3.0 - 2.0 * part));
        } else if let Some(flight) = self.flight.take() {
            self.arrive(flight.to);
        }
    }

    fn arrive(&mut self, goal: Goal) {
        self.flight = None;
        self.pose = goal.pose;
        self.unmoved = goal.camera;
    }
}

/// Returns the view of a camera; see [`Navigation::set_camera`]. `bounds` and `scale` are those of the scene.
fn goal_of(camera: &Camera, bounds: &Bounds, scale: f64) -> Goal {
    let rotation = DMat3::from_cols_array_2d(&camera.rotation).transpose();
    // A camera from a file has a valid rotation; one made by code may not.
    let error = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array();
    let sound = error.iter().all(|v| v.abs() < 0.02) && rotation.determinant() > 0.0;
    let orientation = if sound { DQuat::from_mat3(&rotation).normalize() } else { DQuat::IDENTITY };
    let position = DVec3::from(camera.position);
    let placed = position.is_finite() && position.abs().max_element() < 1e30;
    let position = if placed { position } else { DVec3::ZERO };
    let usable = |v: f64| (1e-6..1e6).contains(&v);
    let pinhole = camera.with_projection(Projection::Pinhole, bounds.center());
    let tan_y = 0.5 * f64::from(pinhole.height) / pinhole.fy;
    let stretch = camera.fx / camera.fy;
    let principal_offset = DVec2::from(camera.principal_offset) / f64::from(camera.height);
    let near = principal_offset.abs().max_element() < 1e6;
    let whole = sound && placed && usable(tan_y) && usable(stretch) && near;
    let mut pose = Pose {
        position,
        orientation,
        tan_y: if usable(tan_y) { tan_y } else { 30f64.to_radians().tan() },
        stretch: if usable(stretch) { stretch } else { 1.0 },
        principal_offset: if near { principal_offset } else { DVec2::ZERO },
        distance: scale,
        magnification: 1.0,
        projection: camera.projection,
    };
    let ahead = (DVec3::from(bounds.center()) - position).dot(pose.forward());
    if ahead > 1e-3 * scale {
        pose.distance = ahead;
    }
    Goal { pose, camera: whole.then(|| camera.clone()) }
}

/// Returns the bounds, or a point if they are not finite; and their size, limited, or 1 for a point.
fn usable(bounds: &Bounds) -> (Bounds, f64) {
    let finite = bounds.min.iter().chain(&bounds.max).all(|v| v.is_finite());
    let bounds = if finite { *bounds } else { Bounds::ORIGIN };
    // A single point has no size. Beyond these limits, squares overflow f32 or lose digits.
    let scale = match bounds.extent() {
        extent if extent > 0.0 => extent.clamp(1e-12, 1e18),
        _ => 1.0,
    };
    (bounds, scale)
}

fn finite(value: f64) -> f64 {
    // Bounded, so that products of a few values stay finite.
    if value.is_nan() { 0.0 } else { value.clamp(-1e9, 1e9) }
}
