//! Measures and prints the price of each format (`convert --price`).

use super::edit::EditArgs;
use crate::cli::outcome::{Outcome, Usage, refuse_without};
use crate::cli::{cameras, loading, options};
use crate::draw::blind;
use crate::io::load::FileOptions;
use crate::io::losses;
use crate::io::output::{OutputGuard, say};
use crate::io::report::text;
use crate::studies::price::{self, Found, Price};
use anyhow::{Error, Result};
use serde_json::{Value as Json, json};
use splatgraph_assets::{Camera, CameraError, Dataset, Scene, SceneFormat, grouped};
use std::path::{Path, PathBuf};

/// Options of `--price`.
#[derive(Debug, clap::Args)]
pub struct PriceArgs {
    /// Print the price of each format instead of writing OUT: bytes, loading time, and PSNR, SSIM and FLIP of exact
    /// pictures against those of IN, after --merge and --transform, with all its splats and bands
    #[arg(long, conflicts_with_all = ["output", "spz_version"])]
    price: bool,
    /// Cameras of the pictures of --price [default: the first camera beside the scene, or one that frames the scene],
    /// or of --write-cameras; --transform moves them with the scene
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    cameras: Option<String>,
    /// Use lenses with distortion as ideal ones [default: such lenses are refused]
    #[arg(long, requires = "cameras")]
    ignore_distortion: bool,
    /// Size of the pictures of --price [default: the cameras']
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    /// Print the losses and, with --price, the prices as JSON, or write them to a file
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
}

impl PriceArgs {
    /// Registers the files of the options. `moves_cameras` is true with `--write-cameras`.
    pub(super) fn claim(
        &self,
        guard: &mut OutputGuard,
        scene: &Path,
        moves_cameras: bool,
    ) -> Result<(), Usage> {
        if self.price || moves_cameras {
            cameras::claim(guard, self.cameras.as_deref(), Some(scene))?;
        } else {
            refuse_without("--price or --write-cameras", &[("--cameras", self.cameras.is_some())])?;
        }
        if !self.price {
            refuse_without("--price", &[("--size", self.size.is_some())])?;
        }
        self.json.as_ref().map_or(Ok(()), |path| Ok(guard.output("--json", path)?))
    }

    /// Reads the dataset of `--cameras`; empty without it.
    pub(super) fn dataset(&self) -> Result<Dataset, CameraError> {
        let spec = self.cameras.as_deref();
        spec.map_or_else(|| Ok(Dataset::default()), |spec| cameras::read(spec, self.ignore_distortion))
    }

    /// Returns true if `--cameras` names all cameras of this file.
    pub(super) fn takes_cameras_of(&self, file: &Path) -> bool {
        self.cameras.as_deref().is_some_and(|spec| Path::new(spec) == file)
    }

    pub(super) fn json(&self) -> Option<&Path> {
        self.json.as_deref()
    }

    /// Measures the prices of `scene`, which was loaded from `path`, in `formats`, or in all if it is empty. Prints
    /// them or writes them to the file of `--json`, with the fields of `lost`. `truth` is the scene before splats or
    /// bands were left out; `None` if it is the same. Given cameras move with the scene. The written files are drawn with
    /// or without their tags as `load` says, as `scene` must be.
    pub(super) fn run(
        &self,
        scene: Scene,
        truth: Option<Scene>,
        (path, edit): (&Path, &EditArgs),
        formats: &[SceneFormat],
        load: &FileOptions,
        lost: Json,
    ) -> Result<Outcome> {
        let formats = if formats.is_empty() { &SceneFormat::WRITTEN } else { formats };
        let original = truth.as_ref().unwrap_or(&scene);
        let given =
            cameras::load_sized(self.cameras.as_deref(), Some(path), self.size, self.ignore_distortion)?;
        let given = given.map(|cameras| edit.moved(cameras)).transpose()?;
        // Use world coordinates: a format may or may not keep the scene's origin.
        let framing = || loading::framing_at(original, self.size).in_world(original.offset());
        let cameras = given.unwrap_or_else(|| vec![framing()]);
        let sized = |camera: Camera| match self.size {
            Some((width, height)) => camera.resized(width, height),
            None => camera,
        };
        let all: Vec<_> = cameras.into_iter().map(sized).collect();
        // Empty pictures are equal in every format.
        let (mut cameras, mut blind, of) = (Vec::new(), Vec::new(), all.len());
        for camera in all {
            let in_scene = camera.relative_to(original.offset());
            if blind::sees(original, &in_scene)? {
                cameras.push(camera);
            } else {
                blind.push(in_scene);
            }
        }
        if let Some(note) = blind::check(original, &blind, of).map_err(Error::msg)? {
            say(format!("{note}; their views are left out"));
        }
        let (splats, of) = (scene.count(), original.count());
        let empty = |format: &SceneFormat| {
            let note = losses::empty_bands(&scene, *format)?;
            Some(format!("{}: {note}\n", format.extension()))
        };
        let empty: String = formats.iter().filter_map(empty).collect();
        let prices = price::measure(scene, truth, &cameras, formats, load)?;
        match &self.json {
            Some(file) => {
                let all = json!({
                    "command": options::command_line(), "scene": options::text_of(path), "splats": splats, "original_splats": of,
                    "cameras": cameras, "backend": "reference", "prices": prices,
                });
                options::write_json(file, &options::with_fields(all, lost))?;
            }
            None => options::print((table(&prices) + &lost_lines(&prices) + &empty).trim_end())?,
        }
        Ok(Outcome::Done)
    }
}

/// Lists what the formats lose, a line for each loss, once for all versions of a format.
fn lost_lines(prices: &[Price]) -> String {
    let mut lines = Vec::new();
    for price in prices {
        let Found::Measured(found) = &price.found else { continue };
        let format = price.format.split(',').next().unwrap_or_default();
        for line in found.losses.iter().map(|loss| format!("{format}: lost: {loss}\n")) {
            if !lines.contains(&line) {
                lines.push(line);
            }
        }
    }
    lines.concat()
}

fn table(prices: &[Price]) -> String {
    let is_pooled = prices.iter().any(|price| match &price.found {
        Found::Measured(found) => found.scores.mean.needs_pooled(),
        Found::Refused { .. } => false,
    });
    let mut head =
        vec!["format", "bytes", "per splat", "load ms", "lowest PSNR dB", "PSNR dB", "SSIM", "FLIP"];
    head.extend(is_pooled.then_some("pooled PSNR dB"));
    let mut rows = Vec::new();
    let mut refused = String::new();
    for price in prices {
        let cells = match &price.found {
            Found::Measured(found) => {
                let mean = &found.scores.mean;
                [
                    grouped(found.bytes),
                    format!("{:.1}", found.bytes_per_splat),
                    format!("{:.1}", found.load_ms),
                    text::number(found.least_psnr_db.or(Some(f64::INFINITY)), 2),
                    text::number(mean.psnr_db, 2),
                    text::number(mean.ssim, 4),
                    text::number(mean.flip, 4),
                    text::number(mean.pooled_psnr_db, 2),
                ]
            }
            Found::Refused { cannot_be_written } => {
                refused += &format!("{}: cannot be written: {cannot_be_written}\n", price.format);
                std::array::from_fn(|_| "-".into())
            }
        };
        let mut row = [vec![price.format.clone()], cells.to_vec()].concat();
        row.truncate(head.len());
        rows.push(row);
    }
    text::table(head, rows) + &refused
}
