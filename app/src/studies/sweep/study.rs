//! Sweeps a scene: draws every view with fewer and fewer splats, then the approach of the first camera.

use super::approach::{self, Closer};
use super::choice::{BUDGET, Choice, for_nearest, ranking};
use super::measure::{Step, counts};
use super::page::{Origin, Shown, SweepResult};
use crate::draw::interleaved::{self, Frames};
use crate::draw::session::Session;
use crate::studies::measurement::time::{Baseline, FRAMES_DIVISOR, Until};
use crate::studies::measurement::view::{self, Measuring, View};
use crate::studies::provenance::Provenance;
use crate::studies::study::{Listener, Steps, StudyError, Subject};
use splatgraph_assets::synth::SynthError;
use std::{iter, thread};

/// The parameters of a sweep.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Name or path of the graph.
    pub pipeline: String,
    /// Names and values of the graph's parameters.
    pub set: Vec<(String, String)>,
    /// Maximum number of steps: the first has all splats, and each other half as many as the previous one, at least 1.
    pub steps: u32,
    /// Numbers of frames and rounds.
    pub frames: Frames,
}

/// Measures quality and time with fewer and fewer splats. Also returns the pictures of the first view.
///
/// # Errors
/// The subject has no camera or none that sees a splat, the graph has errors, a picture cannot be compared, the device
/// fails, an exact picture or a part of the scene does not fit in memory, or the listener cancels.
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
    /// The parameters that [`Choice::Nearest`] sets besides [`BUDGET`]; `None` if the graph has no budget.
    nearest: Option<Vec<(String, String)>>,
}

impl Study {
    /// Prepares the graph with all splats, and finds out which criteria it supports.
    ///
    /// Tells the listener if the nearest splats cannot be measured, and which parameters have no effect.
    ///
    /// # Errors
    /// The subject has no camera or none that sees a splat, an exact picture does not fit in memory, the graph has
    /// errors, or the device fails.
    pub fn new(subject: &Subject, wanted: &Wanted, listener: &mut dyn Listener) -> Result<Study, StudyError> {
        let first = subject.first()?;
        subject.check_views(listener)?;
        let pipeline = wanted.pipeline.as_str();
        let mut whole = subject.session(pipeline, &wanted.set)?;
        let controls = whole.controls((first.width, first.height))?;
        let nearest = for_nearest(&controls);
        if nearest.is_none() {
            listener
                .say(&format!("{pipeline}: no parameter `{BUDGET}`: the nearest splats are not measured"));
        }
        let counts = counts(subject.scene.count(), wanted.steps);
        whole.prepare((first.width, first.height), &mut |_| {})?;
        whole.settings_without_effect().iter().for_each(|line| listener.say(line));
        Ok(Study { whole, counts, nearest })
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
        // Without the true order: indices in a part of the scene are not those in the whole scene.
        let view = View::exact(self.whole.scene(), camera)?;
        self.whole.prepare((camera.width, camera.height), &mut |_| {})?;
        let effort = wanted.frames.choose(&mut self.whole, camera, FRAMES_DIVISOR)?;
        let mut progress = self.progress(subject, at, listener);
        let (mut steps, mut shown): (Vec<Step>, Vec<Shown>) = (Vec::new(), Vec::new());
        let refused = |why: String| StudyError::of(&camera.img_name)(StudyError::Input(why));
        let all = [self.whole.scene().count()];
        // Frame time with all splats, by which the shares are multiplied.
        let mut whole_ms = None;
        let until = Until::narrow(subject.cameras.len());
        for choice in iter::once(None).chain(Choice::ALL.map(Some)) {
            let ranking = choice.and_then(|choice| ranking(self.whole.scene(), camera, choice));
            let has_own_plan = choice == Some(Choice::Nearest) && self.nearest_has_own_plan();
            if has_own_plan {
                // Otherwise, the shares and the curve would compare two plans.
                self.whole.set_graph(&wanted.pipeline, &self.with_budget(wanted, all[0]).unwrap_or_default());
                self.whole.prepare((camera.width, camera.height), &mut |_| {})?;
                interleaved::frame(&mut self.whole, camera)?;
                whole_ms = None;
            }
            let counts = match choice {
                None => &all[..],
                Some(_) => &self.counts[usize::from(!has_own_plan)..],
            };
            for &count in counts {
                let session = self.session_with(wanted, choice, ranking.as_deref(), count)?;
                let Some(mut session) = session else { break };
                session.prepare((camera.width, camera.height), &mut |_| {})?;
                let whole = Baseline { session: &mut self.whole, ms: whole_ms };
                let measured = thread::scope(|scope| {
                    view::measure(scope, &mut session, whole, &view, effort, until).map(Measuring::finish)
                });
                let (found, drawn) = measured?.map_err(refused)?;
                whole_ms = whole_ms.or(found.time.as_ref().map(|time| time.exact_ms));
                progress.next(&format!("{}, {count} splats", camera.img_name))?;
                let number =
                    |name: &str| drawn.counts.iter().find(|(n, _)| n == name).map(|(_, count)| *count);
                steps.push(Step {
                    choice,
                    camera: camera.img_name.clone(),
                    count,
                    visible: number("visible"),
                    drawn: number("drawn"),
                    time: found.time,
                    error: found.error,
                    gpu_bytes: found.gpu_bytes,
                    of_last_frame: found.of_last_frame,
                });
                shown.push(Shown { choice, count, picture: drawn.picture });
            }
        }
        if self.nearest_has_own_plan() {
            self.whole.set_graph(&wanted.pipeline, &wanted.set);
        }
        Ok((steps, shown))
    }

    /// Returns true if the nearest splats are drawn by another plan than the others, which then needs its own step and
    /// baseline with all splats.
    fn nearest_has_own_plan(&self) -> bool {
        self.nearest.as_ref().is_some_and(|needed| !needed.is_empty())
    }

    /// Lists the parameters that draw the nearest `count` splats; `None` if the graph has no budget.
    fn with_budget(&self, wanted: &Wanted, count: u32) -> Option<Vec<(String, String)>> {
        let share = f64::from(count) / f64::from(self.whole.scene().count());
        // Later values override earlier ones.
        let budget = [(BUDGET.to_owned(), share.to_string())];
        Some([wanted.set.as_slice(), self.nearest.as_ref()?, &budget].concat())
    }

    /// Opens a session that draws `count` splats: the first of `ranking`, or the nearest, or all without a criterion.
    /// Returns `None` for the nearest if the graph has no budget.
    fn session_with(
        &self,
        wanted: &Wanted,
        choice: Option<Choice>,
        ranking: Option<&[u32]>,
        count: u32,
    ) -> Result<Option<Session>, StudyError> {
        let Wanted { pipeline, set, .. } = wanted;
        Ok(Some(match (choice, ranking) {
            (None, _) => self.whole.beside(pipeline, set)?,
            (_, Some(ranking)) => {
                // Keep the order of the file.
                let mut chosen = ranking[..count as usize].to_vec();
                chosen.sort_unstable();
                let part = self.whole.scene().picked(&chosen).map_err(SynthError::from)?;
                self.whole.beside_with(part, pipeline, set)?
            }
            (Some(_), None) => {
                let Some(set) = self.with_budget(wanted, count) else { return Ok(None) };
                self.whole.beside(pipeline, &set)?
            }
        }))
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
        approach::measure(&mut self.whole, &closer, effort, &mut progress)
    }

    /// Returns the sweep without measurements.
    pub fn empty(&self, subject: &Subject, wanted: &Wanted) -> SweepResult {
        let Wanted { pipeline, set, frames, .. } = wanted;
        SweepResult {
            command: String::new(),
            origin: Origin {
                provenance: Provenance::of(subject),
                pipeline: pipeline.clone(),
                set: set.clone(),
                rounds: frames.rounds,
                frames: frames.frames,
            },
            missing: Vec::new(),
            steps: Vec::new(),
            closer: Vec::new(),
            fit: None,
        }
    }

    /// Creates the step counter of the whole study, with the steps of `views` views already done.
    fn progress<'a>(&self, subject: &Subject, views: usize, listener: &'a mut dyn Listener) -> Steps<'a> {
        let of_nearest = usize::from(self.nearest_has_own_plan());
        let per_view = 1 + Choice::ALL.len() * (self.counts.len() - 1) + of_nearest;
        let of = per_view * subject.cameras.len() + approach::STEPS.len();
        let mut progress = Steps::new(listener, "sweeping", of);
        progress.skip(views * per_view);
        progress
    }
}
