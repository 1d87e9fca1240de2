//! Compares A and B: reads both pictures back, and computes their differences on another thread.
//!
//! A comparison starts once both viewports draw the requested state. Its result is out of date once the camera, the
//! background, a scene, a graph or a setting changes.

use super::comparing::{Compared, Differences, Step};
use super::{Viewer, Viewport};
use crate::draw::session::image_of;
use crate::view::events::{Event, RendererId};
use crate::view::paint::Mode;
use splatgraph_api::Pixels;
use splatgraph_reference::metrics::{self, Comparison};

impl Viewer {
    /// Compares the next pictures of A and B. The result is reported as an event and by [`Viewer::comparison`]; a
    /// failure, such as a hidden B, only as an event.
    ///
    /// Does nothing without B, or while a comparison is in progress.
    pub fn measure(&mut self) {
        if self.b.is_some() && !self.is_comparing() {
            self.comparing.step = Step::Waiting;
        }
    }

    /// Returns true from [`Viewer::measure`] until the result or a failure is reported.
    pub fn is_comparing(&self) -> bool {
        self.comparing.step != Step::No || self.comparing.worker.busy()
    }

    /// Returns the newest comparison of A and B; `None` before the first, and after [`Viewer::forget_comparison`].
    pub fn comparison(&self) -> Option<&Differences> {
        self.comparing.newest.as_ref().map(|(found, _)| found)
    }

    /// Returns true if the newest comparison has the current camera, background, scenes, graphs and settings; false
    /// without one.
    pub fn comparison_is_current(&self) -> bool {
        self.comparing.newest.as_ref().is_some_and(|(_, of)| *of == self.compares_now())
    }

    /// Drops the newest comparison.
    pub fn forget_comparison(&mut self) {
        self.comparing.newest = None;
    }

    fn compares_now(&self) -> Compared {
        let side =
            |id, viewport: &Viewport| (viewport.renderer.choice().clone(), self.scene_of(id).identity());
        let (width, height) = self.asked;
        Compared {
            camera: self.navigation.camera(width.max(1), height.max(1)),
            background: self.background,
            sides: [
                Some(side(RendererId::A, &self.a)),
                self.b.as_ref().map(|viewport| side(RendererId::B, viewport)),
            ],
        }
    }

    /// Requests a read-back of both pictures once both viewports draw the requested state. If B is hidden, proceeds at
    /// once, so that [`Viewer::compare_pictures`] reports it.
    pub(super) fn start_comparison(&mut self) {
        let asks = match self.comparing.step {
            Step::Waiting => self.b.is_none() || self.compare == Mode::A || !self.changes_soon(),
            // Until both reads are submitted, the camera may still move; the state is recorded again below.
            Step::Reading => self.viewports().any(Viewport::wants_picture),
            Step::No => false,
        };
        if !asks {
            return;
        }
        if self.comparing.step == Step::Waiting {
            self.comparing.step = Step::Reading;
            self.viewports_mut().for_each(Viewport::want_picture);
        }
        self.comparing.of = Some(self.compares_now());
    }

    pub(super) fn take_comparison(&mut self) {
        match self.comparing.worker.take() {
            Some(Ok(found)) => {
                let (Comparison { psnr_db, ssim, worst, .. }, _) = found;
                let (psnr, worst) = (found.0.psnr(), worst.difference);
                self.events.push(Event::Compared { psnr, ssim, worst, identical: psnr_db.is_none() });
                self.comparing.newest = self.comparing.of.take().map(|of| (found, of));
            }
            Some(Err(error)) => self.cannot_compare(&error),
            None => {}
        }
    }

    fn cannot_compare(&mut self, why: &str) {
        self.comparing.step = Step::No;
        self.events.push(Event::Problem { text: format!("A and B cannot be compared: {why}") });
    }

    /// Compares both pictures on another thread, once they have been read back. Gives up, and reports the reason, if B
    /// is hidden or a picture cannot be drawn or read.
    pub(super) fn compare_pictures(&mut self) {
        if self.comparing.step != Step::Reading {
            return;
        }
        let pictures = match self.b.as_mut().filter(|_| self.compare != Mode::A) {
            None => Err("B is not shown".to_owned()),
            Some(b) if self.a.has_picture() && b.has_picture() => {
                let (Some(a), Some(b)) = (self.a.take_picture(), b.take_picture()) else { return };
                a.and_then(|a| Ok((a, b?)))
            }
            // Do not wait for a picture that cannot be drawn.
            Some(b) => match [&self.a, b].into_iter().find_map(|viewport| viewport.renderer.problem(false)) {
                Some(problem) => Err(problem.lines().next().unwrap_or_default().to_owned()),
                None => return,
            },
        };
        let (a, b) = match pictures {
            Ok(pictures) => pictures,
            Err(why) => {
                self.viewports_mut().for_each(Viewport::forget_picture);
                return self.cannot_compare(&why);
            }
        };
        self.comparing.step = Step::No;
        if let Err(error) = self.comparing.worker.start(move |_| Some(differences(&a, &b))) {
            self.cannot_compare(&error);
        }
    }
}

/// Computes the differences of two pictures, in display-encoded colours clamped to 0..1; also returns their size.
fn differences(a: &Pixels, b: &Pixels) -> Result<Differences, String> {
    let image = |pixels| image_of(pixels).map_err(|error| error.to_string());
    let (a, b) = (image(a)?.clamped(), image(b)?.clamped());
    let found = metrics::compare((&a).into(), (&b).into()).map_err(|error| error.to_string())?;
    Ok((found, [a.width, a.height]))
}
