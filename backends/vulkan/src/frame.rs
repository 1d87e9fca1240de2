//! Frames in flight: submission, completion and what is read back.
//!
//! Each frame in flight has a slot: a command pool that is reset and recorded again, a fence, and (with the plan, in
//! [`crate::loaded`]) timestamps, readback memory and what comes with the frame. Frame `n` uses slot `n % FRAMES_IN_FLIGHT`.

use crate::error::api;
use crate::given;
use crate::gpu::{Gpu, Owned};
use crate::limits::invalid;
use crate::loaded::{Loaded, LoadedSlot, queries};
use crate::memory::Buffer;
use crate::picture::PictureBuffer;
use crate::queue;
use crate::record::Recorder;
use crate::screen::{Presentation, Screen};
use ash::vk;
use splatgraph_api::{BackendError, FrameId, FrameInputs, FrameResult, Pixels};
use splatgraph_framework::ir::{PassId, ResourceId, Source};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::Instant;

pub(crate) struct Slot {
    pool: Owned<vk::CommandPool>,
    commands: vk::CommandBuffer,
    fence: Owned<vk::Fence>,
    /// The frame that the device may still be executing.
    pub pending: Option<Pending>,
}

/// A submitted frame, until its results are collected.
pub(crate) struct Pending {
    pub frame: FrameId,
    /// [`Loaded::number`] of the plan that it is a frame of.
    pub plan: u64,
    /// The passes that it runs, in order.
    pub passes: Vec<PassId>,
    pub inspected: Vec<Buffer>,
    /// The pictures that it reads, and that which it writes.
    pub pictures: Vec<Arc<PictureBuffer>>,
    read_output: bool,
    record_ms: f64,
}

/// Who sees a frame's output.
pub(crate) struct Viewers<'a> {
    /// It is copied to this, for other executors.
    pub picture: Option<&'a Arc<PictureBuffer>>,
    /// It is blitted to this window, unless that shows nothing now.
    pub screen: Option<&'a mut Screen>,
}

impl Slot {
    pub fn new(gpu: &Arc<Gpu>) -> Result<Slot, BackendError> {
        let (pool, commands) = queue::command_pool(gpu)?;
        gpu.name(commands, "frame");
        Ok(Slot { pool, commands, fence: queue::fence(gpu)?, pending: None })
    }

    /// Records and submits a frame, whose output also goes `to` where it is seen. The slot must have nothing pending. What is
    /// given back is still to be presented.
    pub fn submit(
        &mut self,
        gpu: &Arc<Gpu>,
        loaded: &mut Loaded,
        slot: usize,
        frame: FrameId,
        inputs: &FrameInputs,
        to: Viewers,
    ) -> Result<Option<Presentation>, BackendError> {
        let Viewers { picture, screen } = to;
        let start = Instant::now();
        write_uniforms(loaded, slot, inputs)?;
        given::take(gpu, loaded, slot, inputs)?;
        if inputs.read_output && loaded.slots[slot].output.is_none() {
            let bytes = loaded.resources.image(loaded.plan.output).map_or(0, |image| image.bytes());
            loaded.slots[slot].output = Some(Buffer::to_host(gpu, "output readback", bytes)?);
        }
        // SAFETY: the frame that last used this slot is done.
        unsafe { gpu.device.reset_command_pool(*self.pool, vk::CommandPoolResetFlags::empty()) }
            .map_err(api("vkResetCommandPool"))?;
        let (commands, copy) = (self.commands, picture.map(Arc::as_ref));
        let recorder = Recorder { gpu, loaded, inputs, frame, slot, commands, picture: copy };
        let recorded = recorder.record()?;
        let waiting = Instant::now();
        let presentation = match (screen, loaded.resources.image(loaded.plan.output)) {
            (Some(screen), Some(output)) => screen.prepare(output, slot)?,
            _ => None,
        };
        let waited = waiting.elapsed();
        match &presentation {
            Some(there) => queue::submit_and_blit(gpu, self.commands, there.blit, *self.fence)?,
            None => queue::submit(gpu, self.commands, *self.fence)?,
        }
        loaded.layouts = recorded.layouts;
        loaded.prologue_due = false;
        loaded.carried.clear();
        let pictures = picture.cloned().into_iter().chain(loaded.resources.take_pictures(slot)).collect();
        self.pending = Some(Pending {
            frame,
            plan: loaded.number,
            passes: recorded.passes,
            inspected: recorded.inspected,
            pictures,
            read_output: inputs.read_output,
            record_ms: (start.elapsed() - waited).as_secs_f64() * 1e3,
        });
        Ok(presentation)
    }

    /// Blocks until the slot's frame is done, and gives what it read back. The slot is free after this, unless the
    /// device was lost. `loaded` is the plan that the frame is one of, `slot` this slot's index.
    pub fn collect(
        &mut self,
        gpu: &Gpu,
        loaded: &Loaded,
        slot: usize,
    ) -> Result<Option<(FrameId, FrameResult)>, BackendError> {
        if self.pending.is_none() {
            return Ok(None);
        }
        queue::wait(gpu, *self.fence)?;
        let Some(pending) = self.pending.take() else { return Ok(None) };
        let (plan, own) = (&loaded.plan, &loaded.slots[slot]);
        let times = Times::read(gpu, own, pending.passes.len())?;
        let words = loaded.readback(slot).into_iter().flat_map(|buffer| buffer.mapped().chunks_exact(4));
        let words = words.map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
        let result = FrameResult {
            pass_ms: pending.passes.iter().enumerate().map(|(i, &pass)| (pass, times.pass(i))).collect(),
            total_ms: times.total(),
            record_ms: pending.record_ms,
            stats: plan.stats.iter().map(|stat| stat.name.clone()).zip(words).collect(),
            output: pending.read_output.then(|| pixels(plan, own)).flatten(),
            inspected: pending.inspected.iter().map(|buffer| buffer.mapped().to_vec()).collect(),
        };
        Ok(Some((pending.frame, result)))
    }

    /// Which of the pending frame's passes are known complete; none where there are no timestamps to tell.
    pub fn finished(&self, gpu: &Gpu, loaded: &LoadedSlot) -> Option<Vec<bool>> {
        let passes = self.pending.as_ref()?.passes.len();
        let times = Times::read(gpu, loaded, passes).ok().filter(|times| !times.ticks.is_empty())?;
        Some((0..passes).map(|pass| times.ticks[queries(pass) as usize + 1].is_some()).collect())
    }
}

/// Copies the frame's uniform blocks to where its descriptor sets point.
fn write_uniforms(loaded: &mut Loaded, slot: usize, inputs: &FrameInputs) -> Result<(), BackendError> {
    for (index, resource) in loaded.plan.resources.iter().enumerate() {
        let bytes = match &resource.source {
            Source::Frame { uniform } => match inputs.uniforms.get(uniform) {
                Some(bytes) => bytes,
                None => return invalid(format!("the frame was given no uniform block `{uniform}`")),
            },
            Source::Live => &inputs.live,
            Source::Transient | Source::Scene { .. } | Source::Given { .. } | Source::Readback => continue,
        };
        let Some(target) = loaded.resources.mapped_mut(ResourceId(index as u32), slot) else { continue };
        if bytes.len() > target.len() {
            return invalid(format!(
                "the frame was given {} bytes for `{}`, which holds {}",
                bytes.len(),
                resource.name,
                target.len()
            ));
        }
        let (given, rest) = target.split_at_mut(bytes.len());
        given.copy_from_slice(bytes);
        rest.fill(0);
    }
    Ok(())
}

fn pixels(plan: &Plan, loaded: &LoadedSlot) -> Option<Pixels> {
    use splatgraph_framework::ir::Shape;
    let Shape::Image { format, width, height } = plan.resource(plan.output).shape else { return None };
    Some(Pixels { format, width, height, bytes: loaded.output.as_ref()?.mapped().to_vec() })
}

/// A frame's timestamps; see [`queries`] for which is which.
struct Times {
    /// Empty where the queue has none; `None` for one that was not written.
    ticks: Vec<Option<u64>>,
    bits: u32,
    /// Nanoseconds per tick.
    period: f64,
}

impl Times {
    fn read(gpu: &Gpu, loaded: &LoadedSlot, passes: usize) -> Result<Times, BackendError> {
        let mut times = Times {
            ticks: Vec::new(),
            bits: gpu.limits.timestamp_bits,
            period: gpu.limits.timestamp_period as f64,
        };
        let Some(pool) = &loaded.timestamps else { return Ok(times) };
        // Each value is followed by whether it is there.
        let mut values = vec![[0u64; 2]; queries(passes) as usize];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WITH_AVAILABILITY;
        // SAFETY: the pool has at least this many timestamps.
        match unsafe { gpu.device.get_query_pool_results(**pool, 0, &mut values, flags) } {
            Ok(()) | Err(vk::Result::NOT_READY) => {}
            Err(answer) => return Err(api("vkGetQueryPoolResults")(answer)),
        }
        times.ticks = values.iter().map(|[value, there]| (*there != 0).then_some(*value)).collect();
        Ok(times)
    }

    /// Milliseconds between two timestamps.
    fn between(&self, from: u32, to: u32) -> Option<f64> {
        let ticks = |query: u32| self.ticks.get(query as usize).copied().flatten();
        Some(milliseconds(ticks(from)?, ticks(to)?, self.bits, self.period))
    }

    fn pass(&self, index: usize) -> Option<f64> {
        self.between(queries(index), queries(index) + 1)
    }

    fn total(&self) -> Option<f64> {
        self.between(0, 1)
    }
}

/// Ticks count modulo two to the number of valid bits, so that a counter may have wrapped between the two.
fn milliseconds(from: u64, to: u64, bits: u32, period: f64) -> f64 {
    let mask = if bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
    (to.wrapping_sub(from) & mask) as f64 * period * 1e-6
}

/// Where a lost device stopped, in words.
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
        // A later pass that overlapped and finished first does not hide the one that did not.
        assert_eq!(said(Some(&[true, false, true])), middle);
        assert!(said(Some(&[false; 3])).contains("none of its passes"));
        assert!(said(Some(&[true; 3])).contains("all its passes"));
        assert!(said(None).contains("without timestamps"));
    }
}
