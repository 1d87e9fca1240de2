mod diff;
mod encoders;
mod example;
mod schema;

use super::*;
use crate::ir::{Accesses, Hazard, ResourceId, Run, Source, Use, Value};
use crate::plan::{Plan, Resource};
use crate::testing;
use example::dump;

/// Returns a dump whose frame passes take 1, 2, 3, ... milliseconds, except passes that need no time.
fn timed(plan: Plan) -> Dump {
    let dump = dump(&plan);
    let times =
        dump.passes.iter().filter(|p| !p.needs_no_time() && p.run == Run::Frame).map(|p| p.name.clone());
    let times: Vec<(String, f64)> = times.zip((1..).map(f64::from)).collect();
    Dump { frame_ms: Some(200.0), ..dump.with_times(&times).0 }
}

fn resource<'a>(dump: &'a Dump, name: &str) -> &'a DumpResource {
    dump.resources.iter().find(|r| r.name == name).unwrap_or_else(|| panic!("no resource {name}"))
}

#[test]
fn a_dump_read_back_from_json_is_the_same() {
    let dump = timed(example::splat(8));
    let back: Dump = serde_json::from_str(&json(&dump).to_string()).expect("it is JSON");
    assert_eq!(back, dump);
}

#[test]
fn a_parameter_has_the_passes_that_depend_on_it_or_the_reason_why_none_does() {
    let dump = dump(&example::splat(8));
    let [digit_bits, cutoff, blend] = &dump.parameters[..] else { panic!("three parameters") };
    assert_eq!(digit_bits.affects, [&*dump.passes[1].name, &*dump.passes[2].name]);
    assert_eq!((digit_bits.shape, blend.shape, &blend.no_effect), (true, false, &None));
    assert_eq!(cutoff.affects, <[&str; 0]>::default());
    let said: Vec<String> =
        text(&dump).lines().filter(|l| l.contains("effect")).map(str::to_string).collect();
    assert_eq!(said, ["parameter cutoff has no effect: nothing in this plan depends on it"]);
    let mut old = json(&dump);
    for name in ["affects", "shape", "no_effect", "type", "choices"] {
        let parameters = old["parameters"].as_array_mut().expect("a list");
        parameters.iter_mut().for_each(|p| drop(p.as_object_mut().expect("an object").remove(name)));
    }
    assert!(serde_json::from_value::<Dump>(old).is_ok(), "a dump from before these fields is read");
}

#[test]
fn barriers_are_numbered_in_the_order_of_recording() {
    let plain = dump(&example::splat(4));
    let mut calls: Vec<_> = plain.passes.iter().map(|pass| pass.barriers.clone()).collect();
    calls.insert(2, plain.handover.clone());
    calls[1] = plain.handover.clone();
    let bare = super::dump(&example::splat(4));
    assert!(
        text(&bare).contains(" every frame\n"),
        "no counts before a backend adds barriers: {}",
        text(&bare)
    );
    let dump = bare.with_barriers(calls);
    let ids: Vec<u32> = dump.barriers().map(|b| b.id).collect();
    assert_eq!(ids, (1..=ids.len() as u32).collect::<Vec<_>>());
    assert_eq!(dump.pass("covariance").unwrap().barriers[0].id, 1);
    assert_eq!((dump.handover[0].id, &dump.handover[0].before), (2, &None));
    assert_eq!(dump.pass("project").unwrap().barriers[0].id, 3);
}

#[test]
fn the_dump_of_an_empty_plan_is_empty() {
    let dump = super::dump(&Plan::default());
    assert_eq!((dump.passes.len(), dump.resources.len(), dump.output.as_str()), (0, 0, ""));
    assert!(
        text(&dump).contains("0 passes once, 0 every frame\n")
            && !html(&dump).is_empty()
            && !dot(&dump).is_empty()
    );
}

#[test]
fn totals_count_every_barrier_and_dependency() {
    let dump = dump(&example::splat(8));
    let t = &dump.totals;
    assert_eq!((t.passes, t.prologue_passes, t.frame_passes), (34, 2, 32));
    let frame: Vec<_> = dump.passes.iter().filter(|p| p.run == Run::Frame).collect();
    assert_eq!(t.frame.calls, frame.iter().filter(|p| !p.barriers.is_empty()).count());
    assert_eq!(t.frame.barriers, frame.iter().map(|p| p.barriers.len()).sum::<usize>());
    assert_eq!(t.frame.barriers, t.frame.memory_barriers + t.frame.image_barriers);
    assert_eq!(t.frame.image_barriers, 4);
    let dependencies = |b: &DumpBarrier| b.dependencies.len();
    let all = t.prologue.dependencies + t.handover.dependencies + t.frame.dependencies;
    assert_eq!(all, dump.barriers().map(dependencies).sum::<usize>());
    assert_eq!(t.saved_bytes, t.unshared_bytes - t.transient_bytes);
    assert_eq!(t.transient_bytes, dump.blocks.iter().map(|b| b.bytes).sum::<u64>());
}

#[test]
fn a_plane_that_is_imported_twice_counts_once() {
    let mut plan = example::splat(4);
    let before = dump(&plan).totals;
    // `position` is read by every frame, `scale` by the prologue only.
    let ids = ["position", "scale"].map(|name| plan.find_resource(name).expect("it is there"));
    for id in ids {
        let again = ResourceId(plan.resources.len() as u32);
        let resource = plan.resource(id).clone();
        plan.resources.push(Resource { name: format!("include.{}", resource.name), ..resource });
        for pass in &mut plan.passes {
            let uses: Vec<Use> = pass.uses.iter().filter(|used| used.resource == id).copied().collect();
            pass.uses.extend(uses.into_iter().map(|used| Use { resource: again, ..used }));
        }
    }
    let after = dump(&plan).totals;
    assert_eq!((after.scene_bytes, after.freed_bytes), (before.scene_bytes, before.freed_bytes));
    assert!(before.freed_bytes > 0);
}

#[test]
fn resources_in_one_block_know_each_other_and_live_one_after_another() {
    let dump = dump(&example::splat(4));
    let depth = resource(&dump, "depth");
    let block = &dump.blocks[depth.block.expect("it is transient") as usize];
    assert_eq!(block.aliases, ["depth", "keys#1"]);
    let lifetimes: Vec<Lifetime> =
        block.aliases.iter().map(|t| resource(&dump, t).lifetime.expect("it lives in the frame")).collect();
    assert!(lifetimes.windows(2).all(|pair| pair[0].last < pair[1].first), "{lifetimes:?}");
    assert_eq!(dump.passes[lifetimes[0].first].name, "project");
    assert_eq!(dump.passes[lifetimes[1].last].name, "sort.scatter[3]");
}

#[test]
fn what_outlives_a_frame_has_no_lifetime() {
    let by_history = dump(&example::splat(4));
    assert_eq!(resource(&by_history, "exposure").history.as_deref(), Some("exposure"));
    for name in ["exposure", "covariances", "position", "camera", "host(stats)"] {
        assert_eq!(resource(&by_history, name).lifetime, None, "{name}");
    }
}

#[test]
fn names_say_which_passes_a_repeat_made() {
    let dump = dump(&example::splat(8));
    let first = dump.passes.iter().position(|p| p.name == "sort.histogram[0]").expect("it is there");
    let expected = DumpRepeat { name: "sort".into(), iterations: 8, first, passes: 24 };
    assert_eq!(dump.repeats, [expected]);
    let scatter = dump.pass("sort.scatter[5]").and_then(|p| p.repeat.clone()).expect("it is in the repeat");
    assert_eq!(
        (scatter.group.as_str(), scatter.member.as_str(), scatter.index),
        ("sort", "sort.scatter", vec![5])
    );
    assert_eq!(dump.pass("sort.clear").unwrap().repeat, None);
}

fn repeated(names: &[&str]) -> (Vec<DumpPass>, Vec<DumpRepeat>) {
    let any = dump(&example::splat(4)).passes[2].clone();
    let mut passes: Vec<DumpPass> =
        names.iter().map(|name| DumpPass { name: name.to_string(), ..any.clone() }).collect();
    let repeats = repeats::find(&mut passes);
    (passes, repeats)
}

fn grouped(names: &[&str]) -> Vec<Option<String>> {
    repeated(names).0.into_iter().map(|p| p.repeat.map(|r| r.group)).collect()
}

#[test]
fn a_pass_beside_an_inner_repeat_is_no_iteration_of_its_own() {
    let iterations = |names: &[&str]| -> Vec<usize> {
        repeated(names).1.into_iter().map(|repeat| repeat.iterations).collect()
    };
    let two =
        ["level[0].clear", "level[0].blur[0]", "level[0].blur[1]", "level[1].clear", "level[1].blur[0]"];
    assert_eq!(iterations(&two), [3]);
    assert_eq!(iterations(&["t[0][0]", "t[0][1]", "t[1][0]", "t[1][1]", "last[1]"]), [4]);
    assert_eq!(iterations(&["clear[0]", "t[0][0]"]), [0; 0], "the body runs once");
    assert_eq!(iterations(&["clear[1]", "t[1][0]", "clear[10]", "t[10][0]"]), [2]);
}

#[test]
fn repeats_that_follow_each_other_stay_apart() {
    let some = |name: &str| Some(name.to_string());
    assert_eq!(grouped(&["a[0]", "a[1]", "b[0]", "b[1]"]), [some("a"), some("a"), some("b"), some("b")]);
    assert_eq!(
        grouped(&["s.a[0]", "s.a[1]", "s.b[0]", "s.b[1]"]),
        [some("s"), some("s"), some("s (2)"), some("s (2)")]
    );
    assert_eq!(grouped(&["a[0]", "x", "a[1]"]), [None, None, None], "others stand between");
    assert_eq!(grouped(&["a[0]", "b[0]"]), [None, None], "a single iteration is no repeat");
    let nested = ["t[0][0]", "t[0][1]", "t[1][0]", "t[1][1]"];
    assert_eq!(grouped(&nested), vec![some("t"); 4], "a repeat in a repeat is one");
}

#[test]
fn push_constants_have_the_names_of_the_shader() {
    let dump = dump(&example::splat(8));
    let push = &dump.pass("sort.scan[3]").unwrap().push;
    assert_eq!(push.len(), 1);
    assert_eq!(
        (push[0].name.as_deref(), push[0].offset, &push[0].value),
        (Some("shift"), 0, &Value::Int(12))
    );
}

#[test]
fn times_are_summed_by_phase_and_frame_and_a_missing_one_leaves_no_sum() {
    let dump = timed(example::splat(4));
    let ms = |name: &str| dump.pass(name).unwrap().gpu_ms.unwrap_or_else(|| panic!("no time for {name}"));
    let phase = |name: &str| dump.phases.iter().find(|p| p.name == name).unwrap();
    assert_eq!(phase("key").gpu_ms, Some(ms("scan_blocks") + ms("compact")));
    assert_eq!(phase("load").gpu_ms, None, "the prologue has no times");
    // 18 passes of the frame have times.
    assert_eq!(dump.gpu_ms, Some((1..=18).map(f64::from).sum()));
    assert_eq!(dump.pass("export").unwrap().gpu_ms, None);
    // The text's phases sum to the measured frame.
    let text = text(&dump);
    assert!(text.contains("200.000 ms on the GPU: ") && text.contains(", unattributed 29.000\n"), "{text}");

    let (partly, found) = dump.with_times(&[("compact".into(), 1.0), ("of another graph".into(), 2.0)]);
    assert_eq!((found, partly.gpu_ms), (1, None));
    assert_eq!(partly.phases.iter().find(|p| p.name == "key").unwrap().gpu_ms, None);
}

#[test]
fn the_text_names_every_pass_barrier_and_resource() {
    let dump = timed(example::splat(4));
    let text = text(&dump);
    for pass in &dump.passes {
        assert!(text.lines().any(|line| line.starts_with(&format!("  {} ", pass.name))), "{}", pass.name);
    }
    for barrier in dump.barriers() {
        assert!(text.contains(&format!("    | {}\n", barrier_line(barrier))), "barrier {}", barrier.id);
        for dependency in &barrier.dependencies {
            assert!(text.contains(&cause_line(barrier, dependency)), "barrier {}", barrier.id);
        }
    }
    for line in [
        "read after write on keys#1, after sort.scatter[0]: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ",
        "color in the memory of sort.totals, after sort.scan[3]: COMPUTE STORAGE_READ -> COLOR_OUTPUT COLOR_WRITE",
        "      after  project (visible), ",
        "sort.histogram[3] of the previous frame (depth in the memory of keys#1)",
        "on image color, Undefined -> ColorTarget: ",
        "block 8 ",
        "history exposure",
        "before the first frame",
        "stat visible: args+12",
        "front_to_back ",
    ] {
        assert!(text.contains(line), "no {line} in\n{text}");
    }
}

#[test]
fn a_need_of_another_pass_is_named_with_it() {
    let dump = dump(&example::splat(4));
    let mut barrier = dump.pass("compact").unwrap().barriers[0].clone();
    let line = cause_line(&barrier, &barrier.dependencies[0]);
    assert!(!line.contains(", for "), "{line}");
    barrier.dependencies[0].conflict.before.name = "sort.clear".into();
    let line = cause_line(&barrier, &barrier.dependencies[0]);
    assert!(line.contains(", for sort.clear: "), "{line}");
}

#[test]
fn the_picture_has_an_edge_for_every_pass_that_a_pass_depends_on() {
    let dump = dump(&example::splat(4));
    let dot = dot(&dump);
    for pass in &dump.passes {
        for first in pass.dependencies.iter().map(|dependency| &dependency.first.name) {
            assert!(
                dot.contains(&format!("  \"{first}\" -> \"{}\" [", pass.name)),
                "{first}, {}\n{dot}",
                pass.name
            );
        }
    }
    assert!(dot.contains("tooltip=\"barrier "), "{dot}");
    assert_eq!(dot.matches("fillcolor=").count(), dump.passes.len());
    assert!(dot.contains("  \"sort.scatter[0]\" -> \"sort.histogram[1]\" [label=\"keys#1\""), "{dot}");
    assert_eq!(dot.matches('{').count(), dot.matches('}').count());
}

fn data_of(page: &str) -> serde_json::Value {
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"dump\">").expect("it has data");
    let (data, _) = rest.split_once("</script>").expect("the data ends");
    serde_json::from_str(data).expect("the data is JSON")
}

#[test]
fn the_page_holds_the_whole_dump() {
    let dump = timed(example::splat(8));
    let page = html(&dump);
    assert_eq!(data_of(&page), json(&dump));
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    for tag in ["html", "head", "body", "style", "script", "main", "header"] {
        let opened = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
        assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
    }
    assert!(!page.contains("{{"), "a placeholder is left");
}

#[test]
fn the_page_asks_no_network() {
    // References within the page are not requests.
    let page = html(&dump(&example::splat(4))).replace("url(#", "");
    for word in [" src=", "<link", "@import", "url(", "fetch(", "XMLHttpRequest", "import("] {
        assert!(!page.contains(word), "{word}");
    }
}

#[test]
fn no_name_ends_the_script_or_fills_a_placeholder() {
    let mut plan = example::splat(4);
    let wicked = "</script><script>alert(1)</script><!-- {{script}} & \u{2028}";
    plan.name = wicked.into();
    plan.summary = wicked.into();
    plan.resources[0].name = wicked.into();
    plan.passes[0].name = wicked.into();
    let page = html(&dump(&plan));
    let plain = html(&dump(&example::splat(4)));
    assert_eq!(page.matches("<script").count(), plain.matches("<script").count());
    assert_eq!(page.matches("</script").count(), plain.matches("</script").count());
    assert!(!page.contains("<!--"));
    assert!(page.contains("<title>&lt;/script>"));
    let data = data_of(&page);
    assert_eq!([&data["graph"], &data["passes"][0]["name"], &data["resources"][0]["name"]], [wicked; 3]);
}

#[test]
fn a_solved_graph_says_which_pass_waits_for_which_on_what() {
    let passes = [testing::make(), testing::show()];
    let plan = testing::plan(&testing::graph("", &passes.join("\n")), &[]);
    let dump = dump(&plan);
    let barrier = &dump.pass("show").expect("it is there").barriers[0];
    let dependency = &barrier.dependencies[0].conflict;
    assert_eq!(dependency.hazard, Hazard::ReadAfterWrite);
    assert_eq!((dependency.resource.name.as_str(), dependency.before.name.as_str()), ("a", "show"));
    assert_eq!(dependency.after[0].name, "make");
    assert_eq!(dependency.after[0].declared, plan.passes[0].origin);
    assert_eq!(barrier.masks.source_accesses, Accesses::STORAGE_WRITE);
    assert_eq!(dump.resources.len(), plan.resources.len());
    let transient = plan.resources.iter().filter(|r| r.source == Source::Transient).count();
    assert_eq!(dump.blocks.iter().map(|b| b.aliases.len()).sum::<usize>(), transient);
}
