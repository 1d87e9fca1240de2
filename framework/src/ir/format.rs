//! Defines formats of images and the fixed-function state of draws.

use serde::{Deserialize, Serialize};

/// A pixel format of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Format {
    /// Four 8-bit unsigned normalised channels, 0 to 1.
    Rgba8Unorm,
    /// Four half-precision floats.
    Rgba16Float,
    /// Four single-precision floats.
    Rgba32Float,
    /// One 32-bit unsigned integer.
    R32Uint,
    /// One single-precision float.
    R32Float,
    /// A 32-bit float depth attachment, 0 to 1. Shaders cannot bind it.
    Depth32Float,
}

impl Format {
    /// Lists every format.
    pub const ALL: [Format; 6] = [
        Format::Rgba8Unorm,
        Format::Rgba16Float,
        Format::Rgba32Float,
        Format::R32Uint,
        Format::R32Float,
        Format::Depth32Float,
    ];

    /// Returns the format's name in graphs: GLSL's name, or `depth32f`, which GLSL lacks.
    pub fn name(self) -> &'static str {
        match self {
            Format::Rgba8Unorm => "rgba8",
            Format::Rgba16Float => "rgba16f",
            Format::Rgba32Float => "rgba32f",
            Format::R32Uint => "r32ui",
            Format::R32Float => "r32f",
            Format::Depth32Float => "depth32f",
        }
    }

    /// Finds the format by its name in another API, such as `Rgba16Float`, `R16G16B16A16_SFLOAT` or `RGBA16F`. `None`
    /// for other names.
    pub fn meant_by(name: &str) -> Option<Format> {
        let kept = |text: &str| -> String {
            text.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
        };
        // Vulkan and WebGPU spell out the number type; GLSL abbreviates it.
        let glsl = kept(name)
            .replace("sfloat", "f")
            .replace("float", "f")
            .replace("uint", "ui")
            .replace("unorm", "");
        let glsl = ["8", "16", "32"].into_iter().fold(glsl, |glsl, bits| {
            let each = ["r", "g", "b", "a"].map(|channel| format!("{channel}{bits}")).concat();
            glsl.replace(&each, &format!("rgba{bits}"))
        });
        Format::ALL.into_iter().find(|format| format.name() == glsl)
    }

    /// Returns the size of a pixel in bytes.
    pub fn bytes_per_pixel(self) -> u32 {
        match self {
            Format::Rgba8Unorm | Format::R32Uint | Format::R32Float | Format::Depth32Float => 4,
            Format::Rgba16Float => 8,
            Format::Rgba32Float => 16,
        }
    }
}

/// The primitives of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Topology {
    /// Three vertices per triangle; triangles share no vertices.
    TriangleList,
    /// Each vertex after the first two completes a triangle with the two vertices before it.
    TriangleStrip,
}

/// Contents of a colour attachment at the start of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Load {
    /// Clears to this red, green, blue and alpha.
    Clear(f32, f32, f32, f32),
    /// Keeps the previous contents.
    Keep,
}

/// Use of the depth attachment by a draw.
///
/// Depth is reversed: 1 is the near plane and 0 is infinitely far. A fragment passes if its depth is greater.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DepthAccess {
    /// Clears the image to 0 before the draw, tests, and writes the depth of each fragment that passes.
    Write,
    /// Tests against the image, and writes the depth of each fragment that passes.
    TestAndWrite,
    /// Tests against the image, and does not write it.
    Test,
}

/// Blending of a fragment with the target: `s` is the shader's output, `d` the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Blend {
    /// No blending: `d = s`.
    Replace,
    /// Back to front, `s` premultiplied: `d = s + (1 - s.a) d`.
    PremultipliedOver,
    /// Back to front, `s` premultiplied. `d.a` is the transmittance, cleared to 1: `d.rgb = s.rgb + (1 - s.a) d.rgb`,
    /// `d.a = (1 - s.a) d.a`.
    TransmittanceOver,
    /// Front to back, `s` premultiplied. `d.a` is the transmittance, cleared to 1: `d.rgb = d.a s.rgb + d.rgb`,
    /// `d.a = (1 - s.a) d.a`.
    TransmittanceUnder,
    /// Sums, in any order: `d = s + d`.
    Add,
}

impl Blend {
    /// Returns true if a factor of the blend equation contains the alpha of the shader's output.
    pub fn reads_alpha(self) -> bool {
        !matches!(self, Blend::Replace | Blend::Add)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_other_apis_mean_the_same_format() {
        for (name, meant) in [
            ("Rgba16Float", Some(Format::Rgba16Float)),
            ("RGBA16F", Some(Format::Rgba16Float)),
            ("R16G16B16A16_SFLOAT", Some(Format::Rgba16Float)),
            ("rgba32-float", Some(Format::Rgba32Float)),
            ("rgba8unorm", Some(Format::Rgba8Unorm)),
            ("R8G8B8A8_UNORM", Some(Format::Rgba8Unorm)),
            ("r32uint", Some(Format::R32Uint)),
            ("R32Float", Some(Format::R32Float)),
            ("Depth32Float", Some(Format::Depth32Float)),
            ("bgra8unorm", None),
            ("", None),
        ] {
            assert_eq!(Format::meant_by(name), meant, "{name}");
        }
    }
}
