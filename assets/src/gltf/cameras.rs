//! Reads the cameras of glTF. A node places a camera, which looks along its -z axis, with x to the right and y up.
//!
//! glTF has no picture sizes, only aspect ratios: all pictures have the height [`HEIGHT`].

use super::container;
use super::document::{Document, Lens, Placed, item};
use crate::camera::Camera;
use crate::error::{SceneError, wrong};
use crate::input::Source;
use crate::projection::Projection;
use glam::{DMat3, DVec3};

const HEIGHT: u32 = 720;

/// Aspect ratio of a perspective camera that specifies none. glTF then leaves it to the viewer's window.
const ASPECT: f64 = 16.0 / 9.0;

/// Maximum width of the pictures, in pixels. A wider view keeps its aspect ratio, so its pixels are not square.
const WIDEST: f64 = 16384.0;

/// Lists the cameras of the scene ([`Document::placed`]), in the order of the file's nodes. Also returns true if an
/// animation moves one of them; animations are not read.
pub(crate) fn cameras(source: &Source) -> Result<(Vec<Camera>, bool), SceneError> {
    let document = Document::read(&container::json(source)?)?;
    let mut placed = document.placed()?;
    placed.sort_unstable_by_key(|node| node.index);
    let animated = document.animated();
    let (mut found, mut has_animation) = (Vec::new(), false);
    for Placed { index, place, .. } in placed {
        let node = &document.nodes[index];
        let Some(camera) = node.camera else { continue };
        has_animation |= animated.contains(&index);
        let camera = item(&document.cameras, camera, "nodes.camera")?;
        let name = if node.name.is_empty() { &camera.name } else { &node.name };
        let fault = |message: String| wrong(format!("nodes[{index}].camera"), message);
        // Scale, mirroring and skew of the nodes are ignored: the z axis keeps its direction.
        let DMat3 { y_axis, z_axis, .. } = DMat3::from_mat4(place);
        let [y, z] = [y_axis, z_axis].map(DVec3::normalize_or_zero);
        let x = y.cross(z).normalize_or_zero();
        let y = z.cross(x);
        // Converts the axes of glTF to those of scenes: half a turn about z, as for splats.
        let world = |v: DVec3| DVec3::new(-v.x, -v.y, v.z);
        let [right, down, forward] = [x, -y, -z].map(world);
        let (projection, aspect, half_height) = lens(camera).map_err(fault)?;
        let width = (f64::from(HEIGHT) * aspect).round().clamp(1.0, WIDEST);
        let camera = Camera {
            id: index as i64,
            img_name: name.clone(),
            width: width as u32,
            height: HEIGHT,
            position: world(place.w_axis.truncate()).into(),
            rotation: DMat3::from_cols(right, down, forward).transpose().to_cols_array_2d(),
            fx: 0.5 * width / (aspect * half_height),
            fy: 0.5 * f64::from(HEIGHT) / half_height,
            principal_offset: [0.0; 2],
            projection,
        };
        if let Some(text) = camera.fault() {
            return Err(fault(text));
        }
        found.push(camera);
    }
    Ok((found, has_animation))
}

/// Returns the projection, the aspect ratio, and half the view's height (for a pinhole, at distance 1). Fails if a
/// number is not positive, or the field of view is half a turn or more.
fn lens(camera: &Lens) -> Result<(Projection, f64, f64), String> {
    let positive = |name: &str, value: f64| match value > 0.0 && value.is_finite() {
        true => Ok(value),
        false => Err(format!("expected a positive {name}, found {value}")),
    };
    match (&camera.perspective, &camera.orthographic) {
        (Some(perspective), None) => {
            let angle = positive("yfov", perspective.yfov)?;
            if angle >= std::f64::consts::PI {
                return Err(format!("expected a yfov below pi, found {angle}"));
            }
            let aspect = positive("aspectRatio", perspective.aspect_ratio.unwrap_or(ASPECT))?;
            Ok((Projection::Pinhole, aspect, (0.5 * angle).tan()))
        }
        (None, Some(orthographic)) => {
            let (x, y) = (positive("xmag", orthographic.xmag)?, positive("ymag", orthographic.ymag)?);
            Ok((Projection::Orthographic, x / y, y))
        }
        _ => Err("expected either perspective or orthographic".into()),
    }
}
