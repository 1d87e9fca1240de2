//! Scores the step from one frame to the next.
//!
//! Let `P` be a renderer's picture, `R` the true one, both with channels clamped to 0..1 as on a display, and `E = P -
//! R` the error. A prime marks frame `t + 1`, and `|.|` is the mean absolute value of a pixel's channels.
//!
//! - The **pop** of a pixel is `|E' - E| = |(P' - P) - (R' - R)|`: its change relative to the true change. It is 0 for
//!   a renderer whose error is constant in time, for any error and any camera.
//! - The **excess** is `max(0, |P' - P| - |R' - R|)`: the change beyond the true change. A pixel that changes as much
//!   as the truth in the opposite direction, or does not change where the truth does, has a pop and no excess.
//!
//! The excess is at most the pop, at every pixel (the triangle inequality). Neither separates a jump from a drift: an
//! error that sticks to a surface moves across the picture with it, and so changes every pixel on the way. The two
//! differ in the worst pixel: a drift causes a small change at many pixels, smaller with finer steps, while two splats
//! that swap places change a pixel by an amount that finer steps do not reduce.

use crate::io::image::Image;
use serde::Serialize;
use splatgraph_reference::metrics::{MetricError, WorstPixel, comparable};

/// The scores of a step, as means over all pixels: pops from 0 to 2, changes and excesses from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Score {
    /// The mean pop: the change of the error.
    pub pop: f64,
    /// The mean excess: the change beyond the change of the true picture.
    pub excess: f64,
    /// The pixel with the largest change of the error, by the mean of its channels.
    pub worst: WorstPixel,
    /// The mean change of the picture.
    pub change: f64,
    /// The mean change of the true picture.
    pub true_change: f64,
}

/// The drawn picture of a frame, and the true one.
pub type Frame<'a> = (&'a Image, &'a Image);

/// Scores the step between two frames.
///
/// # Errors
/// The sizes differ, or a value is not finite.
pub fn score((p0, r0): Frame, (p1, r1): Frame) -> Result<Score, MetricError> {
    comparable(p0.into(), p1.into())?;
    comparable(r0.into(), r1.into())?;
    comparable(p0.into(), r0.into())?;
    let (width, count) = (p0.width, p0.rgb.len());
    let mut worst = WorstPixel { difference: 0.0, x: 0, y: 0 };
    let mut sums = [0.0; 4];
    for (at, ((p0, p1), (r0, r1))) in p0.rgb.iter().zip(&p1.rgb).zip(r0.rgb.iter().zip(&r1.rgb)).enumerate() {
        let shown = |value: f32| f64::from(value.clamp(0.0, 1.0));
        let change =
            |a: &[f32; 3], b: &[f32; 3]| -> [f64; 3] { std::array::from_fn(|c| shown(b[c]) - shown(a[c])) };
        let (drawn, truth) = (change(p0, p1), change(r0, r1));
        let size = |v: [f64; 3]| v.iter().map(|c| c.abs()).sum::<f64>() / 3.0;
        let pop = size(std::array::from_fn(|c| drawn[c] - truth[c]));
        let (drawn, truth) = (size(drawn), size(truth));
        let terms = [pop, (drawn - truth).max(0.0), drawn, truth];
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        if pop > worst.difference {
            worst = WorstPixel { difference: pop, x: at % width, y: at / width };
        }
    }
    let [pop, excess, change, true_change] = sums.map(|sum| sum / count.max(1) as f64);
    Ok(Score { pop, excess, worst, change, true_change })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(pixels: &[[f32; 3]]) -> Image {
        Image { width: pixels.len(), height: 1, rgb: pixels.to_vec() }
    }

    #[test]
    fn an_error_that_is_constant_in_time_does_not_pop_however_large_it_is() {
        let truth = [picture(&[[0.1; 3], [0.5, 0.25, 0.0]]), picture(&[[0.4; 3], [0.25, 0.5, 0.5]])];
        let off = truth.clone().map(|truth| {
            let rgb = truth.rgb.iter().map(|p| p.map(|channel| channel + 0.5)).collect();
            Image { rgb, ..truth }
        });
        let found = score((&off[0], &truth[0]), (&off[1], &truth[1])).unwrap();
        assert!(found.pop < 1e-7 && found.excess < 1e-7 && found.worst.difference < 1e-7, "{found:?}");
        assert!((found.change - found.true_change).abs() < 1e-7 && found.change > 0.2, "{found:?}");
    }

    #[test]
    fn a_picture_that_jumps_where_the_truth_rests_has_a_pop_and_as_much_excess() {
        let rest = picture(&[[0.5; 3], [0.5; 3]]);
        let jumped = picture(&[[0.5; 3], [0.8, 0.5, 0.5]]);
        let found = score((&rest, &rest), (&jumped, &rest)).unwrap();
        assert!((found.pop - 0.05).abs() < 1e-7 && (found.excess - 0.05).abs() < 1e-7, "{found:?}");
        assert!((found.worst.difference - 0.1).abs() < 1e-7 && (found.worst.x, found.worst.y) == (1, 0));
        // A picture that misses a change has a pop, and no excess.
        let found = score((&rest, &rest), (&rest, &jumped)).unwrap();
        assert!((found.pop - 0.05).abs() < 1e-7 && found.excess == 0.0, "{found:?}");
        // Changes above white do not count.
        let bright = picture(&[[1.5; 3]]);
        let brighter = picture(&[[2.5; 3]]);
        assert_eq!(score((&bright, &bright), (&brighter, &bright)).unwrap().pop, 0.0);
    }

    #[test]
    fn pictures_that_cannot_be_compared_are_errors() {
        let (one, two) = (picture(&[[0.0; 3]]), picture(&[[0.0; 3]; 2]));
        assert!(score((&one, &one), (&two, &two)).is_err());
        assert!(score((&one, &two), (&one, &two)).is_err());
        let nan = picture(&[[f32::NAN; 3]]);
        assert!(score((&one, &one), (&nan, &one)).is_err());
    }
}
