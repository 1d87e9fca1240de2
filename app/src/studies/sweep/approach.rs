//! Moves a camera closer to the scene, then makes the picture smaller, to vary splats and covered pixels independently.
//!
//! From closer, fewer splats cover more pixels each; in a smaller picture, the same splats cover fewer. An orthographic
//! view, whose splats have one size at any distance, is enlarged instead of moved. If the draw is fragment-bound, all
//! of these times are on one line over covered pixels times overlap.

use crate::draw::blind;
use crate::draw::interleaved::Effort;
use crate::draw::session::Session;
use crate::studies::measurement::time::{Time, time_alone};
use crate::studies::study::{Steps, StudyError};
use serde::{Deserialize, Serialize};
use splatgraph_assets::{Camera, NEAR, Projection, Scene};
use splatgraph_reference::{check_memory, render};

/// The measurements of one step of the approach.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Closer {
    /// Distance to the median depth of the first view's splats, as a share of the first camera's.
    pub distance: f64,
    /// Width and height of the picture, in pixels.
    pub size: (u32, u32),
    /// Number of pixels with a contribution of at least one splat.
    pub covered: u64,
    /// Mean number of splats that contribute to a covered pixel: the overlap.
    pub overlap: f64,
    /// Covered pixels times overlap: the number of blended fragments.
    pub fragments: u64,
    /// The time of a frame; `None` without timestamps.
    pub time: Option<Time>,
}

/// A straight line through the times: milliseconds = `fixed_ms` + 1e-6 * `ns_per_fragment` * fragments.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Milliseconds that the draw takes without fragments.
    pub fixed_ms: f64,
    /// Nanoseconds that each fragment adds.
    pub ns_per_fragment: f64,
    /// Share of the times' variance that the line explains, at most 1.
    pub r_squared: f64,
}

/// The steps: the share of the distance, and the divisor of the picture's width and height.
pub const STEPS: [(f64, u32); 8] =
    [(1.0, 1), (0.5, 1), (0.25, 1), (0.125, 1), (0.0625, 1), (0.125, 2), (0.125, 3), (0.125, 4)];

/// Makes the cameras of [`STEPS`].
///
/// Each is `first`, moved forward towards the median depth of the splats in its view, or enlarged as much if it is
/// orthographic, with the picture's width and height divided. Without splats in the view, the depth is 1.
pub fn cameras(scene: &Scene, first: &Camera) -> Vec<Camera> {
    let tan = [f64::from(first.width) / first.fx, f64::from(first.height) / first.fy].map(|v| 0.5 * v);
    let [right, down] = [first.principal_offset[0] / first.fx, first.principal_offset[1] / first.fy];
    let seen = |p: &[f32; 3]| {
        let [x, y, z] = first.to_view(p.map(f64::from));
        let (x, y) = (x + right * z, y + down * z);
        (z > NEAR && x.abs() < tan[0] * z && y.abs() < tan[1] * z).then_some(z)
    };
    let mut depths: Vec<f64> = scene.positions().iter().filter_map(seen).collect();
    depths.sort_by(f64::total_cmp);
    let middle = depths.get(depths.len() / 2).copied().unwrap_or(1.0);
    let forward = first.axes()[2];
    let at = |(share, divisor): (f64, u32)| {
        let (step, zoom) = match first.projection {
            Projection::Orthographic => (0.0, 1.0 / share),
            _ => ((1.0 - share) * middle, 1.0),
        };
        let closer = Camera {
            img_name: format!("{} at {share}", first.img_name),
            position: std::array::from_fn(|i| first.position[i] + step * forward[i]),
            fx: zoom * first.fx,
            fy: zoom * first.fy,
            ..first.clone()
        };
        closer.resized((first.width / divisor).max(1), (first.height / divisor).max(1))
    };
    STEPS.map(at).into()
}

/// Measures each camera of [`cameras`]. The exact renderer counts the fragments, by the plan's rules.
///
/// # Errors
/// The session fails, an exact picture does not fit in memory, or the listener cancels.
pub fn measure(
    session: &mut Session,
    cameras: &[Camera],
    effort: Effort,
    progress: &mut Steps,
) -> Result<Vec<Closer>, StudyError> {
    let mut found = Vec::new();
    for (camera, (distance, _)) in cameras.iter().zip(STEPS) {
        progress.next("moving the camera closer")?;
        let size = (camera.width, camera.height);
        session.prepare(size, &mut |_| {})?;
        let rules = blind::rules_of(session.plan(), session.scene(), camera);
        check_memory(session.scene(), camera, &rules)?;
        let picture = render(session.scene(), camera, [0.0; 3], &rules, &|_, _| {});
        let fragments: u64 = picture.contributors.iter().map(|count| u64::from(*count)).sum();
        let covered = picture.contributors.iter().filter(|count| **count > 0).count() as u64;
        let time = time_alone(session, camera, effort)?;
        let overlap = fragments as f64 / covered.max(1) as f64;
        found.push(Closer { distance, size, covered, overlap, fragments, time });
    }
    Ok(found)
}

/// Returns the milliseconds of the phase that blends, `draw` or else `rasterise`; `None` if the graph has neither.
pub fn blending(time: &Time) -> Option<f64> {
    time.phases.get("draw").or_else(|| time.phases.get("rasterise")).copied()
}

/// Fits a line to the times of the phase that blends, by least squares.
///
/// `None` with fewer than three timed steps, if times do not grow with fragments because noise hides the cost, or if
/// the phases cover less than half of a frame, as on a CPU whose timestamps are unreliable.
pub fn fit(steps: &[Closer]) -> Option<Fit> {
    let timed = || steps.iter().filter_map(|step| Some((step, step.time.as_ref()?)));
    if timed().any(|(_, time)| time.phases.values().sum::<f64>() < 0.5 * time.gpu_ms) {
        return None;
    }
    let points: Vec<(f64, f64)> =
        timed().filter_map(|(step, time)| Some((step.fragments as f64, blending(time)?))).collect();
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| points.iter().map(|p| of(p.0 - x, p.1 - y)).sum::<f64>();
    let (xx, xy, yy) = (sum(&|a, _| a * a), sum(&|a, b| a * b), sum(&|_, b| b * b));
    if points.len() < 3 || xy <= 0.0 {
        return None;
    }
    let slope = xy / xx;
    Some(Fit { fixed_ms: y - slope * x, ns_per_fragment: 1e6 * slope, r_squared: xy * xy / (xx * yy) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studies::measurement::noise::Share;
    use splatgraph_assets::synth;

    #[test]
    fn the_camera_comes_closer_to_the_middle_of_what_it_sees() {
        let scene = synth::generate("uniform", 500, 0).unwrap();
        let first = Camera::framing(&scene, 64, 48);
        let all = cameras(&scene, &first);
        assert_eq!((all[0].position, all[0].width), (first.position, first.width));
        assert_eq!((all[7].width, all[7].height), (16, 12));
        let distances: Vec<f64> = all
            .iter()
            .map(|camera| {
                (0..3).map(|i| (camera.position[i] - first.position[i]).powi(2)).sum::<f64>().sqrt()
            })
            .collect();
        let whole = distances[1] * 2.0;
        assert!(whole > 0.0);
        for (found, (share, _)) in distances.iter().zip(STEPS) {
            assert!((found - (1.0 - share) * whole).abs() < 1e-9 * whole, "{distances:?}");
        }
        let parallel = first.with_projection(Projection::Orthographic, scene.robust_bounds().center());
        let half = &cameras(&scene, &parallel)[1];
        assert_eq!((half.position, half.fx, half.fy), (first.position, 2.0 * parallel.fx, 2.0 * parallel.fy));
    }

    #[test]
    fn a_line_is_found_again() {
        let step = |fragments: u64, ms: f64| Closer {
            distance: 1.0,
            size: (1, 1),
            covered: 1,
            overlap: 1.0,
            fragments,
            time: Some(Time {
                gpu_ms: ms,
                spread_ms: None,
                share: Share::EXACT,
                exact_ms: ms,
                exact_spread_ms: None,
                turns: Vec::new(),
                rounds: 8,
                busy: 1.0,
                phases: [("draw".into(), ms)].into(),
                phase_spreads: [].into(),
            }),
        };
        let steps = [step(1_000_000, 3.0), step(2_000_000, 5.0), step(4_000_000, 9.0)];
        let found = fit(&steps).unwrap();
        assert!(
            (found.fixed_ms - 1.0).abs() < 1e-9 && (found.ns_per_fragment - 2.0).abs() < 1e-9,
            "{found:?}"
        );
        assert!((found.r_squared - 1.0).abs() < 1e-9, "{found:?}");
        assert_eq!(fit(&steps[..2]), None);
        let mut untimed = steps.clone();
        untimed[1].time.as_mut().unwrap().gpu_ms = 11.0;
        assert_eq!(fit(&untimed), None, "the phases are less than half of the frame");
        assert_eq!(fit(&[step(1, 1.0), step(1, 2.0), step(1, 3.0)]), None, "equal fragments");
        assert_eq!(fit(&[step(1, 3.0), step(2, 2.0), step(3, 1.0)]), None, "a negative slope");
    }
}
