//! Scenes in other formats: converted, drawn and compared by the program.

use crate::commands::{done, scene, splatgraph};
use crate::common;
use serde_json::Value;
use std::path::Path;

/// Returns the minimum PSNR, in dB, between two scenes' pictures by the exact renderer.
fn least_psnr(folder: &Path, [a, b]: [&str; 2], cameras: &str) -> f64 {
    for (scene, pictures) in [(a, "a"), (b, "b")] {
        let render = ["render", scene, "--backend", "reference", "--cameras", cameras, "--size", "240x135"];
        done(folder, &[&render[..], &["--format", "npy", "-o", pictures]].concat());
    }
    let text = done(folder, &["compare", "--json", "a", "b"]);
    let compared: Value = serde_json::from_str(&text).expect("JSON");
    let psnr = |picture: &Value| picture["psnr_db"].as_f64().unwrap_or(f64::INFINITY);
    let pictures = compared["pictures"].as_array().unwrap_or_else(|| panic!("no pictures in {text}"));
    assert!(!pictures.is_empty());
    pictures.iter().map(psnr).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_scene_is_converted_to_every_format_and_drawn_alike() {
    let folder = scene();
    let folder = folder.path();
    // The demo scene's harmonics exceed the range of most formats.
    for (to, least) in [("spz", 15.0), ("compressed.ply", 25.0), ("splat", 12.0)] {
        let name = format!("converted.{to}");
        let text = done(folder, &["convert", "scene.ply", &name]);
        let bytes = std::fs::metadata(folder.join(&name)).expect("it is there").len();
        assert!(text.contains(&format!("{} bytes", splatgraph_assets::grouped(bytes))), "{text}");
        // The bytes tell the format, whatever the name says.
        std::fs::rename(folder.join(&name), folder.join("converted.bin")).expect("it is there");
        let info = done(folder, &["info", "converted.bin"]);
        assert!(info.contains("5,000 splats"), "{info}");
        let psnr = least_psnr(folder, ["scene.ply", "converted.bin"], "cameras.json");
        assert!(psnr > least, "{to}: {psnr} dB");
    }
}

#[test]
fn a_conversion_says_what_is_lost_and_what_cannot_be_written() {
    let folder = scene();
    let folder = folder.path();
    let text = done(folder, &["convert", "scene.ply", "cut.ply", "--degree", "0"]);
    assert!(text.contains("lost: harmonics: cut from degree 3 to 0"), "{text}");
    let text = done(folder, &["convert", "scene.ply", "clipped.spz"]);
    assert!(text.contains(" coefficients beyond 1 are clipped"), "{text}");
    let info = done(folder, &["info", "cut.ply", "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&info).expect("JSON")["report"]["stored_sh_degree"], 0);
    for (args, code, expected) in [
        (&["scene.ply", "out.xyz"][..], 2, "ends in .ply, .compressed.ply, .spz, .splat"),
        (&["scene.ply", "out.sog"], 2, "found out.sog"),
        (&["scene.ply", "./scene.ply"], 2, "would overwrite the scene"),
        (
            &["cameras.json", "out.spz"],
            1,
            "expected a scene (.ply, .spz, .splat, .ksplat, .sog), found JSON text",
        ),
    ] {
        let output = splatgraph(folder, &[&["convert"], args].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains(expected), "{said}");
        assert!(!folder.join("out.spz").exists());
    }
}

#[test]
fn a_part_of_a_scene_is_written_and_a_moved_scene_looks_the_same_from_a_moved_camera() {
    let folder = scene();
    let folder = folder.path();
    let text = done(
        folder,
        &["convert", "scene.ply", "part.ply", "--where", "opacity > 0.5 && y < 0", "--order", "morton"],
    );
    assert!(
        text.contains(" splats, ")
            && text.lines().nth(1).is_some_and(|line| line.contains("part.ply: ply, ")),
        "{text}"
    );
    done(folder, &["convert", "part.ply", "twice.ply", "--merge", "part.ply"]);
    let count = |name: &str| {
        let info: Value = serde_json::from_str(&done(folder, &["info", name, "--json"])).expect("JSON");
        info["report"]["splats"].as_u64().unwrap_or_else(|| panic!("no count in {info}"))
    };
    assert_eq!(count("twice.ply"), 2 * count("part.ply"));
    // A half turn about x negates y and z, for the scene and the camera.
    done(
        folder,
        &[
            "convert",
            "scene.ply",
            "turned.ply",
            "--transform",
            "rotate:1,0,0,180",
            "--transform",
            "move:5,0,0",
        ],
    );
    let exact = ["render", "--backend", "reference", "--size", "160x90"];
    done(
        folder,
        &[&exact[..], &["scene.ply", "--eye", "1,-2,-6", "--target", "0,0,0", "-o", "a.npy"]].concat(),
    );
    let moved = ["turned.ply", "--eye", "6,2,6", "--target", "5,0,0", "--up", "0,1,0", "-o", "b.npy"];
    done(folder, &[&exact[..], &moved].concat());
    done(folder, &["compare", "a.npy", "b.npy", "--min-psnr", "80"]);
    let old = done(folder, &["convert", "scene.ply", "old.spz", "--spz-version", "3"]);
    assert!(old.contains("old.spz: spz, "), "{old}");
    assert!(done(folder, &["info", "old.spz"]).contains("spz, version 3, gzip"));
}

#[test]
fn captures_in_other_formats_are_drawn_as_the_plain_capture() {
    let Some(data) = common::data("captures_in_other_formats_are_drawn_as_the_plain_capture") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| data.join("scenes").join(name).display().to_string();
    for (name, least) in [("biker.compressed.ply", 150.0), ("biker.spz", 50.0)] {
        let scenes = [path("biker.ply"), path(name)];
        let psnr = least_psnr(folder.path(), [&scenes[0], &scenes[1]], &path("biker.cameras.json"));
        assert!(psnr > least, "{name}: {psnr} dB");
    }
}
