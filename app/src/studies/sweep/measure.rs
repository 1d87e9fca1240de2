//! Defines the steps of a sweep, each with fewer splats.

use super::choice::Choice;
use crate::studies::measurement::error::Error;
use crate::studies::measurement::time::Time;
use serde::{Deserialize, Serialize};

/// The measurements of one step of the sweep in one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// The criterion by which the splats are chosen; `None` if all are drawn. [`Choice::Nearest`] also has a step with
    /// all splats if its plan is not that of the others.
    pub choice: Option<Choice>,
    /// The camera's name.
    pub camera: String,
    /// Number of splats that are kept. [`Choice::Nearest`] instead keeps the same share of the visible splats.
    pub count: u32,
    /// Number of visible splats; `None` if the graph does not count them.
    pub visible: Option<u32>,
    /// Number of drawn splats; `None` if the graph does not count them.
    pub drawn: Option<u32>,
    /// The time of a frame, and its share of the time with all splats; `None` without timestamps.
    pub time: Option<Time>,
    /// The error against the true picture of the whole scene.
    pub error: Error,
    /// Bytes of memory on the device.
    pub gpu_bytes: u64,
    /// True if the plan reads the previous frame: a still view then hides the lag behind a moving camera.
    #[serde(default)]
    pub of_last_frame: bool,
}

/// Returns the numbers of splats of a sweep: all, a half, a quarter and so on, down to 1.
///
/// The list has at least one number, and at most `steps`.
pub fn counts(all: u32, steps: u32) -> Vec<u32> {
    let mut counts: Vec<u32> =
        (0..steps.max(1)).map(|step| all.checked_shr(step).unwrap_or(0).max(1)).collect();
    counts.dedup();
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_has_half_the_splats_of_the_one_before() {
        assert_eq!(counts(1000, 6), [1000, 500, 250, 125, 62, 31]);
        assert_eq!(counts(3, 6), [3, 1]);
        assert_eq!(counts(1, 40), [1]);
        assert_eq!(counts(9, 0), [9]);
    }
}
