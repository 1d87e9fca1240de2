//! Compiles the text of a render graph to a plan that a GPU backend can execute.
//!
//! A graph is a RON file that declares parameters, resources, dispatches and draws. This crate reads it and produces a
//! [`plan::Plan`]: the passes in order, the dependencies between them, and their memory. The plan is a pure function of
//! the files and of the [`ir::Request`]: parameters, and facts of the scene, the device and the viewport. Nothing here
//! touches a GPU.
//!
//! [`ir`] has the plain types that all steps share, and [`plan`] the result, which lowering begins and solving
//! completes. Data passes through these modules in this order (`app/tests/module_order.rs` checks the imports):
//!
//! 1. [`source`] finds and reads files, records the byte span of every element, and renders diagnostics;
//! 2. [`expr`] parses and evaluates the expressions that a graph may contain in place of numbers;
//! 3. [`schema`] is the graph as written, a typed tree;
//! 4. [`lower`] resolves presets, includes, conditions, repeats and swaps to a flat list of passes;
//! 5. [`shader`] compiles GLSL to SPIR-V, and reflects each shader's bindings and accesses;
//! 6. `link` compiles the shaders and checks the flat list against them;
//! 7. [`solve`] orders the passes, places memory and lists the dependencies;
//! 8. [`dump`] writes the plan for people and programs, and `msl` translates its shaders for Metal.
//!
//! [`oracle`] checks the dependencies of a plan independently of [`solve`]. When a file changes, [`reload`] rebuilds
//! the plan while the last good one is still drawn.

#![deny(missing_docs)]

mod build;
pub mod dump;
pub mod expr;
pub mod ir;
mod link;
pub mod lower;
#[cfg(feature = "msl")]
pub mod msl;
pub mod oracle;
pub mod plan;
pub mod reload;
pub mod schema;
pub mod shader;
pub mod solve;
pub mod source;
// `testing` uses this crate by its name, because the tests of the Vulkan backend include it as well.
#[cfg(test)]
extern crate self as splatgraph_framework;
#[cfg(test)]
#[path = "../../tests/numbers.rs"]
mod numbers;
#[cfg(test)]
mod testing;

pub use build::{build, build_candidate};
