//! Searches for the cheapest setting within a budget.
//!
//! Every parameter is measured alone, one step away from the exact settings. Combinations are predicted: squared errors
//! add, as errors of independent causes do, and shares of time multiply. The cheapest predictions are then drawn, and
//! only settings that were drawn and measured are advised. Differences within the noise are reported: see
//! [`crate::studies::measurement::noise`].

use crate::studies::measurement::noise::Share;
use crate::studies::measurement::settings::{DEFAULTS, EXACT};
use crate::studies::study::Setting;
use crate::studies::trade::measure::Row;
use serde::Serialize;
use splatgraph_reference::metrics::decibels;

/// Limits within which a setting must stay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Budget {
    /// Minimum PSNR of every view, in decibels; `None` for no minimum.
    pub psnr: Option<f64>,
    /// Maximum GPU time of a frame, mean over the views, in milliseconds; `None` for no maximum.
    pub ms: Option<f64>,
}

/// The measurements of a setting over all views.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tried {
    /// Setting that was measured.
    pub setting: Setting,
    /// PSNR of each view in decibels, infinite for equal pictures.
    #[serde(serialize_with = "decibels::serialize_views")]
    pub psnr_db: Vec<f64>,
    /// Mean GPU time of a frame over the views, in milliseconds; `None` without timestamps.
    pub gpu_ms: Option<f64>,
    /// Mean share of the exact settings' time, with its range; `None` without timestamps.
    pub share: Option<Share>,
}

impl Tried {
    /// Summarises the rows of a setting; `None` if one of them failed, or if there are none.
    ///
    /// The range of the share is widened to `floor`, the noise floor; without a floor, there is no range. The exact
    /// settings' share is 1, by definition.
    pub fn new(setting: &Setting, rows: &[Row], floor: Option<f64>) -> Option<Tried> {
        let found: Option<Vec<_>> = rows.iter().map(|row| row.found.as_ref().ok()).collect();
        let found = found.filter(|found| !found.is_empty())?;
        let count = found.len() as f64;
        let times: Option<Vec<_>> = found.iter().map(|view| view.time.as_ref()).collect();
        let share = own_share(rows).map(|share| match setting.name == EXACT {
            true => Share::EXACT,
            false => share.widened(floor),
        });
        Some(Tried {
            setting: setting.clone(),
            psnr_db: found.iter().map(|view| view.error.psnr_db.unwrap_or(f64::INFINITY)).collect(),
            gpu_ms: times.map(|times| times.iter().map(|time| time.gpu_ms).sum::<f64>() / count),
            share,
        })
    }

    /// Returns the lowest PSNR over the views, in decibels.
    pub fn least_psnr(&self) -> f64 {
        self.psnr_db.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Returns whether this setting is faster than `other`; false without timestamps. See [`Share::faster`].
    fn faster(&self, other: &Tried) -> Option<bool> {
        match (self.share, other.share) {
            (Some(own), Some(other)) => own.faster(&other),
            _ => Some(false),
        }
    }

    /// Returns the share of the exact settings' time, the mean over views of each view's median; 1 without timestamps.
    pub fn median(&self) -> f64 {
        self.share.map_or(1.0, |share| share.median)
    }
}

/// Returns the mean share of a setting's rows, not widened to the floor. `None` without rows or timestamps, or if a row
/// failed.
pub fn own_share(rows: &[Row]) -> Option<Share> {
    let share = |row: &Row| Some(row.found.as_ref().ok()?.time.as_ref()?.share);
    Share::mean(&rows.iter().map(share).collect::<Option<Vec<_>>>()?)
}

impl Budget {
    /// Returns whether a setting is within the limits; `None` if noise hides the answer, or its share has no range.
    ///
    /// Without timestamps, no setting is within a time limit.
    pub fn allows(&self, tried: &Tried) -> Option<bool> {
        if self.psnr.is_some_and(|least| tried.least_psnr() < least) {
            return Some(false);
        }
        let Some(most) = self.ms else { return Some(true) };
        let Some((ms, share)) = tried.gpu_ms.zip(tried.share) else { return Some(false) };
        let (low, high) = share.range?;
        match (ms * low / share.median, ms * high / share.median) {
            (_, high) if high <= most => Some(true),
            (low, _) if low > most => Some(false),
            _ => None,
        }
    }
}

/// Decibels by which a setting, or the prediction of a combination, may miss the budget and still be considered.
const SLACK_DB: f64 = 1.0;
/// Maximum number of predicted combinations.
const MAX_PREDICTED: usize = 100_000;

/// A combination of values, with its predicted errors and its time as a share of the exact settings'.
#[derive(Clone)]
struct Predicted {
    set: Vec<(String, String)>,
    /// Mean squared error of each view.
    errors: Vec<f64>,
    of_exact: f64,
}

impl Predicted {
    fn least_psnr(&self) -> f64 {
        -10.0 * self.errors.iter().copied().fold(0.0, f64::max).log10()
    }
}

/// Lists combinations of the measured settings `singles` that are predicted near the budget, the most promising first.
///
/// The most promising are the fastest if the budget has a minimum PSNR, otherwise the most accurate. The exact settings
/// and single changes count as combinations. Only settings that change one parameter of the exact settings, and save
/// time beyond the noise, are combined. The second list names the settings with a saving within the noise. Both lists
/// are empty if `singles` lacks the exact settings.
pub fn combinations(singles: &[Tried], budget: &Budget) -> (Vec<Setting>, Vec<String>) {
    let Some(exact) = singles.iter().find(|tried| tried.setting.name == EXACT) else {
        return (Vec::new(), Vec::new());
    };
    let mut unsure = Vec::new();
    let mut parameters: Vec<(String, Vec<(String, &Tried)>)> = Vec::new();
    for tried in singles {
        let Some((name, value)) = single_change(&exact.setting, &tried.setting) else { continue };
        // Errors add, so a setting that misses the budget alone also misses it in every combination.
        if budget.psnr.is_some_and(|least| tried.least_psnr() < least - SLACK_DB) {
            continue;
        }
        match tried.faster(exact) {
            Some(true) => {}
            Some(false) => continue,
            None => {
                unsure.push(tried.setting.name.clone());
                continue;
            }
        }
        match parameters.iter_mut().find(|(own, _)| *own == name) {
            Some((_, values)) => values.push((value, tried)),
            None => parameters.push((name, vec![(value, tried)])),
        }
    }
    let squared = |db: f64| 10f64.powf(-db / 10.0);
    let floor: Vec<f64> = exact.psnr_db.iter().map(|db| squared(*db)).collect();
    let mut all = vec![Predicted { set: Vec::new(), errors: floor.clone(), of_exact: 1.0 }];
    for (name, values) in &parameters {
        for at in 0..all.len() {
            for (value, tried) in values.iter().take(MAX_PREDICTED.saturating_sub(all.len())) {
                let mut next = all[at].clone();
                next.set.push((name.clone(), value.clone()));
                for (view, error) in next.errors.iter_mut().enumerate() {
                    *error += (squared(tried.psnr_db[view]) - floor[view]).max(0.0);
                }
                next.of_exact *= tried.median();
                all.push(next);
            }
        }
    }
    let share = budget.ms.zip(exact.gpu_ms).map(|(ms, exact)| ms / exact);
    let wanted = |p: &Predicted| {
        budget.psnr.is_none_or(|least| p.least_psnr() >= least - SLACK_DB)
            && share.is_none_or(|share| p.of_exact <= 1.1 * share)
    };
    all.retain(wanted);
    all.sort_by(|a, b| match budget.psnr {
        Some(_) => a.of_exact.total_cmp(&b.of_exact),
        None => b.least_psnr().total_cmp(&a.least_psnr()),
    });
    let setting = |p: Predicted| {
        let of = |(name, exact): &(String, String)| {
            let changed = p.set.iter().find(|(own, _)| own == name);
            (name.clone(), changed.map_or_else(|| exact.clone(), |(_, value)| value.clone()))
        };
        let name =
            p.set.iter().map(|(name, value)| format!("{name} = {value}")).collect::<Vec<_>>().join(", ");
        Setting {
            name: if name.is_empty() { EXACT.to_owned() } else { name },
            pipeline: exact.setting.pipeline.clone(),
            set: exact.setting.set.iter().map(of).collect(),
        }
    };
    (all.into_iter().map(setting).collect(), unsure)
}

/// Returns the only parameter in which `other` differs, with its value; `None` if none or several differ, or the graph.
fn single_change(exact: &Setting, other: &Setting) -> Option<(String, String)> {
    if other.pipeline != exact.pipeline || other.set.len() != exact.set.len() {
        return None;
    }
    let mut changed = other.set.iter().filter(|pair| !exact.set.contains(pair));
    let (name, value) = changed.next()?;
    changed.next().is_none().then(|| (name.clone(), value.clone()))
}

/// The best setting within a budget, and the settings that may be better.
#[derive(Clone, Debug, PartialEq)]
pub struct Best<'a> {
    /// The setting; `None` if none is certainly within the budget.
    pub found: Option<&'a Tried>,
    /// Settings that may be better: noise hides the difference in time, or whether they are within the time limit.
    pub hidden: Vec<&'a Tried>,
}

/// Chooses the best setting within the budget: the fastest if the budget has a minimum PSNR, otherwise the most
/// accurate.
///
/// Among settings that noise does not distinguish from the fastest, the most accurate is chosen. If the defaults are
/// within the budget, they are chosen unless another setting is better: with a minimum PSNR, faster beyond the noise;
/// without one, more accurate by more than `MIN_GAIN_DB`.
pub fn best<'a>(tried: &'a [Tried], budget: &Budget) -> Best<'a> {
    let of = |wanted: Option<bool>| tried.iter().filter(move |tried| budget.allows(tried) == wanted);
    let more_accurate = |a: &'a Tried, b: &'a Tried| if b.least_psnr() > a.least_psnr() { b } else { a };
    let mut hidden: Vec<&Tried> = of(None).collect();
    let found = match budget.psnr {
        None => of(Some(true)).reduce(more_accurate),
        Some(_) => {
            let quicker = |a: &'a Tried, b: &'a Tried| if b.median() < a.median() { b } else { a };
            of(Some(true)).reduce(quicker).and_then(|fastest| {
                // `fastest` has to be on the left: `faster` is not symmetric, as the exact settings' range is a point.
                let near =
                    |other: &&Tried| fastest.faster(other) != Some(true) || std::ptr::eq(*other, fastest);
                let found = of(Some(true)).filter(near).reduce(more_accurate)?;
                let unsure = |other: &&Tried| other.faster(found).is_none() && !std::ptr::eq(*other, found);
                hidden.extend(of(Some(true)).filter(unsure));
                Some(found)
            })
        }
    };
    let defaults = of(Some(true)).find(|tried| tried.setting.name == DEFAULTS);
    let found = match (found, defaults) {
        (Some(other), Some(defaults)) if !is_better(other, defaults, budget) => {
            if other.faster(defaults).is_none() && !std::ptr::eq(other, defaults) {
                hidden.push(other);
            }
            hidden.retain(|hidden| !std::ptr::eq(*hidden, defaults));
            Some(defaults)
        }
        (found, _) => found,
    };
    // Without a minimum PSNR, accuracy decides: drop the settings that are less accurate than `found`.
    if let (None, Some(found)) = (budget.psnr, found) {
        hidden.retain(|other| other.least_psnr() > found.least_psnr());
    }
    Best { found, hidden }
}

/// Gain in PSNR, in decibels, above which a more accurate setting replaces the defaults.
const MIN_GAIN_DB: f64 = 0.1;

fn is_better(other: &Tried, defaults: &Tried, budget: &Budget) -> bool {
    match budget.psnr {
        Some(_) => other.faster(defaults) == Some(true),
        None => other.least_psnr() > defaults.least_psnr() + MIN_GAIN_DB,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::Random;

    fn tried(name: &str, set: [&str; 2], psnr_db: f64, ms: f64) -> Tried {
        noisy(name, set, psnr_db, ms, 0.001)
    }

    /// Returns a setting that takes `ms` of the exact settings' 10 ms; its share's range is ± `half`.
    fn noisy(name: &str, set: [&str; 2], psnr_db: f64, ms: f64, half: f64) -> Tried {
        let set =
            [("target", set[0]), ("cutoff", set[1])].map(|(n, v)| (n.to_owned(), v.to_owned())).to_vec();
        let setting = Setting { name: name.into(), pipeline: "splat".into(), set };
        let median = ms / 10.0;
        let share = match name {
            EXACT => Share::EXACT,
            _ => Share { median, range: Some((median - half, median + half)) },
        };
        Tried { setting, psnr_db: vec![psnr_db], gpu_ms: Some(ms), share: Some(share) }
    }

    fn singles() -> Vec<Tried> {
        vec![
            tried(EXACT, ["f", "3.33"], 80.0, 10.0),
            tried("target = h", ["h", "3.33"], 60.0, 5.0),
            tried("cutoff = 2", ["f", "2"], 50.0, 6.0),
            tried("cutoff = 1", ["f", "1"], 30.0, 4.0),
            tried("cutoff = 4", ["f", "4"], 80.0, 9.99),
            noisy("cutoff = 5", ["f", "5"], 80.0, 9.0, 0.2),
        ]
    }

    #[test]
    fn combinations_come_by_their_predicted_cost_within_the_budget() {
        let budget = Budget { psnr: Some(45.0), ms: None };
        let (found, unsure) = combinations(&singles(), &budget);
        let names: Vec<String> = found.into_iter().map(|s| s.name).collect();
        // Both are predicted at 49.6 dB and 3 ms. `cutoff = 4` and `cutoff = 5` do not save time beyond the noise, and
        // `cutoff = 1` misses the budget with its 30 dB.
        assert_eq!(names, ["target = h, cutoff = 2", "target = h", "cutoff = 2", EXACT]);
        assert_eq!(unsure, ["cutoff = 5"]);
        let strict = Budget { psnr: Some(55.0), ms: None };
        assert_eq!(combinations(&singles(), &strict).0[0].name, "target = h");
        let fast = Budget { psnr: None, ms: Some(3.0) };
        let (found, _) = combinations(&singles(), &fast);
        assert_eq!(found[0].name, "target = h, cutoff = 2", "the most accurate within the time");
        assert_eq!(
            found[0].set,
            [("target".to_owned(), "h".to_owned()), ("cutoff".to_owned(), "2".to_owned())]
        );
    }

    #[test]
    fn the_best_is_the_fastest_that_is_accurate_enough_or_the_most_accurate_that_is_fast_enough() {
        let all = singles()[..5].to_vec();
        let name = |psnr, ms| best(&all, &Budget { psnr, ms }).found.map(|tried| tried.setting.name.as_str());
        assert_eq!(name(Some(45.0), None), Some("target = h"));
        assert_eq!(name(Some(70.0), None), Some(EXACT), "a thousandth is no saving");
        assert_eq!(name(None, Some(5.5)), Some("target = h"));
        assert_eq!(name(Some(55.0), Some(4.0)), None);
        assert_eq!(name(Some(81.0), None), None);
    }

    #[test]
    fn the_defaults_are_advised_unless_another_is_better_beyond_the_noise() {
        let exact = tried(EXACT, ["f", "3.33"], 80.0, 10.0);
        let defaults = noisy(DEFAULTS, ["h", "4"], 77.0, 4.7, 0.1);
        let slow = noisy("cutoff = 2", ["f", "2"], 45.7, 7.6, 0.1);
        let budget = Budget { psnr: Some(45.0), ms: None };
        let name = |all: &[Tried], budget| best(all, &budget).found.map(|t| t.setting.name.clone());
        let all = [exact.clone(), slow, defaults.clone()];
        assert_eq!(name(&all, budget).as_deref(), Some(DEFAULTS));
        let near = noisy("target = f", ["f", "4"], 79.0, 4.6, 0.1);
        let all = [exact.clone(), near, defaults.clone()];
        assert_eq!(name(&all, budget).as_deref(), Some(DEFAULTS));
        let quick = tried("cutoff = 1", ["h", "1"], 46.0, 2.0);
        let all = [exact.clone(), quick, defaults.clone()];
        assert_eq!(name(&all, budget).as_deref(), Some("cutoff = 1"), "faster by far more than the noise");
        let limit = Budget { psnr: None, ms: Some(6.0) };
        let (same, closer) = (tried("a", ["f", "5"], 77.05, 5.0), tried("b", ["f", "6"], 79.0, 5.0));
        assert_eq!(name(&[exact.clone(), same.clone(), defaults.clone()], limit).as_deref(), Some(DEFAULTS));
        assert_eq!(name(&[exact, same, closer, defaults], limit).as_deref(), Some("b"));
    }

    /// Simulates a run of `advise`: rounds of settings with fixed shares and pseudo-random noise.
    fn run(seed: u64) -> Vec<Tried> {
        const ROUNDS: usize = 15;
        const NOISE: f64 = 0.05;
        let truth = [
            (EXACT, "0", 80.0, 1.0),
            (DEFAULTS, "1", 77.0, 0.47),
            ("target = h", "2", 70.0, 0.46),
            ("cutoff = 2", "3", 52.0, 0.43),
            ("cutoff = 1", "4", 46.0, 0.42),
            ("both", "5", 45.5, 0.40),
        ];
        let mut random = Random(seed);
        let mut noise = || 1.0 + NOISE * ((random.next() >> 40) as f64 / f64::from(1 << 23) - 1.0);
        let measure = |(name, value, psnr, share): (&str, &str, f64, f64)| {
            let rounds: Vec<f64> = (0..ROUNDS).map(|_| share * noise()).collect();
            let share = if name == EXACT { Some(Share::EXACT) } else { Share::of(&rounds) };
            Tried { share, ..tried(name, [value, "3.33"], psnr, 10.0) }
        };
        truth.map(measure).to_vec()
    }

    #[test]
    fn two_runs_give_the_same_advice_or_call_the_other_too_noisy_to_tell() {
        let budget = Budget { psnr: Some(45.0), ms: None };
        let advice = |seed| {
            let all = run(seed);
            let Best { found, hidden } = best(&all, &budget);
            let name = |tried: &Tried| tried.setting.name.clone();
            (found.map(name).expect("a setting"), hidden.into_iter().map(name).collect::<Vec<_>>())
        };
        let runs: Vec<_> = (0..300).map(advice).collect();
        assert_eq!(advice(7), runs[7], "the same measurements");
        for (at, (found, hidden)) in runs.iter().enumerate() {
            for (other, others) in &runs[at..] {
                assert!(
                    found == other || hidden.contains(other) || others.contains(found),
                    "{found} {hidden:?}, {other} {others:?}"
                );
            }
        }
        // Some runs hide no setting, and not all runs have the same advice.
        let sure = runs.iter().filter(|(_, hidden)| hidden.is_empty()).count();
        assert!(sure > 0 && runs.iter().any(|(found, _)| *found != runs[0].0), "{sure}");
    }

    #[test]
    fn what_noise_hides_is_told_and_the_most_accurate_is_taken() {
        let defaults = noisy("defaults", ["h", "4"], 77.5, 7.0, 0.1);
        let pair = noisy("target = h, cutoff = 2", ["h", "2"], 57.5, 6.3, 0.1);
        let exact = tried(EXACT, ["f", "3.33"], 80.0, 10.0);
        let all = [exact.clone(), pair.clone(), defaults.clone()];
        let budget = Budget { psnr: Some(45.0), ms: None };
        assert_eq!(best(&all, &budget), Best { found: Some(&all[2]), hidden: vec![&all[1]] });
        let quiet =
            [exact.clone(), tried("pair", ["h", "2"], 57.5, 6.3), tried("defaults", ["h", "4"], 77.5, 7.0)];
        assert_eq!(best(&quiet, &budget), Best { found: Some(&quiet[1]), hidden: vec![] });
        let ms = Budget { psnr: None, ms: Some(7.1) };
        assert_eq!(best(&all, &ms), Best { found: None, hidden: vec![&all[1], &all[2]] });
        let glance =
            |tried: Tried| Tried { share: tried.share.map(|share| Share { range: None, ..share }), ..tried };
        let glances = [exact, glance(pair), glance(defaults)];
        let found = best(&glances, &budget);
        assert_eq!((found.found, found.hidden.len()), (Some(&glances[2]), 2), "the defaults");
    }
}
