//! Renders a mesh exactly: finds each pixel's nearest hit of a ray through its centre, and shades it.
//!
//! Rays start at the camera. They advance by 1 in view depth per unit of the ray's parameter, so the parameter of a hit
//! is its view depth. A triangle is tested against the rays of the pixels in its bounding box, or of all pixels if it
//! crosses the near plane. Materials are those of glTF 2.0 (appendix B), lit by the mesh's one light and its
//! ambient light.

use crate::gaussian::Splats;
use crate::rules::{KeyOf, Rules};
use crate::srgb::{decode, encode};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use splatgraph_assets::{Camera, Mesh, MeshMaterial, Texture};
use std::f64::consts::PI;

const ROWS: usize = 8;

/// Minimum roughness, so that highlights do not fall between pixels.
const MIN_ROUGHNESS: f64 = 0.045;

/// Point of the mesh that a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Surface {
    /// View depth, or the distance from the camera if splats are sorted by it.
    pub depth: f64,
    /// Display-encoded colour, 0 to 1.
    pub color: [f64; 3],
}

struct Triangle {
    index: usize,
    corner: DVec3,
    edges: [DVec3; 2],
    /// Bounds of its corners on the image, in pixels: minimum and maximum, across then down. Infinite if it crosses the
    /// near plane.
    pixels: [[f64; 2]; 2],
}

#[derive(Clone, Copy)]
struct Hit {
    triangle: usize,
    depth: f64,
    /// Barycentric weights of the triangle's corners.
    weights: DVec3,
}

/// The surface at each pixel of a rectangle of the image.
pub(crate) struct Surfaces {
    /// Left, top, right and bottom, in pixels; right and bottom exclusive.
    area: [usize; 4],
    /// The surfaces in row order; `None` where the ray misses the mesh.
    found: Vec<Option<Surface>>,
}

impl Surfaces {
    /// Finds the surfaces in `area` of the mesh that comes with the splats. There are none without a mesh, or if the
    /// camera is not a pinhole. `None` once `cancelled`, which several threads call, returns true.
    pub(crate) fn find(
        splats: &(impl Splats + ?Sized),
        camera: &Camera,
        rules: &Rules,
        area: [u32; 4],
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Surfaces> {
        match splats.mesh().filter(|_| camera.projection.is_pinhole()) {
            Some(mesh) => Caster::new(mesh, camera, rules).surfaces(area, cancelled),
            None => Some(Surfaces { area: [0; 4], found: Vec::new() }),
        }
    }

    /// Returns the surface at a pixel; `None` without one, and outside the rectangle.
    pub(crate) fn at(&self, [x, y]: [usize; 2]) -> Option<Surface> {
        let [left, top, right, bottom] = self.area;
        let inside = (left..right).contains(&x) && (top..bottom).contains(&y);
        if inside { self.found[(y - top) * (right - left) + x - left] } else { None }
    }

    /// Returns the depth from which on splats are hidden at a pixel; infinite without a surface.
    pub(crate) fn limit(&self, pixel: [usize; 2]) -> f64 {
        self.at(pixel).map_or(f64::INFINITY, |surface| surface.depth)
    }
}

struct Caster<'a> {
    mesh: &'a Mesh,
    camera: &'a Camera,
    near: f64,
    key_of: KeyOf,
    triangles: Vec<Triangle>,
}

impl<'a> Caster<'a> {
    /// Prepares the triangles of a mesh, except triangles nearer than the near plane.
    fn new(mesh: &'a Mesh, camera: &'a Camera, rules: &Rules) -> Self {
        let near = rules.near;
        let axis_at = camera.principal_point().map(|v| v - 0.5);
        let prepare = |(index, corners): (usize, &[u32; 3])| {
            let [a, b, c] = corners
                .map(|corner| DVec3::from(camera.to_view(mesh.positions[corner as usize].map(f64::from))));
            if [a, b, c].iter().all(|p| p.z <= near) {
                return None;
            }
            let mut pixels = [[f64::NEG_INFINITY, f64::INFINITY]; 2];
            if [a, b, c].iter().all(|p| p.z > near) {
                let focal = [camera.fx, camera.fy];
                pixels = std::array::from_fn(|axis| {
                    let at = [a, b, c].map(|p| focal[axis] * p[axis] / p.z + axis_at[axis]);
                    let bound = |pick: fn(f64, f64) -> f64| at.into_iter().reduce(pick).unwrap_or(0.0);
                    // Rounding may put a corner on either side of a pixel's centre, so the bounds have a margin.
                    [bound(f64::min) - 1e-6, bound(f64::max) + 1e-6]
                });
            }
            Some(Triangle { index, corner: a, edges: [b - a, c - a], pixels })
        };
        let triangles = mesh.triangles.par_iter().enumerate().filter_map(prepare).collect();
        Caster { mesh, camera, near, key_of: rules.key_of, triangles }
    }

    /// Finds the surface at every pixel of a rectangle; `None` once `cancelled`.
    fn surfaces(&self, area: [u32; 4], cancelled: &(dyn Fn() -> bool + Sync)) -> Option<Surfaces> {
        let area = area.map(|side| side as usize);
        let [left, top, right, bottom] = area;
        let width = right - left;
        let mut found = vec![None; width * (bottom - top)];
        let row = |(chunk, pixels): (usize, &mut [Option<Surface>])| {
            if cancelled() {
                return None;
            }
            let first = top + chunk * ROWS;
            let mut hits: Vec<Option<Hit>> = vec![None; pixels.len()];
            for triangle in &self.triangles {
                let inside = |axis: usize, from: usize, count: usize| {
                    let [low, high] = triangle.pixels[axis];
                    let start = (low.ceil().max(from as f64) as usize).max(from);
                    start..((high.floor() + 1.0).min((from + count) as f64).max(0.0) as usize).max(start)
                };
                for y in inside(1, first, pixels.len() / width) {
                    for x in inside(0, left, width) {
                        let hit = &mut hits[(y - first) * width + x - left];
                        *hit = self.nearer(triangle, [x as f64, y as f64], *hit);
                    }
                }
            }
            for (pixel, hit) in pixels.iter_mut().zip(hits) {
                *pixel = hit.map(|hit| self.seen(&hit));
            }
            Some(())
        };
        found.par_chunks_mut((ROWS * width).max(1)).enumerate().try_for_each(row)?;
        Some(Surfaces { area, found })
    }

    /// Returns the nearer of `hit` and the hit of a pixel's ray with `triangle` (Möller and Trumbore). A hit whose
    /// alpha is below the material's cutoff does not count. `None` without a hit.
    fn nearer(&self, triangle: &Triangle, [x, y]: [f64; 2], hit: Option<Hit>) -> Option<Hit> {
        let Camera { fx, fy, .. } = *self.camera;
        let [cx, cy] = self.camera.principal_point().map(|v| v - 0.5);
        let ray = DVec3::new((x - cx) / fx, (y - cy) / fy, 1.0);
        let [to_b, to_c] = triangle.edges;
        let across = ray.cross(to_c);
        let determinant = to_b.dot(across);
        if determinant == 0.0 {
            return hit;
        }
        let from = -triangle.corner;
        let b = from.dot(across) / determinant;
        let other = from.cross(to_b);
        let c = ray.dot(other) / determinant;
        let depth = to_c.dot(other) / determinant;
        let inside = b >= 0.0 && c >= 0.0 && b + c <= 1.0 && depth > self.near;
        if !inside || hit.is_some_and(|hit| hit.depth <= depth) {
            return hit;
        }
        let found = Hit { triangle: triangle.index, depth, weights: DVec3::new(1.0 - b - c, b, c) };
        let material = self.material(&found);
        let cutoff = f64::from(material.alpha_cutoff);
        match cutoff > 0.0 && self.base(material, self.uv(&found))[3] < cutoff {
            true => hit,
            false => Some(found),
        }
    }

    /// Shades a hit, and adds the depth or distance that splats are sorted by.
    fn seen(&self, hit: &Hit) -> Surface {
        let key = match self.key_of {
            KeyOf::Depth => hit.depth,
            KeyOf::Distance => self.place(hit).distance(self.camera.position.into()),
        };
        Surface { depth: key, color: self.shade(hit) }
    }

    fn place(&self, hit: &Hit) -> DVec3 {
        self.between_corners(hit, &self.mesh.positions)
    }

    /// Interpolates a value that each corner has.
    fn between_corners(&self, hit: &Hit, values: &[[f32; 3]]) -> DVec3 {
        let corners = self.mesh.triangles[hit.triangle].map(|corner| values[corner as usize].map(f64::from));
        DMat3::from_cols_array_2d(&corners) * hit.weights
    }

    fn material(&self, hit: &Hit) -> &'a MeshMaterial {
        &self.mesh.materials[self.mesh.material_of[hit.triangle] as usize]
    }

    fn uv(&self, hit: &Hit) -> [f64; 2] {
        let uvs =
            self.mesh.triangles[hit.triangle].map(|corner| self.mesh.uvs[corner as usize].map(f64::from));
        std::array::from_fn(|axis| (0..3).map(|k| hit.weights[k] * uvs[k][axis]).sum())
    }

    /// Returns a material's base colour, in linear light, and its alpha.
    fn base(&self, material: &MeshMaterial, uv: [f64; 2]) -> [f64; 4] {
        let factor = material.base_color.map(f64::from);
        match self.sample(material.base_color_image, uv, true) {
            Some(texel) => std::array::from_fn(|i| factor[i] * texel[i]),
            None => factor,
        }
    }

    /// Samples an image bilinearly, with wrapping; `None` for an empty image. Colours are decoded first if `encoded`.
    fn sample(&self, image: Texture, uv: [f64; 2], encoded: bool) -> Option<[f64; 4]> {
        if image.width == 0 {
            return None;
        }
        let size = [image.width, image.height].map(i64::from);
        let place: [f64; 2] = std::array::from_fn(|i| (uv[i] - uv[i].floor()) * size[i] as f64 - 0.5);
        let at = place.map(|v| v.floor() as i64);
        let part = [place[0] - at[0] as f64, place[1] - at[1] as f64];
        let texel = |x: i64, y: i64| -> [f64; 4] {
            let (x, y) = ((at[0] + x).rem_euclid(size[0]), (at[1] + y).rem_euclid(size[1]));
            let texel = self.mesh.texels[image.first as usize + (y * size[0] + x) as usize];
            let [r, g, b, a] = texel.map(|v| f64::from(v) / 255.0);
            if encoded { [decode(r), decode(g), decode(b), a] } else { [r, g, b, a] }
        };
        let corners = [texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)];
        let weights = [
            (1.0 - part[0]) * (1.0 - part[1]),
            part[0] * (1.0 - part[1]),
            (1.0 - part[0]) * part[1],
            part[0] * part[1],
        ];
        Some(std::array::from_fn(|i| (0..4).map(|k| weights[k] * corners[k][i]).sum()))
    }

    /// Returns the normal at a hit, with the material's normal map applied, turned towards `to_camera`.
    fn normal(&self, hit: &Hit, material: &MeshMaterial, uv: [f64; 2], to_camera: DVec3) -> DVec3 {
        let corners = self.mesh.triangles[hit.triangle].map(|corner| corner as usize);
        let mut normal = self.between_corners(hit, &self.mesh.normals).normalize();
        if let Some([x, y, z, _]) = self.sample(material.normal_image, uv, false) {
            let [a, b, c] = corners.map(|corner| DVec3::from(self.mesh.positions[corner].map(f64::from)));
            let [ua, ub, uc] = corners.map(|corner| DVec2::from(self.mesh.uvs[corner].map(f64::from)));
            let (to_b, to_c) = (b - a, c - a);
            let (ub, uc) = (ub - ua, uc - ua);
            let area = ub.perp_dot(uc);
            let along_u = to_b * (uc.y / area) - to_c * (ub.y / area);
            let along_v = to_c * (ub.x / area) - to_b * (uc.x / area);
            let tangent = along_u - normal * normal.dot(along_u);
            if area != 0.0 && tangent.length_squared() > 0.0 {
                let tangent = tangent.normalize();
                let across = normal.cross(tangent);
                // Green points up, against v.
                let up = if across.dot(along_v) > 0.0 { -across } else { across };
                let scale = f64::from(material.normal_scale);
                let [x, y, z] = [x, y, z].map(|v| 2.0 * v - 1.0);
                normal = (tangent * (scale * x) + up * (scale * y) + normal * z).normalize();
            }
        }
        if normal.dot(to_camera) < 0.0 { -normal } else { normal }
    }

    fn shade(&self, hit: &Hit) -> [f64; 3] {
        let (material, uv, light) = (self.material(hit), self.uv(hit), self.mesh.light.unwrap_or_default());
        let to_camera = (DVec3::from(self.camera.position) - self.place(hit)).normalize();
        let base = self.base(material, uv);
        let (mut metallic, mut roughness) = (f64::from(material.metallic), f64::from(material.roughness));
        if let Some([_, green, blue, _]) = self.sample(material.metallic_roughness_image, uv, false) {
            roughness *= green;
            metallic *= blue;
        }
        if material.unlit {
            return std::array::from_fn(|i| encode(base[i].clamp(0.0, 1.0)));
        }
        let glow = self.sample(material.emission_image, uv, true).unwrap_or([1.0; 4]);
        let normal = self.normal(hit, material, uv, to_camera);
        let to_light = DVec3::from(light.direction.map(f64::from));
        let between = (to_camera + to_light).normalize();
        let (nl, nv) = (normal.dot(to_light).max(0.0), normal.dot(to_camera).max(1e-4));
        let (nh, vh) = (normal.dot(between).max(0.0), to_camera.dot(between).max(0.0));
        let alpha2 = roughness.max(MIN_ROUGHNESS).powi(4);
        let distribution = alpha2 / (PI * (nh * nh * (alpha2 - 1.0) + 1.0).powi(2));
        let shadow = |a: f64, b: f64| a * (b * b * (1.0 - alpha2) + alpha2).sqrt();
        let visible = 0.5 / (shadow(nl, nv) + shadow(nv, nl) + 1e-7);
        std::array::from_fn(|i| {
            let straight = 0.04 + metallic * (base[i] - 0.04);
            let fresnel = straight + (1.0 - straight) * (1.0 - vh).powi(5);
            let diffuse = (1.0 - fresnel) * (1.0 - metallic) * base[i];
            let lit = f64::from(light.color[i]) * nl * (diffuse + PI * distribution * visible * fresnel)
                + f64::from(light.ambient) * base[i]
                + f64::from(material.emission[i]) * glow[i];
            encode(lit.clamp(0.0, 1.0))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Gaussian;
    use splatgraph_assets::{Light, Projection};

    /// Returns a camera that looks along +z from the origin; pixel (2, 2) is in the middle.
    fn camera() -> Camera {
        Camera { fx: 2.0, fy: 2.0, ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (5, 5)) }
    }

    /// Returns a square wall at `z` with sides of `2 * half`, in a single colour.
    fn wall(z: f32, half: f32, base_color: [f32; 4]) -> Mesh {
        Mesh {
            positions: vec![[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]],
            normals: vec![[0.0, 0.0, -1.0]; 4],
            uvs: vec![[0.0; 2]; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material_of: vec![0, 0],
            materials: vec![MeshMaterial { base_color, metallic: 0.0, ..MeshMaterial::default() }],
            ..Mesh::default()
        }
    }

    fn of_area(mesh: &Mesh, area: [u32; 4]) -> Surfaces {
        let surfaces = Caster::new(mesh, &camera(), &Rules::PUBLISHED).surfaces(area, &|| false);
        surfaces.expect("nobody cancels it")
    }

    fn surfaces(mesh: &Mesh) -> Vec<Option<Surface>> {
        of_area(mesh, [0, 0, 5, 5]).found
    }

    #[test]
    fn rays_find_the_nearest_triangle_and_its_view_depth() {
        let mut both = wall(4.0, 10.0, [0.0, 0.0, 1.0, 1.0]);
        both.append(&wall(2.0, 1.0, [1.0, 0.0, 0.0, 1.0]));
        let found = surfaces(&both);
        // The near wall covers the middle 3 x 3 pixels; the far one fills the picture.
        for (at, surface) in found.iter().enumerate() {
            let (x, y) = (at % 5, at / 5);
            let near = (1..=3).contains(&x) && (1..=3).contains(&y);
            let surface = surface.expect("a wall");
            assert!((surface.depth - if near { 2.0 } else { 4.0 }).abs() < 1e-12, "{x}, {y}: {surface:?}");
            assert_eq!(surface.color[0] > surface.color[2], near);
        }
        for [left, top, right, bottom] in [[2, 2, 3, 3], [1, 3, 5, 5], [0, 0, 5, 1]] {
            let part = of_area(&both, [left, top, right, bottom]);
            for (at, surface) in found.iter().enumerate() {
                let pixel @ [x, y] = [at as u32 % 5, at as u32 / 5];
                let inside = (left..right).contains(&x) && (top..bottom).contains(&y);
                assert_eq!(part.at(pixel.map(|v| v as usize)), surface.filter(|_| inside), "{pixel:?}");
            }
        }
        let camera = camera();
        let caster = Caster::new(&both, &camera, &Rules::PUBLISHED);
        assert!(caster.surfaces([0, 0, 5, 5], &|| true).is_none(), "it is cancelled");
        // The lower right 3 x 2 pixels of the picture.
        let window = Camera { width: 3, height: 2, principal_offset: [-1.0, -1.5], ..camera };
        let caster = Caster::new(&both, &window, &Rules::PUBLISHED);
        let part = caster.surfaces([0, 0, 3, 2], &|| false).expect("nobody cancels it");
        for (x, y) in (0..2).flat_map(|y| (0..3).map(move |x| (x, y))) {
            assert_eq!(part.at([x, y]), found[(y + 3) * 5 + x + 2], "{x}, {y}");
        }
    }

    struct Alone(Mesh);

    impl Splats for Alone {
        fn count(&self) -> usize {
            0
        }

        fn get(&self, index: usize) -> Gaussian {
            unreachable!("splat {index} of none")
        }

        fn mesh(&self) -> Option<&Mesh> {
            Some(&self.0)
        }
    }

    #[test]
    fn only_a_pinhole_sees_the_mesh() {
        let alone = Alone(wall(2.0, 10.0, [1.0; 4]));
        for projection in Projection::ALL {
            let camera = Camera { projection, ..camera() };
            let found = Surfaces::find(&alone, &camera, &Rules::PUBLISHED, [0, 0, 5, 5], &|| false);
            let sees = found.is_some_and(|surfaces| surfaces.at([2, 2]).is_some());
            assert_eq!(sees, projection == Projection::Pinhole, "{projection}");
        }
        let none = Surfaces::find(&[] as &[Gaussian], &camera(), &Rules::PUBLISHED, [0, 0, 5, 5], &|| false);
        assert_eq!(none.expect("nobody cancels it").limit([2, 2]), f64::INFINITY);
    }

    #[test]
    fn triangles_nearer_than_the_near_plane_are_cut_off_and_those_across_it_are_not() {
        assert!(surfaces(&wall(0.1, 10.0, [1.0; 4])).iter().all(Option::is_none));
        let mut floor = wall(0.0, 10.0, [1.0; 4]);
        // From behind the camera to far in front, one unit below it.
        floor.positions = vec![[-9.0, 1.0, -9.0], [9.0, 1.0, -9.0], [9.0, 1.0, 9.0], [-9.0, 1.0, 9.0]];
        let found = surfaces(&floor);
        assert!(found[..15].iter().all(Option::is_none), "at and above the horizon");
        assert!((found[22].expect("the floor").depth - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_white_wall_that_faces_the_light_is_as_white_as_diffuse_and_ambient_light_make_it() {
        let mut wall = wall(2.0, 10.0, [1.0; 4]);
        wall.light = Some(Light { direction: [0.0, 0.0, -1.0], ambient: 0.0, ..Light::default() });
        let middle = surfaces(&wall)[12].expect("the wall").color[0];
        // At roughness 1, the specular term is 0.04 * PI * (1 / PI) * 0.5 / 2, and the diffuse term gets 0.96.
        assert!((decode(middle) - (0.96 + 0.01)).abs() < 1e-6, "{middle}");
        wall.light = Some(Light { direction: [0.0, 0.0, 1.0], ..Light::default() });
        assert!((decode(surfaces(&wall)[12].expect("the wall").color[0]) - 0.25).abs() < 1e-12);
    }

    #[test]
    fn images_repeat_are_interpolated_and_cut_out() {
        let mut wall = wall(2.0, 2.0, [1.0; 4]);
        wall.uvs = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        wall.texels = vec![[255, 255, 255, 255], [0, 0, 0, 0]];
        let image = Texture { first: 0, width: 2, height: 1 };
        wall.materials[0] = MeshMaterial { base_color_image: image, alpha_cutoff: 0.3, ..wall.materials[0] };
        let camera = camera();
        let caster = Caster::new(&wall, &camera, &Rules::PUBLISHED);
        let at = |u: f64| caster.sample(image, [u, 7.5], true).expect("an image")[3];
        for (u, alpha) in [(0.25, 1.0), (0.75, 0.0), (0.5, 0.5), (0.0, 0.5), (-0.75, 1.0), (2.0, 0.5)] {
            assert!((at(u) - alpha).abs() < 1e-12, "{u}");
        }
        let row: Vec<bool> = surfaces(&wall)[10..15].iter().map(Option::is_some).collect();
        // Alpha at u = 0, 1/4, 1/2, 3/4, 1 is 1/2, 1, 1/2, 0, 1/2.
        assert_eq!(row, [true, true, true, false, true]);
    }
}
