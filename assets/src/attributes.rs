//! Writes attributes of splats and meshes as little-endian bytes for GPU buffers, and hashes scenes.
//!
//! An attribute of splats has one entry per splat; an attribute of the mesh, one per element of its list. Spherical
//! harmonics (up to 48 floats per splat) are split into *planes* of four floats, each for a buffer of its own.

use crate::error::nearest;
use crate::mesh::{MESH_ATTRIBUTES, Mesh};
use crate::scene::{Scene, sh_floats};
use crate::words::{AttributeInfo, CHUNK, hash, mix, write_floats};
use rayon::prelude::*;
use std::ops::Range;
use tracing::info_span;

/// Maximum number of planes of spherical harmonics; planes above the stored degree are zero.
const MAX_SH_PLANES: u32 = 12;

/// Names of the attributes of splats.
///
/// Positions and scales have 3 floats, wide positions 6 (the rounded position, then the remainder), rotations 4 (a
/// quaternion w x y z), opacities 1. Spherical harmonics come in planes of 4 floats: float `3 * k + c` of coefficient
/// `k`, channel `c`, is in plane `(3 * k + c) / 4`.
pub const ATTRIBUTES: [&str; 6] =
    ["scene.position", "scene.position_wide", "scene.scale", "scene.rotation", "scene.opacity", "scene.sh"];

/// Prefix of the attributes that are further properties of a PLY file, such as `scene.property.label`: 1 float.
pub const PROPERTY_ATTRIBUTE: &str = "scene.property.";

impl Scene {
    /// Finds the index in [`Scene::property_names`] of an attribute.
    fn property_of(&self, attribute: &str) -> Option<usize> {
        let name = attribute.strip_prefix(PROPERTY_ATTRIBUTE)?;
        self.property_names().iter().position(|own| own == name)
    }

    /// Returns the layout of an attribute; `None` if the name is not among [`ATTRIBUTES`] and [`MESH_ATTRIBUTES`], and
    /// is no further property of the scene.
    pub fn attribute(&self, name: &str) -> Option<AttributeInfo> {
        let (stride, planes) = match name {
            _ if self.property_of(name).is_some() => (4, 1),
            "scene.position" | "scene.scale" => (12, 1),
            "scene.position_wide" => (24, 1),
            "scene.rotation" => (16, 1),
            "scene.opacity" => (4, 1),
            "scene.sh" => (16, sh_floats(self.stored_degree()).div_ceil(4) as u32),
            _ => {
                return self
                    .mesh()
                    .map_or_else(|| Mesh::default().attribute(name), |mesh| mesh.attribute(name));
            }
        };
        Some(AttributeInfo { stride, planes, count: self.count().into() })
    }

    /// Writes a part of one plane of an attribute: the bytes from `offset` on that fill `out`.
    ///
    /// A plane has `stride` times `count` bytes ([`Scene::attribute`]); a part consists of whole entries. In a scene
    /// without a mesh, the mesh's attributes are zeros.
    ///
    /// # Errors
    /// The name, the plane or the part is invalid; the text says which.
    pub fn write_attribute(&self, name: &str, plane: u32, offset: u64, out: &mut [u8]) -> Result<(), String> {
        let info = self.attribute(name).ok_or_else(|| {
            let all = || ATTRIBUTES.into_iter().chain(MESH_ATTRIBUTES);
            let near = nearest(name, all()).map(|n| format!("; did you mean {n}?")).unwrap_or_default();
            let all: Vec<&str> = all().collect();
            format!("there is no attribute {name} (available: {}){near}", all.join(", "))
        })?;
        let planes = if name == "scene.sh" { MAX_SH_PLANES } else { 1 };
        if plane >= planes {
            return Err(format!("{name} has no plane {plane}; the last is {}", planes - 1));
        }
        let bytes = info.stride * info.count;
        let length = out.len() as u64;
        let whole = offset.is_multiple_of(info.stride) && length.is_multiple_of(info.stride);
        if !whole || offset.checked_add(length).is_none_or(|end| end > bytes) {
            return Err(format!(
                "{name} has {bytes} bytes ({} elements of {}), and no piece of {length} at {offset}",
                info.count, info.stride,
            ));
        }
        let first = (offset / info.stride) as usize;
        let here = first..first + (length / info.stride) as usize;
        match name {
            "scene.position" => write_floats(&self.positions()[here], out),
            "scene.position_wide" => self.write_wide_positions(here, out),
            "scene.scale" => write_floats(&self.scales()[here], out),
            "scene.rotation" => write_floats(&self.rotations()[here], out),
            "scene.opacity" => write_floats(&self.opacities()[here], out),
            "scene.sh" => self.write_sh_plane(plane, here, out),
            _ if let Some(property) = self.property_of(name) => {
                let values = out.chunks_exact_mut(4).zip(here);
                values.for_each(|(out, at)| out.copy_from_slice(&self.property(at, property).to_le_bytes()));
            }
            _ => match self.mesh() {
                Some(mesh) => mesh.write_attribute(name, offset, out),
                None => out.fill(0),
            },
        }
        Ok(())
    }

    fn write_sh_plane(&self, plane: u32, splats: Range<usize>, out: &mut [u8]) {
        let floats = sh_floats(self.stored_degree());
        let first = (4 * plane as usize).min(floats);
        let here = first..floats.min(first + 4);
        let sh = &self.sh()[splats.start * floats..splats.end * floats];
        out.par_chunks_mut(16 * CHUNK).zip(sh.par_chunks(floats * CHUNK)).for_each(|(out, sh)| {
            for (out, sh) in out.chunks_exact_mut(16).zip(sh.chunks_exact(floats)) {
                let mut entry = [0; 16];
                for (out, value) in entry.chunks_exact_mut(4).zip(&sh[here.clone()]) {
                    out.copy_from_slice(&value.to_le_bytes());
                }
                out.copy_from_slice(&entry);
            }
        });
    }

    /// Writes each position as two triples of floats that sum to it.
    fn write_wide_positions(&self, splats: Range<usize>, out: &mut [u8]) {
        out.par_chunks_mut(24).zip(splats).for_each(|(out, index)| {
            let high = self.columns.position[index];
            let low = self.columns.low.get(index).copied().unwrap_or_default();
            for (out, value) in out.chunks_exact_mut(4).zip(high.into_iter().chain(low)) {
                out.copy_from_slice(&value.to_le_bytes());
            }
        });
    }

    /// Returns a hash of the splats and the mesh, computed once. Equal scenes have equal hashes, whatever their files.
    ///
    /// It leaves out the tags ([`FileNotes::rules`](crate::FileNotes::rules)) and [`Scene::offset`], which attributes
    /// do not depend on, but pictures do.
    pub fn identity(&self) -> u64 {
        *self.identity.get_or_init(|| {
            let _span = info_span!("hash the scene").entered();
            let c = &self.columns;
            let head = [u64::from(self.count()), u64::from(c.degree)];
            let columns = [
                hash(&c.position),
                hash(&c.low),
                hash(&c.scale),
                hash(&c.rotation),
                hash(&c.opacity),
                hash(&c.sh),
            ];
            let properties =
                c.property_names.iter().map(|name| hash(&name.chars().map(u32::from).collect::<Vec<_>>()));
            let property = (!c.property.is_empty()).then(|| hash(&c.property));
            let mesh = self.mesh().map(Mesh::identity);
            head.into_iter().chain(columns).chain(mesh).chain(properties).chain(property).fold(0, mix)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{says, splat};

    fn floats(scene: &Scene, name: &str, plane: u32) -> Vec<f32> {
        let stride = scene.attribute(name).unwrap().stride as usize;
        let mut bytes = vec![0xAA; stride * scene.count() as usize];
        // Two calls cover a nonzero offset.
        let (first, second) = bytes.split_at_mut(stride * (scene.count() as usize / 3));
        scene.write_attribute(name, plane, 0, first).unwrap();
        scene.write_attribute(name, plane, first.len() as u64, second).unwrap();
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    }

    #[test]
    fn attributes_are_the_arrays_as_bytes() {
        let scene = Scene::generate(CHUNK as u32 + 5, 0, splat);
        assert_eq!(floats(&scene, "scene.position", 0), scene.positions().as_flattened());
        assert_eq!(floats(&scene, "scene.scale", 0), scene.scales().as_flattened());
        assert_eq!(floats(&scene, "scene.rotation", 0), scene.rotations().as_flattened());
        assert_eq!(floats(&scene, "scene.opacity", 0), scene.opacities());
    }

    #[test]
    fn the_planes_of_the_harmonics_hold_four_interleaved_floats_and_then_zeros() {
        for (degree, planes) in [(0, 1), (1, 3), (2, 7), (3, 12)] {
            let scene = Scene::generate(CHUNK as u32 + 5, degree, splat);
            assert_eq!(scene.attribute("scene.sh").unwrap().planes, planes);
            for plane in 0..12 {
                let written = floats(&scene, "scene.sh", plane);
                for index in [0, 1, CHUNK + 4] {
                    let mut expected = scene.splat(index).sh;
                    expected[sh_floats(degree)..].fill(0.0);
                    let here = 4 * plane as usize;
                    assert_eq!(
                        written[4 * index..][..4],
                        expected[here..here + 4],
                        "plane {plane} of {degree}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_said() {
        let scene = Scene::generate(4, 3, splat);
        let piece = |name: &str, plane, offset, bytes| {
            scene.write_attribute(name, plane, offset, &mut vec![0; bytes]).unwrap_err()
        };
        let error = |name: &str, plane, bytes| piece(name, plane, 0, bytes);
        says(piece("scene.scale", 0, 4, 12), "no piece of 12 at 4");
        says(piece("scene.scale", 0, 36, 24), "no piece of 24 at 36");
        says(piece("scene.scale", 0, u64::MAX - 3, 12), "has 48 bytes");
        says(error("scene.positions", 0, 48), "did you mean scene.position?");
        says(error("scene.scale", 1, 48), "no plane 1");
        says(error("scene.sh", 12, 64), "the last is 11");
        says(error("scene.scale", 0, 47), "has 48 bytes (4 elements of 12), and no piece of 47 at 0");
    }

    #[test]
    fn the_identity_is_of_the_content() {
        let make = |change: usize| {
            Scene::generate(100, 2, move |i| {
                let mut s = splat(i);
                match change {
                    1 if i == 99 => s.position[2] += 1e-3,
                    2 if i == 7 => s.sh[26] = 0.5,
                    _ => {}
                }
                s
            })
        };
        let identity = make(0).identity();
        assert_eq!(identity, make(0).identity());
        assert_ne!(identity, make(1).identity());
        assert_ne!(identity, make(2).identity());
    }
}
