//! Measures the difference between two pictures.
//!
//! **PSNR** is the mean squared error of the whole picture, in decibels; **SSIM** compares local structure, closer to
//! perception; the **worst pixel** reveals a single missing splat. [`flip`] measures the perceived difference between
//! alternating pictures. All sums are in f64.

pub mod decibels;
pub mod flip;

use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// A borrowed picture: rows from the top, pixels from the left, display-encoded RGB, not clamped.
#[derive(Clone, Copy, Debug)]
pub struct ImageRef<'a> {
    /// Width, in pixels.
    pub width: usize,
    /// Height, in pixels.
    pub height: usize,
    /// `width * height` pixels, row by row.
    pub rgb: Rgb<'a>,
}

/// The pixels of a picture. 0 is black and 1 is white.
///
/// An enum instead of a generic type, so that the metrics are compiled, and optimised, in this crate.
#[derive(Clone, Copy, Debug)]
pub enum Rgb<'a> {
    /// Pixels in single precision.
    F32(&'a [[f32; 3]]),
    /// Pixels in double precision.
    F64(&'a [[f64; 3]]),
}

impl Rgb<'_> {
    fn len(self) -> usize {
        match self {
            Rgb::F32(pixels) => pixels.len(),
            Rgb::F64(pixels) => pixels.len(),
        }
    }

    fn at(self, index: usize) -> [f64; 3] {
        match self {
            Rgb::F32(pixels) => pixels[index].map(f64::from),
            Rgb::F64(pixels) => pixels[index],
        }
    }

    fn range(self, range: Range<usize>) -> impl Iterator<Item = [f64; 3]> {
        range.map(move |index| self.at(index))
    }
}

impl ImageRef<'_> {
    fn pixels(self) -> impl Iterator<Item = [f64; 3]> {
        self.rgb.range(0..self.rgb.len())
    }
}

/// Number of rows of a band. Bands are measured in parallel, and bound the memory of intermediate values.
const BAND: usize = 64;
/// Radius of SSIM's window, in pixels: 11 x 11. Its map lacks a border of this width.
const SSIM_RADIUS: usize = 5;
/// Standard deviation of SSIM's window, in pixels.
const SIGMA: f64 = 1.5;

/// The result of [`compare`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Peak signal-to-noise ratio in decibels, `10 log10(1 / MSE)` of values clamped to 0..1; `None` if the MSE is 0.
    #[serde(serialize_with = "decibels::serialize")]
    pub psnr_db: Option<f64>,
    /// Structural similarity, 1 for equal pictures. See [`ssim`]. `None` for pictures smaller than its window.
    pub ssim: Option<f64>,
    /// The pixel with the largest difference.
    pub worst: WorstPixel,
    /// True if every channel of every pixel is equal, also between single and double precision.
    pub identical: bool,
}

impl Comparison {
    /// Returns PSNR in decibels, infinite if the error is 0.
    pub fn psnr(&self) -> f64 {
        self.psnr_db.unwrap_or(f64::INFINITY)
    }
}

/// The pixel with the largest absolute difference of a channel; of several, the first by rows.
///
/// Values are not clamped, so that differences above white count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstPixel {
    /// The largest absolute difference over the channels, 0 for identical pictures.
    pub difference: f64,
    /// Column, from 0 at the left.
    pub x: usize,
    /// Row, from 0 at the top.
    pub y: usize,
}

/// Reasons why two pictures cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MetricError {
    /// The sizes differ.
    #[error("expected pictures of the same size, found {a_width} x {a_height} and {b_width} x {b_height}")]
    Sizes {
        /// Width of the first picture, in pixels.
        a_width: usize,
        /// Height of the first picture, in pixels.
        a_height: usize,
        /// Width of the second picture, in pixels.
        b_width: usize,
        /// Height of the second picture, in pixels.
        b_height: usize,
    },
    /// A picture has NaN or infinite values.
    #[error(
        "expected finite values, found NaN or infinity in {which}, at {count} pixels, the first ({x}, {y})"
    )]
    NotFinite {
        /// `the first picture` or `the second picture`.
        which: &'static str,
        /// Number of pixels with a value that is not finite.
        count: usize,
        /// Column of the first such pixel, from 0.
        x: usize,
        /// Row of the first such pixel, from 0.
        y: usize,
    },
}

/// Computes PSNR, SSIM and the worst pixel of two pictures.
///
/// # Errors
/// The sizes differ, or a value is not finite.
pub fn compare(a: ImageRef, b: ImageRef) -> Result<Comparison, MetricError> {
    comparable(a, b)?;
    let worst = worst_pixel(a, b);
    let identical = worst.difference == 0.0;
    Ok(Comparison { psnr_db: psnr_over(a, b, &|_| true), ssim: ssim(a, b, None), worst, identical })
}

/// Checks that two pictures have the same size, and finite values.
///
/// # Errors
/// The sizes differ, or a value is not finite.
pub fn comparable(a: ImageRef, b: ImageRef) -> Result<(), MetricError> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(MetricError::Sizes {
            a_width: a.width,
            a_height: a.height,
            b_width: b.width,
            b_height: b.height,
        });
    }
    for (which, image) in [("the first picture", a), ("the second picture", b)] {
        let is_bad = |pixel: [f64; 3]| pixel.iter().any(|value| !value.is_finite());
        if let Some(first) = image.pixels().position(is_bad) {
            let count = image.pixels().filter(|pixel| is_bad(*pixel)).count();
            return Err(MetricError::NotFinite {
                which,
                count,
                x: first % image.width,
                y: first / image.width,
            });
        }
    }
    Ok(())
}

/// Converts PSNR to mean squared error (range 0 to 1). `None`, the PSNR of an error of 0, gives 0.
pub fn squared_error(psnr_db: Option<f64>) -> f64 {
    psnr_db.map_or(0.0, |db| 10f64.powf(-db / 10.0))
}

/// Number of neighbouring pixels that are filtered at once, in vector registers.
const LANES: usize = 8;

/// Sums the pixels under a filter with weights `taps`, for [`LANES`] neighbouring pixels. `of` returns the pixels under
/// a tap.
fn weighted<'a>(taps: &[f64], of: impl Fn(usize) -> &'a [f64]) -> [f64; LANES] {
    let mut sums = [0.0; LANES];
    for (tap, weight) in taps.iter().enumerate() {
        sums.iter_mut().zip(of(tap)).for_each(|(sum, value)| *sum += weight * value);
    }
    sums
}

fn shown(value: f64) -> f64 {
    value.clamp(0.0, 1.0)
}

/// Computes PSNR in decibels over the pixels that `wanted` accepts by index, for pictures of one size.
///
/// `None` if these pixels are equal after clamping to 0..1, or if there are none.
pub fn psnr_over(a: ImageRef, b: ImageRef, wanted: &dyn Fn(usize) -> bool) -> Option<f64> {
    let (mut sum, mut channels) = (0.0, 0usize);
    for (_, (a, b)) in a.pixels().zip(b.pixels()).enumerate().filter(|(index, _)| wanted(*index)) {
        for (a, b) in a.into_iter().zip(b) {
            sum += (shown(a) - shown(b)).powi(2);
        }
        channels += 3;
    }
    (sum > 0.0).then(|| -10.0 * (sum / channels as f64).log10())
}

/// Finds the pixel with the largest difference of a channel, for pictures of one size; of equal ones, the first.
pub fn worst_pixel(a: ImageRef, b: ImageRef) -> WorstPixel {
    let mut worst = WorstPixel { difference: 0.0, x: 0, y: 0 };
    for (i, (a_pixel, b_pixel)) in a.pixels().zip(b.pixels()).enumerate() {
        for c in 0..3 {
            let difference = (a_pixel[c] - b_pixel[c]).abs();
            if difference > worst.difference {
                worst = WorstPixel { difference, x: i % a.width, y: i / a.width };
            }
        }
    }
    worst
}

/// Computes the mean structural similarity (SSIM) of two pictures of one size.
///
/// The source is Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment: From Error Visibility to Structural
/// Similarity", IEEE TIP 13(4), 2004, with its constants: a Gaussian window of 11 x 11 with standard deviation 1.5 and
/// sum 1, K1 = 0.01, K2 = 0.03, and a dynamic range of 1. Values are clamped to 0..1 first.
///
/// The paper leaves three choices: the map covers only pixels whose window is inside the picture (no padding),
/// variances are weighted by the window (not scaled to n - 1), and a colour picture's value is the mean over its
/// channels. scikit-image computes the same as `structural_similarity(a, b, gaussian_weights=True, sigma=1.5,
/// use_sample_covariance=False, data_range=1, channel_axis=2)`.
///
/// With a mask, which has a value per pixel, the mean is over the map's pixels that are true.
///
/// Returns `None` without such pixels: for pictures with fewer than 11 columns or rows, for instance. Panics if the
/// sizes differ.
pub fn ssim(a: ImageRef, b: ImageRef, mask: Option<&[bool]>) -> Option<f64> {
    assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
    let width = a.width;
    let (columns, rows) = (width.checked_sub(2 * SSIM_RADIUS)?, a.height.checked_sub(2 * SSIM_RADIUS)?);
    // The mask of a row of the map.
    let of_row = |y: usize| Some(&mask?[(y + SSIM_RADIUS) * width + SSIM_RADIUS..][..columns]);
    let counted = |y: usize| of_row(y).map_or(columns, |row| row.iter().filter(|counts| **counts).count());
    let count: usize = (0..rows).map(counted).sum();
    let window = gaussian_window();
    let of_band = |top: usize| -> Vec<f64> {
        let band = top..(top + BAND).min(rows);
        let pixels = top * width..(band.end + 2 * SSIM_RADIUS) * width;
        let channels = |image: ImageRef| -> [Vec<f64>; 3] {
            [0, 1, 2].map(|c| image.rgb.range(pixels.clone()).map(|pixel| shown(pixel[c])).collect())
        };
        let (a, b) = (channels(a), channels(b));
        let mut moments = Default::default();
        let of = |y: usize| {
            let mask = of_row(top + y);
            a.iter().zip(&b).map(|(a, b)| ssim_row([a, b], (y, width), mask, &window, &mut moments)).sum()
        };
        (0..band.len()).map(of).collect()
    };
    let tops: Vec<usize> = (0..rows).step_by(BAND).collect();
    // Sums are added in order, so that the result is deterministic.
    let sums: Vec<f64> = tops.into_par_iter().flat_map_iter(of_band).collect();
    (count > 0).then(|| sums.iter().sum::<f64>() / (3 * count) as f64)
}

fn gaussian_window() -> [f64; 2 * SSIM_RADIUS + 1] {
    let mut window: [f64; 2 * SSIM_RADIUS + 1] =
        std::array::from_fn(|i| (-(i as f64 - SSIM_RADIUS as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f64 = window.iter().sum();
    window.iter_mut().for_each(|w| *w /= sum);
    window
}

/// Sums one row of a channel's SSIM map, where `mask` is true; the windows begin at row `top` of pictures with `width`
/// columns.
///
/// The window is separable: the five moments are summed by columns, into `moments`, then by rows.
fn ssim_row(
    [a, b]: [&[f64]; 2],
    (top, width): (usize, usize),
    mask: Option<&[bool]>,
    window: &[f64; 2 * SSIM_RADIUS + 1],
    moments: &mut [Vec<f64>; 5],
) -> f64 {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    // Weighted means of a, b, a a, b b, a b.
    for moment in &mut *moments {
        moment.clear();
        moment.resize(width + LANES, 0.0);
    }
    let [ma, mb, maa, mbb, mab] = moments.each_mut().map(|moment| &mut moment[..width]);
    for (dy, weight) in window.iter().enumerate() {
        let row = (top + dy) * width..(top + dy + 1) * width;
        let (a, b) = (&a[row.clone()], &b[row]);
        for x in 0..width {
            let (a, b) = (a[x], b[x]);
            ma[x] += weight * a;
            mb[x] += weight * b;
            maa[x] += weight * (a * a);
            mbb[x] += weight * (b * b);
            mab[x] += weight * (a * b);
        }
    }
    let (columns, mut sum) = (width - 2 * SSIM_RADIUS, 0.0);
    for at in (0..columns).step_by(LANES) {
        let means = moments.each_ref().map(|moment| weighted(window, |tap| &moment[at + tap..][..LANES]));
        for lane in 0..LANES.min(columns - at) {
            let [a, b, aa, bb, ab] = means.map(|mean| mean[lane]);
            let (a_variance, b_variance, covariance) = (aa - a * a, bb - b * b, ab - a * b);
            let value = ((2.0 * a * b + C1) * (2.0 * covariance + C2))
                / ((a * a + b * b + C1) * (a_variance + b_variance + C2));
            sum += if mask.is_none_or(|mask| mask[at + lane]) { value } else { 0.0 };
        }
    }
    sum
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub struct Image {
        pub width: usize,
        pub height: usize,
        pub rgb: Vec<[f32; 3]>,
    }

    impl Image {
        pub fn from_fn(width: usize, height: usize, pixel: impl Fn(usize, usize) -> [f32; 3]) -> Image {
            let rgb = (0..width * height).map(|at| pixel(at % width, at / width)).collect();
            Image { width, height, rgb }
        }

        pub fn at(&self, x: usize, y: usize) -> [f32; 3] {
            self.rgb[y * self.width + x]
        }
    }

    impl<'a> From<&'a Image> for ImageRef<'a> {
        fn from(Image { width, height, rgb }: &'a Image) -> Self {
            ImageRef { width: *width, height: *height, rgb: Rgb::F32(rgb) }
        }
    }

    /// Computes multiples of 1/100 in integer arithmetic, so that another program can reproduce the picture exactly.
    fn pattern(width: usize, height: usize, seed: usize) -> Image {
        Image::from_fn(width, height, |x, y| {
            std::array::from_fn(|c| ((x * 7 + y * 13 + c * 29 + x * y * seed) % 101) as f32 / 100.0)
        })
    }

    fn grey(width: usize, height: usize, value: f32) -> Image {
        Image { width, height, rgb: vec![[value; 3]; width * height] }
    }

    #[test]
    fn a_tenth_everywhere_is_20_db_and_one_channel_of_two_pixels_is_less() {
        let found = compare((&grey(4, 3, 0.25)).into(), (&grey(4, 3, 0.35)).into()).unwrap();
        assert!((found.psnr() - 20.0).abs() < 1e-5, "{found:?}");

        let a = Image { width: 2, height: 1, rgb: vec![[0.0; 3], [0.0, 0.5, 0.0]] };
        let found = compare((&a).into(), (&grey(2, 1, 0.0)).into()).unwrap();
        assert!((found.psnr() - 10.0 * 24f64.log10()).abs() < 1e-12, "{found:?}");
        assert_eq!(found.worst, WorstPixel { difference: 0.5, x: 1, y: 0 });
        assert!(!found.identical);
    }

    #[test]
    fn identical_pictures_have_an_infinite_ratio() {
        let a = pattern(20, 20, 3);
        let found = compare((&a).into(), (&a).into()).unwrap();
        assert_eq!(found.psnr(), f64::INFINITY);
        assert_eq!(found.worst.difference, 0.0);
        assert!(found.identical);
        assert!((found.ssim.unwrap() - 1.0).abs() < 1e-12);
        let rgb: Vec<[f64; 3]> = a.rgb.iter().map(|pixel| pixel.map(f64::from)).collect();
        let double = ImageRef { width: 20, height: 20, rgb: Rgb::F64(&rgb) };
        assert!(compare((&a).into(), double).unwrap().identical, "equal values in another precision");
    }

    #[test]
    fn the_ratio_is_of_what_is_shown_and_the_worst_pixel_of_what_is_stored() {
        let found = compare((&grey(12, 12, 1.0)).into(), (&grey(12, 12, 1.5)).into()).unwrap();
        assert_eq!(found.psnr(), f64::INFINITY);
        assert_eq!(found.worst.difference, 0.5);
        assert!(!found.identical);
    }

    #[test]
    fn constant_pictures_have_the_similarity_of_their_luminance_alone() {
        // Variances are zero, so the value is (2 a b + C1) / (a^2 + b^2 + C1).
        let (a, b) = (0.25f64, 0.75f64);
        let expected = (2.0 * a * b + 1e-4) / (a * a + b * b + 1e-4);
        let found = ssim((&grey(15, 11, a as f32)).into(), (&grey(15, 11, b as f32)).into(), None).unwrap();
        assert!((found - expected).abs() < 1e-12, "{found} and {expected}");
    }

    #[test]
    fn pictures_smaller_than_the_window_have_no_similarity() {
        assert_eq!(ssim((&grey(10, 40, 0.5)).into(), (&grey(10, 40, 0.5)).into(), None), None);
        assert!(ssim((&grey(11, 11, 0.5)).into(), (&grey(11, 11, 0.5)).into(), None).is_some());
    }

    // Computed by scikit-image in float64, with the call in [`ssim`]'s documentation.
    #[test]
    fn similarity_agrees_with_scikit_image() {
        for (width, height, expected) in
            [(37, 23, SKIMAGE_37_23), (11, 11, SKIMAGE_11_11), (64, 48, SKIMAGE_64_48)]
        {
            let (a, noise) = (pattern(width, height, 3), pattern(width, height, 4));
            let b = Image::from_fn(width, height, |x, y| {
                std::array::from_fn(|c| 0.75 * a.at(x, y)[c] + 0.25 * noise.at(x, y)[c])
            });
            let found = ssim((&a).into(), (&b).into(), None).unwrap();
            assert!((found - expected).abs() < 1e-9, "{width} x {height}: {found} and {expected}");
        }
    }
    const SKIMAGE_37_23: f64 = 0.919814333876476;
    const SKIMAGE_11_11: f64 = 0.9300667448589367;
    const SKIMAGE_64_48: f64 = 0.9208822108055951;

    #[test]
    fn pictures_of_other_sizes_or_with_nan_cannot_be_compared() {
        let message = compare((&grey(2, 3, 0.0)).into(), (&grey(3, 2, 0.0)).into()).unwrap_err().to_string();
        assert_eq!(message, "expected pictures of the same size, found 2 x 3 and 3 x 2");
        let mut bad = grey(3, 2, 0.0);
        bad.rgb[4] = [0.0, f32::NAN, f32::NAN];
        bad.rgb[5][2] = f32::INFINITY;
        let message = compare((&grey(3, 2, 0.0)).into(), (&bad).into()).unwrap_err().to_string();
        assert_eq!(
            message,
            "expected finite values, found NaN or infinity in the second picture, at 2 pixels, the first (1, 1)"
        );
    }
}
