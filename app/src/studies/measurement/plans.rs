//! Distinguishes settings by their plans. Equal plans draw equal pictures, and their times differ only by noise.

use super::settings::with_effect;
use crate::draw::fingerprint::fingerprint;
use crate::draw::session::{Built, Session, SessionError};
use crate::studies::study::{Listener, Setting, Steps, StudyError};
use splatgraph_api::{Compiled, Device, Loader};
use splatgraph_assets::Camera;
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};

/// For a setting, the names of the settings with equal plans, which are not measured.
pub type SamePlan = BTreeMap<String, BTreeSet<String>>;

/// Plans of settings, by the name of the setting.
pub type Plans = HashMap<String, Built>;

/// Settings to measure.
pub struct Planned {
    /// Each setting with the hash of its plans, `None` if one cannot be built.
    pub settings: Vec<(Setting, Option<u64>)>,
    /// The settings that are left out because of equal plans.
    pub same_plan: SamePlan,
    /// The plans of each setting. A setting whose plans cannot be built is missing.
    pub built: Plans,
    /// Pipelines of each setting's plan for one picture size, compiled ahead; to keep until the measurements end.
    ///
    /// Empty on CPUs, where compilation would compete with frames for cores.
    pub pipelines: Vec<Compiled>,
}

/// Leaves out the settings that draw the same pictures as another, and tells the listener why.
///
/// A setting is left out if its parameter has no effect in the plan of `exact`, or if its plans for all cameras equal
/// an earlier setting's. Presets come after the graphs and presets that they are based on, whose names are kept if
/// plans are equal. `exact` is a prepared session of the first setting. Settings rejected by `wanted` are dropped
/// without a report. On a GPU, one plan of each setting is compiled ahead, on other threads.
///
/// # Errors
/// The exact settings are not prepared, or the listener cancels.
pub fn to_measure(
    all: Vec<Setting>,
    exact: &mut Session,
    cameras: &[Camera],
    wanted: &dyn Fn(&Setting) -> bool,
    listener: &mut dyn Listener,
) -> Result<Planned, StudyError> {
    let plan = exact.plan().ok_or(SessionError::NotPrepared)?;
    let (all, lines) = with_effect(all, plan);
    lines.iter().for_each(|line| listener.say(line));
    let all: Vec<Setting> = all.into_iter().filter(wanted).collect();
    let graph = all.first().map(|exact| exact.pipeline.clone());
    let mut sizes: Vec<(u32, u32)> = cameras.iter().map(|camera| (camera.width, camera.height)).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let mut steps = Steps::new(listener, "building plans", all.len());
    let ahead = usize::from(!exact.device().info().is_cpu());
    let (mut planned, mut built) = (Vec::new(), Plans::new());
    let (sender, pipelines) = mpsc::channel();
    let is_cancelled = Arc::new(AtomicBool::new(false));
    rayon::in_place_scope(|scope| -> Result<(), StudyError> {
        for setting in all {
            steps.next(&setting.name).inspect_err(|_| is_cancelled.store(true, Ordering::Relaxed))?;
            let plans = sizes.iter().map(|size| exact.plan_of(&setting.pipeline, &setting.set, *size));
            let plans = plans.collect::<Result<Vec<Plan>, _>>().ok();
            let based_on = plans.iter().flatten().map(|plan| plan.based_on.len()).max().unwrap_or(0);
            let depth = if Some(&setting.pipeline) == graph.as_ref() { 0 } else { 1 + based_on };
            let hash = plans.as_deref().map(fingerprints);
            for plan in plans.iter().flatten().take(ahead).cloned() {
                let (is_cancelled, sender) = (is_cancelled.clone(), sender.clone());
                let cancel = Cancel::new(move || is_cancelled.load(Ordering::Relaxed));
                let loader = exact.device().loader().cancelled_by(cancel);
                scope.spawn(move |_| {
                    // An error is ignored here: it occurs again, and is reported, when the setting is measured.
                    let _ = loader.compile(plan).map(|pipelines| sender.send(pipelines));
                });
            }
            if let Some(plans) = plans {
                let plans: Vec<_> = sizes.iter().copied().zip(plans).collect();
                built.insert(setting.name.clone(), Built::new(plans));
            }
            planned.push((depth, (setting, hash)));
        }
        Ok(())
    })?;
    drop(sender);
    planned.sort_by_key(|(depth, _)| *depth);
    let (settings, same_plan) = distinct(planned.into_iter().map(|(_, planned)| planned));
    for (setting, other) in same_plan.iter().flat_map(|(setting, all)| all.iter().map(move |o| (setting, o)))
    {
        listener.say(&format!("not measured: `{other}` has the same plan as `{setting}`"));
    }
    built.retain(|name, _| settings.iter().any(|(setting, _)| setting.name == *name));
    Ok(Planned { settings, same_plan, built, pipelines: pipelines.into_iter().collect() })
}

fn fingerprints(plans: &[Plan]) -> u64 {
    let mut hash = DefaultHasher::new();
    plans.iter().for_each(|plan| fingerprint(plan).hash(&mut hash));
    hash.finish()
}

/// Leaves out settings with plans that equal an earlier setting's. Also returns which are left out.
fn distinct(
    all: impl IntoIterator<Item = (Setting, Option<u64>)>,
) -> (Vec<(Setting, Option<u64>)>, SamePlan) {
    let mut kept: Vec<(Setting, Option<u64>)> = Vec::new();
    let mut same = SamePlan::new();
    for (setting, plan) in all {
        match kept.iter().find(|(_, other)| plan.is_some() && *other == plan) {
            Some((other, _)) => {
                same.entry(other.name.clone()).or_default().insert(setting.name);
            }
            None => kept.push((setting, plan)),
        }
    }
    (kept, same)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing::plan;

    #[test]
    fn plans_are_equal_whatever_their_names_and_differ_by_each_value_that_is_read() {
        let of = |graph: &str, set: &[(&str, &str)]| fingerprint(&plan(graph, set, 8));
        let tiled = of("tiled", &[]);
        assert_eq!(of("tiled_cpu", &[]), of("auto", &[]), "a choice changes nothing");
        assert_eq!(tiled, of("tiled", &[("budget", "0.5")]), "where pairs are sorted, all splats are drawn");
        assert_eq!(of("splat", &[("order_of", "last_frame")]), of("stale_order", &[]));
        for changed in [("alpha_cap", "0.75"), ("key_bits", "9"), ("sh_degree", "0"), ("stop", "0.05")] {
            assert_ne!(tiled, of("tiled", &[changed]), "{changed:?}");
        }
    }

    #[test]
    fn a_setting_with_the_plan_of_an_earlier_one_is_left_out_and_one_without_a_plan_is_not() {
        let setting = |name: &str| Setting { name: name.into(), pipeline: "splat".into(), set: Vec::new() };
        let all = [("a", Some(1)), ("b", Some(2)), ("c", Some(1)), ("d", None), ("e", None)];
        let (kept, same) = distinct(all.map(|(name, plan)| (setting(name), plan)));
        let names: Vec<&str> = kept.iter().map(|(setting, _)| setting.name.as_str()).collect();
        assert_eq!(
            (names, same),
            (vec!["a", "b", "d", "e"], SamePlan::from([("a".into(), ["c".into()].into())]))
        );
    }
}
