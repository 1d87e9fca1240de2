//! Reads and writes NumPy's `.npy` arrays, and reads `.npz` archives of them.
//!
//! Arrays are written as float32, little-endian, shape `[height, width, 3]`. They are read as float32, float64, or
//! bytes of 0 to 255, with 3 channels, or with 4 channels, of which the last is ignored. Arrays of shape
//! `[height, width]`, also of uint32, are grey.

use super::pixels::{Depth, Header, Image, ImageError, check_size, has_extension, open, room};
use crate::io::output::{self, file::Cause};
use npyz::{AutoSerialize, DType, NpyFile, NpyWriter, Order, TypeChar, WriteOptions, WriterBuilder};
use std::cell::RefCell;
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use zip::ZipArchive;

pub(super) fn write(image: &Image, out: &mut dyn Write) -> Result<(), Cause> {
    let shape = [image.height as u64, image.width as u64, 3];
    write_array(out, f32::default_dtype(), &shape, image.rgb.as_flattened().iter().copied())
}

/// Writes the values of a resource as an array of the given shape. `T` determines the array's type.
///
/// # Errors
/// The extension is not `.npy`, or the file cannot be written.
pub fn save_words<T: AutoSerialize + Copy>(
    path: &Path,
    shape: &[u64],
    words: &[T],
) -> Result<(), ImageError> {
    save(path, T::default_dtype(), shape, words.iter().copied())
}

/// A field of a structured array: a scalar, or a vector of several 32-bit words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ElementField {
    /// Name, unique in the array; empty for padding.
    pub name: String,
    /// NumPy's type without its size: `<f`, `<i`, `<u`, or `|V` for padding.
    pub kind: &'static str,
    /// Number of words.
    pub words: u64,
}

/// Writes the words of a buffer as a structured array of elements, one after the other.
///
/// # Errors
/// The extension is not `.npy`, or the file cannot be written.
pub fn save_elements(path: &Path, fields: &[ElementField], words: &[u32]) -> Result<(), ImageError> {
    let per_element = fields.iter().map(|field| field.words).sum::<u64>().max(1) as usize;
    let field = |ElementField { name, kind, words }: &ElementField| {
        let plain = |bytes: u64| format!("{kind}{bytes}").parse().map(DType::Plain);
        let dtype = match words {
            _ if *kind == "|V" => plain(4 * words)?,
            1 => plain(4)?,
            _ => DType::Array(*words, Box::new(plain(4)?)),
        };
        Ok(npyz::Field { name: name.clone(), dtype })
    };
    let fields: Result<_, npyz::ParseTypeStrError> = fields.iter().map(field).collect();
    let dtype = DType::Record(fields.map_err(|error| ImageError::new(path, error.to_string()))?);
    let count = (words.len() / per_element) as u64;
    save(path, dtype, &[count], words.chunks_exact(per_element).map(Element))
}

/// Saves an array. Fails if the extension is not `.npy`.
fn save<T: npyz::Serialize>(
    path: &Path,
    dtype: DType,
    shape: &[u64],
    values: impl Iterator<Item = T>,
) -> Result<(), ImageError> {
    if !has_extension(path, "npy") {
        return Err(ImageError::new(path, "expected the extension .npy"));
    }
    Ok(output::write(path, |out| write_array(out, dtype, shape, values))?)
}

/// An element of a structured array.
struct Element<'a>(&'a [u32]);

/// Writes the words of an element, whatever their types.
struct ElementWriter<'a>(PhantomData<&'a [u32]>);

impl<'a> npyz::Serialize for Element<'a> {
    type TypeWriter = ElementWriter<'a>;
    fn writer(_: &DType) -> Result<Self::TypeWriter, npyz::DTypeError> {
        Ok(ElementWriter(PhantomData))
    }
}

impl<'a> npyz::TypeWrite for ElementWriter<'a> {
    type Value = Element<'a>;
    fn write_one<W: Write>(&self, mut writer: W, element: &Element<'a>) -> io::Result<()> {
        element.0.iter().try_for_each(|word| writer.write_all(&word.to_le_bytes()))
    }
}

fn write_array<T: npyz::Serialize>(
    out: &mut dyn Write,
    dtype: DType,
    shape: &[u64],
    values: impl Iterator<Item = T>,
) -> Result<(), Cause> {
    // The library writes each value separately. With a concrete buffer type, most writes are a copy of four bytes.
    let mut out = BufWriter::new(out);
    let mut npy: NpyWriter<T, _> =
        WriteOptions::new().dtype(dtype).shape(shape).writer(&mut out).begin_nd()?;
    npy.extend(values)?;
    npy.finish()?;
    Ok(out.flush()?)
}

/// Maximum size of an array's header, in bytes.
const MAX_HEADER: usize = 4096;

/// Maximum number of brackets in a header. The library's parser recurses for each one.
const MAX_BRACKETS: usize = 16;

/// An array whose header has been read.
type Array<R> = NpyFile<io::Chain<io::Cursor<Vec<u8>>, R>>;

/// Reads the header of an array, after checking its length and its nesting, which the library's parser trusts.
fn begin<R: Read>(mut reader: R) -> io::Result<Array<R>> {
    let fail = |text: String| io::Error::new(io::ErrorKind::InvalidData, text);
    // The magic number, the version, and the header's length in 2 or 4 bytes.
    let mut start = vec![0; 8];
    reader.read_exact(&mut start)?;
    let bytes = if start[6] == 1 { 2 } else { 4 };
    let mut length = [0; 4];
    reader.read_exact(&mut length[..bytes])?;
    start.extend_from_slice(&length[..bytes]);
    let length = u32::from_le_bytes(length) as usize;
    if start.starts_with(b"\x93NUMPY") {
        if length > MAX_HEADER {
            return Err(fail(format!("expected a header of at most {MAX_HEADER} bytes, found {length}")));
        }
        let from = start.len();
        start.resize(from + length, 0);
        reader.read_exact(&mut start[from..])?;
        let brackets = start[from..].iter().filter(|byte| b"([{".contains(byte)).count();
        if brackets > MAX_BRACKETS {
            return Err(fail(format!(
                "expected at most {MAX_BRACKETS} brackets in the header, found {brackets}"
            )));
        }
    }
    NpyFile::new(io::Cursor::new(start).chain(reader))
}

/// Reads the header of a `.npy` file, or of an array in an archive, and passes the array to `body`.
fn array<T>(
    path: &Path,
    body: impl FnOnce(Array<BufReader<Box<dyn Read + '_>>>) -> Result<T, ImageError>,
) -> Result<T, ImageError> {
    let parse = |bytes: Box<dyn Read + '_>| {
        body(begin(BufReader::new(bytes)).map_err(|error| ImageError::new(path, error))?)
    };
    let Some((archive, array)) = split_member(path) else { return parse(Box::new(open(path)?)) };
    let kept = KEPT.with_borrow_mut(|kept| kept.as_mut()?.remove(&archive));
    let mut npz = kept.map_or_else(|| open_npz(&archive), Ok)?;
    let found = member(&archive, &mut npz, &array).and_then(|bytes| parse(Box::new(bytes)));
    KEPT.with_borrow_mut(|kept| kept.as_mut().map(|kept| kept.insert(archive, npz)));
    found
}

thread_local! {
    /// Archives that [`keep_archives`] keeps open, by path; `None` outside of it.
    static KEPT: RefCell<Option<HashMap<PathBuf, Npz>>> = const { RefCell::new(None) };
}

/// Keeps every archive that `work` opens on this thread open until it ends.
///
/// Opening an archive reads its whole directory. Once per array, the time would grow with the square of their number.
pub fn keep_archives<T>(work: impl FnOnce() -> T) -> T {
    KEPT.set(Some(HashMap::new()));
    let result = work();
    KEPT.set(None);
    result
}

pub(super) fn load(path: &Path) -> Result<(Image<f64>, Depth), ImageError> {
    array(path, |npy| read(path, npy))
}

pub(super) fn header(path: &Path) -> Result<Header, ImageError> {
    array(path, |npy| {
        shape(path, &npy).map(|(size, channels)| Header {
            size,
            has_alpha: channels == 4,
            is_grey: channels == 1,
            ..Header::default()
        })
    })
}

/// Returns true if the file is as long as the array in its header. The format has no checksums, so other damage is not
/// detected.
pub(super) fn is_whole(path: &Path) -> Result<bool, ImageError> {
    let fail = |error| ImageError::new(path, error);
    let mut file = open(path)?;
    let npy = begin(&mut file).map_err(fail)?;
    let size = match npy.dtype() {
        npyz::DType::Plain(kind) => kind.size_field(),
        _ => return Ok(false),
    };
    // `None` if the size overflows, which `NpyFile::len` does not check.
    let bytes = npy.shape().iter().try_fold(size, |bytes, length| bytes.checked_mul(*length));
    drop(npy);
    let start = file.stream_position().map_err(fail)?;
    let expected = bytes.and_then(|bytes| start.checked_add(bytes));
    Ok(Some(file.get_ref().metadata().map_err(fail)?.len()) == expected)
}

/// Opens an array of an archive. The array's own header, not the archive, determines how much is read.
fn member<'a>(archive: &Path, npz: &'a mut Npz, array: &str) -> Result<impl Read + use<'a>, ImageError> {
    let name = format!("{array}.npy");
    if npz.index_for_name(&name).is_none() {
        let names = npz_names(archive)?.join(", ");
        return Err(ImageError::new(archive, format!("expected an array named `{array}`, found {names}")));
    }
    npz.by_name(&name).map_err(|error| ImageError::new(archive, error))
}

/// Splits `a/b.npz#name` into `a/b.npz` and `name`; `None` for other paths.
pub fn split_member(path: &Path) -> Option<(PathBuf, String)> {
    let (archive, array) = path.to_str()?.rsplit_once('#')?;
    has_extension(Path::new(archive), "npz").then(|| (PathBuf::from(archive), array.to_owned()))
}

/// Lists the names of the arrays in an archive, sorted.
///
/// # Errors
/// The archive cannot be read.
pub fn npz_names(archive: &Path) -> Result<Vec<String>, ImageError> {
    let npz = open_npz(archive)?;
    let mut names: Vec<String> =
        npz.file_names().flatten().filter_map(|name| name.strip_suffix(".npy").map(str::to_owned)).collect();
    names.sort();
    Ok(names)
}

type Npz = ZipArchive<BufReader<File>>;

fn open_npz(archive: &Path) -> Result<Npz, ImageError> {
    ZipArchive::new(open(archive)?).map_err(|e| ImageError::new(archive, e))
}

/// Checks the shape of an array, and returns the picture's size and its number of channels.
fn shape<R: Read>(path: &Path, npy: &NpyFile<R>) -> Result<((usize, usize), usize), ImageError> {
    let shape = npy.shape();
    let (height, width, channels) = match (shape, npy.order()) {
        (&[height, width], Order::C) => (height, width, 1),
        (&[height, width, channels @ (3 | 4)], Order::C) => (height, width, channels),
        (_, order) => {
            return Err(ImageError::new(
                path,
                format!(
                    "expected an array of shape [height, width, 3] or [height, width] in C order (numpy.ascontiguousarray), found \
                     shape {shape:?} in {order:?} order"
                ),
            ));
        }
    };
    Ok((check_size(path, width, height)?, channels as usize))
}

fn read<R: Read>(path: &Path, npy: NpyFile<R>) -> Result<(Image<f64>, Depth), ImageError> {
    let ((width, height), channels) = shape(path, &npy)?;
    let kind = match npy.dtype() {
        npyz::DType::Plain(kind) => Some((kind.type_char(), kind.size_field())),
        _ => None,
    };
    let size = (width, height, channels);
    match kind {
        Some((TypeChar::Float, 4)) => {
            Ok((pixels(path, npy, size, |value: f32| value.into())?, Depth::Single))
        }
        Some((TypeChar::Float, 8)) => Ok((pixels(path, npy, size, |value: f64| value)?, Depth::Double)),
        Some((TypeChar::Uint, 1)) => {
            let level = |v: u8| f64::from(f32::from(v) / 255.0);
            Ok((pixels(path, npy, size, level)?, Depth::Levels(u8::MAX.into())))
        }
        // uint32: counts and indices.
        Some((TypeChar::Uint, 4)) if channels == 1 => {
            Ok((pixels(path, npy, size, |value: u32| value.into())?, Depth::Double))
        }
        _ => Err(ImageError::new(
            path,
            format!(
                "expected values of type float32, float64 or uint8, or uint32 in a single channel, found {}",
                npy.dtype().descr()
            ),
        )),
    }
}

/// Reads the pixels of an array; a single channel is grey, a fourth channel is dropped.
fn pixels<R: Read, T: npyz::Deserialize>(
    path: &Path,
    npy: NpyFile<R>,
    (width, height, channels): (usize, usize, usize),
    convert: impl Fn(T) -> f64,
) -> Result<Image<f64>, ImageError> {
    let mut values = npy.data::<T>().map_err(|e| ImageError::new(path, e))?;
    let mut rgb = room(path, width * height)?;
    let missing = || ImageError::new(path, "the file ends before its last pixel");
    for _ in 0..width * height {
        let mut pixel = [0.0; 4];
        for value in &mut pixel[..channels] {
            let read = values.next().ok_or_else(missing)?;
            *value = convert(read.map_err(|e| ImageError::new(path, e))?);
        }
        rgb.push(if channels == 1 { [pixel[0]; 3] } else { [pixel[0], pixel[1], pixel[2]] });
    }
    Ok(Image { width, height, rgb })
}

#[cfg(test)]
mod tests {
    use super::super::fuzz;
    use super::*;

    fn load(path: &Path) -> Result<Image, ImageError> {
        Image::load(path)
    }

    #[test]
    fn arrays_of_other_shapes_and_types_are_errors_that_say_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        save_words(&path, &[2, 3, 2], &[0.0f32; 12]).unwrap();
        let message = load(&path).unwrap_err().to_string();
        assert!(message.contains("shape [2, 3, 2]"), "{message}");
        save_words(&path, &[2, 2, 3], &[0u32; 12]).unwrap();
        let message = load(&path).unwrap_err().to_string();
        assert!(message.ends_with("or uint32 in a single channel, found '<u4'"), "{message}");
    }

    #[test]
    fn a_header_that_is_too_long_or_too_deep_is_refused_before_it_is_parsed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let said = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            load(&path).unwrap_err().to_string()
        };
        let said_long = said(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{'descr'");
        assert!(
            said_long.ends_with("expected a header of at most 4096 bytes, found 4294967295"),
            "{said_long}"
        );
        let deep = [&b"\x93NUMPY\x01\x00\xa0\x0f"[..], "(".repeat(4000).as_bytes()].concat();
        assert!(
            said(&deep).ends_with("expected at most 16 brackets in the header, found 4000"),
            "{}",
            said(&deep)
        );
    }

    #[test]
    fn an_array_whose_size_overflows_is_not_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let side = 1u64 << 32;
        std::fs::write(&path, fuzz::npy("<f4", "False", &format!("({side}, {side})"), 0)).unwrap();
        assert!(!is_whole(&path).unwrap());
    }

    #[test]
    fn an_array_of_an_archive_that_promises_more_pixels_than_are_allowed_is_refused_from_its_header() {
        let folder = tempfile::tempdir().unwrap();
        let npy = fuzz::npy("<f4", "False", "(1000000, 1000000, 3)", 1 << 20);
        let npz = fuzz::zipped(&npy, zip::CompressionMethod::Stored);
        std::fs::write(folder.path().join("bomb.npz"), npz).unwrap();
        let path = folder.path().join("bomb.npz#b");
        for error in [load(&path).unwrap_err(), Image::header(&path).unwrap_err()] {
            assert!(error.to_string().contains("found 1000000 x 1000000"), "{error}");
        }
    }

    #[test]
    fn doubles_bytes_and_a_fourth_channel_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        save_words(&path, &[1, 1, 3], &[0.25f64, 0.5, 2.0]).unwrap();
        assert_eq!(load(&path).unwrap().rgb, [[0.25, 0.5, 2.0]]);
        assert!(!Image::header(&path).unwrap().has_alpha);
        save_words(&path, &[1, 1, 4], &[0u8, 51, 255, 7]).unwrap();
        assert_eq!(load(&path).unwrap().rgb, [[0.0, 0.2, 1.0]]);
        assert!(Image::header(&path).unwrap().has_alpha);
    }

    #[test]
    fn arrays_of_one_value_per_pixel_are_grey() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        save_words(&path, &[1, 2], &[0.25f32, 7.5]).unwrap();
        assert_eq!(load(&path).unwrap().rgb, [[0.25; 3], [7.5; 3]]);
        save_words(&path, &[2, 1], &[3u32, u32::MAX]).unwrap();
        assert_eq!(super::load(&path).unwrap().0.rgb, [[3.0; 3], [f64::from(u32::MAX); 3]]);
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
        assert_eq!(load(&folder.path().join("a.npz#first")).unwrap().rgb, [[1.0; 3]]);
        let message = load(&folder.path().join("a.npz#third")).unwrap_err().to_string();
        assert!(
            message.ends_with("a.npz: expected an array named `third`, found first, second"),
            "{message}"
        );
        keep_archives(|| {
            load(&folder.path().join("a.npz#first")).unwrap();
            std::fs::remove_file(&path).unwrap();
            // The archive is still open.
            assert_eq!(load(&folder.path().join("a.npz#second")).unwrap().rgb, [[2.0; 3]]);
        });
    }
}
