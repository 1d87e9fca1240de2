//! Describes what a scene needs, and searches for the cheapest setting within a budget.

use super::harmonics::{self, Band};
use super::search::{Best, Budget, Tried, best, combinations, own_share};
use crate::draw::interleaved::{Effort, Frames};
use crate::draw::keys::{self, Need};
use crate::draw::session::{Session, SessionError};
use crate::studies::measurement::plans::{Planned, Plans, to_measure};
use crate::studies::measurement::settings::{self, EXACT};
use crate::studies::measurement::time::FRAMES_DIVISOR;
use crate::studies::measurement::view::{View, start};
use crate::studies::study::{Listener, Setting, Steps, StudyError, Subject};
use crate::studies::trade::measure::{MAX_PENDING, Pending, Row, Sessions};
use serde::Serialize;
use splatgraph_assets::{Camera, Report, Scene};
use splatgraph_framework::lower::Control;
use splatgraph_framework::plan::Plan;
use std::collections::VecDeque;
use std::sync::mpsc::{self, Receiver};
use std::thread::{self, Scope};

/// Properties of a scene that settings depend on.
#[derive(Debug, Serialize)]
pub struct Description {
    /// Dropped splats and unusual values of the scene's file.
    pub report: Report,
    /// The width that depth keys need, for each mapping of depth to keys.
    pub keys: Vec<Need>,
    /// Contribution of each band of harmonics to the colours.
    pub bands: Vec<Band>,
}

/// Describes a scene. In each view, a depth key may leave `errors` pairs of overlapping splats in the wrong order.
pub fn describe(scene: &Scene, cameras: &[Camera], errors: u64) -> Description {
    Description {
        report: Report::new(scene, cameras),
        keys: keys::needs(scene, cameras, errors),
        bands: harmonics::bands(scene),
    }
}

/// The parameters of a search.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The graph whose parameters are changed.
    pub pipeline: String,
    /// Names and values of the parameters that are the same in every setting.
    pub set: Vec<(String, String)>,
    /// Limits for the advised setting.
    pub budget: Budget,
    /// Numbers of frames and rounds.
    pub frames: Frames,
}

/// The settings that a search measured, and its budget.
#[derive(Clone, Debug, PartialEq)]
pub struct Advice {
    /// The limits of the request.
    pub budget: Budget,
    /// The settings that were drawn and measured.
    pub tried: Vec<Tried>,
    /// Names of the settings with a saving within the noise; they were not combined.
    pub unsure: Vec<String>,
}

impl Advice {
    /// Chooses the best setting within the budget.
    pub fn best(&self) -> Best<'_> {
        best(&self.tried, &self.budget)
    }
}

/// Maximum number of combinations to draw, and the number within the budget at which the search ends.
const DRAWN: (usize, usize) = (12, 3);

/// Measures one parameter at a time and every preset, then the most promising combinations.
///
/// # Errors
/// The subject has no camera or none that sees a splat, the graph has errors, the device fails, an exact picture does
/// not fit in memory, or the listener cancels.
pub fn study(
    subject: &Subject,
    needs: &[Need],
    wanted: &Wanted,
    listener: &mut dyn Listener,
) -> Result<Advice, StudyError> {
    let (cameras, first) = (&subject.cameras, subject.first()?);
    subject.check_views(listener)?;
    let mut session = subject.session(&wanted.pipeline, &wanted.set)?;
    let controls = session.controls((first.width, first.height))?;
    let mut singles = settings::measured(&wanted.pipeline, &wanted.set, &controls);
    let advised = advised_keys(&singles[0], needs);
    singles.extend(advised.filter(|advised| singles.iter().all(|other| other.name != advised.name)));
    let mut exact = subject.session(&singles[0].pipeline, &singles[0].set)?;
    exact.prepare((first.width, first.height), &mut |_| {})?;
    let view = |camera| Ok(View::exact(&subject.scene, camera)?);
    // The CPU draws the exact pictures while plans are built.
    let (planned, views) = thread::scope(|scope| -> Result<_, StudyError> {
        let views = ahead(scope, cameras.iter().map(view))?;
        let planned = to_measure(singles, &mut exact, cameras, &|_| true, listener)?;
        let mut steps = Steps::new(listener, "drawing exactly", cameras.len());
        let drawn = cameras.iter().map(|camera| steps.next(&camera.img_name)).zip(&views);
        let drawn: Result<Vec<View>, StudyError> = drawn.map(|(step, view)| step.and(view)).collect();
        Ok((planned, drawn?))
    })?;
    let Planned { settings: singles, built, pipelines: _pipelines, .. } = planned;
    let effort = wanted.frames.choose(&mut exact, first, FRAMES_DIVISOR)?;

    let mut steps = Steps::new(listener, "measuring", singles.len() + DRAWN.0);
    let mut tried = Vec::new();
    let mut exact_ms = vec![None; views.len()];
    let mut floor = None;
    let mut measured = |settings: &[&Setting]| {
        let sessions = (&mut session, &mut exact);
        measured(sessions, &mut exact_ms, (settings, &built), (&views, effort), &mut steps)
    };
    let settings: Vec<&Setting> = singles.iter().map(|(setting, _)| setting).collect();
    for (setting, rows) in settings.iter().zip(measured(&settings)?) {
        let Some(rows) = rows else { continue };
        if setting.name == EXACT {
            // Measured against themselves, the exact settings give the noise floor.
            floor = own_share(&rows).and_then(|share| share.floor());
        }
        tried.extend(Tried::new(setting, &rows, floor));
    }
    let mut within = 0;
    let (combined, unsure) = combinations(&tried, &wanted.budget);
    let new = combined.iter().filter(|setting| singles.iter().all(|(other, _)| other.name != setting.name));
    for setting in new.take(DRAWN.0) {
        let rows = measured(&[setting])?.pop().flatten();
        let found = rows.and_then(|rows| Tried::new(setting, &rows, floor));
        within += usize::from(found.as_ref().is_some_and(|found| wanted.budget.allows(found) == Some(true)));
        tried.extend(found);
        if within == DRAWN.1 {
            break;
        }
    }
    let mut sizes: Vec<(u32, u32)> = cameras.iter().map(|camera| (camera.width, camera.height)).collect();
    sizes.sort_unstable();
    sizes.dedup();
    for found in tried.iter_mut().filter(|found| found.setting.pipeline == wanted.pipeline) {
        shorten(&mut found.setting, &mut session, &sizes)?;
    }
    Ok(Advice { budget: wanted.budget, tried, unsure })
}

/// Computes items on a thread, in order. The thread ends after the current item when the receiver is dropped.
///
/// # Errors
/// The thread cannot be started.
fn ahead<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    items: impl Iterator<Item = T> + Send + 'scope,
) -> Result<Receiver<T>, SessionError> {
    let (send, receive) = mpsc::channel();
    start(scope, move || items.into_iter().try_for_each(|item| send.send(item)))?;
    Ok(receive)
}

/// Returns the exact settings with the narrowest sufficient keys for their depth mapping.
///
/// `None` if their keys already have that width, if no width suffices, or if the graph lacks `key_map` or `key_bits`.
fn advised_keys(exact: &Setting, needs: &[Need]) -> Option<Setting> {
    let of = |name: &str| exact.set.iter().find(|(own, _)| own == name).map(|(_, value)| value.as_str());
    let bits = needs.iter().find(|need| Some(need.map.name()) == of("key_map"))?.bits?;
    if of("key_bits")?.parse() == Ok(bits) {
        return None;
    }
    let mut set = exact.set.clone();
    set.iter_mut().filter(|(name, _)| name == "key_bits").for_each(|(_, value)| *value = bits.to_string());
    Some(Setting { name: format!("key_bits = {bits}"), pipeline: exact.pipeline.clone(), set })
}

/// Removes the values that are the graph's defaults for all `sizes` of pictures, so that the advised command is short.
///
/// A default may depend on other parameters, so it is computed beside the setting's other values. Each removed value is
/// then the default beside the remaining values, too.
fn shorten(setting: &mut Setting, session: &mut Session, sizes: &[(u32, u32)]) -> Result<(), SessionError> {
    session.set_graph(&setting.pipeline, &setting.set);
    let controls: Vec<Vec<Control>> =
        sizes.iter().map(|size| session.controls(*size)).collect::<Result<_, _>>()?;
    let is_changed = |(name, value): &(String, String)| {
        let mut own = controls.iter().flatten().filter(|control| control.param.name == *name);
        own.any(|control| control.unset.to_string() != *value)
    };
    setting.set.retain(is_changed);
    Ok(())
}

/// Measures settings in every view. `exact_ms` caches the exact settings' milliseconds of each view.
///
/// `None` for a setting that draws from the previous frame: the second frame of a still view does not show its error.
fn measured(
    (session, exact): (&mut Session, &mut Session),
    exact_ms: &mut [Option<f64>],
    (settings, built): (&[&Setting], &Plans),
    (views, effort): (&[View], Effort),
    steps: &mut Steps,
) -> Result<Vec<Option<Vec<Row>>>, StudyError> {
    thread::scope(|scope| {
        let mut all: Vec<Option<Vec<Row>>> = Vec::new();
        // Rows are compared while the next ones are drawn.
        let mut pending = VecDeque::new();
        let finish = |all: &mut [Option<Vec<Row>>], (of, row): (usize, Pending)| {
            all[of].as_mut().map(|rows| rows.push(row.finish().0))
        };
        for (of, setting) in settings.iter().enumerate() {
            steps.next(&setting.name)?;
            all.push(Some(Vec::new()));
            let built = built.get(&setting.name);
            let mut sessions = Sessions::new(exact, session, setting, (None, built), views.len());
            for (view, exact_ms) in views.iter().zip(&mut *exact_ms) {
                let row = sessions.measure(scope, view, effort, *exact_ms)?;
                if sessions.plan().is_some_and(Plan::carries_state) {
                    all[of] = None;
                    break;
                }
                *exact_ms = exact_ms.or(row.exact_ms());
                pending.push_back((of, row));
                if pending.len() == MAX_PENDING {
                    pending.pop_front().and_then(|row| finish(&mut all, row));
                }
            }
        }
        for row in pending {
            finish(&mut all, row);
        }
        Ok(all)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn items_are_computed_in_order_until_nobody_waits_for_them() {
        let counted = AtomicUsize::new(0);
        let count = |_| counted.fetch_add(1, Ordering::Relaxed);
        let all: Vec<usize> =
            thread::scope(|scope| ahead(scope, (0..3).map(count)).unwrap().into_iter().collect());
        assert_eq!(all, [0, 1, 2]);
        // A thread that did not end would keep the scope from ending.
        let first = thread::scope(|scope| ahead(scope, (0..).map(count)).unwrap().recv());
        assert_eq!(first, Ok(3));
    }
}
