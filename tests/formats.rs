//! Scenes in other formats: converted, drawn and compared by the program.

use crate::common;
use crate::place::Place;
use serde_json::{Value, json};
use splatgraph_assets::{QUIET, Scene, SceneFormat, SpzVersion, grouped};

/// Draws two scenes with the exact renderer, into `a/` and `b/`. Returns the minimum PSNR over the cameras, in dB;
/// infinite if all pictures are equal.
fn least_psnr(place: &Place, [a, b]: [&str; 2], cameras: &str) -> f64 {
    for (scene, pictures) in [(a, "a"), (b, "b")] {
        let render = format!("render {scene} --backend reference --cameras {cameras} --size 240x135");
        place.done(&format!("{render} --format npy -o {pictures}"));
    }
    let compared = place.told("compare --json a b");
    let psnr = |picture: &Value| picture["psnr_db"].as_f64().unwrap_or(f64::INFINITY);
    let pictures = compared["pictures"].as_array().unwrap_or_else(|| panic!("no pictures in {compared}"));
    assert!(!pictures.is_empty());
    pictures.iter().map(psnr).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_scene_is_converted_to_spz_compressed_ply_and_splat_and_drawn_alike() {
    let place = Place::demo(5000);
    // The demo scene's harmonics exceed the range of most formats.
    for (to, least) in [("spz", 15.0), ("compressed.ply", 25.0), ("splat", 12.0)] {
        let name = format!("converted.{to}");
        let text = place.done(&format!("convert scene.ply {name}"));
        let bytes = std::fs::metadata(place.at(&name)).expect("it is there").len();
        assert!(text.contains(&format!("{} bytes", splatgraph_assets::grouped(bytes))), "{text}");
        // The format is detected from the contents, not from the name.
        std::fs::rename(place.at(&name), place.at("converted.bin")).expect("it is there");
        let info = place.done("info converted.bin");
        assert!(info.contains("5,000 splats"), "{info}");
        let psnr = least_psnr(&place, ["scene.ply", "converted.bin"], "cameras.json");
        assert!(psnr > least, "{to}: {psnr} dB");
    }
}

#[test]
fn a_conversion_between_two_ply_files_says_what_activation_loses() {
    let place = Place::demo(500);
    let text = place.done("convert scene.ply same.ply");
    assert!(!text.contains("lost:"), "{text}");
    // Two floats more per row, quaternions of length 2, and the first logit as 20.
    let bytes = std::fs::read(place.at("scene.ply")).expect("it is there");
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|window| window == end).expect("a header") + end.len();
    let header = String::from_utf8(bytes[..at].to_vec()).expect("text");
    let rows = bytes[at..].chunks_exact(248).enumerate().flat_map(|(index, row)| {
        let floats = row.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("4 bytes")));
        let mut floats: Vec<f32> = floats.collect();
        floats[58..].iter_mut().for_each(|c| *c *= 2.0);
        floats[54] = [20.0, f32::NEG_INFINITY].get(index).copied().unwrap_or(0.5);
        floats[57] = if index == 2 { f32::NEG_INFINITY } else { floats[57] };
        floats.extend([3.0, 4.0]);
        floats.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>()
    });
    let more = header.replace("end_header", "property float segment\nproperty float gain\nend_header");
    let trained: Vec<u8> = more.into_bytes().into_iter().chain(rows).collect();
    std::fs::write(place.at("trained.ply"), trained).expect("it is written");
    let text = place.done("convert trained.ply same.ply");
    for lost in [
        "lost: properties that splats do not have: segment, gain\n",
        "lost, but in no picture: the lengths of quaternions: 500 other than 1, in a range of 2.000 to 2.000",
        "lost, but in no picture: logits above 9.9, in 1 splat: rounded",
        "lost, but in no picture: logits of opacity 0, in 1 splat: written as -104",
        "lost, but in no picture: logarithms of scale 0, in 1 splat: written as -104",
    ] {
        assert!(text.contains(lost), "{lost}: {text}");
    }
    let (_, errors) = place.said("info trained.ply");
    assert!(errors.contains("properties that are not read, although they may matter: gain\n"), "{errors}");
    assert!(!place.done("convert same.ply again.ply").contains("quaternions"));
}

#[test]
fn a_conversion_says_what_is_lost_and_what_cannot_be_written() {
    let place = Place::demo(5000);
    let text = place.done("convert scene.ply cut.ply --degree 0");
    assert!(text.contains("lost: harmonics: cut from degree 3 to 0"), "{text}");
    let text = place.done("convert scene.ply clipped.spz");
    assert!(text.contains(" clipped to 1 or -1"), "{text}");
    assert_eq!(place.told("info cut.ply --json")["report"]["stored_sh_degree"], 0);
    let mut tagged = std::fs::read(place.at("cut.ply")).expect("it is there");
    let comment = b"comment SplatRenderMode: mip\n";
    tagged.splice(4..4, comment.iter().copied());
    std::fs::write(place.at("mip.ply"), tagged).expect("it is written");
    let text = place.done("convert mip.ply mip.spz");
    assert!(text.contains("lost: the tag low_pass mip: the file has compensated instead"), "{text}");
    let merged = place.done("convert mip.ply merged.ply --merge cut.ply");
    assert!(merged.contains("lost: tags in which the merged scenes differ: low_pass\n"), "{merged}");
    assert!(merged.contains(" % of the 2 originals\n"), "{merged}");
    let merged = place.done("convert mip.ply merged.ply --merge cut.ply --tag low_pass=mip --tag up=z");
    assert!(!merged.contains("lost: tags"), "{merged}");
    let tags = place.done("info merged.ply");
    assert!(tags.contains("low_pass mip") && tags.contains("up 0,0,1"), "{tags}");
    let text = place.done("convert cut.ply filtered.spz --tag low_pass=compensated --tag up=0,2,0");
    assert!(text.contains("lost: the tag up 0,1,0: without it, the scene is shown upside down"), "{text}");
    assert!(place.done("info filtered.spz").contains("low_pass compensated"));
    let text = place.done("convert scene.ply sorted.compressed.ply");
    assert!(text.contains("lost: the order of the splats: they follow a Morton curve"), "{text}");
    place.refuses(
        "convert",
        &[
            ("scene.ply out.xyz", 2, "ends in .ply, .compressed.ply, .spz, .splat"),
            ("scene.ply out.ksplat", 2, "found out.ksplat"),
            (
                "scene.ply out.gltf",
                2,
                "ends in .glb, the form that is written, found out.gltf; name it out.glb",
            ),
            ("scene.ply ./scene.ply", 2, "would overwrite the scene"),
            ("- out.spz", 2, "expected a file as the scene, found `-`: standard input is not read"),
            ("cameras.json out.spz", 1, "), found JSON text"),
            ("scene.ply out.sog --format spz", 2, "--format differs from the extension of out.sog"),
            ("scene.ply out --format spz --format sog", 2, "expected one --format for out, found several"),
            ("scene.ply out.ply --where 'opacity > 2'", 1, "expected --crop and --where to keep a splat"),
            (
                "scene.ply out.ply -c none.json",
                2,
                "expected --price or --write-cameras with --cameras, found none",
            ),
            ("scene.ply out.ply --size 9x9", 2, "expected --price with --size, found none"),
            ("scene.ply out.ply --tag low_pass=soft", 2, "expected low_pass=dilated, low_pass=compensated"),
            ("scene.ply out.ply --tag up=", 2, "expected an axis such as z or -y"),
            (
                "scene.ply out.ply -c cameras.json --write-cameras cameras.json",
                2,
                "would overwrite the cameras",
            ),
        ],
    );
}

#[test]
fn what_files_of_gltf_lose_is_told_and_cameras_that_are_written_are_no_loss() {
    let place = Place::demo(50);
    place.done("convert scene.ply plain.glb --degree 0");
    let glb = place.bytes("plain.glb");
    let end = 20 + u32::from_le_bytes([glb[12], glb[13], glb[14], glb[15]]) as usize;
    let mut document: Value = serde_json::from_slice(&glb[20..end]).expect("JSON");
    document["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.1 } }]);
    document["nodes"][0]["camera"] = json!(0);
    document["buffers"][0]["uri"] = json!("s.bin");
    place.write("s.gltf", document.to_string());
    place.write("s.bin", &glb[end + 8..]);
    let cameras = "cameras: 1; `--cameras` reads them, and `convert --write-cameras` writes them\n";
    assert!(place.done("info s.gltf").contains(cameras));
    assert!(place.done("convert s.gltf out.spz").contains(&format!("  lost: {cameras}")));
    assert!(place.fails("convert s.gltf out.glb --strict", 1).contains("found cameras: 1"));
    place.done("convert s.gltf out.glb --strict -c s.gltf --write-cameras out.json");
    let others = "convert s.gltf out.glb --strict -c cameras.json --write-cameras others.json";
    assert!(place.fails(others, 1).contains("found cameras: 1"));

    let mesh = r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
    place.write("m.gltf", mesh);
    place.write("all.ron", r#"Scenes([Scene(file: "scene.ply"), Scene(file: "m.gltf")])"#);
    let render = "-c cameras.json#0 --size 16x9 --backend reference -o out.png";
    for (line, told) in [
        (format!("render scene.ply m.gltf {render}"), "m.gltf: left out: vertex colours\n"),
        ("info all.ron".to_owned(), "all.ron: left out: vertex colours (m.gltf)\n"),
    ] {
        let errors = place.said(&line).1;
        assert!(errors.contains(told), "{errors}");
    }
}

#[test]
fn losses_are_listed_for_each_scene_and_may_be_refused() {
    let place = Place::demo(300);
    let whole = std::fs::read(place.at("scene.ply")).expect("a scene");
    let replaced = |from: &str, to: &str| {
        let at = whole.windows(from.len()).position(|bytes| bytes == from.as_bytes()).expect("it is there");
        [&whole[..at], to.as_bytes(), &whole[at + from.len()..]].concat()
    };
    let owned = "element vertex 300\ncomment Copyright ACME 2026\nobj_info by Jane";
    place.write("owned.ply", replaced("element vertex 300", owned));
    place.write("short.ply", replaced("element vertex 300", "element vertex 100"));
    let words = "comments: `Copyright ACME 2026`, `by Jane`\n";
    let kept = place.done("convert owned.ply kept.ply --strict --transform rotate:1,0,0,90 --order morton");
    assert!(!kept.contains("comments"), "{kept}");
    assert!(place.done("info kept.ply").contains("    Copyright ACME 2026\n    by Jane\n"));
    let (told, errors) = place.said("convert short.ply out.ply --merge owned.ply");
    // Rows of degree 3 have 62 floats.
    let after = "49,600 bytes after the last row that the header declares\n";
    assert!(told.contains(&format!("  lost: short.ply: {after}")), "{told}");
    assert!(errors.contains(&format!("short.ply: not read: {after}")), "{errors}");
    assert!(told.contains(&format!("  lost: owned.ply: {words}")), "{told}");
    let refused = place.fails("convert owned.ply strict.spz --strict --json=refused.json", 1);
    assert!(refused.contains("expected no losses with --strict, found comments: "), "{refused}");
    let told = place.json("refused.json");
    assert!(
        !place.at("strict.spz").exists() && told["output"].is_null() && told["bytes"].is_null(),
        "{told}"
    );
    assert_eq!(told["losses"], json!([words.trim_end()]));
    place.done("convert scene.ply strict.spz --strict --degree 0");
    let losses = place.told("convert owned.ply out.spz --degree 0 --json");
    assert_eq!(losses["losses"], json!([words.trim_end()]));
    assert_eq!(losses["chosen_losses"][0], "harmonics: cut from degree 3 to 0");
    assert_eq!((&losses["splats"], &losses["original_splats"]), (&300.into(), &300.into()));
    let prices = place.told("convert owned.ply --price --size 16x9 --format splat --format spz --json");
    let formats: Vec<_> =
        prices["prices"].as_array().expect("a list").iter().map(|row| &row["format"]).collect();
    assert_eq!(formats, ["splat", "spz, version 3", "spz, version 4"]);
    assert_eq!(prices["losses"], losses["losses"]);
    let line = "convert owned.ply --price --size 160x90 --format glb";
    let told = place.done(line);
    assert!(told.contains("\nglb: lost: the order by depth: "), "{told}");
    assert_eq!(place.told(&format!("{line} --ignore-tags --json"))["prices"][0]["least_psnr_db"], "inf");
}

#[test]
fn a_price_counts_what_is_left_out_and_frames_the_scene_at_the_size_of_the_pictures() {
    let place = Place::demo(300);
    std::fs::rename(place.at("scene.ply"), place.at("alone.ply")).expect("it is renamed");
    std::fs::remove_file(place.at("cameras.json")).expect("it is removed");
    let line = "convert alone.ply --price --size 12x40 --transform scale:2 --json";
    let lowest = |told: &serde_json::Value| told["prices"][0]["least_psnr_db"].as_f64();
    let whole = place.told(line);
    assert!(lowest(&whole).is_none_or(|db| db > 90.0), "{whole}");
    assert_eq!((&whole["splats"], &whole["original_splats"]), (&300.into(), &300.into()));
    for cut in ["--degree 0", "--where opacity>0.5", "--crop box:-9,-9,-9,0,9,9"] {
        let told = place.told(&format!("{line} {cut}"));
        assert!(lowest(&told).is_some_and(|db| db < 60.0), "{cut}: {told}");
        assert_eq!(
            (&told["original_splats"], &told["cameras"]),
            (&whole["splats"], &whole["cameras"]),
            "{cut}"
        );
    }
    place.done("convert alone.ply twice.ply --transform scale:2");
    place.done("render twice.ply --size 12x40 --backend reference -o a.png --write-cameras framing.json");
    let framing = std::fs::read_to_string(place.at("framing.json")).expect("it is there");
    let framing: serde_json::Value = serde_json::from_str(&framing).expect("JSON");
    assert_eq!(whole["cameras"], framing);
    let moved = "--transform rotate:1,0,0,90 -c framing.json";
    place.done(&format!("convert alone.ply turned.ply --write-cameras turned.json {moved}"));
    let price = place.told(&format!("convert alone.ply --price --format ply --json {moved}"));
    assert_eq!(price["cameras"], place.json("turned.json"));
    place.done("convert alone.ply far.ply --transform move:100000,0,0");
    let told = place.done("convert alone.ply --merge far.ply --price --size 12x40");
    for format in ["sog", "compressed.ply"] {
        assert!(told.contains(&format!("\n{format}: lost: positions: steps of up to ")), "{told}");
    }
}

#[test]
fn the_page_has_the_sizes_of_the_captures_in_every_format() {
    let Some(data) = common::data("the_page_has_the_sizes_of_the_captures_in_every_format") else { return };
    let page = include_str!("../docs/formats.md");
    let rows = page.lines().skip_while(|line| !line.starts_with("| scene | format | bytes |")).skip(2);
    let (mut scene, mut formats) = (None, 0);
    for row in rows.take_while(|line| !line.is_empty()) {
        let cells: Vec<&str> = row.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        let [_, name, format, size, per_splat, ..] = cells[..] else { panic!("{row}") };
        if !name.is_empty() {
            let bytes = std::fs::read(data.join(format!("scenes/{name}.ply"))).expect("the capture");
            scene = Some(Scene::parse(&bytes, QUIET).expect("a scene"));
        }
        let scene = scene.as_ref().expect("the first row names a scene");
        let mut bytes = Vec::new();
        let version = match format {
            ".spz`, version 3" => Some(SpzVersion::V3),
            ".spz`, version 4" => Some(SpzVersion::V4),
            _ => None,
        };
        let written = match version {
            Some(version) => scene.write_spz(version, &mut bytes),
            None => scene.write(SceneFormat::of_name(format.as_ref()).expect(row), QUIET, &mut bytes),
        };
        written.expect(row);
        let each = bytes.len() as f64 / f64::from(scene.count());
        assert_eq!(
            (grouped(bytes.len() as u64), format!("{each:.1}")),
            (size.into(), per_splat.into()),
            "{row}"
        );
        formats += 1;
    }
    assert_eq!(formats, 2 * (SceneFormat::WRITTEN.len() + 1));
}

#[test]
fn options_for_splats_are_refused_with_the_mesh() {
    let place = Place::empty();
    place.refuses(
        "synth",
        &[
            ("ring -o r.glb --count 10", 2, "expected --count with a scene of splats, found the mesh `ring`"),
            ("ring -o r.glb --cameras rc.json", 2, "expected --cameras with a scene of splats"),
        ],
    );
    place.done("synth ring -o r.glb");
}

#[test]
fn a_part_of_a_scene_is_written_and_a_moved_scene_looks_the_same_from_a_moved_camera() {
    let place = Place::demo(5000);
    let text = place.done("convert scene.ply part.ply --where 'opacity > 0.5 && y < 0' --order morton");
    assert!(
        text.contains(" splats, ")
            && text.lines().nth(1).is_some_and(|line| line.contains("part.ply: ply, ")),
        "{text}"
    );
    // A scene that stays near the origin stays in floats.
    place.done("convert part.ply near.ply --transform rotate:1,2,3,50 --transform move:1,0,0");
    let bytes = |name: &str| std::fs::metadata(place.at(name)).expect("it is there").len();
    assert_eq!(bytes("near.ply"), bytes("part.ply"));
    let up = place.said("convert part.ply up.ply --transform rotate:1,0,0,-90 --tag up=z").1;
    assert!(up.contains("the tag up becomes 0,1,0: --transform turns what --tag set"), "{up}");
    place.done("convert part.ply twice.ply --merge part.ply");
    let count = |name: &str| {
        let info = place.told(&format!("info {name} --json"));
        info["report"]["splats"].as_u64().unwrap_or_else(|| panic!("no count in {info}"))
    };
    assert_eq!(count("twice.ply"), 2 * count("part.ply"));
    // A half turn about x negates y and z, for the scene and the camera.
    place.done("convert scene.ply turned.ply --transform rotate:1,0,0,180 --transform move:5,0,0");
    let exact = "render --backend reference --size 160x90";
    place.done(&format!("{exact} scene.ply --eye 1,-2,-6 --target 0,0,0 -o a.npy"));
    let moved = "turned.ply --eye 6,2,6 --target 5,0,0 --up 0,1,0 -o b.npy";
    place.done(&format!("{exact} {moved}"));
    place.done("compare a.npy b.npy --min-psnr 80");
    let old = place.done("convert scene.ply old.spz --spz-version 3");
    assert!(old.contains("old.spz: spz, "), "{old}");
    assert!(place.done("info old.spz").contains("spz, version 3, gzip"));
}

#[test]
fn captures_in_other_formats_are_drawn_as_the_plain_capture() {
    let Some(data) = common::data("captures_in_other_formats_are_drawn_as_the_plain_capture") else { return };
    let place = Place::empty();
    let path = |name: &str| data.join("scenes").join(name).display().to_string();
    for (name, least) in [("biker.compressed.ply", 150.0), ("biker.spz", 50.0)] {
        let scenes = [path("biker.ply"), path(name)];
        let psnr = least_psnr(&place, [&scenes[0], &scenes[1]], &path("biker.cameras.json"));
        assert!(psnr > least, "{name}: {psnr} dB");
    }
}
