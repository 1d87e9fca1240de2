//! Opens a source location in the user's editor.
//!
//! `VISUAL` or `EDITOR` names the editor. An editor unknown to `command`, such as one that needs a terminal, is
//! replaced by a `vscode://` link.

use splatgraph_framework::ir::Origin;
use std::env;
use std::path::Path;
use std::process::{Command, Stdio};

/// Fails if the file does not exist (it may be built into the program), or the editor cannot be started.
pub fn open(origin: &Origin) -> Result<(), String> {
    let path = Path::new(&origin.file);
    let path = path.canonicalize().map_err(|_| {
        format!("{} is built into the program: there is no file of that name to edit", origin.file)
    })?;
    let editor = ["VISUAL", "EDITOR"].iter().find_map(|name| env::var(name).ok()).unwrap_or_default();
    let (program, arguments) = command(&editor, &path, origin);
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
            return (opener.to_owned(), vec![format!("vscode://file{file}:{line}:{column}")]);
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
}
