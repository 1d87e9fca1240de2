//! Reads and writes PNG files: 8 bits per channel when written, any colour type and depth when read.

use super::{Image, ImageError, check_size};
use crate::output::file::Cause;
use std::fs::File;
use std::io::{BufReader, Write};
use std::path::Path;

/// Converts a value to a byte: clamped to 0..1, scaled to 0..255, halves rounded up. NaN becomes 0.
fn level(value: f32) -> u8 {
    // A float cast to an integer truncates, saturates, and turns NaN into 0.
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

pub(super) fn write(image: &Image, out: &mut dyn Write) -> Result<(), Cause> {
    let mut encoder = png::Encoder::new(out, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let bytes: Vec<u8> = image.rgb.as_flattened().iter().map(|&v| level(v)).collect();
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&bytes)?;
    Ok(writer.finish()?)
}

/// Loads a file and ignores its alpha: pictures here are opaque.
pub(super) fn load(path: &Path) -> Result<Image, ImageError> {
    let fail = |e: png::DecodingError| ImageError::because(path, e);
    let file = File::open(path).map_err(|e| ImageError::because(path, e))?;
    let mut decoder = png::Decoder::new(BufReader::new(file));
    decoder.set_transformations(png::Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(fail)?;
    let (width, height) = check_size(path, header.width.into(), header.height.into())?;
    let mut reader = decoder.read_info().map_err(fail)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| ImageError::new(path, "the pixels do not fit in memory"))?;
    let mut bytes = vec![0; size];
    let frame = reader.next_frame(&mut bytes).map_err(fail)?;
    bytes.truncate(frame.buffer_size());

    let values: Vec<f32> = match frame.bit_depth {
        png::BitDepth::Sixteen => bytes
            .chunks_exact(2)
            .map(|b| f32::from(u16::from_be_bytes([b[0], b[1]])) / f32::from(u16::MAX))
            .collect(),
        _ => bytes.iter().map(|&b| f32::from(b) / 255.0).collect(),
    };
    let rgb = match frame.color_type {
        png::ColorType::Grayscale => values.iter().map(|&v| [v; 3]).collect(),
        png::ColorType::GrayscaleAlpha => values.chunks_exact(2).map(|v| [v[0]; 3]).collect(),
        png::ColorType::Rgb => values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect(),
        png::ColorType::Rgba => values.chunks_exact(4).map(|v| [v[0], v[1], v[2]]).collect(),
        // EXPAND turns a palette into RGB.
        png::ColorType::Indexed => return Err(ImageError::new(path, "the palette cannot be read")),
    };
    Ok(Image { width, height, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: &Path, color: png::ColorType, depth: png::BitDepth, data: &[u8], palette: Option<&[u8]>) {
        let mut encoder = png::Encoder::new(File::create(path).unwrap(), 2, 1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if let Some(palette) = palette {
            encoder.set_palette(palette.to_vec());
        }
        encoder.write_header().unwrap().write_image_data(data).unwrap();
    }

    #[test]
    fn every_colour_type_is_read_as_rgb_without_its_alpha() {
        use png::{BitDepth::*, ColorType::*};
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let grey = [[0.0; 3], [1.0; 3]];
        let colour = [[0.0, 0.2, 1.0], [1.0, 0.2, 0.0]];

        write(&path, Grayscale, One, &[0b0100_0000], None);
        assert_eq!(load(&path).unwrap().rgb, grey);
        write(&path, GrayscaleAlpha, Eight, &[0, 9, 255, 9], None);
        assert_eq!(load(&path).unwrap().rgb, grey);
        write(&path, Rgba, Eight, &[0, 51, 255, 9, 255, 51, 0, 9], None);
        assert_eq!(load(&path).unwrap().rgb, colour);
        write(&path, Rgb, Sixteen, &[0, 0, 51, 51, 255, 255, 255, 255, 51, 51, 0, 0], None);
        assert_eq!(load(&path).unwrap().rgb, colour);
        write(&path, Indexed, Eight, &[1, 0], Some(&[255, 51, 0, 0, 51, 255]));
        assert_eq!(load(&path).unwrap().rgb, colour);
    }
}
