use super::example::{self, dump};
use crate::dump::{Diff, Dump, diff, diff_text};

fn example_dump(digits: u32) -> Dump {
    dump(&example::splat(digits))
}

fn total(diff: &Diff, name: &str) -> (u64, u64, i64) {
    let total = diff.totals.iter().find(|t| t.name == name).unwrap_or_else(|| panic!("no {name}"));
    (total.a, total.b, total.change)
}

#[test]
fn a_plan_is_no_different_from_itself() {
    let dump = example_dump(8);
    let diff = diff(&dump, &dump);
    assert!(diff.is_empty() && diff.parameters.is_empty() && diff.facts.is_empty());
    assert_eq!(diff.passes.same, dump.passes.len());
    assert_eq!(diff.barriers.same, dump.barriers().count());
    assert_eq!(diff.resources.same, dump.resources.len());
    assert!(diff.totals.iter().all(|t| t.a == t.b && t.change == 0));
}

#[test]
fn more_iterations_are_passes_and_barriers_of_one_side() {
    let (a, b) = (example_dump(4), example_dump(8));
    let there = diff(&a, &b);
    assert_eq!(there.passes.only_b.len(), 12);
    assert!(there.passes.only_a.is_empty());
    assert_eq!(total(&there, "passes"), (22, 34, 12));
    let change = b.totals.frame.barriers as i64 - a.totals.frame.barriers as i64;
    assert_eq!(total(&there, "barriers of the frame").2, change);
    assert_eq!(there.barriers.only_b.len() as i64, change);
    let parameter = &there.parameters[0];
    assert_eq!((parameter.a.as_deref(), parameter.b.as_deref()), (Some("8"), Some("4")));

    let back = diff(&b, &a);
    assert_eq!(back.passes.only_a, there.passes.only_b);
    assert_eq!(back.resources.changed.len(), there.resources.changed.len());
    assert_eq!(total(&back, "passes"), (34, 22, -12));
}

#[test]
fn changes_of_a_pass_are_named() {
    let a = example_dump(4);
    let mut plan = example::splat(4);
    plan.shaders.iter_mut().filter(|s| s.name == "project.comp").for_each(|s| {
        s.defines[0].1 = "5".into();
        s.defines.push(("NEW".into(), "1".into()));
    });
    let project = plan.passes.iter_mut().find(|p| p.name == "project").expect("it is there");
    project.bindings[0].resource = project.bindings[1].resource;
    let diff = diff(&a, &dump(&plan));
    assert_eq!(diff.passes.changed.len(), 1);
    let change = &diff.passes.changed[0];
    assert_eq!(change.name, "project");
    let names: Vec<&str> = change.changes.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["define DIGIT_BITS", "binding Camera", "define NEW"]);
    assert_eq!((&change.changes[2].a, change.changes[2].b.as_deref()), (&None, Some("1")));
}

#[test]
fn another_file_of_a_shader_is_a_change_only_if_its_code_differs() {
    let a = example_dump(4);
    let mut plan = example::splat(4);
    let shader = plan.shaders.iter_mut().find(|s| s.name == "project.comp").expect("it is there");
    shader.path = "mine/project.comp".into();
    assert!(diff(&a, &dump(&plan)).is_empty());
    let shader = plan.shaders.iter_mut().find(|s| s.name == "project.comp").expect("it is there");
    shader.spirv = std::sync::Arc::new(vec![1]);
    shader.defines[0].1 = "5".into();
    let b = dump(&plan);
    let changed = diff(&a, &b).passes.changed;
    let code = changed[0].changes.last().expect("a change");
    assert!(code.name == "code of project.comp", "{changed:?}");
    assert!(code.b.as_ref().is_some_and(|b| b.starts_with("mine/project.comp, SPIR-V ")), "{code:?}");
    assert!(crate::dump::text(&b).contains("\n  project.comp             mine/project.comp\n"));
}

#[test]
fn a_barrier_with_other_masks_or_reasons_is_changed_and_one_on_another_line_is_not() {
    let a = example_dump(4);
    let mut plan = example::splat(4);
    plan.passes.iter_mut().for_each(|p| p.origin.line += 7);
    let mut other = dump(&plan);
    other.handover.clear();
    let moved = diff(&a, &other);
    assert!(moved.passes.changed.is_empty() && moved.barriers.changed.is_empty());
    assert_eq!(moved.barriers.only_a.len(), a.handover.len(), "the handover's");

    let pass = other.passes.iter_mut().rfind(|pass| !pass.barriers.is_empty()).expect("there are barriers");
    pass.barriers[0].masks.source_stages = crate::ir::Stages::all();
    let wider = diff(&a, &other);
    assert_eq!(wider.barriers.changed.len(), 1);
    assert_eq!(wider.barriers.changed[0].a.masks.source_stages.iter().count(), 1);
    assert_eq!(wider.barriers.changed[0].b.masks.source_stages.iter().count(), 10);
}

#[test]
fn a_statistic_in_another_word_or_that_grows_nothing_and_another_output_are_differences() {
    let a = example_dump(4);
    let stat = a.stats.first().expect("it has statistics").name.clone();
    let mut fixed = a.clone();
    fixed.stats[0].grows.clear();
    let mut moved = a.clone();
    moved.stats[0].offset += 16;
    for other in [fixed, moved] {
        let diff = diff(&a, &other);
        assert!(!diff.is_empty() && diff.stats.len() == 1 && diff.stats[0].name == stat, "{diff:?}");
        assert!(diff_text(&diff).contains(&format!("\nstatistics\n  {stat} ")), "{}", diff_text(&diff));
    }
    let mut shown = a.clone();
    shown.output = "color".into();
    shown.outputs.insert("depth".into(), "depth".into());
    let names: Vec<String> = diff(&a, &shown).outputs.into_iter().map(|change| change.name).collect();
    assert!(!diff(&a, &shown).is_empty() && names == ["output", "output depth"], "{names:?}");
}

#[test]
fn resources_change_in_size_and_neighbours() {
    let a = example_dump(4);
    let mut plan = example::splat(4);
    let table = plan.find_resource("sort.table").expect("it is there");
    plan.blocks.iter_mut().for_each(|b| b.aliases.retain(|t| *t != table));
    plan.resources[table.index()].block = None;
    let diff = diff(&a, &dump(&plan));
    let changed: Vec<&str> = diff.resources.changed.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(changed, ["visible", "sort.table"]);
    assert!(diff.resources.changed.iter().all(|c| c.changes[0].name == "shares memory with"));
}

#[test]
fn the_text_says_once_what_is_the_same_for_all_iterations() {
    let text = diff_text(&diff(&example_dump(4), &example_dump(8)));
    for line in [
        "  digit_bits           8 -> 4",
        "  only in b (12): sort.histogram[4..7], sort.scan[4..7], sort.scatter[4..7]",
        "  sort.scan[1..3]\n    push shift: 8 -> 4, 16 -> 8, 24 -> 12",
        "  only in b: before sort.scan[4..7], on all memory",
        "    - write after read on sort.totals in the memory of color, after compose of the previous frame: COMPUTE STORAGE_READ -> CLEAR TRANSFER_WRITE\n",
        "    + write after read on sort.totals, after sort.scan[7] of the previous frame: COMPUTE STORAGE_READ -> CLEAR TRANSFER_WRITE\n",
        "  passes                                  22            34           +12",
    ] {
        assert!(text.contains(line), "no {line} in\n{text}");
    }
}

#[test]
fn a_comparison_survives_json() {
    let diff = diff(&example_dump(4), &example_dump(8));
    let text = serde_json::to_string(&diff).expect("plain data");
    assert_eq!(serde_json::from_str::<Diff>(&text).expect("it is JSON"), diff);
}
