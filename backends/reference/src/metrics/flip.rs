//! Measures the difference that a viewer perceives when flipping between two pictures.
//!
//! The source is Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, "FLIP: A Difference Evaluator
//! for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020; numbers in brackets are its
//! equations. Both pictures are filtered by the contrast sensitivity of the eye at the display's distance. Their
//! colours are compared in a perceptually uniform space, and the difference is amplified where edges or points differ.
//!
//! [`Seen::of_floats`] filters a picture without rounding it. [`Seen::of_8_bits`] first rounds it to 8 bits, as a file
//! or a display does; the result is then that of NVIDIA's program, which computes in f32. Where pictures differ by less
//! than a step, rounding hides the difference or amplifies it to a whole step.

use super::{BAND, ImageRef, LANES, weighted};
use crate::srgb;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Pixels per degree of a 4K display, seen from a distance that equals its width.
const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;

/// A picture after the filters of FLIP, 20 bytes a pixel. A picture that is compared several times is filtered once.
pub struct Seen {
    width: usize,
    /// Colours in L*a*b* with the Hunt effect.
    colour: Vec<[f32; 3]>,
    /// Strength of the edge and of the point at each pixel.
    features: Vec<[f32; 2]>,
}

impl Seen {
    /// Filters a picture. Values are clamped to 0..1.
    pub fn of_floats(image: ImageRef) -> Seen {
        Seen::in_bands(image, BAND, |value| srgb::decode(super::shown(value)))
    }

    /// Filters a picture in 8 bits. Values are clamped to 0..1, and rounded to multiples of 1/255.
    pub fn of_8_bits(image: ImageRef) -> Seen {
        let levels: [f64; 256] = std::array::from_fn(|level| srgb::decode(level as f64 / 255.0));
        Seen::in_bands(image, BAND, |value| levels[(super::shown(value) * 255.0).round() as usize])
    }

    /// Computes the mean FLIP over the pixels: 0 for equal pictures, at most 1.
    ///
    /// With a mask, which has a value per pixel, the mean is over the pixels that are true. Panics if the sizes differ.
    pub fn flip(&self, other: &Seen, mask: Option<&[bool]>) -> f64 {
        let size = |seen: &Seen| (seen.width, seen.colour.len());
        assert_eq!(size(self), size(other), "pictures of one size");
        // No two colours are farther apart than green and blue.
        let most = distance(hunt(to_lab([0.0, 1.0, 0.0])), hunt(to_lab([0.0, 0.0, 1.0])));
        let of = |at: usize| {
            let (a, b) = (self.colour[at].map(f64::from), other.colour[at].map(f64::from));
            if a == b { 0.0 } else { difference(a, b, most).powf(1.0 - self.feature(other, at)) }
        };
        // Sums of rows are added in order, so that the result is deterministic.
        let rows = self.colour.len() / self.width.max(1);
        let counts = |at: &usize| mask.is_none_or(|mask| mask[*at]);
        let row = |y: usize| (y * self.width..(y + 1) * self.width).filter(counts).map(of).sum();
        let sums: Vec<f64> = (0..rows).into_par_iter().map(row).collect();
        let count = (0..self.colour.len()).filter(counts).count();
        sums.iter().sum::<f64>() / count.max(1) as f64
    }

    /// Filters a picture in bands of `band` rows, in parallel; `linear` decodes a value.
    fn in_bands(image: ImageRef, band: usize, linear: impl Fn(f64) -> f64 + Sync) -> Seen {
        let (width, height) = (image.width, image.height);
        let inverse = TO_XYZ.inverse();
        let of_band = |top: usize| {
            // With the rows within the reach of the filters, pixels have the same values as in the whole picture.
            let rows = top.saturating_sub(reach())..(top + band + reach()).min(height);
            let pixels = image.rgb.range(rows.start * width..rows.end * width);
            let opponent: Vec<[f64; 3]> = pixels.map(|pixel| to_opponent(pixel.map(&linear))).collect();
            let plane = |channel: usize| Plane {
                width,
                height: rows.len(),
                values: opponent.iter().map(|pixel| pixel[channel]).collect(),
            };
            let filtered = [0, 1, 2].map(|channel| contrast(&plane(channel), SENSITIVITY[channel]));
            // Features are detected in the lightness, scaled to 0..1.
            let mut lightness = plane(0);
            lightness.values.iter_mut().for_each(|value| *value = (*value + 16.0) / 116.0);
            let own = (top - rows.start) * width..((top + band).min(height) - rows.start) * width;
            let colour = own.clone().map(|at| {
                let rgb = from_opponent([0, 1, 2].map(|channel| filtered[channel].values[at]), &inverse);
                hunt(to_lab(rgb.map(|value| value.clamp(0.0, 1.0)))).map(|value| value as f32)
            });
            (colour.collect::<Vec<_>>(), features(&lightness)[own].to_vec())
        };
        let tops: Vec<usize> = (0..height).step_by(band).collect();
        let bands: Vec<_> = tops.into_par_iter().map(of_band).collect();
        let (mut colour, mut features) = (Vec::new(), Vec::new());
        for (of_colour, of_features) in bands {
            colour.extend(of_colour);
            features.extend(of_features);
        }
        Seen { width, colour, features }
    }

    /// Computes the difference of the features at a pixel, 0 to 1 [16].
    fn feature(&self, other: &Seen, at: usize) -> f64 {
        let of = |kind: usize| f64::from((self.features[at][kind] - other.features[at][kind]).abs());
        (of(0).max(of(1)) / 2f64.sqrt()).sqrt().min(1.0)
    }
}

/// Matrix from linear RGB to XYZ (IEC 61966-2-1). The sums of its rows are the white point D65.
const TO_XYZ: DMat3 = DMat3::from_cols(
    DVec3::new(0.412_390_8, 0.212_639_0, 0.019_330_8),
    DVec3::new(0.357_584_3, 0.715_168_7, 0.119_194_8),
    DVec3::new(0.180_480_8, 0.072_192_3, 0.950_532_2),
);

/// Converts linear RGB to XYZ, relative to the white point.
fn relative(rgb: [f64; 3]) -> [f64; 3] {
    (TO_XYZ * DVec3::from(rgb) / (TO_XYZ * DVec3::ONE)).into()
}

/// Converts linear RGB to the opponent space YCxCz.
fn to_opponent(rgb: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = relative(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Converts YCxCz to linear RGB; `inverse` is the inverse of [`TO_XYZ`].
fn from_opponent([lightness, x, z]: [f64; 3], inverse: &DMat3) -> [f64; 3] {
    let y = (lightness + 16.0) / 116.0;
    let xyz = DVec3::new(y + x / 500.0, y, y - z / 200.0) * (TO_XYZ * DVec3::ONE);
    (*inverse * xyz).into()
}

fn to_lab(rgb: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let curve = |t: f64| if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = relative(rgb).map(curve);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Scales chroma by lightness: the Hunt effect [6].
fn hunt([lightness, a, b]: [f64; 3]) -> [f64; 3] {
    [lightness, 0.01 * lightness * a, 0.01 * lightness * b]
}

/// Computes the HyAB distance between two colours, raised to the power 0.7 [7].
fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((a[0] - b[0]).abs() + ((a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()).powf(0.7)
}

/// Maps the distance between two colours to a difference from 0 to 1 [8].
///
/// Distances below 0.4 of `most`, the largest possible, are spread over 0 to 0.95, the others over 0.95 to 1.
fn difference(a: [f64; 3], b: [f64; 3], most: f64) -> f64 {
    const PART: f64 = 0.4;
    const OF: f64 = 0.95;
    let (found, edge) = (distance(a, b), PART * most);
    if found < edge { OF * found / edge } else { OF + (found - edge) / (most - edge) * (1.0 - OF) }
}

/// A channel of a picture, by rows.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f64>,
}

impl Plane {
    /// Filters rows by `taps`, of odd length. Pixels beyond an edge equal the nearest pixel.
    fn across(&self, taps: &[f64]) -> Plane {
        let width = self.width;
        let mut values = vec![0.0; self.values.len()];
        let mut padded = Vec::new();
        for (out, row) in values.chunks_mut(width).zip(self.values.chunks(width)) {
            padded.clear();
            padded.extend(std::iter::repeat_n(row[0], taps.len() / 2));
            padded.extend_from_slice(row);
            padded.resize(width + taps.len() + LANES, row[width - 1]);
            for (at, out) in out.chunks_mut(LANES).enumerate() {
                let at = at * LANES;
                let sums = weighted(taps, |tap| &padded[at + tap..at + tap + LANES]);
                out.copy_from_slice(&sums[..out.len()]);
            }
        }
        Plane { values, ..*self }
    }

    /// Filters columns by `taps`, of odd length. Pixels beyond an edge equal the nearest pixel.
    fn down(&self, taps: &[f64]) -> Plane {
        let (width, height) = (self.width, self.height);
        let mut values = vec![0.0; self.values.len()];
        for (y, out) in values.chunks_mut(width).enumerate() {
            let row = |tap: usize| (y + tap).saturating_sub(taps.len() / 2).min(height - 1) * width;
            let (whole, rest) = out.as_chunks_mut::<LANES>();
            for (at, out) in whole.iter_mut().enumerate() {
                *out = weighted(taps, |tap| &self.values[row(tap) + at * LANES..][..LANES]);
            }
            for (at, out) in rest.iter_mut().enumerate() {
                let at = width - width % LANES + at;
                *out = taps.iter().enumerate().map(|(tap, weight)| weight * self.values[row(tap) + at]).sum();
            }
        }
        Plane { values, ..*self }
    }
}

/// Contrast sensitivity of the eye to lightness, red-green and blue-yellow (table 1).
///
/// Each is a sum of Gaussians, with their amplitudes and their widths in degrees squared.
const SENSITIVITY: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];

/// The widest Gaussian of [`SENSITIVITY`], which determines the size of all filters.
const WIDEST: f64 = 0.04;

/// Returns the radius of the colour filters, in pixels. It exceeds that of the feature filters.
fn reach() -> usize {
    (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as usize
}

fn taps(radius: usize, of: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..=2 * radius).map(|at| of(at as f64 - radius as f64)).collect()
}

/// Filters a channel by the eye's contrast sensitivity to it [4, 5].
fn contrast(plane: &Plane, gaussians: &[(f64, f64)]) -> Plane {
    let of = |(amplitude, width): &(f64, f64)| {
        let taps = taps(reach(), |x| (-(PI * x / PIXELS_PER_DEGREE).powi(2) / width).exp());
        let sum: f64 = taps.iter().sum();
        // A two-dimensional Gaussian is the product of a horizontal and a vertical one.
        let weight = amplitude * (PI / width).sqrt() * sum * sum;
        (taps.into_iter().map(|tap| tap / sum).collect::<Vec<f64>>(), weight)
    };
    let kernels: Vec<(Vec<f64>, f64)> = gaussians.iter().map(of).collect();
    let all: f64 = kernels.iter().map(|(_, weight)| weight).sum();
    let mut found = Plane { values: vec![0.0; plane.values.len()], ..*plane };
    for (taps, weight) in &kernels {
        let part = plane.across(taps).down(taps);
        found.values.iter_mut().zip(part.values).for_each(|(sum, value)| *sum += weight / all * value);
    }
    found
}

/// Width of the detected features, in degrees.
const FEATURE: f64 = 0.082;

/// Computes the strength of the edge and of the point at each pixel, by derivatives of a Gaussian [11 to 14].
fn features(lightness: &Plane) -> Vec<[f32; 2]> {
    let deviation = 0.5 * FEATURE * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as usize;
    let bell = |x: f64| (-x * x / (2.0 * deviation * deviation)).exp();
    let smooth = taps(radius, bell);
    let sum: f64 = smooth.iter().sum();
    let smooth: Vec<f64> = smooth.into_iter().map(|tap| tap / sum).collect();
    // Scales the positive taps to a sum of 1, and the negative ones to a sum of -1.
    let balanced = |taps: Vec<f64>| -> Vec<f64> {
        let of = |sign: f64| taps.iter().map(|tap| (sign * tap).max(0.0)).sum::<f64>();
        let (above, below) = (of(1.0), of(-1.0));
        taps.iter().map(|tap| if *tap > 0.0 { tap / above } else { tap / below }).collect()
    };
    let edge = balanced(taps(radius, |x| -x * bell(x)));
    let point = balanced(taps(radius, |x| (x * x / (deviation * deviation) - 1.0) * bell(x)));
    let smoothed = lightness.across(&smooth);
    let strength = |kernel: &[f64]| -> Vec<f64> {
        let (across, down) = (lightness.across(kernel).down(&smooth), smoothed.down(kernel));
        across.values.iter().zip(&down.values).map(|(x, y)| (x * x + y * y).sqrt()).collect()
    };
    let (edges, points) = (strength(&edge), strength(&point));
    edges.into_iter().zip(points).map(|(edge, point)| [edge as f32, point as f32]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::tests::Image;

    fn pattern(width: usize, height: usize, seed: usize) -> Image {
        Image::from_fn(width, height, |x, y| {
            let flat = (x / 9 + y / 7 + seed) % 5;
            std::array::from_fn(|c| {
                let point = usize::from((x * 31 + y * 17 + seed).is_multiple_of(97)) * 90;
                ((flat * (40 + 11 * c) + point + (x * (c + 1)) % 23) % 256) as f32 / 255.0
            })
        })
    }

    fn of_floats(a: &Image, b: &Image) -> f64 {
        Seen::of_floats(a.into()).flip(&Seen::of_floats(b.into()), None)
    }

    fn of_8_bits(a: &Image, b: &Image) -> f64 {
        Seen::of_8_bits(a.into()).flip(&Seen::of_8_bits(b.into()), None)
    }

    fn by_nvidia(a: &Image, b: &Image) -> f64 {
        let [a, b] = [a, b].map(|image| {
            let bytes: Vec<u8> = image.rgb.as_flattened().iter().map(|v| (v * 255.0).round() as u8).collect();
            nv_flip::FlipImageRgb8::with_data(image.width as u32, image.height as u32, &bytes)
        });
        let values = nv_flip::flip(a, b, PIXELS_PER_DEGREE as f32).to_vec();
        values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64
    }

    #[test]
    fn in_8_bits_it_is_what_nvidias_program_computes() {
        for (width, height) in [(48, 36), (70, 20), (33, 7), (3, 2), (1, 1)] {
            let (a, b) = (pattern(width, height, 0), pattern(width, height, 3));
            let (own, nvidia) = (of_8_bits(&a, &b), by_nvidia(&a, &b));
            assert!(
                own > 0.05 && (own - nvidia).abs() < 1e-4 * nvidia,
                "{width} x {height}: {own} and {nvidia}"
            );
            assert!((of_floats(&a, &b) - own).abs() < 1e-6 * own, "the pictures are multiples of 1/255");
        }
        let a = pattern(48, 36, 0);
        let dark = Image::from_fn(48, 36, |x, y| a.at(x, y).map(|v| (v * 250.0).round() / 255.0));
        let (own, nvidia) = (of_8_bits(&a, &dark), by_nvidia(&a, &dark));
        assert!(own > 0.001 && (own - nvidia).abs() < 1e-3 * nvidia, "{own} and {nvidia}");
    }

    #[test]
    fn bands_of_rows_have_the_values_of_the_whole_picture() {
        let (a, b) = (pattern(41, 70, 0), pattern(41, 70, 3));
        let of = |band: usize| {
            let seen = |image: &Image| Seen::in_bands(image.into(), band, srgb::decode);
            seen(&a).flip(&seen(&b), None)
        };
        assert!(of(70) > 0.05);
        for band in [1, 9, 32, 64, 100] {
            assert_eq!(of(band).to_bits(), of(70).to_bits(), "bands of {band} rows");
        }
    }

    #[test]
    fn a_difference_below_a_step_of_8_bits_is_seen_in_floats_alone() {
        let grey = |value: f32| Image::from_fn(20, 20, |_, _| [value; 3]);
        let (a, b) = (grey(100.0 / 255.0), grey(100.3 / 255.0));
        assert_eq!((of_floats(&a, &a), of_8_bits(&a, &b)), (0.0, 0.0));
        assert!(of_floats(&a, &b) > 1e-4);
        // Values above white are clamped.
        assert_eq!(of_floats(&grey(1.0), &grey(1.5)), 0.0);
        assert!(of_floats(&grey(0.0), &grey(1.0)) > 0.9);
    }
}
