//! The viewer: a window on a scene in which everything can be changed while it runs.
//!
//! From the inside out:
//!
//! - [`renderer`]: a device with a graph that is kept up to date: built anew beside the frames when files, parameters or the
//!   surroundings change;
//! - [`side`]: a renderer of the scene, with what its frames took ([`history`]) and what of them is looked at;
//! - [`viewer`]: the scene, the camera ([`navigation`]), and one or two sides;
//! - [`panels`]: the user interface around the pictures;
//! - [`paint`] and [`shell`]: the graph of the window itself, which draws the pictures and the user interface over them;
//! - [`window`]: winit's events in, frames out.
//!
//! Only [`window`] knows a window. Everything else runs in tests as it does there.

pub mod events;
pub mod history;
pub mod navigation;
pub mod paint;
pub mod panels;
pub mod profile;
pub mod renderer;
pub mod shell;
#[cfg(test)]
mod testing;
pub mod viewer;
pub mod viewport;
pub mod window;
