//! Measures each scene format: bytes, the error of its pictures, and the time to load it.

use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::io::load::FileOptions;
use crate::io::losses;
use crate::studies::evaluation::{Evaluation, Score, score};
use anyhow::{Context, Result};
use serde::Serialize;
use splatgraph_assets::{Camera, QUIET, Scene, SceneFormat, SceneMemoryError, SpzVersion, memory, sh_floats};
use splatgraph_reference::Rules;
use splatgraph_reference::metrics::decibels;
use std::time::Instant;

/// Number of loads of a file; the fastest counts.
const LOADS: usize = 3;

/// The price of a format: size, error and load time of the scene's file in it.
#[derive(Clone, Debug, Serialize)]
pub struct Price {
    /// Extension of the format, with the version if several are measured.
    pub format: String,
    /// The measurements, or the reason why the scene cannot be written in the format.
    #[serde(flatten)]
    pub found: Found,
}

/// The result for a format.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Found {
    /// The file was written and read.
    Measured(Measured),
    /// The format cannot store the scene.
    Refused {
        /// The reason, as a sentence.
        cannot_be_written: String,
    },
}

/// The measurements of a file.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Size of the file, in bytes.
    pub bytes: u64,
    /// Bytes of the file per splat.
    pub bytes_per_splat: f64,
    /// Milliseconds to read the file from memory: the minimum of several loads.
    pub load_ms: f64,
    /// Lowest PSNR over the views, in decibels; `None` if all pictures are equal.
    #[serde(serialize_with = "decibels::serialize")]
    pub least_psnr_db: Option<f64>,
    /// Scores of the views against the original scene's pictures, and their means.
    pub scores: Evaluation,
    /// Losses of the file due to the contents of the scene, such as tags that the format cannot store.
    pub losses: Vec<String>,
}

/// Writes the scene in each of `formats`, reads it back, and compares its exact pictures with the truth's.
///
/// Without a `truth`, the scene itself is the truth. Cameras are in the world's coordinates, because the files can have
/// other offsets than the scene. A format that loses the scene's tags is drawn without them, which counts as error. The
/// files are drawn with or without their tags as `load` says. The scene's mesh is not drawn: no format stores it, and
/// the price is that of the splats.
///
/// # Errors
/// A picture, a file or a second scene does not fit in memory, a written file cannot be read, or its pictures have
/// values that are not finite.
pub fn measure(
    scene: Scene,
    truth: Option<Scene>,
    cameras: &[Camera],
    formats: &[SceneFormat],
    load: &FileOptions,
) -> Result<Vec<Price>> {
    let (scene, truth) = (&scene.with_mesh(None), truth.map(|truth| truth.with_mesh(None)));
    let mut bytes = Vec::new();
    reserve(scene, &mut bytes)?;
    let views = pictures(truth.as_ref().unwrap_or(scene), cameras)?;
    drop(truth);
    let versions = formats.iter().copied().flat_map(|format| match format {
        SceneFormat::Spz => vec![(format, Some(SpzVersion::V3)), (format, Some(SpzVersion::V4))],
        _ => vec![(format, None)],
    });
    versions.map(|version| price(scene, cameras, &views, version, load, &mut bytes)).collect()
}

/// Reserves memory for a file of the scene in any format. Fails if there is not enough for the file, a second scene and
/// the drawing of its picture.
fn reserve(scene: &Scene, file: &mut Vec<u8>) -> Result<(), SceneMemoryError> {
    /// Room for the values of a splat outside its harmonics, in PLY with positions in `double`.
    const SPLAT: u64 = 4 * (3 + 1 + 3 + 4) + 24;
    const HEADER: u64 = 1 << 20;
    /// Room for a visible splat while the exact renderer sorts its ellipse, in bytes.
    const DRAWN: u64 = 400;
    let (count, degree) = (u64::from(scene.count()), scene.stored_degree());
    let bytes = HEADER + count * (SPLAT + 4 * sh_floats(degree) as u64);
    let needed = bytes + Scene::host_bytes(count, degree) + DRAWN * count;
    let available = memory::available();
    SceneMemoryError::check_against(count, degree, needed, available)?;
    let reserved = usize::try_from(bytes).is_ok_and(|bytes| file.try_reserve_exact(bytes).is_ok());
    if reserved { Ok(()) } else { Err(SceneMemoryError { count, degree, needed, available }) }
}

fn pictures(scene: &Scene, cameras: &[Camera]) -> Result<Vec<Image>> {
    let draw = |camera: &Camera| {
        let camera = camera.relative_to(scene.offset());
        Ok(Truth::draw(scene, &camera, [0.0; 3], &Rules::of_view(scene, &camera))?.image())
    };
    cameras.iter().map(draw).collect()
}

fn price(
    scene: &Scene,
    cameras: &[Camera],
    views: &[Image],
    (format, version): (SceneFormat, Option<SpzVersion>),
    load: &FileOptions,
    bytes: &mut Vec<u8>,
) -> Result<Price> {
    bytes.clear();
    let (name, written) = match version {
        Some(version) => {
            (format!("{}, version {}", format.extension(), version as u32), scene.write_spz(version, bytes))
        }
        None => (format.extension().to_owned(), scene.write(format, QUIET, bytes)),
    };
    if let Err(error) = written {
        return Ok(Price { format: name, found: Found::Refused { cannot_be_written: error.to_string() } });
    }
    let (mut load_ms, mut loaded) = (f64::INFINITY, None);
    for _ in 0..LOADS {
        let begun = Instant::now();
        loaded = Some(Scene::parse(bytes, QUIET)?);
        load_ms = load_ms.min(begun.elapsed().as_secs_f64() * 1e3);
    }
    let loaded = load.tagged(loaded.context("a scene was loaded")?);
    let found = pictures(&loaded, cameras)?;
    let scores: Result<Vec<Score>, _> = found
        .iter()
        .zip(views)
        .zip(cameras)
        .map(|((found, view), camera)| score(&camera.img_name, found, view, None))
        .collect();
    let scores = scores?;
    let least = scores.iter().filter_map(|score| score.psnr_db).reduce(f64::min);
    let measured = Measured {
        bytes: bytes.len() as u64,
        bytes_per_splat: bytes.len() as f64 / f64::from(scene.count().max(1)),
        load_ms,
        least_psnr_db: least,
        scores: Evaluation::new(scores, Vec::new()),
        losses: losses::not_stored(scene, format),
    };
    Ok(Price { format: name, found: Found::Measured(measured) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;

    fn measured<'a>(prices: &'a [Price], name: &str) -> &'a Measured {
        match prices.iter().find(|price| price.format == name).map(|price| &price.found) {
            Some(Found::Measured(measured)) => measured,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn a_format_that_cannot_hold_the_scene_has_the_reason_and_a_mesh_is_no_error() {
        let scene = synth::generate("demo", 30, 0).expect("it is generated");
        let camera = Camera::framing(&scene, 32, 24);
        let far = [1e7, 0.0, 0.0];
        let cameras = [camera.in_world(far)];
        let prices = measure(
            scene.with_offset(far).with_mesh(Some(synth::mesh().into())),
            None,
            &cameras,
            &[SceneFormat::Ply, SceneFormat::Spz],
            &FileOptions::default(),
        );
        let prices = prices.expect("prices");
        let json = serde_json::to_value(&prices).expect("JSON");
        let spz = json.as_array().expect("a list").iter().find(|price| price["format"] == "spz, version 4");
        let reason = spz.expect("it has a row")["cannot_be_written"].as_str().expect("a reason");
        assert!(reason.contains("8388607"), "{reason}");
        let ply = measured(&prices, "ply");
        assert!(ply.least_psnr_db.is_none_or(|db| db > 60.0), "{ply:?}");
    }

    #[test]
    fn a_file_without_the_order_by_depth_names_it_and_is_drawn_like_the_scene_without_tags() {
        let scene = || synth::generate("demo", 300, 0).expect("it is generated").without_tags();
        let camera = Camera::framing(&scene(), 64, 48);
        let price = |ignore_tags| {
            let load = FileOptions { ignore_tags, ..FileOptions::default() };
            let (formats, cameras) = ([SceneFormat::Gltf], std::slice::from_ref(&camera));
            let prices = measure(scene(), None, cameras, &formats, &load).expect("a price");
            measured(&prices, "glb").clone()
        };
        let told = price(false);
        assert!(
            told.least_psnr_db.is_some() && told.losses[0].starts_with("the order by depth:"),
            "{told:?}"
        );
        assert_eq!(price(true).least_psnr_db, None);
    }

    #[test]
    fn every_format_has_a_price_and_exact_ones_have_no_error() {
        let scene = synth::generate("demo", 300, 0).expect("it is generated");
        let camera = Camera::framing(&scene, 64, 48);
        let cut = scene.cut_to_degree(0).expect("it fits in memory");
        let whole = scene.cut_to_degree(3).expect("it fits in memory");
        let prices = measure(
            scene,
            None,
            std::slice::from_ref(&camera),
            &SceneFormat::WRITTEN,
            &FileOptions::default(),
        )
        .expect("prices");
        assert_eq!(prices.len(), SceneFormat::WRITTEN.len() + 1);
        let of = |name: &str| measured(&prices, name);
        let db = |name: &str| of(name).least_psnr_db.unwrap_or(f64::INFINITY);
        assert!(db("ply") > 90.0, "{}", db("ply"));
        assert!(db("splat") < db("ply") && of("splat").bytes == 32 * 300);
        assert_eq!(of("spz, version 3").least_psnr_db, of("spz, version 4").least_psnr_db);
        let prices = measure(cut, Some(whole), &[camera], &[SceneFormat::Ply], &FileOptions::default())
            .expect("prices");
        let db = measured(&prices, "ply").least_psnr_db;
        assert!(db.is_some_and(|db| db < 60.0), "the bands that were cut count as error: {db:?}");
    }
}
