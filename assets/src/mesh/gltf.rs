//! Reads meshes from glTF 2.0, as text or binary (`.gltf`, `.glb`).
//!
//! Each node of the scene is visited once, and its transform is applied to its mesh. Of the lights (`KHR_lights_punctual`),
//! only the directional one visited first is read: its direction and colour. Skins, morph targets, animations and cameras
//! are ignored.

use super::data::{Light, Mesh, MeshMaterial, Texture};
use super::image::{self, MAX_TEXELS};
use crate::error::{SceneError, wrong};
use crate::file;
use crate::gltf::{Column, Container, Material, Primitive, TextureInfo, item};
use crate::input::Source;
use crate::memory;
use crate::uri::{self, Resource};
use glam::{DMat3, DMat4, DVec3};
use std::collections::HashMap;
use std::path::Path;

/// Maximum size of an image in its own file, in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// Maximum number of triangles, and of vertices, over all nodes.
const MAX_ELEMENTS: usize = 1 << 26;

/// The `mode` of a primitive of triangles.
const TRIANGLES: u32 = 4;

impl Mesh {
    /// Parses the bytes of a glTF file. Its buffers and images are read from `folder`.
    ///
    /// # Errors
    /// The bytes are not glTF 2.0 or are damaged, require an extension other than `KHR_mesh_quantization`, have primitives
    /// other than triangles, or have no triangles; a buffer or an image cannot be read; or a limit is exceeded. The text
    /// names the accessor, node or image.
    pub fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<Self, SceneError> {
        Self::read(&Source::Bytes(bytes), folder, memory::available())
    }

    /// Reads a glTF file like [`Mesh::parse`]. Refuses buffers that do not fit twice in the `available` memory.
    pub(crate) fn read(
        source: &Source,
        folder: Option<&Path>,
        available: Option<u64>,
    ) -> Result<Self, SceneError> {
        let container = Container::open(source, folder)?;
        let document = &container.document;
        let bytes = document.buffers.iter().fold(0u64, |sum, buffer| sum.saturating_add(buffer.byte_length));
        if let Some(most) = available.map(|available| available / 2).filter(|most| bytes > *most) {
            return Err(wrong("buffers", format!("expected at most {most} bytes, found {bytes}")));
        }
        let mut reader = Reader {
            container: &container,
            folder,
            images: HashMap::new(),
            materials: HashMap::new(),
            mesh: Self::default(),
        };
        // Converts axes that point left, up and to the front to right, down and front, as for splats in glTF.
        let axes = DMat4::from_scale(DVec3::new(-1.0, -1.0, 1.0));
        let mut lit = false;
        for (index, place) in document.placed()? {
            let (node, world) = (&document.nodes[index], axes * place);
            if let Some(color) = document.sun(node)?.filter(|_| !lit) {
                // A light shines along its node's -z.
                let direction = world.transform_vector3(DVec3::Z).normalize_or(DVec3::NEG_Y).as_vec3().into();
                reader.mesh.light = Light { direction, color, ..Light::default() };
                lit = true;
            }
            for primitive in document.primitives(node)? {
                reader.primitive(primitive, &world, &format!("nodes[{index}]"))?;
            }
        }
        match reader.mesh.triangles.is_empty() {
            true => Err(wrong("meshes", "expected triangles, found none")),
            false => Ok(reader.mesh),
        }
    }
}

struct Reader<'a> {
    container: &'a Container<'a>,
    folder: Option<&'a Path>,
    images: HashMap<usize, Texture>,
    /// Indices of materials in the mesh, by index in the file; `None` is the default material.
    materials: HashMap<Option<usize>, u32>,
    mesh: Mesh,
}

impl Reader<'_> {
    fn primitive(&mut self, primitive: &Primitive, world: &DMat4, part: &str) -> Result<(), SceneError> {
        if let Some(mode) = primitive.mode.filter(|mode| *mode != TRIANGLES) {
            let text = format!("expected a primitive of triangles, mode {TRIANGLES}, found mode {mode}");
            return Err(wrong(part, text));
        }
        let positions = self.floats::<3>(primitive, "POSITION")?;
        let positions =
            positions.ok_or_else(|| wrong(part, "expected a primitive with positions, found none"))?;
        let corners = match primitive.indices {
            Some(indices) => self.indices(indices, positions.len())?,
            None => (0..positions.len() as u32).collect(),
        };
        let triangles: Vec<[u32; 3]> = corners.as_chunks().0.to_vec();
        let (vertices, all) = (self.mesh.positions.len(), self.mesh.triangles.len() + triangles.len());
        if vertices + 3 * positions.len() > MAX_ELEMENTS || all > MAX_ELEMENTS {
            let message =
                format!("expected at most {MAX_ELEMENTS} vertices and triangles in all, found more");
            return Err(wrong(part, message));
        }
        let uvs = self.floats::<2>(primitive, "TEXCOORD_0")?;
        let normals = self.floats::<3>(primitive, "NORMAL")?;
        let lengths = [uvs.as_ref().map(Vec::len), normals.as_ref().map(Vec::len)];
        if let Some(other) = lengths.into_iter().flatten().find(|length| *length != positions.len()) {
            let text = format!("expected {} of every attribute, found {other}", positions.len());
            return Err(wrong(part, text));
        }
        let material = self.material(primitive.material)?;
        self.mesh.material_of.extend(std::iter::repeat_n(material, triangles.len()));

        let point = |p: [f32; 3]| world.transform_point3(DVec3::from(p.map(f64::from)));
        let points: Vec<DVec3> = positions.iter().copied().map(point).collect();
        if !points.iter().all(|p| p.abs().max_element() <= 1e18) {
            return Err(wrong(part, "expected positions within 1e18, found one beyond"));
        }
        let first = vertices as u32;
        match normals {
            Some(normals) => {
                // The cofactor matrix keeps normals perpendicular to their surface under a non-uniform scale.
                let turn = cofactors(world);
                let normal = |n: [f32; 3]| turn * DVec3::from(n.map(f64::from));
                let unit = |n| <[f32; 3]>::from(normal(n).normalize_or(DVec3::NEG_Y).as_vec3());
                let list = normals.into_iter().map(unit);
                self.mesh.normals.extend(list);
                self.mesh.positions.extend(points.iter().map(|p| <[f32; 3]>::from(p.as_vec3())));
                self.mesh.uvs.extend(uvs.unwrap_or_else(|| vec![[0.0; 2]; points.len()]));
                self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|corner| corner + first)));
            }
            // Without normals, triangles are flat-shaded, and each has its own vertices.
            None => {
                for (number, triangle) in triangles.iter().enumerate() {
                    let corners = triangle.map(|corner| points[corner as usize]);
                    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                    // A mirroring transform reverses the winding.
                    let normal = normal.normalize_or(DVec3::NEG_Y) * world.determinant().signum();
                    for (corner, place) in triangle.iter().zip(corners) {
                        self.mesh.positions.push(place.as_vec3().into());
                        self.mesh.normals.push(normal.as_vec3().into());
                        self.mesh.uvs.push(uvs.as_ref().map_or([0.0; 2], |uvs| uvs[*corner as usize]));
                    }
                    self.mesh.triangles.push([0, 1, 2].map(|corner| first + 3 * number as u32 + corner));
                }
            }
        }
        Ok(())
    }

    fn column(&self, index: usize, width: usize) -> Result<Column<'_>, SceneError> {
        let part = format!("accessors[{index}]");
        let column = Column::open(self.container, &part, index, width)?;
        let most = 3 * MAX_ELEMENTS as u64;
        match column.count > most {
            true => Err(wrong(part, format!("expected at most {most} elements, found {}", column.count))),
            false => Ok(column),
        }
    }

    /// Reads an attribute, a vector per vertex; `None` if the primitive lacks it.
    fn floats<const N: usize>(
        &self,
        primitive: &Primitive,
        name: &str,
    ) -> Result<Option<Vec<[f32; N]>>, SceneError> {
        let Some(index) = primitive.attributes.get(name) else { return Ok(None) };
        let read = self.column(*index, N)?.floats()?;
        match read.iter().find(|value| !value.is_finite()) {
            None => Ok(Some(read.as_chunks().0.to_vec())),
            Some(value) => {
                let text = format!("expected finite numbers, found {value}");
                Err(wrong(format!("accessors[{index}]"), text))
            }
        }
    }

    /// Reads indices of vertices, each below `vertices`.
    fn indices(&self, index: usize, vertices: usize) -> Result<Vec<u32>, SceneError> {
        let column = self.column(index, 1)?;
        if !["uchar", "ushort", "uint"].contains(&column.kind()) {
            let text = format!("expected unsigned integers, found {}", column.kind());
            return Err(wrong(format!("accessors[{index}]"), text));
        }
        let read = column.integers()?;
        match read.iter().find(|vertex| **vertex as usize >= vertices) {
            None => Ok(read),
            Some(vertex) => {
                let text = format!("expected indices below {vertices}, found {vertex}");
                Err(wrong(format!("accessors[{index}]"), text))
            }
        }
    }

    fn material(&mut self, index: Option<usize>) -> Result<u32, SceneError> {
        if let Some(known) = self.materials.get(&index) {
            return Ok(*known);
        }
        let (container, default) = (self.container, Material::default());
        let material = match index {
            Some(index) => item(&container.document.materials, index, "materials")?,
            None => &default,
        };
        let pbr = &material.pbr_metallic_roughness;
        let made = MeshMaterial {
            base_color: pbr.base_color_factor,
            metallic: pbr.metallic_factor,
            roughness: pbr.roughness_factor,
            normal_scale: material.normal_texture.as_ref().and_then(|texture| texture.scale).unwrap_or(1.0),
            alpha_cutoff: if material.alpha_mode == "MASK" { material.alpha_cutoff } else { 0.0 },
            base_color_image: self.texture(pbr.base_color_texture.as_ref())?,
            metallic_roughness_image: self.texture(pbr.metallic_roughness_texture.as_ref())?,
            normal_image: self.texture(material.normal_texture.as_ref())?,
        };
        let number = self.mesh.materials.len() as u32;
        self.mesh.materials.push(made);
        self.materials.insert(index, number);
        Ok(number)
    }

    /// Unpacks the image of a texture into the mesh's texels, each image once. Without a texture, returns the empty one.
    fn texture(&mut self, info: Option<&TextureInfo>) -> Result<Texture, SceneError> {
        let Some(info) = info else { return Ok(Texture::default()) };
        let (container, part) = (self.container, format!("textures[{}]", info.index));
        if info.tex_coord != 0 {
            let text = format!("expected an image placed by TEXCOORD_0, found TEXCOORD_{}", info.tex_coord);
            return Err(wrong(part, text));
        }
        let texture = item(&container.document.textures, info.index, "textures")?;
        let index = texture.source.ok_or_else(|| wrong(part, "expected a source, found none"))?;
        if let Some(known) = self.images.get(&index) {
            return Ok(*known);
        }
        let part = format!("images[{index}]");
        let image = item(&container.document.images, index, "images")?;
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => match uri::resolve(uri, self.folder).map_err(|text| wrong(&part, text))? {
                Resource::Data(bytes) => bytes,
                Resource::File(path) => file::read(path, MAX_BYTES)
                    .map_err(|error| wrong(&part, format!("{}: {error}", uri::shown(uri))))?,
            },
            (None, Some(view)) => container.bytes(view)?,
            (None, None) => return Err(wrong(part, "expected a URI or a buffer view, found neither")),
        };
        let left = MAX_TEXELS - self.mesh.texels.len() as u64;
        let unpacked = image::unpack(&bytes, &part, left)?;
        let first = self.mesh.texels.len() as u32;
        let texture = Texture { first, width: unpacked.width, height: unpacked.height };
        self.mesh.texels.extend(unpacked.texels);
        self.images.insert(index, texture);
        Ok(texture)
    }
}

/// Computes the matrix that transforms normals: the cofactors of the linear part, negated if it mirrors.
fn cofactors(world: &DMat4) -> DMat3 {
    let m = DMat3::from_mat4(*world);
    let sign = m.determinant().signum();
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)) * sign
}
