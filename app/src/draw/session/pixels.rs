//! Converts the pixels of a graph's output to an image.

use crate::io::image::Image;
use half::f16;
use half::slice::HalfFloatSliceExt;
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
    let (width, height) = (pixels.width as usize, pixels.height as usize);
    let rgb: Vec<[f32; 3]> = match pixels.format {
        Format::Rgba8Unorm => {
            pixels.bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2]].map(|v| f32::from(v) / 255.0)).collect()
        }
        Format::Rgba16Float => {
            // Whole rows are converted at once: several times as fast as single numbers.
            let mut rgb = Vec::with_capacity(width * height);
            let (mut halves, mut singles) = (vec![f16::ZERO; 4 * width], vec![0.0; 4 * width]);
            for row in pixels.bytes.chunks_exact(8 * width.max(1)) {
                let bytes = row.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]));
                halves.iter_mut().zip(bytes).for_each(|(half, read)| *half = read);
                halves.convert_to_f32_slice(&mut singles);
                rgb.extend(singles.chunks_exact(4).map(|p| [p[0], p[1], p[2]]));
            }
            rgb
        }
        Format::Rgba32Float => {
            let single = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            pixels
                .bytes
                .chunks_exact(16)
                .map(|p| [single(&p[..4]), single(&p[4..8]), single(&p[8..12])])
                .collect()
        }
        Format::R32Float => {
            pixels.bytes.chunks_exact(4).map(|p| [f32::from_le_bytes([p[0], p[1], p[2], p[3]]); 3]).collect()
        }
        Format::R32Uint | Format::Depth32Float => return Err(PixelsError::NoColours(pixels.format.name())),
    };
    if rgb.len() != width * height {
        let (bytes, format) = (pixels.bytes.len(), pixels.format.name());
        return Err(PixelsError::Size { width, height, format, bytes });
    }
    Ok(Image { width, height, rgb })
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
