//! Loads scenes: at a level of detail, with or without the tags of their files, and only the splats of a condition.

use crate::io::condition::Condition;
use crate::io::losses;
use crate::io::output::say;
use splatgraph_assets::{Content, LoadError, Progress, ReadOptions, Scene, SceneHeader, grouped};
use std::path::Path;

/// Options of reading scene files.
///
/// They may come before or after the name of a command.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct FileOptions {
    /// Draw scenes by the published rules, regardless of the tags in their files
    ///
    /// Tags are the filter of the training, the order of the splats, and the direction up: see `splatgraph info`. --set
    /// overrides a single one.
    #[arg(long, global = true)]
    pub ignore_tags: bool,
    /// Level of a streamed SOG (lod-meta.json): 0 is the finest, and the default
    ///
    /// With several scenes, it applies to those with levels.
    #[arg(long, value_name = "N", global = true)]
    pub level: Option<u32>,
    /// Load further properties of a PLY file, for graphs that import scene.property.NAME, and for --where
    ///
    /// Separate several with commas, or repeat the option. `splatgraph info` lists the properties of a file. `convert`
    /// writes them to PLY files.
    #[arg(long = "property", value_name = "NAME", global = true, value_delimiter = ',')]
    pub properties: Vec<String>,
}

/// Options of loading scenes.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct LoadOptions {
    /// Options of reading the files.
    #[command(flatten)]
    pub file: FileOptions,
    /// Leave out the splats for which this expression is false, for instance 'opacity > 0.05 && x < 2'
    ///
    /// The names are those of `splatgraph convert --where`: x, y, z, opacity, scale_min, scale_max, red, green, blue,
    /// index, and the names of --property. Each scene file is loaded whole, and its splats are then left out before --at
    /// moves it. Outputs and selections count the splats that are left.
    #[arg(long = "where", value_name = "EXPRESSION", allow_hyphen_values = true)]
    pub condition: Option<Condition>,
}

impl From<FileOptions> for LoadOptions {
    fn from(file: FileOptions) -> LoadOptions {
        LoadOptions { file, condition: None }
    }
}

impl FileOptions {
    fn read(&self) -> ReadOptions<'_> {
        ReadOptions { level: self.level, properties: &self.properties }
    }

    /// Removes the tags of a scene's file, if they are to be ignored.
    pub fn tagged(&self, scene: Scene) -> Scene {
        if self.ignore_tags { scene.without_tags() } else { scene }
    }
}

impl LoadOptions {
    /// Reads the header of a scene file, which counts all of its splats.
    ///
    /// # Errors
    /// See [`SceneHeader::load_level`].
    pub fn header(&self, path: &Path) -> Result<SceneHeader, LoadError> {
        SceneHeader::load_level(path, self.file.level)
    }

    /// Loads a scene, and reports how many splats the condition leaves out.
    ///
    /// # Errors
    /// See [`Scene::load_with`] and [`Condition::kept`].
    pub fn scene(&self, path: &Path, progress: Progress) -> anyhow::Result<Scene> {
        self.kept(path, self.file.tagged(Scene::load_with(path, self.file.read(), progress)?))
    }

    /// Loads a scene with all its splats, or a mesh that is drawn together with one.
    ///
    /// # Errors
    /// See [`Scene::load_any`].
    pub fn any(&self, path: &Path, progress: Progress) -> Result<Content, LoadError> {
        Ok(match Scene::load_any(path, self.file.read(), progress)? {
            Content::Splats(scene) => Content::Splats(self.file.tagged(*scene).into()),
            mesh => mesh,
        })
    }

    /// Leaves out the splats that do not satisfy the condition, and reports their number.
    ///
    /// # Errors
    /// See [`Condition::kept`].
    pub fn kept(&self, path: &Path, scene: Scene) -> anyhow::Result<Scene> {
        let Some(condition) = &self.condition else { return Ok(scene) };
        let before = scene.count();
        let scene = condition.kept(scene)?;
        let (left_out, before) = (grouped((before - scene.count()).into()), losses::splats(before.into()));
        say(format!("{}: --where leaves out {left_out} of {before}", path.display()));
        Ok(scene)
    }

    /// Returns the words of a command line that give these options.
    pub fn words(&self) -> Vec<String> {
        let FileOptions { ignore_tags, level, properties } = &self.file;
        let ignore_tags = ignore_tags.then(|| vec!["--ignore-tags".to_owned()]);
        let level = level.map(|level| vec!["--level".to_owned(), level.to_string()]);
        let named = !properties.is_empty();
        let properties = named.then(|| vec!["--property".to_owned(), properties.join(",")]);
        let condition = self.condition.as_ref();
        let condition = condition.map(|condition| vec!["--where".to_owned(), condition.to_string()]);
        [ignore_tags, level, properties, condition].into_iter().flatten().flatten().collect()
    }
}
