//! Tests the viewer while single calls of the device fail.
//!
//! In each visit, one call fails. Nothing may panic, hang or leak, and the last frame and state must equal those of a
//! visit without faults. With `SPLATGRAPH_LONG`, every call of every kind fails once; otherwise, some of each kind.

use super::script::{Outcome, Script, check_no_panic, loses};
use crate::view::events::Event;
use splatgraph_null::{Config, Fault, Point};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

const SOME: u64 = 4;

/// Entries that each frame needs; more than the plan's capacity, so that the plan must grow.
const NEEDED: u32 = 300;

const THREADS: usize = 6;

fn visit(faults: &[Fault]) -> (Outcome, Vec<Event>, BTreeMap<Point, u64>) {
    let mut script = Script::open(&Config {
        faults: faults.to_vec(),
        read: NEEDED,
        compile_patience: Duration::from_millis(500),
        ..Config::default()
    });
    script.visit();
    script.close(faults)
}

#[test]
fn whatever_call_of_the_device_fails_the_viewer_goes_on_and_ends_in_the_same_state() {
    let (sound, events, counts) = visit(&[]);
    check_no_panic(&events);
    assert!(!loses(&events), "{events:#?}");
    println!("calls of a visit: {counts:?}");
    let mut faults = Vec::new();
    for (point, count) in counts {
        let step =
            if std::env::var_os("SPLATGRAPH_LONG").is_some() { 1 } else { count.div_ceil(SOME).max(1) };
        faults.extend((0..count).step_by(step as usize).map(|after| Fault { point, after }));
    }
    // The threads need no core each: a visit mostly waits for files to settle, and for retries.
    let (next, reached, lost) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
    let work = || {
        while let Some(fault) = faults.get(next.fetch_add(1, Ordering::Relaxed)) {
            let (outcome, events, counts) = visit(&[*fault]);
            check_no_panic(&events);
            assert_eq!(outcome, sound, "after {fault:?}: {events:#?}");
            // The number of frames depends on timing, so the last calls of one visit may be missing in another.
            reached.fetch_add(usize::from(counts[&fault.point] > fault.after), Ordering::Relaxed);
            lost.fetch_add(usize::from(loses(&events)), Ordering::Relaxed);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(work);
        }
    });
    let (reached, lost) = (reached.into_inner(), lost.into_inner());
    println!(
        "{} visits, {reached} with a fault; in {lost} the device or the window was lost and opened again",
        faults.len()
    );
    assert!(2 * reached > faults.len() && lost > 0);
}
