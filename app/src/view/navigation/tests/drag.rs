//! Tests orbiting, panning and zooming.

use super::*;

#[test]
fn orbiting_keeps_the_distance_and_leaves_the_pivot_on_its_pixel() {
    for input in [drag('l', 130.0, -55.0), drag('m', -310.0, 80.0)] {
        let mut navigation = navigation();
        let (pivot, before) = (navigation.pivot(), now(&navigation));
        assert!(navigation.update(&input));
        let after = now(&navigation);
        assert!(close(navigation.pivot(), pivot, 1e-12));
        let [x, y] = pixel(&after, pivot);
        assert!((x - 431.0).abs() < 1e-9 && (y - 288.0).abs() < 1e-9, "({x}, {y})");
        let distance = |c: &Camera| (DVec3::from(c.position) - pivot).length();
        assert!((distance(&after) - distance(&before)).abs() < 1e-12);
        assert!(apart(&before, &after) > 0.1);
    }
}

#[test]
fn orbiting_turns_the_near_side_after_the_pointer() {
    let mut navigation = navigation();
    navigation.set_camera(&Camera::looking_at([1.0, 0.5, -20.0], [1.0, 0.5, 1.0], 60.0, PIXELS));
    let near = navigation.pivot() - DVec3::Z;
    let [x, y] = pixel(&now(&navigation), near);
    navigation.update(&drag('l', 30.0, 20.0));
    let [moved_x, moved_y] = pixel(&now(&navigation), near);
    assert!(moved_x > x + 1.0 && moved_y > y + 1.0, "({x}, {y}) to ({moved_x}, {moved_y})");
}

#[test]
fn orbiting_keeps_the_horizon_as_it_is() {
    let mut navigation = navigation();
    let roll = |n: &Navigation| {
        let [right, _, forward] = now(n).axes().map(DVec3::from);
        right.dot(n.up()) / forward.cross(n.up()).length()
    };
    let before = roll(&navigation);
    assert!(before.abs() > 0.1, "the camera is askew");
    for _ in 0..50 {
        navigation.update(&drag('l', 37.0, 3.0));
        navigation.update(&drag('r', -11.0, -2.0));
    }
    assert!((roll(&navigation) - before).abs() < 1e-9);
}

#[test]
fn orbiting_and_looking_stop_short_of_the_poles() {
    for (button, y) in [('l', 1e4), ('l', -1e4), ('r', 1e4), ('r', -1e4)] {
        let mut navigation = navigation();
        navigation.update(&drag(button, 0.0, y));
        let elevation = forward(&navigation).dot(navigation.up()).asin().to_degrees();
        assert!((elevation.abs() - 89.9).abs() < 1e-6, "{elevation}");
        assert_eq!(elevation > 0.0, y < 0.0);
        let stopped = now(&navigation);
        navigation.update(&drag(button, 0.0, y));
        assert!(apart(&stopped, &now(&navigation)) < 1e-9);
        // The way back from the limit is not restricted.
        navigation.update(&drag(button, 0.0, -y.signum() * 100.0));
        let back = forward(&navigation).dot(navigation.up()).asin().to_degrees();
        assert!((back.abs() - 59.9).abs() < 1e-6, "{back}");
    }
}

#[test]
fn a_camera_that_is_upside_down_is_turned_after_the_pointer_too() {
    for button in ['l', 'r'] {
        let mut navigation = navigation();
        let mut camera = Camera::looking_at([1.0, -3.0, -20.0], [1.0, 0.5, 1.0], 60.0, PIXELS);
        let roll = DMat3::from_axis_angle(DVec3::from(camera.axes()[2]), std::f64::consts::PI);
        let rotation = roll * DMat3::from_cols_array_2d(&camera.rotation).transpose();
        camera.rotation = rotation.transpose().to_cols_array_2d();
        navigation.set_camera(&camera);
        let near = navigation.pivot() - DVec3::Z;
        let [x, y] = pixel(&now(&navigation), near);
        navigation.update(&drag(button, 30.0, 20.0));
        let [moved_x, moved_y] = pixel(&now(&navigation), near);
        // When orbiting, the near side follows the pointer; when looking around, everything moves against it.
        let sense = if button == 'l' { 1.0 } else { -1.0 };
        let moved = [sense * (moved_x - x), sense * (moved_y - y)];
        assert!(moved[0] > 1.0 && moved[1] > 1.0, "{button}: {moved:?}");
    }
}

#[test]
fn a_camera_that_looks_straight_up_or_down_can_be_turned() {
    for y in [-50.0, 50.0] {
        let mut navigation = navigation();
        navigation.set_camera(&Camera::looking_at([1.0, 0.5, 1.0], [1.0, y, 1.0], 60.0, PIXELS));
        assert!(forward(&navigation).dot(navigation.up()).abs() == 1.0);
        navigation.update(&drag('l', 25.0, -y.signum() * 30.0));
        let steep = forward(&navigation).dot(navigation.up()).asin().to_degrees().abs();
        assert!((80.0..82.0).contains(&steep), "{steep}");
        assert_sound(&navigation);
    }
}

#[test]
fn panning_keeps_the_grabbed_point_under_the_pointer() {
    for input in [drag('m', 75.0, -120.0), drag('l', -40.0, 15.0)] {
        let mut navigation = navigation();
        let depth = navigation.pose.distance;
        let grabbed = point(&now(&navigation), [200.0, 450.0], depth);
        navigation.update(&with("shift", input));
        let [x, y] = pixel(&now(&navigation), grabbed);
        let [dx, dy] = input.moved;
        assert!((x - 200.0 - dx).abs() < 1e-9 && (y - 450.0 - dy).abs() < 1e-9, "({x}, {y})");
        assert!(close(forward(&navigation), DVec3::from(start().axes()[2]), 1e-12));
    }
}

#[test]
fn zooming_in_and_out_again_returns() {
    let scroll = |scroll| Input { size: SIZE, scroll, ..Input::default() };
    let by_drag = |y| with("ctrl", drag('m', 0.0, y));
    for (there, back) in [(scroll(7.0), scroll(-7.0)), (by_drag(-240.0), by_drag(240.0))] {
        let mut navigation = navigation();
        let (before, distance, pivot) = (now(&navigation), navigation.pose.distance, navigation.pivot());
        navigation.update(&there);
        assert!(navigation.pose.distance < 0.5 * distance, "nearer");
        assert!(close(navigation.pivot(), pivot, 1e-12));
        navigation.update(&back);
        assert!(apart(&before, &now(&navigation)) < 1e-12);
    }
}

#[test]
fn zooming_never_goes_through_the_pivot_and_comes_back_from_everywhere() {
    let mut navigation = navigation();
    let (pivot, forward_before) = (navigation.pivot(), forward(&navigation));
    navigation.update(&Input { scroll: 1e12, ..Input::default() });
    let near = (pivot - position(&navigation)).dot(forward_before);
    assert!(near > 0.0 && near < 1e-4, "{near}");
    navigation.update(&Input { scroll: -1e12, ..Input::default() });
    let far = (pivot - position(&navigation)).dot(forward_before);
    assert!((1e4..1e6).contains(&far), "{far}");
    navigation.update(&Input { scroll: 1.0, ..Input::default() });
    assert!((pivot - position(&navigation)).length() < far);
}
