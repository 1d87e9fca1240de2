//! Checks the documentation against the repository. Every path, link and anchor resolves. Quoted output, versions, the
//! fields of output files, and the tutorial's listings are those of the program and its files.

#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Checks the list of packed files. Cargo packs only files in the crate's folder, and so does maturin for the Python
/// package's source distribution.
#[test]
fn the_package_of_the_program_has_every_file_that_is_built_in() {
    let cargo = std::env::var_os("CARGO").unwrap_or("cargo".into());
    let listed = Command::new(cargo)
        .args(["package", "--list", "--allow-dirty", "--offline", "-p", "splatgraph"])
        .current_dir(root())
        .output()
        .expect("cargo starts");
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let listed = String::from_utf8(listed.stdout).expect("names");
    let listed: BTreeSet<&str> = listed.lines().collect();
    for (folder, packed) in
        [("pipelines", "pipelines"), ("shaders", "shaders"), ("examples/tutorial", "tutorial")]
    {
        let mut waiting = vec![(root().join(folder), packed.to_owned())];
        while let Some((folder, packed)) = waiting.pop() {
            for entry in fs::read_dir(folder).expect("a folder") {
                let entry = entry.expect("an entry");
                let name = format!("{packed}/{}", entry.file_name().to_string_lossy());
                match entry.path().is_dir() {
                    true => waiting.push((entry.path(), name)),
                    false => assert!(listed.contains(name.as_str()), "{name} is not packed"),
                }
            }
        }
    }
}

fn page_names() -> Vec<PathBuf> {
    let docs = fs::read_dir(root().join("docs")).expect("docs/ is there").map(|entry| {
        let entry = entry.expect("an entry");
        Path::new("docs").join(entry.file_name())
    });
    let mut pages: Vec<PathBuf> = docs.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    pages.extend(
        ["README.md", "CONTRIBUTING.md", "python/README.md", "editors/vscode/README.md"].map(PathBuf::from),
    );
    pages.sort();
    assert!(pages.len() > 10, "only {pages:?}");
    pages
}

fn pages() -> Vec<(PathBuf, String)> {
    page_names().into_iter().map(|page| (page.clone(), without_code_blocks(&read(&page)))).collect()
}

fn read(page: &Path) -> String {
    fs::read_to_string(root().join(page)).unwrap_or_else(|error| panic!("{}: {error}", page.display()))
}

fn without_code_blocks(text: &str) -> String {
    let mut fenced = false;
    let lines = text.lines().filter(|line| {
        let fence = line.trim_start().starts_with("```");
        fenced ^= fence;
        !fenced && !fence && !line.starts_with("    ")
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Returns the anchors that GitHub generates for a page's headings.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let slug = |heading: &str| {
        let words = heading.trim_start_matches('#').trim().to_lowercase();
        let kept = words.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(slug).collect()
}

#[test]
fn every_path_in_backticks_exists() {
    let folders = [
        "app",
        "assets",
        "backends",
        "docs",
        "editors",
        "examples",
        "framework",
        "pipelines",
        "python",
        "shaders",
        "tests",
    ];
    let is_path = |text: &str| {
        let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "/._-".contains(c));
        plain && text.split_once('/').is_some_and(|(first, _)| folders.contains(&first))
    };
    let (mut checked, mut missing) = (0, Vec::new());
    for (page, text) in pages() {
        // Odd pieces are between two backticks.
        for path in text.split('`').skip(1).step_by(2).filter(|text| is_path(text)) {
            checked += 1;
            if !root().join(path).exists() {
                missing.push(format!("{}: `{path}`", page.display()));
            }
        }
    }
    assert!(checked > 50, "only {checked} paths were found in the pages");
    assert!(missing.is_empty(), "these paths do not exist:\n{}", missing.join("\n"));
}

#[test]
fn every_relative_link_leads_to_a_file_and_every_anchor_to_a_heading() {
    let (mut checked, mut broken) = (0, Vec::new());
    for (page, text) in pages() {
        let links = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(link, _)| link);
        for link in links.filter(|link| !link.contains("://")) {
            checked += 1;
            let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match path {
                "" => page.clone(),
                path => page.parent().expect("a file is in a folder").join(path),
            };
            let whole = root().join(&target).exists()
                && (anchor.is_empty() || anchors(&without_code_blocks(&read(&target))).contains(anchor));
            if !whole {
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(checked > 50, "only {checked} links were found in the pages");
    assert!(broken.is_empty(), "these links lead nowhere:\n{}", broken.join("\n"));
}

/// Collects the commands that the pages quote: page, arguments, and the quoted output.
///
/// A quoted command is an indented block that begins with `$ splatgraph`. An argument `scenes/...` names a captured
/// scene in the folder `SPLATGRAPH_DATA`.
fn quoted_commands() -> Vec<(PathBuf, Vec<String>, Vec<String>)> {
    let mut found = Vec::new();
    for page in page_names() {
        let text = read(&page);
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            let Some(command) = line.strip_prefix("    $ splatgraph ") else { continue };
            let output = lines.by_ref().take_while(|line| line.starts_with("    "));
            let output = output.map(|line| line.strip_prefix("    ").unwrap_or(line).to_owned()).collect();
            found.push((page.clone(), command.split_whitespace().map(str::to_owned).collect(), output));
        }
    }
    found
}

#[test]
fn installations_use_the_tested_versions_of_the_dependencies() {
    let pages: String = page_names().iter().map(|page| read(page)).collect();
    let installations: Vec<&str> = pages.split("cargo install ").skip(1).collect();
    assert!(!installations.is_empty());
    for options in installations {
        assert!(
            options.starts_with("--locked "),
            "cargo install {}",
            options.lines().next().unwrap_or_default()
        );
    }
}

fn splatgraph(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_splatgraph");
    Command::new(program).args(arguments).current_dir(root()).output().expect("the program starts")
}

/// Replaces `scenes/...` with the path of the captured scene. Returns `None` if there is such an argument, and
/// `SPLATGRAPH_DATA` is not set or not UTF-8.
fn with_scenes(arguments: &[String]) -> Option<Vec<String>> {
    let resolve = |argument: &String| match argument.starts_with("scenes/") {
        true => Path::new(&std::env::var_os("SPLATGRAPH_DATA")?)
            .join(argument)
            .into_os_string()
            .into_string()
            .ok(),
        false => Some(argument.clone()),
    };
    arguments.iter().map(resolve).collect()
}

/// Returns true if `output` contains the quoted lines one after another. A quoted `...` matches any number of lines.
fn is_quoted_from(output: &str, quoted: &[String]) -> bool {
    let output: Vec<&str> = output.lines().map(str::trim_end).collect();
    let mut rest = output.as_slice();
    for run in quoted.split(|line| line.trim() == "...").filter(|run| !run.is_empty()) {
        let Some(at) = rest.windows(run.len()).position(|window| window == run) else { return false };
        rest = &rest[at + run.len()..];
    }
    true
}

#[test]
fn quoted_output_is_what_the_commands_print() {
    let commands = quoted_commands();
    assert!(!commands.is_empty(), "no page quotes a command's output");
    let mut wrong = Vec::new();
    for (page, arguments, quoted) in commands {
        let Some(arguments) = with_scenes(&arguments) else {
            // Not println!, whose output is hidden in tests that pass.
            let _ = writeln!(
                std::io::stderr(),
                "NOT RUN: {} of {} needs captured scenes; set SPLATGRAPH_DATA",
                arguments.join(" "),
                page.display()
            );
            continue;
        };
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let output = splatgraph(&arguments);
        assert!(!quoted.is_empty(), "{}: nothing is quoted of {arguments:?}", page.display());
        if !is_quoted_from(&String::from_utf8_lossy(&output.stdout), &quoted) {
            wrong.push(format!("{}: {}", page.display(), arguments.join(" ")));
        }
    }
    assert!(wrong.is_empty(), "these commands print something else:\n{}", wrong.join("\n"));
}

#[test]
fn a_quoted_line_that_the_output_lacks_is_found() {
    let output = "one\n  two\nthree\nfour\n";
    let quoted = |lines: &[&str]| lines.iter().map(|line| line.to_string()).collect::<Vec<_>>();
    assert!(is_quoted_from(output, &quoted(&["one", "...", "three", "four"])));
    assert!(!is_quoted_from(output, &quoted(&["one", "three"])), "a line between was left out");
    assert!(!is_quoted_from(output, &quoted(&["four", "...", "one"])), "another order");
}

/// The tables of a section of docs/output-files.md.
#[derive(Default)]
struct Fields {
    /// All names in backticks.
    names: BTreeSet<String>,
    /// Names of the first column, each also as `object.name`; true if a document must have the field.
    rows: BTreeMap<String, bool>,
    /// Fields whose own fields the table does not list: maps, and objects that are described elsewhere.
    opaque: BTreeSet<String>,
}

fn fields(section: &str) -> Fields {
    let mut found = Fields::default();
    fn paths(cell: &str) -> impl Iterator<Item = Vec<String>> {
        let names = |path: &str| {
            path.split(['.', '[', ']', ' ']).filter(|name| !name.is_empty()).map(str::to_owned).collect()
        };
        cell.split('`').skip(1).step_by(2).map(names)
    }
    for row in section.lines().filter(|line| line.starts_with("| ")) {
        let (first, contents) = row[2..].split_once(" | ").expect("two columns");
        let is_opaque = ["map", "as of", "cameras, as of"].iter().any(|start| contents.starts_with(start));
        let is_needed = !contents.contains("absent") && !contents.contains("empty");
        found.names.extend(paths(row).flatten());
        let mut last: Vec<String> = Vec::new();
        for (path, text) in paths(first).zip(first.split('`').skip(1).step_by(2)) {
            found.opaque.extend(path.last().filter(|_| is_opaque).cloned());
            // `.c` is another field of the last object.
            let object = if text.starts_with('.') { &last[..last.len() - 1] } else { &[][..] };
            let path = [object, &path].concat();
            let pairs = path.windows(2).map(|pair| pair.join("."));
            for name in pairs.chain(path.iter().cloned()) {
                *found.rows.entry(name).or_default() |= is_needed;
            }
            last = path;
        }
    }
    found
}

/// Collects the keys of all objects outside `opaque` fields, each also as `object.key`.
fn keys_of(value: &serde_json::Value, of: &str, opaque: &BTreeSet<String>, keys: &mut BTreeSet<String>) {
    for (key, value) in value.as_object().into_iter().flatten() {
        keys.extend([key.clone(), format!("{of}.{key}")]);
        if !opaque.contains(key) {
            keys_of(value, key, opaque, keys);
        }
    }
    value.as_array().into_iter().flatten().for_each(|element| keys_of(element, of, opaque, keys));
}

#[test]
fn the_fields_of_output_files_are_those_that_the_program_writes() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |line: &str| {
        let line = line.replace("QUICK", "SMALL --rounds 1 --frames 1");
        let line = line.replace("SMALL", "s.ply -c c.json#0 --size 32x24");
        let program = env!("CARGO_BIN_EXE_splatgraph");
        let run = Command::new(program).args(line.split(' ')).current_dir(folder.path()).output();
        let run = run.expect("the program starts");
        assert!(run.status.success(), "{line}: {}", String::from_utf8_lossy(&run.stderr));
    };
    run("synth demo --count 300 -o s.ply --cameras c.json");
    run("synth --photograph s.ply --dataset ds --views 9 --size 32x24");
    let page = read(Path::new("docs/output-files.md"));
    // Sections by the first word of their heading.
    let sections = page.split("\n## ").filter_map(|part| part.split_once([' ', ',', '\n']));
    let sections: BTreeMap<&str, Fields> = sections.map(|(name, text)| (name, fields(text))).collect();
    let shared = &sections["Shared"];
    let mut all = BTreeMap::<&str, BTreeSet<String>>::new();
    for (section, line, files) in [
        (
            "render",
            "render SMALL -p splat --repeat 4 --inspect keys@scatter -o a.png --json=r.json",
            "r.json",
        ),
        ("render", "render SMALL --backend reference -o b.png --json=x.json", "x.json"),
        ("evaluate", "evaluate s.ply -c ds --json=e.json", "e.json"),
        ("convert", "convert SMALL --price --json=p.json", "p.json"),
        ("convert", "convert s.ply o.spz --json=o.json", "o.json"),
        ("advise", "advise QUICK --psnr 20 --json=v.json", "v.json"),
        ("popping", "popping s.ply -p splat --frames 2 --json=q.json -o .", "q.json popping.csv"),
        ("trade", "trade QUICK --only defaults -o t", "t/ledger.json t/ledger.csv"),
        ("sweep", "sweep QUICK --steps 2 -o w", "w/sweep.json w/sweep.csv"),
        ("bench", "bench QUICK --json=f.json -o f", "f.json f/bench.csv"),
        (
            "bench",
            "bench --suite sort --pairs 99 --rounds 1 --frames 1 --json=s.json -o s",
            "s.json s/bench.csv",
        ),
        ("compare", "compare a.png b.png --json=m.json", "m.json"),
        ("info", "info s.ply --json=i.json", "i.json"),
        ("devices", "devices --json=d.json", "d.json"),
        ("devices", "check splat --json=h.json", "h.json"),
        ("devices", "params splat --json=n.json", "n.json"),
        ("film.json", "video s.ply -c c.json --seconds 0.1 --size 32x24 -o film", "film/film.json"),
        ("film.json", "render SMALL -o job/ --shard 0/1", "job/job.json"),
    ] {
        run(line);
        let own = &sections[section];
        let is_opaque = |name: &&String| own.opaque.contains(*name) || !own.rows.contains_key(*name);
        let opaque = shared.opaque.union(&own.opaque).filter(is_opaque).cloned().collect();
        let is_listed = |name: &str| own.names.contains(name) || shared.names.contains(name);
        let column = |name: &str| match name.strip_suffix("_spread_ms").or(name.strip_suffix("_ms")) {
            Some(phase) if !is_listed(name) => name.replacen(phase, "PHASE", 1),
            _ => name.to_owned(),
        };
        let keys = all.entry(section).or_default();
        for file in files.split(' ') {
            let text = fs::read_to_string(folder.path().join(file)).expect(file);
            match serde_json::from_str(&text) {
                Ok(json) => keys_of(&json, "", &opaque, keys),
                Err(_) => keys.extend(text.lines().next().expect(file).split(',').map(column)),
            }
        }
        let unknown: Vec<_> = keys.iter().filter(|key| !key.contains('.') && !is_listed(key)).collect();
        assert!(unknown.is_empty(), "docs/output-files.md, {section}: {line} also writes {unknown:?}");
    }
    all.insert("Shared", all.values().flatten().cloned().collect());
    for (section, keys) in &all {
        let rows = sections[section].rows.iter();
        let unwritten: Vec<_> = rows.filter(|(name, needed)| **needed && !keys.contains(*name)).collect();
        assert!(unwritten.is_empty(), "docs/output-files.md, {section}: nothing writes {unwritten:?}");
    }
}

/// Collects a page's listings: code blocks below a line that ends with a link to a file and a colon. Returns the link
/// and the text of each.
fn listings(text: &str) -> Vec<(String, String)> {
    let (mut found, mut link, mut open): (Vec<(String, String)>, Option<String>, bool) = Default::default();
    for line in text.lines() {
        if line.starts_with("```") {
            open = !open && link.is_some();
            if let Some(link) = link.take().filter(|_| open) {
                found.push((link, String::new()));
            }
        } else if open && let Some((_, listing)) = found.last_mut() {
            *listing += &format!("{line}\n");
        } else if !line.trim().is_empty() {
            let target = line.rsplit_once("](").and_then(|(_, rest)| rest.split_once(')'));
            link = target.filter(|(_, behind)| *behind == ":").map(|(target, _)| target.to_owned());
        }
    }
    found
}

#[test]
fn the_listings_of_the_tutorial_are_its_files_and_every_file_is_listed() {
    let folder = Path::new("examples/tutorial");
    let text = read(Path::new("docs/tutorial.md"));
    let mut listed = BTreeSet::new();
    for (link, listing) in listings(&text) {
        let name = link.rsplit('/').next().unwrap_or_default();
        let file = read(&Path::new("docs").join(&link));
        // The listing is the whole file, or consecutive whole lines of it.
        let lines = format!("\n{file}").contains(&format!("\n{listing}"));
        assert!(lines && !listing.trim().is_empty(), "{name} has no such lines:\n{listing}");
        listed.insert(name.to_owned());
    }
    let files = fs::read_dir(root().join(folder)).expect("the tutorial's files");
    for file in files {
        let name = file.expect("an entry").file_name().to_string_lossy().into_owned();
        assert!(listed.contains(&name), "{name} is not listed in docs/tutorial.md");
    }
    assert_eq!(
        listings("[a.ron](x/a.ron):\n\n```ron\none\n```\n\nText\n\n```sh\nls\n```\n"),
        [("x/a.ron".into(), "one\n".into())]
    );
}

#[test]
fn the_pictures_of_the_tutorial_are_small_and_all_shown() {
    let text = read(Path::new("docs/tutorial.md"));
    let pictures = fs::read_dir(root().join("docs/images/tutorial")).expect("the pictures");
    let mut bytes = 0;
    for picture in pictures {
        let picture = picture.expect("an entry");
        bytes += picture.metadata().expect("a file").len();
        let name = picture.file_name().to_string_lossy().into_owned();
        assert!(text.contains(&format!("](images/tutorial/{name})")), "{name} is not shown");
    }
    assert!(bytes > 0 && bytes < 300_000, "{bytes} bytes");
}
