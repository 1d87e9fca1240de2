//! Shares the views of a rendering among several processes.

use super::args::{Args, Work, prepare};
use super::destination::{Destination, in_folder, per_camera};
use super::drawer::{Drawer, Loaded};
use crate::cli::job::{self, Origin};
use crate::cli::outcome::Usage;
use crate::io::output::names;
use anyhow::{Context, Result};
use serde_json::json;
use std::path::{Path, PathBuf, absolute};

/// Command name in the `job.json` of shared folders.
pub const COMMAND: &str = "render";

pub struct Views {
    args: Args,
    folder: PathBuf,
    work: Work,
    loaded: Option<Loaded>,
    drawer: Option<Drawer>,
}

impl Views {
    /// Checks the arguments and reads the cameras. [`job::Work::open`] loads the scene.
    pub fn new(args: Args) -> Result<Views> {
        let inspects = !args.inspect.is_empty();
        job::refuse(&[
            ("--json", args.json.is_some()),
            ("--timeline", args.timeline.is_some()),
            ("--inspect", inspects),
            ("--write-cameras", args.write_cameras.is_some()),
            ("--repeat", args.repeat > 1),
        ])?;
        let work = prepare(&args)?;
        let named = || args.named().map(|(_, file)| file).find(|file| names::ends_in_separator(file));
        let folder = match &work.destination {
            Some(Destination::Folder(folder, _)) => Some(folder.clone()),
            Some(Destination::Picture(..)) => None,
            // Depths alone, for instance: their folder has the job's record.
            None => named().map(Path::to_owned),
        };
        let Some(folder) = folder else {
            let message =
                "expected a folder with --shard, as in `--output FOLDER/` or `--output depth=FOLDER/`";
            return Err(Usage(message.into()).into());
        };
        Ok(Views { args, folder, work, loaded: None, drawer: None })
    }
}

/// Returns a file's path relative to `folder`, or its absolute path if it is outside.
fn relative(file: &Path, folder: &Path) -> PathBuf {
    let (Ok(file), Ok(folder)) = (absolute(file), absolute(folder)) else { return file.to_owned() };
    file.strip_prefix(folder).map_or(file.clone(), Path::to_owned)
}

impl job::Work for Views {
    fn outputs(&self) -> job::Outputs {
        let views = self.work.stems.clone();
        let files = |stem: &String| {
            let picture = self.work.destination.as_ref().map(|destination| destination.path(stem));
            let named = self
                .args
                .named()
                .map(|(name, file)| per_camera(file, in_folder(name, self.args.format), stem, views.len()));
            picture.into_iter().chain(named).map(|file| relative(&file, &self.folder)).collect()
        };
        let files = views.iter().map(files).collect();
        job::Outputs { command: COMMAND, folder: self.folder.clone(), files, views }
    }

    fn open(&mut self) -> Result<Origin> {
        let mut drawer = Drawer::open(&self.args, &self.work, self.loaded.clone())?;
        let loaded = drawer.loaded().clone();
        let cameras = serde_json::to_value(&loaded.cameras)?;
        let Args { rule, background, backend, .. } = &self.args;
        let mut origin = match drawer.prepared(&self.args)? {
            // Includes the chosen storage: a device with less memory chooses a smaller one, and draws other pictures.
            Some(session) => {
                job::refuse_animated(session)?;
                let mut origin = job::origin_of(session, &cameras, session.graph())?;
                origin.extend([job::plan_of(session)]);
                origin
            }
            None => job::origin(&loaded.scene, &cameras)?,
        };
        let outputs: Vec<&str> = self.args.named().map(|(name, _)| name).collect();
        origin.extend([
            ("--backend".into(), json!(backend.to_string())),
            ("--rule".into(), json!(rule)),
            ("--background".into(), json!(background)),
            ("--output".into(), json!(outputs)),
        ]);
        self.loaded = Some(loaded);
        self.drawer = Some(drawer);
        Ok(origin)
    }

    fn draw(&mut self, views: &[usize]) -> Result<()> {
        let drawer = self.drawer.as_mut().context("no device")?;
        drawer.draw(&self.args, views)?;
        drawer.finish()
    }

    fn close(&mut self) -> Vec<String> {
        let closed = self.drawer.take().map(Drawer::close);
        // `draw` has already written all files, so there is no error to report.
        closed.and_then(Result::ok).map(|(_, messages)| messages).unwrap_or_default()
    }
}
