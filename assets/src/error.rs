//! What can be wrong with a scene file, in sentences that say what was expected, what was found, and where.

use std::path::PathBuf;

/// A scene file that could not be loaded.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct LoadError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: SceneError,
}

/// What is wrong with the bytes of a scene. Lines are counted from 1, over the whole file.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The system would not open, map or read the file.
    #[error("cannot be read: {0}")]
    Io(#[from] std::io::Error),

    /// The file has no bytes.
    #[error("the file is empty; expected a PLY file")]
    Empty,

    /// The first line is not `ply`.
    #[error("not a PLY file: expected a first line `ply`, found {found}")]
    NotPly {
        /// What the file seems to be.
        found: String,
    },

    /// A splat format that is recognised, and not read.
    #[error("this is {format}, a format that is not read yet; {advice}")]
    Unsupported {
        /// The format's name, with its article.
        format: &'static str,
        /// What to do instead.
        advice: &'static str,
    },

    /// A header line that does not parse.
    #[error("line {line} of the header: {message}")]
    Header {
        /// The line's number.
        line: u32,
        /// What was expected, and what was found.
        message: String,
    },

    /// The file ends before `end_header`.
    #[error("the header has no `end_header` line: the file ends inside it, after line {line}")]
    HeaderUnfinished {
        /// The last line's number.
        line: u32,
    },

    /// No `end_header` within the limit.
    #[error("the header is too long: no `end_header` line in the first {limit} bytes")]
    HeaderTooLong {
        /// Bytes that a header may have.
        limit: usize,
    },

    /// No element named `vertex`.
    #[error("the header has no `element vertex`, which holds the splats{}", found_elements(.found))]
    NoVertexElement {
        /// The names of the elements that there are.
        found: Vec<String>,
    },

    /// A property that every splat needs is not there.
    #[error("`element vertex` (line {line}) has no property `{name}`{}{}", nearest_text(.nearest), hint_text(.hint))]
    MissingProperty {
        /// The property.
        name: String,
        /// The line of `element vertex`.
        line: u32,
        /// The property whose name is nearest to it, if one is near.
        nearest: Option<String>,
        /// What the file may be instead.
        hint: Option<&'static str>,
    },

    /// A number of `f_rest_*` that belongs to no degree.
    #[error(
        "`element vertex` (line {line}) has {found} properties f_rest_*, where spherical harmonics of degree 0, 1, 2 or 3 \
         have 0, 9, 24 or 45"
    )]
    RestCount {
        /// How many there are.
        found: usize,
        /// The line of `element vertex`.
        line: u32,
    },

    /// `element vertex 0`.
    #[error("the scene has no splats: `element vertex 0` (line {line})")]
    NoSplats {
        /// The line of `element vertex`.
        line: u32,
    },

    /// Every splat was dropped.
    #[error("none of the {count} splats can be drawn: {reasons}")]
    AllDropped {
        /// How many the file has.
        count: u64,
        /// The counts per reason, in words.
        reasons: String,
    },

    /// The file ends inside the splats.
    #[error(
        "the file is truncated: the header promises {promised} splats (line {line}), the file ends after {there} of them"
    )]
    Truncated {
        /// Whole splats in the file.
        there: u64,
        /// Splats that the header promises.
        promised: u64,
        /// The line of `element vertex`.
        line: u32,
    },

    /// The file ends inside another element.
    #[error(
        "the file is truncated: it ends inside `element {element}` (line {line}), after {there} of {promised} rows"
    )]
    TruncatedElement {
        /// The element's name.
        element: String,
        /// Whole rows in the file.
        there: u64,
        /// Rows that the header promises.
        promised: u64,
        /// The line of the element.
        line: u32,
    },

    /// A count that cannot be true.
    #[error(
        "the header is damaged: `element {element}` (line {line}) promises {promised} rows, but only {available} bytes follow \
         the header"
    )]
    AbsurdCount {
        /// The element's name.
        element: String,
        /// Rows that the header promises.
        promised: u64,
        /// Bytes after the header.
        available: u64,
        /// The line of the element.
        line: u32,
    },

    /// More splats than a 32-bit index can name.
    #[error("the scene has {count} splats; at most 4,294,967,295 can be indexed")]
    TooMany {
        /// How many the file has.
        count: u64,
    },

    /// A row of an ASCII file that does not parse.
    #[error("line {line}: {message}")]
    Row {
        /// The line's number.
        line: u64,
        /// What was expected, and what was found.
        message: String,
    },
}

fn nearest_text(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|n| format!("; the nearest name there is `{n}`")).unwrap_or_default()
}

fn hint_text(hint: &Option<&'static str>) -> String {
    hint.map(|h| format!(" ({h})")).unwrap_or_default()
}

fn found_elements(found: &[String]) -> String {
    if found.is_empty() { String::new() } else { format!("; it has {}", found.join(", ")) }
}

/// The candidate nearest to `name` by edit distance, if one is near enough to be what was meant.
pub(crate) fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::damerau_levenshtein(name, candidate), candidate))
        .filter(|(distance, _)| *distance <= (name.len() / 3).max(1))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}
