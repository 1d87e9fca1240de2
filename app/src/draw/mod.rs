//! Draws frames of a scene: from a graph and a device to pictures, times and counts.

pub mod backend;
pub mod builtin;
pub mod camera;
pub mod camera_path;
pub mod capacity;
pub mod capture;
pub mod facts;
pub mod film;
pub mod fit;
pub mod inspect;
pub mod interleaved;
pub mod keys;
pub mod orbit;
pub mod outputs;
pub mod pick;
pub mod pictures;
pub mod planner;
pub mod projection;
pub mod render_command;
pub mod select;
pub mod session;
pub mod shader_cache;
pub mod splat_set;
pub mod stats;
pub mod storage;
pub mod truth;
