//! From the text of a render graph to a plan that a GPU backend can execute.
//!
//! A graph is a RON file that declares parameters, resources, dispatches and draws. This crate reads it and
//! produces a [`plan::Plan`]: the passes in order, the dependencies between them, the memory they need. Nothing here
//! touches a GPU: the plan is a pure function of the files, the parameters, the facts of the scene and the facts
//! of the device, so it can be built, dumped and tested anywhere.
//!
//! [`ir`] is the ground floor: the plain types that all steps share. Data walks through the other folders in this order, and a test
//! holds the imports to it:
//!
//! 1. [`source`] finds and reads files, knows the byte span of every element and draws diagnostics under them;
//! 2. `expr` parses and evaluates the small expressions that a graph may hold in place of numbers;
//! 3. [`schema`] is the graph as written, a typed tree;
//! 4. [`lower`] resolves presets, includes, conditions, repeats and swaps to a flat list of passes;
//! 5. [`shader`] compiles GLSL to SPIR-V and reads back what each shader binds and touches;
//! 6. `link` compiles the shaders and holds the flat list against them;
//! 7. [`solve`] orders the passes, places memory and lists the dependencies;
//! 8. [`plan`] is the result, [`dump`] writes it for people and programs, and `msl` translates its shaders for Metal.
//!
//! When a file changes, [`reload`] has the plan built again, while the last good plan is still drawn.

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
// The tests of the Vulkan backend share `testing`.
#[cfg(test)]
extern crate self as splatgraph_framework;
#[cfg(test)]
mod testing;

pub use build::build;
