//! Measures the device's bandwidth for copies between buffers, the reference for the bandwidth of passes.

use super::measure::Bench;
use crate::draw::backend::Backend;
use crate::draw::facts::DEFAULT_SIZE;
use crate::draw::interleaved::{Figure, Frames};
use crate::studies::study::{Listener, Setting, Steps, StudyError};
use serde::Serialize;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, synth};

/// Name of the graph that copies.
pub const GRAPH: &str = "bench/copy";
const PHASE: &str = "copy";

/// The copy bandwidth of a device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CopyLimit {
    /// Bytes that the copy reads and writes.
    pub bytes: u64,
    /// GPU time of the copy, in milliseconds.
    pub gpu_ms: Figure,
    /// Bandwidth, in 10^9 bytes per second.
    pub gb_per_s: f64,
}

/// Makes a placeholder scene and camera for graphs that draw no splats.
///
/// # Errors
/// The scene cannot be generated.
pub fn no_scene() -> Result<(Scene, Camera), synth::SynthError> {
    let scene = synth::generate("demo", 1, 0)?;
    let camera = Camera::framing(&scene, DEFAULT_SIZE.0, DEFAULT_SIZE.1);
    Ok((scene, camera))
}

/// Measures the copy limit of a device. If the copy cannot be drawn, the listener gets the reason, and the result is
/// `None`.
///
/// Also `None` without timestamps, and on a CPU, where passes may be served by caches that the copy does not fit in.
///
/// # Errors
/// The device fails.
pub fn copy_limit(
    device: &Backend,
    frames: Frames,
    listener: &mut dyn Listener,
) -> Result<Option<CopyLimit>, StudyError> {
    if device.info().is_cpu() {
        return Ok(None);
    }
    let (scene, camera) = no_scene()?;
    let bench = Bench { device, scene: scene.into(), frames, copy: None };
    let mut nobody = ();
    let steps = &mut Steps::new(&mut nobody, "", 1);
    let outcome = bench.measure(&[Setting::of_graph(GRAPH, &[])], &[camera], steps, "")?.into_iter().next();
    let found = match outcome {
        Some(Ok(found)) => found,
        Some(Err(why)) => {
            listener.say(&format!("the copy limit cannot be measured: {why}"));
            return Ok(None);
        }
        None => return Ok(None),
    };
    let phase = found.mean.phases.into_iter().find(|phase| phase.name == PHASE);
    Ok(phase.and_then(|phase| {
        Some(CopyLimit { bytes: phase.bytes, gpu_ms: phase.gpu_ms?, gb_per_s: phase.gb_per_s? })
    }))
}
