//! Tests of every format: values within its quantisation steps, damage refused, memory bounded.

use super::*;
use crate::ply::tests::{Made, PLAIN};
use crate::scene::{FileNotes, Filter, SortKey, Splat};
use crate::scene_files::names_scenes;
use crate::testing::{captures, parse as read, written};
use std::ops::ControlFlow;
use std::sync::Mutex;

fn varied(count: u32, degree: u32) -> Scene {
    Scene::generate(count, degree, |index| {
        let wave = |k: usize| ((index * 7 + k * 13) as f32 * 0.37).sin();
        Splat {
            position: [10.0 * wave(1), 4.0 * wave(2), 3.0 + wave(3)],
            scale: [1, 2, 3].map(|k| (-3.0 + 2.0 * wave(3 + k)).exp()),
            rotation: [wave(7), wave(8), wave(9), wave(10)],
            opacity: 0.5 + 0.49 * wave(11),
            sh: std::array::from_fn(|k| if k < 3 { wave(12 + k) } else { 0.5 * wave(12 + k) }),
        }
    })
}

/// Returns files of `count` splats in all formats whose files tests can build in any size, each with a name.
fn files(count: u32, degree: u32) -> Vec<(String, Vec<u8>)> {
    let scene = varied(count, degree);
    let mut files: Vec<_> =
        SceneFormat::WRITTEN.map(|format| (format!("{format:?}"), written(&scene, format))).into();
    let mut spz = Vec::new();
    scene.write_spz(SpzVersion::V3, &mut spz).unwrap();
    let text = Made { format: "ascii", count: count as usize, degree, ..PLAIN };
    files.extend([
        ("SPZ 3".into(), spz),
        ("ASCII".into(), text.bytes()),
        ("RAD".into(), rad::tests::one(count as usize, vec![])),
    ]);
    files
}

struct Steps {
    position: f32,
    scale: f32,
    rotation: f32,
    opacity: f32,
    dc: f32,
    /// Tolerance of a coefficient above band 0; `None` if there are none.
    rest: Option<f32>,
}

fn steps(format: SceneFormat) -> Steps {
    let byte = 0.5 / 255.0 + 1e-6;
    match format {
        SceneFormat::Ply => {
            Steps { position: 0.0, scale: 1e-5, rotation: 1e-6, opacity: 1e-6, dc: 0.0, rest: Some(0.0) }
        }
        SceneFormat::Gltf => {
            Steps { position: 0.0, scale: 0.0, rotation: 1e-6, opacity: 0.0, dc: 0.0, rest: Some(0.0) }
        }
        // Half a step of 10 bits, over a range of 20 units for positions, and of 4 for the logarithms of scales.
        SceneFormat::CompressedPly => Steps {
            position: 0.5 * 20.0 / 1023.0,
            scale: 0.5 * 4.0 / 1023.0 + 1e-5,
            rotation: 0.003,
            opacity: byte,
            dc: 2.0 * byte,
            rest: Some(8.0 / 256.0),
        },
        SceneFormat::Spz => Steps {
            position: 0.5 / 4096.0,
            scale: 0.5 / 16.0 + 1e-5,
            rotation: 0.003,
            opacity: byte,
            dc: byte / 0.15 + 1e-5,
            rest: Some(8.5 / 128.0),
        },
        SceneFormat::Splat => Steps {
            position: 0.0,
            scale: 1e-5,
            rotation: 0.015,
            opacity: byte,
            dc: byte / 0.282 + 1e-5,
            rest: None,
        },
        // The values of a codebook have their widest gaps at the ends of the range.
        SceneFormat::Sog => {
            Steps { position: 4e-4, scale: 0.03, rotation: 0.015, opacity: byte, dc: 0.02, rest: Some(0.01) }
        }
        _ => unreachable!("it is read alone"),
    }
}

/// Finds the splat of `scene` nearest to a position: formats may change the order.
fn nearest(scene: &Scene, to: [f32; 3]) -> Splat {
    let distance = |p: &[f32; 3]| (0..3).map(|axis| (p[axis] - to[axis]).powi(2)).sum::<f32>();
    let (index, _) = scene
        .positions()
        .iter()
        .enumerate()
        .min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)))
        .unwrap();
    scene.splat(index)
}

#[test]
fn every_format_reads_what_it_wrote_within_its_steps() {
    for (format, degree) in SceneFormat::WRITTEN.into_iter().flat_map(|f| (0..=3).map(move |d| (f, d))) {
        let scene = varied(600, degree);
        let bytes = written(&scene, format);
        let back = read(&bytes).unwrap_or_else(|error| panic!("{format:?}: {error}"));
        let steps = steps(format);
        assert_eq!((back.count(), back.dropped().total()), (600, 0), "{format:?}");
        assert_eq!(back.stored_degree(), if steps.rest.is_some() { degree } else { 0 }, "{format:?}");
        assert_eq!(back.size_breakdown().sum(), bytes.len() as u64, "{format:?}");
        for index in 0..600 {
            let expected = scene.splat(index);
            let found = nearest(&back, expected.position);
            let near = |what: &str, a: &[f32], b: &[f32], step: f32| {
                for (a, b) in a.iter().zip(b) {
                    assert!(
                        (a - b).abs() <= step,
                        "{format:?} of degree {degree}, {what} {index}: {a} and {b}"
                    );
                }
            };
            near("position", &expected.position, &found.position, steps.position);
            near("scale", &expected.scale.map(f32::ln), &found.scale.map(f32::ln), steps.scale);
            // A quaternion and its negative are one rotation.
            let same: f32 = expected.rotation.iter().zip(found.rotation).map(|(a, b)| a * b).sum();
            near("rotation", &expected.rotation.map(|c| c * same.signum()), &found.rotation, steps.rotation);
            near("opacity", &[expected.opacity], &[found.opacity], steps.opacity);
            let dc = |sh: &[f32]| [sh[0], sh[1], sh[2]].map(|c| c.clamp(-1.77, 1.77));
            near("colour", &dc(&expected.sh), &dc(&found.sh), steps.dc);
            match steps.rest {
                Some(step) => near("harmonics", &expected.sh[3..], &found.sh[3..], step),
                None => assert!(found.sh[3..].iter().all(|c| *c == 0.0)),
            }
        }
    }
}

#[test]
fn a_written_file_is_recognised_without_its_name_and_its_header_says_how_many_splats_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let scene = varied(300, 2);
    for format in SceneFormat::WRITTEN {
        let path = folder.path().join("scene");
        std::fs::write(&path, written(&scene, format)).unwrap();
        let header = SceneHeader::load(&path).unwrap();
        let loaded = Scene::load(&path, crate::QUIET).unwrap();
        assert_eq!((header.count, header.stored_degree), (300, loaded.stored_degree()), "{format:?}");
    }
}

#[test]
fn every_format_keeps_the_tags_that_it_says() {
    let filters = Filter::ALL;
    let ups = [None, Some([1.0, 0.0, 0.0]), Some([0.6, -0.8, 0.0])];
    let keys = SortKey::ALL;
    let notes = filters.into_iter().flat_map(|low_pass| {
        let of = move |up| keys.map(|key_of| FileNotes { low_pass, up, key_of, ..FileNotes::default() });
        ups.into_iter().flat_map(of)
    });
    for notes in notes {
        let scene = varied(3, 0).with_notes(notes);
        for format in SceneFormat::WRITTEN {
            let back = read(&written(&scene, format)).unwrap();
            assert_eq!(back.notes(), format.kept_tags(notes), "{format:?} of {notes:?}");
        }
    }
    let flag = FileNotes { low_pass: Filter::Compensated, ..FileNotes::default() };
    for low_pass in [Filter::Compensated, Filter::Mip] {
        let notes = FileNotes { low_pass, up: ups[1], ..FileNotes::default() };
        let kept = [SceneFormat::Ply, SceneFormat::CompressedPly, SceneFormat::Spz, SceneFormat::Sog];
        assert_eq!(kept.map(|format| format.kept_tags(notes)), [notes, notes, flag, flag]);
    }
}

#[test]
fn a_scene_without_splats_is_not_written_where_the_format_needs_one() {
    let none = Scene::generate(0, 0, crate::testing::splat);
    for format in [SceneFormat::Sog, SceneFormat::Gltf] {
        let said = none.write(format, crate::QUIET, &mut Vec::new()).unwrap_err().to_string();
        assert_eq!(said, "expected at least one splat, found none", "{format:?}");
    }
}

#[test]
fn every_cut_of_a_file_is_an_error_or_a_shorter_scene() {
    let mut files: Vec<_> = files(10, 1).into_iter().map(|(name, bytes)| (name, bytes, 1)).collect();
    files.push(("ksplat".into(), ksplat::ksplat_file::file(2, 1), 1));
    files.extend(["usda", "usdc", "usdz"].map(|end| (end.into(), usd::tests::file(end), 7)));
    for (name, bytes, step) in files {
        // The last bytes of these are not needed: blanks and a line feed.
        let needed = match name.as_str() {
            "usda" => bytes.len() - 4,
            "ASCII" => bytes.len() - 2,
            _ => bytes.len(),
        };
        for end in (0..needed).step_by(step) {
            match read(&bytes[..end]) {
                // In a format without a header, a prefix is a valid file of fewer splats.
                Ok(shorter) => assert_eq!((name.as_str(), shorter.count() as usize * 32), ("Splat", end)),
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
    }
}

/// Loads a file. Calls `tell` with the progress, and also returns the greatest progress, and its total.
fn told(bytes: &[u8], tell: fn(u64) -> ControlFlow<()>) -> (Result<Scene, SceneError>, (u64, u64)) {
    let most = Mutex::new((0, 0));
    let scene = Scene::parse(bytes, &|done, of| {
        let mut most = most.lock().unwrap();
        *most = (most.0.max(done), of);
        tell(done)
    });
    (scene, most.into_inner().unwrap())
}

#[test]
fn progress_ends_at_all_bytes() {
    for (name, bytes) in files(20_000, 1) {
        let (scene, (done, of)) = told(&bytes, |_| ControlFlow::Continue(()));
        assert!(scene.is_ok() && done == of && of > 0, "{name}: {done} of {of}");
    }
}

#[test]
fn a_scene_larger_than_the_memory_is_refused() {
    let with = |bytes: &[u8], memory| {
        let source = &Source::Bytes(bytes);
        parse(&Input::new(source, Some(memory), crate::QUIET), None, None)
    };
    for (name, bytes) in files(5000, 3) {
        assert!(matches!(with(&bytes, 200_000), Err(SceneError::Memory(_))), "{name}");
        assert_eq!(with(&bytes, 64 << 20).unwrap().count(), 5000, "{name}");
    }
    let usd = usd::tests::file("usdc");
    assert!(matches!(with(&usd, 200_000), Err(SceneError::Memory(_))));
    assert_eq!(with(&usd, 64 << 20).unwrap().count(), 22);
}

#[test]
fn a_load_that_its_progress_cancels_ends_before_all_is_read() {
    let cancel = |done| if done > 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    assert!(matches!(told(&usd::tests::file("usdc"), cancel).0, Err(SceneError::Cancelled)));
    for (name, bytes) in files(100_000, 3) {
        let (scene, (done, of)) = told(&bytes, cancel);
        assert!(matches!(scene, Err(SceneError::Cancelled)), "{name}");
        assert!(0 < done && done < of, "{name}: {done} of {of}");
    }
}

#[test]
fn writing_that_its_progress_cancels_ends_with_an_error() {
    let scene = varied(3000, 1);
    let most = Mutex::new((0, 0));
    let tell = |done: u64, of: u64| {
        *most.lock().unwrap() = (done, of);
        if done > 40 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let error = scene.write(SceneFormat::Sog, &tell, &mut Vec::new()).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::Interrupted);
    let (done, of) = *most.lock().unwrap();
    assert!(40 < done && done < 60 && of == 100, "{done} of {of}");
}

#[test]
fn the_compressed_capture_has_the_values_that_were_decoded_from_it() {
    let test = "the_compressed_capture_has_the_values_that_were_decoded_from_it";
    let Some(captures) = captures(test) else { return };
    let load = |name: &str| Scene::load(captures.join(name), crate::QUIET).unwrap();
    let [packed, plain] = ["biker.compressed.ply", "biker.ply"].map(load);
    assert_eq!(packed.count(), plain.count());
    for index in 0..packed.count() as usize {
        let (a, b) = (packed.splat(index), plain.splat(index));
        let near = |a: &[f32], b: &[f32], part: f32| {
            a.iter().zip(b).all(|(a, b)| (a - b).abs() <= part * a.abs().max(1.0))
        };
        let same = near(&a.position, &b.position, 1e-6)
            && a.scale.iter().zip(b.scale).all(|(a, b)| (a / b - 1.0).abs() < 1e-5)
            && near(&a.rotation, &b.rotation, 1e-5)
            && near(&[a.opacity], &[b.opacity], 1e-5)
            && near(&a.sh, &b.sh, 1e-5);
        assert!(same, "splat {index}: {a:?} and {b:?}");
    }
}

#[test]
fn placed_scenes_are_moved_and_joined_as_convert_does_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [a, b] = [3, 2].map(|degree| Scene::generate(300, degree, crate::testing::splat));
    a.write_ply(at("a.ply")).unwrap();
    std::fs::create_dir(at("far")).unwrap();
    b.write_ply(at("far/a.ply")).unwrap();
    let [a, b] = ["a.ply", "far/a.ply"].map(|name| Scene::load(at(name), crate::QUIET).unwrap());
    let text = r#"Scenes([
        Scene(file: "a.ply"),
        Scene(file: "far/a.ply", scale: 0.5, rotate: (axis: (0, 1, 0.5), degrees: 30), translate: (1, -0.5, 2)),
    ])"#;
    std::fs::write(at("both.ron"), text).unwrap();
    let both = Scene::load(at("both.ron"), crate::QUIET).unwrap();
    // The steps follow one another, like the options of `convert`.
    let turn = glam::DQuat::from_axis_angle(glam::DVec3::new(0.0, 1.0, 0.5).normalize(), 30f64.to_radians());
    let steps = [
        Similarity { scale: 0.5, ..Similarity::IDENTITY },
        Similarity { rotation: turn, ..Similarity::IDENTITY },
        Similarity { translation: glam::DVec3::new(1.0, -0.5, 2.0), ..Similarity::IDENTITY },
    ];
    let by = steps.into_iter().fold(Similarity::IDENTITY, Similarity::then);
    let joined = Scene::joined(&[a, b.transformed(&by).unwrap()]).unwrap();
    assert_eq!((both.count(), both.stored_degree()), (600, 3));
    assert_eq!(both.identity(), joined.identity());
    let names = both.size_breakdown().elements.iter().map(|element| element.name.clone());
    let names: Vec<_> = names.collect();
    assert!(names[0].starts_with("a.ply (") && names[1].starts_with("far/a.ply ("), "{names:?}");
    let header = SceneHeader::load(at("both.ron")).unwrap();
    assert_eq!((header.count, header.stored_degree), (600, 3));
    // The scenes are in memory beside the joined one, whose degree is the highest.
    let part = |name: &str| Placed { file: at(name), by: Similarity::IDENTITY, at: (1, 1) };
    let headers =
        SceneHeader::of_parts(&at("both.ron"), &[part("a.ply"), part("far/a.ply"), part("far/a.ply")], None)
            .unwrap();
    let joined = Scene::host_bytes(900, 3) + 900 * 12;
    let needed = Scene::host_bytes(300, 3) + 2 * Scene::host_bytes(300, 2) + joined;
    assert!(SceneHeader::check_joined(&headers, 0, Some(needed)).is_ok());
    let said = SceneHeader::check_joined(&headers, 1, Some(needed)).unwrap_err();
    assert!(SceneHeader::check_joined(&headers[..1], 0, Some(0)).is_ok(), "a single scene is not copied");
    assert_eq!((said.count, said.degree, said.needed), (900, 3, needed + 1));
    assert!(names_scenes(&at("both.ron")) && !names_scenes(&at("a.ply")) && !names_scenes(&at("none")));
}

#[test]
fn splats_that_parts_of_a_list_lose_are_counted_in_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut bytes = written(&Scene::generate(3, 0, crate::testing::splat), SceneFormat::Ply);
    let row = 68;
    let rows = bytes.len() - 3 * row;
    for index in [0, 2] {
        bytes[rows + index * row..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    }
    std::fs::write(at("nan.ply"), bytes).unwrap();
    let huge = |index: usize| Splat {
        scale: [if index == 1 { 1e30 } else { 1.0 }; 3],
        ..crate::testing::splat(index)
    };
    Scene::generate(4, 0, huge).write_ply(at("huge.ply")).unwrap();
    let load = |text: &str| {
        std::fs::write(at("all.ron"), text).unwrap();
        Scene::load(at("all.ron"), crate::QUIET)
    };
    let scene = load(r#"Scenes([Scene(file: "nan.ply"), Scene(file: "huge.ply", scale: 1e9)])"#).unwrap();
    assert_eq!(
        scene.dropped().to_string(),
        "2 with a position not finite in f32, 1 with a scale not finite in f32"
    );
    assert_eq!((scene.count(), scene.parts()[1].splats.clone()), (4, 1..4));
    // The sizes are those of the files; one that is placed twice is counted once.
    let scene = load(r#"Scenes([Scene(file: "nan.ply"), Scene(file: "huge.ply"), Scene(file: "nan.ply")])"#);
    let (scene, length) = (scene.unwrap(), |name| std::fs::metadata(at(name)).unwrap().len());
    let sizes = scene.size_breakdown();
    assert_eq!(sizes.file_bytes, length("all.ron") + length("nan.ply") + length("huge.ply"));
    assert_eq!((sizes.sum(), sizes.header_bytes), (sizes.file_bytes, length("all.ron")));
    assert_eq!((sizes.format.as_str(), sizes.elements[0].rows), ("list of scenes, 2 files", 3));
    let far = |index| Splat { position: [5e5, 5.4e6 + index as f32, 300.0], scale: [0.01; 3], ..huge(0) };
    Scene::generate(9, 0, far).write_ply(at("far.ply")).unwrap();
    let scene = load(
        r#"Scenes([Scene(file: "nan.ply"), Scene(file: "far.ply", translate: (-5e5, -54e5, 0)), Scene(file: "far.ply")])"#,
    );
    let [note] = &scene.unwrap().coarse_notes()[..] else { panic!("one note") };
    assert!(
        note.contains("far.ply: positions are in steps of 5.0e-1") && note.contains("`double`"),
        "{note}"
    );
    Scene::generate(2, 0, |_| huge(1)).write_ply(at("huge.ply")).unwrap();
    let said = load("Scenes([Scene(file: \"huge.ply\", scale: 1e9),\nScene(file: \"huge.ply\")])");
    let said = said.unwrap_err().to_string();
    assert!(said.contains("all.ron: line 1, column 15: "), "{said}");
    assert!(
        said.ends_with("huge.ply: none of the 2 splats can be drawn: 2 with a scale not finite in f32"),
        "{said}"
    );
}

#[cfg(unix)]
#[test]
fn a_mesh_that_is_too_long_or_beyond_the_memory_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.glb");
    std::fs::write(&path, b"glTF\x02\0\0\0").unwrap();
    // A sparse file, which takes no space.
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
    let said = Scene::load_any(&path, ReadOptions::default(), crate::QUIET).unwrap_err().to_string();
    assert!(said.ends_with("bytes, found 1099511627776") && said.contains("expected a file of"), "{said}");
    assert!(check_mesh(1000, Some(2000)).is_ok() && check_mesh(1000, Some(1999)).is_err());
    assert!(check_mesh(MAX_MESH, None).is_ok() && check_mesh(MAX_MESH + 1, None).is_err());
}

#[test]
fn the_rounding_of_positions_is_that_of_the_file() {
    let two_clouds = Scene::try_generate_at(40, 0, true, |index| {
        let splat = Splat { scale: [0.01; 3], ..crate::testing::splat(index) };
        let rotation = [1.0, 0.0, 0.0, 0.0];
        (Splat { rotation, ..splat }, [1e7 * (index % 2) as f64 + 0.3 * index as f64, 0.0, 0.0])
    });
    let two_clouds = two_clouds.unwrap().with_offset([2e6, 0.0, 0.0]);
    for format in [SceneFormat::Gltf, SceneFormat::Splat] {
        let back = read(&written(&two_clouds, format)).unwrap();
        let error =
            |index: usize| (back.world_position(index)[0] - two_clouds.world_position(index)[0]).abs();
        let largest = (0..40).map(error).fold(0.0, f64::max);
        let expected = two_clouds.position_rounding(format);
        assert!(largest > 0.1 && (largest - expected).abs() < 1e-6, "{format:?}: {largest}, {expected}");
    }
    // Quantised positions are read as f32 as well.
    for format in [SceneFormat::CompressedPly, SceneFormat::Sog] {
        let back = read(&written(&two_clouds, format)).unwrap();
        assert!(!back.is_wide() && back.offset() == [0.0; 3], "{format:?}");
        let expected = two_clouds.position_rounding(SceneFormat::Splat);
        assert_eq!(two_clouds.position_rounding(format), expected, "{format:?}");
    }
    assert_eq!(two_clouds.position_rounding(SceneFormat::Ply), 0.0);
    let near = varied(40, 0);
    assert!(SceneFormat::ALL.iter().all(|format| near.position_rounding(*format) == 0.0));
}
