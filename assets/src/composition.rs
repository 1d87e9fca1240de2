//! Reads files that place several scenes in one world (`.ron`).
//!
//! ```ron
//! Scenes([
//!   Scene(file: "garden.ply"),
//!   Scene(file: "statue.spz", scale: 0.5, rotate: (axis: (0, 1, 0), degrees: 90), translate: (1, 0, -2)),
//! ])
//! ```
//!
//! A scene is scaled first, then rotated about an axis through its origin, and then translated. Its harmonics rotate
//! with it. Paths are relative to the folder of this file. The splats of all scenes are joined into one scene, so that
//! a single sort orders them. A `Scene` can also name a mesh, but at least one must have splats.

use crate::error::SceneError;
use crate::scene::{Scene, ScenePart, sh_floats};
use crate::similarity::Similarity;
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use ron::error::{Error, SpannedError};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The byte order mark, which some editors write at the beginning of a text.
pub(crate) const BYTE_ORDER_MARK: &str = "\u{feff}";

pub(crate) const MAX_BYTES: u64 = 1 << 20;

#[derive(Deserialize)]
struct Scenes(Vec<Part>);

#[derive(Deserialize)]
#[serde(rename = "Scene", deny_unknown_fields)]
struct Part {
    file: PathBuf,
    #[serde(default = "one")]
    scale: f64,
    #[serde(default)]
    rotate: Rotation,
    #[serde(default)]
    translate: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rotation {
    axis: [f64; 3],
    degrees: f64,
}

impl Default for Rotation {
    fn default() -> Self {
        Self { axis: [0.0, 1.0, 0.0], degrees: 0.0 }
    }
}

fn one() -> f64 {
    1.0
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Placed {
    pub file: PathBuf,
    /// Transform from the scene's coordinates to the world's.
    pub by: Similarity,
    /// Line and column of the part's key `file` in the list, from 1.
    pub at: (usize, usize),
}

/// Returns true for a composition: its text begins with `Scenes`, after blanks and comments.
pub(crate) fn begins_as_scenes(head: &[u8]) -> bool {
    let mut rest = head.strip_prefix(BYTE_ORDER_MARK.as_bytes()).unwrap_or(head).trim_ascii_start();
    while let Some(length) = comment(rest) {
        rest = rest[length..].trim_ascii_start();
    }
    rest.starts_with(b"Scenes")
}

/// Returns the length of the comment with which a text begins, or of the whole text if the comment does not end. `None`
/// without a comment. Block comments nest.
fn comment(text: &[u8]) -> Option<usize> {
    if text.starts_with(b"//") {
        return Some(text.iter().position(|byte| *byte == b'\n').map_or(text.len(), |at| at + 1));
    }
    let (mut depth, mut rest) = (0, text);
    loop {
        (depth, rest) = match rest {
            [b'/', b'*', rest @ ..] => (depth + 1, rest),
            _ if depth == 0 => break,
            [b'*', b'/', rest @ ..] => (depth - 1, rest),
            [_, rest @ ..] => (depth, rest),
            [] => break,
        }
    }
    Some(text.len() - rest.len()).filter(|length| *length > 0)
}

/// Returns the length of the raw string with which a text begins, such as `r#"a"#`; `None` without one.
fn raw_string(text: &str) -> Option<usize> {
    let after = text.strip_prefix('r')?;
    let inner = after.trim_start_matches('#').strip_prefix('"')?;
    let begin = text.len() - inner.len();
    let end = format!("\"{}", "#".repeat(begin - 2));
    Some(inner.find(&end).map_or(text.len(), |at| begin + at + end.len()))
}

/// Parses the text of a file in `folder`. Fails for invalid text or numbers out of range, and if it names no scene.
pub(crate) fn parse(text: &str, folder: &Path) -> Result<Vec<Placed>, SceneError> {
    let text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
    let scenes: Scenes = ron::from_str(text).map_err(|error| SceneError::Invalid(told(text, &error)))?;
    if scenes.0.is_empty() {
        return Err(SceneError::Invalid("expected at least one scene, found none".into()));
    }
    // Each entry has one key `file`.
    let places = places_of(text, "file").into_iter().chain(std::iter::repeat((1, 1)));
    scenes.0.into_iter().zip(places).map(|(part, at)| placed(part, at, folder)).collect()
}

/// Fields of a scene, each with an example.
const FIELDS: [(&str, &str); 4] = [
    ("file", "\"a.ply\""),
    ("scale", "0.5"),
    ("rotate", "(axis: (0, 1, 0), degrees: 90)"),
    ("translate", "(1, 0, -2)"),
];

/// Describes an error in a list of scenes. For a wrong value, RON's text would not name the field.
fn told(text: &str, error: &SpannedError) -> String {
    let at = (error.span.start.line, error.span.start.col);
    let before = |field| places_of(text, field).into_iter().filter(|place| *place <= at).max();
    let last = FIELDS.iter().filter_map(|(field, example)| Some((before(field)?, field, example))).max();
    let message = match (&error.code, last) {
        (
            Error::ExpectedString
            | Error::ExpectedFloat
            | Error::ExpectedStructLike
            | Error::ExpectedNamedStructLike("Rotation")
            | Error::ExpectedDifferentLength { .. }
            | Error::SuggestRawIdentifier(_),
            Some((_, field, example)),
        ) => format!("expected for instance `{field}: {example}`"),
        (code, _) => code.to_string(),
    };
    format!("line {}, column {}: {message}", at.0, at.1)
}

/// Returns the line and column, from 1, of each occurrence of a word outside comments and strings.
fn places_of(text: &str, word: &str) -> Vec<(usize, usize)> {
    let mut places = Vec::new();
    let (mut line, mut column) = (1, 1);
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let in_word = |c: char| c.is_alphanumeric() || c == '_';
        let skipped = comment(rest.as_bytes()).or_else(|| raw_string(rest));
        let length = skipped.unwrap_or_else(|| match first {
            '"' => {
                let mut escaped = false;
                let end = rest[1..].find(|c| {
                    let ends = c == '"' && !escaped;
                    escaped = c == '\\' && !escaped;
                    ends
                });
                end.map_or(rest.len(), |at| at + 2)
            }
            _ if in_word(first) => rest.find(|c| !in_word(c)).unwrap_or(rest.len()),
            _ => first.len_utf8(),
        });
        let token;
        (token, rest) = rest.split_at(length);
        if token == word {
            places.push((line, column));
        }
        match token.rsplit_once('\n') {
            Some((before, last)) => {
                line += before.matches('\n').count() + 1;
                column = last.chars().count() + 1;
            }
            None => column += token.chars().count(),
        }
    }
    places
}

fn placed(part: Part, at: (usize, usize), folder: &Path) -> Result<Placed, SceneError> {
    let (line, column) = at;
    let wrong = |message: String| {
        let file = part.file.display();
        Err(SceneError::Invalid(format!("line {line}, column {column}: {file}: {message}")))
    };
    if !Similarity::SCALES.contains(&part.scale) {
        return wrong(format!("expected a scale of 1e-9 to 1e9, found {}", part.scale));
    }
    let Rotation { axis, degrees } = part.rotate;
    let Some(unit) = DVec3::from(axis).try_normalize().filter(|_| degrees.is_finite()) else {
        return wrong(format!("expected an axis and degrees, found {axis:?} and {degrees}"));
    };
    let rotation = DQuat::from_axis_angle(unit, degrees.to_radians());
    let translation = DVec3::from(part.translate);
    if !part.translate.iter().all(|v| v.abs() <= Similarity::FARTHEST) {
        return wrong(format!("expected a translation within 1e18, found {:?}", part.translate));
    }
    let by = Similarity { rotation, scale: part.scale, translation };
    Ok(Placed { file: folder.join(part.file), by, at })
}

impl Scene {
    /// Returns true if `own` in this scene has the same splats as `part` in `other`, wherever both are placed.
    ///
    /// Compares their number, opacities and colours of band 0, which a placement does not change.
    pub fn has_splats_of(&self, own: &ScenePart, other: &Self, part: &ScenePart) -> bool {
        /// Tolerance of a coefficient, relative to 1 plus its absolute value. In exact arithmetic, a rotation does not
        /// change band 0; the rotation matrix is rounded.
        const ROUNDING: f32 = 1e-4;
        if own.splats.len() != part.splats.len() {
            return false;
        }
        let of = |scene: &Self, part: &ScenePart, index: usize| {
            let at = part.splats.start as usize + index;
            let floats = sh_floats(scene.columns.degree);
            let color: [f32; 3] = std::array::from_fn(|channel| scene.columns.sh[at * floats + channel]);
            (scene.columns.opacity[at], color)
        };
        (0..own.splats.len()).into_par_iter().with_min_len(1 << 12).all(|index| {
            let ((opacity, color), (its_opacity, its_color)) = (of(self, own, index), of(other, part, index));
            opacity == its_opacity
                && color.iter().zip(its_color).all(|(a, b)| (a - b).abs() <= ROUNDING * (1.0 + b.abs()))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{says, splat};

    fn said(text: &str) -> String {
        parse(text, Path::new("/world")).unwrap_err().to_string()
    }

    #[test]
    fn files_are_beside_their_file_and_numbers_make_a_similarity() {
        let text = r#"// A comment.
            Scenes([
              Scene(file: "a.ply"),
              Scene(file: "/b.spz", scale: 0.5, rotate: (axis: (0, 2, 0), degrees: 90), translate: (1, 0, -2.5)),
            ])"#;
        assert!(begins_as_scenes(text.as_bytes()));
        let all = parse(text, Path::new("/world")).expect("scenes");
        let marked = format!("{BYTE_ORDER_MARK}{text}");
        assert!(begins_as_scenes(marked.as_bytes()));
        assert_eq!(parse(&marked, Path::new("/world")).expect("scenes"), all);
        assert_eq!(all[0], Placed { file: "/world/a.ply".into(), by: Similarity::IDENTITY, at: (3, 21) });
        assert_eq!((all[1].file.as_path(), all[1].by.scale), (Path::new("/b.spz"), 0.5));
        let turned = all[1].by.rotation * DVec3::Z;
        assert!(turned.distance(DVec3::X) < 1e-12 && all[1].by.translation == DVec3::new(1.0, 0.0, -2.5));
    }

    #[test]
    fn other_texts_are_not_scenes() {
        assert!(begins_as_scenes(b"\n /* a * / */ // b\nScenes("));
        let nested = "/* a /* Scenes */ b /**/ */ Scenes([Scene(file: \"a\")])";
        assert!(begins_as_scenes(nested.as_bytes()) && parse(nested, Path::new("")).is_ok());
        for text in ["", "Graph(", "// Scenes", "/* Scenes", "/* /* */ Scenes", "ply\n"] {
            assert!(!begins_as_scenes(text.as_bytes()), "{text}");
        }
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        assert!(said("Scenes([\n  Scene(fil: \"a.ply\"),\n])").starts_with("line 2, column "));
        let text = "Scenes([\n  // Scene(file: \"b.ply\"),\n  Scene(translate: (0, 0, 0), file: \"a\\\"file\"), \
                    /* file */ Scene(file: \"ä.ply\", scale: 0)])";
        says(said(text), "line 3, column 66: ä.ply: expected a scale");
        let text = "Scenes([/* /* \" */ \" */\n  \
                    Scene(file: r\"a\\\"), Scene(file: r#\"\"a\"#), Scene(file: \"b\", scale: 0)])";
        says(said(text), "line 2, column 51: b: expected a scale");
        says(said("Scenes([Scene(file: \"a\", rotate: (axis: (0, 0, 0), degrees: 9))])"), "expected an axis");
        says(said("Scenes([Scene(file: \"a\", translate: (1, 1e30, 0))])"), "within 1e18");
        says(said("Scenes([])"), "expected at least one scene");
        let rotate = "expected for instance `rotate: (axis: (0, 1, 0), degrees: 90)`";
        for (field, example) in [
            ("rotate: (0, 90, 0)", rotate),
            ("rotate: 90", rotate),
            ("rotate: (axis: \"y\", degrees: 90)", rotate),
            ("scale: (1, 1, 1)", "expected for instance `scale: 0.5`"),
            ("translate: [1, 0, 0]", "expected for instance `translate: (1, 0, -2)`"),
        ] {
            says(said(&format!("Scenes([Scene(file: \"a\", {field})])")), example);
        }
    }

    #[test]
    fn a_part_is_recognised_where_it_is_placed_and_another_is_not() {
        let both = || [(5, 1), (7, 3)].map(|(count, degree)| Scene::generate(count, degree, splat));
        let scene = Scene::joined(&both()).unwrap();
        let scene = scene.with_parts(vec![("a.ply".into(), 5), ("b.ply".into(), 7)]);
        assert_eq!(scene.parts()[1], ScenePart { file: "b.ply".into(), splats: 5..12 });

        let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.1);
        let by = Similarity { rotation, scale: 0.3, translation: DVec3::X };
        let [first, second] = both();
        let moved = second.transformed(&by).unwrap();
        let other = Scene::joined(&[moved, first]).unwrap();
        let other = other.with_parts(vec![("b.ply".into(), 7), ("a.ply".into(), 5)]);
        let [a, b] = scene.parts() else { panic!("two parts") };
        let [other_b, other_a] = other.parts() else { panic!("two parts") };
        assert!(scene.has_splats_of(a, &other, other_a) && other.has_splats_of(other_b, &scene, b));
        assert!(!scene.has_splats_of(a, &other, other_b));

        let shifted = Scene::generate(7, 3, |index| splat(index + 1)).with_parts(vec![("b.ply".into(), 7)]);
        assert!(!scene.has_splats_of(b, &shifted, &shifted.parts()[0]));
    }

    #[test]
    fn a_scene_with_another_number_of_splats_than_its_parts_has_none() {
        let scene = Scene::generate(5, 0, splat);
        assert_eq!(scene.with_parts(vec![("a.ply".into(), 6)]).parts(), []);
    }
}
