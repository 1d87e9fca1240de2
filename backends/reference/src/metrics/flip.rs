//! Measures the difference that a viewer perceives when flipping between two pictures.
//!
//! The source is Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, "FLIP: A Difference Evaluator
//! for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020; numbers in brackets are its
//! equations. Both pictures are filtered by the contrast sensitivity of the eye at the display's distance. Their
//! colours are compared in a perceptually uniform space, and the difference is amplified where edges or points differ.
//!
//! [`of_floats`] compares the pictures as they are. [`of_8_bits`] first rounds them to 8 bits, as a file or a display
//! does, and calls NVIDIA's own implementation. Where pictures differ by less than a step, rounding hides the
//! difference or amplifies it to a whole step.

use super::ImageRef;
use crate::srgb;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;

/// Pixels per degree that FLIP assumes: those of a 4K display, 0.7 m wide, at a distance of 0.7 m.
const PIXELS_PER_DEGREE: f64 = nv_flip::DEFAULT_PIXELS_PER_DEGREE as f64;

/// Computes the mean FLIP over the pixels: 0 for equal pictures, at most 1. Values are clamped to 0..1.
///
/// Panics if the sizes differ.
pub fn of_floats(a: ImageRef, b: ImageRef) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
    let (a, b) = (Seen::of(a), Seen::of(b));
    // No two colours are farther apart than green and blue.
    let most = distance(hunt(to_lab([0.0, 1.0, 0.0])), hunt(to_lab([0.0, 0.0, 1.0])));
    let of = |at: usize| difference(a.colour[at], b.colour[at], most).powf(1.0 - a.feature(&b, at));
    let sum: f64 = (0..a.colour.len()).map(of).sum();
    sum / a.colour.len().max(1) as f64
}

/// Computes the mean FLIP of the pictures in 8 bits, with NVIDIA's implementation.
///
/// Panics if the sizes differ.
pub fn of_8_bits(a: ImageRef, b: ImageRef) -> f64 {
    in_bands(a, b, BAND)
}

/// Number of rows per band in [`of_8_bits`].
const BAND: usize = 128;

/// Computes FLIP in 8 bits by bands of rows in parallel, because NVIDIA's implementation has a single thread.
///
/// A band is extended by the radius of the filters, so that its pixels have the same values as in the whole picture.
fn in_bands(a: ImageRef, b: ImageRef, band: usize) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
    let (width, height) = (a.width, a.height);
    let bytes = |image: ImageRef, rows: &Range<usize>| {
        let level = |value: f64| (super::shown(value) * 255.0).round() as u8;
        let pixels = image.rgb.range(rows.start * width..rows.end * width);
        let bytes: Vec<u8> = pixels.flatten().map(level).collect();
        nv_flip::FlipImageRgb8::with_data(width as u32, rows.len() as u32, &bytes)
    };
    let of_band = |top: usize| {
        let rows = top.saturating_sub(reach())..(top + band + reach()).min(height);
        let values =
            nv_flip::flip(bytes(a, &rows), bytes(b, &rows), nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
        values[(top - rows.start) * width..((top + band).min(height) - rows.start) * width].to_vec()
    };
    let tops: Vec<usize> = (0..height).step_by(band).collect();
    let values: Vec<Vec<f32>> = tops.into_par_iter().map(of_band).collect();
    values.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / a.rgb.len().max(1) as f64
}

/// A picture after the filters of FLIP.
struct Seen {
    /// In L*a*b* with the Hunt effect.
    colour: Vec<[f64; 3]>,
    /// Strength of the edge and of the point at each pixel.
    features: Vec<[f64; 2]>,
}

impl Seen {
    fn of(image: ImageRef) -> Seen {
        let opponent: Vec<[f64; 3]> = (0..image.rgb.len())
            .into_par_iter()
            .map(|at| to_opponent(image.rgb.at(at).map(|value| srgb::decode(super::shown(value)))))
            .collect();
        let plane = |channel: usize| Plane {
            width: image.width,
            height: image.height,
            values: opponent.iter().map(|pixel| pixel[channel]).collect(),
        };
        let filtered = [0, 1, 2].map(|channel| contrast(&plane(channel), SENSITIVITY[channel]));
        let inverse = glam::DMat3::from_cols_array_2d(&TO_XYZ).transpose().inverse();
        let colour = (0..opponent.len()).into_par_iter().map(|at| {
            let rgb = from_opponent([0, 1, 2].map(|channel| filtered[channel].values[at]), &inverse);
            hunt(to_lab(rgb.map(|value| value.clamp(0.0, 1.0))))
        });
        // Features are detected in the lightness, scaled to 0..1.
        let mut lightness = plane(0);
        lightness.values.iter_mut().for_each(|value| *value = (*value + 16.0) / 116.0);
        Seen { colour: colour.collect(), features: features(&lightness) }
    }

    /// Computes the difference of the features at a pixel, 0 to 1 [16].
    fn feature(&self, other: &Seen, at: usize) -> f64 {
        let [edge, point] = [0, 1].map(|kind| (self.features[at][kind] - other.features[at][kind]).abs());
        (edge.max(point) / 2f64.sqrt()).sqrt().min(1.0)
    }
}

/// Matrix from linear RGB to XYZ (IEC 61966-2-1). The sums of its rows are the white point D65.
const TO_XYZ: [[f64; 3]; 3] = [
    [0.412_390_8, 0.357_584_3, 0.180_480_8],
    [0.212_639_0, 0.715_168_7, 0.072_192_3],
    [0.019_330_8, 0.119_194_8, 0.950_532_2],
];

fn product(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|row| (0..3).map(|column| matrix[row][column] * v[column]).sum())
}

/// Converts linear RGB to XYZ, relative to the white point.
fn relative(rgb: [f64; 3]) -> [f64; 3] {
    let (xyz, white) = (product(&TO_XYZ, rgb), product(&TO_XYZ, [1.0; 3]));
    std::array::from_fn(|c| xyz[c] / white[c])
}

/// Converts linear RGB to the opponent space YCxCz.
fn to_opponent(rgb: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = relative(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Converts YCxCz to linear RGB; `inverse` is the inverse of [`TO_XYZ`].
fn from_opponent([lightness, x, z]: [f64; 3], inverse: &glam::DMat3) -> [f64; 3] {
    let y = (lightness + 16.0) / 116.0;
    let white = product(&TO_XYZ, [1.0; 3]);
    let xyz = [y + x / 500.0, y, y - z / 200.0];
    (*inverse * glam::DVec3::from(std::array::from_fn::<f64, 3, _>(|c| xyz[c] * white[c]))).into()
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
    ((a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])).powf(0.7)
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
    /// Filters rows by `across` and columns by `down`, of odd lengths. Pixels beyond an edge equal the nearest pixel.
    fn filtered(&self, across: &[f64], down: &[f64]) -> Plane {
        let (width, height) = (self.width, self.height);
        let mut rows = vec![0.0; self.values.len()];
        rows.par_chunks_mut(width).zip(self.values.par_chunks(width)).for_each(|(out, row)| {
            let edge = |value: f64| std::iter::repeat_n(value, across.len() / 2);
            let padded: Vec<f64> =
                edge(row[0]).chain(row.iter().copied()).chain(edge(row[width - 1])).collect();
            for (out, window) in out.iter_mut().zip(padded.windows(across.len())) {
                *out = across.iter().zip(window).map(|(weight, value)| weight * value).sum();
            }
        });
        let mut values = vec![0.0; rows.len()];
        values.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
            for (tap, weight) in down.iter().enumerate() {
                let from = (y + tap).saturating_sub(down.len() / 2).min(height - 1);
                let row = &rows[from * width..(from + 1) * width];
                out.iter_mut().zip(row).for_each(|(out, value)| *out += weight * value);
            }
        });
        Plane { width, height, values }
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
        let part = plane.filtered(taps, taps);
        found.values.iter_mut().zip(part.values).for_each(|(sum, value)| *sum += weight / all * value);
    }
    found
}

/// Width of the detected features, in degrees.
const FEATURE: f64 = 0.082;

/// Computes the strength of the edge and of the point at each pixel, by derivatives of a Gaussian [11 to 14].
fn features(lightness: &Plane) -> Vec<[f64; 2]> {
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
    let strength = |kernel: &[f64]| -> Vec<f64> {
        let (across, down) = (lightness.filtered(kernel, &smooth), lightness.filtered(&smooth, kernel));
        across.values.iter().zip(&down.values).map(|(x, y)| x.hypot(*y)).collect()
    };
    let (edges, points) = (strength(&edge), strength(&point));
    edges.into_iter().zip(points).map(|(edge, point)| [edge, point]).collect()
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

    #[test]
    fn in_8_bits_it_is_what_nvidias_program_computes() {
        for (width, height) in [(48, 36), (70, 20), (3, 2), (1, 1)] {
            let (a, b) = (pattern(width, height, 0), pattern(width, height, 3));
            let (own, nvidia) = (of_floats((&a).into(), (&b).into()), of_8_bits((&a).into(), (&b).into()));
            assert!(
                own > 0.05 && (own - nvidia).abs() < 1e-4 * nvidia,
                "{width} x {height}: {own} and {nvidia}"
            );
        }
        let a = pattern(48, 36, 0);
        let dark = Image::from_fn(48, 36, |x, y| a.at(x, y).map(|v| (v * 250.0).round() / 255.0));
        let (own, nvidia) = (of_floats((&a).into(), (&dark).into()), of_8_bits((&a).into(), (&dark).into()));
        assert!(own > 0.001 && (own - nvidia).abs() < 1e-3 * nvidia, "{own} and {nvidia}");
    }

    #[test]
    fn bands_of_rows_have_the_values_of_the_whole_picture() {
        let (a, b) = (pattern(40, 70, 0), pattern(40, 70, 3));
        let whole = in_bands((&a).into(), (&b).into(), 70);
        assert!(whole > 0.05);
        for band in [1, 9, 32, 64, 100] {
            assert_eq!(
                in_bands((&a).into(), (&b).into(), band).to_bits(),
                whole.to_bits(),
                "bands of {band} rows"
            );
        }
    }

    #[test]
    fn a_difference_below_a_step_of_8_bits_is_seen_in_floats_alone() {
        let a = Image::from_fn(20, 20, |_, _| [100.0 / 255.0; 3]);
        let b = Image::from_fn(20, 20, |_, _| [100.3 / 255.0; 3]);
        assert_eq!((of_floats((&a).into(), (&a).into()), of_8_bits((&a).into(), (&b).into())), (0.0, 0.0));
        assert!(of_floats((&a).into(), (&b).into()) > 1e-4);
        // Values above white are clamped.
        let grey = |value: f32| Image::from_fn(20, 20, |_, _| [value; 3]);
        assert_eq!(of_floats((&grey(1.0)).into(), (&grey(1.5)).into()), 0.0);
        assert!(of_floats((&grey(0.0)).into(), (&grey(1.0)).into()) > 0.9);
    }
}
