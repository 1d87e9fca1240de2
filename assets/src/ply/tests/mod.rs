//! Reads whole PLY files, valid and damaged.

mod damage;
mod properties;

use super::write::property_names;
use crate::input::{Input, OpenFile, Source};
use crate::testing::{captures, golden, parse, says, splat, written};
use crate::{Scene, SceneFormat, Similarity, sh_floats};
use std::path::PathBuf;

pub(crate) struct Made {
    pub format: &'static str,
    pub kind: &'static str,
    pub degree: u32,
    pub count: usize,
    pub reversed: bool,
    /// True for faces with lists before and after the splats.
    pub faces: bool,
    pub line_end: &'static str,
}

pub(crate) const PLAIN: Made = Made {
    format: "binary_little_endian",
    kind: "float",
    degree: 1,
    count: 20,
    reversed: false,
    faces: false,
    line_end: "\n",
};

/// Computes the stored value of a splat's property.
fn raw(index: usize, name: &str) -> f64 {
    let t = index as f64;
    match name.rsplit_once('_').map(|(stem, n)| (stem, n.parse::<f64>().unwrap())) {
        None if name == "opacity" => t * 0.25 - 2.0,
        None => t + name.len() as f64 * 0.5 + name.as_bytes()[0] as f64,
        Some(("scale", n)) => -3.0 - 0.125 * n - t * 0.0625,
        Some(("rot", n)) => {
            if n == 2.0 {
                2.0
            } else {
                0.0
            }
        }
        Some(("f_dc", n)) => 0.5 + n,
        Some((_, n)) => n * 0.25 - t * 0.5,
    }
}

impl Made {
    fn put(&self, out: &mut Vec<u8>, value: f64) {
        let little = self.format != "binary_big_endian";
        match (self.format, self.kind) {
            ("ascii", _) => out.extend_from_slice(format!("{value} ").as_bytes()),
            (_, "double") => out.extend(if little { value.to_le_bytes() } else { value.to_be_bytes() }),
            _ => out.extend(if little { (value as f32).to_le_bytes() } else { (value as f32).to_be_bytes() }),
        }
    }

    /// Appends two faces, with lists of 3 and 4 indices, and a byte of flags each.
    fn put_faces(&self, out: &mut Vec<u8>) {
        for n in [3u8, 4] {
            match self.format {
                "ascii" => {
                    let indices = " 7".repeat(n.into());
                    out.extend_from_slice(format!("{n}{indices} 9{}", self.line_end).as_bytes());
                }
                _ => {
                    out.push(n);
                    out.extend(std::iter::repeat_n(7u8, 4 * usize::from(n)));
                    out.push(9);
                }
            }
        }
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut names = property_names(self.degree);
        if self.reversed {
            names.reverse();
        }
        let face = |name: &str| {
            format!("element {name} 2\nproperty list uchar int vertex_indices\nproperty uchar flags\n")
        };
        let properties: String = names.iter().map(|n| format!("property {} {n}\n", self.kind)).collect();
        let header = format!(
            "ply\nformat {} 1.0\ncomment made for a test\nobj_info none\n{}element vertex {}\n{properties}{}end_header\n",
            self.format,
            if self.faces { face("before") } else { String::new() },
            self.count,
            if self.faces { face("after") } else { String::new() },
        );
        let mut out = header.replace('\n', self.line_end).into_bytes();
        if self.faces {
            self.put_faces(&mut out);
        }
        for index in 0..self.count {
            for name in &names {
                self.put(&mut out, raw(index, name));
            }
            if self.format == "ascii" {
                out.extend_from_slice(self.line_end.as_bytes());
            }
        }
        if self.faces {
            self.put_faces(&mut out);
        }
        out
    }
}

fn error(bytes: &[u8]) -> String {
    parse(bytes).unwrap_err().to_string()
}

fn edited(made: &Made, from: &str, to: &str) -> Vec<u8> {
    let bytes = made.bytes();
    let at =
        bytes.windows(from.len()).position(|w| w == from.as_bytes()).expect("the text to replace is there");
    [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
}

#[test]
fn every_encoding_order_and_type_gives_the_same_scene() {
    for degree in 0..=3 {
        let plain = Made { degree, ..PLAIN };
        let expected = parse(&plain.bytes()).unwrap();
        assert_eq!((expected.count(), expected.stored_degree()), (20, degree));
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            for kind in ["float", "double"] {
                for (reversed, faces, line_end) in
                    [(false, true, "\n"), (true, false, "\r\n"), (true, true, "\r\n")]
                {
                    let made = Made { format, kind, degree, reversed, faces, line_end, ..PLAIN };
                    let bytes = made.bytes();
                    let scene = parse(&bytes).unwrap();
                    assert_eq!(scene.identity(), expected.identity(), "{format} {kind} {reversed} {faces}");
                    assert_eq!(scene.size_breakdown().sum(), bytes.len() as u64);
                    assert_eq!(scene.size_breakdown().trailing_bytes, 0);
                }
            }
        }
    }
}

#[test]
fn only_scalars_of_binary_files_have_a_size_per_row() {
    let per_row = |made: Made| {
        let scene = parse(&made.bytes()).unwrap();
        let fields = &scene.size_breakdown().elements[0].fields;
        fields.iter().map(|field| (field.bytes, field.bytes_per_row)).collect::<Vec<_>>()
    };
    // Lists of 3 and 4 indices have 13 and 17 bytes.
    let faces = Made { faces: true, ..PLAIN };
    assert_eq!(per_row(Made { ..faces }), [(30, None), (2, Some(1))]);
    assert_eq!(per_row(Made { format: "ascii", ..faces }), [(9, None), (2, None)]);
}

#[test]
fn values_are_activated_and_harmonics_interleaved() {
    let scene = parse(&Made { degree: 2, ..PLAIN }.bytes()).unwrap();
    let s = scene.splat(3);
    assert_eq!(s.position, ["x", "y", "z"].map(|n| raw(3, n) as f32));
    assert_eq!(s.scale, [0, 1, 2].map(|n| raw(3, &format!("scale_{n}")).exp() as f32));
    assert_eq!(s.opacity, (1.0 / (1.0 + 1.25f64.exp())) as f32);
    assert_eq!(s.rotation, [0.0, 0.0, 1.0, 0.0]);
    assert_eq!(scene.quaternion_norms().min, 2.0);
    assert_eq!(s.sh[..3], [0.5, 1.5, 2.5]);
    // Coefficient 5 of green is f_rest_(8 + 4).
    assert_eq!(s.sh[3 * 5 + 1], raw(3, "f_rest_12") as f32);
    assert_eq!(s.sh[sh_floats(2)..], [0.0; 21]);
}

#[test]
fn the_3d_filter_of_mip_splatting_is_applied() {
    let mut bytes = PLAIN.bytes();
    let plain = parse(&bytes).unwrap();
    // Behind all other properties: each row grows by the filter's float.
    let row = property_names(1).len() * 4;
    let start = bytes.len() - PLAIN.count * row;
    let rows = bytes.split_off(start);
    let header = String::from_utf8(bytes).unwrap();
    let mut bytes = header.replacen("end_header", "property float filter_3D\nend_header", 1).into_bytes();
    for row in rows.chunks(row) {
        bytes.extend([row, &0.25f32.to_le_bytes()].concat());
    }
    let scene = parse(&bytes).unwrap();
    assert_eq!(scene.notes().low_pass, crate::scene::Filter::Mip);
    for index in 0..PLAIN.count {
        let (before, after) = (plain.splat(index), scene.splat(index));
        let mut opacity = f64::from(before.opacity);
        for (before, after) in before.scale.into_iter().zip(after.scale) {
            let filtered = f64::from(before * before + 0.0625).sqrt();
            assert!((f64::from(after) - filtered).abs() < 1e-7, "{after}, expected {filtered}");
            opacity *= f64::from(before) / filtered;
        }
        assert!((f64::from(after.opacity) - opacity).abs() < 1e-7);
        assert_eq!((before.position, before.sh), (after.position, after.sh));
    }
    assert_eq!(scene.size_breakdown().elements[0].fields.iter().filter(|field| !field.used).count(), 3);
}

#[test]
fn splats_that_move_or_have_another_kernel_are_refused() {
    for (name, expected) in [
        (
            "trbf_center",
            "this is a scene of Spacetime Gaussians, which move; export its splats at one moment",
        ),
        ("scale_t_0", "4D Gaussians"),
        ("shape_0", "generalised exponentials"),
        ("beta", "Deformable Beta Splatting; only 3D Gaussians are drawn"),
        ("f_anchor_feat_0", "a network computes"),
    ] {
        says(error(&edited(&PLAIN, "end_header", &format!("property float {name}\nend_header"))), expected);
    }
    let delta = "element delta_vertex_1 1\nproperty uchar x\nend_header";
    says(error(&edited(&PLAIN, "end_header", delta)), "moving splats (Brush)");
}

#[test]
fn names_with_the_prefix_of_cloudcompare_are_read() {
    let text = String::from_utf8(Made { format: "ascii", ..PLAIN }.bytes()).unwrap();
    let plain = parse(text.as_bytes()).unwrap();
    for prefix in ["scalar_", "scal_", "scalar_scal_"] {
        let mut named = text.clone();
        for name in ["scale_", "rot_", "opacity", "f_dc_", "f_rest_"] {
            named = named.replace(&format!("float {name}"), &format!("float {prefix}{name}"));
        }
        assert_eq!(parse(named.as_bytes()).unwrap().identity(), plain.identity(), "{prefix}");
    }
}

#[test]
fn bytes_of_a_colour_stand_for_band_0() {
    let made = Made { format: "ascii", degree: 0, count: 1, ..PLAIN };
    let mut text = String::from_utf8(made.bytes()).unwrap();
    for (name, color) in [("f_dc_0", "red"), ("f_dc_1", "green"), ("f_dc_2", "blue")] {
        text = text.replace(&format!("float {name}"), &format!("uchar {color}"));
    }
    let splat = parse(text.replace(" 0.5 1.5 2.5 ", " 255 0 51 ").as_bytes()).unwrap().splat(0);
    let expected = crate::activation::flat([1.0, 0.0, 0.2]);
    assert_eq!(splat.sh, expected);
    says(error(text.replace("uchar red", "float red").as_bytes()), "no property `f_dc_0`");
}

#[test]
fn bands_above_3_are_cut() {
    let made = Made { format: "ascii", degree: 3, ..PLAIN };
    let text = String::from_utf8(made.bytes()).unwrap();
    // Coefficient k of channel c becomes f_rest_(24 c + k).
    let mut wide = String::new();
    for line in text.lines() {
        match line.strip_prefix("property float f_rest_") {
            Some(number) => {
                let number: usize = number.parse().unwrap();
                let moved = number / 15 * 24 + number % 15;
                wide += &format!("property float f_rest_{moved}\n");
            }
            None => wide += &format!("{line}\n"),
        }
    }
    let (missing, values): (Vec<_>, Vec<_>) = (0..72)
        .filter(|number| number % 24 >= 15)
        .map(|number| (format!("property float f_rest_{number}\n"), "7"))
        .unzip();
    let (header, rows) = wide.split_once("end_header\n").unwrap();
    let rows: String = rows.lines().map(|row| format!("{row}{}\n", values.join(" "))).collect();
    let scene = parse(format!("{header}{}end_header\n{rows}", missing.concat()).as_bytes()).unwrap();
    assert_eq!((scene.stored_degree(), scene.notes().cut_degree), (3, Some(4)));
    assert_eq!(scene.identity(), parse(text.as_bytes()).unwrap().identity());
}

#[test]
fn values_that_are_not_numbers_drop_their_splat_under_the_right_reason() {
    let names = property_names(1);
    let base = PLAIN.bytes();
    let start = base.len() - PLAIN.count * names.len() * 4;
    let with = |changes: &[(&str, f32)]| {
        let mut bytes = base.clone();
        for (name, value) in changes {
            let column = names.iter().position(|n| n == name).unwrap();
            let at = start + (7 * names.len() + column) * 4;
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        let scene = parse(&bytes).unwrap();
        (scene.count(), scene.dropped().to_string())
    };
    assert_eq!(with(&[("y", f32::NAN)]), (19, "1 with a position not finite in f32".into()));
    // Flat splats have a scale of 0, whose logarithm is -inf.
    assert_eq!(with(&[("scale_2", f32::NEG_INFINITY)]), (20, "none".into()));
    assert_eq!(with(&[("scale_2", 1e4)]), (19, "1 with a scale not finite in f32".into()));
    assert_eq!(with(&[("rot_0", f32::INFINITY)]), (19, "1 with a quaternion not finite in f32".into()));
    assert_eq!(with(&[("rot_2", 0.0)]), (19, "1 with a zero quaternion".into()));
    assert_eq!(with(&[("opacity", f32::NAN)]), (19, "1 with an opacity not finite in f32".into()));
    // SPZ decoders write infinite logits for opacities of 0 and 1.
    for infinite in [f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(with(&[("opacity", infinite)]), (20, "none".into()));
    }
    assert_eq!(with(&[("f_rest_8", f32::NAN)]), (19, "1 with a colour not finite in f32".into()));
    // Normals are not used.
    assert_eq!(with(&[("nx", f32::NAN)]), (20, "none".into()));
}

#[test]
fn doubles_beyond_f32_drop_their_splat_and_are_counted() {
    let made = Made { kind: "double", degree: 0, ..PLAIN };
    let mut bytes = made.bytes();
    let at = bytes.len() - PLAIN.count * property_names(0).len() * 8;
    bytes[at..at + 8].copy_from_slice(&1e40f64.to_le_bytes());
    let scene = parse(&bytes).unwrap();
    assert_eq!(
        (scene.count(), scene.dropped().to_string()),
        (19, "1 with a position not finite in f32".into())
    );
    let text = String::from_utf8(Made { format: "ascii", ..made }.bytes()).unwrap();
    let scene =
        parse(text.replacen("end_header\n", "end_header\n-2e39 ", 1).replacen(" 122.5 ", " ", 1).as_bytes());
    assert_eq!(scene.unwrap().dropped().position, 1);
}

/// Returns a file of splats around `place`, as doubles; the first is far from the others.
fn surveyed(format: &'static str, place: [f64; 3]) -> Vec<u8> {
    let made = Made { format, kind: "double", degree: 0, count: 3000, ..PLAIN };
    let position = |index: usize, axis: usize| {
        let near = place[axis] + 0.001 * ((index * (axis + 3)) % 5000) as f64;
        if index == 0 { -7e8 } else { near }
    };
    let names = property_names(0);
    let mut bytes = made.bytes();
    let header = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    bytes.truncate(header);
    for index in 0..made.count {
        for name in &names {
            let axis = ["x", "y", "z"].iter().position(|axis| axis == name);
            made.put(&mut bytes, axis.map_or_else(|| raw(index % 20, name), |axis| position(index, axis)));
        }
        if format == "ascii" {
            bytes.push(b'\n');
        }
    }
    bytes
}

#[test]
fn doubles_far_from_the_origin_keep_the_digits_that_f32_has_not() {
    let place = [5_340_123.25, -410_777.5, 120.0];
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let scene = parse(&surveyed(format, place)).unwrap();
        // A multiple of 1,024 near the median, which the outlier does not move. The third axis is near the origin.
        assert_eq!(scene.offset(), [5_340_160.0, -410_624.0, 0.0], "{format}");
        for index in [1, 17, 2999] {
            for (axis, place) in place.iter().enumerate() {
                let exact = place + 0.001 * ((index * (axis + 3)) % 5000) as f64;
                let found = f64::from(scene.positions()[index][axis]) + scene.offset()[axis];
                assert!((found - exact).abs() < 1e-5, "{format}, axis {axis}: {found}, expected {exact}");
            }
        }
        assert_eq!(scene.positions()[0][1], (-7e8 + 410_624.0) as f32);
    }
}

#[test]
fn a_scene_with_an_offset_is_written_in_the_coordinates_of_the_world() {
    let scene = parse(&surveyed("ascii", [5e6, 5e6, 0.0])).unwrap();
    let bytes = written(&scene, SceneFormat::Ply);
    let back = parse(&bytes).unwrap();
    assert_eq!(scene.offset()[0], 5_000_192.0);
    assert_eq!((back.offset(), back.positions()), (scene.offset(), scene.positions()));
    assert_eq!(back.size_breakdown().file_bytes, bytes.len() as u64);
    says(back.size_breakdown(), "double");
}

#[test]
fn comments_of_the_header_are_kept_by_copies_in_both_layouts_unless_they_fill_it() {
    let scene = |lines: &str| parse(&edited(&PLAIN, "obj_info none\n", lines)).unwrap();
    let lines = "comment by  Jane\nobj_info inventory 7\n";
    let changed = scene(lines).picked(&[3, 5]).unwrap().cut_to_degree(0).unwrap();
    let changed = changed.transformed(&Similarity { scale: 2.0, ..Similarity::IDENTITY }).unwrap();
    for format in [SceneFormat::Ply, SceneFormat::CompressedPly] {
        let back = parse(&written(&changed, format)).unwrap();
        assert_eq!(
            back.header_comments(),
            ["comment made for a test", "comment by Jane", "obj_info inventory 7"]
        );
        assert_eq!(back.size_breakdown().comments, ["made for a test", "by Jane", "inventory 7"]);
    }
    let long = scene(&format!("comment {}\n", "a".repeat(40_000)));
    assert!(long.header_comments().is_empty() && !long.size_breakdown().comments.is_empty());
}

#[test]
fn quaternions_of_any_length_but_zero_are_rotations() {
    let made = Made { degree: 0, kind: "double", ..PLAIN };
    let plain = parse(&made.bytes()).unwrap();
    let names = property_names(0);
    let column = names.iter().position(|name| name == "rot_2").unwrap();
    let mut bytes = made.bytes();
    let start = bytes.len() - made.count * names.len() * 8;
    for (row, length) in [1e-45f64, 1e-40, 1e-20, 1e20, 3e38].into_iter().enumerate() {
        let at = start + (row * names.len() + column) * 8;
        bytes[at..at + 8].copy_from_slice(&length.to_le_bytes());
    }
    let scene = parse(&bytes).unwrap();
    assert_eq!((scene.dropped().total(), scene.rotations()), (0, plain.rotations()));
    let at = start + column * 8;
    bytes[at..at + 8].copy_from_slice(&0f64.to_le_bytes());
    assert_eq!(parse(&bytes).unwrap().dropped().zero_rotation, 1);
}

#[test]
fn a_scene_that_exceeds_the_memory_is_refused_from_its_header() {
    let bytes = Made { degree: 3, count: 1000, ..PLAIN }.bytes();
    let source = Source::Bytes(&bytes);
    let with = |memory| super::read::parse(&Input::new(&source, Some(memory), crate::QUIET));
    let said = with(200_000).unwrap_err().to_string();
    assert!(
        said.contains("found 1000 splats of degree 3, which need") && said.contains("of 195.3 KiB available"),
        "{said}"
    );
    let enough = Scene::host_bytes(1000, 3) + (rayon::current_num_threads() as u64) * (1 << 20);
    assert_eq!(with(enough).unwrap().count(), 1000);
    assert!(with(enough - 1).is_err());
}

/// Creates a sparse file of `count` splats with properties of one byte. Its rows use no disk space.
#[cfg(unix)]
fn sparse(folder: &std::path::Path, count: u64) -> std::path::PathBuf {
    let properties: String = property_names(3).iter().map(|n| format!("property uchar {n}\n")).collect();
    let header =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n");
    let path = folder.join(format!("{count}.ply"));
    std::fs::write(&path, &header).unwrap();
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    file.set_len(header.len() as u64 + 62 * count).unwrap();
    path
}

#[cfg(unix)]
#[test]
fn more_rows_of_bytes_than_any_memory_or_index_holds_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = sparse(folder.path(), 1 << 32);
    says(
        Scene::load(&path, crate::QUIET).unwrap_err(),
        "at most 4,294,967,295 splats, which 32 bits can index, found 4294967296",
    );
    let path = sparse(folder.path(), (1 << 32) - 1);
    let file = OpenFile::open(&path).unwrap();
    let source = Source::File(&file);
    let said = super::read::parse(&Input::new(&source, Some(64 << 30), crate::QUIET));
    says(said.unwrap_err(), "4294967295 splats of degree 3, which need 992.0 GiB, of 64.0 GiB available");
}

#[test]
fn elements_without_bytes_have_as_many_rows_as_they_like() {
    let huge = u64::MAX;
    let bytes = edited(&PLAIN, "element vertex", &format!("element nothing {huge}\nelement vertex"));
    assert_eq!(parse(&bytes).unwrap().count(), 20);
    says(
        error(&edited(&PLAIN, "element vertex", "element nothing 18446744073709551616\nelement vertex")),
        "expected the number of rows, found `18446744073709551616`",
    );
    let ascii = Made { format: "ascii", degree: 0, ..PLAIN };
    says(
        error(&edited(&ascii, "element vertex", &format!("element nothing {huge}\nelement vertex"))),
        "expected the end of the line",
    );
}

#[test]
fn a_line_of_text_has_a_limit() {
    let ascii = Made { format: "ascii", degree: 0, ..PLAIN };
    let mut bytes = ascii.bytes();
    bytes.extend(std::iter::repeat_n(b'7', super::ascii::MAX_LINE + 1));
    // Nothing after the last row is read.
    assert_eq!(parse(&bytes).unwrap().count(), 20);
    let long = " ".repeat(super::ascii::MAX_LINE + 1);
    let text =
        String::from_utf8(ascii.bytes()).unwrap().replacen("end_header\n", &format!("end_header\n{long}"), 1);
    says(error(text.as_bytes()), "line 24: expected a line of at most 16777216 bytes, found more");
}

#[test]
fn large_files_of_text_and_bytes_give_the_same_scene() {
    let of = |format| Made { format, count: 24_000, degree: 1, faces: true, ..PLAIN }.bytes();
    let [text, binary] = ["ascii", "binary_big_endian"].map(of);
    assert!(text.len() > 2 << 20 && binary.len() > 2 << 20);
    assert_eq!(parse(&text).unwrap().identity(), parse(&binary).unwrap().identity());
}

#[test]
fn a_file_of_nothing_but_bad_splats_is_an_error_that_counts_them() {
    let made = Made { count: 3, degree: 0, format: "ascii", ..PLAIN };
    let text = String::from_utf8(made.bytes()).unwrap();
    let (header, rows) = text.split_once("end_header\n").unwrap();
    let rows: String = rows.lines().map(|r| format!("nan{}\n", &r[r.find(' ').unwrap()..])).collect();
    says(
        error(format!("{header}end_header\n{rows}").as_bytes()),
        "none of the 3 splats can be drawn: 3 with a position not finite in f32",
    );
}

#[test]
fn bytes_after_the_last_row_are_counted_and_skipped() {
    let mut bytes = PLAIN.bytes();
    bytes.extend_from_slice(b"more");
    let scene = parse(&bytes).unwrap();
    assert_eq!(
        (scene.size_breakdown().trailing_bytes, scene.size_breakdown().sum()),
        (4, bytes.len() as u64)
    );
}

#[test]
fn a_scene_written_and_read_back_is_the_same_but_for_rounding() {
    for degree in 0..=3 {
        let scene = Scene::generate(20_000, degree, |i| {
            let mut s = splat(i);
            match i {
                0 => s.opacity = 0.0,
                1 => s.opacity = 1.0,
                2 => s.scale[1] = 0.0,
                _ => {}
            }
            s
        });
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        scene.write_ply(&path).unwrap();
        let size = std::fs::metadata(&path).unwrap().len();
        let back = Scene::load(&path, crate::QUIET).unwrap();
        assert_eq!(
            (back.size_breakdown(), size),
            (scene.size_breakdown(), scene.size_breakdown().file_bytes)
        );
        assert_eq!((back.positions(), back.sh()), (scene.positions(), scene.sh()));
        for (read, wrote) in back.opacities().iter().zip(scene.opacities()) {
            assert!((read - wrote).abs() <= 1e-6 * wrote, "{read} {wrote}");
        }
        for (read, wrote) in back.scales().as_flattened().iter().zip(scene.scales().as_flattened()) {
            assert!((read - wrote).abs() <= 1e-6 * wrote, "{read} {wrote}");
        }
    }
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let said = Scene::load("no/such.ply", crate::QUIET).unwrap_err().to_string();
    assert!(said.starts_with("no/such.ply: cannot be read: "), "{said}");
    says(Scene::load(".", crate::QUIET).unwrap_err(), "folder");
}

#[test]
fn the_captures_load_whole_and_their_size_breakdowns_sum_to_their_sizes() {
    let check = |path: PathBuf, count, degrees| {
        let scene = Scene::load(&path, crate::QUIET).unwrap();
        assert_eq!((scene.count(), scene.dropped().total()), (count, 0), "{}", path.display());
        assert_eq!((scene.stored_degree(), scene.effective_degree()), degrees, "{}", path.display());
        assert_eq!(scene.size_breakdown().sum(), std::fs::metadata(&path).unwrap().len());
    };
    check(golden().join("rules.ply"), 1_067, (3, 3));
    let test = "the_captures_load_whole_and_their_size_breakdowns_sum_to_their_sizes";
    let Some(captures) = captures(test) else { return };
    check(captures.join("biker.ply"), 152_746, (0, 0));
    check(captures.join("playbot-31k.ply"), 31_000, (3, 2));
}
