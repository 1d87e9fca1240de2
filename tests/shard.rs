//! `--shard` and `merge`: several processes together write the files that one process writes.

use crate::place::Place;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;

const CAMERAS: [&str; 3] = ["one", "two", "three"];

/// Returns the files of a folder by their paths in it.
fn files(place: &Place, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let inside = |(path, bytes): (String, Vec<u8>)| (path[folder.len() + 1..].to_owned(), bytes);
    place.files(folder).into_iter().map(inside).collect()
}

fn run(place: &Place, line: &str, more: &[&str], code: i32) -> String {
    let words: Vec<&str> = line.split(' ').chain(more.iter().copied()).collect();
    place.fails(&words, code)
}

/// Removes fields that differ between runs, such as times.
fn without_times(json: &[u8]) -> Value {
    fn clean(value: &mut Value) {
        match value {
            Value::Object(fields) => {
                for name in ["time", "fit", "command", "commands", "origin", "gpu_bytes"] {
                    fields.remove(name);
                }
                fields.values_mut().for_each(clean);
            }
            Value::Array(values) => values.iter_mut().for_each(clean),
            _ => {}
        }
    }
    let mut value = serde_json::from_slice(json).expect("JSON");
    clean(&mut value);
    value
}

#[test]
fn shards_draw_the_pictures_of_one_process_and_none_twice() {
    let place = Place::new();
    place.cameras(&CAMERAS);
    let line = "render scene.ply -c cameras.json --size 32x24 --output depth=out/d.npy -o";
    run(&place, line, &["out"], 0);
    let one = files(&place, "out");
    fs::remove_dir_all(place.at("out")).expect("it is there");
    let told = run(&place, line, &["out", "--shard", "0/2"], 0);
    assert!(told.contains("shard 0/2: 2 of 3 views: 2 done, 0 already there, 0 failed"), "{told}");
    let told = run(&place, "merge out", &[], 1);
    assert!(told.contains("2 of 3 views are present\n") && told.contains("missing: two\n"), "{told}");
    // As if a process had been killed, or the disk was full: one of its pictures is cut.
    let picture = place.bytes("out/three.png");
    place.write("out/three.png", &picture[..picture.len() - 1]);
    let told = run(&place, line, &["out", "--shard", "0/1"], 0);
    assert!(told.contains("3 of 3 views: 2 done, 1 already there"), "{told}");
    // As if the disk had been lost: the length is right.
    let mut picture = place.bytes("out/two.png");
    let middle = picture.len() / 2;
    picture[middle..middle + 16].fill(0);
    place.write("out/two.png", &picture);
    // An output besides the picture is missing.
    fs::remove_file(place.at("out/d-one.npy")).expect("it is there");
    let told = run(&place, "merge out", &[], 1);
    assert!(told.contains("1 of 3 views are present\nmissing: one\nmissing: two\n"), "{told}");
    let told = run(&place, line, &["out", "--shard", "0/1"], 0);
    assert!(told.contains("3 of 3 views: 2 done, 1 already there"), "{told}");
    let mut many = files(&place, "out");
    assert!(many.remove("job.json").is_some() && many == one);
    assert_eq!(run(&place, "merge out", &[], 0), "3 of 3 views are present\n");
    for (more, code, why) in [
        (&["out", "--shard", "0/1", "--background", "1,1,1"][..], 1, "differ in --background: name"),
        (&["out", "--shard", "0/1", "-p", "splat"], 1, "differ in graph"),
        (&["out"], 2, "expected a folder without job.json, found out"),
        (&["new", "--shard", "2/2"], 2, "expected I/N"),
        (&["new", "--shard", "0/2", "--json"], 2, "expected no --json with --shard"),
        (&["new.png", "--shard", "0/2"], 2, "expected one camera for the picture"),
    ] {
        let told = run(&place, line, more, code);
        assert!(told.contains(why), "{more:?}: {told}");
    }
    // The same parameters, spelled in another way.
    let set = |more: &str, done: &str| {
        let line =
            format!("render scene.ply -c cameras.json -p splat --size 32x24 -o set --shard 0/1 {more}");
        assert!(run(&place, &line, &[], 0).contains(done), "{more}");
    };
    set("--set cutoff=3.0 --set digit_bits=4", "3 done");
    set("--set digit_bits=4 --set cutoff=3", "3 already there");
    // The file of the scene has a tag: splats of .glb files are sorted by their distance.
    run(&place, "convert scene.ply tagged.glb", &[], 0);
    for (folder, set) in [("drawn", "-p splat"), ("exact", "--backend reference")] {
        let line = format!("render tagged.glb -c cameras.json {set} --size 32x24 --shard 0/1 -o {folder}");
        run(&place, &line, &[], 0);
        let told = run(&place, &line, &["--ignore-tags"], 1);
        assert!(told.contains("differ in tags: name another folder"), "{told}");
    }
    let told = run(&place, &line.replace("d.npy", "e.npy"), &["out", "--shard", "0/1"], 1);
    assert!(told.contains("differ in the names of files: name another folder"), "{told}");
    let told = run(&place, "merge nowhere", &[], 1);
    assert!(told.contains("expected a folder of --shard, found no nowhere/job.json"), "{told}");
    fs::create_dir(place.at("full")).expect("a folder");
    fs::copy(place.at("out/one.png"), place.at("full/one.png")).expect("a copy");
    let told = run(&place, line, &["full", "--shard", "0/1"], 1);
    assert!(told.contains("expected an empty folder") && told.contains("full/one.png"), "{told}");
}

#[test]
fn graphs_whose_frames_depend_on_those_before_them_are_refused() {
    let place = Place::new();
    place.cameras(&CAMERAS);
    let render = "render scene.ply -c cameras.json --size 32x24 -p stale_order -o out";
    let told = run(&place, render, &["--shard", "0/1"], 2);
    let why = "found `stale_order`, whose frames depend on those before them (state, such as a history, or";
    assert!(told.contains(why) && told.contains("without --shard"), "{told}");
    run(&place, render, &[], 0);
    // `evaluate` starts each view anyway.
    run(&place, "synth --photograph scene.ply --dataset views --views 2 --size 32x24", &[], 0);
    run(&place, "evaluate scene.ply -c views --all -p stale_order -o scores", &["--shard", "0/1"], 0);
}

#[test]
fn shards_of_different_folders_are_joined_with_their_files_outside_the_output() {
    let place = Place::new();
    place.cameras(&CAMERAS);
    for (folder, shard) in [("a", "0/2"), ("b", "1/2")] {
        fs::create_dir(place.at(folder)).expect("a folder");
        fs::copy(place.at("scene.ply"), place.at(format!("{folder}/{folder}.ply"))).expect("a copy");
        let line = format!(
            "render {folder}.ply -c ../cameras.json --size 32x24 --output depth=d.npy -o out --shard {shard}"
        );
        let output = place.program(&line).current_dir(place.at(folder)).output().expect("it runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    assert_eq!(run(&place, "merge a/out b/out", &[], 0), "3 of 3 views are present\n");
    fs::remove_file(place.at("b/d-two.npy")).expect("it is there");
    let told = run(&place, "merge a/out b/out", &[], 1);
    assert!(told.contains("2 of 3 views are present\nmissing: two\n"), "{told}");
}

#[test]
fn depths_without_pictures_are_shared_in_the_folder_of_the_output() {
    let place = Place::new();
    place.cameras(&CAMERAS);
    let line = |file: &str| {
        format!("render scene.ply -c cameras.json --size 32x24 --output depth={file} --shard 0/1")
    };
    run(&place, &line("depths/"), &[], 0);
    fs::remove_file(place.at("depths/two.npy")).expect("it is there");
    let told = run(&place, &line("depths/"), &[], 0);
    assert!(told.contains("1 done, 2 already there"), "{told}");
    assert!(run(&place, &line("d.npy"), &[], 2).contains("expected a folder with --shard, as in"));
}

#[test]
fn a_graph_that_was_edited_is_another_request() {
    let place = Place::new();
    place.cameras(&CAMERAS);
    run(&place, "new my.ron", &[], 0);
    let line = "render scene.ply -c cameras.json --size 32x24 -p my.ron -o out --shard 0/1";
    run(&place, line, &[], 0);
    place.write("my.ron", place.text("my.ron") + "\n// edited\n");
    let told = run(&place, line, &[], 1);
    assert!(told.contains("differ in graph: name another folder"), "{told}");
}

#[test]
fn ledgers_sweeps_and_scores_of_shards_are_joined_to_those_of_one_process() {
    let place = Place::new();
    place.cameras(&CAMERAS);
    fs::copy(place.at("scene.ply"), place.at("same.ply")).expect("a copy");
    let short = "--size 32x24 --rounds 1 --frames 1";
    for (line, file) in [
        (format!("trade scene.ply -c cameras.json {short} --only defaults"), "ledger.json"),
        (format!("sweep scene.ply -c cameras.json {short} --steps 2"), "sweep.json"),
    ] {
        run(&place, &line, &["-o", "one"], 0);
        for shard in ["1/2", "0/2"] {
            // Each shard writes to a separate folder, as on machines without a shared disk, and reads its own scene.
            let line = if shard == "0/2" { line.replace("scene.ply", "./same.ply") } else { line.clone() };
            run(&place, &line, &["-o", &format!("of-{}", &shard[..1]), "--shard", shard], 0);
        }
        let told = run(&place, "merge of-1", &["-o", "part"], 1);
        assert!(told.contains("1 of 3 views are present\nmissing: one\nmissing: three\n"), "{told}");
        let part = place.json(&format!("part/{file}"));
        assert_eq!(part["missing"], json!(["one", "three"]), "{line}");
        let commands = part["command"].as_str().and_then(|command| command.split_once('\n'));
        let (shard, merge) = commands.expect("two commands");
        assert!(shard.ends_with("--shard 1/2") && merge.ends_with("merge of-1 -o part"), "{part}");
        let manifest = place.text("of-1/job.json");
        place.write("of-1/job.json", manifest.replace("\"request\": {", "\"request\": {}, \"former\": {"));
        let told = run(&place, "merge of-1 -o old", &[], 1);
        assert!(told.contains("expected results of this version of the program"), "{told}");
        place.write("of-1/job.json", manifest);
        let page = place.text(&format!("part/{}", file.replace(".json", ".html")));
        assert!(page.contains("1 of 3 views (missing: <code>one</code>, <code>three</code>)"), "{page}");
        assert!(page.contains("1 of 3 views: "), "the titles of page and plots say it, too: {page}");
        run(&place, "merge of-1 of-0 -o many", &[], 0);
        let (one, many) = (files(&place, "one"), files(&place, "many"));
        assert!(one.keys().eq(many.keys()), "{:?} {:?}", one.keys(), many.keys());
        assert_eq!(without_times(&one[file]), without_times(&many[file]), "{line}");
        for (name, bytes) in one.iter().filter(|(name, _)| name.starts_with("pictures/")) {
            assert!(many[name] == *bytes, "{name}");
        }
        for folder in ["one", "of-0", "of-1", "many", "part"] {
            fs::remove_dir_all(place.at(folder)).expect("it is there");
        }
    }
    run(&place, "synth --photograph scene.ply --dataset views --views 9 --size 32x24", &[], 0);
    let line = "evaluate scene.ply -c views --all -o";
    let one = place.run(&["evaluate", "scene.ply", "-c", "views", "--all", "--json"]);
    for shard in ["0/3", "1/3", "2/3"] {
        run(&place, line, &["scores", "--shard", shard], 0);
    }
    run(&place, "merge scores", &[], 0);
    let many = place.bytes("scores/scores.json");
    assert!(many == one.stdout, "{}", String::from_utf8_lossy(&many));
    // Lost and damaged pictures are drawn again, and merging needs none.
    let pictures =
        ["renders/view-0004.png", "differences/view-0005.png"].map(|name| format!("scores/{name}"));
    let whole = pictures.each_ref().map(|picture| place.bytes(picture));
    fs::remove_file(place.at(&pictures[0])).expect("it is there");
    place.write(&pictures[1], &whole[1][..100]);
    assert!(run(&place, "merge scores", &[], 0).contains("9 of 9 views are present"));
    let told = run(&place, line, &["scores", "--shard", "0/1"], 0);
    assert!(told.contains("9 of 9 views: 2 done, 7 already there"), "{told}");
    assert!(pictures.each_ref().map(|picture| place.bytes(picture)) == whole);
    // Changed photographs and damaged parts are scored again. A view that fails costs no other.
    fs::copy(place.at("views/images/view-0001.png"), place.at("views/images/view-0004.png")).expect("a copy");
    fs::copy(place.at("scene.ply"), place.at("copy.ply")).expect("a copy");
    place.write("scores/parts/view-0003.json", "{");
    fs::remove_file(place.at("views/images/view-0007.png")).expect("it is there");
    let told = run(&place, "merge scores", &[], 1);
    assert!(told.contains("8 of 9 views are present\nmissing: view-0003.png\n"), "{told}");
    let line = "evaluate copy.ply -c ./views/ --all -o scores --shard 0/1";
    let told = run(&place, line, &[], 1);
    let why = "9 of 9 views: 2 done, 6 already there, 1 failed\nview-0007.png: expected the photograph ";
    assert!(told.contains(why), "{told}");
    run(&place, "merge scores", &[], 1);
    let part = place.json("scores/scores.json");
    assert_eq!((&part["missing"], &part["mean"]["ssim"]), (&json!(["view-0007.png"]), &Value::Null));
    assert!(part["views"][4]["psnr_db"].as_f64() < Some(40.0), "{part:#}");
    let told = run(&place, &line.replace("--all", "--all --downscale 2"), &[], 1);
    assert!(told.contains("differ in --downscale: name another folder"), "{told}");
    // Photographs of another size are scored again, and not joined with the others.
    run(&place, "synth --photograph scene.ply --dataset small --views 9 --size 16x12", &[], 0);
    let told = run(&place, &line.replace("--all", "--all --masks small/images"), &[], 1);
    assert!(told.contains("differ in --masks: name another folder"), "{told}");
    let small = "evaluate scene.ply -c views --photographs small/images --all -o scores --shard";
    run(&place, &format!("{small} 0/3"), &[], 0);
    let told = run(&place, "merge scores", &[], 1);
    let why = "found view-0001.png with 32 x 24 and view-0000.png with 16 x 12 pixels: run all shards again";
    assert!(told.contains(why), "{told}");
    run(&place, &format!("{small} 0/1"), &[], 0);
    run(&place, "merge scores", &[], 0);
}
