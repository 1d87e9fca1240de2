//! The program is killed at random moments while it draws twelve cameras: every file that exists afterwards must be
//! whole.

use crate::common::{long, say};
use crate::place::{DRAW, Place, SIZE};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use splatgraph::io::image::Image;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

/// Number of kills: in a long run, and by default.
const KILLS: (u32, u32) = (1_000, 16);

const CAMERAS: usize = 12;

/// Bytes of an inspected array. The header before them has a multiple of 64 bytes.
const ARRAY_BYTES: usize = 4 * 200;

/// Checks the folder: only the expected files, and each is whole. Returns the number of pictures and arrays. If the
/// program was `killed` by SIGKILL, its hidden files are allowed, and are removed.
fn assert_whole(place: &Place, killed: bool, what: &str) -> usize {
    let files = place.files(".");
    let mut drawn = 0;
    for (name, bytes) in &files {
        let path = place.at(name);
        let expected_array = |bytes: &[u8]| {
            bytes.starts_with(b"\x93NUMPY")
                && bytes.len() % 64 == ARRAY_BYTES % 64
                && bytes.len() > ARRAY_BYTES
        };
        match name.trim_start_matches("./") {
            "scene.ply" | "cameras.json" => {}
            "stats.json" => {
                let stats: Value =
                    serde_json::from_slice(bytes).unwrap_or_else(|e| panic!("{what}: {name}: {e}"));
                assert_eq!(stats.as_array().map(Vec::len), Some(CAMERAS), "{what}");
            }
            name if name.starts_with("out/camera") && name.ends_with(".png") => {
                let image = Image::load(&path).unwrap_or_else(|error| panic!("{what}: {error}"));
                assert_eq!((image.width as u32, image.height as u32), SIZE, "{what}: {name}");
                drawn += 1;
            }
            name if name.starts_with("seen-camera") && name.ends_with(".npy") => {
                assert!(expected_array(bytes), "{what}: {name} has {} bytes", bytes.len());
                drawn += 1;
            }
            // A file that replaces another has a hidden name between two system calls. Nothing removes it after
            // SIGKILL.
            name if killed && name.contains(".splatgraph-") => {
                assert!(
                    expected_array(bytes) || bytes.ends_with(b"IEND\xaeB`\x82"),
                    "{what}: {name} is not whole"
                );
                fs::remove_file(path).expect("removed");
            }
            name => panic!("{what}: {name} is left"),
        }
    }
    drawn
}

#[test]
fn whenever_the_program_is_killed_every_file_is_whole() {
    let kills = if long() { KILLS.0 } else { KILLS.1 };
    let place = Place::new();
    let names: Vec<String> = (0..CAMERAS).map(|index| format!("camera{index}")).collect();
    place.cameras(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let args = format!("{DRAW} out --json=stats.json --inspect order@compact=seen.npy");
    let clean = || {
        for path in ["out", "stats.json"].map(|name| place.at(name)) {
            let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        }
        for name in &names {
            let _ = fs::remove_file(place.at(format!("seen-{name}.npy")));
        }
    };
    let (code, errors) = place.code(&args);
    assert_eq!((code, assert_whole(&place, false, "the whole run")), (Some(0), 2 * CAMERAS), "{errors}");

    let mut random = super::words::Random(1);
    let mut ended = 0;
    for kill in 0..kills {
        let signal = [Signal::KILL, Signal::TERM, Signal::INT][random.below(3)];
        // Half of the runs overwrite the files of the previous run.
        let over = random.below(2) == 0;
        if !over {
            clean();
        }
        let before = stamps(&place, &names);
        let mut child =
            place.program(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
        let pid = Pid::from_child(&child);
        // Some runs are killed before the first file, while the program starts.
        let wanted = random.below(2 * CAMERAS);
        wait_until(&mut child, || written(&place, &names, &before) >= wanted);
        // Waits a random time, so that the kill often falls within the writing of a file.
        std::thread::sleep(Duration::from_micros(random.below(2_000) as u64));
        // The program may have ended by itself.
        if child.try_wait().expect("asked").is_none() {
            kill_process(pid, signal).expect("it is there until it was waited for");
        }
        let status = child.wait().expect("it ends");
        let what = format!("kill {kill} by {signal:?} after {wanted} files, over the last pictures: {over}");
        let drawn = assert_whole(&place, signal == Signal::KILL, &what);
        assert!(
            status.success() || status.signal() == Some(signal.as_raw()),
            "{what}: it ended with {status}"
        );
        ended += usize::from(!status.success());
        if status.success() {
            assert_eq!(drawn, 2 * CAMERAS, "{what}");
        }
    }
    say(&format!("kills: {kills}, {ended} of them before the end"));
}

#[test]
fn a_program_that_is_killed_between_two_files_leaves_those_before() {
    let place = Place::new();
    let names: Vec<String> = (0..CAMERAS).map(|index| format!("camera{index}")).collect();
    place.cameras(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let args = format!("{DRAW} out --inspect order@compact=seen.npy");
    // The picture's path is a named pipe without a reader: opening it blocks the program.
    let at = CAMERAS / 2;
    let pipe = place.at(format!("out/camera{at}.png"));
    // The pipe is moved here while the files are checked.
    let aside = tempfile::tempdir().expect("a folder");
    fs::create_dir(place.at("out")).expect("made");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo runs").success());
    for signal in [Signal::KILL, Signal::TERM, Signal::INT] {
        let before = stamps(&place, &names);
        let mut command = place.program(&args);
        if signal != Signal::KILL {
            undo_ignoring(&mut command, signal);
        }
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
        wait_until(&mut child, || written(&place, &names, &before) == 2 * at);
        kill_process(Pid::from_child(&child), signal).expect("it is there until it was waited for");
        assert_eq!(child.wait().expect("it ends").signal(), Some(signal.as_raw()));
        let after = stamps(&place, &names);
        assert!(after[..2 * at].iter().all(Option::is_some), "the files before");
        assert!(after[2 * at + 1..].iter().all(Option::is_none), "none of the files after");
        fs::rename(&pipe, aside.path().join("pipe")).expect("moved");
        assert_eq!(assert_whole(&place, signal == Signal::KILL, &format!("{signal:?}")), 2 * at);
        fs::rename(aside.path().join("pipe"), &pipe).expect("moved");
    }
}

/// Returns inode and modification time of each camera's picture and array, if they exist. Replacing a file changes
/// both.
fn stamps(place: &Place, names: &[String]) -> Vec<Option<(u64, SystemTime)>> {
    let both = names.iter().flat_map(|name| [format!("out/{name}.png"), format!("seen-{name}.npy")]);
    both.map(|file| {
        fs::metadata(place.at(&file)).ok().map(|m| (m.ino(), m.modified().expect("Linux has it")))
    })
    .collect()
}

/// Counts the pictures and arrays that were written since `before`.
fn written(place: &Place, names: &[String], before: &[Option<(u64, SystemTime)>]) -> usize {
    let now = stamps(place, names);
    now.iter().zip(before).filter(|(now, before)| now.is_some() && now != before).count()
}

fn wait_until(child: &mut Child, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() && child.try_wait().expect("asked").is_none() {
        assert!(begun.elapsed() < Duration::from_secs(300), "the program hangs");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Returns true if the process has lavapipe's threads: its device is open.
fn has_device(pid: Pid) -> bool {
    let tasks = fs::read_dir(format!("/proc/{}/task", pid.as_raw_nonzero())).into_iter().flatten().flatten();
    tasks
        .filter_map(|task| fs::read_to_string(task.path().join("comm")).ok())
        .any(|name| name.starts_with("llvmpipe"))
}

/// Returns the processor time of a process so far, in the clock ticks of `/proc`; 0 if it has ended.
fn ticks(pid: Pid) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero())).unwrap_or_default();
    // Field 2, the program's name, is in parentheses and may contain spaces. Fields 14 and 15 are user and system time.
    let words = stat.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace();
    words.skip(11).take(2).filter_map(|word| word.parse::<u64>().ok()).sum()
}

/// Restores the default action of a signal. The tests may have been started with the signal ignored, as shells do for
/// background jobs.
fn undo_ignoring(command: &mut Command, signal: Signal) {
    let undo = move || {
        // SAFETY: the call is safe between fork and exec, and sets what a program has by default.
        let before = unsafe { libc::signal(signal.as_raw(), libc::SIG_DFL) };
        if before == libc::SIG_ERR { Err(std::io::Error::last_os_error()) } else { Ok(()) }
    };
    // SAFETY: the closure makes one system call, which is safe between fork and exec, and allocates nothing.
    unsafe { command.pre_exec(undo) };
}

#[test]
fn the_program_dies_of_a_signal_unless_it_is_ignored() {
    let place = Place::new();
    place.cameras(&["one"]);
    // Draws repeatedly, so that the program runs until the signal.
    let args = format!("{DRAW} out --repeat 100000");
    for (signal, ignored) in
        [(Signal::INT, false), (Signal::TERM, false), (Signal::HUP, false), (Signal::HUP, true)]
    {
        let mut command = place.program(&args);
        if ignored {
            let mut nohup = Command::new("nohup");
            nohup.arg(command.get_program()).args(command.get_args()).current_dir(place.at("."));
            command = nohup;
            command.stdin(Stdio::null());
        } else {
            undo_ignoring(&mut command, signal);
        }
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
        let pid = Pid::from_child(&child);
        wait_until(&mut child, || has_device(pid));
        kill_process(pid, signal).expect("it runs");
        if ignored {
            // The program keeps drawing.
            let before = ticks(pid);
            wait_until(&mut child, || ticks(pid) > before + 20);
            assert!(child.try_wait().expect("asked").is_none(), "it ends on a signal that is ignored");
            kill_process(pid, Signal::TERM).expect("it runs");
        }
        let expected = if ignored { Signal::TERM } else { signal };
        assert_eq!(child.wait().expect("it ends").signal(), Some(expected.as_raw()));
        assert!(place.files("out").is_empty());
    }
}
