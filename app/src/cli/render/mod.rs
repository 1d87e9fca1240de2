//! Runs `splatgraph render`: draws pictures of a scene and measures their cost.

use super::job::Manifest;
use super::options;
use super::outcome::Outcome;
use crate::io::output::{self, say};
use anyhow::Result;
use tracing::info_span;

mod args;
mod batch;
mod destination;
mod drawer;
mod frames;
mod kept;
mod views;

use destination::Destination;
use drawer::Drawer;

pub(super) use args::{Args, Renderer, prepare, refuse_graph_options, renderer, renderers};
pub(super) use frames::prepare_plan;
pub(super) use views::{COMMAND, Views};

pub fn run(args: &Args) -> Result<Outcome> {
    // Check the command line before the device is opened and a large scene is loaded.
    let work = info_span!("check the command line").in_scope(|| prepare(args))?;
    let mut others = None;
    if let Some(destination @ Destination::Folder(folder, format)) = &work.destination {
        Manifest::refuse(folder)?;
        let advice = "to draw each scene alone, run the command once for each";
        args.scenes.note_superimposed(advice).iter().for_each(say);
        let count = work.stems.len();
        let own = work.stems.iter().flat_map(|stem| {
            let besides = args.files_of(stem, count).map(|(_, file)| file);
            besides.chain([destination.path(stem)])
        });
        let own = own.collect();
        others = output::names::others(folder, &format.to_string(), &own);
    }
    let mut drawer = Drawer::open(args, &work, None)?;
    let drawn = drawer.draw(args, &(0..work.stems.len()).collect::<Vec<_>>());
    let drawn = drawn.map_err(|error| args.or_picture(error));
    let loaded = drawer.loaded();
    let cameras = match (&args.write_cameras, &drawn) {
        (Some(path), Ok(())) => options::write_cameras(path, &loaded.cameras, &loaded.scene),
        _ => Ok(()),
    };
    let closed = drawer.close();
    // If a camera fails, the statistics of the others are still written.
    if let (Some(path), Ok((stats, _))) = (&args.json, &closed)
        && (drawn.is_ok() || stats.as_array().is_some_and(|stats| !stats.is_empty()))
    {
        options::write_json(path, stats)?;
    }
    drawn.and(cameras)?;
    let (_, messages) = closed?;
    others.iter().for_each(say);
    Ok(super::outcome::validated(args.device.validate, &messages))
}
