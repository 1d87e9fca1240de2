//! The viewer: what a person does with it, done by scripts. The real program's window needs an X server.

mod dice;
#[cfg(target_os = "linux")]
mod failures;
mod fuzz;
mod keys;
mod live;
#[cfg(target_os = "linux")]
mod program;
mod recovery;
#[cfg(target_os = "linux")]
mod screen;
mod soak;
mod twin;
mod whole;
#[cfg(target_os = "linux")]
mod window;
