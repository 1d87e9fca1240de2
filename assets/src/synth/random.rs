//! Generates deterministic random numbers.

/// Hashes a word with SplitMix64 (Steele, Lea and Flood), which is a bijection.
pub(crate) fn splitmix64(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ x >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ x >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ x >> 31
}

/// A stream of random numbers. In the extreme scenes, each splat has its own, so splats can be generated in any order.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        Self(splitmix64(splitmix64(seed) ^ stream))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        splitmix64(self.0)
    }

    /// Draws a number from 0 to 1, excluding 1.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Draws a normally distributed number with mean 0 and deviation 1 (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// Draws a unit vector, uniformly distributed.
    pub(crate) fn direction(&mut self) -> [f64; 3] {
        let z = self.range(-1.0, 1.0);
        let (sin, cos) = self.range(0.0, std::f64::consts::TAU).sin_cos();
        let r = (1.0 - z * z).sqrt();
        [r * cos, r * sin, z]
    }

    /// Draws a point of the unit ball, uniformly distributed.
    pub(crate) fn in_ball(&mut self) -> [f64; 3] {
        let radius = self.unit().cbrt();
        self.direction().map(|c| c * radius)
    }

    /// Draws a rotation, uniformly distributed, as a quaternion w, x, y, z (Shoemake).
    pub(crate) fn rotation(&mut self) -> [f32; 4] {
        let u = self.unit();
        let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
        let (sin1, cos1) = self.range(0.0, std::f64::consts::TAU).sin_cos();
        let (sin2, cos2) = self.range(0.0, std::f64::consts::TAU).sin_cos();
        [a * sin1, a * cos1, b * sin2, b * cos2].map(|c| c as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splitmix64_gives_its_published_sequence() {
        // From state 0, each step adds the golden gamma first.
        assert_eq!(splitmix64(0), 0xE220_A839_7B1D_CDAF);
        assert_eq!(splitmix64(0x9E37_79B9_7F4A_7C15), 0x6E78_9E6A_A1B9_65F4);
    }

    #[test]
    fn rotations_and_directions_have_unit_length() {
        let mut random = Random::new(1, 2);
        for _ in 0..100 {
            let length: f32 = random.rotation().iter().map(|c| c * c).sum();
            assert!((length - 1.0).abs() < 1e-5);
            let length: f64 = random.direction().iter().map(|c| c * c).sum();
            assert!((length - 1.0).abs() < 1e-12);
        }
    }
}
