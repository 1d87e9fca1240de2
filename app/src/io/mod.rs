//! Reads the program's inputs, and writes its outputs.

pub mod condition;
pub mod demo;
pub mod film;
pub(crate) mod folders;
pub mod image;
pub mod load;
pub mod losses;
pub(crate) mod named_file;
mod outliers;
pub mod output;
pub(crate) mod own_file;
pub mod program;
pub mod progress;
pub mod report;
pub mod scene_file;
pub mod timeline;
pub mod uri;
