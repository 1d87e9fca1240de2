//! Properties of every graph, checked on random graphs.
//!
//! `recipe` generates raw material with proptest, `sketch` turns it into a valid graph, and `render` writes the graph's
//! file and shaders. `compiler` replaces glslang, `builds` builds and counts, and `orders` finds the other orders of a
//! frame. The properties here need no GPU: the [oracle](splatgraph_vulkan::sync::model) judges. The properties in `gpu`
//! and `histories` run the shaders.

pub mod builds;
mod compiler;
mod contents;
mod encoders;
pub mod gpu;
mod histories;
mod orders;
mod races;
mod recipe;
mod render;
mod sketch;

use builds::{barriers, for_all, plan, run_batch, shown};
use recipe::{LARGE, SMALL, Settings};
use render::{Style, render};
use sketch::Sketch;
use splatgraph_framework::ir::{DrawCall, Groups, Origin, Pass, Run, ShaderStage, Shape, Source, Work};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::{Glslang, ShaderCompiler, ShaderRequest};
use splatgraph_framework::solve::reorder;
use splatgraph_framework::source::{Kind, Library, SourceMap, render as explain};
use splatgraph_vulkan::sync::model::{self, Rules, mutate};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use crate::common::{long, say};

#[test]
fn no_barrier_is_missing_and_none_is_needless_and_a_call_has_at_most_one_on_all_memory() {
    let tested = AtomicUsize::new(0);
    for_all("barriers", LARGE, 2000, |case| {
        let tests = |pass: &&Pass| matches!(&pass.work, Work::Draw { depth: Some(_), .. });
        tested.fetch_add(case.plan.passes.iter().filter(tests).count(), Relaxed);
        case.judge(&case.plan, "with memory shared")?;
        case.judge(&case.plan(case.sketch.settings[0], false)?, "with memory apart")
    });
    let tested = tested.into_inner();
    say(&format!("random graphs: {tested} draws with a depth attachment"));
    assert!(tested > 100, "too few depth attachments");
}

#[test]
fn a_graph_that_is_built_twice_gives_the_same_plan_and_names_decide_nothing() {
    for_all("names", LARGE, 1000, |case| {
        same(&case.plan, &case.plan(case.sketch.settings[0], true)?, "built again")?;
        let files = render(&case.sketch, Style { other_names: true, ..Style::default() });
        let renamed = plan(&files, case.sketch.settings[0], true)?;
        same(&nameless(&case.plan), &nameless(&renamed), "with other names")
    });
}

/// Returns the plan without names, and without texts that contain names.
fn nameless(plan: &Plan) -> Plan {
    let mut plan = plan.clone();
    plan.resources.iter_mut().for_each(|r| {
        r.name.clear();
        r.history.iter_mut().for_each(String::clear);
    });
    plan.shaders.iter_mut().for_each(|shader| {
        shader.name.clear();
        shader.path.clear();
    });
    plan.passes.iter_mut().for_each(|pass| {
        pass.name.clear();
        pass.phase.clear();
    });
    plan.culled.iter_mut().for_each(|left_out| left_out.pass.clear());
    plan.warnings.clear();
    clear_reasons(&mut plan);
    plan
}

/// Clears the reasons why parameters have no effect: they name passes and lines.
fn clear_reasons(plan: &mut Plan) {
    plan.effects.iter_mut().for_each(|effect| effect.none.iter_mut().for_each(String::clear));
}

#[test]
fn includes_decide_nothing() {
    let (parts, pairs) = (AtomicUsize::new(0), AtomicUsize::new(0));
    for_all("includes", LARGE, 500, |case| {
        let files = render(&case.sketch, Style { includes: true, ..Style::default() });
        parts.fetch_add(files.parts.len(), Relaxed);
        pairs.fetch_add(files.parts.iter().filter(|(_, text)| text.contains("ping_pong")).count(), Relaxed);
        for settings in case.sketch.settings {
            let flat = case.plan(settings, true)?;
            let included =
                plan(&files, settings, true).map_err(|error| format!("{error}\nof\n{}", files.graph))?;
            same(&placeless(&nameless(&flat)), &placeless(&nameless(&included)), "with includes")?;
        }
        Ok(())
    });
    let [parts, pairs] = [parts, pairs].map(AtomicUsize::into_inner);
    say(&format!("random graphs: {parts} graphs included, {pairs} with ping-pong ports"));
    assert!(parts > 1000 && pairs > 100, "too few includes");
}

#[test]
fn passes_without_readers_decide_nothing() {
    for_all("idle passes", LARGE, 1000, |case| {
        let files = render(&case.sketch, Style { idle_passes: true, ..Style::default() });
        let with_idle = plan(&files, case.sketch.settings[0], true)?;
        let idle = with_idle.culled.iter().filter(|left_out| left_out.pass.starts_with("idle")).count();
        if idle == 0 {
            return Err(format!("no idle pass is left out of\n{}", files.graph));
        }
        same(&placeless(&case.plan), &placeless(&with_idle), "with idle passes")
    });
}

/// Returns the plan without line numbers, culled passes, warnings, and reasons for having no effect.
fn placeless(plan: &Plan) -> Plan {
    let mut plan = plan.clone();
    plan.culled.clear();
    plan.warnings.clear();
    let nowhere = Origin { file: String::new(), line: 0, column: 0 };
    plan.params.iter_mut().for_each(|param| param.origin = nowhere.clone());
    plan.resources.iter_mut().for_each(|resource| resource.origin = nowhere.clone());
    plan.passes.iter_mut().for_each(|pass| pass.origin = nowhere.clone());
    clear_reasons(&mut plan);
    plan
}

#[test]
fn parameters_without_an_effect_decide_nothing() {
    let idle = AtomicUsize::new(0);
    for_all("effects", LARGE, 2000, |case| {
        let used = case.sketch.settings[0];
        let valueless = |plan: &Plan| {
            let mut plan = placeless(plan);
            plan.params.clear();
            plan
        };
        for other in Settings::all() {
            // Only parameters without an effect differ.
            let changed = [("flag", other.flag != used.flag), ("steps", other.steps != used.steps)];
            let without = |name| case.plan.no_effect(name).is_some();
            if changed.iter().all(|(name, changed)| !changed || without(name)) && other != used {
                idle.fetch_add(1, Relaxed);
                let plan = case.plan(other, true)?;
                same(
                    &valueless(&case.plan),
                    &valueless(&plan),
                    "with a parameter without an effect changed",
                )?;
            }
        }
        Ok(())
    });
    assert!(idle.into_inner() > 1000, "too few parameters without an effect");
}

fn same(one: &Plan, other: &Plan, what: &str) -> Result<(), String> {
    if one == other {
        return Ok(());
    }
    Err(format!("another plan {what}:\n{}\n{}", shown(one), shown(other)))
}

#[test]
fn shared_memory_is_no_more_and_held_by_one_at_a_time() {
    let beside = AtomicUsize::new(0);
    for_all("memory", LARGE, 2000, |case| {
        beside.fetch_add(reads_beside_images(&case.plan), Relaxed);
        let apart = case.plan(case.sketch.settings[0], false)?;
        let [shared_bytes, bytes] = [&case.plan, &apart].map(Plan::transient_bytes);
        if shared_bytes > bytes || bytes != apart.unshared_bytes() {
            return Err(format!("{shared_bytes} bytes shared, {bytes} apart\n{}", shown(&case.plan)));
        }
        if let Some(block) = apart.blocks.iter().find(|block| block.aliases.len() != 1) {
            return Err(format!("{block:?} is shared, and should not be"));
        }
        tenants_take_turns(&case.plan)
    });
    let beside = beside.into_inner();
    say(&format!(
        "random graphs: {beside} reads of single words behind the pixels of an image in the same memory"
    ));
    assert!(beside > 0, "no reads of single words beside images");
}

/// Counts the reads of indirect arguments and statistics behind the last pixel of an image in the same block.
fn reads_beside_images(plan: &Plan) -> usize {
    let arguments = plan.passes.iter().filter_map(|pass| match pass.work {
        Work::Dispatch { groups: Groups::Indirect { buffer, offset }, .. } => Some((buffer, offset)),
        Work::Draw { call: DrawCall::Indirect { buffer, offset }, .. } => Some((buffer, offset)),
        _ => None,
    });
    let words = arguments.chain(plan.stats.iter().map(|stat| (stat.buffer, stat.offset)));
    words
        .filter(|(buffer, offset)| {
            let mut aliases = plan.aliases(*buffer).map(|alias| plan.resource(alias));
            aliases.any(|alias| matches!(alias.shape, Shape::Image { .. }) && alias.bytes() <= *offset)
        })
        .count()
}

/// Checks that resources of one block are never used at the same time. Resources that outlive a frame must share none.
fn tenants_take_turns(plan: &Plan) -> Result<(), String> {
    for (resource, block) in plan.resources.iter().filter_map(|r| Some((r, r.block?))) {
        if resource.source != Source::Transient || block.index() >= plan.blocks.len() {
            return Err(format!("`{}` is in no block that there is", resource.name));
        }
    }
    for block in plan.blocks.iter().filter(|block| block.aliases.len() > 1) {
        let mut lives = Vec::new();
        for alias in &block.aliases {
            let resource = plan.resource(*alias);
            let uses = |id| plan.pass(id).uses.iter().any(|touch| touch.resource == *alias);
            let once =
                plan.passes.iter().any(|p| p.run == Run::Once && p.uses.iter().any(|t| t.resource == *alias));
            let uses: Vec<usize> = (0..plan.frame.len()).filter(|at| uses(plan.frame[*at])).collect();
            match (uses.first(), uses.last()) {
                (Some(first), Some(last)) if !once && resource.history.is_none() => {
                    lives.push((*first, *last, &resource.name));
                }
                _ => return Err(format!("`{}` shares memory\n{}", resource.name, shown(plan))),
            }
        }
        lives.sort();
        if let Some(pair) = lives.windows(2).find(|pair| pair[0].1 >= pair[1].0) {
            return Err(format!("`{}` and `{}` share memory\n{}", pair[0].2, pair[1].2, shown(plan)));
        }
    }
    Ok(())
}

#[test]
fn a_mutant_is_judged_alike_from_its_mutation_on_and_from_the_start() {
    for_all("trials", SMALL, 150, |case| {
        let (plan, barriers) = (&case.plan, barriers(&case.plan));
        for rules in [Rules::HAZARDS, Rules::NECESSARY, Rules::AVAILABILITY] {
            let needless = mutate::needless_by(plan, &barriers, rules);
            for mutation in mutate::mutations(plan, &barriers) {
                let found = model::has_violation(plan, &mutate::apply(&barriers, &mutation), rules);
                if found == needless.contains(&mutation) {
                    let text = mutation.describe(plan, &barriers);
                    return Err(format!("{text}: {found} from the start\n{}", shown(&case.plan)));
                }
            }
        }
        Ok(())
    });
}

#[test]
fn target_writes_of_random_graphs_that_could_go_by_availability_alone_are_counted() {
    let (all, spare) = (AtomicUsize::new(0), AtomicUsize::new(0));
    for_all("availability", LARGE, 500, |case| {
        let (here, could_go) = crate::mutations::target_writes(&case.plan);
        all.fetch_add(here, Relaxed);
        spare.fetch_add(could_go, Relaxed);
        Ok(())
    });
    let [all, spare] = [all, spare].map(AtomicUsize::into_inner);
    say(&format!("random graphs: {all} target writes, {spare} could go by availability"));
    assert!(spare > 0 && spare < all);
}

#[test]
fn plans_of_one_graph_can_follow_each_other() {
    for_all("swaps", LARGE, 1000, |case| {
        let [settings, other] = case.sketch.settings;
        let apart = case.plan(settings, false)?;
        for (one, share_memory) in [(&case.plan, true), (&apart, false)] {
            let two = case.plan(other, share_memory)?;
            let (of_one, of_two) = (barriers(one), barriers(&two));
            let (a, b) = ((one, &of_one), (&two, &of_two));
            let plans = [(a, 2), (b, 1), (a, 1), (b, 3), (b, 1), (a, 4)];
            let plans = plans.map(|((plan, barriers), frames)| (plan, barriers, frames));
            if let Some(violation) = model::replay_swap(&plans).first() {
                let plan = plans[violation.plan].0;
                let text = violation.describe(plan);
                return Err(format!("in plan {} of a row: {text}\n{}", violation.plan, shown(plan)));
            }
        }
        Ok(())
    });
}

#[test]
fn barriers_suit_up_to_200_orders_of_a_frame() {
    const MAX_ORDERS: usize = 200;
    for_all("orders", SMALL, 1500, |case| {
        for order in orders::orders(&case.plan, MAX_ORDERS) {
            for share_memory in [true, false] {
                let plan = reorder(&case.plan, &order, share_memory);
                case.judge(&plan, &format!("in the order {order:?}"))?;
            }
        }
        Ok(())
    });
}

#[test]
fn declarations_say_what_the_compiler_finds() {
    let compared = AtomicUsize::new(0);
    let cases = if long() { 1000 } else { 40 };
    let found = run_batch(0, cases, LARGE, |recipe| {
        let files = render(&Sketch::of(recipe, LARGE), Style::default());
        compared.fetch_add(files.shaders.len(), Relaxed);
        files.shaders.iter().try_for_each(|(name, text)| compare_reflections(name, text))
    });
    found.unwrap_or_else(|text| panic!("{text}"));
    let compared = compared.into_inner();
    say(&format!("random graphs: declarations of {compared} shaders compared"));
}

fn compare_reflections(name: &str, text: &str) -> Result<(), String> {
    let mut library = Library::default();
    library.memory.insert(name.into(), text.into());
    let mut files = SourceMap::new(library);
    let file = files.find(None, name, Kind::Shader).map_err(|e| e.to_string())?;
    let stage = ShaderStage::of_file(name).ok_or("no shader's name")?;
    let request = ShaderRequest { file, stage, defines: &[], unfit: &[], live_glsl: None };
    let compiled = Glslang::default().compile(&mut files, &request);
    let compiled = compiled.map_err(|e| explain(&files, &e, false))?;
    let mut stated = compiler::reflection(text, stage);
    // Declarations state neither features nor the order of accesses.
    stated.features = compiled.reflection.features;
    for (stated, found) in stated.bindings.iter_mut().zip(&compiled.reflection.bindings) {
        stated.writes_first = found.writes_first;
    }
    if compiled.reflection == stated {
        return Ok(());
    }
    Err(format!("the declarations say {stated:#?}\nand the compiler {:#?}\nof\n{text}", compiled.reflection))
}
