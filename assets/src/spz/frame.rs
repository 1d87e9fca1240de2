//! Converts between coordinate systems whose axes differ in sign.

use crate::scene::Splat;

/// The signs that map a file's axes to a scene's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    axes: [f32; 3],
    /// Sign of each spherical-harmonics coefficient.
    sh: [f32; 16],
}

impl Frame {
    /// Right, up, back: the axes of SPZ.
    pub(super) const RUB: u32 = 4;

    /// Returns the signs for a coordinate system by its number: 1 plus 1 for right, 2 for up and 4 for front instead of
    /// left, down and back. `None` for numbers of permuted axes.
    pub(super) fn new(system: u32) -> Option<Self> {
        let bits = system.checked_sub(1).filter(|bits| *bits < 8)?;
        let sign = |same: bool| if same { 1.0 } else { -1.0 };
        let axes @ [x, y, z] = [sign(bits & 1 != 0), sign(bits & 2 == 0), sign(bits & 4 != 0)];
        // A harmonic is a polynomial in x, y and z; these are the axes of odd power, in the order of the basis.
        let sh = [1.0, y, z, x, x * y, y * z, 1.0, x * z, 1.0, y, x * y * z, y, z, x, z, x];
        Some(Self { axes, sh })
    }

    /// Converts a splat in either direction.
    pub(super) fn apply(&self, splat: &mut Splat) {
        let [x, y, z] = self.axes;
        splat.position.iter_mut().zip(self.axes).for_each(|(value, sign)| *value *= sign);
        // A mirror negates the components of the rotation axis that lie in the mirror.
        let signs = [1.0, y * z, x * z, x * y];
        splat.rotation.iter_mut().zip(signs).for_each(|(value, sign)| *value *= sign);
        for (coefficient, sign) in splat.sh.chunks_exact_mut(3).zip(self.sh) {
            coefficient.iter_mut().for_each(|value| *value *= sign);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::basis;
    use crate::testing::splat;
    use glam::{Mat3, Quat, Vec3};

    #[test]
    fn a_mirrored_splat_is_the_mirror_of_the_splat_in_every_direction() {
        for system in 1..=8 {
            let frame = Frame::new(system).unwrap();
            let mut turned = Splat { rotation: [0.1, 0.7, -0.5, 0.5], ..splat(5) };
            let plain = turned;
            frame.apply(&mut turned);
            let mirror = Mat3::from_diagonal(Vec3::from(frame.axes));
            assert_eq!(Vec3::from(turned.position), mirror * Vec3::from(plain.position));
            let covariance = |s: &Splat| {
                let [w, x, y, z] = s.rotation;
                let axes = Mat3::from_quat(Quat::from_xyzw(x, y, z, w).normalize());
                axes * Mat3::from_diagonal(Vec3::from(s.scale) * Vec3::from(s.scale)) * axes.transpose()
            };
            let (a, b) = (covariance(&turned), mirror * covariance(&plain) * mirror);
            assert!(a.abs_diff_eq(b, 1e-6), "system {system}: {a} and {b}");
            for direction in [[0.36, 0.48, 0.8], [-0.6, 0.64, -0.48]] {
                let there: [f64; 3] = std::array::from_fn(|i| direction[i] * f64::from(frame.axes[i]));
                let color = |sh: &[f32; 48], d| -> f64 {
                    basis(d).iter().enumerate().map(|(k, y)| y * f64::from(sh[3 * k])).sum()
                };
                let (a, b) = (color(&turned.sh, there), color(&plain.sh, direction));
                assert!((a - b).abs() < 1e-5, "system {system}: {a} and {b}");
            }
        }
        assert!(Frame::new(0).is_none() && Frame::new(9).is_none());
    }

    #[test]
    fn the_axes_of_spz_differ_in_y_and_z_and_those_of_ply_in_none() {
        assert_eq!(Frame::new(Frame::RUB).unwrap().axes, [1.0, -1.0, -1.0]);
        assert_eq!(Frame::new(6).unwrap().axes, [1.0; 3]);
    }
}
