//! Measures a setting in a view: a row of the ledger.

use crate::draw::interleaved::Effort;
use crate::draw::session::{Session, SessionError};
use crate::io::image::Image;
use crate::studies::measurement::settings::EXACT;
use crate::studies::measurement::time::{Baseline, MAX_DURATION};
use crate::studies::measurement::view::{self, Drawn, Measured, View};
use crate::studies::study::Setting;
use serde::{Deserialize, Serialize};
use splatgraph_api::Device;

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

/// Measures the setting of `session`, interleaved with the exact settings. Returns the row and its picture.
///
/// # Errors
/// The device fails. A setting that cannot be drawn gives a row with the reason, and no picture.
pub fn measure<D: Device>(
    session: &mut Session<D>,
    exact: Baseline<D>,
    (setting, plan): (&Setting, Option<u64>),
    view: &View,
    effort: Effort,
) -> Result<(Row, Option<Image>), SessionError> {
    let found = match measured(session, exact, setting, view, effort) {
        Ok(found) => found,
        Err(SessionError::Graph(errors)) => Err(errors.text(false).trim().to_owned()),
        Err(error @ (SessionError::Full { .. } | SessionError::NoRoom { .. })) => Err(error.to_string()),
        Err(error) => return Err(error),
    };
    let (found, picture) = match found {
        Ok((found, Drawn { picture, .. })) => (Ok(found), Some(picture)),
        Err(text) => (Err(text), None),
    };
    Ok((Row { setting: setting.name.clone(), plan, camera: view.camera.img_name.clone(), found }, picture))
}

fn measured<D: Device>(
    session: &mut Session<D>,
    exact: Baseline<D>,
    setting: &Setting,
    view: &View,
    effort: Effort,
) -> Result<Result<(Measured, Drawn), String>, SessionError> {
    session.prepare((view.camera.width, view.camera.height), &mut |_| {})?;
    let more = if setting.name == EXACT && effort.rounds > 1 { ROUNDS_OF_EXACT } else { 1 };
    let effort = Effort { rounds: more * effort.rounds, ..effort };
    view::measure(session, exact, view, effort, more * MAX_DURATION)
}
