//! `splatgraph devices`: what can draw here.

use super::{Outcome, options};
use anyhow::{Result, bail};
use splatgraph_vulkan::Vulkan;

/// List the devices that Vulkan knows on this machine
///
/// The index, or a part of the name, is what --device takes. Without --device the first discrete GPU is taken, else an
/// integrated one, else another, one that runs on the CPU last.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph devices
  splatgraph devices --json
  splatgraph render --device llvmpipe -o demo.png")]
pub struct Args {
    /// Print JSON, with the facts that graphs can use
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let devices = Vulkan::devices()?;
    if args.json {
        options::write_text(None, &format!("{:#}\n", serde_json::to_value(&devices)?))?;
        return Ok(Outcome::Done);
    }
    if devices.is_empty() {
        bail!("the Vulkan loader knows no device");
    }
    for device in &devices {
        options::print(&format!("{}: {} ({}; {})", device.index, device.name, device.kind, device.driver))?;
        for (name, value) in device.facts.named() {
            options::print(&format!("     {name} = {value}"))?;
        }
        if let Some(why) = &device.unfit {
            options::print(&format!("     cannot run graphs: {why}"))?;
        }
    }
    Ok(Outcome::Done)
}
