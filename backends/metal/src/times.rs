//! Assembles the timestamps of a frame from the times of its command buffer and the samples of its encoders.
//!
//! Metal takes the two from different clocks: the host's for command buffers, the device's for samples. The samples are
//! therefore shifted: the earliest sample becomes the start of the frame.

/// Maximum number of samples in a counter sample buffer. Metal limits the buffer to 32 KiB, and a sample has 8 bytes.
pub const MAX_SAMPLES: u32 = 4096;

/// Returns the index of the counter sample for a runtime timestamp; `None` if it has none.
///
/// The first two timestamps, of the whole frame, come from the command buffer instead. Timestamps beyond the sample
/// buffer's capacity have no sample.
pub fn sample(timestamp: u32) -> Option<u32> {
    timestamp.checked_sub(2).filter(|sample| *sample < MAX_SAMPLES)
}

/// Returns the value of a counter; `None` if it is 0 (not sampled) or all ones (`MTLCounterErrorValue`).
fn counted(value: u64) -> Option<u64> {
    (value != 0 && value != u64::MAX).then_some(value)
}

/// The times of a frame: start and end of its command buffer, and the samples that its encoders take.
#[derive(Clone, Debug, Default)]
pub struct FrameTimes {
    /// True once the frame has completed. Until then, the samples are those of an earlier frame.
    completed: bool,
    /// Start and end of the command buffer, in nanoseconds; `None` if Metal reports none.
    frame: Option<[u64; 2]>,
    /// For each sample, true if the last recorded frame writes it.
    taken: Vec<bool>,
}

impl FrameTimes {
    /// Creates the times for frames with at most this number of samples.
    pub fn new(samples: usize) -> FrameTimes {
        FrameTimes { taken: vec![false; samples], ..FrameTimes::default() }
    }

    /// Forgets the last frame.
    pub fn reset(&mut self) {
        (self.completed, self.frame) = (false, None);
        self.taken.fill(false);
    }

    /// Reserves samples `first` and `first + 1` for an encoder. Returns false if they do not exist.
    pub fn take(&mut self, first: u32) -> bool {
        let pair = self.taken.get_mut(first as usize..first as usize + 2);
        pair.map(|pair| pair.fill(true)).is_some()
    }

    /// Stores the start and end of the completed command buffer, in seconds: zeros if Metal reports none.
    pub fn complete(&mut self, (start, end): (f64, f64)) {
        self.completed = true;
        self.frame = (start > 0.0 && end >= start).then(|| [start, end].map(|s| (s * 1e9) as u64));
    }

    /// Returns the number of samples to read, up to the last one that the frame took. It is 0 until the frame has
    /// completed.
    pub fn samples(&self) -> usize {
        let last = self.taken.iter().rposition(|&taken| taken);
        last.filter(|_| self.completed).map_or(0, |last| last + 1)
    }

    /// Returns the first `count` timestamps of the frame, in nanoseconds. `samples` are the values of as many samples
    /// as [`samples`](FrameTimes::samples) returned: none until the frame has completed.
    ///
    /// The two timestamps of the frame are `None` if Metal reports none; the others are then not shifted. A pass's
    /// timestamp is `None` if its sample was not taken or failed, or if the pass's pair ends before it starts.
    pub fn timestamps(&self, samples: &[u64], count: u32) -> Vec<Option<u64>> {
        let ticks = |sample: usize| {
            let taken = self.taken.get(sample).is_some_and(|&taken| taken);
            let first = sample & !1;
            let is_pair = samples.get(first).is_some_and(|start| samples.get(first + 1) >= Some(start));
            samples.get(sample).filter(|_| taken && is_pair).copied().and_then(counted)
        };
        let earliest = (0..samples.len()).filter_map(ticks).min().unwrap_or(0);
        let start = self.frame.map_or(earliest, |[start, _]| start);
        let value = |timestamp: u32| match sample(timestamp) {
            None => self.frame.and_then(|frame| frame.get(timestamp as usize).copied()),
            Some(sample) => ticks(sample as usize).map(|ticks| start.saturating_add(ticks - earliest)),
        };
        (0..count).map(value).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the times of a completed frame with `pairs` pairs of samples, which ran from 5 s to 5.000001 s.
    fn completed(pairs: u32) -> FrameTimes {
        let mut times = FrameTimes::new(8);
        (0..pairs).for_each(|pair| assert!(times.take(2 * pair)));
        times.complete((5.0, 5.000_001));
        times
    }

    #[test]
    fn passes_start_after_the_frame_although_samples_come_from_another_clock() {
        const FRAME: [Option<u64>; 2] = [Some(5_000_000_000), Some(5_000_001_000)];
        // The second encoder began first.
        for clock in [100, 7_000_000_000_u64] {
            let samples = [clock + 200, clock + 500, clock, clock + 300];
            let found = completed(2).timestamps(&samples, 6);
            assert_eq!(found[..2], FRAME);
            assert_eq!(found[2..], [200, 500, 0, 300].map(|after| Some(5_000_000_000 + after)));
        }
        assert_eq!(completed(0).timestamps(&[], 4), [FRAME[0], FRAME[1], None, None]);
    }

    #[test]
    fn passes_keep_their_times_if_metal_reports_none_for_the_frame() {
        let mut times = completed(1);
        times.complete((0.0, 0.0));
        assert_eq!(times.timestamps(&[40, 70], 4), [None, None, Some(40), Some(70)]);
    }

    #[test]
    fn a_counter_that_reads_zero_or_an_error_is_unavailable() {
        let counters = |pair: [u64; 2]| completed(1).timestamps(&pair, 4)[2..].to_vec();
        assert!(counters([17, 18]).iter().all(Option::is_some));
        assert_eq!(counters([0, 17])[0], None);
        assert_eq!(counters([17, u64::MAX])[1], None);
        // The pair ends before it starts.
        assert_eq!(counters([18, 17]), [None, None]);
    }

    #[test]
    fn samples_of_an_earlier_frame_are_not_read() {
        let mut times = completed(3);
        assert_eq!(times.samples(), 6);
        times.reset();
        assert!(times.take(0) && !times.take(8));
        assert_eq!(times.samples(), 0, "the frame has not completed");
        times.complete((1.0, 2.0));
        assert_eq!(times.samples(), 2);
        assert_eq!(times.timestamps(&[3, 4, 5, 6], 6)[4..], [None, None], "the frame took one pair only");
    }

    #[test]
    fn timestamps_of_passes_have_samples_while_there_is_room() {
        assert_eq!([sample(0), sample(1), sample(2), sample(3)], [None, None, Some(0), Some(1)]);
        assert_eq!([sample(4097), sample(4098)], [Some(4095), None]);
    }
}
