//! Tests the objections of the check to lists of dependencies with one mistake each.

use super::sketch::*;
use crate::oracle::dependencies;
use crate::solve::add_dependencies;
use crate::{ir::*, plan::*};

fn found(mut sketch: Sketch, change: impl FnOnce(&mut Plan)) -> Vec<String> {
    add_dependencies(&mut sketch.plan);
    change(&mut sketch.plan);
    dependencies(&sketch.plan).iter().map(|objection| objection.describe(&sketch.plan)).collect()
}

fn shared() -> Sketch {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.buffer("y"));
    s.share(x, y);
    s.frame("write", &[writes(x)]);
    s.frame("one", &[reads(x)]);
    s.frame("two", &[reads(x)]);
    s.frame("over", &[writes(y)]);
    s
}

fn drawn() -> Sketch {
    let mut s = Sketch::new();
    let image = s.image("image");
    s.frame("draw", &[Use { layout: Some(Layout::General), ..writes(image) }]);
    let copy = touch(image, COPY, Accesses::TRANSFER_READ);
    s.frame_work("export", Work::Export, &[Use { layout: Some(Layout::TransferSource), ..copy }]);
    s.plan.output = image;
    s
}

#[test]
fn the_solvers_list_is_complete_and_nothing_of_it_is_needless() {
    assert_eq!(found(shared(), |_| {}), [""; 0]);
    assert_eq!(found(drawn(), |_| {}), [""; 0]);
}

#[test]
fn every_reader_since_the_last_write_has_a_dependency_and_the_write_has_none() {
    let mut s = shared();
    add_dependencies(&mut s.plan);
    let name = |id: PassId| s.plan.pass(id).name.as_str();
    let shown: Vec<String> = (s.plan.dependencies.iter())
        .map(|d| format!("{} after {} {:?} {:?}", name(d.second), name(d.first), d.hazard, d.since))
        .collect();
    let expected = [
        "write after over WriteAfterWrite PreviousFrame",
        "one after write ReadAfterWrite Same",
        "two after write ReadAfterWrite Same",
        "over after one WriteAfterRead Same",
        "over after two WriteAfterRead Same",
    ];
    assert_eq!(shown, expected);
}

#[test]
fn a_use_without_an_access_stands_for_no_other() {
    let sketch = || {
        let mut s = Sketch::new();
        let (x, y) = (s.buffer("x"), s.buffer("y"));
        s.share(x, y);
        s.frame("write", &[writes(x)]);
        s.frame("length", &[touch(x, COMPUTE, NO_ACCESS)]);
        s.frame("over", &[writes(y)]);
        s
    };
    assert_eq!(found(sketch(), |_| {}), [""; 0]);
    let text = found(sketch(), |plan| {
        let after = plan.dependencies.iter_mut().find(|d| d.since == Since::Same).expect("on `write`");
        (after.first, after.hazard) = (PassId(1), Hazard::WriteAfterRead);
        after.masks.source_accesses = NO_ACCESS;
    });
    assert_eq!(
        text,
        [
            "no dependency of `over` on `write` orders STORAGE_WRITE at COMPUTE after STORAGE_WRITE at COMPUTE of `y` (WriteAfterWrite)",
            "needless: the whole of the dependency of `over` on `length` for `y` (WriteAfterRead)",
        ]
    );
}

#[test]
fn a_missing_dependency_is_named_by_both_passes_and_accesses() {
    let text = found(shared(), |plan| {
        plan.dependencies.remove(1);
    });
    let expected = "no dependency of `one` on `write` orders STORAGE_READ at COMPUTE after STORAGE_WRITE at COMPUTE of `x` (ReadAfterWrite)";
    assert_eq!(text, [expected]);
}

#[test]
fn a_dependency_of_the_wrong_frame_is_missing_and_needless() {
    let text = found(shared(), |plan| plan.dependencies[3].since = Since::PreviousFrame);
    assert_eq!(text.len(), 2, "{text:#?}");
    assert!(text[0].starts_with("no dependency of `over` on `one`"), "{text:#?}");
    assert!(text[1].starts_with("needless: the whole of the dependency of `over` on `one`"), "{text:#?}");
}

#[test]
fn a_stage_that_no_access_has_is_needless_and_an_access_that_is_left_out_is_missing() {
    let text = found(shared(), |plan| plan.dependencies[1].masks.target_stages |= Stages::VERTEX);
    assert_eq!(
        text,
        ["needless: target VERTEX of the dependency of `one` on `write` for `x` (ReadAfterWrite)"]
    );
    let text = found(shared(), |plan| plan.dependencies[1].masks.target_accesses = Accesses::empty());
    assert!(text[0].starts_with("no dependency of `one` on `write` orders STORAGE_READ"), "{text:#?}");
}

#[test]
fn a_layout_change_that_waits_for_nothing_is_found() {
    let text = found(drawn(), |plan| plan.dependencies.iter_mut().for_each(|d| d.changes_layout = false));
    let change = "no dependency of `export` on `draw` orders the layout change after STORAGE_WRITE at COMPUTE of `image` (LayoutChange)";
    assert!(text.iter().any(|text| text == change), "{text:#?}");
}

#[test]
fn an_image_in_another_layout_than_its_pass_needs_is_found() {
    let text =
        found(drawn(), |plan| plan.layout_changes.retain(|change| change.new != Layout::TransferSource));
    let layout = "`export` expects `image` in the layout TransferSource, found General";
    assert!(text.iter().any(|text| text == layout), "{text:#?}");
    let text = found(drawn(), |plan| {
        let again = *plan.layout_changes.last().expect("the export's");
        plan.layout_changes.push(LayoutChange { old: again.new, ..again });
    });
    assert_eq!(text, ["needless: the change of `image` to TransferSource before `export`"]);
}

#[test]
fn an_image_waits_for_a_read_of_any_bytes_of_its_block() {
    let sketch = || {
        let mut s = Sketch::new();
        let (args, image) = (s.sized("args", 4 * BYTES), s.image("image"));
        s.share(image, args);
        s.frame("fill", &[fills(args)]);
        // Beyond the image's texels, but the image may take more memory than they need.
        let call = DrawCall::Indirect { buffer: args, offset: 2 * BYTES };
        let Work::Draw { vertex, fragment, topology, targets, depth, .. } = draw() else { unreachable!() };
        let draw = Work::Draw { vertex, fragment, topology, call, targets, depth };
        s.frame_work("draw", draw, &[touch(args, Stages::INDIRECT, Accesses::INDIRECT_READ)]);
        s.frame("show", &[Use { discards: true, ..in_general(image, WRITE) }]);
        s
    };
    assert_eq!(found(sketch(), |_| {}), [""; 0]);
    let text =
        found(sketch(), |plan| plan.dependencies.retain(|d| (d.first, d.second) != (PassId(1), PassId(2))));
    let expected = "no dependency of `show` on `draw` orders STORAGE_WRITE at COMPUTE after INDIRECT_READ at INDIRECT of `image` (WriteAfterRead)";
    assert!(text.iter().any(|text| text == expected), "{text:#?}");
}
