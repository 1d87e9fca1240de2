//! The documentation against the repository: every path and every link in it leads somewhere.

#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The pages, by their path from the root, and their text without code blocks.
fn pages() -> Vec<(PathBuf, String)> {
    let docs = fs::read_dir(root().join("docs")).expect("docs/ is there").map(|entry| {
        let entry = entry.expect("an entry");
        Path::new("docs").join(entry.file_name())
    });
    let mut pages: Vec<PathBuf> = docs.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    pages.extend(["README.md", "CONTRIBUTING.md"].map(PathBuf::from));
    pages.sort();
    assert!(pages.len() > 10, "only {pages:?}");
    pages.into_iter().map(|page| (page.clone(), without_code_blocks(&read(&page)))).collect()
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

/// The anchors that GitHub gives to a page's headings.
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
    let folders =
        ["app", "assets", "backends", "docs", "examples", "framework", "pipelines", "shaders", "tests"];
    let is_path = |text: &str| {
        let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "/._-".contains(c));
        plain && text.split_once('/').is_some_and(|(first, _)| folders.contains(&first))
    };
    let (mut checked, mut missing) = (0, Vec::new());
    for (page, text) in pages() {
        // Every second piece stands between two backticks.
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

/// The listings of a page: the link in the line before each, and the text. Only those below a link to a file count.
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
        // A whole file, or whole lines of one.
        let lines = format!("\n{file}").contains(&format!("\n{listing}"));
        assert!(lines && !listing.trim().is_empty(), "{name} has no such lines:\n{listing}");
        listed.insert(name.to_owned());
    }
    let files = fs::read_dir(root().join(folder)).expect("the tutorial's files");
    for file in files {
        let name = file.expect("an entry").file_name().to_string_lossy().into_owned();
        assert!(listed.contains(&name), "{name} is not listed in docs/tutorial.md");
    }
    // What is said to be a listing is compared.
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
