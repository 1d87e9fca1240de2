//! Implements sets of a scene's splats, which the viewer selects and hides, and selection files.
//!
//! A selection file is JSON: the number of the scene's splats and a hash of them, to detect files of another scene, and
//! the indices. `convert --keep` and `--remove` read it.

use crate::io::named_file;
use crate::io::report::text;
use serde::{Deserialize, Serialize};
use splatgraph_assets::{Mesh, Scene, file};
use splatgraph_reference::{Gaussian, Splats};
use std::io::Read as _;
use std::path::Path;

/// A set of splats, by their indices in the scene.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SplatSet {
    /// One bit per splat. The last word is never zero, so that equal sets have equal words.
    words: Vec<u64>,
}

/// Example of a selection file, for errors.
const FORM: &str =
    "a selection such as {\"splats\": 1000, \"indices\": [0, 7]}, with the scene's number of splats";

/// Number of bytes at the start of a file in which a selection is recognised.
const HEAD_BYTES: u64 = 4096;
/// Maximum size of a selection file without its indices, in bytes.
const MAX_FRAME_BYTES: u64 = 1 << 20;
/// Maximum size of an index in a selection file, with the comma and the indentation, in bytes.
const MAX_INDEX_BYTES: u64 = 32;

/// JSON contents of a selection file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SelectionFile {
    splats: u32,
    /// Hash of the scene's splats ([`Scene::identity`]), as hexadecimal digits. Earlier versions did not write it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scene: Option<String>,
    indices: Vec<u32>,
}

impl SplatSet {
    /// Creates the set of the first `count` splats.
    pub fn first(count: u32) -> SplatSet {
        let mut words = vec![u64::MAX; count as usize / 64];
        if !count.is_multiple_of(64) {
            words.push((1 << (count % 64)) - 1);
        }
        SplatSet { words }
    }

    /// Returns true if the set contains the splat.
    pub fn contains(&self, index: u32) -> bool {
        self.words.get(index as usize / 64).is_some_and(|word| word >> (index % 64) & 1 == 1)
    }

    /// Returns the number of splats in the set.
    pub fn len(&self) -> u32 {
        self.words.iter().map(|word| word.count_ones()).sum()
    }

    /// Returns true if the set is empty.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// Returns the number of splats that a scene needs to contain the set: the largest index plus 1. 0 for an empty
    /// set.
    pub fn end(&self) -> u32 {
        let last = self.words.last().map_or(0, |word| 64 - word.leading_zeros());
        self.words.len().saturating_sub(1) as u32 * 64 + last
    }

    /// Returns the indices, ascending.
    pub fn indices(&self) -> Vec<u32> {
        (0..self.end()).filter(|index| self.contains(*index)).collect()
    }

    /// Returns the union of two sets.
    pub fn with(&self, other: &SplatSet) -> SplatSet {
        let word = |set: &SplatSet, at: usize| set.words.get(at).copied().unwrap_or(0);
        let count = self.words.len().max(other.words.len());
        SplatSet { words: (0..count).map(|at| word(self, at) | word(other, at)).collect() }
    }

    /// Returns the splats of this set that are not in `other`.
    pub fn without(&self, other: &SplatSet) -> SplatSet {
        let others = other.words.iter().copied().chain(std::iter::repeat(0));
        let mut words: Vec<u64> = self.words.iter().zip(others).map(|(own, other)| own & !other).collect();
        while words.last() == Some(&0) {
            words.pop();
        }
        SplatSet { words }
    }

    /// Formats the set as the text of a selection file of a scene.
    ///
    /// # Errors
    /// See [`serde_json::to_string`]; numbers cause no error.
    pub fn to_json(&self, scene: &Scene) -> serde_json::Result<String> {
        let (splats, identity) = (scene.count(), text::hex(scene.identity()));
        serde_json::to_string(&SelectionFile { splats, scene: Some(identity), indices: self.indices() })
    }

    /// Returns true if a file begins like a selection: with an object that has the key `indices`.
    pub fn begins_in(path: &Path) -> bool {
        let mut head = Vec::new();
        let read = file::open(path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
        let head = String::from_utf8_lossy(&head);
        read.is_ok() && head.trim_start().starts_with('{') && head.contains("\"indices\"")
    }

    /// Reads a selection file of a scene.
    ///
    /// # Errors
    /// The file cannot be read, is no selection file or too large for one, is of another scene, or lists a splat that
    /// the scene lacks.
    pub fn read(path: &Path, scene: &Scene) -> Result<SplatSet, String> {
        let count = scene.count();
        let of_file = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let limit = MAX_FRAME_BYTES + MAX_INDEX_BYTES * u64::from(count);
        let bytes = named_file::read(path, limit).map_err(|error| of_file(&error))?;
        let file: SelectionFile = serde_json::from_slice(&bytes)
            .map_err(|error| of_file(&format!("expected {FORM}, found {error}")))?;
        let (splats, own) = (file.splats, text::hex(scene.identity()));
        if splats != count {
            return Err(of_file(&format!("expected a selection of {count} splats, found one of {splats}")));
        }
        if let Some(other) = file.scene.filter(|other| *other != own) {
            return Err(of_file(&format!(
                "expected a selection of the scene {own}, found one of {other}: the scene changed after the selection \
                 was saved, or is another; if its splats are in the same order, remove \"scene\" from the selection"
            )));
        }
        match file.indices.iter().find(|index| **index >= count) {
            Some(index) => Err(of_file(&format!("indices: expected numbers below {count}, found {index}"))),
            None => Ok(file.indices.into_iter().collect()),
        }
    }
}

impl FromIterator<u32> for SplatSet {
    fn from_iter<I: IntoIterator<Item = u32>>(indices: I) -> SplatSet {
        let mut words = Vec::new();
        for index in indices {
            let at = index as usize / 64;
            if words.len() <= at {
                words.resize(at + 1, 0);
            }
            words[at] |= 1 << (index % 64);
        }
        SplatSet { words }
    }
}

static NONE: SplatSet = SplatSet { words: Vec::new() };

/// A scene without its hidden splats. They keep their indices, but count as splats with opacity 0.
pub struct Masked<'a> {
    /// Scene with all splats.
    pub scene: &'a Scene,
    /// Splats to leave out.
    pub hidden: &'a SplatSet,
}

impl<'a> Masked<'a> {
    /// Returns the scene with no splat hidden.
    pub fn whole(scene: &'a Scene) -> Masked<'a> {
        Masked { scene, hidden: &NONE }
    }
}

impl Splats for Masked<'_> {
    fn count(&self) -> usize {
        Splats::count(self.scene)
    }

    fn get(&self, index: usize) -> Gaussian {
        let splat = self.scene.get(index);
        if self.hidden.contains(index as u32) { Gaussian { opacity: 0.0, ..splat } } else { splat }
    }

    fn is_wide(&self) -> bool {
        self.scene.is_wide()
    }

    fn mesh(&self) -> Option<&Mesh> {
        self.scene.mesh()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;
    use std::fs;

    fn set(indices: &[u32]) -> SplatSet {
        indices.iter().copied().collect()
    }

    #[test]
    fn sets_are_joined_and_subtracted() {
        let (a, b) = (set(&[1, 63, 64, 200]), set(&[64, 2, 200]));
        assert_eq!(a.indices(), [1, 63, 64, 200]);
        assert_eq!((a.len(), a.end(), a.contains(63), a.contains(65)), (4, 201, true, false));
        assert_eq!(a.with(&b), set(&[1, 2, 63, 64, 200]));
        assert_eq!(b.with(&a), a.with(&b));
        assert_eq!(a.without(&b), set(&[63, 1]));
        assert_eq!(a.without(&a), SplatSet::default());
        assert_eq!((SplatSet::default().len(), SplatSet::default().end()), (0, 0));
        for count in [0, 1, 63, 64, 65, 130] {
            let all = SplatSet::first(count);
            assert_eq!((all.len(), all.end(), all.contains(count)), (count, count, false));
            assert_eq!(all, (0..count).collect());
        }
    }

    #[test]
    fn a_file_of_a_set_belongs_to_its_scene_or_without_a_hash_to_scenes_with_as_many_splats() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("selection.json");
        let [scene, other] = [0, 1].map(|seed| synth::generate("uniform", 100, seed).unwrap());
        let read = |text: &str| {
            fs::write(&path, text).unwrap();
            SplatSet::read(&path, &scene)
        };
        let some = set(&[99, 0, 7]);
        assert_eq!(read(&some.to_json(&scene).unwrap()), Ok(some.clone()));
        assert_eq!(read("{\"splats\":100,\"indices\":[99,0,7]}"), Ok(some.clone()));
        let [own, its] = [&scene, &other].map(|scene| text::hex(scene.identity()));
        let expected = format!("expected a selection of the scene {own}, found one of {its}: ");
        for (text, expected) in [
            (&*some.to_json(&other).unwrap(), &*expected),
            ("{\"splats\":101,\"indices\":[]}", "expected a selection of 100 splats, found one of 101"),
            ("{\"splats\":100,\"indices\":[3,100]}", "indices: expected numbers below 100, found 100"),
            ("{\"splats\":100,\"indices\":[-1]}", "line 1 column "),
            ("{\"splats\":100}", "missing field `indices`"),
            ("[]", "expected a selection such as {\"splats\": 1000, \"indices\": [0, 7]}"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(expected) && error.contains("selection.json: "), "{error}");
        }
        let long = read(&" ".repeat(2 << 20)).unwrap_err();
        assert!(
            long.contains("selection.json: expected a file of at most 1051776 bytes, found 2097152"),
            "{long}"
        );
        fs::remove_file(&path).unwrap();
        assert!(SplatSet::read(&path, &scene).unwrap_err().contains("selection.json: "));
    }
}
