//! Measures the device's bandwidth of copies between buffers, the limit of every pass.

use super::measure::Bench;
use crate::draw::facts::DEFAULT_SIZE;
use crate::draw::interleaved::{Figure, Frames};
use crate::studies::study::{Setting, Steps, StudyError};
use serde::Serialize;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, synth};

/// The graph that copies.
pub const GRAPH: &str = "bench/copy";
/// The phase of its copy.
const PHASE: &str = "copy";

/// The copy limit of a device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CopyLimit {
    /// Bytes that a copy moves: read and written.
    pub bytes: u64,
    /// Milliseconds of a copy on the GPU.
    pub gpu_ms: Figure,
    /// The bytes by the time, in 10^9 bytes per second.
    pub gb_per_s: f64,
}

/// Makes a scene for graphs that draw none, with a camera that is not looked through.
pub fn no_scene() -> Result<(Scene, Camera), synth::SynthError> {
    let scene = synth::generate("demo", 1, 0)?;
    let camera = Camera::framing(&scene, DEFAULT_SIZE.0, DEFAULT_SIZE.1);
    Ok((scene, camera))
}

/// Measures the copy limit; `None` if the device has no timestamps. The inner error says why it cannot be measured.
///
/// # Errors
/// The device fails.
pub fn measure<D: Device>(
    device: &D,
    frames: Frames,
    (scene, camera): (Scene, Camera),
) -> Result<Result<Option<CopyLimit>, String>, StudyError> {
    let bench = Bench { device, scene: scene.into(), frames, copy: None };
    let mut nobody = ();
    let steps = &mut Steps::new(&mut nobody, "", 1);
    let outcome = bench.measure(&[Setting::of_graph(GRAPH, &[])], &[camera], steps, "")?.into_iter().next();
    let found = match outcome {
        Some(Ok(found)) => found,
        Some(Err(why)) => return Ok(Err(why)),
        None => return Ok(Ok(None)),
    };
    let phase = found.mean.phases.into_iter().find(|phase| phase.name == PHASE);
    Ok(Ok(phase.and_then(|phase| {
        Some(CopyLimit { bytes: phase.bytes, gpu_ms: phase.gpu_ms?, gb_per_s: phase.gb_per_s? })
    })))
}
