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
fn a_dump_without_barriers_says_why() {
    let plan = solved(&[
        dispatch("make", "make.comp", r#""Out": "a""#),
        dispatch("show", "show.comp", r#""In": "a", "Image": "image""#),
    ]);
    let error = BackendError::Invalid("none was found".into());
    let dump = dump::add_barriers(splatgraph_framework::dump::dump(&plan), &plan, Err(&error));
    let told: Vec<&str> = dump.warnings.iter().map(|warning| warning.message.as_str()).collect();
    assert_eq!(told, [format!("this dump has no barriers: {error}")]);
    assert_eq!(dump.barriers().count(), 0);
}
