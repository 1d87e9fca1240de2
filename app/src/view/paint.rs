//! The painter: from what egui wants drawn to the buffers that the window's graph draws it from.
//!
//! The window is drawn by a render graph like any other, [`GRAPH`], and what it draws comes as buffers with every frame. egui
//! hands over clipped triangle meshes and changes of textures; [`Painter::paint`] packs the meshes one after another, keeps all
//! textures in one buffer of texels, and writes the arguments of one indirect draw. The vertex shader fetches vertices by
//! index; the fragment shader clips and filters. What lies under the user interface is said by a [`Composition`].
//!
//! The structs here are those of `shaders/window/ui.glsl` and `shaders/window/window.glsl`.

use bytemuck::{Pod, Zeroable};
use egui::epaint::textures::TexturesDelta;
use egui::epaint::{ClippedPrimitive, Mesh, Primitive};
use splatgraph_api::Given;
use splatgraph_framework::ir::{Catalog, GivenBuffer};
use std::collections::BTreeMap;
use std::sync::Arc;
use textures::{Texture, Textures};

pub use composition::{Composition, Mode, Shown, WINDOW, WINDOW_BYTES};

mod composition;
#[cfg(test)]
mod tests;
mod textures;

/// The built-in graph that draws the window.
pub const GRAPH: &str = "view/window";

/// The vertices of all meshes.
pub const VERTICES: &str = "frame.ui_vertices";
/// Their indices, three for each triangle, counted through all meshes.
pub const INDICES: &str = "frame.ui_indices";
/// Clip rectangle and texture of each mesh.
pub const CLIPS: &str = "frame.ui_clips";
/// The texels of all textures, rgba8, display-encoded and premultiplied.
pub const TEXELS: &str = "frame.ui_texels";
/// The arguments of the indirect draw.
pub const DRAW: &str = "frame.ui_draw";
/// The pictures that are shown: their pixels, packed.
pub const PICTURES: [&str; 2] = ["frame.picture_a", "frame.picture_b"];

/// A vertex as the shader reads it.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct Vertex {
    /// In pixels of the window.
    position: [f32; 2],
    /// 0 to 1 across the texture.
    uv: [f32; 2],
    /// Red, green, blue, alpha.
    colour: [u8; 4],
    /// Which of the clips.
    clip: u32,
}

/// Where a mesh may draw, and its texture.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct Clip {
    /// The top left pixel.
    first: [f32; 2],
    /// The one below and to the right of the last.
    beyond: [f32; 2],
    texture: Texture,
}

/// Adds what the window's graph imports to a catalog.
pub fn offer(catalog: &mut Catalog) {
    let words = GivenBuffer { stride: 4, least: 1 };
    let buffers = [
        (VERTICES, GivenBuffer { stride: size_of::<Vertex>() as u64, least: 1 }),
        (INDICES, words),
        (CLIPS, GivenBuffer { stride: size_of::<Clip>() as u64, least: 1 }),
        (TEXELS, words),
        (DRAW, GivenBuffer { stride: 4, least: 4 }),
        (PICTURES[0], words),
        (PICTURES[1], words),
    ];
    catalog.buffers.extend(buffers.map(|(name, buffer)| (name.to_owned(), buffer)));
    catalog.uniforms.insert(WINDOW.to_owned(), WINDOW_BYTES);
}

/// Keeps the textures, and packs meshes. One for each egui context.
#[derive(Debug, Default)]
pub struct Painter {
    textures: Textures,
}

/// The buffers of one frame's user interface. Each holds at least one element, which an empty interface does not draw.
#[derive(Clone, Debug)]
pub struct Painted {
    vertices: Arc<Vec<u8>>,
    indices: Arc<Vec<u8>>,
    clips: Arc<Vec<u8>>,
    texels: Arc<Vec<u8>>,
    draw: Arc<Vec<u8>>,
    /// Primitives that could not be drawn: paint callbacks, which are code for another painter, and meshes that are malformed or
    /// whose texture egui never handed over.
    pub left_out: usize,
}

impl Painted {
    /// Adds them to a frame's inputs.
    pub fn give(&self, buffers: &mut BTreeMap<String, Given>) {
        let all = [
            (VERTICES, &self.vertices),
            (INDICES, &self.indices),
            (CLIPS, &self.clips),
            (TEXELS, &self.texels),
            (DRAW, &self.draw),
        ];
        buffers.extend(all.map(|(name, bytes)| (name.to_owned(), Given::Bytes(bytes.clone()))));
    }
}

impl Painter {
    /// Takes what one pass of egui gave: `FullOutput::textures_delta`, of which none may be left out, and the meshes of
    /// `Context::tessellate` with the pixels per point that they were made for.
    pub fn paint(
        &mut self,
        mut changes: TexturesDelta,
        primitives: &[ClippedPrimitive],
        pixels_per_point: f32,
    ) -> Painted {
        let freed = std::mem::take(&mut changes.free);
        self.textures.set(std::mem::take(&mut changes.set));
        let mut meshes = Meshes::default();
        let mut left_out = 0;
        for ClippedPrimitive { clip_rect, primitive } in primitives {
            let drawable = match primitive {
                Primitive::Mesh(mesh) if mesh.is_valid() && mesh.indices.len() % 3 == 0 => {
                    self.textures.get(mesh.texture_id).map(|texture| (mesh, texture))
                }
                Primitive::Mesh(_) | Primitive::Callback(_) => None,
            };
            let Some((mesh, texture)) = drawable else {
                left_out += 1;
                continue;
            };
            // Whole pixels, so that neighbours neither overlap nor leave a gap; and no infinities.
            let pixel = |p: egui::Pos2| [p.x, p.y].map(|v| (v * pixels_per_point).round().clamp(-1e6, 1e6));
            let clip = Clip { first: pixel(clip_rect.min), beyond: pixel(clip_rect.max), texture };
            meshes.add(mesh, clip, pixels_per_point);
        }
        let painted = Painted {
            draw: bytes(&[meshes.indices.len() as u32, 1, 0, 0]),
            vertices: bytes(&meshes.vertices),
            indices: bytes(&meshes.indices),
            clips: bytes(&meshes.clips),
            texels: self.textures.texels(),
            left_out,
        };
        // This frame may still draw with what goes now.
        self.textures.free(freed);
        painted
    }
}

/// Meshes, one after another.
#[derive(Default)]
struct Meshes {
    vertices: Vec<Vertex>,
    indices: Vec<u32>,
    clips: Vec<Clip>,
}

impl Meshes {
    fn add(&mut self, mesh: &Mesh, clip: Clip, pixels_per_point: f32) {
        let first = self.vertices.len() as u32;
        let index = self.clips.len() as u32;
        self.clips.push(clip);
        self.indices.extend(mesh.indices.iter().map(|i| first + i));
        self.vertices.extend(mesh.vertices.iter().map(|vertex| Vertex {
            position: [vertex.pos.x * pixels_per_point, vertex.pos.y * pixels_per_point],
            uv: [vertex.uv.x, vertex.uv.y],
            colour: vertex.color.to_array(),
            clip: index,
        }));
    }
}

/// The bytes of the elements, of a zero where there are none: no buffer is empty.
fn bytes<T: Pod>(elements: &[T]) -> Arc<Vec<u8>> {
    let none = [T::zeroed()];
    let elements = if elements.is_empty() { &none } else { elements };
    Arc::new(bytemuck::cast_slice(elements).to_vec())
}
