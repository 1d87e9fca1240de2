//! Tests flying and looking around.

use super::*;

#[test]
fn flying_forward_goes_along_the_view_at_the_speed_that_is_said() {
    let mut navigation = navigation();
    let (from, ahead, distance) = (position(&navigation), forward(&navigation), navigation.pose.distance);
    let speed = navigation.fly_speed();
    assert!((speed - 0.2 * 8.0).abs() < 1e-12, "scaled to the scene");
    let mut input = Input { fly: [0.0, 0.0, 1.0], ..wait(0.5) };
    assert!(!navigation.update(&input), "only with the button");
    input.flies = true;
    assert!(navigation.update(&input));
    assert!(close(position(&navigation), from + ahead * 0.5 * speed, 1e-12));
    assert_eq!(navigation.pose.distance, distance, "the pivot comes along");

    let length = |navigation: &mut Navigation, input: &Input| {
        let from = position(navigation);
        navigation.update(input);
        (position(navigation) - from).length()
    };
    let usual = length(&mut navigation, &input);
    assert!((length(&mut navigation, &with("shift", input)) / usual - 4.0).abs() < 1e-9);
    assert!((length(&mut navigation, &with("ctrl", input)) / usual - 0.25).abs() < 1e-9);
    let faster = length(&mut navigation, &Input { scroll: 3.0, ..input });
    assert!((faster / usual - 1.2f64.powi(3)).abs() < 1e-9);
    assert!((length(&mut navigation, &input) / faster - 1.0).abs() < 1e-9, "the speed stays");
    input.fly[0] = 1.0;
    assert!((length(&mut navigation, &input) / faster - 1.0).abs() < 1e-9, "not faster askew");
}

#[test]
fn flying_askew_ends_at_the_farthest_distance() {
    let mut navigation = navigation();
    // At the highest speed, which is 800 sizes of the scene per second.
    let input = Input { fly: [1.0, 1.0, -1.0], flies: true, scroll: 100.0, ..with("shift", wait(1.0)) };
    let mut farther = || {
        navigation.update(&input);
        (position(&navigation) - DVec3::from(bounds().center())).length()
    };
    let limit = (0..3000).map(|_| farther()).last().unwrap();
    assert!(limit >= FARTHEST, "{limit}");
    for _ in 0..3 {
        assert!((farther() / limit - 1.0).abs() < 1e-6);
    }
}

#[test]
fn every_key_of_flying_goes_its_own_way() {
    let start = now(&navigation());
    let [right, _, ahead] = start.axes().map(DVec3::from);
    for (fly, way) in [
        ([0.0, 0.0, 1.0], ahead),
        ([0.0, 0.0, -1.0], -ahead),
        ([1.0, 0.0, 0.0], right),
        ([-1.0, 0.0, 0.0], -right),
        ([0.0, 1.0, 0.0], DEFAULT_UP),
        ([0.0, -1.0, 0.0], -DEFAULT_UP),
    ] {
        let mut navigation = navigation();
        navigation.update(&Input { flies: true, fly, ..wait(0.25) });
        let moved = position(&navigation) - DVec3::from(start.position);
        assert!(close(moved.normalize(), way, 1e-9), "{fly:?}: {moved}");
    }
}

#[test]
fn looking_around_stays_in_place_and_turns_where_the_pointer_goes() {
    let mut navigation = navigation();
    let from = position(&navigation);
    let target = navigation.pivot();
    navigation.update(&drag('r', 40.0, 30.0));
    assert!(close(position(&navigation), from, 1e-12));
    let [x, y] = pixel(&now(&navigation), target);
    assert!(x < 395.0 && y < 295.0, "to the right and down, so that it is left and above: ({x}, {y})");
}

#[test]
fn the_arrow_keys_orbit_and_the_camera_goes_where_they_point() {
    for (orbit, axis, sign) in
        [([-1.0, 0.0], 0, -1.0), ([1.0, 0.0], 0, 1.0), ([0.0, -1.0], 1, -1.0), ([0.0, 1.0], 1, 1.0)]
    {
        let mut navigation = navigation();
        navigation.set_camera(&Camera::looking_at([1.0, 0.5, -20.0], [1.0, 0.5, 1.0], 60.0, PIXELS));
        let (pivot, before) = (navigation.pivot(), now(&navigation));
        navigation.update(&Input { orbit, ..wait(0.1) });
        let moved = before.to_view(now(&navigation).position);
        assert!(moved[axis] * sign > 0.5, "{orbit:?}: {moved:?}");
        assert!(close(navigation.pivot(), pivot, 1e-12));
    }
}
