//! Layouts, storage images and colour attachments.

use super::*;

const COPIED: Side = (Stages::COPY, Accesses::TRANSFER_READ);
const DRAWN: Side = (Stages::COLOR_OUTPUT, Accesses::COLOR_WRITE);
const BLENDS: Side = (Stages::COLOR_OUTPUT, Accesses::COLOR_READ.union(Accesses::COLOR_WRITE));

const VERTEX: &str = "layout(set = 0, binding = 0) readonly buffer Corners { uint corners[]; };
void main() { gl_Position = vec4(float(corners[gl_VertexIndex]), 0, 0, 1); }";

const FRAGMENT: &str = "layout(location = 0) out vec4 color;
void main() { color = vec4(0.5); }";

impl Build {
    fn writes_image(&mut self, name: &str, image: ResourceId) {
        let shader = self.shader(
            "writes_image.comp",
            "layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;
void main() { imageStore(image, ivec2(0), vec4(1)); }",
        );
        self.dispatch(Run::Frame, name, shader, 1, &[(image, 0, WRITE)]);
    }

    fn reads_image(&mut self, name: &str, image: ResourceId) {
        let sink = self.words(&format!("sink of {name}"), 4);
        let shader = self.shader(
            "reads_image.comp",
            "layout(set = 0, binding = 0, rgba8) readonly uniform image2D image;
layout(set = 0, binding = 1) writeonly buffer Sink { vec4 sink; };
void main() { sink = imageLoad(image, ivec2(0)); }",
        );
        self.dispatch(Run::Frame, name, shader, 1, &[(image, 0, READ), (sink, 1, WRITE)]);
    }

    fn draws(&mut self, name: &str, image: ResourceId, load: Load, blend: Blend, corners: ResourceId) {
        let shaders = [self.shader("corners.vert", VERTEX), self.shader("half.frag", FRAGMENT)];
        let call = DrawCall::Direct { vertices: 3, instances: 1 };
        self.draw(name, shaders, call, &[Target { image, load, blend }], &[(corners, 0, READ)]);
    }

    fn picture(&mut self) -> ResourceId {
        self.image("picture", Format::Rgba8Unorm, 1, 1, Usage::STORAGE | Usage::COLOR_TARGET)
    }
}

const CLEARED: Load = Load::Clear(0.0, 0.0, 0.0, 0.0);

/// Returns a case with two dispatches on one image that stays in its layout.
fn two_on_an_image(first: Action, second: Action) -> Case {
    let mut build = Build::new();
    let image = build.picture();
    first(&mut build, "first", image);
    second(&mut build, "second", image);
    let mut case = case(build);
    case.before("second").truncate(1);
    case
}

fn drawn_then_read() -> Case {
    let mut build = Build::new();
    let (image, corners) = (build.picture(), build.words("corners", 4));
    build.draws("first", image, CLEARED, Blend::Replace, corners);
    build.reads_image("second", image);
    case(build).at_change("second", DRAWN, COMPUTE_READS)
}

fn stored_then_drawn() -> Case {
    let mut build = Build::new();
    let (image, corners) = (build.picture(), build.words("corners", 4));
    build.writes_image("first", image);
    build.draws("second", image, Load::Keep, Blend::PremultipliedOver, corners);
    case(build).at_change("second", COMPUTE_WRITES, BLENDS)
}

fn exported(first: impl FnOnce(&mut Build, ResourceId), source: Side) -> Case {
    let mut build = Build::new();
    let image = build.picture();
    first(&mut build, image);
    let case = Case { read_output: true, ..Case::of(build.export(image)) };
    case.at_change("export", source, COPIED)
}

fn transition<'a>(case: &'a mut Case, pass: &str) -> &'a mut Transition {
    let [change] = &mut case.before(pass)[..] else { panic!("one change of a layout") };
    change.image.as_mut().expect("a change of a layout")
}

#[test]
fn read_after_write_between_dispatches_through_an_image_is_caught() {
    let exact = two_on_an_image(Build::writes_image, Build::reads_image);
    let exact = exact.between("second", COMPUTE_WRITES, COMPUTE_READS);
    exact.caught(removed("second"), RAW);
    exact.caught(cleared("second", access(WRITE), NOTHING), RAW);
    exact.caught(cleared("second", NOTHING, access(READ)), RAW);
}

#[test]
fn write_after_read_between_dispatches_through_an_image_is_caught() {
    two_on_an_image(Build::reads_image, Build::writes_image).caught(removed("second"), WAR);
}

#[test]
fn write_after_write_between_dispatches_through_an_image_is_not_seen() {
    two_on_an_image(Build::writes_image, Build::writes_image).not_seen(removed("second"));
}

#[test]
fn a_wrong_layout_of_a_storage_image_is_caught() {
    let case = drawn_then_read();
    case.caught(removed("second"), "imageLayout");
    case.caught(|case| transition(case, "second").new = Layout::TransferSource, "imageLayout");
    case.caught(|case| transition(case, "second").old = Layout::TransferSource, "oldLayout");
    // This discards the drawn pixels, but breaks no rule.
    case.not_seen(|case| transition(case, "second").old = Layout::Undefined);
}

#[test]
fn a_wrong_layout_of_a_copied_image_is_caught() {
    let case = exported(|build, image| build.writes_image("first", image), COMPUTE_WRITES);
    case.caught(removed("export"), "srcImageLayout");
}

#[test]
fn the_layout_of_a_color_attachment_is_not_looked_at() {
    stored_then_drawn().not_seen(removed("second"));
    stored_then_drawn().not_seen(|case| transition(case, "second").new = Layout::TransferSource);
}

#[test]
fn a_layout_changes_after_what_was_stored_and_before_what_is_read() {
    // The transition itself is a write, and the layer checks both sides of its barrier.
    let exported = exported(|build, image| build.writes_image("first", image), COMPUTE_WRITES);
    exported.caught(cleared("export", access(WRITE), NOTHING), WAW);
    exported.caught(cleared("export", COMPUTE_WRITES, NOTHING), WAW);
    exported.caught(cleared("export", NOTHING, access(Accesses::TRANSFER_READ)), RAW);
    exported.caught(cleared("export", NOTHING, COPIED), RAW);
    stored_then_drawn().caught(cleared("second", access(WRITE), NOTHING), WAW);
    stored_then_drawn().caught(cleared("second", COMPUTE_WRITES, NOTHING), WAW);
    drawn_then_read().caught(cleared("second", NOTHING, access(READ)), RAW);
    drawn_then_read().caught(cleared("second", NOTHING, COMPUTE_READS), RAW);
}

#[test]
fn a_layout_that_changes_while_a_dispatch_reads_is_caught() {
    let mut build = Build::new();
    let (image, corners) = (build.picture(), build.words("corners", 4));
    build.reads_image("first", image);
    build.draws("second", image, CLEARED, Blend::Replace, corners);
    let exact = case(build).at_change("second", stage(Stages::COMPUTE), BLENDS);
    exact.caught(cleared("second", stage(Stages::COMPUTE), NOTHING), WAR);
}

#[test]
fn the_order_that_an_images_barrier_gives_holds_for_buffers_too() {
    // `second` may write the buffer that `first` reads, because the barrier on its image waits for `first`.
    let mut build = Build::new();
    let (image, words) = (build.picture(), build.words("words", 4));
    build.reads("first", words);
    let shader = build.shader(
        "second.comp",
        "layout(set = 0, binding = 0) writeonly buffer Words { uint words[]; };
layout(set = 0, binding = 1, rgba8) writeonly uniform image2D image;
void main() { words[0] = 1; imageStore(image, ivec2(0), vec4(1)); }",
    );
    build.dispatch(Run::Frame, "second", shader, 1, &[(words, 0, WRITE), (image, 1, WRITE)]);
    // The export leaves the image in another layout.
    let exact = Case::of(build.export(image)).at_change("second", stage(Stages::COMPUTE), COMPUTE_WRITES);
    exact.caught(cleared("second", stage(Stages::COMPUTE), NOTHING), WAR);
}

#[test]
fn what_a_draw_wrote_to_its_attachment_is_not_seen() {
    drawn_then_read().not_seen(cleared("second", access(Accesses::COLOR_WRITE), NOTHING));
    drawn_then_read().not_seen(cleared("second", DRAWN, NOTHING));
    let mut exported = exported(
        |build, image| {
            let corners = build.words("corners", 4);
            build.draws("first", image, CLEARED, Blend::Replace, corners);
        },
        DRAWN,
    );
    exported.not_seen(cleared("export", access(Accesses::COLOR_WRITE), NOTHING));
    exported.read_output = false;
    exported.not_seen(cleared("export", DRAWN, NOTHING));
}

#[test]
fn what_a_draw_does_to_its_attachment_after_a_change_of_layout_is_not_seen() {
    stored_then_drawn().not_seen(cleared("second", NOTHING, access(BLENDS.1)));
    stored_then_drawn().not_seen(cleared("second", NOTHING, BLENDS));
}

#[test]
fn a_second_draw_into_the_same_attachment_is_not_seen() {
    for blend in [Blend::Replace, Blend::PremultipliedOver] {
        let mut build = Build::new();
        let (image, corners) = (build.picture(), build.words("corners", 4));
        build.draws("first", image, CLEARED, blend, corners);
        build.draws("second", image, Load::Keep, blend, corners);
        let exact = case(build).between("second", DRAWN, BLENDS);
        exact.not_seen(removed("second"));
        exact.not_seen(cleared("second", access(Accesses::COLOR_WRITE), NOTHING));
        exact.not_seen(cleared("second", NOTHING, access(Accesses::COLOR_READ)));
        exact.not_seen(cleared("second", NOTHING, access(Accesses::COLOR_WRITE)));
    }
}

#[test]
fn vertices_that_read_what_a_dispatch_wrote_are_caught() {
    let mut build = Build::new();
    let (image, corners) = (build.picture(), build.words("corners", 4));
    build.writes("first", corners);
    build.draws("second", image, CLEARED, Blend::Replace, corners);
    let mut exact = case(build).at_change("second", NOTHING, BLENDS);
    let wrote = barrier(COMPUTE_WRITES, (Stages::VERTEX, READ));
    exact.before("second").insert(0, wrote);
    exact.caught(|case| drop(case.before("second").remove(0)), RAW);
    exact.caught(cleared("second", access(WRITE), NOTHING), RAW);
    exact.caught(cleared("second", NOTHING, access(READ)), RAW);
    exact.caught(|case| case.before("second")[0].masks.target_stages = Stages::FRAGMENT, RAW);
}

#[test]
fn vertices_that_read_what_a_dispatch_then_writes_are_caught() {
    let mut build = Build::new();
    let (image, corners) = (build.picture(), build.words("corners", 4));
    build.draws("first", image, CLEARED, Blend::Replace, corners);
    build.writes("second", corners);
    let exact = case(build).between("second", stage(Stages::VERTEX), stage(Stages::COMPUTE));
    exact.caught(removed("second"), WAR);
    exact.caught(cleared("second", stage(Stages::VERTEX), NOTHING), WAR);
}

#[test]
fn a_draw_whose_arguments_a_dispatch_wrote_is_caught() {
    let mut build = Build::new();
    let (image, corners, args) = (build.picture(), build.words("corners", 4), build.words("args", 4));
    build.writes("first", args);
    let shaders = [build.shader("corners.vert", VERTEX), build.shader("half.frag", FRAGMENT)];
    let call = DrawCall::Indirect { buffer: args, offset: 0 };
    let target = Target { image, load: CLEARED, blend: Blend::Replace };
    build.draw("second", shaders, call, &[target], &[(corners, 0, READ)]);
    let mut exact = case(build).at_change("second", NOTHING, BLENDS);
    let wrote = barrier(COMPUTE_WRITES, (Stages::INDIRECT, Accesses::INDIRECT_READ));
    exact.before("second").insert(0, wrote);
    exact.caught(|case| drop(case.before("second").remove(0)), RAW);
    exact.caught(cleared("second", access(WRITE), NOTHING), RAW);
    exact.caught(cleared("second", NOTHING, access(Accesses::INDIRECT_READ)), RAW);
}

#[test]
fn every_bit_missing_from_the_handover_of_an_image_that_starts_with_zeros_is_caught() {
    let mut build = Build::new();
    let image = build.picture();
    build.history(image);
    build.reads_image("second", image);
    let mut case = case(build);
    case.before("second").clear();
    let handover = case.barriers.handover.iter_mut().find(|b| b.image.is_some_and(|i| i.image == image));
    let handover = handover.expect("the image changes its layout");
    *handover = Barrier { image: handover.image, ..barrier(FILLS, COMPUTE_READS) };
    let index =
        case.barriers.handover.iter().position(|b| b.masks.source_stages == FILLS.0).expect("that barrier");
    case.caught(|case| drop(case.barriers.handover.remove(index)), RAW);
    case.caught(|case| case.barriers.handover[index].masks.source_accesses = Accesses::empty(), WAW);
    case.caught(|case| case.barriers.handover[index].masks.target_accesses = Accesses::empty(), RAW);
}
