//! Defines the trait that a graphics API implements, and the objects that it creates.
//!
//! [`Gpu`] is an open device, and creates objects. Objects with methods have their own traits: [`Memory`],
//! [`Bindings`], [`Encoder`] and [`Swapchain`]. The rest of the crate decides, for every API, which objects a plan
//! needs, how many frames are in flight, and which contents one plan passes on to the next. An object is dropped only
//! when no frame in flight uses it.
//!
//! An implementation lowers the plan's dependencies to commands once per plan. In Vulkan, they are barriers: the
//! [`Gpu::Synchronization`], which [`Encoder::synchronize`] records pass by pass. In Metal, they are fences and
//! barriers of Metal's encoders, and are created with the pipelines; [`Encoder::pass`] announces the next pass.

use crate::check::within_bytes;
use crate::limits::Limits;
use crate::messages::Messages;
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options};
use splatgraph_framework::{ir::*, plan::*};
use std::fmt::Arguments;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// A window for which a surface, and so a swapchain, can be created.
pub trait Window: HasDisplayHandle + HasWindowHandle + Send + Sync {}

impl<W: HasDisplayHandle + HasWindowHandle + Send + Sync> Window for W {}

/// The state of an open device that does not depend on its API.
pub struct Common {
    /// The device's limits.
    pub limits: Limits,
    /// True if the device is a CPU.
    pub is_cpu: bool,
    /// Validation messages; the list may outlive the device.
    pub messages: Arc<Messages>,
    /// Time that one pass may run before calls that wait for it give up.
    pub patience: Duration,
    /// Time that the driver may take for one pipeline before the load is abandoned.
    pub compile_patience: Duration,
}

impl Common {
    /// Creates the state of a device that is opened with these options.
    pub fn new(info: &DeviceInfo, limits: Limits, messages: Arc<Messages>, options: &Options) -> Common {
        // A CPU is much slower than a GPU.
        let patience = Duration::from_secs(if info.is_cpu() { 600 } else { 10 });
        Common {
            limits,
            is_cpu: info.is_cpu(),
            messages,
            patience: options.patience.unwrap_or(patience),
            compile_patience: options.compile_patience.unwrap_or(Duration::from_secs(60)),
        }
    }
}

/// An open device of one graphics API, usable from several threads. Executors share its one queue, and plans are
/// prepared on their own threads.
pub trait Gpu: Sized + Send + Sync + 'static {
    /// A device memory allocation, freed when it is dropped.
    type Memory: Memory<Self>;
    /// A buffer without memory.
    type UnboundBuffer;
    /// An image without memory.
    type UnboundImage;
    /// A buffer; [`Buffer`] holds its memory.
    type Buffer: Send + Sync;
    /// An image with a view; [`Image`] holds its memory.
    type Image: Send + Sync;
    /// The commands that order one plan's passes, lowered from its dependencies.
    type Synchronization: Send + Sync;
    /// The pipelines of one plan.
    type Pipelines: Send + Sync;
    /// The bindings of one plan's passes: descriptor sets or argument tables.
    type Bindings: Bindings<Self>;
    /// A set of timestamp queries.
    type Timestamps: Send + Sync;
    /// A command recorder.
    type Encoder: Encoder<Self>;
    /// A window's swapchain.
    type Swapchain: Swapchain<Self>;

    /// Lists the machine's devices.
    fn devices() -> Result<Vec<DeviceInfo>, BackendError>;

    /// Opens the device chosen by `options`; with a window, only one that can present to it. Calls `chosen` before the
    /// device is created.
    fn open(
        options: &Options,
        window: Option<Arc<dyn Window>>,
        chosen: &mut dyn FnMut(&DeviceInfo),
    ) -> Result<(DeviceInfo, Arc<Self>), BackendError>;

    /// Returns the device's limits, validation messages and time limits.
    fn common(&self) -> &Common;

    /// Returns the bytes of device memory that all objects use, and the bytes reserved for them.
    fn memory(&self) -> DeviceMemory;

    /// Estimates the bytes that new allocations can use in the largest device-local heap; `None` if unknown. They
    /// include free space that the backend has reserved.
    fn available(&self) -> Option<u64>;

    /// Returns the image uses that the device supports for a format.
    fn format_support(&self, format: Format) -> FormatSupport;

    /// Blocks until the device has finished all submitted work or is lost. Returns false once `limit` has passed, or if
    /// the wait fails. Other threads can submit meanwhile.
    fn wait_idle(&self, limit: Duration) -> bool;

    /// Creates a buffer without memory, and returns its memory requirements.
    ///
    /// Resources of one block of a plan share an allocation if their [`Requirements::types`] and
    /// [`Limits::device_memory_types`] have a type in common and none is dedicated. An API whose objects cannot share
    /// memory sets the limit to 0. The plan still has the dependencies between the resources of a block
    /// ([`Dependency::alias`]); they then order more than necessary.
    fn create_buffer(
        self: &Arc<Self>,
        desc: &BufferDesc,
    ) -> Result<(Self::UnboundBuffer, Requirements), BackendError>;

    /// Creates an image without memory, and returns its memory requirements. The caller has checked that the format
    /// supports the usage.
    fn create_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
    ) -> Result<(Self::UnboundImage, Requirements), BackendError>;

    /// Binds a buffer, created from `desc`, to the start of an allocation that meets its requirements.
    fn bind_buffer(
        self: &Arc<Self>,
        desc: &BufferDesc,
        buffer: Self::UnboundBuffer,
        memory: &Self::Memory,
    ) -> Result<Self::Buffer, BackendError>;

    /// Binds an image, created from `desc`, to the start of an allocation that meets its requirements.
    fn bind_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
        image: Self::UnboundImage,
        memory: &Self::Memory,
    ) -> Result<Self::Image, BackendError>;

    /// Lowers the dependencies of a checked plan to this API's synchronization commands.
    fn synchronization(plan: &Plan) -> Result<Self::Synchronization, BackendError>;

    /// Creates the pipelines of all dispatches and draws of a checked plan.
    ///
    /// Calls `next` before each pipeline that it creates or waits for, and stops if `next` returns an error. Runs on a
    /// thread that may outlive its caller.
    fn create_pipelines(
        self: &Arc<Self>,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Self::Pipelines, BackendError>;

    /// Creates `count` timestamps; `None` if the queue has no timer.
    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Self::Timestamps>, BackendError>;

    /// Reads the first `count` timestamps, in ticks; `None` for each one not written yet.
    fn read_timestamps(
        &self,
        timestamps: &Self::Timestamps,
        count: u32,
    ) -> Result<Vec<Option<u64>>, BackendError>;

    /// Returns the size to create the swapchain with, in pixels; `None` while the window shows nothing. `wanted` is the
    /// size reported to the program, used if the surface does not dictate one.
    fn window_size(&self, wanted: (u32, u32)) -> Result<Option<(u32, u32)>, BackendError>;

    /// Recreates the window's surface, after a call returned [`BackendError::SurfaceLost`]. The caller has dropped the
    /// swapchain.
    fn renew_surface(&self) -> Result<(), BackendError>;
}

/// The bindings of one plan's passes.
pub trait Bindings<G: Gpu>: Sized + Send + Sync {
    /// Creates the bindings of all dispatches and draws, without writing them; see [`binding_copies`].
    fn new(gpu: &Arc<G>, plan: &Plan, pipelines: &G::Pipelines) -> Result<Self, BackendError>;

    /// Writes one binding in one copy of a pass's bindings. No frame in flight may use this copy.
    fn write(&mut self, gpu: &G, pass: PassId, copy: usize, binding: &Binding, target: BindingTarget<G>);

    /// Releases the references that the pass's bindings hold, if they hold any. The pass does not run again.
    fn clear(&mut self, _pass: PassId) {}
}

/// A window's swapchain. The device must be idle when it is dropped.
pub trait Swapchain<G: Gpu>: Sized + Send + 'static {
    /// Creates a swapchain of `size` pixels for the device's window, replacing `former`. The device must be idle.
    fn new(gpu: &Arc<G>, size: (u32, u32), vsync: bool, former: Option<&Self>) -> Result<Self, BackendError>;

    /// Acquires an image for the frame in `slot`. The slot's previous frame must have completed. Blocks until the
    /// window has an image, for at most two seconds.
    fn acquire(&mut self, slot: usize) -> Result<Acquired, BackendError>;

    /// Records the blit of the output of the frame in `slot` into an acquired image, scaled to the image's size. Later
    /// work that waits for the plan's export also waits for the blit.
    fn record_blit(
        &mut self,
        image: u32,
        slot: usize,
        output: &Image<G>,
        plan: &Plan,
        synchronization: &G::Synchronization,
    ) -> Result<(), BackendError>;

    /// Presents an image whose blit was submitted.
    fn present(&mut self, image: u32) -> Result<Presented, BackendError>;
}

/// The pipeline about to be created, for progress and errors; see [`crate::PipelineStates::next`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NextPipeline {
    /// Number of pipelines before this one, all of which exist: the index of this one.
    pub done: usize,
    /// Total pipelines of the plan.
    pub of: usize,
    /// The pass's shader; for a draw, the vertex shader.
    pub shader: ShaderId,
    /// The first pass that uses the pipeline.
    pub pass: PassId,
}

/// The swapchain image in which a frame is presented.
pub struct Show<'a, G: Gpu> {
    /// Swapchain of the window.
    pub swapchain: &'a mut G::Swapchain,
    /// The index of the acquired image.
    pub image: u32,
    /// The slot of the frame.
    pub slot: usize,
}

/// The outcome of [`Swapchain::acquire`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acquired {
    /// An image was acquired.
    Image {
        /// Index of the image in the swapchain.
        index: u32,
        /// True if the swapchain no longer matches the surface exactly.
        suboptimal: bool,
    },
    /// The swapchain is out of date.
    OutOfDate,
    /// The window gave no image within the time limit.
    NotReady,
}

/// The outcome of [`Swapchain::present`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presented {
    /// The image is shown.
    Shown,
    /// The image is shown, but the swapchain no longer matches the surface exactly.
    Suboptimal,
    /// The swapchain is out of date.
    OutOfDate,
}

/// Device memory, mapped or not.
///
/// The host and the device never access mapped bytes at once. The host reads [`Location::Readback`] only after
/// [`Encoder::wait`] returned true for the last submission that writes the memory, and the next such submission follows
/// only once the slice is dropped. It writes [`Location::Upload`] and [`Location::Staging`] only while no submission
/// that reads the memory runs.
pub trait Memory<G: Gpu>: Sized + Send + Sync + 'static {
    /// Allocates memory for an object; `name` names it in errors.
    fn allocate(
        gpu: &Arc<G>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Self, BackendError>;

    /// Returns the size in bytes.
    fn bytes(&self) -> u64;

    /// Returns the mapped bytes; empty if the memory is not mapped.
    fn mapped(&self) -> &[u8];

    /// Returns the mapped bytes for writing; empty if the memory is not mapped.
    fn mapped_mut(&mut self) -> &mut [u8];
}

/// The kind of memory, by its readers and writers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// Device memory that only the device accesses.
    Device,
    /// Mapped memory that the host writes and the device reads.
    Upload,
    /// Mapped host memory that the host writes and a copy reads.
    Staging,
    /// Host memory that only the device accesses, used if device memory has no room.
    Host,
    /// Mapped memory that the device writes and the host reads.
    Readback,
}

/// The memory requirements of an object, or of several that share memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Requirements {
    /// Size, in bytes.
    pub size: u64,
    /// Alignment, in bytes; a power of two.
    pub alignment: u64,
    /// A bit for each suitable memory type.
    pub types: u32,
    /// The kind of allocation.
    pub kind: MemoryKind,
}

/// The kind of an allocation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MemoryKind {
    /// For buffers. Allocators keep them apart from images.
    Linear,
    /// For images, or for images and buffers.
    Optimal,
    /// For a single buffer, as the driver requires: the API's handle of it.
    DedicatedBuffer(u64),
    /// For a single image, as the driver requires: the API's handle of it.
    DedicatedImage(u64),
}

/// A buffer to create.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BufferDesc<'a> {
    /// Name in captures and errors.
    pub name: &'a str,
    /// The size, at least one byte.
    pub bytes: u64,
    /// All uses of the buffer.
    pub usage: Usage,
}

/// An image to create: two-dimensional, with one mip level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageDesc<'a> {
    /// Name in captures and errors.
    pub name: &'a str,
    /// The format of the image's pixels.
    pub format: Format,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// All uses of the image.
    pub usage: Usage,
}

/// The image uses that a device supports for one format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FormatSupport {
    /// True if images can be storage images.
    pub storage: bool,
    /// True if images can be colour targets or, for a depth format, depth targets.
    pub target: bool,
    /// True if images can be colour targets of draws that blend.
    pub blend: bool,
    /// True if images can be the source of blits to a window.
    pub blit: bool,
}

/// A buffer with its memory.
pub struct Buffer<G: Gpu> {
    /// The API's object.
    pub raw: G::Buffer,
    /// Size, in bytes.
    pub bytes: u64,
    /// Uses that the buffer was created for.
    pub usage: Usage,
    // Dropped after the buffer.
    pub(crate) memory: Arc<G::Memory>,
}

impl<G: Gpu> Buffer<G> {
    /// Creates a buffer with its own memory.
    pub(crate) fn new(gpu: &Arc<G>, desc: &BufferDesc, location: Location) -> Result<Self, BackendError> {
        let (unbound, requirements) = gpu.create_buffer(desc)?;
        let memory = G::Memory::allocate(gpu, desc.name, &requirements, location)?;
        Self::bind(gpu, desc, unbound, Arc::new(memory))
    }

    pub(crate) fn bind(
        gpu: &Arc<G>,
        desc: &BufferDesc,
        unbound: G::UnboundBuffer,
        memory: Arc<G::Memory>,
    ) -> Result<Self, BackendError> {
        let raw = gpu.bind_buffer(desc, unbound, &memory)?;
        Ok(Buffer { raw, bytes: desc.bytes, usage: desc.usage, memory })
    }

    /// Creates a mapped buffer that copies write and the host reads.
    ///
    /// # Errors
    /// The buffer exceeds the device's largest, or there is no memory for it.
    pub(crate) fn to_host(gpu: &Arc<G>, name: &str, bytes: u64) -> Result<Self, BackendError> {
        within_bytes(|| format!("the size of buffer `{name}`"), bytes, gpu.common().limits.max_buffer_bytes)?;
        Self::new(gpu, &BufferDesc { name, bytes, usage: Usage::COPY_TARGET }, Location::Readback)
    }

    /// Returns the mapped bytes; empty if the memory is not mapped.
    pub(crate) fn mapped(&self) -> &[u8] {
        let slice = self.memory.mapped();
        &slice[..slice.len().min(self.bytes as usize)]
    }

    /// Returns the mapped bytes for writing; empty if the memory is not mapped or is shared with other objects.
    pub(crate) fn mapped_mut(&mut self) -> &mut [u8] {
        let slice = Arc::get_mut(&mut self.memory).map(G::Memory::mapped_mut).unwrap_or_default();
        let end = slice.len().min(self.bytes as usize);
        &mut slice[..end]
    }
}

/// An image with its memory.
pub struct Image<G: Gpu> {
    /// The API's object.
    pub raw: G::Image,
    /// The format of the image's pixels.
    pub format: Format,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Uses that the image was created for.
    pub usage: Usage,
    // Dropped after the image.
    pub(crate) memory: Arc<G::Memory>,
}

impl<G: Gpu> Image<G> {
    pub(crate) fn bind(
        gpu: &Arc<G>,
        desc: &ImageDesc,
        unbound: G::UnboundImage,
        memory: Arc<G::Memory>,
    ) -> Result<Self, BackendError> {
        let raw = gpu.bind_image(desc, unbound, &memory)?;
        Ok(Image { raw, format: desc.format, size: desc.size, usage: desc.usage, memory })
    }

    /// Returns the size of the image's pixels in bytes, rows tightly packed.
    pub fn bytes(&self) -> u64 {
        self.format.bytes_per_pixel() as u64 * self.size.0 as u64 * self.size.1 as u64
    }
}

/// The object that a binding refers to.
pub enum BindingTarget<'a, G: Gpu> {
    /// A range of bytes of a buffer.
    Buffer(&'a Buffer<G>, Range<u64>),
    /// A whole image, as a storage image.
    Image(&'a Image<G>),
}

/// Returns the number of copies of a pass's bindings. There is one, or one per frame in flight if a bound object
/// differs between frames.
pub fn binding_copies(plan: &Plan, pass: &Pass) -> usize {
    let per_frame = pass.bindings.iter().any(|b| plan.resource(b.resource).source.is_per_frame());
    if per_frame { splatgraph_api::FRAMES_IN_FLIGHT } else { 1 }
}

/// A layout change that the runtime adds, outside the plan.
pub struct ImageLayout<'a, G: Gpu> {
    /// The image, whose contents are kept unless `old` is [`Layout::Undefined`].
    pub image: &'a Image<G>,
    /// The current layout.
    pub old: Layout,
    /// The new layout.
    pub new: Layout,
}

/// A draw's vertex and instance counts.
pub enum Draw<'a, G: Gpu> {
    /// The host knows the counts.
    Direct {
        /// Number of vertices per instance.
        vertices: u32,
        /// Number of instances.
        instances: u32,
    },
    /// The counts are on the device: the four words of an indirect draw, at a byte offset of a buffer.
    Indirect(&'a Buffer<G>, u64),
}

/// A recorder of commands that are submitted together and can be waited for.
///
/// It is reused: [`begin`](Encoder::begin), commands, [`end`](Encoder::end), [`submit`](Encoder::submit),
/// [`wait`](Encoder::wait). The caller guarantees what the plan's checks establish: ranges lie within their buffers,
/// objects were created for their uses, and images are in the layout of their use.
pub trait Encoder<G: Gpu>: Sized + Send + 'static {
    /// Creates an encoder; `name` appears in GPU captures.
    fn new(gpu: &Arc<G>, name: &str) -> Result<Self, BackendError>;

    /// Begins recording and discards earlier commands. The last submission must have completed.
    fn begin(&mut self) -> Result<(), BackendError>;

    /// Ends recording.
    fn end(&mut self) -> Result<(), BackendError>;

    /// Submits the commands, followed by the blit to the swapchain image `show`, if any.
    fn submit(&mut self, show: Option<Show<G>>) -> Result<(), BackendError>;

    /// Blocks until the last submission, including the blit, has completed; the encoder can then be reused. Returns
    /// false once `limit` has passed.
    fn wait(&mut self, limit: Duration) -> Result<bool, BackendError>;

    /// Announces the pass that the next commands belong to, even if it records none. If `timed`, timestamps are written
    /// before and after them. APIs with separate encoders choose the pass's encoder here.
    fn pass(&mut self, _pipelines: &G::Pipelines, _id: PassId, _timed: bool) {}

    /// Opens a debug label around the next commands.
    fn push_label(&mut self, name: Arguments);

    /// Closes the label opened last.
    fn pop_label(&mut self);

    /// Records the barriers before a pass, or (`None`) between the prologue and the first frame.
    ///
    /// `image` finds the image of a layout change. It returns `None` if the change does not apply in this frame; only
    /// the execution dependency remains.
    fn synchronize<'a>(
        &mut self,
        synchronization: &G::Synchronization,
        at: Option<PassId>,
        image: impl Fn(ResourceId) -> Option<&'a Image<G>>,
    );

    /// Records a full memory barrier between all earlier commands and submissions and all later commands, with layout
    /// changes.
    fn full_barrier<'a>(&mut self, changes: impl Iterator<Item = ImageLayout<'a, G>>);

    /// Makes copies into a byte range of a buffer visible to all later submissions.
    fn after_copy(&mut self, target: &Buffer<G>, range: Range<u64>);

    /// Makes all copies visible to the host, once it has waited for the submission.
    fn copies_to_host(&mut self);

    /// Binds a pass's pipeline, its bindings for the frame in `slot`, and its push constants. Does nothing for a pass
    /// without a pipeline.
    fn bind(
        &mut self,
        pipelines: &G::Pipelines,
        bindings: &G::Bindings,
        id: PassId,
        pass: &Pass,
        slot: usize,
    );

    /// Dispatches `groups` workgroups in x, y and z.
    fn dispatch(&mut self, groups: [u32; 3]);

    /// Dispatches workgroups. Their counts in x, y and z are three words at a byte offset of a buffer.
    fn dispatch_indirect(&mut self, arguments: &Buffer<G>, offset: u64);

    /// Draws into `targets`, all of one size, with an optional depth attachment.
    fn draw<'a>(
        &mut self,
        targets: impl Iterator<Item = (&'a Target, &'a Image<G>)>,
        depth: Option<(DepthAccess, &'a Image<G>)>,
        draw: Draw<G>,
    );

    /// Fills a whole buffer with a 32-bit word.
    fn fill(&mut self, buffer: &Buffer<G>, value: u32);

    /// Fills an image in [`Layout::TransferTarget`] with zeros. The API must be able to clear images in this layout.
    /// [`full_barrier`](Encoder::full_barrier) also moves the images of continued histories into it.
    fn clear(&mut self, image: &Image<G>);

    /// Copies bytes from one buffer to another.
    fn copy_buffer(&mut self, source: (&Buffer<G>, u64), target: (&Buffer<G>, u64), bytes: u64);

    /// Copies an image in [`Layout::TransferSource`] to the start of a buffer, rows tightly packed.
    fn copy_image(&mut self, image: &Image<G>, target: &Buffer<G>);

    /// Copies an image in [`Layout::TransferSource`] to one of equal format and size in [`Layout::TransferTarget`].
    fn copy_to_image(&mut self, image: &Image<G>, target: &Image<G>);

    /// Resets the first `count` timestamps.
    fn reset_timestamps(&mut self, timestamps: &G::Timestamps, count: u32);

    /// Writes a timestamp once all earlier commands have completed. APIs with separate encoders may instead sample the
    /// start and the end of the pass's encoder.
    fn timestamp(&mut self, timestamps: &G::Timestamps, index: u32);
}
