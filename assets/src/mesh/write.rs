//! Writes meshes as binary glTF (`.glb`).

use super::data::{Mesh, MeshMaterial, Texture};
use crate::gltf::write_head;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::{Error, Write};

/// A document in progress: the bytes of the binary chunk, and the JSON that describes them.
#[derive(Default)]
struct Writer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    images: Vec<Value>,
    materials: Vec<Value>,
}

impl Writer {
    /// Appends bytes, and returns the index of their buffer view.
    fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}));
        self.views.len() - 1
    }

    /// Appends floats, and returns the index of their accessor.
    fn floats<const N: usize>(&mut self, values: &[[f32; N]], kind: &str) -> usize {
        let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let mut accessor = json!({
            "bufferView": view, "componentType": 5126, "count": values.len(), "type": kind,
        });
        // glTF requires the minimum and maximum of positions, and allows them for other attributes.
        let bound = |pick: fn(f32, f32) -> f32, start: f32| {
            values
                .iter()
                .fold([start; N], |all, value| std::array::from_fn(|i| pick(all[i], value[i])))
                .to_vec()
        };
        accessor["min"] = json!(bound(f32::min, f32::INFINITY));
        accessor["max"] = json!(bound(f32::max, f32::NEG_INFINITY));
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Appends a texture as PNG, and returns its glTF `textureInfo`; `None` for an empty texture.
    fn image(&mut self, mesh: &Mesh, texture: Texture) -> Result<Option<Value>, Error> {
        if texture.width == 0 {
            return Ok(None);
        }
        let count = (texture.width * texture.height) as usize;
        let texels = mesh.texels[texture.first as usize..][..count].as_flattened();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, texture.width, texture.height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(texels)?;
        let view = self.view(&file);
        self.images.push(json!({"bufferView": view, "mimeType": "image/png"}));
        Ok(Some(json!({"index": self.images.len() - 1})))
    }

    fn material(&mut self, mesh: &Mesh, of: &MeshMaterial) -> Result<(), Error> {
        let mut pbr = json!({
            "baseColorFactor": of.base_color, "metallicFactor": of.metallic, "roughnessFactor": of.roughness,
        });
        if let Some(image) = self.image(mesh, of.base_color_image)? {
            pbr["baseColorTexture"] = image;
        }
        if let Some(image) = self.image(mesh, of.metallic_roughness_image)? {
            pbr["metallicRoughnessTexture"] = image;
        }
        let mut material = json!({"pbrMetallicRoughness": pbr});
        if let Some(mut image) = self.image(mesh, of.normal_image)? {
            image["scale"] = json!(of.normal_scale);
            material["normalTexture"] = image;
        }
        if let Some(image) = self.image(mesh, of.emission_image)? {
            material["emissiveTexture"] = image;
        }
        if of.emission != [0.0; 3] {
            material["emissiveFactor"] = json!(of.emission.map(|v| v.min(1.0)));
        }
        if of.unlit {
            material["extensions"] = json!({"KHR_materials_unlit": {}});
        }
        if of.alpha_cutoff > 0.0 {
            material["alphaMode"] = json!("MASK");
            material["alphaCutoff"] = json!(of.alpha_cutoff);
        }
        self.materials.push(material);
        Ok(())
    }
}

impl Mesh {
    /// Writes the mesh as binary glTF, with y up. The light is not written, and emission is clamped to 1.
    ///
    /// # Errors
    /// The writer fails, or the file would have 4 GiB or more.
    pub fn write_glb(&self, out: &mut impl Write) -> Result<(), Error> {
        let mut writer = Writer::default();
        let turned =
            |list: &[[f32; 3]]| -> Vec<[f32; 3]> { list.iter().map(|[x, y, z]| [-x, -y, *z]).collect() };
        let mut primitives = Vec::new();
        for (index, material) in self.materials.iter().enumerate() {
            let of = self.triangles.iter().zip(&self.material_of).filter(|(_, of)| **of as usize == index);
            let corners: Vec<usize> =
                of.flat_map(|(triangle, _)| triangle.map(|corner| corner as usize)).collect();
            let vertices: Vec<usize> = corners.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
            let picked = |list: &[[f32; 3]]| -> Vec<_> { vertices.iter().map(|at| list[*at]).collect() };
            let position = writer.floats(&turned(&picked(&self.positions)), "VEC3");
            let normal = writer.floats(&turned(&picked(&self.normals)), "VEC3");
            let uvs: Vec<[f32; 2]> = vertices.iter().map(|at| self.uvs[*at]).collect();
            let uv = writer.floats(&uvs, "VEC2");
            let corners: Vec<u32> =
                corners.iter().map(|corner| vertices.partition_point(|at| at < corner) as u32).collect();
            let bytes: Vec<u8> = corners.iter().flat_map(|corner| corner.to_le_bytes()).collect();
            let view = writer.view(&bytes);
            writer.accessors.push(json!({
                "bufferView": view, "componentType": 5125, "count": corners.len(), "type": "SCALAR",
            }));
            primitives.push(json!({
                "attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv},
                "indices": writer.accessors.len() - 1, "material": index,
            }));
            writer.material(self, material)?;
        }
        let [x, y, z] = self.origin;
        // Subtraction from 0 avoids a negative zero.
        let node = json!({"mesh": 0, "translation": [0.0 - x, 0.0 - y, z]});
        let mut root = json!({
            "asset": {"version": "2.0", "generator": "splatgraph"},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node], "meshes": [{"primitives": primitives}],
            "materials": writer.materials, "accessors": writer.accessors, "bufferViews": writer.views,
            "buffers": [{"byteLength": writer.bytes.len()}],
        });
        if self.materials.iter().any(|material| material.unlit) {
            root["extensionsUsed"] = json!(["KHR_materials_unlit"]);
        }
        if !writer.images.is_empty() {
            let textures: Vec<Value> =
                (0..writer.images.len()).map(|source| json!({"source": source})).collect();
            (root["images"], root["textures"]) = (json!(writer.images), json!(textures));
        }
        write_head(&root, writer.bytes.len() as u64, out)?;
        out.write_all(&writer.bytes)
    }
}
