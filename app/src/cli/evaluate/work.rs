//! Reads the command line and the dataset of `splatgraph evaluate`: the cameras to draw, their photographs, and the
//! files.

use crate::cli::cameras;
use crate::cli::job::ShardArgs;
use crate::cli::options::{self, DeviceArgs, Listed};
use crate::cli::outcome::Usage;
use crate::cli::render::{Renderer, refuse_graph_options, renderer, renderers};
use crate::draw::backend::Api;
use crate::draw::projection::{self, ProjectionError};
use crate::io::image::Image;
use crate::io::load::LoadOptions;
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{OutputGuard, is_standard_output, one_line, say};
use crate::studies::evaluation::{Score, score};
use anyhow::{Context, Result, anyhow, bail};
use clap::ValueEnum;
use splatgraph_assets::{Camera, CameraOptions, Capture, Dataset, NERFSTUDIO, Scene, TEST_EVERY};
use std::path::{Path, PathBuf};

pub const EXAMPLES: &str = "Examples:
  splatgraph evaluate point_cloud.ply -c garden/
  splatgraph evaluate point_cloud.ply -c garden/ --downscale 4 --json
  splatgraph evaluate point_cloud.ply -c lego/ --background 1,1,1 -o scores/
  splatgraph evaluate point_cloud.ply -c garden/ --backend reference";

/// Score a scene against photographs: PSNR, SSIM and FLIP per test view, and their means
///
/// Draws the test views of a dataset at the photographs' size, and compares both. Test views are the dataset's own
/// (Blender, nerfstudio), or else every eighth photograph by name, as in the 3DGS reference implementation, or the
/// views of --split. A line on standard error says so. PSNR and SSIM are computed as in `compare`, and FLIP as its
/// `flip_8_bits`. The means over the views are comparable with published tables, except for the differences that
/// docs/formats.md lists.
///
/// A view does not stop the others if its photograph is missing, damaged or of another shape, or if its picture has
/// values that are not finite. The JSON lists it in `missing`, there are no means, and the exit code is 1.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[arg(help = options::scene_help())]
    pub scene: PathBuf,
    /// The dataset: a COLMAP folder, a folder with transforms_test.json, or a file of cameras
    #[arg(short, long, value_name = "DATASET")]
    pub cameras: PathBuf,
    /// Folder of the photographs [default: the dataset's]
    #[arg(long, value_name = "DIR")]
    pub photographs: Option<PathBuf>,
    /// Folder of masks: pixels that are black in a photograph's mask are not scored
    ///
    /// A mask is a PNG or JPEG of the photograph's shape and name, with another extension or with .png appended, as for
    /// COLMAP. Grey above one half counts. The scores are means over the pixels that count: of the squared error, and
    /// of the maps of SSIM and FLIP, for which the picture takes the photograph's other pixels. A view without a mask
    /// has no score.
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Compare at 1/N of the photographs' width and height
    ///
    /// Uses the photographs in a folder images_N beside images/ if that folder exists (for a transforms.json, beside
    /// the images/ in the photographs' names), and averages pixels otherwise.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: u32,
    /// Score all views, not only the test views
    #[arg(long)]
    pub all: bool,
    /// Test views of a dataset that names none: `every-8th` by name, or the tenth of a transforms.json that `nerfstudio`
    /// holds out by default [default: every-8th]
    #[arg(long, value_name = "every-8th|nerfstudio", hide_possible_values = true, conflicts_with = "all")]
    pub split: Option<Split>,
    /// The graph: the name of a built-in one, or a path
    #[arg(short, long, value_name = "NAME", default_value = options::DEFAULT_PIPELINE)]
    pub pipeline: String,
    /// Set a parameter of the graph; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    pub set: Vec<(String, String)>,
    /// Renderer: `vulkan`, `metal` (on Apple's systems), or `reference`, the exact renderer on the CPU
    #[arg(long, value_name = "NAME", default_value_t = Renderer::Device(Api::default()))]
    #[arg(value_parser = Listed(renderers, renderer), hide_possible_values = true)]
    pub backend: Renderer,
    /// Frames to draw of each view, whose state begins anew; the last is scored [default: 2 if the graph reads the
    /// previous frame, otherwise 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub repeat: Option<u32>,
    /// Background colour, display-encoded: 0 is black, 1 is white, also behind photographs with alpha
    #[arg(long, value_name = "R,G,B|#RRGGBB", default_value = "0,0,0", allow_hyphen_values = true, value_parser = options::colour)]
    pub background: [f32; 3],
    /// Print JSON instead of a table, or write it to FILE beside the table
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    pub json: Option<PathBuf>,
    /// Also write the pictures into DIR: renders/, photographs/ and differences/ (of what is scored, times ten)
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    #[command(flatten)]
    pub load: LoadOptions,
}

/// A rule for the test views of a dataset that names none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Split {
    #[value(name = EVERY_EIGHTH)]
    EveryEighth,
    #[value(name = NERFSTUDIO)]
    Nerfstudio,
}

const EVERY_EIGHTH: &str = "every-8th";

#[derive(Debug)]
pub struct View {
    pub name: String,
    pub photograph: std::io::Result<PathBuf>,
    /// Mask of the photograph; `None` without `--masks`.
    pub mask: Option<std::io::Result<PathBuf>>,
    /// Camera as in the dataset, at its own picture size.
    pub camera: Camera,
}

impl View {
    pub fn photograph(&self) -> Result<&Path> {
        self.photograph.as_deref().map_err(|error| anyhow!("{error}"))
    }

    /// Returns the camera of the picture to draw: at `1/downscale` of the photograph's size.
    ///
    /// # Errors
    /// The photograph cannot be read, its aspect ratio differs from the camera's by more than one pixel and one
    /// percent, or the picture is too large; see [`cameras::check_size`].
    pub fn drawn(&self, downscale: u32) -> Result<Camera> {
        let path = self.photograph()?;
        let (width, height) = Image::photograph_size(path)?;
        let (own_width, own_height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let expected = own_height * width as f64 / own_width;
        let off = (expected - height as f64).abs();
        // Tolerate a pixel of height; in a portrait, also a pixel of width.
        if off > f64::max(1.0, own_height / own_width) && off > 0.01 * expected {
            let is_turned = (height as f64, width as f64) == (own_width, own_height);
            let turned = if is_turned { "; an EXIF orientation is not read: rotate the pixels" } else { "" };
            bail!(
                "{}: expected a photograph of {own_width} x {own_height} pixels, or of that shape, found {width} x {height}{turned}",
                path.display()
            );
        }
        let [width, height] =
            [width, height].map(|side| (side as f64 / f64::from(downscale)).round().max(1.0) as u32);
        let camera = self.camera.stretched(width, height);
        cameras::check_size(&camera)?;
        Ok(camera)
    }

    pub fn mask(&self) -> Result<Option<&Path>> {
        let mask = self.mask.as_ref().map(|mask| mask.as_deref().map_err(|error| anyhow!("{error}")));
        mask.transpose()
    }

    /// Reads the mask of a photograph of the size `photograph`: true for the pixels that count, at the picture's size
    /// `drawn`. `None` without `--masks`.
    fn counts(&self, photograph: (usize, usize), drawn: (usize, usize)) -> Result<Option<Vec<bool>>> {
        let Some(path) = self.mask()? else { return Ok(None) };
        let mask = Image::load_photograph(path, [0.0; 3])?;
        let own = (mask.width, mask.height);
        // A mask may have another size than the photograph: beside reduced photographs, it often has the full size. The
        // sides of either may be rounded, by half a pixel of that picture.
        let [across, down] = [own.0 * photograph.1, own.1 * photograph.0];
        if across.abs_diff(down) > own.0.max(own.1).max(photograph.0).max(photograph.1) {
            let text = |(width, height): (usize, usize)| format!("{width} x {height}");
            bail!(
                "{}: expected a mask of the shape of {}, found {}",
                path.display(),
                text(photograph),
                text(own)
            );
        }
        let mask = if own == drawn { mask } else { mask.averaged(drawn.0, drawn.1) };
        let counts: Vec<bool> = mask.rgb.iter().map(|[grey, ..]| *grey > 0.5).collect();
        if !counts.contains(&true) {
            bail!("{}: expected a mask with pixels that count, found only black", path.display());
        }
        Ok(Some(counts))
    }

    /// Returns the camera of the picture to draw, the photograph at the picture's size, and the pixels that count, if
    /// there is a mask.
    ///
    /// # Errors
    /// See [`View::drawn`]; also, the photograph or the mask may be damaged, or the mask have another shape.
    pub fn load(&self, downscale: u32, background: [f32; 3]) -> Result<(Camera, Image, Option<Vec<bool>>)> {
        let camera = self.drawn(downscale)?;
        let drawn = (camera.width as usize, camera.height as usize);
        let photograph = Image::load_photograph(self.photograph()?, background)?;
        let own = (photograph.width, photograph.height);
        let photograph = if own == drawn { photograph } else { photograph.averaged(drawn.0, drawn.1) };
        Ok((camera, photograph, self.counts(own, drawn)?))
    }

    pub fn score(&self, drawn: &Image, photograph: &Image, mask: Option<&[bool]>) -> Result<Score> {
        let found = score(&self.name, drawn, photograph, mask);
        found.with_context(|| format!("{} cannot be scored", one_line(&self.name)))
    }
}

#[derive(Debug)]
pub struct Work {
    pub guard: OutputGuard,
    pub downscale: u32,
    /// Source of smaller photographs: a folder such as `images_2`, or `averaged`; `None` without `--downscale`.
    pub downscaled: Option<String>,
    pub views: Vec<View>,
    pub stems: Vec<String>,
    /// Source of the test views: `all`, [`EVERY_EIGHTH`], or [`Dataset::split`].
    pub split: &'static str,
    capture: Option<Capture>,
    /// True if a file says how nerfstudio moved the cameras before the training.
    is_aligned: bool,
}

impl Work {
    /// Warns the user if the cameras or the test views differ from those of the training, as far as the scene tells.
    pub fn tell_training(&self, args: &Args, scene: &Scene) {
        // `ns-export` writes "Generated by Nerstudio".
        let has_name = |comment: &String| {
            let comment = comment.to_ascii_lowercase();
            ["nerstudio", "nerfstudio"].iter().any(|name| comment.contains(name))
        };
        if !self.is_aligned && !scene.size_breakdown().comments.iter().any(has_name) {
            cameras::tell_off_center(self.views.iter().map(|view| &view.camera));
            return;
        }
        if self.capture.is_some() && !self.is_aligned {
            say(format!(
                "{}: nerfstudio trained the scene, and moves a capture before that: copy the dataparser_transforms.json of the training beside the cameras",
                args.cameras.display()
            ));
        }
        if self.capture == Some(Capture::Frames) && self.split == EVERY_EIGHTH && args.split.is_none() {
            say(
                "nerfstudio trained the scene, with some of these views: `--split nerfstudio` scores those that it holds out by default",
            );
        }
    }
}

/// Subfolders of `--output`.
pub const FOLDERS: [&str; 3] = ["renders", "photographs", "differences"];

/// Reads the cameras, finds the photographs, and checks the files of the command line.
pub fn prepare(args: &Args) -> Result<Work> {
    if let Renderer::Reference = args.backend {
        refuse_graph_options(&args.pipeline, &args.set, &args.device)?;
    }
    let photographs = args.photographs.as_deref();
    let nerfstudio_split = args.split == Some(Split::Nerfstudio);
    let options = CameraOptions { photographs, nerfstudio_split, ..CameraOptions::default() };
    let dataset = match args.cameras.to_str() {
        Some(spec) => Dataset::select(spec, options)?,
        None => Dataset::load_with(&args.cameras, options)?,
    };
    cameras::tell_alignment(&dataset);
    if let (Some(_), Some(named)) = (args.split, dataset.split.filter(|named| *named != NERFSTUDIO)) {
        let text = format!("expected a dataset that names no test views with --split, found `{named}`");
        return Err(Usage(text).into());
    }
    if args.masks.is_none() {
        cameras::tell_masks(&dataset);
    }
    if let (Some(name), Some(list), false) = (dataset.unmatched.first(), dataset.split, args.all) {
        let more = match dataset.unmatched.len() - 1 {
            0 => String::new(),
            more => format!(" and {more} more without a frame"),
        };
        bail!(
            "{}: `{list}`: expected photographs of frames, found {}{more}; --all scores all frames",
            args.cameras.display(),
            one_line(name)
        );
    }
    let is_reduced = args.photographs.is_none() && args.downscale > 1;
    let reduced = is_reduced.then(|| dataset.reduced(args.downscale)).flatten();
    let downscale = if reduced.is_some() { 1 } else { args.downscale };
    let found = reduced.as_ref().unwrap_or(&dataset);
    let count = found.views.len();
    let chosen: Vec<_> = if args.all { found.views.iter().collect() } else { found.test_views() };
    if chosen.is_empty() {
        bail!(
            "{}: expected at least one test view, found none among {count} views; --all scores all of them",
            args.cameras.display()
        );
    }
    let split = if args.all { "all" } else { dataset.split.unwrap_or(EVERY_EIGHTH) };
    let Some(folder) = args.photographs.as_ref().or(found.photographs.as_ref()) else {
        let factors = dataset.reduced_factors();
        let found = match factors.first() {
            Some(factor) => {
                let names: Vec<String> = factors.iter().map(|factor| format!("images_{factor}")).collect();
                format!("found {}: --downscale {factor} takes images_{factor}", names.join(", "))
            }
            None => "found none: name it with --photographs".into(),
        };
        let cameras = args.cameras.display();
        let text = format!("{cameras}: expected a folder `images` near the cameras, {found}");
        return Err(Usage(text).into());
    };
    if let Renderer::Device(_) = args.backend {
        projection::shared(&chosen.iter().map(|view| view.camera.clone()).collect::<Vec<_>>())?;
        // A photograph is no picture of another projection, so pinholes are not converted. A graph's errors are
        // reported when it is built.
        let graph = projection::of_graph(&args.pipeline, &args.set);
        let other = |graph| chosen.iter().find(|view| view.camera.projection != graph).zip(Some(graph));
        if let Some((view, graph)) = graph.and_then(other) {
            let error = ProjectionError { graph, camera: view.camera.projection };
            bail!("{}: {error}", one_line(&view.photograph));
        }
    }
    let mask = |folder: &Path, photograph: &str| {
        cameras::beside_photograph(folder, photograph).ok_or_else(|| {
            let name = one_line(photograph);
            std::io::Error::other(format!("expected the mask {name}.png in {}, found none", folder.display()))
        })
    };
    let view = |view: &splatgraph_assets::View| View {
        name: view.photograph.clone(),
        photograph: Dataset::photograph_in(folder, &view.photograph),
        mask: args.masks.as_deref().map(|masks| mask(masks, &view.photograph)),
        camera: view.camera.clone(),
    };
    let views: Vec<View> = chosen.into_iter().map(view).collect();
    if views.iter().all(|view| view.photograph.is_err()) {
        views[0].photograph()?;
    }
    if views.iter().all(|view| view.mask().is_err()) {
        views[0].mask()?;
    }
    let is_photograph = |view: &&View| {
        let real = |path: Option<&Path>| path.and_then(|path| path.canonicalize().ok());
        let mask = real(view.mask().ok().flatten());
        mask.is_some() && mask == real(view.photograph().ok())
    };
    if let Some(view) = views.iter().find(is_photograph) {
        bail!(
            "{}: expected a folder of masks for --masks, found the photograph",
            view.photograph()?.display()
        );
    }
    let names: Vec<String> = views.iter().map(|view| view.camera.img_name.clone()).collect();
    let stems = names::unique(&names, MAX_NAME_BYTES - ".png".len());
    let mut guard = OutputGuard::default();
    let mut claim = || -> Result<(), Usage> {
        guard.scene("the scene", &args.scene)?;
        cameras::claim_dataset(&mut guard, &dataset)?;
        if dataset.photographs.as_ref() != Some(folder) {
            cameras::claim_photographs(&mut guard, folder, &found.views)?;
        }
        for mask in views.iter().filter_map(|view| view.mask().ok().flatten()) {
            guard.input("a mask", mask)?;
        }
        guard.input("the graph", Path::new(&args.pipeline))?;
        args.json.iter().try_for_each(|path| guard.output("--json", path))?;
        if let Some(output) = &args.output {
            if is_standard_output(output) {
                return Err(Usage("expected a folder for --output, found `-`".into()));
            }
            for (folder, stem) in
                FOLDERS.iter().flat_map(|folder| stems.iter().map(move |stem| (folder, stem)))
            {
                guard.output("--output", &picture(output, folder, stem))?;
            }
        }
        Ok(())
    };
    claim()?;
    let rule = match split {
        EVERY_EIGHTH => Some(format!("every {TEST_EVERY}th view by name")),
        NERFSTUDIO => Some("the views that nerfstudio holds out by default".into()),
        "val_filenames" => Some("`val_filenames`, as there is no `test_filenames`".into()),
        "train_filenames" => Some("the views that are not in `train_filenames`".into()),
        _ => None,
    };
    if let Some(rule) = rule.filter(|_| views.len() < count) {
        say(format!("scored: {rule}, {} of {count}; --all scores all", views.len()));
    }
    let downscaled = (args.downscale > 1).then(|| match reduced {
        Some(_) => format!("images_{}", args.downscale),
        None => "averaged".into(),
    });
    match downscaled.as_deref() {
        Some("averaged") => say(format!("the photographs are averaged to 1/{downscale} of their size{}", {
            // `--photographs images_2 --downscale 2`.
            let sizes =
                views.iter().find_map(|view| Some((view.drawn(downscale).ok()?.width, view.camera.width)));
            let smaller = sizes.filter(|(drawn, own)| drawn * downscale + downscale < *own);
            smaller.map_or(String::new(), |(drawn, own)| {
                format!(", to {drawn} pixels across: they were reduced before, as the cameras have {own}")
            })
        })),
        Some(folder) => say(format!("the photographs are those of {folder}")),
        None => {}
    }
    let (capture, is_aligned) = (dataset.capture, dataset.alignment.is_some());
    Ok(Work { guard, downscale, downscaled, views, stems, split, capture, is_aligned })
}

pub fn picture(output: &Path, folder: &str, stem: &str) -> PathBuf {
    output.join(folder).join(format!("{stem}.png"))
}
