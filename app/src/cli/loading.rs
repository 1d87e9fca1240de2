//! Loads scenes and their cameras, and reports what is unusual about them.

use super::outcome;
use crate::draw::blind::{self, View};
use crate::draw::facts::{self, SceneFacts};
use crate::io::demo;
use crate::io::load::LoadOptions;
use crate::io::losses;
use crate::io::output::{self, names, say};
use crate::io::progress::Progress;
use crate::lsp;
use anyhow::{Context, Result, anyhow, bail, ensure};
use splatgraph_assets::{Camera, Content, LoadError, QUIET, Scene, SceneError, SceneFormat};
use splatgraph_framework::ir::Catalog;
use splatgraph_framework::source::nearest;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use tracing::info_span;

/// Cancel flag that is never set.
pub static NEVER: AtomicBool = AtomicBool::new(false);

/// Opens a device while another thread runs `load`, which loads the scene. Returns both results.
///
/// If `open` fails, the load is cancelled, and the error of the load is not reported. Drivers free memory when a thread
/// that called them ends, so the device is not opened on a thread that ends here.
pub fn open_and_load<D, L: Send>(
    open: impl FnOnce() -> Result<D>,
    load: impl FnOnce(&AtomicBool) -> Result<L> + Send,
) -> Result<(D, L)> {
    let cancel = AtomicBool::new(false);
    if rayon::current_thread_index().is_some() {
        // This thread is the pool (see `threads`), so it cannot wait for a load that needs the pool.
        return Ok((open()?, load(&cancel)?));
    }
    thread::scope(|scope| {
        let loading = thread::Builder::new()
            .name("scene".into())
            .spawn_scoped(scope, || load(&cancel))
            .context("no thread can be started to load the scene")?;
        let opened = open().inspect_err(|_| cancel.store(true, Ordering::Relaxed));
        let loaded = info_span!("wait for the scene").in_scope(|| loading.join());
        Ok((opened?, loaded.unwrap_or_else(|panic| resume_unwind(panic))?))
    })
}

/// Loads a scene and shows the progress.
pub fn load_scene(path: &Path, load: &LoadOptions) -> Result<Scene> {
    load_scene_unless(&NEVER, path, load)
}

/// Loads a scene; see [`load_any_unless`]. Fails soon after `cancel` becomes true, and for a file with only a mesh.
pub fn load_scene_unless(cancel: &AtomicBool, path: &Path, load: &LoadOptions) -> Result<Scene> {
    match load_any_unless(cancel, path, load)? {
        Content::Splats(scene) => load.kept(path, *scene),
        Content::Mesh(_) => bail!(LoadError { path: path.to_owned(), problem: SceneError::MeshAlone }),
    }
}

/// Loads a scene, or a mesh to draw with one, and shows the progress. Fails soon after `cancel` becomes true.
///
/// Prints what was dropped or not read, and other unusual properties of the scene.
pub fn load_any_unless(cancel: &AtomicBool, path: &Path, load: &LoadOptions) -> Result<Content> {
    let progress = Mutex::new(Progress::new(format!("loading {}", path.display())));
    let _span = info_span!("load the scene", path = %path.display()).entered();
    let content = load.any(path, &|done, of| {
        // Called on many threads. While one reports, the others skip their report.
        if let Ok(mut progress) = progress.try_lock() {
            progress.set(done, of, "");
        }
        if cancel.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    let notes = match &content {
        Content::Splats(scene) => losses::notes(scene),
        Content::Mesh(mesh) => losses::mesh_notes(mesh),
    };
    notes.into_iter().for_each(|note| say(format!("{}: {note}", path.display())));
    Ok(content)
}

/// Reports the tags that a merged scene ignores, because the scenes differ in them.
pub fn tell_mixed_tags(name: &str, scene: &Scene) {
    if let Some(tags) = losses::mixed_tags(scene) {
        say(format!("{name}: {tags}"));
    }
}

/// Finds a scene that was probably meant by a path that does not exist or is a folder. It has a similar name, or is the
/// only scene in the folder.
pub fn nearby(error: &LoadError) -> Option<PathBuf> {
    let path = &error.path;
    let folder = if path.is_dir() { path } else { path.parent()? };
    let listed = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let files = listed.read_dir().ok()?.flatten().map(|entry| PathBuf::from(entry.file_name()));
    let scenes: Vec<PathBuf> = files.filter(|file| SceneFormat::of_name(file).is_some()).collect();
    if path.is_dir() {
        return if let [only] = scenes.as_slice() { Some(folder.join(only)) } else { None };
    }
    let name = path.file_name().filter(|_| !path.exists())?.to_str()?;
    let without_extension = scenes.iter().find(|scene| scene.file_stem().is_some_and(|stem| stem == name));
    let near = || nearest(name, scenes.iter().filter_map(|scene| scene.to_str())).map(Path::new);
    Some(folder.join(without_extension.map(PathBuf::as_path).or_else(near)?))
}

/// Loads the scene at `path`, or the demo scene for `None`. Returns the scene, its path, and the demo scene's camera;
/// `None` for a scene at `path`.
///
/// With a level, which the demo scene lacks, loading fails. Setting `cancel` stops the load of a scene file, but not of
/// the demo scene.
pub fn scene_or_demo(
    cancel: &AtomicBool,
    path: Option<&Path>,
    load: &LoadOptions,
) -> Result<(Scene, PathBuf, Option<Camera>)> {
    let Some(path) = path else {
        let (scene, path) = load_demo(&load.file.clone().into())?;
        return Ok((load.kept(&path, scene)?, path, demo::camera()));
    };
    Ok((load_scene_unless(cancel, path, load)?, path.to_owned(), None))
}

/// Loads the demo scene. Generates it unless its file is intact, and writes it if possible.
fn load_demo(load: &LoadOptions) -> Result<(Scene, PathBuf)> {
    let path = demo::path().context(
        "the demo scene has no folder: set XDG_CACHE_HOME or HOME to an absolute path, or name a scene",
    )?;
    let intact = || {
        ensure!(demo::is_intact(&path)?, "{} does not have the checksum in its name", path.display());
        load_scene(&path, load)
    };
    if path.is_file() {
        match intact() {
            // A crash, a full disk or another program may have damaged the file.
            Err(error) if load.file.level.is_none() => {
                say(format!("{error}; the demo scene is generated again"))
            }
            loaded => return Ok((loaded?, path)),
        }
    }
    let bytes = info_span!("generate the demo scene").in_scope(demo::generate);
    let bytes = bytes.map_err(|error| anyhow!("the demo scene cannot be generated: {error}"))?;
    let scene = match output::write_bytes(&path, &bytes) {
        Ok(()) => {
            say(format!("the demo scene was generated into {}", path.display()));
            load_scene(&path, load)?
        }
        // With a level, loading the file would have been an error, too.
        Err(error) if load.file.level.is_some() => return Err(error.into()),
        Err(error) => {
            say(format!("the demo scene is generated at each use, because {error}"));
            Scene::parse(&bytes, QUIET)?
        }
    };
    Ok((scene, path))
}

const FRAMING: &str = "framing";

/// Lists the names that the cameras of [`scene_and_cameras`] have before they are made unique. Does not load the scene.
pub fn camera_names(scene: Option<&Path>, given: Option<&[Camera]>) -> Vec<String> {
    let own = || {
        scene.is_none().then(demo::camera).flatten().map_or_else(|| FRAMING.into(), |camera| camera.img_name)
    };
    given.map_or_else(|| vec![own()], |all| all.iter().map(|camera| camera.img_name.clone()).collect())
}

/// Converts the names of [`camera_names`] to unique file names of at most `room` bytes.
pub fn stems(scene: Option<&Path>, given: Option<&[Camera]>, room: usize) -> Vec<String> {
    names::unique(&camera_names(scene, given), room)
}

/// Returns the name of the scene at `path`, or of the demo scene.
pub fn scene_name(path: Option<&Path>) -> String {
    path.map_or_else(|| demo::NAME.to_owned(), |path| path.display().to_string())
}

/// Loads the scene at `path`, or the demo scene, and prepares its cameras; see [`cameras_of`]. Without `given`, uses
/// the demo scene's camera, or frames the scene.
pub fn scene_and_cameras(
    path: Option<&Path>,
    load: &LoadOptions,
    given: Option<Vec<Camera>>,
    size: Option<(u32, u32)>,
) -> Result<(Scene, Vec<Camera>)> {
    let (scene, _, own) = scene_or_demo(&NEVER, path, load)?;
    let cameras = cameras_of(&scene, given.or(own.map(|own| vec![own])), size);
    Ok((scene, cameras))
}

/// Converts cameras to the scene's coordinates and to the requested size; without cameras, frames the scene at that
/// size.
///
/// Their names become unique; see [`names::distinct`].
pub fn cameras_of(scene: &Scene, given: Option<Vec<Camera>>, size: Option<(u32, u32)>) -> Vec<Camera> {
    let given = given.map(|cameras| in_scene(&cameras, scene));
    let mut cameras = given.unwrap_or_else(|| vec![framing_at(scene, size)]);
    let names: Vec<String> = cameras.iter().map(|camera| camera.img_name.clone()).collect();
    for (camera, name) in cameras.iter_mut().zip(names::distinct(&names)) {
        if let Some((width, height)) = size {
            *camera = camera.resized(width, height);
        }
        camera.img_name = name;
    }
    cameras
}

/// Scales a camera's picture down to at most `width` pixels across. Smaller pictures stay unchanged.
pub fn at_most(camera: &Camera, width: u32) -> Camera {
    if camera.width <= width {
        return camera.clone();
    }
    let height = (f64::from(camera.height) * f64::from(width) / f64::from(camera.width)).round();
    camera.resized(width, (height as u32).max(1))
}

/// Converts cameras to the scene's coordinates. Reports cameras that are far from the scene and do not see it.
pub fn in_scene(cameras: &[Camera], scene: &Scene) -> Vec<Camera> {
    let cameras: Vec<Camera> = cameras.iter().map(|camera| camera.relative_to(scene.offset())).collect();
    stray_cameras(&cameras, scene).iter().for_each(say);
    cameras
}

/// Describes the cameras that are more than ten extents from the scene and look elsewhere. They probably have other
/// coordinates than the scene. `None` if there are none.
pub fn stray_cameras(cameras: &[Camera], scene: &Scene) -> Option<String> {
    let bounds = scene.robust_bounds();
    let distance = |camera: &Camera| camera.distance_elsewhere(&bounds, 10.0 * bounds.extent());
    let distances: Vec<f64> = cameras.iter().filter_map(distance).collect();
    let nearest = distances.iter().copied().reduce(f64::min)?;
    let (of, bounds) = (cameras.len(), bounds.in_world(scene.offset()));
    Some(format!(
        "{} of {of} cameras see nothing of the scene: the nearest is {nearest:.0} units away, and most splats are in \
         the box {bounds}; are the coordinates those of another scene?",
        distances.len()
    ))
}

/// Reports that `blind` of `of` cameras see no splat, unless `blind` is 0. `framing` names the option or the command
/// that frames the scene, for advice.
///
/// Unless all are blind, also reports that splats in `views` are too near.
pub fn tell_blind(scene: &Scene, (blind, of): (usize, usize), views: &[View], framing: &str) {
    let advice = format!("; {framing}, without --cameras, --eye and --target, frames the scene");
    if blind > 0 {
        // Which of several views are blind is not known.
        let example = views.first().filter(|_| blind == of);
        say(blind::note(scene, (blind, of), example, &advice));
    }
    if blind < of {
        blind::cut(scene, views).iter().for_each(say);
    }
}

pub fn framing(scene: &Scene) -> Camera {
    framing_at(scene, None)
}

/// Returns the camera that frames a scene in pictures of this size, or of the default size.
pub fn framing_at(scene: &Scene, size: Option<(u32, u32)>) -> Camera {
    let (width, height) = size.unwrap_or(facts::DEFAULT_SIZE);
    Camera { img_name: FRAMING.into(), ..Camera::framing(scene, width, height) }
}

/// Returns the facts and the imports of the scene at `path`, or of the nominal scene.
pub fn scene_facts(path: Option<&Path>, load: &LoadOptions) -> Result<(SceneFacts, Catalog)> {
    let Some(path) = path else {
        outcome::refuse_without("a scene", &[("--where", load.condition.is_some())])?;
        return Ok((SceneFacts::NOMINAL, lsp::nominal_catalog()));
    };
    let scene = load_scene(path, load)?;
    Ok((SceneFacts::of(&scene), facts::catalog(&scene)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;

    #[test]
    fn a_scene_with_a_similar_name_and_the_only_one_of_a_folder_are_suggested() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["splat.ply", "notes.txt"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let near = |path: &str| {
            let error = LoadError { path: folder.path().join(path), problem: SceneError::MeshAlone };
            nearby(&error)
        };
        for path in ["splat.pl", "splat", "plat.ply", ""] {
            assert_eq!(near(path), Some(folder.path().join("splat.ply")), "{path}");
        }
        assert_eq!((near("splat.ply"), near("garden.spz")), (None, None));
        std::fs::write(folder.path().join("other.spz"), "").unwrap();
        assert_eq!(near(""), None);
    }

    #[test]
    fn the_default_camera_frames_the_scene_in_a_picture_of_any_shape() {
        let scene = synth::generate("uniform", 500, 0).unwrap();
        for size in [(300, 600), (300, 300), (960, 540), (900, 100)] {
            let camera = cameras_of(&scene, None, Some(size)).remove(0);
            assert_eq!((camera.width, camera.height), size);
            let corners = scene.robust_bounds().corners().map(|corner| camera.to_view(corner));
            let reach = |axis: usize, focal: f64, side: u32| {
                let of = |view: &[f64; 3]| (view[axis] / view[2] * focal).abs() / (0.5 * f64::from(side));
                corners.iter().map(of).fold(0.0, f64::max)
            };
            let widest = reach(0, camera.fx, size.0).max(reach(1, camera.fy, size.1));
            assert!((0.9..0.93).contains(&widest), "{size:?}: {widest}");
        }
        let given = vec![Camera::framing(&scene, 200, 100)];
        let wide = cameras_of(&scene, Some(given.clone()), Some((300, 100))).remove(0);
        assert_eq!(wide.fy, given[0].fy, "a camera of a file keeps its vertical field of view");
    }
}
