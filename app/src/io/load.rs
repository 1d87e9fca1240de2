//! Loads scenes, at a level of detail, and with or without the tags of their files.

use splatgraph_assets::{Content, LoadError, Progress, Scene, SceneHeader};
use std::path::Path;

/// Options of loading scenes.
///
/// They may come before or after the name of a command.
#[derive(Clone, Copy, Debug, Default, PartialEq, clap::Args)]
pub struct LoadOptions {
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
}

impl LoadOptions {
    /// Reads the header of a scene file.
    ///
    /// # Errors
    /// See [`SceneHeader::load_level`].
    pub fn header(&self, path: &Path) -> Result<SceneHeader, LoadError> {
        SceneHeader::load_level(path, self.level)
    }

    /// Loads a scene.
    ///
    /// # Errors
    /// See [`Scene::load_level`].
    pub fn scene(&self, path: &Path, progress: Progress) -> Result<Scene, LoadError> {
        Ok(self.tagged(Scene::load_level(path, self.level, progress)?))
    }

    /// Loads a scene, or a mesh that is drawn together with one.
    ///
    /// # Errors
    /// See [`Scene::load_any`].
    pub fn any(&self, path: &Path, progress: Progress) -> Result<Content, LoadError> {
        Ok(match Scene::load_any(path, self.level, progress)? {
            Content::Splats(scene) => Content::Splats(self.tagged(*scene).into()),
            mesh => mesh,
        })
    }

    fn tagged(&self, scene: Scene) -> Scene {
        if self.ignore_tags { scene.without_tags() } else { scene }
    }
}
