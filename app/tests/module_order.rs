//! Checks the files of every crate: imports between files form no circle, and modules have one layout. In the crates of
//! [`ORDERS`], imports between modules run one way.
//!
//! An import is a path, in a `use` or in code, that leads to another file of the crate. A re-exported name (`use
//! child::Name` in `mod.rs`) counts as an import of the file that defines it. Tests may import anything: files and
//! folders called `tests`, `testing` or `fuzz`, and code under `#[cfg(test)]`. So may `main.rs`.

// The tests write files of their own.
#![allow(clippy::disallowed_methods)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Folders of crates whose modules have an order, and the modules, the lowest first.
///
/// In the framework, `lower` begins a plan, `link` adds its shaders, and `solve` the rest.
const ORDERS: [(&str, &[&str]); 4] = [
    ("app", &["numbers", "io", "draw", "studies", "view", "lsp", "cli"]),
    (
        "framework",
        &[
            "ir", "source", "plan", "expr", "schema", "lower", "shader", "link", "msl", "solve", "dump",
            "oracle", "reload", "build",
        ],
    ),
    ("backends/metal", &["error", "features", "lower", "progress", "times", "sync", "dump", "walk", "apple"]),
    ("backends/null", &["fault", "journal", "gpu", "encoder", "backend"]),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn every_module_imports_only_those_before_it() {
    ORDERS
        .iter()
        .for_each(|(folder, order)| assert_modules_run_one_way(&root().join(folder).join("src"), order));
}

#[test]
fn no_files_of_a_crate_import_each_other_in_a_circle() {
    crates().iter().for_each(|source| assert_files_have_no_circle(source));
}

#[test]
fn modules_of_every_crate_are_laid_out_alike() {
    crates().iter().for_each(|source| assert_modules_are_laid_out_alike(source));
}

/// Lists the folders `src` of the workspace's members.
fn crates() -> Vec<PathBuf> {
    let (_, members) = include_str!("../../Cargo.toml").split_once("\nmembers = [").expect("a list");
    let members = members.split(']').next().expect("it ends");
    let folders = members.split('"').skip(1).step_by(2).flat_map(|member| match member.strip_suffix("/*") {
        Some(parent) => {
            let inside = fs::read_dir(root().join(parent)).expect("a folder");
            inside.map(|entry| entry.expect("an entry").path()).collect()
        }
        None => vec![root().join(member)],
    });
    let mut found: Vec<PathBuf> =
        folders.map(|folder| folder.join("src")).filter(|src| src.is_dir()).collect();
    found.sort();
    assert!(found.len() > 8, "only {found:?}");
    found
}

#[test]
fn an_import_against_the_order_fails_with_file_line_and_both_modules() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("writable");
    write("low.rs", "//! See [`crate::high`].\nuse std::fmt;\n\nuse crate::{\n    high::Thing, low,\n};\n");
    write("high.rs", "use crate::low;\n#[cfg(test)]\nmod tests {\n    use crate::top;\n}\nuse super::low;\n");
    write("top.rs", "fn f() { crate::high::g() }\n");
    let failure = std::panic::catch_unwind(|| {
        assert_modules_run_one_way(folder.path(), &["low", "high", "top"]);
    });
    let message = *failure.expect_err("an import is wrong").downcast::<String>().expect("a text");
    let found: Vec<&str> = message.lines().skip(1).collect();
    assert_eq!(found, ["low.rs:4: names `crate::high::Thing`"]);
}

#[test]
fn a_circle_between_a_module_and_its_child_fails_and_names_that_are_passed_on_lead_to_their_file() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("high")).expect("writable");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("writable");
    write("high/mod.rs", "mod a;\nmod b;\npub use a::Thing;\nuse b::f;\n");
    write("high/a.rs", "pub struct Thing;\n");
    write(
        "high/b.rs",
        "use super::Thing;\nmod inner {\n    use super::*;\n}\n#[cfg(test)]\nmod tests {\n    use super::super::g;\n}\n",
    );
    assert_files_have_no_circle(folder.path());
    write("high/b.rs", "fn f() {\n    let _ = \"super::g\"; // super::g\n    super::g()\n}\n");
    let failure = std::panic::catch_unwind(|| assert_files_have_no_circle(folder.path()));
    let message = *failure.expect_err("there is a circle").downcast::<String>().expect("a text");
    let found: Vec<&str> = message.lines().skip(1).collect();
    assert_eq!(found, ["high/mod.rs:4: names `b::f`", "high/b.rs:3: names `super::g`"]);
}

/// The path of a module from the crate's root.
type Module = Vec<String>;

struct File {
    place: String,
    /// Every path that the code names, with its line.
    paths: Vec<(usize, Module)>,
    /// Names imported by `use`: the last segment, or the name after `as`.
    names: BTreeMap<String, Module>,
}

/// Fails if a module imports a later one of `order`, which lists a crate's modules from the ground up.
fn assert_modules_run_one_way(src: &Path, order: &[&str]) {
    let files = read(src);
    let mut wrong = Vec::new();
    for (own, file) in &files {
        let at =
            |module: &Module| order.iter().position(|name| Some(*name) == module.first().map(String::as_str));
        // The crate's root may import everything.
        let Some(first) = own.first() else { continue };
        let Some(place) = at(own) else {
            wrong.push(format!("{}: the module `{first}` is not in the order", file.place));
            continue;
        };
        for Import { other, text } in imports(&files, own, file) {
            if at(other).is_some_and(|other| other > place) {
                wrong.push(text);
            }
        }
    }
    let order = order.join(" <- ");
    assert!(
        wrong.is_empty(),
        "expected imports of {} in the order {order}, found\n{}",
        src.display(),
        wrong.join("\n")
    );
}

/// Fails if imports between a crate's files form a cycle, including cycles between a module and its children.
fn assert_files_have_no_circle(src: &Path) {
    let files = read(src);
    let mut left: BTreeMap<&Module, Vec<Import>> = BTreeMap::new();
    for (own, file) in &files {
        left.insert(own, imports(&files, own, file));
    }
    // Repeatedly removes files without remaining imports or importers. What remains are the cycles, and the files
    // between two cycles.
    loop {
        let before = left.len();
        let kept: BTreeSet<&Module> = left.keys().copied().collect();
        left.values_mut().for_each(|all| all.retain(|import| kept.contains(import.other)));
        let imported: BTreeSet<&Module> = left.values().flatten().map(|import| import.other).collect();
        left.retain(|own, all| !all.is_empty() && imported.contains(own));
        if left.len() == before {
            break;
        }
    }
    let circles: Vec<&str> = left.values().flatten().map(|import| import.text.as_str()).collect();
    assert!(
        circles.is_empty(),
        "expected no circle of imports between files of {}, found\n{}",
        src.display(),
        circles.join("\n")
    );
}

struct Import<'a> {
    other: &'a Module,
    text: String,
}

fn imports<'a>(files: &'a BTreeMap<Module, File>, own: &Module, file: &File) -> Vec<Import<'a>> {
    let import = |(line, path): &(usize, Module)| {
        let other = target(files, own, path)?;
        Some(Import { other, text: format!("{}:{line}: names `{}`", file.place, path.join("::")) })
    };
    file.paths.iter().filter_map(import).collect()
}

/// Fails if modules are not laid out alike.
///
/// A module with children must be `name/mod.rs`. Unit tests must be at the end of their file, in `tests.rs`, or in
/// `tests/` beside it.
fn assert_modules_are_laid_out_alike(src: &Path) {
    let mut wrong = Vec::new();
    for (place, text) in sources(src) {
        let path = src.join(&place);
        if path.with_extension("").is_dir() && !place.ends_with("mod.rs") {
            wrong.push(format!(
                "{place}: expected {}/mod.rs, as it has children",
                place.trim_end_matches(".rs")
            ));
        }
        if place.ends_with("_tests.rs") || place.ends_with("_test.rs") {
            wrong.push(format!("{place}: expected a file in `tests/`"));
        }
        let code: Vec<&str> = text.lines().collect();
        let begin = code.windows(2).position(|two| two[0] == "#[cfg(test)]" && two[1] == "mod tests {");
        if let Some(begin) = begin
            && let Some(end) = code[begin..].iter().position(|line| *line == "}")
            && code[begin + end + 1..].iter().any(|line| !line.is_empty())
        {
            wrong.push(format!("{place}:{}: expected the module `tests` at the end of the file", begin + 2));
        }
    }
    assert!(
        wrong.is_empty(),
        "expected one layout of modules in {}, found\n{}",
        src.display(),
        wrong.join("\n")
    );
}

/// Lists the sources below a folder: paths below it, with their text.
fn sources(src: &Path) -> Vec<(String, String)> {
    let (mut found, mut folders) = (Vec::new(), vec![src.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a readable folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let place = path.strip_prefix(src).expect("below src").to_string_lossy().into_owned();
                found.push((place, fs::read_to_string(&path).expect("a readable source")));
            }
        }
    }
    assert!(!found.is_empty(), "{} holds no source file", src.display());
    found.sort();
    found
}

fn read(src: &Path) -> BTreeMap<Module, File> {
    let mut files = BTreeMap::new();
    for (place, text) in sources(src) {
        let mut module: Module = place.trim_end_matches(".rs").split('/').map(String::from).collect();
        if module.iter().any(|name| matches!(name.as_str(), "tests" | "testing" | "fuzz" | "main")) {
            continue;
        }
        if module.last().is_some_and(|last| last == "mod" || last == "lib") {
            module.pop();
        }
        let (paths, names) = paths(&tokens(&text));
        files.insert(module, File { place, paths, names });
    }
    files
}

/// Finds the file that a path leads to, following re-exports.
fn target<'a>(files: &'a BTreeMap<Module, File>, own: &Module, path: &[String]) -> Option<&'a Module> {
    let mut at = own.clone();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => at.clear(),
        "self" | "super" => {}
        child if files.contains_key(&[own.as_slice(), &[child.to_owned()]].concat()) => {}
        _ => return None,
    }
    if path[0] == "crate" || path[0] == "self" {
        rest = &rest[1..];
    }
    while rest.first().is_some_and(|name| name == "super") {
        at.pop();
        rest = &rest[1..];
    }
    // Eight steps follow any chain of re-exports in these crates.
    for _ in 0..8 {
        while let Some(name) = rest.first() {
            at.push(name.clone());
            if !files.contains_key(&at) {
                at.pop();
                break;
            }
            rest = &rest[1..];
        }
        let (Some(name), Some(file)) = (rest.first(), files.get(&at).filter(|_| at != *own)) else { break };
        let Some(next) = file.names.get(name) else { break };
        let through = target(files, &at, next)?;
        at.clone_from(through);
        // The item itself may be re-exported again.
        rest = next.last().map_or(&[], std::slice::from_ref);
    }
    files.get_key_value(&at).map(|(found, _)| found).filter(|found| *found != own)
}

/// Splits code into names and punctuation, with line numbers. Leaves out comments, strings within a line, and blocks
/// under `#[cfg(test)]`.
fn tokens(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let (mut after_cfg, mut in_tests) = (false, false);
    for (line, code) in text.lines().enumerate() {
        in_tests |= after_cfg && code.ends_with('{');
        after_cfg = code.starts_with("#[cfg(") && code.contains("test");
        if !in_tests {
            line_tokens(code, line + 1, &mut found);
        }
        in_tests &= code != "}";
    }
    found
}

fn line_tokens(code: &str, line: usize, found: &mut Vec<(usize, String)>) {
    let mut chars = code.chars().peekable();
    while let Some(c) = chars.next() {
        let mut token = c.to_string();
        match c {
            '/' if chars.peek() == Some(&'/') => return,
            '"' => {
                while let Some(c) = chars.next() {
                    match c {
                        '\\' => drop(chars.next()),
                        '"' => break,
                        _ => {}
                    }
                }
                continue;
            }
            ':' if chars.peek() == Some(&':') => {
                chars.next();
                token.push(':');
            }
            c if c.is_alphanumeric() || c == '_' => {
                while let Some(c) = chars.next_if(|c| c.is_alphanumeric() || *c == '_') {
                    token.push(c);
                }
            }
            c if c.is_whitespace() => continue,
            _ => {}
        }
        found.push((line, token));
    }
}

/// Lists the paths in a file's code, and the names that its `use`s import.
///
/// Within an inline module, a `super` that leads back to the file is left out.
fn paths(tokens: &[(usize, String)]) -> (Vec<(usize, Module)>, BTreeMap<String, Module>) {
    let (mut all, mut names) = (Vec::new(), BTreeMap::new());
    let word = |at: usize| tokens.get(at).map_or("", |(_, token)| token.as_str());
    // `inner` holds the brace depths at which inline modules began.
    let (mut inner, mut depth, mut at) = (Vec::new(), 0, 0);
    while at < tokens.len() {
        let line = tokens[at].0;
        match word(at) {
            "{" => depth += 1,
            "}" => {
                depth -= 1;
                inner.retain(|began| *began < depth);
            }
            "mod" if word(at + 2) == "{" => inner.push(depth),
            "use" => {
                let mut found = Vec::new();
                at = tree(tokens, at + 1, &[], &mut found);
                for (path, name) in found {
                    let Some(path) = outside(path, inner.len()) else { continue };
                    if inner.is_empty() {
                        names.insert(name, path.clone());
                    }
                    all.push((line, path));
                }
                continue;
            }
            name if name.starts_with(|c: char| c.is_alphabetic() || c == '_')
                && word(at + 1) == "::"
                && !matches!(word(at.wrapping_sub(1)), "::" | "." | "in") =>
            {
                let mut path = vec![name.to_owned()];
                while word(at + 1) == "::"
                    && word(at + 2).starts_with(|c: char| c.is_alphabetic() || c == '_')
                {
                    path.push(word(at + 2).to_owned());
                    at += 2;
                }
                all.extend(outside(path, inner.len()).map(|path| (line, path)));
            }
            _ => {}
        }
        at += 1;
    }
    (all, names)
}

/// Removes the `super`s that lead out of inline modules; `None` if the path stays within them.
fn outside(path: Module, inner: usize) -> Option<Module> {
    let up = path.iter().take_while(|name| *name == "super").count();
    match path.first().map(String::as_str) {
        _ if inner == 0 => Some(path),
        Some("crate") => Some(path),
        _ if up > inner => Some(path[inner..].to_vec()),
        _ => None,
    }
}

/// Reads a `use` tree from token `at`; returns the position after it. Each path comes with the imported name.
fn tree(
    tokens: &[(usize, String)],
    mut at: usize,
    front: &[String],
    found: &mut Vec<(Module, String)>,
) -> usize {
    let mut path = front.to_vec();
    let mut name = None;
    while let Some((_, token)) = tokens.get(at) {
        match token.as_str() {
            "{" => {
                at += 1;
                while tokens.get(at).is_some_and(|(_, token)| token != "}") {
                    at = tree(tokens, at, &path, found);
                    if tokens.get(at).is_some_and(|(_, token)| token == ",") {
                        at += 1;
                    }
                }
                at += 1;
                if tokens.get(at).is_some_and(|(_, token)| token == ";") {
                    at += 1;
                }
                return at;
            }
            "," | "}" | ";" => break,
            "::" => {}
            "as" => {
                name = tokens.get(at + 1).map(|(_, token)| token.clone());
                at += 1;
            }
            _ => path.push(token.clone()),
        }
        at += 1;
    }
    if path.last().is_some_and(|last| last == "self" || last == "*") && path.len() > 1 {
        path.pop();
    }
    let name = name.or_else(|| path.last().cloned()).unwrap_or_default();
    found.push((path, name));
    at + usize::from(tokens.get(at).is_some_and(|(_, token)| token == ";"))
}
