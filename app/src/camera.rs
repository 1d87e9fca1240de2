//! Converts a camera to the uniform block `Camera` of `shaders/camera.glsl`.
//!
//! Cameras have the form of the reference implementation's `cameras.json`: a position in the world, a rotation from the
//! camera's axes (x right, y down, z forward) to the world's, and focal lengths in pixels. Shaders need the opposite
//! direction, world to camera. Everything is computed in f64 and rounded to f32 once, at the end, as in the reference
//! pipeline: equal bits give equal depths, and equal depths give the same order of the splats.

use bytemuck::{Pod, Zeroable};
use splatgraph_assets::{Bounds, Camera, NEAR};
use std::collections::BTreeMap;

/// The block's name among a plan's frame uniforms.
pub const CAMERA: &str = "frame.camera";

/// Size of the block, in bytes.
pub const CAMERA_BYTES: u64 = size_of::<Block>() as u64;

/// The block `Camera` of `shaders/camera.glsl`, in the layout std140.
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
    /// Near plane, the scene's depth range, frame number.
    depth: [f32; 4],
    background: [f32; 4],
    /// The position's part below its f32.
    position_low: [f32; 4],
    /// Room for new members without a change of size.
    reserved: [[f32; 4]; 6],
}

const _: () = assert!(size_of::<Block>() == 256);

/// The frame's number in the block: byte offset of its vector, and its component.
pub const FRAME_NUMBER: (u32, u32) = (std::mem::offset_of!(Block, depth) as u32, 3);

/// Makes the uniform blocks of a frame, by name.
///
/// `bounds` is the scene's box, `background` the display-encoded colour behind the splats, and `frame` the frame's number,
/// which counts up from 0.
pub fn frame_uniforms(
    camera: &Camera,
    bounds: &Bounds,
    background: [f32; 3],
    frame: u32,
) -> BTreeMap<String, Vec<u8>> {
    [(CAMERA.to_owned(), uniform(camera, depth_range(camera, bounds), background, frame))].into()
}

/// Computes a range that holds the view depths of the scene's box as f32 computes them, neither end nearer than [`NEAR`].
///
/// A depth is a sum of four terms, each rounded to 24 bits: depths beyond the box by that much are in the range.
pub fn depth_range(camera: &Camera, bounds: &Bounds) -> [f64; 2] {
    let (near, far) = camera.depth_range(bounds);
    let axis = |i: usize| camera.position[i].abs() + f64::from(bounds.min[i].abs().max(bounds.max[i].abs()));
    let rounding = ROUNDING * (0..3).map(axis).sum::<f64>();
    [(near - rounding).max(NEAR), (far + rounding).max(NEAR)]
}

/// Bound on the error of a view depth in f32, as a share of the coordinates that it is computed from: four roundings, doubled.
pub const ROUNDING: f64 = 8.0 / (1u64 << 24) as f64;

/// Packs the block; `depth` is the scene's depth range.
fn uniform(camera: &Camera, depth: [f64; 2], background: [f32; 3], frame: u32) -> Vec<u8> {
    // A point `p` of the world is at `rows * p + translation` in the camera's frame.
    let rows = camera.axes();
    let translation = rows.map(|row| -(0..3).map(|i| row[i] * camera.position[i]).sum::<f64>());
    let column = |c: usize| [rows[0][c] as f32, rows[1][c] as f32, rows[2][c] as f32, 0.0];
    let [tx, ty, tz] = translation.map(|v| v as f32);
    let [x, y, z] = camera.position.map(|v| v as f32);
    let [low_x, low_y, low_z] = camera.position.map(|v| (v - f64::from(v as f32)) as f32);
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let [r, g, b] = background;
    let block = Block {
        view: [column(0), column(1), column(2), [tx, ty, tz, 1.0]],
        position: [x, y, z, 0.0],
        focal: [camera.fx, camera.fy, 0.5 * width / camera.fx, 0.5 * height / camera.fy].map(|v| v as f32),
        viewport: [width, height, 1.0 / width, 1.0 / height].map(|v| v as f32),
        depth: [NEAR as f32, depth[0] as f32, depth[1] as f32, frame as f32],
        background: [r, g, b, 0.0],
        position_low: [low_x, low_y, low_z, 0.0],
        reserved: [[0.0; 4]; 6],
    };
    bytemuck::bytes_of(&block).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes a camera at (1, 2, 3) that looks along x; its right is -z, its down is y.
    fn sideways() -> Camera {
        Camera {
            id: 0,
            img_name: "sideways".into(),
            width: 200,
            height: 100,
            position: [1.0, 2.0, 3.0],
            // Columns: right, down, forward.
            rotation: [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
            fx: 50.0,
            fy: 40.0,
        }
    }

    fn floats(bytes: &[u8]) -> Vec<f32> {
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }

    #[test]
    fn the_matrix_takes_a_point_of_the_world_into_the_cameras_frame() {
        let f = floats(&uniform(&sideways(), [0.0; 2], [0.0; 3], 0));
        // (5, 3, 1) is 4 ahead, 1 below and 2 to the right.
        let point = [5.0, 3.0, 1.0, 1.0];
        let at = |row: usize| (0..4).map(|column| f[4 * column + row] * point[column]).sum::<f32>();
        assert_eq!([at(0), at(1), at(2), at(3)], [2.0, 1.0, 4.0, 1.0]);
    }

    #[test]
    fn the_block_lies_as_the_shaders_declare_it() {
        let bytes = uniform(&sideways(), [1.5, 8.0], [0.25, 0.5, 0.75], 7);
        assert_eq!(bytes.len(), 256);
        let f = floats(&bytes);
        assert_eq!(f[16..20], [1.0, 2.0, 3.0, 0.0], "position at 64");
        assert_eq!(f[20..24], [50.0, 40.0, 2.0, 1.25], "focal at 80");
        assert_eq!(f[24..28], [200.0, 100.0, 0.005, 0.01], "viewport at 96");
        assert_eq!(f[28..32], [0.2, 1.5, 8.0, 7.0], "depth at 112");
        assert_eq!(f[32..36], [0.25, 0.5, 0.75, 0.0], "background at 128");
        assert!(f[36..].iter().all(|v| *v == 0.0));
    }

    #[test]
    fn elements_are_rounded_once_from_double_precision() {
        let mut camera = sideways();
        camera.position = [1e8 + 0.25, 0.0, 0.0];
        let f = floats(&uniform(&camera, [0.0; 2], [0.0; 3], 0));
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
}
