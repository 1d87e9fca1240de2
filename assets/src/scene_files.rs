//! Lists the files that a scene is read from: parts of a composition, textures of a folder, chunks and buffers.

use crate::composition;
use crate::error::SceneError;
use crate::file;
use crate::input::{HEAD, OpenFile, Source};
use crate::json;
use crate::words::word;
use crate::{gltf, rad};
use percent_encoding::percent_decode_str;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Maximum length of a JSON document that is searched for names, in bytes.
const MAX_JSON: u64 = 64 << 20;

/// Maximum length of a file's name in a document, in bytes. Longer texts are data.
const MAX_NAME: usize = 4096;

/// Maximum nesting of documents: a composition, a streamed SOG, and one of its folders.
const MAX_DEPTH: u32 = 3;

/// Finds the file that stands for a folder; `None` for a file or another folder. It is the JSON document of a SOG
/// scene, or the last scene of a training by the reference implementation.
pub(crate) fn document(path: &Path) -> Option<PathBuf> {
    let names = ["lod-meta.json", "meta.json"].iter().filter(|_| path.is_dir());
    names.map(|name| path.join(name)).find(|document| document.is_file()).or_else(|| {
        let iterations = path.join("point_cloud").read_dir().ok()?.flatten();
        let scenes = iterations.filter_map(|entry| {
            let number: u64 = entry.file_name().to_str()?.strip_prefix("iteration_")?.parse().ok()?;
            Some((number, entry.path().join("point_cloud.ply")))
        });
        scenes.filter(|(_, scene)| scene.is_file()).max().map(|(_, scene)| scene)
    })
}

/// Lists the existing files of a scene: `path`, or a folder's document, and the files that documents name.
///
/// Nothing is decoded, so that the files are known before the scene is loaded. Every text of a JSON document counts as
/// a name, so the list may have files that the scene does not use. Unreadable documents name no files.
pub fn scene_files(path: &Path) -> BTreeSet<PathBuf> {
    let mut files = BTreeSet::new();
    add(path.to_owned(), MAX_DEPTH, &mut files);
    files
}

/// Returns true if a file is a composition; false if it cannot be read.
pub fn names_scenes(path: &Path) -> bool {
    let head = || OpenFile::open(path).and_then(|file| Source::File(&file).head(HEAD));
    head().is_ok_and(|head| composition::begins_as_scenes(&head))
}

/// Lists the paths that decide what a scene contains, whether they exist or not. They are [`scene_files`], `path`
/// itself, and the files that a list of scenes names.
pub fn scene_paths(path: &Path) -> BTreeSet<PathBuf> {
    let mut paths = scene_files(path);
    if names_scenes(path) {
        paths.extend(named(path).unwrap_or_default());
    }
    paths.insert(path.to_owned());
    paths
}

fn add(path: PathBuf, depth: u32, files: &mut BTreeSet<PathBuf>) {
    let path = document(&path).unwrap_or(path);
    if files.contains(&path) || !path.is_file() {
        return;
    }
    let named = if depth > 0 { named(&path).unwrap_or_default() } else { Vec::new() };
    files.insert(path);
    named.into_iter().for_each(|file| add(file, depth - 1, files));
}

fn named(path: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let file = OpenFile::open(path)?;
    let source = Source::File(&file);
    let head = source.head(HEAD)?;
    if composition::begins_as_scenes(&head) {
        let text = String::from_utf8_lossy(&source.head(composition::MAX_BYTES as usize)?).into_owned();
        return Ok(composition::parse(&text, folder)?.into_iter().map(|part| part.file).collect());
    }
    // Offset and length of the JSON text.
    let (start, length) = match head.as_slice() {
        head if head.starts_with(gltf::MAGIC) && head.len() > 20 => (20, u64::from(word(head, 12))),
        head if head.starts_with(rad::MAGIC) && head.len() > 8 => (8, u64::from(word(head, 4))),
        head if head.trim_ascii_start().starts_with(b"{") => (0, source.length()),
        _ => return Ok(Vec::new()),
    };
    // A document beyond these limits is not read as a scene either.
    let text = json::read(&source, (start, length), MAX_JSON, json::STREAMED_OBJECT)?;
    let names = json::strings(&text, MAX_NAME);
    // The names of glTF are URIs.
    let uris = names.iter().map(|name| percent_decode_str(name).decode_utf8_lossy().into_owned());
    let all: BTreeSet<String> = uris.chain(names.iter().cloned()).collect();
    Ok(all
        .iter()
        .filter(|name| !name.is_empty())
        .filter_map(|name| file::beside(Some(folder), name))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn the_files_of_a_scene_are_those_that_its_documents_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let write = |name: &str, bytes: &[u8]| {
            fs::create_dir_all(at(name).parent().unwrap()).unwrap();
            fs::write(at(name), bytes).unwrap();
        };
        let binary = |magic: &[u8], rest: &[u8], text: &str| {
            let length = (text.len() as u32).to_le_bytes();
            [magic, rest, &length, if rest.is_empty() { b"" } else { b"JSON" }, text.as_bytes(), b"\0\0"]
                .concat()
        };
        write("a.ply", b"ply\n");
        write("unnamed.ply", b"ply\n");
        write(
            "lod/lod-meta.json",
            br#"{"lodLevels": 1, "filenames": ["0/meta.json"], "environment": "gone/meta.json"}"#,
        );
        write(
            "lod/0/meta.json",
            br#"{"version": 2, "means": {"files": ["means_l.webp"]}, "outside": "../../a.ply"}"#,
        );
        write("lod/0/means_l.webp", b"RIFF");
        write("lod/0/other.webp", b"RIFF");
        write("b.gltf", br#" {"buffers": [{"uri": "my%20buf.bin"}, {"uri": "data:;base64,AAAA"}]}"#);
        write("my buf.bin", b"0123");
        write("c.glb", &binary(b"glTF", &[0; 8], r#"{"images": [{"uri": "c.png"}]}"#));
        write("c.png", b"\x89PNG");
        write("d.rad", &binary(b"RAD0", b"", r#"{"chunks": [{"filename": "d-0.radc"}]}"#));
        write("d-0.radc", b"RADC");
        let list = ["a.ply", "lod", "b.gltf", "c.glb", "d.rad", "list.ron", "gone.ply"];
        let list = list.map(|file| format!("Scene(file: {file:?}),")).concat();
        write("list.ron", format!("Scenes([{list}])").as_bytes());
        let found = |name: &str| -> Vec<String> {
            let name_of = |file: &PathBuf| file.strip_prefix(folder.path()).unwrap().display().to_string();
            scene_files(&at(name)).iter().map(name_of).collect()
        };
        assert_eq!(found("a.ply"), ["a.ply"]);
        assert_eq!(found("gone.ply"), [""; 0]);
        assert_eq!(found("."), [""; 0]);
        for file in
            ["iteration_7000/point_cloud.ply", "iteration_30000/point_cloud.ply", "iteration_40000/other"]
        {
            write(&format!("point_cloud/{file}"), b"ply\n");
        }
        assert_eq!(found("."), ["point_cloud/iteration_30000/point_cloud.ply"]);
        let others: Vec<PathBuf> =
            scene_paths(&at("list.ron")).difference(&scene_files(&at("list.ron"))).cloned().collect();
        assert_eq!(others, [at("gone.ply"), at("lod")]);
        assert!(scene_paths(&at("gone.ply")).contains(&at("gone.ply")));
        assert_eq!(found("lod"), ["lod/0/means_l.webp", "lod/0/meta.json", "lod/lod-meta.json"]);
        assert_eq!(
            found("list.ron"),
            [
                "a.ply",
                "b.gltf",
                "c.glb",
                "c.png",
                "d-0.radc",
                "d.rad",
                "list.ron",
                "lod/0/means_l.webp",
                "lod/0/meta.json",
                "lod/lod-meta.json",
                "my buf.bin",
            ]
        );
    }
}
