//! Parses and checks random command lines without a device. No check may panic, hang, or change a file.

#[path = "../../../tests/files/words.rs"]
mod words;

use super::outcome::Usage;
use super::{
    Cli, Command, advise, bench, compare, convert, dump, evaluate, experiment, merge, new, options, popping,
    render, sweep, synth, trade, video, view,
};
use crate::io::image::Image;
use anyhow::Result;
use clap::{CommandFactory, Parser};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// Number of command lines in the long run, and in the default run.
const LINES: (u64, u64) = (100_000, 3_000);

/// Runs the checks of a command that precede its work.
fn check(command: &Command) -> Result<()> {
    match command {
        Command::Render(args) => render::prepare(args).map(drop),
        Command::Video(args) => video::prepare(args).map(drop),
        Command::View(args) => Ok(view::check_files(args)?),
        Command::Dump(args) => Ok(dump::guard(args).map(drop)?),
        Command::Compare(args) => compare::prepare(args).map(drop),
        Command::Synth(args) => Ok(synth::check_files(args)?),
        Command::Bench(args) => bench::prepare(args).map(drop),
        Command::Trade(args) => Ok(trade::guard(args).map(drop)?),
        Command::Sweep(args) => Ok(sweep::guard(args).map(drop)?),
        Command::Advise(args) => Ok(advise::guard(args).map(drop)?),
        Command::Experiment(args) => Ok(experiment::guard(args).map(drop)?),
        Command::Popping(args) => Ok(popping::guard(args).map(drop)?),
        Command::Convert(args) => Ok(convert::check_files(args).map(drop)?),
        Command::Evaluate(args) => evaluate::prepare(args).map(drop),
        Command::New(args) => Ok(new::prepare(args).map(drop)?),
        Command::Merge(args) => merge::prepare(args).map(drop),
        Command::Check(_)
        | Command::Source(_)
        | Command::Params(_)
        | Command::Lsp(_)
        | Command::Info(_)
        | Command::Devices(_)
        | Command::Completions(_)
        | Command::Man(_) => Ok(()),
    }
}

fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.append(&mut files(&path));
        } else {
            found.insert(path.clone(), fs::read(path).unwrap());
        }
    }
    found
}

#[test]
fn the_random_command_lines_have_every_command() {
    let commands = Cli::command();
    let all: BTreeSet<&str> = commands.get_subcommands().map(clap::Command::get_name).collect();
    let mut tried: BTreeSet<&str> = words::COMMANDS.split_whitespace().collect();
    // `devices` and `help` are among the rare words. `lsp` reads standard input until an editor closes it.
    tried.extend(["devices", "help", "lsp"].iter().filter(|name| all.contains(*name)));
    assert_eq!(tried, all, "COMMANDS in tests/files/words.rs");
}

#[test]
fn no_command_line_panics_before_its_work_or_changes_a_file() {
    let lines = if std::env::var_os("SPLATGRAPH_LONG").is_some() { LINES.0 } else { LINES.1 };
    let folder = tempfile::tempdir().unwrap();
    words::write_files(folder.path());
    let before = files(folder.path());
    let [mut refused, mut usage, mut failed, mut fine] = [0u32; 4];
    for number in 0..lines {
        // Other tests share this process's working directory, so files are named by absolute path.
        let words =
            words::line(&mut words::Random(number)).into_iter().map(|word| in_folder(folder.path(), &word));
        let words: Vec<String> = ["splatgraph".to_owned()].into_iter().chain(words).collect();
        let run = || Cli::try_parse_from(&words).map(|cli| check(&cli.command));
        match catch_unwind(AssertUnwindSafe(run)) {
            Err(_) => panic!("line {number} panics: {words:?}"),
            Ok(Err(error)) => {
                let _ = error.render().to_string();
                refused += 1;
            }
            Ok(Ok(Err(error))) if error.is::<Usage>() => usage += 1,
            Ok(Ok(Err(_))) => failed += 1,
            Ok(Ok(Ok(()))) => fine += 1,
        }
        if number % 1000 == 999 || number + 1 == lines {
            assert!(files(folder.path()) == before, "a line up to {number} changes files");
        }
    }
    // `eprintln!` is captured in tests that pass.
    let _ = writeln!(
        std::io::stderr(),
        "command lines: {lines}: {refused} refused by the parser, {usage} by the checks, {failed} failed, {fine} fine"
    );
    assert!([refused, usage, failed, fine].iter().all(|count| u64::from(*count) > lines / 300));
    assert!(options::size("1x1").is_ok());
}

/// Puts `folder` before a word, or before the value of `--option=value`, if it is the name of a file.
fn in_folder(folder: &Path, word: &str) -> String {
    let (option, value) = match word.split_once('=') {
        Some((option, value)) if option.starts_with('-') => (format!("{option}="), value),
        _ => (String::new(), word),
    };
    let is_file = words::FILES.split(' ').any(|file| file == value)
        || value.contains(['.', '/']) && !value.starts_with(['/', '-']);
    if is_file { format!("{option}{}/{value}", folder.display()) } else { word.to_owned() }
}
