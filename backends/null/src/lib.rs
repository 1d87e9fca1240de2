//! A backend that executes nothing and records every call.
//!
//! [`Null`] runs plans through the same runtime as every other backend, in microseconds and on any machine. Its [`Journal`] has
//! every call that the runtime made, in order and comparable, and counts the objects that are alive. It also checks the promises
//! that the runtime makes to an API: an object is not destroyed, nor a binding written, while a submission that uses it has not
//! completed, and an encoder is not used again before it was waited for. A broken promise is a validation message.
//!
//! [`Fault`]s make the n-th call of a kind fail: allocations, submissions, the swapchain. Tests of frames, histories, swaps and
//! faults run on it.

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

/// A device that executes nothing, and the plan that it would execute.
pub type Null = splatgraph_runtime::Executor<NullGpu>;

/// Opens a device, and returns it with the journal of its calls, which outlives it.
///
/// # Errors
/// The error of a fault in the creation of its first objects.
pub fn open(config: &Config) -> (Result<Null, BackendError>, Journal) {
    let (info, gpu) = NullGpu::new(config);
    let journal = gpu.journal.clone();
    let null = match config.window {
        Some(size) => Null::in_window(info, gpu, size),
        None => Null::new(info, gpu),
    };
    (null, journal)
}
