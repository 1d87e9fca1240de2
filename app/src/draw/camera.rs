//! Converts a camera to the uniform block `Camera` of `shaders/camera.glsl`.
//!
//! Cameras have the form of the reference implementation's `cameras.json`: a position in the world, a rotation from the
//! camera's axes (x right, y down, z forward) to the world's, and focal lengths in pixels. Shaders need the opposite
//! direction, world to camera. Everything is computed in f64 and rounded to f32 once, at the end.

use bytemuck::{Pod, Zeroable};
use glam::DVec3;
use splatgraph_assets::{Bounds, Camera, NEAR};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the block among a plan's frame uniforms.
pub const CAMERA: &str = "frame.camera";

/// Size of the block, in bytes.
pub const CAMERA_BYTES: u64 = size_of::<Block>() as u64;

/// Uniform block `Camera` of `shaders/camera.glsl`, in std140 layout.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Block {
    /// World-to-camera transform, column by column.
    view: [[f32; 4]; 4],
    position: [f32; 4],
    /// Focal lengths in pixels, and the tangents of half the fields of view.
    focal: [f32; 4],
    /// Width and height in pixels, and their inverses.
    viewport: [f32; 4],
    /// Near plane; nearest and farthest depth of the scene's box; greatest distance of the box from the camera.
    depth: [f32; 4],
    background: [f32; 4],
    /// Part of the position below f32 precision: the f64 position minus `position`.
    position_low: [f32; 4],
    frame: u32,
    padding: [u32; 3],
    /// Reference point for positions in camera space; see [`origin`]. In world coordinates.
    origin: [f32; 4],
    /// Part of the origin below f32 precision.
    origin_low: [f32; 4],
    /// Vector from the camera to the origin: `to_origin` in world axes, `view_origin` in camera axes.
    to_origin: [f32; 4],
    view_origin: [f32; 4],
    /// Offset of the principal point from the middle of the picture: in pixels, and divided by the focal lengths.
    principal: [f32; 4],
}

const _: () = assert!(size_of::<Block>() == 256);

/// Focal length, in pixels, above which rounding relative to the camera can move a splat by 0.001 pixels.
const LONG_FOCAL: f64 = 16_384.0;

/// Byte offset of the frame number in the block.
pub const FRAME_NUMBER: u32 = std::mem::offset_of!(Block, frame) as u32;

/// Byte offset of the background in the block.
pub const BACKGROUND: u32 = std::mem::offset_of!(Block, background) as u32;

/// Makes the uniform blocks of a frame, by name.
///
/// `camera` and `bounds`, the scene's box, are in the scene's coordinates. `background` is display-encoded. `frame`
/// counts the frames from 0.
pub fn frame_uniforms(
    camera: &Camera,
    bounds: &Bounds,
    background: [f32; 3],
    frame: u32,
) -> BTreeMap<String, Vec<u8>> {
    let (depth, distance) = (depth_range(camera, bounds), farthest(camera, bounds));
    [(CAMERA.to_owned(), uniform(camera, depth, distance, background, frame))].into()
}

/// Computes a range that contains the f32 view depths of the scene's box. Both ends are clamped to at least [`NEAR`].
///
/// A depth is a sum of four terms, each rounded to 24 bits. The range includes depths that this rounding moves out of
/// the box.
pub fn depth_range(camera: &Camera, bounds: &Bounds) -> [f64; 2] {
    let (near, far) = camera.depth_range(bounds);
    let axis = |i: usize| camera.position[i].abs() + f64::from(bounds.min[i].abs().max(bounds.max[i].abs()));
    let rounding = ROUNDING * (0..3).map(axis).sum::<f64>();
    [(near - rounding).max(NEAR), (far + rounding).max(NEAR)]
}

/// Bound on the relative error of a view depth in f32: four roundings, doubled.
///
/// It is relative to the sum of the absolute coordinates of the camera and the point.
pub const ROUNDING: f64 = 8.0 / (1u64 << 24) as f64;

/// Computes an upper bound on the distance from the camera to any point in the scene's box.
///
/// It also bounds distances that a shader computes in f32.
pub fn farthest(camera: &Camera, bounds: &Bounds) -> f64 {
    let corner =
        bounds.corners().into_iter().map(|corner| DVec3::from(corner).distance(camera.position.into()));
    corner.fold(NEAR, f64::max) * (1.0 + ROUNDING)
}

fn uniform(camera: &Camera, depth: [f64; 2], distance: f64, background: [f32; 3], frame: u32) -> Vec<u8> {
    // World to camera: `rows * p + translation`.
    let rows = camera.axes();
    let translation = rows.map(|row| -(0..3).map(|i| row[i] * camera.position[i]).sum::<f64>());
    let column = |c: usize| [rows[0][c] as f32, rows[1][c] as f32, rows[2][c] as f32, 0.0];
    let [tx, ty, tz] = translation.map(|v| v as f32);
    let position = camera.position.map(Double::of);
    let [x, y, z] = position.map(|v| v.high);
    let [low_x, low_y, low_z] = position.map(|v| v.low);
    let origin = origin(camera, depth).map(Double::of);
    let [origin_x, origin_y, origin_z] = origin.map(|v| v.high);
    let [origin_low_x, origin_low_y, origin_low_z] = origin.map(|v| v.low);
    // Use the origin as shaders see it: the sum of two floats.
    let to_origin: [f64; 3] = std::array::from_fn(|axis| origin[axis].value() - position[axis].value());
    let [to_x, to_y, to_z] = to_origin.map(|v| v as f32);
    let [view_x, view_y, view_z] = rows.map(|row| (0..3).map(|i| row[i] * to_origin[i]).sum::<f64>() as f32);
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let [x_offset, y_offset] = camera.principal_offset;
    let [r, g, b] = background;
    let block = Block {
        view: [column(0), column(1), column(2), [tx, ty, tz, 1.0]],
        position: [x, y, z, 0.0],
        focal: [camera.fx, camera.fy, 0.5 * width / camera.fx, 0.5 * height / camera.fy].map(|v| v as f32),
        viewport: [width, height, 1.0 / width, 1.0 / height].map(|v| v as f32),
        depth: [NEAR as f32, depth[0] as f32, depth[1] as f32, distance as f32],
        background: [r, g, b, 0.0],
        position_low: [low_x, low_y, low_z, 0.0],
        frame,
        padding: [0; 3],
        origin: [origin_x, origin_y, origin_z, 0.0],
        origin_low: [origin_low_x, origin_low_y, origin_low_z, 0.0],
        to_origin: [to_x, to_y, to_z, 0.0],
        view_origin: [view_x, view_y, view_z, 0.0],
        principal: [x_offset, y_offset, x_offset / camera.fx, y_offset / camera.fy].map(|v| v as f32),
    };
    bytemuck::bytes_of(&block).to_vec()
}

/// A number as the sum of two f32: the rounded value and the remainder.
#[derive(Clone, Copy)]
struct Double {
    high: f32,
    low: f32,
}

impl Double {
    fn of(value: f64) -> Double {
        let high = value as f32;
        Double { high, low: (value - f64::from(high)) as f32 }
    }

    fn value(self) -> f64 {
        f64::from(self.high) + f64::from(self.low)
    }
}

/// Chooses the reference point for positions in camera space. It is the camera itself, or a point inside the scene for
/// a telephoto view of a distant scene. `depth` is the scene's depth range.
///
/// A position relative to the camera is rounded by 6e-8 of its distance. On the picture, this is fx * 6e-8 pixels at
/// any distance: several pixels for a long focal length. Relative to a point inside the scene, it is rounded by 6e-8 of
/// its distance from that point.
fn origin(camera: &Camera, depth: [f64; 2]) -> [f64; 3] {
    let [near, far] = depth;
    let is_telephoto = camera.fx.max(camera.fy) > LONG_FOCAL;
    // For splats near the camera, rounding relative to the scene's middle would be larger.
    if !is_telephoto || near < 0.25 * far || !far.is_finite() {
        return camera.position;
    }
    let [_, _, forward] = camera.axes();
    std::array::from_fn(|axis| camera.position[axis] + 0.5 * (near + far) * forward[axis])
}

/// Computes the mean up direction of the cameras, of length 1. `None` without cameras, or if the directions cancel out.
pub fn mean_up(cameras: &[Camera]) -> Option<DVec3> {
    let ups = cameras.iter().map(|camera| -DVec3::from(camera.axes()[1])).filter(|up| up.is_finite());
    let sum: DVec3 = ups.sum();
    // Strips of a flight, flown in turn in opposite directions, cancel out up to the tilts of the cameras.
    (sum.length() > 0.05 * cameras.len() as f64).then(|| sum.normalize())
}

/// Computes the mean direction of cameras that look along nearly the same direction, of length 1.
///
/// `None` without cameras, or if the mean of their unit vectors is at most 0.95 long, as when all deviate from it by 19
/// degrees.
///
/// Such cameras may look down, and their up directions then lie along the ground. Poses alone do not tell.
pub fn common_view(cameras: &[Camera]) -> Option<DVec3> {
    let sum: DVec3 = cameras.iter().map(|camera| DVec3::from(camera.axes()[2])).sum();
    (sum.length() > 0.95 * cameras.len() as f64).then(|| sum.normalize())
}

/// Finds the camera file that belongs to a scene; `None` if there is none.
///
/// For a scene `NAME.EXT` or `NAME.compressed.ply`, searches for `NAME.cameras.json`, then for `cameras.json` in the
/// scene's folder. If the scene is named `point_cloud.ply`, the three folders above are searched as well, because the
/// reference implementation writes `cameras.json` beside `point_cloud/iteration_N/point_cloud.ply`.
pub fn beside(scene: &Path) -> Option<PathBuf> {
    let stem = Path::new(scene.file_stem()?);
    let is_compressed =
        [scene, stem].map(Path::extension) == [Some("ply".as_ref()), Some("compressed".as_ref())];
    let plain = if is_compressed { scene.with_extension("") } else { scene.to_owned() };
    let own = plain.with_extension("cameras.json");
    if own.is_file() {
        return Some(own);
    }
    let folders = scene.parent()?.ancestors().take(if scene.ends_with("point_cloud.ply") { 4 } else { 1 });
    folders.map(|folder| folder.join("cameras.json")).find(|file| file.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes a camera at (1, 2, 3) that looks along +x. Its right is -z, and its down is +y.
    fn sideways() -> Camera {
        Camera {
            id: 0,
            img_name: "sideways".into(),
            width: 200,
            height: 100,
            position: [1.0, 2.0, 3.0],
            rotation: [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
            fx: 50.0,
            fy: 40.0,
            principal_offset: [0.0; 2],
            projection: Default::default(),
        }
    }

    fn floats(bytes: &[u8]) -> Vec<f32> {
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }

    #[test]
    fn the_matrix_takes_a_point_of_the_world_into_the_cameras_frame() {
        let f = floats(&uniform(&sideways(), [0.0; 2], 0.0, [0.0; 3], 0));
        // The point (5, 3, 1) is 4 ahead of the camera, 1 below and 2 to the right.
        let point = [5.0, 3.0, 1.0, 1.0];
        let at = |row: usize| (0..4).map(|column| f[4 * column + row] * point[column]).sum::<f32>();
        assert_eq!([at(0), at(1), at(2), at(3)], [2.0, 1.0, 4.0, 1.0]);
    }

    #[test]
    fn the_block_lies_as_the_shaders_declare_it() {
        let bytes = uniform(&sideways(), [1.5, 8.0], 9.0, [0.25, 0.5, 0.75], 7);
        assert_eq!(bytes.len(), 256);
        let f = floats(&bytes);
        assert_eq!(f[16..20], [1.0, 2.0, 3.0, 0.0], "position at 64");
        assert_eq!(f[20..24], [50.0, 40.0, 2.0, 1.25], "focal at 80");
        assert_eq!(f[24..28], [200.0, 100.0, 0.005, 0.01], "viewport at 96");
        assert_eq!(f[28..32], [0.2, 1.5, 8.0, 9.0], "depth at 112");
        assert_eq!(f[32..36], [0.25, 0.5, 0.75, 0.0], "background at 128");
        assert_eq!(f[40].to_bits(), 7, "frame at 160");
        assert_eq!(f[44..48], [1.0, 2.0, 3.0, 0.0], "origin at 176: the camera");
        assert!(f[36..40].iter().chain(&f[41..44]).chain(&f[48..]).all(|v| *v == 0.0));
        let aside = Camera { principal_offset: [25.0, -10.0], ..sideways() };
        let f = floats(&uniform(&aside, [1.5, 8.0], 9.0, [0.25, 0.5, 0.75], 7));
        assert_eq!(f[60..], [25.0, -10.0, 0.5, -0.25], "principal point at 240");
    }

    #[test]
    fn a_telephoto_view_of_a_distant_scene_has_its_origin_amid_the_scene() {
        let mut camera = sideways();
        camera.position = [-1e6 + 0.1, 2.0, 3.0];
        (camera.fx, camera.fy) = (1e8, 1e8);
        let f = floats(&uniform(&camera, [999_999.0, 1_000_001.0], 1_000_001.0, [0.0; 3], 0));
        let point = |at: usize| [0, 1, 2].map(|axis| f64::from(f[at + axis]));
        let origin: Vec<f64> = point(44).iter().zip(point(48)).map(|(high, low)| high + low).collect();
        assert!((origin[0] - 0.1).abs() < 1e-7, "{origin:?}");
        assert_eq!((point(52), point(56)), ([1e6, 0.0, 0.0], [0.0, 0.0, 1e6]));
        // Here the scene surrounds the camera.
        let f = floats(&uniform(&camera, [0.2, 1_000_001.0], 1_000_001.0, [0.0; 3], 0));
        assert_eq!(f[44..47], f[16..19]);
    }

    #[test]
    fn elements_are_rounded_once_from_double_precision() {
        let mut camera = sideways();
        camera.position = [1e8 + 0.25, 0.0, 0.0];
        let f = floats(&uniform(&camera, [0.0; 2], 0.0, [0.0; 3], 0));
        assert_eq!(f[14], -(1e8 + 0.25) as f32);
        assert_eq!((f[16], f[36]), (1e8, 0.25), "the position has twice the digits");
    }

    #[test]
    fn the_depth_range_spans_the_box_and_ends_at_the_near_plane() {
        let bounds = Bounds { min: [2.0, -9.0, -9.0], max: [11.0, 9.0, 9.0] };
        let [near, far] = depth_range(&sideways(), &bounds);
        assert!((0.9999..1.0).contains(&near) && far > 10.0 && far < 10.0001, "{near} {far}");
        let around = Bounds { min: [-5.0; 3], max: [5.0; 3] };
        let [near, far] = depth_range(&sideways(), &around);
        assert!(near == NEAR && far > 4.0 && far < 4.0001, "{near} {far}");
        let behind = Bounds { min: [-9.0; 3], max: [0.0; 3] };
        assert_eq!(depth_range(&sideways(), &behind), [NEAR, NEAR]);
    }

    #[test]
    fn up_is_the_mean_of_the_cameras_unless_they_cancel_out() {
        let level = Camera::looking_at([0.0; 3], [0.0, 0.0, 5.0], 60.0, (800, 600));
        assert!(mean_up(&[level.clone(), level.clone()]).unwrap().distance(DVec3::NEG_Y) < 1e-12);
        let mut on_its_side = level.clone();
        on_its_side.rotation =
            glam::DMat3::from_rotation_z(0.5 * std::f64::consts::PI).transpose().to_cols_array_2d();
        let mean = mean_up(&[level.clone(), on_its_side]).unwrap();
        assert!((mean.length() - 1.0).abs() < 1e-12 && (mean.x - 0.5f64.sqrt()).abs() < 1e-9, "{mean}");
        let mut over = level.clone();
        over.rotation = glam::DMat3::from_rotation_z(std::f64::consts::PI).transpose().to_cols_array_2d();
        assert_eq!(mean_up(&[level, over]), None);
        assert_eq!(mean_up(&[]), None);
        // Two strips of a flight over z = 0, north and south. The tilts add up to a camera upside down.
        let strip = |north| {
            Camera::looking_at_upright([0.0; 3], [0.0, 0.1, -5.0], [0.0, north, 0.0], 60.0, (800, 600))
        };
        let flight = [strip(1.0), strip(-1.0)];
        assert_eq!(mean_up(&flight), None);
        assert!(common_view(&flight).unwrap().distance(DVec3::NEG_Z) < 0.03);
        let around = [[5.0, 0.0, 5.0], [-5.0, 0.0, 5.0], [0.0, 5.0, 5.0], [0.0, -5.0, 5.0]];
        let oblique =
            around.map(|eye| Camera::looking_at_upright(eye, [0.0; 3], [0.0, 0.0, 1.0], 60.0, (800, 600)));
        assert!(mean_up(&oblique).unwrap().distance(DVec3::Z) < 1e-9 && common_view(&oblique).is_none());
    }
}
