//! Converts egui's output to the buffers of the window's graph.
//!
//! A render graph, [`GRAPH`], draws the window from buffers that each frame supplies. [`Painter::paint`] concatenates
//! egui's clipped triangle meshes, keeps all textures in one buffer of texels, and writes the arguments of one indirect
//! draw. A [`Composition`] defines the pictures below the user interface.
//!
//! The graph keeps the window's picture. Each frame redraws the view, and the rectangles around meshes that changed
//! (`damage`). Each area is redrawn completely, from its background up.
//!
//! The structs here match `shaders/window/ui.glsl` and `shaders/window/window.glsl`.

use bytemuck::{Pod, Zeroable};
use damage::{Interface, Piece, misses, scaled};
use egui::epaint::textures::TexturesDelta;
use egui::epaint::{ClippedPrimitive, Primitive};
use egui::{Pos2, Rect, Vec2};
use splatgraph_framework::ir::{Catalog, HostBuffer};
use std::collections::BTreeMap;
use std::sync::Arc;
use textures::{Texture, Textures};

use composition::bytes;
pub use composition::{Composition, Mode, PARTS, PICTURES, Shown, VIEW_DRAW, WINDOW, WINDOW_BYTES};

mod composition;
mod damage;
#[cfg(test)]
mod tests;
mod textures;

/// Name of the built-in graph that draws the window.
pub const GRAPH: &str = "view/window";

/// Name of the buffer with the vertices of the triangles to draw.
pub const VERTICES: &str = "frame.ui_vertices";
/// Name of the buffer with the indices into [`VERTICES`], three per triangle.
pub const INDICES: &str = "frame.ui_indices";
/// Name of the buffer with the clip rectangle and texture of each mesh and background in each redrawn area.
pub const CLIPS: &str = "frame.ui_clips";
/// Name of the buffer with the texels of all textures, rgba8, display-encoded and premultiplied.
pub const TEXELS: &str = "frame.ui_texels";
/// Name of the buffer with the arguments of the indirect draw.
pub const DRAW: &str = "frame.ui_draw";
/// A vertex, in the shader's layout.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct Vertex {
    /// Position, in pixels of the window.
    position: [f32; 2],
    uv: [f32; 2],
    /// Red, green, blue and alpha, premultiplied.
    colour: [u8; 4],
    clip: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct Clip {
    first: [f32; 2],
    /// Bottom right corner, in pixels; exclusive.
    beyond: [f32; 2],
    texture: Texture,
}

/// Adds the imports of the window's graph to a catalog.
pub fn offer(catalog: &mut Catalog) {
    let words = HostBuffer { stride: 4, least: 1 };
    let buffers = [
        (VERTICES, HostBuffer { stride: size_of::<Vertex>() as u64, least: 1 }),
        (INDICES, words),
        (CLIPS, HostBuffer { stride: size_of::<Clip>() as u64, least: 1 }),
        (TEXELS, words),
        (DRAW, HostBuffer { stride: 4, least: 4 }),
        (VIEW_DRAW, HostBuffer { stride: 16, least: PARTS as u64 + 1 }),
    ];
    catalog.buffers.extend(PICTURES.as_flattened().iter().map(|name| ((*name).to_owned(), words)));
    catalog.buffers.extend(buffers.map(|(name, buffer)| (name.to_owned(), buffer)));
    catalog.uniforms.insert(WINDOW.to_owned(), WINDOW_BYTES);
}

/// Packer of egui's meshes and textures; each egui context needs its own.
#[derive(Debug, Default)]
pub struct Painter {
    textures: Textures,
    /// The interface that the window shows; `None` if unknown.
    shown: Option<Interface>,
    packed: Option<Interface>,
}

/// Contents of the buffers of one frame's user interface, by name. Each has at least one element; a placeholder element
/// is not drawn.
pub type Painted = BTreeMap<&'static str, Arc<Vec<u8>>>;

impl Painter {
    /// Packs the output of one pass of egui: all of `FullOutput::textures_delta`, and the meshes of
    /// `Context::tessellate`. `pixels_per_point` scales them to the composition's pixels, along each axis.
    ///
    /// Packs everything over the view, and elsewhere only what covers the difference to the interface in the window:
    /// see [`Painter::drawn`]. Skips paint callbacks, malformed meshes, and meshes with an unknown texture.
    pub fn paint(
        &mut self,
        mut changes: TexturesDelta,
        primitives: Vec<ClippedPrimitive>,
        pixels_per_point: Vec2,
        under: &Composition,
    ) -> Painted {
        let freed = std::mem::take(&mut changes.free);
        self.textures.set(std::mem::take(&mut changes.set));
        let mut pieces = Vec::new();
        for ClippedPrimitive { clip_rect, primitive } in primitives {
            let Primitive::Mesh(mesh) = primitive else { continue };
            let is_sound = mesh.is_valid() && mesh.indices.len() % 3 == 0;
            let Some(texture) = self.textures.get(mesh.texture_id).filter(|_| is_sound) else { continue };
            // Whole pixels, so that adjacent areas neither overlap nor leave gaps.
            let clip = scaled(clip_rect, pixels_per_point).round();
            pieces.push(Piece::new(mesh, clip, texture, pixels_per_point));
        }
        let texels = self.textures.texels();
        let now = Interface::new(under, texels.clone(), pieces);
        let mut meshes = Meshes::default();
        for (area, erased) in now.areas(self.shown.as_ref()) {
            if erased {
                meshes.black(area);
            }
            now.pieces.iter().for_each(|piece| meshes.add(piece, area));
        }
        self.packed = Some(now);
        // This frame may still use the freed textures.
        self.textures.free(freed);
        [
            (VERTICES, bytes(&meshes.vertices)),
            (INDICES, bytes(&meshes.indices)),
            (CLIPS, bytes(&meshes.clips)),
            (TEXELS, texels),
            (DRAW, bytes(&[meshes.indices.len() as u32, 1, 0, 0])),
        ]
        .into()
    }

    /// Records that the window shows the last packed interface.
    pub fn drawn(&mut self) {
        self.shown = self.packed.take();
    }

    /// Returns true if the last packed interface differs from the one in the window, or if either is unknown.
    pub fn differs(&self) -> bool {
        match (&self.packed, &self.shown) {
            (Some(packed), Some(shown)) => !packed.is(shown),
            _ => true,
        }
    }

    /// Forgets the shown interface, so that the next frame packs all of it.
    pub fn forget(&mut self) {
        self.shown = None;
    }
}

#[derive(Default)]
struct Meshes {
    vertices: Vec<Vertex>,
    indices: Vec<u32>,
    clips: Vec<Clip>,
}

impl Meshes {
    /// Adds the triangles that may cover a pixel of the area, and their vertices.
    fn add(&mut self, piece: &Piece, area: Rect) {
        let visible = piece.bounds.intersect(area);
        if !visible.is_positive() {
            return;
        }
        let index = self.clips.len() as u32;
        let (first, beyond) = (visible.min.into(), visible.max.into());
        self.clips.push(Clip { first, beyond, texture: piece.texture });
        let positions = piece.positions();
        let mut places: Vec<Option<u32>> = vec![None; positions.len()];
        for triangle in piece.mesh.indices.as_chunks::<3>().0 {
            let position = |corner: usize| positions[triangle[corner] as usize];
            if misses(visible, [position(0), position(1), position(2)]) {
                continue;
            }
            for i in triangle {
                let i = *i as usize;
                let place = *places[i].get_or_insert_with(|| {
                    let egui::epaint::Vertex { uv, color, .. } = piece.mesh.vertices[i];
                    let (position, uv) = (positions[i].into(), uv.into());
                    self.vertices.push(Vertex { position, uv, colour: color.to_array(), clip: index });
                    self.vertices.len() as u32 - 1
                });
                self.indices.push(place);
            }
        }
    }

    fn black(&mut self, area: Rect) {
        let (clip, first) = (self.clips.len() as u32, self.vertices.len() as u32);
        self.clips.push(Clip { first: area.min.into(), beyond: area.max.into(), texture: Texture::zeroed() });
        // At a `uv` of 0, where egui's white texel is, the shader reads no texture.
        let vertex =
            |position: Pos2| Vertex { position: position.into(), uv: [0.0; 2], colour: [0, 0, 0, 255], clip };
        let corners = [area.left_top(), area.right_top(), area.left_bottom(), area.right_bottom()];
        self.vertices.extend(corners.map(vertex));
        self.indices.extend([0, 1, 2, 1, 2, 3].map(|i| first + i));
    }
}
