//! Formats of images and fixed-function state of draws.

use serde::{Deserialize, Serialize};

/// Names a format of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Format {
    /// Four channels of 8 bits, from 0 to 1.
    Rgba8Unorm,
    /// Four half-precision floats.
    Rgba16Float,
    /// Four single-precision floats.
    Rgba32Float,
    /// One unsigned integer of 32 bits.
    R32Uint,
    /// One single-precision float.
    R32Float,
}

impl Format {
    /// Lists every format.
    pub const ALL: [Format; 5] =
        [Format::Rgba8Unorm, Format::Rgba16Float, Format::Rgba32Float, Format::R32Uint, Format::R32Float];

    /// Returns GLSL's name of the format, which graphs use too.
    pub fn name(self) -> &'static str {
        match self {
            Format::Rgba8Unorm => "rgba8",
            Format::Rgba16Float => "rgba16f",
            Format::Rgba32Float => "rgba32f",
            Format::R32Uint => "r32ui",
            Format::R32Float => "r32f",
        }
    }

    /// Returns the size of a pixel in bytes.
    pub fn bytes_per_pixel(self) -> u32 {
        match self {
            Format::Rgba8Unorm | Format::R32Uint | Format::R32Float => 4,
            Format::Rgba16Float => 8,
            Format::Rgba32Float => 16,
        }
    }
}

/// Names the primitives of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Topology {
    /// Three vertices for each triangle.
    TriangleList,
    /// One vertex for each triangle after the first two.
    TriangleStrip,
}

/// Says how a draw begins with a target's contents.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Load {
    /// Fills the target with red, green, blue and alpha.
    Clear(f32, f32, f32, f32),
    /// Keeps the former contents.
    Keep,
}

/// Combines a fragment with its target: `s` is the shader's output, `d` the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Blend {
    /// `d = s`
    Replace,
    /// Back to front, `s` premultiplied: `d = s + (1 - s.a) d`.
    PremultipliedOver,
    /// Back to front, `s` premultiplied, `d.a` holds the transmittance (cleared to 1):
    /// `d.rgb = s.rgb + (1 - s.a) d.rgb`, `d.a = (1 - s.a) d.a`.
    TransmittanceOver,
    /// Front to back, `s` premultiplied, `d.a` holds the transmittance (cleared to 1):
    /// `d.rgb = d.a s.rgb + d.rgb`, `d.a = (1 - s.a) d.a`.
    TransmittanceUnder,
}
