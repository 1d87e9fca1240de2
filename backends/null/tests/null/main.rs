//! Tests the runtime call by call, on a device that executes nothing.

mod common;
mod compilers;
mod faults;
mod frames;
mod histories;
#[path = "../../../../framework/tests/nominal/mod.rs"]
mod nominal;
mod once;
mod presets;
mod results;
#[path = "../../../runtime/src/testing.rs"]
mod testing;
mod uploads;
mod window;
