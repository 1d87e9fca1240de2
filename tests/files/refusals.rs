//! Outputs that would destroy something are refused, with exit code 2, before anything is drawn.

use crate::place::{DRAW, Place};
use splatgraph::io::image::{Image, save_words};
use std::fs;

fn refused(place: &Place, args: &str, why: &str) {
    let before = place.files(".");
    let output = place.run(args);
    let errors = String::from_utf8_lossy(&output.stderr);
    // Removes the note about the camera, which is printed before the refusal.
    let errors: String = errors
        .split_inclusive('\n')
        .filter(|line| !line.starts_with("the camera is the first of "))
        .collect();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {errors}");
    assert!(output.stdout.is_empty(), "{args:?}");
    assert!(errors.starts_with("error: ") && errors.lines().count() == 1, "{args:?}: {errors}");
    assert!(errors.contains(why), "{args:?}: {errors}");
    assert!(place.files(".") == before, "{args:?} changes files");
}

#[test]
fn no_output_goes_over_an_input_or_over_another_output() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    fs::hard_link(place.at("scene.ply"), place.at("hard.png")).expect("made");
    std::os::unix::fs::symlink("scene.ply", place.at("soft.json")).expect("made");
    fs::create_dir(place.at("out")).expect("made");
    std::os::unix::fs::symlink("../scene.ply", place.at("out/two.png")).expect("made");
    place.write("graph.ron", "Preset(graph: \"splat\", set: {})");
    for name in ["a.npy", "b.npy", "pics/x.png", "others/x.png"] {
        Image::from_fn(2, 2, |_, _| [0.5; 3]).save(&place.at(name)).expect("written");
    }
    place.write("stats.json", r#"[{"pipeline": "splat", "passes": [{"name": "draw", "gpu_ms": 1.0}]}]"#);
    let long = "x".repeat(300);
    let long_keys = format!("a@b={}.npy", "k".repeat(230));
    for (args, why) in [
        ("render scene.ply -o a.png --json=scene.ply", "--json would overwrite the scene"),
        ("render scene.ply -o a.png --json=soft.json", "--json would overwrite the scene"),
        ("render scene.ply -o hard.png", "--output would overwrite the scene"),
        ("render scene.ply -c cameras.json -o out", "--output would overwrite the scene"),
        ("render scene.ply -c cameras.json#0 --json=cameras.json", "overwrite the cameras"),
        ("render scene.ply -p graph.ron --json=./graph.ron", "overwrite the graph"),
        ("render scene.ply -o a.png --json=a.png", "--json and --output name one file"),
        ("render scene.ply -o - --json", "standard output"),
        ("render scene.ply -o z --json=z", "which is inside the file of --json"),
        ("render scene.ply --inspect a@b=k.npy --inspect c@d=./k.npy", "two outputs of --inspect"),
        ("render scene.ply -c cameras.json --inspect a@b=k.npy -o . --json=k-one.npy", "one file"),
        ("render scene.ply -c cameras.json -o -", "expected one camera"),
        (&format!("render scene.ply -o {long}.png"), "the file system allows 255"),
        (
            &format!("render scene.ply -c cameras.json --inspect {long_keys}"),
            "no room for the cameras' names",
        ),
        ("render scene.ply -o scene.ply/a.png", "scene.ply"),
        ("render scene.ply -o a.png --json=out", "which is a folder"),
        ("view scene.ply --events scene.ply", "--events would overwrite the scene"),
        ("view scene.ply --screenshot -", "expected a file for --screenshot"),
        ("view scene.ply --screenshot a.png --events a.png", "name one file"),
        ("dump graph.ron -o graph.ron", "--output would overwrite the graph"),
        ("dump splat --times stats.json -o stats.json", "overwrite the file of --times"),
        ("dump splat --scene scene.ply -o hard.png", "overwrite the scene"),
        ("synth demo -o z.ply --cameras z.ply", "--output and --cameras name one file"),
        ("synth demo -o - --cameras -", "standard output"),
        ("synth --enlarge scene.ply --count 300 -o ./scene.ply", "overwrite the scene"),
        ("synth demo --count 10", "missing output file"),
        ("compare a.npy b.npy --diff b.npy", "overwrite a compared picture"),
        ("compare pics others --diff others", "overwrite a compared picture"),
        ("compare a.npy b.npy --diff -", "expected a file for --diff"),
        ("render scene.ply -o a.png --json new.json", "expected --json=new.json to write a file"),
        ("bench scene.ply --json cameras.json", "expected --json=cameras.json to write a file"),
        ("advise scene.ply --json new.json", "expected --json=new.json to write a file"),
        ("info scene.ply --json -", "expected --json alone for standard output"),
    ] {
        refused(&place, args, why);
    }
    place.refuses("info scene.ply --json", &[("--json=new.json", 2, "cannot be used multiple times")]);
}

#[test]
fn no_output_goes_over_a_file_that_another_input_names() {
    let place = Place::demo(300);
    fs::remove_file(place.at("cameras.json")).expect("made");
    place.done("convert scene.ply other.ply");
    place.done("convert scene.ply packed.sog");
    place.write(
        "list.ron",
        r#"Scenes([Scene(file: "scene.ply"), Scene(file: "other.ply", translate: (1, 0, 0))])"#,
    );
    let mut archive =
        zip::ZipArchive::new(fs::File::open(place.at("packed.sog")).expect("a file")).expect("a ZIP");
    archive.extract(place.at("sog")).expect("unpacked");
    place.done("synth --photograph scene.ply --dataset views --views 2 --size 32x18");
    for args in [
        "convert list.ron scene.ply",
        "convert scene.ply other.ply --merge list.ron",
        "convert sog sog/means_l.webp --format spz",
        "info list.ron --json=other.ply",
        "render list.ron -o a.png --json=other.ply",
        "render scene.ply list.ron -o a.png --json=other.ply",
        "synth --enlarge list.ron --count 900 -o other.ply",
        "evaluate list.ron -c views --json=other.ply",
        "dump splat --scene list.ron -o other.ply",
        "bench list.ron --json=other.ply",
    ] {
        refused(&place, args, "would overwrite a file of ");
    }
    refused(
        &place,
        "render scene.ply -c views -o views/images",
        "would overwrite a photograph of the dataset",
    );
    // A photograph's name that leads too far away is not read, but an output must not overwrite the file.
    place.write("a.png", "");
    place.write(
        "views/far/transforms.json",
        r#"{"w": 32, "h": 18, "fl_x": 30, "frames": [{"file_path": "../../a.png",
            "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}]}"#,
    );
    refused(
        &place,
        "render scene.ply -c views/far/transforms.json -o a.png",
        "would overwrite a photograph of the dataset",
    );
}

#[test]
fn a_scene_after_json_is_the_scene_and_not_the_file_to_write() {
    let place = Place::new();
    place.cameras(&["one"]);
    let before = place.bytes("scene.ply");
    let loaded = |words: &str| {
        place.told(&format!("render {words} -p unsorted --device llvmpipe --size 16x8"))[0]["counts"]["loaded"].clone()
    };
    assert_eq!(loaded("--json scene.ply"), loaded("scene.ply --json"));
    let bench = place.told("bench --pipelines unsorted --rounds 1 --frames 1 --sizes 16x8 --json scene.ply");
    assert_eq!(bench["scenes"][0]["scene"], "scene.ply", "{bench:#}");
    let popping = place.told("popping -p unsorted --frames 2 --size 16x8 --json scene.ply");
    assert_eq!(popping["origin"]["scene"], "scene.ply", "{popping:#}");
    assert!(place.bytes("scene.ply") == before);
}

#[test]
fn a_file_that_cannot_be_created_is_refused_before_anything_is_written() {
    let place = Place::new();
    for args in ["new scene.ply/my.ron", "devices --json=scene.ply/a.json", "man scene.ply"] {
        refused(&place, args, "which cannot be written: Not a directory");
    }
}

#[test]
fn a_window_on_the_demo_scene_does_not_overwrite_it() {
    let place = Place::shipped();
    // With this file, the place is a checkout.
    place.write("app/src/io/demo.rs", "");
    let file = format!("assets/splats/{}", splatgraph::io::demo::FILE);
    place.write(&file, "ply");
    refused(&place, &format!("view --events {file}"), "--events would overwrite the demo scene");
}

#[test]
fn no_command_overwrites_a_shader_of_its_graph() {
    let place = Place::shipped();
    place.write("scene.ply", Place::new().bytes("scene.ply"));
    place.done("synth --photograph scene.ply --dataset views --views 1 --size 32x18");
    let stem = place.files("views/images").into_keys().next().expect("a photograph");
    let stem = stem.trim_start_matches("views/images/").split('.').next().unwrap_or_default().to_owned();
    let shader = "shaders/camera.glsl";
    for output in ["ledger/ledger.csv", "sweep/sweep.csv", &format!("scores/renders/{stem}.png")] {
        place.write(output, "");
        fs::remove_file(place.at(output)).expect("removed");
        fs::hard_link(place.at(shader), place.at(output)).expect("made");
    }
    let before = place.files(".");
    for args in [
        "dump pipelines/splat.ron --format text -o shaders/camera.glsl",
        "bench scene.ply --pipelines pipelines/splat.ron --sizes 32x18 --json=shaders/camera.glsl",
        "advise scene.ply -p pipelines/splat.ron --size 32x18 --psnr 30 --json=shaders/camera.glsl",
        "trade scene.ply -p pipelines/splat.ron --size 32x18",
        "sweep scene.ply -p pipelines/splat.ron --size 32x18 --shard 0/1",
        "evaluate scene.ply -c views -p pipelines/splat.ron -o scores",
    ] {
        let output = place.run(args);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(errors.contains("would overwrite a file of the graph"), "{args:?}: {errors}");
        assert_eq!(output.status.code(), Some(2), "{args:?}: {errors}");
        assert!(place.files(".") == before, "{args:?} changes files");
    }
}

#[test]
fn every_camera_has_a_picture_and_an_array_of_its_own() {
    let place = Place::new();
    let long = "n".repeat(400);
    #[rustfmt::skip]
    let names = [
        "a/b", "a_b", "a-2", "a", "a", "A", "", "camera6", "..", "../../x", "CON", "\x1b[31mred", &long, "line\nbreak",
        "\u{202e}x",
    ];
    place.cameras(&names);
    let args = format!("{DRAW} out --inspect order@compact=seen.npy --json=stats.json");
    let text = place.done(&args);
    let lines: Vec<&str> = text.lines().filter(|line| line.contains(": 64 x 48, ")).collect();
    let pictures = place.files("out");
    assert_eq!((lines.len(), pictures.len()), (names.len(), names.len()), "{text}");
    for line in lines {
        let file = line.split(": ").next().unwrap_or_default();
        assert!(pictures.contains_key(file), "{file} was told, found {:?}", pictures.keys());
    }
    let arrays = place.files(".").into_keys().filter(|name| name.starts_with("./seen-")).count();
    assert_eq!(arrays, names.len());
    // A second run must choose the same names.
    place.done(&args);
    assert_eq!(place.files("out").into_keys().collect::<Vec<_>>(), pictures.into_keys().collect::<Vec<_>>());
}

#[test]
fn an_archive_cannot_send_differences_out_of_their_folder() {
    let place = Place::new();
    for archive in ["a.npz", "b.npz"] {
        let mut npz = zip::ZipWriter::new(fs::File::create(place.at(archive)).expect("a file"));
        for name in ["../../outside", "/tmp/absolute", "plain"] {
            save_words(&place.at("member.npy"), &[1, 1, 3], &[0.5f32; 3]).expect("written");
            npz.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).expect("begun");
            std::io::Write::write_all(&mut npz, &place.bytes("member.npy")).expect("written");
        }
        npz.finish().expect("written");
    }
    place.done("compare a.npz b.npz --diff in/side");
    let names: Vec<String> = place.files("in").into_keys().collect();
    assert_eq!(names, ["in/side/_._.._outside.png", "in/side/_tmp_absolute.png", "in/side/plain.png"]);
}
