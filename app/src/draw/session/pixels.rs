//! Converts the pixels of a graph's output to an image.

use crate::io::image::Image;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use splatgraph_api::Pixels;
use splatgraph_framework::ir::Format;

/// The reason why a graph's output is not an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PixelsError {
    /// The device returned no picture.
    #[error("expected a picture from the device, found none")]
    Missing,
    /// The output's format, named here, has no colours.
    #[error("expected colours in the graph's output, found the format {0}")]
    NoColours(&'static str),
    /// The bytes do not match the size.
    #[error("expected {width} x {height} pixels of the format {format}, found {bytes} bytes")]
    Size {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
        /// Name of the format.
        format: &'static str,
        /// Number of bytes.
        bytes: usize,
    },
}

/// Converts pixels to an RGB image. A single float channel becomes grey, and alpha is dropped.
///
/// # Errors
/// The format has no colours, or the bytes do not match the size.
pub fn image_of(pixels: &Pixels) -> Result<Image, PixelsError> {
    let (width, height, format) = (pixels.width as usize, pixels.height as usize, pixels.format);
    if matches!(format, Format::R32Uint | Format::Depth32Float) {
        return Err(PixelsError::NoColours(format.name()));
    }
    let (bytes, row) = (pixels.bytes.len(), width * format.bytes_per_pixel() as usize);
    if bytes != row * height {
        return Err(PixelsError::Size { width, height, format: format.name(), bytes });
    }
    let mut rgb = vec![[0.0; 3]; width * height];
    let convert = |(rgb, bytes): (&mut [_], &[_])| convert_row(format, bytes, rgb);
    let (row_pixels, row_bytes) = (width.max(1), row.max(1));
    // A thread of the pool that waited for parts would begin to convert and encode other pictures before it finished
    // this one.
    if rayon::current_thread_index().is_some() {
        rgb.chunks_mut(row_pixels).zip(pixels.bytes.chunks(row_bytes)).for_each(convert);
    } else {
        rgb.par_chunks_mut(row_pixels).zip(pixels.bytes.par_chunks(row_bytes)).for_each(convert);
    }
    Ok(Image { width, height, rgb })
}

/// Converts a row of pixels. The format has colours.
fn convert_row(format: Format, bytes: &[u8], rgb: &mut [[f32; 3]]) {
    let single = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    match format {
        Format::Rgba8Unorm => {
            let level = |value: u8| f32::from(value) / 255.0;
            let colours = bytes.chunks_exact(4).map(|p| [level(p[0]), level(p[1]), level(p[2])]);
            rgb.iter_mut().zip(colours).for_each(|(rgb, colour)| *rgb = colour);
        }
        Format::Rgba16Float => {
            // A row is converted at once: several times as fast as single numbers.
            let halves: Vec<f16> = bytes.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]])).collect();
            let singles = halves.to_f32_vec();
            rgb.iter_mut().zip(singles.chunks_exact(4)).for_each(|(rgb, p)| *rgb = [p[0], p[1], p[2]]);
        }
        Format::Rgba32Float => {
            let colours =
                bytes.chunks_exact(16).map(|p| [single(&p[..4]), single(&p[4..8]), single(&p[8..12])]);
            rgb.iter_mut().zip(colours).for_each(|(rgb, colour)| *rgb = colour);
        }
        Format::R32Float | Format::R32Uint | Format::Depth32Float => {
            rgb.iter_mut().zip(bytes.chunks_exact(4)).for_each(|(rgb, b)| *rgb = [single(b); 3]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_api::PixelBytes;

    #[test]
    fn pictures_of_every_colour_format_are_read() {
        let image = |format, bytes: &[u8]| {
            image_of(&Pixels { format, width: 1, height: 1, bytes: PixelBytes::new(bytes.to_vec()) })
                .map(|image| image.rgb[0])
                .map_err(|error| error.to_string())
        };
        assert_eq!(image(Format::Rgba8Unorm, &[0, 51, 255, 7]), Ok([0.0, 0.2, 1.0]));
        let halves: Vec<u8> =
            [0.5, -2.0, 1.5, 0.0].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        assert_eq!(image(Format::Rgba16Float, &halves), Ok([0.5, -2.0, 1.5]));
        let singles: Vec<u8> = [0.1f32, -2.0, 1e9, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(image(Format::Rgba32Float, &singles), Ok([0.1, -2.0, 1e9]));
        assert_eq!(image(Format::R32Float, &0.25f32.to_le_bytes()), Ok([0.25; 3]));
        let error = |format, bytes: &[u8]| image(format, bytes).expect_err("no image");
        assert_eq!(
            error(Format::R32Uint, &[0; 4]),
            "expected colours in the graph's output, found the format r32ui"
        );
        assert_eq!(
            error(Format::Rgba8Unorm, &[0; 3]),
            "expected 1 x 1 pixels of the format rgba8, found 3 bytes"
        );
    }
}
