//! Recognises the format of a scene file by its first bytes, and describes files that are not scenes.

use crate::error::SceneError;
use crate::scene::{FileNotes, Filter, SortKey};
use crate::{gltf, ksplat, ply, rad, sog, splat, spz, usd};
use std::path::Path;

const MAGIC: &[(&[u8], &str)] = &[
    (b"\x89PNG", "a PNG image"),
    (b"\xFF\xD8\xFF", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"RIFF", "a RIFF file (WebP, WAV or AVI)"),
    (b"\x76\x2F\x31\x01", "an OpenEXR image"),
    (b"\x1F\x8B", "a gzip file (unpack it first)"),
    (b"\x28\xB5\x2F\xFD", "a Zstandard file (unpack it first)"),
    (b"BZh", "a bzip2 file (unpack it first)"),
    (b"\xFD7zXZ", "an xz file (unpack it first)"),
    (b"7z\xBC\xAF", "a 7-Zip archive (unpack it first)"),
    (b"\x7FELF", "an ELF executable"),
    (b"%PDF", "a PDF document"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"version https://git-lfs", "a Git LFS pointer, not the file itself (run `git lfs pull`)"),
    (b"<!DOCTYPE", "an HTML page (a download that needed a login?)"),
    (b"<html", "an HTML page (a download that needed a login?)"),
    (b"{", "JSON text"),
    (b"[", "JSON text"),
    (b"\xEF\xBB\xBFply", "a PLY file behind a byte order mark (save it without one)"),
];

/// A format of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneFormat {
    /// PLY in the layout of the reference implementation.
    Ply,
    /// PLY in PlayCanvas's compressed layout.
    CompressedPly,
    /// Niantic's SPZ: versions 1 to 4 are read, 3 and 4 are written.
    Spz,
    /// antimatter15's `.splat`.
    Splat,
    /// PlayCanvas's SOG. Versions 1 and 2 are read, in one file or a folder, and so are levels of a streamed scene.
    /// Version 2 is written, in one file.
    Sog,
    /// Mark Kellogg's `.ksplat`; read, not written.
    Ksplat,
    /// Spark's `.rad` and `.radc`; read, not written.
    Rad,
    /// OpenUSD's `ParticleField3DGaussianSplat`: `.usda`, `.usdc` and `.usdz`; read, not written.
    Usd,
    /// Khronos's glTF with `KHR_gaussian_splatting`: `.glb` and `.gltf` are read, `.glb` is written.
    Gltf,
}

impl SceneFormat {
    /// The formats that [`Scene::write`](crate::Scene::write) writes.
    pub const WRITTEN: [Self; 6] =
        [Self::Ply, Self::CompressedPly, Self::Spz, Self::Splat, Self::Sog, Self::Gltf];

    /// All formats.
    pub const ALL: [Self; 9] = [
        Self::Ply,
        Self::CompressedPly,
        Self::Spz,
        Self::Splat,
        Self::Sog,
        Self::Ksplat,
        Self::Rad,
        Self::Usd,
        Self::Gltf,
    ];

    /// Returns the usual file extension, without the first dot.
    pub fn extension(self) -> &'static str {
        self.extensions()[0]
    }

    /// Lists the file extensions, without the first dot; the usual one comes first.
    pub fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Ply => &["ply"],
            Self::CompressedPly => &["compressed.ply"],
            Self::Spz => &["spz"],
            Self::Splat => &["splat"],
            Self::Sog => &["sog"],
            Self::Ksplat => &["ksplat"],
            Self::Rad => &["rad", "radc"],
            Self::Usd => &["usd", "usda", "usdc", "usdz"],
            Self::Gltf => &["glb", "gltf"],
        }
    }

    /// Describes the format in a few words.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Ply => "the layout of the 3DGS reference implementation, exact",
            Self::CompressedPly => "PlayCanvas's compressed PLY, 16 bytes per splat",
            Self::Spz => "Niantic's SPZ, versions 1 to 4, written as 4 or 3",
            Self::Splat => "antimatter15's .splat, 32 bytes per splat, without harmonics above degree 0",
            Self::Sog => {
                "PlayCanvas's SOG, version 2: 20 bytes per splat before packing, and a palette of harmonics"
            }
            Self::Ksplat => "Mark Kellogg's .ksplat, read-only",
            Self::Rad => "Spark's .rad, read-only",
            Self::Usd => "OpenUSD's ParticleField3DGaussianSplat, read-only",
            Self::Gltf => "glTF with KHR_gaussian_splatting, exact, sorted by distance",
        }
    }

    /// Finds the format by the longest matching extension of `path`, ignoring case; `None` if none matches.
    pub fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let all =
            Self::ALL.into_iter().flat_map(|format| format.extensions().iter().map(move |end| (format, end)));
        let matching = all.filter(|(_, end)| name.ends_with(&format!(".{end}")));
        matching.max_by_key(|(_, end)| end.len()).map(|(format, _)| format)
    }

    /// Returns the tags that a scene with the tags of `notes` has after it is written in this format and read back.
    pub fn kept_tags(self, notes: FileNotes) -> FileNotes {
        let none = FileNotes::default();
        match self {
            Self::Ply | Self::CompressedPly => {
                let up = notes.up.filter(|up| ply::axis(*up).is_some());
                FileNotes { low_pass: notes.low_pass, up, ..none }
            }
            // These formats have one flag for all filters.
            Self::Spz | Self::Sog if notes.is_antialiased() => {
                FileNotes { low_pass: Filter::Compensated, ..none }
            }
            Self::Gltf => FileNotes { key_of: SortKey::Distance, ..none },
            _ => none,
        }
    }

    /// Describes the losses of a scene with harmonics of `degree` in this format, one phrase per kind of value.
    pub fn losses(self, degree: u32) -> Vec<&'static str> {
        let mut losses = match self {
            Self::Ply | Self::Ksplat | Self::Rad | Self::Usd | Self::Gltf => vec![],
            Self::Sog => vec![
                "positions: 16 bits per axis, of the range of sign(v) ln(1 + |v|)",
                "rotations: 8 bits per component",
                "scales and colours: 256 values, opacities: 8 bits",
            ],
            Self::CompressedPly => vec![
                "positions and scales: 10 or 11 bits per axis, of the range in a chunk of 256 splats",
                "rotations: 10 bits per component",
                "colours and opacities: 8 bits",
            ],
            Self::Spz => vec![
                "positions: steps of 1/4096, or of more in a scene beyond 2048 units",
                "scales: steps of 1/16 of the logarithm, from e^-10 to e^5.94",
                "rotations: 9 bits and a sign per component",
                "colours and opacities: 8 bits, colours of -0.44 to 1.44",
            ],
            Self::Splat => vec!["rotations, colours and opacities: 8 bits, colours of 0 to 1 only"],
        };
        match self {
            Self::CompressedPly if degree > 0 => losses.push("harmonics: 8 bits of -4 to 4"),
            Self::Sog if degree > 0 => {
                losses.push("harmonics: a palette of at most 65,536 entries, of 256 values")
            }
            Self::Spz if degree > 0 => losses.push("harmonics of -1 to 1: 5 bits in band 1, 4 bits above"),
            Self::Splat if degree > 0 => losses.push("harmonics: cut to degree 0"),
            _ => {}
        }
        losses
    }
}

/// Recognises the format of a scene file of `length` bytes from its first bytes.
///
/// `head` has the first [`HEAD`](crate::input::HEAD) bytes, or the whole of a shorter file. Both layouts of PLY are
/// [`SceneFormat::Ply`] here: the header distinguishes them. The extension of `path`, if given, identifies `.gltf`,
/// `.ksplat` and `.splat` files that their bytes do not.
///
/// # Errors
/// The file is empty or not a scene.
pub(crate) fn format(path: Option<&Path>, head: &[u8], length: u64) -> Result<SceneFormat, SceneError> {
    if head.is_empty() {
        return Err(SceneError::Empty);
    }
    if head.starts_with(b"ply\n") || head.starts_with(b"ply\r\n") {
        return Ok(SceneFormat::Ply);
    }
    let extension = path
        .and_then(|p| p.extension())
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    if head.starts_with(spz::MAGIC) || spz::begins_as_spz(head) {
        return Ok(SceneFormat::Spz);
    }
    if head.starts_with(rad::MAGIC) || head.starts_with(rad::CHUNK_MAGIC) {
        return Ok(SceneFormat::Rad);
    }
    let is_layer = head.starts_with(usd::BINARY_MAGIC) || head.starts_with(usd::TEXT_MAGIC);
    if is_layer || usd::begins_as_package(head) {
        return Ok(SceneFormat::Usd);
    }
    // SOG comes before glTF: a SOG's JSON can have keys of glTF, too. Any other ZIP archive matches as well; SOG's
    // reader reports it.
    if head.starts_with(sog::MAGIC) || sog::begins_as_json(head) {
        return Ok(SceneFormat::Sog);
    }
    if head.starts_with(gltf::MAGIC) || extension == "gltf" || gltf::begins_as_json(head) {
        return Ok(SceneFormat::Gltf);
    }
    let magic = MAGIC.iter().find(|(magic, _)| head.starts_with(magic));
    let known = |(_, what): &(&[u8], &str)| Err(SceneError::NotScene { found: (*what).to_owned() });
    // Magic numbers of one or two bytes come last: a `.splat`, which has none, can begin with any bytes.
    if let Some(magic) = magic.filter(|(magic, _)| magic.len() > 2) {
        return known(magic);
    }
    if extension == "ksplat" || ksplat::is_plausible(head) {
        return Ok(SceneFormat::Ksplat);
    }
    // `.splat` has no magic number, so its name or its values identify it. Its reader reports any errors.
    let whole = length.is_multiple_of(splat::STRIDE as u64);
    if extension == "splat" || (whole && splat::is_plausible(head)) {
        return Ok(SceneFormat::Splat);
    }
    if let Some(magic) = magic {
        return known(magic);
    }
    Err(SceneError::NotScene { found: format!("the bytes {}", quoted(&head[..head.len().min(16)])) })
}

fn quoted(bytes: &[u8]) -> String {
    format!("\"{}\"", bytes.escape_ascii())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(name: &str, bytes: &[u8]) -> String {
        format(Some(Path::new(name)), bytes, bytes.len() as u64).unwrap_err().to_string()
    }

    #[test]
    fn well_known_files_are_named() {
        assert!(said("a.ply", b"\x89PNG\r\n\x1A\n").contains("a PNG image"));
        assert!(said("a.ply", b"\x1F\x8B\x08").contains("a gzip file"));
        assert!(said("a.ply", b"version https://git-lfs.github.com/spec/v1").contains("git lfs pull"));
    }

    #[test]
    fn a_file_name_names_the_format_of_its_longest_extension() {
        for format in SceneFormat::ALL {
            let name = format!("folder/A.{}", format.extension().to_uppercase());
            assert_eq!(SceneFormat::of_name(Path::new(&name)), Some(format), "{name}");
        }
        assert_eq!(SceneFormat::of_name(Path::new("ply")), None);
    }

    #[test]
    fn unknown_bytes_are_shown() {
        assert!(said("a.ply", b"hello\0").contains("\"hello\\x00\""));
    }
}
