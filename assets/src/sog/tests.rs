//! Tests of SOG files built texel by texel.

use super::{header, parse as read};
use crate::error::SceneError;
use crate::input::{Input, Source};
use crate::scene::Scene;
use image_webp::{ColorType, WebPEncoder};
use serde_json::{Value, json};
use std::io::{Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

fn parse(bytes: &[u8]) -> Result<Scene, SceneError> {
    read(&Input { source: &Source::Bytes(bytes), memory: Some(1 << 30), progress: crate::QUIET })
}

fn webp(width: u32, height: u32, texels: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    WebPEncoder::new(&mut bytes).encode(texels, width, height, ColorType::Rgba8).unwrap();
    bytes
}

/// Builds a texture of 4 x 4 texels that begins with these.
fn small(texels: &[[u8; 4]]) -> Vec<u8> {
    let mut all = texels.concat();
    all.resize(64, 0);
    webp(4, 4, &all)
}

fn archive(meta: &Value, files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    zip.start_file("meta.json", options).unwrap();
    zip.write_all(meta.to_string().as_bytes()).unwrap();
    for (name, bytes) in files {
        zip.start_file(*name, options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// Builds the parts of a file with two splats of degree 1.
fn two() -> (Value, Vec<(&'static str, Vec<u8>)>) {
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

fn near(a: &[f32], b: &[f32]) {
    assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?} and {b:?}");
}

#[test]
fn texels_have_the_values_that_the_format_defines() {
    let (meta, files) = two();
    let bytes = archive(&meta, &files);
    let scene = parse(&bytes).unwrap();
    assert_eq!((scene.count(), scene.stored_degree(), scene.notes().is_antialiased()), (2, 1, true));
    assert_eq!(scene.size_breakdown().sum(), bytes.len() as u64);
    let [first, second] = [0, 1].map(|index| scene.splat(index));
    near(&first.position, &[1f32.exp() - 1.0, 1.0 - 2f32.exp(), 3f32.exp() - 1.0]);
    // 128 << 8 of 65,535 is a little above the middle.
    let n = -2.0 + 4.0 * 32_768.0 / 65_535.0;
    near(&second.position, &[1.0 - 1f32.exp(), (n as f32).exp_m1(), 0.0]);
    near(&first.scale, &[1.0, 1f32.exp(), (-1f32).exp()]);
    // Alpha 253: x is the largest. The others together are longer than 1, so x is 0, and w, y and z are normalised.
    let third = 1.0 / 3f32.sqrt();
    near(&first.rotation, &[third, 0.0, -third, third]);
    near(&second.rotation, &[1.0, 0.0, 0.0, 0.0]);
    near(&[first.opacity, second.opacity], &[0.2, 1.0]);
    near(&first.sh[..3], &[1.0, -1.0, 0.0]);
    near(&first.sh[3..12], &std::array::from_fn::<f32, 9, _>(|k| (k as f32 + 1.0) / 64.0));
    near(&second.sh[3..12], &[0.0; 9]);
    let source = Source::Bytes(&bytes);
    assert_eq!(header(&source).unwrap().count, 2);
}

#[test]
fn damage_names_the_file_and_the_field() {
    let with = |pointer: &str, value: Value| {
        let (mut meta, files) = two();
        *meta.pointer_mut(pointer).unwrap() = value;
        parse(&archive(&meta, &files)).unwrap_err().to_string()
    };
    assert!(with("/version", json!(3)).contains("`meta.json: version`: expected 2, found 3"));
    assert!(with("/version", json!(1)).contains("SOG scene of version 1"));
    assert!(with("/count", json!(0)).contains("`meta.json: count`: expected at least one splat"));
    assert!(
        with("/count", json!(17))
            .contains("`l.webp`: expected 17 texels and at most 4 rows more, found 4 x 4")
    );
    assert!(with("/count", json!(4_000_000_000u32)).contains("`meta.json: count`: expected at most"));
    assert!(
        with("/sh0/codebook", json!([1.0]))
            .contains("`meta.json: sh0.codebook`: expected 256 numbers, found 1")
    );
    assert!(with("/shN/bands", json!(4)).contains("`meta.json: shN.bands`: expected 1 to 3, found 4"));
    assert!(
        with("/shN/count", json!(200))
            .contains("`n.webp`: expected 192 x 4 texels for 200 entries, found 192 x 2")
    );
    assert!(with("/quats/files/0", json!("none")).contains("`none`: expected this file in the archive"));
    assert!(with("/means/mins", json!("a")).starts_with("line 1: meta.json: invalid type"));
    let (meta, mut files) = two();
    files[2].1 = b"RIFF".to_vec();
    let said = parse(&archive(&meta, &files)).unwrap_err().to_string();
    assert!(said.contains("`s.webp`: expected a WebP texture"), "{said}");
    let whole = archive(&meta, &two().1);
    for end in (4..whole.len()).step_by(7) {
        assert!(parse(&whole[..end]).is_err(), "{end}");
    }
}

#[test]
fn a_label_beyond_the_palette_drops_the_splat_and_an_archive_of_something_else_is_no_scene() {
    let (meta, mut files) = two();
    files[6].1 = small(&[[65, 0, 0, 255], [0, 0, 0, 255]]);
    let scene = parse(&archive(&meta, &files)).unwrap();
    assert_eq!((scene.count(), scene.dropped().color), (1, 1));
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("readme", SimpleFileOptions::default()).unwrap();
    let other = zip.finish().unwrap().into_inner();
    assert!(parse(&other).unwrap_err().to_string().contains("a ZIP archive without a meta.json"));
}

#[test]
fn a_texture_of_one_colour_and_huge_size_is_refused_before_it_is_unpacked() {
    let (mut meta, mut files) = two();
    meta["count"] = json!(1);
    // It packs to a few bytes: only the picture's size reveals it.
    files[0].1 = webp(2048, 2048, &vec![0; 2048 * 2048 * 4]);
    let bytes = archive(&meta, &files);
    assert!(bytes.len() < 20_000);
    let said = parse(&bytes).unwrap_err().to_string();
    assert!(
        said.contains("`l.webp`: expected 1 texels and at most 4 rows more, found 2048 x 2048"),
        "{said}"
    );
}
