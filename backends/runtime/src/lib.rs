//! Executes plans on any graphics API: the part of a backend that is the same for all of them.
//!
//! [`Executor`] implements [`splatgraph_api::Device`] on top of [`Gpu`], the small trait that a graphics API implements. A plan's way
//! through the crate:
//!
//! 1. `check` checks it against itself and against the device's `limits`;
//! 2. `pipelines` lets the driver compile them, on a thread that can be given up;
//!    `resources` (with `aliasing`, `attributes`, `once` and `host_buffers`), `bindings` and `upload` create what it needs, which together is
//!    a `compiled` plan; a `loader` does all this on any thread;
//!    What another plan has computed once is taken over (`results`);
//! 3. the plan becomes the current one of an `executor`, and continues from the `history` of the one before;
//! 4. `record` records a frame of it, step by step, and `frame` submits it and reads the results back; `window` shows its output, and
//!    `outputs` shares it with other executors;
//! 5. `watch` knows which pass the device runs, so that every wait for it has an end.
//!
//! The crate decides nothing about order. A backend lowers a plan's dependencies to commands of its API when the plan is loaded; `record`
//! passes these back to it pass by pass, and adds barriers only for the crate's own work (uploads, readback, inspection, shared outputs,
//! the change from one plan to the next).
//!
//! Ownership runs one way: an executor holds the state that executors of one device share, that holds the device, and objects hold
//! the device that they were made from.

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
mod messages;
mod once;
mod outputs;
mod pipelines;
mod record;
mod resources;
mod results;
mod shared;
#[cfg(test)]
mod testing;
mod timing;
mod upload;
mod usage;
mod watch;
mod window;

pub use devices::choose;
pub use executor::Executor;
pub use gpu::{
    Acquired, BindingTarget, Buffer, BufferDesc, COMPILE_PATIENCE, Draw, Encoder, FormatSupport, Gpu, Image,
    ImageDesc, ImageLayout, Location, Memory, MemoryKind, NextPipeline, Presented, Requirements, Show,
    Window, binding_copies,
};
pub use limits::{Limits, SubgroupLimits};
pub use loader::{Loader, Ready};
pub use messages::Messages;
pub use pipelines::compilers_given_up;
