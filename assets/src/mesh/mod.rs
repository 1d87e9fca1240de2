//! Stores a triangle mesh beside the splats of a scene.
//!
//! A mesh is one list of vertices and one of triangles, whatever nodes and primitives its file has: their transforms are applied on load.
//! A material has factors and up to three images (base colour, metalness and roughness, normals), after glTF 2.0. [`Mesh::parse`] reads
//! glTF, [`Mesh::write_glb`] writes it.
//!
//! Axes of files point left, up and front, those of scenes right, down and front. On load, x and y change their signs, as for splats in
//! glTF.

mod data;
mod gltf;
mod image;
mod write;

pub use data::{Light, MESH_ATTRIBUTES, Mesh, MeshMaterial, Texture};
pub(crate) use gltf::begins_as_gltf;

#[cfg(test)]
mod tests;
