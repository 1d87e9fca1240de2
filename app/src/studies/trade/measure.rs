//! Measures a setting in a view: a row of the ledger.

use crate::draw::interleaved::Effort;
use crate::draw::session::{Built, Session, SessionError};
use crate::io::image::Image;
use crate::io::report::text::hex;
use crate::studies::measurement::settings::EXACT;
use crate::studies::measurement::time::{Baseline, Until, has_range};
use crate::studies::measurement::view::{self, Drawn, Measured, Measuring, View};
use crate::studies::study::{Setting, reason};
use serde::{Deserialize, Serialize};
use splatgraph_framework::plan::Plan;
use std::thread::Scope;

/// A row of the ledger: the measurements of a setting in a view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The setting's name.
    pub setting: String,
    /// Hash of the setting's plans, as 16 hexadecimal digits; `None` if one cannot be built.
    pub plan: Option<String>,
    /// The camera's name.
    pub camera: String,
    /// The measurements, or the reason that the setting cannot be drawn or compared.
    pub found: Result<Measured, String>,
}

/// Factor on the maximum number and duration of rounds in which the exact settings are measured against themselves.
///
/// All rows depend on the noise of the exact settings, so the range must be narrow in each view, not only in the mean.
const ROUNDS_OF_EXACT: u32 = 4;

/// A row whose comparison may still run.
pub struct Pending<'scope> {
    setting: String,
    plan: Option<u64>,
    camera: String,
    found: Result<Measuring<'scope>, String>,
}

impl Pending<'_> {
    /// Makes a row of a setting that cannot be drawn.
    #[cfg(test)]
    pub fn failed(setting: &str, camera: &str) -> Self {
        let found = Err("out of memory".into());
        Pending { setting: setting.into(), plan: None, camera: camera.into(), found }
    }

    /// Returns the milliseconds of the exact settings; `None` if no time was measured.
    pub fn exact_ms(&self) -> Option<f64> {
        Some(self.found.as_ref().ok()?.time.as_ref()?.exact_ms)
    }

    /// Waits for the comparison. Returns the row and its picture; `None` if it cannot be drawn or compared.
    pub fn finish(self) -> (Row, Option<Image>) {
        let Pending { setting, plan, camera, found } = self;
        let (found, picture) = match found.and_then(Measuring::finish) {
            Ok((found, Drawn { picture, .. })) => (Ok(found), Some(picture)),
            Err(text) => (Err(text), None),
        };
        (Row { setting, plan: plan.map(hex), camera, found }, picture)
    }
}

/// Maximum number of pending rows: each holds its picture, and may run a thread.
pub const MAX_PENDING: usize = 8;

/// The sessions that measure a setting in several views.
pub struct Sessions<'a> {
    exact: &'a mut Session,
    session: &'a mut Session,
    setting: &'a Setting,
    plan: Option<u64>,
    built: Built,
    /// Number of views over which times are averaged.
    views: usize,
    /// Value of [`Session::growths`] when the setting was loaded; `None` before the first view.
    loaded: Option<u32>,
}

impl<'a> Sessions<'a> {
    /// Stores the sessions; the setting is loaded with the first view. `plan` is the hash of its plans, and `built` the
    /// plans; both `None` if they are unknown. Times are averaged over `views` views.
    pub fn new(
        exact: &'a mut Session,
        session: &'a mut Session,
        setting: &'a Setting,
        (plan, built): (Option<u64>, Option<&Built>),
        views: usize,
    ) -> Sessions<'a> {
        let built = built.cloned().unwrap_or_default();
        Sessions { exact, session, setting, plan, built, views, loaded: None }
    }

    /// Measures the setting in a view, interleaved with the exact settings. `exact_ms` is [`Baseline::ms`].
    ///
    /// # Errors
    /// The device fails, or rejects the plan of the exact settings. If the setting cannot be drawn, the result is
    /// instead a row with the reason: see [`reason`].
    pub fn measure<'scope>(
        &mut self,
        scope: &'scope Scope<'scope, '_>,
        view: &'scope View,
        effort: Effort,
        exact_ms: Option<f64>,
    ) -> Result<Pending<'scope>, SessionError> {
        let Sessions { exact, session, setting, plan, built, views, loaded } = self;
        exact.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
        // Reload after a list grew for the previous view, so that its memory does not count in this view.
        if *loaded != Some(session.growths()) {
            session.set_planned(&setting.pipeline, &setting.set, built);
        }
        *loaded = Some(session.growths());
        let baseline = Baseline { session: exact, ms: exact_ms };
        let found = match measured(scope, session, baseline, setting, view, (effort, *views)) {
            Ok(found) => Ok(found),
            Err(error) => Err(reason(error)?),
        };
        let (setting, camera) = (setting.name.clone(), view.camera.img_name.clone());
        Ok(Pending { setting, plan: *plan, camera, found })
    }

    /// Returns the plan that was measured last; `None` if it could not be built.
    pub fn plan(&self) -> Option<&Plan> {
        self.session.plan()
    }
}

fn measured<'scope>(
    scope: &'scope Scope<'scope, '_>,
    session: &mut Session,
    exact: Baseline,
    setting: &Setting,
    view: &'scope View,
    (effort, views): (Effort, usize),
) -> Result<Measuring<'scope>, SessionError> {
    session.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
    let until = Until::narrow(views);
    if setting.name != EXACT || !has_range(effort) {
        return view::measure(scope, session, exact, view, effort, until);
    }
    let effort = Effort { rounds: ROUNDS_OF_EXACT * effort.rounds, ..effort };
    let until = Until { views: 1, longest: ROUNDS_OF_EXACT * until.longest };
    view::measure(scope, session, exact, view, effort, until)
}
