//! Adds random choices to [`Random`], for the fuzz and soak tests of the viewer.

use crate::numbers::Random;

impl Random {
    /// Draws a number from 0 to 1, exclusive.
    #[cfg(target_os = "linux")]
    pub fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Draws an element, each with equal probability.
    pub fn of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Draws an element with a probability proportional to its weight.
    #[cfg(target_os = "linux")]
    pub fn weighted<T: Copy>(&mut self, all: &[(usize, T)]) -> T {
        let mut left = self.below(all.iter().map(|(weight, _)| weight).sum());
        for (weight, one) in all {
            match left.checked_sub(*weight) {
                Some(rest) => left = rest,
                None => return *one,
            }
        }
        unreachable!("less than the sum of the weights was drawn")
    }
}
