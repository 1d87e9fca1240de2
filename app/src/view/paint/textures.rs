//! Packs the texels of all of egui's textures into one buffer.
//!
//! A texture occupies consecutive texels, row by row from the top, in the first gap that is large enough. The [`Arc`]
//! of the bytes is replaced only when textures are set, so an upload of the same [`Arc`] can be skipped.

use bytemuck::{Pod, Zeroable};
use egui::epaint::textures::TextureFilter;
use egui::epaint::{ImageData, ImageDelta, TextureId};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Size of a texel, in bytes.
const TEXEL: usize = 4;

/// Flag for linear filtering of magnified textures.
pub const SMOOTH_MAGNIFIED: u32 = 1;
/// Flag for linear filtering of minified textures.
pub const SMOOTH_MINIFIED: u32 = 2;

/// Location of a texture among the texels, in the shader's layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Texture {
    /// Index of the first texel.
    pub texels: u32,
    pub width: u32,
    pub height: u32,
    /// Flags [`SMOOTH_MAGNIFIED`] and [`SMOOTH_MINIFIED`].
    pub smoothing: u32,
}

impl Texture {
    fn count(&self) -> usize {
        self.width as usize * self.height as usize
    }

    fn end(&self) -> usize {
        self.texels as usize + self.count()
    }
}

#[derive(Debug)]
pub struct Textures {
    texels: Arc<Vec<u8>>,
    known: BTreeMap<TextureId, Texture>,
}

impl Default for Textures {
    fn default() -> Textures {
        // A buffer must have at least one element.
        Textures { texels: Arc::new(vec![0; TEXEL]), known: BTreeMap::new() }
    }
}

impl Textures {
    /// Returns the location of a texture; `None` if it is unknown or has no texels.
    pub fn get(&self, id: TextureId) -> Option<Texture> {
        self.known.get(&id).copied().filter(|texture| texture.count() > 0)
    }

    pub fn texels(&self) -> Arc<Vec<u8>> {
        self.texels.clone()
    }

    /// Creates and changes textures. The changes of each are applied in order.
    pub fn set<L: IntoIterator<Item = ImageDelta>>(
        &mut self,
        changes: impl IntoIterator<Item = (TextureId, L)>,
    ) {
        // In the order of ids, so that equal interfaces produce equal buffers.
        let changes: BTreeMap<TextureId, L> = changes.into_iter().collect();
        if changes.is_empty() {
            return;
        }
        // A frame in flight may still use the previous texels.
        let mut texels = self.texels.to_vec();
        for (id, changes) in changes {
            for change in changes {
                self.change(&mut texels, id, &change);
            }
        }
        self.texels = Arc::new(texels);
    }

    /// Frees textures. Later textures reuse their space.
    pub fn free(&mut self, ids: impl IntoIterator<Item = TextureId>) {
        for id in ids {
            self.known.remove(&id);
        }
    }

    fn change(&mut self, texels: &mut Vec<u8>, id: TextureId, change: &ImageDelta) {
        let ImageData::Color(image) = &change.image;
        let [width, height] = image.size;
        let smooth = |filter, flag| if filter == TextureFilter::Linear { flag } else { 0 };
        let smoothing = smooth(change.options.magnification, SMOOTH_MAGNIFIED)
            | smooth(change.options.minification, SMOOTH_MINIFIED);
        let [left, top] = change.pos.unwrap_or([0, 0]);
        let texture = match change.pos {
            None => {
                let same = self.get(id).filter(|old| [old.width as usize, old.height as usize] == image.size);
                let at = match same {
                    Some(old) => old.texels as usize,
                    None => {
                        self.known.remove(&id);
                        self.room(width * height)
                    }
                };
                let texture =
                    Texture { texels: at as u32, width: width as u32, height: height as u32, smoothing };
                texels.resize(texels.len().max(texture.end() * TEXEL), 0);
                texture
            }
            // Ignore a change to an unknown texture, or one that exceeds the texture.
            Some(_) => match self.get(id) {
                Some(old) if left + width <= old.width as usize && top + height <= old.height as usize => {
                    Texture { smoothing, ..old }
                }
                _ => return,
            },
        };
        self.known.insert(id, texture);
        for (row, pixels) in image.pixels.chunks_exact(width.max(1)).take(height).enumerate() {
            let start = texture.texels as usize + (top + row) * texture.width as usize + left;
            for (target, pixel) in texels[start * TEXEL..].chunks_exact_mut(TEXEL).zip(pixels) {
                target.copy_from_slice(&pixel.to_array());
            }
        }
    }

    /// Returns the first texel of a gap of at least `count` texels, or else the end of the last texture.
    fn room(&self, count: usize) -> usize {
        let mut taken: Vec<&Texture> = self.known.values().collect();
        taken.sort_by_key(|texture| texture.texels);
        let mut at = 0;
        for texture in taken {
            if texture.texels as usize >= at + count {
                break;
            }
            at = at.max(texture.end());
        }
        at
    }
}
