//! Executes plans on any graphics API: the part of a backend that all APIs share.
//!
//! [`Executor`] implements [`splatgraph_api::Device`] on top of [`Gpu`], the small trait that a graphics API
//! implements. A plan passes through the crate in these steps:
//!
//! 1. `check` checks its consistency, and that it respects the device's `limits`.
//! 2. `states` lists its pipelines, and `pipelines` compiles them on a thread that can be abandoned. `resources` (with
//!    `aliasing`, `attributes`, `once` and `host_buffers`), `bindings` and `upload` create the rest of a `compiled`
//!    plan. `results` reuses prologue results of other plans. A `loader` does all this on any thread.
//! 3. The plan becomes the current one of an `executor`, and continues from the `history` of the previous one.
//! 4. `record` records a frame, `frame` submits it and reads its results back, `window` presents its output, and
//!    `outputs` shares it with other executors.
//! 5. `watch` tracks which pass the device runs, and a `stopwatch` for how long, so that every wait is bounded.
//!
//! The crate does not order passes. A backend lowers a plan's dependencies to commands of its API when the plan is
//! loaded, and `record` asks for them pass by pass. The crate adds barriers only for its own work: uploads, readback,
//! inspection, shared outputs, and the change from one plan to the next.
//!
//! Ownership runs one way: an executor holds the state that all executors of a device share, the shared state holds the
//! device, and every object holds its device.

#![deny(missing_docs)]

mod aliasing;
mod attributes;
mod bindings;
mod check;
mod compiled;
mod devices;
mod executor;
mod frame;
mod gpu;
mod history;
mod host_buffers;
mod inputs;
mod inspect;
mod limits;
mod loader;
mod lock;
mod messages;
mod once;
mod outputs;
mod pipelines;
mod record;
mod resources;
mod results;
mod shared;
mod states;
mod stopwatch;
#[cfg(test)]
mod testing;
mod timing;
mod upload;
mod usage;
mod watch;
mod window;

pub use check::too_large;
pub use devices::choose;
pub use executor::Executor;
pub use gpu::{
    Acquired, BindingTarget, Bindings, Buffer, BufferDesc, Common, Draw, Encoder, FormatSupport, Gpu, Image,
    ImageDesc, ImageLayout, Location, Memory, MemoryKind, NextPipeline, Presented, Requirements, Show,
    Swapchain, Window, binding_copies,
};
pub use limits::{Limits, SubgroupLimits};
pub use loader::{Loader, Ready};
pub use lock::lock;
pub use messages::Messages;
pub use pipelines::abandoned_compilers;
pub use states::{BlendFactor, BlendFactors, PipelineState, PipelineStates};
