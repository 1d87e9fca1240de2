//! Shares the views of a command among processes, through a folder.
//!
//! The views of `render`, `trade`, `sweep` and `evaluate` are independent. Each writes its own files, which are either
//! complete or absent. Therefore, any number of processes may share the views, in any order: `--shard 2/8` does every
//! eighth view, and the Python package distributes views to the workers of a cluster ([`Job`]). A view is skipped if
//! all its files exist, are undamaged and match the inputs.
//!
//! `job.json` in the folder names the views and all inputs that determine their results, independent of how a command
//! line spells them. A job with another description is rejected. `merge` reads the description, joins the results, and
//! names the missing ones.

use super::outcome::{self, Outcome, Usage};
use crate::draw::animation::is_animated;
use crate::draw::fingerprint::fingerprint;
use crate::draw::session::Session;
use crate::draw::stats;
use crate::io::image::Image;
use crate::io::output::{self, Claim, one_line, say};
use crate::io::report::text;
use crate::io::{own_file, program};
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json, json};
use splatgraph_assets::Scene;
use splatgraph_framework::reload::Wanted;
use splatgraph_framework::source::Content;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A share of the views: every `count`-th view, starting at `index`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    pub fn views(self, of: usize) -> Vec<usize> {
        (self.index..of).step_by(self.count).collect()
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "shard {}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Shard, String> {
        let parsed = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parsed {
            Some((index, count)) if index < count => Ok(Shard { index, count }),
            _ => Err("expected I/N with I from 0 to N - 1, for instance 0/8".into()),
        }
    }
}

/// The option of a command whose views can be shared.
#[derive(Debug, clap::Args)]
pub struct ShardArgs {
    /// Do only every N-th view, from view I (0 to N - 1), and skip views whose results are in the folder of --output
    ///
    /// For arrays of jobs, with the same command and folder in each: `--shard
    /// $SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT`. `merge` joins the results and names missing views. `--shard 0/1`
    /// is a run that can be interrupted.
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
}

/// Inputs that determine the results of views, by their names in messages. May also contain [`REQUEST`].
pub type Origin = Map<String, Json>;

/// Entry of an [`Origin`] with the scene's tags, which `--ignore-tags` changes. Earlier versions did not record it.
const TAGS: &str = "tags";

/// Entry of an [`Origin`] with the words of the command line that merged documents repeat, such as the scene's path. It
/// is not compared: equal files have different paths on different machines.
pub const REQUEST: &str = "request";

/// Reads the [`REQUEST`] of a description.
///
/// # Errors
/// The request is absent or has other fields, because an earlier version of the program wrote it.
pub fn request<T: DeserializeOwned>(origin: &Origin) -> Result<T> {
    serde_json::from_value(origin.get(REQUEST).cloned().unwrap_or_default()).context(
        "expected results of this version of the program, found those of an earlier one: run all shards again in another folder",
    )
}

pub struct Outputs {
    pub command: &'static str,
    pub folder: PathBuf,
    /// Names of the views in messages.
    pub views: Vec<String>,
    /// Files of each view, relative to the folder, or absolute if outside of it. The first is the result, which `merge`
    /// reads.
    pub files: Vec<Vec<PathBuf>>,
}

impl Outputs {
    /// Names the results of a command that writes a JSON file for each view with [`write_part`]. `stems` are the views'
    /// names in file names, unique and without extension.
    pub fn parts(command: &'static str, folder: &Path, stems: &[String]) -> Outputs {
        let files = stems.iter().map(|stem| vec![part(stem)]).collect();
        Outputs { command, folder: folder.into(), views: stems.to_vec(), files }
    }
}

/// A command whose views can be divided among several processes.
pub trait Work: Send {
    /// Names the views, and the files of their results. [`Job::new`] calls it once.
    fn outputs(&self) -> Outputs;

    /// Loads the scene and opens the device. Returns the inputs that determine the results.
    ///
    /// # Errors
    /// The scene cannot be loaded, there is no device, or the graph is invalid.
    fn open(&mut self) -> Result<Origin>;

    /// Processes the views with these indices and writes their files. Call [`Work::open`] first.
    ///
    /// # Errors
    /// A view failed. Close and reopen the work before the next call.
    fn draw(&mut self, views: &[usize]) -> Result<()>;

    /// Returns true if a view's files match the inputs that the [`Origin`] does not contain.
    fn is_current(&self, _view: usize) -> bool {
        true
    }

    /// Closes the device, and returns its validation messages.
    fn close(&mut self) -> Vec<String>;
}

const MANIFEST: &str = "job.json";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    pub command: String,
    pub origin: Origin,
    pub views: Vec<String>,
    /// Files of each view: see [`Outputs::files`].
    pub files: Vec<Vec<PathBuf>>,
}

impl Manifest {
    /// Reads the description in a folder.
    ///
    /// # Errors
    /// The folder has no valid description, or one from an earlier version of the program.
    pub fn read(folder: &Path) -> Result<Manifest> {
        let path = folder.join(MANIFEST);
        let text = own_file::read(&path)
            .with_context(|| format!("expected a folder of --shard, found no {}", path.display()))?;
        let found: Manifest = serde_json::from_slice(&text)
            .with_context(|| format!("{}: expected the description of a job", path.display()))?;
        if !found.origin.contains_key(TAGS) {
            bail!(
                "{}: expected results of this version of the program, found those of an earlier one, which may be of scenes with different tags: run all shards again in another folder",
                path.display()
            );
        }
        Ok(found)
    }

    /// Writes the description into a folder, or checks that the folder has one that is equal except for [`REQUEST`].
    ///
    /// # Errors
    /// The folder has results of another request or without a description, or the file cannot be read or written.
    fn claim(&self, folder: &Path) -> Result<()> {
        let path = folder.join(MANIFEST);
        let text = format!("{:#}\n", serde_json::to_value(self)?);
        let result = || self.files.iter().flatten().map(|file| folder.join(file)).find(|file| file.exists());
        match output::claim(&path, text.as_bytes(), result)? {
            Claim::Written => return Ok(()),
            Claim::Found(found) if found == text.as_bytes() => return Ok(()),
            Claim::Found(_) => {}
            Claim::Stray(file) => bail!(
                "expected an empty folder, or one with the {MANIFEST} of this request, found {}",
                file.display()
            ),
        }
        let (own, found) = (serde_json::from_str::<Manifest>(&text)?, Manifest::read(folder)?);
        let mut changes = own.changes(&found);
        if changes.is_empty() && own.files != found.files {
            changes.push("the places of files".into());
        }
        if changes.is_empty() {
            return Ok(());
        }
        bail!(
            "{}: expected results of this request, found some that differ in {}: name another folder, or remove this one",
            path.display(),
            changes.join(" and ")
        );
    }

    /// Rejects a folder with the description of shared views: new pictures would not match it.
    pub fn refuse(folder: &Path) -> Result<(), Usage> {
        match folder.join(MANIFEST).exists() {
            true => Err(Usage(format!(
                "expected a folder without {MANIFEST}, found {}: add --shard 0/1 to go on there, or name another folder",
                folder.display()
            ))),
            false => Ok(()),
        }
    }

    /// Names the differences from another description.
    ///
    /// If the command differs, only it is named. Otherwise, these are inputs except [`REQUEST`], and the views or else
    /// their files. Files outside of the folder are compared by file name only, because each folder has its own.
    pub fn changes(&self, other: &Manifest) -> Vec<String> {
        if self.command != other.command {
            return vec!["command".into()];
        }
        let names =
            self.origin.keys().chain(other.origin.keys().filter(|key| !self.origin.contains_key(*key)));
        let differs =
            names.filter(|name| *name != REQUEST && self.origin.get(*name) != other.origin.get(*name));
        let mut changes: Vec<String> = differs.cloned().collect();
        // Other inputs often change the plan; named alone, it tells that the devices differ.
        if changes.len() > 1 {
            changes.retain(|name| name != "plan");
        }
        let inside = |file: &PathBuf| match file.is_absolute() {
            true => file.file_name().map(Into::into),
            false => Some(file.clone()),
        };
        let names = |manifest: &Manifest| -> Vec<Option<PathBuf>> {
            manifest.files.iter().flatten().map(inside).collect()
        };
        if self.views != other.views {
            changes.push("the list of views".into());
        } else if names(self) != names(other) {
            changes.push("the names of files".into());
        }
        changes
    }
}

/// Outcome of a run over some views. Views are given by index.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ran {
    /// Views that this run completed.
    pub done: Vec<usize>,
    /// Views that were skipped because they had results.
    pub kept: Vec<usize>,
    /// Views that failed, each with the reason.
    pub failed: Vec<(usize, String)>,
}

/// The views of a command, to be done by this process in any order.
pub struct Job {
    work: Box<dyn Work>,
    outputs: Outputs,
    opened: bool,
    messages: Vec<String>,
}

impl Job {
    /// Creates the job of all views of a command. The first [`Job::run`] loads the scene and opens the device.
    pub fn new(work: Box<dyn Work>) -> Job {
        Job { outputs: work.outputs(), work, opened: false, messages: Vec::new() }
    }

    /// Returns the names of the views, for messages.
    pub fn views(&self) -> &[String] {
        &self.outputs.views
    }

    /// Processes the views without current, undamaged results. `views` are indices into [`Job::views`]. A failed view
    /// does not stop the others, and its files are removed; see [`Ran::failed`].
    ///
    /// # Errors
    /// The scene cannot be loaded, there is no device, the folder has results of another request, or the files of a
    /// failed view cannot be removed.
    pub fn run(&mut self, views: &[usize]) -> Result<Ran> {
        let mut ran = Ran::default();
        self.open()?;
        let Outputs { folder, files, .. } = &self.outputs;
        // Unpacking a picture can take as long as writing it, so all threads share the check.
        let present: Vec<bool> = views.par_iter().map(|view| is_present(folder, &files[*view])).collect();
        let mut missing = Vec::new();
        for (&view, present) in views.iter().zip(present) {
            if present && self.work.is_current(view) { &mut ran.kept } else { &mut missing }.push(view);
        }
        while !missing.is_empty() {
            // Several frames are in flight, so an error does not identify its view. After an error, views are drawn one
            // at a time until the failed one is found.
            self.reopen(&ran)?;
            if missing.len() > 1 && self.draw(&missing).is_ok() {
                ran.done.append(&mut missing);
                break;
            }
            while let Some(view) = (!missing.is_empty()).then(|| missing.remove(0)) {
                if self.has(view) {
                    ran.done.push(view);
                    continue;
                }
                self.reopen(&ran)?;
                match self.draw(&[view]) {
                    Ok(()) => ran.done.push(view),
                    Err(error) => {
                        self.remove(view)?;
                        ran.failed.push((view, reason(&error)));
                        break;
                    }
                }
            }
        }
        Ok(ran)
    }

    /// Closes the device. Returns its validation messages, after those of devices that failures closed.
    pub fn close(&mut self) -> Vec<String> {
        self.shut();
        std::mem::take(&mut self.messages)
    }

    fn has(&self, view: usize) -> bool {
        is_present(&self.outputs.folder, &self.outputs.files[view]) && self.work.is_current(view)
    }

    /// Removes the files of a failed view, which would otherwise count as its results: they may be of earlier inputs.
    fn remove(&self, view: usize) -> Result<()> {
        for file in self.outputs.files[view].iter().map(|file| self.outputs.folder.join(file)) {
            output::remove(&file)?;
        }
        Ok(())
    }

    /// Draws views with the opened work, and closes it if one fails.
    fn draw(&mut self, views: &[usize]) -> Result<()> {
        self.work.draw(views).inspect_err(|_| self.shut())
    }

    fn open(&mut self) -> Result<()> {
        if self.opened {
            return Ok(());
        }
        let origin = self.work.open()?;
        let Outputs { command, folder, views, files } = &self.outputs;
        let (views, files) = (views.clone(), files.clone());
        Manifest { command: (*command).into(), origin, views, files }.claim(folder)?;
        self.opened = true;
        Ok(())
    }

    /// Opens the work again if a failure closed it. No view is to blame for an error, and none loses its files.
    fn reopen(&mut self, ran: &Ran) -> Result<()> {
        self.open().with_context(|| match ran.failed.last() {
            Some((view, why)) => {
                let view = one_line(&self.outputs.views[*view]);
                format!("the other views cannot be done after {view} failed ({})", why.trim())
            }
            None => "the views cannot be done one by one after one failed".into(),
        })
    }

    fn shut(&mut self) {
        self.opened = false;
        self.messages.extend(self.work.close());
    }
}

/// Processes the views of a shard and reports the failures. With `validate`, validation messages are a failure.
///
/// # Errors
/// See [`Job::run`].
pub fn run(work: Box<dyn Work>, shard: Shard, validate: bool) -> Result<Outcome> {
    let mut job = Job::new(work);
    let views = shard.views(job.views().len());
    let Ran { done, kept, failed } = job.run(&views)?;
    say(format!(
        "{shard}: {} of {} views: {} done, {} already there, {} failed",
        views.len(),
        job.views().len(),
        done.len(),
        kept.len(),
        failed.len()
    ));
    for (view, why) in &failed {
        say(format!("{}: {}", one_line(&job.views()[*view]), why.trim()));
    }
    let outcome = outcome::validated(validate, &job.close());
    Ok(if failed.is_empty() { outcome } else { Outcome::Failed })
}

/// Returns true if all files of a view exist and no damage is found. `folder` is the job's folder.
pub fn is_present(folder: &Path, files: &[PathBuf]) -> bool {
    files.iter().all(|file| is_whole(&folder.join(file)).unwrap_or(false))
}

/// Returns false for a damaged picture (see [`Image::is_whole`]), and for invalid JSON. Files are written atomically,
/// but an interrupted copy, a full disk or a lost connection to a shared disk can damage them later.
fn is_whole(path: &Path) -> Result<bool> {
    Ok(match path.extension().and_then(OsStr::to_str) {
        Some("json") => serde_json::from_slice::<IgnoredAny>(&own_file::read(path)?).is_ok(),
        _ => Image::is_whole(path)?,
    })
}

pub fn reason(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text += &format!(": {cause}");
        }
    }
    text
}

/// Returns a view's result file, relative to the folder, for commands whose results are not pictures.
pub fn part(view: &str) -> PathBuf {
    Path::new("parts").join(format!("{view}.json"))
}

/// Writes a view's result as JSON, for commands whose results are not pictures.
pub fn write_part(folder: &Path, view: &str, result: &impl Serialize) -> Result<()> {
    let text = format!("{:#}\n", serde_json::to_value(result)?);
    Ok(output::write_bytes(&folder.join(part(view)), text.as_bytes())?)
}

/// Returns the inputs that determine the pictures of a scene and a graph. `session` must be prepared. `cameras` are as
/// for [`origin`].
///
/// # Errors
/// The program's file cannot be read.
pub fn origin_of(
    session: &Session,
    cameras: &Json,
    (pipeline, set): (&str, &[(String, String)]),
) -> Result<Origin> {
    let hash = |file: Wanted| match file.content {
        Content::Bytes { hash, .. } => Some(text::hex(hash)),
        _ => None,
    };
    // Sorted by hash: the order of the paths depends on the folders.
    let files: BTreeSet<String> = session.files().into_iter().filter_map(hash).collect();
    // The contents identify a graph's file, not the folders in its path.
    let pipeline = Path::new(pipeline).file_name().map_or(pipeline.into(), OsStr::to_string_lossy);
    let params = session.plan().map(|plan| plan.params.as_slice()).unwrap_or_default();
    let value = |(name, text): &(String, String)| {
        let param = params.iter().find(|param| param.name == *name);
        (name.clone(), param.map_or_else(|| json!(text), |param| stats::json(&param.value)))
    };
    let set: BTreeMap<String, Json> = set.iter().map(value).collect();
    let mut origin = origin(session.scene(), cameras)?;
    origin.insert("graph".into(), json!({ "pipeline": pipeline, "set": set, "files": files }));
    Ok(origin)
}

/// Returns the hash of a session's plan, as an entry of an [`Origin`]. Plans of devices differ if `auto` draws another
/// graph on each.
pub fn plan_of(session: &Session) -> (String, Json) {
    ("plan".into(), json!(session.plan().map(|plan| text::hex(fingerprint(plan)))))
}

/// Returns the inputs that determine the pictures of a scene, except for the graph. `cameras` are relative to
/// [`Scene::offset`].
///
/// # Errors
/// The program's file cannot be read.
pub fn origin(scene: &Scene, cameras: &Json) -> Result<Origin> {
    let program = program::hash().context("the program's file cannot be read")?;
    let hash = text::hex(scene.identity());
    let rules = scene.notes().rules();
    let origin = json!({ "program": program, "scene": hash, TAGS: rules, "cameras": cameras });
    Ok(origin.as_object().cloned().unwrap_or_default())
}

/// Rejects options that do not apply to a share of the views. Each entry is an option, and true if it is given.
pub fn refuse(given: &[(&str, bool)]) -> Result<(), Usage> {
    outcome::refuse(given, |option| {
        format!("expected no {option} with --shard, which processes only part of the views")
    })
}

/// Rejects a graph whose pictures depend on earlier frames. Each process, and each resumed one, draws other frames
/// before a view. `session` must be prepared.
pub fn refuse_animated(session: &Session) -> Result<(), Usage> {
    match session.plan() {
        Some(plan) if is_animated(plan) => Err(Usage(format!(
            "expected a graph that draws each view on its own with --shard, found `{}`, whose frames depend on those \
             before them (state, such as a history, or `camera.frame`): each shard would start them anew; draw all \
             views in one process, without --shard",
            plan.name
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;
    use std::cell::Cell;
    use std::fs;

    #[test]
    fn shards_have_every_view_once() {
        let shards = (0..3).map(|index| Shard { index, count: 3 }.views(8));
        assert_eq!(shards.collect::<Vec<_>>(), [vec![0, 3, 6], vec![1, 4, 7], vec![2, 5]]);
        assert_eq!("0/1".parse(), Ok(Shard { index: 0, count: 1 }));
        for text in ["1/1", "0/0", "-1/2", "1", "a/b"] {
            assert!(text.parse::<Shard>().unwrap_err().contains("expected I/N"), "{text}");
        }
    }

    /// A job in a folder, with the names of its views, the indices of the views that fail, and the number of times that
    /// it can be opened.
    struct Some(PathBuf, Vec<String>, &'static [usize], Cell<u32>);

    impl Work for Some {
        fn outputs(&self) -> Outputs {
            Outputs::parts("render", &self.0, &self.1)
        }

        fn open(&mut self) -> Result<Origin> {
            let left = self.3.get().checked_sub(1).context("no device")?;
            self.3.set(left);
            origin(&synth::generate("uniform", self.2.len() as u32, 0)?, &json!([]))
        }

        fn draw(&mut self, views: &[usize]) -> Result<()> {
            for view in views {
                if self.2.contains(view) {
                    bail!("view {view} is bad");
                }
                write_part(&self.0, &self.1[*view], view)?;
            }
            Ok(())
        }

        fn close(&mut self) -> Vec<String> {
            Vec::new()
        }
    }

    #[test]
    fn a_view_that_fails_costs_no_other_and_what_is_there_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let job_of = |bad, opens| {
            let views = (0..6).map(|view| view.to_string()).collect();
            Job::new(Box::new(Some(folder.path().into(), views, bad, Cell::new(opens))))
        };
        let job = |bad| job_of(bad, u32::MAX);
        let ran = job(&[1, 4]).run(&[0, 1, 2, 4, 5]).unwrap();
        assert_eq!((ran.done.as_slice(), ran.kept.as_slice()), (&[0, 2, 5][..], &[][..]));
        assert_eq!(ran.failed, [(1, "view 1 is bad".into()), (4, "view 4 is bad".into())]);
        let ran = job(&[3, 4]).run(&[0, 1, 2, 3, 4, 5]).unwrap();
        assert_eq!((ran.done.as_slice(), ran.kept.as_slice()), (&[1][..], &[0, 2, 5][..]));
        // A device that cannot be opened again costs no view its files.
        let stale = folder.path().join(part("5"));
        fs::write(&stale, "{").unwrap();
        fs::remove_file(folder.path().join(part("1"))).unwrap();
        let error = job_of(&[3, 4], 2).run(&[3, 4, 5, 1]).unwrap_err();
        assert_eq!(
            format!("{error:#}"),
            "the other views cannot be done after 3 failed (view 3 is bad): no device"
        );
        assert!(stale.exists());
        job(&[3, 4]).run(&[1, 5]).unwrap();
        let error = job(&[3]).run(&[0]).unwrap_err().to_string();
        assert!(error.contains("found some that differ in scene: name another folder"), "{error}");
        // A description of an earlier version of the program.
        let manifest = folder.path().join(MANIFEST);
        let old = fs::read_to_string(&manifest).unwrap().replace("\"tags\"", "\"labels\"");
        fs::write(&manifest, old).unwrap();
        let error = job(&[3, 4]).run(&[0]).unwrap_err().to_string();
        assert!(error.contains("this version of the program, found those of an earlier one"), "{error}");
        fs::remove_file(manifest).unwrap();
        let error = job(&[3]).run(&[0]).unwrap_err().to_string();
        assert!(error.starts_with("expected an empty folder") && error.ends_with("0.json"), "{error}");
    }

    #[test]
    fn of_different_requests_that_begin_at_once_in_one_folder_one_gets_it() {
        for _ in 0..20 {
            let folder = tempfile::tempdir().unwrap();
            let start = std::sync::Barrier::new(8);
            let claim = |number: usize| {
                let view = vec![number.to_string()];
                let origin = Origin::from_iter([(TAGS.to_owned(), json!([]))]);
                let (command, files) = ("render".to_owned(), vec![vec![part("0")]]);
                let manifest = Manifest { command, origin, views: view, files };
                start.wait();
                manifest.claim(folder.path()).map(|()| manifest)
            };
            let claim = &claim;
            let claims: Vec<_> = std::thread::scope(|scope| {
                let threads: Vec<_> = (0..8).map(|number| scope.spawn(move || claim(number / 2))).collect();
                threads.into_iter().map(|thread| thread.join().unwrap()).collect()
            });
            let (done, refused): (Vec<_>, Vec<_>) = claims.into_iter().partition(Result::is_ok);
            let done: Vec<_> = done.into_iter().map(Result::unwrap).collect();
            // Two threads have equal requests, and share the folder.
            assert_eq!((done.len(), refused.len()), (2, 6));
            assert_eq!([&done[0], &done[1]], [&Manifest::read(folder.path()).unwrap(); 2]);
            for error in refused.into_iter().map(|refused| refused.unwrap_err().to_string()) {
                assert!(error.contains("found some that differ in the list of views"), "{error}");
            }
        }
    }

    #[test]
    fn a_description_that_cannot_be_read_is_an_error_and_does_not_count_as_absent() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(MANIFEST)).unwrap();
        let views = vec!["0".to_owned()];
        let mut job = Job::new(Box::new(Some(folder.path().into(), views, &[], Cell::new(1))));
        let error = job.run(&[0]).unwrap_err();
        assert!(error.root_cause().is::<std::io::Error>(), "{error:#}");
        assert!(error.to_string().ends_with(MANIFEST), "{error:#}");
    }
}
