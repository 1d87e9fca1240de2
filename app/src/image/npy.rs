//! Reads and writes NumPy's `.npy` arrays, and reads `.npz` archives of them.
//!
//! Arrays are written as float32, little-endian, shape `[height, width, 3]`. They are read as any float type, or as bytes
//! of 0 to 255, with 3 channels, or 4 of which the last is ignored.

use super::{Image, ImageError, MAX_PIXELS, check_size, has_extension};
use crate::output::{self, file::Cause};
use npyz::{NpyFile, NpyWriter, Order, TypeChar, WriteOptions, WriterBuilder};
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use zip::ZipArchive;
use zip::result::ZipError;

pub(super) fn write(image: &Image, out: &mut dyn Write) -> Result<(), Cause> {
    let shape = [image.height as u64, image.width as u64, 3];
    write_array(out, &shape, image.rgb.as_flattened().iter().copied())
}

/// Writes 32-bit words of a resource as an array of `shape` (uint32 or float32).
pub fn save_words<T: npyz::AutoSerialize + Copy>(
    path: &Path,
    shape: &[u64],
    words: &[T],
) -> Result<(), ImageError> {
    if !has_extension(path, "npy") {
        return Err(ImageError::new(path, "expected the extension .npy"));
    }
    Ok(output::write(path, |out| write_array(out, shape, words.iter().copied()))?)
}

fn write_array<T: npyz::AutoSerialize>(
    out: &mut dyn Write,
    shape: &[u64],
    values: impl Iterator<Item = T>,
) -> Result<(), Cause> {
    let mut npy: NpyWriter<T, _> = WriteOptions::new().default_dtype().shape(shape).writer(out).begin_nd()?;
    npy.extend(values)?;
    Ok(npy.finish()?)
}

pub(super) fn load(path: &Path) -> Result<Image, ImageError> {
    let file = File::open(path).map_err(|e| ImageError::because(path, e))?;
    read(path, NpyFile::new(BufReader::new(file)).map_err(|e| ImageError::because(path, e))?)
}

pub(super) fn load_member(archive: &Path, array: &str) -> Result<Image, ImageError> {
    let mut npz = open_npz(archive)?;
    let member = match npz.by_name(&format!("{array}.npy")) {
        Ok(member) => member,
        Err(ZipError::FileNotFound) => {
            let names = npz_names(archive)?.join(", ");
            return Err(ImageError::new(
                archive,
                format!("expected an array named `{array}`, found {names}"),
            ));
        }
        Err(error) => return Err(ImageError::because(archive, error)),
    };
    read(archive, NpyFile::new(BufReader::new(member)).map_err(|e| ImageError::because(archive, e))?)
}

/// Lists the names of an archive's arrays, sorted.
pub fn npz_names(archive: &Path) -> Result<Vec<String>, ImageError> {
    let npz = open_npz(archive)?;
    let mut names: Vec<String> =
        npz.file_names().flatten().filter_map(|name| name.strip_suffix(".npy").map(str::to_owned)).collect();
    names.sort();
    Ok(names)
}

/// Opens an `.npz`, which is a zip archive of `.npy` files.
fn open_npz(archive: &Path) -> Result<ZipArchive<BufReader<File>>, ImageError> {
    let file = File::open(archive).map_err(|e| ImageError::because(archive, e))?;
    ZipArchive::new(BufReader::new(file)).map_err(|e| ImageError::because(archive, e))
}

fn read<R: Read>(path: &Path, npy: NpyFile<R>) -> Result<Image, ImageError> {
    let fail = |e: io::Error| ImageError::because(path, e);
    let shape = npy.shape().to_vec();
    let (&[height, width, channels @ (3 | 4)], Order::C) = (shape.as_slice(), npy.order()) else {
        return Err(ImageError::new(
            path,
            format!(
                "expected an array of shape [height, width, 3], found shape {shape:?} ({:?} order)",
                npy.order()
            ),
        ));
    };
    let (width, height) = check_size(path, width, height)?;
    debug_assert!((width * height) as u64 <= MAX_PIXELS);
    let kind = match npy.dtype() {
        npyz::DType::Plain(kind) => (kind.type_char(), kind.size_field()),
        other => {
            return Err(ImageError::new(
                path,
                format!("expected values of type float32, float64 or uint8, found {}", other.descr()),
            ));
        }
    };
    let values: Vec<f32> = match kind {
        (TypeChar::Float, 4) => npy.into_vec::<f32>().map_err(fail)?,
        (TypeChar::Float, 8) => npy.into_vec::<f64>().map_err(fail)?.into_iter().map(|v| v as f32).collect(),
        (TypeChar::Uint, 1) => {
            npy.into_vec::<u8>().map_err(fail)?.into_iter().map(|v| f32::from(v) / 255.0).collect()
        }
        _ => {
            return Err(ImageError::new(
                path,
                format!("expected values of type float32, float64 or uint8, found {}", npy.dtype().descr()),
            ));
        }
    };
    let rgb = values.chunks_exact(channels as usize).map(|v| [v[0], v[1], v[2]]).collect();
    Ok(Image { width, height, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_other_shapes_and_types_are_errors_that_say_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        save_words(&path, &[2, 6], &[0.0f32; 12]).unwrap();
        let message = load(&path).unwrap_err().to_string();
        assert!(message.contains("shape [2, 6]"), "{message}");
        save_words(&path, &[2, 2, 3], &[0u32; 12]).unwrap();
        let message = load(&path).unwrap_err().to_string();
        assert!(message.ends_with("found '<u4'"), "{message}");
    }

    #[test]
    fn doubles_bytes_and_a_fourth_channel_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        save_words(&path, &[1, 1, 3], &[0.25f64, 0.5, 2.0]).unwrap();
        assert_eq!(load(&path).unwrap().rgb, [[0.25, 0.5, 2.0]]);
        save_words(&path, &[1, 1, 4], &[0u8, 51, 255, 7]).unwrap();
        assert_eq!(load(&path).unwrap().rgb, [[0.0, 0.2, 1.0]]);
    }

    #[test]
    fn an_archive_gives_its_arrays_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let mut npz = zip::ZipWriter::new(File::create(&path).unwrap());
        for (name, value) in [("second", 2.0f32), ("first", 1.0)] {
            let member = folder.path().join("member.npy");
            save_words(&member, &[1, 1, 3], &[value; 3]).unwrap();
            npz.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            npz.write_all(&std::fs::read(member).unwrap()).unwrap();
        }
        npz.finish().unwrap();
        assert_eq!(npz_names(&path).unwrap(), ["first", "second"]);
        assert_eq!(load_member(&path, "first").unwrap().rgb, [[1.0; 3]]);
        let message = load_member(&path, "third").unwrap_err().to_string();
        assert!(
            message.ends_with("a.npz: expected an array named `third`, found first, second"),
            "{message}"
        );
    }
}
