//! `bench` as a command: interleaved graphs, the copy limit, and sorting on its own.

use crate::place::Place;
use serde_json::Value;

const SHORT: &str = "bench --rounds 2 --frames 1 --validate";

fn done(place: &Place, more: &str) -> String {
    let (text, errors) = place.said(&format!("{SHORT} {more}"));
    assert!(errors.contains("validation: no messages"), "{errors}");
    text
}

fn rows(report: &Value) -> &Vec<Value> {
    report["rows"].as_array().expect("rows")
}

fn part<'a>(list: &'a Value, name: &str) -> &'a Value {
    let found = list.as_array().expect("a list").iter().find(|part| part["name"] == name);
    found.unwrap_or_else(|| panic!("no {name} in {list}"))
}

#[test]
fn graphs_are_measured_in_every_size_and_number_of_splats() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let text = done(
        &place,
        "scene.ply -c cameras.json --pipelines splat,unsorted --sizes 64x48,128x96 --splats 200,300 --json=bench.json -o out",
    );
    for words in ["scene, 300 splats, 128x96", "passes of unsorted", "back_to_front", "of copy"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let report = place.json("bench.json");
    assert_eq!(
        (&report["version"], &report["complete"], &report["effort"]["rounds"]),
        (&1.into(), &true.into(), &2.into())
    );
    assert!(report["device"].as_str().is_some_and(|name| name.contains("llvmpipe")), "{}", report["device"]);
    // On a CPU, a copy does not bound passes, and pass times are not meaningful.
    assert_eq!((&report["is_cpu"], &report["copy"]), (&true.into(), &serde_json::Value::Null));
    assert!(
        text.contains("only the GPU ms of whole frames are reliable") && !text.contains("copy limit"),
        "{text}"
    );
    assert_eq!(report["scenes"][0]["cameras"].as_array().map(Vec::len), Some(2));
    let places: Vec<(u64, u64, &str)> = rows(&report)
        .iter()
        .map(|row| {
            let width = row["size"][0].as_u64().expect("a width");
            (row["splats"].as_u64().expect("a number"), width, row["pipeline"].as_str().expect("a name"))
        })
        .collect();
    let expected = [200, 300].into_iter().flat_map(|splats| {
        let sizes = [64, 128].into_iter();
        sizes.flat_map(move |width| ["splat", "unsorted"].map(|graph| (splats, width, graph)))
    });
    assert_eq!(places, expected.collect::<Vec<_>>());
    for row in rows(&report) {
        let found = &row["found"]["Ok"];
        let views = found["views"].as_array().expect("views");
        let names: Vec<&str> = views.iter().filter_map(|view| view["camera"].as_str()).collect();
        assert_eq!(names, ["one", "two"]);
        let ms = |figures: &Value| figures["gpu_ms"]["median"].as_f64().expect("lavapipe has a timer");
        let mean = views.iter().map(ms).sum::<f64>() / 2.0;
        assert!((ms(&found["mean"]) - mean).abs() < 1e-9 && mean > 0.0, "{found}");
        assert_eq!(views[0]["width"], row["size"][0]);
        let rounds = views[0]["gpu_ms_of_rounds"].as_array().expect("a list");
        let sum: f64 = rounds.iter().filter_map(Value::as_f64).sum();
        assert!(rounds.len() == 2 && (0.5 * sum - ms(&views[0])).abs() < 1e-9, "{}", views[0]);
        let sorted = found["mean"]["phases"].as_array().unwrap().iter().any(|phase| phase["name"] == "sort");
        assert_eq!(sorted, row["pipeline"] == "splat");
        // The output is read and written once: half floats or floats in, floats out.
        let pixels = row["size"][0].as_u64().unwrap() * row["size"][1].as_u64().unwrap();
        let compose = part(&found["mean"]["passes"], "compose")["bytes"].as_u64().unwrap();
        assert!(compose >= 24 * pixels && compose <= 32 * pixels + 256, "{compose} bytes of {pixels} pixels");
        let buffers: u64 =
            found["memory"].as_array().unwrap().iter().map(|m| m["bytes"].as_u64().unwrap()).sum();
        assert_eq!(found["memory_bytes"].as_u64(), Some(buffers));
    }
    let csv = place.text("out/bench.csv");
    assert!(csv.starts_with("scene,splats,") && csv.contains(",of_copy,set,device,program\n"), "{csv}");
    let device = format!(",\"{} (", report["device"].as_str().expect("a name"));
    let cells = |line: &str| line.split_once(&device).map(|(cells, _)| cells.split(',').count());
    assert!(csv.lines().skip(1).all(|line| cells(line) == Some(14)), "{csv}");
    assert!(
        csv.contains(",\"unsorted\",\"\",frame,gpu,") && csv.contains(",\"two\",pass,\"compose\","),
        "{csv}"
    );
    for name in ["splats-scene-64x48", "splats-scene-128x96", "sizes-scene-200", "sizes-scene-300"] {
        let svg = place.text(&format!("out/{name}.svg"));
        assert!(svg.contains("unsorted") && svg.contains("<polyline"), "{svg}");
        let plot = place.image(&format!("out/{name}.png"));
        assert!(plot.rgb.iter().any(|pixel| *pixel != plot.rgb[0]), "it is not empty");
    }
}

#[test]
fn the_files_in_the_folder_belong_to_one_run_also_to_one_that_ends_early() {
    let place = Place::new();
    place.cameras(&["one"]);
    let short = "bench scene.ply -c cameras.json --rounds 1 --frames 1 -p splat -o out";
    place.done(&format!("{short} --sizes 32x24,48x36"));
    place.image("out/sizes-scene-all.png");
    place.write("out/sizes.png", "");
    place.write("broken.ply", "ply\n");
    let errors = place.fails(&format!("{short} --size 32x24 --set cutoff=2 broken.ply"), 1);
    assert!(errors.contains("plots of an earlier run are removed: sizes-scene-all\n"), "{errors}");
    let files: Vec<String> = place.files("out").into_keys().collect();
    assert_eq!(files, ["out/bench.csv", "out/sizes.png"]);
    let csv = place.text("out/bench.csv");
    assert!(
        csv.lines().count() > 5 && csv.lines().skip(1).all(|line| line.contains(",\"cutoff=2\",")),
        "{csv}"
    );
}

#[test]
fn a_graph_that_draws_no_scene_is_measured_too() {
    let place = Place::new();
    place.write(
        "fill.comp",
        "#version 460\nlayout(local_size_x = 64) in;\n\
         layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n\
         void main() { imageStore(image, ivec2(gl_GlobalInvocationID.x, 0), vec4(1.0)); }",
    );
    place.write(
        "fill.ron",
        r#"Graph(
          version: 1, summary: "White",
          resources: { "image": Image(format: "rgba8", size: ("viewport.width", "viewport.height")) },
          passes: [Dispatch(name: "fill", shader: "fill.comp", size: Threads("viewport.width"), bind: { "image": "image" })],
          output: "image",
        )"#,
    );
    let (json, errors) = place.said(&format!("{SHORT} scene.ply --pipelines fill.ron --size 64x2 --json"));
    let report: Value = serde_json::from_str(&json).expect("JSON alone on standard output");
    let found = &rows(&report)[0]["found"]["Ok"];
    assert_eq!(part(&found["mean"]["passes"], "fill")["bytes"], 64 * 2 * 4);
    assert!(errors.contains("passes of fill.ron"), "the tables stand beside the JSON: {errors}");
}

#[test]
fn the_sort_alone_is_measured_and_what_does_not_fit_says_why() {
    let place = Place::new();
    let text = done(
        &place,
        "--suite sort --pairs 5000,20000,67108864 --json=sort.json -o out --set digit_bits=4 --no-robustness",
    );
    let report = place.json("sort.json");
    assert_eq!((&report["validate"], &report["no_robustness"]), (&true.into(), &true.into()));
    assert!(text.contains("accesses of shaders are not checked (--no-robustness)"), "{text}");
    let found: Vec<(u64, u64, bool)> = rows(&report)
        .iter()
        .map(|row| {
            let number = |name: &str| row[name].as_u64().expect("a number");
            (number("pairs"), number("key_bits"), row["found"]["Ok"].is_object())
        })
        .collect();
    let expected = [(5000, true), (20_000, true), (67_108_864, false)];
    let expected =
        expected.into_iter().flat_map(|(pairs, fits)| [16, 24, 32].map(|bits| (pairs, bits, fits)));
    assert_eq!(found, expected.collect::<Vec<_>>());
    for row in &rows(&report)[..6] {
        let sorted = &row["found"]["Ok"];
        let ms = sorted["phase"]["gpu_ms"]["median"].as_f64().expect("lavapipe has a timer");
        let rate = row["pairs"].as_f64().unwrap() / ms * 1e-6;
        assert!((sorted["gkeys_per_s"].as_f64().unwrap() / rate - 1.0).abs() < 1e-9, "{sorted}");
        assert!(sorted["at_most_ms"].as_f64().unwrap() >= ms, "{sorted}");
        // One fill of the totals, and three dispatches for each 4-bit digit.
        let passes = sorted["passes"].as_array().map(Vec::len);
        assert_eq!(passes.map(|count| count as u64), Some(1 + 3 * row["key_bits"].as_u64().unwrap() / 4));
    }
    assert!(text.contains("67,108,864, 32 bits: not sorted: `keys#0` has 256.0 MiB"), "{text}");
    let csv = place.text("out/bench.csv");
    assert_eq!(csv.lines().count(), 1 + 9, "{csv}");
    assert!(csv.lines().all(|line| line.matches(',').count() >= 10), "{csv}");
    let svg = place.text("out/sort.svg");
    assert!(svg.contains("keys of 24 bits"), "{svg}");
}

#[test]
fn a_graph_whose_requirements_no_device_meets_is_a_row_and_two_names_of_one_file_are_told() {
    let place = Place::new();
    let (source, _) = place.said("source splat");
    let none = source.replacen("require: [", "require: [(\"scene.count > 5000\", \"many splats\"), ", 1);
    place.write("none.ron", &none);
    place.write("pipelines/splat.ron", source.replace("summary: \"", "summary: \"Mine. "));
    let line = format!("{SHORT} scene.ply --sizes 64x48 --json=found.json -p");
    let (_, errors) = place.said(&format!("{line} none.ron,splat,pipelines/splat.ron"));
    assert!(errors.contains("`splat` is pipelines/splat.ron, which takes precedence over"), "{errors}");
    assert!(
        errors.contains("`splat` and `pipelines/splat.ron` are one graph: pipelines/splat.ron"),
        "{errors}"
    );
    let report = place.json("found.json");
    let found: Vec<bool> = rows(&report).iter().map(|row| row["found"]["Ok"].is_object()).collect();
    assert_eq!(found, [false, true, true]);
    let (_, errors) = place.said("dump pipelines/splat.ron --diff splat");
    assert!(errors.contains("are one graph") && errors.contains("takes precedence"), "{errors}");
    let (_, errors) = place.said("dump splat --diff splat --set-b digit_bits=4");
    assert!(errors.is_empty(), "{errors}");
    place.fails(&format!("{line} none.ron"), 1);
    assert!(place.json("found.json")["rows"][0]["found"]["Err"].is_string());
}

#[test]
fn mistakes_are_told_before_anything_is_drawn_and_a_candidate_that_does_not_fit_is_a_row() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.write("kept.json", "{}");
    place.refuses(
        SHORT,
        &[
            ("scene.ply --pipelines splat,splta", 1, "there is no graph `splta`"),
            ("scene.ply --set digit_bitz=4", 1, "did you mean `digit_bits`"),
            ("scene.ply --set key_bits=99", 1, "99 is not in 8 to 32"),
            ("scene.ply --pipelines splat,splat", 2, "expected each value once, found `splat` twice"),
            ("scene.ply --pipelines splat,,key16", 2, "found an empty one"),
            ("scene.ply --sizes 64x48,64", 2, "expected WIDTHxHEIGHT"),
            ("scene.ply --splats 0", 2, "0 is not in 1.."),
            ("scene.ply -c cameras.json -c cameras.json", 2, "expected one --cameras for all scenes"),
            ("scene.ply --pairs 100", 2, "add --suite sort"),
            ("scene.ply --suite sort", 2, "SCENE is for --suite frames"),
            ("--suite sort --set key_bits=8", 2, "--set key_bits: --suite sort sets it itself"),
            ("--suite sort --set digit_bits=12 --json=kept.json", 1, "12 is not in 1 to 11"),
            ("scene.ply --json=scene.ply", 2, "--json would overwrite the scene"),
            ("missing.ply", 1, "missing.ply"),
            (
                "scene.ply --pipelines unsorted,bench/copy --set mebibytes=4000 --sizes 32x24",
                1,
                "no parameter `mebibytes`",
            ),
        ],
    );
    place
        .write("large.ron", "Preset(graph: \"bench/copy\", summary: \"4 GB\", set: { \"mebibytes\": 4000 })");
    let (text, said) = place.said(&format!("{SHORT} scene.ply --pipelines unsorted,large.ron --sizes 32x24"));
    assert!(said.contains("1 of 2 rows could not be drawn"), "{said}");
    assert!(
        text.contains("large.ron: not drawn: `from` has 3.91 GiB") && text.contains("passes of unsorted"),
        "{text}"
    );
}
