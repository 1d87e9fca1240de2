//! Evaluates the timestamps of frames, and locates the pass in which a lost device stopped.

use crate::gpu::Gpu;
use splatgraph_api::{BackendError, FrameId};

/// Returns the number of timestamps of a frame with `passes` passes. They are, in order, the frame's start and end,
/// then each pass's start and end.
pub(crate) fn queries(passes: usize) -> u32 {
    2 + 2 * passes as u32
}

/// A frame's timestamps; see [`queries`] for their order.
pub(crate) struct Times {
    /// Ticks of the timestamps. Empty if the queue has no timer; `None` for a timestamp that was not written.
    ticks: Vec<Option<u64>>,
    bits: u32,
    /// Nanoseconds per tick.
    period: f64,
}

impl Times {
    pub fn read<G: Gpu>(
        gpu: &G,
        timestamps: Option<&G::Timestamps>,
        passes: usize,
    ) -> Result<Times, BackendError> {
        let limits = &gpu.common().limits;
        let ticks = match timestamps {
            Some(timestamps) => gpu.read_timestamps(timestamps, queries(passes))?,
            None => Vec::new(),
        };
        Ok(Times { ticks, bits: limits.timestamp_bits, period: limits.timestamp_period as f64 })
    }

    /// Returns for each pass whether it is known to be complete; `None` without a timer.
    pub fn finished(&self, passes: usize) -> Option<Vec<bool>> {
        let done = |pass| self.ticks[queries(pass) as usize + 1].is_some();
        (!self.ticks.is_empty()).then(|| (0..passes).map(done).collect())
    }

    fn between(&self, from: u32, to: u32) -> Option<f64> {
        let ticks = |query: u32| self.ticks.get(query as usize).copied().flatten();
        Some(milliseconds(ticks(from)?, ticks(to)?, self.bits, self.period))
    }

    pub fn pass(&self, index: usize) -> Option<f64> {
        self.between(queries(index), queries(index) + 1)
    }

    pub fn pass_start(&self, index: usize) -> Option<f64> {
        self.between(0, queries(index))
    }

    /// Returns the frame's start on the clock of the timestamps, in milliseconds; `None` without a timestamp.
    pub fn start(&self) -> Option<f64> {
        let ticks = self.ticks.first().copied().flatten()?;
        Some(milliseconds(0, ticks, self.bits, self.period))
    }

    pub fn total(&self) -> Option<f64> {
        self.between(0, 1)
    }
}

/// Converts the ticks between two timestamps to milliseconds, modulo 2^`bits`: the counter may have wrapped once.
fn milliseconds(from: u64, to: u64, bits: u32, period: f64) -> f64 {
    let mask = if bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
    (to.wrapping_sub(from) & mask) as f64 * period * 1e-6
}

/// Describes where a lost device stopped: the last pass known to be complete and the next one.
pub(crate) fn lost_in(frame: FrameId, names: &[&str], finished: Option<&[bool]>) -> String {
    let Some(finished) = finished else {
        return format!("in or after frame {}; without timestamps no pass of it is known complete", frame.0);
    };
    let done = finished.iter().take_while(|&&done| done).count();
    match (done.checked_sub(1).and_then(|last| names.get(last)), names.get(done)) {
        (Some(last), Some(next)) => {
            format!(
                "in frame {}; the last pass known complete is `{last}`, the next one is `{next}`",
                frame.0
            )
        }
        (Some(last), None) => {
            format!("after frame {}; all its passes are known complete, the last is `{last}`", frame.0)
        }
        (None, Some(first)) => {
            format!("in frame {}; none of its passes is known complete, the first is `{first}`", frame.0)
        }
        (None, None) => format!("in frame {}, which has no passes", frame.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_timestamp_counter_may_wrap_within_its_valid_bits() {
        assert_eq!(milliseconds(10, 1_000_010, 64, 1.0), 1.0);
        assert_eq!(milliseconds((1 << 36) - 500_000, 500_000, 36, 1.0), 1.0);
        assert_eq!(milliseconds(u64::MAX - 9, 90, 64, 10.0), 0.001);
    }

    #[test]
    fn a_lost_device_names_the_pass_that_ran_last() {
        let names = ["key", "sort.scan[0]", "draw"];
        let said = |finished: Option<&[bool]>| lost_in(FrameId(7), &names, finished);
        let middle = said(Some(&[true, false, false]));
        assert!(middle.contains("frame 7") && middle.contains("complete is `key`"), "{middle}");
        assert!(middle.contains("next one is `sort.scan[0]`"), "{middle}");
        // A later pass that overlapped and finished first does not hide the unfinished one.
        assert_eq!(said(Some(&[true, false, true])), middle);
        assert!(said(Some(&[false; 3])).contains("none of its passes"));
        assert!(said(Some(&[true; 3])).contains("all its passes"));
        assert!(said(None).contains("without timestamps"));
    }
}
