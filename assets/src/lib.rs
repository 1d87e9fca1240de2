//! Loads, checks, measures and generates 3D Gaussian Splatting scenes.
//!
//! - [`Scene::load`] reads a scene file of any [`SceneFormat`], in parallel; [`Scene::write`] writes one.
//! - [`Report`] counts a scene's flaws; [`SizeBreakdown`] accounts for the bytes of its file.
//! - [`Scene::write_attribute`] writes the contents of GPU buffers.
//! - [`Dataset`] reads cameras with the names of their photographs.
//! - [`synth`] generates scenes: one for demonstration, and extreme ones for tests.
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

mod activation;
mod attributes;
mod bounds;
mod camera;
mod composition;
mod dataset;
mod edit;
mod error;
pub mod file;
mod formats;
mod framing;
mod gltf;
pub mod harmonics;
mod input;
mod json;
mod ksplat;
pub mod memory;
mod mesh;
mod node_transform;
mod ply;
mod projection;
mod rad;
mod recognise;
mod report;
mod scalar;
mod scene;
mod scene_files;
mod scene_format;
mod similarity;
mod size_breakdown;
mod sog;
mod splat;
mod spz;
pub mod synth;
#[cfg(test)]
mod testing;
mod uri;
mod usd;
mod words;

pub use activation::SH_C0;
pub use attributes::{ATTRIBUTES, PROPERTY_ATTRIBUTE};
pub use bounds::{Bounds, WorldBounds, decimals};
pub use camera::Camera;
pub use dataset::{
    CameraError, CameraOptions, Capture, Crop, Dataset, FrameTiming, MAX_CAMERA_BYTES, NERFSTUDIO,
    TEST_EVERY, View, photograph, unnamed,
};
pub use error::{LoadError, SceneError};
pub use formats::{Content, LargeSteps};
pub use input::{Progress, QUIET, ReadOptions, SceneHeader};
pub use memory::SceneMemoryError;
pub use mesh::{Light, MESH_ATTRIBUTES, Mesh, MeshMaterial, Texture};
pub use projection::Projection;
pub use report::{DepthRange, DepthReport, NEAR, OpacityReport, PlaceReport, Report, SizeReport};
pub use scene::{
    ALPHA_FLOOR, CoarsePositions, ColorRange, Dropped, FileNotes, Filter, MixedTags, Properties,
    QuaternionNorms, Scene, ScenePart, SortKey, Splat, sh_floats,
};
pub use scene_files::{names_scenes, scene_files, scene_paths};
pub use scene_format::SceneFormat;
pub use similarity::Similarity;
pub use size_breakdown::{ElementSize, FieldSize, SizeBreakdown, grouped, rounded};
pub use spz::SpzVersion;
pub use words::AttributeInfo;
