use super::*;
use crate::testing::plan_of;

#[test]
fn the_only_writer_runs_before_a_reader_that_stands_above_it_in_the_file() {
    let plan = solved(&[show(), make()]);
    assert_eq!(frame(&plan), ["make", "show", "export"], "{}", shown(&plan));
}

#[test]
fn several_writers_keep_the_order_of_the_file() {
    let plan = solved(&[
        dispatch("first", "make.comp", r#""Out": "a""#),
        dispatch("second", "change.comp", r#""Out": "a""#),
        dispatch("third", "change.comp", r#""Out": "a""#),
        show(),
    ]);
    assert_eq!(frame(&plan), ["first", "second", "third", "show", "export"], "{}", shown(&plan));
    assert_eq!(dependencies(&plan, "third"), ["ReadAfterWrite on a after second"]);
}

#[test]
fn a_shader_that_only_asks_for_a_length_waits_for_nothing_and_hides_no_write() {
    let passes = [
        dispatch("make", "pair.comp", r#""Out": "a", "Out2": "b""#),
        dispatch("length", "length.comp", r#""In": "a", "Out": "c""#),
        dispatch("again", "make.comp", r#""Out": "a""#),
        dispatch("join", "join.comp", r#""In": "a", "In2": "b", "Out": "d""#),
        dispatch("show", "join_show.comp", r#""In": "c", "In2": "d", "Image": "image""#),
    ];
    let plan = solved(&passes);
    assert_eq!(dependencies(&plan, "again"), ["WriteAfterWrite on a after make"]);
    assert_eq!(dependencies(&plan, "length"), ["WriteAfterRead on c after show of the previous frame"]);
    for plan in [plan, packed(&passes)] {
        assert_eq!(oracle::dependencies(&plan), [], "{}", shown(&plan));
    }
}

#[test]
fn a_shader_that_only_asks_for_the_size_of_an_image_waits_for_its_layout_and_keeps_no_pass() {
    let size = [
        dispatch("size", "size.comp", r#""Color": "color", "Out": "c""#),
        dispatch("copy", "copy.comp", r#""In": "c", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ];
    let passes = [&[dispatch("paint", "paint.comp", r#""Color": "color""#)], &size[..]].concat();
    for plan in [solved(&size), packed(&size), solved(&passes), packed(&passes)] {
        assert_eq!(frame(&plan), ["size", "copy", "show", "export"]);
        let changes = plan.layout_changes.iter();
        let changed: Vec<&str> = changes.map(|change| plan.resource(change.image).name.as_str()).collect();
        assert!(changed.contains(&"color"), "{}", shown(&plan));
        assert_eq!(oracle::dependencies(&plan), [], "{}", shown(&plan));
    }
}

#[test]
fn a_pass_that_nothing_reads_from_is_left_out_with_what_feeds_only_it() {
    let plan = solved(&[
        make(),
        dispatch("spare", "make.comp", r#""Out": "b""#),
        dispatch("waste", "copy.comp", r#""In": "b", "Out": "c""#),
        show(),
    ]);
    assert_eq!(frame(&plan), ["make", "show", "export"]);
    let left: Vec<&str> = plan.culled.iter().map(|l| l.pass.as_str()).collect();
    assert_eq!(left, ["spare", "waste"]);
    assert!(plan.find_resource("b").is_none(), "a resource without uses needs no memory");
}

#[test]
fn ping_pong_ends_at_the_right_half_for_odd_and_even_counts() {
    for count in 1..=4 {
        let plan = solved(&[
            dispatch("make", "make.comp", r#""Out": "keys""#),
            format!(
                r#"Repeat(var: "i", count: {count}, body: [
                    Dispatch(name: "step", shader: "copy.comp", size: Threads(64), bind: {{"In": "front(keys)", "Out": "back(keys)"}}),
                    Swap("keys"),
                ]),"#
            ),
            dispatch("show", "show.comp", r#""In": "keys", "Image": "image""#),
        ]);
        assert_eq!(plan.frame.len(), count + 3, "{}", shown(&plan));
        let last = format!("keys#{}", count % 2);
        let show = plan.passes.iter().find(|p| p.name == "show").unwrap();
        assert_eq!(plan.resource(show.bindings[0].resource).name, last, "{}", shown(&plan));
    }
}

#[test]
fn a_buffer_that_each_frame_clears_is_not_taken_for_the_keys_of_a_sort() {
    let passes = [
        r#"Dispatch(name: "seed", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "keys"}),"#,
        &dispatch("clear", "make.comp", r#""Out": "a""#),
        r#"Repeat(var: "i", count: 3, body: [
            Dispatch(name: "step", shader: "counted.comp", size: Threads(64), bind: {"In": "keys", "Out": "back(keys)", "Count": "a"}),
            Swap("keys"),
        ]),"#,
        &dispatch("show", "show.comp", r#""In": "keys", "Image": "image""#),
    ];
    let counted = ("counted.comp", "r In 4\nw Out 4\nrwa Count 4");
    let plan = plan_of(&[counted, ("graph.ron", &graph("", &passes.join("\n")))], &[]);
    let warnings: Vec<&str> = plan.warnings.iter().map(|w| w.diagnostic.message.as_str()).collect();
    assert_eq!(warnings, ["the next frame does not start with the result of `step[2]`"]);
}

#[test]
fn the_same_file_gives_the_same_plan() {
    let passes = [
        make(),
        dispatch("left", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("right", "copy.comp", r#""In": "a", "Out": "c""#),
        dispatch("join", "join.comp", r#""In": "b", "In2": "c", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ];
    assert_eq!(solved(&passes), solved(&passes));
}

#[test]
fn a_writer_that_is_left_out_still_keeps_its_neighbours_apart() {
    let plan = solved(&[
        dispatch("first", "make.comp", r#""Out": "a""#),
        dispatch("use", "join.comp", r#""In": "a", "In2": "c", "Out": "d""#),
        dispatch("spare", "make.comp", r#""Out": "a""#),
        dispatch("both", "pair.comp", r#""Out": "a", "Out2": "b""#),
        dispatch("late", "make.comp", r#""Out": "c""#),
        dispatch("join", "join.comp", r#""In": "b", "In2": "d", "Out": "e""#),
        dispatch("show", "show.comp", r#""In": "e", "Image": "image""#),
    ]);
    assert_eq!(frame(&plan), ["first", "late", "use", "both", "join", "show", "export"], "{}", shown(&plan));
    assert_eq!(plan.culled[0].pass, "spare");
}

#[test]
fn a_name_may_be_chosen_by_an_expression() {
    let text = with_history(&[
        dispatch("make", "make.comp", r#""Out": "past""#),
        dispatch("show", "show.comp", r#""In": "scene.count > 5 ? 'last(past)' : 'past'", "Image": "image""#),
    ]);
    let late = plan(&text, &[]);
    assert_eq!(frame(&late), ["show", "make", "export"]);
    let now = plan(&text.replace("> 5", "< 5"), &[]);
    assert_eq!(frame(&now), ["make", "show", "export"]);
    let wrong = error_of(&text.replace("'last(past)'", "7"));
    assert!(wrong.contains("a resource is needed here") && wrong.contains("the integer 7"), "{wrong}");
}

#[test]
fn another_order_of_the_same_passes_gets_the_dependencies_that_it_needs() {
    let plan = solved(&[
        make(),
        dispatch("left", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("right", "copy.comp", r#""In": "a", "Out": "c""#),
        dispatch("join", "join.comp", r#""In": "b", "In2": "c", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ]);
    let mut ids = plan.frame.clone();
    ids.swap(1, 2);
    let other = reorder(&plan, &ids, false);
    assert_eq!(frame(&other), ["make", "right", "left", "join", "show", "export"]);
    assert_eq!(dependencies(&other, "right")[0], "ReadAfterWrite on a after make", "{}", shown(&other));
}
