//! Records every call of the runtime, and executes nothing.
//!
//! [`Null`] runs plans through the runtime that every other backend uses, in microseconds and on any machine. Its
//! [`Journal`] records every call of the runtime in order, and counts live objects. It also checks the runtime's
//! guarantees to an API: while a submission is in flight, its objects are not destroyed and its bindings not written;
//! and an encoder is not reused before it was waited for. A broken guarantee is a validation message.
//!
//! [`Fault`]s make the n-th call of a kind fail: allocations, submissions, the swapchain. Tests of frames, histories,
//! swaps and faults run on it.

#![deny(missing_docs)]

mod backend;
mod encoder;
mod fault;
mod gpu;
mod journal;

pub use fault::{Fault, Point};
pub use gpu::{Config, NullGpu, limits};
pub use journal::{Call, Journal, Object};

use splatgraph_api::BackendError;

/// A device that executes nothing, with a plan.
pub type Null = splatgraph_runtime::Executor<NullGpu>;

/// Opens a device, and returns it with the journal of its calls, which outlives it.
///
/// # Errors
/// The error of a fault during the creation of the device's first objects.
pub fn open(config: &Config) -> (Result<Null, BackendError>, Journal) {
    let (info, gpu) = NullGpu::new(config);
    let journal = gpu.journal.clone();
    let null = match config.window {
        Some(size) => Null::in_window(info, gpu, size),
        None => Null::new(info, gpu),
    };
    (null, journal)
}
