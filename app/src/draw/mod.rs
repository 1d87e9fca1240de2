//! Draws frames of a scene: from a graph and a device to pictures, times and counts.
//!
//! - [`backend`]: choice of the graphics backend;
//! - [`builtin`]: built-in graphs and shaders;
//! - [`camera`]: the camera's uniform block;
//! - [`camera_path`]: smooth paths of a camera through keys;
//! - [`orbit`]: cameras that move around a point;
//! - [`pick`]: splats of a pixel;
//! - [`truth`]: exact picture, drawn on the CPU in f64, for comparisons;
//! - [`keys`]: width that depth keys need;
//! - [`facts`]: facts and imports of graphs;
//! - [`capacity`]: detection of incomplete frames, and the capacity that they need;
//! - [`planner`]: builds of plans from graphs;
//! - [`fit`]: check whether a scene fits a device;
//! - [`storage`]: choice of the most accurate storage that fits a given memory;
//! - [`render_command`]: command that draws a picture again;
//! - [`inspect`]: contents of a resource after a pass;
//! - [`outputs`]: images that a frame has besides its picture;
//! - [`session`]: frames of a device, a scene and a plan;
//! - [`shader_cache`]: folder of compiled shaders;
//! - [`stats`]: times and counts of frames;
//! - [`pictures`]: encoding of pictures on threads while the device draws the next ones;
//! - [`film`]: films of a moving camera, with motion blur;
//! - [`interleaved`]: interleaved frames of several sessions, and their times;
//! - [`capture`]: pictures with the order of their splats.

pub mod backend;
pub mod builtin;
pub mod camera;
pub mod camera_path;
pub mod capacity;
pub mod capture;
pub mod facts;
pub mod film;
pub mod fit;
pub mod inspect;
pub mod interleaved;
pub mod keys;
pub mod orbit;
pub mod outputs;
pub mod pick;
pub mod pictures;
pub mod planner;
pub mod render_command;
pub mod session;
pub mod shader_cache;
pub mod stats;
pub mod storage;
pub mod truth;
