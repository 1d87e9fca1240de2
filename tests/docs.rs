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
