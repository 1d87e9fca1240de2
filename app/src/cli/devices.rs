//! Runs `splatgraph devices`: lists the devices of this machine.

use super::{Outcome, options};
use crate::backend::Backend;
use anyhow::{Result, bail};
use splatgraph_assets::memory::display;

/// List this machine's Vulkan devices
///
/// --device takes an index, or a part of a name. Without --device, a discrete GPU is preferred, then an integrated one, then
/// any other; a device that runs on the CPU comes last.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph devices
  splatgraph devices --json
  splatgraph render --device llvmpipe -o demo.png")]
pub struct Args {
    /// Print JSON, with the facts for graphs
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let devices = Backend::devices()?;
    if args.json {
        options::write_text(None, &format!("{:#}\n", serde_json::to_value(&devices)?))?;
        return Ok(Outcome::Done);
    }
    if devices.is_empty() {
        bail!("no device was found");
    }
    for device in &devices {
        options::print(&format!("{}: {} ({}; {})", device.index, device.name, device.kind, device.driver))?;
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
    Ok(Outcome::Done)
}
