//! Adds random choices to [`Random`], for the fuzz and soak tests of the viewer.

use crate::numbers::Random;
use egui::{Pos2, Rect};
use splatgraph_framework::ir::{Domain, Value};

impl Random {
    /// Draws a number from 0 to 1, exclusive.
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Draws an element, each with equal probability.
    pub fn of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Draws a point in a rectangle.
    pub fn within(&mut self, rect: Rect) -> Pos2 {
        rect.lerp_inside([self.share() as f32, self.share() as f32])
    }

    /// Draws a value of a parameter. An integer is at most `most` above the minimum.
    pub fn value(&mut self, domain: &Domain, most: i64) -> Value {
        let share = self.share();
        match domain {
            Domain::Bool => Value::Bool(share < 0.5),
            Domain::Int { min, max } => {
                let range = (max - min).min(most);
                Value::Int(min + (range as f64 * share).round() as i64)
            }
            Domain::Float { min, max, .. } => Value::Float(min + (max - min) * share),
            Domain::Choice(choices) => Value::Text(self.of(choices).clone()),
        }
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
