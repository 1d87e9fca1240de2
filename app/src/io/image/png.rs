//! Reads and writes PNG files: 8 bits per channel when written, any colour type and depth when read.

use super::pixels::{Header, Image, ImageError, NotFinite, check_size, open, room};
use crate::io::output::file::Cause;
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

/// Writes a picture, and counts its pixels that are not finite. The file declares sRGB only if its values are `colors`.
pub(super) fn write(image: &Image, colors: bool, out: &mut dyn Write) -> Result<NotFinite, Cause> {
    let (bytes, not_finite) = image.bytes();
    write_bytes((image.width, image.height), &bytes, colors, out)?;
    Ok(not_finite)
}

/// Writes the bytes of RGB, or of RGBA if there are four per pixel.
pub(super) fn write_bytes(
    (width, height): (usize, usize),
    bytes: &[u8],
    colors: bool,
    out: &mut dyn Write,
) -> Result<(), Cause> {
    let mut encoder = png::Encoder::new(out, width as u32, height as u32);
    let has_alpha = bytes.len() == 4 * width * height;
    encoder.set_color(if has_alpha { png::ColorType::Rgba } else { png::ColorType::Rgb });
    encoder.set_depth(png::BitDepth::Eight);
    if colors {
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    }
    // `Balanced` takes many times as long, for files that are only a few percent smaller.
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    Ok(writer.finish()?)
}

/// Returns true if the file has the signature and all chunks, with the right checksums (PNG specification, 5.2 and
/// 5.3). The pixels are not decoded.
pub(super) fn is_whole(path: &Path) -> Result<bool, ImageError> {
    let mut bytes = Vec::new();
    open(path)?.read_to_end(&mut bytes).map_err(|error| ImageError::new(path, error))?;
    let Some(mut rest) = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n") else { return Ok(false) };
    // A chunk is its length, its type, that many bytes of data, and the checksum of type and data.
    while let Some((length, after)) = rest.split_first_chunk() {
        let length = (u32::from_be_bytes(*length) as usize).saturating_add(4);
        let Some((chunk, after)) = after.split_at_checked(length) else { break };
        let Some((sum, after)) = after.split_first_chunk() else { break };
        if crc32fast::hash(chunk) != u32::from_be_bytes(*sum) {
            break;
        }
        if chunk == b"IEND" {
            return Ok(after.is_empty());
        }
        rest = after;
    }
    Ok(false)
}

/// A decoder whose header has been read.
type Decoder = png::Decoder<BufReader<File>>;

/// Reads the header of a PNG file. Returns the decoder, and the picture's size.
fn decoder(path: &Path) -> Result<(Decoder, (usize, usize)), ImageError> {
    let mut decoder = png::Decoder::new(open(path)?);
    decoder.set_transformations(png::Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(|e| ImageError::new(path, e))?;
    let size = check_size(path, header.width.into(), header.height.into())?;
    Ok((decoder, size))
}

/// Reads the header. A transparent colour counts as alpha.
pub(super) fn header(path: &Path) -> Result<Header, ImageError> {
    use png::ColorType::{Grayscale, GrayscaleAlpha, Rgba};
    let (decoder, size) = decoder(path)?;
    let colour = decoder.read_info().ok().map(|info| info.output_color_type().0);
    let has_alpha = matches!(colour, Some(GrayscaleAlpha | Rgba));
    Ok(Header {
        size,
        has_alpha,
        is_grey: matches!(colour, Some(Grayscale | GrayscaleAlpha)),
        ..Header::default()
    })
}

/// Loads a file without its alpha. Also returns the level of white: 255 or 65535.
pub(super) fn load(path: &Path) -> Result<(Image, u16), ImageError> {
    load_over(path, None)
}

/// Loads a file. If it has alpha and a background is given, blends it over the background. Also returns the level of
/// white: 255 or 65535.
pub(super) fn load_over(path: &Path, background: Option<[f32; 3]>) -> Result<(Image, u16), ImageError> {
    let fail = |e: png::DecodingError| ImageError::new(path, e);
    let (decoder, (width, height)) = decoder(path)?;
    let mut reader = decoder.read_info().map_err(fail)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| ImageError::new(path, "the pixels do not fit in memory"))?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size).map_err(|e| ImageError::new(path, e))?;
    bytes.resize(size, 0);
    let frame = reader.next_frame(&mut bytes).map_err(fail)?;
    bytes.truncate(frame.buffer_size());

    let channels = match frame.color_type {
        png::ColorType::Grayscale => 1,
        png::ColorType::GrayscaleAlpha => 2,
        png::ColorType::Rgb => 3,
        png::ColorType::Rgba => 4,
        // Does not occur: EXPAND turns a palette into RGB.
        png::ColorType::Indexed => return Err(ImageError::new(path, "the palette cannot be read")),
    };
    // Red, green and blue of a grey picture are its one channel.
    let [r, g, b] = if channels < 3 { [0; 3] } else { [0, 1, 2] };
    let mut rgb = room(path, width * height)?;
    let background = background.filter(|_| channels % 2 == 0);
    let over = |value: &dyn Fn(usize) -> f32| match background {
        Some(background) => {
            let (alpha, colors) = (value(channels - 1), [r, g, b].map(value));
            std::array::from_fn(|c| alpha * colors[c] + (1.0 - alpha) * background[c])
        }
        None => [r, g, b].map(value),
    };
    let greatest = match frame.bit_depth {
        png::BitDepth::Sixteen => {
            let value = |p: &[u8], c: usize| {
                f32::from(u16::from_be_bytes([p[2 * c], p[2 * c + 1]])) / f32::from(u16::MAX)
            };
            rgb.extend(bytes.chunks_exact(2 * channels).map(|p| over(&|c| value(p, c))));
            u16::MAX
        }
        _ => {
            rgb.extend(bytes.chunks_exact(channels).map(|p| over(&|c| f32::from(p[c]) / 255.0)));
            u8::MAX.into()
        }
    };
    if rgb.len() != width * height {
        let text = format!("expected {} pixels, found {}", width * height, rgb.len());
        return Err(ImageError::new(path, text));
    }
    Ok((Image { width, height, rgb }, greatest))
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
        assert_eq!(load(&path).unwrap().0.rgb, grey);
        assert!(!header(&path).unwrap().has_alpha);
        write(&path, GrayscaleAlpha, Eight, &[0, 9, 255, 9], None);
        assert_eq!(load(&path).unwrap().0.rgb, grey);
        assert!(header(&path).unwrap().has_alpha);
        write(&path, Rgba, Eight, &[0, 51, 255, 9, 255, 51, 0, 9], None);
        assert_eq!(load(&path).unwrap().0.rgb, colour);
        write(&path, Rgb, Sixteen, &[0, 0, 51, 51, 255, 255, 255, 255, 51, 51, 0, 0], None);
        assert_eq!(load(&path).unwrap().0.rgb, colour);
        write(&path, Indexed, Eight, &[1, 0], Some(&[255, 51, 0, 0, 51, 255]));
        assert_eq!(load(&path).unwrap().0.rgb, colour);
    }

    #[test]
    fn over_a_background_alpha_blends_what_an_opaque_file_has_as_it_is() {
        use png::{BitDepth::*, ColorType::*};
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let near = |pixel: [f32; 3], expected: [f32; 3]| {
            pixel.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6)
        };
        write(&path, Rgba, Eight, &[255, 0, 0, 51, 0, 0, 255, 255], None);
        let rgb = load_over(&path, Some([1.0, 1.0, 0.0])).unwrap().0.rgb;
        assert!(near(rgb[0], [1.0, 0.8, 0.0]) && near(rgb[1], [0.0, 0.0, 1.0]), "{rgb:?}");
        write(&path, Rgb, Eight, &[255, 0, 0, 0, 0, 255], None);
        assert_eq!(
            load_over(&path, Some([1.0, 1.0, 0.0])).unwrap().0.rgb,
            [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        );
    }
}
