//! Measures elapsed time. Of the time for which this process is stopped, it counts at most [`MAX_STEP`].

use std::time::{Duration, Instant};

/// Maximum time counted between two looks. The caller looks more often than this, unless the process is stopped
/// (Ctrl-Z, a suspended batch job), and then the watched work, or its completion, is stopped as well.
const MAX_STEP: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug)]
pub(crate) struct Stopwatch {
    time: Duration,
    looked: Instant,
}

impl Stopwatch {
    pub fn start() -> Stopwatch {
        Stopwatch { time: Duration::ZERO, looked: Instant::now() }
    }

    /// Returns the time since the start. Each call counts at most [`MAX_STEP`] since the previous one.
    pub fn look(&mut self) -> Duration {
        self.look_at(Instant::now())
    }

    fn look_at(&mut self, now: Instant) -> Duration {
        self.time += now.saturating_duration_since(self.looked).min(MAX_STEP);
        self.looked = now;
        self.time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_for_which_the_process_is_stopped_does_not_count() {
        let mut watch = Stopwatch::start();
        let mut now = watch.looked;
        for _ in 0..100 {
            now += Duration::from_millis(20);
            watch.look_at(now);
        }
        assert_eq!(watch.look_at(now), Duration::from_secs(2));
        assert_eq!(watch.look_at(now + Duration::from_secs(3600)), Duration::from_secs(3));
    }
}
