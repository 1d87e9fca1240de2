//! Fuzzes the readers with randomly damaged scene and camera files.

use crate::allocation::alone;
use crate::damage::{kind, run};
use crate::glb_file;
use crate::ksplat_file;
use crate::rad_file::{self, array};
use crate::sog_file::{archive, folder, two, version_1, zipped};
use crate::spz_file;
use flate2::{Compression, read::GzDecoder, write::GzEncoder};
use serde_json::json;
use splatgraph_assets::{Camera, CameraError, Dataset, Scene, SceneFormat, SpzVersion, synth};
use std::io::{Cursor, Read as _, Write as _};
use std::path::Path;
use zip::{CompressionMethod, ZipArchive};

/// Generates a scene from its generator's name and its number of splats, and writes it.
fn written(
    (generator, count): (&str, u32),
    write: impl Fn(&Scene, &mut Vec<u8>) -> std::io::Result<()>,
) -> Vec<u8> {
    let scene = synth::generate(generator, count, 0).expect("it is generated");
    let mut bytes = Vec::new();
    write(&scene, &mut bytes).expect("memory takes it");
    bytes
}

/// Builds small PLY files in all encodings, with the lengths of their headers.
fn scenes() -> Vec<(Vec<u8>, usize)> {
    let generated = [("uniform", 6), ("needles", 9), ("demo", 3)];
    let mut seeds: Vec<_> = generated.map(|of| written(of, |scene, out| scene.write_ply_to(out))).into();
    let names = "x y z scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 opacity f_dc_0 f_dc_1 f_dc_2";
    let face = |name: &str| format!("element {name} 2\nproperty list uchar int l\nproperty uchar flags\n");
    for (format, kind) in
        [("ascii", "float"), ("binary_big_endian", "double"), ("binary_little_endian", "uchar")]
    {
        let properties: String = names.split(' ').map(|name| format!("property {kind} {name}\n")).collect();
        let (before, after) = (face("before"), face("after"));
        let header = format!(
            "ply\nformat {format} 1.0\ncomment a\nelement nothing 3\n{before}element vertex 5\n{properties}{after}end_header\n"
        );
        let header = if format == "ascii" { header.replace("element nothing 3\n", "") } else { header };
        let mut bytes = header.into_bytes();
        let faces = |bytes: &mut Vec<u8>| match format {
            "ascii" => bytes.extend(b"2 7 7 1\n3 7 7 7 1\n"),
            _ => bytes.extend([2, 0, 0, 0, 7, 0, 0, 0, 7, 1, 0, 1]),
        };
        faces(&mut bytes);
        for row in 0..5 {
            for column in 0..14 {
                let value = if column == 6 { 1.0 } else { 0.125 * f64::from(row + column) };
                match kind {
                    "float" => bytes.extend(format!("{value} ").bytes()),
                    "double" => bytes.extend(value.to_be_bytes()),
                    _ => bytes.push((8.0 * value) as u8),
                }
            }
            if format == "ascii" {
                bytes.push(b'\n');
            }
        }
        faces(&mut bytes);
        seeds.push(bytes);
    }
    let header = |bytes: &[u8]| bytes.windows(11).position(|w| w == b"end_header\n").map_or(0, |at| at + 11);
    seeds.iter().map(|bytes| (bytes.clone(), header(bytes))).collect()
}

#[test]
fn damaged_scenes_are_read_or_refused() {
    // A buffer per thread, and the lists of a parallel loop.
    let memory = 4 << 20;
    run("scenes", &scenes(), memory, parse);
}

/// Builds files of small scenes in a format, and returns each with `head`, the length of its head.
fn packed_scenes(format: SceneFormat, head: usize) -> Vec<(Vec<u8>, usize)> {
    let write = |scene: &Scene, out: &mut Vec<u8>| scene.write(format, splatgraph_assets::QUIET, out);
    [("uniform", 6), ("needles", 300), ("demo", 3)].map(|of| (written(of, write), head)).into()
}

fn spz3_scenes() -> [Vec<u8>; 2] {
    [("uniform", 6), ("demo", 3)].map(|of| written(of, |scene, out| scene.write_spz(SpzVersion::V3, out)))
}

fn parse(bytes: &[u8]) -> Result<(), String> {
    match Scene::parse(bytes, splatgraph_assets::QUIET) {
        Ok(scene) => {
            assert_eq!(scene.size_breakdown().sum(), bytes.len() as u64);
            assert!(scene.count() > 0 && scene.positions().as_flattened().iter().all(|v| v.is_finite()));
            Ok(())
        }
        Err(error) => Err(kind(&error.to_string())),
    }
}

#[test]
fn damaged_scenes_of_every_format_are_read_or_refused() {
    let memory = 4 << 20;
    for (format, head) in [
        (SceneFormat::CompressedPly, 900),
        (SceneFormat::Splat, 64),
        (SceneFormat::Spz, 128),
        (SceneFormat::Gltf, 1500),
    ] {
        run(&format!("{format:?}"), &packed_scenes(format, head), memory, parse);
    }
    run("SPZ version 3", &spz3_scenes().map(|bytes| (bytes, 20)), memory, parse);
    run("SOG as written", &packed_scenes(SceneFormat::Sog, 200), SOG_MEMORY, parse);
}

#[test]
fn damaged_spz_inside_gltf_is_read_or_refused() {
    let seeds = spz3_scenes().map(|spz| {
        let bytes = glb_file::around_spz(&spz);
        let head = bytes.len() - spz.len() - 8;
        (bytes, head)
    });
    run("SPZ inside glTF", &seeds, 4 << 20, parse);
}

#[test]
fn damage_inside_an_spz_file_is_read_or_refused() {
    let inside = |bytes: &[u8]| {
        let mut unpacked = Vec::new();
        GzDecoder::new(bytes).read_to_end(&mut unpacked).expect("it is whole");
        unpacked
    };
    let mut seeds: Vec<_> = spz3_scenes().iter().map(|bytes| (inside(bytes), 16)).collect();
    // Records after the arrays: the axes, and an unknown one.
    seeds[0].0[14] = 2;
    seeds[0].0.extend([3, 0, 0xBE, 0xAD, 4, 0, 0, 0, 6, 0, 0, 0, 9, 9, 9, 9, 1, 0, 0, 0, 7]);
    run("SPZ, unpacked", &seeds, 4 << 20, |bytes| {
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(bytes).expect("memory takes it");
        parse(&packed.finish().expect("memory takes it"))
    });
}

#[test]
fn damaged_spz_files_of_version_4_are_read_or_refused() {
    // The bytes of an array are all different, so most streams have one uncompressed block.
    let file = |count: usize, degree: u8, coefficients: usize| {
        let array = |length: usize| (0..length * count).map(|at| (97 * at + 0x55) as u8).collect();
        spz_file::file(count as u32, (degree, 0), &[], &[9, 1, 3, 3, 4, 3 * coefficients].map(array))
    };
    let seeds = [(file(5, 0, 0), 112), (file(3, 3, 15), 128), (file(2, 4, 24), 128)];
    run("SPZ version 4", &seeds, 4 << 20, parse);
}

/// Bytes that the SOG reader may allocate in addition to 64 times the file's length. A palette with 3 bands and 65,536
/// entries decodes to 4 MB, even from a few compressed bytes.
const SOG_MEMORY: usize = 16 << 20;

fn unzipped(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).expect("it is whole");
    let count = zip.len();
    let file = |index| {
        let mut file = zip.by_index(index).expect("it is whole");
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).expect("it is whole");
        (file.name().expect("it is UTF-8").into_owned(), bytes)
    };
    (0..count).map(file).collect()
}

#[test]
fn damage_inside_a_sog_file_as_written_is_read_or_refused() {
    // The checksums of the archive are right, so that damage reaches the reader of each file.
    let (scene, _) = packed_scenes(SceneFormat::Sog, 0).pop().expect("there are three");
    let files = unzipped(&scene);
    for (damaged, (name, whole)) in files.iter().enumerate() {
        let head = if name == "meta.json" { whole.len() } else { 32 };
        run(&format!("{name} of SOG"), &[(whole.clone(), head)], SOG_MEMORY, |bytes| {
            let parts = files.iter().enumerate().map(|(index, (name, whole))| {
                (name.as_str(), if index == damaged { bytes } else { whole.as_slice() })
            });
            parse(&zipped(parts, CompressionMethod::Stored))
        });
    }
}

#[test]
fn damaged_ksplat_files_are_read_or_refused() {
    // Two times in five, the damage hits the fields of the file's header; otherwise, it is anywhere.
    let seeds = [0, 1, 2].map(|level| (ksplat_file::file(level, 1), 48));
    run("ksplat", &seeds, 4 << 20, parse);
}

/// Builds files that use all encodings, compressed or not, each with about the length of its texts as its head. They
/// are a `.rad` of one chunk, a `.rad` of two chunks with a palette of harmonics and a tree, and a `.radc`.
fn rad(compressed: bool) -> [(Vec<u8>, usize); 3] {
    let values = |count: usize| (0..count).map(|index| (index as f32 * 0.37).sin()).collect::<Vec<f32>>();
    let positive = |count: usize| values(count).iter().map(|value| 0.6 + 0.3 * value).collect::<Vec<f32>>();
    let of = |count: usize, [center, alpha, rgb, scales, turn]: [&'static str; 5]| {
        vec![
            array("center", (center, -1.0, 1.0), 3, &values(3 * count)),
            array("alpha", (alpha, 0.0, 1.0), 1, &positive(count)),
            array("rgb", (rgb, 0.0, 1.0), 3, &positive(3 * count)),
            array("scales", (scales, -12.0, 9.0), 3, &positive(3 * count)),
            array("orientation", (turn, 0.0, 0.0), 3, &positive(3 * count)),
        ]
    };
    let number = |name, encoding, values: &[f32]| array(name, (encoding, -1.0, 1.0), 1, values);
    let mut plain = of(20, ["f32_lebytes", "r8", "r8_delta", "ln_0r8", "oct88r8"]);
    for (name, encoding, width) in [("sh1", "s8", 9), ("sh2", "s8_delta", 15), ("sh3", "r8", 21)] {
        plain.push(array(name, (encoding, -1.0, 1.0), width, &values(width * 20)));
    }
    let mut first = of(3, ["f16_lebytes", "f16", "f16", "ln_f16", "f16"]);
    first.push(array("sh1_code", ("f16", 0.0, 0.0), 9, &values(18)));
    let mut second = of(2, ["f16", "f32", "r8", "f32", "f32"]);
    let trees = [(&mut first, [1.0, 0.0, 1.0], 3), (&mut second, [0.0; 3], 2)];
    for (arrays, labels, count) in trees {
        arrays.push(number("sh_label", "u16", &labels[..count]));
        arrays.push(number("child_count", "u16", &[2.0, 0.0, 2.0][3 - count..]));
        arrays.push(number("child_start", "u32", &[1.0, 0.0, 3.0][..count]));
    }
    let chunks = [
        rad_file::chunk(0, 20, &plain, compressed),
        rad_file::chunk(0, 3, &first, compressed),
        rad_file::chunk(3, 2, &second, compressed),
    ];
    let files = [
        rad_file::file(20, &chunks[..1], &[], None),
        rad_file::file(5, &chunks[1..], &[], Some(2)),
        chunks[0].clone(),
    ];
    files.map(|bytes| (bytes, 1600))
}

#[test]
fn damaged_rad_files_are_read_or_refused() {
    for compressed in [false, true] {
        let name = if compressed { "RAD" } else { "RAD, not compressed" };
        run(name, &rad(compressed), 4 << 20, parse);
    }
}

#[test]
fn damaged_usd_files_are_read_or_refused() {
    let file = |end: &str| {
        let name = format!("{}/tests/usd/splats.{end}", env!("CARGO_MANIFEST_DIR"));
        std::fs::read(name).expect("it is in the repository")
    };
    // The heads: the text's first prim; the binary file's header; reversed, its tokens, fields and paths, which come
    // after the values; the archive's header.
    let [text, binary, package] = ["usda", "usdc", "usdz"].map(file);
    run("USD, text", &[(text.clone(), 700)], 4 << 20, parse);
    run("USD, binary", &[(binary.clone(), 88)], 4 << 20, parse);
    run("USD, binary, sections", &[(reversed(&binary), 1500)], 4 << 20, |bytes| parse(&reversed(bytes)));
    run("USD, archive", &[(package, 128)], 4 << 20, parse);
}

/// Reverses the bytes: damage at the head of the result hits the end of the file.
fn reversed(bytes: &[u8]) -> Vec<u8> {
    bytes.iter().rev().copied().collect()
}

#[test]
fn damaged_sog_files_are_read_or_refused() {
    for (version, parts) in [(1, version_1()), (2, two())] {
        let methods = [CompressionMethod::Stored, CompressionMethod::Deflated];
        let seeds = methods.map(|method| (archive(&parts, method), 200));
        run(&format!("SOG version {version}"), &seeds, SOG_MEMORY, parse);
    }
}

/// Writes a file with an old modification time. A reader would wait until a new time is 20 ms old.
fn write_old(path: &Path, bytes: &[u8]) {
    let mut file = std::fs::File::create(path).unwrap();
    file.write_all(bytes).unwrap();
    file.set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
}

fn load(folder: &Path) -> Result<(), String> {
    match Scene::load(folder, splatgraph_assets::QUIET) {
        Ok(scene) => {
            assert!(scene.count() > 0 && scene.positions().as_flattened().iter().all(|v| v.is_finite()));
            assert_eq!(scene.size_breakdown().sum(), scene.size_breakdown().file_bytes);
            Ok(())
        }
        // Without the path, which differs from run to run.
        Err(error) => Err(kind(&error.problem.to_string())),
    }
}

#[test]
fn damaged_folders_of_sog_are_read_or_refused() {
    let place = tempfile::tempdir().unwrap();
    for (version, parts) in [(1, version_1()), (2, two())] {
        folder(place.path(), &parts);
        let meta = parts.0.to_string().into_bytes();
        run(&format!("meta.json of version {version}"), &[(meta.clone(), meta.len())], SOG_MEMORY, |bytes| {
            write_old(&place.path().join("meta.json"), bytes);
            load(place.path())
        });
    }
}

#[test]
fn damaged_streamed_sog_is_read_or_refused() {
    let place = tempfile::tempdir().unwrap();
    folder(&place.path().join("0_0"), &version_1());
    folder(&place.path().join("0_1"), &two());
    let leaf =
        |file: u32, offset: u32| json!({ "lods": { "0": { "file": file, "offset": offset, "count": 1 } } });
    let document = json!({
        "version": 1, "lodLevels": 1, "filenames": ["0_0/meta.json", "0_1/meta.json"],
        "environment": "0_0/meta.json",
        "tree": { "children": [{ "children": [leaf(0, 0), leaf(1, 1)] }, leaf(1, 0)] },
    });
    let text = document.to_string().into_bytes();
    run("lod-meta.json", &[(text.clone(), text.len())], SOG_MEMORY, |bytes| {
        write_old(&place.path().join("lod-meta.json"), bytes);
        load(place.path())
    });
}

#[test]
fn damaged_cameras_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    Camera::save(&synth::demo_cameras(), &path).unwrap();
    let pretty = std::fs::read(&path).unwrap();
    let one = br#"[{"id": 3, "img_name": "a\u0041\ud83d\ude00", "width": 4, "height": 2, "position": [1, 2, 3.5], "lens": {"x": [1, null]},
        "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 5.0, "fy": 6e0}]"#;
    let seeds = [pretty, one.to_vec()].map(|bytes| (bytes.clone(), bytes.len()));
    run("cameras", &seeds, 1 << 20, |bytes| {
        let Ok(text) = std::str::from_utf8(bytes) else { return Err("not UTF-8".into()) };
        sound(Dataset::parse(text, Path::new("c.json")))
    });
}

#[test]
fn damaged_cameras_of_gltf_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.gltf");
    let perspective = json!({ "yfov": 0.9, "aspectRatio": 1.5, "znear": 0.1 });
    let document = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0, 2] }],
        "nodes": [
            { "children": [1], "rotation": [0.0, 0.6, 0.0, 0.8], "translation": [1.0, 2.0, 3.5] },
            { "name": "a", "camera": 0, "scale": [2.0, 2.0, 1.0] },
            { "camera": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1] },
        ],
        "cameras": [{ "perspective": perspective }, { "orthographic": { "xmag": 4, "ymag": 2.5 } }],
    });
    let text = document.to_string().into_bytes();
    run("cameras of glTF", &[(text.clone(), text.len())], 1 << 20, |bytes| {
        write_old(&path, bytes);
        // Without the path, which differs from run to run.
        match Dataset::load(&path) {
            Err(CameraError::Invalid { message, .. }) => Err(kind(&message)),
            read => sound(read),
        }
    });
}

fn sound(read: Result<Dataset, CameraError>) -> Result<(), String> {
    let dataset = read.map_err(|error| kind(&error.to_string()))?;
    assert!(dataset.views.iter().all(|view| view.camera.fault().is_none()));
    assert!(dataset.test_views().len() <= dataset.views.len());
    Ok(())
}

#[test]
fn damaged_transforms_are_read_or_refused() {
    let frame = r#"{"file_path": "./a b.png", "transform_matrix": [[1,0,0,2],[0,1,0,0.5],[0,0,1,3],[0,0,0,1]], "fl_x": 6, "fl_y": 7}"#;
    let text = format!(
        r#"{{"camera_model": "OPENCV", "fl_x": 5.0, "w": 4, "h": 2.0, "cx": 2, "k1": 0, "frames": [{frame}, {frame}], "aabb_scale": 16, "camera_angle_x": 0.9, "test_filenames": ["a"]}}"#
    );
    run("transforms", &[(text.clone().into_bytes(), text.len())], 1 << 20, |bytes| {
        let Ok(text) = std::str::from_utf8(bytes) else { return Err("not UTF-8".into()) };
        sound(Dataset::parse(text, Path::new("nowhere/transforms.json")))
    });
}

/// Builds `cameras.bin` and `images.bin` of a COLMAP model with two images.
fn colmap_binary() -> [Vec<u8>; 2] {
    let mut lenses = 1u64.to_le_bytes().to_vec();
    lenses.extend([1u32, 1].map(u32::to_le_bytes).as_flattened());
    lenses.extend([8u64, 6].map(u64::to_le_bytes).as_flattened());
    lenses.extend([9.0, 9.0, 4.0, 3.0].map(f64::to_le_bytes).as_flattened());
    let mut images = 2u64.to_le_bytes().to_vec();
    for id in [1u32, 2] {
        images.extend(id.to_le_bytes());
        images.extend([1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0].map(f64::to_le_bytes).as_flattened());
        images.extend(1u32.to_le_bytes());
        images.extend(b"a.png\0");
        images.extend(3u64.to_le_bytes());
        images.extend([7; 72]);
    }
    [lenses, images]
}

#[test]
fn damaged_models_of_colmap_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = Dataset::colmap_text(&synth::demo_cameras(), "png").unwrap();
    let text = text.map(|(_, text)| text.into_bytes());
    let [text_lenses, text_images, _] = text;
    let [lenses, images] = colmap_binary();
    for (form, whole) in [("txt", [text_lenses, text_images]), ("bin", [lenses, images])] {
        for damaged in [0, 1] {
            let below = folder.path().join(format!("{form}{damaged}"));
            std::fs::create_dir(&below).unwrap();
            let names = ["cameras", "images"].map(|name| below.join(format!("{name}.{form}")));
            std::fs::write(&names[1 - damaged], &whole[1 - damaged]).unwrap();
            let seeds = [(whole[damaged].clone(), whole[damaged].len())];
            // The limit covers a buffer and a line.
            run(&format!("COLMAP {form} {damaged}"), &seeds, 1 << 20, |bytes| {
                std::fs::write(&names[damaged], bytes).unwrap();
                sound(Dataset::load(&below))
            });
        }
    }
}

#[test]
fn json_nested_without_end_is_refused() {
    let _alone = alone();
    for open in ["[", "{\"a\":"] {
        let nested = format!("[{{\"lens\":{}", open.repeat(1_000_000));
        let said = Camera::parse(&nested, Path::new("c.json")).unwrap_err().to_string();
        assert!(said.contains("recursion limit") || said.contains("EOF while parsing"), "{said}");
    }
}
