use super::*;

fn aliases(plan: &Plan) -> Vec<Vec<&str>> {
    let names = |block: &crate::plan::Block| {
        block.aliases.iter().map(|id| plan.resource(*id).name.as_str()).collect::<Vec<_>>()
    };
    plan.blocks.iter().filter(|b| b.aliases.len() > 1).map(names).collect()
}

#[test]
fn resources_that_are_never_alive_together_share_memory_and_the_next_alias_waits_for_the_last() {
    let passes = [
        make(),
        dispatch("one", "copy.comp", r#""In": "a", "Out": "b""#),
        dispatch("two", "copy.comp", r#""In": "b", "Out": "c""#),
        dispatch("show", "show.comp", r#""In": "c", "Image": "image""#),
    ];
    let plan = packed(&passes);
    // `a` ends before `image` begins; `b` and `c` each overlap one of the two.
    assert_eq!(aliases(&plan), [["image", "a"]], "{}", shown(&plan));
    assert_eq!(plan.unshared_bytes() - plan.transient_bytes(), 256);
    let expected = ["WriteAfterRead on a (image) after export of the previous frame"];
    assert_eq!(dependencies(&plan, "make"), expected, "{}", shown(&plan));
    let apart = solved(&passes);
    assert_eq!(aliases(&apart), Vec::<Vec<&str>>::new());
    assert_eq!(apart.unshared_bytes(), apart.transient_bytes());
}

#[test]
fn an_image_does_not_follow_an_alias_whose_last_write_is_not_read() {
    // `b` is written and never read; the pass is needed for its other output. The length of `b` is not a read.
    let plan = packed(&[
        dispatch("make", "pair.comp", r#""Out": "a", "Out2": "b""#),
        dispatch("one", "copy.comp", r#""In": "a", "Out": "c""#),
        dispatch("length", "length.comp", r#""In": "b", "Out": "e""#),
        dispatch("two", "join.comp", r#""In": "c", "In2": "e", "Out": "d""#),
        dispatch("show", "show.comp", r#""In": "d", "Image": "image""#),
    ]);
    let image = plan.find_resource("image").unwrap();
    let aliases: Vec<&str> = plan.aliases(image).map(|id| plan.resource(id).name.as_str()).collect();
    assert!(!aliases.contains(&"b") && !aliases.is_empty(), "{aliases:?}{}", shown(&plan));
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
