//! Runs `splatgraph devices`: lists the devices of this machine.

use super::options;
use super::outcome::Outcome;
use crate::draw::backend::Api;
use crate::io::output::say;
use anyhow::Result;
use splatgraph_api::DeviceInfo;
use splatgraph_assets::memory::display;
use std::path::PathBuf;

/// List this machine's devices
///
/// Pass --device an index within the command's backend, or a part of a name. By default, commands prefer a discrete
/// GPU, then an integrated GPU, then any other device. Devices that run on the CPU come last. The device `null`
/// executes nothing. The exit code is 1 if the default backend has no device, or cannot list its devices.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph devices
  splatgraph devices --json
  splatgraph render --device llvmpipe -o demo.png
  splatgraph render --backend null --repeat 100 --json       # the cost of everything except the GPU's work")]
pub struct Args {
    /// Print JSON, with the facts for graphs, or write it to a file
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<Outcome> {
    options::claim_json(args.json.as_deref(), [].into_iter())?;
    let mut devices: Vec<(Api, DeviceInfo)> = Vec::new();
    for api in Api::ALL {
        match api.devices() {
            Ok(found) if found.is_empty() && api == Api::default() => say("error: no device was found"),
            Ok(found) => devices.extend(found.into_iter().map(|device| (api, device))),
            Err(error) if api == Api::default() => say(format!("error: {error}")),
            // The default backend decides the exit code.
            Err(error) => say(format!("{api}: {error}")),
        }
    }
    let usual = devices.iter().any(|(api, _)| *api == Api::default());
    let outcome = if usual { Outcome::Done } else { Outcome::Failed };
    if let Some(path) = &args.json {
        let all = devices.iter().map(|(api, device)| {
            let mut value = serde_json::to_value(device)?;
            value["backend"] = api.name().into();
            // Graphs read only some of them as facts, but shaders may need any.
            value["features"] = device.facts.features.iter_names().map(|(name, _)| name).collect();
            Ok(value)
        });
        let all = all.collect::<Result<Vec<_>>>()?;
        options::write_json(path, &serde_json::Value::from(all))?;
        return Ok(outcome);
    }
    for (api, device) in &devices {
        let DeviceInfo { index, name, kind, driver, .. } = device;
        let driver = if driver.is_empty() { String::new() } else { format!("; {driver}") };
        options::print(&format!("{api} {index}: {name} ({kind}{driver})"))?;
        for (name, value) in device.facts.named() {
            options::print(&format!("     {name} = {value}"))?;
        }
        if device.unfit.is_none() {
            options::print(&format!("     {}", device.robustness))?;
        }
        let available = device.heap.available.map(|bytes| format!(", {} available", display(bytes)));
        options::print(&format!(
            "     memory: {}{}",
            display(device.heap.bytes),
            available.unwrap_or_default()
        ))?;
        if let Some(why) = &device.unfit {
            options::print(&format!("     cannot run graphs: {why}"))?;
        }
    }
    Ok(outcome)
}
