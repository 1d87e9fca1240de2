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

    let ffmpeg = "ffmpeg -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1 -i -";
    let documents = [include_str!("../docs/video.md").to_owned(), place.done("video --help")];
    documents.iter().for_each(|text| assert!(text.contains(ffmpeg), "{text}"));
    let encoder = |film| format!("other formats need an encoder: `-o - | {ffmpeg} {film}`");
    let no_encoder = format!("found .mp4; {}, or a program built with `--features av1`", encoder("film.mp4"));
    place.refuses(
        LINE,
        &[
            ("film.mp4", 2, &no_encoder),
            ("film.gif --format=png", 2, "--format is for the pictures of a folder"),
            ("film.gif --shutter=0.5", 2, "--samples"),
            ("rgba=film.apng", 2, "expected a film, found the output `rgba`"),
            ("film.gif --orbit=4", 2, "cannot be used with"),
            ("cameras.json/x.gif", 2, "which cannot be written: Not a directory"),
            ("my;film.mp4", 2, &encoder("'my;film.mp4'")),
            ("scene.ply", 2, &format!("found .ply; {}", encoder("FILM"))),
        ],
    );
    let one = "expected two cameras or more for a path, found 1";
    place.refuses(
        "video scene.ply -o film.gif",
        &[
            ("--cameras=cameras.json#0", 2, one),
            ("--orbit=3 --closed", 2, "expected a path through --cameras with --closed"),
            ("--closed", 2, "expected a path through --cameras with --closed"),
            ("--fps=60", 2, "expected at most 50 frames per second in a .gif, found 60"),
            ("--fps=29.98", 2, "a whole number or a fraction, for instance 30 or 30000/1001"),
        ],
    );
}
