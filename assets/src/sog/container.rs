//! Reads the files of a scene, in an archive or in a folder, and unpacks textures.

use super::meta::unexpected;
use crate::error::{SceneError, wrong};
use crate::input::{self, Source, SourceReader, beside, read_beside};
use image_webp::WebPDecoder;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use zip::ZipArchive;
use zip::result::ZipError;

pub(crate) const MAGIC: &[u8; 4] = b"PK\x03\x04";

pub(super) const MAX_META: u64 = 1 << 20;

/// Maximum number of padding rows: writers round a texture's height up to a multiple of 4.
const PADDING: u64 = 4;

/// Ends of the names that tell what another archive contains: scenes, a SOG in a folder, a PyTorch checkpoint.
const MEMBERS: [&str; 9] =
    ["meta.json", ".ply", ".spz", ".splat", ".ksplat", ".sog", ".rad", ".glb", "data.pkl"];

enum Place<'a> {
    /// A ZIP archive, and its length in bytes.
    Archive(ZipArchive<BufReader<SourceReader<'a>>>, u64),
    /// A `meta.json`, and the folder of the other files; `None` if the `meta.json` is not read from a file.
    Folder(&'a Source<'a>, Option<PathBuf>),
}

pub(super) struct Container<'a> {
    place: Place<'a>,
    /// Name and packed bytes of each file that was read.
    pub sizes: Vec<(String, u64)>,
}

/// A texture of 4 bytes per texel.
pub(super) struct Texture {
    pub width: u32,
    pub height: u32,
    pub texels: Vec<u8>,
}

impl<'a> Container<'a> {
    pub(super) fn open(source: &'a Source<'a>, folder: Option<&Path>) -> Result<Self, SceneError> {
        let place = if source.head(MAGIC.len())? == MAGIC {
            Place::Archive(input::archive(source)?, source.length())
        } else {
            Place::Folder(source, folder.map(Path::to_owned))
        };
        Ok(Self { place, sizes: Vec::new() })
    }

    pub(super) fn kind(&self) -> &'static str {
        match self.place {
            Place::Archive(..) => "",
            Place::Folder(..) => ", in a folder",
        }
    }

    pub(super) fn meta(&mut self) -> Result<Vec<u8>, SceneError> {
        match &self.place {
            Place::Archive(zip, _) => {
                if zip.index_for_name("meta.json").is_none() {
                    let known =
                        |name: &&str| MEMBERS.iter().any(|end| name.to_ascii_lowercase().ends_with(end));
                    let names: Vec<_> = zip.file_names().flatten().collect();
                    let member = names.iter().map(|name| &**name).find(known).map(|name| {
                        format!(" but with {}", name.chars().take(80).collect::<String>().escape_debug())
                    });
                    let member = member.unwrap_or_default();
                    let found = format!("a ZIP archive without a meta.json{member} (unpack it first)");
                    return Err(SceneError::NotScene { found });
                }
                self.read("meta.json", MAX_META)
            }
            Place::Folder(source, _) => {
                let length = source.length();
                if length > MAX_META {
                    let message = format!("expected at most {MAX_META} bytes, found {length}");
                    return Err(wrong("meta.json", message));
                }
                self.sizes.push(("meta.json".into(), length));
                Ok(source.head(length as usize)?)
            }
        }
    }

    fn read(&mut self, name: &str, most: u64) -> Result<Vec<u8>, SceneError> {
        let (bytes, packed) = match &mut self.place {
            Place::Archive(zip, _) => {
                let mut entry = zip.by_name(name).map_err(|error| match error {
                    ZipError::FileNotFound => wrong(name, "expected this file in the archive, found none"),
                    other => wrong(name, format!("expected a readable file of the archive, found: {other}")),
                })?;
                let packed = entry.compressed_size();
                let mut bytes = Vec::new();
                let read = (&mut entry).take(most + 1).read_to_end(&mut bytes);
                read.map_err(|error| wrong(name, format!("expected an intact file, found damage: {error}")))?;
                (bytes, packed)
            }
            Place::Folder(_, folder) => {
                let most = usize::try_from(most + 1).unwrap_or(usize::MAX);
                let bytes = read_beside(folder.as_deref(), name, |source, _| Ok(source.head(most)?))?;
                let length = bytes.len() as u64;
                (bytes, length)
            }
        };
        if bytes.len() as u64 > most {
            return Err(wrong(name, format!("expected at most {most} bytes, found more")));
        }
        self.sizes.push((name.to_owned(), packed));
        Ok(bytes)
    }

    /// Reads a texture with a texel for each of `count` splats.
    pub(super) fn texels(&mut self, name: &str, count: u64) -> Result<Texture, SceneError> {
        self.texture(name, count, |width, height| {
            let (texels, most) = (width * height, count + PADDING * width);
            let expected = || format!("expected {count} texels and at most {PADDING} rows more");
            (texels < count || texels > most).then(expected)
        })
    }

    /// Reads a texture of about `count` texels.
    ///
    /// `fault` gets the width and height before the texture is unpacked, and describes the expected ones; `None` if
    /// they are right.
    pub(super) fn texture(
        &mut self,
        name: &str,
        count: u64,
        fault: impl Fn(u64, u64) -> Option<String>,
    ) -> Result<Texture, SceneError> {
        // Limits with slack: ZIP hardly compresses WebP, and a WebP file is hardly longer than its texels.
        let most = match &self.place {
            Place::Archive(_, length) => 4 * length + MAX_META,
            Place::Folder(..) => 8 * count + MAX_META,
        };
        let bytes = self.read(name, most)?;
        let unreadable = |error| wrong(name, format!("expected a WebP texture, found: {error}"));
        let other = [(&b"\x89PNG"[..], "PNG"), (b"\xFF\xD8\xFF", "JPEG"), (b"RIFF", "WebP")];
        match other.iter().find(|(magic, _)| bytes.starts_with(magic)) {
            Some((_, "WebP")) => {}
            found => {
                let found = found.map_or("another format", |(_, name)| name);
                return Err(wrong(name, format!("expected a WebP texture, found {found}")));
            }
        }
        let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(unreadable)?;
        if decoder.is_lossy() {
            return Err(wrong(name, "expected lossless WebP, found lossy, which loses the low bits"));
        }
        let (width, height) = decoder.dimensions();
        if let Some(expected) = fault(width.into(), height.into()) {
            return Err(wrong(name, format!("{expected}, found {width} x {height}")));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut pixels = Vec::new();
        let length = width as usize * height as usize * channels;
        input::grow(&mut pixels, length)?;
        decoder.read_image(&mut pixels).map_err(unreadable)?;
        let texels = match channels {
            4 => pixels,
            _ => pixels.chunks_exact(3).flat_map(|rgb| [rgb[0], rgb[1], rgb[2], 255]).collect(),
        };
        Ok(Texture { width, height, texels })
    }

    /// Returns the length of the archive, or the total length of the files with these names.
    ///
    /// A file that cannot be read counts as 0; a later read reports the problem.
    pub(super) fn bytes_of<'n>(&self, names: impl Iterator<Item = &'n str>) -> u64 {
        match &self.place {
            Place::Archive(_, length) => *length,
            Place::Folder(_, folder) => names
                .filter_map(|name| beside(folder.as_deref(), name).ok())
                .filter_map(|path| std::fs::metadata(path).ok())
                .fold(0, |sum, file| sum.saturating_add(file.len())),
        }
    }

    /// Returns the packed bytes of the files that were read, and the bytes of the archive or of all files.
    ///
    /// Fails if the files claim more bytes than the archive has.
    pub(super) fn packed_bytes(&self) -> Result<(u64, u64), SceneError> {
        let sum = self.sizes.iter().fold(0u64, |sum, (_, bytes)| sum.saturating_add(*bytes));
        match self.place {
            Place::Archive(_, length) if sum > length => {
                Err(unexpected("files", &format!("at most the {length} bytes of the archive"), sum))
            }
            Place::Archive(_, length) => Ok((sum, length)),
            Place::Folder(..) => Ok((sum, sum)),
        }
    }
}
