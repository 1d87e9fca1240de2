//! Writes animated PNGs.

use super::frame::{Frame, Rate, Writer, mixed};
use crate::io::output::file::Cause;
use std::io::Write;

pub(super) struct Film<'a> {
    writer: png::Writer<&'a mut dyn Write>,
}

impl<'a> Film<'a> {
    pub(super) fn begin(
        out: &'a mut dyn Write,
        (width, height): (u32, u32),
        rate: Rate,
        frames: u32,
    ) -> Result<Self, Cause> {
        let mut encoder = png::Encoder::new(out, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_compression(png::Compression::Fast);
        encoder.set_animated(frames, 0)?;
        let (delay, of) = delay(rate);
        encoder.set_frame_delay(delay, of)?;
        Ok(Film { writer: encoder.write_header()? })
    }
}

/// Computes the time between two frames in seconds, as the nearest fraction of 16-bit numbers.
fn delay(rate: Rate) -> (u16, u16) {
    let seconds = 1.0 / rate.per_second();
    let fraction = |of| ((seconds * f64::from(of)).round().clamp(1.0, 65_535.0) as u16, of);
    let error = |(delay, of): &(u16, u16)| (f64::from(*delay) / f64::from(*of) - seconds).abs();
    (1..=u16::MAX).map(fraction).min_by(|a, b| error(a).total_cmp(&error(b))).unwrap_or((1, 1))
}

impl Writer for Film<'_> {
    fn add(&mut self, frame: Frame) -> Result<(), Cause> {
        let Frame::Bytes(bytes) = frame else { return Err(mixed()) };
        Ok(self.writer.write_image_data(&bytes)?)
    }

    fn finish(self: Box<Self>) -> Result<(), Cause> {
        Ok(self.writer.finish()?)
    }
}
