//! Opens a source location in the user's editor.
//!
//! `VISUAL` or `EDITOR` names the editor. An editor unknown to `command`, such as one that needs a terminal, is
//! replaced by a `vscode://` link.

use crate::draw::builtin;
use crate::io::uri;
use splatgraph_framework::ir::Origin;
use std::env;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Fails if the file cannot be found (it may be built into the program), or the editor cannot be started.
pub fn open(origin: &Origin) -> Result<(), String> {
    let path = located(&origin.file)?;
    let (program, arguments) = command(&chosen(|name| env::var(name).ok()), &path, origin);
    let started = Command::new(&program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let mut child = started.map_err(|error| format!("{program} cannot be started: {error}"))?;
    // Reap the process when it ends.
    let _ = std::thread::Builder::new().name("editor".to_owned()).spawn(move || child.wait());
    Ok(())
}

fn located(file: &str) -> Result<PathBuf, String> {
    Path::new(file).canonicalize().map_err(|error| {
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

fn command(editor: &str, path: &Path, origin: &Origin) -> (String, Vec<String>) {
    let mut words = editor.split_whitespace().map(str::to_owned);
    let program = words.next().unwrap_or_default();
    let mut arguments: Vec<String> = words.collect();
    let name = Path::new(&program).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let Origin { line, column, .. } = origin;
    let file = path.display();
    match name.as_str() {
        "code" | "code-insiders" | "codium" | "cursor" => {
            arguments.extend(["--goto".to_owned(), format!("{file}:{line}:{column}")]);
        }
        "subl" | "zed" => arguments.push(format!("{file}:{line}:{column}")),
        "gvim" | "emacs" | "emacsclient" | "gedit" | "kate" | "mousepad" => {
            let place = if name == "kate" { format!("--line={line}") } else { format!("+{line}") };
            arguments.extend([place, file.to_string()]);
        }
        _ => {
            let opener = if cfg!(target_vendor = "apple") { "open" } else { "xdg-open" };
            let link = format!("vscode://file{}:{line}:{column}", uri::encoded(path));
            return (opener.to_owned(), vec![link]);
        }
    }
    (program, arguments)
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
        let error = located(builtin::FILES[0].0).unwrap_err();
        assert!(error.contains("is built into the program"), "{error}");
        let deleted = tempfile::tempdir().unwrap().path().join("gone.ron");
        let error = located(&deleted.display().to_string()).unwrap_err();
        assert!(error.contains("gone.ron cannot be opened: ") && !error.contains("built"), "{error}");
    }
}
