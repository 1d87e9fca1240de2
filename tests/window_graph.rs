//! The viewer's window graph without a window: hand-made pictures and egui interfaces, compared with expected pixels.

use egui::{Align2, Color32, FontId, Rect, TextureOptions, Vec2, pos2, vec2};
use half::f16;
use splatgraph::draw::backend::Backend;
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::Planner;
use splatgraph::view::paint::{self, Composition, Mode, Painted, Painter, Shown};
use splatgraph_api::{BufferContents, Device, FrameInputs, NoScene};
use splatgraph_framework::ir::{Catalog, Format};
use std::sync::Arc;

use crate::common;

struct Window {
    device: Backend,
    size: [u32; 2],
}

struct Drawn {
    width: usize,
    pixels: Vec<[u8; 4]>,
}

impl Drawn {
    fn at(&self, x: usize, y: usize) -> [u8; 3] {
        let [r, g, b, a] = self.pixels[y * self.width + x];
        assert_eq!(a, 255, "the window is opaque at ({x}, {y})");
        [r, g, b]
    }

    fn row(&self, y: usize) -> Vec<[u8; 3]> {
        (0..self.width).map(|x| self.at(x, y)).collect()
    }
}

impl Window {
    fn open(size: [u32; 2]) -> Window {
        let mut device = common::device();
        let mut catalog = Catalog::default();
        paint::offer(&mut catalog);
        let facts = facts::facts(&SceneFacts::NOMINAL, &device.info().facts, size.into());
        let plan = Planner::default().plan(paint::GRAPH, &[], &facts, &catalog);
        let plan = plan.unwrap_or_else(|errors| panic!("{errors}"));
        device.load(plan, &NoScene, &mut |_| {}).expect("loads");
        Window { device, size }
    }

    fn draw(&mut self, composition: &Composition, interface: &Painted) -> Drawn {
        let mut inputs = FrameInputs { read_output: true, ..FrameInputs::default() };
        composition.give(&mut inputs);
        let given = |(name, bytes): (&&str, &Arc<Vec<u8>>)| {
            ((*name).to_owned(), BufferContents::Bytes(bytes.clone()))
        };
        inputs.buffers.extend(interface.iter().map(given));
        let frame = self.device.submit(&inputs).expect("submitted");
        let pixels = self.device.wait(frame).expect("drawn").output.expect("asked for");
        assert_eq!((pixels.format, [pixels.width, pixels.height]), (Format::Rgba8Unorm, self.size));
        let texels = pixels.bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]);
        Drawn { width: pixels.width as usize, pixels: texels.collect() }
    }

    fn compose(&mut self, composition: &Composition) -> Drawn {
        self.draw(
            composition,
            &Painter::default().paint(Default::default(), vec![], Vec2::splat(1.0), composition),
        )
    }

    fn close(mut self) {
        common::assert_silent(&mut self.device, paint::GRAPH);
        let messages = self.device.close();
        assert!(messages.is_empty(), "closing the device\n{}", messages.join("\n"));
    }
}

/// Colour of the window around the pictures.
const BACKGROUND: [u8; 3] = [0; 3];

fn composition(
    window: [u32; 2],
    view: [u32; 4],
    mode: Mode,
    a: Option<Shown>,
    b: Option<Shown>,
) -> Composition {
    Composition { window, view, a, b, mode, split: 0.5, amplification: 1.0 }
}

fn picture(format: Format, [width, height]: [u32; 2], pixel: impl Fn(u32, u32) -> [f32; 3]) -> Option<Shown> {
    let mut bytes = Vec::new();
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let [r, g, b] = pixel(x, y);
        // Alpha has no effect.
        let rgba = [r, g, b, 0.25];
        match format {
            Format::Rgba8Unorm => bytes.extend(rgba.map(|v| (v * 255.0).round() as u8)),
            Format::Rgba16Float => rgba.iter().for_each(|v| bytes.extend(f16::from_f32(*v).to_le_bytes())),
            Format::Rgba32Float => rgba.iter().for_each(|v| bytes.extend(v.to_le_bytes())),
            Format::R32Float | Format::Depth32Float => bytes.extend(r.to_le_bytes()),
            Format::R32Uint => bytes.extend([0; 4]),
        }
    }
    Some(Shown { format, width, height, pixels: BufferContents::Bytes(Arc::new(bytes)) })
}

fn flat(format: Format, size: [u32; 2], colour: [u8; 3]) -> Option<Shown> {
    picture(format, size, |_, _| colour.map(|v| f32::from(v) / 255.0))
}

/// Compares a picture on the device, which comes in parts, with a picture from the host, in a single part.
#[test]
fn a_picture_in_parts_is_shown_like_one_in_one() {
    let mut window = Window::open([300, 300]);
    let mut scene = window.device.new_context().expect("there can be another");
    let graph = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/gray_scott/graph.ron");
    let facts = facts::facts(&SceneFacts::NOMINAL, &scene.info().facts, (16, 16));
    let set = common::settings(&[("side", "270"), ("step_pairs", "1")]);
    let plan = Planner::default().plan(graph, &set, &facts, &Catalog::default());
    let plan = plan.unwrap_or_else(|errors| panic!("{errors}"));
    let inputs = FrameInputs { live: plan.live_bytes(), read_output: true, show: true, ..Default::default() };
    scene.load(plan, &NoScene, &mut |_| {}).expect("loads");
    let frame = scene.submit(&inputs).expect("submitted");
    let pixels = scene.wait(frame).expect("drawn").output.expect("asked for");
    let on_device = Shown::from(scene.picture().expect("shown"));
    let on_host =
        Shown { pixels: BufferContents::Bytes(Arc::new(pixels.bytes.to_vec())), ..on_device.clone() };
    let composed = |shown| composition([300, 300], [10, 20, 270, 270], Mode::A, Some(shown), None);
    let (one, parts) = (window.compose(&composed(on_host)), window.compose(&composed(on_device.clone())));
    assert!(one.pixels == parts.pixels);
    // A and B are equal, so their difference is black.
    let difference = composition(
        [300, 300],
        [10, 20, 270, 270],
        Mode::Difference,
        Some(on_device.clone()),
        Some(on_device),
    );
    let difference = window.compose(&difference);
    assert!((20..290).all(|y| difference.row(y)[10..280].iter().all(|pixel| *pixel == [0; 3])));
    assert!(one.row(290 - 1)[10..280].iter().any(|pixel| *pixel != BACKGROUND));
    drop(scene);
    window.close();
}

#[test]
fn pictures_of_every_format_stand_in_the_view_pixel_by_pixel() {
    let mut window = Window::open([12, 7]);
    let view = [3, 2, 5, 4];
    let colour = |x: u32, y: u32| [40 * x as u8 + 10, 60 * y as u8, 200];
    let wild = |x, y| match (x, y) {
        (1, 1) => [-3.0, 7.5, 0.5],
        _ => colour(x, y).map(|v| f32::from(v) / 255.0),
    };
    for format in [Format::Rgba8Unorm, Format::Rgba16Float, Format::Rgba32Float, Format::R32Float] {
        let grey = format == Format::R32Float;
        let drawn = window.compose(&composition([12, 7], view, Mode::A, picture(format, [5, 4], wild), None));
        for (x, y) in (0..7u32).flat_map(|y| (0..12u32).map(move |x| (x, y))) {
            let inside = (3..8).contains(&x) && (2..6).contains(&y);
            let (u, v) = (x.wrapping_sub(3), y.wrapping_sub(2));
            let expected = match (u, v) {
                _ if !inside => BACKGROUND,
                // Out of range: clamped on conversion to 8 bits, or when drawn from floats.
                (1, 1) if grey => [0; 3],
                (1, 1) => [0, 255, 128],
                _ if grey => [colour(u, v)[0]; 3],
                _ => colour(u, v),
            };
            assert_eq!(drawn.at(x as usize, y as usize), expected, "{format:?} at ({x}, {y})");
        }
    }
    let none = window.compose(&composition([12, 7], view, Mode::A, None, None));
    assert_eq!(none.at(5, 4), BACKGROUND);
    let words =
        window.compose(&composition([12, 7], view, Mode::A, flat(Format::R32Uint, [5, 4], [9; 3]), None));
    assert_eq!(words.at(5, 4), BACKGROUND, "not colours");
    window.close();
}

#[test]
fn a_is_left_of_the_line_and_b_right_of_it() {
    let mut window = Window::open([20, 3]);
    let (red, green) = ([255, 0, 0], [0, 255, 0]);
    let a = flat(Format::Rgba16Float, [16, 3], red);
    let b = flat(Format::Rgba32Float, [16, 3], green);
    for (split, line) in [(0.5f32, 10usize), (0.25, 6), (0.0, 2), (1.0, 18)] {
        let both = composition([20, 3], [2, 0, 16, 3], Mode::Split, a.clone(), b.clone());
        let row = window.compose(&Composition { split, ..both }).row(1);
        for (x, found) in row.into_iter().enumerate() {
            let expected = match x {
                _ if !(2..18).contains(&x) => BACKGROUND,
                _ if x + 1 == line => [0; 3],
                _ if x == line => [255; 3],
                _ if x < line => red,
                _ => green,
            };
            assert_eq!(found, expected, "{split} at {x}");
        }
    }
    window.close();
}

#[test]
fn a_difference_is_black_where_pictures_agree_and_amplified_where_not() {
    let size = [4, 4];
    let mut window = Window::open(size);
    let a = [100, 20, 250];
    let mut difference = |b: [u8; 3], formats: [Format; 2], amplification| {
        let (a, b) = (flat(formats[0], size, a), flat(formats[1], size, b));
        let both = composition(size, [0, 0, 4, 4], Mode::Difference, a, b);
        window.compose(&Composition { amplification, ..both }).at(2, 2)
    };
    let (bytes, floats) = (Format::Rgba8Unorm, Format::Rgba32Float);
    for formats in [[bytes, bytes], [floats, floats]] {
        assert_eq!(difference(a, formats, 1e3), [0; 3]);
    }
    assert_eq!(difference([101, 19, 250], [bytes, bytes], 64.0), [64, 64, 0]);
    assert_eq!(difference([101, 19, 250], [floats, bytes], 64.0), [64, 64, 0]);
    assert_eq!(difference([0, 25, 250], [bytes, bytes], 2.0), [200, 10, 0]);
    assert_eq!(difference([0, 25, 250], [bytes, bytes], 1e3), [255, 255, 0]);
    window.close();
}

#[test]
fn a_picture_of_another_size_is_scaled_to_the_views_height_about_its_middle() {
    let mut window = Window::open([8, 4]);
    let view = [0, 0, 8, 4];
    let halves = |x, width| if 2 * x < width { [0.0; 3] } else { [1.0; 3] };
    let same_shape = picture(Format::Rgba8Unorm, [4, 2], |x, _| halves(x, 4));
    let row = window.compose(&composition([8, 4], view, Mode::A, same_shape, None)).row(2);
    let reds: Vec<u8> = row.into_iter().map(|[red, ..]| red).collect();
    assert_eq!(reds, [0, 0, 0, 64, 191, 255, 255, 255]);
    // A square picture leaves background at both sides.
    let narrow = picture(Format::Rgba32Float, [20, 20], |x, _| halves(x, 20));
    let row = window.compose(&composition([8, 4], view, Mode::A, narrow, None)).row(1);
    assert_eq!([row[1], row[6]], [BACKGROUND; 2]);
    assert_eq!([row[2], row[3], row[4], row[5]], [[0; 3], [0; 3], [255; 3], [255; 3]]);
    // A picture wider than the view is cropped at both sides.
    let wide =
        picture(Format::Rgba16Float, [32, 8], |x, _| if (8..24).contains(&x) { [1.0; 3] } else { [0.0; 3] });
    let row = window.compose(&composition([8, 4], view, Mode::A, wide, None)).row(1);
    assert!(row.iter().all(|pixel| *pixel == [255; 3]), "{row:?}");
    window.close();
}

/// Runs a pass of egui over the window of `under`; returns what the painter draws.
fn interface(
    painter: &mut Painter,
    context: &egui::Context,
    under: &Composition,
    pixels_per_point: f32,
    ui: impl FnMut(&mut egui::Ui),
) -> Painted {
    let [width, height] = under.window;
    let size = vec2(width as f32, height as f32) / pixels_per_point;
    let mut input =
        egui::RawInput { screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), size)), ..Default::default() };
    input.viewports.entry(egui::ViewportId::ROOT).or_default().native_pixels_per_point =
        Some(pixels_per_point);
    let output = context.run_ui(input, ui);
    assert_eq!(output.pixels_per_point, pixels_per_point);
    let meshes = context.tessellate(output.shapes, pixels_per_point);
    painter.paint(output.textures_delta, meshes, Vec2::splat(pixels_per_point), under)
}

#[test]
fn egui_draws_its_colours_inside_its_clips_over_the_picture() {
    let size = [120, 60];
    let mut window = Window::open(size);
    let under = composition(size, [0, 0, 120, 60], Mode::A, None, None);
    let orange = Color32::from_rgb(250, 130, 10);
    let glass = Color32::from_rgba_premultiplied(100, 0, 20, 128);
    for scale in [1.0, 2.0] {
        let (mut painter, context) = (Painter::default(), egui::Context::default());
        let rect =
            |x: f32, y: f32, w: f32, h: f32| Rect::from_min_size(pos2(x, y) / scale, vec2(w, h) / scale);
        let painted = interface(&mut painter, &context, &under, scale, |ui| {
            ui.painter().rect_filled(rect(10.0, 10.0, 20.0, 30.0), 0.0, orange);
            ui.painter().with_clip_rect(rect(50.0, 20.0, 10.0, 10.0)).rect_filled(
                rect(40.0, 10.0, 30.0, 30.0),
                0.0,
                orange,
            );
            ui.painter().rect_filled(rect(80.0, 10.0, 20.0, 30.0), 0.0, glass);
        });
        let drawn = window.draw(&under, &painted);
        let solid = |x, y| drawn.at(x, y) == [250, 130, 10];
        for (x, y) in (0..60).flat_map(|y| (0..78).map(move |x| (x, y))) {
            let inside = (10..30).contains(&x) && (10..40).contains(&y);
            let clipped = (50..60).contains(&x) && (20..30).contains(&y);
            // egui antialiases borders over up to a pixel; clips are sharp.
            let border = (9..=30).contains(&x)
                && (9..=40).contains(&y)
                && !((11..29).contains(&x) && (11..39).contains(&y));
            if !border {
                assert_eq!(solid(x, y), inside || clipped, "{scale}: ({x}, {y}) is {:?}", drawn.at(x, y));
                assert!(solid(x, y) || drawn.at(x, y) == BACKGROUND);
            }
        }
        for (channel, (over, under)) in
            drawn.at(90, 25).into_iter().zip([100, 0, 20].into_iter().zip(BACKGROUND)).enumerate()
        {
            let (over, under): (u8, (u8, u8)) = (over, under);
            let expected = f32::from(under.0) + (1.0 - 128.0 / 255.0) * f32::from(under.1);
            assert!((f32::from(over) - expected).abs() <= 1.0, "channel {channel}: {over}, not {expected}");
        }
    }
    window.close();
}

#[test]
fn text_has_ink_where_it_stands_and_nowhere_else() {
    let size = [160, 50];
    let mut window = Window::open(size);
    let under = composition(size, [0, 0, 160, 50], Mode::A, None, None);
    let (mut painter, context) = (Painter::default(), egui::Context::default());
    let mut place = Rect::NOTHING;
    let painted = interface(&mut painter, &context, &under, 1.0, |ui| {
        let font = FontId::proportional(18.0);
        place = ui.painter().text(pos2(20.0, 12.0), Align2::LEFT_TOP, "Hamburgefonts", font, Color32::WHITE);
    });
    let drawn = window.draw(&under, &painted);
    let (mut full, mut some) = (0, 0);
    for (x, y) in (0..50).flat_map(|y| (0..160).map(move |x| (x, y))) {
        let inside = place.expand(1.0).contains(pos2(x as f32 + 0.5, y as f32 + 0.5));
        let pixel = drawn.at(x, y);
        assert!(inside || pixel == BACKGROUND, "ink at ({x}, {y}), outside of {place}");
        full += u32::from(pixel.iter().all(|v| *v > 240));
        some += u32::from(pixel != BACKGROUND);
    }
    let area = place.area() as u32;
    assert!(full > area / 40, "strokes are white: {full} of {area} pixels");
    assert!(some > area / 5 && some < area * 2 / 3, "{some} of {area} pixels have ink");
    window.close();
}

#[test]
fn textures_are_drawn_with_the_filter_that_they_ask_for_and_follow_changes() {
    let size = [64, 32];
    let mut window = Window::open(size);
    let under = composition(size, [0, 0, 64, 32], Mode::A, None, None);
    let (mut painter, context) = (Painter::default(), egui::Context::default());
    let four = |colours: [u8; 4]| egui::ColorImage::new([2, 2], colours.map(Color32::from_gray).to_vec());
    let load = |name: &str, options| context.load_texture(name, four([0, 100, 200, 40]), options);
    let (mut sharp, smooth) =
        (load("sharp", TextureOptions::NEAREST), load("smooth", TextureOptions::LINEAR));
    let show = |ui: &mut egui::Ui, texture: &egui::TextureHandle, x: f32| {
        let (rect, uv) = (
            Rect::from_min_size(pos2(x, 4.0), vec2(24.0, 24.0)),
            Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)),
        );
        ui.painter().image(texture.id(), rect, uv, Color32::WHITE);
    };
    let mut frame = |painter: &mut Painter, sharp: &egui::TextureHandle| {
        let painted = interface(painter, &context, &under, 1.0, |ui| {
            show(ui, sharp, 4.0);
            show(ui, &smooth, 36.0);
        });
        window.draw(&under, &painted)
    };
    let drawn = frame(&mut painter, &sharp);
    let grey = |drawn: &Drawn, x, y| drawn.at(x, y)[0];
    let corners = |drawn: &Drawn| {
        [(5, 5), (15, 15), (16, 5), (27, 15), (4, 16), (15, 27), (16, 16), (27, 27)]
            .map(|(x, y)| grey(drawn, x, y))
    };
    assert_eq!(corners(&drawn), [0, 0, 100, 100, 200, 200, 40, 40]);
    // Linear between the texel centres, which are 12 pixels apart; constant beyond them.
    for x in 0..24u8 {
        let part = ((f32::from(x) - 5.5) / 12.0).clamp(0.0, 1.0);
        let found = grey(&drawn, 36 + x as usize, 6);
        assert!((f32::from(found) - 100.0 * part).abs() <= 1.0, "column {x}: {found}");
    }
    sharp.set_partial(
        [1, 0],
        egui::ColorImage::new([1, 1], vec![Color32::from_gray(222)]),
        TextureOptions::NEAREST,
    );
    let drawn = frame(&mut painter, &sharp);
    assert_eq!(corners(&drawn), [0, 0, 222, 222, 200, 200, 40, 40]);
    window.close();
}

/// Draws the interface of a step. It has panels around the view, some of which change, and a box that crosses the
/// view's edge.
fn panels(ui: &mut egui::Ui, step: usize) {
    let rect = |[x, y, width, height]: [f32; 4]| Rect::from_min_size(pos2(x, y), vec2(width, height));
    let grey = |value: usize| Color32::from_gray(60 + 30 * value as u8);
    let font = || FontId::proportional(14.0);
    // Each panel has its own clip, as in the viewer: with one clip, egui would make one mesh of all.
    let panel = |place: [f32; 4], colour| {
        let painter = ui.painter().with_clip_rect(rect(place));
        painter.rect_filled(rect(place).shrink(2.0), 3.0, colour);
        painter
    };
    panel([0.0, 10.0, 38.0, 66.0], grey(step / 3));
    let right = panel([122.0, 10.0, 36.0, 66.0], grey(0));
    right.text(pos2(126.0, 20.0), Align2::LEFT_TOP, step / 4, font(), Color32::WHITE);
    if step % 8 < 6 {
        let status = panel([0.0, 80.0, 160.0, 20.0], grey(1));
        status.text(pos2(4.0, 82.0), Align2::LEFT_TOP, format!("status {}", step / 5), font(), grey(4));
    }
    let glass = Color32::from_rgba_premultiplied(90, 0, 60, 120);
    ui.painter().rect_filled(
        rect([20.0 + 9.0 * step as f32, 8.0 + 4.0 * step as f32, 30.0, 22.0]),
        3.0,
        glass,
    );
}

#[test]
fn a_window_in_which_only_changes_are_drawn_shows_what_one_that_is_drawn_whole_shows() {
    let size = [160, 100];
    let (mut kept, mut whole) = (Window::open(size), Window::open(size));
    let context = egui::Context::default();
    let (mut painter, mut triangles) = (Painter::default(), Vec::new());
    for step in 0..16 {
        // The view changes at step 12, its picture in every step.
        let view = [40, 10, if step < 12 { 80 } else { 70 }, 66];
        let shade = [16 * step as u8, 100, 200];
        let picture = flat(Format::Rgba16Float, [view[2], if step == 6 { 50 } else { 66 }], shade);
        let under = composition(size, view, Mode::A, picture, None);
        let input = egui::RawInput {
            screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), vec2(160.0, 100.0))),
            ..Default::default()
        };
        let output = context.run_ui(input, |ui| panels(ui, step));
        let meshes = context.tessellate(output.shapes, 1.0);
        let changes = painter.paint(output.textures_delta, meshes.clone(), Vec2::splat(1.0), &under);
        let drawn = kept.draw(&under, &changes);
        // Repaints everything with the same painter, which has the textures, after it forgot what the window shows.
        painter.forget();
        let everything = painter.paint(Default::default(), meshes, Vec2::splat(1.0), &under);
        let expected = whole.draw(&under, &everything);
        painter.drawn();
        assert!(drawn.pixels == expected.pixels, "step {step}");
        let count = |painted: &Painted| {
            let draw = &painted[paint::DRAW];
            u32::from_le_bytes([draw[0], draw[1], draw[2], draw[3]]) / 3
        };
        triangles.push((count(&changes), count(&everything)));
    }
    // The first step draws everything, the next ones only what changed.
    assert!(
        triangles[0].0 == triangles[0].1 && triangles[1..4].iter().all(|(some, all)| some < all),
        "{triangles:?}"
    );
    kept.close();
    whole.close();
}
