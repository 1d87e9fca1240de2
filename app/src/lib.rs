//! The application: draws scenes with render graphs and says what the pictures cost.
//!
//! This library joins the parts: a scene from `splatgraph-assets`, a plan that `splatgraph-framework` built from a graph
//! file, and a device that executes it. The program `splatgraph` ([`cli`]) is a thin layer over it:
//!
//! - [`builtin`]: the graphs and shaders that are part of the program;
//! - [`facts`]: what graphs may know of scene, device and viewport;
//! - [`planner`]: from a graph's name to a plan;
//! - [`camera`]: from a camera to the uniform block that shaders read;
//! - [`session`]: a device, a scene and a plan that draw frames together;
//! - [`stats`]: what frames cost, for people and programs;
//! - [`inspect`]: what a buffer holds after a pass;
//! - [`image`] and [`metrics`]: pictures in files, and how far two of them are apart;
//! - [`view`]: the window in which everything can be changed while it runs;
//! - [`demo`]: the scene that is drawn when none is given;
//! - [`progress`]: progress on standard error.

pub mod builtin;
pub mod camera;
pub mod cli;
pub mod demo;
pub mod facts;
pub mod image;
pub mod inspect;
pub mod metrics;
pub mod planner;
pub mod progress;
pub mod session;
pub mod stats;
#[cfg(feature = "window")]
pub mod view;
