//! Measures a setting in a view: a row of the ledger.

use crate::draw::interleaved::Effort;
use crate::draw::session::{Session, SessionError};
use crate::io::image::Image;
use crate::studies::measurement::settings::EXACT;
use crate::studies::measurement::time::{Baseline, MAX_DURATION};
use crate::studies::measurement::view::{self, Drawn, Measured, Measuring, View};
use crate::studies::study::Setting;
use serde::{Deserialize, Serialize};
use splatgraph_api::Device;
use std::thread::Scope;

/// A row of the ledger: the measurements of a setting in a view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The setting's name.
    pub setting: String,
    /// Hash of the setting's plans; `None` if one cannot be built.
    pub plan: Option<u64>,
    /// The camera's name.
    pub camera: String,
    /// The measurements, or the reason that the setting cannot be drawn.
    pub found: Result<Measured, String>,
}

/// Factor on the rounds when the exact settings are measured against themselves: all rows depend on their noise.
const ROUNDS_OF_EXACT: u32 = 4;

/// A row whose picture may still be compared.
pub struct Pending<'scope> {
    setting: String,
    plan: Option<u64>,
    camera: String,
    found: Result<Measuring<'scope>, String>,
}

impl Pending<'_> {
    /// Milliseconds of the exact settings; `None` if no time was measured.
    pub fn exact_ms(&self) -> Option<f64> {
        Some(self.found.as_ref().ok()?.time.as_ref()?.exact_ms)
    }

    /// Waits for the comparison. Returns the row and its picture; a setting that cannot be drawn has none.
    pub fn finish(self) -> (Row, Option<Image>) {
        let Pending { setting, plan, camera, found } = self;
        let (found, picture) = match found.and_then(Measuring::finish) {
            Ok((found, Drawn { picture, .. })) => (Ok(found), Some(picture)),
            Err(text) => (Err(text), None),
        };
        (Row { setting, plan, camera, found }, picture)
    }
}

/// The sessions that measure settings.
pub struct Sessions<'a, D> {
    /// Draws the exact settings.
    pub exact: &'a mut Session<D>,
    /// Draws the settings that are measured.
    pub session: &'a mut Session<D>,
}

impl<D: Device> Sessions<'_, D> {
    /// Measures a setting, interleaved with the exact settings.
    ///
    /// `loaded` holds the growths of `session` at which the setting was loaded; `None` for the setting's first view. A
    /// list that grew for the previous view is reloaded, so that its memory does not count in this view. `exact_ms` is
    /// [`Baseline::ms`].
    ///
    /// # Errors
    /// The device fails. A setting that cannot be drawn gives a row with the reason.
    pub fn measure<'scope>(
        &mut self,
        scope: &'scope Scope<'scope, '_>,
        (setting, plan): (&Setting, Option<u64>),
        (view, effort): (&'scope View, Effort),
        exact_ms: Option<f64>,
        loaded: &mut Option<u32>,
    ) -> Result<Pending<'scope>, SessionError> {
        let Sessions { exact, session } = self;
        exact.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
        if *loaded != Some(session.growths()) {
            session.set_graph(&setting.pipeline, &setting.set);
        }
        *loaded = Some(session.growths());
        let baseline = Baseline { session: exact, ms: exact_ms };
        let found = match measured(scope, session, baseline, setting, view, effort) {
            Ok(found) => Ok(found),
            Err(SessionError::Graph(errors)) => Err(errors.text(false).trim().to_owned()),
            Err(error @ (SessionError::Full { .. } | SessionError::NoRoom { .. })) => Err(error.to_string()),
            Err(error) => return Err(error),
        };
        Ok(Pending { setting: setting.name.clone(), plan, camera: view.camera.img_name.clone(), found })
    }
}

fn measured<'scope, D: Device>(
    scope: &'scope Scope<'scope, '_>,
    session: &mut Session<D>,
    exact: Baseline<D>,
    setting: &Setting,
    view: &'scope View,
    effort: Effort,
) -> Result<Measuring<'scope>, SessionError> {
    session.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
    let more = if setting.name == EXACT && effort.rounds > 1 { ROUNDS_OF_EXACT } else { 1 };
    let effort = Effort { rounds: more * effort.rounds, ..effort };
    view::measure(scope, session, exact, view, effort, more * MAX_DURATION)
}
