//! Draws the views of `splatgraph evaluate`, writes their pictures, and describes what the scores depend on.

use super::work::{Args, FOLDERS, Work, picture};
use crate::cli::loading;
use crate::cli::options;
use crate::cli::outcome::claim_graph_files;
use crate::cli::render::Renderer;
use crate::draw::backend::Backend;
use crate::draw::blind;
use crate::draw::fit;
use crate::draw::outputs;
use crate::draw::session::{FrameOptions, Session};
use crate::draw::stats;
use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::io::program;
use crate::studies::evaluation::Evaluation;
use crate::studies::measurement::view::MEASURED_FRAME;
use anyhow::{Context, Result};
use serde_json::{Map, Value as Json, json};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::plan::Plan;
use splatgraph_reference::Rules;
use std::sync::Arc;

/// Field of the JSON with the value of [`origin`].
pub const ORIGIN: &str = "origin";

pub enum Drawer {
    /// A session, and the number of frames to draw of each view; `None` for the default.
    Device(Box<Session>, Option<u32>),
    Reference(Arc<Scene>),
}

impl Drawer {
    /// Loads the scene, unless it is given, while the device is opened. The exact renderer needs no device.
    ///
    /// Prepares the plan for the first view that can be drawn, and registers the graph's files as inputs.
    pub fn open(args: &Args, work: &mut Work, scene: Option<Arc<Scene>>) -> Result<Drawer> {
        let load = |cancel: &_| {
            let load = || loading::load_scene_unless(cancel, &args.scene, &args.load).map(Arc::new);
            scene.map_or_else(load, Ok)
        };
        let Renderer::Device(api) = args.backend else {
            return Ok(Drawer::Reference(load(&loading::NEVER)?));
        };
        let open = || {
            let device = Backend::open(api, &args.device.options())?;
            fit::check_header(&args.scene, &args.load, device.info(), &args.pipeline, &args.set)?;
            Ok(device)
        };
        let (device, scene) = loading::open_and_load(open, load)?;
        let mut session = Session::new(device, scene, &args.pipeline, &args.set);
        if let Some(camera) = work.views.iter().find_map(|view| view.drawn(work.downscale).ok()) {
            session.prepare((camera.width, camera.height), &mut |_| {})?;
        }
        claim_graph_files(&mut work.guard, &session.files())?;
        Ok(Drawer::Device(Box::new(session), args.repeat))
    }

    pub fn scene(&self) -> &Scene {
        match self {
            Drawer::Reference(scene) => scene,
            Drawer::Device(session, _) => session.scene(),
        }
    }

    /// Counts the splats that the near plane cuts off, if they are a noticeable part of the view that was drawn last.
    pub fn too_near(&self, camera: &Camera) -> Option<u64> {
        let scene = self.scene();
        let camera = camera.relative_to(scene.offset());
        let rules = match self {
            Drawer::Reference(_) => Rules::of_view(scene, &camera),
            Drawer::Device(session, _) => blind::rules_of(session.plan(), scene, &camera),
        };
        blind::noticeable_cuts(scene, &[(&camera, rules)])[0]
    }

    /// Reports that one of several frames is scored. `None` if each view is drawn once, or if --repeat chose the frame.
    pub fn note(&self) -> Option<String> {
        let Drawer::Device(session, None) = self else { return None };
        let plan = session.plan().filter(|plan| plan.carries_state())?;
        Some(format!(
            "`{}` reads the previous frame: frame {MEASURED_FRAME} of each view is scored, in which an average has not converged; --repeat N draws more",
            plan.name
        ))
    }

    /// Draws a view from a camera in world coordinates. Pictures do not depend on the views before.
    pub fn draw(&mut self, camera: &Camera, background: [f32; 3]) -> Result<Image> {
        match self {
            Drawer::Reference(scene) => {
                let camera = camera.relative_to(scene.offset());
                Ok(Truth::draw(scene, &camera, background, &Rules::of_view(scene, &camera))?.image())
            }
            Drawer::Device(session, repeat) => {
                let camera = camera.relative_to(session.scene().offset());
                session.prepare((camera.width, camera.height), &mut |_| {})?;
                session.restart()?;
                let default =
                    if session.plan().is_some_and(Plan::carries_state) { MEASURED_FRAME } else { 1 };
                for _ in 1..repeat.unwrap_or(default) {
                    let frame =
                        session.submit(&camera, &FrameOptions { background, ..FrameOptions::default() })?;
                    session.wait(frame)?;
                }
                Ok(outputs::draw(session, &camera, background)?.colour)
            }
        }
    }
}

/// Makes a picture of the scored differences, times ten: of clamped colours, and black where a pixel does not count.
fn scored_difference(drawn: &Image, photograph: &Image, mask: Option<&[bool]>) -> Image {
    let clamped = |image: &Image| image.clone().clamped();
    let mut difference = Image::difference(&clamped(drawn), &clamped(photograph), 10.0);
    let pixels = difference.rgb.iter_mut().zip(mask.into_iter().flatten());
    pixels.filter(|(_, counts)| !**counts).for_each(|(pixel, _)| *pixel = [0.0; 3]);
    difference
}

/// Writes the pictures of a view to the folder of `--output`, if any.
pub fn save(args: &Args, stem: &str, drawn: &Image, photograph: &Image, mask: Option<&[bool]>) -> Result<()> {
    let Some(output) = &args.output else { return Ok(()) };
    let difference = scored_difference(drawn, photograph, mask);
    for (folder, image) in FOLDERS.into_iter().zip([drawn, photograph, &difference]) {
        image.save(&picture(output, folder, stem))?;
    }
    Ok(())
}

pub fn request(args: &Args) -> Json {
    let graph = match args.backend {
        Renderer::Device(_) => json!(args.pipeline),
        Renderer::Reference => json!(null),
    };
    json!({
        "scene": options::text_of(&args.scene), "dataset": options::text_of(&args.cameras),
        "backend": args.backend.to_string(), "pipeline": graph,
        "set": args.set, "repeat": args.repeat, "downscale": args.downscale, "photographs": args.photographs.as_deref().map(options::text_of),
        "masks": args.masks.as_deref().map(options::text_of), "all": args.all,
        "background": args.background, "ignore_tags": args.load.file.ignore_tags, "level": args.load.file.level,
        "where": args.load.condition.as_ref().map(ToString::to_string),
    })
}

/// Describes what the scores depend on besides the request.
///
/// These are the program, the device, the graph that is drawn, how photographs are made smaller, and what the test views
/// are. For the exact renderer, the device and the graph are null. The graph is also null if no view can be drawn.
pub fn origin(drawer: &mut Drawer, downscaled: Option<&str>, split: &str) -> Result<Json> {
    let (device, plan) = match drawer {
        Drawer::Reference(_) => (None, None),
        Drawer::Device(session, _) => {
            let info = session.device().info();
            (Some(format!("{} ({})", info.name, info.driver)), session.plan())
        }
    };
    let parameters = plan.map(|plan| -> Map<String, Json> {
        plan.params.iter().map(|param| (param.name.clone(), stats::json(&param.value))).collect()
    });
    Ok(json!({
        "version": program::VERSION,
        "program": program::hash().context("the program's file cannot be read")?,
        "device": device,
        "based_on": plan.map(|plan| &plan.based_on),
        "parameters": parameters,
        "downscaled": downscaled,
        "split": split,
    }))
}

pub fn as_json(mut request: Json, found: &Evaluation) -> String {
    request["views"] = json!(found.views);
    request["missing"] = json!(found.missing);
    request["mean"] = json!(found.mean);
    format!("{request:#}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_shows_only_what_is_scored() {
        let image = |rgb: [[f32; 3]; 3]| Image { width: 3, height: 1, rgb: rgb.to_vec() };
        let (drawn, photograph) =
            (image([[3.0; 3], [0.5; 3], [0.5; 3]]), image([[1.0; 3], [0.25; 3], [0.25; 3]]));
        let found = scored_difference(&drawn, &photograph, Some(&[true, true, false]));
        assert_eq!(found.rgb, [[0.0; 3], [2.5; 3], [0.0; 3]]);
        assert_eq!(scored_difference(&drawn, &photograph, None).rgb, [[0.0; 3], [2.5; 3], [2.5; 3]]);
    }
}
