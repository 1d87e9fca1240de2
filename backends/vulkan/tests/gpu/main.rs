//! Plans made by hand, run on a real device (lavapipe will do) with synchronization validation on.
//!
//! Every test opens a device of its own and ends with [`build::finish`], which closes it and wants no message: not of
//! the frames, and not of the closing. Those of windows ([`screen`]) start an X server besides.

mod bounds;
mod build;
mod calibration;
mod compute;
mod draw;
mod frames;
mod given;
mod loading;
mod pictures;
#[cfg(all(unix, not(target_os = "macos")))]
mod screen;
mod sharing;
mod swapping;
mod threads;
#[cfg(all(unix, not(target_os = "macos")))]
mod x11;
