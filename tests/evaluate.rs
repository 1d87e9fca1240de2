//! `evaluate` as a command: a scene is rendered to photographs, and scenes are scored against them.

use crate::place::Place;
use serde_json::Value;
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, Projection};

fn photographed() -> Place {
    let place = Place::demo(5000);
    place.done("synth --photograph scene.ply --dataset views --views 9 --size 96x54");
    place
}

#[test]
fn a_scene_is_photographed_again_by_the_same_command_and_never_into_another_dataset() {
    let place = photographed();
    let again = "synth --photograph scene.ply --dataset views --views 9 --size 96x54";
    for hidden in ["views/.DS_Store", "views/images/.DS_Store"] {
        place.write(hidden, "");
    }
    std::fs::create_dir(place.at("views/lost+found")).expect("made");
    let files = place.files("views");
    place.done(again);
    // Simulates an interrupted run.
    std::fs::remove_dir_all(place.at("views/sparse")).expect("it is there");
    std::fs::remove_file(place.at("views/images/view-0008.png")).expect("it is there");
    place.done(again);
    assert!(place.files("views") == files);

    let fewer = "synth --photograph scene.ply --dataset views --size 96x54 --views 8";
    let larger = "synth --photograph scene.ply --dataset views --views 9";
    place
        .refuses("", &[(fewer, 2, "found views/images/view-0008.png"), (larger, 2, "found views/sparse/0/")]);
    for other in ["images/IMG_1.jpg", "sparse/0/images.bin", "sparse/cameras.txt", "cameras.bin"] {
        place.write(&format!("views/{other}"), "");
        let why = format!("expected --dataset without files of another dataset, found views/{other}");
        place.refuses("", &[(again, 2, &why)]);
        std::fs::remove_file(place.at(format!("views/{other}"))).expect("it is there");
    }
}

fn scored(place: &Place, more: &str) -> Value {
    place.told(&format!("evaluate scene.ply -c views --json {more}"))
}

#[test]
fn a_photographed_scene_scores_as_well_as_8_bits_allow_and_another_scene_does_not() {
    let place = photographed();
    let exact = scored(&place, "--backend reference -o scores");
    // Every eighth view is scored: of nine, the first and the last.
    let views: Vec<&str> =
        exact["views"].as_array().expect("views").iter().map(|v| v["view"].as_str().unwrap()).collect();
    assert_eq!(views, ["view-0000.png", "view-0008.png"]);
    // Rounding to 8 bits is an error of 1 / (255 sqrt(12)), 58.9 dB.
    let psnr = |found: &Value| found["mean"]["psnr_db"].as_f64().expect("a number");
    assert!((58.0..60.0).contains(&psnr(&exact)), "{exact:#}");
    assert!(exact["mean"]["ssim"].as_f64() > Some(0.998), "{exact:#}");
    for name in ["renders/view-0000", "photographs/view-0008", "differences/view-0000"] {
        assert!(place.at(format!("scores/{name}.png")).is_file(), "{name}");
    }
    let drawn = scored(&place, "--all");
    assert_eq!(drawn["views"].as_array().map(Vec::len), Some(9));
    assert!(psnr(&drawn) > 50.0, "{drawn:#}");
    assert_eq!(drawn["all"], true);
    let rule = |line: &str| place.code(line).1.contains("scored: every 8th view by name, 2 of 9");
    assert!(rule("evaluate scene.ply -c views"));
    assert!(!rule("evaluate scene.ply -c views --all"));
    let (table, errors) = place.said("evaluate scene.ply -c views --json=scores.json --all -o scores");
    assert!(!errors.contains("not of this run"), "{errors}");
    let (_, errors) = place.said("evaluate scene.ply -c views -o scores");
    let left = "scores/renders: 7 files are not of this run, such as view-0001.png\n";
    assert!(errors.contains(left) && errors.contains("scores/differences: 7 files"), "{errors}");
    assert!(table.contains("view-0000.png") && place.json("scores.json")["mean"] == drawn["mean"], "{table}");
    assert_eq!(
        (&drawn["photographs"], &drawn["background"]),
        (&Value::Null, &serde_json::json!([0.0, 0.0, 0.0]))
    );
    let origin = &drawn["origin"];
    assert!(origin["based_on"][0].is_string(), "`auto` is based on a graph: {drawn:#}");
    assert!(origin["device"].is_string() && origin["parameters"].is_object(), "{drawn:#}");
    let half = scored(&place, "--backend reference --downscale 2");
    assert_eq!((&half["origin"]["downscaled"], &origin["downscaled"]), (&"averaged".into(), &Value::Null));
    assert_eq!(
        (half["views"][0]["width"].as_u64(), half["views"][0]["height"].as_u64()),
        (Some(48), Some(27))
    );
    // A downscaled photograph averages 2 x 2 pixels; a render at half size samples once.
    assert!((20.0..psnr(&exact)).contains(&psnr(&half)), "{half:#}");
    place.done("synth demo --count 300 --seed 3 -o other.ply");
    let other = place.done("evaluate other.ply -c views/sparse/0 --backend reference");
    let mean = other.lines().last().expect("a row").split_whitespace().nth(1).expect("a number");
    assert!(mean.parse::<f64>().expect("a number") < 30.0, "{other}");
}

#[test]
fn the_score_of_an_average_over_frames_does_not_depend_on_the_views_before() {
    let place = photographed();
    place.average();
    let psnr =
        |line: &str, view: usize| scored(&place, line)["views"][view]["psnr_db"].as_f64().expect("a number");
    let last = psnr("-p mean.ron", 1);
    assert_eq!(psnr("-p mean.ron --all", 8), last);
    assert!(last < 30.0 && psnr("-p mean.ron --repeat 30", 1) > 50.0, "{last}");
    let said = |more: &str| place.said(&format!("evaluate scene.ply -c views -p mean.ron {more}")).1;
    let note = "`mean.ron` reads the previous frame: frame 2 of each view is scored, in which an average has not \
                converged; --repeat N draws more";
    assert!(said("").contains(note) && !said("--repeat 2").contains("converged"));
}

#[test]
fn cameras_are_moved_with_a_scene_and_a_dataset_that_lacks_a_file_is_told() {
    let place = photographed();
    let steps = "--transform rotate:1,0.5,0,100 --transform scale:2.5 --transform move:0,1,0";
    let (_, errors) = place.said(&format!("convert scene.ply moved.ply {steps}"));
    assert!(errors.contains("cameras.json is not moved: `-c cameras.json --write-cameras FILE`"), "{errors}");
    place.write("kept/note.txt", "");
    let told = ["kept/a.ply", "kept.ply"].map(|to| place.said(&format!("convert scene.ply {to}")).1);
    let note = "no cameras are beside kept/a.ply: draw it with `-c cameras.json`";
    assert_eq!(told.each_ref().map(|errors| errors.contains(note)), [true, false], "{told:?}");
    let refused = place.fails("convert scene.ply kept/b.ply --where opacity>2", 1);
    assert!(!refused.contains("no cameras are beside"), "{refused}");
    let line = format!("convert scene.ply moved.ply {steps} -c views --write-cameras moved.cameras.json");
    let (_, errors) = place.said(&line);
    assert!(!errors.contains("not moved"), "{errors}");
    let psnr = |line: &str| {
        place.told(&format!("evaluate {line} --backend reference --json"))["mean"]["psnr_db"].as_f64()
    };
    let photographs = "--photographs views/images";
    assert!(psnr(&format!("moved.ply -c moved.cameras.json {photographs}")) > Some(58.0));
    assert!(psnr("moved.ply -c views") < Some(30.0));
    let told = place.done("info moved.ply -c moved.cameras.json");
    let rotation = told.split("turns the scene upright").next().and_then(|text| text.split('`').nth_back(1));
    let line = "convert moved.ply up.ply -c moved.cameras.json --write-cameras up.cameras.json";
    let steps = rotation.and_then(|text| text.strip_prefix("convert ")).unwrap_or_else(|| panic!("{told}"));
    place.done(&format!("{line} {steps}"));
    let up = &place.told("info up.ply -c up.cameras.json --json")["cameras_up"];
    assert!(up[1].as_f64() < Some(-0.999_99), "{up}");

    // The comment of `ns-export`, with its spelling of nerfstudio.
    let mut trained = place.bytes("scene.ply");
    trained.splice(4..4, b"comment Generated by Nerstudio 1.1.5\n".iter().copied());
    place.write("trained.ply", trained);
    let said = |line: &str| place.said(&format!("evaluate {line} --backend reference")).1;
    let advice = "copy the dataparser_transforms.json of the training";
    assert!(said("trained.ply -c views").contains(advice) && !said("scene.ply -c views").contains(advice));
    assert!(!said(&format!("trained.ply -c moved.cameras.json {photographs}")).contains(advice));

    std::fs::create_dir(place.at("views/sparse/1")).expect("made");
    for name in ["cameras.txt", "images.txt"] {
        place.write(&format!("views/sparse/1/{name}"), place.text(&format!("views/sparse/0/{name}")));
    }
    let other = "COLMAP's model 0 is read, with 9 cameras; not read: views/sparse/1\n";
    assert!(said("scene.ply -c views").contains(other));
    std::fs::rename(place.at("views/images"), place.at("views/images_2")).expect("renamed");
    let why = "expected a folder `images` near the cameras, found images_2: --downscale 2 takes images_2";
    place.refuses("evaluate scene.ply -c views", &[("", 2, why), ("--downscale 4", 2, why)]);
    assert!(said("scene.ply -c views --downscale 2").contains("the photographs are those of images_2\n"));
    let twice = said("scene.ply -c views --photographs views/images_2 --downscale 2");
    assert!(!twice.contains("reduced before"), "the photographs have the size of the cameras: {twice}");
    place.done("render scene.ply -c views --size 48x27 -o small");
    let twice = said("scene.ply -c views --photographs small --downscale 2");
    let reduced = "averaged to 1/2 of their size, to 24 pixels across: they were reduced before, as the cameras have 96\n";
    assert!(twice.contains(reduced), "{twice}");
}

#[test]
fn a_scene_that_is_too_near_to_be_drawn_whole_is_told_with_its_scores() {
    let place = photographed();
    place.done(
        "convert scene.ply small.ply --transform scale:0.005 -c views --write-cameras small.cameras.json",
    );
    let line = "-c small.cameras.json --photographs views/images --backend reference --json=scores.json";
    let (_, errors) = place.said(&format!("evaluate small.ply {line}"));
    assert!(errors.contains("2 of 2 cameras lose a large part of their picture, up to "), "{errors}");
    assert!(errors.contains("0.2 units; enlarge the scene and its cameras"), "{errors}");
    assert!(place.json("scores.json")["views"][0]["too_near"].as_u64() > Some(0));
    assert!(scored(&place, "")["views"][0].get("too_near").is_none());
}

/// Writes a `transforms.json` of the first `count` views, with more fields of the file.
fn transforms(place: &Place, count: usize, fields: &str) {
    let frame = |camera: &Camera| {
        let (r, p) = (camera.rotation, camera.position);
        let matrix = [0, 1, 2].map(|row| [r[row][0], -r[row][1], -r[row][2], p[row]]);
        let name = format!("images/{}.png", camera.img_name);
        serde_json::json!({"file_path": name, "transform_matrix": matrix, "mask_path": "m.png"})
    };
    let cameras = Camera::load(place.at("views/sparse/0")).expect("cameras");
    let frames: Vec<Value> = cameras[..count].iter().map(frame).collect();
    let Camera { width, height, fx, fy, .. } = cameras[0];
    let frames = serde_json::to_string(&frames).expect("JSON");
    let text = format!(
        r#"{{"w": {width}, "h": {height}, "fl_x": {fx}, "fl_y": {fy}, {fields} "frames": {frames}}}"#
    );
    place.write("views/transforms.json", text);
}

#[test]
fn the_test_views_of_nerfstudio_are_scored_and_stay_test_views_of_a_written_file() {
    let place = Place::demo(5000);
    place.done("synth --photograph scene.ply --dataset views --views 12 --size 96x54");
    let mut trained = place.bytes("scene.ply");
    trained.splice(4..4, b"comment Generated by Nerstudio 1.1.5\n".iter().copied());
    place.write("trained.ply", trained);
    let line = "evaluate trained.ply -c views/transforms.json --backend reference --json=scores.json";
    let scored = |more: &str| {
        let (_, errors) = place.said(&format!("{line} {more}"));
        let found = place.json("scores.json");
        let name =
            |view: &Value| view["view"].as_str().unwrap().replace("images/view-00", "").replace(".png", "");
        let names: Vec<String> = found["views"].as_array().unwrap().iter().map(name).collect();
        (errors, names.join(" "), found["origin"]["split"].as_str().unwrap().to_owned())
    };
    transforms(&place, 12, "\"cx\": 44,");
    let (errors, names, split) = scored("");
    assert_eq!((names.as_str(), split.as_str()), ("00 08", "every-8th"));
    assert!(errors.contains("`--split nerfstudio` scores those that it holds out by default"), "{errors}");
    assert!(errors.contains("copy the dataparser_transforms.json"), "{errors}");
    assert!(
        !errors.contains("off the middle"),
        "nerfstudio trains with the file's principal point: {errors}"
    );
    let (errors, names, split) = scored("--split nerfstudio");
    assert_eq!((names.as_str(), split.as_str()), ("10", "nerfstudio"));
    assert!(errors.contains("scored: the views that nerfstudio holds out by default, 1 of 12"), "{errors}");
    assert!(!errors.contains("--split"), "{errors}");
    assert!(!scored("--split every-8th").0.contains("--split"));
    assert_eq!(scored("--all").2, "all");

    let lists = r#""train_filenames": ["images/view-0000.png"], "val_filenames": ["images/view-0001.png"],"#;
    transforms(&place, 2, lists);
    let (errors, names, split) = scored("");
    assert_eq!((names.as_str(), split.as_str()), ("01", "val_filenames"));
    assert!(errors.contains("scored: `val_filenames`, as there is no `test_filenames`, 1 of 2"), "{errors}");
    let named = "expected a dataset that names no test views with --split, found `val_filenames`";
    place.refuses(line, &[("--split nerfstudio", 2, named)]);
    let convert =
        "convert scene.ply moved.ply --transform scale:2 -c views/transforms.json --write-cameras moved.json";
    let (_, errors) = place.said(convert);
    assert!(errors.contains("moved.json: masks (`mask_path`) are not written"), "{errors}");
    let (_, moved) =
        place.said("evaluate moved.ply -c moved.json --photographs views --json=moved_scores.json");
    let found = place.json("moved_scores.json");
    assert_eq!(found["views"].as_array().map(Vec::len), Some(1), "{moved}");
    assert_eq!(
        (&found["views"][0]["view"], &found["origin"]["split"]),
        (&"images/view-0001".into(), &"test".into())
    );
}

#[test]
fn a_photograph_that_is_missing_damaged_or_of_another_shape_costs_no_other_view() {
    let place = photographed();
    let image = |view: u32| format!("views/images/view-000{view}.png");
    std::fs::remove_file(place.at(image(2))).expect("it is there");
    let whole = place.bytes(&image(3));
    place.write(&image(3), &whole[..whole.len() / 2]);
    place.done("render scene.ply --size 54x54 -o square.png");
    std::fs::copy(place.at("square.png"), place.at(image(4))).expect("a copy");
    // A photograph that was reduced and cut to whole pixels is the same view.
    place.done("render scene.ply --size 32x17 -o small.png");
    std::fs::copy(place.at("small.png"), place.at(image(5))).expect("a copy");
    let errors = place.fails("evaluate scene.ply -c views --all --backend reference --json=scores.json", 1);
    for why in [
        "view-0002.png: expected the photograph",
        "view-0003.png: unexpected end of file",
        "view-0004.png: expected a photograph of 96 x 54 pixels, or of that shape, found 54 x 54",
    ] {
        assert!(errors.contains(why), "{why}: {errors}");
    }
    let found = place.json("scores.json");
    let missing = ["view-0002.png", "view-0003.png", "view-0004.png"];
    assert_eq!(found["missing"], serde_json::json!(missing));
    assert_eq!((found["views"].as_array().map(Vec::len), &found["mean"]["psnr_db"]), (Some(6), &Value::Null));
}

#[test]
#[cfg(target_os = "linux")]
fn a_picture_that_cannot_be_written_stops_the_run_and_is_no_missing_photograph() {
    let place = photographed();
    std::fs::create_dir_all(place.at("scores/renders")).expect("a folder");
    std::os::unix::fs::symlink("/dev/full", place.at("scores/renders/view-0002.png")).expect("made");
    let errors =
        place.fails("evaluate scene.ply -c views --all --backend reference -o scores --json=scores.json", 1);
    assert!(errors.contains("No space left") && !errors.contains("view-0003"), "{errors}");
    assert!(place.at("scores/renders/view-0001.png").exists() && !place.at("scores.json").exists());
}

#[test]
fn the_cameras_of_a_dataset_are_drawn_by_render_and_mistakes_are_told() {
    let place = photographed();
    let render = "render scene.ply --backend reference -o";
    place.done(&format!("{render} all -c views"));
    assert_eq!(std::fs::read_dir(place.at("all")).expect("pictures").count(), 9);
    let compared = place.done("compare all views/images --min-psnr 55");
    assert!(compared.contains("view-0008"), "{compared}");
    let look = "orbit --orbit 3 --eye 0,-1,-6 --fov 45 --size 40x30";
    place.done(&format!("{render} {look} --write-cameras orbit.json --output alpha=alpha/"));
    assert_eq!(std::fs::read_dir(place.at("orbit")).expect("pictures").count(), 3);
    place.done(&format!("{render} again -c orbit.json --output alpha=again/alpha/"));
    for name in ["orbit-0000", "orbit-0002"] {
        for (first, second) in [("orbit", "again"), ("alpha", "again/alpha")] {
            let extension = if first == "alpha" { "npy" } else { "png" };
            let [first, second] = [first, second].map(|folder| format!("{folder}/{name}.{extension}"));
            assert!(place.bytes(&first) == place.bytes(&second), "{first} {second}");
        }
    }
    place.refuses(
        "",
        &[("render scene.ply -o a.png --write-cameras scene.ply", 2, "would overwrite the scene")],
    );

    std::fs::create_dir(place.at("shared")).expect("made");
    place.write("shared/job.json", "{}");
    let shared = "expected a folder without job.json, found shared";
    place.refuses("", &[("evaluate scene.ply -c views -o shared", 2, shared)]);
    let [cameras, photograph] = ["the cameras", "a photograph of the dataset"]
        .map(|input| format!("--json would overwrite {input}, views/"));
    place.refuses(
        "",
        &[
            ("evaluate scene.ply -c views --json=views/sparse/0/images.txt", 2, &cameras),
            ("render scene.ply -c views#1 -o x.png --json=views/sparse/0/cameras.txt", 2, &cameras),
            ("convert scene.ply --price -c views --json=views/sparse/0/images.txt", 2, &cameras),
            // Not a test view.
            ("evaluate scene.ply -c views --json=views/images/view-0001.png", 2, &photograph),
        ],
    );
    std::fs::remove_file(place.at("views/images/view-0008.png")).expect("it is there");
    std::fs::create_dir(place.at("empty")).expect("a folder");
    let mut fisheyes = Camera::load(place.at("views")).expect("cameras");
    fisheyes.iter_mut().for_each(|camera| camera.projection = Projection::Fisheye);
    Camera::save(&fisheyes, place.at("fisheyes.json")).expect("written");
    place.write("broken.ron", "Graph(");
    place.refuses(
        "",
        &[
            ("evaluate scene.ply -c views", 1, "expected the photograph "),
            (
                "evaluate scene.ply -c views -p fisheye",
                1,
                "view-0000.png: expected a graph for pinhole cameras, found one for fisheye cameras",
            ),
            ("evaluate scene.ply -c cameras.json", 2, "name it with --photographs"),
            ("evaluate scene.ply -c empty", 1, "expected cameras.json, transforms.json"),
            ("evaluate scene.ply -c views --backend reference --set cutoff=3", 2, "--set is for graphs"),
            (
                "evaluate scene.ply -c fisheyes.json --photographs views/images -p broken.ron",
                1,
                "broken.ron:1:",
            ),
            ("synth --photograph scene.ply", 2, "--dataset"),
            ("synth uniform -o u.ply --dataset new", 2, "expected --photograph with --dataset, found none"),
            ("synth uniform -o u.ply --views 3", 2, "expected --photograph with --views, found none"),
            ("render scene.ply --orbit 2 -o one.png", 2, "expected one camera for the picture"),
        ],
    );
    let identity = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]";
    place.write(
        "views/transforms.json",
        format!(
            r#"{{"w": 96, "h": 54, "fl_x": 80, "test_filenames": ["./images/view-0000.png", "images/x.png"],
                "frames": [{{"file_path": "images/view-0000.png", "transform_matrix": {identity}}}]}}"#
        ),
    );
    let why = "`test_filenames`: expected photographs of frames, found images/x.png; --all scores all frames";
    place.refuses("", &[("evaluate scene.ply -c views/transforms.json", 1, why)]);
    let wrong = place.text("views/sparse/0/cameras.txt");
    place.write("views/sparse/0/cameras.txt", wrong.replacen("PINHOLE", "OPENCV", 1));
    let why = "cameras.txt:2: `k1`: expected a value, found the end of the line";
    place.refuses("", &[("render scene.ply -c views -o x", 1, why)]);
}

#[test]
fn grey_photographs_and_pinholes_whose_middle_is_elsewhere_are_told() {
    let place = photographed();
    let photograph = place.image("views/images/view-0000.png");
    let grey = |x, y| [photograph.at(x, y)[1]; 3];
    let of_grey = Image::from_fn(photograph.width, photograph.height, grey);
    let line = "evaluate scene.ply --backend reference --photographs views/images";
    assert!(!place.said(&format!("{line} -c views")).1.contains("grey"));
    of_grey.save(&place.at("views/images/view-0000.png")).expect("saved");
    let told = place.said(&format!("{line} -c views --json=scores.json")).1;
    assert!(told.contains("1 photograph is grey: the colours of the pictures count as errors\n"), "{told}");
    let views = &place.json("scores.json")["views"];
    assert_eq!((&views[0]["is_grey"], views[1].get("is_grey")), (&Value::Bool(true), None));
    let mut cameras = Camera::load(place.at("views")).expect("cameras");
    cameras.iter_mut().for_each(|camera| camera.principal_offset = [3.0, 0.0]);
    let said = |cameras: &[Camera]| {
        Camera::save(cameras, place.at("aside.json")).expect("written");
        place.said(&format!("{line} -c aside.json")).1
    };
    assert!(said(&cameras).contains("principal points are up to 3.0 pixels off the middle"));
    cameras.iter_mut().for_each(|camera| camera.projection = Projection::Fisheye);
    assert!(!said(&cameras).contains("off the middle"), "nobody trains fisheyes with the middle");
}

#[test]
fn pixels_that_are_black_in_a_mask_are_not_scored() {
    let place = photographed();
    // A passer-by covers the left third of the first view.
    let one = "views/images/view-0000.png";
    let photograph = place.image(one);
    let is_hidden = |x: usize| 3 * x < photograph.width;
    let white = |x: usize, y: usize| if is_hidden(x) { [1.0; 3] } else { photograph.at(x, y) };
    let (width, height) = (photograph.width, photograph.height);
    Image::from_fn(width, height, white).save(&place.at(one)).expect("saved");
    let masks = |file: &str, mask: Image| {
        place.write(&format!("masks/{file}"), "");
        mask.save(&place.at(format!("masks/{file}"))).expect("saved");
    };
    masks("view-0000.png.png", Image::from_fn(width, height, |x, _| [f32::from(u8::from(!is_hidden(x))); 3]));
    let line = "evaluate scene.ply -c views --backend reference";
    let said = place.fails(&format!("{line} --masks masks"), 1);
    assert!(said.contains("expected the mask view-0008.png.png in masks, found none"), "{said}");
    // A full-size mask: an eighth of its sides is rounded to those of the photograph.
    masks("view-0008.png", Image::from_fn(8 * width + 3, 8 * height - 3, |_, _| [1.0; 3]));
    let found = scored(&place, "--backend reference --masks masks -o scores");
    assert_eq!(
        place.image("scores/differences/view-0000.png").at(0, 0),
        [0.0; 3],
        "the passer-by is not scored"
    );
    let (masked, whole) = (&found["views"][0], &found["views"][1]);
    assert!(
        (masked["counted"].as_f64(), whole["counted"].as_f64()) == (Some(2.0 / 3.0), Some(1.0)),
        "{found:#}"
    );
    for view in [masked, whole] {
        assert!((58.0..60.0).contains(&view["psnr_db"].as_f64().expect("a number")), "{view}");
        assert!(view["ssim"].as_f64() > Some(0.998) && view["flip"].as_f64() < Some(0.02), "{view}");
    }
    let all = scored(&place, "--backend reference");
    assert!(
        all["views"][0]["psnr_db"].as_f64() < Some(20.0) && all["views"][0].get("counted").is_none(),
        "{all:#}"
    );
    assert!(place.done(&format!("{line} --masks masks")).contains("96 x 54, 66.7 % counted"));
    masks("dark/view-0000.png", Image::from_fn(width, height, |_, _| [0.0; 3]));
    masks("dark/view-0008.png", Image::from_fn(height, width, |_, _| [1.0; 3]));
    let said = place.fails(&format!("{line} --masks masks/dark"), 1);
    assert!(said.contains("expected a mask with pixels that count, found only black"), "{said}");
    assert!(said.contains("expected a mask of the shape of 96 x 54, found 54 x 96"), "{said}");
    place.refuses(
        line,
        &[
            ("--masks nowhere", 1, "expected the mask view-0000.png.png in nowhere, found none"),
            ("--masks views/images", 1, "expected a folder of masks for --masks, found the photograph"),
            ("--masks masks --json=masks/view-0008.png", 2, "a mask"),
        ],
    );
}
