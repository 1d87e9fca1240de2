//! Tests the placement of barriers between passes, between frames, and after the prologue.

use super::*;

#[track_caller]
fn assert_before(plan: &Plan, pass: &str, expected: &[&str]) {
    assert_eq!(before(plan, pass), expected, "{}", shown(plan));
}

#[track_caller]
fn assert_first(plan: &Plan, pass: &str, expected: &str) {
    assert_eq!(before(plan, pass)[0], expected, "{}", shown(plan));
}

#[track_caller]
fn assert_handover(plan: &Plan, expected: &[&str]) {
    assert_eq!(handover(plan), expected, "{}", shown(plan));
}

/// Solves a graph in which `make` writes the buffer `a`, and `show` reads it and writes the image.
fn make_and_show() -> Plan {
    solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
    ])
}

#[test]
fn a_reader_waits_for_the_writer_and_sees_its_writes() {
    let plan = make_and_show();
    assert_first(
        &plan,
        "show",
        "COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make",
    );
}

#[test]
fn two_readers_in_the_same_stage_share_one_barrier() {
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("left", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("right", "copy.comp", r#""In": "a", "Out": "c""#),
        dispatch("join", "join.comp", r#""In": "b", "In2": "c", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ]);
    let on_a = |pass| before(&plan, pass).iter().filter(|b| b.contains(" on a ")).count();
    assert_eq!((on_a("left"), on_a("right")), (1, 0), "{}", shown(&plan));
}

#[test]
fn the_next_frame_waits_before_it_overwrites_what_this_one_reads() {
    let plan = make_and_show();
    // The barrier for `make` joins the existing call at the end of the previous frame.
    assert_before(&plan, "make", &[]);
    assert_before(
        &plan,
        "export",
        &[
            "COMPUTE -> COMPUTE: WriteAfterRead on a after show of the previous frame, for make",
            "COMPUTE STORAGE_WRITE -> COPY TRANSFER_READ [image General -> TransferSource]: ReadAfterWrite on image after show",
        ],
    );
}

#[test]
fn what_waits_for_something_older_than_the_last_call_joins_that_call() {
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("one", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("two", "copy.comp", r#""In": "b", "Out": "c""#),
        r#"Fill(name: "clear", buffer: "a", value: 0),"#.into(),
        dispatch("also", "change.comp", r#""Out": "a""#),
        dispatch("show", "join_show.comp", r#""In": "c", "In2": "a", "Image": "image""#),
    ]);
    assert_eq!(frame(&plan)[2..4], ["two", "clear"]);
    assert_before(&plan, "clear", &[]);
    assert!(before(&plan, "two")[0].contains("COMPUTE|CLEAR"), "{}", shown(&plan));
    assert!(before(&plan, "two")[0].contains(", for clear"), "{}", shown(&plan));
}

#[test]
fn a_write_after_reads_that_another_barrier_orders_has_none_of_its_own() {
    // `back` reads `a` and writes `b`; `again` reads `b`, and overwrites `a`.
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("back", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("again", "copy.comp", r#""In": "b", "Out": "a""#),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
    ]);
    assert_before(
        &plan,
        "again",
        &[
            "COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on b after back, WriteAfterRead on a after back",
        ],
    );
}

#[test]
fn a_second_stage_that_reads_is_made_to_see_without_flushing_again() {
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("copy", "copy.comp", r#""In": "a", "Out": "b""#),
        draw("draw", "Clear(0, 0, 0, 0)"),
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
fn a_pass_that_runs_once_is_in_the_prologue_and_the_first_frame_sees_what_it_wrote() {
    let plan = solved(&[
        r#"Dispatch(name: "make", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#
            .into(),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
    ]);
    assert_eq!(plan.prologue.len(), 1);
    assert_eq!(plan.pass(plan.prologue[0]).run, Run::Once);
    assert_handover(
        &plan,
        &["COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make"],
    );
    assert!(
        !before(&plan, "show").iter().any(|b| b.contains(" on a ")),
        "later frames need not see it again"
    );
}

#[test]
fn a_cleared_image_is_not_kept_and_a_drawn_one_is_read_in_the_layout_of_its_reader() {
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        draw("draw", "Clear(0, 0, 0, 0)"),
        dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
    ]);
    assert_before(
        &plan,
        "draw",
        &[
            "COMPUTE STORAGE_WRITE -> VERTEX STORAGE_READ: ReadAfterWrite on a after make",
            "COMPUTE -> COLOR_OUTPUT COLOR_WRITE [color Undefined -> ColorTarget]: WriteAfterRead on color after filter of the previous frame",
        ],
    );
    assert_before(
        &plan,
        "filter",
        &[
            "COLOR_OUTPUT COLOR_WRITE -> COMPUTE STORAGE_READ [color ColorTarget -> General]: ReadAfterWrite on color after draw",
            "COPY -> COMPUTE STORAGE_WRITE [image Undefined -> General]: WriteAfterRead on image after export of the previous frame",
        ],
    );
}

#[test]
fn a_draw_that_tests_waits_at_both_tests_for_the_depths_that_another_wrote() {
    let draw = |name: &str, load: &str, access: &str| {
        format!(
            r#"Draw(name: "{name}", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip,
                call: Direct(vertices: 4, instances: 2), bind: {{"In": "a"}},
                targets: [Target(image: "color", load: {load}, blend: PremultipliedOver)],
                depth: Depth(image: "depth", access: {access})),"#
        )
    };
    let passes = [
        dispatch("make", "make.comp", r#""Out": "a""#),
        draw("mesh", "Clear(0, 0, 0, 0)", "Write"),
        draw("splats", "Keep", "Test"),
        dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
    ];
    let depth =
        r#"resources: { "depth": Image(format: "depth32f", size: ("viewport.width", "viewport.height")),"#;
    let text = graph("", &passes.join("\n")).replace("resources: {", depth);
    let plan = apart(&text);
    assert_before(
        &plan,
        "splats",
        &["COLOR_OUTPUT|EARLY_TESTS|LATE_TESTS COLOR_WRITE|DEPTH_WRITE -> \
             COLOR_OUTPUT|EARLY_TESTS|LATE_TESTS COLOR_READ|COLOR_WRITE|DEPTH_READ: \
             ReadAfterWrite on color after mesh, ReadAfterWrite on depth after mesh"],
    );
    // The next frame clears `depth` after this frame's depth tests.
    let mesh = before(&plan, "mesh").join("\n");
    assert!(mesh.contains("WriteAfterRead on depth after splats of the previous frame"), "{}", shown(&plan));
}

#[test]
fn a_fill_and_an_atomic_use_of_it_are_apart_in_both_directions() {
    let plan = solved(&[
        r#"Fill(name: "clear", buffer: "a", value: 0),"#.into(),
        dispatch("count", "change.comp", r#""Out": "a""#),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
    ]);
    assert_first(
        &plan,
        "export",
        "COMPUTE -> CLEAR: WriteAfterRead on a after show of the previous frame, for clear",
    );
    assert_before(
        &plan,
        "count",
        &["CLEAR TRANSFER_WRITE -> COMPUTE STORAGE_READ|STORAGE_WRITE: ReadAfterWrite on a after clear"],
    );
}

#[test]
fn no_barrier_is_there_without_a_hazard() {
    let plan = make_and_show();
    let hazards: Vec<Hazard> =
        placed(&plan).before.iter().flatten().flat_map(|b| &b.causes).map(|(d, _)| d.hazard).collect();
    // Expected: `make` after the previous frame's `show`; `show` after `make`, and its image after the last export; the
    // export after `show`.
    assert_eq!(hazards.len(), 4, "{}", shown(&plan));
}

#[test]
fn a_target_that_is_drawn_to_twice_keeps_its_layout_and_waits() {
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        draw("first", "Clear(0, 0, 0, 0)"),
        draw("second", "Keep"),
        dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
    ]);
    assert_eq!(
        before(&plan, "second"),
        [
            "COLOR_OUTPUT COLOR_WRITE -> COLOR_OUTPUT COLOR_READ|COLOR_WRITE: ReadAfterWrite on color after first"
        ]
    );
}

#[test]
fn an_image_whose_layout_only_the_first_frame_changes_still_waits_for_the_frame_before() {
    // `paint` and `filter` use `color` in the same layout, so later frames need no layout change.
    let plan = solved(&[
        dispatch("paint", "paint.comp", r#""Color": "color""#),
        dispatch("filter", "filter.comp", r#""Color": "color", "Image": "image""#),
    ]);
    assert_eq!(
        handover(&plan),
        ["NONE -> COMPUTE STORAGE_WRITE [color Undefined -> General]: LayoutChange on color after "]
    );
    assert_first(
        &plan,
        "export",
        "COMPUTE -> COMPUTE: WriteAfterRead on color after filter of the previous frame, for paint",
    );
}

#[test]
fn an_image_that_is_written_once_is_seen_by_every_frame() {
    let plan = solved(&[
        r#"Dispatch(name: "paint", run: Once, shader: "paint.comp", size: Threads(64), bind: {"Color": "image"}),"#.into(),
    ]);
    assert_handover(
        &plan,
        &[
            "COMPUTE STORAGE_WRITE -> COPY TRANSFER_READ [image General -> TransferSource]: ReadAfterWrite on image after paint",
        ],
    );
    assert_before(&plan, "export", &[]);
}

#[test]
fn a_draw_that_writes_in_both_of_its_stages_is_waited_for_in_both() {
    let plan = solved(&[
        r#"Fill(name: "clear", buffer: "b", value: 0),"#.into(),
        r#"Draw(name: "draw", vertex: "count.vert", fragment: "count.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {"Count": "b"}, targets: [Target(image: "color", load: Clear(0, 0, 0, 0), blend: Replace)]),"#
            .into(),
        dispatch("show", "show.comp", r#""In": "b", "Image": "image""#),
    ]);
    assert_first(
        &plan,
        "show",
        "VERTEX|FRAGMENT STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on b after draw",
    );
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
    let plan = plan(&text.replace("output:", r#"stats: {"n": ("a", 8)}, output:"#), &[]);
    assert_eq!(frame(&plan), ["make", "show", "export", "host"]);
    assert_before(
        &plan,
        "host",
        &[
            "COPY TRANSFER_WRITE -> COMPUTE|HOST HOST_READ: ReadAfterWrite on host(stats) after export, WriteAfterRead on a after show+export of the previous frame, for make",
        ],
    );
}

#[test]
fn a_dump_without_barriers_says_why() {
    let plan = make_and_show();
    let error = BackendError::Invalid("none was found".into());
    let dump = dump::add_barriers(splatgraph_framework::dump::dump(&plan), &plan, Err(&error));
    let told: Vec<&str> = dump.warnings.iter().map(|warning| warning.message.as_str()).collect();
    assert_eq!(told, [format!("this dump has no barriers: {error}")]);
    assert_eq!(dump.barriers().count(), 0);
}
