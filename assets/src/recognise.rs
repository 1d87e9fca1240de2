//! Recognises the format of a scene file by its first bytes, and describes files that are not scenes.

use crate::error::SceneError;
use crate::scene_format::SceneFormat;
use crate::{gltf, ksplat, rad, sog, splat, spz, usd};
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

/// Texts that begin with the first string and contain the second near their beginning. The third describes them.
const TEXTS: [(&str, &str, &str); 3] = [
    ("<", "SuperSplat", "a page of SuperSplat's viewer (export the splats as a scene)"),
    ("{", "\"geometricError\"", "a tileset of 3D Tiles (name one of its .glb files)"),
    ("{", "\"totalSplats\"", "LCC (which `splat-transform` can convert)"),
];

fn text(head: &[u8]) -> Option<&'static str> {
    let text = String::from_utf8_lossy(head);
    let is = |start: &str, key: &str| text.trim_start().starts_with(start) && text.contains(key);
    // A SOG's textures have `files`; gsplat's `meta.json` has only their shapes.
    if is("{", "\"means\"") && text.contains("\"quats\"") && !text.contains("\"files\"") {
        return Some("gsplat's PNG compression (export the splats as a scene)");
    }
    TEXTS.iter().find(|(start, key, _)| is(start, key)).map(|(.., what)| *what)
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
    if let Some(found) = text(head) {
        return Err(SceneError::NotScene { found: found.to_owned() });
    }
    // SOG comes before glTF: a SOG's JSON can have keys of glTF, too. Any other ZIP archive matches as well; SOG's
    // reader reports it.
    if head.starts_with(sog::MAGIC) || sog::begins_as_json(head) {
        return Ok(SceneFormat::Sog);
    }
    if extension == "gltf" || gltf::begins_as_gltf(head) {
        return Ok(SceneFormat::Gltf);
    }
    // JSON begins with the same brackets.
    if extension == "ron" {
        let found = "a .ron file that is no list `Scenes([...])`".to_owned();
        return Err(SceneError::NotScene { found });
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
    // The contents are not shown: a list of scenes can name any file, and its author may not be allowed to read it.
    Err(SceneError::NotScene { found: "a file of an unknown format".into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::says;

    fn said(name: &str, bytes: &[u8]) -> String {
        format(Some(Path::new(name)), bytes, bytes.len() as u64).unwrap_err().to_string()
    }

    #[test]
    fn well_known_files_are_named() {
        says(said("a.ply", b"\x89PNG\r\n\x1A\n"), "a PNG image");
        says(said("a.ply", b"\x1F\x8B\x08"), "a gzip file");
        says(said("a.html", b"<!DOCTYPE html>\n<title>SuperSplat Viewer"), "SuperSplat's viewer");
        says(said("a.html", b"<!DOCTYPE html>\n<title>Log in"), "a download that needed a login?");
        says(said("a.json", b"{\"asset\": {}, \"geometricError\": 1}"), "a tileset of 3D Tiles");
        says(said("a.ron", b"[Scene(file: \"a.ply\")]"), "found a .ron file that is no list `Scenes([...])`");
        says(said("a.lcc", b"{\"totalSplats\": 9}"), "LCC");
        says(
            said("meta.json", b"{\"means\": {\"shape\": [9, 3]}, \"quats\": {}}"),
            "gsplat's PNG compression",
        );
        says(said("a.ply", b"version https://git-lfs.github.com/spec/v1"), "git lfs pull");
    }

    #[test]
    fn unknown_bytes_are_not_shown() {
        let said = said("a.ply", b"root:*:20228:0:99");
        assert!(said.ends_with("found a file of an unknown format"), "{said}");
    }
}
