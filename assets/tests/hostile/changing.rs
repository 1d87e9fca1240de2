//! Tests files that are truncated and rewritten while they are read: the result is a whole scene or an error.

use crate::allocation::alone;
use crate::long;
use splatgraph_assets::{LoadError, Scene, SceneError, synth};
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

fn load(path: &Path) -> Result<Scene, LoadError> {
    Scene::load(path, splatgraph_assets::QUIET)
}

/// Returns the bytes of a scene file that depends on the seed, and the identity of its scene.
fn written(seed: u64) -> (Vec<u8>, u64) {
    let scene = synth::generate("uniform", 40_000, seed).expect("it is generated");
    let mut bytes = Vec::new();
    scene.write_ply_to(&mut bytes).expect("memory takes it");
    let read = Scene::parse(&bytes, splatgraph_assets::QUIET).expect("a whole file");
    (bytes, read.identity())
}

/// Rewrites a file in place in pieces, as trainers do: truncated first, or over the old bytes of equal length.
fn rewrite(path: &Path, bytes: &[u8], truncate: bool) {
    let mut file = match truncate {
        true => File::create(path),
        false => OpenOptions::new().write(true).open(path),
    }
    .expect("the file is ours");
    for piece in bytes.chunks(1 << 20) {
        file.write_all(piece).expect("there is room");
        std::thread::yield_now();
    }
}

#[test]
fn a_file_that_is_rewritten_while_it_is_read_is_a_whole_scene_or_an_error() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let scenes = [written(1), written(2)];
    fs::write(&path, &scenes[0].0).unwrap();
    let loads = if long() { 2_000 } else { 40 };
    let done = AtomicBool::new(false);
    let (mut whole, mut refused) = ([0u32, 0], 0u32);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for turn in 0u64.. {
                if done.load(Relaxed) {
                    break;
                }
                let (bytes, _) = &scenes[(turn / 2) as usize % 2];
                match turn % 5 {
                    // Truncates the file, so that it is shorter than its header declares.
                    3 => File::options()
                        .write(true)
                        .open(&path)
                        .unwrap()
                        .set_len(turn * 9973 % bytes.len() as u64)
                        .unwrap(),
                    truncate => rewrite(&path, bytes, truncate % 2 == 0),
                }
                std::thread::sleep(Duration::from_millis(turn * 37 % 400));
            }
        });
        let (begun, mut turn) = (Instant::now(), 0);
        let is_seen = |whole: &[u32; 2], refused| whole.iter().sum::<u32>() > 0 && refused > 0;
        while turn < loads || !is_seen(&whole, refused) && begun.elapsed() < Duration::from_secs(60) {
            turn += 1;
            match load(&path) {
                Ok(scene) => {
                    let found = scenes.iter().position(|(_, identity)| *identity == scene.identity());
                    whole[found.expect("half of one scene and half of another")] += 1;
                }
                Err(error) => {
                    refused += 1;
                    let text = error.to_string();
                    // A load between two writes can see a truncated file, but never a mixed one.
                    let cut =
                        ["the file is truncated", "follow the header", "the header has no `end_header`"];
                    let expected = match error.problem {
                        SceneError::Changed | SceneError::BecameShorter { .. } | SceneError::Empty => true,
                        SceneError::Invalid(said) => cut.iter().any(|cut| said.contains(cut)),
                        _ => false,
                    };
                    assert!(expected, "{text}");
                }
            }
        }
        done.store(true, Relaxed);
    });
    println!("{loads} loads: {whole:?} whole scenes, {refused} errors");
    assert!(whole.iter().sum::<u32>() > 0 && refused > 0, "the loads were all whole or all errors");
}

#[test]
fn a_file_that_is_truncated_between_two_pieces_says_that_it_became_shorter() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let text = ascii_rows(60_000);
    for bytes in [&written(3).0, &text] {
        fs::write(&path, bytes).unwrap();
        let length = bytes.len() as u64;
        // The first report of progress comes between the header and the rows.
        let truncate = |done: u64, _| {
            if done == 0 {
                File::options().write(true).open(&path).unwrap().set_len(length / 2).unwrap();
            }
            ControlFlow::Continue(())
        };
        let said = Scene::load(&path, &truncate).unwrap_err();
        assert!(
            matches!(said.problem, SceneError::BecameShorter { expected, found } if (expected, found) == (length, length / 2)),
            "{said}"
        );
        let said = said.to_string();
        assert!(said.contains("became shorter while it was read: expected"), "{said}");
    }
}

#[test]
fn a_file_that_is_written_over_while_it_is_read_says_so() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let (bytes, _) = written(4);
    fs::write(&path, &bytes).unwrap();
    let touch = |done: u64, _| {
        if done == 0 {
            rewrite(&path, &bytes, false);
        }
        ControlFlow::Continue(())
    };
    let said = Scene::load(&path, &touch).unwrap_err();
    assert!(matches!(said.problem, SceneError::Changed), "{said}");
    // A new file that replaces the path does not affect the opened file.
    let replace = |done: u64, _| {
        if done == 0 {
            fs::write(folder.path().join("new"), "not a scene").unwrap();
            fs::rename(folder.path().join("new"), &path).unwrap();
        }
        ControlFlow::Continue(())
    };
    assert_eq!(Scene::load(&path, &replace).unwrap().count(), 40_000);
}

/// Builds a text file of `count` splats of degree 0.
fn ascii_rows(count: usize) -> Vec<u8> {
    let names = "x y z scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 opacity f_dc_0 f_dc_1 f_dc_2";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let header = format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n");
    let rows = "0.125 1 2 -3 -3 -3 1 0 0 0 0.5 0.25 0.25 0.25\n".repeat(count);
    (header + &rows).into_bytes()
}
