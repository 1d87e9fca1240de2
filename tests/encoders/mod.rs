//! The built-in graphs and an example, lowered to Metal's encoders, fences and barriers.
//!
//! Nothing here needs a Mac. [`bound`] gives the minimum numbers of encoders, fences, waits and barriers. The model
//! of Metal's rules must accept each list of encoders, and object if a wait, an update, a barrier or a part of one is
//! removed.

use crate::common::{self, say, settings};
use splatgraph::draw::backend;
use splatgraph::draw::builtin;
use splatgraph::draw::facts;
use splatgraph::draw::planner::Planner;
use splatgraph::view::paint;
use splatgraph_assets::grouped;
use splatgraph_framework::dump::{self, EncoderTotals};
use splatgraph_framework::plan::Plan;
use splatgraph_metal::dump::add_encoders;
use splatgraph_metal::sync::model::{Model, mutate};
use splatgraph_metal::sync::{Division, Encoders, Encoding, encoders};
use std::sync::LazyLock;

mod bound;

/// Plans of built-in graphs, benchmark graphs, the window's graph and an example; some have parameters that add or move
/// passes. First all plans that share memory, then all that do not.
pub static PLANS: LazyLock<Vec<Plan>> = LazyLock::new(|| [true, false].into_iter().flat_map(plans).collect());

fn plans(share_memory: bool) -> Vec<Plan> {
    let mut planner = Planner::default();
    let catalog = common::catalog();
    let plain = common::facts_of(&facts::portable_device(facts::USUAL_SUBGROUP_SIZE));
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/gray_scott/graph.ron");
    let graphs = common::graphs().into_iter().chain([example]).map(|graph| (graph, vec![]));
    let varied = [
        ("splat", vec![("key_map", "equalised"), ("key_bits", "16")]),
        ("splat", vec![("sh_storage", "q8"), ("position_storage", "fixed16")]),
        ("splat", vec![("sort", "false"), ("order_of", "last_frame")]),
        ("splat", vec![("order_of", "last_frame"), ("blend", "front_to_back")]),
        ("splat", vec![("sorter", "serial"), ("digit_bits", "11")]),
    ];
    planner.share_memory = share_memory;
    let mut plan = |(graph, set): (&str, Vec<(&str, &str)>)| {
        planner
            .plan(graph, &settings(&set), &plain, &catalog)
            .unwrap_or_else(|error| panic!("{graph}: {error}"))
    };
    graphs.chain(varied).map(&mut plan).collect()
}

pub fn page() -> String {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/metal.md");
    std::fs::read_to_string(page).expect("the page is there")
}

fn waits(encodings: &[Encoding]) -> usize {
    encodings.iter().map(|encoding| encoding.waits.len()).sum()
}

fn barriers(encodings: &[Encoding]) -> usize {
    encodings.iter().flat_map(|encoding| &encoding.passes).filter(|pass| pass.barrier.is_some()).count()
}

#[test]
fn nothing_is_unordered_in_a_built_in_graph_on_metal_and_nothing_is_needless() {
    let mut mutants = 0;
    let mut wrong = Vec::new();
    for plan in &*PLANS {
        let model = Model::new(plan);
        for division in Division::ALL {
            let encoders = encoders(plan, division);
            let what = |text: String| format!("{}, {division:?}: {text}", plan.name);
            wrong.extend(model.objections(&encoders).iter().map(|found| what(found.describe(plan))));
            mutants += mutate::mutations(&encoders).len();
            let needless = mutate::needless(&model, &encoders);
            wrong.extend(needless.iter().map(|m| what(format!("needless: {}", m.describe(plan, &encoders)))));
        }
    }
    say(&format!("metal: {mutants} mutants of built-in graphs"));
    let what = "the built-in graphs, the graphs of the window and of `bench`, the examples, and variants";
    let row = format!("| {what} | {} | {} | 0 |", PLANS.len(), grouped(mutants as u64));
    assert!(page().contains(&row), "docs/metal.md: expected this row:\n{row}");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_built_in_graph_has_more_encoders_fences_or_barriers_on_metal_than_it_must_have() {
    say(
        "metal: graph, passes, encoders, fences, waits, updates, barriers of a frame; with an encoder for each pass",
    );
    let mut wrong = Vec::new();
    for plan in &*PLANS {
        let counts = |Encoders { frame, fences, .. }: &Encoders| {
            let updates: usize = frame.iter().map(|encoding| encoding.updates.len()).sum();
            [frame.len(), *fences as usize, waits(frame), updates, barriers(frame)]
        };
        let [merged, apart] = Division::ALL.map(|division| encoders(plan, division));
        say(&format!(
            "metal: {:22} {:3} {:3?} {:3?}",
            plan.name.rsplit('/').next().unwrap_or_default(),
            plan.frame.len(),
            counts(&merged),
            counts(&apart)
        ));
        let least = bound::Least::of(plan);
        let found = bound::Least {
            encoders: merged.frame.len(),
            fences: merged.fences as usize,
            waits: waits(&merged.frame),
            barriers: barriers(&merged.frame),
        };
        if found != least {
            wrong.push(format!("{}: expected {least:?}, found {found:?}", plan.name));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_page_on_metal_shows_what_the_command_prints() {
    let page = page();
    let mut missing = Vec::new();
    let mut expect = |text: String| {
        if !page.contains(&text) {
            missing.push(text);
        }
    };
    let shown = [builtin::names(), vec![paint::GRAPH]].concat();
    for name in shown {
        // The first plan of a name has default parameters, and shares memory.
        let plan = PLANS.iter().find(|plan| plan.name == name).expect("it is one of them");
        let dump = add_encoders(backend::dump(plan), plan);
        let text = dump::encoders_text(&dump).expect("they were added");
        let totals = dump.encoders.expect("they were added").frame_totals;
        let EncoderTotals { encoders, fences, waits, barriers, .. } = totals;
        let (passes, calls) = (plan.frame.len(), dump.totals.frame.calls);
        expect(format!("| `{name}` | {passes} | {encoders} | {fences} | {waits} | {barriers} | {calls} |"));
        if ["auto", "digit4"].contains(&name) {
            let frame = plan.frame.iter().map(|pass| plan.pass(*pass).bindings.len());
            let (updates, bindings) = (totals.updates, frame.sum::<usize>());
            expect(format!("| {fences} ({waits}, {updates}) | {barriers} | {bindings} |"));
            let (table, rest) = text.split_once("\nreasons\n").expect("both parts");
            let (_, counts) = rest.split_once("\ncounts\n").expect("both parts");
            expect(table.to_string());
            expect(format!("\ncounts\n{counts}"));
        }
    }
    assert!(missing.is_empty(), "docs/metal.md: expected these rows and texts:\n{}", missing.join("\n"));
}
