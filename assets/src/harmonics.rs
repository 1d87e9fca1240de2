//! Evaluates and fits real spherical harmonics, in the basis and with the signs of the 3DGS reference implementation.
//!
//! A splat's colour in direction `d` (unit, from the camera to the splat) is `max(0, 0.5 + sum_k c_k Y_k(d))` per
//! channel. Coefficient 0 is band 0, 1 to 3 band 1, 4 to 8 band 2, 9 to 15 band 3.
//!
//! A *lobe* is a function that is symmetric about an axis: here a cubic in the cosine of the angle to the axis. The
//! addition theorem of spherical harmonics converts its Legendre coefficients to the sixteen above (see [`Zonal`]).

use glam::{DQuat, DVec3};
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Evaluates the sixteen basis functions of degrees 0 to 3 at a unit direction.
///
/// Source of the constants: the orthonormal real harmonics, sqrt((2l+1)/(4 pi) (l-m)!/(l+m)!), times sqrt(2) for
/// m != 0. The signs of odd m are negative, as in the reference.
pub fn basis([x, y, z]: [f64; 3]) -> [f64; 16] {
    let c0 = (1.0 / (4.0 * PI)).sqrt();
    let c1 = (3.0 / (4.0 * PI)).sqrt();
    let c2 = (15.0 / (4.0 * PI)).sqrt();
    let c20 = (5.0 / (16.0 * PI)).sqrt();
    let c22 = (15.0 / (16.0 * PI)).sqrt();
    let c30 = (7.0 / (16.0 * PI)).sqrt();
    let c31 = (21.0 / (32.0 * PI)).sqrt();
    let c32 = (105.0 / (4.0 * PI)).sqrt();
    let c320 = (105.0 / (16.0 * PI)).sqrt();
    let c33 = (35.0 / (32.0 * PI)).sqrt();
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        c0,
        -c1 * y,
        c1 * z,
        -c1 * x,
        c2 * x * y,
        -c2 * y * z,
        c20 * (2.0 * zz - xx - yy),
        -c2 * x * z,
        c22 * (xx - yy),
        -c33 * y * (3.0 * xx - yy),
        c32 * x * y * z,
        -c31 * y * (4.0 * zz - xx - yy),
        c30 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -c31 * x * (4.0 * zz - xx - yy),
        c320 * z * (xx - yy),
        -c33 * x * (xx - 3.0 * yy),
    ]
}

/// A rotation of spherical harmonics, as a matrix.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Turn {
    /// Row `j` gives coefficient `j` of the rotated function. `None` is the identity, which changes no bit.
    matrix: Option<[[f64; 16]; 16]>,
}

/// Returns the range of the coefficients of the band that has coefficient `j`.
fn band_of(j: usize) -> Range<usize> {
    let l = j.isqrt();
    l * l..(l + 1) * (l + 1)
}

impl Turn {
    /// Computes the matrix of a rotation.
    ///
    /// Its elements are the integrals of `Y_j(d) Y_k(R^-1 d)` over the sphere. The product is a polynomial of degree 6
    /// at most, which four Gauss-Legendre nodes along z and eight equal steps around it integrate exactly.
    pub(crate) fn new(rotation: DQuat) -> Self {
        /// Positive nodes on -1 to 1 with their weights; each node also counts with the opposite sign.
        const NODES: [(f64, f64); 2] = [
            (0.339_981_043_584_856_26, 0.652_145_154_862_546_2),
            (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        ];
        if rotation == DQuat::IDENTITY {
            return Self { matrix: None };
        }
        let mut matrix = [[0.0; 16]; 16];
        for (z, weight) in NODES.into_iter().flat_map(|(z, weight)| [(z, weight), (-z, weight)]) {
            for step in 0..8 {
                let (sin, cos) = (TAU * f64::from(step) / 8.0).sin_cos();
                let around = (1.0 - z * z).sqrt();
                let direction = DVec3::new(around * cos, around * sin, z);
                let (here, before) =
                    (basis(direction.into()), basis((rotation.inverse() * direction).into()));
                for (row, here) in matrix.iter_mut().zip(here) {
                    for (element, before) in row.iter_mut().zip(before) {
                        *element += weight * TAU / 8.0 * here * before;
                    }
                }
            }
        }
        Self { matrix: Some(matrix) }
    }

    /// Rotates each band up to `degree` by itself. Between bands, the matrix has only rounding errors, which would fill
    /// empty bands.
    pub(crate) fn apply(&self, sh: &mut [f32; 48], degree: u32) {
        let (before, coefficients) = (*sh, (degree + 1) * (degree + 1));
        for (j, row) in self.matrix.iter().flatten().enumerate().take(coefficients as usize) {
            for channel in 0..3 {
                let terms = band_of(j).map(|k| row[k] * f64::from(before[3 * k + channel]));
                sh[3 * j + channel] = terms.sum::<f64>() as f32;
            }
        }
    }
}

/// Returns an upper bound of the absolute value of a splat's colour, over all channels and directions.
///
/// `sh` holds the coefficients of a splat, with the channels of each coefficient together. By the addition theorem
/// (Unsöld), the squared functions of band `l` sum to (2l+1)/(4 pi) in every direction. By Cauchy-Schwarz, a band is
/// at most the root of that sum times the norm of the band's coefficients.
pub fn brightest(sh: &[f32]) -> f64 {
    let channel = |channel: usize| {
        let band = |l: usize| {
            let coefficients =
                sh[(3 * l * l).min(sh.len())..sh.len().min(3 * (l + 1) * (l + 1))].chunks_exact(3);
            let squares: f64 = coefficients.map(|c| f64::from(c[channel]).powi(2)).sum();
            (squares * (2 * l + 1) as f64 / (4.0 * PI)).sqrt()
        };
        0.5 + (0..4).map(band).sum::<f64>()
    };
    (0..3).map(channel).fold(0.0, f64::max)
}

/// A function of the cosine to an axis, as coefficients of the Legendre polynomials P0 to P3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zonal(pub [f64; 4]);

impl Zonal {
    /// Fits a smooth highlight, `exp(sharpness * (cos - 1))`, which is 1 on the axis.
    ///
    /// Its bands are damped by Lanczos' sigma factors. These widen the lobe slightly, and prevent ringing from the
    /// truncation at degree 3, which would cause dark bands.
    pub fn lobe(sharpness: f64) -> Self {
        const SAMPLES: usize = 256;
        let mut coefficients = [0.0; 4];
        for sample in 0..SAMPLES {
            let t = (2.0 * sample as f64 + 1.0) / SAMPLES as f64 - 1.0;
            let value = (sharpness * (t - 1.0)).exp();
            for (l, (sum, p)) in coefficients.iter_mut().zip(legendre(t)).enumerate() {
                *sum += value * p * (2.0 * l as f64 + 1.0) / SAMPLES as f64;
            }
        }
        for (l, c) in coefficients.iter_mut().enumerate().skip(1) {
            let x = PI * l as f64 / 4.5;
            *c *= x.sin() / x;
        }
        Self(coefficients)
    }

    /// Fits a cubic in the cosine to a function on `[from, 1]`, by least squares.
    ///
    /// This suits surfaces: the axis is the normal, and cameras never see the back.
    pub fn fit(from: f64, function: impl Fn(f64) -> f64) -> Self {
        const SAMPLES: usize = 64;
        let mut normal = [[0.0; 5]; 4];
        for sample in 0..SAMPLES {
            let t = from + (1.0 - from) * (sample as f64 + 0.5) / SAMPLES as f64;
            let (p, value) = (legendre(t), function(t));
            for row in 0..4 {
                for column in 0..4 {
                    normal[row][column] += p[row] * p[column];
                }
                normal[row][4] += p[row] * value;
            }
        }
        Self(solve(normal))
    }

    /// Evaluates the function at the cosine of an angle to the axis.
    pub fn at(&self, cosine: f64) -> f64 {
        self.0.iter().zip(legendre(cosine)).map(|(c, p)| c * p).sum()
    }

    /// Computes the sixteen coefficients of the lobe about an axis (unit).
    ///
    /// By the addition theorem, P_l(a . d) = 4 pi / (2l+1) sum_m Y_lm(a) Y_lm(d), with the basis of this module.
    pub fn about(&self, axis: [f64; 3]) -> [f64; 16] {
        let mut coefficients = basis(axis);
        for (k, value) in coefficients.iter_mut().enumerate() {
            let l = k.isqrt();
            *value *= self.0[l] * 4.0 * PI / (2.0 * l as f64 + 1.0);
        }
        coefficients
    }
}

fn legendre(t: f64) -> [f64; 4] {
    [1.0, t, 1.5 * t * t - 0.5, 2.5 * t * t * t - 1.5 * t]
}

/// Solves four linear equations by Gauss-Jordan elimination.
///
/// The matrix is symmetric and positive definite, so no pivoting is needed.
fn solve(mut m: [[f64; 5]; 4]) -> [f64; 4] {
    for pivot in 0..4 {
        let scale = m[pivot][pivot];
        m[pivot].iter_mut().for_each(|v| *v /= scale);
        let pivot_row = m[pivot];
        for (row, values) in m.iter_mut().enumerate() {
            if row != pivot {
                let factor = values[pivot];
                values.iter_mut().zip(pivot_row).for_each(|(v, p)| *v -= factor * p);
            }
        }
    }
    m.map(|row| row[4])
}

#[cfg(test)]
mod tests {
    use super::*;

    const DIRECTIONS: [[f64; 3]; 4] =
        [[0.6, 0.8, 0.0], [-0.48, 0.6, 0.64], [0.0, 0.0, -1.0], [0.36, -0.48, -0.8]];

    #[test]
    fn no_direction_is_brighter_than_the_bound_and_of_each_band_alone_one_comes_near() {
        let directions: Vec<[f64; 3]> = (0..4000)
            .map(|i| {
                let (z, turn) = ((f64::from(i) + 0.5) / 2000.0 - 1.0, 2.399_963_229_728_653 * f64::from(i));
                let across = (1.0 - z * z).sqrt();
                [across * turn.cos(), across * turn.sin(), z]
            })
            .collect();
        for floats in [3, 12, 27, 48] {
            // The coefficients of a lobe: every band is largest in the same direction.
            let axis = basis([0.36, -0.48, -0.8]);
            let sh: Vec<f32> =
                (0..floats).map(|i| (axis[i / 3] * [900.0, -3.0, 1.0][i % 3]) as f32).collect();
            let red = |d: &[f64; 3]| {
                0.5 + basis(*d).iter().zip(sh.chunks_exact(3)).map(|(y, c)| y * f64::from(c[0])).sum::<f64>()
            };
            let (most, bound) = (directions.iter().map(red).fold(0.0, f64::max), brightest(&sh));
            assert!(most <= bound && most > 0.99 * bound, "{floats} floats: {most}, bound {bound}");
        }
        assert_eq!(brightest(&[0.0; 48]), 0.5);
    }

    #[test]
    fn rotations_leave_empty_bands_empty_and_the_identity_keeps_every_bit() {
        let sh: [f32; 48] = std::array::from_fn(|float| match float / 3 {
            0..4 | 9.. => 0.0,
            k => 0.1 * (k as f32).sin(),
        });
        let turned = |rotation: DQuat| {
            let mut turned = sh;
            Turn::new(rotation).apply(&mut turned, 3);
            turned
        };
        assert_eq!(turned(DQuat::IDENTITY), sh);
        let found = turned(DQuat::from_rotation_z(1.0));
        assert!(found[..12].iter().chain(&found[27..]).all(|value| *value == 0.0), "{found:?}");
        assert_ne!(found, sh);
    }

    #[test]
    fn the_constants_are_those_of_the_reference() {
        let at = basis([0.5, 0.5, std::f64::consts::FRAC_1_SQRT_2]);
        assert!((at[0] - 0.28209479177387814).abs() < 1e-15);
        assert!((at[1] + 0.4886025119029199 * 0.5).abs() < 1e-15);
        assert!((basis([0.0, 0.0, 1.0])[6] - 2.0 * 0.31539156525252005).abs() < 1e-15);
        assert!((basis([1.0, 0.0, 0.0])[13] - 0.4570457994644658).abs() < 1e-15);
        assert!((basis([0.0, 1.0, 0.0])[9] - 0.5900435899266435).abs() < 1e-15);
    }

    #[test]
    fn a_lobe_about_an_axis_is_the_same_function_as_its_polynomial() {
        let lobe = Zonal::lobe(5.0);
        for axis in DIRECTIONS {
            let coefficients = lobe.about(axis);
            for d in DIRECTIONS {
                let cosine: f64 = axis.iter().zip(d).map(|(a, b)| a * b).sum();
                let sum: f64 = coefficients.iter().zip(basis(d)).map(|(c, y)| c * y).sum();
                assert!((sum - lobe.at(cosine)).abs() < 1e-12, "{sum} {}", lobe.at(cosine));
            }
        }
    }

    #[test]
    fn a_cubic_is_fitted_exactly() {
        let f = |t: f64| 0.3 - t + 2.0 * t * t - 0.7 * t * t * t;
        let fitted = Zonal::fit(-0.3, f);
        for t in [-0.3, 0.0, 0.4, 1.0] {
            assert!((fitted.at(t) - f(t)).abs() < 1e-10);
        }
    }
}
