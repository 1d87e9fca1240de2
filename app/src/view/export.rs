//! Writes splats to a new file, on another thread. The extension selects a scene format or, if it is `.json`, a list of
//! the splats' indices.
//!
//! Only one file is written at a time, and no existing file is replaced.

use super::latest::Latest;
use super::renderer::Wake;
use crate::draw::splat_set::SplatSet;
use crate::io::losses::Original;
use crate::io::output::{self, OutputGuard};
use crate::io::scene_file;
use splatgraph_assets::Scene;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Summary of a file that was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// Number of splats.
    pub splats: u32,
    /// Size of the file, in bytes.
    pub bytes: u64,
    /// Tags of the file with their values, such as `up 0,0,1`.
    pub tags: Vec<String>,
    /// Data of the scene that the file lacks, as `convert` lists it, except losses that no picture shows. Empty for a
    /// list of indices.
    pub lost: Vec<String>,
}

/// Writer that runs on another thread. Dropping it waits for the file.
pub struct Exporter {
    work: Latest<Written>,
    path: PathBuf,
    /// Progress of the write, in percent; 0 if unknown.
    percent: Arc<AtomicU64>,
}

impl Exporter {
    /// Creates an idle exporter. It calls `wake` when a file is written or has failed.
    pub fn new(wake: Wake) -> Exporter {
        Exporter { work: Latest::new("write", wake), path: PathBuf::new(), percent: Arc::default() }
    }

    /// Starts to write `splats` of a scene to a new file. `up` replaces the scene's up direction, if given.
    ///
    /// # Errors
    /// The exporter is busy, there is no splat, the file exists or cannot be created, its extension is unknown, or the
    /// system cannot start a thread. Later failures are in the result of [`Exporter::take`].
    pub fn start(
        &mut self,
        scene: Arc<Scene>,
        splats: Arc<SplatSet>,
        up: Option<[f64; 3]>,
        path: &Path,
    ) -> Result<(), String> {
        if self.busy() {
            return Err(format!(
                "expected {} to be finished, found it still being written",
                self.path.display()
            ));
        }
        if splats.is_empty() {
            return Err("expected at least one splat to write, found none".to_owned());
        }
        let or_list = |error| format!("{error}; or in .json, for a list of indices");
        let format = if is_list(path) { None } else { Some(scene_file::format_of(path).map_err(or_list)?) };
        OutputGuard::default().output("the file", path).map_err(|error| error.to_string())?;
        if std::fs::symlink_metadata(path).is_ok() {
            return Err("expected a new file, found one that exists".to_owned());
        }
        let percent = Arc::new(AtomicU64::new(0));
        (self.path, self.percent) = (path.to_owned(), percent.clone());
        let path = path.to_owned();
        self.work.start(move |_| {
            let written = |bytes, tags, lost| Written { splats: splats.len(), bytes, tags, lost };
            let write = || -> Result<Written, String> {
                let Some(format) = format else {
                    let text = splats.to_json(&scene).map_err(|error| error.to_string())? + "\n";
                    output::write_new_bytes(&path, text.as_bytes()).map_err(|error| error.to_string())?;
                    return Ok(written(text.len() as u64, Vec::new(), Vec::new()));
                };
                let mut part = scene.picked(&splats.indices()).map_err(|error| error.to_string())?;
                let mut notes = part.notes();
                if up.is_some_and(|up| up != scene.up() || notes.mixed.up) {
                    (notes.up, notes.mixed.up) = (up, false);
                    part = part.with_notes(notes);
                }
                let progress = |done: u64, of: u64| {
                    percent.store(100 * done / of.max(1), Ordering::Relaxed);
                    ControlFlow::Continue(())
                };
                let bytes = scene_file::write_new(&part, format, &progress, &path);
                let bytes = bytes.map_err(|error| error.to_string())?;
                let tags = format.kept_tags(part.notes()).tags();
                let tags = tags.into_iter().map(|(name, value)| format!("{name} {value}")).collect();
                Ok(written(bytes, tags, Original::of(&scene).losses(&part, format)))
            };
            Some(write())
        })
    }

    /// Returns true while a file is being written, and until its result is taken.
    pub fn busy(&self) -> bool {
        self.work.busy()
    }

    /// Describes the file that is being written; `None` if there is none.
    pub fn progress(&self) -> Option<String> {
        let percent = match self.percent.load(Ordering::Relaxed) {
            0 => String::new(),
            percent => format!(", {percent} %"),
        };
        self.busy().then(|| format!("writing {}{percent}", self.path.display()))
    }

    /// Takes the path and the result of the finished write; `None` while it runs, or if none was started.
    pub fn take(&mut self) -> Option<(PathBuf, Result<Written, String>)> {
        Some((self.path.clone(), self.work.take()?))
    }

    /// Waits for the write, and takes its path and result; `None` if none was started.
    pub fn wait(&mut self) -> Option<(PathBuf, Result<Written, String>)> {
        Some((self.path.clone(), self.work.wait()?))
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        self.wait();
    }
}

fn is_list(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::{QUIET, synth};

    fn exporter() -> Exporter {
        Exporter::new(Arc::new(|| {}))
    }

    #[test]
    fn existing_files_unknown_formats_and_nothing_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let scene = Arc::new(synth::generate("uniform", 20, 0).unwrap());
        let some: Arc<SplatSet> = Arc::new([1].into_iter().collect());
        std::fs::write(at("scene.ply"), "mine").unwrap();
        let mut exporter = exporter();
        let said = |exporter: &mut Exporter, splats: &Arc<SplatSet>, path: PathBuf| {
            exporter.start(scene.clone(), splats.clone(), None, &path).unwrap_err()
        };
        assert!(said(&mut exporter, &some, at("scene.ply")).contains("expected a new file"));
        let unknown = said(&mut exporter, &some, at("part.png"));
        assert!(unknown.contains("expected a file name that ends in .ply"), "{unknown}");
        assert!(unknown.ends_with("; or in .json, for a list of indices"), "{unknown}");
        assert!(said(&mut exporter, &some, at("scene.ply/part.ply")).contains("scene.ply"));
        assert!(said(&mut exporter, &Arc::default(), at("a.ply")).contains("expected at least one splat"));
        assert_eq!(std::fs::read_to_string(at("scene.ply")).unwrap(), "mine");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn the_summary_of_a_file_names_its_tags() {
        let folder = tempfile::tempdir().unwrap();
        let scene = Arc::new(synth::generate("uniform", 20, 0).unwrap());
        let mut exporter = exporter();
        for (name, expected) in [("a.ply", &["up 0,0,1"][..]), ("a.splat", &[])] {
            let (all, path) = (Arc::new(SplatSet::first(20)), folder.path().join(name));
            exporter.start(scene.clone(), all, Some([0.0, 0.0, 1.0]), &path).unwrap();
            let Some((_, Ok(Written { tags, .. }))) = exporter.wait() else {
                panic!("{name} is not written")
            };
            assert_eq!(tags, expected);
        }
    }

    #[test]
    fn a_chosen_up_direction_replaces_those_in_which_merged_scenes_differ() {
        let folder = tempfile::tempdir().unwrap();
        let scene = synth::generate("uniform", 20, 0).unwrap();
        let mut notes = scene.notes();
        notes.mixed.up = true;
        let scene = Arc::new(scene.with_notes(notes));
        let mut exporter = exporter();
        let mut written = |up: Option<[f64; 3]>, name: &str| {
            let all = Arc::new(SplatSet::first(20));
            exporter.start(scene.clone(), all, up, &folder.path().join(name)).unwrap();
            let Some((_, Ok(Written { tags, lost, .. }))) = exporter.wait() else { panic!("{name}") };
            (tags, lost.into_iter().filter(|lost| lost.starts_with("tags in which")).count())
        };
        assert_eq!(written(None, "none.ply"), (vec![], 1));
        // The direction of scenes without a tag, too.
        for (up, tag) in [([1.0, 0.0, 0.0], "up 1,0,0"), ([0.0, -1.0, 0.0], "up 0,-1,0")] {
            assert_eq!(written(Some(up), &format!("{tag}.ply")), (vec![tag.to_owned()], 0));
        }
    }

    #[test]
    fn a_dropped_exporter_finishes_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("part.spz");
        let scene = Arc::new(synth::generate("demo", 20_000, 3).unwrap());
        let all = Arc::new(SplatSet::first(20_000));
        let mut exporter = exporter();
        exporter.start(scene.clone(), all.clone(), None, &path).unwrap();
        let second = exporter.start(scene, all, None, &folder.path().join("second.spz")).unwrap_err();
        assert!(second.contains("still being written"), "{second}");
        drop(exporter);
        assert_eq!(Scene::load(&path, QUIET).unwrap().count(), 20_000);
    }
}
