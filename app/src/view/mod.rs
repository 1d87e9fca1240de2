//! Implements the viewer: a window that draws a scene while its graph, shaders and parameters are edited.
//!
//! The main modules, from the lowest layer to the highest:
//!
//! - [`renderer`]: a device with a graph, whose plan is rebuilt in the background when files, parameters or inputs
//!   change;
//! - [`viewport`]: a renderer of the scene with its frame times ([`history`]) and its inspection;
//! - [`viewer`]: the scene, the camera ([`navigation`]), and one or two viewports;
//! - [`panels`]: the user interface around the pictures;
//! - [`paint`] and [`shell`]: the window's graph, which draws the user interface over the pictures;
//! - [`recovery`]: replacement of a lost device;
//! - [`window`]: winit's events in, frames out.
//!
//! Only [`window`] depends on a window system, so tests run all other modules without one.

pub mod cameras;
pub mod events;
pub mod export;
pub mod history;
pub mod kept;
pub mod latest;
pub mod navigation;
pub mod opening;
pub mod paint;
pub mod panels;
pub mod profile;
pub mod recovery;
pub mod renderer;
pub mod shell;
#[cfg(test)]
mod tests;
pub mod undo;
pub mod viewer;
pub mod viewport;
pub mod wheel;
pub mod window;
