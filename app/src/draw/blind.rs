//! Finds cameras that see no splat. Their pictures are empty, so they are equal whatever draws them.

use crate::draw::truth::Truth;
use rayon::prelude::*;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{PictureMemoryError, Rules, project};

/// Opacity from which a splat contributes to the pixel nearest to its centre, whatever the low-pass filter.
const CLEAR: f64 = 0.05;

/// Returns true if a splat contributes to the exact picture of a camera. `camera` is in the scene's coordinates.
///
/// # Errors
/// The exact picture does not fit in memory. It is not drawn if the centre of an opaque enough splat is in the picture.
pub fn sees(scene: &Scene, camera: &Camera) -> Result<bool, PictureMemoryError> {
    let rules = Rules::of_view(scene, camera);
    let (width, height) = (f64::from(camera.width) - 1.0, f64::from(camera.height) - 1.0);
    let is_clear = |index| {
        project(scene, index, camera, &rules).is_some_and(|splat| {
            let [x, y] = splat.center;
            splat.opacity >= CLEAR && (0.0..=width).contains(&x) && (0.0..=height).contains(&y)
        })
    };
    if (0..scene.count()).into_par_iter().any(is_clear) {
        return Ok(true);
    }
    Ok(Truth::draw(scene, camera, [0.0; 3], &rules)?.stats.most_contributors > 0)
}

/// Returns true if no splat is opaque enough to contribute to a pixel.
pub fn is_invisible(scene: &Scene) -> bool {
    !(0..scene.count() as usize).any(|index| scene.can_show(index))
}

/// Reports that `blind` of `of` cameras see no splat, and the box of most splats, unless all splats are invisible.
pub fn note(scene: &Scene, blind: usize, of: usize) -> String {
    let why = match is_invisible(scene) {
        true => "no splat has an opacity of 1/255 or more".to_owned(),
        false => format!("most splats are in the box {}", scene.robust_bounds().in_world(scene.offset())),
    };
    format!("{blind} of {of} cameras see no splat: {why}")
}

/// Reports that `blind` of a comparison's `of` cameras see no splat; `None` if `blind` is 0.
///
/// # Errors
/// No camera sees a splat, so there is nothing to compare.
pub fn check(scene: &Scene, blind: usize, of: usize) -> Result<Option<String>, String> {
    if blind == 0 {
        return Ok(None);
    }
    let note = note(scene, blind, of);
    if blind < of { Ok(Some(note)) } else { Err(note + "; no picture can be compared") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::{Splat, synth};

    #[test]
    fn a_camera_sees_a_splat_if_one_contributes_to_its_exact_picture() {
        let scene = synth::generate("uniform", 300, 0).expect("a small scene");
        let ahead = Camera::framing(&scene, 32, 24);
        let away = Camera::looking_at([0.0, 0.0, -50.0], [0.0, 0.0, -60.0], 60.0, (32, 24));
        assert_eq!((sees(&scene, &ahead), sees(&scene, &away)), (Ok(true), Ok(false)));
        assert!(note(&scene, 1, 2).starts_with("1 of 2 cameras see no splat: most splats are in the box "));
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
            note(&one(0.0, 0.003), 1, 1),
            "1 of 1 cameras see no splat: no splat has an opacity of 1/255 or more"
        );
    }
}
