//! Loads the scenes of a picture or a film: one, or several that are sorted together.

use super::loading;
use super::look_at::point;
use super::options;
use super::outcome::Usage;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Target, Wanted};
use crate::draw::session::Session;
use crate::draw::storage::StorageError;
use crate::io::load::LoadOptions;
use crate::io::losses;
use crate::io::output::{OutputGuard, say};
use anyhow::{Error, Result};
use splatgraph_api::DeviceInfo;
use splatgraph_assets::{Camera, Content, Scene, SceneHeader, Similarity};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Arguments that name scenes.
#[derive(Debug, clap::Args)]
pub struct ScenesArgs {
    #[arg(value_name = "SCENE", help = options::optional_scene_help())]
    pub scene: Option<PathBuf>,
    /// Further scenes in the same picture, sorted together, and meshes (.glb, .gltf). To rotate or scale them, write a
    /// scene file (.ron)
    #[arg(value_name = "SCENE")]
    more: Vec<PathBuf>,
    /// Move a further scene or mesh by this vector; the first --at is for the first further file, the second for the
    /// second
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    at: Vec<[f64; 3]>,
    #[command(flatten)]
    load: LoadOptions,
}

impl ScenesArgs {
    pub fn claim(&self, guard: &mut OutputGuard) -> Result<(), Usage> {
        if let Some(path) = &self.scene {
            guard.scene("the scene", path)?;
        }
        let (places, scenes) = (self.at.len(), self.more.len());
        if places > scenes {
            return Err(Usage(format!(
                "expected at most one --at for each scene after the first, found {places} for {scenes}"
            )));
        }
        self.more.iter().try_for_each(|path| Ok(guard.scene("a further scene", path)?))
    }

    /// Formats the note that each of several pictures shows all scenes, with `advice` for pictures of one scene; `None`
    /// for a single scene.
    pub fn note_superimposed(&self, advice: &str) -> Option<String> {
        let count = self.more.len() + 1;
        (count > 1).then(|| format!("{count} scenes are in each picture; {advice}"))
    }

    /// Returns the load options of one scene. If any scene has levels, `--level` applies only to scenes with levels.
    fn options_of(&self, path: Option<&Path>) -> LoadOptions {
        let has_levels = |path: Option<&Path>| path.is_some_and(SceneHeader::has_levels);
        let others = || self.more.iter().map(|path| Some(path.as_path())).chain([self.scene.as_deref()]);
        let mut load = self.load.clone();
        if load.file.level.is_some() && !has_levels(path) && others().any(has_levels) {
            load.file.level = None;
        }
        load
    }

    /// Rejects a first scene whose header shows that it is too large for the device.
    pub fn check_header(&self, device: &DeviceInfo, pipeline: &str, set: &[(String, String)]) -> Result<()> {
        let load = self.options_of(self.scene.as_deref());
        self.scene.iter().try_for_each(|path| fit::check_header(path, &load, device, pipeline, set))
    }

    /// Adds to an error about memory how many splats would fit, if exactly one scene is named. `session` draws the
    /// scene at this size; `limit` is that of `--memory`, in bytes.
    pub fn too_large(
        &self,
        error: StorageError,
        limit: Option<u64>,
        session: &mut Session,
        size: (u32, u32),
    ) -> Error {
        let Some(path) = self.scene.as_deref().filter(|_| self.more.is_empty()) else { return error.into() };
        let target = Target::now(session.device(), limit);
        let (graph, set) = session.graph();
        let (scene, catalog) = (SceneFacts::of(session.scene()), &facts::catalog(session.scene()));
        error.with_fit(&Wanted { graph, set, scene, catalog, size }, &target, path, &self.load)
    }

    /// Loads the scenes and meshes, moves all but the first by `--at`, and joins them. Also returns the demo scene's
    /// camera; `None` if a scene is named.
    ///
    /// # Errors
    /// A scene cannot be loaded, the joined scene does not fit in memory, or `cancel` became true.
    pub fn load(&self, cancel: &AtomicBool) -> Result<(Scene, Option<Camera>)> {
        let scene = self.scene.as_deref();
        let (first, _, camera) = loading::scene_or_demo(cancel, scene, &self.options_of(scene))?;
        if self.more.is_empty() {
            return Ok((first, camera));
        }
        let (mut all, mut meshes) = (vec![first], Vec::new());
        for (index, path) in self.more.iter().enumerate() {
            let at = self.at.get(index).map(|at| (*at).into());
            let by = at.map(|translation| Similarity { translation, ..Similarity::IDENTITY });
            let load = self.options_of(Some(path));
            match loading::load_any_unless(cancel, path, &load)? {
                Content::Splats(scene) => {
                    let scene = load.kept(path, *scene)?;
                    all.push(if let Some(by) = by { scene.transformed(&by)? } else { scene });
                }
                Content::Mesh(mesh) => meshes.push((mesh, by.unwrap_or(Similarity::IDENTITY))),
            }
        }
        let joined = match all.pop() {
            Some(only) if all.is_empty() => only,
            last => {
                all.extend(last);
                let joined = Scene::joined(&all)?;
                loading::tell_mixed_tags("all scenes", &joined);
                if joined.notes().mixed.up {
                    let mut ups: Vec<_> = all.iter().filter_map(|scene| scene.notes().up).collect();
                    ups.dedup();
                    let others = ups.len() == 1;
                    ups.into_iter().filter_map(|up| losses::lost_up(up, others)).for_each(say);
                }
                joined
            }
        };
        Ok((meshes.iter().fold(joined, |scene, (mesh, by)| scene.beside(mesh, by)), camera))
    }
}
