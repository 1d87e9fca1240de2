//! Defines the interface between applications and backends: a device that loads a plan and renders frames of it.
//!
//! A backend executes [`splatgraph_framework::plan::Plan`]s. It owns the device, the plan's memory and pipelines, and
//! the uploads of the scene. It orders accesses by the plan's dependencies, and does not search for conflicts itself.
//! The order of calls is: open the device (each backend has its own constructor), [`Device::load`] a plan with the
//! scene's data, then [`Device::submit`] frames and [`Device::wait`] for their results. At most [`FRAMES_IN_FLIGHT`]
//! frames of a context are in flight: submitting another one first waits for the oldest.

#![deny(missing_docs)]

mod error;

pub use error::{BackendError, LimitExceeded, Recovery, Unit, display_bytes};

use serde::Serialize;
use splatgraph_framework::ir::{DeviceFacts, Format, PassId, ResourceId};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Deref;
use std::sync::Arc;
use std::time::Duration;

/// Maximum number of frames in flight, per context.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// Name in [`Device::memory`] of the buffers that read outputs back. A frame with [`FrameInputs::read_output`] creates
/// one if the plan has none that is free.
pub const OUTPUT_READBACK: &str = "output readback";

/// A physical device that a backend could open.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceInfo {
    /// Position in the backend's list of devices.
    pub index: usize,
    /// Name from the driver, such as `NVIDIA H100 80GB HBM3`.
    pub name: String,
    /// Kind of device, for instance `discrete`, `integrated` or `cpu`.
    pub kind: String,
    /// Name and version of the driver.
    pub driver: String,
    /// The facts that graphs can use; all 0, false or empty if the device's API version is too low.
    pub facts: DeviceFacts,
    /// Effects of out-of-range shader accesses; [`Bounds::None`] on a device opened without checks.
    pub robustness: Robustness,
    /// The largest device-local heap; may be [`Heap::default`] if the device cannot run plans.
    pub heap: Heap,
    /// Reason why the device cannot run plans; `None` if it can.
    pub unfit: Option<String>,
}

impl DeviceInfo {
    /// Returns true if the device is a CPU. Its frames then compete with the program for cores.
    pub fn is_cpu(&self) -> bool {
        self.kind == "cpu"
    }
}

/// Effects of out-of-range shader accesses to buffers and images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Robustness {
    /// For storage and uniform buffers.
    pub buffers: Bounds,
    /// For storage images.
    pub images: Bounds,
}

/// The memory that an out-of-range access can reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bounds {
    /// Accesses are unchecked: they can reach any memory, and can crash the device or the program.
    #[default]
    None,
    /// Accesses stay within the resource's memory, but may read or write any of it.
    Memory,
    /// Out-of-range reads return 0, and out-of-range writes are dropped.
    Exact,
}

impl fmt::Display for Robustness {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let text = |bounds| match bounds {
            Bounds::None => "unchecked",
            Bounds::Memory => "kept within the resource's memory",
            Bounds::Exact => "without effect",
        };
        write!(
            f,
            "accesses beyond the end of a buffer: {}; of an image: {}",
            text(self.buffers),
            text(self.images)
        )
    }
}

/// A heap of device-local memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Heap {
    /// Size of the heap in bytes.
    pub bytes: u64,
    /// Estimate of the bytes that this process can still allocate, from when the device was listed or [`Device::heap`]
    /// was called. `None` if unknown.
    pub available: Option<u64>,
}

/// Options for opening a device.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The device's index in the list of devices, or part of its name (case-insensitive). Digits that are not an index
    /// must be a whole word of the name. Default: of the devices that can run plans, the first discrete GPU, else the
    /// first integrated GPU, else any other device, CPUs last.
    pub device: Option<String>,
    /// Level of API validation.
    pub validation: Validation,
    /// Time that one pass may run before calls that wait for it return [`BackendError::Stuck`]. Default: 10 seconds, or
    /// ten minutes on a CPU. The limit applies to a whole frame if the timestamps of its passes are omitted
    /// ([`FrameInputs::untimed_passes`]) or cannot be read while the device runs.
    pub patience: Option<Duration>,
    /// Time that the driver may take for one pipeline before the load fails with [`BackendError::StuckCompiler`].
    /// Default: 60 seconds.
    pub compile_patience: Option<Duration>,
    /// Disables bounds checks of shader accesses, to measure their cost. See [`DeviceInfo::robustness`].
    pub unchecked: bool,
}

/// The level of API validation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validation {
    /// No validation at all.
    #[default]
    Off,
    /// The default checks.
    On,
    /// The default checks and, with Vulkan, synchronization validation, which reports hazards.
    Synchronization,
}

/// Memory use of a device, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Bytes that buffers and images occupy.
    pub used: u64,
    /// Bytes allocated from the device, including unused parts of the allocations.
    pub reserved: u64,
}

/// A source of the bytes of the scene's attributes.
pub trait SceneData: Sync {
    /// Copies bytes of plane `plane` of `attribute`, starting at `offset`, into `target`.
    ///
    /// The plane has `stride * count` bytes; the plan has both numbers. A load requests each piece of a plane once, in
    /// ascending order; `offset` and the length of `target` are multiples of the stride. `target` may be slow to read.
    ///
    /// # Errors
    /// The reason why the scene cannot supply the bytes.
    fn write(&self, attribute: &str, plane: u32, offset: u64, target: &mut [u8]) -> Result<(), String>;

    /// Returns a number that identifies the data. Scenes with different data must have different numbers: planes,
    /// histories and shared results are reused if the number is equal.
    fn identity(&self) -> u64;
}

/// A scene without attributes, for plans that import none.
pub struct NoScene;

impl SceneData for NoScene {
    fn write(&self, attribute: &str, _: u32, _: u64, _: &mut [u8]) -> Result<(), String> {
        Err(format!("`{attribute}`: there is no scene"))
    }

    fn identity(&self) -> u64 {
        0
    }
}

/// The inputs of one frame.
#[derive(Clone, Debug, Default)]
pub struct FrameInputs {
    /// Bytes of each uniform block with source `Frame`, by name (`frame.camera`). Missing bytes at the end are zero.
    pub uniforms: BTreeMap<String, Vec<u8>>,
    /// Bytes of the uniform block of live parameters, at least to the end of the last one: `Plan::live_bytes`.
    pub live: Vec<u8>,
    /// Contents of each host buffer, by name: at least its declared size, in whole elements.
    pub buffers: BTreeMap<String, BufferContents>,
    /// Keeps the output as a picture that other plans of this device can read; see [`Device::picture`].
    pub show: bool,
    /// Shows the output in the context's window, if any; see [`Device::submit`].
    pub present: bool,
    /// Reads the output image back.
    pub read_output: bool,
    /// Reads resources back, each right after a pass. A prologue pass can be named only in the frame that runs the
    /// prologue.
    pub inspect: Vec<Inspect>,
    /// Omits the passes' timestamps, which cost time. The timestamps of the whole frame stay.
    pub untimed_passes: bool,
    /// Copies the plan's state ([`Plan::is_state`]) before the frame's passes change it; see
    /// [`Loader::restoring_histories`]. The copies take time, and as much device memory as the state.
    pub save_histories: bool,
}

/// The contents of a host buffer for one frame.
#[derive(Clone, Debug, PartialEq)]
pub enum BufferContents {
    /// Bytes from the host. Passing the same [`Arc`] again (compared by pointer) avoids another copy.
    Bytes(Arc<Vec<u8>>),
    /// A shown output of any context of the device, in the output's format. Row 0 is at the top, and rows are tightly
    /// packed.
    Picture(Picture),
    /// Rows of a shown output, for outputs that exceed the limit of a storage binding. Indirect commands can read
    /// their arguments from them only if `first` is 0.
    Rows {
        /// The shown output.
        picture: Picture,
        /// The first row. Its byte offset must be a multiple of [`ROWS_ALIGNMENT`].
        first: u32,
        /// The number of rows, at least one.
        count: u32,
    },
}

/// Required byte alignment of the first row of [`BufferContents::Rows`]. It suffices on every device: Vulkan allows no
/// larger `minStorageBufferOffsetAlignment`.
pub const ROWS_ALIGNMENT: u64 = 256;

/// The output of a context's last frame with [`FrameInputs::show`], kept on the device. A later shown frame of equal
/// size and format overwrites it. It can be read until its context is dropped or shows a frame of another size or
/// format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Picture {
    /// Unique number among the pictures of a device.
    pub id: u64,
    /// Format of a pixel.
    pub format: Format,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
}

/// A request for the contents of a resource after a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inspect {
    /// The resource to read back.
    pub resource: ResourceId,
    /// The pass after which the resource is read.
    pub after: PassId,
}

/// The number of a submitted frame, unique within its context.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId(pub u64);

/// The work that a device is executing.
#[derive(Clone, Debug, PartialEq)]
pub struct Running {
    /// Description, for instance "pass `sort.scan[0]` of `splat`"; "a frame of `splat`" if the pass is unknown.
    pub place: String,
    /// Time since a query or a wait first found the device in this pass: a lower bound.
    pub time: Duration,
}

/// The results of a frame.
#[derive(Clone, Debug, Default)]
pub struct FrameResult {
    /// GPU milliseconds of each pass, in execution order; `None` without timestamps.
    ///
    /// The frame that runs the prologue includes the prologue's passes. The host pass and skipped passes have no entry.
    pub pass_ms: Vec<(PassId, Option<f64>)>,
    /// GPU milliseconds from the first to the last command of the frame; `None` without timestamps.
    pub total_ms: Option<f64>,
    /// Start of the frame in milliseconds, on a clock whose origin is unknown and which may wrap. `None` without
    /// timestamps.
    pub start_ms: Option<f64>,
    /// Milliseconds from the start of the frame to the start of each pass; indexed like `pass_ms`.
    pub pass_start_ms: Vec<Option<f64>>,
    /// Host milliseconds spent recording and submitting, without waits for the device or the window.
    pub record_ms: f64,
    /// The plan's statistics, in the plan's order.
    pub stats: Vec<(String, u32)>,
    /// The output, if requested.
    pub output: Option<Pixels>,
    /// The bytes of the inspected resources, in the order of the requests. Images are in their GPU format, row 0 first,
    /// rows tightly packed.
    pub inspected: Vec<Vec<u8>>,
}

/// An image in its GPU format, row 0 at the top, rows tightly packed.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// Format of a pixel.
    pub format: Format,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// `width * height` pixels in the format's layout.
    pub bytes: PixelBytes,
}

/// The bytes of a picture that was read back, in the memory that the device wrote. Clones share them. The memory is
/// reused once the last clone is dropped; until then other frames allocate more.
#[derive(Clone)]
pub struct PixelBytes(Arc<dyn AsRef<[u8]> + Send + Sync>);

impl PixelBytes {
    /// Wraps an owner of bytes.
    pub fn new(holder: impl AsRef<[u8]> + Send + Sync + 'static) -> PixelBytes {
        PixelBytes(Arc::new(holder))
    }
}

impl Deref for PixelBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        (*self.0).as_ref()
    }
}

impl PartialEq for PixelBytes {
    fn eq(&self, other: &PixelBytes) -> bool {
        **self == **other
    }
}

impl fmt::Debug for PixelBytes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} bytes", self.len())
    }
}

/// The progress of a load.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress<'a> {
    /// The load creates a pipeline, or waits for it.
    Pipeline {
        /// Number of pipelines before this one. All of them are ready, created or reused.
        done: usize,
        /// Total pipelines of the plan.
        of: usize,
        /// Shader of this pipeline; for a draw, the vertex shader.
        shader: &'a str,
    },
    /// The scene is being uploaded.
    Upload {
        /// Bytes that the scene has supplied so far; copies of the last ones may still run.
        done_bytes: u64,
        /// Total bytes to upload.
        of_bytes: u64,
    },
}

/// Pipelines that [`Loader::compile`] created. They keep the device open.
pub struct Compiled {
    _pipelines: Box<dyn Send>,
}

impl Compiled {
    /// Wraps a backend's pipelines.
    pub fn new(pipelines: impl Send + 'static) -> Compiled {
        Compiled { _pipelines: Box::new(pipelines) }
    }
}

impl fmt::Debug for Compiled {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("Compiled").finish_non_exhaustive()
    }
}

/// A handle that prepares one plan, on any thread, while frames of another plan are drawn.
pub trait Loader: Send + 'static {
    /// A plan and all objects created for it.
    type Ready: Send + 'static;

    /// Lets `cancel` end [`Loader::prepare`] and [`Loader::compile`] with [`BackendError::Cancelled`].
    ///
    /// It takes effect while pipelines are compiled, even if the driver is busy. After that, the upload is always
    /// completed, so that the next plan finds the scene on the device.
    #[must_use]
    fn cancelled_by(self, cancel: Cancel) -> Self;

    /// Lets the plan reuse results of other plans' `run: Once` passes on this device, if all their inputs are equal.
    /// Passes whose results are reused do not run, so do not use this to measure or inspect them.
    #[must_use]
    fn sharing_results(self) -> Self;

    /// Lets the plan's histories begin with zeros, instead of the contents in the current plan.
    #[must_use]
    fn clearing_histories(self) -> Self;

    /// Lets the plan continue with all state of the current one ([`Plan::is_state`]).
    ///
    /// This includes histories that the prologue writes, and results of the prologue that frames change. For a plan
    /// that differs only in capacities.
    #[must_use]
    fn keeping_state(self) -> Self;

    /// Lets the plan's state ([`Plan::is_state`]) begin with the contents from before the current plan's last frame
    /// with [`FrameInputs::save_histories`]. The frame can then be repeated with another plan. Without such a frame,
    /// the state begins anew.
    #[must_use]
    fn restoring_histories(self) -> Self;

    /// Creates only a plan's pipelines. While the result is kept, plans with equal pipelines are prepared faster:
    /// Vulkan reuses the pipelines, and on Metal the system has already compiled their shaders.
    ///
    /// # Errors
    /// The errors of [`Loader::prepare`], except errors about the memory of resources and about the scene.
    fn compile(self, plan: Plan) -> Result<Compiled, BackendError>;

    /// Creates the plan's pipelines and resources, and uploads its scene attributes that are not on the device yet.
    ///
    /// # Errors
    /// - [`BackendError::Invalid`], [`BackendError::Limit`] or [`BackendError::Unsupported`] if the device cannot run
    ///   the plan.
    /// - [`BackendError::StuckCompiler`] if the driver takes longer than [`Options::compile_patience`] for a pipeline.
    ///   The compiler's thread is then abandoned, and the plan is refused with this error until the thread has ended.
    ///   Also if too many threads are abandoned and the oldest has exceeded that time.
    /// - [`BackendError::OutOfMemory`], [`BackendError::Scene`], [`BackendError::Cancelled`], [`BackendError::Stuck`]
    ///   if a copy of the upload takes longer than [`Options::patience`], or a driver error.
    fn prepare(
        self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self::Ready, BackendError>;
}

/// An opened device, and the plan that it executes.
///
/// Several contexts can be open on one device ([`Device::new_context`]). Each has its own plan and frames. They share
/// one queue, in the order of submission, and one copy of the scene's attributes.
///
/// ```
/// use splatgraph_api::{BackendError, Device, FrameInputs, NoScene, Pixels};
/// use splatgraph_framework::plan::Plan;
///
/// /// Draws one frame of a plan that reads no scene.
/// fn draw(device: &mut impl Device, plan: Plan) -> Result<Option<Pixels>, BackendError> {
///     let live = plan.live_bytes();
///     device.load(plan, &NoScene, &mut |_| {})?;
///     let frame = device.submit(&FrameInputs { live, read_output: true, ..FrameInputs::default() })?;
///     Ok(device.wait(frame)?.output)
/// }
/// ```
pub trait Device: Sized {
    /// The loader that [`Device::loader`] returns.
    type Loader: Loader;

    /// Describes the physical device.
    fn info(&self) -> &DeviceInfo;

    /// Creates another context on the same device, without a plan or a window.
    fn new_context(&self) -> Result<Self, BackendError>;

    /// Returns true if both contexts use one device. They share its queue and can read each other's
    /// [pictures](Device::picture).
    fn shares_device(&self, other: &Self) -> bool;

    /// Makes the plan the current one, and lets the next frame run its prologue.
    ///
    /// Creates the plan's objects, and uploads the scene attributes that it reads and the device lacks. If that fails,
    /// the earlier plan stays current. Frames of the earlier plan can be in flight; their results stay available. The
    /// new plan continues the earlier plan's history of equal name and shape if the scene is unchanged, the new plan
    /// makes no further uses of the history, and its prologue only clears it.
    fn load(
        &mut self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), BackendError> {
        let ready = self.loader().prepare(plan, scene, progress)?;
        self.swap(ready)
    }

    /// Returns a loader, which does the first half of [`Device::load`] on any thread while frames are drawn. It stays
    /// valid across swaps to other plans.
    fn loader(&self) -> Self::Loader;

    /// Makes a prepared plan the current one: the second half of [`Device::load`]. Call it between two frames; it never
    /// blocks.
    ///
    /// # Errors
    /// [`BackendError::Invalid`] if another context's loader prepared the plan; [`BackendError::DeviceLost`].
    fn swap(&mut self, ready: <Self::Loader as Loader>::Ready) -> Result<(), BackendError>;

    /// Returns the output of the last frame that was submitted with [`FrameInputs::show`]; `None` before the first.
    fn picture(&self) -> Option<Picture>;

    /// Records and submits a frame. Blocks only while [`FRAMES_IN_FLIGHT`] frames are in flight and, for a frame to
    /// present, until the window can accept it.
    ///
    /// A frame with [`FrameInputs::present`] is scaled to the window. With vsync, the window accepts one frame per
    /// refresh of the display, except on Wayland, where it never waits for the display. Frames that the window does not
    /// accept within two seconds, and those of a hidden window, are drawn but not shown.
    ///
    /// # Errors
    /// [`BackendError::Stuck`] if the device runs one pass for longer than [`Options::patience`]. Nothing is submitted
    /// then. [`BackendError::Invalid`] if no plan is loaded, or the inputs do not fit it. [`BackendError::Limit`] or
    /// [`BackendError::OutOfMemory`] if host buffers or copies are too large for the device.
    /// [`BackendError::Unsupported`] if the device cannot present the output's format. [`BackendError::SurfaceLost`] if
    /// the window is gone. If only the presentation fails, the frame runs, but its result cannot be taken.
    fn submit(&mut self, inputs: &FrameInputs) -> Result<FrameId, BackendError>;

    /// Returns true if the last submitted frame was to be presented, but could not be shown in the window. False
    /// without a window.
    fn missed_window(&self) -> bool;

    /// Sets the window's size in pixels; a window of size 0 is hidden. Does nothing without a window.
    fn resize_window(&mut self, width: u32, height: u32);

    /// Switches vsync on (the default) or off. Without it, frames are shown as soon as they are drawn, if the window
    /// system allows it. Does nothing without a window.
    fn set_vsync(&mut self, vsync: bool);

    /// Blocks until the frame has completed, and takes its result. Each result can be taken once.
    ///
    /// # Errors
    /// [`BackendError::Stuck`] if the device runs one pass for longer than [`Options::patience`]. The frame stays in
    /// flight. [`BackendError::Invalid`] if the frame has no result, for instance because it was already taken.
    fn wait(&mut self, frame: FrameId) -> Result<FrameResult, BackendError>;

    /// Takes the frame's result if the frame has completed, else returns `None`; never blocks.
    ///
    /// # Errors
    /// [`BackendError::Invalid`] if the frame has no result, as for [`Device::wait`].
    fn try_wait(&mut self, frame: FrameId) -> Result<Option<FrameResult>, BackendError>;

    /// Returns true if the next [`Device::submit`] would not wait for a frame in flight; never blocks.
    fn is_ready(&mut self) -> Result<bool, BackendError>;

    /// Returns the work that the device is executing for any context. `None` if this context has no frame in flight, or
    /// if checking on its frames fails. Never blocks.
    fn running(&mut self) -> Option<Running>;

    /// Lists device memory by name, in bytes: the plan's resources, then scene attributes, then the backend's own.
    ///
    /// The sum is the allocated memory. Memory that contexts share is listed by each of them. Resources that share
    /// memory form one entry, with names joined by ` + `. The copies of a resource per frame in flight form one entry,
    /// and so do the buffers that read outputs back, [`OUTPUT_READBACK`].
    fn memory(&self) -> Vec<(String, u64)>;

    /// Returns the size and the available bytes of the largest device-local heap, as of now.
    fn heap(&self) -> Heap;

    /// Returns the device's messages since the last call on any of its contexts: those of validation, and with Metal
    /// also the reason why a frame could not be captured.
    fn take_messages(&mut self) -> Vec<String>;
}
