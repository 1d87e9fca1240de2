//! Defines pictures in memory, and the error and the limits that all readers of pictures share.

use crate::io::output::OutputError;
use splatgraph_assets::{grouped, memory};
use splatgraph_reference::metrics::{ImageRef, Rgb};
use std::fmt;
use std::path::{Path, PathBuf};

/// Maximum number of pixels of a picture that is read, so that a damaged header cannot exhaust the memory.
const MAX_PIXELS: u64 = 1 << 28;

/// A picture: rows from the top, pixels from the left, display-encoded RGB, not clamped.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<C = f32> {
    /// Width, in pixels.
    pub width: usize,
    /// Height, in pixels.
    pub height: usize,
    /// `width * height` pixels, row by row. 0 is black and 1 is white.
    pub rgb: Vec<[C; 3]>,
}

/// The precision of the values in a picture's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// Integers from 0 to the given level, which is white.
    Levels(u16),
    /// Floats of single or half precision.
    Single,
    /// Floats of double precision, or 32-bit integers.
    Double,
}

impl Image<f64> {
    /// Rounds every channel to f32. Values that were read from f32 are unchanged.
    pub fn narrow(&self) -> Image {
        let rgb = self.rgb.iter().map(|pixel| pixel.map(|value| value as f32)).collect();
        Image { width: self.width, height: self.height, rgb }
    }

    /// Clamps every channel to 0..1, as a screen or an 8-bit file does.
    pub fn clamped(mut self) -> Image<f64> {
        self.rgb.as_flattened_mut().iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
        self
    }

    /// Restores the levels of an integer picture to f64 precision: replaces each float32 by the nearest level.
    ///
    /// `greatest` is the level of white.
    pub fn levels(mut self, greatest: u16) -> Image<f64> {
        let greatest = f64::from(greatest);
        let level = |value: &mut f64| *value = (*value * greatest).round() / greatest;
        self.rgb.as_flattened_mut().iter_mut().for_each(level);
        self
    }
}

impl<'a> From<&'a Image> for ImageRef<'a> {
    fn from(Image { width, height, rgb }: &'a Image) -> Self {
        ImageRef { width: *width, height: *height, rgb: Rgb::F32(rgb) }
    }
}

impl<'a> From<&'a Image<f64>> for ImageRef<'a> {
    fn from(Image { width, height, rgb }: &'a Image<f64>) -> Self {
        ImageRef { width: *width, height: *height, rgb: Rgb::F64(rgb) }
    }
}

impl Image {
    /// Makes a picture of the absolute differences, multiplied by `gain`. Panics if the sizes differ.
    pub fn difference<C: Copy + Into<f64>>(a: &Image<C>, b: &Image<C>, gain: f32) -> Image {
        assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
        let amplified = |a: C, b: C| ((a.into() - b.into()).abs() * f64::from(gain)) as f32;
        let pixels = a.rgb.iter().zip(&b.rgb);
        let rgb = pixels.map(|(a, b)| std::array::from_fn(|c| amplified(a[c], b[c]))).collect();
        Image { width: a.width, height: a.height, rgb }
    }

    /// Makes a picture from a function of the column and the row.
    pub fn from_fn(width: usize, height: usize, mut pixel: impl FnMut(usize, usize) -> [f32; 3]) -> Image {
        let mut rgb = Vec::with_capacity(width * height);
        for y in 0..height {
            rgb.extend((0..width).map(|x| pixel(x, y)));
        }
        Image { width, height, rgb }
    }

    /// Returns the pixel at column `x` of row `y`. Panics outside of the picture.
    pub fn at(&self, x: usize, y: usize) -> [f32; 3] {
        assert!(x < self.width && y < self.height, "pixel ({x}, {y}) of {} x {}", self.width, self.height);
        self.rgb[y * self.width + x]
    }

    /// Clamps every channel to 0..1, as a screen or an 8-bit file does.
    pub fn clamped(mut self) -> Image {
        for value in self.rgb.as_flattened_mut() {
            *value = value.clamp(0.0, 1.0);
        }
        self
    }

    /// Converts every channel to f64.
    pub fn wide(&self) -> Image<f64> {
        let rgb = self.rgb.iter().map(|pixel| pixel.map(f64::from)).collect();
        Image { width: self.width, height: self.height, rgb }
    }

    /// Converts every channel to 8 bits, as a screen shows it. Also counts the pixels that are not finite.
    pub fn bytes(&self) -> (Vec<u8>, NotFinite) {
        // One value at a time: `map` of a pixel's array is called, not inlined, and takes four times as long.
        let bytes = self.rgb.as_flattened().iter().map(|value| level(*value)).collect();
        let pixels = self.rgb.iter().filter(|pixel| !is_finite(**pixel)).count();
        (bytes, NotFinite { pixels, of: self.rgb.len() })
    }

    /// Shrinks the picture to at most `width` columns, as [`Image::averaged`] does. Keeps the aspect ratio.
    pub fn reduced(&self, width: usize) -> Image {
        let width = width.min(self.width);
        self.averaged(width, (self.height * width).div_ceil(self.width))
    }
}

/// The number of pixels with a channel that is NaN or infinite, which integers cannot hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NotFinite {
    /// Number of such pixels.
    pub pixels: usize,
    /// Number of all pixels.
    pub of: usize,
}

impl NotFinite {
    /// Describes the pixels of the picture `name` in a sentence; `None` without such pixels.
    pub fn note(self, name: impl fmt::Display) -> Option<String> {
        let (pixels, of) = (grouped(self.pixels as u64), grouped(self.of as u64));
        (self.pixels > 0).then(|| {
            format!(
                "{name}: {pixels} of {of} pixels are NaN or infinite: the file has 0 for NaN, and 0 or 1 for infinity; .npy and \
                 .exr keep the values"
            )
        })
    }
}

/// Properties of a picture that its file's header gives.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Width and height, in pixels.
    pub size: (usize, usize),
    /// True if there is an alpha channel, which [`Image::load`] drops.
    pub has_alpha: bool,
    /// True if there is a single channel besides alpha, as in depths.
    pub is_grey: bool,
    /// Encoding that an EXR file declares for its colours; `None` if it declares none, and for other formats.
    pub encoding: Option<String>,
    /// Position of the first pixel in the frame, right and down; not (0, 0) only for some EXR files.
    pub corner: [i32; 2],
}

/// An error while reading or writing a picture.
#[derive(Debug, thiserror::Error)]
#[error("{}: {what}", path.display())]
pub struct ImageError {
    /// The picture's file, or the archive that contains it.
    pub path: PathBuf,
    what: String,
}

impl ImageError {
    pub(super) fn new(path: &Path, what: impl fmt::Display) -> ImageError {
        ImageError { path: path.to_owned(), what: what.to_string() }
    }
}

impl From<OutputError> for ImageError {
    fn from(error: OutputError) -> ImageError {
        ImageError { path: error.path, what: format!("cannot be written: {}", error.cause) }
    }
}

pub(super) fn open(path: &Path) -> Result<std::io::BufReader<std::fs::File>, ImageError> {
    splatgraph_assets::file::open(path).map(std::io::BufReader::new).map_err(|e| ImageError::new(path, e))
}

pub(super) fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}

/// Maximum memory per pixel while a picture is read, in bytes. The three channels are held as f64, and as f32.
const BYTES_PER_PIXEL: u64 = 24 + 12;

/// Allocates memory for the pixels of a picture, or returns an error.
pub(super) fn room<C>(path: &Path, pixels: usize) -> Result<Vec<[C; 3]>, ImageError> {
    let mut rgb = Vec::new();
    rgb.try_reserve_exact(pixels).map_err(|e| ImageError::new(path, e))?;
    Ok(rgb)
}

/// Checks the size in a file's header, before memory is allocated for it.
pub(super) fn check_size(path: &Path, width: u64, height: u64) -> Result<(usize, usize), ImageError> {
    let pixels = width.saturating_mul(height);
    if pixels == 0 {
        return Err(ImageError::new(path, format!("expected at least one pixel, found {width} x {height}")));
    }
    if pixels > MAX_PIXELS {
        let text = format!("expected at most {MAX_PIXELS} pixels, found {width} x {height}");
        return Err(ImageError::new(path, text));
    }
    let needed = pixels.saturating_mul(BYTES_PER_PIXEL);
    if let Some(available) = memory::available().filter(|available| needed > *available) {
        let (needed, available) = (memory::display(needed), memory::display(available));
        let text = format!(
            "expected a picture that fits in the {available} of memory available, found {width} x {height} pixels, which need {needed}"
        );
        return Err(ImageError::new(path, text));
    }
    Ok((width as usize, height as usize))
}

/// Returns true unless a channel is NaN or infinite.
#[inline]
pub(crate) fn is_finite(pixel: [f32; 3]) -> bool {
    pixel.iter().all(|value| value.is_finite())
}

/// Converts a value to a byte: clamped to 0..1, scaled to 0..255, halves rounded up. NaN becomes 0.
#[inline]
pub(super) fn level(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
