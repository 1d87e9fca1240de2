//! Finds cameras that see no splat. Their pictures are empty, and therefore equal for every renderer.

use crate::draw::truth::Truth;
use crate::io::losses::splats;
use rayon::prelude::*;
use splatgraph_assets::{Camera, Filter, Scene};
use splatgraph_framework::ir::Param;
use splatgraph_framework::plan::Plan;
use splatgraph_reference::{KeyOf, LowPass, PictureMemoryError, Projected, Rules, project};
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Opacity from which a splat contributes to the pixel nearest to its centre, whatever the low-pass filter.
const CLEAR: f64 = 0.05;

/// Returns true if a splat contributes to the exact picture of a camera. `camera` is in the scene's coordinates.
///
/// # Errors
/// The exact picture does not fit in memory. It is not drawn if the centre of an opaque enough splat is in the picture.
pub fn sees(scene: &Scene, camera: &Camera) -> Result<bool, PictureMemoryError> {
    let rules = Rules::of_view(scene, camera);
    if centred(scene, camera, &rules, CLEAR).any(|_| true) {
        return Ok(true);
    }
    Ok(Truth::draw(scene, camera, [0.0; 3], &rules)?.stats.most_contributors > 0)
}

/// Projects a splat; `None` if its centre is not in the picture, or its opacity there is below `opacity`.
fn centre(scene: &Scene, index: u32, camera: &Camera, rules: &Rules, opacity: f64) -> Option<Projected> {
    let (width, height) = (f64::from(camera.width) - 1.0, f64::from(camera.height) - 1.0);
    project(scene, index, camera, rules).filter(|splat| {
        let [x, y] = splat.center;
        splat.opacity >= opacity && (0.0..=width).contains(&x) && (0.0..=height).contains(&y)
    })
}

/// Finds the splats whose centres are in the picture, with opacities of at least `opacity` there.
fn centred(scene: &Scene, camera: &Camera, rules: &Rules, opacity: f64) -> impl ParallelIterator<Item = u32> {
    let is_inside = move |index: &u32| centre(scene, *index, camera, rules, opacity).is_some();
    (0..scene.count()).into_par_iter().filter(is_inside)
}

/// Share of a scene's splats from which a loss of splats is noticed.
const NOTICEABLE: f64 = 0.05;

/// Share of a picture from which a loss of splats that would cover it is noticed.
const NOTICEABLE_AREA: f64 = 0.25;

/// Largest share of a picture that one splat counts for. A few floaters at a camera are normal, and could cover it all.
const LARGEST_AREA: f64 = 0.02;

/// A view: its camera, in the scene's coordinates, and the rules by which it was drawn.
pub type View<'a> = (&'a Camera, Rules);

/// Returns the rules of a view, with the plan's values of the parameters that are rules.
pub fn rules_of(plan: Option<&Plan>, scene: &Scene, camera: &Camera) -> Rules {
    let mut rules = Rules::of_view(scene, camera);
    let Some(plan) = plan else { return rules };
    // Graphs without this parameter never stop blending.
    rules.stop = None;
    for Param { name, value, .. } in &plan.params {
        let value = value.to_string();
        match name.as_str() {
            "low_pass" => rules.low_pass = Filter::named(&value).map_or(LowPass::None, LowPass::from),
            // A graph's own parameter of the name may have values that the rule does not.
            "jacobian_limit" => rules.set("jacobian_clamp", &value).unwrap_or_default(),
            "alpha_floor" | "alpha_cap" | "key_of" | "stop" => rules.set(name, &value).unwrap_or_default(),
            _ => {}
        }
    }
    rules
}

/// Counts the splats whose centres are in the picture, without and with the near plane.
fn in_picture(scene: &Scene, (camera, rules): &View) -> [usize; 2] {
    [0.0, rules.near].map(|near| centred(scene, camera, &wide(rules, near), rules.alpha_floor).count())
}

/// Returns rules with another near plane, and with the low-pass filter that leaves out no splat.
fn wide(rules: &Rules, near: f64) -> Rules {
    Rules { near, low_pass: Rules::PUBLISHED.low_pass, ..rules.clone() }
}

/// Names the near plane, and how to get beyond it.
fn too_near(rules: &Rules) -> String {
    format!(
        "nearer than the near plane, {} units; enlarge the scene and its cameras: `convert --transform scale:20 \
         -c CAMERAS --write-cameras FILE`",
        rules.near as f32
    )
}

/// Computes the share of the picture that a splat would cover without the near plane, weighted by its opacity.
///
/// At most [`LARGEST_AREA`]. `None` if the splat is beyond the near plane or behind the camera, or if its centre is
/// outside the picture or too faint to be drawn.
fn cut_area(scene: &Scene, index: u32, (camera, rules): &View) -> Option<f64> {
    let view = glam::DVec3::from(camera.to_view(scene.positions()[index as usize].map(f64::from)));
    let is_sphere = camera.projection.sees_behind() && rules.key_of == KeyOf::Distance;
    let depth = if is_sphere { view.length() } else { view.z };
    // Rejects most splats before they are projected, assuming that a pinhole's principal point is inside the picture.
    let is_outside = |v: f64, focal: f64, side: u32| (v * focal).abs() > depth * f64::from(side);
    let is_aside =
        is_outside(view.x, camera.fx, camera.width) || is_outside(view.y, camera.fy, camera.height);
    if depth <= 0.0 || depth > rules.near || (camera.projection.is_pinhole() && is_aside) {
        return None;
    }
    let splat = centre(scene, index, camera, &wide(rules, 0.0), rules.alpha_floor)?;
    let pixels = f64::from(camera.width) * f64::from(camera.height);
    Some((TAU * splat.determinant.sqrt() * splat.opacity / pixels).min(LARGEST_AREA))
}

/// Counts the splats that the near plane cuts off in each view, and sums their shares of the picture.
///
/// Splats farther from a camera than twice the near plane may be missed. Only views wider than 120 degrees have any.
fn cut_off(scene: &Scene, views: &[View]) -> Vec<(u64, f64)> {
    // A grid finds the cameras at a splat: most splats are at none.
    let side = 2.0 * views.iter().map(|(_, rules)| rules.near).fold(0.0, f64::max);
    let cell = |point: [f64; 3]| point.map(|v| (v / side).floor() as i64);
    let mut grid: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    for (view, (camera, _)) in views.iter().enumerate() {
        let middle = cell(camera.position);
        for [x, y, z] in (0..27).map(|cell| [cell % 3, cell / 3 % 3, cell / 9]) {
            let steps = [x - 1, y - 1, z - 1];
            let near = std::array::from_fn(|axis| middle[axis].saturating_add(steps[axis]));
            grid.entry(near).or_default().push(view);
        }
    }
    let add = |mut sums: Vec<(u64, f64)>, index: u32| {
        let at = cell(scene.positions()[index as usize].map(f64::from));
        for &view in grid.get(&at).into_iter().flatten() {
            if let Some(area) = cut_area(scene, index, &views[view]) {
                sums[view].0 += 1;
                sums[view].1 += area;
            }
        }
        sums
    };
    let none = || vec![(0, 0.0); views.len()];
    let sum = |a: Vec<(u64, f64)>, b| a.into_iter().zip(b).map(|((n, x), (m, y))| (n + m, x + y)).collect();
    (0..scene.count()).into_par_iter().fold(none, add).reduce(none, sum)
}

/// Counts, for each view, the splats that the near plane cuts off; `None` unless they are a noticeable part of it.
pub fn noticeable_cuts(scene: &Scene, views: &[View]) -> Vec<Option<u64>> {
    let is_noticed = |(splats, area): &(u64, f64)| {
        *splats as f64 > NOTICEABLE * f64::from(scene.count()) || *area >= NOTICEABLE_AREA
    };
    let cut = cut_off(scene, views).into_iter();
    cut.map(|cut| Some(cut).filter(is_noticed).map(|(splats, _)| splats)).collect()
}

/// Reports the views of which the near plane of `rules` cuts off a noticeable part; `None` if there are none. `cuts` are
/// the [`noticeable_cuts`] of all views.
pub fn cut_note(cuts: &[Option<u64>], rules: &Rules) -> Option<String> {
    let (most, near) = (splats(cuts.iter().copied().flatten().max()?), too_near(rules));
    let (count, of) = (cuts.iter().flatten().count(), cuts.len());
    Some(format!("{count} of {of} cameras lose a large part of their picture, up to {most}: they are {near}"))
}

/// Finds the views of which the near plane cuts off a noticeable part, and reports them as [`cut_note`] does.
pub fn cut(scene: &Scene, views: &[View]) -> Option<String> {
    cut_note(&noticeable_cuts(scene, views), &views.first()?.1)
}

/// Names the rules that left out splats whose centres are in the picture of a view without a splat. `None` if there are
/// no such splats.
fn left_out(scene: &Scene, view: &View) -> Option<String> {
    let (_, rules) = view;
    let [count, beyond] = in_picture(scene, view);
    let near = too_near(rules);
    // A few splats at the camera do not tell why the others are not seen.
    let are_few = beyond == 0 && (count as f64) < NOTICEABLE * f64::from(scene.count());
    let is_dilated = matches!(rules.low_pass, LowPass::Dilate(_));
    let filter = "`low_pass`, unless it is `dilated`, leaves out splats much smaller than a pixel";
    let cap = "`alpha_cap=1` leaves out opaque splats, because each would end the blending";
    let ends = |stop: f64| 1.0 - rules.alpha_cap < stop;
    let causes = [(!is_dilated, filter), (rules.stop.is_some_and(ends), cap)];
    let mut causes: Vec<&str> =
        causes.into_iter().filter(|(holds, _)| *holds).map(|(_, text)| text).collect();
    if beyond == 0 {
        causes = vec![&near];
    } else if causes.is_empty() {
        causes.push("the graph draws none of them");
    }
    let centres = format!("the centres of {} are in the picture", splats(count as u64));
    (count > 0 && !are_few).then(|| format!("{centres}, but {}", causes.join(", and ")))
}

/// Returns true if no splat is opaque enough to contribute to a pixel.
fn is_invisible(scene: &Scene) -> bool {
    !(0..scene.count() as usize).any(|index| scene.can_show(index))
}

/// Reports that `blind` of `of` cameras see no splat, and why. `example` is the view of one of them.
///
/// Either all splats are invisible, or rules leave them out, or they are elsewhere. In the last case, the text names
/// the box of most splats, and ends with `advice`.
pub fn note(scene: &Scene, (blind, of): (usize, usize), example: Option<&View>, advice: &str) -> String {
    let why = match example.and_then(|example| left_out(scene, example)) {
        _ if is_invisible(scene) => "no splat has an opacity of 1/255 or more".to_owned(),
        Some(rules) => rules,
        None => {
            let bounds = scene.robust_bounds().in_world(scene.offset());
            format!("most splats are in the box {bounds}{advice}")
        }
    };
    format!("{blind} of {of} cameras see no splat: {why}")
}

/// Reports that the cameras in `blind`, out of `of` cameras, see no splat, and why; `None` if `blind` is empty.
pub fn told(scene: &Scene, blind: &[Camera], of: usize) -> Option<String> {
    let example = blind.first().map(|first| (first, Rules::of_view(scene, first)))?;
    Some(note(scene, (blind.len(), of), Some(&example), ""))
}

/// Reports cameras that see no splat, as [`told`] does, out of `of` cameras of a comparison.
///
/// # Errors
/// No camera sees a splat, so there is nothing to compare.
pub fn check(scene: &Scene, blind: &[Camera], of: usize) -> Result<Option<String>, String> {
    match told(scene, blind, of) {
        Some(note) if blind.len() == of => Err(note + "; no picture can be compared"),
        note => Ok(note),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::{Projection, Similarity, Splat, synth};

    #[test]
    fn a_camera_sees_a_splat_if_one_contributes_to_its_exact_picture() {
        let scene = synth::generate("uniform", 300, 0).expect("a small scene");
        let ahead = Camera::framing(&scene, 32, 24);
        let away = Camera::looking_at([0.0, 0.0, -50.0], [0.0, 0.0, -60.0], 60.0, (32, 24));
        assert_eq!((sees(&scene, &ahead), sees(&scene, &away)), (Ok(true), Ok(false)));
        let rules = Rules::of_view(&scene, &away);
        let elsewhere = note(&scene, (1, 2), Some(&(&away, rules)), "; turn");
        assert!(elsewhere.starts_with("1 of 2 cameras see no splat: most splats are in the box "));
        assert!(elsewhere.ends_with("; turn"), "{elsewhere}");
        // The centre of a large splat is outside the picture, its edge inside.
        let one = |x: f32, opacity: f32| {
            Scene::generate(1, 0, |_| Splat {
                position: [x, 0.0, 4.0],
                scale: [1.0; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity,
                sh: [0.0; 48],
            })
        };
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (32, 24));
        let found = [(0.0, 0.5), (3.0, 0.5), (50.0, 0.5), (0.0, 0.003)];
        let found = found.map(|(x, opacity)| sees(&one(x, opacity), &camera));
        assert_eq!(found, [Ok(true), Ok(true), Ok(false), Ok(false)]);
        assert_eq!(
            note(&one(0.0, 0.003), (1, 1), None, "; turn"),
            "1 of 1 cameras see no splat: no splat has an opacity of 1/255 or more"
        );
        let of = |low_pass: LowPass, alpha_cap: f64| {
            let rules = Rules { low_pass, alpha_cap, ..Rules::PUBLISHED };
            note(&one(0.0, 0.5), (1, 1), Some(&(&camera, rules)), "; turn")
        };
        let (dilated, cap) = (Rules::PUBLISHED.low_pass, Rules::PUBLISHED.alpha_cap);
        let said = [of(LowPass::Compensated(0.3), cap), of(dilated, 1.0), of(dilated, cap)];
        for (said, why) in said.iter().zip([
            "`low_pass`, unless it is `dilated`, leaves out splats much smaller than a pixel",
            "`alpha_cap=1` leaves out opaque splats, because each would end the blending",
            "the graph draws none of them",
        ]) {
            let begin = "1 of 1 cameras see no splat: the centres of 1 splat are in the picture, but ";
            assert_eq!(*said, format!("{begin}{why}"));
        }
    }

    #[test]
    fn splats_nearer_than_the_near_plane_are_told_with_a_remedy() {
        let figurine = synth::generate("uniform", 300, 0).expect("a small scene");
        let by = Similarity { scale: 0.03 / figurine.bounds().extent(), ..Similarity::IDENTITY };
        let figurine = figurine.transformed(&by).expect("it fits");
        let at = |distance: f64| Camera::looking_at([0.0, 0.0, -distance], [0.0; 3], 60.0, (32, 24));
        let said = |distance: f64| {
            let camera = at(distance);
            let view = (&camera, Rules::of_view(&figurine, &camera));
            (note(&figurine, (1, 1), Some(&view), ""), cut(&figurine, &[view]))
        };
        let remedy = "nearer than the near plane, 0.2 units; enlarge the scene and its cameras: \
                      `convert --transform scale:20 -c CAMERAS --write-cameras FILE`";
        let (all, _) = said(0.1);
        assert!(all.starts_with("1 of 1 cameras see no splat: the centres of 300 splats are in"), "{all}");
        assert!(all.ends_with(&format!("picture, but {remedy}")), "{all}");
        let half = said(0.2).1.expect("half of the splats are too near");
        let count = half.strip_prefix("1 of 1 cameras lose a large part of their picture, up to ");
        let count = count.and_then(|text| text.split_once(' ')).expect("a count");
        assert!(count.0.parse().is_ok_and(|count: u32| (90..=210).contains(&count)), "{half}");
        assert_eq!(count.1, format!("splats: they are {remedy}"));
        assert_eq!(said(0.3).1, None);
        // From within a large scene, few splats are too near.
        let large = synth::generate("uniform", 300, 0).expect("a small scene");
        assert_eq!(cut(&large, &[(&at(0.1), Rules::PUBLISHED)]), None);
    }

    #[test]
    fn cameras_that_lose_a_wall_are_told_and_those_that_lose_floaters_are_not() {
        // A tube along z, with a radius of 0.3 and a length of 10 units. The first splats are floaters instead.
        let tube = |floaters: usize| {
            Scene::generate(30_000, 0, move |index| {
                let share = index as f64 / 30_000.0;
                // By the golden ratio, the turns are spread evenly.
                let (sin, cos) = (TAU * 0.618_034 * index as f64).sin_cos();
                let (position, scale) = match index < floaters {
                    true => ([0.3 * share, 0.0, 5.15], 0.05),
                    false => ([0.3 * cos, 0.3 * sin, 10.0 * share], 0.015),
                };
                let (position, rotation) = (position.map(|v| v as f32), [1.0, 0.0, 0.0, 0.0]);
                Splat { position, scale: [scale; 3], rotation, opacity: 0.8, sh: [0.0; 48] }
            })
        };
        let told = |scene: &Scene, cameras: &[Camera]| {
            let views: Vec<View> =
                cameras.iter().map(|camera| (camera, Rules::of_view(scene, camera))).collect();
            cut(scene, &views)
        };
        let along = |eye: [f64; 3], fov: f64| Camera::looking_at(eye, [0.0, 0.0, 9.0], fov, (960, 540));
        let across = Camera::looking_at([0.15, 0.0, 5.0], [0.3, 0.0, 5.1], 60.0, (960, 540));
        let silent = [along([0.0, 0.0, 5.0], 60.0), along([0.0, 0.0, -5.0], 60.0)];
        let wide = along([0.0, 0.0, 5.0], 120.0);
        let around = wide.with_projection(Projection::Equirectangular, [0.0; 3]);
        let beside = Camera { position: [0.25, 0.0, 5.0], ..around.clone() };
        let all = [silent.as_slice(), &[around, wide, across, beside]].concat();
        let said = told(&tube(0), &all).expect("three cameras are too close to the wall");
        assert!(said.starts_with("3 of 6 cameras lose a large part of their picture, up to "), "{said}");
        assert_eq!(told(&tube(10), &silent), None);
    }
}
