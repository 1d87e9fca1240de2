use super::*;
use crate::draw::facts;
use crate::draw::planner::Planner;
use egui::epaint::textures::TextureOptions;
use egui::epaint::{ColorImage, ImageDelta, Mesh, TextureId};
use egui::{Color32, pos2, vec2};
use splatgraph_api::{BufferContents, FrameInputs};
use splatgraph_framework::ir::{DrawCall, Format, Shape, Source, Work};
use splatgraph_vulkan::sync;
use splatgraph_vulkan::sync::model::{Replay, mutate::needless, replay};

const FONT: TextureId = TextureId::Managed(0);

const ONE: Vec2 = Vec2::splat(1.0);

fn changes(list: Vec<(TextureId, ImageDelta)>, free: &[TextureId]) -> TexturesDelta {
    let mut changes = TexturesDelta::default();
    for (id, change) in list {
        changes.push(id, change);
    }
    free.iter().for_each(|id| changes.free(*id));
    changes
}

/// Makes an image whose texels contain their index and `tag`.
fn image([width, height]: [usize; 2], tag: u8) -> ColorImage {
    let pixels = (0..width * height).map(|i| Color32::from_rgba_premultiplied(i as u8, tag, 0, 255));
    ColorImage::new([width, height], pixels.collect())
}

fn whole(size: [usize; 2], tag: u8) -> ImageDelta {
    ImageDelta::full(image(size, tag), TextureOptions::LINEAR)
}

/// Makes a composition whose view is the whole window, so that the interface is packed as one area.
fn whole_view() -> Composition {
    Composition { window: [1000, 800], view: [0, 0, 1000, 800], ..composition() }
}

/// Makes a painter with a font texture of 2 x 2 texels.
fn painter() -> Painter {
    let mut painter = Painter::default();
    painter.paint(changes(vec![(FONT, whole([2, 2], 0))], &[]), vec![], ONE, &whole_view());
    painter
}

fn rectangle(rect: Rect, colour: Color32, clip_rect: Rect, texture: TextureId) -> ClippedPrimitive {
    let mut mesh = Mesh::default();
    mesh.add_colored_rect(rect, colour);
    mesh.texture_id = texture;
    ClippedPrimitive { clip_rect, primitive: Primitive::Mesh(mesh) }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn read<T: Pod>(bytes: &[u8]) -> Vec<T> {
    bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
}

fn texels(painter: &Painter, id: TextureId) -> Vec<[u8; 4]> {
    let Texture { texels: at, width, height, .. } = painter.textures.get(id).expect("there");
    let all: Vec<[u8; 4]> = read(&painter.textures.texels());
    all[at as usize..][..(width * height) as usize].to_vec()
}

#[test]
fn a_rectangle_becomes_two_triangles_with_its_colour_and_clip() {
    let red = Color32::from_rgba_premultiplied(200, 10, 0, 220);
    let rect = Rect::from_min_size(pos2(10.0, 20.0), vec2(30.0, 5.0));
    let clip = Rect::from_min_max(pos2(12.3, 0.0), pos2(1e9, f32::INFINITY));
    let mut painter = painter();
    let first = rectangle(Rect::EVERYTHING, Color32::BLACK, Rect::EVERYTHING, FONT);
    let painted = painter.paint(
        TexturesDelta::default(),
        vec![first, rectangle(rect, red, clip, FONT)],
        vec2(2.0, 2.0),
        &whole_view(),
    );
    assert_eq!(words(&painted[DRAW]), [12, 1, 0, 0]);
    let indices = words(&painted[INDICES]);
    assert!(indices[6..].iter().all(|i| (4..8).contains(i)), "counted through all meshes: {indices:?}");
    let vertices: Vec<Vertex> = read(&painted[VERTICES]);
    let second = &vertices[4..];
    assert!(second.iter().all(|v| v.colour == [200, 10, 0, 220] && v.clip == 1 && v.uv == [0.0; 2]));
    let mut corners: Vec<[f32; 2]> = second.iter().map(|v| v.position).collect();
    corners.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(corners, [[20.0, 40.0], [20.0, 50.0], [80.0, 40.0], [80.0, 50.0]], "in pixels");
    let area: f32 = indices[6..]
        .chunks(3)
        .map(|t| {
            let [a, b, c] = [t[0], t[1], t[2]].map(|i| vertices[i as usize].position);
            0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
        })
        .sum();
    assert_eq!(area, 600.0);
    let clips: Vec<Clip> = read(&painted[CLIPS]);
    assert_eq!(clips[0].beyond, [1000.0, 800.0], "within the window");
    assert_eq!(clips[1].first, [25.0, 40.0], "rounded to whole pixels");
    assert_eq!(clips[1].beyond, [80.0, 50.0], "around what is drawn");
    assert_eq!(clips[1].texture, painter.textures.get(FONT).unwrap());
}

#[test]
fn triangles_and_clips_are_scaled_alike_also_by_a_factor_for_each_axis() {
    let rect = Rect::from_min_size(pos2(10.0, 20.0), vec2(30.0, 10.0));
    let clip = Rect::from_min_size(pos2(0.0, 24.0), vec2(100.0, 100.0));
    let mesh = rectangle(rect, Color32::RED, clip, FONT);
    let painted = painter().paint(TexturesDelta::default(), vec![mesh], vec2(2.0, 0.5), &whole_view());
    let corners = read::<Vertex>(&painted[VERTICES])
        .into_iter()
        .map(|vertex| pos2(vertex.position[0], vertex.position[1]));
    assert_eq!(
        Rect::from_points(&corners.collect::<Vec<_>>()),
        Rect::from_min_max(pos2(20.0, 10.0), pos2(80.0, 15.0))
    );
    let clips: Vec<Clip> = read(&painted[CLIPS]);
    assert_eq!((clips[0].first, clips[0].beyond), ([20.0, 12.0], [80.0, 15.0]));
}

#[test]
fn an_empty_interface_draws_nothing_and_its_buffers_are_not_empty() {
    let painted = Painter::default().paint(TexturesDelta::default(), vec![], ONE, &whole_view());
    assert_eq!(words(&painted[DRAW]), [0, 1, 0, 0]);
    let mut catalog = Catalog::default();
    offer(&mut catalog);
    // The others come from the composition.
    let others = [PICTURES.as_flattened(), &[VIEW_DRAW]].concat();
    for (name, buffer) in catalog.buffers.iter().filter(|(name, _)| !others.contains(&name.as_str())) {
        assert!(painted[name.as_str()].len() as u64 >= buffer.least * buffer.stride, "{name}");
    }
    assert_eq!(painted.len(), catalog.buffers.len() - others.len());
}

#[test]
fn what_cannot_be_drawn_is_left_out() {
    let rect = Rect::from_min_size(Pos2::ZERO, vec2(1.0, 1.0));
    let strange = rectangle(rect, Color32::RED, rect, TextureId::User(9));
    let mut broken = rectangle(rect, Color32::RED, rect, FONT);
    if let Primitive::Mesh(mesh) = &mut broken.primitive {
        mesh.indices[1] = 4;
    }
    let fine = rectangle(rect, Color32::RED, rect, FONT);
    let painted = painter().paint(TexturesDelta::default(), vec![strange, broken, fine], ONE, &whole_view());
    assert_eq!(words(&painted[DRAW])[0], 6);
}

#[test]
fn a_part_of_a_texture_lands_at_its_texels() {
    let mut painter = painter();
    let id = TextureId::Managed(3);
    painter.paint(changes(vec![(id, whole([4, 3], 1))], &[]), vec![], ONE, &whole_view());
    let part = ImageDelta::partial([1, 1], image([2, 2], 2), TextureOptions::NEAREST);
    painter.paint(changes(vec![(id, part)], &[]), vec![], ONE, &whole_view());
    let found: Vec<(u8, u8)> = texels(&painter, id).iter().map(|t| (t[1], t[0])).collect();
    let expected = [
        [(1, 0), (1, 1), (1, 2), (1, 3)],
        [(1, 4), (2, 0), (2, 1), (1, 7)],
        [(1, 8), (2, 2), (2, 3), (1, 11)],
    ];
    assert_eq!(found, expected.concat());
    assert_eq!(painter.textures.get(id).unwrap().smoothing, 0, "the last change says how");
    assert_eq!(texels(&painter, FONT)[3], [3, 0, 0, 255], "its neighbour is as it was");
}

#[test]
fn a_part_that_sticks_out_of_its_texture_changes_nothing() {
    let mut painter = painter();
    let before = texels(&painter, FONT);
    let part = |at| ImageDelta::partial(at, image([2, 1], 9), TextureOptions::LINEAR);
    painter.paint(changes(vec![(FONT, part([1, 0])), (FONT, part([0, 2]))], &[]), vec![], ONE, &whole_view());
    painter.paint(changes(vec![(TextureId::User(1), part([0, 0]))], &[]), vec![], ONE, &whole_view());
    assert_eq!(texels(&painter, FONT), before);
    assert_eq!(painter.textures.get(TextureId::User(1)), None);
}

#[test]
fn the_room_of_textures_that_are_freed_is_used_again() {
    let mut painter = painter();
    let [a, b, c] = [1, 2, 3].map(TextureId::Managed);
    painter.paint(
        changes(vec![(a, whole([8, 8], 1)), (b, whole([4, 4], 2))], &[]),
        vec![],
        ONE,
        &whole_view(),
    );
    let (room, length) = (painter.textures.get(a).unwrap().texels, painter.textures.texels().len());
    painter.paint(changes(vec![], &[a]), vec![], ONE, &whole_view());
    assert_eq!(painter.textures.get(a), None);
    painter.paint(changes(vec![(c, whole([7, 9], 3))], &[]), vec![], ONE, &whole_view());
    assert_eq!(painter.textures.get(c).unwrap().texels, room);
    assert_eq!(painter.textures.texels().len(), length);
    assert_eq!((texels(&painter, c)[62], texels(&painter, b)[15]), ([62, 3, 0, 255], [15, 2, 0, 255]));
    // A texture that does not fit the gap is appended, without changes to its neighbours.
    painter.paint(changes(vec![(c, whole([9, 9], 4))], &[]), vec![], ONE, &whole_view());
    assert_eq!((texels(&painter, c)[80], texels(&painter, b)[15]), ([80, 4, 0, 255], [15, 2, 0, 255]));
    assert_eq!(painter.textures.get(c).unwrap().texels, 4 + 64 + 16);
}

#[test]
fn a_texture_that_goes_after_a_frame_is_still_drawn_in_it() {
    let mut painter = painter();
    let rect = Rect::from_min_size(Pos2::ZERO, vec2(1.0, 1.0));
    let id = TextureId::Managed(5);
    let mesh = || vec![rectangle(rect, Color32::WHITE, rect, id)];
    let painted = painter.paint(changes(vec![(id, whole([1, 1], 7))], &[id]), mesh(), ONE, &whole_view());
    assert_eq!(words(&painted[DRAW])[0], 6);
    let clips: Vec<Clip> = read(&painted[CLIPS]);
    assert_eq!(painted[TEXELS][4 * clips[0].texture.texels as usize + 1], 7);
    let after = painter.paint(TexturesDelta::default(), mesh(), ONE, &whole_view());
    assert_eq!(words(&after[DRAW])[0], 0);
}

#[test]
fn texels_are_handed_over_anew_only_when_they_changed() {
    let mut painter = painter();
    let texels =
        |painter: &mut Painter, changes| painter.paint(changes, vec![], ONE, &whole_view())[TEXELS].clone();
    let first = texels(&mut painter, TexturesDelta::default());
    let held = first.to_vec();
    assert!(Arc::ptr_eq(&first, &texels(&mut painter, TexturesDelta::default())));
    let second = texels(&mut painter, changes(vec![(FONT, whole([2, 2], 8))], &[]));
    assert!(!Arc::ptr_eq(&first, &second));
    assert_eq!(first.to_vec(), held, "what was given away stays as it was");
    assert_ne!(first, second);
}

fn composition() -> Composition {
    let shown = |format| Shown { format, width: 3, height: 2, pixels: BufferContents::Bytes(Arc::default()) };
    Composition {
        window: [640, 0],
        view: [200, 10, 400, 300],
        a: Some(shown(Format::Rgba16Float)),
        b: Some(shown(Format::R32Uint)),
        mode: Mode::Difference,
        split: 0.25,
        amplification: 16.0,
    }
}

#[test]
fn the_block_of_the_window_lies_as_the_shaders_declare_it() {
    let bytes = composition().bytes();
    let (w, f) = (words(&bytes), read::<f32>(&bytes));
    assert_eq!(bytes.len() as u64, WINDOW_BYTES);
    assert_eq!(w[0..4], [200, 10, 400, 300], "view at 0");
    // Pixels from the host are one part, of all rows.
    assert_eq!(w[4..8], [3, 2, 2, 2], "A at 16");
    assert_eq!(w[8..12], [3, 2, 0, 2], "B at 32, which holds no colours");
    assert_eq!(f[12..16], [640.0, 1.0, 0.25, 16.0], "size, split, amplification at 48");
    assert_eq!(w[16], 2, "mode at 64");
}

#[test]
fn the_windows_graph_builds_and_each_of_its_barriers_is_needed() {
    let mut catalog = Catalog::default();
    offer(&mut catalog);
    let device = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
    let facts = facts::without_scene(&device, (640, 400));
    let plan = Planner::default().plan(GRAPH, &[], &facts, &catalog).unwrap_or_else(|e| panic!("{e}"));
    let output = plan.resource(plan.output);
    assert_eq!(output.shape, Shape::Image { format: Format::Rgba8Unorm, width: 640, height: 400 });
    let given = plan.resources.iter().filter(|r| matches!(r.source, Source::HostBuffer { .. })).count();
    assert_eq!(given, catalog.buffers.len(), "it imports all that is offered");
    assert_eq!(catalog.uniforms[WINDOW], 80);
    let phases: Vec<&str> = plan.frame.iter().map(|pass| plan.pass(*pass).phase.as_str()).collect();
    assert_eq!(phases[..6], ["compose", "compose", "compose", "compose", "compose", "ui"]);
    let ui = &plan.pass(plan.frame[5]).work;
    assert!(matches!(ui, Work::Draw { call: DrawCall::Indirect { offset: 0, .. }, .. }));
    let barriers = sync::barriers(&plan).expect("there are some");
    let violations = replay(&plan, &barriers, &Replay::default());
    assert!(violations.is_empty(), "{:?}", violations.iter().map(|o| o.describe(&plan)).collect::<Vec<_>>());
    assert_eq!(needless(&plan, &barriers).len(), 0);
}

#[test]
fn a_picture_of_the_views_size_is_copied_and_others_are_composed() {
    let draws =
        |under: &Composition| -> Vec<u32> { under.draws().map(|[_, instances, ..]| instances).to_vec() };
    let a = Composition { mode: Mode::A, view: [200, 10, 3, 2], ..composition() };
    assert_eq!(draws(&a), [1, 0, 0, 0, 0]);
    let general = [0, 0, 0, 0, 1];
    assert_eq!(draws(&Composition { mode: Mode::Split, ..a.clone() }), general);
    assert_eq!(draws(&Composition { view: [200, 10, 3, 4], ..a.clone() }), general);
    assert_eq!(draws(&Composition { a: None, ..a.clone() }), general);
    assert_eq!(draws(&Composition { a: a.b.clone(), ..a.clone() }), general, "no colours");
    assert_eq!(draws(&Composition { view: [200, 10, 3, 0], ..a }), [0; 5]);
}

#[test]
fn an_interface_that_is_shown_is_not_packed_again_until_it_is_forgotten() {
    let under = Composition { window: [1000, 800], view: [0, 0, 500, 800], ..composition() };
    let rect = Rect::from_min_size(pos2(600.0, 10.0), vec2(30.0, 5.0));
    let mut painter = painter();
    let packed = |painter: &mut Painter, colour| {
        let mesh = rectangle(rect, colour, Rect::EVERYTHING, FONT);
        words(&painter.paint(TexturesDelta::default(), vec![mesh], ONE, &under)[DRAW])[0]
    };
    let both = 12;
    assert_eq!(packed(&mut painter, Color32::RED), both, "the background and the rectangle");
    assert_eq!(packed(&mut painter, Color32::RED), both, "it was not drawn");
    painter.drawn();
    assert_eq!(packed(&mut painter, Color32::RED), 0);
    painter.drawn();
    assert_eq!(packed(&mut painter, Color32::GREEN), both);
    assert_eq!(packed(&mut painter, Color32::RED), 0, "the green one was not drawn");
    painter.forget();
    assert_eq!(packed(&mut painter, Color32::RED), both);
}

#[test]
fn a_picture_from_the_host_that_is_larger_than_a_binding_comes_in_parts() {
    let (width, height) = (16_384u32, 2_100u32);
    let pixels: Vec<u32> = (0..width * height).collect();
    let picture = Shown {
        format: Format::Rgba8Unorm,
        width,
        height,
        pixels: BufferContents::Bytes(Arc::new(bytemuck::cast_slice(&pixels).to_vec())),
    };
    let under = Composition { a: Some(picture), b: None, mode: Mode::A, ..composition() };
    let mut inputs = FrameInputs::default();
    under.give(&mut inputs);
    let rows = bytemuck::pod_read_unaligned::<u32>(&inputs.uniforms[WINDOW][28..32]);
    let mut first = 0;
    for name in PICTURES[0] {
        let BufferContents::Bytes(bytes) = &inputs.buffers[name] else { panic!("{name} is no part") };
        assert!(bytes.len() <= 128 << 20);
        assert_eq!(bytemuck::pod_read_unaligned::<u32>(&bytes[..4]), first * width, "{name}");
        first += (bytes.len() / 4) as u32 / width;
        assert!(
            first == height || first.is_multiple_of(rows),
            "{name} ends in row {first} of parts of {rows}"
        );
    }
    assert_eq!(first, height);
}
