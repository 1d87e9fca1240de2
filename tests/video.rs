//! Films: equal frames in every format, folders with missing frames, blur, and mistakes.

use crate::commands::{scene, splatgraph};
use crate::common;
use splatgraph::io::image::Image;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

const SIZE: (usize, usize) = (48, 27);

/// Four frames through the cameras of the folder.
const LINE: [&str; 10] = [
    "video",
    "scene.ply",
    "--cameras=cameras.json",
    "--seconds=0.4",
    "--fps=10",
    "--size=48x27",
    "--background=0.1,0.2,0.3",
    "--closed",
    "--pipeline=splat",
    "-o",
];

fn film(folder: &Path, more: &[&str]) -> Output {
    let device = common::device_option();
    let args: Vec<&str> = LINE.iter().chain(more).copied().chain(device.as_deref()).collect();
    splatgraph(folder, &args)
}

/// Standard output of a film that is drawn.
fn drawn(folder: &Path, more: &[&str]) -> String {
    let output = film(folder, more);
    assert!(output.status.success(), "{more:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn refused(folder: &Path, more: &[&str], code: i32) -> String {
    let output = film(folder, more);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{more:?}: {errors}");
    errors
}

fn frame(folder: &Path, name: &str, index: usize) -> Image {
    let image = Image::load(&folder.join(format!("{name}/{index:05}.png"))).expect("a frame");
    assert_eq!((image.width, image.height), SIZE);
    image
}

/// The largest difference of a channel, in levels of 8 bits.
fn difference(a: &Image, b: &Image) -> f32 {
    let pairs = a.rgb.as_flattened().iter().zip(b.rgb.as_flattened());
    255.0 * pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn every_format_has_the_frames_of_the_folder_which_begin_at_the_first_camera() {
    let folder = scene();
    let folder = folder.path();
    let said = drawn(folder, &["frames", "--validate"]);
    assert!(said.starts_with("frames: 4 frames of 48 x 27, 0.4 s at 10 fps; 4 drawn in"), "{said}");
    let frames: Vec<Image> = (0..4).map(|index| frame(folder, "frames", index)).collect();
    assert!(frames.windows(2).all(|pair| difference(&pair[0], &pair[1]) > 30.0), "the camera moves");
    let device = common::device_option();
    let still =
        ["render", "scene.ply", "-c", "cameras.json#0", "--size", "48x27", "-p", "splat", "-o", "still.png"];
    let still: Vec<&str> =
        still.into_iter().chain(["--background=0.1,0.2,0.3"]).chain(device.as_deref()).collect();
    assert!(splatgraph(folder, &still).status.success());
    let still = Image::load(&folder.join("still.png")).expect("a picture");
    assert!(difference(&frames[0], &still) < 2.5, "{}", difference(&frames[0], &still));

    drawn(folder, &["film.apng"]);
    let file = std::io::BufReader::new(fs::File::open(folder.join("film.apng")).expect("written"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    for frame in &frames {
        reader.next_frame(&mut bytes).expect("a frame");
        assert!(bytes == frame.bytes());
    }
    let said = drawn(folder, &["film.gif"]);
    let length = fs::metadata(folder.join("film.gif")).expect("written").len();
    assert!(said.contains("bytes; 4 drawn") && length > 2000, "{said}: {length}");
    drawn(folder, &["film.y4m"]);
    let video = fs::read(folder.join("film.y4m")).expect("written");
    let text = video.iter().position(|byte| *byte == b'\n').expect("a header") + 1;
    assert_eq!((video.len() - text) % 4, 0);
    let planes = &video[text + 6..text + 6 + SIZE.0 * SIZE.1];
    let luma = |[r, g, b]: [f32; 3]| 16.0 + 219.0 * (0.2126 * r + 0.7152 * g + 0.0722 * b);
    let far =
        planes.iter().zip(&frames[0].rgb).find(|(found, rgb)| (f32::from(**found) - luma(**rgb)).abs() > 1.5);
    assert!(far.is_none(), "{far:?}");
}

#[test]
fn the_same_command_again_draws_what_is_missing_and_another_film_is_refused() {
    let folder = scene();
    let folder = folder.path();
    drawn(folder, &["frames"]);
    let at = |index: usize| folder.join(format!("frames/{index:05}.png"));
    let before: Vec<Vec<u8>> = (0..4).map(|index| fs::read(at(index)).expect("written")).collect();
    fs::remove_file(at(1)).expect("removed");
    // A picture of another size is not complete; a complete one is not redrawn, whatever it shows.
    fs::write(at(2), "half a picture").expect("written");
    fs::copy(at(0), at(3)).expect("copied");
    let said = drawn(folder, &["frames"]);
    assert!(said.contains("(2 were there)") && said.contains("; 2 drawn in"), "{said}");
    let after: Vec<Vec<u8>> = (0..4).map(|index| fs::read(at(index)).expect("written")).collect();
    assert!(after[..3] == before[..3]);
    assert!(after[3] == before[0]);

    let said = refused(folder, &["frames", "--samples=2"], 1);
    assert!(said.contains("film.json is of another film (samples is 1 there and 2 here)"), "{said}");
    let said = refused(folder, &["frames", "--set=cutoff=2"], 1);
    assert!(said.contains("of another film (plan is"), "{said}");
    fs::remove_file(folder.join("frames/film.json")).expect("removed");
    let said = refused(folder, &["frames"], 1);
    assert!(said.contains("expected film.json beside frames/00000.png"), "{said}");
}

#[test]
fn blur_mixes_the_time_while_the_shutter_is_open_and_a_closed_shutter_blurs_nothing() {
    let folder = scene();
    let folder = folder.path();
    drawn(folder, &["sharp"]);
    drawn(folder, &["stopped", "--samples=3", "--shutter=0"]);
    drawn(folder, &["blurred", "--samples=8", "--shutter=1"]);
    for index in 0..4 {
        let sharp = frame(folder, "sharp", index);
        assert!(difference(&sharp, &frame(folder, "stopped", index)) < 1.5);
        assert!(difference(&sharp, &frame(folder, "blurred", index)) > 10.0);
    }
}

#[test]
fn a_film_on_standard_output_is_a_y4m_and_a_reader_that_leaves_is_no_error() {
    let folder = scene();
    let folder = folder.path();
    drawn(folder, &["film.y4m"]);
    let piped = film(folder, &["-"]);
    assert!(piped.status.success());
    assert!(piped.stdout == fs::read(folder.join("film.y4m")).expect("written"));
    assert!(String::from_utf8_lossy(&piped.stderr).contains("standard output: 4 frames of 48 x 27"));
    let device = common::device_option();
    let mut child = Command::new(env!("CARGO_BIN_EXE_splatgraph"))
        .args(LINE.iter().copied().chain(["-", "--size=640x360"]).filter(|word| *word != "--size=48x27"))
        .args(device)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn an_orbit_has_as_many_frames_as_it_says_and_mistakes_are_told() {
    let folder = scene();
    let folder = folder.path();
    let device = common::device_option();
    let line = ["video", "scene.ply", "--orbit=5", "--eye=0,-1,-4", "--size=32x18", "-o", "turn"];
    let output = splatgraph(folder, &line.into_iter().chain(device.as_deref()).collect::<Vec<_>>());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let pictures = fs::read_dir(folder.join("turn")).expect("a folder").count();
    assert_eq!(pictures, 6, "five pictures and film.json");

    for (more, code, expected) in [
        (&["film.mp4"][..], 2, "found .mp4; other formats need an encoder: `-o - | ffmpeg -i - film.mp4`"),
        (&["film.gif", "--format=png"], 2, "--format is for the pictures of a folder"),
        (&["film.gif", "--shutter=0.5"], 2, "--samples"),
        (&["film.gif", "--orbit=4"], 2, "cannot be used with"),
        (&["cameras.json/x.gif"], 2, "which cannot be written: Not a directory"),
        (&["scene.ply"], 2, "expected a folder, or a name that ends in"),
    ] {
        let said = refused(folder, more, code);
        assert!(said.contains(expected), "{more:?}: {said}");
    }
    for (option, expected) in [
        ("--cameras=cameras.json#0", "expected two cameras or more for a path, found 1"),
        ("--fps=29.97", "for instance 30 or 30000/1001"),
    ] {
        let output = splatgraph(folder, &["video", "scene.ply", option, "-o", "film.gif"]);
        assert_eq!(output.status.code(), Some(2));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains(expected), "{said}");
    }
}
