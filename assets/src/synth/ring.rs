//! Generates a mesh for the demo scene: an upright bronze ring, half sunk into the pond.

use crate::mesh::{Mesh, MeshMaterial, Texture};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Centre of the ring, on the water behind the lotus.
const CENTER: DVec3 = DVec3::new(0.0, 0.0, 0.62);
/// Radius of the ring, and of its cross-section.
const RADII: DVec2 = DVec2::new(1.42, 0.13);
/// Quads along the ring, and around its cross-section.
const STEPS: [u32; 2] = [192, 24];
/// Texels of the images, along and around.
const TEXELS: [u32; 2] = [512, 64];

/// Evaluates a smooth periodic pattern on the torus, -2 to 2. `scale` is an integer factor on its frequencies.
fn patches(at: DVec2, scale: f64) -> f64 {
    const WAVES: [[f64; 3]; 5] =
        [[7.0, 1.0, 0.4], [11.0, -1.0, 1.9], [5.0, 2.0, 4.2], [16.0, 1.0, 2.7], [3.0, -2.0, 5.5]];
    let wave = |[x, y, phase]: [f64; 3]| (TAU * scale * (x * at.x + y * at.y) + phase).sin();
    WAVES.into_iter().map(wave).sum::<f64>() / 2.5
}

/// Evaluates the pattern of hammer marks, 0 to 1.
fn hammered(at: DVec2) -> f64 {
    let (x, y) = (48.0 * at.x, 6.0 * at.y);
    let dent = |x: f64| 0.5 + 0.5 * (TAU * x).cos();
    dent(x + 0.3 * patches(at, 1.0)) * dent(y + 0.5 * (x.floor() % 2.0))
}

/// Generates the mesh that [`MESH`](super::MESH) names, in the coordinates of the demo scene.
pub fn mesh() -> Mesh {
    let mut mesh = Mesh::default();
    for (row, column) in (0..=STEPS[1]).flat_map(|row| (0..=STEPS[0]).map(move |column| (row, column))) {
        let uv = DVec2::new(f64::from(column) / f64::from(STEPS[0]), f64::from(row) / f64::from(STEPS[1]));
        let ((sin, cos), (rise, reach)) = ((TAU * uv.x).sin_cos(), (TAU * uv.y).sin_cos());
        let outward = DVec3::new(cos, sin, 0.0);
        let normal = outward * reach + DVec3::Z * rise;
        let place = CENTER + outward * RADII.x + normal * RADII.y;
        mesh.positions.push(place.as_vec3().into());
        mesh.normals.push(normal.as_vec3().into());
        mesh.uvs.push([uv.x as f32, uv.y as f32]);
    }
    let across = STEPS[0] + 1;
    for (row, column) in (0..STEPS[1]).flat_map(|row| (0..STEPS[0]).map(move |column| (row, column))) {
        let at = row * across + column;
        mesh.triangles.push([at, at + 1, at + across + 1]);
        mesh.triangles.push([at, at + across + 1, at + across]);
    }
    mesh.material_of = vec![0; mesh.triangles.len()];
    let images = [colors, surface, bumps].map(|texel: fn(DVec2) -> DVec3| image(&mut mesh, texel));
    mesh.materials.push(MeshMaterial {
        base_color_image: images[0],
        metallic_roughness_image: images[1],
        normal_image: images[2],
        ..MeshMaterial::default()
    });
    mesh
}

/// Appends an image to the mesh's texels. `texel` gives its channels, 0 to 1.
fn image(mesh: &mut Mesh, texel: fn(DVec2) -> DVec3) -> Texture {
    let [width, height] = TEXELS;
    let texture = Texture { first: mesh.texels.len() as u32, width, height };
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let at = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) / DVec2::new(width.into(), height.into());
        let [r, g, b] = <[f64; 3]>::from(texel(at)).map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8);
        mesh.texels.push([r, g, b, 255]);
    }
    texture
}

/// Returns the amount of verdigris, 0 to 1: in patches, and in the hammer marks.
fn verdigris(at: DVec2) -> f64 {
    let amount = 0.9 * patches(at, 1.0) + 0.5 * patches(at, 3.0) + 0.6 * hammered(at) - 0.5;
    (2.5 * amount + 0.3).clamp(0.0, 1.0)
}

fn colors(at: DVec2) -> DVec3 {
    let shade = 1.0 + 0.08 * patches(at, 4.0);
    shade * DVec3::new(0.80, 0.58, 0.34).lerp(DVec3::new(0.35, 0.60, 0.52), verdigris(at))
}

/// Returns roughness in green and metalness in blue.
fn surface(at: DVec2) -> DVec3 {
    let green = verdigris(at);
    DVec3::new(0.0, 0.38 + 0.5 * green + 0.05 * patches(at, 5.0), 1.0 - green)
}

fn bumps(at: DVec2) -> DVec3 {
    const STEP: DVec2 = DVec2::new(1.0 / 1024.0, 1.0 / 128.0);
    let slope = |by: DVec2| hammered(at - by) - hammered(at + by);
    // Green points up, against v.
    let normal = DVec3::new(0.5 * slope(DVec2::new(STEP.x, 0.0)), -0.5 * slope(DVec2::new(0.0, STEP.y)), 1.0);
    0.5 * normal.normalize() + 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ring_is_half_under_water_and_its_normals_point_out_of_it() {
        let ring = mesh();
        let above = ring.positions.iter().filter(|p| p[1] < 0.0).count() as f64;
        assert!((above / ring.positions.len() as f64 - 0.5).abs() < 0.02);
        for (place, normal) in ring.positions.iter().zip(&ring.normals) {
            let (place, normal) = (DVec3::from(place.map(f64::from)), DVec3::from(normal.map(f64::from)));
            let line = (place - CENTER).with_z(0.0).normalize() * RADII.x + CENTER;
            assert!(((place - line) / RADII.y).distance(normal) < 1e-5);
        }
    }
}
