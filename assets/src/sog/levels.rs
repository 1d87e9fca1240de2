//! Reads one level of a streamed SOG.
//!
//! A `lod-meta.json` names several SOG scenes, and has a tree of boxes. A leaf has, for each level, a run of splats in
//! one of the scenes. Level 0 is the finest. The splats of `environment` belong to every level. Format:
//! <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog/>.

use super::meta::malformed;
use super::read;
use crate::error::{SceneError, wrong};
use crate::input::{Input, SceneHeader, Source, read_beside};
use crate::json;
use crate::scene::Scene;
use crate::size_breakdown::{ElementSize, SizeBreakdown};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::ops::{ControlFlow, Range};
use std::path::Path;

const NAME: &str = "lod-meta.json";

const MAX_JSON: u64 = 64 << 20;

/// The fields that a reader needs; others are ignored.
#[derive(Deserialize)]
struct Document {
    version: Option<u32>,
    #[serde(rename = "lodLevels")]
    levels: u32,
    environment: Option<String>,
    filenames: Vec<String>,
    tree: Node,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    #[serde(default)]
    lods: BTreeMap<u32, Run>,
}

#[derive(Clone, Copy, Deserialize)]
struct Run {
    file: usize,
    offset: u32,
    count: u32,
}

/// The runs of a level in a file, in ascending order; `None` for all splats of the file.
type Runs = Option<Vec<Range<u64>>>;

struct Level {
    level: u32,
    levels: u32,
    files: Vec<(String, Runs)>,
}

pub(super) fn begins_as_levels(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    text.trim_start().starts_with('{') && text.contains("\"lodLevels\"")
}

fn unexpected(field: &str, expected: String, found: impl std::fmt::Display) -> SceneError {
    wrong(format!("{NAME}: {field}"), format!("expected {expected}, found {found}"))
}

impl Node {
    /// Collects the runs of a level in the node and below it. A leaf without the level adds none.
    fn collect(&self, level: u32, runs: &mut Vec<Run>) {
        runs.extend(self.lods.get(&level).filter(|run| run.count > 0));
        for child in &self.children {
            child.collect(level, runs);
        }
    }
}

impl Level {
    fn read(source: &Source, level: Option<u32>) -> Result<Self, SceneError> {
        let text = json::read(source, (0, source.length()), MAX_JSON, json::STREAMED_OBJECT);
        let text = text.map_err(|error| error.in_file(NAME))?;
        let document: Document = serde_json::from_slice(&text).map_err(|error| malformed(NAME, &error))?;
        if let Some(found) = document.version.filter(|version| *version != 1) {
            return Err(unexpected("version", "1".into(), found));
        }
        let (level, levels) = (level.unwrap_or(0), document.levels);
        if level >= levels {
            let most = levels.saturating_sub(1);
            return Err(unexpected(
                "lodLevels",
                format!("level 0, the finest, to {most}, the coarsest"),
                level,
            ));
        }
        let mut runs = Vec::new();
        document.tree.collect(level, &mut runs);
        // Grouped by path, not by index, so that a file that the document names twice is read once.
        let mut by_file: BTreeMap<&Path, Vec<Range<u64>>> = BTreeMap::new();
        for Run { file, offset, count } in runs {
            let Some(name) = document.filenames.get(file) else {
                let most = document.filenames.len();
                return Err(unexpected("tree.lods.file", format!("a number below {most}"), file));
            };
            let first = u64::from(offset);
            by_file.entry(Path::new(name)).or_default().push(first..first + u64::from(count));
        }
        let mut files = Vec::new();
        for (file, mut runs) in by_file {
            runs.sort_unstable_by_key(|run| run.start);
            if let Some(pair) = runs.windows(2).find(|pair| pair[1].start < pair[0].end) {
                let expected = format!("runs that do not overlap in {}", file.display());
                return Err(unexpected("tree.lods.offset", expected, pair[1].start));
            }
            files.push((file.to_string_lossy().into_owned(), Some(runs)));
        }
        files.extend(document.environment.map(|file| (file, None)));
        if files.is_empty() {
            return Err(unexpected("tree", format!("a leaf with splats in level {level}"), "none"));
        }
        Ok(Self { level, levels, files })
    }
}

pub(super) fn header(
    source: &Source,
    folder: Option<&Path>,
    level: Option<u32>,
) -> Result<SceneHeader, SceneError> {
    Ok(SceneHeader::joined(&headers(&Level::read(source, level)?, folder)?))
}

/// Returns the headers of the level's splats in each file. Fails if a run ends beyond its file's splats.
fn headers(level: &Level, folder: Option<&Path>) -> Result<Vec<SceneHeader>, SceneError> {
    let header = |(name, runs): &(String, Runs)| {
        let header = read_beside(folder, name, |source, path| read::header(source, path.parent()))?;
        let end = runs.iter().flatten().map(|run| run.end).max().unwrap_or(0);
        if end > header.count {
            let expected = format!("runs within the {} splats of {name}", header.count);
            return Err(unexpected("tree.lods", expected, format_args!("one that ends at {end}")));
        }
        let count =
            runs.as_ref().map_or(header.count, |runs| runs.iter().map(|run| run.end - run.start).sum());
        Ok(SceneHeader { count, ..header })
    };
    level.files.iter().map(header).collect()
}

/// Parses a level of a streamed scene; the finest if `level` is `None`.
pub(super) fn parse(input: &Input, folder: Option<&Path>, level: Option<u32>) -> Result<Scene, SceneError> {
    let level = Level::read(input.source, level)?;
    let headers = headers(&level, folder)?;
    SceneHeader::check_joined(&headers, 0, input.memory)?;
    let all = SceneHeader::joined(&headers);
    let (mut scenes, mut before) = (Vec::with_capacity(headers.len()), 0);
    let mut breakdown = empty(&level, input.source.length());
    for ((name, runs), SceneHeader { count, .. }) in level.files.iter().zip(headers) {
        // Converts a reader's progress to splats of the level.
        let tell = |done: u64, of: u64| -> ControlFlow<()> {
            let share = done as f64 / of.max(1) as f64;
            (input.progress)(before + (share * count as f64) as u64, all.count)
        };
        let scene = read_beside(folder, name, |source, path| {
            let input = Input::new(source, input.memory, &tell);
            read::parse(&input, path.parent(), runs.as_deref())
        })?;
        add(&mut breakdown, scene.size_breakdown());
        scenes.push(scene);
        before += count;
    }
    Ok(Scene::of_one_file(scenes)?.with_breakdown(breakdown))
}

fn empty(level: &Level, length: u64) -> SizeBreakdown {
    let Level { level, levels, .. } = level;
    let finest = if *level == 0 { ", the finest" } else { "" };
    let format = format!("sog, streamed, level {level}{finest}, of {levels}");
    SizeBreakdown::new(format, length, length, vec![ElementSize::new("splats", 0, Vec::new())])
}

fn add(all: &mut SizeBreakdown, part: &SizeBreakdown) {
    all.file_bytes += part.file_bytes;
    all.header_bytes += part.header_bytes;
    let (all, part) = (&mut all.elements[0], &part.elements[0]);
    all.rows += part.rows;
    all.bytes += part.bytes;
    for field in &part.fields {
        match all.fields.iter_mut().find(|known| known.name == field.name) {
            Some(known) => known.bytes += field.bytes,
            None => all.fields.push(field.clone()),
        }
    }
}
