//! The viewer as a user operates it, by scripts. The real program's window needs an X server; the long runs read their
//! memory, files and threads in /proc.

mod cameras;
mod dice;
#[cfg(target_os = "linux")]
mod failures;
mod fuzz;
mod keys;
mod live;
mod monkey;
#[cfg(target_os = "linux")]
mod program;
#[cfg(target_os = "linux")]
mod recovery;
#[cfg(target_os = "linux")]
mod screen;
#[cfg(target_os = "linux")]
mod soak;
mod splats;
mod tools;
mod whole;
#[cfg(target_os = "linux")]
mod window;
