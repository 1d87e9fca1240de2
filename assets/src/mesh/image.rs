//! Unpacks the images of materials: PNG and JPEG, to 8 bits of red, green, blue and alpha.

use crate::error::{SceneError, wrong};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

const MAX_SIDE: u32 = 16_384;
/// Maximum number of texels of all images of a mesh: 256 MiB.
pub(super) const MAX_TEXELS: u64 = 1 << 26;

/// An unpacked image, row 0 at the top.
pub(super) struct Unpacked {
    pub width: u32,
    pub height: u32,
    pub texels: Vec<[u8; 4]>,
}

/// Unpacks the bytes of an image file of at most `most` texels; `part` names it in errors.
pub(super) fn unpack(bytes: &[u8], part: &str, most: u64) -> Result<Unpacked, SceneError> {
    let wrong = |message: String| wrong(part, message);
    let fits = |width: u32, height: u32| {
        if ![width, height].iter().all(|side| (1..=MAX_SIDE).contains(side)) {
            return Err(wrong(format!("expected 1 to {MAX_SIDE} texels a side, found {width} x {height}")));
        }
        if u64::from(width) * u64::from(height) > most {
            return Err(wrong(format!(
                "expected at most {MAX_TEXELS} texels in all images, found {width} x {height} more"
            )));
        }
        Ok(())
    };
    if bytes.starts_with(b"\x89PNG") {
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder
            .set_transformations(png::Transformations::normalize_to_color8() | png::Transformations::ALPHA);
        let mut reader = decoder.read_info().map_err(|error| wrong(error.to_string()))?;
        let (width, height) = (reader.info().width, reader.info().height);
        fits(width, height)?;
        let length = reader.output_buffer_size().ok_or_else(|| wrong("the image is too large".into()))?;
        let mut unpacked = vec![0; length];
        let frame = reader.next_frame(&mut unpacked).map_err(|error| wrong(error.to_string()))?;
        let texels = match frame.color_type {
            png::ColorType::GrayscaleAlpha => {
                unpacked.chunks_exact(2).map(|p| [p[0], p[0], p[0], p[1]]).collect()
            }
            png::ColorType::Rgba => unpacked.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect(),
            other => return Err(wrong(format!("expected colours with alpha, found {other:?}"))),
        };
        return Ok(Unpacked { width, height, texels });
    }
    if bytes.starts_with(b"\xFF\xD8\xFF") {
        let options = DecoderOptions::default()
            .set_max_width(MAX_SIDE as usize)
            .set_max_height(MAX_SIDE as usize)
            .jpeg_set_out_colorspace(ColorSpace::RGB);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
        decoder.decode_headers().map_err(|error| wrong(error.to_string()))?;
        let (width, height) = decoder.dimensions().ok_or_else(|| wrong("the image has no size".into()))?;
        let (width, height) = (width as u32, height as u32);
        fits(width, height)?;
        let rgb = decoder.decode().map_err(|error| wrong(error.to_string()))?;
        let texels = rgb.chunks_exact(3).map(|p| [p[0], p[1], p[2], 255]).collect();
        return Ok(Unpacked { width, height, texels });
    }
    Err(wrong("expected an image as PNG or JPEG".into()))
}
