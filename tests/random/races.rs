//! Races inside a pass. Graphs with a race are refused, and the model finds a race that is added to a plan.

use splatgraph_framework::ir::{Accesses, Stages, Use, Work as PlanWork};
use splatgraph_vulkan::sync::model::{Replay, replay};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use super::builds::{barriers, for_all, plan, shown};
use super::recipe::{Kind, LARGE, Role};
use super::render::{Style, render};
use super::sketch::Target;
use crate::common::say;

#[test]
fn a_dispatch_that_writes_the_buffer_of_its_own_arguments_is_refused() {
    let (refused, absent) = (AtomicUsize::new(0), AtomicUsize::new(0));
    for_all("own arguments", LARGE, 500, |case| {
        let writes_arguments = |at: &usize| {
            let pass = &case.sketch.passes[*at];
            let args = |of| matches!(of, Target::Buffer(at) if case.sketch.buffers[at].role == Role::Args);
            let what = pass.binds.iter().find(|bind| bind.writes && args(bind.what.of))?.what;
            matches!(pass.work, Kind::Dispatch { .. }).then_some((*at, what))
        };
        for (at, what) in (0..case.sketch.passes.len()).filter_map(|at| writes_arguments(&at)) {
            let mut sketch = case.sketch.clone();
            sketch.passes[at].indirect = Some((what, 0));
            let files = render(&sketch, Style::default());
            match plan(&files, sketch.settings[0], true) {
                Err(error) if error.contains("which holds its own arguments") => {
                    refused.fetch_add(1, Relaxed);
                }
                Err(error) => return Err(format!("another error: {error}\nof\n{}", files.graph)),
                // A false condition or an empty repeat removes the pass.
                Ok(plan) if plan.passes.iter().all(|pass| !pass.name.starts_with(&format!("p{at:02}"))) => {
                    absent.fetch_add(1, Relaxed);
                }
                Ok(_) => return Err(format!("a race is accepted in\n{}", files.graph)),
            }
        }
        Ok(())
    });
    let [refused, absent] = [refused, absent].map(AtomicUsize::into_inner);
    say(&format!("random graphs: {refused} races refused, {absent} passes left out"));
    assert!(refused > 50, "too few races");
}

#[test]
fn the_oracle_finds_a_race_between_the_stages_of_a_draw() {
    let races = AtomicUsize::new(0);
    for_all("stages", LARGE, 300, |case| {
        for (at, pass) in case.plan.passes.iter().enumerate() {
            let reads = |touch: &&Use| {
                (touch.stages, touch.accesses, touch.layout) == (Stages::VERTEX, Accesses::STORAGE_READ, None)
            };
            let (PlanWork::Draw { .. }, Some(read)) = (&pass.work, pass.uses.iter().find(reads)) else {
                continue;
            };
            let write = Use { stages: Stages::FRAGMENT, accesses: Accesses::STORAGE_WRITE, ..*read };
            let mut racy = case.plan.clone();
            racy.passes[at].uses.push(write);
            let name = format!("`{}` (", pass.name);
            let found = replay(&racy, &barriers(&case.plan), &Replay::default());
            let own = |text: &String| text.matches(&name).count() == 2 && text.contains("without waiting");
            if !found.iter().map(|violation| violation.describe(&racy)).any(|text| own(&text)) {
                return Err(format!("no race is found in `{}` of\n{}", pass.name, shown(&racy)));
            }
            races.fetch_add(1, Relaxed);
        }
        Ok(())
    });
    assert!(races.into_inner() > 50, "too few draws");
}
