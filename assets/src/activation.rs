//! Converts stored values of splats to activated values, and back.
//!
//! Most formats store the logarithm of a scale, the logit of an opacity, and quaternions of any length. Conversions are
//! computed in f64 and rounded to f32 once.

use std::cmp::Ordering;

/// Band 0 of the spherical harmonics, `1 / (2 sqrt(pi))`: a colour is `0.5 + SH_C0 * f_dc`.
pub const SH_C0: f64 = 0.282_094_791_773_878_14;

/// Converts a colour to harmonics of band 0 only.
#[inline]
pub(crate) fn flat(color: [f64; 3]) -> [f32; 48] {
    let mut sh = [0.0; 48];
    for (coefficient, color) in sh.iter_mut().zip(color) {
        *coefficient = ((color - 0.5) / SH_C0) as f32;
    }
    sh
}

/// Computes the exponential of a logarithm. Negative infinity, which converters write for flat splats, gives 0.
#[inline]
pub(crate) fn exponential(logarithm: f32) -> f32 {
    f64::from(logarithm).exp() as f32
}

/// Applies the 3D filter of Mip-Splatting to a splat's scales and opacity. A filter of 0 changes nothing.
///
/// As in Mip-Splatting's `get_scaling_n_opacity_with_3D_filter`, s' = sqrt(s^2 + filter^2) and o' = o sqrt(det / det').
/// det and det' are the products of s^2 and of s'^2.
pub(crate) fn filtered(scale: [f32; 3], opacity: f32, filter: f32) -> ([f32; 3], f32) {
    if filter == 0.0 {
        return (scale, opacity);
    }
    let filtered = scale.map(|scale| f64::from(scale).hypot(filter.into()));
    let kept: f64 =
        scale.iter().zip(filtered).map(|(scale, filtered)| f64::from(*scale) / filtered).product();
    (filtered.map(|scale| scale as f32), (f64::from(opacity) * kept) as f32)
}

/// Computes the natural logarithm, clamped from below to -104, whose exponential rounds to 0 in f32.
pub(crate) fn logarithm(scale: f32) -> f32 {
    f64::from(scale).ln().max(-104.0) as f32
}

/// Computes the sigmoid of a logit. Infinite logits, which SPZ decoders write for opacities of 0 and 1, give 0 and 1.
#[inline]
pub(crate) fn sigmoid(logit: f32) -> f32 {
    // e^-x overflows only internally, to 1 / inf = 0, which is the limit.
    (1.0 / (1.0 + (-f64::from(logit)).exp())) as f32
}

/// Computes the inverse of the sigmoid, clamped to -104 and 18, whose sigmoids round to 0 and 1 in f32. Opacities are
/// clamped to 0..1.
pub(crate) fn logit(opacity: f32) -> f32 {
    let p = f64::from(opacity).clamp(0.0, 1.0);
    (p / (1.0 - p)).ln().clamp(-104.0, 18.0) as f32
}

/// Normalises a quaternion; also returns its original length. Leaves a zero quaternion unchanged. Also leaves a unit
/// quaternion unchanged, so that a scene that is saved and loaded again has the same bits.
#[inline]
pub(crate) fn unit(raw: [f64; 4]) -> ([f32; 4], f64) {
    // A unit quaternion that is rounded to f32 has a length within half an epsilon of 1.
    const ROUNDING: f64 = 0.5 * f32::EPSILON as f64;
    let norm = raw.iter().map(|c| c * c).sum::<f64>().sqrt();
    let divisor = if norm > 0.0 && (norm - 1.0).abs() > ROUNDING { norm } else { 1.0 };
    (raw.map(|c| (c / divisor) as f32), norm)
}

/// Restores the omitted component of a unit quaternion, its largest and not negative, at index `omitted`.
///
/// `others` are the other components, in ascending order of index.
#[inline]
pub(crate) fn with_omitted(omitted: usize, others: [f64; 3]) -> [f64; 4] {
    let largest = (1.0 - others.iter().map(|c| c * c).sum::<f64>()).max(0.0).sqrt();
    std::array::from_fn(|at| match at.cmp(&omitted) {
        Ordering::Less => others[at],
        Ordering::Equal => largest,
        Ordering::Greater => others[at - 1],
    })
}

/// Removes the component with the largest absolute value, which [`with_omitted`] restores. Returns its index and the
/// other components, negated if the removed one is negative.
pub(crate) fn omit_largest(quaternion: [f32; 4]) -> (usize, [f64; 3]) {
    let larger = |best: usize, at: usize| {
        if quaternion[at].abs() > quaternion[best].abs() { at } else { best }
    };
    let largest = (1..4).fold(0, larger);
    let sign = if quaternion[largest] < 0.0 { -1.0 } else { 1.0 };
    let others = |at: usize| f64::from(quaternion[at + usize::from(at >= largest)]) * sign;
    (largest, std::array::from_fn(others))
}

/// Quantises a value, clamped to 0..1, to the nearest of `most + 1` equidistant levels, numbered from 0.
#[inline]
pub(crate) fn quantised(value: f64, most: u32) -> u32 {
    (value.clamp(0.0, 1.0) * f64::from(most)).round() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quaternion_that_was_normalised_is_not_changed_again() {
        for number in 0..10_000 {
            let wave = |k: usize| f64::from(((number * 7 + k * 13) as f32 * 0.37).sin());
            let once = unit(std::array::from_fn(wave)).0;
            assert_eq!(unit(once.map(f64::from)).0, once);
        }
        assert_eq!(unit([0.0, 2.0, 0.0, 0.0]), ([0.0, 1.0, 0.0, 0.0], 2.0));
        assert_eq!(unit([0.0; 4]), ([0.0; 4], 0.0));
    }

    #[test]
    fn values_that_are_not_finite_stay_visible_as_such_except_those_with_a_limit() {
        assert!(exponential(f32::NAN).is_nan());
        assert_eq!((exponential(f32::INFINITY), exponential(f32::NEG_INFINITY)), (f32::INFINITY, 0.0));
        assert!(sigmoid(f32::NAN).is_nan());
        for large in [1e30, f32::INFINITY] {
            assert_eq!((sigmoid(large), sigmoid(-large)), (1.0, 0.0));
        }
        assert_eq!((logit(1.5), logit(-0.5)), (logit(1.0), logit(0.0)));
        assert!(logit(f32::NAN).is_nan());
        assert_eq!(unit([0.0; 4]), ([0.0; 4], 0.0));
    }

    #[test]
    fn the_largest_component_is_omitted_and_made_positive() {
        assert_eq!(omit_largest([0.5, -0.75, 0.0, 0.25]), (1, [-0.5, 0.0, -0.25]));
        assert_eq!(omit_largest([0.5, 0.25, 0.0, 0.75]), (3, [0.5, 0.25, 0.0]));
    }
}
