//! Renders 3D Gaussian Splatting scenes exactly, on the CPU, in f64, as the reference for all other renderers.
//!
//! It follows the published CUDA rasteriser (graphdeco-inria/diff-gaussian-rasterization, commit 59f5f77, called "the
//! rasteriser" in this crate) rule by rule. [`Rules`] names each rule, so that a single rule can be changed and its
//! effect measured. It shares no arithmetic with the shaders and executes no plan: [`render`] is a pure function of
//! splats, camera, background and rules.
//!
//! Data flows one way through the modules. [`Splats`] returns each [`Gaussian`] in f64. `project` converts it to an
//! ellipse on the image, through the camera's `lens`, with its colour from `harmonics`. `order` sorts ellipses by
//! depth. `raster` blends them, a row of tiles at a time, down to the surface that `mesh` finds. `pixel` lists the
//! splats of a single pixel. [`metrics`] measures how far another picture is from the exact one.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use splatgraph_assets::{Camera, synth};
//! use splatgraph_reference::{Rules, render};
//!
//! let scene = synth::generate("uniform", 500, 0)?;
//! let camera = Camera::framing(&scene, 64, 48);
//! let picture = render(&scene, &camera, [0.0; 3], &Rules::PUBLISHED, &|_, _| {});
//! assert_eq!(picture.color.len(), 64 * 48);
//! # Ok(())
//! # }
//! ```

#![deny(missing_docs)]

mod gaussian;
mod harmonics;
mod lens;
mod memory;
mod mesh;
pub mod metrics;
mod order;
mod pixel;
mod project;
mod raster;
mod rules;
mod srgb;

pub use gaussian::{Gaussian, Splats};
pub use memory::{PictureMemoryError, check_memory};
pub use order::{depth_order, inversions, sort_pairs};
pub use pixel::{Fragment, Fragments, Projected, fragments, project};
pub use raster::{Picture, Progress, Visible, largest, render, visible};
pub use rules::{Depth, Extent, KeyOf, LowPass, Order, RULES, RuleError, RuleInfo, Rules, ShDirection, Ties};
