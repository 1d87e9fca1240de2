//! Tests of SOG files built texel by texel.

#[path = "../../tests/files/sog.rs"]
mod sog_file;

use super::header;
use crate::error::{LoadError, SceneError};
use crate::input::{ReadOptions, SceneHeader, Source};
use crate::scene::Scene;
use crate::testing::{parse, says};
use serde_json::{Value, json};
use sog_file::{folder, small, two, version_1, webp, zipped};
use std::path::Path;
use zip::CompressionMethod;

fn load_at(path: &Path, level: Option<u32>) -> Result<Scene, LoadError> {
    Scene::load_with(path, ReadOptions { level, ..ReadOptions::default() }, crate::QUIET)
}

fn archive(meta: &Value, files: &[(&'static str, Vec<u8>)]) -> Vec<u8> {
    sog_file::archive(&(meta.clone(), files.to_vec()), CompressionMethod::Stored)
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
    assert_eq!(header(&source, None, None).unwrap().count, 2);
}

#[test]
fn a_surveyed_scene_keeps_the_precision_of_the_file_and_a_band_without_values_stays_empty() {
    let splat = |index: usize| {
        let mut splat = crate::testing::splat(index);
        splat.sh[27..].fill(0.0);
        splat.sh[12] = (index as f32 * 0.37).sin();
        splat
    };
    let surveyed = Scene::generate(3000, 3, splat).with_offset([500_000.0, 0.0, 4_000_000.0]);
    let mut bytes = Vec::new();
    super::write(&surveyed, crate::QUIET, &mut bytes).unwrap();
    let back = parse(&bytes).unwrap();
    assert_eq!(back.offset(), [499_712.0, 0.0, 3_999_744.0]);
    assert_eq!((back.stored_degree(), back.effective_degree()), (3, 2));
    for (at, index) in surveyed.morton_order().into_iter().enumerate() {
        let (a, b) = (back.world_position(at), surveyed.world_position(index as usize));
        assert!((0..3).all(|axis| (a[axis] - b[axis]).abs() < 5e-5), "{a:?} and {b:?}");
    }
}

#[test]
fn equal_splats_are_read_although_they_take_almost_no_bytes() {
    let (mut meta, mut files) = two();
    let count = 1 << 20;
    meta["count"] = json!(count);
    for (name, texels) in files.iter_mut().filter(|(name, _)| *name != "n.webp") {
        let texel = if *name == "c.webp" { [160, 96, 128, 51] } else { [0, 0, 0, 255] };
        *texels = webp(1024, 1024, &texel.repeat(count));
    }
    let bytes = archive(&meta, &files);
    assert!(bytes.len() < count / 51, "{}", bytes.len());
    assert_eq!(parse(&bytes).unwrap().count(), count as u32);
}

#[test]
fn damage_names_the_file_and_the_field() {
    let (meta, mut files) = two();
    files[2].1 = b"\x89PNG\r\n\x1A\n".to_vec();
    says(parse(&archive(&meta, &files)).unwrap_err(), "`s.webp`: expected a WebP texture, found PNG");
    let with = |pointer: &str, value: Value| {
        let (mut meta, files) = two();
        *meta.pointer_mut(pointer).unwrap() = value;
        parse(&archive(&meta, &files)).unwrap_err().to_string()
    };
    let cases = [
        ("/version", json!(3), "`meta.json: version`: expected 1 or 2, found 3"),
        ("/version", json!(1), "meta.json: missing field `shape`"),
        ("/count", json!(0), "`meta.json: count`: expected at least one splat"),
        ("/count", json!(17), "`l.webp`: expected 17 texels and at most 4 rows more, found 4 x 4"),
        ("/count", json!(4_000_000_000u32), "`meta.json: count`: expected at most"),
        ("/sh0/codebook", json!([1.0]), "`meta.json: sh0.codebook`: expected 256 numbers, found 1"),
        ("/shN/bands", json!(4), "`meta.json: shN.bands`: expected 1 to 3, found 4"),
        ("/shN/count", json!(200), "`n.webp`: expected 192 x 4 texels for 200 entries, found 192 x 2"),
        ("/quats/files/0", json!("none"), "`none`: expected this file in the archive"),
        ("/means/mins", json!("a"), "line 1: meta.json: invalid type"),
    ];
    for (pointer, value, expected) in cases {
        let found = with(pointer, value);
        assert!(found.contains(expected), "{found}; expected {expected}");
    }
    let (meta, mut files) = two();
    files[2].1 = b"RIFF".to_vec();
    says(parse(&archive(&meta, &files)).unwrap_err(), "`s.webp`: expected a WebP texture");
}

#[test]
fn a_label_beyond_the_palette_drops_the_splat_and_an_archive_of_something_else_is_no_scene() {
    let (meta, mut files) = two();
    files[6].1 = small(&[[65, 0, 0, 255], [0, 0, 0, 255]]);
    let scene = parse(&archive(&meta, &files)).unwrap();
    assert_eq!((scene.count(), scene.dropped().color), (1, 1));
    let other = zipped([("readme", &b""[..])], CompressionMethod::Stored);
    says(parse(&other).unwrap_err(), "a ZIP archive without a meta.json (unpack it first)");
    let other = zipped([("readme", &b""[..]), ("a/Scene.PLY", &b""[..])], CompressionMethod::Stored);
    says(
        parse(&other).unwrap_err(),
        "a ZIP archive without a meta.json but with a/Scene.PLY (unpack it first)",
    );
    let (meta, files) = two();
    let whole = archive(&meta, &files);
    says(
        parse(&whole[..whole.len() / 2]).unwrap_err(),
        "`zip`: the file is truncated: expected the archive's directory",
    );
    says(parse(&whole[..whole.len() - 1]).unwrap_err(), "`zip`: the file is truncated: expected");
}

#[test]
fn a_texture_of_one_colour_and_huge_size_is_refused_before_it_is_unpacked() {
    let (mut meta, mut files) = two();
    meta["count"] = json!(1);
    // It compresses to a few bytes, so only its width and height reveal it.
    files[0].1 = webp(2048, 2048, &vec![0; 2048 * 2048 * 4]);
    let bytes = archive(&meta, &files);
    assert!(bytes.len() < 20_000);
    says(
        parse(&bytes).unwrap_err(),
        "`l.webp`: expected 1 texels and at most 4 rows more, found 2048 x 2048",
    );
}

#[test]
fn version_1_has_values_between_the_ends_of_ranges() {
    let (meta, files) = version_1();
    let bytes = archive(&meta, &files);
    let scene = parse(&bytes).unwrap();
    assert_eq!(scene.size_breakdown().format, "sog, version 1");
    assert_eq!((scene.count(), scene.stored_degree(), scene.notes().is_antialiased()), (2, 2, false));
    let first = scene.splat(0);
    // The same positions and rotations as in version 2.
    near(&first.position, &[1f32.exp() - 1.0, 1.0 - 2f32.exp(), 3f32.exp() - 1.0]);
    let part = |byte: u8| f32::from(byte) / 255.0;
    let logarithms = [-4.0 + 8.0 * part(128), -2.0 + 4.0 * part(144), part(112)];
    near(&first.scale.map(f32::ln), &logarithms);
    near(&first.sh[..3], &[-1.0 + 2.0 * part(160), -2.0 + 4.0 * part(96), 0.5 * part(128)]);
    // The logit of alpha 51 is -6 + 10.2 / 5.
    near(&[first.opacity], &[1.0 / (1.0 + 3.96f32.exp())]);
    near(&first.sh[3..7], &[-1.0, 1.0, 1.55, 0.0]);
    let source = Source::Bytes(&bytes);
    let header = header(&source, None, None).unwrap();
    assert_eq!((header.count, header.stored_degree), (2, 2));

    let with = |pointer: &str, value: Value| {
        let (mut meta, files) = version_1();
        *meta.pointer_mut(pointer).unwrap() = value;
        parse(&archive(&meta, &files)).unwrap_err().to_string()
    };
    says(with("/means/shape", json!([])), "`meta.json: count`: expected at least one splat");
    says(with("/means/shape/0", json!(5_000_000_000u64)), "`meta.json: means.shape`: expected at most");
    assert!(with("/sh0/mins", json!([1, 2, 3])).starts_with("line 1: meta.json: "));
    says(
        with("/shN/files/0", json!("l.webp")),
        "`l.webp`: expected 192, 512 or 960 x at most 1024 texels, found 4 x 4",
    );
}

#[test]
fn a_folder_has_the_splats_of_the_archive_and_only_its_own_files() {
    let place = tempfile::tempdir().unwrap();
    for parts in [two(), version_1()] {
        folder(place.path(), &parts);
        let packed = parse(&archive(&parts.0, &parts.1)).unwrap();
        for path in [place.path().to_owned(), place.path().join("meta.json")] {
            let scene = Scene::load(&path, crate::QUIET).unwrap();
            assert_eq!(scene.identity(), packed.identity());
            let breakdown = scene.size_breakdown();
            assert!(breakdown.format.ends_with(", in a folder"), "{}", breakdown.format);
            let bytes = |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().metadata().unwrap().len();
            let all: u64 = std::fs::read_dir(place.path()).unwrap().map(bytes).sum();
            assert_eq!((breakdown.sum(), breakdown.file_bytes), (all, all));
            let header = SceneHeader::load(&path).unwrap();
            assert_eq!((header.count, header.stored_degree), (2, scene.stored_degree()));
        }
    }
    let (mut meta, files) = two();
    for (name, said) in [
        ("../q.webp", "`../q.webp`: expected a file in the folder of the JSON"),
        ("/etc/passwd", "`/etc/passwd`: expected a file in the folder of the JSON"),
        ("none.webp", "`none.webp`: expected a readable file beside this one"),
        ("meta.json", "`meta.json`: expected a WebP texture"),
    ] {
        meta["quats"]["files"][0] = json!(name);
        folder(place.path(), &(meta.clone(), files.clone()));
        says(Scene::load(place.path(), crate::QUIET).unwrap_err(), said);
    }
    // A document without a folder has no textures.
    says(parse(two().0.to_string().as_bytes()).unwrap_err(), "expected a file in the folder of the JSON");
}

/// Writes a streamed scene with two leaves. Each has a splat at level 0, and the first has one at level 1.
fn streamed(at: &Path) -> Value {
    folder(&at.join("0_0"), &two());
    folder(&at.join("1_0"), &version_1());
    let leaf = |lods: Value| json!({ "bound": { "min": [0, 0, 0], "max": [1, 1, 1] }, "lods": lods });
    let run = |file: u32, offset: u32| json!({ "file": file, "offset": offset, "count": 1 });
    let document = json!({
        "version": 1, "count": 3, "counts": [2, 1], "lodLevels": 2,
        "filenames": ["0_0/meta.json", "1_0/meta.json"],
        "tree": { "children": [leaf(json!({ "0": run(0, 0), "1": run(1, 1) })), leaf(json!({ "0": run(0, 1) }))] },
    });
    std::fs::write(at.join("lod-meta.json"), document.to_string()).unwrap();
    document
}

#[test]
fn a_level_of_a_streamed_scene_has_its_runs_and_the_environment() {
    let place = tempfile::tempdir().unwrap();
    let mut document = streamed(place.path());
    let load = |level: Option<u32>| load_at(place.path(), level);
    let [fine, coarse] = [two(), version_1()].map(|(meta, files)| parse(&archive(&meta, &files)).unwrap());
    let finest = load(None).unwrap();
    assert_eq!(finest.identity(), fine.identity());
    assert_eq!(finest.size_breakdown().format, "sog, streamed, level 0, the finest, of 2");
    assert_eq!(finest.size_breakdown().sum(), finest.size_breakdown().file_bytes);
    let level = load(Some(1)).unwrap();
    assert_eq!((level.count(), level.splat(0)), (1, coarse.splat(1)));
    says(
        load(Some(2)).unwrap_err(),
        "`lod-meta.json: lodLevels`: expected level 0, the finest, to 1, the coarsest, found 2",
    );
    let put =
        |document: &Value| std::fs::write(place.path().join("lod-meta.json"), document.to_string()).unwrap();
    document["environment"] = json!("0_0/meta.json");
    put(&document);
    let level = load(Some(1)).unwrap();
    assert_eq!((level.count(), level.stored_degree()), (3, 2));
    assert_eq!(level.splat(1).position, fine.splat(0).position);
    assert_eq!(level.size_breakdown().sum(), level.size_breakdown().file_bytes);
    let header = SceneHeader::load_level(place.path(), Some(1)).unwrap();
    assert_eq!((header.count, header.stored_degree), (3, 2));
    let one = load_at(&place.path().join("1_0"), Some(0)).unwrap_err();
    assert!(matches!(one.problem, SceneError::NoLevels), "{one}");
}

#[test]
fn in_a_list_a_level_is_that_of_the_scenes_with_levels() {
    let place = tempfile::tempdir().unwrap();
    streamed(place.path());
    Scene::generate(5, 0, crate::testing::splat).write_ply(place.path().join("a.ply")).unwrap();
    let list = place.path().join("list.ron");
    let load = |text: &str, level: u32| {
        std::fs::write(&list, text).unwrap();
        let header = SceneHeader::load_level(&list, Some(level)).map(|header| header.count);
        let scene = load_at(&list, Some(level)).map(|scene| scene.count());
        (header.map_err(|error| error.to_string()), scene.map_err(|error| error.to_string()))
    };
    let mixed = r#"Scenes([Scene(file: "a.ply"), Scene(file: "lod-meta.json")])"#;
    assert_eq!([load(mixed, 0), load(mixed, 1)], [(Ok(7), Ok(7)), (Ok(6), Ok(6))]);
    for (text, level, why) in [
        (r#"Scenes([Scene(file: "a.ply")])"#, 0, "expected a scene with levels"),
        (mixed, 2, "to 1, the coarsest, found 2"),
    ] {
        let (header, scene) = load(text, level);
        let errors = [header.unwrap_err(), scene.unwrap_err()];
        assert!(errors.iter().all(|error| error.contains(why)), "{errors:?}");
    }
    for (text, has_levels) in [
        (r#"Scenes([Scene(file: "a.ply"), Scene(file: "a.ply")])"#, false),
        (mixed, true),
        (r#"Scenes([Scene(file: "gone.ply")])"#, true),
    ] {
        std::fs::write(&list, text).unwrap();
        assert_eq!(SceneHeader::has_levels(&list), has_levels, "{text}");
    }
}

#[test]
fn damage_of_a_streamed_scene_names_the_field_or_the_file() {
    let place = tempfile::tempdir().unwrap();
    let document = streamed(place.path());
    let with = |pointer: &str, value: Value| {
        let mut document = document.clone();
        *document.pointer_mut(pointer).unwrap() = value;
        std::fs::write(place.path().join("lod-meta.json"), document.to_string()).unwrap();
        Scene::load(place.path(), crate::QUIET).unwrap_err().to_string()
    };
    says(with("/version", json!(2)), "`lod-meta.json: version`: expected 1, found 2");
    says(with("/lodLevels", json!(0)), "`lod-meta.json: lodLevels`: expected level 0");
    says(with("/tree/children/0/lods/0/file", json!(2)), "expected a number below 2, found 2");
    says(
        with("/tree/children/0/lods/0/count", json!(2)),
        "`lod-meta.json: tree.lods.offset`: expected runs that do not overlap in 0_0/meta.json",
    );
    says(
        with("/tree/children/1/lods/0/count", json!(4_000_000_000u32)),
        "`lod-meta.json: tree.lods`: expected runs within the 2 splats of 0_0/meta.json, found one that ends at 4000000001",
    );
    says(with("/tree/children", json!([])), "`lod-meta.json: tree`: expected a leaf with splats");
    says(with("/filenames/0", json!("../a")), "`../a`: expected a file in the folder of the JSON");
    says(with("/filenames/0", json!("none")), "`none`: expected a readable file beside this one, found");
    assert!(
        with("/tree", json!(7)).starts_with(&format!(
            "{}: line 1: lod-meta.json: ",
            place.path().join("lod-meta.json").display()
        ))
    );
}
