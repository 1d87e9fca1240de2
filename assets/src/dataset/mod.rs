//! Reads cameras with the names of their photographs: the datasets that scenes are trained on.
//!
//! | dataset | recognised by |
//! |---|---|
//! | COLMAP, text or binary | a file `cameras` or `images`; a folder with both in it, in `sparse/0`, `sparse` or `0` |
//! | Blender, nerfstudio, instant-ngp | a JSON object with `frames`, or a folder with `transforms*.json` |
//! | a path of nerfstudio's viewer | a JSON object with `camera_path` |
//! | the 3DGS reference implementation's `cameras.json` | a JSON list, or a folder with that file |
//! | glTF, the cameras of the default scene | `glTF` in the first four bytes, or the extension `.gltf` |
//!
//! Cameras are pinholes, or have another [`Projection`](crate::Projection) if the dataset names one. A lens with
//! distortion is refused, unless [`CameraOptions`] ignores its distortion. Principal points are those of the dataset;
//! the reference moves them to the images' centres.

mod alignment;
mod colmap;
mod error;
mod json;
pub mod photograph;
mod view;

use alignment::Applied;
pub use error::{CameraError, MAX_CAMERA_BYTES};
pub use view::{CameraOptions, Capture, Crop, Dataset, FrameTiming, NERFSTUDIO, View, unnamed};

use crate::camera::Camera;
use crate::file;
use crate::gltf;
use crate::input::{OpenFile, Source};
use std::collections::HashSet;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Sampling stride of test views if the dataset does not specify any, as in the reference implementation (`llffhold`).
pub const TEST_EVERY: usize = 8;

/// Lists the folder of a COLMAP model and the three around it. Photographs and other files are looked for in these
/// folders.
fn around_model(folder: &Path) -> Vec<PathBuf> {
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let folder = here.canonicalize().unwrap_or_else(|_| here.to_owned());
    folder.ancestors().take(4).map(Path::to_owned).collect()
}

impl Dataset {
    /// Reads the cameras of a folder or a file in any of the module's formats.
    ///
    /// # Errors
    /// No format is recognised, the file cannot be read, or a camera is malformed or has distortion. The error names
    /// the file, and if possible the line or byte and the field.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, CameraError> {
        Self::load_with(path.as_ref(), CameraOptions::default())
    }

    /// Reads a dataset as [`Dataset::load`] does, with options.
    ///
    /// # Errors
    /// The errors of [`Dataset::load`].
    pub fn load_with(path: &Path, options: CameraOptions) -> Result<Self, CameraError> {
        let mut dataset = Self::load_sized(path, options, None)?;
        if options.nerfstudio_split && dataset.split.is_none() && !dataset.views.is_empty() {
            dataset.split_as_nerfstudio();
        }
        Ok(dataset)
    }

    /// Chooses test views as nerfstudio does for a `transforms.json` without lists (`get_train_eval_split_fraction`):
    /// those between nine tenths of the views, which are spread evenly.
    fn split_as_nerfstudio(&mut self) {
        const TRAIN_SHARE: f64 = 0.9;
        let count = self.views.len();
        let last = (TRAIN_SHARE * count as f64).ceil() as usize - 1;
        // The rounding of `numpy.linspace`.
        let step = count.saturating_sub(1) as f64 / last.max(1) as f64;
        let mut train: HashSet<usize> = (0..last).map(|index| (index as f64 * step) as usize).collect();
        train.insert(count - 1);
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| self.views[*a].photograph.cmp(&self.views[*b].photograph));
        for (rank, index) in order.into_iter().enumerate() {
            self.views[index].test = Some(!train.contains(&rank));
        }
        self.split = Some(NERFSTUDIO);
    }

    /// Reads a dataset as [`Dataset::load_with`] does. `fallback` is the size if no photograph can be read.
    fn load_sized(
        path: &Path,
        options: CameraOptions,
        fallback: Option<(u32, u32)>,
    ) -> Result<Self, CameraError> {
        if path.is_dir() {
            return Self::load_folder(path, options);
        }
        // COLMAP's files come in pairs; either one identifies the model.
        if let Some(folder) = path.parent().filter(|_| colmap::has_name_of_model(path)) {
            return Self::load_colmap(folder, options);
        }
        if let Some(dataset) = Self::load_gltf(path)? {
            return Ok(dataset);
        }
        let text = file::read_text(path, MAX_CAMERA_BYTES).map_err(|error| match error.kind() {
            // Not UTF-8.
            ErrorKind::InvalidData => CameraError::UnknownFormat { path: path.to_owned() },
            _ => CameraError::io(path)(error),
        })?;
        let (mut dataset, applied) = json::parse(&text, path, options, fallback)?;
        dataset.files.push(path.to_owned());
        if let Some((file, applied)) = path.parent().and_then(alignment::beside).zip(applied.as_ref()) {
            alignment::apply(&mut dataset, file, applied)?;
        }
        // Blender's scenes have a file for each split.
        let test = match path.file_stem().and_then(|stem| stem.to_str()) {
            Some("transforms_test") => Some(true),
            Some("transforms_train" | "transforms_val") => Some(false),
            _ => None,
        };
        dataset.views.iter_mut().for_each(|view| view.test = view.test.or(test));
        dataset.split = dataset.split.or(test.map(|_| "transforms_test"));
        dataset.capture = applied.filter(|_| test.is_none()).map(|_| Capture::Frames);
        Ok(dataset)
    }

    /// Parses the text of a `cameras.json`, a `transforms.json` or a `camera_path.json`. Errors name `path`;
    /// photographs are in its folder. A `dataparser_transforms.json` there is not read.
    ///
    /// # Errors
    /// The errors of [`Dataset::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, CameraError> {
        Self::parse_with(text, path, CameraOptions::default())
    }

    /// Parses a text as [`Dataset::parse`] does, with options.
    ///
    /// # Errors
    /// The errors of [`Dataset::load`].
    pub fn parse_with(text: &str, path: &Path, options: CameraOptions) -> Result<Self, CameraError> {
        json::parse(text, path, options, None).map(|(dataset, _)| dataset)
    }

    fn load_folder(folder: &Path, options: CameraOptions) -> Result<Self, CameraError> {
        for below in ["", "sparse/0", "sparse", "0"] {
            let colmap = folder.join(below);
            if colmap::is_folder(&colmap) {
                let mut dataset = Self::load_colmap(&colmap, options)?;
                if below.ends_with('0') {
                    dataset.other_models = colmap::beside(&colmap);
                }
                return Ok(dataset);
            }
        }
        let splits = ["test", "train", "val"].map(|split| folder.join(format!("transforms_{split}.json")));
        if splits[0].exists() {
            let mut dataset = Self::load_with(&splits[0], options)?;
            // The photographs of the other splits may not be there: only test views are scored.
            let size = dataset.views.first().map(|view| (view.camera.width, view.camera.height));
            for file in splits[1..].iter().filter(|file| file.exists()) {
                let split = Self::load_sized(file, options, size)?;
                dataset.has_masks |= split.has_masks;
                dataset.files.extend(split.files);
                dataset.views.extend(split.views);
            }
            return Ok(dataset);
        }
        let mut files = ["transforms.json", "transforms_train.json", "transforms_val.json", "cameras.json"]
            .map(|name| folder.join(name))
            .into_iter();
        let file = files.find(|file| file.exists());
        let none = || Err(CameraError::NoCameras { path: folder.to_owned() });
        file.map_or_else(none, |file| Self::load_with(&file, options))
    }

    /// Reads the cameras of a glTF file; `None` for a file with neither its magic number nor the extension `.gltf`.
    fn load_gltf(path: &Path) -> Result<Option<Self>, CameraError> {
        let is_text = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gltf"));
        let mut head = [0; gltf::MAGIC.len()];
        let mut read = || file::open(path).and_then(|mut file| file.read_exact(&mut head));
        if !(is_text || read().is_ok() && head == *gltf::MAGIC) {
            return Ok(None);
        }
        let file = OpenFile::open(path).map_err(CameraError::io(path))?;
        let (cameras, has_animation) = gltf::cameras(&Source::File(&file))
            .map_err(|problem| CameraError::invalid(path, String::new(), problem.to_string()))?;
        if cameras.is_empty() {
            return Err(CameraError::Empty { path: path.to_owned() });
        }
        let view = |camera: Camera| View { photograph: camera.img_name.clone(), camera, test: None };
        let views = cameras.into_iter().map(view).collect();
        Ok(Some(Self { views, files: vec![path.to_owned()], has_animation, ..Self::default() }))
    }

    fn load_colmap(folder: &Path, options: CameraOptions) -> Result<Self, CameraError> {
        let mut dataset = colmap::load(folder, options.ignore_distortion)?;
        dataset.capture = Some(Capture::Colmap);
        let around = around_model(folder);
        dataset.photographs =
            around.iter().map(|around| around.join("images")).find(|images| images.is_dir());
        if let Some(file) = around.iter().find_map(|around| alignment::beside(around)) {
            alignment::apply(&mut dataset, file, &Applied::default())?;
        }
        Ok(dataset)
    }

    /// Reads the dataset of `path`, or a selection of its views.
    ///
    /// `path#name` is one view, by a camera's `img_name` or its photograph's name. `path#2` is the view with that index
    /// from 0, unless a camera has that name; without names, so is `path#camera2` (see [`unnamed`]). `path#front/*` are
    /// the views whose names begin with `front/`; their test views are those of the whole dataset.
    ///
    /// # Errors
    /// The errors of [`Dataset::load`], the dataset is empty, or there is no such camera.
    pub fn select(spec: &str, options: CameraOptions) -> Result<Self, CameraError> {
        // If the whole text names a file, the `#` is part of the file's name.
        let (path, wanted) = match spec.rsplit_once('#') {
            Some((path, wanted)) if !Path::new(spec).exists() => (Path::new(path), Some(wanted)),
            _ => (Path::new(spec), None),
        };
        let mut dataset = Self::load_with(path, options)?;
        if dataset.views.is_empty() {
            return Err(CameraError::Empty { path: path.to_owned() });
        }
        let Some(wanted) = wanted else { return Ok(dataset) };
        let begins = |view: &View, start: &str| view.camera.img_name.starts_with(start);
        if let Some(start) = wanted.strip_suffix('*')
            && dataset.views.iter().any(|view| begins(view, start))
        {
            // Test views are chosen from the whole dataset, before the other views are dropped.
            let tests: HashSet<String> =
                dataset.test_views().iter().map(|view| view.photograph.clone()).collect();
            dataset.views.iter_mut().for_each(|view| view.test = Some(tests.contains(&view.photograph)));
            dataset.views.retain(|view| begins(view, start));
            return Ok(dataset);
        }
        // Names of frames are often numbers, so they come before indices.
        let named = |name: &str| dataset.views.iter().position(|view| view.camera.img_name == name);
        // `000003` is not an index but a frame's name, which follows a folder's name in a rig.
        let is_index = |index: &usize| *index < dataset.views.len() && index.to_string() == wanted;
        let numbered = || wanted.parse().ok().filter(is_index);
        let by_name = named(wanted).or_else(|| named(photograph::stem(wanted)));
        let count = dataset.views.len();
        let has_no_name = |index: &usize| dataset.views[*index].camera.img_name.is_empty();
        let called = || (0..count).filter(has_no_name).find(|index| unnamed(*index, count) == wanted);
        let Some(index) = by_name.or_else(numbered).or_else(called) else {
            let names = dataset.views.iter().map(|view| view.camera.img_name.clone());
            return Err(CameraError::NotFound {
                path: path.to_owned(),
                wanted: wanted.to_owned(),
                count,
                names: names.filter(|name| !name.is_empty()).take(8).collect(),
            });
        };
        let name = &dataset.views[index].camera.img_name;
        let equal = || dataset.views.iter().enumerate().filter(|(_, view)| view.camera.img_name == *name);
        if by_name.is_some() {
            dataset.same_name = equal().nth(1).map(|(next, _)| (equal().count(), next));
        }
        let mut view = dataset.views.swap_remove(index);
        if view.camera.img_name.is_empty() {
            view.camera.img_name = unnamed(index, count);
        }
        (dataset.views, dataset.timing) = (vec![view], None);
        Ok(dataset)
    }

    /// Returns the test views: the dataset's own, or every eighth in the order of the photographs' names. The first
    /// view is then a test view.
    pub fn test_views(&self) -> Vec<&View> {
        if self.views.iter().any(|view| view.test.is_some()) {
            return self.views.iter().filter(|view| view.test == Some(true)).collect();
        }
        let mut views: Vec<&View> = self.views.iter().collect();
        views.sort_by(|a, b| a.photograph.cmp(&b.photograph));
        views.into_iter().step_by(TEST_EVERY).collect()
    }

    /// Lists the factors N, 2 or more, of the folders `images_N` of a COLMAP dataset, in ascending order. Downloads
    /// often have them without `images`.
    pub fn reduced_factors(&self) -> Vec<u32> {
        let names = self.around().into_iter().filter_map(|around| around.read_dir().ok()).flatten().flatten();
        let factor = |name: &str| name.strip_prefix("images_")?.parse().ok().filter(|factor| *factor > 1);
        let mut factors: Vec<u32> = names.filter_map(|entry| factor(entry.file_name().to_str()?)).collect();
        factors.sort_unstable();
        factors.dedup();
        factors
    }

    /// Lists the folders in which the photographs of a COLMAP model are looked for; none for other datasets.
    fn around(&self) -> Vec<PathBuf> {
        let is_model = |file: &&PathBuf| colmap::has_name_of_model(file);
        let model = self.files.first().filter(is_model).and_then(|file| file.parent());
        model.map(around_model).unwrap_or_default()
    }

    /// Returns the dataset with smaller photographs, from folders `images_N` with N the `factor`. The folders are
    /// beside `images`, or near a COLMAP model without `images`. The cameras keep their sizes. `None` unless there is
    /// such a folder for every photograph.
    pub fn reduced(&self, factor: u32) -> Option<Self> {
        let Some(folder) = &self.photographs else {
            let mut folders = self.around().into_iter().map(|around| around.join(format!("images_{factor}")));
            let folder = folders.find(|folder| folder.is_dir())?;
            return Some(Self { photographs: Some(folder), ..self.clone() });
        };
        let beside = |images: &Path| images.with_file_name(format!("images_{factor}"));
        if folder.ends_with("images") {
            let photographs = Some(beside(folder)).filter(|folder| folder.is_dir());
            return photographs.map(|folder| Self { photographs: Some(folder), ..self.clone() });
        }
        let reduced = |view: &View| {
            let path = Path::new(&view.photograph);
            let images = path.ancestors().skip(1).find(|around| around.ends_with("images"))?;
            let smaller = beside(images).join(path.strip_prefix(images).ok()?);
            let found = folder.join(beside(images)).is_dir();
            found.then(|| View { photograph: smaller.display().to_string(), ..view.clone() })
        };
        let views = self.views.iter().map(reduced).collect::<Option<_>>()?;
        Some(Self { views, ..self.clone() })
    }

    /// Finds the file of a photograph in `folder`. The extension of `name` may be missing or differ.
    ///
    /// # Errors
    /// There is no such file, or its name leads neither into `folder` nor into its parent.
    pub fn photograph_in(folder: &Path, name: &str) -> std::io::Result<PathBuf> {
        photograph::find(folder, name)
    }

    /// Formats the files of a COLMAP model, with their names: `cameras.txt`, `images.txt` and a `points3D.txt` without
    /// points.
    ///
    /// A photograph's name is its camera's `img_name`, a dot and `extension`.
    ///
    /// # Errors
    /// A camera is neither a pinhole nor a fisheye.
    pub fn colmap_text(
        cameras: &[Camera],
        extension: &str,
    ) -> Result<[(&'static str, String); 3], CameraError> {
        colmap::text::write(cameras, extension)
    }
}

impl Camera {
    /// Reads the cameras of a [`Dataset`], in the world's coordinates; see [`Camera::relative_to`].
    ///
    /// # Errors
    /// The errors of [`Dataset::load`].
    pub fn load(path: impl AsRef<Path>) -> Result<Vec<Self>, CameraError> {
        Dataset::load(path).map(Dataset::into_cameras)
    }

    /// Parses the text of cameras in JSON, as [`Dataset::parse`] does.
    ///
    /// # Errors
    /// The errors of [`Dataset::parse`].
    pub fn parse(text: &str, path: &Path) -> Result<Vec<Self>, CameraError> {
        Dataset::parse(text, path).map(Dataset::into_cameras)
    }

    /// Writes a `cameras.json`; replaces an existing file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(cameras: &[Self], path: impl AsRef<Path>) -> Result<(), CameraError> {
        let path = path.as_ref();
        let written = || {
            let text = serde_json::to_string_pretty(cameras)?;
            std::fs::write(path, text + "\n")
        };
        written().map_err(CameraError::io(path))
    }
}

impl Dataset {
    /// Returns the cameras, without their photographs.
    pub fn into_cameras(self) -> Vec<Camera> {
        self.views.into_iter().map(|view| view.camera).collect()
    }
}

#[cfg(test)]
mod tests;
