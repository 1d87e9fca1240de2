//! Random graphs, lowered to Metal's encoders, fences and barriers.

use splatgraph_metal::sync::model::{Model, mutate};
use splatgraph_metal::sync::{Division, encoders};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use super::builds::{for_all, shown};
use super::recipe::LARGE;
use crate::common::say;

#[test]
fn nothing_is_unordered_on_metal_and_nothing_is_needless() {
    let (mutants, fences) = (AtomicUsize::new(0), AtomicUsize::new(0));
    for_all("metal", LARGE, 1000, |case| {
        for plan in [&case.plan, &case.plan(case.sketch.settings[0], false)?] {
            let model = Model::new(plan);
            for division in Division::ALL {
                let encoders = encoders(plan, division);
                let what =
                    |text: String| Err(format!("{division:?}: {text}\n{encoders:#?}\n{}", shown(plan)));
                if let Some(objection) = model.objections(&encoders).first() {
                    return what(objection.describe(plan));
                }
                if let Some(mutation) = mutate::needless(&model, &encoders).first() {
                    return what(format!("needless: {}", mutation.describe(plan, &encoders)));
                }
                mutants.fetch_add(mutate::mutations(&encoders).len(), Relaxed);
                fences.fetch_add(encoders.fences as usize, Relaxed);
            }
        }
        Ok(())
    });
    let [mutants, fences] = [mutants, fences].map(AtomicUsize::into_inner);
    say(&format!("random graphs: metal: {fences} fences, {mutants} mutants"));
    assert!(mutants > 10_000, "too few mutants");
}
