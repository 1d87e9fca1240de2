//! Opens a source location in the user's editor.
//!
//! `VISUAL` or `EDITOR` names the editor. Without either, or if the editor is not in `EDITORS`, for example because it
//! needs a terminal, a `vscode://` link is opened. If that fails, the error message names the location.

use crate::draw::builtin;
use crate::io::uri;
use crate::view::renderer::Wake;
use splatgraph_framework::ir::Origin;
use std::env;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// A program that fails within this time of its start has not opened the file. After a longer time, the user may have
/// closed it.
const STARTING: Duration = Duration::from_secs(10);

/// Arguments that open a location; `{file}`, `{line}` and `{column}` are replaced.
const GOTO: &[&str] = &["--goto", "{file}:{line}:{column}"];
const COLONS: &[&str] = &["{file}:{line}:{column}"];
const PLUS: &[&str] = &["+{line}", "{file}"];

/// Editors that can be started without a terminal, with their arguments.
const EDITORS: [(&str, &[&str]); 12] = [
    ("code", GOTO),
    ("code-insiders", GOTO),
    ("codium", GOTO),
    ("cursor", GOTO),
    ("subl", COLONS),
    ("zed", COLONS),
    ("gvim", PLUS),
    ("emacs", PLUS),
    ("emacsclient", PLUS),
    ("gedit", PLUS),
    ("kate", &["--line={line}", "{file}"]),
    ("mousepad", PLUS),
];

/// Launcher of the user's editor, with its failures.
pub struct Editor {
    failures: (Sender<String>, Receiver<String>),
    wake: Wake,
}

impl Editor {
    /// Creates an editor launcher. It calls `wake` when a launched program has failed.
    pub fn new(wake: Wake) -> Editor {
        Editor { failures: channel(), wake }
    }

    /// Opens a location. Fails if the file cannot be found (it may be built into the program), or no program can be
    /// started; see also [`Editor::take_failure`].
    pub fn open(&mut self, origin: &Origin) -> Result<(), String> {
        let path = located(&origin.file, Path::new(""))?;
        let editor = chosen(|name| env::var(name).ok());
        let (program, arguments) = command(&editor, &path, origin);
        let failure = format!("{}; the place is {}:{}", advice(&editor), path.display(), origin.line);
        self.start(&program, arguments, failure)
    }

    /// Starts a program; `failure` is the rest of the message if it fails.
    fn start(&self, program: &str, arguments: Vec<String>, failure: String) -> Result<(), String> {
        let begun = Instant::now();
        let started = Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let mut child =
            started.map_err(|error| format!("{program} cannot be started: {error}. {failure}"))?;
        let (sender, wake, program) = (self.failures.0.clone(), self.wake.clone(), program.to_owned());
        let wait = move || {
            if let Ok(status) = child.wait()
                && !status.success()
                && begun.elapsed() < STARTING
            {
                let _ = sender.send(format!("{program} failed ({status}). {failure}"));
                wake();
            }
        };
        let _ = std::thread::Builder::new().name("editor".to_owned()).spawn(wait);
        Ok(())
    }

    /// Takes the error message of a program that failed after its start; `None` if there is none.
    pub fn take_failure(&self) -> Option<String> {
        self.failures.1.try_recv().ok()
    }
}

/// Advises the user what to do if the program for `editor` fails.
fn advice(editor: &str) -> String {
    let known = EDITORS.map(|(name, _)| name).join(", ");
    match words(editor).first() {
        None => format!("Set VISUAL to one of {known}"),
        Some(program) if arguments_of(program).is_some() => format!("VISUAL or EDITOR is `{editor}`"),
        Some(program) => format!(
            "{program} may need a terminal, so a vscode:// link was tried instead: set VISUAL to one of {known}"
        ),
    }
}

/// Returns the absolute path of a file that is named relative to `folder`. Fails if there is no such file.
fn located(file: &str, folder: &Path) -> Result<PathBuf, String> {
    dunce::canonicalize(folder.join(file)).map_err(|error| {
        let is_built_in = builtin::FILES.iter().any(|(path, _)| *path == file);
        match error.kind() {
            ErrorKind::NotFound if is_built_in => {
                format!("{file} is built into the program: there is no file of that name to edit")
            }
            _ => format!("{file} cannot be opened: {error}"),
        }
    })
}

/// Returns the user's editor, from the variables that `variable` reads; empty if none is set.
fn chosen(variable: impl Fn(&str) -> Option<String>) -> String {
    let set = |name| variable(name).filter(|editor| !editor.trim().is_empty());
    ["VISUAL", "EDITOR"].into_iter().find_map(set).unwrap_or_default()
}

/// Returns the arguments of an editor in [`EDITORS`]; `None` for other editors.
fn arguments_of(program: &str) -> Option<&'static [&'static str]> {
    let name = Path::new(program).file_stem().unwrap_or_default();
    EDITORS.iter().find(|(known, _)| name == *known).map(|(_, arguments)| *arguments)
}

/// Splits an editor's variable into the program and its arguments, at white space outside of quotes, as a shell does.
/// Returns the path of a program unchanged, and nothing for a quote without its end.
fn words(editor: &str) -> Vec<String> {
    if Path::new(editor).is_file() {
        return vec![editor.to_owned()];
    }
    // On Windows, backslashes separate folders; for shells, they quote.
    let text = if cfg!(windows) { editor.replace('\\', r"\\") } else { editor.to_owned() };
    shlex::split(&text).unwrap_or_default()
}

fn command(editor: &str, path: &Path, Origin { line, column, .. }: &Origin) -> (String, Vec<String>) {
    let mut words = words(editor).into_iter();
    let program = words.next().unwrap_or_default();
    let Some(arguments) = arguments_of(&program) else {
        let opener = if cfg!(target_vendor = "apple") { "open" } else { "xdg-open" };
        let link = format!("vscode://file{}:{line}:{column}", uri::encoded(path));
        return (opener.to_owned(), vec![link]);
    };
    let place = |argument: &&str| {
        let place = argument.replace("{line}", &line.to_string()).replace("{column}", &column.to_string());
        place.replace("{file}", &path.display().to_string())
    };
    (program, words.chain(arguments.iter().map(place)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn editors_are_given_the_line_in_their_own_way() {
        let origin = Origin { file: "a.ron".to_owned(), line: 7, column: 3 };
        let path = Path::new("/graphs/a.ron");
        let of = |editor: &str| {
            let (program, arguments) = command(editor, path, &origin);
            format!("{program} {}", arguments.join(" "))
        };
        assert_eq!(of("code --wait"), "code --wait --goto /graphs/a.ron:7:3");
        assert_eq!(of("/usr/bin/gvim"), "/usr/bin/gvim +7 /graphs/a.ron");
        assert!(of("vim").ends_with(" vscode://file/graphs/a.ron:7:3"), "vim needs a terminal");
        assert!(of("").ends_with(" vscode://file/graphs/a.ron:7:3"));
    }

    #[test]
    fn an_editor_in_a_folder_with_a_space_is_found_and_quotes_are_those_of_a_shell() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("my editors/code");
        std::fs::create_dir_all(program.parent().unwrap()).unwrap();
        std::fs::write(&program, "").unwrap();
        let program = program.display().to_string();
        let origin = Origin { file: "a.ron".to_owned(), line: 7, column: 3 };
        let of = |editor: &str| command(editor, Path::new("/a.ron"), &origin);
        let goto = ["--goto", "/a.ron:7:3"].map(str::to_owned);
        assert_eq!(of(&program), (program.clone(), goto.to_vec()));
        let (found, arguments) = of(&format!("'{program}' --profile \"my graphs\" --wait"));
        assert_eq!(found, program);
        assert_eq!(arguments[..3], ["--profile", "my graphs", "--wait"]);
        assert_eq!(arguments[3..], goto);
        assert!(advice(&format!("'{program}'")).starts_with("VISUAL or EDITOR is "));
    }

    #[test]
    fn a_program_that_fails_is_reported_with_the_place() {
        let editor = Editor::new(std::sync::Arc::new(|| {}));
        editor.start("false", vec![], "the place is a.ron:7".to_owned()).expect("it starts");
        let failure = editor.failures.1.recv().expect("it fails");
        assert_eq!(failure, "false failed (exit status: 1). the place is a.ron:7");
        let error = editor
            .start("no-such-program", vec![], "the place is a.ron:7".to_owned())
            .expect_err("no program");
        assert!(error.ends_with(". the place is a.ron:7"), "{error}");
    }

    #[test]
    fn an_editor_that_cannot_be_started_leads_to_those_that_can() {
        let advice = advice("vim -u NONE");
        assert!(advice.starts_with("vim may need a terminal") && advice.contains("gvim, emacs"), "{advice}");
        let origin = Origin { file: "a.ron".to_owned(), line: 7, column: 3 };
        for (editor, _) in EDITORS {
            let (program, _) = command(editor, Path::new("/a.ron"), &origin);
            assert_eq!(program, editor, "the editor itself is started, not a link");
        }
    }

    #[test]
    fn a_link_encodes_what_a_uri_reserves() {
        let origin = Origin { file: "a.ron".to_owned(), line: 7, column: 3 };
        let (_, arguments) = command("", Path::new("/my graphs/50%#?.ron"), &origin);
        assert_eq!(arguments, ["vscode://file/my%20graphs/50%25%23%3F.ron:7:3"]);
    }

    #[test]
    fn an_empty_variable_does_not_hide_the_other() {
        let of = |visual: &'static str, editor: &'static str| {
            chosen(|name| Some(if name == "VISUAL" { visual } else { editor }.to_owned()))
        };
        assert_eq!(of("", "code"), "code");
        assert_eq!(of("zed", "code"), "zed");
        assert_eq!(of("", " "), "");
        assert_eq!(chosen(|_| None), "");
    }

    #[test]
    fn only_a_file_of_the_program_is_told_to_be_built_in() {
        let folder = tempfile::tempdir().unwrap();
        let error = located(builtin::FILES[0].0, folder.path()).unwrap_err();
        assert!(error.contains("is built into the program"), "{error}");
        let error = located("gone.ron", folder.path()).unwrap_err();
        assert!(error.contains("gone.ron cannot be opened: ") && !error.contains("built"), "{error}");
    }
}
