//! Compares frame times, and tells differences from noise.
//!
//! A turn is a frame of the baseline, then a frame of the setting. The baseline has the exact settings; in a sweep, it
//! draws all splats. The share of a turn is the setting's time divided by the baseline's. The share of a setting is the
//! median over its turns, and its range is the 99 % confidence interval of this median. The interval is computed from
//! ranks (the binomial interval of a median; David and Nagaraja, "Order Statistics", 3rd edition, 7.1), so no
//! distribution is assumed. Turns end once the range is narrow ([`enough`]), which lowers the confidence a little. A
//! turn has one frame of each, because shares of medians would need more frames for an equally narrow range.
//!
//! Over several views, the share is the mean of the views' shares. The views are measured one after the other, so their
//! errors are independent and add in quadrature: each side of the mean's range is the root of the sum of the views'
//! squared sides, divided by the number of views n. Each view's range may therefore be √n times as wide as the mean's,
//! up to √8 times. If noise is one-sided, the median of few turns is biased, equally in all views. The bias does not
//! add in quadrature, so the range of a mean over many views has less than 99 % confidence (docs/accuracy.md has
//! numbers).
//!
//! `advise` and `trade` also measure the exact settings against themselves. Without noise, their share would be 1. Its
//! distance from 1 is the **noise floor**, and their ranges are widened to at least `median * (1 ± floor)`.

use crate::draw::stats::median;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Minimum number of turns for a range: with 8, the median is within the extremes in 99.2 % of cases.
pub const MIN_TURNS: usize = 8;

/// Maximum probability that the true median is outside of the range.
const RISK: f64 = 0.01;

/// Minimum relative saving in time. Settings with a smaller difference count as equally fast.
pub const MIN_SAVING: f64 = 0.02;

/// PSNRs that differ by less than this, in decibels, count as equal: half of the last digit in tables.
const EQUAL_DB: f64 = 0.05;

/// Maximum number of views by which a view's range may be wider. With more, the bias of few turns exceeds the range.
const MOST_VIEWS: usize = 8;

/// Width at which turns end: half of the width of the mean's range is at most `NARROW.0 + NARROW.1 * |share - 1|`.
const NARROW: (f64, f64) = (0.01, 0.05);

/// A frame time as a share of the baseline's, such as the exact settings' time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// The median of the turns; over several views, the mean of the views' medians.
    pub median: f64,
    /// Confidence interval of `median`, which [`Share::widened`] extends. `None` with fewer than [`MIN_TURNS`] turns,
    /// or if widened without a noise floor.
    pub range: Option<(f64, f64)>,
}

impl Share {
    /// The share of the exact settings, by definition.
    pub const EXACT: Share = Share { median: 1.0, range: Some((1.0, 1.0)) };

    /// Summarises the shares of turns; `None` without turns.
    pub fn of(turns: &[f64]) -> Option<Share> {
        let mut sorted = turns.to_vec();
        sorted.sort_by(f64::total_cmp);
        let outside = outside(sorted.len());
        let range = outside.map(|outside| (sorted[outside], sorted[sorted.len() - 1 - outside]));
        Some(Share { median: median(sorted)?, range })
    }

    /// Averages the shares over views, whose errors are independent; `None` without views. The range is `None` if a
    /// view has none.
    pub fn mean(views: &[Share]) -> Option<Share> {
        let count = Some(views.len() as f64).filter(|count| *count > 0.0)?;
        let median = views.iter().map(|view| view.median).sum::<f64>() / count;
        let half = |of: &dyn Fn(f64, (f64, f64)) -> f64| -> Option<f64> {
            let squares = views.iter().map(|view| Some(of(view.median, view.range?).powi(2)));
            Some(squares.sum::<Option<f64>>()?.sqrt() / count)
        };
        let (below, above) =
            (half(&|median, (low, _)| median - low), half(&|median, (_, high)| high - median));
        Some(Share { median, range: below.zip(above).map(|(below, above)| (median - below, median + above)) })
    }

    /// Returns the noise floor: the median's distance from 1. `None` without a range.
    ///
    /// Only meaningful for the exact settings' share, measured against themselves.
    pub fn floor(&self) -> Option<f64> {
        self.range.map(|_| (1.0 - self.median).abs())
    }

    /// Widens the range to at least the floor, in proportion to the median. Without a floor, the range becomes `None`.
    pub fn widened(self, floor: Option<f64>) -> Share {
        let range = self.range.zip(floor).map(|((low, high), floor)| {
            let (down, up) = (self.median * (1.0 - floor), self.median * (1.0 + floor));
            (low.min(down), high.max(up))
        });
        Share { range, ..self }
    }

    /// Returns whether this takes at least [`MIN_SAVING`] less time than `other`; `None` if noise hides the answer, or
    /// if either has no range.
    pub fn faster(&self, other: &Share) -> Option<bool> {
        let ((low, high), (other_low, other_high)) = (self.range?, other.range?);
        let kept = 1.0 - MIN_SAVING;
        match () {
            () if high < kept * other_low => Some(true),
            () if low >= kept * other_high => Some(false),
            () => None,
        }
    }
}

/// Formats a share with the distance to the farther end of its range: `70.2 ± 0.4 %`. The range may be skewed. Without
/// a range, `?` takes its place.
impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let farther = self.range.map(|(low, high)| (high - self.median).max(self.median - low));
        let farther = farther.map_or("?".into(), |farther| format!("{:.1}", 100.0 * farther));
        write!(f, "{:.1} ± {farther} %", 100.0 * self.median)
    }
}

/// Returns the number of turns outside the median's range, on each side; `None` with too few turns.
fn outside(turns: usize) -> Option<usize> {
    // `log_term`: logarithm of the probability that exactly `count` turns are below the median. The probability itself
    // underflows for thousands of turns. `below`: the probability that at most `count` are.
    let mut log_term = turns as f64 * 0.5f64.ln();
    let (mut below, mut found) = (0.0, None);
    for count in 0..=turns / 2 {
        below += log_term.exp();
        if 2.0 * below > RISK {
            break;
        }
        found = Some(count);
        log_term += ((turns - count) as f64 / (count + 1) as f64).ln();
    }
    found
}

/// Returns true if the range of the turns' median is narrow enough to end measuring one of `views` views.
pub fn enough(turns: &[f64], views: usize) -> bool {
    let found = Share::of(turns);
    let narrow = |share: &Share| {
        let wanted = NARROW.0 + NARROW.1 * (share.median - 1.0).abs();
        share
            .range
            .is_some_and(|(low, high)| 0.5 * (high - low) <= wanted * (views.min(MOST_VIEWS) as f64).sqrt())
    };
    found.as_ref().is_some_and(narrow)
}

/// Position of a setting relative to the Pareto front of time and accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mark {
    /// On the Pareto front: this setting saves at least [`MIN_SAVING`] over every more accurate one on the front.
    ///
    /// No equally accurate setting saves as much over it.
    Best,
    /// On the front by the medians, but within the noise.
    Likely,
    /// Not on the front by the medians, but within the noise.
    Unlikely,
    /// Not on the front: it does not save [`MIN_SAVING`] over a setting on the front that is at least as accurate.
    Beaten,
    /// Not judged: still pictures do not show the setting's error.
    Hidden,
}

/// Time and accuracy of a setting.
#[derive(Clone, Copy, Debug)]
pub struct Point<'a> {
    /// Name of the setting. Of points with equal medians, the first by name is on the front.
    pub name: &'a str,
    /// Share of the exact settings' time, widened to the floor; `None` without timestamps.
    pub share: Option<Share>,
    /// PSNR in decibels; infinite for equal pictures.
    pub psnr_db: f64,
    /// True if still pictures do not show the setting's error.
    pub hidden: bool,
}

/// Returns the mark of each point on the Pareto front of time and PSNR. The order of the points does not matter.
///
/// The front is built from the most to the least accurate point. PSNRs that are within `EQUAL_DB` of the highest one
/// left count as equal to it, and of equally accurate points, the fastest comes first. A point joins the front if it
/// saves [`MIN_SAVING`] over each point already on it. Points that are not on the front beat no other: otherwise, of
/// three points that save 1.3 % over one another, each would be beaten. Without times, only PSNR counts.
pub fn front(points: &[Point]) -> Vec<Mark> {
    let faster = |a: usize, b: usize| match (points[a].share, points[b].share) {
        (Some(a), Some(b)) => a.faster(&b),
        _ => Some(false),
    };
    let time = |at: usize| points[at].share.map_or(f64::INFINITY, |share| share.median);
    // Slower than a point that comes earlier, which is on the front, or is beaten by one that beats this, too.
    let is_slower = |a: usize, b: usize| {
        let ranges = points[a].share.zip(points[b].share).and_then(|(a, b)| a.range.zip(b.range));
        ranges.is_some_and(|((low, _), (_, high))| low >= high)
    };
    let equal = |a: f64, b: f64| a == b || (a - b).abs() < EQUAL_DB;
    let psnr_db = |at: usize| points[at].psnr_db;
    let mut order: Vec<usize> = (0..points.len()).filter(|at| !points[*at].hidden).collect();
    order.sort_by(|a, b| psnr_db(*b).total_cmp(&psnr_db(*a)));
    // For each point, the highest of the PSNRs that count as equal.
    let (mut levels, mut level) = (vec![f64::NAN; points.len()], f64::NAN);
    for &at in &order {
        if !equal(level, psnr_db(at)) {
            level = psnr_db(at);
        }
        levels[at] = level;
    }
    let by_name = |a: usize, b: usize| points[a].name.cmp(points[b].name);
    order.sort_by(|&a, &b| {
        levels[b].total_cmp(&levels[a]).then(time(a).total_cmp(&time(b))).then(by_name(a, b))
    });
    let mut marks = vec![Mark::Hidden; points.len()];
    // The front by the medians.
    let mut seeming: Vec<usize> = Vec::new();
    for (place, &at) in order.iter().enumerate() {
        let (earlier, later) = (&order[..place], &order[place + 1..]);
        let beats = |other: usize| marks[other] == Mark::Best && faster(at, other) == Some(false);
        let beaten = earlier.iter().any(|other| is_slower(at, *other) || beats(*other));
        let mut equals = later.iter().take_while(|other| levels[**other] == levels[at]);
        let told =
            earlier.iter().all(|other| marks[*other] == Mark::Beaten || faster(at, *other) == Some(true))
                && equals.all(|other| faster(*other, at) == Some(false));
        let seems = seeming.iter().all(|other| time(at) < (1.0 - MIN_SAVING) * time(*other));
        marks[at] = match (beaten, told, seems) {
            (true, ..) => Mark::Beaten,
            (_, true, _) => Mark::Best,
            (_, false, true) => Mark::Likely,
            (_, false, false) => Mark::Unlikely,
        };
        seeming.extend(seems.then_some(at));
    }
    marks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::Random;

    fn share(median: f64, half: f64) -> Option<Share> {
        Some(Share { median, range: Some((median - half, median + half)) })
    }

    fn point(share: Option<Share>, psnr_db: f64) -> Point<'static> {
        Point { name: "other", share, psnr_db, hidden: false }
    }

    #[test]
    fn a_range_holds_the_median_of_noise_in_99_of_100_runs() {
        assert_eq!(
            [0, 7, 8, 10, 11, 16, 20].map(outside),
            [None, None, Some(0), Some(0), Some(0), Some(2), Some(3)]
        );
        // By the normal approximation, 2,000 - 2.576 * sqrt(4,000) / 2 = 1,918.5.
        assert!((1916..=1919).contains(&outside(4000).expect("a range")), "{:?}", outside(4000));
        // Turns with a median of 1 and one-sided noise, as on a busy machine.
        let mut numbers = Random(1);
        let mut random = || (numbers.next() >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        let missed = (0..4000).filter(|_| {
            let turns: Vec<f64> =
                (0..16).map(|_| random()).map(|v| 1.0 + if v > 0.0 { v } else { 0.1 * v }).collect();
            let (low, high) = Share::of(&turns).and_then(|share| share.range).expect("16 turns");
            !(low..=high).contains(&1.0)
        });
        assert!(missed.count() < 40);
    }

    #[test]
    fn turns_are_enough_when_the_range_is_narrow_and_farther_from_1_less_narrow() {
        let near: Vec<f64> = (0..8).map(|i| 0.96 + 0.005 * f64::from(i)).collect();
        let far: Vec<f64> = near.iter().map(|v| v + 2.0).collect();
        assert!(!enough(&near, 1) && enough(&far, 1) && enough(&[1.0; 8], 1) && !enough(&[1.0; 7], 100));
        assert!(!enough(&near, 2) && enough(&near, 3), "half of the range is 0.0175, and 0.0111 is wanted");
        let wide: Vec<f64> = near.iter().map(|v| 1.0 + 2.0 * (v - 0.9775)).collect();
        assert!(!enough(&wide, 100), "half of the range is 0.035, and 0.0283 is enough in many views");
    }

    #[test]
    fn what_is_within_the_floor_is_neither_faster_nor_slower_for_sure() {
        let floor = share(0.81, 0.05).expect("a share").floor();
        assert_eq!(Share::of(&[1.0; 3]).expect("turns").floor(), None);
        assert!((floor.expect("a range") - 0.19).abs() < 1e-12);
        let narrow = share(0.9, 0.01).expect("a share");
        assert_eq!(narrow.faster(&Share::EXACT), Some(true));
        assert_eq!(narrow.widened(floor).faster(&Share::EXACT), None);
        assert_eq!(share(0.5, 0.01).expect("a share").widened(floor).faster(&Share::EXACT), Some(true));
        assert_eq!(share(1.0, 0.01).expect("a share").faster(&Share::EXACT), Some(false), "1 % is no saving");
        assert_eq!(
            Share::of(&[0.5; 3]).expect("turns").widened(floor).faster(&Share::EXACT),
            None,
            "3 turns"
        );
    }

    #[test]
    fn the_front_holds_what_is_faster_for_sure_and_noise_is_told() {
        let exact = Point { name: "exact", ..point(Some(Share::EXACT), 100.0) };
        let marks = |others: &[Point]| front(&[&[exact], others].concat())[1..].to_vec();
        assert_eq!(front(&[exact]), [Mark::Best]);
        assert_eq!(marks(&[point(share(0.8, 0.02), 60.0)]), [Mark::Best]);
        assert_eq!(marks(&[point(share(1.0, 0.01), 60.0)]), [Mark::Beaten], "no faster, less accurate");
        assert_eq!(marks(&[point(share(0.9, 0.15), 100.0)]), [Mark::Likely]);
        assert_eq!(marks(&[point(share(1.05, 0.15), 100.0)]), [Mark::Unlikely]);
        assert_eq!(
            marks(&[point(share(1.0, 0.015), 100.0)]),
            [Mark::Beaten],
            "of equals, the first by name is on the front"
        );
        // 0.795 saves less than `MIN_SAVING` compared with 0.8, and is less accurate.
        let close = [point(share(0.8, 0.003), 60.0), point(share(0.795, 0.003), 50.0)];
        assert_eq!(marks(&close), [Mark::Best, Mark::Beaten]);
        let noisy = [point(share(0.8, 0.03), 60.0), point(share(0.77, 0.03), 50.0)];
        assert_eq!(marks(&noisy), [Mark::Best, Mark::Likely]);
        let hidden = Point { hidden: true, ..point(share(0.5, 0.0), 200.0) };
        assert_eq!(marks(&[hidden, close[0]]), [Mark::Hidden, Mark::Best], "it beats nothing either");
        // A gain of 0.01 dB does not count.
        let hair = [point(share(1.0, 0.01), 100.01), point(share(1.0, 0.01), 100.06)];
        assert_eq!(marks(&hair[..1]), [Mark::Beaten]);
        assert_eq!(marks(&hair[1..]), [Mark::Best]);
        let same = [point(share(1.0, 0.01), f64::INFINITY), point(share(1.0, 0.01), f64::INFINITY)];
        assert_eq!(marks(&same), [Mark::Best, Mark::Beaten]);
        assert_eq!(
            front(&[point(None, 50.0), point(None, 60.0), point(None, 60.0)]),
            [Mark::Beaten, Mark::Best, Mark::Beaten]
        );
    }

    #[test]
    fn the_fastest_of_the_most_accurate_is_on_the_front_in_any_order() {
        let timed = |median| point(share(median, 0.001), 100.0);
        let [exact, second, fastest] = [1.0, 0.987, 0.975].map(timed);
        for (points, at) in [
            ([exact, second, fastest], 2),
            ([exact, fastest, second], 1),
            ([second, exact, fastest], 2),
            ([second, fastest, exact], 1),
            ([fastest, exact, second], 0),
            ([fastest, second, exact], 0),
        ] {
            let mut expected = [Mark::Beaten; 3];
            expected[at] = Mark::Best;
            assert_eq!(front(&points), expected);
        }
        // Too noisy to tell which is the fastest; a third setting is slower than both.
        let [a, b] = [1.0, 1.01].map(|median| point(share(median, 0.02), 100.0));
        assert_eq!(
            front(&[a, b, point(share(1.2, 0.01), 60.0)]),
            [Mark::Likely, Mark::Unlikely, Mark::Beaten]
        );
    }

    #[test]
    fn the_mean_over_views_is_narrower_than_their_ranges_and_has_one_if_all_have() {
        let views = [share(0.5, 0.1), share(0.7, 0.2)].map(Option::unwrap);
        let found = Share::mean(&views).expect("views");
        let (low, high) = found.range.expect("a range");
        let half = (0.1f64.powi(2) + 0.2f64.powi(2)).sqrt() / 2.0;
        assert!((found.median - 0.6).abs() < 1e-12, "{found:?}");
        assert!((low - (0.6 - half)).abs() < 1e-12 && (high - (0.6 + half)).abs() < 1e-12, "{found:?}");
        // Only what lies below the median lowers the mean's range.
        let skewed = Share { median: 0.5, range: Some((0.5, 0.6)) };
        assert_eq!(skewed.to_string(), "50.0 ± 10.0 %");
        let (low, high) = Share::mean(&[skewed; 4]).and_then(|mean| mean.range).expect("a range");
        assert!((low - 0.5).abs() < 1e-12 && (high - 0.55).abs() < 1e-12, "{low} {high}");
        assert_eq!(Share::mean(&[views[0], Share { range: None, ..views[1] }]).expect("views").range, None);
        assert_eq!(Share::mean(&[]), None);
    }
}
