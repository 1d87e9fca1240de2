//! Loads, checks, measures and generates 3D Gaussian Splatting scenes.
//!
//! [`Scene::load`] reads a `.ply` file in the layout of the reference implementation and converts it in parallel;
//! [`Report`] counts its flaws, [`SizeBreakdown`] accounts for the file's bytes, and [`Scene::write_attribute`] writes the
//! contents of GPU buffers. [`Camera`] reads and writes the reference's `cameras.json`. [`synth`] generates scenes: one for
//! demonstration, and extreme ones for tests.
//!
//! The crate depends on no GPU and no window. Lengths are in the scene's own unit; y points down.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use splatgraph_assets::{Camera, Report, synth};
//!
//! let scene = synth::generate("uniform", 1000, 0)?;
//! let camera = Camera::framing(&scene, 960, 540);
//! println!("{}", Report::new(&scene, &[camera]));
//! # Ok(())
//! # }
//! ```

#![deny(missing_docs)]

mod attributes;
mod bounds;
mod camera;
mod error;
pub mod file;
pub mod harmonics;
pub mod memory;
mod ply;
mod recognise;
mod report;
mod scene;
mod size_breakdown;
pub mod synth;
#[cfg(test)]
mod testing;

pub use attributes::{ATTRIBUTES, AttributeInfo};
pub use bounds::Bounds;
pub use camera::{Camera, CameraError, MAX_CAMERA_BYTES};
pub use error::{LoadError, SceneError};
pub use memory::SceneMemoryError;
pub use ply::read::{Progress, SceneHeader};
pub use report::{DepthRange, DepthReport, NEAR, OpacityReport, PlaceReport, Report, SizeReport};
pub use scene::{ALPHA_FLOOR, ColorRange, Dropped, QuaternionNorms, Scene, Splat, sh_floats};
pub use size_breakdown::{ElementSize, FieldSize, SizeBreakdown, grouped};
