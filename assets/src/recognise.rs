//! Identifies files that are not PLY files, for error messages.
//!
//! Users pass the wrong file, a compressed one, or a Git LFS pointer. The first bytes usually identify it, and "this is a gzip
//! file" helps more than "bad magic".

use crate::error::SceneError;
use std::path::Path;

const CONVERT: &str = "convert it to a plain .ply, for instance with SuperSplat or with splat-transform";

/// Leading bytes of well-known files, with a description.
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
    (b"PK\x03\x04", "a ZIP archive (unpack it first)"),
    (b"glTF", "a binary glTF model"),
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

/// Makes the error for a file whose first `bytes` do not begin as a PLY file. `path` is the file's path, if there is one, and
/// `length` its length in bytes.
pub(crate) fn not_ply(path: Option<&Path>, bytes: &[u8], length: u64) -> SceneError {
    let extension = path
        .and_then(|p| p.extension())
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    let gzip = bytes.starts_with(b"\x1F\x8B");
    let unsupported = |format| SceneError::Unsupported { format, advice: CONVERT };
    // SPZ is gzip around a header "NGSP"; without unpacking, the name is what tells it from any other gzip file.
    if bytes.starts_with(b"NGSP") || (gzip && extension == "spz") {
        return unsupported("a Niantic .spz scene");
    }
    match extension.as_str() {
        "sog" if bytes.starts_with(b"PK\x03\x04") => return unsupported("a PlayCanvas .sog scene"),
        "ksplat" => return unsupported("a .ksplat scene"),
        // 32 bytes per splat and no header: only the name and the size can say it.
        "splat" if length.is_multiple_of(32) => return unsupported("an antimatter15 .splat scene"),
        _ => {}
    }
    let found = match MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        Some((_, what)) => (*what).to_owned(),
        None => format!("the bytes {}", quoted(&bytes[..bytes.len().min(16)])),
    };
    SceneError::NotPly { found }
}

/// Makes the error for a PLY file with packed vertices.
pub(crate) fn compressed_ply() -> SceneError {
    SceneError::Unsupported { format: "a PlayCanvas compressed PLY scene", advice: CONVERT }
}

/// Quotes bytes and escapes those that are not printable.
fn quoted(bytes: &[u8]) -> String {
    format!("\"{}\"", bytes.escape_ascii())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(name: &str, bytes: &[u8]) -> String {
        not_ply(Some(Path::new(name)), bytes, bytes.len() as u64).to_string()
    }

    #[test]
    fn well_known_files_are_named() {
        assert!(said("a.ply", b"\x89PNG\r\n\x1A\n").contains("a PNG image"));
        assert!(said("a.ply", b"\x1F\x8B\x08").contains("a gzip file"));
        assert!(said("a.ply", b"version https://git-lfs.github.com/spec/v1").contains("git lfs pull"));
    }

    #[test]
    fn splat_formats_are_refused_by_name_with_what_to_do() {
        for (name, bytes, word) in [
            ("a.spz", &b"\x1F\x8B\x08"[..], ".spz"),
            ("a.bin", b"NGSP\x02\0\0\0", ".spz"),
            ("a.splat", &[7u8; 64], ".splat"),
            ("a.sog", b"PK\x03\x04", ".sog"),
        ] {
            let said = said(name, bytes);
            assert!(
                said.contains(word) && said.contains("unsupported format") && said.contains("convert"),
                "{said}"
            );
        }
    }

    #[test]
    fn unknown_bytes_are_shown() {
        assert!(said("a.ply", b"hello\0").contains("\"hello\\x00\""));
    }
}
