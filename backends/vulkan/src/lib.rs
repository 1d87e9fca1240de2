//! Runs plans on a Vulkan 1.3 device, with or without a window system.
//!
//! [`Vulkan`] is the runtime's [`Executor`](splatgraph_runtime::Executor) on Vulkan. The runtime decides which objects
//! a plan needs and records its frames; this crate creates the objects and makes the calls.
//!
//! - `instance`, `surface`, `device`, `features` and `robustness`: Vulkan's loader and the validation layer, the
//!   window, and the choice of a device with its limits and optional features;
//! - `gpu`: the open device, and ownership of its objects;
//! - `lower` and [`sync`]: the plan in Vulkan's terms, as plain data, without calling Vulkan. `sync` lowers the plan's
//!   dependencies to barriers, and contains the model of Vulkan's rules that checks them;
//! - `memory`, `pipelines`, `descriptors`, `queue`, `encoder` and `swapchain`: the objects and the commands;
//! - `backend`: implements the runtime's [`Gpu`](splatgraph_runtime::Gpu) with them;
//! - `error`: converts result codes to errors.

#![deny(missing_docs)]

mod backend;
mod descriptors;
mod device;
mod encoder;
mod error;
mod features;
mod gpu;
mod instance;
mod lower;
mod memory;
mod pipelines;
mod queue;
mod robustness;
mod surface;
mod swapchain;
pub mod sync;
#[cfg(test)]
#[path = "../../runtime/src/testing.rs"]
mod testing;

pub use gpu::VulkanGpu;
pub use splatgraph_api::{DeviceMemory, Options, Validation};

/// An open Vulkan device and the plan that it executes.
pub type Vulkan = splatgraph_runtime::Executor<VulkanGpu>;
/// A handle that prepares one plan for a [`Vulkan`].
pub type Loader = splatgraph_runtime::Loader<VulkanGpu>;
/// A plan prepared for a [`Vulkan`].
pub type Ready = splatgraph_runtime::Ready<VulkanGpu>;
