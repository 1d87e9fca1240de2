//! Sweeps a scene: every view with fewer and fewer splats, then the approach of the first camera.

use super::approach;
use super::choice::{BUDGET, Choice, for_nearest};
use super::measure::{Step, Sweep, counts};
use super::page::{Shown, Swept, gather};
use crate::draw::interleaved::Frames;
use crate::io::image::Image;
use crate::studies::measurement::view::View;
use crate::studies::study::{Listener, Steps, StudyError, Subject};
use splatgraph_api::Device;

/// The request of the study.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The graph, and its parameters.
    pub pipeline: String,
    /// See `pipeline`.
    pub set: Vec<(String, String)>,
    /// Steps, each with half the splats of the one before.
    pub steps: u32,
    /// The numbers of frames.
    pub frames: Frames,
}

/// Measures quality and time with fewer and fewer splats. Also returns the pictures of the first view.
///
/// # Errors
/// The graph has errors, a picture cannot be compared, the device fails, or the listener cancels.
pub fn study<D: Device>(
    subject: &Subject<D>,
    wanted: &Wanted,
    listener: &mut dyn Listener,
) -> Result<(Swept, Vec<Shown>), StudyError> {
    let (cameras, first) = (&subject.cameras, subject.first()?);
    let counts = counts(subject.scene.count(), wanted.steps);
    let (pipeline, set) = (wanted.pipeline.as_str(), wanted.set.as_slice());
    let mut whole = subject.session(pipeline, set)?;
    let controls = whole.controls((first.width, first.height))?;
    let nearest = for_nearest(&controls);
    if nearest.is_none() {
        listener.say(&format!("{pipeline}: no parameter `{BUDGET}`: the nearest splats are not measured"));
    }
    // Quads blend every fragment.
    let stops = controls.iter().any(|control| control.param.name == "stop");
    let per_view = 1 + Choice::ALL.len() * (counts.len() - 1);
    let of = per_view * cameras.len() + approach::STEPS.len();
    let (mut steps, mut shown): (Vec<Step>, Vec<Shown>) = (Vec::new(), Vec::new());
    for (at, camera) in cameras.iter().enumerate() {
        // The orders of different parts of the scene cannot be compared.
        let view = View::exact(whole.scene(), camera);
        whole.prepare((camera.width, camera.height), &mut |_| {})?;
        whole.settings_without_effect().iter().for_each(|line| listener.say(line));
        let effort = wanted.frames.choose(&mut whole, camera, 4)?;
        let mut progress = Steps::new(listener, "sweeping", of);
        progress.skip(at * per_view);
        let mut sweep = Sweep { whole: &mut whole, pipeline, set, ms: None, nearest: nearest.as_deref() };
        let refused = |why: String| StudyError::of(&camera.img_name)(StudyError::Input(why));
        let mut keep = |step: Step, picture: Image| -> Result<(), StudyError> {
            progress.next(&format!("{}, {} splats", camera.img_name, step.count))?;
            if at == 0 {
                shown.push(Shown { choice: step.choice, count: step.count, picture });
            }
            steps.push(step);
            Ok(())
        };
        let (step, picture) = sweep.all(&view, effort)?.map_err(refused)?;
        keep(step, picture)?;
        for choice in Choice::ALL {
            sweep.steps(choice, &counts[1..], &view, effort, &mut keep)?.map_err(refused)?;
        }
    }
    let closer = approach::cameras(whole.scene(), first);
    whole.prepare((first.width, first.height), &mut |_| {})?;
    let effort = wanted.frames.choose(&mut whole, first, 4)?;
    let mut progress = Steps::new(listener, "sweeping", of);
    progress.skip(per_view * cameras.len());
    let closer = approach::measure(&mut whole, &closer, stops, effort, &mut progress)?;
    let scene = (subject.name.clone(), subject.scene.count());
    Ok((gather(scene, wanted.pipeline.clone(), subject.device_name(), steps, closer), shown))
}
