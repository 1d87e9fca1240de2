//! Builds SOG files texel by texel, for tests.

use image_webp::{ColorType, WebPEncoder};
use serde_json::{Value, json};
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A `meta.json`, and the names and bytes of its textures.
pub type Parts = (Value, Vec<(&'static str, Vec<u8>)>);

pub fn webp(width: u32, height: u32, texels: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    WebPEncoder::new(&mut bytes).encode(texels, width, height, ColorType::Rgba8).unwrap();
    bytes
}

/// Builds a texture of 4 x 4 texels that begins with `texels`.
pub fn small(texels: &[[u8; 4]]) -> Vec<u8> {
    let mut all = texels.concat();
    all.resize(64, 0);
    webp(4, 4, &all)
}

pub fn zipped<'a>(
    files: impl IntoIterator<Item = (&'a str, &'a [u8])>,
    method: CompressionMethod,
) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method);
    for (name, bytes) in files {
        zip.start_file(name, options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

pub fn archive((meta, files): &Parts, method: CompressionMethod) -> Vec<u8> {
    let meta = meta.to_string();
    let others = files.iter().map(|(name, bytes)| (*name, bytes.as_slice()));
    zipped([("meta.json", meta.as_bytes())].into_iter().chain(others), method)
}

/// Builds the parts of a file with two splats of degree 1.
pub fn two() -> Parts {
    let codebook = |step: f64| (0..256).map(|u| step * f64::from(u - 128)).collect::<Vec<_>>();
    let meta = json!({
        "version": 2, "count": 2, "model": "antialiased",
        "means": { "mins": [-1.0, -2.0, 0.0], "maxs": [1.0, 2.0, 3.0], "files": ["l.webp", "u.webp"] },
        "scales": { "codebook": codebook(0.0625), "files": ["s.webp"] },
        "quats": { "files": ["q.webp"] },
        "sh0": { "codebook": codebook(0.03125), "files": ["c.webp"] },
        "shN": { "count": 65, "bands": 1, "codebook": codebook(0.015625), "files": ["n.webp", "i.webp"] },
    });
    let mut palette = vec![128; 192 * 2 * 4];
    // Entry 64, the first in the second row.
    palette[192 * 4..][..12].copy_from_slice(&[129, 130, 131, 255, 132, 133, 134, 255, 135, 136, 137, 255]);
    let files = vec![
        ("l.webp", small(&[[255, 0, 255, 255], [0, 0, 0, 255]])),
        ("u.webp", small(&[[255, 0, 255, 255], [0, 128, 0, 255]])),
        ("s.webp", small(&[[128, 144, 112, 255], [128, 128, 128, 255]])),
        ("q.webp", small(&[[255, 0, 255, 253], [9, 9, 9, 0]])),
        ("c.webp", small(&[[160, 96, 128, 51], [128, 128, 128, 255]])),
        ("n.webp", webp(192, 2, &palette)),
        ("i.webp", small(&[[64, 0, 0, 255], [0, 0, 0, 255]])),
    ];
    (meta, files)
}

/// Builds the parts of a file of version 1 with two splats of degree 2.
pub fn version_1() -> Parts {
    let (meta, mut files) = two();
    let mut means = meta["means"].clone();
    means["shape"] = json!([2, 3]);
    let meta = json!({
        "means": means,
        "scales": { "shape": [2, 3], "mins": [-4.0, -2.0, 0.0], "maxs": [4.0, 2.0, 1.0], "files": ["s.webp"] },
        "quats": { "shape": [2, 4], "encoding": "quaternion_packed", "files": ["q.webp"] },
        "sh0": { "shape": [2, 1, 4], "mins": [-1.0, -2.0, 0.0, -6.0], "maxs": [1.0, 2.0, 0.5, 4.2], "files": ["c.webp"] },
        "shN": { "shape": [2, 8, 3], "mins": -1.0, "maxs": 1.55, "files": ["n.webp", "i.webp"] },
    });
    let mut palette = vec![100; 512 * 2 * 4];
    // Entry 64, the first in the second row.
    palette[512 * 4..][..4].copy_from_slice(&[0, 200, 255, 255]);
    files[5].1 = webp(512, 2, &palette);
    (meta, files)
}

/// Writes the parts of a file into a folder.
pub fn folder(at: &Path, (meta, files): &Parts) {
    std::fs::create_dir_all(at).unwrap();
    std::fs::write(at.join("meta.json"), meta.to_string()).unwrap();
    for (name, bytes) in files {
        std::fs::write(at.join(name), bytes).unwrap();
    }
}
