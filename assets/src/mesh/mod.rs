//! Stores a triangle mesh beside the splats of a scene.
//!
//! A mesh is one list of vertices and one list of triangles. The nodes and primitives of its file are joined on load,
//! with their transforms applied. A material has factors and up to four images (base colour, metalness and roughness,
//! normals, emission), as in glTF 2.0. [`Mesh::parse`] reads glTF, [`Mesh::write_glb`] writes it.
//!
//! A file's axes point left, up and to the front; a scene's point right, down and to the front. On load, x and y change
//! their signs, as for splats in glTF.

mod data;
mod gltf;
mod image;
mod write;

pub use data::{Light, MESH_ATTRIBUTES, Mesh, MeshMaterial, Texture};

#[cfg(test)]
mod tests;
