use super::*;
use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;
use std::f64::consts::{PI, TAU};

const SIZE: (u32, u32) = (320, 180);

/// Makes a camera from a position, a rotation vector in radians, and a horizontal focal length in pixels.
fn key(position: [f64; 3], turn: [f64; 3], focal: f64) -> Camera {
    let rotation = DMat3::from_quat(DQuat::from_scaled_axis(turn.into()));
    Camera {
        id: 0,
        img_name: String::new(),
        width: SIZE.0,
        height: SIZE.1,
        position,
        rotation: rotation.transpose().to_cols_array_2d(),
        fx: focal,
        fy: 1.25 * focal,
        principal_offset: [0.0; 2],
        projection: Default::default(),
    }
}

fn keys() -> Vec<Camera> {
    vec![
        key([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 200.0),
        key([1.0, 0.2, 0.0], [0.0, 0.4, 0.1], 220.0),
        key([4.0, -1.0, 2.0], [0.2, 1.9, 0.1], 150.0),
        key([4.1, -1.0, 2.1], [0.2, 2.6, -0.3], 400.0),
        key([-1.0, 3.0, 5.0], [-0.4, 2.2, 0.5], 300.0),
    ]
}

fn path(keys: Vec<Camera>, closed: bool) -> CameraPath {
    let mut path = CameraPath::new(2.0, [0.0, -1.0, 0.0]);
    path.set_keys(keys).unwrap();
    path.set_closed(closed);
    path
}

/// Measures the translation (in units of 2), the rotation and the zoom between two cameras.
fn apart(a: &Camera, b: &Camera) -> [f64; 3] {
    let way = (DVec3::from(a.position) - DVec3::from(b.position)).length() / 2.0;
    let [a_axes, b_axes] = [a, b].map(|camera| DMat3::from_cols_array_2d(&camera.axes()));
    // A rotation moves each axis by a chord. The squares of the three chords sum to 8 sin^2(angle / 2).
    let chords: f64 = (a_axes - b_axes).to_cols_array().iter().map(|v| v * v).sum();
    let turn = 2.0 * (chords / 8.0).sqrt().min(1.0).asin();
    let zoom = ((a.fx / b.fx).ln().powi(2) / 2.0 + (a.fy / b.fy).ln().powi(2) / 2.0).sqrt();
    [way, turn, zoom]
}

fn distance(a: &Camera, b: &Camera) -> f64 {
    DVec3::from(apart(a, b)).length()
}

fn assert_sound(camera: &Camera, what: &str) {
    assert_eq!(camera.fault(), None, "{what}");
    let axes = camera.axes().map(DVec3::from);
    for (i, a) in axes.iter().enumerate() {
        for (j, b) in axes.iter().enumerate() {
            let product = a.dot(*b);
            assert!((product - f64::from(i == j)).abs() < 1e-12, "{what}: {product}");
        }
    }
}

#[test]
fn a_path_passes_through_its_keys_at_their_times() {
    for closed in [false, true] {
        let path = path(keys(), closed);
        let times = path.key_seconds();
        assert_eq!(times.len(), 5);
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
        assert_eq!(times[0], 0.0);
        assert_eq!(times[4] == path.seconds(), !closed);
        for (time, key) in times.iter().zip(path.keys()) {
            let camera = path.at(*time).unwrap();
            assert!(distance(&camera, key) < 1e-7, "at {time}: {camera:?}, not {key:?}");
            assert!((camera.fx / key.fx - 1.0).abs() < 1e-9 && (camera.fy / key.fy - 1.0).abs() < 1e-9);
            assert_eq!((camera.width, camera.height), SIZE);
        }
        let end = path.at(path.seconds()).unwrap();
        assert!(distance(&end, &path.keys()[if closed { 0 } else { 4 }]) < 1e-7);
    }
}

#[test]
fn the_speed_is_constant_within_a_hundredth() {
    for closed in [false, true] {
        let path = path(keys(), closed);
        const STEPS: u32 = 3001;
        let step = path.seconds() / f64::from(STEPS);
        let at =
            |index: u32| path.at(f64::from(index) * step - if index == STEPS { 1e-12 } else { 0.0 }).unwrap();
        let steps: Vec<f64> = (0..STEPS).map(|index| distance(&at(index), &at(index + 1))).collect();
        let mean = steps.iter().sum::<f64>() / f64::from(STEPS);
        for (index, step) in steps.iter().enumerate() {
            assert!(
                (step / mean - 1.0).abs() < 0.01,
                "closed: {closed}, step {index}: {} of the mean",
                step / mean
            );
        }
    }
}

#[test]
fn there_is_no_kink_at_a_key() {
    for closed in [false, true] {
        let path = path(keys(), closed);
        let times = path.key_seconds();
        for time in &times[if closed { 0..5 } else { 1..4 }] {
            let step = 1e-4;
            let [before, at, after] = [-step, 0.0, step].map(|offset| path.at(time + offset).unwrap());
            let way = |a: &Camera, b: &Camera| DVec3::from(b.position) - DVec3::from(a.position);
            let turn = |a: &Camera, b: &Camera| {
                let [a, b] = [a, b].map(|c| DQuat::from_mat3(&DMat3::from_cols_array_2d(&c.axes())));
                (a.inverse() * b).to_scaled_axis()
            };
            let scale = distance(&at, &after);
            let kinks = [
                (way(&before, &at) - way(&at, &after)).length() / 2.0,
                (turn(&before, &at) - turn(&at, &after)).length(),
                ((at.fy / before.fy).ln() - (after.fy / at.fy).ln()).abs(),
            ];
            assert!(
                kinks.iter().all(|kink| *kink < 0.02 * scale),
                "closed: {closed}, at {time}: {kinks:?} of {scale}"
            );
        }
    }
}

#[test]
fn a_path_through_level_keys_stays_level_and_passes_through_them() {
    let up = [0.2, -1.0, 0.1];
    let level = |eye, target| Camera::looking_at_upright(eye, target, up, 60.0, SIZE);
    let keys = |last| {
        let steep = level([4.0, -6.0, 2.0], [5.0, 0.0, 3.0]);
        vec![level([0.0; 3], [1.0, -0.5, 3.0]), steep, level([-1.0, 0.5, 6.0], [-4.0, -1.0, 2.0]), last]
    };
    let roll = |camera: &Camera| DVec3::from(camera.axes()[0]).dot(DVec3::from(up).normalize());
    let most = |keys: Vec<Camera>, up, closed| {
        let mut path = CameraPath::new(2.0, up);
        path.set_keys(keys).unwrap();
        path.set_closed(closed);
        for (time, key) in path.key_seconds().iter().zip(path.keys()) {
            let found = distance(&path.at(*time).unwrap(), key);
            assert!(found < 1e-7, "{found} from the key at {time}");
        }
        let rolls = (0..=300).map(|step| roll(&path.at(f64::from(step) / 30.0).unwrap()).abs());
        rolls.fold(0.0, f64::max)
    };
    let last = level([3.0, 0.0, -2.0], [0.0, 0.3, -5.0]);
    let rolled = |degrees: f64| {
        let turn = DMat3::from_rotation_z(-degrees.to_radians());
        let rotation = (turn * DMat3::from_cols_array_2d(&last.rotation)).to_cols_array_2d();
        Camera { rotation, ..last.clone() }
    };
    for closed in [false, true] {
        assert!(most(keys(last.clone()), up, closed) < 1e-9);
        assert!(most(keys(rolled(0.05)), up, closed) < 1e-3, "a key's small roll stays");
        assert!(most(keys(rolled(1.0)), up, closed) > 0.05, "the path between tilted keys is free");
        assert!(most(keys(last.clone()), [0.0; 3], closed) > 0.05);
        // A view straight down has no roll: the path fades to that of free rotations.
        assert!(most(keys(level([3.0, 0.0, -2.0], [2.8, 1.0, -2.1])), up, closed) > 1e-3);
    }
}

#[test]
fn a_turn_in_place_takes_the_time_of_its_angle_and_stays_in_place() {
    let keys = vec![
        key([0.0, 0.0, 0.0], [0.0; 3], 200.0),
        key([6.0, 0.0, 0.0], [0.0; 3], 200.0),
        key([6.0, 0.0, 0.0], [0.0, 1.5, 0.0], 200.0),
        key([6.0, 3.0, 0.0], [0.0, 1.5, 0.0], 200.0),
    ];
    let path = path(keys, false);
    let times = path.key_seconds();
    // The segments measure 6 / 2, 1.5 (the turn) and 3 / 2.
    for (time, expected) in times.iter().zip([0.0, 5.0, 7.5, 10.0]) {
        assert!((time - expected).abs() < 1e-3, "{times:?}");
    }
    for step in 0..100 {
        let time = times[1] + (times[2] - times[1]) * f64::from(step) / 100.0;
        let [way, ..] = apart(&path.at(time).unwrap(), &path.keys()[1]);
        assert!(way < 1e-6, "{way} away at {time}");
        let [_, turn, _] = apart(&path.at(4.9 * f64::from(step) / 100.0).unwrap(), &path.keys()[0]);
        assert!(turn < 1e-9, "turned by {turn} on a straight way");
    }
}

#[test]
fn two_keys_make_a_straight_way_with_an_even_turn_and_an_even_zoom_in_logarithms() {
    let ends = [key([1.0, 2.0, 3.0], [0.0, 0.2, 0.0], 100.0), key([3.0, 2.0, 7.0], [0.0, 1.4, 0.0], 400.0)];
    let path = path(ends.to_vec(), false);
    for (part, angle) in [(0.25, 0.5), (0.5, 0.8), (0.75, 1.1)] {
        let camera = path.at(part * path.seconds()).unwrap();
        let expected =
            key([1.0 + 2.0 * part, 2.0, 3.0 + 4.0 * part], [0.0, angle, 0.0], 100.0 * 4f64.powf(part));
        assert!(distance(&camera, &expected) < 1e-4, "{camera:?}, not {expected:?}");
    }
    for (time, end) in [(-1.0, 0), (f64::NEG_INFINITY, 0), (11.0, 1), (f64::INFINITY, 1), (f64::NAN, 0)] {
        assert!(distance(&path.at(time).unwrap(), &ends[end]) < 1e-9, "at {time}");
    }
}

#[test]
fn a_closed_path_through_two_keys_goes_there_and_back() {
    let ends = [key([0.0; 3], [0.0; 3], 100.0), key([4.0, 0.0, 0.0], [0.0, 1.0, 0.0], 100.0)];
    let path = path(ends.to_vec(), true);
    assert!((path.key_seconds()[1] - 5.0).abs() < 1e-3);
    for (time, same) in [(2.0, 8.0), (-2.0, 8.0), (12.0, 2.0), (1002.0, 2.0)] {
        assert!(distance(&path.at(time).unwrap(), &path.at(same).unwrap()) < 1e-3, "at {time}");
    }
    assert_eq!(path.at(f64::INFINITY), path.at(0.0));
}

#[test]
fn no_key_has_no_camera_and_one_key_or_equal_keys_are_that_camera_bit_by_bit() {
    assert_eq!(path(vec![], false).at(1.0), None);
    assert_eq!(path(vec![], true).key_seconds(), Vec::<f64>::new());
    assert_eq!(path(vec![], false).at_frame(0.0, 10), None);
    let one = keys()[2].clone();
    for count in 1..4 {
        for closed in [false, true] {
            let path = path(vec![one.clone(); count], closed);
            assert_eq!(path.key_seconds(), vec![0.0; count]);
            for time in [0.0, 3.0, 10.0, f64::NAN] {
                assert_eq!(path.at(time).as_ref(), Some(&one));
            }
        }
    }
}

#[test]
fn equal_keys_in_a_row_count_as_one() {
    let mut doubled = keys();
    doubled.insert(2, doubled[2].clone());
    doubled.insert(0, doubled[0].clone());
    doubled.push(doubled[6].clone());
    for closed in [false, true] {
        let (path, expected) = (path(doubled.clone(), closed), path(keys(), closed));
        let times = expected.key_seconds();
        let [a, b, c, d, e] = times[..] else { panic!("{times:?}") };
        assert_eq!(path.key_seconds(), [a, a, b, c, c, d, e, e]);
        for step in 0..50 {
            assert_eq!(path.at(f64::from(step) / 5.0), expected.at(f64::from(step) / 5.0));
        }
    }
    let mut round = keys();
    round.push(round[0].clone());
    let (path, expected) = (path(round, true), path(keys(), true));
    assert_eq!(path.at(3.7), expected.at(3.7));
    assert_eq!(path.key_seconds()[5], 10.0);
}

#[test]
fn the_way_between_opposite_rotations_turns_by_half_a_circle_at_an_even_speed() {
    for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(0.6, 0.0, -0.8)] {
        let ends = [key([0.0; 3], [0.0; 3], 100.0), key([0.0; 3], (PI * axis).into(), 100.0)];
        let path = path(ends.to_vec(), false);
        for step in 0..=20 {
            let camera = path.at(f64::from(step) / 2.0).unwrap();
            assert_sound(&camera, "between opposite rotations");
            let [way, turn, _] = apart(&camera, &ends[0]);
            assert!(
                way == 0.0 && (turn - PI * f64::from(step) / 20.0).abs() < 1e-3,
                "{axis}, {step}: {turn}"
            );
        }
    }
}

#[test]
fn turns_take_the_shorter_way_round() {
    let ends = [key([0.0; 3], [0.0, 3.0, 0.0], 100.0), key([0.0; 3], [0.0, -3.0, 0.0], 100.0)];
    let middle = path(ends.to_vec(), false).at(5.0).unwrap();
    let [_, turn, _] = apart(&middle, &key([0.0; 3], [0.0, PI, 0.0], 100.0));
    assert!(turn < 1e-3, "{turn} from the middle of the shorter way");
}

#[test]
fn a_short_turn_before_a_long_way_does_not_make_it_spin() {
    let keys = vec![
        key([0.0; 3], [0.0; 3], 200.0),
        key([0.001, 0.0, 0.0], [0.0, 2.0, 0.0], 200.0),
        key([1e5, 0.0, 0.0], [0.0, 2.1, 0.0], 200.0),
        key([1e5, 0.0, 0.001], [0.0, 0.1, 0.0], 200.0),
    ];
    let path = path(keys.clone(), false);
    let times = path.key_seconds();
    for step in 0..200 {
        let time = times[1] + (times[2] - times[1]) * f64::from(step) / 200.0;
        let [_, turn, _] = apart(&path.at(time).unwrap(), &keys[1]);
        assert!(turn < 0.5, "turned by {turn} at {time}");
    }
}

#[test]
fn frames_are_equal_steps_with_both_ends_of_an_open_path_and_one_of_a_closed_one() {
    let open = path(keys(), false);
    let frame = |index: f64| open.at_frame(index, 11).unwrap();
    assert!(distance(&frame(0.0), &keys()[0]) < 1e-7 && distance(&frame(10.0), &keys()[4]) < 1e-7);
    assert!(distance(&frame(3.0), &open.at(3.0).unwrap()) < 1e-12);
    assert!(distance(&frame(3.5), &open.at(3.5).unwrap()) < 1e-12);
    assert_eq!(open.at_frame(0.0, 1), open.at(0.0));
    let closed = path(keys(), true);
    let last = closed.at_frame(9.0, 10).unwrap();
    assert!(distance(&last, &closed.at(9.0).unwrap()) < 1e-12);
    assert!(distance(&last, &closed.at(0.0).unwrap()) > 0.1, "the first is not drawn twice");
}

#[test]
fn keys_that_are_frames_keep_their_times_and_equal_ones_are_a_hold() {
    // At rest, then in motion, then at rest.
    let places = [0.0, 0.0, 1.0, 4.0, 4.0, 4.0];
    let frames: Vec<Camera> =
        places.iter().map(|x| key([*x, 0.0, 0.0], [0.0, 0.1 * x, 0.0], 200.0)).collect();
    for closed in [false, true] {
        let mut path = path(frames.clone(), closed);
        path.set_frames(true);
        let at = |frame: f64| path.at_frame(frame, 6).unwrap();
        let x = |frame: f64| at(frame).position[0];
        for (index, camera) in frames.iter().enumerate() {
            assert_eq!(at(index as f64), *camera, "frame {index}, exactly");
            // Twice as many frames have them at even places.
            let count = if closed { 12 } else { 11 };
            let found = path.at_frame(2.0 * index as f64, count).unwrap();
            assert!(distance(&found, camera) < 1e-9, "frame {index}: {found:?}");
        }
        for step in 0..=10 {
            let part = 0.1 * f64::from(step);
            assert_eq!((x(part), x(3.0 + part), x(4.0 + part)), (0.0, 4.0, 4.0), "holds, {part} later");
            assert!((0.0..=1.0).contains(&x(1.0 + part)) && (1.0..=4.0).contains(&x(2.0 + part)));
        }
        assert!((x(2.0 + 1e-4) - x(2.0) - (x(2.0) - x(2.0 - 1e-4))).abs() < 1e-6, "no kink in motion");
        assert_eq!(x(5.5) < 3.0, closed, "a closed path returns");
        assert_eq!(x(-1.0), if closed { 4.0 } else { 0.0 });
    }
    let mut one = path(frames[..1].to_vec(), false);
    one.set_frames(true);
    assert_eq!(
        (one.at_frame(0.0, 1), one.at_frame(3.3, 5)),
        (Some(frames[0].clone()), Some(frames[0].clone()))
    );
}

#[test]
fn keys_are_edited_and_unusable_ones_refused() {
    let mut path = path(keys(), false);
    path.reorder(4, 0);
    path.reorder(0, 99);
    assert_eq!(path.keys(), keys());
    path.reorder(1, 3);
    let order = |path: &CameraPath| path.keys().iter().map(|key| key.fx).collect::<Vec<_>>();
    assert_eq!(order(&path), [200.0, 150.0, 400.0, 220.0, 300.0]);
    path.remove(0);
    path.remove(9);
    path.reorder(9, 0);
    path.insert(99, keys()[0].clone()).unwrap();
    assert_eq!(order(&path), [150.0, 400.0, 220.0, 300.0, 200.0]);
    let broken = Camera { position: [f64::NAN, 0.0, 0.0], ..keys()[0].clone() };
    let error = path.insert(1, broken.clone()).unwrap_err().to_string();
    assert!(error.starts_with("expected a valid camera as key 1: expected a position"), "{error}");
    assert!(path.set_keys(vec![keys()[0].clone(), broken]).is_err());
    assert_eq!(path.keys().len(), 5);
    for (asked, seconds) in [(3.0, 3.0), (f64::NAN, 3.0), (0.0, 0.1), (f64::INFINITY, 86_400.0)] {
        path.set_seconds(asked);
        assert_eq!(path.seconds(), seconds);
    }
}

#[test]
fn zoom_and_principal_point_are_the_keys_own_also_for_pictures_of_several_sizes() {
    let at = |x: f64| Camera { principal_offset: [10.0 * x, -4.0], ..key([x, 0.0, 0.0], [0.0; 3], 200.0) };
    let keys = vec![at(0.0), at(1.0).resized(640, 360)];
    let path = path(keys, false);
    for step in 0..=10 {
        let camera = path.at(f64::from(step)).unwrap();
        assert!((camera.fx - 200.0).abs() < 1e-9 && (camera.fy - 250.0).abs() < 1e-9, "{camera:?}");
        let [x, y] =
            [camera.principal_offset[0] - 10.0 * camera.position[0], camera.principal_offset[1] + 4.0];
        assert!(x.abs() < 1e-9 && y.abs() < 1e-9, "{camera:?}");
    }
}

#[test]
fn the_lens_is_the_one_that_all_keys_share() {
    let with = |projection| {
        let each = |key: Camera| Camera { projection, ..key };
        keys().into_iter().map(each).collect::<Vec<_>>()
    };
    let pinholes = path(keys(), true);
    for projection in Projection::ALL {
        let path = path(with(projection), true);
        for step in 0..20 {
            let camera = path.at(f64::from(step) / 2.0).unwrap();
            assert_eq!(camera.projection, projection);
            assert_sound(&camera, projection.name());
            if projection != Projection::Equirectangular {
                let pinhole = pinholes.at(f64::from(step) / 2.0).unwrap();
                assert_eq!(Camera { projection: Projection::Pinhole, ..camera }, pinhole);
            }
        }
    }
    let mut mixed = with(Projection::Fisheye);
    mixed[3].projection = Projection::Orthographic;
    mixed[3].img_name = "plan".into();
    let mut path = path(keys(), false);
    let error = path.set_keys(mixed).unwrap_err().to_string();
    let text = format!(
        "camera path: expected cameras with one projection, found camera 0 and {} more (fisheye), plan (orthographic)",
        keys().len() - 2
    );
    assert!(error.starts_with(&text) && path.keys() == &keys()[..], "{error}");
    path.insert(9, with(Projection::Fisheye).remove(2)).unwrap();
    assert_eq!(path.at(5.0).unwrap().projection, Projection::Pinhole);
}

#[test]
fn the_focal_length_of_a_panorama_takes_no_time() {
    let at = |x: f64, focal: f64| Camera {
        projection: Projection::Equirectangular,
        ..key([x, 0.0, 0.0], [0.0; 3], focal)
    };
    let path = path(vec![at(0.0, 1.0), at(2.0, 500.0), at(4.0, 1.0)], false);
    assert!((path.key_seconds()[1] - 5.0).abs() < 1e-3, "{:?}", path.key_seconds());
    assert!(
        distance(&path.at(2.5).unwrap(), &Camera { position: [1.0, 0.0, 0.0], ..path.at(2.5).unwrap() })
            < 1e-3
    );
}

#[test]
fn a_played_path_runs_by_the_seconds_of_frames_and_an_open_one_ends() {
    let path = path(keys(), false);
    let mut play = Playback::default();
    assert_eq!(play.advance(1.0, &path), None);
    play.play(&path);
    assert_eq!(play.advance(60.0, &path), path.at(0.0));
    assert_eq!(play.advance(2.5, &path), path.at(2.5));
    play.pause();
    assert_eq!((play.advance(1.0, &path), play.position()), (None, 2.5));
    play.seek(7.0, &path);
    play.play(&path);
    assert_eq!(play.advance(0.5, &path), path.at(7.0));
    assert_eq!(play.advance(f64::NAN, &path), path.at(7.0));
    assert_eq!(play.advance(5.0, &path), path.at(10.0));
    assert!(!play.is_playing() && play.position() == 10.0);
    play.play(&path);
    assert_eq!((play.position(), play.is_playing()), (0.0, true));
    for (asked, position) in [(-1.0, 0.0), (f64::NAN, 0.0), (99.0, 10.0)] {
        play.seek(asked, &path);
        assert_eq!(play.position(), position);
    }
}

#[test]
fn a_closed_path_is_played_round_and_round_and_one_without_keys_not_at_all() {
    let closed = path(keys(), true);
    let mut play = Playback::default();
    play.play(&closed);
    play.advance(0.0, &closed);
    play.advance(9.0, &closed);
    play.advance(3.5, &closed);
    assert!(play.is_playing() && (play.position() - 2.5).abs() < 1e-12);
    let empty = path(vec![], true);
    assert_eq!((play.advance(1.0, &empty), play.is_playing()), (None, false));
    play.play(&empty);
    assert!(!play.is_playing());
}

fn wild() -> impl Strategy<Value = f64> {
    let extremes = [0.0, -0.0, 1e-300, 1e-9, 1.0, 1e9, 1e17, -1e17];
    prop_oneof![2 => -10.0..10.0, 1 => prop::sample::select(extremes.to_vec())]
}

fn wild_key() -> impl Strategy<Value = Camera> {
    let angle = prop_oneof![1 => Just(0.0), 1 => Just(PI), 1 => Just(0.5 * PI), 2 => -TAU..TAU];
    let focal = prop_oneof![3 => 10.0..1000.0, 1 => prop::sample::select(vec![1e-19, 1e19])];
    (prop::array::uniform3(wild()), prop::array::uniform3(angle), focal)
        .prop_map(|(position, turn, focal)| key(position, turn, focal))
}

proptest! {
    #[test]
    fn whatever_the_keys_every_camera_is_sound_and_their_times_are_in_order(
        few in prop::collection::vec(wild_key(), 1..5), picks in prop::collection::vec(0..5usize, 0..6),
        closed: bool, frames: bool, radian in prop_oneof![3 => 0.1..10.0f64, 1 => prop::sample::select(vec![0.0, -1.0, f64::NAN, 1e-300, 1e300])],
    ) {
        let keys: Vec<Camera> = few.iter().chain(picks.iter().map(|pick| &few[pick % few.len()])).cloned().collect();
        let mut path = CameraPath::new(radian, [0.0, -1.0, 0.0]);
        path.set_keys(keys.clone()).unwrap();
        path.set_closed(closed);
        path.set_frames(frames);
        for step in 0..=60 {
            let camera = path.at(f64::from(step) / 6.0).unwrap();
            let numbers = [&camera.position[..], camera.rotation.as_flattened(), &[camera.fx, camera.fy]].concat();
            prop_assert!(numbers.iter().all(|v| v.is_finite()), "{camera:?}");
            prop_assert!(camera.fx > 0.0 && camera.fy > 0.0);
            let axes = DMat3::from_cols_array_2d(&camera.axes());
            let error = axes.transpose() * axes - DMat3::IDENTITY;
            prop_assert!(error.to_cols_array().iter().all(|v| v.abs() < 1e-9), "{camera:?}");
            prop_assert!(axes.determinant() > 0.0);
        }
        let times = path.key_seconds();
        prop_assert_eq!(times.len(), keys.len());
        prop_assert!(times.windows(2).all(|pair| pair[0] <= pair[1]) && times.iter().all(|t| (0.0..=10.0).contains(t)));
    }
}
