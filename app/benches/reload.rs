//! Measures the time from a change to the first frame of the new plan, and the median time of a frame.
//!
//! `cargo bench -p splatgraph --bench reload [-- --device NAME] [--scene SCENE.ply] [--size WxH] [--runs N]` draws a
//! copy of the preset `splat` without a window, and changes its files and a parameter. The viewer measures the time:
//! from the notice of the save, or the change of the parameter, to the end of the new plan's first frame on the device.

#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use anyhow::{Context, Result, bail};
use splatgraph::draw::backend::{Api, Backend, Options};
use splatgraph::view::events::Event;
use splatgraph::view::viewer::Viewer;
use splatgraph_api::Device;
use splatgraph_assets::{Scene, synth};
use splatgraph_framework::ir::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest wait for a new plan.
const PATIENCE: Duration = Duration::from_secs(60);

struct Args {
    device: Option<String>,
    scene: Option<PathBuf>,
    size: (u32, u32),
    runs: usize,
}

impl Args {
    fn parse() -> Result<Args> {
        let mut args = Args { device: None, scene: None, size: (640, 360), runs: 15 };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            let mut value = || words.next().with_context(|| format!("{word} wants a value"));
            match word.as_str() {
                "--device" => args.device = Some(value()?),
                "--scene" => args.scene = Some(value()?.into()),
                "--runs" => args.runs = value()?.parse()?,
                "--size" => {
                    let text = value()?;
                    let (width, height) = text.split_once('x').context("--size wants WIDTHxHEIGHT")?;
                    args.size = (width.parse()?, height.parse()?);
                }
                // Cargo passes this option.
                "--bench" => {}
                other => bail!("there is no option {other}"),
            }
        }
        Ok(args)
    }
}

enum Modification {
    /// Appends a line to a file of the copy.
    Edit(&'static str, fn(usize) -> String),
    /// Sets a parameter to its two values alternately.
    Set(&'static str, [Value; 2]),
}

fn main() -> Result<()> {
    let args = Args::parse()?;
    let folder = tempfile::tempdir()?;
    for (name, text) in splatgraph::draw::builtin::FILES {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap_or(folder.path()))?;
        std::fs::write(path, text)?;
    }
    let (scene, path) = match &args.scene {
        Some(path) => (Scene::load(path, splatgraph_assets::QUIET)?, path.clone()),
        None => (synth::generate("demo", 200_000, 0)?, folder.path().join("demo.ply")),
    };
    let splats = scene.count();
    let device =
        Backend::open(Api::default(), &Options { device: args.device.clone(), ..Options::default() })?;
    println!("{}, {splats} splats, {} x {}", device.info().name, args.size.0, args.size.1);
    let graph = folder.path().join("pipelines/splat.ron");
    let mut viewer = Viewer::new(device, (scene, path), &graph.to_string_lossy(), &[], Arc::new(|| {}))?;
    viewer.continuous = true;
    viewer.a.renderer.patience = PATIENCE;
    until_swapped(&mut viewer, args.size)?;
    for _ in 0..200.min(20 * args.runs) {
        viewer.frame(args.size);
    }
    viewer.finish(PATIENCE)?;
    let quantiles = |q: Option<splatgraph::view::history::Quantiles>| q.unwrap_or_default();
    let (gpu, cpu) = (quantiles(viewer.a.history.total()), quantiles(viewer.a.history.record()));
    println!(
        "a frame: GPU {:.3} ms (99 %: {:.3}), host {:.3} ms (99 %: {:.3})",
        gpu.median, gpu.p99, cpu.median, cpu.p99
    );

    let comment = |run: usize| format!("\n// {run}\n");
    let changes = [
        ("a compute shader's text (project.comp)", Modification::Edit("shaders/project.comp", comment)),
        ("a fragment shader's text (splat.frag)", Modification::Edit("shaders/splat.frag", comment)),
        ("an include of both (splat.glsl)", Modification::Edit("shaders/splat.glsl", comment)),
        ("the graph's text (splat.ron)", Modification::Edit("pipelines/splat.ron", comment)),
        ("a constant (digit_bits)", Modification::Set("digit_bits", [Value::Int(4), Value::Int(8)])),
    ];
    println!(
        "{:40} {:>9} {:>9} {:>9}   {:>7} {:>7}",
        "change of", "median", "least", "most", "plan", "device"
    );
    for (name, change) in changes {
        let mut found: Vec<[f64; 3]> = Vec::new();
        for run in 0..args.runs {
            let before = viewer.a.history.frames();
            match &change {
                Modification::Edit(file, line) => append(&folder.path().join(file), &line(run))?,
                Modification::Set(param, values) => {
                    viewer.a.renderer.set_param(param, Some(values[run % 2].clone()))
                }
            }
            let (swap, asked) = until_swapped(&mut viewer, args.size)?;
            viewer.finish(PATIENCE)?;
            let drawn = viewer.a.history.frames() - before;
            if drawn != asked {
                bail!("{drawn} of {asked} frames were drawn");
            }
            found.push(swap);
        }
        let column = |i: usize| {
            let mut values: Vec<f64> = found.iter().map(|swap| swap[i]).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let (latency, plan, device) = (column(0), column(1), column(2));
        let (middle, last) = (latency.len() / 2, latency.len() - 1);
        println!(
            "{name:40} {:9.1} {:9.1} {:9.1}   {:7.1} {:7.1}   ms",
            latency[middle], latency[0], latency[last], plan[middle], device[middle]
        );
    }
    Ok(())
}

/// Draws until a plan is swapped. Returns its latency, plan and device times in milliseconds, and the frames drawn.
fn until_swapped(viewer: &mut Viewer, size: (u32, u32)) -> Result<([f64; 3], u64)> {
    let begun = Instant::now();
    let mut frames = 0;
    while begun.elapsed() < PATIENCE {
        viewer.frame(size);
        frames += u64::from(viewer.a.renderer.plan().is_some());
        for event in viewer.take_events() {
            match event {
                Event::Swapped { swap, .. } => {
                    return Ok(([swap.latency_ms, swap.plan_ms, swap.prepare_ms], frames));
                }
                Event::Failed { text, .. } => bail!("{text}"),
                _ => {}
            }
        }
    }
    bail!("no new plan came")
}

fn append(path: &Path, text: &str) -> Result<()> {
    use std::io::Write;
    Ok(std::fs::OpenOptions::new().append(true).open(path)?.write_all(text.as_bytes())?)
}
