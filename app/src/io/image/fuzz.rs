//! Loads randomly damaged pictures: each reader returns a picture or an error, in a bounded time.
//!
//! The case's number determines the case, so all runs are identical. In half of the cases, the checksums of PNG chunks
//! are repaired, and arrays are damaged both before and after they are put into an archive, so that the damage reaches
//! the decoders. `SPLATGRAPH_LONG=1` (`./x test --long`) runs more cases.

use super::{Image, split_member};
use crate::numbers::Random;
use std::fs;
use std::io::{Cursor, Write};
use std::time::{Duration, Instant};

/// Damaged files per format: in the long run, and in the default run.
const CASES: (u64, u64) = (100_000, 1_000);

const TIME_LIMIT: Duration = Duration::from_secs(30);

const NUMBERS: [u64; 12] = [
    0,
    1,
    127,
    255,
    65_535,
    65_536,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
];

fn damage(bytes: &mut Vec<u8>, words: &[&str], random: &mut Random) {
    for _ in 0..=random.below(3) {
        // In half of the cases, only the first bytes are damaged, because headers matter most.
        let reach = if random.below(2) == 0 { bytes.len().min(160) } else { bytes.len() };
        let at = random.below(reach);
        let left = bytes.len() - at;
        match random.below(8) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..at + random.below(left.min(40)))),
            2 if left > 0 => bytes[at] ^= 1 << random.below(8),
            3 if left > 0 => bytes[at] = random.next() as u8,
            4 => {
                let number = NUMBERS[random.below(NUMBERS.len())];
                let width = [1, 2, 4, 8][random.below(4)].min(left);
                let order = if random.below(2) == 0 { number.to_le_bytes() } else { number.to_be_bytes() };
                let digits =
                    if order == number.to_le_bytes() { &order[..width] } else { &order[8 - width..] };
                bytes[at..at + width].copy_from_slice(digits);
            }
            5 => {
                let from = random.below(bytes.len());
                let piece = bytes[from..(from + random.below(60)).min(bytes.len())].to_vec();
                drop(bytes.splice(at..at, piece));
            }
            _ => {
                let word = words[random.below(words.len())].bytes();
                let over = if random.below(2) == 0 { word.len().min(left) } else { 0 };
                drop(bytes.splice(at..at + over, word));
            }
        }
    }
}

/// Writes the correct checksum after every chunk that is still complete.
fn mend_sums(png: &mut [u8]) {
    let mut at = 8;
    while let Some(length) = png.get(at..at + 4) {
        let length = u32::from_be_bytes(length.try_into().expect("four bytes")) as usize;
        let Some(sum) = at.checked_add(8 + length).filter(|end| *end + 4 <= png.len()) else { return };
        let right = crc32fast::hash(&png[at + 4..sum]);
        png[sum..sum + 4].copy_from_slice(&right.to_be_bytes());
        at = sum + 4;
    }
}

fn png(color: ::png::ColorType, depth: ::png::BitDepth, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut out, 8, 4);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if color == ::png::ColorType::Indexed {
        encoder.set_palette(vec![0, 10, 20, 200, 100, 0, 255, 255, 255, 3, 2, 1]);
    }
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(bytes).expect("the pixels");
    writer.finish().expect("the end");
    out
}

/// Makes an array of a type, an order and a shape, with this many bytes after its header.
pub(super) fn npy(dtype: &str, order: &str, shape: &str, bytes: usize) -> Vec<u8> {
    let header = format!("{{'descr': '{dtype}', 'fortran_order': {order}, 'shape': {shape}, }}");
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    let padded = (header.len() + 11).next_multiple_of(64) - 10;
    out.extend((padded as u16).to_le_bytes());
    out.extend(format!("{header:<0$}\n", padded - 1).bytes());
    out.extend((0..bytes).map(|i| (i % 61) as u8));
    out
}

/// Makes an archive with one array, `b`.
pub(super) fn zipped(npy: &[u8], method: zip::CompressionMethod) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    archive.start_file("b.npy", options).expect("a member");
    archive.write_all(npy).expect("its bytes");
    archive.finish().expect("an archive").into_inner()
}

fn saved(name: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    let image = Image::from_fn(9, 5, |x, y| [x as f32 / 9.0, y as f32 / 5.0, 0.5]);
    image.save(&path).expect("it is saved");
    fs::read(path).expect("it is there")
}

/// Damages pictures of a format, and loads each from a file named `name`. `last` runs after the damage.
fn fuzz(name: &str, seeds: &[Vec<u8>], words: &[&str], last: impl Fn(&mut Vec<u8>, &mut Random)) {
    let cases = if std::env::var_os("SPLATGRAPH_LONG").is_some() { CASES.0 } else { CASES.1 };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    let file = split_member(&path).map_or(path.clone(), |(archive, _)| archive);
    let read = |bytes: &[u8]| {
        fs::write(&file, bytes).expect("written");
        let image = Image::load(&path);
        let size = Image::header(&path).map(|header| header.size);
        match (&image, &size) {
            (Ok(image), Ok(size)) => assert_eq!((image.width, image.height), *size),
            (Ok(_), Err(error)) => panic!("a picture without a size: {error}"),
            (Err(error), _) => assert!(!error.to_string().is_empty()),
        }
        image.inspect(|image| assert_eq!(image.rgb.len(), image.width * image.height)).is_ok()
    };
    for (index, seed) in seeds.iter().enumerate() {
        let mut whole = seed.clone();
        last(&mut whole, &mut Random(0));
        assert!(read(&whole), "seed {index} of {name} is no picture");
    }
    let (mut pictures, mut slowest) = (0, Duration::ZERO);
    for case in 0..cases {
        let mut random = Random(case);
        let mut bytes = seeds[random.below(seeds.len())].clone();
        damage(&mut bytes, words, &mut random);
        last(&mut bytes, &mut random);
        let begun = Instant::now();
        pictures += u64::from(read(&bytes));
        slowest = slowest.max(begun.elapsed());
        assert!(begun.elapsed() < TIME_LIMIT, "{name}: case {case} takes {:?}", begun.elapsed());
    }
    // Tests that pass do not show the output of `eprintln!`.
    let _ = writeln!(
        std::io::stderr(),
        "fuzz: {cases} of {name}: {pictures} are pictures, {} errors; the slowest took {slowest:?}",
        cases - pictures
    );
    assert!(pictures > 0 && pictures < cases, "{pictures} of {cases} damaged {name} are pictures");
}

#[test]
fn damaged_png_files_are_pictures_or_errors() {
    use ::png::BitDepth::{Eight, Four, One, Sixteen, Two};
    use ::png::ColorType::{Grayscale, GrayscaleAlpha, Indexed, Rgb, Rgba};
    let pixels: Vec<u8> = (0..8 * 4 * 8).map(|i| (i * 7 % 256) as u8).collect();
    let kinds = [(Rgb, Eight, 3), (Rgba, Sixteen, 8), (Grayscale, Sixteen, 2), (GrayscaleAlpha, Eight, 2)];
    let mut seeds: Vec<Vec<u8>> =
        kinds.into_iter().map(|(color, depth, bytes)| png(color, depth, &pixels[..32 * bytes])).collect();
    seeds.extend([png(Grayscale, One, &pixels[..4]), png(Grayscale, Four, &pixels[..16])]);
    seeds.extend([png(Indexed, Two, &pixels[..8]), saved("a.png")]);
    let words = ["IHDR", "PLTE", "IDAT", "IEND", "tRNS", "gAMA", "sBIT", "acTL", "fcTL", "zTXt", "iCCP"];
    fuzz("a.png", &seeds, &words, |bytes, random| {
        if random.below(2) == 0 {
            mend_sums(bytes);
        }
    });
}

fn arrays() -> Vec<Vec<u8>> {
    vec![
        saved("a.npy"),
        npy("<f4", "False", "(3, 4, 3)", 3 * 4 * 3 * 4),
        npy("<f8", "False", "(3, 4, 3)", 3 * 4 * 3 * 8),
        npy("|u1", "False", "(3, 4, 3)", 3 * 4 * 3),
    ]
}

const NUMPY: [&str; 16] = [
    "'descr'",
    "<f4",
    ">f4",
    "<f2",
    "<f8",
    "|u1",
    "|O",
    "<U9",
    "True",
    "False",
    "(",
    ")",
    ", 3",
    "65536",
    "-1",
    "99999999999999999999",
];

#[test]
fn damaged_npy_files_are_pictures_or_errors() {
    fuzz("a.npy", &arrays(), &NUMPY, |_, _| {});
}

#[test]
fn damaged_npz_archives_are_pictures_or_errors() {
    let methods = [zip::CompressionMethod::Stored, zip::CompressionMethod::Deflated];
    let words = ["PK\u{1}\u{2}", "PK\u{3}\u{4}", "PK\u{5}\u{6}", "b.npy", "../b.npy", "\u{1}\0", "\u{8}\0"];
    fuzz("a.npz#b", &arrays(), &NUMPY, |bytes, random| {
        *bytes = zipped(bytes, methods[random.below(2)]);
        if random.below(2) == 1 {
            damage(bytes, &words, random);
        }
    });
}

#[test]
fn damaged_exr_files_are_pictures_or_errors() {
    use ::exr::prelude::{
        Blocks, Compression, Encoding, Layer, LayerAttributes, LineOrder, SpecificChannels, Vec2,
        WritableImage, f16,
    };
    let folder = tempfile::tempdir().expect("a folder");
    let grey = folder.path().join("grey.exr");
    super::save_values(&grey, &["Z"], (9, 5), super::Samples::Float(&[0.5; 45]), Some("Z"))
        .expect("it is saved");
    let mut seeds = vec![saved("a.exr"), fs::read(grey).expect("it is there")];
    for compression in
        [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::PIZ, Compression::B44]
    {
        for tiled in [false, true] {
            let pixel = |at: Vec2<usize>| (at.x() as f32 / 40.0, at.y() as f32 / 20.0, f16::from_f32(0.25));
            let blocks = if tiled { Blocks::Tiles(Vec2(16, 16)) } else { Blocks::ScanLines };
            let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
            let layer =
                Layer::new((40, 20), LayerAttributes::default(), encoding, SpecificChannels::rgb(pixel));
            let mut out = Cursor::new(Vec::new());
            ::exr::image::Image::from_layer(layer).write().to_buffered(&mut out).expect("it is written");
            seeds.push(out.into_inner());
        }
    }
    let words =
        ["channels\0chlist\0", "dataWindow\0", "compression\0", "tiles\0", "lineOrder\0", "chunkCount\0"];
    fuzz("a.exr", &seeds, &words, |_, _| {});
}
