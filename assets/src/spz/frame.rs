//! Converts between coordinate systems whose axes differ in sign and in order.

use crate::harmonics::Turn;
use crate::scene::Splat;
use glam::DQuat;
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

/// A change of axes: signs, optionally followed by a quarter turn about x.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Frame {
    axes: [f32; 3],
    /// Sign of each spherical-harmonics coefficient.
    sh: [f32; 16],
    /// Quarter turn from right, front, up to right, down, front: (x, y, z) becomes (x, -z, y). `None` without one.
    turn: Option<Turn>,
}

impl Frame {
    /// Number of the coordinate system right, up, back, which SPZ uses by default.
    pub(super) const RUB: u32 = 4;

    /// Creates the change from a coordinate system to the scene's axes; `None` for a number outside 1 to 16.
    ///
    /// A number is 1 plus a sum of flags: 1 for right, 2 for up and 4 for front instead of left, down and back. The
    /// flag 8 exchanges the last two axes: the second is then along the view, and the third vertical.
    pub(super) fn new(system: u32) -> Option<Self> {
        let bits = system.checked_sub(1).filter(|bits| *bits < 16)?;
        let sign = |same: bool| if same { 1.0 } else { -1.0 };
        let (right, up, front) = (bits & 1 != 0, bits & 2 != 0, bits & 4 != 0);
        let upright = bits < 8;
        let axes @ [x, y, z] = match upright {
            true => [sign(right), sign(!up), sign(front)],
            false => [sign(right), sign(front), sign(up)],
        };
        // A harmonic is a polynomial in x, y and z. Its sign is the product of the signs of the axes with odd power.
        let sh = [1.0, y, z, x, x * y, y * z, 1.0, x * z, 1.0, y, x * y * z, y, z, x, z, x];
        let turn = (!upright).then(|| Turn::new(DQuat::from_rotation_x(FRAC_PI_2)));
        Some(Self { axes, sh, turn })
    }

    /// Converts a splat with harmonics of `degree`. Without a quarter turn, the change is its own inverse.
    pub(super) fn apply(&self, splat: &mut Splat, degree: u32) {
        let [x, y, z] = self.axes;
        splat.position.iter_mut().zip(self.axes).for_each(|(value, sign)| *value *= sign);
        // A mirror negates the components of the rotation axis that lie in the mirror.
        let signs = [1.0, y * z, x * z, x * y];
        splat.rotation.iter_mut().zip(signs).for_each(|(value, sign)| *value *= sign);
        for (coefficient, sign) in splat.sh.chunks_exact_mut(3).zip(self.sh) {
            coefficient.iter_mut().for_each(|value| *value *= sign);
        }
        if let Some(turn) = &self.turn {
            let [x, y, z] = splat.position;
            splat.position = [x, -z, y];
            // The product with the quarter of a turn, (1, 1, 0, 0) / sqrt(2).
            let [w, x, y, z] = splat.rotation.map(f64::from);
            splat.rotation = [w - x, w + x, y - z, y + z].map(|value| (value * FRAC_1_SQRT_2) as f32);
            turn.apply(&mut splat.sh, degree);
        }
    }
}

/// Negates x and y: converts between glTF's axes (left, up, front) and a scene's.
pub(crate) fn flip(splat: &mut Splat, degree: u32) {
    Frame::new(7).expect("it is a number of a coordinate system").apply(splat, degree);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::basis;
    use crate::testing::splat;
    use glam::{Mat3, Quat, Vec3};

    #[test]
    fn a_mirrored_splat_is_the_mirror_of_the_splat_in_every_direction() {
        for system in 1..=16 {
            let frame = Frame::new(system).unwrap();
            let mut turned = Splat { rotation: [0.1, 0.7, -0.5, 0.5], ..splat(5) };
            let plain = turned;
            frame.apply(&mut turned, 3);
            let signs = Mat3::from_diagonal(Vec3::from(frame.axes));
            let turn = Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y);
            let mirror = if system > 8 { turn * signs } else { signs };
            assert_eq!(Vec3::from(turned.position), mirror * Vec3::from(plain.position));
            let covariance = |s: &Splat| {
                let [w, x, y, z] = s.rotation;
                let axes = Mat3::from_quat(Quat::from_xyzw(x, y, z, w).normalize());
                axes * Mat3::from_diagonal(Vec3::from(s.scale) * Vec3::from(s.scale)) * axes.transpose()
            };
            let (a, b) = (covariance(&turned), mirror * covariance(&plain) * mirror.transpose());
            assert!(a.abs_diff_eq(b, 1e-6), "system {system}: {a} and {b}");
            for direction in [[0.36, 0.48, 0.8], [-0.6, 0.64, -0.48]] {
                let there = (mirror * Vec3::from(direction.map(|v| v as f32))).to_array().map(f64::from);
                let color = |sh: &[f32; 48], d| -> f64 {
                    basis(d).iter().enumerate().map(|(k, y)| y * f64::from(sh[3 * k])).sum()
                };
                let (a, b) = (color(&turned.sh, there), color(&plain.sh, direction));
                assert!((a - b).abs() < 1e-5, "system {system}: {a} and {b}");
            }
        }
        assert!(Frame::new(0).is_none() && Frame::new(17).is_none());
    }

    #[test]
    fn axes_are_named_by_their_numbers() {
        let place = |system: u32| {
            let mut turned = Splat { position: [1.0, 2.0, 3.0], ..splat(0) };
            Frame::new(system).unwrap().apply(&mut turned, 0);
            turned.position
        };
        // The systems are right, front, up; left, front, up; and right, back, up.
        assert_eq!([16, 15, 12].map(place), [[1.0, -3.0, 2.0], [-1.0, -3.0, 2.0], [1.0, -3.0, -2.0]]);
        // The systems are left, up, front; and right, down, front.
        assert_eq!([7, 6].map(place), [[-1.0, -2.0, 3.0], [1.0, 2.0, 3.0]]);
    }

    #[test]
    fn the_axes_of_spz_differ_in_y_and_z_and_those_of_ply_in_none() {
        assert_eq!(Frame::new(Frame::RUB).unwrap().axes, [1.0, -1.0, -1.0]);
        assert_eq!(Frame::new(6).unwrap().axes, [1.0; 3]);
    }
}
