//! Draws frames of a scene: from a graph and a device to pictures, times and counts.
//!
//! - [`backend`]: the choice of the graphics backend;
//! - [`builtin`]: the built-in graphs and shaders;
//! - [`camera`]: the camera's uniform block;
//! - [`camera_path`]: smooth ways of a camera through keys;
//! - [`orbit`]: cameras that move around a point;
//! - [`pick`]: the splats of a pixel;
//! - [`truth`]: the exact picture, drawn on the CPU in f64;
//! - [`keys`]: the width that depth keys need;
//! - [`facts`]: the facts and imports of graphs;
//! - [`capacity`]: incomplete frames, and room for them;
//! - [`planner`]: builds plans from graphs;
//! - [`fit`]: whether a scene fits a device;
//! - [`render_command`]: the command that draws a picture again;
//! - [`inspect`]: the contents of a resource after a pass;
//! - [`outputs`]: the images of a frame besides its picture;
//! - [`session`]: draws frames with a device, a scene and a plan;
//! - [`shader_cache`]: a folder with compiled shaders;
//! - [`stats`]: the times and counts of frames;
//! - [`pictures`]: encodes pictures on threads while the device draws the next ones;
//! - [`film`]: films of a moving camera;
//! - [`interleaved`]: frames of several sessions interleaved, and their times;
//! - [`capture`]: a picture with the order of its splats.

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
pub mod truth;
