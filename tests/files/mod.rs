//! The outputs of the real program: complete or missing files, refusals, exit codes, and text without terminal escapes.

mod drivers;
mod full;
mod kills;
mod lines;
mod refusals;
mod system;
mod terminal;
pub mod words;
