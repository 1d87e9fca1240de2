//! The interface between applications and backends: a device that loads a plan and renders frames of it.
//!
//! A backend executes [`splatgraph_framework::plan::Plan`]s. It owns the device, the plan's memory and pipelines, and the
//! uploads of the scene. What comes after what is decided by the plan's dependencies; a backend looks for no conflicts of its
//! own. The order of calls is: open the device (each backend's own constructor), [`Device::load`] a plan with the scene's data, then [`Device::submit`] frames and
//! [`Device::wait`] for their results, with up to [`FRAMES_IN_FLIGHT`] submitted and not yet waited for.

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

/// Frames that may be submitted before the oldest is waited for.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// A physical device that a backend could open.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceInfo {
    /// Position in the backend's list of devices.
    pub index: usize,
    /// Name that the driver gives, such as `NVIDIA H100 80GB HBM3`.
    pub name: String,
    /// For instance `discrete`, `integrated`, `cpu`.
    pub kind: String,
    /// Name and version of the driver.
    pub driver: String,
    /// The facts that graphs can use; all 0 where the device lacks the API version.
    pub facts: DeviceFacts,
    /// The bounds of accesses beyond the ends of buffers and images, where the device is opened with them.
    pub robustness: Robustness,
    /// The largest of its memory heaps.
    pub heap: Heap,
    /// The reason why it cannot run plans, if it cannot.
    pub unfit: Option<String>,
}

/// The bounds of a shader's accesses beyond the ends of buffers and images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Robustness {
    /// The bounds of storage and uniform buffers.
    pub buffers: Bounds,
    /// The bounds of storage images.
    pub images: Bounds,
}

/// The bound of accesses beyond the end of a resource.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bounds {
    /// None: they reach other memory, and can end the device or the program.
    #[default]
    None,
    /// They stay within the memory of the resource, and may read and write any of it.
    Memory,
    /// Reads give 0, and writes do nothing.
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

/// A heap of a device's own memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Heap {
    /// Its size in bytes.
    pub bytes: u64,
    /// Bytes that this process could still allocate of it when it was asked, as the driver estimates, the needs of other programs
    /// considered (in Vulkan by `VK_EXT_memory_budget`). `None` where the driver does not say.
    pub available: Option<u64>,
}

/// The choice of a device to open.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// A part of the device's name in any case, or its index in the list of devices. Without it the first discrete GPU is
    /// taken, else the first integrated one, else another, a CPU last.
    pub device: Option<String>,
    /// The checks of the API's validation.
    pub validation: Validation,
    /// The longest time that one pass may run before calls that wait for it give up with [`BackendError::Stuck`]. Without it
    /// 10 seconds, and ten minutes where the device is a CPU. Where the device does not tell its passes apart while it runs, as
    /// lavapipe does not, it is the time of a frame.
    pub patience: Option<Duration>,
    /// The longest time that the driver may take over one pipeline before the load of its plan fails with
    /// [`BackendError::StuckCompiler`]. Without it 60 seconds.
    pub compile_patience: Option<Duration>,
    /// Leaves accesses beyond the ends of buffers and images unchecked, to measure what the checks cost. See
    /// [`DeviceInfo::robustness`].
    pub unchecked: bool,
}

/// The checks that the API's validation makes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validation {
    /// None of it.
    #[default]
    Off,
    /// The default checks.
    On,
    /// The default checks and synchronization validation: every hazard that it can see is a message.
    Synchronization,
}

/// Bytes of a device's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Bytes in use by objects.
    pub used: u64,
    /// Bytes allocated from the device: those in use, and the rest of the pieces that they were cut from.
    pub reserved: u64,
}

/// Reads the bytes of the scene's attributes, as a plan asks for them.
pub trait SceneData: Sync {
    /// Writes a piece of plane `plane` of `attribute` into `target`: the bytes from `offset` on.
    ///
    /// The plane has the plan's stride * count bytes. Its pieces are asked for while loading, each once, in ascending order;
    /// `offset` and the length of `target` are multiples of the stride. `target` may be memory that is slow to read.
    ///
    /// # Errors
    /// The reason, in words, why the scene cannot supply it.
    fn write(&self, attribute: &str, plane: u32, offset: u64, target: &mut [u8]) -> Result<(), String>;

    /// Returns a number that differs whenever the data does: planes uploaded under the same identity are kept.
    fn identity(&self) -> u64;
}

/// Stands for no scene, for plans that import no attributes.
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
    /// Bytes of each uniform block with source `Frame`, by name (`frame.camera`).
    pub uniforms: BTreeMap<String, Vec<u8>>,
    /// Bytes of the live uniform block.
    pub live: Vec<u8>,
    /// Contents of each host buffer, by name.
    pub buffers: BTreeMap<String, BufferContents>,
    /// Keep the output as a picture that other plans of this device can read: see [`Device::picture`].
    pub show: bool,
    /// Show the output in the device's window, if it has one: see [`Windowed`].
    pub present: bool,
    /// Read the output image back.
    pub read_output: bool,
    /// Read resources back, each right after a pass of the frame (by index into the plan's passes), or after a pass of the
    /// prologue in the frame that runs it.
    pub inspect: Vec<Inspect>,
    /// Leave out the timestamps of the passes, which take a device some time themselves. Those of the whole frame stay.
    pub untimed_passes: bool,
}

/// The contents of a host buffer for one frame.
#[derive(Clone, Debug, PartialEq)]
pub enum BufferContents {
    /// Bytes of the host. The same [`Arc`] as in the frame before is not copied again.
    Bytes(Arc<Vec<u8>>),
    /// The output of another plan, row 0 at the top, rows tightly packed, pixels as its format has them.
    Picture(Picture),
    /// Some rows of such an output, for one that is larger than a storage binding may be. They are bound as a buffer, and cannot be
    /// arguments of indirect calls.
    Rows {
        /// The output.
        picture: Picture,
        /// The first row. Its place in bytes must be a multiple of [`ROWS_ALIGNMENT`].
        first: u32,
        /// The number of rows, at least one.
        count: u32,
    },
}

/// The alignment in bytes of the first row of [`BufferContents::Rows`]: the largest that any device asks for.
pub const ROWS_ALIGNMENT: u64 = 256;

/// The output of a frame that was submitted with [`FrameInputs::show`], on the device.
///
/// It can be read until its executor shows another size or format, or is dropped; frames in flight that read it keep it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Picture {
    /// Number that tells pictures of one device apart.
    pub id: u64,
    /// Format of a pixel.
    pub format: Format,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

/// A request for the contents of a resource after a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inspect {
    /// The resource to read back.
    pub resource: ResourceId,
    /// The pass after which it is read.
    pub after: PassId,
}

/// A submitted frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId(pub u64);

/// The work that a device executes at present.
#[derive(Clone, Debug, PartialEq)]
pub struct Running {
    /// The pass with its plan, for instance "pass `sort.scan[0]` of `splat`", as far as is known.
    pub place: String,
    /// The time since the device last finished a pass, or since it was first looked at after that.
    pub time: Duration,
}

/// The results of a frame.
#[derive(Clone, Debug, Default)]
pub struct FrameResult {
    /// GPU milliseconds per pass that ran, in order of execution (prologue included in the frame that ran it; the host's
    /// step, which runs nothing, left out). `None` where the device has no timestamps.
    pub pass_ms: Vec<(PassId, Option<f64>)>,
    /// GPU milliseconds from the first to the last command of the frame.
    pub total_ms: Option<f64>,
    /// Host milliseconds spent recording and submitting.
    pub record_ms: f64,
    /// The plan's statistics, in the plan's order.
    pub stats: Vec<(String, u32)>,
    /// The output, if it was asked for.
    pub output: Option<Pixels>,
    /// The bytes of the inspected resources, in the order asked.
    pub inspected: Vec<Vec<u8>>,
}

/// An image as the GPU holds it, row 0 at the top, rows tightly packed.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// Format of a pixel.
    pub format: Format,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// `width * height` pixels in the format's layout.
    pub bytes: PixelBytes,
}

/// Holds the bytes of a picture that was read back, where the device wrote them; clones share them.
///
/// Their memory is not written again before the last clone is gone. Frames that are read back meanwhile get memory of their own, so
/// whoever keeps many pictures keeps as much memory.
#[derive(Clone)]
pub struct PixelBytes(Arc<dyn AsRef<[u8]> + Send + Sync>);

impl PixelBytes {
    /// Wraps whatever holds the bytes.
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
    /// Reports the pipeline that is made next.
    Pipeline {
        /// Pipelines that were made.
        done: usize,
        /// Pipelines of the plan.
        of: usize,
        /// Shader of the next one.
        shader: &'a str,
    },
    /// Reports the upload of the scene.
    Upload {
        /// Bytes that were uploaded.
        done_bytes: u64,
        /// Bytes to upload in all.
        of_bytes: u64,
    },
}

/// Makes a plan ready to run while frames of another are being drawn, on any thread.
pub trait Loader: Send + 'static {
    /// A plan with everything that was created for it.
    type Ready: Send + 'static;

    /// Makes [`Loader::prepare`] end early with [`BackendError::Cancelled`] when `cancel` asks for it, in whatever the driver is then.
    ///
    /// An upload that was begun goes on to its end: the next plan finds the scene on the device.
    #[must_use]
    fn cancelled_by(self, cancel: Cancel) -> Self;

    /// Lets the plan take over the results of passes with `run: Once` of other plans of the device.
    ///
    /// It takes over those for which all that they depend on is equal. The passes are left out, and both plans hold one buffer. Not for
    /// measurements and inspections of these passes.
    #[must_use]
    fn sharing_results(self) -> Self;

    /// Creates the plan's pipelines and resources, and uploads the scene attributes that it reads and that are not on the device
    /// yet.
    ///
    /// # Errors
    /// [`BackendError::StuckCompiler`] if the driver takes longer over a pipeline than [`Options::compile_patience`]. Nobody waits for
    /// it any more then; the same plan is refused with the same error until the driver has come to its end.
    fn prepare(
        self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self::Ready, BackendError>;
}

/// An opened device, and the plan that it executes.
///
/// Several contexts can be open on one device at a time ([`Device::new_context`]): each has a plan and frames of its own, and they
/// take turns on one queue, in the order of their submission. Scene attributes that several read are on the device once.
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
    /// See [`Device::loader`].
    type Loader: Loader;

    /// Describes the physical device.
    fn info(&self) -> &DeviceInfo;

    /// Creates another context on the same device, without a plan.
    fn new_context(&self) -> Result<Self, BackendError>;

    /// Returns true for contexts of one device: they take turns on its queue, and can read each other's [pictures](Device::picture).
    fn shares_device(&self, other: &Self) -> bool;

    /// Makes the plan the current one: creates what it needs, uploads the scene attributes that it reads, and lets the
    /// next frame run its prologue. On an error the former plan stays current.
    ///
    /// Does not wait for the former plan's frames: their results can be had as before. Where both plans have a history of
    /// the same name and shape, and the scene is the same, the new plan goes on from what those frames leave in it.
    fn load(
        &mut self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), BackendError> {
        let ready = self.loader().prepare(plan, scene, progress)?;
        self.swap(ready)
    }

    /// Returns the first half of [`Device::load`], to be run while frames are drawn, on any thread. It can be taken at any time,
    /// also before a [`Device::swap`] to another plan.
    fn loader(&self) -> Self::Loader;

    /// Makes a prepared plan the current one, between two frames: the second half of [`Device::load`]. It waits for nothing.
    fn swap(&mut self, ready: <Self::Loader as Loader>::Ready) -> Result<(), BackendError>;

    /// Returns the output of the last frame that was submitted with [`FrameInputs::show`].
    fn picture(&self) -> Option<Picture>;

    /// Records and submits a frame. Blocks only while [`FRAMES_IN_FLIGHT`] frames are still being executed, and, if the frame is
    /// to be shown in a window, until the window can take it: see [`Windowed`].
    ///
    /// # Errors
    /// [`BackendError::Stuck`] while the device runs one pass for longer than [`Options::patience`]. Nothing is submitted then.
    fn submit(&mut self, inputs: &FrameInputs) -> Result<FrameId, BackendError>;

    /// Blocks until the frame is done. Each frame's result can be taken once.
    ///
    /// # Errors
    /// [`BackendError::Stuck`] while the device runs one pass for longer than [`Options::patience`]. The frame stays in flight.
    fn wait(&mut self, frame: FrameId) -> Result<FrameResult, BackendError>;

    /// Takes the frame's result if the frame is done; never blocks.
    fn try_wait(&mut self, frame: FrameId) -> Result<Option<FrameResult>, BackendError>;

    /// Says whether the next [`Device::submit`] need not wait for a frame in flight; never blocks.
    fn is_ready(&mut self) -> Result<bool, BackendError>;

    /// Returns the work that the device executes at present, of all contexts on it; none if this context waits for nothing. Never
    /// blocks.
    ///
    /// A program that must stay responsive calls it while a frame is not done, and goes without the frame if the time is long.
    fn running(&mut self) -> Option<Running>;

    /// Lists names and bytes of device memory: the plan's resources first, then scene attributes, then the backend's own. Every
    /// piece of memory is listed once, so that the sum is the allocated memory (of each context, what several share): resources that share one are one entry, under their
    /// names joined by ` + `; a resource that exists once per frame in flight is one entry.
    fn memory(&self) -> Vec<(String, u64)>;

    /// Describes the largest heap of the device's own memory, as it is now.
    fn heap(&self) -> Heap;

    /// Returns the validation messages since the last call; none when validation is off.
    fn take_messages(&mut self) -> Vec<String>;
}

/// A device that shows its frames in a window. (Each backend has a constructor of its own for it.)
///
/// Frames with [`FrameInputs::present`] are scaled to the window. [`Device::submit`] blocks for them until the window has room: with
/// vsync, once per refresh of the display. While the window shows nothing they are drawn and not shown.
pub trait Windowed: Device {
    /// Sets the window's size in pixels; a window of size 0 shows nothing.
    fn resize_window(&mut self, width: u32, height: u32);

    /// Sets whether frames wait for the display's refresh, as they do at first. Without it they are shown as fast as they are
    /// drawn, where the window system allows it.
    fn set_vsync(&mut self, vsync: bool);
}
