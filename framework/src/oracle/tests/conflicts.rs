//! Which accesses are listed as conflicts.

use super::*;

/// The pairs of passes, with the resource of the first and what is said of frames in flight.
fn pairs(sketch: &Sketch) -> Vec<String> {
    let name = |id: PassId| &sketch.plan.pass(id).name;
    let shown = |Conflict { touches: [one, other], per_frame }: &Conflict| {
        let resource = &sketch.plan.resource(one.resource).name;
        let apart = if *per_frame { ", per frame" } else { "" };
        format!("{} {}: {resource}{apart}", name(one.pass), name(other.pass))
    };
    conflicts(&sketch.plan).iter().map(shown).collect()
}

#[test]
fn a_write_conflicts_with_itself_and_with_reads_and_reads_with_none() {
    let mut s = Sketch::new();
    let x = s.buffer("x");
    s.frame("write", &[], &[writes(x)]);
    s.frame("one", &[], &[reads(x)]);
    s.frame("two", &[], &[reads(x)]);
    assert_eq!(pairs(&s), ["write write: x", "write one: x", "write two: x"]);
}

#[test]
fn resources_in_one_memory_conflict_where_their_bytes_meet() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.buffer("y"));
    s.frame("x", &[], &[reads(x)]);
    s.frame("y", &[], &[writes(y)]);
    assert_eq!(pairs(&s), ["y y: y"]);
    s.share(x, y);
    assert_eq!(pairs(&s), ["x y: x", "y y: y"]);
}

#[test]
fn arguments_conflict_by_their_words_alone() {
    let mut s = Sketch::new();
    let (args, short) = (s.buffer("args"), s.sized("short", 16));
    s.share(args, short);
    let work =
        |offset| Work::Dispatch { shader: ShaderId(0), groups: Groups::Indirect { buffer: args, offset } };
    let uses = [touch(args, Stages::INDIRECT, Accesses::INDIRECT_READ)];
    s.frame_work("within", &[], work(0), &uses);
    s.frame_work("behind", &[], work(16), &uses);
    s.frame("write", &[], &[writes(short)]);
    assert_eq!(pairs(&s), ["within write: args", "write write: short"]);
}

#[test]
fn what_each_frame_in_flight_has_for_itself_conflicts_within_the_frame() {
    let mut s = Sketch::new();
    let stats = s.resource("stats", Shape::Buffer { stride: 4, count: 1 }, Source::Readback);
    s.plan.stats.push(Stat { name: "count".into(), buffer: stats, offset: 0 });
    s.frame_work("export", &[], Work::Export, &[touch(stats, COPY, Accesses::TRANSFER_WRITE)]);
    s.frame_work("host", &[], Work::Host, &[touch(stats, Stages::HOST, Accesses::HOST_READ)]);
    assert_eq!(pairs(&s), ["export export: stats, per frame", "export host: stats, per frame"]);
}
