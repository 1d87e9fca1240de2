//! Runs plans on a Vulkan 1.3 device, with or without a window system.
//!
//! [`Vulkan`] is the runtime's [`Executor`](splatgraph_runtime::Executor) on top of Vulkan: the runtime decides which objects a plan
//! needs and records its frames, and this crate makes the objects and the calls.
//!
//! - `instance`, `surface` and `device`: Vulkan's own loader and the validation layer, the window, and which device to open with
//!   what limits;
//! - `gpu`: the opened device and ownership of the objects made from it;
//! - `lower` and [`sync`]: the plan in Vulkan's terms, as plain data, without calling Vulkan. `sync` lowers the plan's dependencies to
//!   barriers, and has the model of Vulkan's rules that checks them;
//! - `memory`, `pipelines`, `descriptors`, `queue`, `encoder` and `swapchain`: the objects and the commands;
//! - `backend`: all of these as the runtime's [`Gpu`](splatgraph_runtime::Gpu).

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
pub use splatgraph_runtime::compilers_given_up;

/// An opened Vulkan device, and the plan that it executes.
pub type Vulkan = splatgraph_runtime::Executor<VulkanGpu>;
/// Makes plans ready for one [`Vulkan`].
pub type Loader = splatgraph_runtime::Loader<VulkanGpu>;
/// A plan that was made ready for one [`Vulkan`].
pub type Ready = splatgraph_runtime::Ready<VulkanGpu>;
