//! Submits frames, and collects their results.
//!
//! Each frame in flight has a slot: a reused encoder, and its own copy of some of the plan's objects
//! ([`crate::compiled`]), such as timestamps and uniform blocks. Frame `n` uses slot `n % FRAMES_IN_FLIGHT`.

use crate::compiled::CompiledPlan;
use crate::gpu::{Buffer, Encoder, Gpu};
use crate::outputs::SharedOutput;
use crate::record::Recorder;
use crate::shared::Shared;
use crate::timing::Times;
use crate::watch::{self, Ticket};
use crate::window::Swapchain;
use crate::{inputs, inspect};
use splatgraph_api::{BackendError, FrameId, FrameInputs, FrameResult, PixelBytes, Pixels};
use splatgraph_framework::ir::{PassId, Shape};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::info_span;

pub(crate) struct Slot<G: Gpu> {
    encoder: G::Encoder,
    pub pending: Option<Pending<G>>,
}

/// A submitted frame, until its results are collected.
pub(crate) struct Pending<G: Gpu> {
    pub frame: FrameId,
    /// Number of the frame's plan; see [`CompiledPlan::number`].
    pub plan: u64,
    pub passes: Arc<[PassId]>,
    pub ticket: Ticket<G>,
    pub inspected: Vec<Buffer<G>>,
    /// The shared outputs that the frame reads, and the one that it writes; kept alive until it completes.
    pub outputs: Vec<Arc<SharedOutput<G>>>,
    readback: Option<Arc<Buffer<G>>>,
    pub prologue: bool,
    untimed_passes: bool,
    record_ms: f64,
}

pub(crate) struct Frame<'a, G: Gpu> {
    pub id: FrameId,
    pub slot: usize,
    pub inputs: &'a FrameInputs,
    /// The shared output that receives a copy of the frame's output, if the frame is shown.
    pub output: Option<&'a Arc<SharedOutput<G>>>,
    /// The swapchain that the frame's output is blitted to, if any.
    pub swapchain: Option<&'a mut Swapchain<G>>,
}

impl<G: Gpu> Slot<G> {
    pub fn new(gpu: &Arc<G>) -> Result<Self, BackendError> {
        Ok(Slot { encoder: G::Encoder::new(gpu, "frame")?, pending: None })
    }

    /// Records and submits a frame. The slot must have no pending frame. Returns the index of the swapchain image to
    /// present, if any.
    pub fn submit(
        &mut self,
        shared: &Shared<G>,
        compiled: &mut CompiledPlan<G>,
        frame: Frame<G>,
    ) -> Result<Option<u32>, BackendError> {
        let Frame { id, slot, inputs, output, mut swapchain } = frame;
        let gpu = &shared.gpu;
        let start = Instant::now();
        inputs::write_uniforms(compiled, slot, inputs)?;
        inputs::take_host_buffers(shared, compiled, slot, inputs)?;
        let readback = inputs.read_output.then(|| compiled.free_readback(gpu)).transpose()?;
        let saved = inputs.save_histories.then(|| compiled.copies_of_state(gpu)).transpose()?;
        let inspected = inspect::buffers(gpu, compiled, slot, &inputs.inspect)?;
        let recorder = Recorder {
            encoder: &mut self.encoder,
            compiled,
            inputs,
            frame: id,
            slot,
            saved: saved.as_deref().unwrap_or_default(),
            inspected: &inspected,
            readback: readback.as_deref(),
            shared: output.map(Arc::as_ref),
        };
        let recorded = info_span!("record").in_scope(|| recorder.record())?;
        let waiting = Instant::now();
        let image = match (&mut swapchain, compiled.resources.image(compiled.plan.output)) {
            (Some(swapchain), Some(output)) => {
                swapchain.prepare(output, (&compiled.plan, &compiled.synchronization), slot)?
            }
            _ => None,
        };
        let waited = waiting.elapsed();
        let show = swapchain.as_mut().zip(image).and_then(|(swapchain, image)| swapchain.show(image, slot));
        let passes: Arc<[PassId]> = recorded.passes.into();
        let watched = watch::Frame {
            plan: compiled.plan.clone(),
            passes: passes.clone(),
            timestamps: compiled.timestamps[slot].clone().filter(|_| !inputs.untimed_passes),
        };
        let submit = || shared.watch.submit(Some(watched), || self.encoder.submit(show));
        let ticket = info_span!("give to the queue").in_scope(submit)?;
        if compiled.prologue_due {
            shared.results.add(compiled.results());
        }
        compiled.layouts = recorded.layouts;
        if let Some(saved) = saved {
            compiled.saved = saved;
        }
        let prologue = std::mem::take(&mut compiled.prologue_due);
        compiled.carried.clear();
        self.pending = Some(Pending {
            frame: id,
            plan: compiled.number,
            passes,
            ticket,
            inspected,
            outputs: output.cloned().into_iter().chain(compiled.resources.take_outputs(slot)).collect(),
            readback,
            prologue,
            untimed_passes: inputs.untimed_passes,
            record_ms: (start.elapsed() - waited).as_secs_f64() * 1e3,
        });
        Ok(image)
    }

    /// Returns the result of the slot's frame and frees the slot. `None` if no frame is pending, or it is unfinished.
    ///
    /// If `patient`, blocks until the frame has completed. If the wait fails, the frame stays pending. `compiled` is
    /// the frame's plan, and `slot` this slot's index.
    pub fn collect(
        &mut self,
        shared: &Shared<G>,
        compiled: &CompiledPlan<G>,
        slot: usize,
        patient: bool,
    ) -> Result<Option<(FrameId, FrameResult)>, BackendError> {
        let gpu = &*shared.gpu;
        match &self.pending {
            None => return Ok(None),
            Some(pending) if patient => shared.watch.wait(gpu, &mut self.encoder, &pending.ticket)?,
            Some(_) if self.encoder.wait(Duration::ZERO)? => {}
            Some(_) => return Ok(None),
        }
        let Some(pending) = self.pending.take() else { return Ok(None) };
        let (plan, timestamps) = (&compiled.plan, compiled.timestamps[slot].as_deref());
        let times = Times::read(gpu, timestamps, pending.passes.len())?;
        let words = compiled.readback(slot).into_iter().flat_map(|buffer| buffer.mapped().chunks_exact(4));
        let words = words.map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
        let result = FrameResult {
            pass_ms: pending.passes.iter().enumerate().map(|(i, &pass)| (pass, times.pass(i))).collect(),
            total_ms: times.total(),
            start_ms: times.start(),
            pass_start_ms: (0..pending.passes.len()).map(|i| times.pass_start(i)).collect(),
            record_ms: pending.record_ms,
            stats: plan.stats.iter().map(|stat| stat.name.clone()).zip(words).collect(),
            output: pending.readback.and_then(|buffer| pixels(plan, buffer)),
            inspected: pending.inspected.iter().map(|buffer| buffer.mapped().to_vec()).collect(),
        };
        Ok(Some((pending.frame, result)))
    }

    /// Returns for each pass of the pending frame whether it is known to be complete. `None` if no frame is pending, or
    /// its passes' timestamps are unavailable.
    pub fn finished(&self, gpu: &G, timestamps: Option<&G::Timestamps>) -> Option<Vec<bool>> {
        let pending = self.pending.as_ref().filter(|pending| !pending.untimed_passes)?;
        let passes = pending.passes.len();
        Times::read(gpu, timestamps, passes).ok()?.finished(passes)
    }
}

fn pixels<G: Gpu>(plan: &Plan, buffer: Arc<Buffer<G>>) -> Option<Pixels> {
    let Shape::Image { format, width, height } = plan.resource(plan.output).shape else { return None };
    Some(Pixels { format, width, height, bytes: PixelBytes::new(ReadbackLoan(buffer)) })
}

/// A readback buffer on loan to the caller: [`CompiledPlan::free_readback`] skips it until the loan is dropped.
struct ReadbackLoan<G: Gpu>(Arc<Buffer<G>>);

impl<G: Gpu> AsRef<[u8]> for ReadbackLoan<G> {
    fn as_ref(&self) -> &[u8] {
        self.0.mapped()
    }
}
