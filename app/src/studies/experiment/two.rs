//! Works through an example of two splats: with the formulas, with the exact renderer, and on the device.
//!
//! The splats' alphas and colours at a pixel are taken from exact pictures of each splat alone. The formulas are then
//! evaluated step by step with only these numbers.

use super::exact::{self, GRAPH, draw};
use super::ways::{WAYS, Way};
use crate::draw::session::Session;
use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::studies::study::StudyError;
use splatgraph_api::Device;
use splatgraph_assets::harmonics::basis;
use splatgraph_assets::{Camera, Scene, Splat};
use splatgraph_reference::{Gaussian, Rules, Splats, render};

/// Size of the example's pictures; odd, so that a pixel is in the middle.
const SIZE: (u32, u32) = (193, 129);

/// A splat's alpha and colour at the pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Alpha, 0 to 1.
    pub alpha: f64,
    /// Colour, display-encoded.
    pub color: [f64; 3],
}

/// The result of one way of blending the two splats.
#[derive(Clone, Debug)]
pub struct Blended {
    /// The way of blending.
    pub way: &'static Way,
    /// The sum of colours after each step, starting at zero. Also the transmittance, if the way computes it.
    pub steps: Vec<([f64; 3], Option<f64>)>,
    /// Colour of the pixel that the device drew.
    pub drawn: [f64; 3],
    /// The device's picture of the two splats.
    pub image: Image,
}

impl Blended {
    /// Returns the colour that the formula gives: the sum after the last step.
    pub fn computed(&self) -> [f64; 3] {
        self.steps.last().map_or([0.0; 3], |(sum, _)| *sum)
    }
}

/// The worked example of two splats, at one pixel.
#[derive(Clone, Debug)]
pub struct Two {
    /// The near splat and the far one at the pixel.
    pub layers: [Layer; 2],
    /// The result of each way of blending.
    pub ways: Vec<Blended>,
    /// The exact renderer's colour of the pixel.
    pub exact: [f64; 3],
    /// The exact renderer's picture of the two splats.
    pub image: Image,
}

/// Computes and draws the example, in its own context on the session's device.
///
/// # Errors
/// The graph has errors, the device fails, or the exact picture does not fit in memory.
pub fn work_out(session: &mut Session) -> Result<Two, StudyError> {
    let scene = scene();
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, SIZE);
    let truth = Truth::draw(&scene, &camera, [0.0; 3], &Rules::PUBLISHED)?;
    let pixel = (SIZE.1 / 2 * SIZE.0 + SIZE.0 / 2) as usize;
    // The scene lists the far splat first.
    let layers = [1, 0].map(|index| layer(&scene.get(index), &camera, pixel));
    let mut own = Session::new(session.device().new_context()?, scene, GRAPH, &[]);
    let exact = exact::values(&mut own, SIZE)?;
    let mut ways = Vec::new();
    for way in &WAYS {
        let image = draw(&mut own, &exact, way.set, &camera)?.image;
        let drawn = image.rgb[pixel].map(f64::from);
        ways.push(Blended { way, steps: steps(way, layers), drawn, image });
    }
    Ok(Two { layers, ways, exact: truth.picture.color[pixel], image: truth.image() })
}

/// Makes an orange splat, and a blue one that it partly covers; the blue one is first in the list.
fn scene() -> Scene {
    let splat = |z: f64, opacity: f32, color: [f64; 3]| {
        let side = if z > 3.0 { 1.0 } else { -1.0 };
        let mut sh = [0.0; 48];
        for (sh, color) in sh.iter_mut().zip(color) {
            *sh = ((color - 0.5) / basis([0.0, 0.0, 1.0])[0]) as f32;
        }
        let (x, deviation) = (0.09 * side * z, 0.11 * z);
        let position = [x as f32, 0.0, z as f32];
        Splat { position, scale: [deviation as f32; 3], rotation: [1.0, 0.0, 0.0, 0.0], opacity, sh }
    };
    let list = [splat(4.0, 0.95, [0.15, 0.45, 0.95]), splat(2.0, 0.9, [0.95, 0.5, 0.1])];
    Scene::generate(2, 0, |index| list[index])
}

/// Draws a splat alone, and reads its alpha and its colour at a pixel.
fn layer(splat: &Gaussian, camera: &Camera, pixel: usize) -> Layer {
    let alone = render(&[*splat][..], camera, [0.0; 3], &Rules::PUBLISHED, &|_, _| {});
    let alpha = 1.0 - alone.transmittance[pixel];
    Layer { alpha, color: alone.color[pixel].map(|channel| channel / alpha) }
}

fn steps(way: &Way, [near, far]: [Layer; 2]) -> Vec<([f64; 3], Option<f64>)> {
    let sequence = if way.nearest_first { [near, far] } else { [far, near] };
    let sequence = if way.sorted { sequence } else { [sequence[1], sequence[0]] };
    let (mut sum, mut transmittance) = ([0.0; 3], way.under.then_some(1.0));
    let mut steps = vec![(sum, transmittance)];
    for Layer { alpha, color } in sequence {
        sum = std::array::from_fn(|c| match transmittance {
            Some(left) => sum[c] + left * alpha * color[c],
            None => alpha * color[c] + (1.0 - alpha) * sum[c],
        });
        transmittance = transmittance.map(|left| left * (1.0 - alpha));
        steps.push((sum, transmittance));
    }
    steps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn over_from_behind_and_under_from_the_front_agree_and_the_wrong_ways_agree_on_the_other_picture() {
        let scene = scene();
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, SIZE);
        let pixel = (SIZE.1 / 2 * SIZE.0 + SIZE.0 / 2) as usize;
        let layers = [1, 0].map(|index| layer(&scene.get(index), &camera, pixel));
        assert!(layers.iter().all(|layer| (0.3..0.9).contains(&layer.alpha)), "{layers:?}");
        let result = |name: &str| {
            let way = WAYS.iter().find(|way| way.name == name).expect("a way");
            steps(way, layers).last().expect("steps").0
        };
        let truth = Truth::draw(&scene, &camera, [0.0; 3], &Rules::PUBLISHED).unwrap().picture.color[pixel];
        let close = |a: [f64; 3], b: [f64; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-12);
        assert!(close(result("back to front"), truth) && close(result("front to back"), truth));
        assert!(close(result("unsorted"), result("front to back, naive")));
        assert!(!close(result("unsorted"), truth));
    }
}
