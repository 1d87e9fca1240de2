//! Submits commands, waits for submissions, and reads timestamps.

use crate::gpu::{MetalGpu, Submission};
use crate::lower;
use crate::objc;
use crate::progress::Progress;
use metal::{CounterSampleBuffer, CounterSampleBufferDescriptor, MTLStorageMode};
use splatgraph_api::BackendError;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Interval between checks for failed submissions during a wait.
const SLICE: Duration = Duration::from_millis(50);

/// Submits a frame or an upload, followed by the draw into a window, if any. The last command buffer signals `done`.
///
/// The commands start once the event `start` reaches its value. This function makes the queue signal that value when
/// earlier submissions, of all executors, have completed: all of them if `after_all`, otherwise the published ones.
pub(crate) fn submit(
    gpu: &MetalGpu,
    mut submission: Submission,
    after_all: bool,
) -> Result<Submission, BackendError> {
    // The lock also serializes submissions.
    let mut in_flight = gpu.in_flight();
    let (event, value) = &submission.start;
    let before: Vec<_> = in_flight.iter().filter(|before| after_all || before.publishes).collect();
    let order = if before.is_empty() {
        event.set_signaled_value(*value);
        None
    } else {
        let order = gpu.commands("order")?;
        before.iter().for_each(|Submission { done, .. }| order.encode_wait_for_event(&done.0, done.1));
        order.encode_signal_event(event, *value);
        order.commit();
        Some(order)
    };
    submission.commands.iter().for_each(|commands| commands.commit());
    submission.commands.extend(order);
    in_flight.push(submission.clone());
    Ok(submission)
}

/// Blocks until a submission has completed, for at most `limit`. Returns false if the limit has passed.
///
/// # Errors
/// Returns an error if a command buffer failed, also one of another executor: this submission may have waited for it.
pub(crate) fn wait(gpu: &MetalGpu, submission: &Submission, limit: Duration) -> Result<bool, BackendError> {
    let ended = has_ended(gpu, submission, limit);
    drop(gpu.in_flight());
    gpu.failure().map_or(Ok(ended), Err)
}

/// Blocks until all earlier submissions have completed or failed, for at most `limit`. Returns false if the limit has
/// passed. Other threads can submit meanwhile.
pub(crate) fn idle(gpu: &MetalGpu, limit: Duration) -> bool {
    let begun = Instant::now();
    let before = gpu.in_flight().clone();
    before.iter().all(|submission| has_ended(gpu, submission, limit.saturating_sub(begun.elapsed())))
}

/// Blocks until a submission has completed or failed, for at most `limit`. Returns false if the limit has passed.
fn has_ended(gpu: &MetalGpu, submission: &Submission, limit: Duration) -> bool {
    let begun = Instant::now();
    while submission.progress() == Progress::Running {
        let left = limit.saturating_sub(begun.elapsed()).min(SLICE);
        if left.is_zero() {
            return false;
        }
        submission.wait(left);
        // The submission may wait for another one that has failed.
        drop(gpu.in_flight());
    }
    true
}

/// The timestamps of a frame: two of its command buffer, then samples at the ends of encoders.
#[derive(Clone)]
pub struct Timestamps(Arc<Times>);

struct Times {
    samples: Option<CounterSampleBuffer>,
    written: Mutex<Written>,
}

#[derive(Default)]
struct Written {
    /// True once the frame has completed. Until then, the samples are those of an earlier frame.
    completed: bool,
    /// Start and end of the frame on the device, in nanoseconds; `None` if Metal reports none.
    frame: Option<[u64; 2]>,
    /// For each sample, true if the last recorded frame writes it.
    samples: Vec<bool>,
}

impl Timestamps {
    /// Creates `count` timestamps. Those of passes are missing if the device cannot sample counters at the ends of
    /// encoders, or has no counter sample buffer left.
    pub(crate) fn new(gpu: &MetalGpu, count: u32) -> Timestamps {
        let samples = u64::from(count.saturating_sub(2).min(lower::MAX_SAMPLES));
        let buffer = gpu.timestamps.as_ref().filter(|_| samples > 0).and_then(|set| {
            objc::pool(|| {
                let descriptor = CounterSampleBufferDescriptor::new();
                descriptor.set_counter_set(set);
                descriptor.set_sample_count(samples);
                descriptor.set_storage_mode(MTLStorageMode::Shared);
                gpu.device.new_counter_sample_buffer_with_descriptor(&descriptor).ok()
            })
        });
        let written = Written { samples: vec![false; samples as usize], ..Written::default() };
        Timestamps(Arc::new(Times { samples: buffer, written: Mutex::new(written) }))
    }

    fn written(&self) -> MutexGuard<'_, Written> {
        self.0.written.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn reset(&self) {
        let mut written = self.written();
        (written.completed, written.frame) = (false, None);
        written.samples.fill(false);
    }

    /// Reserves samples `first` and `first + 1` for an encoder, and returns their buffer; `None` if they do not exist.
    pub(crate) fn take(&self, first: u32) -> Option<&CounterSampleBuffer> {
        let samples = self.0.samples.as_ref()?;
        self.written().samples.get_mut(first as usize..first as usize + 2)?.fill(true);
        Some(samples)
    }

    /// Stores the start and end of the completed frame's command buffer, in seconds.
    pub(crate) fn completed(&self, (start, end): (f64, f64)) {
        let mut written = self.written();
        written.completed = true;
        // The times are zero if Metal reports none.
        written.frame = (start > 0.0 && end >= start).then(|| [start, end].map(|s| (s * 1e9) as u64));
    }

    /// Reads the first `count` timestamps, in nanoseconds.
    ///
    /// They are `None` until the frame has completed, and for pairs that end before they start.
    pub(crate) fn read(&self, count: u32) -> Vec<Option<u64>> {
        let written = self.written();
        let used = written.samples.iter().rposition(|&taken| taken).map_or(0, |last| last + 1);
        let values = self.0.samples.as_ref().filter(|_| used > 0 && written.completed);
        let values = values.and_then(|samples| objc::resolve(samples, used)).unwrap_or_default();
        let value = |timestamp: u32| match lower::sample(timestamp) {
            None => written.frame.and_then(|frame| frame.get(timestamp as usize).copied()),
            Some(sample) => {
                let taken = written.samples.get(sample as usize).is_some_and(|&taken| taken);
                let first = sample as usize & !1;
                let is_pair = values.get(first).is_some_and(|start| values.get(first + 1) >= Some(start));
                values.get(sample as usize).filter(|_| taken && is_pair).copied().and_then(lower::counted)
            }
        };
        (0..count).map(value).collect()
    }
}
