//! Draws a path of cameras with variants of graphs, and scores each step.

use super::score::{Score, score};
use crate::draw::capture::{self, Capture};
use crate::draw::interleaved;
use crate::draw::orbit;
use crate::draw::session::Session;
use crate::draw::truth::{self, Truth};
use crate::io::image::Image;
use crate::studies::study::{Listener, Setting, Steps, StudyError, Subject};
use serde::Serialize;
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::{ResourceId, Shape};
use splatgraph_framework::plan::Plan;
use splatgraph_reference::{Rules, depth_order};

/// Maximum bytes of the true pictures of a path, which are kept for all variants.
const MAX_BYTES: u64 = 4 << 30;

/// A camera of the path, with the true picture and the true order of the splats.
struct Frame<'a> {
    camera: &'a Camera,
    picture: Image,
    /// Indices of the splats beyond the near plane, near to far.
    order: Vec<u32>,
}

/// A variant's step from one frame to the next.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Name of the camera at the end of the step.
    pub camera: String,
    /// Angle by which the camera turns in the step, in degrees.
    pub degrees: f64,
    /// The scores of the change.
    #[serde(flatten)]
    pub score: Score,
    /// Number of pairs of splats that swap places in the drawn order. `None` if the graph has no readable order, or if
    /// an order repeats a splat.
    pub order_changes: Option<u64>,
    /// Number of pairs of the drawn splats that swap places in the true order; `None` without a readable order.
    pub true_order_changes: Option<u64>,
}

/// All steps of a variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Track {
    /// Graph and parameters of the variant.
    #[serde(flatten)]
    pub variant: Setting,
    /// Steps of the path, one fewer than its frames.
    pub steps: Vec<Step>,
}

/// Makes a path of cameras around the middle of a scene, `step` degrees apart, with `camera` halfway.
pub fn orbit(scene: &Scene, camera: &Camera, frames: u32, step: f64) -> Vec<Camera> {
    let center = scene.robust_bounds().center();
    let first = -0.5 * f64::from(frames.saturating_sub(1)) * step;
    let frame = |at: u32| {
        let turned = orbit::turned(camera, center, first + f64::from(at) * step);
        Camera { id: at.into(), img_name: format!("frame {at}"), ..turned }
    };
    (0..frames).map(frame).collect()
}

/// Checks that a path can be measured.
///
/// # Errors
/// There are fewer than two cameras, their sizes differ, or they have too many pixels.
pub fn check(cameras: &[Camera]) -> Result<(), StudyError> {
    let size = |camera: &Camera| (camera.width, camera.height);
    let refused = |text: String| Err(StudyError::Input(text));
    let [first, _, ..] = cameras else {
        return refused(format!("expected a path of at least two cameras, found {}", cameras.len()));
    };
    if let Some(other) = cameras.iter().find(|camera| size(camera) != size(first)) {
        return refused(format!(
            "expected pictures of the same size along the path, found {:?} and {:?} pixels: --size makes them equal",
            size(first),
            size(other)
        ));
    }
    let pixels = u64::from(first.width) * u64::from(first.height) * cameras.len() as u64;
    let bytes = pixels.saturating_mul(size_of::<[f32; 3]>() as u64);
    if bytes > MAX_BYTES {
        return refused(format!(
            "expected true pictures of at most {} MiB in all, found {} MiB: use a smaller --size or fewer --frames",
            MAX_BYTES >> 20,
            bytes >> 20
        ));
    }
    Ok(())
}

/// Draws the path of the subject's cameras with each variant, and scores the steps.
///
/// The first camera is drawn `warm_up` times before, from empty histories. `rules`, as pairs of name and value, change
/// the rules of the true pictures.
///
/// The true pictures are drawn first, which takes time: call [`Subject::check`] before, to report errors in a graph at
/// once.
///
/// # Errors
/// The path cannot be measured or shows no splat, a rule is invalid, an exact picture does not fit in memory, a graph
/// has errors, its pictures cannot be scored, the device fails, or the listener cancels.
pub fn study(
    subject: &Subject,
    variants: &[Setting],
    warm_up: u32,
    rules: &[(String, String)],
    listener: &mut dyn Listener,
) -> Result<Vec<Track>, StudyError> {
    let Subject { scene, cameras, .. } = subject;
    check(cameras)?;
    subject.check_views(listener)?;
    let mut session = subject.session("", &[])?;
    let mut steps = Steps::new(listener, "measuring popping", cameras.len() * (1 + variants.len()));
    let mut path = Vec::new();
    for (at, camera) in cameras.iter().enumerate() {
        steps.next(&format!("the exact pictures, frame {at}"))?;
        let rules = truth::rules(Rules::of_view(scene, camera), rules);
        let rules = rules.map_err(|error| StudyError::Input(error.to_string()))?;
        let picture = Truth::draw(scene, camera, [0.0; 3], &rules)?.image();
        path.push(Frame { camera, picture, order: depth_order(&**scene, camera, &rules) });
    }
    let mut tracks = Vec::new();
    let mut messages = Vec::new();
    for variant in variants {
        tracks.push(measure(&mut session, variant, &path, warm_up, &mut steps)?);
        messages.extend(session.settings_without_effect());
        if session.plan().is_some_and(averages) {
            messages.push(format!(
                "{}: keeps an image from frame to frame; an average that has not converged after the first camera's {} frames counts as popping (--warm-up)",
                variant.name,
                warm_up + 1
            ));
        }
    }
    messages.iter().for_each(|line| listener.say(line));
    Ok(tracks)
}

/// Returns true if a plan keeps an image from frame to frame, as averages do.
fn averages(plan: &Plan) -> bool {
    let mut resources = (0..).map(ResourceId).zip(&plan.resources);
    resources.any(|(id, resource)| matches!(resource.shape, Shape::Image { .. }) && plan.is_state(id))
}

/// Draws a path with a variant, and scores its steps.
///
/// Each frame is drawn once, so that a graph with a history reads the path's previous frame.
fn measure(
    session: &mut Session,
    variant: &Setting,
    path: &[Frame],
    warm_up: u32,
    progress: &mut Steps,
) -> Result<Track, StudyError> {
    session.set_graph(&variant.pipeline, &variant.set);
    let mut steps = Vec::new();
    let mut last: Option<(&Frame, Capture)> = None;
    for (at, frame) in path.iter().enumerate() {
        let camera = frame.camera;
        progress.next(&format!("{}, frame {at}", variant.name))?;
        if at == 0 {
            session.prepare((camera.width, camera.height), &mut |_| {})?;
            // Otherwise, a variant would begin with the state of the one before.
            session.restart()?;
            for _ in 0..warm_up {
                interleaved::frame(session, camera)?;
            }
        }
        let next = capture::take(session, camera).map_err(StudyError::of(&variant.name))?;
        if let Some((before, last)) = &last {
            let score = score((&last.image, &before.picture), (&next.image, &frame.picture))
                .map_err(StudyError::of(&variant.name))?;
            let orders = last.order.as_ref().zip(next.order.as_ref());
            steps.push(Step {
                camera: camera.img_name.clone(),
                degrees: orbit::turn_between(before.camera, camera),
                score,
                order_changes: orders.and_then(|(before, after)| capture::order_changes(before, after)),
                true_order_changes: orders.and_then(|(drawn, after)| {
                    let drawn = capture::only(&before.order, drawn);
                    capture::order_changes(&drawn, &capture::only(&frame.order, after))
                }),
            });
        }
        last = Some((frame, next));
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
