//! Submits commands, waits for submissions, and reads timestamps.

use crate::apple::gpu::{MetalGpu, Submission};
use crate::apple::objc;
use crate::progress::Progress;
use crate::times::{FrameTimes, MAX_SAMPLES};
use metal::{CounterSampleBuffer, CounterSampleBufferDescriptor, MTLStorageMode};
use splatgraph_api::BackendError;
use splatgraph_runtime::lock;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Interval between checks for failed submissions during a wait.
const SLICE: Duration = Duration::from_millis(50);

/// Submits a frame or an upload, followed by the draw into a window, if any. The last command buffer signals `done`.
///
/// The commands start once the event `start` reaches its value: when earlier submissions, of all executors, have
/// completed. These are all submissions in flight if `after_all`, otherwise the published ones. Without any, the value
/// is signalled from the host, at once.
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
/// Returns an error if any executor's command buffer failed: this submission may have waited for it.
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

/// The timestamps of a frame: start and end of its command buffer, then samples at the start and end of each encoder.
#[derive(Clone)]
pub struct Timestamps(Arc<Times>);

struct Times {
    samples: Option<CounterSampleBuffer>,
    frame: Mutex<FrameTimes>,
}

impl Timestamps {
    /// Creates `count` timestamps. Timestamps of passes are missing if the device cannot sample counters where encoders
    /// start and end, or has no counter sample buffer left, and beyond the first [`MAX_SAMPLES`].
    pub(crate) fn new(gpu: &MetalGpu, count: u32) -> Timestamps {
        let samples = count.saturating_sub(2).min(MAX_SAMPLES);
        let buffer = gpu.timestamps.as_ref().filter(|_| samples > 0).and_then(|set| {
            objc::pool(|| {
                let descriptor = CounterSampleBufferDescriptor::new();
                descriptor.set_counter_set(set);
                descriptor.set_sample_count(samples.into());
                descriptor.set_storage_mode(MTLStorageMode::Shared);
                gpu.device.new_counter_sample_buffer_with_descriptor(&descriptor).ok()
            })
        });
        let frame = Mutex::new(FrameTimes::new(samples as usize));
        Timestamps(Arc::new(Times { samples: buffer, frame }))
    }

    pub(crate) fn reset(&self) {
        lock(&self.0.frame).reset();
    }

    /// Reserves samples `first` and `first + 1` for an encoder, and returns their buffer; `None` if they do not exist.
    pub(crate) fn take(&self, first: u32) -> Option<&CounterSampleBuffer> {
        let samples = self.0.samples.as_ref()?;
        lock(&self.0.frame).take(first).then_some(samples)
    }

    /// Stores the start and end of the completed frame's command buffer, in seconds.
    pub(crate) fn completed(&self, times: (f64, f64)) {
        lock(&self.0.frame).complete(times);
    }

    /// Reads the first `count` timestamps, in nanoseconds; see [`FrameTimes::timestamps`].
    pub(crate) fn read(&self, count: u32) -> Vec<Option<u64>> {
        let frame = lock(&self.0.frame);
        let used = frame.samples();
        let samples = self.0.samples.as_ref().filter(|_| used > 0);
        let samples = samples.and_then(|samples| objc::resolve(samples, used)).unwrap_or_default();
        frame.timestamps(&samples, count)
    }
}
