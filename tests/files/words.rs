//! Random command lines from valid, nearly valid and hostile words, and the files that they name.

use super::Image;
pub use crate::numbers::Random;
use splatgraph_assets::{Camera, synth};
use std::fs;
use std::path::Path;

impl Random {
    /// Draws a word of a list. `~` stands for a space; a double space or one at the end gives an empty word.
    fn word(&mut self, words: &str) -> String {
        let words: Vec<&str> = words.split(' ').collect();
        words[self.below(words.len())].replace('~', " ")
    }
}

/// The commands; frequent ones are repeated. A test compares the list with the program's commands.
pub const COMMANDS: &str = "render render render view dump check info compare compare synth synth bench trade \
    sweep advise popping experiment evaluate convert video merge new source params completions man";

/// Existing files (see [`write_files`]), other spellings of their names, and missing files.
pub const FILES: &str = "scene.ply ./scene.ply link.ply hard.ply cameras.json stats.json graph.ron \
    step.comp a.npy b.npy a.png pics more . pipe scene.ply/x.png missing.ply cameras.json#0 \
    cameras.json#one cameras.json#99 arrays.npz#x ";

/// Names for outputs: new files, existing inputs, devices, folders, and names that are refused.
const OUTPUTS: &str = "out.png out.exr out.npy out.ply out.json out.html new/folder/out.png out \
    out.png/x.npy - /dev/null /dev/full new/./out.png new/../out.png out.jpg  . .. scene.ply ./scene.ply \
    link.ply hard.ply cameras.json stats.json graph.ron step.comp a.npy a.png pics \u{202e}gnp.\x1b[2J.png";

const NUMBERS: &str = "0 1 -1 2 100 0.5 -0.5 nan inf 1e300 4294967296 18446744073709551616  x 0x10 ~3";

const GRAPHS: &str = "graph.ron unsorted nope scene.ply pics  ../splat pipe";

/// Writes the existing files of [`FILES`] to a folder, over those of an earlier call.
pub fn write_files(folder: &Path) {
    let at = |name: &str| folder.join(name);
    for link in ["link.ply", "hard.ply"] {
        let _ = fs::remove_file(at(link));
    }
    synth::generate("demo", 20, 0).expect("a generator").write_ply(at("scene.ply")).expect("written");
    #[cfg(unix)]
    std::os::unix::fs::symlink("scene.ply", at("link.ply")).expect("made");
    fs::hard_link(at("scene.ply"), at("hard.ply")).expect("made");
    let camera = synth::demo_cameras().swap_remove(0).resized(40, 24);
    let named = |name: &str| Camera { img_name: name.into(), ..camera.clone() };
    Camera::save(&["one", "two/three", "two_three", "one"].map(named), at("cameras.json")).expect("written");
    for (name, text) in [
        ("stats.json", r#"[{"pipeline": "splat", "passes": [{"name": "draw", "gpu_ms": 1.0}]}]"#),
        ("graph.ron", r#"Graph(output: "nothing")"#),
        ("step.comp", "#version 460\nvoid main() {}\n"),
    ] {
        fs::write(at(name), text).expect("written");
    }
    let image = Image::from_fn(16, 16, |x, y| [x as f32 / 16.0, y as f32 / 16.0, 0.0]);
    for name in ["a.npy", "b.npy", "a.png", "pics/a.png", "pics/b.npy", "more/a.png", "more/b.npy"] {
        image.save(&at(name)).expect("written");
    }
}

pub fn line(random: &mut Random) -> Vec<String> {
    let command = match random.below(30) {
        0 => random.word("help rendre  devices"),
        _ => random.word(COMMANDS),
    };
    let command = command.as_str();
    let mut words = vec![command.to_owned()];
    // Mostly the number of operands that the command expects.
    let operands = match command {
        "render" | "video" | "view" | "info" | "bench" | "trade" | "sweep" | "advise" | "popping" => {
            random.below(8).min(1)
        }
        "compare" => [2, 2, 2, 2, 2, 2, 2, 2, 1, 3][random.below(10)],
        "check" => 1 + random.below(2),
        "devices" => random.below(20) / 19,
        _ => [1, 1, 1, 1, 1, 1, 1, 1, 0, 2][random.below(10)],
    };
    for _ in 0..operands {
        let word = match command {
            "dump" | "check" | "source" | "params" => random.word(GRAPHS),
            "new" => {
                random.word("out.ron new/out.ron out.ron graph.ron nope ./.ron new/../out.ron scene.ply")
            }
            "experiment" => random.word("order sh nope "),
            "completions" => random.word("bash elvish fish powershell zsh nope "),
            "synth" => random.word("demo demo uniform uniform nope "),
            _ => random.word(FILES),
        };
        words.push(word);
    }
    for _ in 0..random.below(4) {
        option(command, random, &mut words);
    }
    if random.below(40) == 0 {
        let at = random.below(words.len() + 1);
        words.insert(at, "x".repeat(random.below(6000)));
    }
    let output = match command {
        "render" => Some("-oout.png"),
        "video" => Some("-oout.gif"),
        "synth" => Some("-oout.ply"),
        _ => None,
    };
    if let Some(output) = output
        && !words.iter().any(|word| word.starts_with("-o"))
        && random.below(4) > 0
    {
        words.push(output.into());
    }
    if command == "synth" && !words.iter().any(|word| word.starts_with("--count")) {
        words.push("--count=20".into());
    }
    words
}

/// Adds an option, mostly one of the command's, and usually a value, mostly of its type.
fn option(command: &str, random: &mut Random, words: &mut Vec<String>) {
    let own = match command {
        "render" => {
            "-o -o --format --json --json --repeat --inspect --cameras --size --background --write-cameras --set \
            --pipeline --validate --device --shard"
        }
        "view" => {
            "--events --screenshot --cameras --size --background --split --gain --scale --frames \
            --inspect --show --as --compare --compare-set"
        }
        "video" => {
            "-o -o --format --cameras --cameras-as --closed --orbit --seconds --fps --samples --shutter \
            --size --write-cameras --set --device --shard"
        }
        "new" => "--from --force --force",
        "params" => "--set --json --size --device --scene",
        "dump" => "-o --format --diff --times --scene --size --set --set-b",
        "compare" => "--diff --diff --gain --range --min-psnr --json --by-number",
        "synth" => "-o -o --cameras --count --seed --enlarge",
        "bench" => "-o --json --cameras --pipelines --sizes --splats --suite --pairs --set --rounds --frames",
        "trade" | "sweep" | "advise" | "popping" | "experiment" => {
            "-o -o --cameras --size --pipeline \
            --rounds --frames --json --psnr --device --shard"
        }
        _ => "--set --json --size --device --cameras",
    };
    let name = match random.below(40) {
        0 => random.word("-o --json --inspect -- - --nope -x --help --version --format"),
        _ => random.word(own),
    };
    let hostile = random.below(5) == 0;
    let mut of = |good: &str, bad: &str| random.word(if hostile { bad } else { good });
    let value = match name.as_str() {
        "-o" if command == "synth" => of("out.ply new/out.ply ./out.ply", OUTPUTS),
        "-o" if command == "video" => of("out.gif new/out.apng out.y4m out pics", OUTPUTS),
        "--fps" => of("24 30000/1001", "0 30/0 1e9 29.97 4294967297"),
        "-o" | "--diff" if command != "dump" => of("out.png out.exr new/out.npy out pics", OUTPUTS),
        "--screenshot" => of("out.png new/out.exr", OUTPUTS),
        "-o" | "--events" | "--json" => of("out.json out.html new/out.txt -", OUTPUTS),
        "--cameras" if command == "synth" => of("out.json new/out.json -", OUTPUTS),
        "--cameras" => of("cameras.json cameras.json#0 cameras.json#one", FILES),
        "--inspect" => of(
            "keys@scatter keys@scatter=keys.npy a@b=new/keys.npy",
            "@ keys a@b=a.npy a@b= a@b=keys.txt = a@b==c.npy",
        ),
        "--set" | "--set-b" | "--compare-set" => {
            of("digit_bits=4 cutoff=3", "digit_bits=nan = nope=1 \x1b[31m=1 cutoff=1e300 a")
        }
        "--size" => of("64x48 1x1", "0x1 64 4294967295x1 x -1x-1 64~x~48 32769x1"),
        "--sizes" => of("64x48 64x48,1x1", "64x48,64x48 64x48, , 0x1"),
        "--pipelines" => of("unsorted splat,graph.ron", "splat,splat , nope splat,,key16"),
        "--splats" | "--pairs" => of("1 20,40", "20,20 0 , -1 4294967296 x"),
        "--range" => of("0,1 -5,8", "1,0 nan,1 , 0 -inf,inf"),
        "--shard" => of("0/1 1/3", "2/2 0/0 / x -1/2 0/18446744073709551616"),
        "--cameras-as" => of("keys frames", "nope "),
        "--suite" => of("frames sort", "nope "),
        "--from" => of("splat compute post", "nope "),
        "--background" => of("0,0,0 -1,0,0", "1,2 nan,0,0 a,b,c ,, 1,2,3,4 --json"),
        "--format" if command == "dump" => of("text json html dot", "png  yaml"),
        "--format" => of("png exr npy", "jpg text  PNG"),
        "--pipeline" | "--compare" => of("unsorted graph.ron", GRAPHS),
        "--count" => of("1 20", "0 -1 x 4294967296"),
        "--enlarge" | "--scene" => of("scene.ply", FILES),
        "--times" => of("stats.json", FILES),
        "--show" => of("settings graph,none", ", nope "),
        "--as" => of("split difference", "nope "),
        "--device" => of("llvmpipe 0", "99 nope \x1b]0;x\x07 "),
        _ => of("1 2 0.5", NUMBERS),
    };
    match random.below(20) {
        0..4 => words.push(format!("{name}={value}")),
        4 => words.push(name),
        _ => words.extend([name, value]),
    }
}
