//! Checks the values of every encoding, trees, palettes, chunks beside the file, and the refusal of damage.

#[path = "../../../tests/rad_file.rs"]
mod rad_file;

use crate::QUIET;
use crate::activation::SH_C0;
use crate::scene::Scene;
use crate::testing::{parse as read, says};
use half::f16;
use rad_file::{Array, array, chunk, file};
use std::ops::ControlFlow;

const FLOATS: (&str, f32, f32) = ("f32", 0.0, 0.0);

/// Returns `count` different numbers from -1 to 1.
fn numbers(count: usize) -> Vec<f32> {
    (0..count).map(|index| (index as f32 * 0.73).sin()).collect()
}

/// Builds the arrays of `count` splats as floats. An array in `replaced` replaces the one of its property, or is added.
fn arrays(count: usize, replaced: Vec<Array>) -> Vec<Array> {
    let positive = |count: usize| numbers(count).iter().map(|value| 0.5 + 0.4 * value).collect::<Vec<_>>();
    let mut all = vec![
        array("center", FLOATS, 3, &numbers(3 * count)),
        array("alpha", FLOATS, 1, &positive(count)),
        array("rgb", FLOATS, 3, &positive(3 * count)),
        array("scales", FLOATS, 3, &positive(3 * count)),
        array(
            "orientation",
            FLOATS,
            3,
            &numbers(3 * count).iter().map(|value| value / 2.0).collect::<Vec<_>>(),
        ),
    ];
    for new in replaced {
        match all.iter_mut().find(|old| old.property == new.property) {
            Some(old) => *old = new,
            None => all.push(new),
        }
    }
    all
}

pub(crate) fn one(count: usize, replaced: Vec<Array>) -> Vec<u8> {
    file(count as u64, &[chunk(0, count as u64, &arrays(count, replaced), true)], &[], None)
}

#[test]
fn every_encoding_of_numbers_has_the_values_that_the_format_defines() {
    let values = numbers(3 * 50);
    let (min, max) = (-0.75f32, 1.25f32);
    let code = |value: f32| f64::from(((value - min) / (max - min) * 255.0).clamp(0.0, 255.0).round());
    let half = |value: f32| f16::from_f32(value).to_f32();
    let r8 = |value: f32| (f64::from(min) + code(value) / 255.0 * 2.0) as f32;
    let s8 = |value: f32| (f64::from((value / max * 127.0).round()) / 127.0 * 1.25) as f32;
    let cases: [(&str, &dyn Fn(f32) -> f32); 8] = [
        ("f32", &|value| value),
        ("f32_lebytes", &|value| value),
        ("f16", &half),
        ("f16_lebytes", &half),
        ("r8", &r8),
        ("r8_delta", &r8),
        ("s8", &s8),
        ("s8_delta", &s8),
    ];
    for (encoding, expected) in cases {
        for compressed in [false, true] {
            let replaced = vec![array("center", (encoding, min, max), 3, &values)];
            let chunk = chunk(0, 50, &arrays(50, replaced), compressed);
            let bytes = file(50, &[chunk], &[], None);
            let scene = read(&bytes).unwrap_or_else(|error| panic!("{encoding}: {error}"));
            let expected: Vec<f32> = values.iter().map(|value| expected(*value)).collect();
            assert_eq!(scene.positions().as_flattened(), expected, "{encoding}");
            assert_eq!(scene.size_breakdown().sum(), bytes.len() as u64);
        }
    }
}

#[test]
fn scales_are_numbers_or_logarithms_and_zero_has_a_code() {
    let values: Vec<f32> =
        (0..30).map(|index| if index == 4 { 0.0 } else { (index as f32 - 20.0).exp() }).collect();
    let (min, max) = (-12.0f32, 9.0f32);
    let log = |value: f32| match value {
        0.0 => 0.0,
        _ => {
            let code = ((value.ln() - min) / (max - min) * 254.0).clamp(0.0, 254.0).round();
            (-12.0 + f64::from(code) / 254.0 * 21.0).exp() as f32
        }
    };
    let half = |value: f32| f16::from_f32(value.ln()).to_f64().exp() as f32;
    let cases: [(&str, &dyn Fn(f32) -> f32); 3] =
        [("f32", &|value| value), ("ln_0r8", &log), ("ln_f16", &half)];
    for (encoding, expected) in cases {
        let scene = read(&one(10, vec![array("scales", (encoding, min, max), 3, &values)])).unwrap();
        let expected: Vec<f32> = values.iter().map(|value| expected(*value)).collect();
        assert_eq!(scene.scales().as_flattened(), expected, "{encoding}");
    }
}

#[test]
fn colours_opacities_and_harmonics_are_those_of_a_scene() {
    let harmonics = [("sh1", 9), ("sh2", 15), ("sh3", 21)];
    for degree in 0..=3 {
        let bands = harmonics.iter().take(degree);
        let more = bands.map(|(name, width)| array(name, ("s8", -2.0, 2.0), *width, &numbers(width * 20)));
        let scene = read(&one(20, more.collect())).unwrap();
        assert_eq!(scene.stored_degree() as usize, degree);
        for index in 0..20 {
            let splat = scene.splat(index);
            let positive = |at: usize| 0.5 + 0.4 * numbers(60)[at];
            assert_eq!(splat.opacity, positive(index));
            for channel in 0..3 {
                let expected = ((f64::from(positive(3 * index + channel)) - 0.5) / SH_C0) as f32;
                assert_eq!(splat.sh[channel], expected);
            }
            let mut first = 3;
            for (_, width) in harmonics.iter().take(degree) {
                for (component, found) in splat.sh[first..].iter().take(*width).enumerate() {
                    let code = (numbers(width * 20)[index * width + component] / 2.0 * 127.0).round();
                    assert_eq!(*found, (f64::from(code) / 127.0 * 2.0) as f32);
                }
                first += width;
            }
        }
    }
}

#[test]
fn orientations_have_three_components_or_an_axis_and_an_angle() {
    let scene = read(&one(5, vec![])).unwrap();
    for index in 0..5 {
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(numbers(15)[3 * index + axis] / 2.0));
        let w = (1.0 - x * x - y * y - z * z).sqrt();
        let found = scene.splat(index).rotation.map(f64::from);
        assert!([w, x, y, z].iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-7), "{found:?}");
    }
    // In the octahedral map, the centre is the axis z, the right end is x, and the corners are -z.
    let cases = [
        ([255.0, 127.5, 255.0], [0.0, 1.0, 0.0, 0.0]),
        ([0.0, 0.0, 255.0], [0.0, 0.0, 0.0, -1.0]),
        ([255.0, 0.0, 255.0], [0.0, 0.0, 0.0, -1.0]),
        ([9.0, 100.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
        ([255.0, 127.0, 85.0], [(3f64).sqrt() / 2.0, 0.5, 0.0, 0.0]),
    ];
    let bytes: Vec<f32> = cases.iter().flat_map(|(bytes, _)| *bytes).collect();
    let scene = read(&one(5, vec![array("orientation", ("oct88r8", 0.0, 0.0), 3, &bytes)])).unwrap();
    for (index, (_, expected)) in cases.iter().enumerate() {
        let found = scene.splat(index).rotation;
        assert!(
            expected.iter().zip(found).all(|(a, b)| (a - f64::from(b)).abs() < 5e-3),
            "{index}: {found:?}"
        );
    }
}

#[test]
fn the_leaves_of_a_tree_are_read_and_opacities_above_1_are_counted() {
    // Two chunks: a root with two children, one of which has two.
    let tree = |children: &[f32], starts: &[f32], alphas: &[f32]| {
        arrays(
            children.len(),
            vec![
                array("child_count", ("u16", 0.0, 0.0), 1, children),
                array("child_start", ("u32", 0.0, 0.0), 1, starts),
                array("alpha", ("f16", 0.0, 0.0), 1, alphas),
            ],
        )
    };
    let first = tree(&[2.0, 0.0, 2.0], &[1.0, 0.0, 3.0], &[2.0, 0.5, 1.5]);
    let second = tree(&[0.0, 0.0], &[0.0, 0.0], &[1.25, 0.25]);
    let chunks = [chunk(0, 3, &first, true), chunk(3, 2, &second, true)];
    let bytes = file(5, &chunks, &[], None);
    let scene = read(&bytes).unwrap();
    assert_eq!(scene.opacities(), [0.5, 1.0, 0.25]);
    assert_eq!(scene.positions()[0], numbers(9)[3..6]);
    assert_eq!((scene.notes().lod_nodes, scene.notes().clamped_opacities), (2, 1));
    let expected = [
        "2 nodes of a tree of levels of detail above its leaves",
        "1 opacities outside 0 to 1, read as 0 or 1",
    ];
    assert_eq!(scene.notes().left_out(), expected);
    assert_eq!(scene.size_breakdown().sum(), bytes.len() as u64);
    says(&scene.size_breakdown().format, "2 chunks, leaves of a tree");
    let nodes = tree(&[1.0], &[0.0], &[0.5]);
    says(
        read(&file(1, &[chunk(0, 1, &nodes, true)], &[], None)).unwrap_err(),
        "none of the 1 splats can be drawn: 1 nodes above the leaves",
    );
}

#[test]
fn harmonics_can_be_a_palette_in_the_first_chunk() {
    let palette = || array("sh1_code", ("f16", 0.0, 0.0), 9, &numbers(36));
    let labelled =
        |labels: &[f32], encoding: &'static str| array("sh_label", (encoding, 0.0, 0.0), 1, labels);
    let first = arrays(2, vec![palette(), labelled(&[3.0, 0.0], "u16")]);
    let second = arrays(1, vec![labelled(&[2.0], "u32")]);
    let chunks = [chunk(0, 2, &first, true), chunk(2, 1, &second, true)];
    let scene = read(&file(3, &chunks, &[], Some(4))).unwrap();
    assert_eq!(scene.stored_degree(), 1);
    for (index, entry) in [3, 0, 2].into_iter().enumerate() {
        let expected: Vec<f32> =
            numbers(36)[9 * entry..][..9].iter().map(|value| f16::from_f32(*value).to_f32()).collect();
        assert_eq!(scene.splat(index).sh[3..12], expected);
    }
    // A single chunk does not declare the number of entries.
    let scene = read(&chunks[0]).unwrap();
    assert_eq!((scene.count(), scene.stored_degree()), (2, 1));
    says(read(&chunks[1]).unwrap_err(), "chunks[0].sh_label`: expected the palette in the first chunk");
    // A label beyond the palette drops its splat.
    let far = arrays(2, vec![palette(), labelled(&[4.0, 0.0], "u16")]);
    let scene = read(&file(2, &[chunk(0, 2, &far, true)], &[], Some(4))).unwrap();
    assert_eq!((scene.count(), scene.dropped().color), (1, 1));
}

#[test]
fn chunks_can_be_files_beside_the_document() {
    let folder = tempfile::tempdir().unwrap();
    let chunks = [chunk(0, 30, &arrays(30, vec![]), true), chunk(30, 7, &arrays(7, vec![]), false)];
    let names = ["scene-0.radc", "scene-1.radc"];
    for (name, chunk) in names.iter().zip(&chunks) {
        std::fs::write(folder.path().join(name), chunk).unwrap();
    }
    let path = folder.path().join("scene.rad");
    let document = file(37, &chunks, &names, None);
    std::fs::write(&path, &document).unwrap();
    let scene = Scene::load(&path, QUIET).unwrap();
    let whole = read(&file(37, &chunks, &[], None)).unwrap();
    assert_eq!(scene.identity(), whole.identity());
    let sizes = scene.size_breakdown();
    assert_eq!(sizes.sum(), sizes.file_bytes);
    assert_eq!(sizes.file_bytes as usize, document.len() + chunks[0].len() + chunks[1].len());
    let header = crate::SceneHeader::load(&path).unwrap();
    assert_eq!((header.count, header.stored_degree), (37, 0));
    assert_eq!(Scene::load(folder.path().join(names[1]), QUIET).unwrap().count(), 7);
    // Work is done only while a file of chunks is open.
    let touch = |done: u64, _| {
        if done > 0 {
            names.iter().zip(&chunks).for_each(|(name, chunk)| {
                std::fs::write(folder.path().join(name), chunk).unwrap();
            });
        }
        ControlFlow::Continue(())
    };
    let said = Scene::load(&path, &touch).unwrap_err().to_string();
    assert!(said.contains("`scene-") && said.contains("while it was read"), "{said}");
    std::fs::write(&path, file(37, &chunks, &["scene-0.radc", "../scene-1.radc"], None)).unwrap();
    says(
        Scene::load(&path, QUIET).unwrap_err(),
        "expected a file in the folder of the JSON, found another place",
    );
    std::fs::write(&path, file(37, &chunks, &["scene-0.radc", "none.radc"], None)).unwrap();
    says(Scene::load(&path, QUIET).unwrap_err(), "`none.radc`: expected a readable file beside this one");
}

#[test]
fn damage_names_the_byte_and_the_field() {
    let said = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    let with = |replaced: Vec<Array>| said(&one(4, replaced));
    let number = |encoding: &'static str| array("alpha", (encoding, 0.0, 1.0), 1, &[0.0, 0.5, 0.2, 1.0]);
    let whole = one(4, vec![]);
    let replaced = |old: &str, new: &str| {
        let at = whole.windows(old.len()).position(|window| window == old.as_bytes()).unwrap();
        said(&[&whole[..at], new.as_bytes(), &whole[at + old.len()..]].concat())
    };
    let alpha = |values: &[f32]| vec![array("alpha", FLOATS, 1, values)];
    for (found, expected) in [
        (with(vec![number("u16")]), "chunks[0].properties[1].encoding`: expected an encoding of numbers"),
        (with(alpha(&[0.5; 3])), "chunks[0].properties[1], alpha`: expected 16 unpacked bytes, found 12"),
        (with(alpha(&[0.5; 5])), "expected 16 unpacked bytes, found 17 or more"),
        (replaced("\"version\":1", "\"version\":2"), "byte 8, `version`: expected 1, found 2"),
        (replaced("\"type\":\"gsplat\"", "\"type\":\"nsplat\""), "`type`: expected gsplat, found nsplat"),
        (replaced("RADC", "RADX"), "`magic`: expected RADC, found RADX"),
        (
            replaced("\"base\":0", "\"base\":1"),
            "chunks[0].base`: expected 0, the splats of the chunks before, found 1",
        ),
        (replaced("\"rgb\"", "\"rbg\""), "`JSON`: unknown variant `rbg`"),
    ] {
        assert!(found.contains(expected), "{found}; expected {expected}");
    }
    let found = replaced("\"count\":4", "\"count\":5");
    assert!(
        found.contains("unpacked bytes") || found.contains("the sum over the chunks, found 5"),
        "{found}"
    );
    let found = replaced("\"rgb\"", "\"sh1\"");
    assert!(!found.is_empty());
}

#[test]
fn a_bomb_is_refused_before_it_is_unpacked() {
    // The header declares a million splats, more than deflate can compress into these bytes.
    let alpha = Array { property: "alpha", encoding: "f32", min: 0.0, max: 0.0, bytes: vec![0; 40] };
    let mut all = arrays(1, vec![]);
    all[1] = alpha;
    let bytes = file(1_000_000, &[chunk(0, 1_000_000, &all, true)], &[], None);
    says(read(&bytes).unwrap_err(), "properties[0].bytes`: expected at least 12000000 unpacked bytes");
}
