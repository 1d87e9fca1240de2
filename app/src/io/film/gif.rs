//! Writes animated GIFs, with 256 colours in each frame.

use super::frame::{Frame, Rate, Writer, mixed};
use crate::io::image::{Image, NotFinite};
use crate::io::output::file::Cause;
use std::io::Write;

const MAX_GIF_SIDE: usize = 65_535;

/// Sampling factor of NeuQuant, 1 to 30: larger is faster and less accurate.
const SPEED: i32 = 1;

/// Width of the picture in which NeuQuant sees each colour once. Its height must have 16 bits.
const SAMPLE_WIDTH: u16 = 512;

/// Chooses a frame's 256 colours, and compresses the frame.
pub(super) fn encode(image: &Image) -> Result<(gif::Frame<'static>, NotFinite), Cause> {
    if image.width.max(image.height) > MAX_GIF_SIDE {
        let found = format!("{} x {}", image.width, image.height);
        return Err(format!(
            "expected a GIF of at most {MAX_GIF_SIDE} pixels across and down, found {found}"
        )
        .into());
    }
    let (width, height) = (image.width as u16, image.height as u16);
    let (bytes, not_finite) = image.bytes();
    let pixels = bytes.as_chunks::<3>().0;
    let mut colours = pixels.to_vec();
    colours.sort_unstable();
    let most = colours.chunk_by(|a, b| a == b).max_by_key(|equal| equal.len());
    let background = most.map_or([0; 3], |equal| equal[0]);
    // If pixels counted instead of colours, the colours of small parts would be lost beside a large background.
    colours.dedup();
    let rows = colours.len().div_ceil(SAMPLE_WIDTH.into());
    colours.resize(rows * usize::from(SAMPLE_WIDTH), colours.last().copied().unwrap_or_default());
    let sample = gif::Frame::from_rgb_speed(SAMPLE_WIDTH, rows as u16, colours.as_flattened(), SPEED);
    let index = |pixel: &[u8; 3]| colours.binary_search(pixel).map_or(0, |at| sample.buffer[at]);
    let mut palette = sample.palette.clone().unwrap_or_default();
    // The background must not change from frame to frame.
    if let Some(entry) = palette.as_chunks_mut().0.get_mut(usize::from(index(&background))) {
        *entry = background;
    }
    let indices: Vec<u8> = pixels.iter().map(index).collect();
    let mut frame = gif::Frame::from_palette_pixels(width, height, indices, palette, None);
    frame.make_lzw_pre_encoded();
    Ok((frame, not_finite))
}

pub(super) struct Film<'a> {
    encoder: gif::Encoder<&'a mut dyn Write>,
    rate: Rate,
    frames: u32,
}

impl<'a> Film<'a> {
    pub(super) fn begin(
        out: &'a mut dyn Write,
        (width, height): (u32, u32),
        rate: Rate,
    ) -> Result<Self, Cause> {
        let side = |side: u32| u16::try_from(side);
        let mut encoder = gif::Encoder::new(out, side(width)?, side(height)?, &[])?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        Ok(Film { encoder, rate, frames: 0 })
    }

    /// Computes the start time of a frame, in hundredths of a second.
    fn hundredths(&self, frame: u32) -> u64 {
        (100.0 * f64::from(frame) / self.rate.per_second()).round() as u64
    }
}

impl Writer for Film<'_> {
    fn add(&mut self, frame: Frame) -> Result<(), Cause> {
        let Frame::Gif(mut frame) = frame else { return Err(mixed()) };
        // Rounding start times instead of delays prevents an accumulated error.
        let delay = self.hundredths(self.frames + 1) - self.hundredths(self.frames);
        frame.delay = u16::try_from(delay).unwrap_or(u16::MAX);
        self.frames += 1;
        Ok(self.encoder.write_lzw_pre_encoded_frame(&frame)?)
    }

    fn finish(self: Box<Self>) -> Result<(), Cause> {
        self.encoder.into_inner()?;
        Ok(())
    }
}
