use super::*;

#[test]
fn a_pass_that_only_the_next_frame_reads_from_is_not_left_out() {
    let plan = solved(&[
        r#"Dispatch(name: "start", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#
            .into(),
        show(),
        dispatch("step", "change.comp", r#""Out": "a""#),
    ]);
    assert_eq!(frame(&plan), ["show", "step", "export"], "{}", shown(&plan));
    assert_eq!(
        dependencies(&plan, "show")[1],
        "ReadAfterWrite on a after step of the previous frame",
        "{}",
        shown(&plan)
    );
}

#[test]
fn a_reader_of_the_last_frame_comes_before_the_writer_wherever_it_stands() {
    let plan = kept(&[
        dispatch("make", "make.comp", r#""Out": "past""#),
        dispatch("use", "copy.comp", r#""In": "last(past)", "Out": "a""#),
        show(),
    ]);
    assert_eq!(frame(&plan), ["use", "make", "show", "export"], "{}", shown(&plan));
    assert_eq!(plan.prologue.len(), 1, "zeros to begin with");
    assert!(matches!(plan.pass(plan.prologue[0]).work, Work::ClearHistory { .. }));
    let expected = ["start(past) of the prologue", "make of the previous frame"];
    let expected = expected.map(|after| format!("ReadAfterWrite on past after {after}"));
    assert!(dependencies(&plan, "use").starts_with(&expected), "{}", shown(&plan));
    assert_eq!(dependencies(&plan, "make"), ["WriteAfterRead on past after use"], "{}", shown(&plan));
}

#[test]
fn of_a_ping_pong_resource_the_half_that_the_frame_ends_with_lives_on_for_odd_and_even_counts() {
    for count in 1..=4 {
        let plan = kept(&[
            dispatch("use", "copy.comp", r#""In": "last(order)", "Out": "a""#),
            dispatch("make", "make.comp", r#""Out": "order""#),
            format!(
                r#"Repeat(var: "i", count: {count}, body: [
                Dispatch(name: "step", shader: "copy.comp", size: Threads(64), bind: {{"In": "front(order)", "Out": "back(order)"}}),
                Swap("order"),
            ]),"#
            ),
            show(),
        ]);
        let real = plan.passes.iter().find(|p| p.name == "use").unwrap().bindings[0].resource;
        assert_eq!(plan.resource(real).name, format!("order#{}", count % 2), "{}", shown(&plan));
        assert_eq!(plan.resource(real).history.as_deref(), Some("order"));
        let others = plan.resources.iter().filter(|r| r.history.is_some()).count();
        assert_eq!(others, 1, "the other half is as any other buffer");
        // All of the frame's passes are needed by the next frame.
        assert_eq!(plan.culled, []);
    }
}

#[test]
fn a_history_that_is_changed_in_place_is_its_own_reader() {
    let plan = kept(&[
        dispatch("step", "change.comp", r#""Out": "past""#),
        dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
    ]);
    assert_eq!(frame(&plan), ["step", "show", "export"]);
    let expected = "WriteAfterRead on past after show of the previous frame".to_string();
    assert!(dependencies(&plan, "step").contains(&expected), "{}", shown(&plan));
}

#[test]
fn an_image_with_a_history_keeps_its_contents_through_changes_of_layout() {
    let plan = kept(&[
        make(),
        dispatch("use", "filter.comp", r#""Color": "last(trail)", "Image": "image""#),
        r#"Draw(name: "draw", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {"In": "a"}, targets: [Target(image: "trail", load: Keep, blend: PremultipliedOver)]),"#.into(),
    ]);
    let changes: Vec<(Layout, Layout)> = (plan.layout_changes.iter())
        .filter(|change| plan.resource(change.image).name == "trail")
        .map(|change| (change.old, change.new))
        .collect();
    // The clear before the first frame, the handover to the layout that frames leave, and two changes per frame.
    let expected = [
        (Layout::Undefined, Layout::TransferTarget),
        (Layout::TransferTarget, Layout::ColorTarget),
        (Layout::ColorTarget, Layout::General),
        (Layout::General, Layout::ColorTarget),
    ];
    assert_eq!(changes, expected, "{}", shown(&plan));
}

#[test]
fn a_pass_that_needs_the_last_frame_and_this_one_of_the_same_buffer_is_a_cycle() {
    let error = error_of(&with_history(&[
        dispatch("make", "make.comp", r#""Out": "past""#),
        dispatch("use", "join.comp", r#""In": "last(past)", "In2": "past", "Out": "a""#),
        show(),
    ]));
    assert!(error.contains("wait for each other"), "{error}");
}

#[test]
fn what_the_frame_before_left_cannot_be_filled() {
    let passes = [r#"Fill(name: "f", buffer: "last(past)", value: 0),"#.to_string()];
    let text = error_of(&with_history(&passes));
    assert!(text.contains("cannot be filled"), "{text}");
}

/// Returns whether the contents of a resource persist, and whether it shares memory.
fn kept_and_shared(plan: &Plan, name: &str) -> (bool, bool) {
    let id = plan.find_resource(name).expect("it is used");
    (plan.resource(id).history.is_some(), plan.aliases(id).next().is_some())
}

#[test]
fn a_history_that_frames_write_in_part_keeps_the_rest() {
    // It is unknown whether a shader writes everything: `make` may leave a part unchanged.
    let passes = [
        dispatch("first", "make.comp", r#""Out": "a""#),
        dispatch("second", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("make", "copy.comp", r#""In": "b", "Out": "past""#),
        dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
    ];
    let plan = kept(&passes);
    assert_eq!(kept_and_shared(&plan, "past"), (true, false), "{}", shown(&plan));
    assert_eq!(plan.pass(plan.prologue[0]).name, "start(past)");
    let plain = with_history(&passes).replace(
        "past\": Buffer(stride: 4, count: 64, history: true)",
        "past\": Buffer(stride: 4, count: 64)",
    );
    let plain = super::plan(&plain, &[]);
    assert_eq!(kept_and_shared(&plain, "past"), (false, true), "{}", shown(&plain));
    assert_eq!(plain.prologue, []);
}

#[test]
fn a_history_that_every_frame_writes_over_before_it_reads_is_none() {
    let overwritten = [
        r#"Fill(name: "clear", buffer: "past", value: 0),"#.into(),
        dispatch("count", "change.comp", r#""Out": "past""#),
        draw("draw", "Clear(0, 0, 0, 0)").replace("color", "trail"),
        make(),
        dispatch("mix", "filter.comp", r#""Color": "trail", "Image": "image""#),
        dispatch("show", "mix.comp", r#""In": "past", "Image": "image""#),
    ];
    let plan = kept(&overwritten);
    assert!(plan.resources.iter().all(|r| r.history.is_none()), "{}", shown(&plan));
    assert_eq!(plan.prologue, []);
    // Variants that keep contents: a fill that is not first, and a target that is not cleared.
    let mut kept = overwritten.clone();
    kept.swap(0, 1);
    kept[2] = kept[2].replace("Clear(0, 0, 0, 0)", "Keep");
    let plan = super::kept(&kept);
    assert_eq!([kept_and_shared(&plan, "past"), kept_and_shared(&plan, "trail")], [(true, false); 2]);
}

#[test]
fn a_history_with_a_single_writer_is_written_over_before_it_is_read_wherever_that_stands() {
    let passes = [
        dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
        r#"Fill(name: "clear", buffer: "past", value: 0),"#.into(),
    ];
    let plan = kept(&passes);
    assert_eq!(frame(&plan), ["clear", "show", "export"]);
    assert_eq!((kept_and_shared(&plan, "past").0, plan.prologue.len()), (false, 0));
}

#[test]
fn a_pass_that_runs_once_and_writes_a_part_of_a_history_finds_zeros() {
    let passes = [
        r#"Dispatch(name: "seed", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "past"}),"#.into(),
        dispatch("step", "change.comp", r#""Out": "past""#),
        dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
    ];
    let plan = kept(&passes);
    let prologue: Vec<&str> = plan.prologue.iter().map(|id| plan.pass(*id).name.as_str()).collect();
    assert_eq!(prologue, ["start(past)", "seed"], "{}", shown(&plan));
}

#[test]
fn a_pass_that_runs_once_reads_zeros_before_another_seeds_the_history() {
    let passes = [
        r#"Dispatch(name: "peek", run: Once, shader: "join.comp", size: Threads(64), bind: {"In": "last(past)", "In2": "b", "Out": "a"}),"#.into(),
        r#"Dispatch(name: "seed", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "past"}),"#.into(),
        r#"Dispatch(name: "make", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "b"}),"#.into(),
        dispatch("step", "change.comp", r#""Out": "past""#),
        dispatch("show", "join_show.comp", r#""In": "past", "In2": "a", "Image": "image""#),
    ];
    let plan = kept(&passes);
    let prologue: Vec<&str> = plan.prologue.iter().map(|id| plan.pass(*id).name.as_str()).collect();
    assert_eq!(prologue, ["start(past)", "make", "peek", "seed"], "{}", shown(&plan));
}

#[test]
fn a_history_is_shown_while_the_repeat_that_changes_it_has_no_iterations() {
    let step = dispatch("step", "change.comp", r#""Out": "past""#);
    let passes = [
        format!(r#"Repeat(var: "i", count: 0, body: [Repeat(var: "j", count: 2, body: [{step}])]),"#),
        dispatch("show", "show.comp", r#""In": "past", "Image": "image""#),
    ];
    let plan = kept(&passes);
    assert_eq!(frame(&plan), ["show", "export"], "{}", shown(&plan));
    let left: Vec<_> = plan.culled.iter().map(|left| (left.pass.as_str(), left.why.as_str())).collect();
    assert_eq!(left, [("step", "the count of its repeat is 0: 0")]);
}

#[test]
fn whether_contents_are_kept_may_depend_on_a_constant() {
    let passes = [
        dispatch("make", "make.comp", r#""Out": "past""#),
        dispatch("use", "copy.comp", r#""In": "keep ? 'last(past)' : 'past'", "Out": "a""#),
        show(),
    ];
    let text = with_history(&passes)
        .replace(
            "\"past\": Buffer(stride: 4, count: 64, history: true)",
            "\"past\": Buffer(stride: 4, count: 64, history: \"keep\")",
        )
        .replace("params: {", "params: {\"keep\": Const(Bool(default: true)),");
    assert_eq!(frame(&plan(&text, &[])), ["use", "make", "show", "export"]);
    let plan = plan(&text, &[("keep", "false")]);
    assert_eq!(
        (frame(&plan), kept_and_shared(&plan, "past").0),
        (vec!["make", "use", "show", "export"], false)
    );
}

#[test]
fn a_history_without_readers_goes_with_its_passes() {
    let plan = kept(&[
        dispatch("make", "make.comp", r#""Out": "past""#),
        dispatch("spare", "copy.comp", r#""In": "last(past)", "Out": "b""#),
        dispatch("other", "make.comp", r#""Out": "a""#),
        show(),
    ]);
    assert_eq!(frame(&plan), ["other", "show", "export"]);
    assert_eq!(plan.prologue, []);
    assert!(plan.resources.iter().all(|r| r.history.is_none()));
}

#[test]
fn a_result_that_frames_change_is_state_unless_they_first_overwrite_it() {
    let clear = r#"Fill(name: "clear", buffer: "a", value: 0),"#;
    for (first, is_state) in [("", true), (clear, false)] {
        let plan = solved(&[
            r#"Dispatch(name: "start", run: Once, shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#.into(),
            r#"Dispatch(name: "keep", run: Once, shader: "copy.comp", size: Threads(64), bind: {"In": "a", "Out": "b"}),"#.into(),
            first.into(),
            dispatch("step", "change.comp", r#""Out": "a""#),
            show(),
            dispatch("also", "show.comp", r#""In": "b", "Image": "image""#),
        ]);
        assert_eq!(plan.prologue.len(), 2, "{}", shown(&plan));
        assert_eq!(plan.carries_state(), is_state, "{}", shown(&plan));
    }
}
