//! Draws a view with fewer and fewer splats, and measures the time and the error of each step.

use super::choice::{BUDGET, Choice, ranking};
use crate::draw::interleaved::Effort;
use crate::draw::session::{Session, SessionError};
use crate::io::image::Image;
use crate::studies::measurement::error::Error;
use crate::studies::measurement::time::{Baseline, MAX_DURATION, Time};
use crate::studies::measurement::view::{self, Measuring, View};
use crate::studies::study::StudyError;
use serde::{Deserialize, Serialize};
use splatgraph_assets::synth::SynthError;
use std::thread;

/// The measurements of one step of the sweep in one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// The criterion by which the splats are chosen; `None` if all are drawn.
    pub choice: Option<Choice>,
    /// The camera's name.
    pub camera: String,
    /// Number of splats that are kept. [`Choice::Nearest`] instead keeps the same share of the visible splats.
    pub count: u32,
    /// Number of visible splats; `None` if the graph does not count them.
    pub visible: Option<u32>,
    /// Number of drawn splats; `None` if the graph does not count them.
    pub drawn: Option<u32>,
    /// The time of a frame, and its share of the time with all splats; `None` without timestamps.
    pub time: Option<Time>,
    /// The error against the true picture of the whole scene.
    pub error: Error,
    /// Bytes of memory on the device.
    pub gpu_bytes: u64,
}

/// Returns the numbers of splats of a sweep: all, a half, a quarter and so on; at most `steps` numbers, at least one.
pub fn counts(all: u32, steps: u32) -> Vec<u32> {
    let mut counts: Vec<u32> =
        (0..steps.max(1)).map(|step| all.checked_shr(step).unwrap_or(0).max(1)).collect();
    counts.dedup();
    counts
}

/// The inputs of a sweep of one view.
pub struct Sweep<'a> {
    /// The session that draws all splats, prepared at the view's size.
    pub whole: &'a mut Session,
    /// Name or path of the graph.
    pub pipeline: &'a str,
    /// Names and values of the graph's parameters.
    pub set: &'a [(String, String)],
    /// Frame time with all splats, in milliseconds, by which the view's shares are multiplied; set by [`Sweep::all`].
    /// `None` before that, and without timestamps.
    pub ms: Option<f64>,
    /// Parameters that [`Choice::Nearest`] sets besides [`BUDGET`]; `None` if the graph has no budget.
    pub nearest: Option<&'a [(String, String)]>,
}

impl Sweep<'_> {
    /// Measures the view with all splats.
    ///
    /// # Errors
    /// The device fails. The inner error is the reason that the picture cannot be compared.
    pub fn all(
        &mut self,
        view: &View,
        effort: Effort,
    ) -> Result<Result<(Step, Image), String>, SessionError> {
        let mut session = self.whole.beside(self.pipeline, self.set)?;
        let count = session.scene().count();
        let found = self.step(&mut session, None, count, view, effort)?;
        self.ms = found.as_ref().ok().and_then(|(step, _)| Some(step.time.as_ref()?.exact_ms));
        Ok(found)
    }

    /// Measures the view with each of `counts` splats. `each` receives every step with its picture. [`Choice::Nearest`]
    /// is not measured if [`Sweep::nearest`] is `None`.
    ///
    /// # Errors
    /// The device fails, `each` fails, or a part of the scene does not fit in memory. The inner error is the reason
    /// that a picture cannot be compared.
    pub fn steps(
        &mut self,
        choice: Choice,
        counts: &[u32],
        view: &View,
        effort: Effort,
        each: &mut dyn FnMut(Step, Image) -> Result<(), StudyError>,
    ) -> Result<Result<(), String>, StudyError> {
        let all = self.whole.scene().count();
        let ranking = ranking(self.whole.scene(), &view.camera, choice);
        for &count in counts {
            let mut session = match &ranking {
                Some(ranking) => {
                    // Keep the order of the file.
                    let mut chosen = ranking[..count as usize].to_vec();
                    chosen.sort_unstable();
                    let part = self.whole.scene().picked(&chosen).map_err(SynthError::from)?;
                    self.whole.beside_with(part, self.pipeline, self.set)?
                }
                None => {
                    let Some(needed) = self.nearest else { return Ok(Ok(())) };
                    let share = f64::from(count) / f64::from(all);
                    // Later values override earlier ones.
                    let budget = [(BUDGET.to_owned(), share.to_string())];
                    self.whole.beside(self.pipeline, &[self.set, needed, &budget].concat())?
                }
            };
            match self.step(&mut session, Some(choice), count, view, effort)? {
                Ok((step, picture)) => each(step, picture)?,
                Err(text) => return Ok(Err(text)),
            }
        }
        Ok(Ok(()))
    }

    fn step(
        &mut self,
        session: &mut Session,
        choice: Option<Choice>,
        count: u32,
        view: &View,
        effort: Effort,
    ) -> Result<Result<(Step, Image), String>, SessionError> {
        session.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
        let whole = Baseline { session: &mut *self.whole, ms: self.ms };
        let measured = thread::scope(|scope| {
            view::measure(scope, session, whole, view, effort, MAX_DURATION).map(Measuring::finish)
        });
        let (found, drawn) = match measured? {
            Ok(found) => found,
            Err(text) => return Ok(Err(text)),
        };
        let number = |name: &str| drawn.counts.iter().find(|(n, _)| n == name).map(|(_, count)| *count);
        let step = Step {
            choice,
            camera: view.camera.img_name.clone(),
            count,
            visible: number("visible"),
            drawn: number("drawn"),
            time: found.time,
            error: found.error,
            gpu_bytes: found.gpu_bytes,
        };
        Ok(Ok((step, drawn.picture)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_has_half_the_splats_of_the_one_before() {
        assert_eq!(counts(1000, 6), [1000, 500, 250, 125, 62, 31]);
        assert_eq!(counts(3, 6), [3, 1]);
        assert_eq!(counts(1, 40), [1]);
        assert_eq!(counts(9, 0), [9]);
    }
}
