//! Little memory, few processes, invalid drivers, and pipes in place of files: the program must not panic.

use crate::place::{DRAW, Place, shipped};
use rustix::process::{Resource, Rlimit, setrlimit};
use splatgraph::io::demo;
use splatgraph_assets::synth;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::thread;

pub fn limit(command: &mut Command, resource: Resource, most: u64) {
    let limit = move || Ok(setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) })?);
    // SAFETY: the closure makes one system call, which is safe between fork and exec, and allocates nothing.
    unsafe { command.pre_exec(limit) };
}

#[test]
fn a_driver_that_is_none_is_an_error_that_says_so() {
    let place = Place::new();
    place.write("garbage.json", b"\x00\xff{ this is no manifest");
    place.write("library.so", "no library either");
    place.write("manifest.json", r#"{"file_format_version": "1.0.0", "ICD": {"library_path": "./library.so", "api_version": "1.3.0"}}"#);
    place.write("huge.json", format!(r#"{{"ICD": {{"library_path": "{}"}}}}"#, "x".repeat(100_000)));
    for manifest in ["garbage.json", "manifest.json", "huge.json", "missing.json", ".", "scene.ply"] {
        for args in ["devices", "render scene.ply -o a.png"] {
            let path = place.at(manifest);
            let mut command = place.program(args);
            let output = command
                .env("VK_DRIVER_FILES", &path)
                .env("VK_ICD_FILENAMES", &path)
                .output()
                .expect("it runs");
            let errors = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{manifest}, {args:?}: {errors}");
            assert!(errors.contains("error: "), "{manifest}, {args:?}: {errors}");
            assert!(!errors.contains("0 bytes"), "{manifest}, {args:?}: {errors}");
            let named = format!("in VK_DRIVER_FILES={}, and looks nowhere else", path.display());
            assert!(manifest != "missing.json" || errors.contains(&named), "{args:?}: {errors}");
        }
    }
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        let mut command = place.program("devices");
        command.env_remove("VK_DRIVER_FILES").env_remove("VK_ICD_FILENAMES");
        let output = command.env(variable, "").output().expect("it runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{errors}");
        assert!(errors.contains(&format!("error: {variable} is set, but empty")), "{errors}");
    }
    assert!(!place.at("a.png").exists());
}

#[test]
fn the_demo_scene_is_drawn_where_it_cannot_be_kept_and_a_damaged_file_of_it_is_written_anew() {
    let place = Place::empty();
    let drawn = |cache: &str, picture: &str| {
        let mut command = place.program(&format!("render -p unsorted --device llvmpipe -o {picture}"));
        let output = command.env("XDG_CACHE_HOME", cache).output().expect("it runs");
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{errors}");
        errors
    };
    let errors = drawn("/proc/none", "unkept.png");
    assert!(errors.contains("the demo scene is generated at each use, because /proc/none/"), "{errors}");
    // These files do not make the folder a checkout, which has the demo scene in assets/splats/.
    place.write("pipelines/splat.ron", shipped("pipelines/splat.ron"));
    place.write("assets/mine.txt", "");
    place.scene("other.ply", "uniform", 20, 0);
    for damaged in [b"ply\nformat binary_little_endian 1.0\n".to_vec(), place.bytes("other.ply")] {
        place.write(&format!("cache/splatgraph/{}", demo::FILE), damaged);
        let errors = drawn(&place.named("cache"), "kept.png");
        assert!(errors.contains("the demo scene is generated again\n"), "{errors}");
    }
    assert_eq!(drawn(&place.named("cache"), "again.png"), "");
    assert!(place.bytes("unkept.png") == place.bytes("kept.png"), "both draw one scene");
    assert!(place.bytes("again.png") == place.bytes("kept.png"), "both draw one scene");
}

#[test]
fn few_threads_and_little_memory_are_no_reason_to_panic() {
    let place = Place::new();
    splatgraph::io::image::Image::from_fn(64, 48, |x, y| [x as f32, y as f32, 0.5])
        .save(&place.at("a.npy"))
        .expect("written");
    fs::set_permissions(place.at("."), fs::Permissions::from_mode(0o777)).expect("set");
    // The limit on processes does not apply to root. So root runs the program as another user, from a copy that this
    // user can reach.
    let program = place.at("program");
    let root = rustix::process::geteuid().is_root();
    // `cp` copies it: if this process had it open for writing while another test forks, starting it would fail (busy).
    let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_splatgraph")).arg(&program).status();
    assert!(copied.expect("cp runs").success());
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("set");
    let draw = "render scene.ply --size 64x48 --pipeline unsorted --device llvmpipe -o a.png";
    // With compiled shaders, drawing gets as far as the pipelines.
    let warmed = place.program(draw).env("XDG_CACHE_HOME", place.at("cache")).status();
    assert!(warmed.expect("it runs").success());
    fs::remove_file(place.at("a.png")).expect("removed");
    for args in
        ["compare a.npy a.npy", "info scene.ply", "synth demo --count 1000 -o new.ply", "dump unsorted", draw]
    {
        // Compiling shaders takes more memory. With less, one of many allocations fails, which ends any Rust program.
        let memory = if args.starts_with("dump") { 900_000 } else { 600_000 } * 1024;
        let last = if args == draw {
            [(Resource::Nproc, 7), (Resource::Nproc, 10)]
        } else {
            [(Resource::Nproc, 1), (Resource::As, memory)]
        };
        for (resource, most) in [(Resource::Nproc, 2), (Resource::Nproc, 3)].into_iter().chain(last) {
            let mut command = Command::new(&program);
            command.args(args.split(' ')).current_dir(place.at(".")).env("RAYON_NUM_THREADS", "64");
            command.env("XDG_CACHE_HOME", place.at("cache"));
            // Each arena of glibc reserves 64 MiB, and how many there are depends on the threads' timing.
            command.env("MALLOC_ARENA_MAX", "1");
            if root {
                // A user without other processes.
                command.uid(54_321).gid(54_321);
            }
            limit(&mut command, resource, most);
            let output = command.output().expect("it runs");
            let errors = String::from_utf8_lossy(&output.stderr);
            let code = output.status.code();
            assert!(
                matches!(code, Some(0 | 1)),
                "{args:?} with {most} of {resource:?}: {}\n{errors}",
                output.status
            );
            assert!(!errors.contains("panicked"), "{args:?} with {most} of {resource:?}: {errors}");
            // The other commands may fail. `dump`, for example, compiles shaders, which needs a thread.
            if args.starts_with("compare") || args.starts_with("synth") {
                assert_eq!(code, Some(0), "{args:?} with {most} of {resource:?}: {errors}");
            }
        }
    }
}

#[test]
fn writing_or_pricing_a_scene_with_too_little_memory_for_it_is_refused() {
    let place = Place::new();
    place.done("synth uniform --count 300000 -o large.ply");
    for line in ["convert large.ply large.sog", "convert large.ply --price --size 16x16"] {
        // From too little for the scene itself to nearly enough.
        let refused = [200, 240, 280].map(|mebibytes: u64| {
            let mut command = place.program(line);
            command.env("RAYON_NUM_THREADS", "2").env("MALLOC_ARENA_MAX", "1");
            limit(&mut command, Resource::As, mebibytes << 20);
            let output = command.output().expect("it runs");
            let errors = String::from_utf8_lossy(&output.stderr);
            let code = output.status.code();
            assert!(matches!(code, Some(0 | 1)), "{line} with {mebibytes} MiB: {}\n{errors}", output.status);
            assert!(code == Some(0) || errors.contains("expected a scene that fits in memory"), "{errors}");
            code == Some(1)
        });
        assert!(refused[0], "{line}");
    }
}

#[test]
fn counts_that_no_memory_holds_are_errors_in_one_sentence_and_write_nothing() {
    let place = Place::new();
    let most = u32::MAX;
    let generators = synth::generators().iter();
    let mut lines: Vec<String> =
        generators.map(|generator| format!("synth {} --count {most} -o big.ply", generator.name)).collect();
    assert!(lines.len() > 10);
    lines.push(format!("synth --enlarge scene.ply --count {most} -o big.ply"));
    lines.push(format!("check unsorted --splats {most}"));
    for line in lines {
        let errors = place.fails(&line, 1);
        assert!(errors.starts_with("error: ") && !errors.contains("panicked"), "{line:?}: {errors}");
        if line.starts_with("synth") {
            assert!(
                errors.contains("expected a scene that fits in memory, found 4294967295 splats"),
                "{errors}"
            );
            assert_eq!(errors.trim_end().lines().count(), 1, "{errors}");
        }
    }
    for count in ["0", "4294967296", "18446744073709551616", "1e9"] {
        place.fails(&format!("synth uniform --count {count} -o big.ply"), 2);
    }
    assert!(!place.at("big.ply").exists());
}

#[test]
fn a_fifo_in_place_of_a_file_that_the_program_reads_again_is_refused_without_waiting_for_a_writer() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    for name in ["job/job.json", "film/film.json"] {
        let path = place.at(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        assert!(Command::new("mkfifo").arg(&path).status().expect("mkfifo runs").success());
    }
    for args in [
        "render scene.ply -c cameras.json -o job --shard 0/1",
        "merge job",
        "video scene.ply -c cameras.json --seconds 1 -o film",
    ] {
        let output = place.run(args);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && errors.contains("found a FIFO"), "{args}: {errors}");
    }
}

#[test]
fn a_selection_and_times_are_read_from_the_pipes_that_options_name() {
    let place = Place::new();
    place.scene("two.ply", "uniform", 2, 0);
    let pipe = place.at("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo runs").success());
    let first = r#"{"splats": 2, "indices": [0]}"#;
    let times = r#"[{"pipeline": "splat", "passes": [{"name": "compose", "gpu_ms": 1.5}]}]"#;
    for (args, text) in [
        ("convert two.ply one.ply --keep pipe", first),
        ("convert two.ply one.ply --remove pipe", first),
        ("dump splat --times pipe -o dump.html", times),
    ] {
        let pipe = pipe.clone();
        let writer = thread::spawn(move || fs::write(pipe, text));
        place.done(args);
        writer.join().expect("it ends").expect("it is written");
    }
    assert!(place.text("dump.html").contains("1.5"));
}

#[test]
fn an_exact_picture_larger_than_the_memory_is_refused_with_its_size() {
    let place = Place::new();
    let mut command = place.program("render scene.ply --backend reference --size 8192x8192 -o a.png");
    limit(&mut command, Resource::As, 4 << 30);
    let output = command.output().expect("it runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    let size = "memory available, found 8192 x 8192 pixels and ";
    assert!(errors.contains(size) && errors.contains(" visible splats, which need"), "{errors}");
    assert!(!place.at("a.png").exists());
}

#[test]
fn a_picture_larger_than_any_device_has_is_refused_with_its_camera_and_size() {
    let place = Place::new();
    place.cameras(&["one"]);
    let text = place.text("cameras.json");
    place.write("cameras.json", text.replace("\"width\": 64", "\"width\": 100000"));
    place.refuses(
        "render scene.ply -o a.png",
        &[
            (
                "--cameras cameras.json",
                1,
                "the camera one: expected a picture of at most 32768 x 32768 pixels, found 100000 x 48",
            ),
            ("--size 100000x48", 2, "32768x32768"),
        ],
    );
    place.done("render scene.ply -o a.png --cameras cameras.json --size 64x48");
    place.refuses("info scene.ply", &[("-c cameras.json", 1, "found 100000 x 48")]);
    place.done("info scene.ply -c cameras.json --size 64x48");
    place.write("cameras.json", text.replace("\"width\": 64", "\"width\": 4294967295"));
    let most = "camera 0: expected an image of at most 1048576 x 1048576 pixels, found 4294967295 x 48";
    place.refuses("info scene.ply", &[("-c cameras.json", 1, most)]);
}

#[test]
fn a_negative_background_needs_no_equals_sign() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.done(&format!("{DRAW} a.npy --background -1,0,0"));
    let image = place.image("a.npy");
    assert!(image.rgb.iter().any(|pixel| pixel[0] < 0.0));
}
