//! Hand-made plans, run on a real device (lavapipe suffices) with synchronization validation.
//!
//! Nearly every test opens its own device and ends with [`build::finish`], which closes it and fails on any message,
//! including messages about closing. Tests of windows ([`screen`]) also start an X server.
//!
//! The tests do not run on Apple's systems, which have no lavapipe.
#![cfg(not(target_vendor = "apple"))]

mod bounds;
mod build;
mod compute;
mod draw;
mod frames;
mod given;
mod loading;
mod pictures;
#[cfg(unix)]
mod screen;
mod sharing;
mod swapping;
mod threads;
#[cfg(unix)]
mod x11;
