//! Reads and writes OpenEXR files.
//!
//! Pictures have the float32 channels R, G and B. Normals (N.X, N.Y and N.Z) are read as colours, and a single channel
//! as grey.
//!
//! By default, programs interpret the values of an EXR as linear light, but ours are display-encoded. Two attributes
//! declare this: `colorInteropID` for programs, in the vocabulary of the Academy Software Foundation's Color Interop
//! Forum, and `comments` for people.

use super::pixels::{Depth, Header, Image, ImageError, check_size, open};
use crate::io::output::{self, file::Cause};
use exr::block::reader::ChunksReader;
use exr::block::samples::FromNativeSample;
use exr::prelude as x;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, WritableImage};
use std::cell::Cell;
use std::io::{Cursor, Write};
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::sync::Once;

/// Name of the attribute for a file's encoding.
const INTEROP: &str = "colorInteropID";
/// The encoding of our files, and by assumption of files that declare none.
pub const ENCODING: &str = "srgb_rec709_display";
const COMMENT: &str = "Display-encoded (sRGB) values, not linear light; not clamped to 0..1.";

/// Compression and order of the blocks. Threads finish blocks in any order, but blocks are written in the order of the
/// rows, so that equal pictures are equal files.
const BLOCKS: x::Encoding =
    x::Encoding { line_order: x::LineOrder::Increasing, ..x::Encoding::SMALL_FAST_LOSSLESS };

/// Returns the attributes of a layer. `about` describes values that are not colours. Colours are declared to be
/// display-encoded.
fn attributes(about: Option<&str>) -> x::LayerAttributes {
    let mut attributes = x::LayerAttributes {
        software_name: Some(x::Text::from(concat!("splatgraph ", env!("CARGO_PKG_VERSION")))),
        comments: x::Text::new_or_none(about.unwrap_or(COMMENT)),
        ..Default::default()
    };
    if about.is_none() {
        let encoding = x::AttributeValue::Text(x::Text::from(ENCODING));
        attributes.other.insert(x::Text::from(INTEROP), encoding);
    }
    attributes
}

pub(super) fn write(image: &Image, out: &mut dyn Write) -> Result<(), Cause> {
    let channels = x::SpecificChannels::rgb(|at: x::Vec2<usize>| {
        let [r, g, b] = image.at(at.x(), at.y());
        (r, g, b)
    });
    let size = (image.width, image.height);
    let layer = x::Layer::new(size, attributes(None), BLOCKS, channels);
    // The library seeks in its output, which a pipe does not support.
    let mut bytes = Vec::new();
    x::Image::from_layer(layer).write().to_buffered(Cursor::new(&mut bytes))?;
    Ok(out.write_all(&bytes)?)
}

/// Values of an output besides the picture.
#[derive(Clone, Copy)]
pub enum Samples<'a> {
    /// 32-bit floats.
    Float(&'a [f32]),
    /// 32-bit integers.
    Uint(&'a [u32]),
}

/// Writes one channel per name. `values` are interleaved, in the order of `names`.
///
/// `about` describes channels that are not colours; `None` declares them to be display-encoded colours.
///
/// # Errors
/// The file cannot be written.
pub fn save_values(
    path: &Path,
    names: &[&str],
    (width, height): (usize, usize),
    values: Samples,
    about: Option<&str>,
) -> Result<(), ImageError> {
    fn every<T: Copy>(values: &[T], at: usize, of: usize) -> Vec<T> {
        values.iter().skip(at).step_by(of).copied().collect()
    }
    let channel = |(at, name): (usize, &&str)| {
        let samples = match values {
            Samples::Float(values) => x::FlatSamples::F32(every(values, at, names.len())),
            Samples::Uint(values) => x::FlatSamples::U32(every(values, at, names.len())),
        };
        x::AnyChannel::new(*name, samples)
    };
    let channels = x::AnyChannels::sort(names.iter().enumerate().map(channel).collect());
    let layer = x::Layer::new((width, height), attributes(about), BLOCKS, channels);
    Ok(output::write(path, |out| {
        let mut bytes = Vec::new();
        x::Image::from_layer(layer).write().to_buffered(Cursor::new(&mut bytes))?;
        Ok(out.write_all(&bytes)?)
    })?)
}

/// The layer that is read as the picture, and its channels.
///
/// It is the first layer with R, G and B, else the first one with a normal. If there is none, the first layer with a
/// single channel decides: the first layer that has a channel of that name is read.
struct Found {
    header: Header,
    /// Names of the channels that become R, G and B; a single name for grey.
    channels: Vec<x::Text>,
    depth: Depth,
}

/// Reads the headers of all layers, and checks the layers' sizes.
fn headers(path: &Path) -> Result<(exr::meta::MetaData, Vec<(usize, usize)>), ImageError> {
    let file = open(path)?;
    let meta = quietly(|| exr::meta::MetaData::read_from_buffered(file, false))
        .ok_or_else(|| {
            ImageError::new(path, "expected the header of an OpenEXR file, found one that cannot be read")
        })?
        .map_err(|e| ImageError::new(path, e))?;
    let mut sizes = Vec::new();
    for header in &meta.headers {
        let size = header.layer_size;
        sizes.push(check_size(path, size.width() as u64, size.height() as u64)?);
    }
    Ok((meta, sizes))
}

/// Finds the layer of the picture, as [`Found`] describes it, in the headers of a file.
fn find(path: &Path) -> Result<Found, ImageError> {
    let (meta, sizes) = headers(path)?;
    let has = |at: usize, name: &x::Text| {
        meta.headers[at].channels.list.iter().any(|channel| channel.name == *name)
    };
    let first = |names: &[x::Text]| (0..sizes.len()).find(|&at| names.iter().all(|name| has(at, name)));
    let only = meta.headers.iter().find(|header| header.channels.list.len() == 1);
    let grey = only.map(|header| vec![header.channels.list[0].name.clone()]);
    let colours = [["R", "G", "B"], ["N.X", "N.Y", "N.Z"]].map(|names| names.map(x::Text::from).to_vec());
    let found = colours.into_iter().chain(grey).find_map(|names| Some((first(&names)?, names)));
    let Some((at, channels)) = found else {
        return Err(ImageError::new(
            path,
            "expected a layer with the channels R, G and B, N.X, N.Y and N.Z, or a single channel, found none",
        ));
    };
    let layer = &meta.headers[at];
    let encoding = match layer.own_attributes.other.get(&x::Text::from(INTEROP)) {
        Some(x::AttributeValue::Text(encoding)) => Some(encoding.to_string()),
        _ => None,
    };
    let header = Header {
        size: sizes[at],
        has_alpha: channels.len() > 1 && has(at, &x::Text::from("A")),
        is_grey: channels.len() == 1,
        encoding,
        corner: [layer.own_attributes.layer_position.x(), layer.own_attributes.layer_position.y()],
    };
    let read = |channel: &&x::ChannelDescription| channels.contains(&channel.name);
    let are_integers = layer.channels.list.iter().filter(read).any(|c| c.sample_type == x::SampleType::U32);
    let depth = if are_integers { Depth::Double } else { Depth::Single };
    Ok(Found { header, channels, depth })
}

pub(super) fn header(path: &Path) -> Result<Header, ImageError> {
    find(path).map(|found| found.header)
}

/// Returns true if the file has all the blocks of its header, and each can be unpacked.
///
/// The format has no checksums, so damage that unpacks to other pixels is not detected.
pub(super) fn is_whole(path: &Path) -> Result<bool, ImageError> {
    headers(path)?;
    let file = open(path)?;
    // Unpacks one block at a time, because many pictures are checked in parallel.
    let unpacked = || -> x::Result<bool> {
        let reader = exr::block::read(file, false)?;
        // Finds blocks through the offset table, as `load` does, so that damage to the table is detected.
        let chunks = reader.filter_chunks(false, |_, tile, _| tile.is_largest_resolution_level())?;
        Ok(chunks.sequential_decompressor(false).all(|block| block.is_ok()))
    };
    Ok(quietly(unpacked).is_some_and(|read| read.unwrap_or(false)))
}

/// Loads the data window of the picture's layer, with its precision.
pub(super) fn load(path: &Path) -> Result<(Image<f64>, Depth), ImageError> {
    let Found { channels, depth, .. } = find(path)?;
    let damaged = || ImageError::new(path, "expected compressed pixels, found bytes that cannot be unpacked");
    let image = quietly(|| read(path, &channels)).unwrap_or_else(|| Err(damaged()))?;
    Ok((image, depth))
}

/// A sample in the precision that holds every type of the format.
#[derive(Clone, Copy, Default)]
struct Sample(f64);

impl FromNativeSample for Sample {
    fn from_f16(value: x::f16) -> Sample {
        Sample(value.to_f64())
    }

    fn from_f32(value: f32) -> Sample {
        Sample(value.into())
    }

    fn from_u32(value: u32) -> Sample {
        Sample(value.into())
    }
}

thread_local! {
    /// True while [`quietly`] catches this thread's panics, whose messages the panic hook then suppresses.
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `body`; if it panics, prints no message and returns `None`. The library panics on some damaged files.
fn quietly<T>(body: impl FnOnce() -> T) -> Option<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let usual = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !QUIET.get() {
                usual(info);
            }
        }));
    });
    QUIET.set(true);
    // Unwind safe: after a panic, nothing reads the state that `body` changed.
    let result = panic::catch_unwind(AssertUnwindSafe(body));
    QUIET.set(false);
    result.ok()
}

fn black(size: x::Vec2<usize>) -> Image<f64> {
    let (width, height) = (size.width(), size.height());
    Image { width, height, rgb: vec![[0.0; 3]; width * height] }
}

fn set(image: &mut Image<f64>, at: x::Vec2<usize>, pixel: [f64; 3]) {
    image.rgb[at.y() * image.width + at.x()] = pixel;
}

/// Reads three channels as red, green and blue, or one as grey, from the first layer that has them.
fn read(path: &Path, channels: &[x::Text]) -> Result<Image<f64>, ImageError> {
    let fail = |error: exr::error::Error| ImageError::new(path, error);
    let file = open(path)?;
    let reader = x::read().no_deep_data().largest_resolution_level().specific_channels();
    // Without threads: a panic on a thread of a pool would end the program.
    if let [r, g, b] = channels {
        let channels = reader.required::<Sample>(r.clone()).required(g.clone()).required(b.clone());
        let pixels = channels.collect_pixels(
            |size, _| black(size),
            |image, at, (r, g, b): (Sample, Sample, Sample)| set(image, at, [r.0, g.0, b.0]),
        );
        let reader = pixels.first_valid_layer().all_attributes().non_parallel();
        return Ok(reader.from_buffered(file).map_err(fail)?.layer_data.channel_data.pixels);
    }
    let pixels = reader
        .required::<Sample>(channels[0].clone())
        .collect_pixels(|size, _| black(size), |image, at, (value,): (Sample,)| set(image, at, [value.0; 3]));
    let reader = pixels.first_valid_layer().all_attributes().non_parallel();
    Ok(reader.from_buffered(file).map_err(fail)?.layer_data.channel_data.pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_channel_is_grey_a_normal_is_a_colour_and_two_channels_are_no_picture() {
        let save_values = |path: &Path, names: &[&str], size, values: &[f32]| {
            super::save_values(path, names, size, Samples::Float(values), Some("a test"))
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        save_values(&path, &["Z"], (3, 2), &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        let image = Image::load(&path).unwrap();
        assert_eq!((image.width, image.height, image.at(1, 1)), (3, 2, [4.0; 3]));
        assert!(!Image::header(&path).unwrap().has_alpha);
        save_values(&path, &["A", "Z"], (3, 1), &[0.0; 6]).unwrap();
        let message = Image::load(&path).unwrap_err().to_string();
        assert!(message.ends_with("N.X, N.Y and N.Z, or a single channel, found none"), "{message}");
        save_values(&path, &["N.X", "N.Y", "N.Z"], (1, 1), &[1.0, 2.0, 3.0]).unwrap();
        assert_eq!(Image::load(&path).unwrap().rgb, [[1.0, 2.0, 3.0]]);
        let ids = [7, u32::MAX];
        super::save_values(&path, &["index"], (2, 1), Samples::Uint(&ids), Some("index")).unwrap();
        let (image, depth) = load(&path).unwrap();
        assert_eq!((image.rgb, depth), (ids.map(|id| [f64::from(id); 3]).to_vec(), Depth::Double));
        save_values(&path, &["A", "B", "G", "R"], (1, 1), &[0.0, 3.0, 2.0, 1.0]).unwrap();
        assert_eq!(Image::load(&path).unwrap().rgb, [[1.0, 2.0, 3.0]]);
        assert!(Image::header(&path).unwrap().has_alpha);
    }

    #[test]
    fn equal_pictures_are_equal_files_though_several_threads_pack_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        // 12 blocks, of which the first takes longest.
        let image = Image::from_fn(1024, 768, |x, y| {
            let noise = (x * 7919 + y * 104_729) % 10_007;
            [if x + y < 256 { noise as f32 } else { 0.25 }; 3]
        });
        let saved = || {
            image.save(&path).unwrap();
            std::fs::read(&path).unwrap()
        };
        let first = saved();
        assert!((0..8).all(|_| saved() == first));
    }

    #[test]
    fn the_file_says_that_its_values_are_not_linear() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let check = || {
            let meta = exr::meta::MetaData::read_from_file(&path, true).unwrap();
            let attributes = &meta.headers[0].own_attributes;
            assert_eq!(attributes.comments.as_ref().unwrap().to_string(), COMMENT);
            assert_eq!(
                attributes.other.get(&x::Text::from(INTEROP)),
                Some(&x::AttributeValue::Text(x::Text::from(ENCODING)))
            );
        };
        Image { width: 1, height: 1, rgb: vec![[0.5; 3]] }.save(&path).unwrap();
        check();
        save_values(&path, &["R", "G", "B", "A"], (1, 1), Samples::Float(&[0.5; 4]), None).unwrap();
        check();
        assert_eq!(Image::header(&path).unwrap().encoding.as_deref(), Some(ENCODING));
    }
}
