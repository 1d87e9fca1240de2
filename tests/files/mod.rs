//! Outputs of the real program: files are complete or missing; refusals, exit codes, and text without terminal escapes.

mod bytes;
mod drivers;
mod full;
mod kills;
mod lines;
mod refusals;
mod system;
mod terminal;
pub mod words;

// `words` is also a module of the program's unit tests, where this type has another path.
use splatgraph::io::image::Image;
