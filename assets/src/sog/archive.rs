//! Reads the files of the archive, and unpacks textures into rows of one texel per splat.

use super::meta::wrong;
use crate::error::SceneError;
use crate::input::{Source, SourceReader};
use image_webp::WebPDecoder;
use std::io::{BufReader, Cursor, Read};
use zip::ZipArchive;
use zip::result::ZipError;

/// Maximum bytes of `meta.json`.
const MOST_META: u64 = 1 << 20;

/// Maximum number of padding rows: writers round a texture's height up to a multiple of 4.
const PADDING: u64 = 4;

/// An opened archive.
pub(super) struct Archive<'a> {
    zip: ZipArchive<BufReader<SourceReader<'a>>>,
    length: u64,
    /// Name and packed bytes of each file that was read.
    pub sizes: Vec<(String, u64)>,
}

/// A texture of 4 bytes per texel.
pub(super) struct Texture {
    pub width: u32,
    pub texels: Vec<u8>,
}

fn damaged(name: &str, message: String) -> SceneError {
    SceneError::Part { part: name.into(), message }
}

impl<'a> Archive<'a> {
    pub(super) fn open(source: &'a Source<'a>) -> Result<Self, SceneError> {
        let reader = BufReader::new(SourceReader::new(source, 0));
        let zip = ZipArchive::new(reader)
            .map_err(|error| damaged("zip", format!("expected a whole archive, found damage: {error}")))?;
        Ok(Self { zip, length: source.length(), sizes: Vec::new() })
    }

    /// Reads `meta.json`, which every scene must have.
    pub(super) fn meta(&mut self) -> Result<Vec<u8>, SceneError> {
        if self.zip.index_for_name("meta.json").is_none() {
            let found = "a ZIP archive without a meta.json (unpack it first)".into();
            return Err(SceneError::NotScene { found });
        }
        self.read("meta.json", MOST_META)
    }

    /// Reads a file of at most `most` bytes.
    fn read(&mut self, name: &str, most: u64) -> Result<Vec<u8>, SceneError> {
        let mut entry = self.zip.by_name(name).map_err(|error| match error {
            ZipError::FileNotFound => damaged(name, "expected this file in the archive, found none".into()),
            other => damaged(name, format!("expected a readable file of the archive, found: {other}")),
        })?;
        let packed = entry.compressed_size();
        let mut bytes = Vec::new();
        let read = (&mut entry).take(most + 1).read_to_end(&mut bytes);
        read.map_err(|error| damaged(name, format!("expected a whole file, found damage: {error}")))?;
        if bytes.len() as u64 > most {
            return Err(damaged(name, format!("expected at most {most} bytes, found more")));
        }
        self.sizes.push((name.to_owned(), packed));
        Ok(bytes)
    }

    /// Reads a texture with a texel for each of `count` splats.
    pub(super) fn texels(&mut self, name: &str, count: u64) -> Result<Texture, SceneError> {
        self.texture(name, |width, height| {
            let (texels, most) = (width * height, count + PADDING * width);
            let expected = || format!("expected {count} texels and at most {PADDING} rows more");
            (texels < count || texels > most).then(expected)
        })
    }

    /// Reads a texture; `fault` checks its width and height before it is unpacked.
    pub(super) fn texture(
        &mut self,
        name: &str,
        fault: impl Fn(u64, u64) -> Option<String>,
    ) -> Result<Texture, SceneError> {
        // A file can be only a little longer than its packed bytes in the archive: WebP packs better than ZIP.
        let bytes = self.read(name, 4 * self.length + MOST_META)?;
        let unreadable = |error| damaged(name, format!("expected a WebP texture, found: {error}"));
        let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(unreadable)?;
        if decoder.is_lossy() {
            return Err(damaged(
                name,
                "expected lossless WebP, found lossy, which loses the low bits".into(),
            ));
        }
        let (width, height) = decoder.dimensions();
        if let Some(expected) = fault(width.into(), height.into()) {
            return Err(damaged(name, format!("{expected}, found {width} x {height}")));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut pixels = Vec::new();
        let length = width as usize * height as usize * channels;
        pixels.try_reserve_exact(length).map_err(std::io::Error::from)?;
        pixels.resize(length, 0);
        decoder.read_image(&mut pixels).map_err(unreadable)?;
        let texels = match channels {
            4 => pixels,
            _ => pixels.chunks_exact(3).flat_map(|rgb| [rgb[0], rgb[1], rgb[2], 255]).collect(),
        };
        Ok(Texture { width, texels })
    }

    /// Sums the packed bytes of the files read; the archive must contain them.
    pub(super) fn packed_bytes(&self) -> Result<u64, SceneError> {
        let sum = self.sizes.iter().fold(0u64, |sum, (_, bytes)| sum.saturating_add(*bytes));
        if sum > self.length {
            return Err(wrong("files", &format!("at most the {} bytes of the archive", self.length), sum));
        }
        Ok(sum)
    }
}
