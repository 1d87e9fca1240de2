//! Tests of SPZ files built byte by byte.

#[path = "../../../tests/spz_file.rs"]
mod spz_file;

use super::layout::*;
use super::*;
use crate::scene::{FileNotes, Filter, Scene};
use crate::testing::{captures, parse, says};
use flate2::{Compression, write::GzEncoder};
use std::io::Write as _;

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

fn header(version: u32, count: u32, degree: u8, flags: u8) -> Vec<u8> {
    let mut bytes = b"NGSP".to_vec();
    bytes.extend(version.to_le_bytes());
    bytes.extend(count.to_le_bytes());
    bytes.extend([degree, 12, flags, 0]);
    bytes
}

/// Builds the arrays of one splat at (1, -2, 3) in the file's axes.
fn splat(version: u32, degree: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    for value in [1.0f32, -2.0, 3.0] {
        match version {
            1 => bytes.extend(half::f16::from_f32(value).to_le_bytes()),
            _ => bytes.extend(&((value * 4096.0) as i32).to_le_bytes()[..3]),
        }
    }
    bytes.push(51);
    bytes.extend([255, 0, 51]);
    bytes.extend([160, 144, 176]);
    match version {
        // w is the largest; x 0, y positive, z negative.
        3 => bytes.extend((3u32 << 30 | 511 << 10 | 512 | 255).to_le_bytes()),
        _ => bytes.extend([255, 0, 51].map(|c: u8| c.saturating_sub(127))),
    }
    bytes.extend((1..=3 * ((degree + 1) * (degree + 1) - 1)).map(|k| 128 + k));
    bytes
}

fn file(version: u32, degree: u8, flags: u8, more: &[u8]) -> Vec<u8> {
    gzip(&[header(version, 1, degree, flags), splat(version, degree), more.to_vec()].concat())
}

fn said(bytes: &[u8]) -> String {
    parse(bytes).unwrap_err().to_string()
}

fn near(a: &[f32], b: &[f32]) {
    assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} and {b:?}");
}

#[test]
fn versions_1_to_3_have_the_values_that_the_format_defines() {
    for version in 1..=3 {
        let plain = [header(version, 1, 1, 0), splat(version, 1)].concat();
        says(parse(&plain).unwrap_err(), &format!("SPZ of version {version}, unpacked"));
        let scene = parse(&file(version, 1, 0, &[])).unwrap();
        let found = scene.splat(0);
        // y and z of the file point the other way.
        assert_eq!(found.position, [1.0, 2.0, -3.0], "version {version}");
        near(&found.scale, &[1.0, (-1.0f32).exp(), std::f32::consts::E]);
        near(&[found.opacity], &[0.2]);
        near(&found.sh[..3], &[0.5 / 0.15, -0.5 / 0.15, -0.3 / 0.15]);
        // Band 1 is y, z, x.
        near(&found.sh[3..12], &[-1, -2, -3, -4, -5, -6, 7, 8, 9].map(|k| k as f32 / 128.0));
        assert_eq!(scene.notes(), FileNotes::default());
    }
    let found = parse(&file(3, 0, 0, &[])).unwrap().splat(0).rotation;
    let (y, z) = (0.5f32.sqrt(), 255.0 / 511.0 * 0.5f32.sqrt());
    let w = (1.0 - y * y - z * z).sqrt();
    near(&found, &[w, 0.0, -y, z]);
    let found = parse(&file(2, 0, 0, &[])).unwrap().splat(0).rotation;
    let expected = [128.0f32, 0.0, 0.0].map(|u| u / 127.5 - 1.0);
    // x, y and z together are longer than 1, so w is 0.
    let norm = expected.iter().map(|c| c * c).sum::<f32>().sqrt();
    near(&found, &[0.0, expected[0] / norm, -expected[1] / norm, -expected[2] / norm]);
}

#[test]
fn a_fifth_band_is_cut_off_and_the_flag_of_the_filter_is_kept() {
    let scene = parse(&file(3, 4, ANTIALIASED, &[])).unwrap();
    assert_eq!(scene.stored_degree(), 3);
    assert_eq!(
        scene.notes(),
        FileNotes { low_pass: Filter::Compensated, cut_degree: Some(4), ..FileNotes::default() }
    );
    near(&scene.splat(0).sh[45..48], &[46, 47, 48].map(|k| (k - 3) as f32 / 128.0));
    let report = crate::report::Report::new(&scene, &[]).to_string();
    says(&report, "degree 4 in the file, cut to 3");
    says(report, "low_pass compensated");
}

#[test]
fn an_extension_names_the_axes_and_others_are_skipped() {
    let record = |kind: u32, payload: &[u8]| {
        [&kind.to_le_bytes()[..], &(payload.len() as u32).to_le_bytes(), payload].concat()
    };
    let camera = record(0xADBE_0002, &[0; 12]);
    let system = |n: u32| record(COORDINATE_SYSTEM, &n.to_le_bytes());
    let position = |records: &[u8]| parse(&file(3, 0, EXTENSIONS, records)).map(|s| s.splat(0).position);
    assert_eq!(position(&camera).unwrap(), [1.0, 2.0, -3.0]);
    assert_eq!(position(&[camera, system(6)].concat()).unwrap(), [1.0, -2.0, 3.0]);
    // 0 means unspecified; 16 is right, front, up.
    assert_eq!(position(&system(0)).unwrap(), [1.0, 2.0, -3.0]);
    assert_eq!(position(&system(16)).unwrap(), [1.0, -3.0, -2.0]);
    says(
        position(&system(17)).unwrap_err(),
        "byte 36, `extensions`: expected a coordinate system of 0 to 16",
    );
    says(position(&system(6)[..9]).unwrap_err(), "expected a complete record, found 9 bytes");
}

#[test]
fn damage_names_the_byte_and_the_field() {
    let with = |at: usize, byte: u8| {
        let mut bytes = [header(3, 1, 0, 0), splat(3, 0)].concat();
        bytes[at] = byte;
        said(&gzip(&bytes))
    };
    assert_eq!(with(4, 9), "byte 4, `version`: expected 1 to 3, found 9");
    assert_eq!(with(12, 5), "byte 12, `shDegree`: expected 0 to 4, found 5");
    assert_eq!(with(13, 25), "byte 13, `fractionalBits`: expected at most 24, found 25");
    assert_eq!(with(8, 0), "byte 8, `numPoints`: expected at least one splat, found 0");
    assert_eq!(with(8, 2), "byte 36, `colors`: expected 6 bytes, found the end of the compressed stream");
    let whole = file(3, 3, 0, &[]);
    let mut damaged = whole.clone();
    let at = whole.len() - 6;
    damaged[at] ^= 1;
    says(said(&damaged), "expected an intact compressed stream, found damage");
}

#[test]
fn a_header_that_promises_too_much_and_a_bomb_are_refused_without_their_memory() {
    let promise = gzip(&header(3, 1 << 31, 3, 0));
    let said = said(&promise);
    assert!(said.starts_with("byte 8, `numPoints`: expected at most"), "{said}");
    assert!(said.ends_with("bytes can hold, found 2147483648"), "{said}");
    let bomb = file(3, 0, EXTENSIONS, &vec![0; 8 << 20]);
    assert!(bomb.len() < 200_000);
    says(parse(&bomb).unwrap_err(), "byte 36, `extensions`: expected at most 65536 bytes");
}

#[test]
fn equal_splats_are_read_however_far_they_are_compressed() {
    let scene = Scene::generate(200_000, 0, |_| crate::testing::splat(0));
    for version in [SpzVersion::V3, SpzVersion::V4] {
        let mut bytes = Vec::new();
        write(&scene, version, &mut bytes).unwrap();
        assert_eq!(parse(&bytes).unwrap().count(), 200_000, "{version:?}, {} bytes", bytes.len());
    }
}

#[test]
fn a_scene_beyond_2048_units_is_written_with_coarser_steps() {
    let scene = Scene::generate(2, 0, |i| crate::scene::Splat {
        position: [5000.0 * i as f32, -1.25, 0.5],
        ..crate::testing::splat(i)
    });
    let mut bytes = Vec::new();
    write(&scene, SpzVersion::V3, &mut bytes).unwrap();
    let back = parse(&bytes).unwrap();
    assert_eq!((back.splat(1).position, back.splat(0).position), ([5000.0, -1.25, 0.5], [0.0, -1.25, 0.5]));
    let far = scene.with_offset([1e8, 0.0, 0.0]);
    says(write(&far, SpzVersion::V4, &mut Vec::new()).unwrap_err(), "expected coordinates up to 8388607");
}

fn streams(degree: u8, records: &[u8]) -> Vec<u8> {
    let mut all = splat(3, degree).into_iter();
    let mut arrays = [9, 1, 3, 3, 4].map(|length| all.by_ref().take(length).collect()).to_vec();
    arrays.push(all.collect());
    let flags = if records.is_empty() { 0 } else { EXTENSIONS };
    spz_file::file(1, (degree, flags), records, &arrays)
}

#[test]
fn version_4_has_the_splats_of_version_3() {
    for degree in 0..=4 {
        let (new, old) = (streams(degree, &[]), file(3, degree, 0, &[]));
        let [found, expected] = [&new, &old].map(|bytes| parse(bytes).unwrap());
        assert_eq!(found.splat(0), expected.splat(0));
        assert_eq!(found.size_breakdown().sum(), new.len() as u64);
        assert_eq!(found.size_breakdown().format, "spz, version 4, zstd");
    }
    let system = [&COORDINATE_SYSTEM.to_le_bytes()[..], &4u32.to_le_bytes(), &6u32.to_le_bytes()].concat();
    assert_eq!(parse(&streams(1, &system)).unwrap().splat(0).position, [1.0, -2.0, 3.0]);
}

#[test]
fn both_written_versions_have_the_same_splats_and_no_stream_without_bytes() {
    for degree in 0..=3 {
        let scene = Scene::generate(3000, degree, crate::testing::splat);
        let [old, new] = [SpzVersion::V3, SpzVersion::V4].map(|version| {
            let mut bytes = Vec::new();
            write(&scene, version, &mut bytes).unwrap();
            if version == SpzVersion::V4 {
                assert_eq!(bytes[15], if degree == 0 { 5 } else { 6 });
            }
            parse(&bytes).unwrap()
        });
        assert_eq!((old.count(), old.identity()), (3000, new.identity()), "degree {degree}");
    }
}

#[test]
fn damage_of_version_4_names_the_byte_and_the_field() {
    let with = |at: usize, byte: u8| {
        let mut bytes = streams(0, &[]);
        bytes[at] = byte;
        said(&bytes)
    };
    assert_eq!(with(4, 5), "byte 4, `version`: expected 4, found 5");
    assert_eq!(with(15, 6), "byte 15, `numStreams`: expected 5 for shDegree 0, found 6");
    assert!(with(16, 31).starts_with("byte 16, `tocByteOffset`: expected 32 to "));
    assert_eq!(with(40, 8), "byte 40, `positions`: expected 9 unpacked bytes for 1 splats, found 8");
    assert!(with(33, 1).starts_with("byte 32, `positions`: the file is truncated: expected "));
    says(with(32 + 5 * 16, 0), "byte 112, `positions`: expected an intact compressed stream, found damage");
    says(said(&[streams(0, &[]), vec![0]].concat()), "found 1 bytes");
    says(said(&gzip(&streams(0, &[]))), "found SPZ of version 4 in a gzip file (unpack it first)");
    // Every written stream has a checksum, which reveals any damage that changes a value.
    let scene = Scene::generate(300, 1, crate::testing::splat);
    let mut written = Vec::new();
    write(&scene, SpzVersion::V4, &mut written).unwrap();
    let first = LONG_HEADER + 6 * ENTRY;
    for at in (first..written.len()).step_by(7) {
        let mut damaged = written.clone();
        damaged[at] ^= 1 << (at % 8);
        let same = |found: Scene| found.identity() == parse(&written).unwrap().identity();
        assert!(parse(&damaged).map_or(true, same), "byte {at}");
    }
    let last = written.len() - 1;
    written[last] ^= 1;
    says(said(&written), "`sh`: expected an intact compressed stream, found damage: its checksum differs");
    says(said(&written[..last]), "`sh`: the file is truncated: expected ");
    let mut promise = streams(0, &[]);
    promise[8..12].fill(0x7F);
    assert!(said(&promise).starts_with("byte 8, `numPoints`: expected at most "));
}

#[test]
fn the_capture_has_the_splats_of_the_plain_capture_within_its_steps() {
    let test = "the_capture_has_the_splats_of_the_plain_capture_within_its_steps";
    let Some(captures) = captures(test) else { return };
    let load = |name: &str| Scene::load(captures.join(name), crate::QUIET).unwrap();
    let [packed, plain] = ["biker.spz", "biker.ply"].map(load);
    assert_eq!(packed.count(), plain.count());
    for index in 0..packed.count() as usize {
        let (a, b) = (packed.splat(index), plain.splat(index));
        let near = |a: &[f32], b: &[f32], step: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step);
        let logarithm = |scale: f32| scale.ln().clamp(-10.0, 5.9375);
        let turn: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| a * b).sum();
        assert!(
            near(&a.position, &b.position, 0.5 / 4096.0 + 1e-5)
                && near(&a.scale.map(logarithm), &b.scale.map(logarithm), 0.5 / 16.0 + 1e-4)
                && turn.abs() > 0.99998
                && near(&[a.opacity], &[b.opacity], 0.5 / 255.0 + 1e-5)
                && near(
                    &a.sh[..3],
                    &b.sh[..3].iter().map(|c| c.clamp(-3.34, 3.34)).collect::<Vec<_>>(),
                    0.5 / 255.0 / 0.15 + 1e-4
                ),
            "splat {index}: {a:?} and {b:?}"
        );
    }
}
