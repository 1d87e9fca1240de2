//! Films: equal frames in every format, folders with missing frames, blur, and mistakes.

use crate::common;
use crate::place::Place;
use serde_json::json;
use splatgraph::io::image::Image;
use std::fs;
use std::process::Stdio;

const SIZE: (usize, usize) = (48, 27);

/// Films four frames through the cameras of the folder. The output path must be appended.
const LINE: &str = "video scene.ply --cameras=cameras.json --seconds=0.4 --fps=10 --size=48x27 \
                    --background=0.1,0.2,0.3 --closed --pipeline=splat -o";

fn drawn(place: &Place, more: &str) -> String {
    place.done(&format!("{LINE} {more}"))
}

fn frame(place: &Place, name: &str, index: usize) -> Image {
    let image = place.image(&format!("{name}/{index:05}.png"));
    assert_eq!((image.width, image.height), SIZE);
    image
}

/// Returns the largest difference of a channel, in 8-bit steps.
fn difference(a: &Image, b: &Image) -> f32 {
    let pairs = a.rgb.as_flattened().iter().zip(b.rgb.as_flattened());
    255.0 * pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn every_format_has_the_frames_of_the_folder_which_begin_at_the_first_camera() {
    let place = Place::demo(5000);
    let said = drawn(&place, "frames --validate");
    assert!(said.starts_with("frames: 4 frames of 48 x 27, 0.4 s at 10 fps; 4 drawn in"), "{said}");
    let frames: Vec<Image> = (0..4).map(|index| frame(&place, "frames", index)).collect();
    assert!(frames.windows(2).all(|pair| difference(&pair[0], &pair[1]) > 30.0), "the camera moves");
    place.done(
        "render scene.ply -c cameras.json#0 --size 48x27 -p splat -o still.png --background=0.1,0.2,0.3",
    );
    let still = place.image("still.png");
    assert!(difference(&frames[0], &still) < 2.5, "{}", difference(&frames[0], &still));

    drawn(&place, "film.apng");
    let file = std::io::BufReader::new(fs::File::open(place.at("film.apng")).expect("written"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    for frame in &frames {
        reader.next_frame(&mut bytes).expect("a frame");
        assert!(bytes == frame.bytes().0);
    }
    let said = drawn(&place, "film.gif");
    assert!(said.contains("bytes; 4 drawn"), "{said}");
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::RGBA);
    let file = fs::File::open(place.at("film.gif")).expect("written");
    let mut reader = options.read_info(std::io::BufReader::new(file)).expect("a GIF");
    for (index, frame) in frames.iter().enumerate() {
        let found = reader.read_next_frame().expect("a frame").expect("one of four");
        assert_eq!((usize::from(found.width), usize::from(found.height)), (frame.width, frame.height));
        // A palette has 256 colours, so the frame is only the nearest one.
        let far = |frame: &Image| {
            let found = found.buffer.chunks_exact(4).flat_map(|pixel| &pixel[..3]);
            found.zip(frame.bytes().0).map(|(a, b)| u64::from(a.abs_diff(b))).sum::<u64>()
        };
        assert_eq!((0..frames.len()).min_by_key(|&other| far(&frames[other])), Some(index));
    }
    assert!(reader.read_next_frame().expect("the end").is_none());
}

#[test]
fn the_same_command_again_draws_what_is_missing_and_another_film_is_refused() {
    let place = Place::demo(5000);
    drawn(&place, "frames");
    let at = |index: usize| place.at(format!("frames/{index:05}.png"));
    let read = || -> Vec<Vec<u8>> { (0..4).map(|index| fs::read(at(index)).expect("written")).collect() };
    let before = read();
    fs::remove_file(at(1)).expect("removed");
    // A file that is not a whole picture is redrawn. A whole picture is kept, whatever it shows.
    fs::write(at(2), &before[2][..before[2].len() / 2]).expect("written");
    fs::copy(at(0), at(3)).expect("copied");
    let said = drawn(&place, "frames");
    assert!(said.contains("(2 already there)") && said.contains("; 2 drawn in"), "{said}");
    let after = read();
    assert!(after[..3] == before[..3]);
    assert!(after[3] == before[0]);

    let other = "film.json belongs to another film (samples is 1 there and 2 here)";
    place.refuses(
        LINE,
        &[("frames --samples=2", 1, other), ("frames --set=cutoff=2", 1, "to another film (plan is")],
    );
    let of_another_build = place.text("frames/film.json").replace("\"program\": \"", "\"program\": \"x");
    place.write("frames/film.json", &of_another_build);
    place.refuses(LINE, &[("frames", 1, "to another film (program is")]);
    fs::remove_file(place.at("frames/film.json")).expect("removed");
    place.refuses(LINE, &[("frames", 1, "expected film.json beside frames/00000.png")]);
}

#[test]
fn the_cameras_of_a_path_file_are_the_frames_with_its_rate_and_its_holds() {
    let place = Place::demo(5000);
    // Moves, rests for a frame, and moves again, ever faster.
    let poses = [0.0, 0.1, 0.1, 0.3, 0.6].map(|x| {
        json!({"camera_to_world": [1, 0, 0, x, 0, -1, 0, -1, 0, 0, -1, -4, 0, 0, 0, 1], "fov": 50, "aspect": 1.5})
    });
    let path = json!({"render_width": 48, "render_height": 32, "fps": 25.0, "camera_path": poses});
    place.write("camera_path.json", path.to_string());
    let film = "video scene.ply -c camera_path.json -p splat -o";
    let (out, told) = place.said(&format!("{film} film --write-cameras film.json"));
    assert!(out.starts_with("film: 5 frames of 48 x 32, 0.2 s at 25 fps"), "{out}");
    assert!(
        told.contains("the 5 cameras are the frames of a film, 25 per second; --cameras-as keys"),
        "{told}"
    );
    let again = "film.json: the times of the frames are not written: `video -c film.json --cameras-as frames --fps 25`";
    assert!(told.contains(again), "{told}");
    place.done("render scene.ply -c camera_path.json -p splat -o stills/");
    for frame in 0..5 {
        let film = place.bytes(&format!("film/{frame:05}.png"));
        assert!(film == place.bytes(&format!("stills/camera{frame}.png")), "frame {frame}");
    }
    assert!(place.bytes("film/00001.png") == place.bytes("film/00002.png"), "a hold");
    // With a duration, the frames are at even places among the cameras; blur is that of the motion.
    let out = place.done(&format!("{film} slow --seconds 0.3 --fps 30 --write-cameras slow.json"));
    assert!(out.starts_with("slow: 9 frames of 48 x 32, 0.3 s at 30 fps"), "{out}");
    let x = |index: usize| place.json("slow.json")[index]["position"][0].as_f64().expect("a number");
    assert_eq!([x(2), x(3), x(4)], [0.1; 3]);
    assert!(x(5) > 0.12 && x(5) < 0.25 && (x(6) - 0.3).abs() < 1e-9, "{} {}", x(5), x(6));
    let (_, told) = place.said(&format!("{film} blurred --samples 4 --write-cameras blurred.json"));
    let note = "blurred.json: the cameras are those of the middle of each exposure";
    assert!(told.contains(note), "{told}");
    assert_eq!(place.text("blurred.json"), place.text("film.json"));
    let out = place.done(&format!("{film} keys --cameras-as keys --seconds 0.2"));
    assert!(out.starts_with("keys: 6 frames of 48 x 32, 0.2 s at 30 fps"), "{out}");
    assert!(place.bytes("keys/00001.png") != place.bytes("film/00001.png"));
    let out =
        place.done("video scene.ply -c cameras.json --cameras-as frames --size 48x27 --fps 4 -o four.y4m");
    assert!(out.starts_with("four.y4m: 4 frames of 48 x 27, 1.0 s at 4 fps"), "{out}");
    let white = json!({"r": 255, "g": 255, "b": 255});
    let crop = json!({"crop_center": [0, 0, 0], "crop_scale": [2, 2, 1], "crop_rot": [0, 0, 0], "crop_bg_color": white});
    let cropped = json!({"render_width": 48, "render_height": 32, "camera_path": poses, "crop": crop});
    place.write("cropped.json", cropped.to_string());
    let (_, told) = place.said("video scene.ply -c cropped.json -p splat -o cropped");
    let sides = "x > -1 && x < 1 && y > -1 && y < 1 && z > -0.5 && z < 0.5";
    let options = format!("the crop is not read: `--where '{sides}' --background 1,1,1` is the same");
    assert!(told.contains(&options), "{told}");
    place.edit("camera_path.json", "25.0", "0.0");
    let rate = "expected cameras with 0.1 to 1000 frames per second, found 0; --fps chooses another rate";
    place.refuses(film, &[("other", 2, rate)]);
}

#[test]
fn shards_draw_the_frames_of_a_film_once_and_a_run_without_them_completes_it() {
    let place = Place::demo(5000);
    drawn(&place, "whole --samples=2");
    let said = drawn(&place, "shared --samples=2 --shard=1/3");
    assert!(said.starts_with("shared: shard 1/3, 1 of 4 frames of 48 x 27, 0.4 s"), "{said}");
    assert!(!place.at("shared/00000.png").exists() && place.at("shared/00001.png").exists());
    let said = drawn(&place, "shared --samples=2 --shard=0/3");
    assert!(said.contains("shard 0/3, 2 of 4 frames") && said.contains("; 2 drawn in"), "{said}");
    let again = drawn(&place, "shared --samples=2 --shard=0/3");
    assert!(again.contains("(2 already there)") && again.contains("; 0 drawn in"), "{again}");
    let faster = LINE.replace("--seconds=0.4 --fps=10", "--seconds=0.2 --fps=20");
    let said = place.done(&format!("{faster} shared --samples=2"));
    assert!(said.contains("(3 already there)") && said.contains("; 1 drawn in"), "{said}");
    assert_eq!(place.json("shared/film.json")["fps"], "20", "the rate is not compared");
    for index in 0..4 {
        assert!(
            place.bytes(&format!("shared/{index:05}.png")) == place.bytes(&format!("whole/{index:05}.png"))
        );
    }
    let animated = LINE.replace("=splat", "=stale_order");
    place.refuses(
        &animated,
        &[("one --shard=0/1", 2, "expected a graph that draws each view on its own with --shard")],
    );
}

#[test]
fn frames_that_depend_on_those_before_them_are_drawn_from_the_start_and_only_missing_ones_are_saved() {
    let place = Place::demo(5000);
    let line = LINE.replace("=splat", "=stale_order");
    place.done(&format!("{line} frames"));
    let before = place.bytes("frames/00002.png");
    fs::remove_file(place.at("frames/00002.png")).expect("removed");
    fs::copy(place.at("frames/00003.png"), place.at("frames/00000.png")).expect("copied");
    let resumed = place.run(&format!("{line} frames"));
    let (out, notes) = (String::from_utf8_lossy(&resumed.stdout), String::from_utf8_lossy(&resumed.stderr));
    assert!(out.contains("(3 already there)") && out.contains("; 3 drawn in"), "{out}");
    assert!(notes.contains("the first 3 are drawn, and the missing ones saved"), "{notes}");
    assert!(place.bytes("frames/00002.png") == before);
    assert!(place.bytes("frames/00000.png") == place.bytes("frames/00003.png"));
    let blurred = place.run(&format!("{line} blurred --samples=2"));
    let notes = String::from_utf8_lossy(&blurred.stderr);
    assert!(notes.contains("and each of the 2 samples counts as one"), "{notes}");
}

#[test]
fn blur_mixes_the_time_while_the_shutter_is_open_and_a_closed_shutter_blurs_nothing() {
    let place = Place::demo(5000);
    drawn(&place, "sharp");
    drawn(&place, "stopped --samples=3 --shutter=0");
    drawn(&place, "blurred --samples=8 --shutter=1");
    for index in 0..4 {
        let sharp = frame(&place, "sharp", index);
        assert!(difference(&sharp, &frame(&place, "stopped", index)) < 1.5);
        assert!(difference(&sharp, &frame(&place, "blurred", index)) > 10.0);
    }
}

#[test]
fn a_film_on_standard_output_is_a_y4m_and_a_reader_that_leaves_is_no_error() {
    let place = Place::demo(5000);
    drawn(&place, "film.y4m");
    let piped = place.run(&format!("{LINE} -"));
    assert!(piped.status.success());
    assert!(piped.stdout == place.bytes("film.y4m"));
    assert!(String::from_utf8_lossy(&piped.stderr).contains("standard output: 4 frames of 48 x 27"));
    // Encoders refuse odd sizes, which keyframes set in a window may have.
    place.done("render scene.ply -c cameras.json --size 49x27 -o stills/ --write-cameras odd.json");
    let odd = place.run("video scene.ply -c odd.json --seconds=0.1 --fps=10 -o odd.y4m");
    assert!(
        String::from_utf8_lossy(&odd.stderr).contains("encoders expect even numbers, the keys have 49 x 27")
    );
    assert!(place.bytes("odd.y4m").starts_with(b"YUV4MPEG2 W50 H28 "));
    for size in ["--size=48x27", "--size=640x360"] {
        let mut child = place
            .program(&format!("{} -", LINE.replace("--size=48x27", size)))
            .args(common::device_option())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it starts");
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("it ends");
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{text}");
        assert!(text.contains("the reader closed the pipe before the end of the film"), "{text}");
    }
}

#[test]
fn a_path_through_cameras_with_one_lens_keeps_it_and_needs_a_graph_that_draws_it() {
    let place = Place::demo(5000);
    let with = |lenses: [&str; 2]| {
        let mut cameras = place.json("cameras.json");
        let cameras = cameras.as_array_mut().expect("a list");
        cameras.truncate(2);
        for (camera, lens) in cameras.iter_mut().zip(lenses) {
            camera["projection"] = lens.into();
            // The focal length is in pixels per world unit for orthographic cameras, and per radian for the others.
            let scale = if lens == "orthographic" { 0.2 } else { 0.5 };
            for side in ["fx", "fy"] {
                camera[side] = (camera[side].as_f64().expect("a focal length") * scale).into();
            }
        }
        serde_json::to_string(cameras).expect("JSON")
    };
    let film = "video scene.ply --cameras=lens.json --seconds=0.2 --fps=10 --size=48x27 -o";
    for lens in ["fisheye", "orthographic", "equirectangular"] {
        place.write("lens.json", with([lens; 2]));
        let (_, told) = place.said(&format!("{film} {lens} -p {lens}"));
        assert!(!told.contains("tilted"), "{lens}: {told}");
        for index in 0..2 {
            let still = format!("{lens}-{index}.png");
            place.done(&format!("render scene.ply -c lens.json#{index} --size=48x27 -p {lens} -o {still}"));
            let far = difference(&frame(&place, lens, index), &place.image(&still));
            assert!(far < 2.5, "{still}: {far}");
        }
        let error = format!(
            "expected a graph for {lens} cameras, found one for pinhole cameras: use --pipeline {lens}"
        );
        place.refuses(film, &[("film.gif", 1, &error)]);
    }
    // Pinhole cameras are converted to the graph's projection, also those that are written.
    place.write("lens.json", with(["pinhole"; 2]));
    for lens in ["fisheye", "orthographic", "equirectangular"] {
        let (_, told) = place.said(&format!("{film} converted-{lens} -p {lens} --write-cameras {lens}.json"));
        let tilt = "panoramas are tilted by up to 8.4 degrees from the up direction 0,-1,0";
        assert_eq!(told.contains(tilt), lens == "equirectangular", "{told}");
        place.done(&format!("render scene.ply -c {lens}.json#1 -p {lens} -o still.png"));
        let far = difference(&frame(&place, &format!("converted-{lens}"), 1), &place.image("still.png"));
        assert!(far < 2.5, "{lens}: {far}");
        place.refuses(
            "render scene.ply -o still.png",
            &[(&format!("-c {lens}.json#1"), 1, &format!("expected a graph for {lens} cameras"))],
        );
    }
    let still = "render scene.ply -c lens.json#0 -o still.png --size=48x24";
    assert!(place.said(&format!("{still} -p equirectangular")).1.contains("panoramas are tilted by up to"));
    // The graph of a panorama must sort by distance to draw the half behind the camera.
    let half = format!("{still} -p tiled_cpu --set projection=equirectangular");
    let note = "tiled_cpu: what is behind the camera is not drawn";
    assert!(place.said(&half).1.contains(note));
    let fisheye = "render scene.ply -p splat --set projection=fisheye --eye=0,-1,0 --target=0,-1,1 --size=32x32 -o still.png";
    for (fov, is_told) in [(120, false), (200, true)] {
        let (_, told) = place.said(&format!("{fisheye} --fov={fov}"));
        assert_eq!(told.contains("splat: what is behind the camera is not drawn"), is_told, "{told}");
    }
    for chosen in ["--set key_of=distance", "--set key_of=depth"] {
        assert!(!place.said(&format!("{half} {chosen}")).1.contains(note), "{chosen}");
    }
    // Without a size, a panorama has the shape 2:1; without a target, it is level.
    place.done("video scene.ply --orbit=2 -p equirectangular -o round --write-cameras round.json");
    let camera = &place.json("round.json")[1];
    assert_eq!((&camera["width"], &camera["height"]), (&json!(960), &json!(480)), "{camera}");
    assert!(camera["rotation"][1][2].as_f64().is_some_and(|y| y.abs() < 1e-9), "{camera}");
    for lenses in [["fisheye", "pinhole"], ["fisheye", "orthographic"]] {
        place.write("lens.json", with(lenses));
        place.refuses(film, &[("film.gif -p fisheye", 1, "expected cameras with one projection")]);
        let still = "render scene.ply -c lens.json --size=48x27 -o stills/";
        place.refuses(still, &[("-p fisheye", 1, "expected cameras with one projection")]);
    }
}

#[test]
fn an_orbit_has_as_many_frames_as_it_says_and_mistakes_are_told() {
    let place = Place::demo(5000);
    place.done("video scene.ply --orbit=5 --eye=0,-1,-4 --size=32x18 -o turn --write-cameras turn.json");
    place.done("render scene.ply -c turn.json#3 -o still.png");
    let far = difference(&place.image("turn/00003.png"), &place.image("still.png"));
    assert!(far < 2.5, "{far}");
    let pictures = fs::read_dir(place.at("turn")).expect("a folder").count();
    assert_eq!(pictures, 6, "five pictures and film.json");
    place.done("video scene.ply --orbit=1 --size=32x18 -o turn.v2/");
    assert!(place.at("turn.v2/00000.png").exists(), "a slash makes a name with a dot a folder's");

    let (_, told) = place.said("video scene.ply --orbit=2 --eye=0,-1,0 --target=0,-2,0 --size=32x18 -o spin");
    assert!(told.contains("the camera only turns on the spot"), "{told}");

    let output = place.run("video scene.ply scene.ply --orbit=1 --size=32x18 -o both/");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("2 scenes are in each picture; docs/video.md"), "{text}");

    // A film that is refused leaves the cameras of the film in the folder.
    let cameras = place.text("turn.json");
    place.refuses(
        "video scene.ply --orbit=4 --eye=0,-1,-4 --size=32x18 --write-cameras turn.json",
        &[(
            "-o turn",
            1,
            "film.json belongs to another film (frames is 5 there and 4 here): remove the folder",
        )],
    );
    assert_eq!(place.text("turn.json"), cameras);
    fs::remove_file(place.at("turn/film.json")).expect("removed");
    (0..4).for_each(|frame| fs::remove_file(place.at(format!("turn/{frame:05}.png"))).expect("removed"));
    let (_, told) = place.said("video scene.ply --orbit=4 --size=32x18 -o turn");
    assert!(told.contains("turn: 00004.png is not of this run"), "{told}");

    let ffmpeg = "ffmpeg -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1 -i -";
    let documents = [include_str!("../docs/video.md").to_owned(), place.done("video --help")];
    documents.iter().for_each(|text| assert!(text.contains(ffmpeg), "{text}"));
    let encoder = |film| format!("other formats need an encoder: `-o - | {ffmpeg} {film}`");
    let found = |extension: &str, then: &str| {
        format!("found .{extension} (for a folder of that name, end it with a slash); {then}")
    };
    let no_encoder =
        format!("{}, or a program built with `--features av1`", found("mp4", &encoder("film.mp4")));
    place.refuses(
        LINE,
        &[
            ("film.mp4", 2, &no_encoder),
            ("film.gif --format=png", 2, "--format is for the pictures of a folder"),
            ("film.gif --shutter=0.5", 2, "expected --samples of 2 or more with --shutter, found 1"),
            ("film.gif --shard=0/2", 2, "--shard is for the pictures of a folder"),
            (
                "beauty.exr",
                2,
                "found .exr; for a picture per frame, name a folder: `-o beauty/ --format exr` writes",
            ),
            (
                "pat/frame_%04d.png",
                2,
                "found a pattern of names; for a picture per frame, name a folder: `-o pat/` writes",
            ),
            (
                "shot.####.exr",
                2,
                "found a pattern of names; for a picture per frame, name a folder: `-o frames/ --format",
            ),
            ("rgba=film.apng", 2, "expected a film, found the output `rgba`"),
            ("film.gif --orbit=4", 2, "cannot be used with"),
            ("cameras.json/x.gif", 2, "which cannot be written: Not a directory"),
            ("my;film.mp4", 2, &encoder("'my;film.mp4'")),
            ("scene.ply", 2, &found("ply", &encoder("FILM"))),
        ],
    );
    let one = "expected two cameras or more for a path, found 1";
    place.refuses(
        "video scene.ply -o film.gif",
        &[
            ("--cameras=cameras.json#0", 2, one),
            ("--orbit=3 --closed", 2, "expected a path through --cameras with --closed"),
            ("--closed", 2, "expected a path through --cameras with --closed"),
            ("--cameras-as=frames", 2, "expected a path through --cameras with --cameras-as, found a circle"),
            ("--fps=60", 2, "expected at most 50 frames per second in a .gif, found 60"),
            ("--fps=29.98", 2, "a whole number or a fraction, for instance 30 or 30000/1001"),
        ],
    );
}
