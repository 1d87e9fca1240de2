//! Writes animated GIFs, with 256 colours in each frame.

use super::frame::{Frame, Rate, Writer, mixed};
use crate::io::image::{Image, NotFinite};
use crate::io::output::file::Cause;
use std::io::Write;

const MAX_GIF_SIDE: usize = 65_535;

/// Sampling factor of NeuQuant, 1 to 30: larger is faster and less accurate.
const SPEED: i32 = 10;

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
    let mut frame = gif::Frame::from_rgb_speed(width, height, &bytes, SPEED);
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
