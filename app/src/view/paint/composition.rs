//! Defines the pictures below the user interface: where the window shows them, and their comparison.

use bytemuck::{Pod, Zeroable};
use splatgraph_api::{BufferContents, FrameInputs, Picture, ROWS_ALIGNMENT};
use splatgraph_framework::ir::Format;
use std::sync::Arc;

/// Name of the uniform block with the composition's layout.
pub const WINDOW: &str = "frame.window";

/// Size of the uniform block, in bytes.
pub const WINDOW_BYTES: u64 = size_of::<Block>() as u64;

/// Name of the buffer with the view's indirect draw arguments. If A is shown alone and unscaled, each of its parts has
/// a draw. The last draw is for all other compositions. Unused draws have no instances.
pub const VIEW_DRAW: &str = "frame.view_draw";
/// Names of the buffers with the pixels of pictures A and B, packed. A picture is split into parts of whole rows,
/// unless the host packed it and it fits in one storage binding.
pub const PICTURES: [[&str; PARTS]; 2] = [
    ["frame.picture_a0", "frame.picture_a1", "frame.picture_a2", "frame.picture_a3"],
    ["frame.picture_b0", "frame.picture_b1", "frame.picture_b2", "frame.picture_b3"],
];
/// Maximum number of parts that a picture is split into.
pub const PARTS: usize = 4;

/// Largest storage binding that every device supports, in bytes: the minimum that Vulkan guarantees for
/// `maxStorageBufferRange`.
const BINDING: usize = 128 << 20;

/// A picture to show, drawn by a plan or packed by the host (as [`BufferContents::Bytes`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Format of the pixels. [`Format::R32Float`] is shown as grey. [`Format::R32Uint`] and [`Format::Depth32Float`]
    /// are not shown.
    pub format: Format,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Pixels in the given format, row 0 at the top, rows tightly packed.
    pub pixels: BufferContents,
}

impl From<Picture> for Shown {
    fn from(picture: Picture) -> Shown {
        let Picture { format, width, height, .. } = picture;
        Shown { format, width, height, pixels: BufferContents::Picture(picture) }
    }
}

/// Choice of what the view shows: A, or a comparison of A and B.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// A alone.
    #[default]
    A,
    /// A to the left of a line, B to the right.
    Split,
    /// `amplification * |A - B|` per channel, of the displayed values (clamped to 0..1).
    Difference,
}

/// The scene's part of the window. Around the pictures, it is black.
///
/// A picture of the view's size is shown pixel by pixel. A picture of another size, from before a resize or drawn at
/// another resolution, is scaled to the view's height about its centre, as [`splatgraph_assets::Camera::resized`]
/// scales the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct Composition {
    /// Width and height of the window, in pixels.
    pub window: [u32; 2],
    /// Rectangle of the view in the window: left, top, width, height in pixels.
    pub view: [u32; 4],
    /// Picture A; without a comparison, it fills the view.
    pub a: Option<Shown>,
    /// Picture B, drawn only in comparisons.
    pub b: Option<Shown>,
    /// Choice between A and the comparisons of A and B.
    pub mode: Mode,
    /// Position of the split line, from 0 at the view's left border to 1 at its right border.
    pub split: f32,
    /// Amplification of the difference.
    pub amplification: f32,
}

/// The uniform block of `shaders/window/window.glsl`, in std140 layout.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Block {
    view: [u32; 4],
    picture_a: [u32; 4],
    picture_b: [u32; 4],
    size: [f32; 2],
    split: f32,
    amplification: f32,
    mode: u32,
    unused: [u32; 3],
}

const _: () = assert!(size_of::<Block>() == 80);

impl Composition {
    /// Packs the uniform block [`WINDOW`].
    pub fn bytes(&self) -> Vec<u8> {
        let block = Block {
            view: self.view,
            picture_a: shape(&self.a),
            picture_b: shape(&self.b),
            // Divisors in the shader must not be 0.
            size: self.window.map(|side| side.max(1) as f32),
            split: self.split,
            amplification: self.amplification,
            mode: match self.mode {
                Mode::A => 0,
                Mode::Split => 1,
                Mode::Difference => 2,
            },
            unused: [0; 3],
        };
        bytemuck::bytes_of(&block).to_vec()
    }

    /// Packs the view's indirect draw arguments; see [`VIEW_DRAW`].
    pub(super) fn draws(&self) -> [[u32; 4]; PARTS + 1] {
        let [_, _, width, height] = self.view;
        let plain = self.a.as_ref().filter(|a| {
            self.mode == Mode::A && shape(&self.a)[2] != 0 && [a.width, a.height] == [width, height]
        });
        let mut draws = [[6, 0, 0, 0]; PARTS + 1];
        for (part, draw) in (0..).zip(&mut draws[..PARTS]) {
            draw[1] = u32::from(plain.is_some_and(|picture| picture.rows(part).is_some()));
        }
        draws[PARTS][1] = u32::from(plain.is_none() && width > 0 && height > 0);
        draws
    }

    /// Adds the uniform block, the pictures and their draws to a frame's inputs.
    pub fn give(&self, inputs: &mut FrameInputs) {
        inputs.uniforms.insert(WINDOW.to_owned(), self.bytes());
        inputs.buffers.insert(VIEW_DRAW.to_owned(), BufferContents::Bytes(bytes(&self.draws())));
        for (names, picture) in PICTURES.into_iter().zip([&self.a, &self.b]) {
            for (part, name) in (0..).zip(names) {
                // A missing part is one word, which the shader does not read.
                let given = picture.as_ref().and_then(|picture| picture.part(part));
                let given = given.unwrap_or_else(|| BufferContents::Bytes(Arc::new(vec![0; 4])));
                inputs.buffers.insert(name.to_owned(), given);
            }
        }
    }
}

impl Shown {
    /// Returns the number of rows of each part but the last. Pixels from the host are one part if they fit in a storage
    /// binding.
    fn rows_per_part(&self) -> u32 {
        match &self.pixels {
            BufferContents::Bytes(bytes) if bytes.len() <= BINDING => self.height,
            // Aligned for every width and format, because pixels have at least four bytes.
            _ => self.height.div_ceil(PARTS as u32).next_multiple_of(ROWS_ALIGNMENT as u32 / 4),
        }
    }

    /// Returns the first row and the number of rows of a part; `None` if the picture does not need it.
    fn rows(&self, part: u32) -> Option<(u32, u32)> {
        let rows = self.rows_per_part();
        let first = part.checked_mul(rows).filter(|first| *first < self.height)?;
        Some((first, rows.min(self.height - first)))
    }

    fn part(&self, part: u32) -> Option<BufferContents> {
        let (first, count) = self.rows(part)?;
        Some(match &self.pixels {
            BufferContents::Picture(picture) => BufferContents::Rows { picture: *picture, first, count },
            BufferContents::Bytes(bytes) if count < self.height => {
                let row = bytes.len() / self.height as usize;
                let [first, count] = [first, count].map(|rows| rows as usize * row);
                BufferContents::Bytes(Arc::new(bytes[first..first + count].to_vec()))
            }
            other => other.clone(),
        })
    }
}

/// Packs a picture's width, height, format, and rows per part for the shader. The format is 0 if nothing can be shown.
fn shape(picture: &Option<Shown>) -> [u32; 4] {
    let Some(shown @ Shown { format, width, height, .. }) = picture else { return [0; 4] };
    let format = match format {
        _ if *width == 0 || *height == 0 => 0,
        Format::R32Uint | Format::Depth32Float => 0,
        Format::Rgba8Unorm => 1,
        Format::Rgba16Float => 2,
        Format::Rgba32Float => 3,
        Format::R32Float => 4,
    };
    [*width, *height, format, shown.rows_per_part().max(1)]
}

/// Copies the elements' bytes; for no elements, returns the bytes of one zero element, because no buffer may be empty.
pub(super) fn bytes<T: Pod>(elements: &[T]) -> Arc<Vec<u8>> {
    let none = [T::zeroed()];
    let elements = if elements.is_empty() { &none } else { elements };
    Arc::new(bytemuck::cast_slice(elements).to_vec())
}
