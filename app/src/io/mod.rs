//! Reads the program's inputs, and writes its outputs.
//!
//! - [`output`]: files, terminal text, signals;
//! - [`image`]: picture files;
//! - [`film`]: film files;
//! - [`report`]: plots, and self-contained pages;
//! - [`program`]: hash of the program's build;
//! - [`progress`]: progress on standard error;
//! - [`load`]: scene files;
//! - [`scene_file`]: scene files to write, and their losses;
//! - [`demo`]: the demo scene;
//! - [`timeline`]: the time that each step of a command takes.

pub mod demo;
pub mod film;
pub(crate) mod folders;
pub mod image;
pub mod load;
pub mod output;
pub mod program;
pub mod progress;
pub mod report;
pub mod scene_file;
pub mod timeline;
