//! Runs plans on Apple GPUs.
//!
//! The crate has two halves. One lowers a plan to Metal's terms, as plain data. It makes no Apple calls, and is
//! compiled and tested everywhere:
//!
//! - [`features`]: the limits of a device, from the few numbers that Metal reports;
//! - [`sync`]: the division of passes into encoders with fences between them, and the model of Metal's rules that
//!   checks it;
//! - [`dump`]: the encoders for `splatgraph dump`;
//! - [`lower`]: pipelines, arguments, usages and copies;
//! - [`walk`]: when to open, order and close each encoder, as the passes of a frame are announced;
//! - [`progress`]: whether a submission has completed or failed;
//! - [`times`]: the timestamps of a frame;
//! - [`error`]: conversion of Metal's failures to errors.
//!
//! The other half, `apple`, creates the objects and follows this data. It is compiled only for Apple's systems.

#![deny(missing_docs)]

pub mod dump;
pub mod error;
pub mod features;
pub mod lower;
pub mod progress;
pub mod sync;
pub mod times;
pub mod walk;

#[cfg(target_vendor = "apple")]
mod apple;
#[cfg(test)]
#[path = "../../runtime/src/testing.rs"]
mod handmade;
#[cfg(test)]
mod testing;

#[cfg(target_vendor = "apple")]
pub use apple::{MetalGpu, capture_next_frame};

/// An open Apple GPU and the plan that it executes.
#[cfg(target_vendor = "apple")]
pub type Metal = splatgraph_runtime::Executor<MetalGpu>;
