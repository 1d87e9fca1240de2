//! Runs plans on Apple's systems: creates Metal's objects, and executes the plain data of the other modules.
//!
//! `objc` has the calls that the `metal` crate lacks.
//!
//! These modules have never been run: they are compiled and linted for Apple silicon on other systems.
//! `docs/metal-mac.md` lists the first things to check on a Mac.

mod backend;
mod capture;
mod descriptors;
mod device;
mod encoder;
mod gpu;
mod memory;
mod objc;
mod pipelines;
mod queue;
mod surface;
mod swapchain;

pub use capture::capture_next_frame;
pub use gpu::MetalGpu;
