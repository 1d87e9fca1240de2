//! What lies under the user interface: which pictures, where, and how they are compared.

use super::PICTURES;
use bytemuck::{Pod, Zeroable};
use splatgraph_api::{FrameInputs, Given, Picture};
use splatgraph_framework::ir::Format;
use std::sync::Arc;

/// The name of the uniform block.
pub const WINDOW: &str = "frame.window";

/// Its bytes.
pub const WINDOW_BYTES: u64 = size_of::<Block>() as u64;

/// A picture that is shown: as a plan drew it, or packed by the host (then as [`Given::Bytes`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// [`Format::R32Float`] is shown as grey; [`Format::R32Uint`] holds no colours and is not shown.
    pub format: Format,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// The pixels, row 0 at the top, rows tightly packed, each as the format has it.
    pub pixels: Given,
}

impl From<Picture> for Shown {
    fn from(picture: Picture) -> Shown {
        let Picture { format, width, height, .. } = picture;
        Shown { format, width, height, pixels: Given::Picture(picture) }
    }
}

/// How two pictures are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// A alone.
    #[default]
    A,
    /// A to the left of a line, B to the right.
    Split,
    /// `amplification * |A - B|`, channel by channel, of the values as they are displayed (clamped to 0..1).
    Difference,
}

/// What the window shows of the scene.
///
/// A picture of the view's size is shown pixel by pixel. One of another size was drawn before the view was resized: it is scaled
/// to the view's height about the view's middle, as [`splatgraph_assets::Camera::resized`] will have the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct Composition {
    /// The window's width and height in pixels.
    pub window: [u32; 2],
    /// Where in the window the scene is shown: left, top, width, height in pixels.
    pub view: [u32; 4],
    /// Picture A.
    pub a: Option<Shown>,
    /// Picture B.
    pub b: Option<Shown>,
    pub mode: Mode,
    /// Where the line is, from 0 at the view's left border to 1 at its right one.
    pub split: f32,
    /// Factor of the difference.
    pub amplification: f32,
    /// Colour outside of the view, and in it where there is no picture; display-encoded.
    pub background: [f32; 3],
}

/// `shaders/window/window.glsl`, in the layout std140.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Block {
    view: [u32; 4],
    picture_a: [u32; 4],
    picture_b: [u32; 4],
    background: [f32; 4],
    size: [f32; 2],
    split: f32,
    amplification: f32,
    mode: u32,
    unused: [u32; 3],
}

const _: () = assert!(size_of::<Block>() == 96);

impl Composition {
    /// The bytes of the uniform block.
    pub fn bytes(&self) -> Vec<u8> {
        let [r, g, b] = self.background;
        let block = Block {
            view: self.view,
            picture_a: shape(&self.a),
            picture_b: shape(&self.b),
            background: [r, g, b, 0.0],
            // What divides is not 0.
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

    /// Adds the block and the pictures to a frame's inputs.
    pub fn give(&self, inputs: &mut FrameInputs) {
        inputs.uniforms.insert(WINDOW.to_owned(), self.bytes());
        for (name, picture) in PICTURES.into_iter().zip([&self.a, &self.b]) {
            // Where there is none, a word that nobody reads.
            let given = match picture {
                Some(picture) => picture.pixels.clone(),
                None => Given::Bytes(Arc::new(vec![0; 4])),
            };
            inputs.buffers.insert(name.to_owned(), given);
        }
    }
}

/// Width, height and format, as the shader reads them. An empty picture is none.
fn shape(picture: &Option<Shown>) -> [u32; 4] {
    let Some(Shown { format, width, height, .. }) = picture else { return [0; 4] };
    let format = match format {
        _ if *width == 0 || *height == 0 => 0,
        Format::R32Uint => 0,
        Format::Rgba8Unorm => 1,
        Format::Rgba16Float => 2,
        Format::Rgba32Float => 3,
        Format::R32Float => 4,
    };
    [*width, *height, format, 0]
}
