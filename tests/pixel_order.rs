//! Tiles that blend the splats of a pixel in the order of their depths there, compared with the exact renderer.

use crate::common::{self, EXACT_TILES, settings};
use crate::images::{self, drawn, psnr};
use crate::mesh::square;
use splatgraph::draw::session::Session;
use splatgraph::draw::truth::Truth;
use splatgraph_assets::{Camera, Projection, Scene, Splat, synth};
use splatgraph_reference::{Order, Rules};
use std::sync::Arc;

fn exact(scene: &Scene, camera: &Camera, order: Order) -> splatgraph::io::image::Image {
    let rules = Rules { order, ..Rules::of_view(scene, camera) };
    Truth::draw(scene, camera, [0.0; 3], &rules).expect("drawn").image()
}

/// Returns one of 17 plates around the origin, which cross each other in all directions.
fn plate(i: usize) -> Splat {
    let t = i as f32;
    let mut sh = [0.0; 48];
    sh[..3].copy_from_slice(&[t, 2.3 * t, 3.1 * t].map(|phase| 1.5 * phase.sin()));
    let rotation = [t.cos(), (1.3 * t).sin(), (0.7 * t).cos(), (2.1 * t).sin()];
    let position = [(1.1 * t).sin(), (1.7 * t).cos(), (2.9 * t).sin()].map(|v| 0.4 * v);
    let length = rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
    Splat { position, scale: [0.8, 0.5, 0.02], rotation: rotation.map(|v| v / length), opacity: 0.8, sh }
}

fn plates() -> Arc<Scene> {
    Arc::new(Scene::generate(17, 3, plate))
}

fn camera(projection: Projection) -> Camera {
    let (width, height) = (132u32, 92u32);
    let pinhole = Camera::looking_at([0.0, 0.3, -3.0], [0.0; 3], 60.0, (width, height));
    let focal = match projection {
        Projection::Pinhole => return pinhole,
        Projection::Orthographic => f64::from(width) / 5.0,
        Projection::Fisheye => f64::from(width) / 1.5,
        // The plates are at the edge of the panorama, and wrap around it.
        Projection::Equirectangular => {
            let behind = Camera::looking_at([0.0, 0.3, -3.0], [0.0, 0.3, -6.0], 60.0, (width, height));
            return Camera { projection, fx: f64::from(width) / 2.0, fy: f64::from(width) / 2.0, ..behind };
        }
    };
    Camera { projection, fx: focal, fy: focal, ..pinhole }
}

#[test]
fn a_window_with_room_for_all_splats_gives_the_exact_order_of_each_pixel() {
    let scene = plates();
    let mut session = Session::new(common::device(), scene.clone(), "tiled", &[]);
    for projection in Projection::ALL {
        let camera = camera(projection);
        let key_of = if projection.sees_behind() { "distance" } else { "depth" };
        let centre = exact(&scene, &camera, Order::Centre);
        let pixel = exact(&scene, &camera, Order::Pixel);
        let apart = psnr(&centre, &pixel);
        assert!(apart < 45.0, "{projection}: the orders differ by only {apart:.1} dB");
        for covariance in ["six", "factored"] {
            let more = [
                ("projection", projection.name()),
                ("key_of", key_of),
                ("pixel_window", "16"),
                ("covariance", covariance),
            ];
            let set = [EXACT_TILES[0].1, &more].concat();
            let db = psnr(&drawn(&mut session, &camera, "tiled", &set), &pixel);
            println!("{projection}, {covariance}: {db:.1} dB");
            assert!(db > 75.0, "{projection}, {covariance}: {db:.1} dB, expected more than 75");
        }
        // A narrow window is nearer to it than none, with records of half floats, too.
        let of = |session: &mut Session, window: &str| {
            let set = [("projection", projection.name()), ("key_of", key_of), ("pixel_window", window)];
            psnr(&drawn(session, &camera, "tiled", &set), &pixel)
        };
        let [none, narrow, wide] = ["0", "4", "16"].map(|window| of(&mut session, window));
        assert!(none + 3.0 < narrow && narrow < wide && wide > 60.0, "{projection}: {none} {narrow} {wide}");
    }
    images::close(session, "windows of pixels");
}

#[test]
fn a_mesh_hides_what_is_behind_it_at_each_pixel() {
    let camera = camera(Projection::Pinhole);
    // It covers the picture and cuts through the plates.
    let mut wall = square([-1.0, -1.0], 0.05, [0.2, 0.4, 0.1, 1.0]);
    wall.positions.iter_mut().for_each(|[x, y, _]| (*x, *y) = (10.0 * *x, 10.0 * *y));
    let scene = Arc::new(Scene::generate(17, 3, plate).with_mesh(Some(Arc::new(wall))));
    let [centre, pixel] = [Order::Centre, Order::Pixel].map(|order| exact(&scene, &camera, order));
    let mut session = Session::new(common::device(), scene, "tiled", &[]);
    let set = [EXACT_TILES[0].1, &[("pixel_window", "16")]].concat();
    let db = psnr(&drawn(&mut session, &camera, "tiled", &set), &pixel);
    println!("{db:.1} dB, by centres {:.1} dB", psnr(&centre, &pixel));
    assert!(
        db > 70.0 && psnr(&centre, &pixel) < 40.0,
        "{db:.1} dB, by centres {:.1} dB",
        psnr(&centre, &pixel)
    );
    images::close(session, "a mesh among windows of pixels");
}

#[test]
fn outputs_leave_the_order_of_each_pixel_as_it_is() {
    let (scene, camera) = (plates(), camera(Projection::Pinhole));
    let set = [EXACT_TILES[0].1, &[("pixel_window", "8")]].concat();
    let mut session = images::session(scene.clone(), "tiled", &set);
    let picture = images::picture(&mut session, &camera, [0.0; 3]);
    session.set_outputs(&["depth", "normal", "index"].map(String::from));
    let with_outputs = images::picture(&mut session, &camera, [0.0; 3]);
    assert!(images::bytes(&picture) == images::bytes(&with_outputs), "outputs change the picture");
    images::close(session, "outputs beside windows of pixels");
}

#[test]
fn the_preset_draws_a_capture_closer_to_the_order_of_each_pixel() {
    let scene = Arc::new(synth::generate("demo", 4000, 0).expect("a scene"));
    let camera = synth::demo_cameras()[0].resized(160, 90);
    let pixel = exact(&scene, &camera, Order::Pixel);
    let mut session = Session::new(common::device(), scene, "tiled", &settings(&[]));
    let [tiled, window] =
        ["tiled", "pixel_order"].map(|graph| psnr(&drawn(&mut session, &camera, graph, &[]), &pixel));
    println!("{tiled:.1} dB, with a window {window:.1} dB");
    assert!(window > tiled + 3.0, "{window:.1} dB, without a window {tiled:.1} dB");
}
