//! Evaluates a splat's view-dependent colour from real spherical harmonics up to degree 3.

use crate::rules::{Rules, ShDirection};
use splatgraph_assets::harmonics::basis;

/// Evaluates a splat's colour as seen from `eye`.
///
/// Computes `sum_k sh[k] Y_k(d) + 0.5` per channel, with `d` the unit vector from the camera to the splat (reversed for
/// [`ShDirection::ToCamera`]), then applies the floor and ceiling of the rules. Source: `computeColorFromSH` of the
/// rasteriser (cuda_rasterizer/forward.cu). Its constants are the orthonormal real harmonics, with negative signs for
/// odd m.
pub(crate) fn color(sh: &[[f64; 3]; 16], position: [f64; 3], eye: [f64; 3], rules: &Rules) -> [f64; 3] {
    let sign = match rules.sh_direction {
        ShDirection::FromCamera => 1.0,
        ShDirection::ToCamera => -1.0,
    };
    let d: [f64; 3] = std::array::from_fn(|i| sign * (position[i] - eye[i]));
    let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
    let weights = basis(d.map(|v| v / length));
    let used = (rules.sh_degree.min(3) as usize + 1).pow(2);
    std::array::from_fn(|channel| {
        // A splat at the eye has no direction: bands that depend on it are NaN and are left out.
        let bands: f64 = (0..used).map(|k| weights[k] * sh[k][channel]).filter(|v| !v.is_nan()).sum();
        let value = 0.5 + bands;
        let value = rules.color_floor.map_or(value, |floor| value.max(floor));
        rules.color_ceiling.map_or(value, |ceiling| value.min(ceiling))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks orthonormality: products of the functions integrate to the identity over the sphere.
    ///
    /// Gauss-Legendre in the cosine and equal steps around the axis integrate polynomials of this degree exactly.
    #[test]
    fn the_basis_is_orthonormal_over_the_sphere() {
        // Nodes and weights for 5 points (Abramowitz and Stegun, table 25.4).
        let nodes = [
            (0.0, 0.5688888888888889),
            (0.5384693101056831, 0.47862867049936647),
            (-0.5384693101056831, 0.47862867049936647),
            (0.906179845938664, 0.23692688505618908),
            (-0.906179845938664, 0.23692688505618908),
        ];
        const STEPS: usize = 12;
        let mut products = [[0.0; 16]; 16];
        for (z, weight) in nodes {
            for step in 0..STEPS {
                let angle = std::f64::consts::TAU * step as f64 / STEPS as f64;
                let r = f64::sqrt(1.0 - z * z);
                let values = basis([r * angle.cos(), r * angle.sin(), z]);
                for (row, a) in products.iter_mut().zip(values) {
                    for (sum, b) in row.iter_mut().zip(values) {
                        *sum += a * b * weight * std::f64::consts::TAU / STEPS as f64;
                    }
                }
            }
        }
        for (i, row) in products.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                let expected = f64::from(u8::from(i == j));
                assert!((value - expected).abs() < 1e-12, "functions {i} and {j}: {value}");
            }
        }
    }

    #[test]
    fn colours_are_floored_at_zero_and_have_no_ceiling() {
        let mut sh = [[0.0; 3]; 16];
        sh[0] = [-9.0, 0.0, 9.0];
        let [red, green, blue] = color(&sh, [0.0, 0.0, 1.0], [0.0; 3], &Rules::PUBLISHED);
        assert_eq!((red, green), (0.0, 0.5));
        assert!(blue > 3.0);
    }

    #[test]
    fn a_splat_at_the_eye_has_the_colour_of_band_0() {
        let sh = [[0.5; 3]; 16];
        let found = color(&sh, [1.0; 3], [1.0; 3], &Rules::PUBLISHED);
        assert!(found.iter().all(|v| (v - 0.641_047_395_886_939).abs() < 1e-12), "{found:?}");
    }
}
