//! Reads GPU times for a dump from the statistics of `splatgraph render --json`.

use crate::draw::stats::median;
use crate::io::named_file;
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Fields of [`crate::draw::stats::CameraStats`] that a dump uses.
#[derive(Deserialize)]
struct Camera {
    pipeline: String,
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
    /// Pass names, each with its median time over the cameras, in milliseconds.
    pub passes: Vec<(String, f64)>,
}

/// Maximum size of the statistics, in bytes.
const MAX_BYTES: u64 = 1 << 30;

pub fn load(path: &Path) -> Result<Times> {
    let text =
        named_file::read(path, MAX_BYTES).with_context(|| format!("{} cannot be read", path.display()))?;
    parse(&text).with_context(|| format!("{} has no GPU times", path.display()))
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
    let mut found: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for pass in cameras.into_iter().flat_map(|camera| camera.passes) {
        found.entry(pass.name).or_default().extend(pass.gpu_ms);
    }
    let passes: Vec<(String, f64)> =
        found.into_iter().filter_map(|(name, times)| Some((name, median(times)?))).collect();
    if passes.is_empty() {
        bail!("the device has no timestamps");
    }
    Ok(Times { pipeline, passes })
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
        assert_eq!(times.pipeline, "splat");
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
