//! Represents pictures in memory, and reads and writes picture files.
//!
//! An [`Image`] holds blended pixels as float32, *display-encoded*: a screen shows the values unchanged. Splat scenes
//! are trained on ordinary photographs, so their colours already have that encoding, and nothing here converts to or
//! from linear light.
//!
//! Three formats can be written and read: `.npy` (float32), `.exr` (float32, with attributes for the encoding) and
//! `.png` (8 bits per channel). `.jpg` can be read. `#` selects an array of a `.npz` archive: `golden.npz#camera0`.
//! Photographs ([`Image::load_photograph`]) are PNG or JPEG files.

mod exr;
#[cfg(test)]
mod fuzz;
mod npy;
mod photograph;
mod pixels;
mod png;

use crate::io::output;
use pixels::has_extension;
use std::fmt;
use std::path::Path;
use std::str::FromStr;
use tracing::info_span;

pub use exr::{ENCODING, Samples, save_values};
pub use npy::{ElementField, keep_archives, npz_names, save_elements, save_words, split_member};
pub(crate) use pixels::is_finite;
pub use pixels::{Depth, Header, Image, ImageError, NotFinite};

/// Writes colours with alpha as a PNG file: 8 bits per channel, colours not multiplied by alpha.
///
/// `values` are four per pixel: display-encoded colours multiplied by alpha, and alpha. Colours are clamped after the
/// division by alpha; they are black where alpha is 0. Returns the number of pixels that are not finite.
///
/// # Errors
/// The file cannot be written. An existing file is then kept.
pub fn save_rgba_png(
    path: &Path,
    (width, height): (usize, usize),
    values: &[f32],
) -> Result<NotFinite, ImageError> {
    let _span = info_span!("encode and write", path = %path.display()).entered();
    let (mut bytes, mut pixels) = (Vec::with_capacity(4 * width * height), 0);
    for [r, g, b, alpha] in values.as_chunks().0 {
        let level = |value: &f32| pixels::level(if *alpha > 0.0 { value / alpha } else { 0.0 });
        bytes.extend([level(r), level(g), level(b), pixels::level(*alpha)]);
        pixels += usize::from(![r, g, b, alpha].iter().all(|value| value.is_finite()));
    }
    output::write(path, |out| png::write_bytes((width, height), &bytes, true, out))?;
    Ok(NotFinite { pixels, of: width * height })
}

impl Image {
    /// Reads the header of a picture, not its pixels.
    ///
    /// # Errors
    /// See [`Image::load`]; damage after the header is not detected.
    pub fn header(path: &Path) -> Result<Header, ImageError> {
        match format_of(path) {
            Some(Format::Png) => png::header(path),
            Some(Format::Exr) => exr::header(path),
            Some(Format::Npy) => npy::header(path),
            None if is_jpeg(path) => {
                Image::photograph_size(path).map(|size| Header { size, ..Header::default() })
            }
            None => Err(no_picture(path)),
        }
    }

    /// Returns false for a picture file with detectable damage.
    ///
    /// Such damage is a cut file, a wrong signature or checksum of a PNG, or a block of an EXR that cannot be unpacked.
    ///
    /// # Errors
    /// The extension is not `.png`, `.exr` or `.npy`, the file cannot be read, or the header of an EXR or NumPy file is
    /// damaged.
    pub fn is_whole(path: &Path) -> Result<bool, ImageError> {
        match Format::of(path) {
            Some(Format::Png) => png::is_whole(path),
            Some(Format::Exr) => exr::is_whole(path),
            Some(Format::Npy) => npy::is_whole(path),
            None => Err(no_picture(path)),
        }
    }

    /// Loads a picture from `.png`, `.jpg`, `.exr`, `.npy`, or `archive.npz#array`. Drops alpha; one channel is grey.
    ///
    /// # Errors
    /// The path has another extension, or the file cannot be read, is damaged or is too large.
    pub fn load(path: &Path) -> Result<Image, ImageError> {
        match format_of(path) {
            Some(Format::Png) => png::load(path).map(|(image, _)| image),
            None if is_jpeg(path) => Image::load_photograph(path, [0.0; 3]),
            _ => Image::load_wide(path).map(|(image, _)| image.narrow()),
        }
    }

    /// Loads a picture as [`Image::load`] does, but keeps float64 values. Also returns the file's precision.
    ///
    /// # Errors
    /// See [`Image::load`].
    pub fn load_wide(path: &Path) -> Result<(Image<f64>, Depth), ImageError> {
        match format_of(path) {
            Some(Format::Npy) => npy::load(path),
            Some(Format::Png) => {
                let (image, greatest) = png::load(path)?;
                Ok((image.wide(), Depth::Levels(greatest)))
            }
            Some(Format::Exr) => exr::load(path),
            None if is_jpeg(path) => Ok((Image::load(path)?.wide(), Depth::Levels(u8::MAX.into()))),
            None => Err(no_picture(path)),
        }
    }

    /// Saves a picture in the format of the path's extension, and creates its folder.
    ///
    /// # Errors
    /// The extension is unknown, or the file cannot be written. An existing file is then kept.
    pub fn save(&self, path: &Path) -> Result<(), ImageError> {
        let Some(format) = Format::of(path) else {
            return Err(ImageError::new(path, "expected the extension .png, .exr or .npy"));
        };
        self.save_as(format, path).map(drop)
    }

    /// Saves a picture in this format, whatever the file's extension. The path `-` is standard output. Returns the
    /// number of pixels that the format cannot hold; `None` for formats that hold all floats.
    ///
    /// # Errors
    /// The file cannot be written. An existing file is then kept.
    pub fn save_as(&self, format: Format, path: &Path) -> Result<Option<NotFinite>, ImageError> {
        let _span = info_span!("encode and write", path = %path.display()).entered();
        let mut not_finite = None;
        output::write(path, |out| match format {
            Format::Png => png::write(self, true, out).map(|found| not_finite = Some(found)),
            Format::Exr => exr::write(self, out),
            Format::Npy => npy::write(self, out),
        })?;
        Ok(not_finite)
    }

    /// Saves values that are not colours, such as alpha, as a PNG file. Programs must not convert them as colours, so
    /// the file does not declare an encoding. Returns the number of pixels that are not finite.
    ///
    /// # Errors
    /// The file cannot be written. An existing file is then kept.
    pub fn save_png_of_data(&self, path: &Path) -> Result<NotFinite, ImageError> {
        let _span = info_span!("encode and write", path = %path.display()).entered();
        let mut not_finite = NotFinite::default();
        output::write(path, |out| png::write(self, false, out).map(|found| not_finite = found))?;
        Ok(not_finite)
    }

    /// Encodes the picture as a PNG file, and returns its bytes.
    ///
    /// # Errors
    /// The picture has no pixels, or too many for the format.
    pub fn png(&self) -> Result<Vec<u8>, ImageError> {
        let mut bytes = Vec::new();
        png::write(self, true, &mut bytes).map_err(|cause| ImageError::new(Path::new("a PNG"), cause))?;
        Ok(bytes)
    }
}

/// The file formats in which pictures are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// 8 bits per channel, clamped to 0..1.
    Png,
    /// float32, OpenEXR.
    Exr,
    /// float32, NumPy, shape `[height, width, 3]`.
    Npy,
}

impl Format {
    /// Returns the format for a path's extension, in upper or lower case; `None` for others, also for `.jpg`, which is
    /// only read.
    pub fn of(path: &Path) -> Option<Format> {
        [Format::Png, Format::Exr, Format::Npy].into_iter().find(|f| has_extension(path, f.extension()))
    }

    /// Returns the format's extension, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Png => "png",
            Format::Exr => "exr",
            Format::Npy => "npy",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.extension())
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(text: &str) -> Result<Format, String> {
        Format::of(Path::new(&format!("x.{text}"))).ok_or_else(|| "expected png, exr or npy".into())
    }
}

/// Returns true for a JPEG file's extension, in upper or lower case.
pub fn is_jpeg(path: &Path) -> bool {
    ["jpg", "jpeg"].iter().any(|extension| has_extension(path, extension))
}

fn no_picture(path: &Path) -> ImageError {
    if !has_extension(path, "npz") {
        return ImageError::new(path, "expected a picture (.png, .jpg, .exr, .npy, or FILE.npz#NAME)");
    }
    let names = match npz_names(path) {
        Ok(names) => names,
        Err(error) => return error,
    };
    let example = names.first().map_or("camera0", String::as_str);
    let names = names.join(", ");
    let text = format!(
        "an archive of arrays: name one of them, for instance {}#{example} (it holds {names})",
        path.display()
    );
    ImageError::new(path, text)
}

/// Returns the format of a file to read. An array in an archive is a NumPy array, whatever its name ends in.
fn format_of(path: &Path) -> Option<Format> {
    if split_member(path).is_some() { Some(Format::Npy) } else { Format::of(path) }
}

#[cfg(test)]
mod tests {
    use super::pixels::check_size;
    use super::*;
    use crate::io::output::faults;
    use std::path::PathBuf;

    fn ramp() -> Image {
        Image::from_fn(7, 5, |x, y| [x as f32 / 3.0 - 0.5, y as f32 / 4.0, 1e-3 * (x * y) as f32])
    }

    #[test]
    fn a_picture_that_lacks_its_last_byte_is_not_whole_nor_is_a_packed_one_without_its_second_half() {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::from_fn(300, 64, |x, y| [(x * x % 293) as f32 / 300.0, (x * y % 71) as f32, 0.5]);
        for name in ["a.png", "a.exr", "a.npy"] {
            let path = folder.path().join(name);
            image.save(&path).unwrap();
            assert!(Image::is_whole(&path).unwrap(), "{name}");
            let bytes = std::fs::read(&path).unwrap();
            std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
            assert_eq!(Image::header(&path).unwrap().size, (300, 64));
            assert!(!Image::is_whole(&path).unwrap_or(false), "{name}");
            // As after a failure of a shared disk.
            let mut lost = bytes.clone();
            lost[bytes.len() / 2..].fill(0);
            std::fs::write(&path, lost).unwrap();
            assert_eq!(Image::is_whole(&path).unwrap(), name == "a.npy", "{name}");
            if name == "a.exr" {
                // The first offset, which is the position of the first block.
                let is_first = |at: &usize| {
                    let offset = u64::from_le_bytes(bytes[*at..*at + 8].try_into().unwrap());
                    offset == (*at + 2 * 8) as u64
                };
                let table = (0..bytes.len() - 8).find(is_first).unwrap();
                let mut lost = bytes.clone();
                lost[table..table + 8].fill(0);
                std::fs::write(&path, lost).unwrap();
                assert!(!Image::is_whole(&path).unwrap_or(false), "offsets");
            }
            let mut lost = bytes;
            lost[..4].fill(0);
            std::fs::write(&path, lost).unwrap();
            assert!(!Image::is_whole(&path).unwrap_or(false), "{name}: no signature");
        }
    }

    #[test]
    fn the_difference_of_two_pictures_is_amplified() {
        let grey = |value| Image::from_fn(2, 2, |_, _| [value; 3]);
        assert_eq!(Image::difference(&grey(0.5), &grey(0.25), 8.0).rgb, [[2.0; 3]; 4]);
    }

    #[test]
    fn a_reduced_picture_keeps_its_proportions_and_is_not_enlarged() {
        let image = Image::from_fn(6, 3, |x, y| [x as f32, y as f32, 1.0]);
        let small = image.reduced(4);
        assert_eq!((small.width, small.height), (4, 2));
        assert!((small.at(0, 0)[0] - 1.0 / 3.0).abs() < 1e-6, "{:?}", small.at(0, 0));
        assert_eq!(image.reduced(7), image);
    }

    #[test]
    fn float_formats_give_back_every_bit_also_outside_0_to_1() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.npy", "a.exr", "made/on/the/way/a.NPY"] {
            let path = folder.path().join(name);
            ramp().save(&path).unwrap();
            assert_eq!(Image::load(&path).unwrap(), ramp(), "{name}");
        }
    }

    #[test]
    fn a_full_disk_at_any_step_leaves_the_old_picture_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.npy", "a.exr", "a.png"] {
            let path = folder.path().join(name);
            let steps = faults::at_every_step(&path, |path| ramp().save(path));
            assert!(steps >= 4, "{name}: {steps} steps");
            assert_eq!(Image::load(&path).unwrap().width, 7);
            std::fs::remove_file(path).unwrap();
        }
        let path = folder.path().join("words.npy");
        faults::at_every_step(&path, |path| save_words(path, &[6], &[1u32; 6]));
    }

    #[test]
    fn png_clamps_and_rounds_half_up() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let image = Image {
            width: 2,
            height: 1,
            rgb: vec![[-1.0, 0.5, 2.0], [0.5 / 255.0, 0.499 / 255.0, f32::INFINITY]],
        };
        image.save(&path).unwrap();
        let levels = |l: [u8; 3]| l.map(|v| f32::from(v) / 255.0);
        assert_eq!(Image::load(&path).unwrap().rgb, [levels([0, 128, 255]), levels([1, 0, 255])]);
    }

    #[test]
    fn a_png_of_colours_declares_srgb_and_one_of_data_declares_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let declares = || {
            let bytes = std::fs::read(&path).unwrap();
            [b"sRGB", b"gAMA", b"cHRM", b"iCCP"].map(|chunk| bytes.windows(4).any(|name| name == chunk))
        };
        ramp().save(&path).unwrap();
        assert!(declares()[0]);
        let colors = Image::load(&path).unwrap();
        ramp().save_png_of_data(&path).unwrap();
        assert_eq!((declares(), Image::load(&path).unwrap()), ([false; 4], colors));
    }

    #[test]
    fn files_of_something_else_are_errors_that_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.exr", "a.npy", "a.npz#x", "a.jpg", "missing.png", "a.npz"] {
            let path = folder.path().join(name);
            if !name.contains("missing") {
                std::fs::write(
                    folder.path().join(name.split('#').next().unwrap()),
                    b"hello, this is no picture",
                )
                .unwrap();
            }
            let message = Image::load(&path).unwrap_err().to_string();
            assert!(message.contains(name.split('#').next().unwrap()), "{message}");
        }
    }

    #[test]
    fn truncated_files_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.exr", "a.npy"] {
            let path = folder.path().join(name);
            ramp().save(&path).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            for length in (0..bytes.len()).step_by(7) {
                std::fs::write(&path, &bytes[..length]).unwrap();
                // A PNG may lack its last chunk, which holds no pixels.
                if let Ok(image) = Image::load(&path) {
                    assert_eq!((image.width, image.height), (7, 5), "{name} cut to {length} bytes");
                    assert!(name == "a.png" && length > bytes.len() - 16, "{name} cut to {length} bytes");
                }
            }
        }
    }

    #[test]
    fn a_header_that_claims_too_many_pixels_is_an_error() {
        let path = Path::new("huge.png");
        let message = check_size(path, u64::MAX, 2).unwrap_err().to_string();
        assert!(message.starts_with("huge.png: expected at most"), "{message}");
        assert!(check_size(path, 0, 4).is_err());
        assert!(check_size(path, 1 << 12, 1 << 12).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_regular_file_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.exr", "a.npy", "a.npz"] {
            let path = folder.path().join(name);
            assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
            let path = if name == "a.npz" { folder.path().join("a.npz#b") } else { path };
            for error in [Image::header(&path).unwrap_err(), Image::load(&path).unwrap_err()] {
                assert!(error.to_string().ends_with("expected a regular file, found a FIFO"), "{error}");
            }
        }
    }

    #[test]
    fn an_array_in_an_archive_is_named_after_a_hash() {
        assert_eq!(
            split_member(Path::new("a#b/c.npz#camera0")),
            Some((PathBuf::from("a#b/c.npz"), "camera0".to_owned()))
        );
        assert_eq!(split_member(Path::new("a#1.png")), None);
    }
}
