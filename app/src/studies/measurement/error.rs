//! Measures the error of a picture against the truth.

use crate::io::image::Image;
use serde::{Deserialize, Serialize};
use splatgraph_reference::metrics::flip::Seen;
use splatgraph_reference::metrics::{self, MetricError, decibels, squared_error};

const STEP: f32 = 1.0 / 255.0;

/// The error of a picture, of values clamped to 0..1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Error {
    /// Peak signal-to-noise ratio in decibels; `None` if the pictures are equal.
    #[serde(with = "decibels")]
    pub psnr_db: Option<f64>,
    /// Structural similarity, 1 for equal pictures; `None` for pictures smaller than its window.
    pub ssim: Option<f64>,
    /// Mean of NVIDIA's FLIP over the pictures in 8 bits: 0 for equal pictures, at most 1 (Andersson et al. 2020).
    pub flip: f64,
    /// The largest absolute difference of a channel.
    pub worst: f64,
    /// Share of pixels in which a channel differs by more than 1/255.
    pub off: f64,
    /// Number of covered pixels.
    pub covered: usize,
    /// PSNR of the covered pixels; `None` if they are equal, or if no pixel is covered.
    #[serde(with = "decibels")]
    pub covered_psnr_db: Option<f64>,
    /// Share of covered pixels in which a channel differs by more than 1/255; 0 if no pixel is covered.
    pub covered_off: f64,
}

/// Compares a picture with the truth. `covered` is true for each pixel that a splat contributes to. `seen` is the truth
/// in 8 bits after the filters of FLIP.
///
/// # Errors
/// The sizes differ, or a value is not finite.
pub fn measure(picture: &Image, truth: &Image, covered: &[bool], seen: &Seen) -> Result<Error, MetricError> {
    metrics::comparable(picture.into(), truth.into())?;
    let of_pixels = |wanted: &(dyn Fn(usize) -> bool + Sync)| {
        (metrics::psnr_over(picture.into(), truth.into(), &wanted), differences(picture, truth, wanted))
    };
    let (((psnr_db, (worst, off)), (covered_psnr_db, (_, covered_off))), (flip, ssim)) = rayon::join(
        || rayon::join(|| of_pixels(&|_| true), || of_pixels(&|pixel| covered[pixel])),
        || {
            let flip = || seen.flip(&Seen::of_8_bits(picture.into()), None);
            rayon::join(flip, || metrics::ssim(picture.into(), truth.into(), None))
        },
    );
    let covered = covered.iter().filter(|covered| **covered).count();
    Ok(Error { psnr_db, ssim, flip, worst, off, covered, covered_psnr_db, covered_off })
}

/// Returns the mean of values; 0 if there are none.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0u32), |(sum, count), v| (sum + v, count + 1));
    sum / f64::from(count.max(1))
}

/// Computes the PSNR of the mean of the views' squared errors; infinite if all are 0, or without views. `None` is a
/// view without an error.
pub fn joint_psnr(of_views: impl Iterator<Item = Option<f64>>) -> f64 {
    weighted_psnr(of_views.map(|psnr_db| (psnr_db, 1)))
}

/// Computes the PSNR of several parts together, each given as its PSNR and its number of pixels.
///
/// `None` is a part without an error. The result is infinite if all errors are 0, or if there are no pixels.
pub fn weighted_psnr(parts: impl Iterator<Item = (Option<f64>, usize)>) -> f64 {
    let (sum, count) = parts.fold((0.0, 0), |(sum, count), (psnr_db, pixels)| {
        (sum + pixels as f64 * squared_error(psnr_db), count + pixels)
    });
    -10.0 * (sum / count.max(1) as f64).log10()
}

/// Returns the largest difference of a channel, and the share of pixels that differ by more than [`STEP`].
///
/// Only the `wanted` pixels count. A pixel differs by its largest difference of a channel.
fn differences(picture: &Image, truth: &Image, wanted: impl Fn(usize) -> bool) -> (f64, f64) {
    let (mut worst, mut off, mut count) = (0.0f32, 0usize, 0usize);
    for (_, (a, b)) in picture.rgb.iter().zip(&truth.rgb).enumerate().filter(|(pixel, _)| wanted(*pixel)) {
        let channels = [0, 1, 2].map(|c| (a[c].clamp(0.0, 1.0) - b[c].clamp(0.0, 1.0)).abs());
        let most = channels.into_iter().fold(0.0, f32::max);
        (worst, off, count) = (worst.max(most), off + usize::from(most > STEP), count + 1);
    }
    (worst.into(), off as f64 / count.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_in_one_pixel_counts_over_all_and_over_the_covered_ones() {
        let truth = Image::from_fn(16, 16, |_, _| [0.5; 3]);
        let mut picture = truth.clone();
        picture.rgb[3] = [0.5, 0.75, 0.5];
        picture.rgb[4] = [0.502, 0.5, 0.5];
        let covered: Vec<bool> = (0..256).map(|i| i < 4).collect();
        let measured = |picture: &Image, truth: &Image| {
            measure(picture, truth, &covered, &Seen::of_8_bits(truth.into())).unwrap()
        };
        let error = measured(&picture, &truth);
        // The MSE over the four covered pixels is 0.0625 / (3 * 4).
        assert!((error.covered_psnr_db.unwrap() - 10.0 * 192f64.log10()).abs() < 1e-9, "{error:?}");
        assert_eq!((error.off, error.covered, error.covered_off), (1.0 / 256.0, 4, 0.25));
        assert!((error.worst - 0.25).abs() < 1e-9 && error.flip > 0.0, "{error:?}");
        // A highlight above white is white, as in a photograph of it.
        let [mut above, mut white] = [picture.clone(), truth.clone()];
        (above.rgb[9], white.rgb[9]) = ([1.5; 3], [1.0; 3]);
        assert_eq!(measured(&above, &white).worst, error.worst);
        let same = measured(&truth, &truth);
        assert_eq!((same.psnr_db, same.flip, same.off, same.ssim), (None, 0.0, 0.0, Some(1.0)));
        // JSON distinguishes an infinite PSNR from one that was not measured.
        let json = serde_json::to_value(&same).unwrap();
        assert_eq!((&json["psnr_db"], &json["covered_psnr_db"]), (&"inf".into(), &"inf".into()));
        assert_eq!(serde_json::from_value::<Error>(json).unwrap(), same);
    }
}
