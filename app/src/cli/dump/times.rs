//! Reads GPU times for a dump from the statistics of `splatgraph render --json`.

use crate::cli::cameras::MAX_SIDE;
use crate::draw::stats::{json, median};
use crate::io::named_file;
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use splatgraph_framework::dump::Dump;
use std::collections::BTreeMap;
use std::path::Path;

/// Fields of [`crate::draw::stats::CameraStats`] that a dump uses.
#[derive(Deserialize)]
struct Camera {
    pipeline: String,
    #[serde(default)]
    width: u32,
    #[serde(default)]
    height: u32,
    #[serde(default)]
    device: String,
    #[serde(default)]
    parameters: serde_json::Map<String, serde_json::Value>,
    gpu_ms: Option<f64>,
    passes: Vec<Pass>,
}

#[derive(Deserialize)]
struct Pass {
    name: String,
    gpu_ms: Option<f64>,
}

#[derive(Debug, PartialEq)]
pub struct Times {
    pub pipeline: String,
    /// Size of the pictures; `None` if the cameras' sizes differ, or the file has no valid ones.
    pub size: Option<(u32, u32)>,
    pub device: String,
    /// Values of the graph's parameters, for the first camera.
    pub parameters: serde_json::Map<String, serde_json::Value>,
    /// Median over the cameras of the frame's time, in milliseconds; `None` if none has a time.
    pub frame_ms: Option<f64>,
    /// Pass names, each with its median time over the cameras, in milliseconds.
    pub passes: Vec<(String, f64)>,
}

impl Times {
    /// Lists what differs between the run and a plan, as phrases such as `cutoff=1 instead of 3`.
    ///
    /// Capacities are not compared: a run raises them.
    pub fn others(&self, dump: &Dump, size: (u32, u32), device: Option<&str>) -> Vec<String> {
        let words = |(width, height)| format!("{width}x{height}");
        let mut others = Vec::new();
        if let Some(found) = self.size.filter(|found| *found != size) {
            others.push(format!("pictures of {} instead of {}", words(found), words(size)));
        }
        if let Some(device) = device.filter(|device| !self.device.is_empty() && self.device != *device) {
            others.push(format!("device {} instead of {device}", self.device));
        }
        for parameter in dump.parameters.iter().filter(|parameter| parameter.grows.is_none()) {
            if let Some(value) = self.parameters.get(&parameter.name)
                && *value != json(&parameter.value)
            {
                others.push(format!("{}={value} instead of {}", parameter.name, parameter.value));
            }
        }
        others
    }
}

/// Maximum size of the statistics, in bytes.
const MAX_BYTES: u64 = 1 << 30;

pub fn load(path: &Path) -> Result<Times> {
    parse(&read(path)?).with_context(|| format!("{} has no GPU times", path.display()))
}

/// Reads a JSON file that the user named.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    named_file::read(path, MAX_BYTES).with_context(|| format!("{} cannot be read", path.display()))
}

fn parse(text: &[u8]) -> Result<Times> {
    let cameras: Vec<Camera> = serde_json::from_slice(text)
        .context("expected the output of `splatgraph render --json`, a list with an entry for each camera")?;
    let Some(first) = cameras.first() else {
        bail!("expected an entry for each camera, found an empty list")
    };
    let pipeline = first.pipeline.clone();
    if let Some(other) = cameras.iter().find(|camera| camera.pipeline != pipeline) {
        bail!("expected one graph, found {pipeline} and {}", other.pipeline);
    }
    let size = (first.width, first.height);
    let is_size = size.0.min(size.1) > 0 && size.0.max(size.1) <= MAX_SIDE;
    let same = is_size && cameras.iter().all(|camera| (camera.width, camera.height) == size);
    let (device, parameters) = (first.device.clone(), first.parameters.clone());
    let frame_ms = median(cameras.iter().filter_map(|camera| camera.gpu_ms).collect());
    let mut found: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for pass in cameras.into_iter().flat_map(|camera| camera.passes) {
        found.entry(pass.name).or_default().extend(pass.gpu_ms);
    }
    let passes: Vec<(String, f64)> =
        found.into_iter().filter_map(|(name, times)| Some((name, median(times)?))).collect();
    if passes.is_empty() {
        bail!("the device has no timestamps");
    }
    Ok(Times { pipeline, size: same.then_some(size), device, parameters, frame_ms, passes })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(times: &str) -> String {
        format!(r#"{{"pipeline": "splat", "passes": [{times}], "gpu_ms": 3.0}}"#)
    }

    #[test]
    fn a_pass_has_the_median_of_its_times_over_the_cameras() {
        let cameras = [
            camera(r#"{"name": "once", "gpu_ms": 7.0}, {"name": "draw", "gpu_ms": 5.0}"#),
            camera(r#"{"name": "draw", "gpu_ms": 1.0}, {"name": "untimed", "gpu_ms": null}"#),
            camera(r#"{"name": "draw", "gpu_ms": 2.0}"#),
        ];
        let times = parse(format!("[{}]", cameras.join(",")).as_bytes()).expect("they have times");
        assert_eq!((times.pipeline.as_str(), times.frame_ms), ("splat", Some(3.0)));
        assert_eq!(times.passes, [("draw".to_owned(), 2.0), ("once".to_owned(), 7.0)]);
    }

    #[test]
    fn files_without_times_are_refused_with_the_reason() {
        for (text, reason) in [
            ("{}", "render --json"),
            ("[]", "empty"),
            (&format!("[{}]", camera(r#"{"name": "draw", "gpu_ms": null}"#)), "timestamps"),
            (&format!("[{},{}]", camera(""), camera("").replace("splat", "key16")), "key16"),
        ] {
            let error = format!("{:#}", parse(text.as_bytes()).unwrap_err());
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
