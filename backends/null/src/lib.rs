//! Records every call of the runtime, and executes nothing.
//!
//! [`Null`] runs plans through the runtime that every other backend uses, without a GPU. Its [`Journal`] records every
//! call of the runtime in order, and counts live objects. It also checks the runtime's guarantees to an API, and
//! reports a broken one as a validation message. While a submission is in flight, its objects are not destroyed, its
//! bindings are not written, and its encoder is not reused. A swapchain is destroyed only on an idle device, a pass
//! runs only with all its bindings written, and copies stay within their buffers.
//!
//! A [`Fault`] makes the n-th call of a kind fail, such as an allocation, a submission or a call on the swapchain.

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

/// An open null device and the plan that it runs.
pub type Null = splatgraph_runtime::Executor<NullGpu>;

/// Opens a null device. Also returns the journal of its calls, which can outlive it.
///
/// # Errors
/// A fault during the creation of the device's first objects makes opening fail with its error.
pub fn open(config: &Config) -> (Result<Null, BackendError>, Journal) {
    let (info, gpu) = NullGpu::new(config);
    let journal = gpu.journal.clone();
    let null = match config.window {
        Some(size) => Null::in_window(info, gpu, size),
        None => Null::new(info, gpu),
    };
    (null, journal)
}
