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
//! The other half, only for Apple's systems, creates the objects and follows this data. `objc` has the calls that the
//! crate `metal` lacks.
//!
//! That half has never been run: it is compiled and linted for Apple silicon on other systems. `docs/metal-mac.md`
//! lists the first things to check on a Mac.

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
mod backend;
#[cfg(target_vendor = "apple")]
mod capture;
#[cfg(target_vendor = "apple")]
mod descriptors;
#[cfg(target_vendor = "apple")]
mod device;
#[cfg(target_vendor = "apple")]
mod encoder;
#[cfg(target_vendor = "apple")]
mod gpu;
#[cfg(target_vendor = "apple")]
mod memory;
#[cfg(target_vendor = "apple")]
mod objc;
#[cfg(target_vendor = "apple")]
mod pipelines;
#[cfg(target_vendor = "apple")]
mod queue;
#[cfg(target_vendor = "apple")]
mod surface;
#[cfg(target_vendor = "apple")]
mod swapchain;

#[cfg(test)]
#[path = "../../runtime/src/testing.rs"]
mod handmade;
#[cfg(test)]
mod testing;

#[cfg(target_vendor = "apple")]
pub use capture::capture_next_frame;
#[cfg(target_vendor = "apple")]
pub use gpu::MetalGpu;

/// An open Apple GPU and the plan that it executes.
#[cfg(target_vendor = "apple")]
pub type Metal = splatgraph_runtime::Executor<MetalGpu>;
