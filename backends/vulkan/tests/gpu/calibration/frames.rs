//! Hazards between frames, with copies and with the host.
//!
//! Two frames are submitted without waiting for either. The layer compares submissions only if its environment requests
//! it ([`again_comparing_submissions`]), so tests of two frames run both without and with that setting.

use super::*;

/// Checks that the layer catches a mistake between two frames if and only if it compares submissions. `test` is the
/// calling test's name in this file.
fn caught_between_submissions(
    test: &str,
    case: impl Fn() -> Case,
    mistake: impl FnOnce(&mut Case),
    expected: &str,
) {
    let case = Case { frames: 2, ..case() };
    if compares_submissions() {
        case.caught(mistake, expected);
    } else {
        case.not_seen(mistake);
        again_comparing_submissions(&format!("calibration::frames::{test}"));
    }
}

fn statistic() -> Case {
    let mut build = Build::new();
    let words = build.words("words", 4);
    build.fill(Run::Frame, "first", words, 1);
    build.stat("statistic", words, 0);
    case(build).between("export", FILLS, (Stages::COPY, Accesses::TRANSFER_READ))
}

#[test]
fn read_after_write_across_frames() {
    let order = stage(Stages::COMPUTE);
    let case = || two(Build::reads, Build::writes).between("second", order, order);
    let test = "read_after_write_across_frames";
    caught_between_submissions(test, case, removed("first"), RAW);
}

#[test]
fn a_missing_access_across_frames() {
    let case = || {
        let order = stage(Stages::COMPUTE);
        let case = two(Build::reads, Build::writes).between("second", order, order);
        case.between("first", COMPUTE_WRITES, COMPUTE_DOES_BOTH)
    };
    let test = "a_missing_access_across_frames";
    caught_between_submissions(test, case, cleared("first", access(WRITE), NOTHING), RAW);
}

#[test]
fn write_after_read_across_frames() {
    let case = || two(Build::writes, Build::reads).between("second", COMPUTE_WRITES, COMPUTE_READS);
    caught_between_submissions("write_after_read_across_frames", case, removed("first"), WAR);
}

#[test]
fn write_after_write_of_a_fill_across_frames() {
    let case = || two(fills, Build::changes).between("second", FILLS, COMPUTE_DOES_BOTH);
    let test = "write_after_write_of_a_fill_across_frames";
    caught_between_submissions(test, case, removed("first"), WAW);
}

#[test]
fn a_copy_that_reads_what_the_next_frame_writes() {
    let test = "a_copy_that_reads_what_the_next_frame_writes";
    caught_between_submissions(test, statistic, removed("first"), WAR);
}

#[test]
fn a_copy_that_reads_what_a_fill_writes_is_caught() {
    statistic().caught(removed("export"), RAW);
    statistic().caught(cleared("export", access(Accesses::TRANSFER_WRITE), NOTHING), RAW);
    statistic().caught(cleared("export", NOTHING, access(Accesses::TRANSFER_READ)), RAW);
}

#[test]
fn a_host_that_reads_without_a_barrier_is_not_seen() {
    statistic().not_seen(removed("host"));
}

#[test]
fn an_image_in_the_wrong_layout_across_frames_is_caught() {
    let mut build = Build::new();
    let image = build.image("kept", Format::R32Uint, 1, 1, Usage::STORAGE);
    let grow = build.shader("grow.comp", &image_shader("imageLoad(image, ivec2(0)) + 1"));
    build.history(image);
    build.dispatch(Run::Frame, "grow", grow, 1, &[(image, 0, BOTH)]);
    let case = Case { frames: 2, ..Case::of(build.export(image)) };
    case.caught(|case| case.barriers.handover.clear(), "VUID-VkImageMemoryBarrier2-oldLayout");
    case.caught(removed("grow"), "VUID-vkCmdDispatch");
}
