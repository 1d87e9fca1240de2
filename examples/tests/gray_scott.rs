//! Runs the example as its page describes.

use std::fs::File;
use std::io::BufReader;
use std::process::Command;

#[test]
fn the_reaction_fills_the_picture_with_a_pattern() {
    let folder = tempfile::tempdir().expect("a folder");
    let status = Command::new(env!("CARGO_BIN_EXE_gray_scott")).current_dir(&folder).status();
    assert!(status.expect("the example starts").success());

    let file = File::open(folder.path().join("gray_scott.png")).expect("it writes a picture");
    let mut reader = png::Decoder::new(BufReader::new(file)).read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a small picture")];
    reader.next_frame(&mut pixels).expect("pixels");

    // Each square of 32 x 32 pixels has dark and bright parts, so the seeds have spread everywhere.
    for corner in (0..8 * 8).map(|i| (i % 8 * 32, i / 8 * 32)) {
        let reds = (0..32 * 32).map(|i| pixels[4 * ((corner.1 + i / 32) * 256 + corner.0 + i % 32)]);
        let (least, most) = reds.fold((u8::MAX, u8::MIN), |(least, most), v| (least.min(v), most.max(v)));
        assert!(least < 40 && most > 180, "the square at {corner:?} has reds of {least} to {most}");
    }
}
