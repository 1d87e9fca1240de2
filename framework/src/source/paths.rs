//! Handles paths as texts, with `/` between components.

use std::fs;
use std::path::Path;

/// Simplifies `.` and `..` in a path for messages, unless that would lead to another file.
pub(super) fn displayed(path: &Path) -> String {
    let plain = slashed(path);
    let short = normalised(&plain);
    // After a link to a folder, `..` is not the previous component of the path.
    match (fs::canonicalize(path), fs::canonicalize(&short)) {
        (Ok(a), Ok(b)) if a != b => plain,
        _ => short,
    }
}

/// Returns the text of a path, with `/` between components also on Windows, which accepts it.
pub(super) fn slashed(path: &Path) -> String {
    let text = path.to_string_lossy();
    if cfg!(windows) { text.replace('\\', "/") } else { text.into_owned() }
}

/// Returns the length of a path's root: `/`, or on Windows also `C:/` and `//`; 0 for a relative path.
fn root_length(path: &str) -> usize {
    match path.as_bytes() {
        [b'/', b'/', ..] if cfg!(windows) => 2,
        [b'/', ..] => 1,
        [_, b':', b'/', ..] if cfg!(windows) => 3,
        _ => 0,
    }
}

/// Removes `.`, inner `..` and doubled slashes from a path, as text. A leading `..` of a relative path stays.
pub(super) fn normalised(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    let (root, rest) = path.split_at(root_length(path));
    for part in rest.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => {
                parts.pop();
            }
            ".." if !root.is_empty() => {}
            _ => parts.push(part),
        }
    }
    format!("{root}{}", parts.join("/"))
}

pub(super) fn joined(folder: &str, name: &str) -> String {
    if root_length(name) > 0 { normalised(name) } else { normalised(&appended(folder, name)) }
}

pub(super) fn appended(folder: &str, name: &str) -> String {
    match folder {
        "" => name.to_string(),
        _ if folder.ends_with('/') => format!("{folder}{name}"),
        _ => format!("{folder}/{name}"),
    }
}

pub(super) fn parent(path: &str) -> &str {
    path.rfind('/').map_or("", |slash| &path[..slash.max(root_length(path))])
}

/// Splits a folder before its last component called `pipelines` or `shaders`; `None` if it has none.
pub(super) fn root_and_rest(folder: &str) -> Option<(&str, &str)> {
    let mut end = folder.len();
    loop {
        let start = folder[..end].rfind('/').map_or(0, |slash| slash + 1);
        if matches!(&folder[start..end], "pipelines" | "shaders") {
            return Some(folder.split_at(start));
        }
        end = start.checked_sub(1)?;
    }
}
