//! Runs plans on Apple GPUs.
//!
//! The crate has two halves. One lowers a plan to Metal's terms, as plain data. It calls nothing of Apple's, and is compiled and tested
//! everywhere:
//!
//! - [`features`]: the limits of a device, from the few numbers that Metal tells;
//! - [`sync`]: the passes divided into encoders, with fences between them, and the model of Metal's rules that checks them;
//! - [`dump`]: the encoders for `splatgraph dump`;
//! - [`lower`]: pipelines, arguments, usages and copies;
//! - [`walk`]: which encoder is opened, ordered and closed when, as the passes of a frame come by;
//! - [`error`]: Metal's answers as errors.
//!
//! The other half, for Apple's systems alone, makes the objects and walks over that data. Its files are named after those of the
//! Vulkan backend: `surface` and `device`; `gpu`; `memory`, `pipelines`, `descriptors` (tables of arguments), `queue`, `encoder` and
//! `swapchain`; and `backend`, which is all of these as the runtime's [`Gpu`](splatgraph_runtime::Gpu). Besides there are `objc`, the
//! calls that the crate `metal` lacks, and `capture`, a frame for Xcode.
//!
//! Nobody has run that half: it is compiled and linted for Apple silicon on other systems. `docs/metal-mac.md` lists what is to be looked
//! at first on a Mac.

#![deny(missing_docs)]

pub mod dump;
pub mod error;
pub mod features;
pub mod lower;
pub mod sync;
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

/// An opened Apple GPU, and the plan that it executes.
#[cfg(target_vendor = "apple")]
pub type Metal = splatgraph_runtime::Executor<MetalGpu>;
