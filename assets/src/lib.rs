//! Loads, checks, measures and generates 3D Gaussian Splatting scenes.
//!
//! [`Scene::load`] maps a `.ply` file in the layout of the reference implementation and converts it in parallel;
//! [`Report`] says what is worth knowing of it, [`SizeBreakdown`] where its bytes go, and [`Scene::write_attribute`] gives the
//! bytes that a GPU buffer wants. [`Camera`] reads and writes the reference's `cameras.json`. [`synth`] makes scenes from
//! nothing: one to look at, and extreme ones to test with.
//!
//! The crate knows no GPU and no window. Units are the scene's own; y points down.
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

mod attributes;
mod bounds;
mod camera;
mod error;
pub mod harmonics;
mod ply;
mod recognise;
mod report;
mod scene;
pub mod synth;
#[cfg(test)]
mod testing;
mod size_breakdown;

pub use attributes::{ATTRIBUTES, AttributeInfo};
pub use bounds::Bounds;
pub use camera::{Camera, CameraError};
pub use error::{LoadError, SceneError};
pub use ply::read::Progress;
pub use report::{DepthRange, DepthReport, NEAR, OpacityReport, PlaceReport, Report, SizeReport};
pub use scene::{Dropped, QuaternionNorms, Scene, Splat, sh_floats};
pub use size_breakdown::{ElementSize, FieldSize, SizeBreakdown, grouped};
