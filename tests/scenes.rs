//! Several scenes in one picture: by a composition file, by names on the command line, and by `convert`, with equal
//! bits.

use crate::commands::{done, splatgraph};
use crate::common;
use std::fs;
use std::path::Path;

/// A folder with two scenes.
fn scenes() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    done(folder.path(), &["synth", "demo", "--count", "3000", "-o", "a.ply", "--cameras", "cameras.json"]);
    done(folder.path(), &["synth", "demo", "--count", "2000", "--seed", "5", "-o", "b.ply"]);
    folder
}

/// Draws a scene, or several, and returns the bytes of the picture.
fn picture(folder: &Path, scenes: &[&str]) -> Vec<u8> {
    let device = common::device_option();
    let line = ["-c", "cameras.json#0", "--size", "96x54", "-p", "splat", "-o", "out.npy"];
    let args: Vec<&str> =
        ["render"].iter().chain(scenes).chain(&line).copied().chain(device.as_deref()).collect();
    done(folder, &args);
    fs::read(folder.join("out.npy")).expect("a picture")
}

/// Converts a scene file to PLY, and returns its bytes.
fn converted(folder: &Path, args: &[&str]) -> Vec<u8> {
    done(folder, &[&["convert"], args, &["converted.ply"]].concat());
    fs::read(folder.join("converted.ply")).expect("a scene")
}

const PLACE: &str = "scale: 0.5, rotate: (axis: (0, 1, 0.5), degrees: 30), translate: (1, -0.5, 2)";

#[test]
fn scenes_of_a_file_are_those_that_convert_moves_and_merges_bit_by_bit() {
    let folder = scenes();
    let folder = folder.path();
    let write = |name: &str, text: &str| fs::write(folder.join(name), text).expect("written");
    write("moved.ron", &format!("Scenes([Scene(file: \"b.ply\", {PLACE})])"));
    let steps = ["--transform=scale:0.5", "--transform=rotate:0,1,0.5,30", "--transform=move:1,-0.5,2"];
    let moved = converted(folder, &[&["b.ply"][..], &steps].concat());
    assert!(moved == converted(folder, &["moved.ron"]), "moved");
    write("plain.ron", "// Two scenes.\nScenes([Scene(file: \"a.ply\"), Scene(file: \"b.ply\")])");
    assert!(converted(folder, &["a.ply", "--merge=b.ply"]) == converted(folder, &["plain.ron"]), "merged");
    // Every command that takes a scene takes several.
    assert!(done(folder, &["info", "plain.ron"]).contains("5,000"));
}

#[test]
fn scenes_on_the_command_line_are_drawn_in_one_sort_with_their_places() {
    let folder = scenes();
    let folder = folder.path();
    let text = "Scenes([Scene(file: \"a.ply\"), Scene(file: \"b.ply\", translate: (0.5, -0.25, 1))])";
    fs::write(folder.join("both.ron"), text).expect("written");
    let both = picture(folder, &["both.ron"]);
    assert!(both == picture(folder, &["a.ply", "b.ply", "--at=0.5,-0.25,1"]));
    assert!(both != picture(folder, &["a.ply", "b.ply"]), "the second scene is in the picture");
}

#[test]
fn mistakes_in_places_are_told() {
    let folder = scenes();
    let folder = folder.path();
    let refused = |args: &[&str]| {
        let output = splatgraph(folder, args);
        assert!(!output.status.success(), "{args:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let of = |text: &str| {
        fs::write(folder.join("bad.ron"), text).expect("written");
        refused(&["info", "bad.ron"])
    };
    assert!(of("Scenes([\n  Scene(file: \"a.ply\", scal: 2),\n])").contains("bad.ron: line 2, column"));
    let said = of("Scenes([Scene(file: \"none.ply\")])");
    assert!(said.contains("bad.ron: none.ply: cannot be read"), "{said}");
    let said = of("Scenes([Scene(file: \"bad.ron\")])");
    assert!(said.contains("bad.ron: bad.ron: expected one scene, found several"), "{said}");
    let said = refused(&["render", "a.ply", "b.ply", "--at=1,2,3", "--at=4,5,6", "-o", "out.png"]);
    assert!(
        said.contains("expected at most one --at for each scene after the first, found 2 for 1"),
        "{said}"
    );
    let said = refused(&["render", "a.ply", "b.ply", "--at=1,2", "-o", "out.png"]);
    assert!(said.contains("expected three numbers"), "{said}");
    let said = refused(&["render", "a.ply", "b.ply", "-o", "b.ply"]);
    assert!(said.contains("expected the extension"), "{said}");
}
