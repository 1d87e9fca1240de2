//! Reads the images that a frame has besides its picture (alpha, depths, normals and others) as arrays and files.
//!
//! A graph declares them under `outputs`. [`Session::set_outputs`] requests some of them; a plan does no work for the
//! others. [`draw`] draws a frame and returns its colours with its outputs. docs/splatting.md defines the built-in
//! graphs' outputs.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use splatgraph::draw::{backend::{Api, Backend}, outputs, session::Session};
//! use splatgraph_assets::{Camera, synth};
//!
//! let scene = synth::generate("uniform", 500, 0)?;
//! let camera = Camera::framing(&scene, 64, 48);
//! let mut session = Session::new(Backend::open(Api::default(), &Default::default())?, scene, "auto", &[]);
//! session.set_outputs(&["alpha".into(), "expected_depth".into()]);
//! let frame = outputs::draw(&mut session, &camera, [0.0; 3])?;
//! assert_eq!(frame.colour.rgb.len(), 64 * 48);
//! assert_eq!((frame.outputs[1].name.as_str(), &frame.outputs[1].shape[..]), ("expected_depth", &[48, 64][..]));
//! # Ok(())
//! # }
//! ```

use crate::draw::inspect::{Finding, Words};
use crate::draw::session::{FrameOptions, PixelsError, Session, SessionError, image_of};
use crate::io::image::{
    Format, Image, ImageError, NotFinite, Samples, save_rgba_png, save_values, save_words,
};
use crate::io::output::OutputError;
use splatgraph_api::Inspect;
use splatgraph_assets::{Camera, NEAR, Projection};
use splatgraph_framework::ir::{Format as Pixel, PassId, Shape, Value, Work};
use splatgraph_framework::plan::Plan;
use std::borrow::Cow;
use std::f64::consts::FRAC_PI_2;
use std::path::Path;

/// Names of the built-in graphs' outputs, each with a description.
pub const NAMES: [(&str, &str); 7] = [
    ("alpha", "the share of the pixel that splats cover, 0 to 1"),
    ("depth", "the sum of the depths of the splats' centres, each times its share of the pixel (gsplat's D)"),
    ("expected_depth", "the mean depth of the splats' centres: `depth` divided by `alpha` (gsplat's ED)"),
    (
        "median_depth",
        "the depth of the centre of the last splat that more than half of the light reaches; 0 without splats",
    ),
    ("normal", "the sum of the splats' normals in the world, each times its share"),
    ("contributors", "the number of splats that are blended (uint32)"),
    ("index", "the index of the splat with the largest share; 4294967295 without splats (uint32)"),
];

/// Name of the built-in output with three channels.
const NORMAL: &str = "normal";

/// The output that is made from the picture and `alpha`, with its description. It is not in [`NAMES`], because no graph
/// declares it.
pub const RGBA: (&str, &str) = (
    "rgba",
    "the picture without its background, with alpha: straight in .png, premultiplied in .exr and .npy",
);

/// An image of a frame besides its picture, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// Name of the output in the graph.
    pub name: String,
    /// Shape: `[height, width]`, or `[height, width, channels]`.
    pub shape: Vec<u64>,
    /// Values in row-major order: the last dimension varies fastest.
    pub words: Words,
    /// True if depths are distances from the camera, because splats are sorted by distance.
    pub by_distance: bool,
}

/// A drawn frame, with its outputs.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Picture over the background: display-encoded, not clamped.
    pub colour: Image,
    /// Outputs requested with [`Session::set_outputs`], in the order of the graph.
    pub outputs: Vec<Output>,
    /// The graph's counts, such as `visible` and `drawn`.
    pub counts: Vec<(String, u32)>,
}

/// Draws a frame at the camera's size, and reads back its picture and outputs.
///
/// Builds and loads the plan if necessary. The camera is in the scene's coordinates, as for [`Session::submit`]. The
/// background is display-encoded.
///
/// # Errors
/// The graph has errors or lacks an output, the device fails, or the picture has no colours.
pub fn draw(session: &mut Session, camera: &Camera, background: [f32; 3]) -> Result<Frame, SessionError> {
    session.prepare((camera.width, camera.height), &mut |_| {})?;
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    let inspect = inspections(plan);
    let options = FrameOptions { background, read_output: true, inspect, ..FrameOptions::default() };
    let frame = session.submit(camera, &options)?;
    let result = session.wait(frame)?;
    let colour = image_of(result.output.as_ref().ok_or(PixelsError::Missing)?)?;
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    Ok(Frame { colour, outputs: read(plan, &result.inspected), counts: result.stats })
}

/// Returns true if the plan sorts splats by their distance from the camera.
pub fn sorts_by_distance(plan: &Plan) -> bool {
    let by_distance = Value::Text("distance".into());
    plan.params.iter().any(|param| param.name == "key_of" && param.value == by_distance)
}

/// Reports that depth outputs contain distances from the camera, for a picture whose splats are sorted by distance.
///
/// `None` if `outputs` names no depth. `change` is the option that sorts by view depth.
pub fn distance_note<'a>(outputs: impl IntoIterator<Item = &'a str>, change: &str) -> Option<String> {
    let depths: Vec<String> =
        outputs.into_iter().filter(|name| name.ends_with("depth")).map(|name| format!("`{name}`")).collect();
    (!depths.is_empty()).then(|| {
        format!(
            "{}: distances from the camera, not view depths, because the scene's splats are sorted by distance; {change} sorts by view depth",
            depths.join(", ")
        )
    })
}

/// Reports that a plan sorts by view depth and so leaves out what is behind a camera that shows it.
///
/// `None` if the settings choose the order.
pub fn behind_note(plan: &Plan, set: &[(String, String)], camera: &Camera) -> Option<String> {
    let by_depth = Value::Text("depth".into());
    let leaves_out = plan.params.iter().any(|param| param.name == "key_of" && param.value == by_depth);
    let asked = set.iter().any(|(name, _)| name == "key_of");
    (leaves_out && !asked && shows_behind(camera)).then(|| {
        format!(
            "{}: what is behind the camera is not drawn, nor are splats at a view depth below {NEAR}; --set \
             key_of=distance draws them",
            plan.name
        )
    })
}

/// Returns true if a picture has directions of more than 90 degrees from the camera's axis.
fn shows_behind(camera: &Camera) -> bool {
    let [x, y] = camera.principal_point();
    let across = x.max(f64::from(camera.width) - x) / camera.fx;
    let down = y.max(f64::from(camera.height) - y) / camera.fy;
    match camera.projection {
        Projection::Equirectangular => true,
        Projection::Fisheye => across.hypot(down) > FRAC_PI_2,
        Projection::Pinhole | Projection::Orthographic => false,
    }
}

/// Reports that outputs do not contain the mesh, for a picture that does. `None` without outputs.
pub fn mesh_note<'a>(outputs: impl IntoIterator<Item = &'a str>) -> Option<String> {
    let names: Vec<String> = outputs.into_iter().map(|name| format!("`{name}`")).collect();
    let what = "of the splats in front of the mesh, without the mesh itself";
    (!names.is_empty()).then(|| format!("{}: {what}", names.join(", ")))
}

/// Lists the plan's outputs as inspections after the export of the picture, in plan order.
pub fn inspections(plan: &Plan) -> Vec<Inspect> {
    let mut ids = (0..plan.passes.len() as u32).map(PassId);
    let after = ids.rfind(|id| plan.pass(*id).work == Work::Export);
    let output = |after| plan.outputs.iter().map(move |output| Inspect { resource: output.image, after });
    after.into_iter().flat_map(output).collect()
}

/// Interprets the bytes of a frame's [`inspections`] as outputs. The fourth channel of `normal` is dropped.
pub fn read(plan: &Plan, inspected: &[Vec<u8>]) -> Vec<Output> {
    let outputs = plan.outputs.iter().zip(inspections(plan)).zip(inspected);
    let by_distance = sorts_by_distance(plan);
    let output = |((output, target), bytes): ((&splatgraph_framework::ir::Output, Inspect), &Vec<u8>)| {
        let Finding { mut shape, mut words, .. } = Finding::new(plan, &target, bytes, &[]);
        // Images have one or four channels. A graph's own output may use all.
        if let (NORMAL, [.., channels @ 4], Words::Float(values)) =
            (output.name.as_str(), &mut shape[..], &mut words)
        {
            *channels = 3;
            *values = values.chunks_exact(4).flat_map(|pixel| &pixel[..3]).copied().collect();
        }
        Output { name: output.name.clone(), shape, words, by_distance }
    };
    outputs.map(output).collect()
}

/// Returns the name of the graph's output that the output `name` needs: `alpha` for [`RGBA`], otherwise the same name.
pub fn source_of(name: &str) -> &str {
    if name == RGBA.0 { "alpha" } else { name }
}

/// Returns the output `name`: [`RGBA`] is computed from `picture` and `source`, any other output is `source` itself.
///
/// `source` is the output that [`source_of`] names. `background` is the picture's, display-encoded. Returns `None` if
/// `source` is missing, or for [`RGBA`], if `picture` is missing or `source` is not one float per pixel of it.
pub fn named<'a>(
    name: &str,
    source: Option<&'a Output>,
    picture: Option<&Image>,
    background: [f32; 3],
) -> Option<Cow<'a, Output>> {
    match name == RGBA.0 {
        true => rgba(picture?, source?, background).map(Cow::Owned),
        false => source.map(Cow::Borrowed),
    }
}

/// Makes the output [`RGBA`]: colours premultiplied by alpha, display-encoded, and alpha. The shape is
/// `[height, width, 4]`.
///
/// `background` is the picture's, display-encoded. Returns `None` if `alpha` is not one float per pixel of the picture.
fn rgba(picture: &Image, alpha: &Output, background: [f32; 3]) -> Option<Output> {
    let Words::Float(alpha) = &alpha.words else { return None };
    if alpha.len() != picture.rgb.len() {
        return None;
    }
    let pixel = |(rgb, alpha): (&[f32; 3], &f32)| {
        let [r, g, b] = std::array::from_fn(|c| rgb[c] - (1.0 - alpha) * background[c]);
        [r, g, b, *alpha]
    };
    let values = picture.rgb.iter().zip(alpha).flat_map(pixel).collect();
    let shape = vec![picture.height as u64, picture.width as u64, 4];
    Some(Output { name: RGBA.0.into(), shape, words: Words::Float(values), by_distance: false })
}

const NO_INTEGERS: &str = "expected the extension .npy or .exr: PNG cannot store 32-bit integers";

/// Checks that the output named `name` can be written in a format, as [`Output::save`] does.
///
/// # Errors
/// The format is not possible. The error lists the possible formats.
pub fn check_format(name: &str, format: Format) -> Result<(), String> {
    let expected = match (name, format) {
        ("contributors" | "index", Format::Png) => NO_INTEGERS,
        ("depth" | "expected_depth" | "median_depth", Format::Png) => {
            "expected the extension .npy or .exr: PNG values end at 1, and depths exceed it"
        }
        _ => return Ok(()),
    };
    Err(format!("{expected} (output `{name}`)"))
}

/// Checks that a plan's outputs can be written in the formats of their files, before a frame is drawn.
///
/// # Errors
/// An output of integers has a PNG file.
pub fn check_formats<'a>(
    plan: &Plan,
    files: impl IntoIterator<Item = (&'a str, Format)>,
) -> Result<(), String> {
    let is_integer = |name: &str| {
        let mut named = plan.outputs.iter().filter(|output| output.name == name);
        named.any(|output| {
            matches!(plan.resource(output.image).shape, Shape::Image { format: Pixel::R32Uint, .. })
        })
    };
    let mut refused = files.into_iter().filter(|(name, format)| *format == Format::Png && is_integer(name));
    refused.next().map_or(Ok(()), |(name, _)| Err(format!("{NO_INTEGERS} (output `{name}`)")))
}

impl Output {
    /// Writes the values in the extension's format: `.npy` and `.exr` keep floats or integers, `.png` is a picture.
    ///
    /// In a PNG, a normal is normalised and becomes the colour (n + 1) / 2, or black if it is zero. [`RGBA`] is written
    /// with straight alpha in a PNG, and premultiplied in the other formats; the PNG of another output shows the first
    /// three channels. Returns the number of pixels that the format cannot hold; `None` for formats that hold all
    /// values.
    ///
    /// # Errors
    /// The extension is not one of `.npy`, `.exr` and `.png`, [`check_format`] refuses the format, or the file cannot
    /// be written.
    pub fn save(&self, path: &Path) -> Result<Option<NotFinite>, ImageError> {
        if let Some(format) = Format::of(path) {
            let refused = |why: String| OutputError { path: path.to_owned(), cause: why.into() };
            check_format(&self.name, format).map_err(refused)?;
        }
        let (width, channels) = (self.shape[1] as usize, self.shape.get(2).map_or(1, |n| *n as usize));
        let size = (width, self.shape[0] as usize);
        if Format::of(path) == Some(Format::Exr) {
            let samples = match &self.words {
                Words::Float(values) => Samples::Float(values),
                Words::Uint(words) => Samples::Uint(words),
            };
            let names: &[&str] = match (channels, self.name.as_str()) {
                (1, "alpha") => &["A"],
                (1, "depth" | "expected_depth" | "median_depth") => &["Z"],
                (1, "index" | "contributors") => &[&self.name],
                (1, _) => &["Y"],
                (3, NORMAL) => &["N.X", "N.Y", "N.Z"],
                (4, _) => &["R", "G", "B", "A"],
                _ => &["R", "G", "B"],
            };
            let about = (self.name != RGBA.0).then(|| self.about());
            save_values(path, names, size, samples, about.as_deref())?;
            return Ok(None);
        }
        let values = match (Format::of(path), &self.words) {
            (Some(Format::Png), Words::Float(values)) => values,
            (_, Words::Float(values)) => return save_words(path, &self.shape, values).map(|()| None),
            (Some(Format::Png), Words::Uint(_)) => {
                let cause = format!("{NO_INTEGERS} (output `{}`)", self.name).into();
                return Err(OutputError { path: path.to_owned(), cause }.into());
            }
            (_, Words::Uint(words)) => return save_words(path, &self.shape, words).map(|()| None),
        };
        if self.name == RGBA.0 {
            return save_rgba_png(path, size, values).map(Some);
        }
        let pixel = |x: usize, y: usize| {
            let at = (y * width + x) * channels;
            let found = std::array::from_fn(|c| values[at + c.min(channels - 1)]);
            if self.name == NORMAL { colour_of_normal(found) } else { found }
        };
        let image = Image::from_fn(size.0, size.1, pixel);
        // Other outputs of three channels may be colours.
        let is_data = channels == 1 || self.name == NORMAL;
        if is_data { image.save_png_of_data(path).map(Some) } else { image.save_as(Format::Png, path) }
    }
}

impl Output {
    /// Describes the values, for people who open the file.
    fn about(&self) -> String {
        // A graph's own output may have the name of a built-in one and hold something else, such as colours.
        let is_built_in = (self.shape.len() == 2) != (self.name == NORMAL);
        let what =
            NAMES.into_iter().find(|(name, _)| is_built_in && *name == self.name).map(|(_, what)| what);
        let what = what.map(|what| format!(": {what}")).unwrap_or_default();
        let depths = match (is_built_in && self.name.ends_with("depth"), self.by_distance) {
            (true, true) => ". Depths are distances from the camera",
            (true, false) => ". Depths are along the viewing axis (view z)",
            (false, _) => "",
        };
        format!("{}{what}{depths}", self.name)
    }
}

fn colour_of_normal(normal: [f32; 3]) -> [f32; 3] {
    let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
    normal.map(|v| if length == 0.0 { 0.0 } else { 0.5 * (v / length + 1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_are_written_in_the_formats_that_hold_them() {
        let folder = tempfile::tempdir().unwrap();
        let save = |name: &str, words: Words, shape: &[u64], file: &str| {
            let path = folder.path().join(file);
            let output = Output { name: name.into(), shape: shape.to_vec(), words, by_distance: true };
            output.save(&path).map(|_| path)
        };
        let alpha = Words::Float(vec![0.0, 0.25, 0.5, 1.0]);
        let grey = Image::load(&save("alpha", alpha.clone(), &[2, 2], "a.png").unwrap()).unwrap();
        assert_eq!((grey.at(1, 1), grey.at(0, 0)), ([1.0; 3], [0.0; 3]));
        save("depth", alpha.clone(), &[2, 2], "d.exr").unwrap();
        let error = save("depth", alpha, &[2, 2], "d.png").unwrap_err().to_string();
        assert!(error.contains("expected the extension .npy or .exr"), "{error}");
        let picture = Image { width: 2, height: 1, rgb: vec![[0.3, 0.4, 0.5], [0.2, 0.4, 0.6]] };
        let half = Output {
            name: "alpha".into(),
            shape: vec![1, 2],
            words: Words::Float(vec![0.5, 0.0]),
            by_distance: false,
        };
        let rgba = rgba(&picture, &half, [0.2, 0.4, 0.6]).expect("an alpha for each pixel");
        let path = folder.path().join("rgba.png");
        rgba.save(&path).unwrap();
        let [levels, clear] = Image::load(&path).unwrap().rgb[..] else { panic!("two pixels") };
        // (0.3 - 0.5 * 0.2) / 0.5 and so on.
        assert_eq!((levels.map(|v| (255.0 * v).round()), clear), ([102.0, 102.0, 102.0], [0.0; 3]));
        assert!(Image::header(&path).unwrap().has_alpha);
        rgba.save(&path.with_extension("exr")).unwrap();
        let premultiplied = Image::load(&path.with_extension("exr")).unwrap().rgb[0];
        assert!(premultiplied.iter().all(|v| (v - 0.2).abs() < 1e-6), "{premultiplied:?}");
        assert!(Image::header(&path.with_extension("exr")).unwrap().has_alpha);
        // Own outputs, with a name of a built-in one.
        let own = Words::Float(vec![0.25, 0.5, 0.75, 0.0]);
        let [exr, npy] =
            ["own.exr", "own.npy"].map(|file| save("expected_depth", own.clone(), &[1, 1, 4], file).unwrap());
        let is_depth = std::fs::read(&exr).unwrap().windows(8).any(|part| part == b"distance");
        assert!(Image::header(&exr).unwrap().has_alpha && !is_depth);
        assert_eq!(Image::load(&npy).unwrap().rgb, [[0.25, 0.5, 0.75]]);
        let shown = Image::load(&save("motion", own, &[1, 1, 4], "own.png").unwrap()).unwrap();
        assert_eq!(shown.rgb[0].map(|v| (255.0 * v).round()), [64.0, 128.0, 191.0], "whatever its alpha");
        let error = save("hits", Words::Uint(vec![7]), &[1, 1], "h.png").unwrap_err().to_string();
        assert!(
            error.contains("expected the extension .npy or .exr: PNG cannot store 32-bit integers"),
            "{error}"
        );
        let normals = Words::Float(vec![0.0, 0.0, -0.5, 0.0, 0.0, 0.0]);
        let colours = Image::load(&save("normal", normals, &[1, 2, 3], "n.png").unwrap()).unwrap();
        assert_eq!((colours.at(0, 0)[2], colours.at(1, 0)), (0.0, [0.0; 3]));
        for (name, shape, counted) in [
            ("alpha", vec![2, 4], Some(2)),
            ("normal", vec![2, 1, 3], Some(1)),
            (RGBA.0, vec![1, 2, 4], Some(2)),
        ] {
            let words = Words::Float(
                [0.5, f32::NAN, 0.0, 0.5, 0.5, 0.5, 0.5, f32::INFINITY]
                    [..shape.iter().product::<u64>() as usize]
                    .to_vec(),
            );
            let output = Output { name: name.into(), shape, words, by_distance: true };
            let found =
                |file: &str| output.save(&folder.path().join(file)).unwrap().map(|found| found.pixels);
            assert_eq!(
                (found("nan.png"), found("nan.npy"), found("nan.exr")),
                (counted, None, None),
                "{name}"
            );
        }
        save("index", Words::Uint(vec![7]), &[1, 1], "i.exr").unwrap();
        let bytes = std::fs::read(folder.path().join("d.exr")).unwrap();
        let says = |text: &str| bytes.windows(text.len()).any(|part| part == text.as_bytes());
        assert!(
            says("depth: the sum of the depths of the splats' centres")
                && says("(gsplat's D). Depths are distances from the camera")
        );
        for (name, format, fits) in [
            ("alpha", Format::Png, true),
            ("depth", Format::Png, false),
            ("depth", Format::Exr, true),
            ("index", Format::Exr, true),
            ("index", Format::Png, false),
            ("index", Format::Npy, true),
        ] {
            assert_eq!(check_format(name, format).is_ok(), fits, "{name} {format}");
        }
    }
}
