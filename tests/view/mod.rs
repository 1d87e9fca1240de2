//! The viewer: what a person does with it, done by scripts.

mod dice;
mod failures;
mod fuzz;
mod keys;
mod live;
mod program;
mod recovery;
mod screen;
mod soak;
mod twin;
mod whole;
mod window;
