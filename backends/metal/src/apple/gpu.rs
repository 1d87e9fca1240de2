//! Holds the open device, and the state that its executors share.
//!
//! Metal's objects are reference-counted, and command buffers retain the objects that their commands use, so nothing is
//! destroyed while the GPU uses it. Resources are untracked, so Metal orders nothing by itself. To order frames of
//! several executors, the device lists the submissions in flight and marks those that all later ones wait for.

use crate::apple::device::Physical;
use crate::apple::objc;
use crate::apple::surface::{FORMAT, Surface};
use crate::error::{no_object, of_command_buffer};
use crate::features::{self, LANES};
use crate::lower;
use crate::progress::{Progress, progress};
use metal::*;
use splatgraph_api::{BackendError, Options};
use splatgraph_runtime::{Common, Window, lock};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::time::Duration;

/// An open Apple GPU; see [`crate::Metal`].
pub struct MetalGpu {
    pub(crate) device: Device,
    pub(crate) queue: CommandQueue,
    pub(crate) common: Common,
    pub(crate) builtin: Builtin,
    pub(crate) surface: Option<Surface>,
    /// The timestamp counters; `None` if they cannot be sampled where encoders start and end.
    pub(crate) timestamps: Option<CounterSet>,
    pub(crate) filters_floats: bool,
    /// True if command buffers and encoders are labelled, because captures or Metal's validation are enabled.
    pub(crate) labels: bool,
    pub(crate) allocated: AtomicU64,
    /// Submissions that may not have completed, in the queue's order.
    in_flight: Mutex<Vec<Submission>>,
    /// Code and description of the first error of a command buffer.
    failure: OnceLock<(i64, String)>,
}

/// A submission: its command buffers, and the events around them.
#[derive(Clone)]
pub(crate) struct Submission {
    /// The frame or upload, the draw into a window, and the wait for earlier submissions; the last two are optional.
    pub commands: Vec<CommandBuffer>,
    /// Event and value that the commands wait for before they start.
    pub start: (SharedEvent, u64),
    /// Event and value that signal completion of the whole.
    pub done: (SharedEvent, u64),
    /// True if all later submissions wait for this one.
    pub publishes: bool,
}

impl Submission {
    pub fn progress(&self) -> Progress {
        progress(self.commands.iter().map(|commands| objc::status(commands)))
    }

    /// Blocks until the submission has completed, for at most `limit` (1 ms or more). Metal's own work on the host may
    /// add to it.
    pub fn wait(&self, limit: Duration) {
        let milliseconds = u64::try_from(limit.as_millis()).unwrap_or(u64::MAX).max(1);
        let (event, value) = &self.done;
        if objc::wait_for_event(event, *value, milliseconds) && self.progress() == Progress::Running {
            // Signalling the event was the last command: only Metal's own work on the host is left.
            self.commands.iter().for_each(|commands| commands.wait_until_completed());
        }
    }

    /// Signals, from the host, the events that a failed command buffer did not signal, so that no waiter hangs.
    fn release(&self) {
        for (event, value) in [&self.start, &self.done] {
            if event.signaled_value() < *value {
                event.set_signaled_value(*value);
            }
        }
    }
}

impl MetalGpu {
    pub(crate) fn new(
        physical: Physical,
        window: Option<Arc<dyn Window>>,
        options: &Options,
    ) -> Result<MetalGpu, BackendError> {
        let Physical { raw: device, info, reported } = physical;
        let queue = objc::new_queue(&device).ok_or_else(|| no_object("newCommandQueue"))?;
        queue.set_label("queue");
        let surface = window.map(|window| Surface::new(window, &device)).transpose()?;
        let set =
            ["METAL_CAPTURE_ENABLED", "MTL_CAPTURE_ENABLED", "MTL_DEBUG_LAYER", "METAL_DEVICE_WRAPPER_TYPE"];
        Ok(MetalGpu {
            builtin: Builtin::new(&device)?,
            queue,
            common: Common::new(&info, features::limits(&reported), Arc::default(), options),
            surface,
            timestamps: timestamps(&device),
            filters_floats: reported.filters_floats,
            labels: set.iter().any(|name| std::env::var_os(name).is_some_and(|value| value != "0")),
            allocated: AtomicU64::new(0),
            in_flight: Mutex::default(),
            failure: OnceLock::new(),
            device,
        })
    }

    /// Locks and returns the submissions that are still running. Records the first failure, and releases the commands
    /// that wait for a failed submission.
    pub(crate) fn in_flight(&self) -> MutexGuard<'_, Vec<Submission>> {
        let mut all = lock(&self.in_flight);
        all.retain(|submission| {
            let progress = submission.progress();
            if let Progress::Failed(index) = progress {
                self.failure.get_or_init(|| objc::error(&submission.commands[index]));
                submission.release();
            }
            progress == Progress::Running
        });
        all
    }

    /// Returns the error of the first command buffer, of any executor, that failed; `None` if none has. Results after a
    /// failure are unreliable.
    pub(crate) fn failure(&self) -> Option<BackendError> {
        self.failure.get().map(|(code, text)| of_command_buffer(*code, text))
    }

    /// Creates a command buffer. The caller provides an autorelease pool.
    pub(crate) fn commands(&self, name: &str) -> Result<CommandBuffer, BackendError> {
        let commands = objc::command_buffer(&self.queue).ok_or_else(|| no_object("commandBuffer"))?;
        if self.labels {
            commands.set_label(name);
        }
        Ok(commands)
    }
}

/// Finds the timestamp counters; `None` if they cannot be sampled where encoders start and end.
fn timestamps(device: &DeviceRef) -> Option<CounterSet> {
    if !device.supports_counter_sampling(MTLCounterSamplingPoint::AtStageBoundary) {
        return None;
    }
    objc::pool(|| device.counter_sets().into_iter().find(|set| set.name() == "timestamp"))
}

/// The backend's own pipelines, for fills, clears and presentation.
pub(crate) struct Builtin {
    pub fill_words: ComputePipelineState,
    /// A buffer of one word, the target of commands without effect: in place of empty dispatches, and in encoders that
    /// would otherwise be empty.
    pub scratch: Buffer,
    pub clear_floats: ComputePipelineState,
    pub clear_words: ComputePipelineState,
    pub show: RenderPipelineState,
    /// Sampler without interpolation, for outputs that are shown at their own size or cannot be interpolated.
    pub nearest: SamplerState,
    pub linear: SamplerState,
}

impl Builtin {
    fn new(device: &DeviceRef) -> Result<Builtin, BackendError> {
        objc::pool(|| {
            let library = library(device, include_str!("builtin.metal"), "builtin.metal")?;
            let show = RenderPipelineDescriptor::new();
            show.set_label("show");
            let functions = [function(&library, "show_corner")?, function(&library, "show_pixel")?];
            show.set_vertex_function(Some(&functions[0]));
            show.set_fragment_function(Some(&functions[1]));
            if let Some(target) = show.color_attachments().object_at(0) {
                target.set_pixel_format(FORMAT);
            }
            let call = "newRenderPipelineStateWithDescriptor";
            let show =
                device.new_render_pipeline_state(&show).map_err(|answer| BackendError::Api { call, answer });
            let kernel = |name: &str, threads| {
                let function = function(&library, name)?;
                kernel(device, &function, name, threads).map(|(state, _)| state)
            };
            Ok(Builtin {
                scratch: objc::new_buffer(device, 4, private())
                    .ok_or_else(|| no_object("newBufferWithLength:options:"))?,
                fill_words: kernel("fill_words", 256)?,
                clear_floats: kernel("clear_floats", 256)?,
                clear_words: kernel("clear_words", 256)?,
                show: show?,
                nearest: sampler(device, MTLSamplerMinMagFilter::Nearest),
                linear: sampler(device, MTLSamplerMinMagFilter::Linear),
            })
        })
    }
}

impl Builtin {
    /// Records a dispatch that writes `word` to the first `words` words of a buffer.
    pub fn fill(&self, encoder: &ComputeCommandEncoderRef, target: &BufferRef, [words, word]: [u32; 2]) {
        let fill = [words, word].map(u32::to_le_bytes).concat();
        encoder.set_compute_pipeline_state(&self.fill_words);
        encoder.set_buffer(0, Some(target), 0);
        encoder.set_bytes(1, fill.len() as u64, fill.as_ptr().cast());
        let groups = MTLSize::new(lower::fill_groups(words.into()).max(1).into(), 1, 1);
        encoder.dispatch_thread_groups(groups, MTLSize::new(256, 1, 1));
    }
}

/// Returns the resource options of memory that only the device accesses.
pub(crate) fn private() -> MTLResourceOptions {
    MTLResourceOptions::StorageModePrivate | MTLResourceOptions::HazardTrackingModeUntracked
}

fn sampler(device: &DeviceRef, filter: MTLSamplerMinMagFilter) -> SamplerState {
    let descriptor = SamplerDescriptor::new();
    descriptor.set_min_filter(filter);
    descriptor.set_mag_filter(filter);
    descriptor.set_address_mode_s(MTLSamplerAddressMode::ClampToEdge);
    descriptor.set_address_mode_t(MTLSamplerAddressMode::ClampToEdge);
    device.new_sampler(&descriptor)
}

/// Compiles a library, without fast math: NaN and the order of operations stay. Products and sums may still be
/// contracted, except those that are `precise` in GLSL.
pub(crate) fn library(device: &DeviceRef, source: &str, name: &str) -> Result<Library, BackendError> {
    let options = CompileOptions::new();
    options.set_fast_math_enabled(false);
    options.set_language_version(MTLLanguageVersion::V2_4);
    // Honours `invariant gl_Position`, so that such vertex functions of different pipelines compute identical positions.
    options.set_preserve_invariance(true);
    let library = device.new_library_with_source(source, &options).map_err(|answer| BackendError::Api {
        call: "newLibraryWithSource",
        answer: format!("{answer} for `{name}`"),
    })?;
    library.set_label(name);
    Ok(library)
}

pub(crate) fn function(library: &LibraryRef, name: &str) -> Result<Function, BackendError> {
    library
        .get_function(name, None)
        .map_err(|answer| BackendError::Api { call: "newFunctionWithName", answer })
}

/// Creates a kernel's pipeline for threadgroups of `threads` threads; fails if the device allows fewer. Also returns
/// the lanes of its SIMD groups.
pub(crate) fn kernel(
    device: &DeviceRef,
    function: &FunctionRef,
    name: &str,
    threads: u64,
) -> Result<(ComputePipelineState, u64), BackendError> {
    let call = "newComputePipelineStateWithDescriptor";
    let failed = |answer: String| BackendError::Api { call, answer: format!("{answer} for `{name}`") };
    let descriptor = ComputePipelineDescriptor::new();
    descriptor.set_label(name);
    descriptor.set_compute_function(Some(function));
    // Metal limits the registers per thread so that this many threads fit.
    descriptor.set_max_total_threads_per_threadgroup(threads);
    descriptor
        .set_thread_group_size_is_multiple_of_thread_execution_width(threads.is_multiple_of(LANES.into()));
    let state = device.new_compute_pipeline_state(&descriptor).map_err(failed)?;
    let most = state.max_total_threads_per_threadgroup();
    if most < threads {
        return Err(failed(format!("expected threadgroups of at most {most} threads, found {threads}")));
    }
    let lanes = state.thread_execution_width();
    Ok((state, lanes))
}
