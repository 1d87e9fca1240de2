//! Defines a camera, as in the `cameras.json` of the 3DGS reference implementation.
//!
//! A camera is a position, a rotation, a focal length, an image size and a principal point.
//! Position and rotation are camera-to-world, and the columns of the rotation are the camera's axes in the world: x
//! right, y down, z forward. Most cameras are pinholes; [`Projection`] lists the others.
//! [`Dataset`](crate::Dataset) reads camera files.

use crate::bounds::Bounds;
use crate::projection::Projection;
use crate::scene::Scene;
use crate::similarity::Similarity;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// A camera. Unknown fields of the file are ignored, but [`Dataset`](crate::Dataset) refuses a lens with distortion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Entry", into = "Entry")]
pub struct Camera {
    /// Number of the camera: `id` of a `cameras.json`, COLMAP's `IMAGE_ID`, the index of glTF's node or of a frame.
    pub id: i64,
    /// Name of the camera's photograph without its extension, or of glTF's node or camera; can be empty.
    pub img_name: String,
    /// Image width, in pixels.
    pub width: u32,
    /// Image height, in pixels.
    pub height: u32,
    /// Centre of projection, in world units.
    pub position: [f64; 3],
    /// Camera-to-world rotation, row by row; the columns are right, down and forward.
    pub rotation: [[f64; 3]; 3],
    /// Horizontal focal length, in the unit that [`Projection`] lists: pixels for a pinhole.
    pub fx: f64,
    /// Vertical focal length, in the unit of `fx`.
    pub fy: f64,
    /// Principal point, where the view's axis meets the image: right and down from the image's centre, in pixels. In an
    /// equirectangular image, it must be the centre.
    pub principal_offset: [f64; 2],
    /// Mapping from view space to the picture; pinhole if the file does not name it.
    pub projection: Projection,
}

/// A camera as it is in a file, with the principal point relative to the image's top left corner.
#[derive(Serialize, Deserialize)]
#[serde(rename = "Camera")]
pub(crate) struct Entry {
    #[serde(default)]
    id: i64,
    #[serde(default)]
    img_name: String,
    width: u32,
    height: u32,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    // Panoramas may lack both.
    fx: Option<f64>,
    fy: Option<f64>,
    // Left out for the image's centre, like in the files of the reference implementation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
    #[serde(default, skip_serializing_if = "Projection::is_pinhole")]
    projection: Projection,
    /// The other fields of the file.
    #[serde(flatten, skip_serializing)]
    others: Map<String, Value>,
}

impl Entry {
    /// Returns a field that is not one of a camera.
    pub(crate) fn other(&self, name: &str) -> Option<&Value> {
        self.others.get(name)
    }

    pub(crate) fn projection(&self) -> Projection {
        self.projection
    }
}

/// Finds the first non-zero number of a lens's distortion, and the name of its field; `None` if there is none. `field`
/// returns a field of a camera.
pub(crate) fn distortion<'a>(field: impl Fn(&str) -> Option<&'a Value>) -> Option<(&'static str, f64)> {
    const NAMES: [&str; 16] = [
        "k1",
        "k2",
        "k3",
        "k4",
        "k5",
        "k6",
        "p1",
        "p2",
        "distortion",
        "distortion_params",
        "distortion_coefficients",
        // Of Kalibr, of OpenCV's scripts, and of ROS.
        "distortion_coeffs",
        "dist_coeffs",
        "radial_distortion",
        "tangential_distortion",
        "D",
    ];
    fn nonzero(value: &Value) -> Option<f64> {
        match value {
            Value::Number(number) => number.as_f64().filter(|number| *number != 0.0),
            Value::String(text) => text.trim().parse().ok().filter(|number| *number != 0.0),
            Value::Array(list) => list.iter().find_map(nonzero),
            Value::Object(fields) => fields.values().find_map(nonzero),
            _ => None,
        }
    }
    NAMES.into_iter().find_map(|name| Some((name, nonzero(field(name)?)?)))
}

impl TryFrom<Entry> for Camera {
    type Error = String;

    fn try_from(entry: Entry) -> Result<Self, String> {
        let Entry { id, img_name, width, height, position, rotation, fx, fy, cx, cy, projection, .. } = entry;
        let principal_offset = Self::offset_of([cx, cy], [width, height]);
        let of_width =
            (projection == Projection::Equirectangular).then(|| f64::from(width) / std::f64::consts::TAU);
        let focal = |name: &str, given: Option<f64>| {
            given.or(of_width).ok_or_else(|| format!("missing field `{name}`"))
        };
        let (fx, fy) = (focal("fx", fx)?, focal("fy", fy)?);
        Ok(Self { id, img_name, width, height, position, rotation, fx, fy, principal_offset, projection })
    }
}

impl From<Camera> for Entry {
    fn from(camera: Camera) -> Self {
        let center = camera.principal_point();
        let [cx, cy] = [0, 1].map(|axis| (camera.principal_offset[axis] != 0.0).then_some(center[axis]));
        let Camera {
            id,
            img_name,
            width,
            height,
            position,
            rotation,
            fx,
            fy,
            principal_offset: _,
            projection,
        } = camera;
        Self {
            id,
            img_name,
            width,
            height,
            position,
            rotation,
            fx: Some(fx),
            fy: Some(fy),
            cx,
            cy,
            projection,
            others: Map::new(),
        }
    }
}

impl Camera {
    /// Maximum width and height of the image, in pixels. Commands that draw at the camera's own size allow less.
    pub const MAX_SIDE: u32 = 1 << 20;

    /// Creates a camera at `eye` that looks at `target`, upright in a world with y down.
    ///
    /// `horizontal_fov` is in degrees. For a view straight up or down, the camera's x axis is the world's.
    pub fn looking_at(eye: [f64; 3], target: [f64; 3], horizontal_fov: f64, size: (u32, u32)) -> Self {
        Self::looking_at_upright(eye, target, [0.0, -1.0, 0.0], horizontal_fov, size)
    }

    /// Creates a camera like [`Camera::looking_at`], upright with respect to the vector `up`, of any length.
    ///
    /// For a view along `up`, the camera's x axis is the world's x axis (or z, for a view near x), made perpendicular
    /// to the view.
    pub fn looking_at_upright(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        horizontal_fov: f64,
        (width, height): (u32, u32),
    ) -> Self {
        let eye = glam::DVec3::from(eye);
        let forward = (glam::DVec3::from(target) - eye).normalize_or(glam::DVec3::Z);
        let aside = if forward.x.abs() < 0.9 { glam::DVec3::X } else { glam::DVec3::Z };
        let along = (aside - forward * aside.dot(forward)).normalize();
        let right = (-glam::DVec3::from(up)).cross(forward).normalize_or(along);
        let down = forward.cross(right);
        let focal = 0.5 * f64::from(width) / (0.5 * horizontal_fov.to_radians()).tan();
        Self {
            id: 0,
            img_name: String::new(),
            width,
            height,
            position: eye.into(),
            rotation: glam::DMat3::from_cols(right, down, forward).transpose().to_cols_array_2d(),
            fx: focal,
            fy: focal,
            principal_offset: [0.0; 2],
            projection: Projection::Pinhole,
        }
    }

    /// Converts the camera from the world's coordinates to a scene's. `origin` is the scene's [`Scene::offset`].
    pub fn relative_to(&self, origin: [f64; 3]) -> Self {
        Self { position: std::array::from_fn(|axis| self.position[axis] - origin[axis]), ..self.clone() }
    }

    /// Converts the camera from a scene's coordinates to the world's. `origin` is the scene's [`Scene::offset`].
    pub fn in_world(&self, origin: [f64; 3]) -> Self {
        self.relative_to(origin.map(|v| -v))
    }

    /// Returns the camera's axes in world coordinates: right, down and forward.
    pub fn axes(&self) -> [[f64; 3]; 3] {
        std::array::from_fn(|axis| std::array::from_fn(|row| self.rotation[row][axis]))
    }

    /// Transforms a point from world to camera space: right, down and forward of the camera.
    pub fn to_view(&self, point: [f64; 3]) -> [f64; 3] {
        self.axes().map(|axis| (0..3).map(|i| axis[i] * (point[i] - self.position[i])).sum())
    }

    /// Returns the principal point, in pixels right and down from the image's top left corner.
    pub fn principal_point(&self) -> [f64; 2] {
        let [x, y] = self.principal_offset;
        [0.5 * f64::from(self.width) + x, 0.5 * f64::from(self.height) + y]
    }

    /// Converts a principal point's pixel position to [`Camera::principal_offset`]. A missing
    /// coordinate is the centre's.
    pub(crate) fn offset_of(center: [Option<f64>; 2], size: [u32; 2]) -> [f64; 2] {
        [0, 1].map(|axis| center[axis].map_or(0.0, |center| center - 0.5 * f64::from(size[axis])))
    }

    /// Rounds the principal point as a file does, so that the camera equals the one read back.
    #[must_use]
    pub fn rounded(self) -> Self {
        let principal_offset = Self::offset_of(self.principal_point().map(Some), [self.width, self.height]);
        Self { principal_offset, ..self }
    }

    /// Computes the minimum and maximum view depth of a box's corners; negative behind the camera.
    pub fn depth_range(&self, bounds: &Bounds) -> (f64, f64) {
        let depths = bounds.corners().map(|corner| self.to_view(corner)[2]);
        depths
            .into_iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(near, far), z| (near.min(z), far.max(z)))
    }

    /// Returns the distance to the centre of a box that is farther than `far` and outside the image.
    ///
    /// `None` for other boxes, and for fisheyes and panoramas, which see much of what is around them.
    pub fn distance_elsewhere(&self, bounds: &Bounds, far: f64) -> Option<f64> {
        let center = bounds.center();
        let distance = glam::DVec3::from(center).distance(self.position.into());
        let [x, y, z] = self.to_view(center);
        let scale = match self.projection {
            Projection::Pinhole => 1.0 / z,
            Projection::Orthographic => 1.0,
            Projection::Fisheye | Projection::Equirectangular => return None,
        };
        let radius = glam::DVec3::from(bounds.size()).length();
        let [cx, cy] = self.principal_point();
        let is_inside = |at: f64, focal: f64, middle: f64, side: u32| {
            let (pixel, margin) = (middle + at * scale * focal, radius * scale * focal);
            (-margin..=f64::from(side) + margin).contains(&pixel)
        };
        let is_seen =
            z > -radius && is_inside(x, self.fx, cx, self.width) && is_inside(y, self.fy, cy, self.height);
        (distance > far && !is_seen).then_some(distance)
    }

    /// Returns the camera with another image size and the same vertical field of view.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let factor = f64::from(height) / f64::from(self.height);
        let principal_offset = self.principal_offset.map(|v| v * factor);
        Self { width, height, fx: self.fx * factor, fy: self.fy * factor, principal_offset, ..self.clone() }
            .rounded()
    }

    /// Returns the camera with another image size and the same view. Its pixels may not be square.
    pub fn stretched(&self, width: u32, height: u32) -> Self {
        let [x, y] =
            [(width, self.width), (height, self.height)].map(|(to, from)| f64::from(to) / f64::from(from));
        let principal_offset = [self.principal_offset[0] * x, self.principal_offset[1] * y];
        Self { width, height, fx: self.fx * x, fy: self.fy * y, principal_offset, ..self.clone() }.rounded()
    }

    /// Converts a pinhole camera to another projection, with the same position and, except for a panorama, about the
    /// same view.
    ///
    /// A fisheye view keeps its scale at the picture's centre. An orthographic one keeps it at the distance of the
    /// centre of [`Scene::robust_bounds`]. Cameras with a projection other than pinhole are returned unchanged.
    pub fn projected(&self, projection: Projection, scene: &Scene) -> Camera {
        if !self.projection.is_pinhole() || projection.is_pinhole() {
            return self.clone();
        }
        self.with_projection(projection, scene.robust_bounds().center())
    }

    /// Converts the camera from any projection to another, as [`Camera::projected`] does. `center` is the centre of the
    /// scene's [`robust_bounds`](Scene::robust_bounds).
    pub fn with_projection(&self, projection: Projection, center: [f64; 3]) -> Camera {
        /// Minimum distance for the scale of an orthographic view, which would be infinite at the scene's centre.
        const MIN_DISTANCE: f64 = 0.2;
        if projection == self.projection {
            return self.clone();
        }
        let distance = || glam::DVec3::from(center).distance(self.position.into()).max(MIN_DISTANCE);
        let scale = match (self.projection, projection) {
            (_, Projection::Orthographic) => 1.0 / distance(),
            (Projection::Orthographic, _) => distance(),
            _ => 1.0,
        };
        let principal_offset =
            if projection == Projection::Equirectangular { [0.0; 2] } else { self.principal_offset };
        Camera { projection, fx: self.fx * scale, fy: self.fy * scale, principal_offset, ..self.clone() }
    }

    /// Returns the horizontal and vertical scale of the picture, in the units that [`Projection`] lists.
    ///
    /// An equirectangular camera's scale follows from its image size, in pixels per radian, and ignores `fx` and `fy`.
    pub fn focal(&self) -> [f64; 2] {
        match self.projection {
            Projection::Equirectangular => {
                [f64::from(self.width) / std::f64::consts::TAU, f64::from(self.height) / std::f64::consts::PI]
            }
            _ => [self.fx, self.fy],
        }
    }

    /// Replaces an inexact rotation, such as one with three decimals, by the nearest rotation, because it would scale
    /// depths. A rotation that is only rounded to f32 stays. A panorama's principal point becomes the middle.
    ///
    /// The camera must have no [`fault`](Self::fault).
    pub fn straighten(&mut self) {
        /// Maximum deviation that rounding to f32 leaves.
        const ROUNDING: f64 = 1e-5;
        let matrix = glam::DMat3::from_cols_array_2d(&self.rotation);
        let deviation = (matrix * matrix.transpose() - glam::DMat3::IDENTITY).to_cols_array();
        if deviation.iter().any(|v| v.abs() > ROUNDING) {
            // Newton's iteration for the polar decomposition (Higham 1986): each step squares the deviation.
            let step = |matrix: glam::DMat3, _| 0.5 * (matrix + matrix.inverse().transpose());
            self.rotation = (0..4).fold(matrix, step).to_cols_array_2d();
        }
        if self.projection == Projection::Equirectangular {
            self.principal_offset = [0.0; 2];
        }
    }

    /// Describes the first reason why the camera is unusable; `None` for a usable camera.
    ///
    /// Checks the image size, the focal lengths, the principal point, the position and the rotation. Renderers compute
    /// in f32, so the numbers must also be within limits that keep intermediate results in its range.
    pub fn fault(&self) -> Option<String> {
        /// Maximum deviation of the rotation from orthonormal. Some files have only three decimals.
        const TOLERANCE: f64 = 0.01;
        /// Minimum focal length, in pixels; its inverse is the maximum. Both, times 2^32 pixels, are within the range
        /// of f32.
        const MIN_FOCAL: f64 = 1e-20;
        if self.width == 0 || self.height == 0 {
            return Some(format!("the image is {} x {} pixels", self.width, self.height));
        }
        if self.width.max(self.height) > Self::MAX_SIDE {
            return Some(format!(
                "expected an image of at most {0} x {0} pixels, found {1} x {2}",
                Self::MAX_SIDE,
                self.width,
                self.height
            ));
        }
        for (name, focal) in [("fx", self.fx), ("fy", self.fy)] {
            if !(focal > 0.0 && focal.is_finite()) {
                return Some(format!("expected a positive {name}, found {focal}"));
            }
            if !(MIN_FOCAL..=1.0 / MIN_FOCAL).contains(&focal) {
                return Some(format!(
                    "expected {name} from {MIN_FOCAL:e} to {:e} pixels, found {focal:e}",
                    1.0 / MIN_FOCAL
                ));
            }
        }
        let (farthest, place) = match self.projection {
            // `straighten` puts it in the middle; (width - 1) / 2 is half a pixel aside.
            Projection::Equirectangular => (1.0, "within a pixel of the middle of a panorama".to_owned()),
            _ => (f64::from(Self::MAX_SIDE), format!("within {} pixels of the middle", Self::MAX_SIDE)),
        };
        for (axis, name) in ["cx", "cy"].into_iter().enumerate() {
            // The comparison is false for NaN.
            let within = self.principal_offset[axis].abs() <= farthest;
            if !within {
                let found = self.principal_point()[axis];
                return Some(format!("expected the principal point {place}, found {name} = {found}"));
            }
        }
        for (axis, value) in ["x", "y", "z"].into_iter().zip(self.position) {
            if value.is_nan() || value.abs() > Similarity::FARTHEST {
                return Some(format!(
                    "expected a position within {:e} of the origin, found {axis} = {value:e}",
                    Similarity::FARTHEST
                ));
            }
        }
        let axes = self.axes().map(glam::DVec3::from);
        for (i, a) in axes.iter().enumerate() {
            for (j, b) in axes.iter().enumerate().skip(i) {
                let (product, wanted) = (a.dot(*b), f64::from(i == j));
                // The comparison is false for NaN.
                let within = (product - wanted).abs() <= TOLERANCE;
                if !within {
                    return Some(format!(
                        "the rotation is not orthonormal: column {i} times column {j} is {product:.4}, expected {wanted}"
                    ));
                }
            }
        }
        if axes[0].cross(axes[1]).dot(axes[2]) < 0.0 {
            return Some("the rotation mirrors: its determinant is -1".into());
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::splat;

    #[test]
    fn looking_at_a_point_puts_it_on_the_axis_with_the_world_upright() {
        let camera = Camera::looking_at([1.0, -2.0, 3.0], [4.0, 1.0, -2.0], 90.0, (200, 100));
        assert_eq!(camera.fault(), None);
        let v = camera.to_view([4.0, 1.0, -2.0]);
        assert!(v[0].abs() < 1e-12 && v[1].abs() < 1e-12 && (v[2] - 43f64.sqrt()).abs() < 1e-12);
        assert!(camera.axes()[1][1] > 0.0, "down in the image is down in the world");
        assert!((camera.fx - 100.0).abs() < 1e-9);
    }

    #[test]
    fn a_rounded_rotation_becomes_the_nearest_one_and_one_in_f32_stays() {
        let exact = Camera::looking_at([1.0, -2.0, 3.0], [4.0, 1.0, -2.0], 90.0, (200, 100));
        let rounded = |to: &dyn Fn(f64) -> f64| {
            let mut camera = Camera { rotation: exact.rotation.map(|row| row.map(to)), ..exact.clone() };
            let before = camera.rotation;
            camera.straighten();
            (camera, before)
        };
        let (single, before) = rounded(&|v| f64::from(v as f32));
        assert_eq!(single.rotation, before);
        for coarse in [&|v: f64| (v * 1e3).round() / 1e3, &|v: f64| v * 1.004] as [&dyn Fn(f64) -> f64; 2] {
            let (camera, before) = rounded(coarse);
            assert_ne!(camera.rotation, before);
            let axes = camera.axes().map(glam::DVec3::from);
            assert!(
                axes.iter().all(|axis| (axis.length() - 1.0).abs() < 1e-12)
                    && axes[0].dot(axes[1]).abs() < 1e-12
            );
            let near = camera.rotation.as_flattened().iter().zip(exact.rotation.as_flattened());
            assert!(near.into_iter().all(|(a, b)| (a - b).abs() < 1e-3));
        }
    }

    #[test]
    fn another_projection_keeps_the_size_of_the_scene_and_is_named_in_files() {
        let scene = Scene::generate(500, 0, splat);
        let camera = Camera::framing(&scene, 400, 300);
        assert!(
            !serde_json::to_string(&camera).unwrap().contains("projection"),
            "pinhole cameras have no field"
        );
        let distance = camera.to_view(scene.robust_bounds().center())[2];
        let parallel = camera.projected(Projection::Orthographic, &scene);
        assert!((parallel.fx * distance / camera.fx - 1.0).abs() < 1e-9, "pixels of a unit at the centre");
        assert_eq!(parallel.projected(Projection::Fisheye, &scene), parallel, "it is converted once");
        let fisheye = camera.projected(Projection::Fisheye, &scene);
        assert_eq!((fisheye.fx, fisheye.focal()), (camera.fx, [camera.fx, camera.fy]));
        let text = serde_json::to_string(&fisheye).unwrap();
        assert!(text.ends_with("\"projection\":\"fisheye\"}"), "{text}");
        assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), fisheye);
        assert_eq!(camera.projected(Projection::Pinhole, &scene), camera);
        let back = parallel.with_projection(Projection::Pinhole, scene.robust_bounds().center());
        assert!((back.fx / camera.fx - 1.0).abs() < 1e-12 && back.projection.is_pinhole());
    }

    #[test]
    fn a_view_along_up_has_axes_too_and_another_up_turns_the_picture() {
        for (target, up) in [
            ([0.0, 5.0, 0.0], [0.0, 1.0, 0.0]),
            ([2.0, 0.0, 0.0], [-1.0, 0.0, 0.0]),
            ([0.0, 0.0, 1.0], [0.0; 3]),
        ] {
            let camera = Camera::looking_at_upright([0.0; 3], target, up, 60.0, (8, 8));
            assert_eq!(camera.fault(), None, "{target:?}");
        }
        let camera = Camera::looking_at_upright([0.0; 3], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0], 60.0, (8, 8));
        assert_eq!(camera.axes()[1], [0.0, 0.0, -1.0], "down in the image is against up");
    }

    #[test]
    fn a_stretched_camera_sees_every_point_at_the_same_share_of_the_picture() {
        let camera = Camera::looking_at([1.0, -2.0, 3.0], [4.0, 1.0, -2.0], 90.0, (200, 100));
        let half = camera.stretched(101, 37);
        assert!((half.fx / 101.0 - camera.fx / 200.0).abs() < 1e-12);
        assert!((half.fy / 37.0 - camera.fy / 100.0).abs() < 1e-12);
    }

    #[test]
    fn a_far_camera_that_looks_elsewhere_is_told_from_one_that_sees_the_box() {
        let bounds = Bounds { min: [-1.0; 3], max: [1.0; 3] };
        let at = |eye: [f64; 3], target: [f64; 3]| Camera::looking_at(eye, target, 60.0, (64, 48));
        let elsewhere = |camera: Camera| camera.distance_elsewhere(&bounds, 20.0);
        let far = at([5000.0, 0.0, 0.0], [5000.0, 0.0, 1.0]);
        assert_eq!(elsewhere(far.with_projection(Projection::Fisheye, [0.0; 3])), None);
        assert_eq!(elsewhere(far), Some(5000.0));
        assert_eq!(elsewhere(at([0.0, 0.0, 30.0], [0.0, 0.0, 31.0])), Some(30.0));
        assert_eq!(elsewhere(at([0.0, 0.0, 19.0], [0.0, 0.0, 31.0])), None);
        let seen = at([0.0, 0.0, -1e6], [0.0; 3]);
        assert_eq!(elsewhere(seen.with_projection(Projection::Orthographic, [0.0; 3])), None);
        assert_eq!(elsewhere(seen), None);
    }
}
