//! Tests the encoders that a backend adds, as text and as JSON.

use super::*;
use crate::plan::Cause;

/// Adds hand-made encoders to a dump, for a few of its passes, with every construct once.
pub fn encoded(dump: Dump) -> Dump {
    let place = |name: &str| {
        let resource = dump.resources.iter().find(|r| r.name == name).map(|r| r.declared.clone());
        let declared = resource.or_else(|| dump.pass(name).map(|pass| pass.declared.clone()));
        Declared { name: name.into(), declared: declared.unwrap_or_else(|| panic!("no {name}")) }
    };
    let reason = |hazard, before: &str, resource: &str, after: &str| Cause {
        hazard,
        before: place(before),
        resource: place(resource),
        after: vec![place(after)],
        previous_frame: false,
        alias: None,
    };
    let pass = |name: &str| EncodedPass { pass: name.into(), barrier: None };
    let read = reason(Hazard::ReadAfterWrite, "scan_blocks", "visible", "project");
    let barrier = EncoderBarrier { scope: vec!["buffers".into(), "textures".into()], reasons: vec![read] };
    let overwritten = Cause {
        previous_frame: true,
        alias: Some(place("color")),
        ..reason(Hazard::WriteAfterRead, "project", "depth", "compose")
    };
    let drawn = reason(Hazard::ReadAfterWrite, "back_to_front", "splats", "project");
    let stage = |name: &str| Some(name.to_string());
    let compute = DumpEncoder {
        kind: "compute".into(),
        waits: vec![DumpWait { fence: 1, stage: None, reasons: vec![overwritten] }],
        passes: vec![pass("project"), EncodedPass { barrier: Some(barrier), ..pass("scan_blocks") }],
        updates: vec![DumpUpdate { fence: 0, stage: None }],
    };
    let render = DumpEncoder {
        kind: "render".into(),
        waits: vec![DumpWait { fence: 0, stage: stage("vertex"), reasons: vec![drawn] }],
        passes: vec![pass("back_to_front")],
        updates: vec![DumpUpdate { fence: 1, stage: stage("fragment") }],
    };
    let once = DumpEncoder {
        kind: "compute".into(),
        waits: vec![],
        passes: vec![pass("covariance")],
        updates: vec![],
    };
    let totals = |encoders, fences, barriers| EncoderTotals {
        encoders,
        fences,
        waits: fences,
        updates: fences,
        barriers,
    };
    let encoders = DumpEncoders {
        prologue: vec![once],
        handover: vec![reason(Hazard::ReadAfterWrite, "project", "covariances", "covariance")],
        frame: vec![compute, render],
        prologue_totals: totals(1, 0, 0),
        frame_totals: totals(2, 2, 1),
        timed_totals: totals(3, 3, 0),
    };
    Dump { encoders: Some(encoders), ..dump }
}

#[test]
fn encoders_stand_beside_the_barriers_of_the_plan_and_the_reasons_below() {
    let text = encoders_text(&encoded(dump(&example::splat(4)))).expect("it has encoders");
    let words: Vec<String> =
        text.lines().map(|l| l.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    for line in [
        "encoder 1 (compute)",
        "wait for fence 0 before vertex stage",
        "update fence 1 after fragment stage",
        "every frame, encoder 1, fence 1",
        "write after read on depth in the memory of color, after compose of the previous frame, for project",
        "read after write on covariances, after covariance, for project",
    ] {
        assert!(words.iter().any(|words| words == line), "{line} is not in\n{text}");
    }
    let row = words.iter().find(|words| words.starts_with("scan_blocks")).expect("it is there");
    assert!(row.starts_with("scan_blocks barrier: buffers, textures barrier "), "{row}");
    assert!(words.iter().any(|row| row.starts_with("every frame 2 encoders, 2 fences, 2 waits, 1 barrier ")));
}

#[test]
fn a_dump_without_encoders_has_no_text_of_them() {
    assert_eq!(encoders_text(&dump(&example::splat(4))), None);
}

#[test]
fn encoders_read_back_from_json_are_the_same() {
    let dump = encoded(dump(&example::splat(4)));
    let back: Dump = serde_json::from_str(&json(&dump).to_string()).expect("it is JSON");
    assert_eq!(back, dump);
}
