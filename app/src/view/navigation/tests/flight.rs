//! Tests flights to another camera.

use super::*;

#[test]
fn a_flight_has_the_projection_of_its_destination() {
    let (mut navigation, camera) = projected(Projection::Orthographic);
    navigation.flight_seconds = FLIGHT_SECONDS;
    navigation.set_camera(&Camera { position: [5.0, -4.0, -9.0], ..start() });
    navigation.update(&wait(0.0));
    navigation.update(&wait(0.1));
    assert!(navigation.is_moving() && now(&navigation).projection.is_pinhole());
    navigation.set_camera(&camera);
    navigation.update(&wait(0.0));
    navigation.update(&wait(1.0));
    assert_eq!(now(&navigation), camera);
}

#[test]
fn a_jump_ends_a_flight_and_arrives_at_once() {
    let mut navigation = navigation();
    navigation.flight_seconds = FLIGHT_SECONDS;
    navigation.frame(SIZE);
    let other = Camera::looking_at([-8.0, -3.0, 2.0], [0.0; 3], 40.0, PIXELS);
    navigation.jump_to(&other);
    assert!(!navigation.is_moving());
    assert_eq!(now(&navigation), other);
}

#[test]
fn the_way_to_another_camera_takes_a_moment_and_ends_exactly_there() {
    let mut navigation = navigation();
    navigation.flight_seconds = FLIGHT_SECONDS;
    let other = Camera::looking_at([-8.0, -3.0, 2.0], [0.0; 3], 40.0, PIXELS);
    navigation.set_camera(&other);
    assert!(apart(&now(&navigation), &start()) < 1e-12, "time has not passed yet");
    // Time before the first update does not belong to the flight.
    navigation.update(&wait(60.0));
    assert!(navigation.is_moving() && apart(&now(&navigation), &start()) < 1e-12);
    let mut last = (position(&navigation) - DVec3::from(other.position)).length();
    for _ in 0..6 {
        assert!(navigation.is_moving() && navigation.update(&wait(0.05)));
        let left = (position(&navigation) - DVec3::from(other.position)).length();
        assert!(left < last && left > 0.0, "{left} of {last}");
        last = left;
    }
    navigation.update(&wait(0.06));
    assert!(!navigation.is_moving());
    assert_eq!(now(&navigation), other);
    assert!(!navigation.update(&wait(0.05)), "at rest");
}

#[test]
fn the_user_ends_a_flight_where_it_is() {
    let mut navigation = navigation();
    navigation.flight_seconds = FLIGHT_SECONDS;
    navigation.frame(SIZE);
    for _ in 0..2 {
        navigation.update(&wait(0.1));
    }
    assert!(apart(&now(&navigation), &start()) > 0.1, "on the way");
    let midway = now(&navigation);
    navigation.update(&drag('l', 1.0, 0.0));
    assert!(!navigation.is_moving());
    assert!(apart(&midway, &now(&navigation)) < 0.2);
}
