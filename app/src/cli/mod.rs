//! Defines the command line, one module per command.
//!
//! A command is a struct of arguments, documented by its help text, and a function `run`. Results, and notes on written
//! files, go to standard output; other messages go to standard error. The exit code is 0 for success, 1 for a failure,
//! 2 for an invalid command line, and 128 plus the signal's number after a signal. An output that would overwrite an
//! input or another output is an invalid command line, detected before anything is drawn.

mod advise;
mod bench;
mod cameras;
mod check;
mod compare;
mod completions;
mod console;
mod convert;
mod devices;
mod dump;
mod evaluate;
mod experiment;
#[cfg(all(test, feature = "window"))]
mod fuzz;
mod help;
mod info;
mod job;
mod known_devices;
mod loading;
mod look_at;
mod lsp;
mod man;
mod merge;
mod new;
mod options;
mod outcome;
mod params;
mod popping;
mod render;
mod scenes;
mod source;
mod stdout;
mod subject;
mod sweep;
mod synth;
mod threads;
mod trade;
mod version;
mod video;
#[cfg(feature = "window")]
mod view;
#[cfg(not(feature = "window"))]
mod windowless;

use crate::draw::planner::{self, GraphErrors};
use crate::draw::session::SessionError;
use crate::draw::shader_cache::ShaderCache;
use crate::io::condition::ConditionError;
use crate::io::load::FileOptions;
use crate::io::output::{self, say, say_styled, shell_word, terminal};
use crate::io::program;
use crate::io::timeline::Timeline;
use crate::{draw::backend, draw::builtin};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use job::{Shard, Work};
use outcome::{Outcome, Usage, colour};
use splatgraph_framework::shader::Worker;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;
use tracing::info_span;
#[cfg(not(feature = "window"))]
use windowless as view;

pub use job::{Job, Ran};

const EXAMPLES: &str = "  splatgraph render -o demo.png                     # a picture of the demo scene
  splatgraph render scene.ply --cameras cameras.json -o pictures/ --json=stats.json
  splatgraph video scene.ply --cameras keys.json -o film.gif   # a smooth path through cameras
  splatgraph render scene.ply --pipeline digit4 --set cutoff=3.0 -o out.exr
  splatgraph compare out.npy golden.npz#camera0
  splatgraph convert scene.ply scene.spz            # another format, and what it loses
  splatgraph evaluate scene.ply -c garden/          # PSNR, SSIM and FLIP against photographs
  splatgraph bench scene.ply --pipelines splat,key16   # GPU time per pass, drawn interleaved
  splatgraph trade scene.ply -c cameras.json        # what each setting saves, and what it costs
  splatgraph advise scene.ply --psnr 45             # the fastest setting that is accurate enough
  splatgraph merge pictures/                        # join the results of several processes (--shard)
  splatgraph sweep scene.ply                        # quality and time as splats are removed
  splatgraph experiment order                       # a page on the order of splats
  splatgraph popping                                # the error that changes from frame to frame
  splatgraph new my.ron                             # a renderer of your own, to start from
  splatgraph params                                 # what --set can change
  splatgraph dump splat --format dot | dot -Tsvg > splat.svg";

const EXIT_CODES: &str = "Exit codes:
  0        success
  1        a failure, a check that did not pass, or a result that lacks views
  2        an invalid command line; nothing was written
  128 + N  ended by signal N

A failure can leave an earlier file of --json=FILE as it was: delete it before the command.";

const ENVIRONMENT: &str = "Environment variables:
  XDG_CACHE_HOME              folder of compiled shaders and of the demo scene [default: ~/.cache]
  XDG_STATE_HOME              folder of the window's state [default: ~/.local/state]
  SPLATGRAPH_SHADER_CACHE=off compiles all shaders in each run
  RAYON_NUM_THREADS           number of worker threads on the CPU [default: its number of cores]
  NO_COLOR                    no colours in messages, if it is not empty
  VK_DRIVER_FILES             the only Vulkan drivers that are used, as paths of their manifests";

fn examples() -> String {
    let view = match cfg!(feature = "window") {
        true => "  splatgraph view                                   # a window on the demo scene\n",
        false => "",
    };
    format!("Examples:\n{view}{EXAMPLES}\n\n{EXIT_CODES}\n\n{ENVIRONMENT}")
}

/// Draw 3D Gaussian Splatting scenes with renderers that are text files, and measure the cost of every choice
///
/// A renderer is a graph in a RON file: parameters, buffers, compute dispatches and draws. `splatgraph source` lists
/// the built-in ones, and `splatgraph new` writes one to start from. Pass the path of a graph to `--pipeline`.
#[derive(Debug, Parser)]
#[command(name = "splatgraph", version = program::VERSION, max_term_width = 110)]
#[command(after_help = examples())]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Allow graphs and shaders to name files in this folder; may be repeated
    ///
    /// Other files must be in the graph's folder, in pipelines/ or shaders/ next to that folder, or built in.
    #[arg(long, value_name = "DIR", global = true)]
    include_root: Vec<PathBuf>,
    /// Accepted before the command's name, and passed to the arguments of the command.
    #[command(flatten)]
    _load: FileOptions,
}

#[derive(Debug, Subcommand)]
enum Command {
    Render(render::Args),
    Video(video::Args),
    View(view::Args),
    Dump(dump::Args),
    Check(check::Args),
    New(new::Args),
    Source(source::Args),
    Params(params::Args),
    Lsp(lsp::Args),
    Info(info::Args),
    Compare(compare::Args),
    Convert(convert::Args),
    Evaluate(evaluate::Args),
    Synth(synth::Args),
    Bench(bench::Args),
    Trade(trade::Args),
    Sweep(sweep::Args),
    Advise(advise::Args),
    Merge(merge::Args),
    Experiment(experiment::Args),
    Popping(popping::Args),
    Devices(devices::Args),
    Completions(completions::Args),
    Man(man::Args),
}

impl Command {
    fn timeline(&self) -> Option<&Path> {
        match self {
            Command::Render(args) => args.timeline.as_deref(),
            _ => None,
        }
    }

    /// Returns the shard of the command, and whether validation was requested; `None` without `--shard`.
    fn shard(&self) -> Option<(Shard, bool)> {
        let (shard, validate) = match self {
            Command::Render(args) => (args.shard.shard, args.device.validate),
            Command::Trade(args) => (args.shard.shard, args.device.validate),
            Command::Sweep(args) => (args.shard.shard, args.device.validate),
            Command::Evaluate(args) => (args.shard.shard, args.device.validate),
            _ => return None,
        };
        shard.map(|shard| (shard, validate))
    }

    fn work(self) -> anyhow::Result<Box<dyn Work>> {
        Ok(match self {
            Command::Render(args) => Box::new(render::Views::new(args)?),
            Command::Trade(args) => Box::new(trade::Views::new(args)?),
            Command::Sweep(args) => Box::new(sweep::Views::new(args)?),
            Command::Evaluate(args) => Box::new(evaluate::Views::new(args)?),
            _ => return Err(Usage("expected one of render, trade, sweep, evaluate".into()).into()),
        })
    }
}

/// Creates the job of a command line, for a process that chooses the views itself. The first word is the command.
///
/// The folders of `--include-root` stay allowed until the process ends.
///
/// # Errors
/// The command has no views to share, its arguments or cameras are invalid, or `--shard` is among the arguments.
pub fn job(arguments: &[OsString]) -> anyhow::Result<Job> {
    let words = [OsString::from("splatgraph")].into_iter().chain(arguments.iter().cloned());
    let cli = Cli::try_parse_from(words)?;
    options::refuse_json_apart(arguments)?;
    if cli.command.shard().is_some() {
        return Err(Usage("expected no --shard: workers are assigned their views".into()).into());
    }
    planner::configure(planner::Settings { include_roots: cli.include_root, ..Default::default() });
    Ok(Job::new(cli.command.work()?))
}

/// Runs the program with the process's arguments.
///
/// The program compiles shaders in a second process of its own, so its `main` calls
/// [`serve_if_asked`](splatgraph_framework::shader::serve_if_asked) first.
pub fn main() -> ExitCode {
    // If the program's own path is unknown, shaders are compiled in this process.
    let worker = Worker::this_program().ok();
    let store = std::env::current_exe().ok().and_then(|program| ShaderCache::of_user(&program));
    ExitCode::from(run(std::env::args_os().collect(), worker, store))
}

/// Runs the program with `arguments`, of which the first is its name, and returns the exit code.
///
/// Without `worker`, shaders are compiled in this process; without `store`, they are not cached between runs. Installs
/// signal handlers and builds rayon's global pool. Ends the process instead of returning if a compiler thread was
/// abandoned or a window's device was left open.
pub fn run(arguments: Vec<OsString>, worker: Option<Worker>, store: Option<ShaderCache>) -> u8 {
    let begun = Instant::now();
    output::signals::end_cleanly();
    let parsed = command(&arguments)
        .try_get_matches_from(&arguments)
        .and_then(|matches| Cli::from_arg_matches(&matches));
    // If the command has no --json, clap's error says so.
    let unknown = parsed.as_ref().err().and_then(|error| error.get(ContextKind::InvalidArg));
    if !unknown.is_some_and(|option| *option == ContextValue::String("--json".into()))
        && let Err(error) = options::refuse_json_apart(&arguments)
    {
        return report(&error.into());
    }
    let cli = match parsed {
        Ok(cli) => cli,
        // clap's error does not name the invalid word.
        Err(error) if error.kind() == ErrorKind::InvalidUtf8 => return report(&not_utf_8(&arguments).into()),
        Err(error) => return terminal::say_usage(error, colour()),
    };
    let timeline = cli.command.timeline().map(|path| Timeline::start(path, begun));
    info_span!("start threads").in_scope(threads::build_pool);
    let store = store.map(|cache| Arc::new(cache) as Arc<_>);
    planner::configure(planner::Settings { worker, store, include_roots: cli.include_root });
    let result = match cli.command.shard() {
        Some((shard, validate)) => cli.command.work().and_then(|work| job::run(work, shard, validate)),
        None => run_command(&cli.command),
    };
    // Write the timeline only on success: the error may be that its file is an input.
    let result = match timeline {
        Some(timeline) => result.and_then(|outcome| {
            say(timeline.finish(&command_line(&arguments))?);
            Ok(outcome)
        }),
        None => result,
    };
    let code = match result {
        Ok(Outcome::Done) => 0,
        Ok(Outcome::Failed) => 1,
        Err(error) => report(&error),
    };
    #[cfg(feature = "window")]
    let left_open = crate::view::window::is_left_open();
    #[cfg(not(feature = "window"))]
    let left_open = false;
    if left_open || backend::abandoned_compilers() > 0 {
        // A library's exit handler may wait for an abandoned compiler thread or for a device that is still open.
        output::signals::end_now(code);
    }
    code
}

fn not_utf_8(arguments: &[OsString]) -> Usage {
    let pairs = arguments.iter().zip(arguments.iter().skip(1)).filter(|(_, word)| word.to_str().is_none());
    let found = pairs.map(|(before, word)| match before.to_str() {
        Some(option) if option.starts_with('-') => format!("{option} {}", word.display()),
        _ => word.display().to_string(),
    });
    // Paths may be any bytes, so perhaps only one of these is wrong.
    Usage(format!("expected valid UTF-8, found {}", found.collect::<Vec<_>>().join(" or ")))
}

fn command_line(arguments: &[OsString]) -> String {
    let words = arguments.iter().skip(1).map(|word| shell_word(&word.to_string_lossy()));
    ["splatgraph".to_owned()].into_iter().chain(words).collect::<Vec<_>>().join(" ")
}

fn run_command(command: &Command) -> anyhow::Result<Outcome> {
    match command {
        Command::Render(args) => render::run(args),
        Command::Video(args) => video::run(args),
        Command::View(args) => view::run(args),
        Command::Dump(args) => dump::run(args),
        Command::Check(args) => check::run(args),
        Command::New(args) => new::run(args),
        Command::Source(args) => source::run(args),
        Command::Params(args) => params::run(args),
        Command::Lsp(args) => lsp::run(args),
        Command::Info(args) => info::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Synth(args) => synth::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Trade(args) => trade::run(args),
        Command::Sweep(args) => sweep::run(args),
        Command::Advise(args) => advise::run(args),
        Command::Merge(args) => merge::run(args),
        Command::Experiment(args) => experiment::run(args),
        Command::Popping(args) => popping::run(args),
        Command::Devices(args) => devices::run(args),
        Command::Completions(args) => completions::run(args, Cli::command()),
        Command::Man(args) => man::run(args, Cli::command()),
    }
}

/// Builds the clap command. If `arguments` ask for it, its long help lists graphs, devices, scene formats and generated
/// scenes, and its long version has the program's hash.
fn command(arguments: &[OsString]) -> clap::Command {
    let has = |word: &str| arguments.iter().skip(1).any(|argument| argument == word);
    let mut command = Cli::command();
    // The lists and the program's hash take time, so only the answers that need them have them.
    if has("--version") {
        command = command.long_version(&*version::long().leak());
    }
    if !has("--help") && !has("help") {
        return command;
    }
    let presets = preset_list();
    command.mut_subcommands(|command| {
        let list = match command.get_name() {
            "view" | "render" | "video" | "dump" | "info" => presets.clone(),
            "check" => format!("Devices:\n{}\n\n{presets}", known_devices::list()),
            "convert" => convert::format_list(),
            "synth" => synth::generator_list(),
            _ => return command,
        };
        let examples = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        command.after_long_help(format!("{examples}\n\n{list}"))
    })
}

fn preset_list() -> String {
    let groups = builtin::groups();
    let rows = |title: &str| {
        let files = groups.iter().filter(|(other, _)| *other == title).flat_map(|(_, files)| files);
        help::two_columns(files.map(|file| (file.name.to_owned(), file.summary.clone())).collect())
    };
    format!(
        "Built-in graphs:\n{}\n{}\n\nTheir parameters, for --set: splatgraph params NAME\nTheir text: splatgraph source NAME",
        rows("Graphs"),
        rows("Filters"),
    )
}

fn report(error: &anyhow::Error) -> u8 {
    // Graph errors are rendered with the source text, and need no prefix.
    let graph_errors = |e: &'_ (dyn std::error::Error + 'static)| match e.downcast_ref::<SessionError>() {
        Some(SessionError::Graph(errors)) => Some(errors.text(colour()).to_owned()),
        _ => e.downcast_ref::<GraphErrors>().map(|errors| errors.text(colour()).to_owned()),
    };
    if let Some(text) = error.chain().find_map(graph_errors) {
        say_styled(&format!("{}\n", text.trim_end()));
        return 1;
    }
    say(format!("error: {error}"));
    if let Some(near) = error.chain().find_map(|cause| loading::nearby(cause.downcast_ref()?)) {
        say(format!("  did you mean {}?", near.display()));
    }
    let mut said = error.to_string();
    for cause in error.chain().skip(1) {
        let cause = cause.to_string();
        // Some errors already contain the text of their cause.
        if !said.contains(&cause) {
            say(format!("  because: {cause}"));
        }
        said = cause;
    }
    if error.is::<Usage>() || error.is::<ConditionError>() { 2 } else { 1 }
}

/// Parses the arguments of a command. The first word is the command's name.
#[cfg(test)]
fn parsed<A: clap::Args>(
    words: impl IntoIterator<Item = impl Into<OsString> + Clone>,
) -> Result<A, clap::Error> {
    let command = A::augment_args(clap::Command::new("command"));
    A::from_arg_matches(&command.try_get_matches_from(words)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        command(&[]).debug_assert();
    }

    #[test]
    fn the_examples_in_the_help_are_commands_that_this_program_has() {
        let mut help = command(&[]);
        let help = help.render_help().to_string();
        let lines = help.lines().filter_map(|line| line.trim_start().strip_prefix("splatgraph "));
        let names: Vec<&str> = lines.filter_map(|line| line.split_whitespace().next()).collect();
        assert!(names.len() > 10, "{help}");
        for name in names {
            assert!(command(&[]).find_subcommand(name).is_some(), "`{name}` of the examples is no command");
        }
    }

    #[test]
    fn a_heading_stands_over_the_options_that_it_describes_and_the_output_comes_first() {
        let all = Cli::command();
        for (name, heading, count) in [
            ("render", "A camera without a file", 6),
            ("video", "A circle without a file of cameras", 6),
            ("convert", "Changes, in this order", 8),
        ] {
            let options = || {
                all.find_subcommand(name).expect("a command").get_arguments().filter(|a| !a.is_positional())
            };
            let under = options().filter(|option| option.get_help_heading() == Some(heading)).count();
            let others = options().any(|option| ![None, Some(heading)].contains(&option.get_help_heading()));
            assert_eq!((under, others), (count, false), "{name}");
            let first = options().next().map(|option| option.get_id().as_str());
            assert_eq!(first, Some(if name == "convert" { "format" } else { "output" }), "{name}");
        }
    }

    #[test]
    fn options_of_loading_may_stand_before_or_after_the_command() {
        for line in
            ["splatgraph --level 2 --ignore-tags info a.sog", "splatgraph info a.sog --level 2 --ignore-tags"]
        {
            let Command::Info(args) = Cli::try_parse_from(line.split(' ')).expect(line).command else {
                panic!("{line}: expected info")
            };
            assert_eq!(
                args.load.file,
                FileOptions { ignore_tags: true, level: Some(2), ..FileOptions::default() },
                "{line}"
            );
        }
    }

    #[test]
    fn settings_sizes_and_colours_are_checked_when_the_line_is_parsed() {
        let parse = |line: &str| Cli::try_parse_from(line.split(' ')).map(|_| ()).map_err(|e| e.to_string());
        assert_eq!(
            parse("splatgraph render -o a.png --set a=1 --set b=2 --size 64x48 --background 0,0.5,1"),
            Ok(())
        );
        for (line, expected) in [
            ("splatgraph render", "--output"),
            ("splatgraph render -o a.png --set a", "NAME=VALUE"),
            ("splatgraph render -o a.png --size 64", "WIDTHxHEIGHT"),
            ("splatgraph render -o a.png --size 0x7", "WIDTHxHEIGHT"),
            ("splatgraph view --size 4294967295x1", "at most 32768x32768"),
            ("splatgraph render -o a.png --background 1,2", "three numbers"),
            ("splatgraph evaluate a.ply -c b --background 255,0,0", "(255 is 1), found 255"),
            ("splatgraph render -o a.png --inspect keys", "RESOURCE@PASS"),
            ("splatgraph render -o a.png --repeat 0", "--repeat"),
            ("splatgraph dump splat --format yaml", "yaml"),
            ("splatgraph compare a.png b.png --min-psnr nan", "a number of decibels"),
            ("splatgraph compare a.png b.png --gain 3", "--diff"),
        ] {
            let message = parse(line).unwrap_err();
            assert!(message.contains(expected), "{line}: {message}");
        }
    }
}
