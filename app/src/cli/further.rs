//! Further scenes in the picture of the first, for the commands that draw pictures and films.

use super::look_at::point;
use super::options;
use super::outcome::Usage;
use crate::io::output::OutputGuard;
use anyhow::Result;
use splatgraph_assets::{Scene, Similarity};
use std::path::PathBuf;

/// Options of further scenes.
#[derive(Debug, clap::Args)]
pub struct FurtherArgs {
    /// Further scenes in the same picture; one sort orders the splats of all. To turn or scale them, write a scene file (.ron)
    #[arg(value_name = "SCENE")]
    more: Vec<PathBuf>,
    /// Move a further scene; the first --at is for the first of them, the second for the second
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    at: Vec<[f64; 3]>,
}

impl FurtherArgs {
    /// Checks the numbers of options, and adds the scenes to the inputs.
    pub fn claim(&self, guard: &mut OutputGuard) -> Result<(), Usage> {
        let (places, scenes) = (self.at.len(), self.more.len());
        if places > scenes {
            return Err(Usage(format!(
                "expected at most one --at for each scene after the first, found {places} for {scenes}"
            )));
        }
        self.more.iter().try_for_each(|path| Ok(guard.input("a further scene", path)?))
    }

    /// Loads the further scenes, moves them, and joins all.
    ///
    /// # Errors
    /// A scene cannot be loaded, or all of them do not fit in memory.
    pub fn join(&self, first: Scene) -> Result<Scene> {
        if self.more.is_empty() {
            return Ok(first);
        }
        let mut all = vec![first];
        for (index, path) in self.more.iter().enumerate() {
            let scene = options::load_scene(path)?;
            all.push(match self.at.get(index) {
                Some(at) => {
                    scene.transformed(&Similarity { translation: (*at).into(), ..Similarity::IDENTITY })?
                }
                None => scene,
            });
        }
        Ok(Scene::joined(&all)?)
    }
}
