//! Writes YUV4MPEG2 (`.y4m`): a line of text, then uncompressed frames.
//!
//! Colours are BT.709 in the limited range, as in HD video. Chroma is 4:2:0, with each sample in the middle of four
//! pixels, as in JPEG. The format has no field for the matrix, so a reader has to assume BT.709.

use super::frame::{Frame, Rate, Writer, mixed};
use crate::io::image::{Image, NotFinite, is_finite};
use crate::io::output::file::Cause;
use std::io::Write;

/// Luma weight of red in BT.709.
const RED: f32 = 0.2126;

/// Luma weight of blue in BT.709; green has the rest.
const BLUE: f32 = 0.0722;

pub(super) fn encode(image: &Image) -> (Vec<u8>, NotFinite) {
    let (planes, not_finite) = planes(image);
    ([b"FRAME\n".as_slice(), &planes].concat(), not_finite)
}

/// Converts a picture to the planes of a frame: luma, blue chroma, red chroma. Also counts the pixels that are not
/// finite.
pub(super) fn planes(image: &Image) -> (Vec<u8>, NotFinite) {
    let mut not_finite = NotFinite { pixels: 0, of: image.rgb.len() };
    let (width, height) = (image.width, image.height);
    let [across, down] = [width, height].map(|side| side.div_ceil(2));
    let mut bytes = Vec::with_capacity(width * height + 2 * across * down);
    let clamped = |x: usize, y: usize| image.at(x, y).map(|value| value.clamp(0.0, 1.0));
    for pixel in &image.rgb {
        not_finite.pixels += usize::from(!is_finite(*pixel));
        bytes.push(level(16.0 + 219.0 * luma(pixel.map(|value| value.clamp(0.0, 1.0)))));
    }
    let mut chroma = [Vec::with_capacity(across * down), Vec::with_capacity(across * down)];
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            // With an odd width or height, the last column or row counts twice.
            let (right, below) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
            let four = [clamped(x, y), clamped(right, y), clamped(x, below), clamped(right, below)];
            let mean: [f32; 3] =
                std::array::from_fn(|c| 0.25 * four.iter().map(|pixel| pixel[c]).sum::<f32>());
            let luma = luma(mean);
            chroma[0].push(level(128.0 + 224.0 * 0.5 * (mean[2] - luma) / (1.0 - BLUE)));
            chroma[1].push(level(128.0 + 224.0 * 0.5 * (mean[0] - luma) / (1.0 - RED)));
        }
    }
    for plane in chroma {
        bytes.extend(plane);
    }
    (bytes, not_finite)
}

fn luma([red, green, blue]: [f32; 3]) -> f32 {
    RED * red + (1.0 - RED - BLUE) * green + BLUE * blue
}

fn level(value: f32) -> u8 {
    // The cast saturates, and turns NaN into 0.
    value.round() as u8
}

pub(super) struct Film<'a> {
    out: &'a mut dyn Write,
}

impl<'a> Film<'a> {
    pub(super) fn begin(
        out: &'a mut dyn Write,
        (width, height): (u32, u32),
        rate: Rate,
    ) -> Result<Self, Cause> {
        let Rate { frames, seconds } = rate;
        // FFmpeg reads the last two words, which the format defines as comments.
        writeln!(
            out,
            "YUV4MPEG2 W{width} H{height} F{frames}:{seconds} Ip A1:1 C420jpeg XYSCSS=420JPEG XCOLORRANGE=LIMITED"
        )?;
        Ok(Film { out })
    }
}

impl Writer for Film<'_> {
    fn add(&mut self, frame: Frame) -> Result<(), Cause> {
        let Frame::Bytes(bytes) = frame else { return Err(mixed()) };
        Ok(self.out.write_all(&bytes)?)
    }

    fn finish(self: Box<Self>) -> Result<(), Cause> {
        Ok(())
    }
}
