//! Reads photographs. PNG and JPEG are distinguished by their first bytes.

use super::pixels::{Image, ImageError, check_size, open, room};
use super::png;
use splatgraph_assets::photograph;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

fn is_png(path: &Path) -> Result<bool, ImageError> {
    photograph::is_png(path).map_err(|error| ImageError::new(path, error))
}

/// A decoder whose header has been read.
type Decoder = JpegDecoder<BufReader<File>>;

/// Reads the header of a JPEG file. Returns the decoder, and the picture's size.
fn header(path: &Path) -> Result<(Decoder, (usize, usize)), ImageError> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(open(path)?, options);
    let wrong =
        |found: String| ImageError::new(path, format!("expected a PNG or JPEG photograph, found {found}"));
    decoder.decode_headers().map_err(|error| wrong(error.to_string()))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| wrong("a JPEG without a size".into()))?;
    let size = check_size(path, width as u64, height as u64)?;
    Ok((decoder, size))
}

impl Image {
    /// Reads the width and height of a photograph in pixels, from its header alone.
    ///
    /// # Errors
    /// The file cannot be read, is neither PNG nor JPEG, or is too large.
    pub fn photograph_size(path: &Path) -> Result<(usize, usize), ImageError> {
        if is_png(path)? {
            png::header(path).map(|header| header.size)
        } else {
            header(path).map(|(_, size)| size)
        }
    }

    /// Loads a photograph. If it has an alpha channel, it is blended over `background`, a display-encoded
    /// colour.
    ///
    /// # Errors
    /// See [`Image::photograph_size`]; also, the file may be damaged.
    pub fn load_photograph(path: &Path, background: [f32; 3]) -> Result<Image, ImageError> {
        if is_png(path)? {
            return png::load_over(path, Some(background)).map(|(image, _)| image);
        }
        let (mut decoder, (width, height)) = header(path)?;
        let bytes = decoder.decode().map_err(|error| {
            ImageError::new(path, format!("expected an intact JPEG, found damage: {error}"))
        })?;
        let expected = 3 * width * height;
        if bytes.len() != expected {
            return Err(ImageError::new(
                path,
                format!("expected {expected} bytes of RGB, found {}", bytes.len()),
            ));
        }
        let mut rgb = room(path, width * height)?;
        rgb.extend(bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(|byte| f32::from(byte) / 255.0)));
        Ok(Image { width, height, rgb })
    }

    /// Shrinks the picture to a size by averaging. Each pixel is weighted by its overlap with the new pixel.
    pub fn averaged(&self, width: usize, height: usize) -> Image {
        let across = weights(self.width, width);
        let down = weights(self.height, height);
        Image::from_fn(width, height, |x, y| {
            let mut sum = [0.0f64; 3];
            for (row, vertical) in &down[y] {
                for (column, horizontal) in &across[x] {
                    let pixel = self.at(*column, *row);
                    sum = std::array::from_fn(|c| sum[c] + vertical * horizontal * f64::from(pixel[c]));
                }
            }
            sum.map(|channel| channel as f32)
        })
    }
}

/// Lists, for each of `to` new pixels, the old pixels out of `from` that it covers, with their weights.
fn weights(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let step = from as f64 / to as f64;
    let covered = |index: usize| {
        let (begin, end) = (index as f64 * step, ((index + 1) as f64 * step).min(from as f64));
        let share =
            |pixel: usize| (end.min((pixel + 1) as f64) - begin.max(pixel as f64)).max(0.0) / (end - begin);
        (begin as usize..(end.ceil() as usize).min(from)).map(|pixel| (pixel, share(pixel))).collect()
    };
    (0..to).map(covered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 16 x 8 pixels: the left half is rgb(200, 60, 30), the right one rgb(20, 90, 220). Quality 95, no subsampling.
    const JPEG: &[u8] = include_bytes!("halves.jpg");

    #[test]
    fn a_jpeg_is_read_whatever_its_name_and_damage_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.png");
        std::fs::write(&path, JPEG).unwrap();
        assert_eq!(Image::photograph_size(&path).unwrap(), (16, 8));
        let image = Image::load_photograph(&path, [0.0; 3]).unwrap();
        let near = |pixel: [f32; 3], expected: [f32; 3]| {
            pixel.iter().zip(expected).all(|(a, b)| (a * 255.0 - b).abs() < 4.0)
        };
        assert!(
            near(image.at(2, 4), [200.0, 60.0, 30.0]) && near(image.at(13, 4), [20.0, 90.0, 220.0]),
            "{:?}",
            image.rgb
        );
        let said = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Image::load_photograph(&path, [0.0; 3]).unwrap_err().to_string()
        };
        for (bytes, what) in
            [(b"GIF89a..", "a file that begins with `GIF8`"), (b"II*\0\x08\0\0\0", "a TIFF file")]
        {
            assert!(said(bytes).ends_with(&format!("expected a PNG or JPEG photograph, found {what}")));
        }
        assert!(said(b"").contains("photo.png: "));
        for end in 4..JPEG.len() / 2 {
            std::fs::write(&path, &JPEG[..end]).unwrap();
            // Must not panic. A file cut inside the pixels may still give a picture.
            _ = Image::load_photograph(&path, [0.0; 3]);
        }
    }

    #[test]
    fn an_averaged_picture_keeps_the_mean_whatever_the_sizes_are() {
        let image = Image::from_fn(13, 7, |x, y| [x as f32, y as f32, (x * y % 5) as f32]);
        let mean = |image: &Image, c: usize| {
            image.rgb.iter().map(|pixel| f64::from(pixel[c])).sum::<f64>() / image.rgb.len() as f64
        };
        for (width, height) in [(13, 7), (6, 4), (4, 7), (1, 1)] {
            let small = image.averaged(width, height);
            assert_eq!((small.width, small.height), (width, height));
            assert!((0..3).all(|c| (mean(&small, c) - mean(&image, c)).abs() < 1e-5), "{width} x {height}");
        }
        assert_eq!(image.averaged(13, 7), image);
        let halves = Image::from_fn(4, 2, |x, _| [x as f32; 3]).averaged(2, 1);
        assert_eq!(halves.rgb, [[0.5; 3], [2.5; 3]]);
    }
}
