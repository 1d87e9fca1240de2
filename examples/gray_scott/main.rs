//! Runs a render graph that draws no splats: load, build, run, read back, write a PNG.
//!
//!     cargo run --release -p splatgraph-examples --bin gray_scott

use std::{error::Error, fs::File};

use splatgraph_api::{Device, FrameInputs, NoScene, Options};
use splatgraph_framework::build;
use splatgraph_framework::ir::{Catalog, Request};
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::source::{GraphErrors, SourceMap};
#[cfg(target_vendor = "apple")]
use splatgraph_metal::Metal as Backend;
#[cfg(not(target_vendor = "apple"))]
use splatgraph_vulkan::Vulkan as Backend;

const GRAPH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/gray_scott/graph.ron");
const FRAMES: usize = 60;

fn main() -> Result<(), Box<dyn Error>> {
    let mut device = Backend::open(&Options::default())?;

    // Text to plan. The files that were read stay in `files`, so that errors can show them.
    let mut files = SourceMap::default();
    let catalog = Catalog::default();
    let facts = device.info().facts.into();
    let request = Request::new(GRAPH, &facts, &catalog);
    let plan = build(&request, &mut files, &mut Glslang::default())
        .map_err(|errors| GraphErrors::new(&files, &errors))?;

    // Plan to pixels.
    let live = plan.live_bytes();
    device.load(plan, &NoScene, &mut |_| {})?;
    for _ in 1..FRAMES {
        device.submit(&FrameInputs { live: live.clone(), ..Default::default() })?;
    }
    let last = device.submit(&FrameInputs { live, read_output: true, ..Default::default() })?;
    let image = device.wait(last)?.output.ok_or("the frame has no output")?;

    let mut png = png::Encoder::new(File::create("gray_scott.png")?, image.width, image.height);
    png.set_color(png::ColorType::Rgba);
    png.write_header()?.write_image_data(&image.bytes)?;
    Ok(())
}
