//! Scenes with meshes: quads and tiles draw what the exact renderer draws, and each convention of depth is tested
//! alone.

use crate::common::{self, EXACT_TILES, Graph, OPEN, OPEN_TILES, settings};
use crate::images;
use splatgraph::draw::session::Session;
use splatgraph::draw::truth::{Truth, rules};
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, Light, Mesh, MeshMaterial, Scene, Similarity, Splat, synth};
use splatgraph_reference::Rules;
use std::sync::Arc;

fn pond() -> Arc<Scene> {
    let demo = synth::generate("demo", 4000, 0).expect("it is generated");
    Arc::new(demo.beside(&synth::mesh(), &Similarity::IDENTITY))
}

/// Graphs that draw with 32-bit floats: quads, and both tile renderers by the rules of quads (no early stop).
const GRAPHS: [(Graph, &[(&str, &str)]); 3] = [
    (("mesh_quads", &[("target", "rgba32f")]), &[]),
    (EXACT_TILES[1], &OPEN_TILES),
    (EXACT_TILES[0], &OPEN_TILES),
];

fn as_drawn() -> Rules {
    rules(Rules::PUBLISHED, &settings(&OPEN)).expect("rules")
}

fn drawn(session: &mut Session, camera: &Camera, graph: Graph, set: &[(&str, &str)]) -> Image {
    images::drawn(session, camera, graph.0, &common::with(graph, set))
}

fn psnr(a: &Image, b: &Image, counted: &[bool]) -> f64 {
    let keep = |image: &Image| Image {
        width: counted.iter().filter(|counted| **counted).count(),
        height: 1,
        rgb: std::iter::zip(&image.rgb, counted)
            .filter(|(_, counted)| **counted)
            .map(|(pixel, _)| *pixel)
            .collect(),
    };
    images::psnr(&keep(a), &keep(b))
}

/// Marks the pixels away from the mesh's edges: the mesh covers all or none of their 3 x 3 neighbourhood.
fn away_from_edges(mesh: &Mesh, camera: &Camera) -> Vec<bool> {
    // The mesh alone: the scene's only splat is at the camera, where it is culled.
    let unseen = |_| Splat {
        position: camera.position.map(|v| v as f32),
        scale: [1e-3; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.5,
        sh: [0.0; 48],
    };
    let alone = Scene::generate(1, 0, unseen).with_mesh(Some(Arc::new(mesh.clone())));
    let blue = Truth::draw(&alone, camera, [0.0, 0.0, 1e3], &Rules::PUBLISHED).unwrap().image();
    let (width, height) = (blue.width as i32, blue.height as i32);
    let shown = |x: i32, y: i32| {
        let (x, y) = (x.clamp(0, width - 1), y.clamp(0, height - 1));
        blue.rgb[(y * width + x) as usize][2] < 2.0
    };
    let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
    (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| around.clone().all(|(dx, dy)| shown(x + dx, y + dy) == shown(x, y)))
        .collect()
}

#[test]
fn quads_and_tiles_with_a_mesh_draw_what_the_exact_renderer_draws_from_four_cameras() {
    let scene = pond();
    let mut session = Session::new(common::device(), scene.clone(), "mesh_quads", &[]);
    for camera in synth::demo_cameras() {
        // A principal point aside, as of a window of a larger picture.
        let camera = Camera { principal_offset: [20.0, -13.5], ..camera.resized(192, 108) };
        let truth = Truth::draw(&scene, &camera, [0.0; 3], &as_drawn()).unwrap().image();
        let counted = away_from_edges(scene.mesh().expect("the ring"), &camera);
        assert!(counted.iter().filter(|counted| **counted).count() * 10 > counted.len() * 8, "few edges");
        for (graph, set) in GRAPHS {
            let found = drawn(&mut session, &camera, graph, set);
            let near = psnr(&found, &truth, &counted);
            assert!(near > 60.0, "{} from `{}`: {near:.1} dB", graph.0, camera.img_name);
            // Without the mesh, the error must be much larger.
            let bare = drawn(&mut session, &camera, graph, &[set, &[("mesh", "false")]].concat());
            let far = psnr(&bare, &truth, &counted);
            assert!(
                far < near - 20.0,
                "{} from `{}`: {far:.1} dB without the mesh",
                graph.0,
                camera.img_name
            );
        }
    }
    common::assert_silent(session.device(), "meshes");
}

/// Returns a camera at the origin that looks along +z, 16 x 16 pixels. One unit at depth 2 is 8 pixels.
fn camera() -> Camera {
    Camera { fx: 16.0, fy: 16.0, ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (16, 16)) }
}

/// Makes a square of one colour, 2 x 2 units, at `z`. Its upper left corner is at `left` and `top`.
pub fn square([left, top]: [f32; 2], z: f32, base_color: [f32; 4]) -> Mesh {
    Mesh {
        positions: [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
            .map(|[x, y]| [left + x, top + y, z])
            .into(),
        normals: vec![[0.0, 0.0, -1.0]; 4],
        uvs: vec![[0.0; 2]; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material_of: vec![0; 2],
        materials: vec![MeshMaterial { base_color, metallic: 0.0, ..MeshMaterial::default() }],
        light: Some(Light { color: [0.0; 3], ambient: 1.0, ..Light::default() }),
        ..Mesh::default()
    }
}

fn white(z: f32) -> Splat {
    let mut sh = [0.0; 48];
    sh[..3].fill(0.5 / 0.282_094_8);
    Splat { position: [0.0, 0.0, z], scale: [20.0; 3], rotation: [1.0, 0.0, 0.0, 0.0], opacity: 0.9, sh }
}

fn pixel(splat: Splat, mesh: &Mesh, [x, y]: [usize; 2]) -> [[f32; 3]; 3] {
    let scene = Scene::generate(1, 0, |_| splat).with_mesh(Some(Arc::new(mesh.clone())));
    let mut session = Session::new(common::device(), Arc::new(scene), "mesh_quads", &[]);
    GRAPHS.map(|(graph, set)| drawn(&mut session, &camera(), graph, set).rgb[y * 16 + x])
}

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];

#[test]
fn the_nearer_of_two_triangles_is_seen_whichever_is_drawn_first() {
    // Depth is reversed: cleared to 0, greater is nearer. With one of the two conventions wrong, the far square or none
    // shows.
    let (near, far) = (square([-1.0, -1.0], 2.0, RED), square([-1.0, -1.0], 3.0, GREEN));
    for order in [[&near, &far], [&far, &near]] {
        let mut both = order[0].clone();
        both.append(order[1]);
        for [r, g, _] in pixel(white(50.0), &both, [8, 8]) {
            assert!(r > 0.99 && g < 0.01, "{r} {g}");
        }
    }
}

#[test]
fn a_splat_is_hidden_by_the_mesh_before_it_and_dims_the_mesh_behind_it() {
    let wall = square([-1.0, -1.0], 2.0, RED);
    for [r, g, _] in pixel(white(2.1), &wall, [8, 8]) {
        assert!(r > 0.99 && g < 0.01, "behind the wall: {r} {g}");
    }
    for [r, g, _] in pixel(white(1.9), &wall, [8, 8]) {
        assert!(r > 0.99 && (g - 0.9).abs() < 0.01, "before the wall: {r} {g}");
    }
    // The wall covers the lower right quarter; in the upper left, the splat shows over the black background.
    for [r, g, b] in pixel(white(2.1), &square([0.0, 0.0], 2.0, RED), [0, 0]) {
        assert!([r, g, b].iter().all(|v| (v - 0.9).abs() < 0.01), "beside the wall: {r} {g} {b}");
    }
}

#[test]
fn a_mesh_far_away_is_hidden_by_a_splat_as_a_near_one_is() {
    // The depth buffer stores near / depth: 1000 and 1001 differ by 2e-7 there, which 32-bit floats resolve.
    let wall = Mesh {
        positions: vec![[-2e3, -2e3, 1e3], [2e3, -2e3, 1e3], [2e3, 2e3, 1e3], [-2e3, 2e3, 1e3]],
        ..square([0.0; 2], 0.0, RED)
    };
    let wide = |z| Splat { scale: [2e4; 3], ..white(z) };
    for [_, g, _] in pixel(wide(1001.0), &wall, [8, 8]) {
        assert!(g < 0.01, "behind: {g}");
    }
    for [_, g, _] in pixel(wide(999.0), &wall, [8, 8]) {
        assert!((g - 0.9).abs() < 0.01, "before: {g}");
    }
}

#[test]
fn x_points_right_y_down_and_pixels_are_sampled_at_their_centres() {
    // At depth 2 the square's corner is on the axis, at (8, 8), and the square is 16 pixels wide: the lower right
    // quarter.
    let wall = square([0.0, 0.0], 2.0, RED);
    for (at, seen) in [([7, 8], false), ([8, 7], false), ([8, 8], true), ([15, 15], true)] {
        for [r, ..] in pixel(Splat { opacity: 0.0, ..white(50.0) }, &wall, at) {
            assert_eq!(r > 0.5, seen, "{at:?}");
        }
    }
}

#[test]
fn what_is_nearer_than_the_near_plane_is_cut_off() {
    for (z, seen) in [(0.19, false), (0.21, true)] {
        let wall = square([-1.0, -1.0], z, RED);
        for [r, ..] in pixel(Splat { opacity: 0.0, ..white(50.0) }, &wall, [8, 8]) {
            assert_eq!(r > 0.5, seen, "at {z}");
        }
    }
}

#[test]
fn an_image_is_red_at_its_upper_left_where_u_and_v_are_0_and_its_colours_are_decoded() {
    let mut wall = square([-1.0, -1.0], 2.0, [1.0; 4]);
    wall.uvs = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    wall.texels = vec![[255, 0, 0, 255], [0, 128, 0, 255], [0, 0, 255, 255], [255; 4]];
    let image = splatgraph_assets::Texture { first: 0, width: 2, height: 2 };
    wall.materials[0].base_color_image = image;
    // The same picture, without light: as emission, and as the colour of an unlit surface.
    let base_color = [0.0, 0.0, 0.0, 1.0];
    let glowing = MeshMaterial { base_color, emission: [1.0; 3], emission_image: image, ..wall.materials[0] };
    let unlit = MeshMaterial { unlit: true, emission: [1.0; 3], ..wall.materials[0] };
    let none = Splat { opacity: 0.0, ..white(50.0) };
    // The centres of pixels 3 and 12 are 1/16 texel from a texel's centre, towards the square's edge, where the image
    // repeats.
    let (own, next) = (0.9375f32, 0.0625f32);
    let encode = |v: f32| if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    let linear = [[1.0, 0.0, 0.0], [0.0, 0.215_860_5, 0.0], [0.0, 0.0, 1.0], [1.0; 3]];
    for (texel, at) in [[3, 3], [12, 3], [3, 12], [12, 12]].into_iter().enumerate() {
        // The texel itself, its horizontal neighbour, its vertical neighbour, and the diagonal one.
        let weights =
            [(texel, own * own), (texel ^ 1, own * next), (texel ^ 2, own * next), (texel ^ 3, next * next)];
        let expected: [f32; 3] = std::array::from_fn(|c| {
            encode(weights.iter().map(|(texel, weight)| weight * linear[*texel][c]).sum())
        });
        let dark = Some(Light { color: [0.0; 3], ambient: 0.0, ..Light::default() });
        let drawn = [(wall.materials[0], wall.light), (glowing, dark), (unlit, dark)];
        for found in drawn.into_iter().flat_map(|(material, light)| {
            pixel(none, &Mesh { materials: vec![material], light, ..wall.clone() }, at)
        }) {
            assert!(
                (0..3).all(|c| (found[c] - expected[c]).abs() < 1e-3),
                "{at:?}: {found:?}, expected {expected:?}"
            );
        }
    }
}
