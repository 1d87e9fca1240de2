//! What the solver promises, one sentence a test. A failing assertion prints the dump.

use crate::dump::{dump, text};
use crate::plan::{Hazard, Plan, Run};
use crate::testing::{dispatch, graph, plan};

fn solved(params: &str, passes: &[String]) -> Plan {
    match plan(&graph(params, &passes.join("\n")), &[]) {
        Ok(plan) => plan,
        Err(error) => panic!("{error}"),
    }
}

fn shown(plan: &Plan) -> String {
    text(&dump(plan))
}

/// The names of the frame's passes, as they run.
fn frame(plan: &Plan) -> Vec<&str> {
    plan.frame.iter().map(|s| plan.pass(s.pass).name.as_str()).collect()
}

/// The barriers before a pass, as text.
fn before(plan: &Plan, pass: &str) -> Vec<String> {
    let dump = dump(plan);
    let pass = dump.passes.iter().find(|p| p.name == pass).unwrap_or_else(|| panic!("{}", shown(plan)));
    pass.barriers.iter().map(crate::dump::barrier_line).collect()
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
        "read after write on a, after make: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ",
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
        [
            "read after write on a, after second: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ | STORAGE_WRITE"
        ]
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
    let on_a = |pass| before(&plan, pass).iter().filter(|b| b.contains(" on a,")).count();
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
    let left: Vec<&str> = plan.left_out.iter().map(|l| l.pass.as_str()).collect();
    assert_eq!(left, ["spare", "waste"]);
    assert!(plan.find_resource("b").is_none(), "what nobody touches needs no memory");
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
    assert_eq!(
        before(&plan, "make"),
        ["write after read on a, after show of the frame before: COMPUTE -> COMPUTE"],
        "{}",
        shown(&plan)
    );
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
        ["read after write on b, after back: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ"]
    );
}

#[test]
fn a_second_stage_that_reads_is_made_to_see_without_flushing_again() {
    let plan = solved("", &[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("copy", "copy.comp", r#""In": "a", "Out": "b""#),
        r#"Dispatch(name: "show", shader: "show.comp", size: Indirect("a", 0), bind: {"In": "b", "Image": "image"}),"#.into(),
    ]);
    let barriers = before(&plan, "show");
    assert!(
        barriers
            .contains(&"read after write on a, after make: COMPUTE -> INDIRECT INDIRECT_READ".to_string()),
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
        let dump = dump(&plan);
        let show = dump.passes.iter().find(|p| p.name == "show").unwrap();
        assert_eq!(show.reads, [last], "{}", shown(&plan));
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
    let barriers = before(&plan, "show");
    assert_eq!(
        barriers[0],
        "read after write on a, after make: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ",
        "{}",
        shown(&plan)
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
            "write after read on color, after filter of the frame before: COMPUTE -> COLOR_OUTPUT COLOR_WRITE, Undefined -> ColorTarget",
            "read after write on a, after make: COMPUTE STORAGE_WRITE -> VERTEX STORAGE_READ",
        ],
        "{}",
        shown(&plan)
    );
    assert_eq!(
        before(&plan, "filter"),
        [
            "read after write on color, after draw: COLOR_OUTPUT COLOR_WRITE -> COMPUTE STORAGE_READ, ColorTarget -> General",
            "write after read on image, after export of the frame before: COPY -> COMPUTE STORAGE_WRITE, Undefined -> General",
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
        before(&plan, "clear"),
        ["write after read on a, after show of the frame before: COMPUTE -> CLEAR"],
        "{}",
        shown(&plan)
    );
    assert_eq!(
        before(&plan, "count"),
        ["read after write on a, after clear: CLEAR TRANSFER_WRITE -> COMPUTE STORAGE_READ | STORAGE_WRITE"]
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
    let hazards: Vec<Hazard> = plan.frame.iter().flat_map(|s| &s.barriers).map(|b| b.hazard).collect();
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
            "read after write on color, after first: COLOR_OUTPUT COLOR_WRITE -> COLOR_OUTPUT COLOR_READ | COLOR_WRITE, ColorTarget -> ColorTarget"
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
        before(&plan, "paint"),
        [
            "write after read on color, after filter of the frame before: COMPUTE -> COMPUTE STORAGE_WRITE, Undefined -> General"
        ],
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
        before(&plan, "export"),
        [
            "read after write on image, after paint, export of the frame before: COMPUTE | COPY STORAGE_WRITE -> COPY TRANSFER_READ, TransferSource -> TransferSource"
        ],
        "{}",
        shown(&plan)
    );
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
    assert_eq!(plan.left_out[0].pass, "spare");
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
        "read after write on a, after start, step of the frame before: COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ",
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
        "read after write on b, after draw: VERTEX | FRAGMENT STORAGE_WRITE -> COMPUTE STORAGE_READ",
        "{}",
        shown(&plan)
    );
}
