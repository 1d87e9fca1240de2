//! Draws a path of cameras with variants of graphs, and scores each step.

use super::score::{Score, score};
use crate::draw::capture::{self, Capture, CaptureError};
use crate::draw::orbit;
use crate::draw::session::{FrameOptions, Session, SessionError};
use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::studies::metrics::MetricError;
use serde::Serialize;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{Rules, depth_order};

/// Bytes that the true pictures of a path may take: they are kept, so that each is drawn once for all variants.
const MOST_BYTES: u64 = 4 << 30;

/// A graph with the values that some of its parameters are set to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Variant {
    /// A preset's name, or the changes: `key_bits=8`.
    pub name: String,
    /// The graph, as `--pipeline` takes it.
    pub pipeline: String,
    /// Names and values, as `--set` takes them.
    pub set: Vec<(String, String)>,
}

/// A step of a variant, from a frame to the next.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// The camera that the step ends at.
    pub camera: String,
    /// Degrees by which the camera turns in the step.
    pub degrees: f64,
    /// The change of the error.
    #[serde(flatten)]
    pub score: Score,
    /// Pairs of splats that change places in the drawn order; `None` if the graph has none that can be read.
    pub order_changes: Option<u64>,
    /// Pairs of the same splats that change places in the true order.
    pub true_order_changes: Option<u64>,
}

/// The steps of a variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Track {
    /// The variant.
    #[serde(flatten)]
    pub variant: Variant,
    /// Its steps, one less than frames.
    pub steps: Vec<Step>,
}

/// An error of a measurement.
#[derive(Debug, thiserror::Error)]
pub enum PoppingError {
    /// A graph has errors, or the device failed.
    // Not transparent: a graph's errors are found among the causes, and printed with their source text.
    #[error("{0}")]
    Session(#[from] SessionError),
    /// A picture cannot be drawn.
    #[error("{variant}: {error}")]
    Capture {
        /// The variant's name.
        variant: String,
        /// The reason.
        #[source]
        error: CaptureError,
    },
    /// A picture cannot be scored.
    #[error("{variant}: {error}")]
    Metric {
        /// The variant's name.
        variant: String,
        /// The reason.
        #[source]
        error: MetricError,
    },
    /// The cameras of a path have pictures of several sizes.
    #[error(
        "expected pictures of one size along the path, found {0:?} and {1:?} pixels: --size makes them equal"
    )]
    Sizes((u32, u32), (u32, u32)),
    /// The true pictures need too much memory.
    #[error("expected true pictures of at most {} MiB in all, found {} MiB: take a smaller --size or fewer --frames", MOST_BYTES >> 20, .0 >> 20)]
    Memory(u64),
    /// The path has no step.
    #[error("expected a path of at least two cameras, found {0}")]
    Short(usize),
}

/// Makes a path around the middle of a scene, with the given camera in its middle. `step` is in degrees.
pub fn orbit(scene: &Scene, camera: &Camera, frames: u32, step: f64) -> Vec<Camera> {
    let center = scene.robust_bounds().center();
    let first = -0.5 * f64::from(frames.saturating_sub(1)) * step;
    let frame = |at: u32| {
        let turned = orbit::turned(camera, center, first + f64::from(at) * step);
        Camera { id: at.into(), img_name: format!("frame {at}"), ..turned }
    };
    (0..frames).map(frame).collect()
}

/// A path with the true picture and order of each frame.
pub struct Path {
    cameras: Vec<Camera>,
    truths: Vec<Image>,
    orders: Vec<Vec<u32>>,
}

impl Path {
    /// Draws the true pictures. `report` is told the frame that is drawn next.
    ///
    /// # Errors
    /// There are fewer than two cameras, of several sizes, or of too many pixels.
    pub fn new(
        scene: &Scene,
        cameras: Vec<Camera>,
        report: &mut dyn FnMut(usize),
    ) -> Result<Path, PoppingError> {
        check(&cameras)?;
        let (mut truths, mut orders) = (Vec::new(), Vec::new());
        for (at, camera) in cameras.iter().enumerate() {
            report(at);
            truths.push(Truth::draw(scene, camera, [0.0; 3], &Rules::PUBLISHED).image());
            orders.push(depth_order(scene, camera, &Rules::PUBLISHED));
        }
        Ok(Path { cameras, truths, orders })
    }
}

/// Checks that a path can be measured.
///
/// # Errors
/// There are fewer than two cameras, of several sizes, or of too many pixels.
pub fn check(cameras: &[Camera]) -> Result<(), PoppingError> {
    let size = |camera: &Camera| (camera.width, camera.height);
    let [first, _, ..] = cameras else { return Err(PoppingError::Short(cameras.len())) };
    if let Some(other) = cameras.iter().find(|camera| size(camera) != size(first)) {
        return Err(PoppingError::Sizes(size(first), size(other)));
    }
    let pixels = u64::from(first.width) * u64::from(first.height) * cameras.len() as u64;
    let bytes = pixels.saturating_mul(size_of::<[f32; 3]>() as u64);
    if bytes > MOST_BYTES { Err(PoppingError::Memory(bytes)) } else { Ok(()) }
}

/// Draws a path with a variant, and scores its steps. `report` is told the frame that is drawn next.
///
/// Each frame is drawn once, so that a graph that keeps something from the last frame has that of the path. The first frame is
/// drawn twice: it has no last one.
///
/// # Errors
/// The graph has errors, its pictures cannot be scored, or the device fails.
pub fn measure<D: Device>(
    session: &mut Session<D>,
    variant: &Variant,
    path: &Path,
    report: &mut dyn FnMut(usize),
) -> Result<Track, PoppingError> {
    session.set_graph(&variant.pipeline, &variant.set);
    let mut steps = Vec::new();
    let mut last: Option<Capture> = None;
    for (at, (camera, truth)) in path.cameras.iter().zip(&path.truths).enumerate() {
        report(at);
        if at == 0 {
            session.prepare((camera.width, camera.height), &mut |_| {})?;
            session.tell_settings_without_effect();
            let frame = session.submit(camera, &FrameOptions::default())?;
            session.wait(frame)?;
        }
        let named = |error| PoppingError::Capture { variant: variant.name.clone(), error };
        let next = capture::take(session, camera).map_err(named)?;
        if let Some(last) = &last {
            let named = |error| PoppingError::Metric { variant: variant.name.clone(), error };
            let score = score((&last.image, &path.truths[at - 1]), (&next.image, truth)).map_err(named)?;
            let orders = last.order.as_ref().zip(next.order.as_ref());
            let truths = (&path.orders[at - 1], &path.orders[at]);
            steps.push(Step {
                camera: camera.img_name.clone(),
                degrees: orbit::turn_between(&path.cameras[at - 1], camera),
                score,
                order_changes: orders.and_then(|(before, after)| capture::order_changes(before, after)),
                true_order_changes: orders.and_then(|(before, after)| {
                    let before = capture::only(truths.0, before);
                    capture::order_changes(&before, &capture::only(truths.1, after))
                }),
            });
        }
        last = Some(next);
    }
    Ok(Track { variant: variant.clone(), steps })
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;

    #[test]
    fn an_orbit_has_the_camera_in_its_middle_and_looks_at_one_point() {
        let scene = synth::generate("demo", 500, 0).unwrap();
        let camera = Camera::framing(&scene, 64, 48);
        let path = orbit(&scene, &camera, 5, 0.5);
        assert_eq!(path.len(), 5);
        assert!((0..3).all(|i| (path[2].position[i] - camera.position[i]).abs() < 1e-12), "{path:?}");
        let center = scene.robust_bounds().center();
        let seen: Vec<[f64; 3]> = path.iter().map(|camera| camera.to_view(center)).collect();
        assert!(seen.iter().all(|at| (0..3).all(|i| (at[i] - seen[0][i]).abs() < 1e-9)), "{seen:?}");
        assert!(path[0].position != path[4].position && path.iter().all(|camera| camera.fault().is_none()));
    }

    #[test]
    fn paths_that_cannot_be_measured_are_refused() {
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 48));
        let message = |cameras: &[Camera]| check(cameras).map_err(|error| error.to_string());
        assert_eq!(message(&[camera.clone(), camera.clone()]), Ok(()));
        assert!(
            message(std::slice::from_ref(&camera)).unwrap_err().contains("at least two cameras, found 1")
        );
        let sizes = message(&[camera.clone(), camera.resized(32, 24)]).unwrap_err();
        assert!(sizes.contains("(64, 48) and (32, 24)"), "{sizes}");
        let memory = message(&vec![camera.resized(8192, 8192); 6]).unwrap_err();
        assert!(memory.contains("at most 4096 MiB") && memory.contains("4608 MiB"), "{memory}");
    }
}
