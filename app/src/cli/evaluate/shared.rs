//! Scores views in several processes that share a folder (`evaluate --shard`), and merges their scores.

use super::drawer::{self, Drawer, ORIGIN, as_json, request, save};
use super::work::{Args, FOLDERS, View, Work, picture, prepare};
use crate::cli::job::{self, Manifest};
use crate::cli::options;
use crate::cli::outcome::Usage;
use crate::io::image::Image;
use crate::io::output::{self, one_line, say};
use crate::io::own_file;
use crate::io::progress::Progress;
use crate::io::report::text;
use crate::studies::evaluation::{Evaluation, Score};
use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};
use splatgraph_assets::Scene;
use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Result file of one view of a shared evaluation.
#[derive(Serialize, Deserialize)]
pub struct Part {
    #[serde(flatten)]
    score: Score,
    /// Hash of the files of the photograph and its mask. A view that has another hash is scored again.
    photograph: String,
}

fn hash_of(view: &View) -> Result<String> {
    let mut hash = DefaultHasher::new();
    for file in [Some(view.photograph()?), view.mask()?].into_iter().flatten() {
        hash.write(&own_file::read(file)?);
    }
    Ok(text::hex(hash.finish()))
}

pub struct Views {
    args: Args,
    folder: PathBuf,
    work: Work,
    scene: Option<Arc<Scene>>,
    drawer: Option<Drawer>,
}

impl Views {
    pub fn new(args: Args) -> Result<Views> {
        job::refuse(&[("--json", args.json.is_some())])?;
        let Some(folder) = args.output.clone() else {
            return Err(Usage("expected a folder for --output with --shard, found none".into()).into());
        };
        let work = prepare(&args)?;
        Ok(Views { args, folder, work, scene: None, drawer: None })
    }
}

impl job::Work for Views {
    fn outputs(&self) -> job::Outputs {
        let views = self.work.views.iter().map(|view| view.name.clone()).collect();
        job::Outputs { views, ..job::Outputs::parts(COMMAND, &self.folder, &self.work.stems) }
    }

    fn open(&mut self) -> Result<job::Origin> {
        let mut drawer = Drawer::open(&self.args, &mut self.work, self.scene.clone())?;
        let scene = match &drawer {
            Drawer::Reference(scene) => scene.clone(),
            Drawer::Device(session, _) => session.shared_scene(),
        };
        self.work.tell_training(&self.args, &scene);
        let views = self.work.views.iter();
        let cameras: Vec<_> = views.map(|view| view.camera.relative_to(scene.offset())).collect();
        let cameras = serde_json::to_value(cameras)?;
        let mut origin = match &drawer {
            Drawer::Reference(scene) => job::origin(scene, &cameras)?,
            Drawer::Device(session, _) => {
                job::origin_of(session, &cameras, (&self.args.pipeline, &self.args.set))?
            }
        };
        self.scene = Some(scene);
        let mut request = request(&self.args);
        request[ORIGIN] = drawer::origin(&mut drawer, self.work.downscaled.as_deref(), self.work.split)?;
        let Args { backend, downscale, repeat, background, .. } = &self.args;
        origin.extend([
            ("--backend".into(), json!(backend.to_string())),
            ("--downscale".into(), json!(downscale)),
            ("--repeat".into(), json!(repeat)),
            ("--masks".into(), json!(self.args.masks.is_some())),
            ("--background".into(), json!(background)),
            (job::REQUEST.into(), request),
        ]);
        self.drawer = Some(drawer);
        Ok(origin)
    }

    fn draw(&mut self, views: &[usize]) -> Result<()> {
        let drawer = self.drawer.as_mut().context("no device")?;
        let mut progress = Progress::new("scoring");
        for (index, &view) in views.iter().enumerate() {
            let (stem, view) = (&self.work.stems[view], &self.work.views[view]);
            progress.set(index as u64, views.len() as u64, &view.name);
            let hash = hash_of(view)?;
            let background = self.args.background;
            let (camera, photograph, mask) = view.load(self.work.downscale, background)?;
            let drawn = drawer.draw(&camera, background)?;
            let score = view.score(&drawn, &photograph, mask.as_deref())?;
            let score = Score { too_near: drawer.too_near(&camera), ..score };
            save(&self.args, stem, &drawn, &photograph, mask.as_deref())?;
            job::write_part(&self.folder, stem, &Part { score, photograph: hash })?;
        }
        Ok(())
    }

    fn is_current(&self, view: usize) -> bool {
        let scored = || -> Result<bool> {
            let part = own_file::read(&self.folder.join(job::part(&self.work.stems[view])))?;
            let part: Part = serde_json::from_slice(&part)?;
            Ok(part.photograph == hash_of(&self.work.views[view])?)
        };
        // `merge` needs only the score.
        let whole = |folder| Image::is_whole(&picture(&self.folder, folder, &self.work.stems[view]));
        FOLDERS.into_iter().all(|folder| whole(folder).unwrap_or(false)) && scored().unwrap_or(false)
    }

    fn close(&mut self) -> Vec<String> {
        match self.drawer.take() {
            Some(Drawer::Device(session, _)) => session.into_device().close(),
            _ => Vec::new(),
        }
    }
}

/// Command name in the `job.json` of shared folders.
pub const COMMAND: &str = "evaluate";

/// File name of the scores in the folder of a shared run.
const SCORES: &str = "scores.json";

/// Checks that all pictures have the same scale relative to their cameras. The photographs' sizes are not part of the
/// origin, because a missing photograph has none.
fn check_scales(origin: &job::Origin, parts: &[Part], missing: &[usize]) -> Result<()> {
    let cameras = origin.get("cameras").and_then(Json::as_array).context("the cameras of an evaluation")?;
    let present = cameras.iter().enumerate().filter(|(view, _)| !missing.contains(view));
    let (mut low, mut high) = ((0.0, None), (f64::INFINITY, None));
    for (part, (_, camera)) in parts.iter().zip(present) {
        let own = camera["width"].as_f64().context("the width of a camera")?;
        let width = part.score.width as f64;
        // Widths are rounded, and photographs may be cropped; see `View::drawn`.
        let slack = f64::max(1.0, 0.01 * width);
        let (least, most) = ((width - slack) / own, (width + slack) / own);
        low = if least > low.0 { (least, Some(part)) } else { low };
        high = if most < high.0 { (most, Some(part)) } else { high };
    }
    if let ((least, Some(large)), (most, Some(small))) = (low, high)
        && least > most
    {
        let text = |Part { score, .. }: &Part| {
            format!("{} with {} x {}", one_line(&score.view), score.width, score.height)
        };
        bail!(
            "expected scores of photographs of one size, found {} and {} pixels: run all shards again with the same photographs",
            text(large),
            text(small)
        );
    }
    Ok(())
}

/// Prints the scores that several processes computed, and writes them to `scores.json` in `output`. `missing` has the
/// indices of the views without scores.
///
/// # Errors
/// The origin has no request, the pictures differ in scale, or the file cannot be written.
pub fn merge(manifest: &Manifest, parts: Vec<Part>, missing: &[usize], output: &Path) -> Result<()> {
    let origin = &manifest.origin;
    check_scales(origin, &parts, missing)?;
    let missing = missing.iter().filter_map(|view| manifest.views.get(*view).cloned()).collect();
    let found = Evaluation::new(parts.into_iter().map(|part| part.score).collect(), missing);
    found.grey_note().iter().for_each(say);
    found.near_note().iter().for_each(say);
    let request = origin.get(job::REQUEST).cloned().context("the origin of an evaluation")?;
    output::write_bytes(&output.join(SCORES), (as_json(request, &found) + "\n").as_bytes())?;
    options::print(found.table().trim_end())
}
