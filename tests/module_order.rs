//! Checks that imports run one way: each module imports only modules before it in a list.

use std::fs;
use std::path::{Path, PathBuf};

/// Reads the sources of a module and fails on every import that runs against `order`.
///
/// `src` is the folder of the module `root`, `crate` or for instance `crate::view`. `order` lists its submodules from the ground
/// up; paths outside of `root` are not checked. A file may name the modules before its own (by `root`, or as many `super::` as
/// lead to it), in a `use` or inline. Tests may import anything: a file called `tests.rs` or `testing.rs`, a folder called
/// `tests`, and the rest of a module behind `#[cfg(test)]`. The file of `root` itself may name every submodule.
pub fn assert_imports_run_one_way(src: &Path, root: &str, order: &[&str]) {
    let mut files = Vec::new();
    collect(src, &mut files);
    files.sort();
    let mut wrong = Vec::new();
    for file in &files {
        let relative = file.strip_prefix(src).expect("below src");
        let path: Vec<String> =
            relative.with_extension("").iter().map(|p| p.to_string_lossy().into()).collect();
        if path.iter().any(|p| matches!(p.as_str(), "tests" | "testing"))
            || matches!(&*path[0], "lib" | "main" | "mod")
        {
            continue;
        }
        let Some(own) = order.iter().position(|m| *m == path[0]) else {
            wrong.push(format!("{}: the module `{}` is not in the order", relative.display(), path[0]));
            continue;
        };
        let depth = path.iter().filter(|p| *p != "mod").count();
        let text = fs::read_to_string(file).expect("a source file is readable");
        for (line, name) in imports(&code(&text), root, depth) {
            match order.iter().position(|m| *m == name) {
                Some(other) if other <= own => {}
                Some(_) => {
                    wrong.push(format!("{}:{line}: `{}` imports `{name}`", relative.display(), path[0]))
                }
                None => {
                    wrong.push(format!("{}:{line}: `{name}` is no module of the order", relative.display()))
                }
            }
        }
    }
    assert!(!files.is_empty(), "{} holds no source file", src.display());
    assert!(
        wrong.is_empty(),
        "expected imports in the order {}, found\n{}",
        order.join(" <- "),
        wrong.join("\n")
    );
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a readable folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

/// Blanks comments and modules behind `#[cfg(test)]`, and keeps the line breaks.
fn code(text: &str) -> String {
    let mut code = String::new();
    let (mut after_cfg, mut in_tests) = (false, false);
    for line in text.lines() {
        in_tests |= after_cfg && line.starts_with("mod ") && line.ends_with('{');
        after_cfg = line == "#[cfg(test)]";
        if !in_tests {
            code += line.split("//").next().unwrap_or("");
        }
        in_tests &= line != "}";
        code.push('\n');
    }
    code
}

/// Lists the submodules of `root` that the code names, with their lines. The code is `depth` modules below `root`.
fn imports(code: &str, root: &str, depth: usize) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for start in [format!("{root}::"), "super::".repeat(depth)] {
        for (at, _) in code.match_indices(&start) {
            let before = code[..at].chars().next_back();
            if before.is_some_and(|c| c.is_alphanumeric() || matches!(c, '_' | ':')) {
                continue;
            }
            let line = code[..at].matches('\n').count() + 1;
            for name in heads(&code[at + start.len()..]) {
                found.push((line, name));
            }
        }
    }
    found
}

/// Lists the first names of a path: one, or those of a group in braces.
fn heads(path: &str) -> Vec<String> {
    let name =
        |text: &str| text.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    // A glob in a module within the file, `super::*`, names nothing.
    let Some(group) = path.strip_prefix('{') else {
        return Some(name(path)).filter(|n| !n.is_empty()).into_iter().collect();
    };
    let (mut heads, mut depth, mut start) = (Vec::new(), 0, 0);
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                heads.push(name(&group[start..at]));
                start = at + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    heads.retain(|head| !head.is_empty());
    heads
}
