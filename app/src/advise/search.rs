//! Searches for the cheapest setting within a budget.
//!
//! Every parameter is measured alone, one step away from the exact settings. What several do together is predicted: squared
//! errors add up, as those of independent causes do, and shares of time multiply. The cheapest predictions are then drawn,
//! and only what was drawn and measured is advised.

use crate::trade::measure::Row;
use crate::trade::settings::{EXACT, Setting};
use serde::Serialize;

/// The wanted limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Budget {
    /// Least PSNR of every view, in decibels.
    pub psnr: Option<f64>,
    /// Greatest mean GPU time of a frame, in milliseconds.
    pub ms: Option<f64>,
}

/// The measurements of a setting over all views.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tried {
    /// The setting.
    pub setting: Setting,
    /// PSNR of each view in decibels, infinite for equal pictures.
    pub psnr_db: Vec<f64>,
    /// Mean GPU time of a frame over the views, in milliseconds; `None` without timestamps.
    pub gpu_ms: Option<f64>,
    /// Mean share of the exact settings' time; 1 without timestamps.
    pub of_exact: f64,
}

impl Tried {
    /// Sums up the rows of a setting; `None` if one of them failed.
    pub fn new(setting: &Setting, rows: &[Row]) -> Option<Tried> {
        let found: Option<Vec<_>> = rows.iter().map(|row| row.found.as_ref().ok()).collect();
        let found = found.filter(|found| !found.is_empty())?;
        let count = found.len() as f64;
        let times: Option<Vec<_>> = found.iter().map(|view| view.time.as_ref()).collect();
        Some(Tried {
            setting: setting.clone(),
            psnr_db: found.iter().map(|view| view.error.psnr_db.unwrap_or(f64::INFINITY)).collect(),
            gpu_ms: times.as_ref().map(|times| times.iter().map(|time| time.gpu_ms).sum::<f64>() / count),
            of_exact: times.map_or(1.0, |times| times.iter().map(|time| time.of_exact).sum::<f64>() / count),
        })
    }

    /// The PSNR of the view with the least.
    pub fn least_psnr(&self) -> f64 {
        self.psnr_db.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

impl Budget {
    /// Returns true if a setting is within the limits. Without timestamps, no limit of time can be kept.
    pub fn allows(&self, tried: &Tried) -> bool {
        let accurate = self.psnr.is_none_or(|least| tried.least_psnr() >= least);
        accurate && self.ms.is_none_or(|most| tried.gpu_ms.is_some_and(|ms| ms <= most))
    }

    /// Returns true if the first of two settings within the limits is the better: the faster where an error is allowed, else the more accurate.
    ///
    /// Shares of the exact settings' time, from the same rounds, tell which is the faster: the device's load may have changed between
    /// two settings.
    fn prefers(&self, a: &Tried, b: &Tried) -> bool {
        match self.psnr {
            Some(_) => a.of_exact < b.of_exact,
            None => a.least_psnr() > b.least_psnr(),
        }
    }
}

/// Least saving of a value of a parameter that is tried together with others: less is noise.
const SAVES: f64 = 0.01;
/// Decibels by which a prediction may miss the budget and be drawn all the same.
const SLACK_DB: f64 = 1.0;
/// Most combinations that are predicted.
const MOST: usize = 100_000;

/// A combination of values with its predicted errors and time.
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

/// Lists combinations to draw, the most promising first. `singles` hold the exact settings and others one parameter away from them.
///
/// Settings of other graphs, and with other parameters away from their exact values, are not combined.
pub fn combinations(singles: &[Tried], budget: &Budget) -> Vec<Setting> {
    let Some(exact) = singles.iter().find(|tried| tried.setting.name == EXACT) else { return Vec::new() };
    let mut parameters: Vec<(String, Vec<(String, &Tried)>)> = Vec::new();
    for tried in singles {
        let Some((name, value)) = single_change(&exact.setting, &tried.setting) else { continue };
        if tried.of_exact > 1.0 - SAVES {
            continue;
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
            for (value, tried) in values.iter().take(MOST.saturating_sub(all.len())) {
                let mut next = all[at].clone();
                next.set.push((name.clone(), value.clone()));
                for (view, error) in next.errors.iter_mut().enumerate() {
                    *error += (squared(tried.psnr_db[view]) - floor[view]).max(0.0);
                }
                next.of_exact *= tried.of_exact;
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
    all.into_iter().map(setting).collect()
}

/// The one parameter in which a setting of the same graph differs.
fn single_change(exact: &Setting, other: &Setting) -> Option<(String, String)> {
    if other.pipeline != exact.pipeline || other.set.len() != exact.set.len() {
        return None;
    }
    let mut changed = other.set.iter().filter(|pair| !exact.set.contains(pair));
    let (name, value) = changed.next()?;
    changed.next().is_none().then(|| (name.clone(), value.clone()))
}

/// Chooses the best setting within the budget.
pub fn best<'a>(tried: &'a [Tried], budget: &Budget) -> Option<&'a Tried> {
    let allowed = tried.iter().filter(|tried| budget.allows(tried));
    allowed.reduce(|best, other| if budget.prefers(other, best) { other } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tried(name: &str, set: [&str; 2], psnr_db: f64, ms: f64) -> Tried {
        let set =
            [("target", set[0]), ("cutoff", set[1])].map(|(n, v)| (n.to_owned(), v.to_owned())).to_vec();
        let setting = Setting { name: name.into(), pipeline: "splat".into(), set };
        Tried { setting, psnr_db: vec![psnr_db], gpu_ms: Some(ms), of_exact: ms / 10.0 }
    }

    fn singles() -> Vec<Tried> {
        vec![
            tried(EXACT, ["f", "3.33"], 80.0, 10.0),
            tried("target = h", ["h", "3.33"], 60.0, 5.0),
            tried("cutoff = 2", ["f", "2"], 50.0, 6.0),
            tried("cutoff = 1", ["f", "1"], 30.0, 4.0),
            tried("cutoff = 4", ["f", "4"], 80.0, 9.99),
        ]
    }

    #[test]
    fn combinations_come_by_their_predicted_cost_within_the_budget() {
        let budget = Budget { psnr: Some(45.0), ms: None };
        let names: Vec<String> = combinations(&singles(), &budget).into_iter().map(|s| s.name).collect();
        // Together 49.6 dB and 3 ms; what saves nothing is not combined, and 30 dB are out of the question.
        assert_eq!(names, ["target = h, cutoff = 2", "target = h", "cutoff = 2", EXACT]);
        let strict = Budget { psnr: Some(55.0), ms: None };
        assert_eq!(combinations(&singles(), &strict)[0].name, "target = h");
        let fast = Budget { psnr: None, ms: Some(3.0) };
        let found = combinations(&singles(), &fast);
        assert_eq!(found[0].name, "target = h, cutoff = 2", "the most accurate within the time");
        assert_eq!(
            found[0].set,
            [("target".to_owned(), "h".to_owned()), ("cutoff".to_owned(), "2".to_owned())]
        );
    }

    #[test]
    fn the_best_is_the_fastest_that_is_accurate_enough_or_the_most_accurate_that_is_fast_enough() {
        let all = singles();
        let name = |psnr, ms| best(&all, &Budget { psnr, ms }).map(|tried| tried.setting.name.as_str());
        assert_eq!(name(Some(45.0), None), Some("target = h"));
        assert_eq!(name(Some(70.0), None), Some("cutoff = 4"));
        assert_eq!(name(None, Some(5.0)), Some("target = h"));
        assert_eq!(name(Some(55.0), Some(4.0)), None);
        assert_eq!(name(Some(81.0), None), None);
        // The device became slower while the second was measured.
        let slowed = [
            tried("a", ["f", "3"], 50.0, 6.0),
            Tried { gpu_ms: Some(9.0), ..tried("b", ["h", "3"], 50.0, 5.0) },
        ];
        let budget = Budget { psnr: Some(45.0), ms: None };
        assert_eq!(best(&slowed, &budget).map(|tried| tried.setting.name.as_str()), Some("b"));
    }
}
