//! Tests of the solver's guarantees, one sentence each. A failing assertion prints the dump.

use crate::ir::{Accesses, Hazard, Layout, PassId, Run, Stages, Work};
use crate::plan::{Barrier, Plan, Step};
use crate::solve::reorder;
use crate::testing::{apart, dispatch, graph, plan};

/// Every resource in memory of its own.
fn solved(params: &str, passes: &[String]) -> Plan {
    apart(&graph(params, &passes.join("\n"))).unwrap_or_else(|error| panic!("{error}"))
}

/// Resources in shared memory where they can be.
fn packed(passes: &[String]) -> Plan {
    plan(&graph("", &passes.join("\n")), &[]).unwrap_or_else(|error| panic!("{error}"))
}

fn shown(plan: &Plan) -> String {
    let step = |step: &Step| {
        let barriers: Vec<String> =
            step.barriers.iter().map(|b| format!("  | {}", line(plan, b, Some(step.pass)))).collect();
        format!("{}\n{}\n", barriers.join("\n"), plan.pass(step.pass).name)
    };
    let steps = |steps: &[Step]| steps.iter().map(step).collect::<String>();
    format!("\n{}handover {:#?}\n{}", steps(&plan.prologue), handover(plan), steps(&plan.frame))
}

/// The names of the frame's passes, as they run.
fn frame(plan: &Plan) -> Vec<&str> {
    plan.frame.iter().map(|s| plan.pass(s.pass).name.as_str()).collect()
}

/// The barriers before a pass, as text.
fn before(plan: &Plan, pass: &str) -> Vec<String> {
    let step = plan.prologue.iter().chain(&plan.frame).find(|s| plan.pass(s.pass).name == pass);
    let step = step.unwrap_or_else(|| panic!("{}", shown(plan)));
    step.barriers.iter().map(|b| line(plan, b, Some(step.pass))).collect()
}

fn handover(plan: &Plan) -> Vec<String> {
    plan.handover.iter().map(|b| line(plan, b, None)).collect()
}

/// `COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make`.
/// A later pass that needs it is named at the end.
fn line(plan: &Plan, barrier: &Barrier, step: Option<PassId>) -> String {
    fn flags<T>(names: impl Iterator<Item = (&'static str, T)>) -> String {
        names.map(|(name, _)| name).collect::<Vec<_>>().join("|")
    }
    let side = |stages: Stages, accesses: Accesses| {
        [flags(stages.iter_names()), flags(accesses.iter_names())].join(" ").trim().to_string()
    };
    let layouts = barrier
        .image
        .map_or(String::new(), |t| format!(" [{} {:?} -> {:?}]", plan.resource(t.image).name, t.old, t.new));
    let reasons = barrier.dependencies.iter().map(|d| {
        let after: Vec<&str> = d.after.iter().map(|id| plan.pass(*id).name.as_str()).collect();
        let alias = d.alias.map_or(String::new(), |id| format!(" ({})", plan.resource(id).name));
        let frame = if d.previous_frame { " of the frame before" } else { "" };
        let before = match step.is_none_or(|step| step == d.before) {
            true => String::new(),
            false => format!(", for {}", plan.pass(d.before).name),
        };
        let resource = &plan.resource(d.resource).name;
        format!("{:?} on {resource}{alias} after {}{frame}{before}", d.hazard, after.join("+"))
    });
    format!(
        "{} -> {}{layouts}: {}",
        side(barrier.source_stages, barrier.source_accesses),
        side(barrier.target_stages, barrier.target_accesses),
        reasons.collect::<Vec<_>>().join(", ")
    )
}

#[test]
fn a_reader_waits_for_the_writer_and_sees_its_writes() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    let barriers = before(&plan, "show");
    assert_eq!(
        barriers[0],
        "COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make",
        "{}",
        shown(&plan)
    );
}

#[test]
fn the_only_writer_runs_before_a_reader_that_stands_above_it_in_the_file() {
    let plan = solved(
        "",
        &[
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
            dispatch("make", "make.comp", r#""Out": "a""#),
        ],
    );
    assert_eq!(frame(&plan), ["make", "show", "export"], "{}", shown(&plan));
}

#[test]
fn several_writers_keep_the_order_of_the_file() {
    let plan = solved(
        "",
        &[
            dispatch("first", "make.comp", r#""Out": "a""#),
            dispatch("second", "change.comp", r#""Out": "a""#),
            dispatch("third", "change.comp", r#""Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    assert_eq!(frame(&plan), ["first", "second", "third", "show", "export"], "{}", shown(&plan));
    assert_eq!(
        before(&plan, "third"),
        ["COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ|STORAGE_WRITE: ReadAfterWrite on a after second"]
    );
}

#[test]
fn two_readers_in_the_same_stage_share_one_barrier() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("left", "copy.comp", r#""In": "a", "Out": "b""#),
            dispatch("right", "copy.comp", r#""In": "a", "Out": "c""#),
            dispatch("join", "join.comp", r#""In": "b", "In2": "c", "Out": "d""#),
            dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
        ],
    );
    let on_a = |pass| before(&plan, pass).iter().filter(|b| b.contains(" on a ")).count();
    assert_eq!((on_a("left"), on_a("right")), (1, 0), "{}", shown(&plan));
}

#[test]
fn a_pass_that_nothing_reads_from_is_left_out_with_what_feeds_only_it() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("spare", "make.comp", r#""Out": "b""#),
            dispatch("waste", "copy.comp", r#""In": "b", "Out": "c""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    assert_eq!(frame(&plan), ["make", "show", "export"]);
    let left: Vec<&str> = plan.culled.iter().map(|l| l.pass.as_str()).collect();
    assert_eq!(left, ["spare", "waste"]);
    assert!(plan.find_resource("b").is_none(), "a resource without uses needs no memory");
}

#[test]
fn the_next_frame_waits_before_it_overwrites_what_this_one_reads() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    // It waits at the last frame's end, where there is a call anyway.
    assert_eq!(before(&plan, "make"), [""; 0]);
    assert_eq!(
        before(&plan, "export"),
        [
            "COMPUTE -> COMPUTE: WriteAfterRead on a after show of the frame before, for make",
            "COMPUTE STORAGE_WRITE -> COPY TRANSFER_READ [image General -> TransferSource]: ReadAfterWrite on image after show"
        ],
        "{}",
        shown(&plan)
    );
}

#[test]
fn what_waits_for_something_older_than_the_last_call_joins_that_call() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("one", "copy.comp", r#""In": "a", "Out": "b""#),
            dispatch("two", "copy.comp", r#""In": "b", "Out": "c""#),
            r#"Fill(name: "clear", buffer: "a", value: 0),"#.into(),
            dispatch("also", "change.comp", r#""Out": "a""#),
            dispatch("show", "join_show.comp", r#""In": "c", "In2": "a", "Image": "image""#),
        ],
    );
    assert_eq!(frame(&plan)[2..4], ["two", "clear"]);
    assert_eq!(before(&plan, "clear"), [""; 0], "{}", shown(&plan));
    assert!(before(&plan, "two")[0].contains("COMPUTE|CLEAR"), "{}", shown(&plan));
    assert!(before(&plan, "two")[0].contains(", for clear"), "{}", shown(&plan));
}

#[test]
fn a_write_after_reads_that_another_barrier_orders_has_none_of_its_own() {
    // `back` reads `a` and writes `b`; `again` reads `b`, and overwrites `a`.
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("back", "copy.comp", r#""In": "a", "Out": "b""#),
            dispatch("again", "copy.comp", r#""In": "b", "Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    assert_eq!(
        before(&plan, "again"),
        [
            "COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on b after back, WriteAfterRead on a after back"
        ]
    );
}

#[test]
fn a_second_stage_that_reads_is_made_to_see_without_flushing_again() {
    let plan = solved("", &[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("copy", "copy.comp", r#""In": "a", "Out": "b""#),
        r#"Draw(name: "draw", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {"In": "a"}, targets: [Target(image: "color", load: Clear(0, 0, 0, 0), blend: PremultipliedOver)]),"#.into(),
        dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
        dispatch("show", "mix.comp", r#""In": "b", "Image": "image""#),
    ]);
    assert!(
        before(&plan, "draw")[0]
            .starts_with("COMPUTE -> VERTEX STORAGE_READ: ReadAfterWrite on a after make"),
        "{}",
        shown(&plan)
    );
}

#[test]
fn ping_pong_ends_at_the_right_half_for_odd_and_even_counts() {
    for count in 1..=4 {
        let plan = solved(
            "",
            &[
                dispatch("make", "make.comp", r#""Out": "keys""#),
                format!(
                    r#"Repeat(var: "i", count: {count}, body: [
                    Dispatch(name: "step", shader: "copy.comp", size: Threads(64), bind: {{"In": "front(keys)", "Out": "back(keys)"}}),
                    Swap("keys"),
                ]),"#
                ),
                dispatch("show", "show.comp", r#""In": "keys", "Image": "image""#),
            ],
        );
        assert_eq!(plan.frame.len(), count + 3, "{}", shown(&plan));
        let last = format!("keys#{}", count % 2);
        let show = plan.passes.iter().find(|p| p.name == "show").unwrap();
        assert_eq!(plan.resource(show.bindings[0].resource).name, last, "{}", shown(&plan));
    }
}

#[test]
fn a_pass_that_runs_once_is_in_the_prologue_and_the_first_frame_sees_what_it_wrote() {
    let plan = solved("", &[
        r#"Dispatch(name: "make", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#.into(),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
    ]);
    assert_eq!(plan.prologue.len(), 1);
    assert_eq!(plan.pass(plan.prologue[0].pass).run, Run::Once);
    assert_eq!(
        handover(&plan),
        ["COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make"],
        "{}",
        shown(&plan)
    );
    assert!(
        !before(&plan, "show").iter().any(|b| b.contains(" on a ")),
        "later frames need not see it again"
    );
}

#[test]
fn a_cleared_image_is_not_kept_and_a_drawn_one_is_read_in_the_layout_of_its_reader() {
    let plan = solved("", &[
        dispatch("make", "make.comp", r#""Out": "a""#),
        r#"Draw(name: "draw", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {"In": "a"}, targets: [Target(image: "color", load: Clear(0, 0, 0, 0), blend: PremultipliedOver)]),"#.into(),
        dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
    ]);
    assert_eq!(
        before(&plan, "draw"),
        [
            "COMPUTE STORAGE_WRITE -> VERTEX STORAGE_READ: ReadAfterWrite on a after make",
            "COMPUTE -> COLOR_OUTPUT COLOR_WRITE [color Undefined -> ColorTarget]: WriteAfterRead on color after filter of the frame before",
        ],
        "{}",
        shown(&plan)
    );
    assert_eq!(
        before(&plan, "filter"),
        [
            "COLOR_OUTPUT COLOR_WRITE -> COMPUTE STORAGE_READ [color ColorTarget -> General]: ReadAfterWrite on color after draw",
            "COPY -> COMPUTE STORAGE_WRITE [image Undefined -> General]: WriteAfterRead on image after export of the frame before",
        ],
        "{}",
        shown(&plan)
    );
}

#[test]
fn a_fill_and_an_atomic_use_of_it_are_apart_in_both_directions() {
    let plan = solved(
        "",
        &[
            r#"Fill(name: "clear", buffer: "a", value: 0),"#.into(),
            dispatch("count", "change.comp", r#""Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    assert_eq!(
        before(&plan, "export")[0],
        "COMPUTE -> CLEAR: WriteAfterRead on a after show of the frame before, for clear",
        "{}",
        shown(&plan)
    );
    assert_eq!(
        before(&plan, "count"),
        ["CLEAR TRANSFER_WRITE -> COMPUTE STORAGE_READ|STORAGE_WRITE: ReadAfterWrite on a after clear"]
    );
}

#[test]
fn the_same_file_gives_the_same_plan() {
    let passes = [
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("left", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("right", "copy.comp", r#""In": "a", "Out": "c""#),
        dispatch("join", "join.comp", r#""In": "b", "In2": "c", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ];
    assert_eq!(solved("", &passes), solved("", &passes));
}

#[test]
fn no_barrier_is_there_without_a_hazard() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ],
    );
    let hazards: Vec<Hazard> =
        plan.frame.iter().flat_map(|s| &s.barriers).flat_map(|b| &b.dependencies).map(|d| d.hazard).collect();
    // make after the last frame's show; show after make, and the image after the last export; export after show.
    assert_eq!(hazards.len(), 4, "{}", shown(&plan));
}

fn draw(name: &str, load: &str) -> String {
    format!(
        r#"Draw(name: "{name}", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {{"In": "a"}}, targets: [Target(image: "color", load: {load}, blend: PremultipliedOver)]),"#
    )
}

#[test]
fn a_target_that_is_drawn_to_twice_keeps_its_layout_and_waits() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            draw("first", "Clear(0, 0, 0, 0)"),
            draw("second", "Keep"),
            dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
        ],
    );
    assert_eq!(
        before(&plan, "second"),
        [
            "COLOR_OUTPUT COLOR_WRITE -> COLOR_OUTPUT COLOR_READ|COLOR_WRITE: ReadAfterWrite on color after first"
        ],
        "{}",
        shown(&plan)
    );
}

#[test]
fn an_image_whose_layout_only_the_first_frame_changes_still_waits_for_the_frame_before() {
    // `paint` and `filter` touch `color` in the same layout, so that a later frame finds it as it needs it.
    let plan = solved(
        "",
        &[
            dispatch("paint", "paint.comp", r#""Color": "color""#),
            dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
        ],
    );
    assert_eq!(
        handover(&plan),
        [" -> COMPUTE STORAGE_WRITE [color Undefined -> General]: LayoutChange on color after "],
        "{}",
        shown(&plan)
    );
    assert_eq!(
        before(&plan, "export")[0],
        "COMPUTE -> COMPUTE: WriteAfterRead on color after filter of the frame before, for paint",
        "{}",
        shown(&plan)
    );
}

#[test]
fn an_image_that_is_written_once_is_seen_by_every_frame() {
    let plan = solved("", &[
        r#"Dispatch(name: "paint", run: Once, shader: "paint.comp", size: Threads(64), bind: {"Color": "image"}),"#.into(),
    ]);
    assert_eq!(
        handover(&plan),
        [
            "COMPUTE STORAGE_WRITE -> COPY TRANSFER_READ [image General -> TransferSource]: ReadAfterWrite on image after paint"
        ],
        "{}",
        shown(&plan)
    );
    assert_eq!(before(&plan, "export"), [""; 0], "it stays as it is");
}

#[test]
fn a_writer_that_is_left_out_still_keeps_its_neighbours_apart() {
    let plan = solved(
        "",
        &[
            dispatch("first", "make.comp", r#""Out": "a""#),
            dispatch("use", "join.comp", r#""In": "a", "In2": "c", "Out": "d""#),
            dispatch("spare", "make.comp", r#""Out": "a""#),
            dispatch("both", "pair.comp", r#""Out": "a", "Out2": "b""#),
            dispatch("late", "make.comp", r#""Out": "c""#),
            dispatch("join", "join.comp", r#""In": "b", "In2": "d", "Out": "e""#),
            dispatch("show", "show.comp", r#""In": "e", "Image": "image""#),
        ],
    );
    assert_eq!(frame(&plan), ["first", "late", "use", "both", "join", "show", "export"], "{}", shown(&plan));
    assert_eq!(plan.culled[0].pass, "spare");
}

#[test]
fn a_pass_that_only_the_next_frame_reads_from_is_not_left_out() {
    let plan = solved("", &[
        r#"Dispatch(name: "start", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#.into(),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        dispatch("step", "change.comp", r#""Out": "a""#),
    ]);
    assert_eq!(frame(&plan), ["show", "step", "export"], "{}", shown(&plan));
    assert_eq!(
        before(&plan, "show")[0],
        "COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after step of the frame before",
        "{}",
        shown(&plan)
    );
}

#[test]
fn a_draw_that_writes_in_both_of_its_stages_is_waited_for_in_both() {
    let plan = solved("", &[
        r#"Fill(name: "clear", buffer: "b", value: 0),"#.into(),
        r#"Draw(name: "draw", vertex: "count.vert", fragment: "count.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {"Count": "b"}, targets: [Target(image: "color", load: Clear(0, 0, 0, 0), blend: Replace)]),"#
            .into(),
        dispatch("show", "show.comp", r#""In": "b", "Image": "image""#),
    ]);
    assert_eq!(
        before(&plan, "show")[0],
        "VERTEX|FRAGMENT STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on b after draw",
        "{}",
        shown(&plan)
    );
}

/// The resources of each block that has several.
fn aliases(plan: &Plan) -> Vec<Vec<&str>> {
    let names = |block: &crate::plan::Block| {
        block.aliases.iter().map(|id| plan.resource(*id).name.as_str()).collect::<Vec<_>>()
    };
    plan.blocks.iter().filter(|b| b.aliases.len() > 1).map(names).collect()
}

#[test]
fn resources_that_are_never_alive_together_share_memory_and_the_next_tenant_waits_for_the_last() {
    let passes = [
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("one", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("two", "copy.comp", r#""In": "b", "Out": "c""#),
        dispatch("show", "show.comp", r#""In": "c", "Image": "image""#),
    ];
    let plan = packed(&passes);
    // `a` ends before the image begins; each of the others meets one of the two.
    assert_eq!(aliases(&plan), [["image", "a"]], "{}", shown(&plan));
    assert_eq!(plan.unshared_bytes() - plan.transient_bytes(), 256);
    assert_eq!(
        before(&plan, "make"),
        ["COPY -> COMPUTE: WriteAfterRead on a (image) after export of the frame before"],
        "{}",
        shown(&plan)
    );
    let apart = solved("", &passes);
    assert_eq!(aliases(&apart), Vec::<Vec<&str>>::new());
    assert_eq!(apart.unshared_bytes(), apart.transient_bytes());
}

#[test]
fn a_resource_that_outlives_a_frame_shares_no_memory() {
    let plan = packed(&[
        r#"Dispatch(name: "start", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#
            .into(),
        dispatch("one", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("show", "show.comp", r#""In": "b", "Image": "image""#),
    ]);
    let block = |name| plan.resource(plan.find_resource(name).unwrap()).block.unwrap();
    assert_eq!(plan.blocks[block("a").index()].aliases.len(), 1, "{}", shown(&plan));
}

#[test]
fn an_image_does_not_follow_an_alias_whose_last_write_is_not_read() {
    // `b` is written and never read; the pass is needed for its other output.
    let plan = packed(&[
        dispatch("make", "pair.comp", r#""Out": "a", "Out2": "b""#),
        dispatch("one", "copy.comp", r#""In": "a", "Out": "c""#),
        dispatch("two", "copy.comp", r#""In": "c", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ]);
    let image = plan.find_resource("image").unwrap();
    let aliases: Vec<&str> = plan.aliases(image).map(|id| plan.resource(id).name.as_str()).collect();
    assert!(!aliases.contains(&"b") && !aliases.is_empty(), "{aliases:?}{}", shown(&plan));
}

/// [`graph`] with a buffer, a ping-pong buffer and an image with histories: `past`, `order`, `trail`.
fn with_history(passes: &[String]) -> String {
    graph("", &passes.join("\n")).replace(
        "resources: {",
        r#"resources: {
        "past": Buffer(stride: 4, count: 64, history: true),
        "order": Buffer(stride: 4, count: 64, ping_pong: true, history: true),
        "trail": Image(format: "rgba16f", size: ("viewport.width", "viewport.height"), history: true),"#,
    )
}

#[test]
fn a_reader_of_the_last_frame_comes_before_the_writer_wherever_it_stands() {
    let plan = plan(
        &with_history(&[
            dispatch("make", "make.comp", r#""Out": "past""#),
            dispatch("use", "copy.comp", r#""In": "last(past)", "Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ]),
        &[],
    )
    .unwrap();
    assert_eq!(frame(&plan), ["use", "make", "show", "export"], "{}", shown(&plan));
    assert_eq!(plan.prologue.len(), 1, "zeros to begin with");
    assert!(matches!(plan.pass(plan.prologue[0].pass).work, Work::Start { .. }));
    assert_eq!(
        handover(&plan),
        ["CLEAR TRANSFER_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on past after start(past)"],
        "{}",
        shown(&plan)
    );
    // What `show` waits for makes all that was written before it visible, to the next frame as well.
    assert_eq!(before(&plan, "use"), [""; 0], "{}", shown(&plan));
    assert!(before(&plan, "make")[0].contains("WriteAfterRead on past after use"), "{}", shown(&plan));
}

#[test]
fn of_a_ping_pong_resource_the_half_that_the_frame_ends_with_lives_on_for_odd_and_even_counts() {
    for count in 1..=4 {
        let plan = plan(
            &with_history(&[
                dispatch("use", "copy.comp", r#""In": "last(order)", "Out": "a""#),
                dispatch("make", "make.comp", r#""Out": "order""#),
                format!(
                    r#"Repeat(var: "i", count: {count}, body: [
                    Dispatch(name: "step", shader: "copy.comp", size: Threads(64), bind: {{"In": "front(order)", "Out": "back(order)"}}),
                    Swap("order"),
                ]),"#
                ),
                dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
            ]),
            &[],
        )
        .unwrap();
        let real = plan.passes.iter().find(|p| p.name == "use").unwrap().bindings[0].resource;
        assert_eq!(plan.resource(real).name, format!("order#{}", count % 2), "{}", shown(&plan));
        assert_eq!(plan.resource(real).history.as_deref(), Some("order"));
        let others = plan.resources.iter().filter(|r| r.history.is_some()).count();
        assert_eq!(others, 1, "the other half is as any other buffer");
        // All of the frame's passes are needed, for the next frame.
        assert_eq!(plan.culled, []);
    }
}

#[test]
fn a_history_without_readers_is_none() {
    let plan = plan(
        &with_history(&[
            dispatch("make", "make.comp", r#""Out": "past""#),
            dispatch("spare", "copy.comp", r#""In": "last(past)", "Out": "b""#),
            dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
        ]),
        &[],
    )
    .unwrap();
    assert_eq!(frame(&plan), ["make", "show", "export"]);
    assert_eq!(plan.prologue, []);
    assert!(plan.resources.iter().all(|r| r.history.is_none()));
}

#[test]
fn a_history_that_is_changed_in_place_is_its_own_reader() {
    let plan = plan(
        &with_history(&[
            dispatch("step", "change.comp", r#""Out": "past""#),
            dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
        ]),
        &[],
    )
    .unwrap();
    assert_eq!(frame(&plan), ["step", "show", "export"]);
    assert!(
        before(&plan, "export")[0]
            .contains("WriteAfterRead on past after show of the frame before, for step"),
        "{}",
        shown(&plan)
    );
}

#[test]
fn an_image_with_a_history_keeps_its_contents_through_changes_of_layout() {
    let plan = plan(
        &with_history(&[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("use", "filter.comp", r#""Color": "last(trail)", "Image": "image""#),
            r#"Draw(name: "draw", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
                bind: {"In": "a"}, targets: [Target(image: "trail", load: Keep, blend: PremultipliedOver)]),"#.into(),
        ]),
        &[],
    )
    .unwrap();
    let changes: Vec<Layout> = plan
        .frame
        .iter()
        .flat_map(|s| &s.barriers)
        .filter_map(|b| b.image)
        .filter(|t| plan.resource(t.image).name == "trail")
        .map(|t| t.old)
        .collect();
    assert_eq!(changes, [Layout::ColorTarget, Layout::General], "{}", shown(&plan));
    assert!(
        handover(&plan)[0].contains("[trail TransferTarget -> ColorTarget]"),
        "frames find it as they leave it{}",
        shown(&plan)
    );
}

#[test]
fn a_pass_that_needs_the_last_frame_and_this_one_of_the_same_buffer_is_a_cycle() {
    let error = plan(
        &with_history(&[
            dispatch("make", "make.comp", r#""Out": "past""#),
            dispatch("use", "join.comp", r#""In": "last(past)", "In2": "past", "Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ]),
        &[],
    )
    .unwrap_err();
    assert!(error.contains("wait for each other"), "{error}");
}

#[test]
fn only_what_was_declared_so_lives_on_and_it_can_only_be_read() {
    let error = |passes: &[String]| plan(&with_history(passes), &[]).unwrap_err();
    let text = error(&[dispatch("show", "show.comp", r#""In": "last(a)", "Image": "image""#)]);
    assert!(text.contains("declared without `history: true`"), "{text}");
    let text = error(&[dispatch("show", "make.comp", r#""Out": "last(past)""#)]);
    assert!(text.contains("of the frame before and can only be read"), "{text}");
    let text = error(&[r#"Fill(name: "f", buffer: "last(past)", value: 0),"#.into()]);
    assert!(text.contains("cannot be filled"), "{text}");
    let text = error(&[
        dispatch("turn", "copy.comp", r#""In": "last(past)", "Out": "past""#),
        dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
    ]);
    assert!(text.contains("written and bound twice"), "{text}");
}

#[test]
fn a_name_may_be_chosen_by_an_expression() {
    let text = with_history(&[
        dispatch("make", "make.comp", r#""Out": "past""#),
        dispatch("show", "show.comp", r#""In": "scene.count > 5 ? 'last(past)' : 'past'", "Image": "image""#),
    ]);
    let late = plan(&text, &[]).unwrap();
    assert_eq!(frame(&late), ["show", "make", "export"]);
    let now = plan(&text.replace("> 5", "< 5"), &[]).unwrap();
    assert_eq!(frame(&now), ["make", "show", "export"]);
    let wrong = plan(&text.replace("'last(past)'", "7"), &[]).unwrap_err();
    assert!(wrong.contains("a resource is needed here") && wrong.contains("the integer 7"), "{wrong}");
}

#[test]
fn the_statistics_are_copied_for_the_host_and_made_visible_to_it() {
    let text = graph(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
        ]
        .join("\n"),
    );
    let plan = plan(&text.replace("output:", r#"stats: {"n": ("a", 8)}, output:"#), &[]).unwrap();
    assert_eq!(frame(&plan), ["make", "show", "export", "host"]);
    assert_eq!(
        before(&plan, "host"),
        [
            "COPY TRANSFER_WRITE -> COMPUTE|HOST HOST_READ: ReadAfterWrite on host(stats) after export, WriteAfterRead on a after show+export of the frame before, for make"
        ],
        "{}",
        shown(&plan)
    );
}

#[test]
fn another_order_of_the_same_passes_gets_the_barriers_that_it_needs() {
    let plan = solved(
        "",
        &[
            dispatch("make", "make.comp", r#""Out": "a""#),
            dispatch("left", "copy.comp", r#""In": "a", "Out": "b""#),
            dispatch("right", "copy.comp", r#""In": "a", "Out": "c""#),
            dispatch("join", "join.comp", r#""In": "b", "In2": "c", "Out": "d""#),
            dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
        ],
    );
    let mut ids: Vec<_> = plan.frame.iter().map(|s| s.pass).collect();
    ids.swap(1, 2);
    let other = reorder(&plan, &ids, false).unwrap();
    assert_eq!(frame(&other), ["make", "right", "left", "join", "show", "export"]);
    assert!(before(&other, "right")[0].contains("ReadAfterWrite on a after make"), "{}", shown(&other));
}
