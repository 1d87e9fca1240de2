//! Projections other than pinhole. Each draws what the exact renderer draws, also at the picture's edges and where its
//! Jacobian degenerates.

use crate::common::{self, EXACT_TILES, FAST_TILES, Graph, OPEN, OPEN_TILES, QUADS, settings};
use crate::golden::Golden;
use crate::images::{self, psnr};
use splatgraph::draw::session::Session;
use splatgraph::draw::truth::{Truth, rules};
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, Projection, Scene, Splat};
use splatgraph_reference::Rules;
use std::sync::Arc;

fn lenses() -> impl Iterator<Item = Projection> {
    Projection::ALL.into_iter().filter(|projection| !projection.is_pinhole())
}

/// Makes a bright, oblique splat of opacity 0.7.
fn splat(position: [f32; 3], scale: [f32; 3]) -> Splat {
    let mut sh = [0.0; 48];
    sh[..3].copy_from_slice(&[1.0, 0.7, 0.4]);
    Splat { position, scale, rotation: [0.8, 0.4, -0.2, 0.4], opacity: 0.7, sh }
}

fn scene_of(splats: &[Splat]) -> Arc<Scene> {
    Arc::new(Scene::generate(splats.len() as u32, 3, |i| splats[i]))
}

/// Returns 600 splats in all directions from the origin, some narrower than a pixel and some large.
fn around() -> Arc<Scene> {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let splats: Vec<Splat> = (0..600)
        .map(|_| {
            let [x, y, z] = std::array::from_fn(|_| next() - 0.5);
            let distance = (0.5 + 5.0 * next()) / (x * x + y * y + z * z).sqrt().max(0.05);
            let mut made =
                splat([x, y, z].map(|v| v * distance), std::array::from_fn(|_| 0.01 + 0.15 * next()));
            made.sh[3..].iter_mut().for_each(|c| *c = 0.3 * (next() - 0.5));
            made.sh[..3].iter_mut().for_each(|c| *c = 2.0 * (next() - 0.4));
            made
        })
        .collect();
    scene_of(&splats)
}

/// Makes a camera at the origin that looks along +z, with x to the right and y down. A fisheye picture is 200
/// degrees wide, an orthographic one 6 units; others have a focal length of half the width.
fn camera(projection: Projection, (width, height): (u32, u32)) -> Camera {
    let focal = match projection {
        Projection::Fisheye => f64::from(width) / 200f64.to_radians(),
        Projection::Orthographic => f64::from(width) / 6.0,
        _ => f64::from(width) / 2.0,
    };
    let pinhole = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (width, height));
    Camera { projection, fx: focal, fy: focal, ..pinhole }
}

fn drawn(session: &mut Session, camera: &Camera, graph: Graph, set: &[(&str, &str)]) -> Image {
    let key_of = if camera.projection.sees_behind() { "distance" } else { "depth" };
    let lens = [("projection", camera.projection.name()), ("key_of", key_of)];
    images::drawn(session, camera, graph.0, &common::with(graph, &[&lens[..], set].concat()))
}

fn exact(scene: &Scene, camera: &Camera, changes: &[(&str, &str)]) -> Image {
    let rules = rules(Rules::of_view(scene, camera), &settings(changes)).expect("rules");
    Truth::draw(scene, camera, [0.0; 3], &rules).unwrap().image()
}

#[test]
fn every_projection_draws_splats_all_around_the_camera_as_the_exact_renderer_does() {
    let scene = around();
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    for projection in lenses() {
        // The picture's size is no multiple of a tile or a bin, so that tiles and bins at its edges are cut.
        let camera = camera(projection, (204, 116));
        let published = exact(&scene, &camera, &[]);
        // Near the poles of a panorama, splats are wider than half of it: see the test below.
        let bound = if projection == Projection::Equirectangular { 80.0 } else { 115.0 };
        for graph in EXACT_TILES {
            let db = psnr(&drawn(&mut session, &camera, graph, &[]), &published);
            println!("{projection}, {graph:?}: {db:.1} dB");
            assert!(db > bound, "{projection}, {graph:?}: {db:.1} dB from the exact renderer");
        }
        if projection != Projection::Equirectangular {
            let db = psnr(&drawn(&mut session, &camera, QUADS, &[]), &exact(&scene, &camera, &OPEN));
            println!("{projection}, quads: {db:.1} dB");
            assert!(db > 115.0, "{projection}, quads: {db:.1} dB from the exact renderer");
        }
        // Sorted by depth instead of distance, only the splats ahead of the camera are drawn.
        if projection.sees_behind() {
            let ahead = exact(&scene, &camera, &[("key_of", "depth")]);
            let db = psnr(&drawn(&mut session, &camera, EXACT_TILES[1], &[("key_of", "depth")]), &ahead);
            let whole = psnr(&ahead, &published);
            assert!(db > 90.0 && whole < 30.0, "{projection}: {db:.1} dB, {whole:.1} from the whole");
        }
    }
    common::assert_silent(session.device(), "projections");
}

/// Draws windows of pictures. They begin at a corner of tiles and bins, which thus cut splats in both pictures alike.
#[test]
fn a_camera_with_its_principal_point_aside_draws_a_window_of_a_larger_picture() {
    const CORNER: [usize; 2] = [192, 64];
    let scene = around();
    // The Jacobian of a pinhole is clamped relative to the picture. At this limit, splats beyond its edges hardly
    // differ.
    let limit = ("jacobian_limit", "100");
    for projection in [Projection::Pinhole, Projection::Orthographic, Projection::Fisheye] {
        let whole = camera(projection, (384, 256));
        let window = Camera { width: 160, height: 96, principal_offset: [-80.0, 16.0], ..whole.clone() };
        let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
        let part = |image: Image| {
            let rows = image.rgb.chunks(image.width).skip(CORNER[1]).take(96);
            Image {
                width: 160,
                height: 96,
                rgb: rows.flat_map(|row| row[CORNER[0]..][..160].to_vec()).collect(),
            }
        };
        let published = exact(&scene, &window, &[("jacobian_clamp", "100")]);
        let db = psnr(&published, &part(exact(&scene, &whole, &[("jacobian_clamp", "100")])));
        println!("{projection}, exact: {db:.1} dB");
        assert!(db > 140.0, "{projection}: {db:.1} dB from the window of the exact picture");
        for graph in [EXACT_TILES[0], EXACT_TILES[1], QUADS] {
            let larger = part(drawn(&mut session, &whole, graph, &[limit]));
            let db = psnr(&drawn(&mut session, &window, graph, &[limit]), &larger);
            println!("{projection}, {graph:?}: {db:.1} dB");
            assert!(db > 100.0, "{projection}, {graph:?}: {db:.1} dB from the window");
            // Splats within a fifth of the window beyond its edges are kept. Others can reach into it.
            let db = psnr(&drawn(&mut session, &window, graph, &[limit, ("cull_margin", "0.2")]), &larger);
            println!("{projection}, {graph:?}, culled: {db:.1} dB");
            // Splats beside the view of a pinhole reach far into it without the clamp.
            let bound = if projection == Projection::Pinhole { 15.0 } else { 25.0 };
            assert!(db > bound, "{projection}, {graph:?}: {db:.1} dB if culled by centres");
        }
        common::assert_silent(session.device(), "windows");
    }
}

/// Draws splats away from the poles of a panorama.
///
/// A splat repeats every 360 degrees. A tile blends the copy nearest to the tile's middle, the exact renderer the copy
/// nearest to the pixel. They differ only if a splat is wider than half the panorama, which happens near the poles.
#[test]
fn a_panorama_is_exact_away_from_its_poles() {
    let all = around();
    let far: Vec<Splat> = (0..all.count() as usize)
        .map(|i| all.splat(i))
        .filter(|splat| {
            let [x, y, z] = splat.position;
            y.abs() < 1.5 * x.hypot(z)
        })
        .collect();
    assert!(far.len() > 300, "{} splats", far.len());
    let scene = scene_of(&far);
    let camera = camera(Projection::Equirectangular, (204, 116));
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    let truth = exact(&scene, &camera, &[]);
    for graph in EXACT_TILES {
        let db = psnr(&drawn(&mut session, &camera, graph, &[]), &truth);
        println!("{graph:?}: {db:.1} dB");
        assert!(db > 100.0, "{graph:?}: {db:.1} dB");
    }
}

#[test]
fn captures_drawn_by_tiles_agree_with_the_exact_renderer() {
    let test = "captures_drawn_by_tiles_agree_with_the_exact_renderer";
    let Some(data) = common::data(test) else { return };
    for name in ["playbot-31k", "biker"] {
        let golden = Golden::whole(&data, name);
        let (scene, first) = (golden.scene(), golden.cameras().swap_remove(0).resized(320, 240));
        let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
        for projection in lenses() {
            let camera = first.projected(projection, &scene);
            let truth = exact(&scene, &camera, &[]);
            // Fast tiles draw splats to the alpha floor; the published tiles cut some of them off at three sigmas.
            let graphs = EXACT_TILES
                .map(|graph| (graph, 90.0))
                .into_iter()
                .chain(FAST_TILES.map(|graph| (graph, 70.0)));
            for (graph, bound) in graphs {
                let db = psnr(&drawn(&mut session, &camera, graph, &[]), &truth);
                println!("{name}, {projection}, {graph:?}: {db:.1} dB");
                assert!(db > bound, "{name}, {projection}, {graph:?}: {db:.1} dB");
            }
        }
    }
}

/// Returns the red channel of the pixels in a row.
fn row(image: &Image, y: usize) -> Vec<f32> {
    image.rgb[y * image.width..(y + 1) * image.width].iter().map(|pixel| pixel[0]).collect()
}

#[test]
fn a_splat_behind_a_panorama_is_on_both_edges_of_it() {
    // Slightly to one side: the splat's centre is at the left edge, and its copy shows the other half at the right
    // edge.
    let scene = scene_of(&[Splat { rotation: [1.0, 0.0, 0.0, 0.0], ..splat([-0.01, 0.0, -3.0], [0.4; 3]) }]);
    let camera = camera(Projection::Equirectangular, (200, 100));
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    let truth = exact(&scene, &camera, &OPEN);
    for graph in EXACT_TILES {
        let image = drawn(&mut session, &camera, graph, &OPEN_TILES);
        let db = psnr(&image, &truth);
        assert!(db > 100.0, "{graph:?}: {db:.1} dB");
        let row = row(&image, 50);
        assert!(row[0] > 0.5 && row[199] > 0.5, "{graph:?}: {} and {}", row[0], row[199]);
        assert!(
            (row[0] - row[199]).abs() < 0.02 && row[100] == 0.0,
            "no step at the seam: {} {}",
            row[0],
            row[199]
        );
        // The brightness falls off alike from both edges.
        for i in 1..20 {
            assert!(row[i] <= row[i - 1] && row[199 - i] <= row[200 - i], "{graph:?}, {i}: {row:?}");
        }
    }
}

#[test]
fn a_splat_straight_above_a_panorama_is_a_band_along_its_top() {
    let scene = scene_of(&[splat([0.0, -3.0, 0.0], [0.3; 3]), splat([0.0, 3.0, 1e-6], [0.2; 3])]);
    let camera = camera(Projection::Equirectangular, (200, 100));
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    let truth = exact(&scene, &camera, &OPEN);
    for graph in EXACT_TILES {
        let image = drawn(&mut session, &camera, graph, &OPEN_TILES);
        let db = psnr(&image, &truth);
        assert!(db > 90.0, "{graph:?}: {db:.1} dB");
        for y in [0, 99] {
            let row = row(&image, y);
            assert!(row.iter().all(|v| *v > 0.5 && (v - row[0]).abs() < 0.01), "{graph:?}, row {y}: {row:?}");
        }
        assert!(row(&image, 50).iter().all(|v| *v == 0.0));
    }
}

#[test]
fn a_fisheye_shows_what_is_behind_the_camera_up_to_the_edge_of_its_field_of_view() {
    let at = |degrees: f32| {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        [3.0 * sine, 0.0, 3.0 * cosine]
    };
    let (width, height) = (200, 100);
    let camera = camera(Projection::Fisheye, (width, height));
    for (degrees, seen) in
        [(0.0, true), (60.0, true), (89.9, true), (95.0, true), (130.0, false), (180.0, false)]
    {
        let scene = scene_of(&[splat(at(degrees), [0.05; 3])]);
        let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
        let truth = exact(&scene, &camera, &OPEN);
        let middle = 99.5 + degrees.to_radians() * camera.fx as f32;
        for graph in [EXACT_TILES[0], EXACT_TILES[1], QUADS] {
            let open: &[_] = if graph.0 == "splat" { &[] } else { &OPEN_TILES };
            let image = drawn(&mut session, &camera, graph, open);
            let db = psnr(&image, &truth);
            assert!(db > 100.0, "{graph:?}, {degrees} degrees: {db:.1} dB");
            let brightest =
                image.rgb.iter().enumerate().max_by(|a, b| a.1[0].total_cmp(&b.1[0])).expect("a pixel");
            assert_eq!(brightest.1[0] > 0.1, seen, "{graph:?}, {degrees} degrees");
            let x = (brightest.0 % width as usize) as f32;
            assert!(
                !seen || (x - middle).abs() <= 1.0,
                "{graph:?}, {degrees} degrees: at {x}, expected {middle}"
            );
        }
    }
}

#[test]
fn an_orthographic_splat_has_one_size_at_every_depth() {
    let camera = camera(Projection::Orthographic, (120, 60));
    let image = |depth: f32| {
        let scene = scene_of(&[splat([0.5, -0.25, depth], [0.3, 0.1, 0.2])]);
        drawn(&mut Session::new(common::device(), scene, "splat", &[]), &camera, EXACT_TILES[1], &[])
    };
    let near = image(1.0);
    assert!(near.rgb.iter().any(|pixel| pixel[0] > 0.5));
    let db = psnr(&near, &image(40.0));
    assert!(db > 100.0, "{db:.1} dB");
    assert!(image(0.1).rgb.iter().all(|pixel| *pixel == [0.0; 3]), "nearer than the near plane");
}

#[test]
fn a_camera_is_refused_by_a_graph_for_another_projection_and_quads_draw_no_panorama() {
    let scene = around();
    let fisheye = camera(Projection::Fisheye, (64, 32));
    let mut session = Session::new(common::device(), scene, "tiled_cpu", &[]);
    session.prepare((64, 32), &mut |_| {}).expect("it is prepared");
    let error = session.submit(&fisheye, &Default::default()).expect_err("another projection").to_string();
    assert!(error.contains("expected a graph for fisheye cameras, found one for pinhole cameras"), "{error}");
    session.set_graph("splat", &settings(&[("projection", "equirectangular")]));
    let error = session.prepare((64, 32), &mut |_| {}).expect_err("no such value").to_string();
    assert!(error.contains("equirectangular") && error.contains("fisheye"), "{error}");
}
