//! Keeps the last good product, and the error of a newer attempt, while files are being edited.
//!
//! The caller passes the time in. The picture depends on the newest attempt that succeeded. An error right after a
//! change is delayed ([`GRACE`]), because the file may be half written. If the rest arrives in time, the next attempt
//! begins and the error is never shown.

use std::time::{Duration, Instant};

/// Delay of errors after a file change.
pub const GRACE: Duration = Duration::from_millis(200);

/// One build, to be passed back with its outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Attempt {
    number: u64,
}

/// The newest product `P`, and the error `E` of a newer attempt.
#[derive(Clone, Debug)]
pub struct LastGood<P, E> {
    good: Option<P>,
    good_attempt: u64,
    newest: Attempt,
    /// Earliest time to show an error of the newest attempt; `None` to show it at once.
    patient_until: Option<Instant>,
    /// The error that was visible when a newer attempt began, with its attempt.
    shown: Option<(Attempt, E)>,
    /// Error of the newest attempt, delayed until `patient_until`.
    kept_back: Option<E>,
}

impl<P, E> Default for LastGood<P, E> {
    fn default() -> Self {
        LastGood {
            good: None,
            good_attempt: 0,
            newest: Attempt { number: 0 },
            patient_until: None,
            shown: None,
            kept_back: None,
        }
    }
}

impl<P, E> LastGood<P, E> {
    /// Creates a state without a product.
    pub fn new() -> Self {
        LastGood::default()
    }

    /// Begins an attempt because files changed. Its error will be delayed until [`GRACE`] after `now`. The error of the
    /// previous attempt is dropped if it is still delayed.
    pub fn changed(&mut self, now: Instant) -> Attempt {
        self.begin(now, Some(now + GRACE))
    }

    /// Begins an attempt for another reason (the start, a parameter). Its error is shown at once, unless a file
    /// changed less than [`GRACE`] ago.
    pub fn asked(&mut self, now: Instant) -> Attempt {
        self.begin(now, self.patient_until)
    }

    fn begin(&mut self, now: Instant, patient_until: Option<Instant>) -> Attempt {
        let newest = self.newest;
        if let Some(error) = self.kept_back.take().filter(|_| self.is_due(now)) {
            self.shown = Some((newest, error));
        }
        self.patient_until = patient_until;
        self.newest.number += 1;
        self.newest
    }

    /// Records the product of an attempt and drops the errors of older ones. If there is a newer product, does nothing
    /// and returns false.
    pub fn succeeded(&mut self, attempt: Attempt, product: P) -> bool {
        if self.good.is_some() && attempt.number < self.good_attempt {
            return false;
        }
        self.good = Some(product);
        self.good_attempt = attempt.number;
        self.shown.take_if(|(of, _)| *of <= attempt);
        if attempt == self.newest {
            self.kept_back = None;
        }
        true
    }

    /// Records the error of an attempt, unless a newer attempt has begun.
    pub fn failed(&mut self, attempt: Attempt, error: E) {
        if attempt == self.newest {
            self.kept_back = Some(error);
        }
    }

    /// Returns the newest product; `None` before the first success.
    pub fn good(&self) -> Option<&P> {
        self.good.as_ref()
    }

    /// Returns the error to show, if any: the newest attempt's unless it is delayed, otherwise the one shown before.
    pub fn error(&self, now: Instant) -> Option<&E> {
        let newer = if self.is_due(now) { self.kept_back.as_ref() } else { None };
        newer.or(self.shown.as_ref().map(|(_, error)| error))
    }

    /// Returns the time at which a delayed error becomes visible; `None` if no error is delayed.
    pub fn due(&self, now: Instant) -> Option<Instant> {
        self.patient_until.filter(|_| self.kept_back.is_some() && !self.is_due(now))
    }

    fn is_due(&self, now: Instant) -> bool {
        self.patient_until.is_none_or(|until| until <= now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Shown = LastGood<&'static str, &'static str>;

    const MS: Duration = Duration::from_millis(1);

    fn working() -> (Shown, Instant) {
        let mut shown = Shown::new();
        let now = Instant::now();
        let attempt = shown.asked(now);
        assert!(shown.succeeded(attempt, "first"));
        (shown, now)
    }

    #[test]
    fn what_never_worked_says_so_at_once() {
        let mut shown = Shown::new();
        let now = Instant::now();
        assert_eq!((shown.good(), shown.error(now)), (None, None));
        let attempt = shown.asked(now);
        shown.failed(attempt, "no such graph");
        assert_eq!((shown.good(), shown.error(now)), (None, Some(&"no such graph")));
        assert_eq!(shown.due(now), None);
    }

    #[test]
    fn an_error_leaves_the_last_good_and_is_shown_after_the_grace() {
        let (mut shown, now) = working();
        let attempt = shown.changed(now);
        shown.failed(attempt, "syntax error");
        assert_eq!((shown.good(), shown.error(now)), (Some(&"first"), None));
        assert_eq!(shown.due(now), Some(now + GRACE));
        assert_eq!(shown.error(now + GRACE - MS), None);
        assert_eq!(shown.error(now + GRACE), Some(&"syntax error"));
        assert_eq!(shown.due(now + GRACE), None);
        assert_eq!(shown.good(), Some(&"first"));
    }

    #[test]
    fn an_error_that_comes_after_the_grace_is_shown_at_once() {
        let (mut shown, now) = working();
        let attempt = shown.changed(now);
        shown.failed(attempt, "after a long build");
        assert_eq!(shown.error(now + GRACE + MS), Some(&"after a long build"));
    }

    #[test]
    fn half_a_file_is_never_shown_as_an_error() {
        let (mut shown, now) = working();
        let half = shown.changed(now);
        shown.failed(half, "half a file");
        let whole = shown.changed(now + 50 * MS);
        for later in [50, 199, 200, 1000] {
            assert_eq!(shown.error(now + later * MS), None, "after {later} ms");
        }
        assert!(shown.succeeded(whole, "second"));
        assert_eq!((shown.good(), shown.error(now + 300 * MS)), (Some(&"second"), None));
    }

    #[test]
    fn an_error_of_an_attempt_that_was_overtaken_does_not_count() {
        let (mut shown, now) = working();
        let half = shown.changed(now);
        let whole = shown.changed(now + 50 * MS);
        shown.failed(half, "half a file");
        assert_eq!(shown.error(now + 10_000 * MS), None);
        assert!(shown.succeeded(whole, "second"));
        assert_eq!(shown.error(now + 10_000 * MS), None);
    }

    #[test]
    fn a_shown_error_stays_until_the_next_attempt_is_decided() {
        let (mut shown, now) = working();
        let attempt = shown.changed(now);
        shown.failed(attempt, "one");
        let later = now + 1000 * MS;
        assert_eq!(shown.error(later), Some(&"one"));
        let attempt = shown.changed(later);
        assert_eq!(shown.error(later), Some(&"one"), "it does not flicker");
        shown.failed(attempt, "two");
        assert_eq!(shown.error(later + GRACE - MS), Some(&"one"));
        assert_eq!(shown.error(later + GRACE), Some(&"two"));
        let attempt = shown.changed(later + 500 * MS);
        assert!(shown.succeeded(attempt, "second"));
        assert_eq!((shown.good(), shown.error(later + 500 * MS)), (Some(&"second"), None));
        assert_eq!(shown.error(later + 9000 * MS), None);
    }

    #[test]
    fn an_older_success_mends_what_is_shown_but_not_what_is_newer() {
        let (mut shown, now) = working();
        let bad = shown.changed(now);
        shown.failed(bad, "one");
        let good = shown.changed(now + 1000 * MS);
        let worse = shown.changed(now + 1100 * MS);
        assert!(shown.succeeded(good, "second"));
        assert_eq!(shown.error(now + 1100 * MS), None);
        shown.failed(worse, "two");
        assert_eq!(shown.error(now + 1300 * MS), Some(&"two"));
        assert_eq!(shown.good(), Some(&"second"));
        // An attempt that began before the visible error succeeds late.
        let late = shown.changed(now + 2000 * MS);
        let worst = shown.changed(now + 2100 * MS);
        shown.failed(worst, "three");
        let newest = shown.changed(now + 3000 * MS);
        assert!(shown.succeeded(late, "third"));
        assert_eq!((shown.good(), shown.error(now + 3000 * MS)), (Some(&"third"), Some(&"three")));
        assert!(shown.succeeded(newest, "fourth"));
        assert_eq!(shown.error(now + 3000 * MS), None);
    }

    #[test]
    fn an_older_product_does_not_replace_a_newer_one() {
        let (mut shown, now) = working();
        let one = shown.changed(now);
        let two = shown.changed(now);
        assert!(shown.succeeded(two, "second"));
        assert!(!shown.succeeded(one, "stale"));
        assert_eq!(shown.good(), Some(&"second"));
    }

    #[test]
    fn a_parameter_changed_right_after_a_file_is_as_patient_as_the_file() {
        let (mut shown, now) = working();
        shown.changed(now);
        let attempt = shown.asked(now + 10 * MS);
        shown.failed(attempt, "half a file");
        assert_eq!(shown.error(now + 100 * MS), None);
        assert_eq!(shown.error(now + GRACE), Some(&"half a file"));
    }
}
