//! Tests the navigation with every input, and the setting of its camera.

mod drag;
mod flight;
mod fly;

use super::*;
use proptest::prelude::*;

const SIZE: [f64; 2] = [800.0, 600.0];
const PIXELS: (u32, u32) = (800, 600);

fn bounds() -> Bounds {
    Bounds { min: [-2.0, -1.0, -3.0], max: [4.0, 2.0, 5.0] }
}

/// Returns a tilted camera with non-square pixels and an off-centre principal point.
fn start() -> Camera {
    let mut camera = Camera::looking_at([6.0, -4.0, -9.0], [1.0, 0.5, 1.0], 70.0, PIXELS);
    let roll = DMat3::from_axis_angle(DVec3::from(camera.axes()[2]), 0.2);
    let rotation = roll * DMat3::from_cols_array_2d(&camera.rotation).transpose();
    camera.rotation = rotation.transpose().to_cols_array_2d();
    camera.fx *= 1.25;
    camera.principal_offset = [31.0, -12.0];
    camera
}

fn navigation() -> Navigation {
    let mut navigation = Navigation::new(&bounds(), &start(), DEFAULT_UP);
    navigation.flight_seconds = 0.0;
    navigation
}

fn wait(seconds: f64) -> Input {
    Input { size: SIZE, seconds, ..Input::default() }
}

/// Makes a drag: the right button (`r`) looks around, any other one orbits.
fn drag(button: char, x: f64, y: f64) -> Input {
    Input { moved: [x, y], drags: button != 'r', flies: button == 'r', ..wait(0.01) }
}

fn with(modifier: &str, input: Input) -> Input {
    Input { shift: modifier == "shift", ctrl: modifier == "ctrl", ..input }
}

fn projected(projection: Projection) -> (Navigation, Camera) {
    let camera = start().with_projection(projection, bounds().center());
    let mut navigation = Navigation::new(&bounds(), &camera, DEFAULT_UP);
    navigation.flight_seconds = 0.0;
    (navigation, camera)
}

/// Projects a point of the world to pixels, with pixel centres at halves.
fn pixel(camera: &Camera, point: DVec3) -> [f64; 2] {
    let [x, y, z] = camera.to_view(point.into());
    let [cx, cy] = camera.principal_point();
    [cx + camera.fx * x / z, cy + camera.fy * y / z]
}

fn point(camera: &Camera, pixel: [f64; 2], z: f64) -> DVec3 {
    let [right, down, forward] = camera.axes().map(DVec3::from);
    let [cx, cy] = camera.principal_point();
    let (x, y) = ((pixel[0] - cx) / camera.fx * z, (pixel[1] - cy) / camera.fy * z);
    DVec3::from(camera.position) + x * right + y * down + z * forward
}

fn now(navigation: &Navigation) -> Camera {
    navigation.camera(PIXELS.0, PIXELS.1)
}

fn forward(navigation: &Navigation) -> DVec3 {
    DVec3::from(now(navigation).axes()[2])
}

fn position(navigation: &Navigation) -> DVec3 {
    DVec3::from(now(navigation).position)
}

fn apart(a: &Camera, b: &Camera) -> f64 {
    let numbers = |c: &Camera| {
        let flat: Vec<f64> = c.rotation.as_flattened().to_vec();
        [&c.position[..], &flat[..], &[c.fx / c.fy, c.fy / f64::from(c.height)]].concat()
    };
    numbers(a).iter().zip(numbers(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn close(a: DVec3, b: DVec3, within: f64) -> bool {
    (a - b).length() < within
}

#[test]
fn a_moved_camera_keeps_its_projection_and_scale() {
    for projection in Projection::ALL {
        let (mut navigation, camera) = projected(projection);
        assert_eq!(now(&navigation), camera);
        let nudge = drag('l', 1e-6, 0.0);
        assert!(navigation.update(&nudge));
        let moved = now(&navigation);
        assert_eq!(moved.projection, projection);
        assert!((moved.fx / camera.fx - 1.0).abs() < 1e-6, "{projection}: {} after {}", moved.fx, camera.fx);
        assert!((moved.fy / camera.fy - 1.0).abs() < 1e-6, "{projection}: {} after {}", moved.fy, camera.fy);
    }
}

#[test]
fn zooming_enlarges_an_orthographic_view_as_it_does_a_pinholes() {
    let (mut navigation, camera) = projected(Projection::Orthographic);
    let center = DVec3::from(bounds().center());
    let distance = |camera: &Camera| center.distance(camera.position.into());
    assert!(navigation.update(&Input { scroll: 3.0, ..wait(0.01) }));
    let moved = now(&navigation);
    assert!(distance(&moved) < 0.8 * distance(&camera));
    let expected = distance(&camera) / distance(&moved);
    assert!(
        (moved.fy / camera.fy / expected - 1.0).abs() < 1e-9,
        "{} times, {expected}",
        moved.fy / camera.fy
    );
}

#[test]
fn an_orthographic_graph_zooms_in_place_and_keeps_its_scale_when_the_camera_moves() {
    let mut navigation = navigation();
    navigation.set_orthographic(true);
    let center = bounds().center();
    let shown = |n: &Navigation| now(n).with_projection(Projection::Orthographic, center);
    let first = shown(&navigation);
    assert!((navigation.height() * first.fy / f64::from(PIXELS.1) - 1.0).abs() < 1e-12);
    assert!(navigation.update(&Input { scroll: 30.0, ..wait(0.01) }));
    let near = shown(&navigation);
    assert!(
        (near.fy / first.fy / (30.0 * ZOOM_PER_NOTCH).exp() - 1.0).abs() < 1e-9,
        "{}",
        near.fy / first.fy
    );
    assert_eq!(near.position, first.position, "the near plane cuts nothing off");
    // A point stays under the pointer while the view is panned, at any depth.
    navigation.update(&with("shift", drag('m', 40.0, -30.0)));
    let panned = shown(&navigation);
    let moved = DVec3::from(panned.to_view(first.position)) * panned.fy;
    assert!((moved - DVec3::new(40.0 * panned.fy / panned.fx, -30.0, 0.0)).length() < 1e-6, "{moved}");
    for input in [
        drag('l', 300.0, 50.0),
        Input { fly: [0.0, 0.0, 1.0], ..drag('r', 9.0, 4.0) },
        with("shift", drag('m', 999.0, 0.0)),
    ] {
        assert!(navigation.update(&input));
        assert!((shown(&navigation).fy / near.fy - 1.0).abs() < 1e-9, "{input:?}");
    }
    navigation.set_height(1.5);
    assert!((navigation.height() - 1.5).abs() < 1e-12 && !navigation.shows(&start()));
    // Another graph draws the pivot at the same scale, with the same field of view.
    navigation.home();
    navigation.update(&Input { scroll: 5.0, ..wait(0.01) });
    navigation.set_orthographic(false);
    let camera = now(&navigation);
    let ratio = camera.fy / camera.to_view(navigation.pivot().into())[2] / first.fy;
    assert!((ratio / (5.0 * ZOOM_PER_NOTCH).exp() - 1.0).abs() < 0.02, "{ratio}");
    assert!(
        (navigation.field_of_view() - Navigation::new(&bounds(), &start(), DEFAULT_UP).field_of_view()).abs()
            < 1e-9
    );
    // Framing and a camera from a file bring their own scale.
    navigation.set_orthographic(true);
    navigation.update(&Input { scroll: 50.0, ..wait(0.01) });
    navigation.frame(SIZE);
    assert!(bounds().corners().iter().all(|corner| shown(&navigation).to_view(*corner)[2] > NEAR));
    assert!(navigation.height() > bounds().extent() * 0.5);
    navigation.set_camera(&start());
    assert_eq!(now(&navigation), start());
}

/// Computes the share of the view that a box fills; `None` if a corner is too near.
fn filled(camera: &Camera, bounds: &Bounds) -> Option<f64> {
    let mut most = 0.0f64;
    for corner in bounds.corners() {
        let [x, y, z] = camera.to_view(corner);
        if z < NEAR {
            return None;
        }
        most = most.max((x / z * camera.fx / (0.5 * f64::from(camera.width))).abs());
        most = most.max((y / z * camera.fy / (0.5 * f64::from(camera.height))).abs());
    }
    Some(most)
}

#[test]
fn framing_shows_all_of_the_scene_from_the_same_direction() {
    for size in [[800.0, 600.0], [300.0, 1000.0], [1920.0, 200.0]] {
        let mut navigation = navigation();
        navigation.update(&drag('r', 300.0, 100.0));
        let before = forward(&navigation);
        navigation.update(&Input { size, frame: true, ..Input::default() });
        let camera = navigation.camera(size[0] as u32, size[1] as u32);
        let filled = filled(&camera, &bounds()).expect("nothing is too near");
        assert!((filled - 0.92).abs() < 1e-9, "{size:?}: {filled}");
        assert!(close(forward(&navigation), before, 1e-12));
        assert!(close(navigation.pivot(), DVec3::from(bounds().center()), 1e-9));
    }
}

#[test]
fn tiny_and_huge_scenes_and_single_points_are_framed_and_flown_through() {
    for (size, fills) in [(0.0, false), (1e-6, false), (1e-3, false), (1e6, true), (1e30, true)] {
        let bounds = Bounds { min: [1.0 - size; 3], max: [1.0 + size; 3] };
        let mut navigation = Navigation::new(&bounds, &start(), DEFAULT_UP);
        navigation.flight_seconds = 0.0;
        navigation.frame(SIZE);
        let filled = filled(&now(&navigation), &bounds).expect("nothing is too near");
        assert!(filled < 0.9201 && (!fills || filled > 0.9199), "{size}: {filled}");
        let before = position(&navigation);
        navigation.update(&Input { flies: true, fly: [0.0, 0.0, 1.0], ..wait(1.0) });
        let flown = (position(&navigation) - before).length();
        assert!((flown - navigation.fly_speed()).abs() <= 1e-9 * before.length(), "{size}: {flown}");
        assert_sound(&navigation);
    }
}

#[test]
fn a_camera_that_was_set_is_read_back_to_the_last_bit_and_resized_keeps_its_height() {
    let mut navigation = navigation();
    let mut other = start();
    (other.id, other.img_name) = (7, "seven".into());
    // With as few digits as in files, the matrix is not exactly a rotation.
    other.rotation = other.rotation.map(|row| row.map(|v| (v * 1e3).round() / 1e3));
    navigation.set_camera(&other);
    assert_eq!(now(&navigation), other);
    assert_eq!(navigation.camera(1600, 300), other.resized(1600, 300));
    assert_eq!(navigation.camera(0, 0), other.resized(1, 1));
}

#[test]
fn a_camera_that_was_moved_there_and_back_is_the_same() {
    let mut navigation = navigation();
    navigation.update(&with("shift", drag('m', 50.0, 20.0)));
    assert_eq!(now(&navigation).img_name, "");
    navigation.update(&with("shift", drag('m', -50.0, -20.0)));
    assert!(apart(&now(&navigation), &start()) < 1e-12);
    let wide = navigation.camera(1600, 600);
    assert!((wide.fy - start().fy).abs() < 1e-9 && (wide.fx - start().fx).abs() < 1e-9, "more at the sides");
}

#[test]
fn the_field_of_view_is_set_in_place_within_its_range() {
    let mut navigation = navigation();
    let (before, pivot) = (now(&navigation), navigation.pivot());
    let vertical = |camera: &Camera| 2.0 * (0.5 * f64::from(camera.height) / camera.fy).atan().to_degrees();
    assert!((navigation.field_of_view() - vertical(&before)).abs() < 1e-9);
    for (asked, expected) in [(40.0, 40.0), (1.0, 5.0), (f64::INFINITY, 150.0), (f64::NAN, 150.0)] {
        navigation.set_field_of_view(asked);
        assert!((navigation.field_of_view() - expected).abs() < 1e-9, "{asked}");
        let camera = now(&navigation);
        assert!((vertical(&camera) - expected).abs() < 1e-9, "{asked}");
        assert_eq!(camera.position, before.position);
        assert!((camera.fx / camera.fy - 1.25).abs() < 1e-12, "the pixels' shape stays");
        assert!(close(navigation.pivot(), pivot, 1e-12));
        assert_sound(&navigation);
    }
}

#[test]
fn framing_and_home_keep_a_field_of_view_that_was_set_and_a_camera_brings_its_own() {
    let mut navigation = navigation();
    navigation.flight_seconds = FLIGHT_SECONDS;
    let settle = |navigation: &mut Navigation| {
        for _ in 0..2 {
            navigation.update(&wait(1.0));
        }
        assert!(!navigation.is_moving());
    };
    let set = |navigation: &Navigation| (navigation.field_of_view() - 100.0).abs() < 1e-9;
    navigation.frame(SIZE);
    navigation.set_field_of_view(100.0);
    assert!(set(&navigation));
    settle(&mut navigation);
    assert!(set(&navigation));
    assert!((filled(&now(&navigation), &bounds()).unwrap() - 0.92).abs() > 0.01, "framed for another one");
    navigation.frame(SIZE);
    settle(&mut navigation);
    assert!(set(&navigation) && (filled(&now(&navigation), &bounds()).unwrap() - 0.92).abs() < 1e-9);
    navigation.home();
    settle(&mut navigation);
    assert!(set(&navigation) && now(&navigation).position == start().position);
    let other = Camera::looking_at([-8.0, -3.0, 2.0], [0.0; 3], 40.0, PIXELS);
    navigation.set_camera(&other);
    settle(&mut navigation);
    assert_eq!(now(&navigation), other);
    navigation.update(&Input { home: true, ..wait(1.0) });
    settle(&mut navigation);
    assert_eq!(now(&navigation), start(), "with its own field of view");
}

#[test]
fn another_up_is_turned_about_and_one_without_a_direction_is_ignored() {
    let with_up = |up| Navigation::new(&bounds(), &start(), up);
    let mut navigation = with_up(DVec3::new(0.0, 0.0, 2.0));
    assert_eq!(navigation.up(), DVec3::Z);
    let height = |n: &Navigation| (position(n) - n.pivot()).z;
    let before = height(&navigation);
    navigation.update(&drag('l', 123.0, 0.0));
    assert!((height(&navigation) - before).abs() < 1e-12);
    for none in [DVec3::ZERO, DVec3::splat(f64::NAN)] {
        assert_eq!(with_up(none).up(), DEFAULT_UP);
        let before = (now(&navigation), navigation.up());
        navigation.set_up(none);
        assert_eq!((now(&navigation), navigation.up()), before);
    }
    navigation.set_up(DVec3::new(-3.0, 0.0, 0.0));
    assert_eq!(navigation.up(), DVec3::NEG_X);
}

#[test]
fn a_view_without_a_size_pans_nothing_and_frames_all_the_same() {
    let mut navigation = navigation();
    let mut input = with("shift", drag('m', 10.0, 10.0));
    input.size = [0.0; 2];
    assert!(!navigation.update(&input));
    navigation.update(&Input { frame: true, ..Input::default() });
    assert!(filled(&navigation.camera(0, 0), &bounds()).unwrap() < 0.93);
    assert_sound(&navigation);
}

fn assert_sound(navigation: &Navigation) {
    let camera = now(navigation);
    let numbers = [&camera.position[..], camera.rotation.as_flattened(), &[camera.fx, camera.fy]].concat();
    assert!(numbers.iter().all(|v| v.is_finite()), "{camera:?}");
    let [right, down, forward] = camera.axes().map(DVec3::from);
    for (i, a) in [right, down, forward].iter().enumerate() {
        for (j, b) in [right, down, forward].iter().enumerate() {
            assert!((a.dot(*b) - f64::from(i == j)).abs() < 1e-9, "{camera:?}");
        }
    }
    assert!(close(right.cross(down), forward, 1e-9), "{camera:?}");
    assert!(camera.fx > 0.0 && camera.fy > 0.0 && navigation.pose.distance > 0.0, "{camera:?}");
    assert!(navigation.fly_speed() > 0.0 && navigation.fly_speed().is_finite());
}

/// Generates ordinary numbers mixed with extreme ones.
fn wild() -> impl Strategy<Value = f64> {
    let extremes =
        [0.0, -0.0, 1e-300, 1e9, -1e9, 1e300, f64::MAX, f64::MIN, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    prop_oneof![3 => -500.0..500.0, 1 => prop::sample::select(extremes.to_vec())]
}

prop_compose! {
    fn inputs()(
        size in prop::array::uniform2(wild()), moved in prop::array::uniform2(wild()),
        scroll in wild(), seconds in wild(), bits in any::<u32>(), command in 0..40,
    ) -> Input {
        let bit = |i: u32| bits >> i & 1 == 1;
        let along = |i: u32| f64::from(bit(i)) - f64::from(bit(i + 1));
        Input {
            size, moved, scroll, seconds,
            drags: bit(0), flies: bit(1), shift: bit(2), ctrl: bit(3),
            fly: [4, 6, 8].map(along), orbit: [10, 12].map(along),
            frame: command == 0,
            home: command == 1,
        }
    }
}

proptest! {
    #[test]
    fn whatever_the_input_the_camera_is_finite_and_orthonormal(
        list in prop::collection::vec(inputs(), 1..40),
        low in prop::array::uniform3(-1e3f32..1e3), extent in prop::sample::select(&[0.0f32, 1e-20, 1e-3, 10.0, 1e12, 1e38, f32::INFINITY, f32::NAN]),
        numbers in prop::array::uniform8(wild()), up in prop::array::uniform3(wild()), animated: bool, view in wild(),
    ) {
        let bounds = Bounds { min: low, max: low.map(|v| v + extent) };
        let mut navigation = Navigation::new(&bounds, &start(), DVec3::from(up));
        navigation.flight_seconds = if animated { FLIGHT_SECONDS } else { 0.0 };
        let [x, y, z, a, b, c, fx, fy] = numbers;
        let odd = Camera { position: [x, y, z], rotation: [[a, b, c], [b, c, a], [c, a, b]], fx, fy, ..start() };
        for (i, input) in list.iter().enumerate() {
            if i == 7 {
                navigation.set_camera(&odd);
            }
            if i % 11 == 5 {
                navigation.set_field_of_view(view);
            }
            if i % 4 == 2 {
                navigation.set_orthographic(i % 8 == 2);
                navigation.set_height(view);
            }
            navigation.update(input);
            assert_sound(&navigation);
        }
    }
}
