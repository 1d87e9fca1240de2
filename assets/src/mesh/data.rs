//! Defines the triangles, materials and texels of a mesh, and packs them for GPU buffers.

use crate::similarity::Similarity;
use crate::words::{AttributeInfo, hash, mix};
use glam::DVec3;
use std::borrow::Cow;

/// Names of a mesh's attributes, by which graphs import them.
pub const MESH_ATTRIBUTES: [&str; 8] = [
    "mesh.position",
    "mesh.normal",
    "mesh.uv",
    "mesh.index",
    "mesh.material_of",
    "mesh.material",
    "mesh.texel",
    "mesh.light",
];

/// The location of a material's image among the texels of its mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Texture {
    /// Index of the first texel, at the top left. Rows follow without gaps.
    pub first: u32,
    /// Width in texels, at most 65,535; 0 for no image.
    pub width: u32,
    /// Height in texels, at most 65,535.
    pub height: u32,
}

/// The material of a triangle: the metallic-roughness model of glTF 2.0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshMaterial {
    /// Linear red, green, blue, and alpha; multiplied by the image.
    pub base_color: [f32; 4],
    /// Metalness, 0 to 1; multiplied by the image's blue channel.
    pub metallic: f32,
    /// Roughness, 0 to 1; multiplied by the image's green channel.
    pub roughness: f32,
    /// Factor on x and y of the normals in the image.
    pub normal_scale: f32,
    /// Minimum alpha: fragments below it are discarded. 0 keeps all.
    pub alpha_cutoff: f32,
    /// Image of display-encoded colours and alpha.
    pub base_color_image: Texture,
    /// Image with roughness in green and metalness in blue.
    pub metallic_roughness_image: Texture,
    /// Image of normals in tangent space: channels of 0 to 1 are components of -1 to 1.
    pub normal_image: Texture,
    /// Linear red, green and blue of the emitted light; multiplied by the image.
    pub emission: [f32; 3],
    /// Image of display-encoded colours of the emitted light.
    pub emission_image: Texture,
    /// True for a surface of its base colour, without light and emission (`KHR_materials_unlit`).
    pub unlit: bool,
}

impl Default for MeshMaterial {
    /// Returns glTF's default material: white, metallic and rough.
    fn default() -> Self {
        Self {
            base_color: [1.0; 4],
            metallic: 1.0,
            roughness: 1.0,
            normal_scale: 1.0,
            alpha_cutoff: 0.0,
            base_color_image: Texture::default(),
            metallic_roughness_image: Texture::default(),
            normal_image: Texture::default(),
            emission: [0.0; 3],
            emission_image: Texture::default(),
            unlit: false,
        }
    }
}

/// The light on a mesh: one direction, and ambient light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Unit vector to the light, in the world.
    pub direction: [f32; 3],
    /// Linear red, green and blue. A white surface that faces a light of 1 is white.
    pub color: [f32; 3],
    /// Ambient light, as a share of the base colour.
    pub ambient: f32,
}

impl Default for Light {
    /// Returns white light from the upper left, on the side of -z.
    fn default() -> Self {
        Self { direction: [-0.48, -0.64, -0.6], color: [1.0; 3], ambient: 0.25 }
    }
}

/// A mesh: triangles with materials, and the light on them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, in world units: in a scene, relative to [`Scene::offset`](crate::Scene::offset); otherwise
    /// relative to `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals, one per position.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, one per position. (0, 0) is the image's top left corner; images repeat.
    pub uvs: Vec<[f32; 2]>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Index of the material of each triangle.
    pub material_of: Vec<u32>,
    /// The materials.
    pub materials: Vec<MeshMaterial>,
    /// Texels of all images: red, green, blue and alpha, 8 bits each.
    pub texels: Vec<[u8; 4]>,
    /// The light on the mesh; `None` for the default one, which does not turn with the mesh.
    pub light: Option<Light>,
    /// World coordinates that positions are relative to, because f32 is coarse far from 0; 0 in a scene.
    pub origin: [f64; 3],
    /// Parts of its files that are not drawn, a phrase for each file that has such parts.
    pub left_out: Vec<String>,
}

impl Mesh {
    /// Returns the layout of an attribute and its number of elements; `None` if the name is not among
    /// [`MESH_ATTRIBUTES`].
    ///
    /// An empty list counts as one element of zeros, because buffers cannot be empty.
    pub fn attribute(&self, name: &str) -> Option<AttributeInfo> {
        let (stride, count) = match name {
            "mesh.position" => (12, self.positions.len()),
            "mesh.normal" => (12, self.normals.len()),
            "mesh.uv" => (8, self.uvs.len()),
            "mesh.index" => (4, 3 * self.triangles.len()),
            "mesh.material_of" => (4, self.material_of.len()),
            "mesh.material" => (80, self.materials.len()),
            "mesh.texel" => (4, self.texels.len()),
            "mesh.light" => (16, 2),
            _ => return None,
        };
        Some(AttributeInfo { stride, planes: 1, count: count.max(1) as u64 })
    }

    /// Returns the words of attribute `name`, which must be one of [`MESH_ATTRIBUTES`].
    fn words(&self, name: &str) -> Cow<'_, [u32]> {
        match name {
            "mesh.position" => bytemuck::cast_slice(&self.positions).into(),
            "mesh.normal" => bytemuck::cast_slice(&self.normals).into(),
            "mesh.uv" => bytemuck::cast_slice(&self.uvs).into(),
            "mesh.index" => self.triangles.as_flattened().into(),
            "mesh.material_of" => self.material_of.as_slice().into(),
            "mesh.material" => self.materials.iter().flat_map(MeshMaterial::words).collect(),
            "mesh.texel" => self.texels.iter().map(|texel| u32::from_le_bytes(*texel)).collect(),
            _ => self.light.unwrap_or_default().words().to_vec().into(),
        }
    }

    /// Writes the part of an attribute of [`MESH_ATTRIBUTES`] that begins at byte `offset` and fills `out`. The one
    /// element of an empty list is zeros.
    pub(crate) fn write_attribute(&self, name: &str, offset: u64, out: &mut [u8]) {
        let words = self.words(name);
        let words = words.iter().skip(offset as usize / 4).copied().chain(std::iter::repeat(0));
        out.chunks_exact_mut(4).zip(words).for_each(|(out, word)| out.copy_from_slice(&word.to_le_bytes()));
    }

    /// Transforms the mesh in the world. Its positions are relative to `from`; the result's are relative to `offset`.
    pub(crate) fn transformed(&self, by: &Similarity, from: [f64; 3], offset: [f64; 3]) -> Self {
        let point = |p: &[f32; 3]| -> [f32; 3] {
            let world = DVec3::from(p.map(f64::from)) + DVec3::from(from);
            (by.point(world) - DVec3::from(offset)).as_vec3().into()
        };
        let normal = |n: &[f32; 3]| (by.rotation * DVec3::from(n.map(f64::from))).as_vec3().into();
        Self {
            positions: self.positions.iter().map(point).collect(),
            normals: self.normals.iter().map(normal).collect(),
            light: self.light.map(|light| Light { direction: normal(&light.direction), ..light }),
            origin: [0.0; 3],
            ..self.clone()
        }
    }

    /// Appends the triangles, materials and images of another mesh, which has the same origin. Takes its light if this
    /// mesh has none.
    pub fn append(&mut self, other: &Self) {
        self.light = self.light.or(other.light);
        let new = other.left_out.iter().filter(|text| !self.left_out.contains(text));
        let new: Vec<String> = new.cloned().collect();
        self.left_out.extend(new);
        let (vertices, materials) = (self.positions.len() as u32, self.materials.len() as u32);
        let texels = self.texels.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.uvs.extend(&other.uvs);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|corner| corner + vertices)));
        self.material_of.extend(other.material_of.iter().map(|material| material + materials));
        let moved = |texture: Texture| Texture { first: texture.first + texels, ..texture };
        self.materials.extend(other.materials.iter().map(|material| MeshMaterial {
            base_color_image: moved(material.base_color_image),
            metallic_roughness_image: moved(material.metallic_roughness_image),
            normal_image: moved(material.normal_image),
            emission_image: moved(material.emission_image),
            ..*material
        }));
        self.texels.extend(&other.texels);
    }

    pub(crate) fn identity(&self) -> u64 {
        let lists = MESH_ATTRIBUTES.map(|name| hash(&self.words(name)));
        lists.into_iter().fold(self.triangles.len() as u64, mix)
    }
}

impl Light {
    /// Packs the light as shaders read it: two vectors of four.
    fn words(&self) -> [u32; 8] {
        let ([x, y, z], [r, g, b]) = (self.direction, self.color);
        [x, y, z, 0.0, r, g, b, self.ambient].map(f32::to_bits)
    }
}

impl MeshMaterial {
    /// Packs the material as shaders read it: 20 words.
    fn words(&self) -> [u32; 20] {
        let image = |t: Texture| [t.first, t.width | t.height << 16];
        let [r, g, b, a] = self.base_color.map(f32::to_bits);
        let factors = [self.metallic, self.roughness, self.normal_scale, self.alpha_cutoff].map(f32::to_bits);
        let [m, s, n, c] = factors;
        let [er, eg, eb] = self.emission.map(f32::to_bits);
        let [b0, b1] = image(self.base_color_image);
        let [r0, r1] = image(self.metallic_roughness_image);
        let [n0, n1] = image(self.normal_image);
        let [e0, e1] = image(self.emission_image);
        let unlit = f32::from(u8::from(self.unlit)).to_bits();
        [r, g, b, a, m, s, n, c, b0, b1, r0, r1, n0, n1, e0, e1, er, eg, eb, unlit]
    }
}
