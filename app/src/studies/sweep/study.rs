//! Sweeps a scene: draws every view with fewer and fewer splats, then the approach of the first camera.

use super::approach::{self, Closer};
use super::choice::{BUDGET, Choice, for_nearest};
use super::measure::{Step, Sweep, counts};
use super::page::{Shown, SweepResult};
use crate::draw::interleaved::Frames;
use crate::draw::session::Session;
use crate::io::image::Image;
use crate::studies::measurement::time::FRAMES_DIVISOR;
use crate::studies::measurement::view::View;
use crate::studies::study::{Listener, Steps, StudyError, Subject};

/// The parameters of a sweep.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Name or path of the graph.
    pub pipeline: String,
    /// Names and values of the graph's parameters.
    pub set: Vec<(String, String)>,
    /// Number of steps, each with half the splats of the previous one.
    pub steps: u32,
    /// Numbers of frames and rounds.
    pub frames: Frames,
}

/// Measures quality and time with fewer and fewer splats. Also returns the pictures of the first view.
///
/// # Errors
/// The graph has errors, a picture cannot be compared, the device fails, an exact picture or a part of the scene does
/// not fit in memory, or the listener cancels.
pub fn study(
    subject: &Subject,
    wanted: &Wanted,
    listener: &mut dyn Listener,
) -> Result<(SweepResult, Vec<Shown>), StudyError> {
    let mut study = Study::new(subject, wanted, listener)?;
    let (mut steps, mut shown) = (Vec::new(), Vec::new());
    for at in 0..subject.cameras.len() {
        let (of_view, pictures) = study.view(subject, wanted, at, listener)?;
        steps.extend(of_view);
        if at == 0 {
            shown = pictures;
        }
    }
    let closer = study.approach(subject, wanted, listener)?;
    Ok((study.empty(subject, wanted).with(steps, closer), shown))
}

/// State of a sweep.
pub struct Study {
    whole: Session,
    counts: Vec<u32>,
    /// The parameters that [`Choice::Nearest`] sets; `None` if the graph has no budget.
    nearest: Option<Vec<(String, String)>>,
    /// True if the graph stops blending a pixel once it is opaque.
    stops: bool,
}

impl Study {
    /// Reads the graph, and finds out which criteria it supports.
    ///
    /// # Errors
    /// The subject has no camera, the graph has errors, or the device fails.
    pub fn new(subject: &Subject, wanted: &Wanted, listener: &mut dyn Listener) -> Result<Study, StudyError> {
        let first = subject.first()?;
        let pipeline = wanted.pipeline.as_str();
        let mut whole = subject.session(pipeline, &wanted.set)?;
        let controls = whole.controls((first.width, first.height))?;
        let nearest = for_nearest(&controls);
        if nearest.is_none() {
            listener
                .say(&format!("{pipeline}: no parameter `{BUDGET}`: the nearest splats are not measured"));
        }
        let stops = controls.iter().any(|control| control.param.name == "stop");
        let counts = counts(subject.scene.count(), wanted.steps);
        whole.prepare((first.width, first.height), &mut |_| {})?;
        whole.settings_without_effect().iter().for_each(|line| listener.say(line));
        Ok(Study { whole, counts, nearest, stops })
    }

    /// Returns the session that draws all splats.
    pub fn session(&self) -> &Session {
        &self.whole
    }

    /// Measures a view, given as the index of one of the subject's cameras. Also returns the pictures.
    ///
    /// # Errors
    /// A picture cannot be compared, the device fails, an exact picture or a part of the scene does not fit in memory,
    /// or the listener cancels.
    pub fn view(
        &mut self,
        subject: &Subject,
        wanted: &Wanted,
        at: usize,
        listener: &mut dyn Listener,
    ) -> Result<(Vec<Step>, Vec<Shown>), StudyError> {
        let camera = &subject.cameras[at];
        let (pipeline, set) = (wanted.pipeline.as_str(), wanted.set.as_slice());
        // Without the true order: indices in a part of the scene are not those in the whole scene.
        let view = View::exact(self.whole.scene(), camera)?;
        self.whole.prepare((camera.width, camera.height), &mut |_| {})?;
        let effort = wanted.frames.choose(&mut self.whole, camera, FRAMES_DIVISOR)?;
        let mut progress = self.progress(subject, at, listener);
        let (mut steps, mut shown): (Vec<Step>, Vec<Shown>) = (Vec::new(), Vec::new());
        let nearest = self.nearest.as_deref();
        let mut sweep = Sweep { whole: &mut self.whole, pipeline, set, ms: None, nearest };
        let refused = |why: String| StudyError::of(&camera.img_name)(StudyError::Input(why));
        let mut keep = |step: Step, picture: Image| -> Result<(), StudyError> {
            progress.next(&format!("{}, {} splats", camera.img_name, step.count))?;
            shown.push(Shown { choice: step.choice, count: step.count, picture });
            steps.push(step);
            Ok(())
        };
        let (step, picture) = sweep.all(&view, effort)?.map_err(refused)?;
        keep(step, picture)?;
        for choice in Choice::ALL {
            sweep.steps(choice, &self.counts[1..], &view, effort, &mut keep)?.map_err(refused)?;
        }
        Ok((steps, shown))
    }

    /// Measures the approach of the first camera.
    ///
    /// # Errors
    /// The device fails, an exact picture does not fit in memory, or the listener cancels.
    pub fn approach(
        &mut self,
        subject: &Subject,
        wanted: &Wanted,
        listener: &mut dyn Listener,
    ) -> Result<Vec<Closer>, StudyError> {
        let first = subject.first()?;
        let closer = approach::cameras(self.whole.scene(), first);
        self.whole.prepare((first.width, first.height), &mut |_| {})?;
        let effort = wanted.frames.choose(&mut self.whole, first, FRAMES_DIVISOR)?;
        let mut progress = self.progress(subject, subject.cameras.len(), listener);
        approach::measure(&mut self.whole, &closer, self.stops, effort, &mut progress)
    }

    /// Returns the sweep without measurements.
    pub fn empty(&self, subject: &Subject, wanted: &Wanted) -> SweepResult {
        SweepResult {
            scene: subject.name.clone(),
            splats: subject.scene.count(),
            pipeline: wanted.pipeline.clone(),
            device: subject.device_name(),
            steps: Vec::new(),
            closer: Vec::new(),
            fit: None,
        }
    }

    /// Creates the step counter of the whole study, with the steps of `views` views already done.
    fn progress<'a>(&self, subject: &Subject, views: usize, listener: &'a mut dyn Listener) -> Steps<'a> {
        let per_view = 1 + Choice::ALL.len() * (self.counts.len() - 1);
        let of = per_view * subject.cameras.len() + approach::STEPS.len();
        let mut progress = Steps::new(listener, "sweeping", of);
        progress.skip(views * per_view);
        progress
    }
}
