//! The trait that a graphics API implements, and the objects that it makes.
//!
//! [`Gpu`] is an opened device. It creates objects, submits the commands that an [`Encoder`] recorded, and shows images in a
//! window. Everything above it (which objects a plan needs, which frames are in flight, what continues from one plan to the next)
//! is decided in this crate and is the same for every API.
//!
//! Ownership runs one way: an executor holds the device, and every object holds the device that it was made from, by an
//! [`Arc`]. The executor drops an object only when no frame in flight uses it.
//!
//! An implementation orders passes by commands that it makes of the plan's dependencies, once per plan. Vulkan's are
//! [`Gpu::Synchronization`], which [`Encoder::synchronize`] records pass by pass. Metal's belong to encoders with fences of the device,
//! which come with its pipelines: it learns from [`Encoder::pass`] where it stands. Bindings are written one by one, to descriptor sets or to
//! argument tables. An encoder carries the means to wait for its own completion, a fence or a shared event.

use crate::limits::Limits;
use crate::messages::Messages;
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options};
use splatgraph_framework::{ir::*, plan::*};
use std::fmt::{Arguments, Debug};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// The longest time that the driver may take over one pipeline where the program does not say: some take seconds.
pub const COMPILE_PATIENCE: Duration = Duration::from_secs(60);

/// A window that a swapchain can be made for.
pub trait Window: HasDisplayHandle + HasWindowHandle + Send + Sync {}

impl<W: HasDisplayHandle + HasWindowHandle + Send + Sync> Window for W {}

/// An opened device of one graphics API.
///
/// It can be used from several threads at a time: executors submit to its one queue in turn, and plans are made ready on
/// threads of their own.
pub trait Gpu: Sized + Send + Sync + 'static {
    /// A piece of device memory, freed when it is dropped.
    type Memory: Memory;
    /// Names the object that an allocation is dedicated to.
    type Dedicated: Copy + Debug + PartialEq;
    /// A buffer without memory.
    type UnboundBuffer;
    /// An image without memory.
    type UnboundImage;
    /// A buffer, without the memory that [`Buffer`] holds for it.
    type Buffer: Send + Sync;
    /// An image with a view of it, without the memory that [`Image`] holds for it.
    type Image: Send + Sync;
    /// What orders the passes of one plan: the commands that its dependencies are lowered to.
    type Synchronization: Send + Sync;
    /// The pipelines of one plan.
    type Pipelines: Send + Sync;
    /// The bindings of one plan's passes: descriptor sets or argument tables.
    type Bindings: Send + Sync;
    /// A set of timestamps that commands write.
    type Timestamps: Send + Sync;
    /// A recorder of commands.
    type Encoder: Encoder<Self> + 'static;
    /// The images of a window. The device must be idle when it is dropped.
    type Swapchain: Send + 'static;

    /// Lists the machine's devices.
    fn devices() -> Result<Vec<DeviceInfo>, BackendError>;

    /// Opens the device that `options` choose; with a window, only one that can draw in it is fit.
    fn open(
        options: &Options,
        window: Option<Arc<dyn Window>>,
    ) -> Result<(DeviceInfo, Arc<Self>), BackendError>;

    /// Returns the device's limits.
    fn limits(&self) -> &Limits;

    /// Returns the collected validation messages, which may outlive the device.
    fn messages(&self) -> &Arc<Messages>;

    /// Reports the memory of the whole device.
    fn memory(&self) -> DeviceMemory;

    /// Returns the bytes that can still be allocated of the largest heap of the device's own memory, as the driver estimates now;
    /// none where it does not say.
    fn available(&self) -> Option<u64>;

    /// Says for what the device supports images of a format.
    fn format_support(&self, format: Format) -> FormatSupport;

    /// Returns the longest time that one pass may run before calls that wait for it give up.
    fn patience(&self) -> Duration;

    /// Returns the longest time that the driver may take over one pipeline before it is given up.
    fn compile_patience(&self) -> Duration;

    /// Blocks until the device has finished all submitted work, as a lost device has, or until the time is over. Returns true in
    /// the first case. Others can submit meanwhile.
    fn wait_idle(&self, limit: Duration) -> bool;

    /// Creates a buffer without memory, and says what memory it needs.
    fn create_buffer(
        self: &Arc<Self>,
        desc: &BufferDesc,
    ) -> Result<(Self::UnboundBuffer, Requirements<Self::Dedicated>), BackendError>;

    /// Creates an image without memory, and says what memory it needs. The format supports the usage.
    fn create_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
    ) -> Result<(Self::UnboundImage, Requirements<Self::Dedicated>), BackendError>;

    /// Allocates memory. An error names `name` and the size.
    fn allocate(
        self: &Arc<Self>,
        name: &str,
        requirements: &Requirements<Self::Dedicated>,
        location: Location,
    ) -> Result<Self::Memory, BackendError>;

    /// Binds a buffer to the start of memory that meets its requirements.
    fn bind_buffer(
        self: &Arc<Self>,
        buffer: Self::UnboundBuffer,
        memory: &Self::Memory,
    ) -> Result<Self::Buffer, BackendError>;

    /// Binds an image to the start of memory that meets its requirements.
    fn bind_image(
        self: &Arc<Self>,
        image: Self::UnboundImage,
        memory: &Self::Memory,
    ) -> Result<Self::Image, BackendError>;

    /// Lowers the dependencies of a checked plan.
    fn synchronization(plan: &Plan) -> Result<Self::Synchronization, BackendError>;

    /// Creates the pipelines of all dispatches and draws of a checked plan, announcing each before it is made.
    ///
    /// An error of `next` ends it there.
    ///
    /// Called on a thread that nobody may wait for any more when it returns.
    fn create_pipelines(
        self: &Arc<Self>,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Self::Pipelines, BackendError>;

    /// Creates the bindings of all passes that run: [`binding_copies`] for each that binds anything. They are not written.
    fn create_bindings(
        self: &Arc<Self>,
        plan: &Plan,
        pipelines: &Self::Pipelines,
    ) -> Result<Self::Bindings, BackendError>;

    /// Writes one binding of one copy of a pass's bindings, which no frame in flight uses.
    fn write_binding(
        &self,
        bindings: &mut Self::Bindings,
        pass: PassId,
        copy: usize,
        binding: &Binding,
        target: BindingTarget<Self>,
    );

    /// Lets go of what a pass's bindings hold: the pass does not run again, and what it bound is freed.
    fn clear_bindings(&self, _bindings: &mut Self::Bindings, _pass: PassId) {}

    /// Creates `count` timestamps; none where the queue has no timer.
    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Self::Timestamps>, BackendError>;

    /// Reads the first `count` timestamps in ticks; none for each that was not written yet.
    fn read_timestamps(
        &self,
        timestamps: &Self::Timestamps,
        count: u32,
    ) -> Result<Vec<Option<u64>>, BackendError>;

    /// Creates an encoder; `name` appears in captures.
    fn create_encoder(self: &Arc<Self>, name: &str) -> Result<Self::Encoder, BackendError>;

    /// Submits the recorded commands of an encoder, and after them the blit to a swapchain's image, if one is named.
    fn submit(&self, encoder: &mut Self::Encoder, show: Option<Show<Self>>) -> Result<(), BackendError>;

    /// Blocks until the last submission of an encoder has completed, its blit included, or until the time is over. Returns true in
    /// the first case, after which the encoder has no submission.
    fn wait(&self, encoder: &mut Self::Encoder, limit: Duration) -> Result<bool, BackendError>;

    /// Returns the size in pixels of the window's images, given the size that the program was told; none while the window shows
    /// nothing.
    fn window_size(&self, told: (u32, u32)) -> Result<Option<(u32, u32)>, BackendError>;

    /// Makes the surface of the window anew. Its swapchain is gone.
    ///
    /// Calls that find the surface lost, of this and of swapchains, answer [`BackendError::SurfaceLost`].
    fn renew_surface(&self) -> Result<(), BackendError>;

    /// Creates a swapchain for the window that the device was opened with. The device is idle, and `former` is not used again.
    fn create_swapchain(
        self: &Arc<Self>,
        size: (u32, u32),
        vsync: bool,
        former: Option<&Self::Swapchain>,
    ) -> Result<Self::Swapchain, BackendError>;

    /// Acquires an image for the frame in `slot`, whose former frame is done. Blocks until the window has one, for two seconds
    /// at most.
    fn acquire(&self, swapchain: &mut Self::Swapchain, slot: usize) -> Result<Acquired, BackendError>;

    /// Records the blit of a frame's output into an acquired image, scaled to its size. Whatever waits for the copies of the plan's
    /// export waits for the blit as well.
    fn record_blit(
        &self,
        show: Show<Self>,
        output: &Image<Self>,
        plan: &Plan,
        synchronization: &Self::Synchronization,
    ) -> Result<(), BackendError>;

    /// Presents an image whose blit was submitted.
    fn present(&self, show: Show<Self>) -> Result<Presented, BackendError>;
}

/// The pipeline that is made next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NextPipeline {
    /// Pipelines that were made.
    pub done: usize,
    /// Pipelines of the plan.
    pub of: usize,
    /// Its shader; of a draw, that of the vertices.
    pub shader: ShaderId,
    /// The first pass that it is for.
    pub pass: PassId,
}

impl NextPipeline {
    /// Describes the next pipeline of a lowered plan, whose passes have the pipelines `of_pass`.
    ///
    /// # Panics
    /// No pass has the pipeline `done`.
    pub fn new(of_pass: &[Option<usize>], done: usize, of: usize, shader: ShaderId) -> NextPipeline {
        let pass = of_pass.iter().position(|pipeline| *pipeline == Some(done));
        NextPipeline { done, of, shader, pass: PassId(pass.expect("each pipeline is that of a pass") as u32) }
    }
}

/// A swapchain's image that the frame in a slot is shown in.
pub struct Show<'a, G: Gpu> {
    /// The swapchain.
    pub swapchain: &'a mut G::Swapchain,
    /// The index of the acquired image.
    pub image: u32,
    /// The slot of the frame.
    pub slot: usize,
}

/// The outcome of [`Gpu::acquire`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acquired {
    /// An image was acquired.
    Image {
        /// Its index in the swapchain.
        index: u32,
        /// Another swapchain would fit the window better.
        suboptimal: bool,
    },
    /// The swapchain does not fit the window any more.
    OutOfDate,
    /// The window gave no image in time.
    NotReady,
}

/// The outcome of [`Gpu::present`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presented {
    /// The image is shown.
    Shown,
    /// The image is shown, and another swapchain would fit the window better.
    Suboptimal,
    /// The swapchain does not fit the window any more.
    OutOfDate,
}

/// Device memory, mapped or not.
pub trait Memory: Send + Sync + 'static {
    /// Returns the size in bytes.
    fn bytes(&self) -> u64;

    /// Returns the host's view, empty where the memory is not mapped.
    fn mapped(&self) -> &[u8];

    /// Returns the host's view for writing, empty where the memory is not mapped.
    fn mapped_mut(&mut self) -> &mut [u8];
}

/// The readers and writers of a piece of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// The device alone.
    Device,
    /// The host writes, the device reads.
    Upload,
    /// The device alone, in the host's memory, where its own has no room.
    Host,
    /// The device writes, the host reads.
    Readback,
}

/// The memory that an object, or several that share it, need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Requirements<D> {
    /// Bytes.
    pub size: u64,
    /// Bytes, a power of two.
    pub alignment: u64,
    /// A bit for each memory type that fits.
    pub types: u32,
    /// The kind of allocation.
    pub kind: MemoryKind<D>,
}

/// The kind of an allocation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MemoryKind<D> {
    /// For buffers, which allocators keep apart from images.
    Linear,
    /// For images, or for images and buffers.
    Optimal,
    /// For one object alone, as its driver demands.
    Dedicated(D),
}

/// A buffer to create.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BufferDesc<'a> {
    /// Appears in captures and errors.
    pub name: &'a str,
    /// The size, not 0.
    pub bytes: u64,
    /// Every use of it.
    pub usage: Usage,
}

/// A two-dimensional image with one mip level to create.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageDesc<'a> {
    /// Appears in captures and errors.
    pub name: &'a str,
    /// The format of its pixels.
    pub format: Format,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Every use of it.
    pub usage: Usage,
}

/// The uses that a device supports for images of one format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FormatSupport {
    /// Storage images.
    pub storage: bool,
    /// Colour targets.
    pub target: bool,
    /// Colour targets of draws that blend.
    pub blend: bool,
    /// Sources of blits to a window.
    pub blit: bool,
}

/// A buffer with its memory.
pub struct Buffer<G: Gpu> {
    /// The API's object.
    pub raw: G::Buffer,
    /// The size.
    pub bytes: u64,
    /// Every use that it was made for.
    pub usage: Usage,
    // Dropped after the buffer.
    pub(crate) memory: Arc<G::Memory>,
}

impl<G: Gpu> Buffer<G> {
    /// Creates a buffer with its own memory.
    pub(crate) fn new(gpu: &Arc<G>, desc: &BufferDesc, location: Location) -> Result<Self, BackendError> {
        let (unbound, requirements) = gpu.create_buffer(desc)?;
        let memory = gpu.allocate(desc.name, &requirements, location)?;
        Self::bind(gpu, desc, unbound, Arc::new(memory))
    }

    pub(crate) fn bind(
        gpu: &Arc<G>,
        desc: &BufferDesc,
        unbound: G::UnboundBuffer,
        memory: Arc<G::Memory>,
    ) -> Result<Self, BackendError> {
        let raw = gpu.bind_buffer(unbound, &memory)?;
        Ok(Buffer { raw, bytes: desc.bytes, usage: desc.usage, memory })
    }

    /// Creates a buffer for copies that the host reads.
    pub(crate) fn to_host(gpu: &Arc<G>, name: &str, bytes: u64) -> Result<Self, BackendError> {
        Self::new(gpu, &BufferDesc { name, bytes, usage: Usage::COPY_TARGET }, Location::Readback)
    }

    /// Returns the host's view, empty where the memory is not mapped.
    pub(crate) fn mapped(&self) -> &[u8] {
        let slice = self.memory.mapped();
        &slice[..slice.len().min(self.bytes as usize)]
    }

    /// Returns the host's view for writing, empty where the memory is not mapped or is shared with other objects.
    pub(crate) fn mapped_mut(&mut self) -> &mut [u8] {
        let slice = Arc::get_mut(&mut self.memory).map(Memory::mapped_mut).unwrap_or_default();
        let end = slice.len().min(self.bytes as usize);
        &mut slice[..end]
    }
}

/// An image with its memory.
pub struct Image<G: Gpu> {
    /// The API's object.
    pub raw: G::Image,
    /// The format of its pixels.
    pub format: Format,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Every use that it was made for.
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
        let raw = gpu.bind_image(unbound, &memory)?;
        Ok(Image { raw, format: desc.format, size: desc.size, usage: desc.usage, memory })
    }

    /// Returns the bytes of its pixels, rows tightly packed.
    pub fn bytes(&self) -> u64 {
        self.format.bytes_per_pixel() as u64 * self.size.0 as u64 * self.size.1 as u64
    }
}

/// The object that a binding points to.
pub enum BindingTarget<'a, G: Gpu> {
    /// A range of bytes of a buffer.
    Buffer(&'a Buffer<G>, Range<u64>),
    /// A whole image, as a storage image.
    Image(&'a Image<G>),
}

/// Returns how many copies of a pass's bindings a plan needs: one per frame in flight where a binding differs between them.
pub fn binding_copies(plan: &Plan, pass: &Pass) -> usize {
    let per_frame = pass.bindings.iter().any(|b| plan.resource(b.resource).source.is_per_frame());
    if per_frame { splatgraph_api::FRAMES_IN_FLIGHT } else { 1 }
}

/// A change of an image's layout outside of the plan's own.
pub struct ImageLayout<'a, G: Gpu> {
    /// The image, whose contents are kept unless `old` is [`Layout::Undefined`].
    pub image: &'a Image<G>,
    /// The layout that it is in.
    pub old: Layout,
    /// The layout that it is brought into.
    pub new: Layout,
}

/// A draw's vertex and instance counts.
pub enum Draw<'a, G: Gpu> {
    /// Known to the host.
    Direct {
        /// Vertices of each instance.
        vertices: u32,
        /// Instances.
        instances: u32,
    },
    /// Four words at a byte offset of a buffer.
    Indirect(&'a Buffer<G>, u64),
}

/// A recorder of commands that are submitted together, and can be waited for.
///
/// It is used again and again: [`begin`](Encoder::begin), commands, [`end`](Encoder::end), [`Gpu::submit`], [`Gpu::wait`]. The
/// caller promises what the plan's checks establish: buffers hold the ranges that are named, objects allow the use made of
/// them, and images are in the layout of that use.
pub trait Encoder<G: Gpu>: Send {
    /// Starts to record; what was recorded before is gone. The last submission has completed.
    fn begin(&mut self) -> Result<(), BackendError>;

    /// Ends the recording.
    fn end(&mut self) -> Result<(), BackendError>;

    /// Announces the pass whose commands follow, if it runs any. With `timed`, timestamps stand before and after them.
    ///
    /// An API whose commands belong to encoders of their own learns here where the pass stands.
    fn pass(&mut self, _pipelines: &G::Pipelines, _id: PassId, _timed: bool) {}

    /// Opens a label around the next commands, for captures and messages.
    fn push_label(&mut self, name: Arguments);

    /// Closes the label opened last.
    fn pop_label(&mut self);

    /// Records what a pass waits for, or (`None`) the handover between the prologue and the first frame.
    ///
    /// `image` finds the image of a layout change of the plan. It finds none where the change does not apply in this frame: only its
    /// order remains.
    fn synchronize<'a>(
        &mut self,
        synchronization: &G::Synchronization,
        at: Option<PassId>,
        image: impl Fn(ResourceId) -> Option<&'a Image<G>>,
    );

    /// Records a barrier from everything before to everything after, on all memory, with changes of layouts.
    fn full_barrier<'a>(&mut self, changes: impl Iterator<Item = ImageLayout<'a, G>>);

    /// Orders copies into a buffer after everything submitted before.
    fn before_copy(&mut self, target: &Buffer<G>);

    /// Makes copies into a range of bytes of a buffer visible to everything submitted later.
    fn after_copy(&mut self, target: &Buffer<G>, range: Range<u64>);

    /// Makes all copies visible to the host, once it has waited for the submission.
    fn copies_to_host(&mut self);

    /// Binds a pass's pipeline, its bindings for the frame in `slot`, and its push constants. Nothing for a pass without a
    /// pipeline.
    fn bind(
        &mut self,
        pipelines: &G::Pipelines,
        bindings: &G::Bindings,
        id: PassId,
        pass: &Pass,
        slot: usize,
    );

    /// Dispatches workgroups in x, y and z.
    fn dispatch(&mut self, groups: [u32; 3]);

    /// Dispatches as many workgroups as three words at a byte offset of a buffer say.
    fn dispatch_indirect(&mut self, arguments: &Buffer<G>, offset: u64);

    /// Draws into targets of one size.
    fn draw<'a>(&mut self, targets: impl Iterator<Item = (&'a Target, &'a Image<G>)>, draw: Draw<G>);

    /// Writes a word to all of a buffer.
    fn fill(&mut self, buffer: &Buffer<G>, value: u32);

    /// Writes zeros to all of an image, which is in [`Layout::TransferTarget`].
    fn clear(&mut self, image: &Image<G>);

    /// Copies bytes from one buffer to another.
    fn copy_buffer(&mut self, source: (&Buffer<G>, u64), target: (&Buffer<G>, u64), bytes: u64);

    /// Copies an image, which is in [`Layout::TransferSource`], to the start of a buffer, rows tightly packed.
    fn copy_image(&mut self, image: &Image<G>, target: &Buffer<G>);

    /// Resets the first `count` timestamps.
    fn reset_timestamps(&mut self, timestamps: &G::Timestamps, count: u32);

    /// Writes a timestamp once everything before it has completed.
    fn timestamp(&mut self, timestamps: &G::Timestamps, index: u32);
}
