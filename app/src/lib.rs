//! Draws scenes with render graphs and measures the cost of the pictures.
//!
//! This library joins the parts: a scene from `splatgraph-assets`, a plan that `splatgraph-framework` built from a graph
//! file, and a device that executes it. The program `splatgraph` ([`cli`]) is a thin layer over it:
//!
//! - [`output`]: everything that leaves the program: files, terminal text, signals;
//! - [`backend`]: the choice of the graphics backend;
//! - [`builtin`]: the built-in graphs and shaders;
//! - [`facts`]: the facts and imports of graphs;
//! - [`keys`]: the width that depth keys need;
//! - [`capacity`]: frames that were drawn in part, and room for them;
//! - [`planner`]: builds plans from graphs;
//! - [`render_command`]: the command that draws a picture again;
//! - [`fit`]: whether a scene fits a device;
//! - [`camera`]: the camera's uniform block;
//! - [`camera_path`]: smooth ways of a camera through keys;
//! - [`orbit`]: cameras that move around a point;
//! - [`pick`]: the splats of a pixel;
//! - [`session`]: draws frames with a device, a scene and a plan;
//! - [`interleaved`]: frames of several sessions interleaved, and their times;
//! - [`capture`]: a picture with the order of its splats;
//! - [`stats`]: the times and counts of frames;
//! - [`inspect`]: the contents of a resource after a pass;
//! - [`image`] and [`metrics`]: picture files, and differences between pictures;
//! - [`report`]: plots, and pages in one file;
//! - [`trade`]: the cost of each setting, in time and in accuracy;
//! - [`mod@bench`]: time, memory and bytes of graphs, drawn interleaved;
//! - [`advise`]: what a scene needs, and the cheapest setting within a budget;
//! - [`sweep`]: the cost of a budget of splats;
//! - [`experiment`]: pages that show what an equation says, on a scene;
//! - [`popping`]: the error that changes from frame to frame;
//! - [`view`]: the interactive viewer;
//! - [`lsp`]: the language server for editors;
//! - [`demo`]: the demo scene;
//! - [`progress`]: progress on standard error.

#![deny(missing_docs)]
// Tests write files and lines as they like; the program does so through `output` alone.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_macros))]

pub mod advise;
pub mod backend;
pub mod bench;
pub mod builtin;
pub mod camera;
pub mod camera_path;
pub mod capacity;
pub mod capture;
pub mod cli;
pub mod demo;
pub mod experiment;
pub mod facts;
pub mod fit;
mod folders;
pub mod image;
pub mod inspect;
pub mod interleaved;
pub mod keys;
pub mod lsp;
pub mod metrics;
#[cfg(test)]
#[path = "../../tests/numbers.rs"]
mod numbers;
pub mod orbit;
pub mod output;
pub mod pick;
pub mod planner;
pub mod popping;
pub mod progress;
pub mod render_command;
pub mod report;
pub mod session;
mod shader_cache;
pub mod stats;
pub mod sweep;
pub mod trade;
pub mod truth;
#[cfg(feature = "window")]
pub mod view;
