//! Reads the cameras of glTF files.

use super::*;

/// Writes a glTF file with two cameras, its text changed by `change`, and reads them.
fn gltf(change: impl Fn(String) -> String) -> Result<Vec<Camera>, String> {
    gltf_dataset(change).map(Dataset::into_cameras)
}

fn gltf_dataset(change: impl Fn(String) -> String) -> Result<Dataset, String> {
    let text = r#"{"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_unknown"], "scene": 0, "scenes": [{"nodes": [2, 0]}],
        "nodes": [{"children": [1], "translation": [0, 0, 2]},
                  {"name": "front", "camera": 1, "translation": [0, 0, 3], "scale": [2, 3, 4]},
                  {"camera": 0, "rotation": [0, 0.7071067811865476, 0, 0.7071067811865476]},
                  {"name": "not in the scene", "camera": 0}],
        "cameras": [{"name": "wide", "type": "perspective", "perspective": {"yfov": 1.5707963267948966, "aspectRatio": 2, "znear": 0.1}},
                    {"type": "orthographic", "orthographic": {"xmag": 4, "ymag": 3, "znear": 0.1, "zfar": 9}}]}"#;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.gltf");
    std::fs::write(&path, change(text.into())).unwrap();
    Dataset::load(&path).map_err(|error| error.to_string().replace(&path.display().to_string(), "FILE"))
}

#[test]
fn cameras_of_gltf_are_pinholes_or_orthographic() {
    let cameras = gltf(|text| text).unwrap();
    let [front, wide] = cameras.as_slice() else { panic!("{cameras:#?}") };
    assert_eq!((front.img_name.as_str(), front.projection), ("front", Projection::Orthographic));
    // The view is 8 units wide and 6 high.
    assert_eq!((front.width, front.height, front.fx, front.fy), (960, 720, 120.0, 120.0));
    // The point (1, 2, 0) in glTF: 1 to the right of the optical axis, 2 above it, and 5 in front of the camera.
    let view = front.to_view([-1.0, -2.0, 0.0]);
    assert!((0..3).all(|axis| (view[axis] - [1.0, -2.0, 5.0][axis]).abs() < 1e-9), "{view:?}");

    assert_eq!((wide.img_name.as_str(), wide.projection), ("wide", Projection::Pinhole));
    assert_eq!((wide.width, wide.height), (1440, 720));
    // 90 degrees from top to bottom.
    assert!((wide.fx - 360.0).abs() < 1e-9 && (wide.fy - 360.0).abs() < 1e-9, "{wide:?}");
    // Turned to the left, it looks along -x.
    let view = wide.to_view([3.0, 0.0, 0.0]);
    assert!((0..3).all(|axis| (view[axis] - [0.0, 0.0, 3.0][axis]).abs() < 1e-9), "{view:?}");
}

#[test]
fn nodes_that_mirror_or_skew_a_camera_turn_it_without_that() {
    let front = |text: &'static str| gltf(|all| all.replace("[2, 3, 4]", text)).unwrap().remove(0);
    assert_eq!(front("[-2, 3, 4]"), front("[2, 3, 4]"));
    // The node above skews x and y: the camera keeps the direction of z, and that of y, which is (-1, 5) here.
    let rotated = "[2, 3, 4], \"rotation\": [0, 0, 0.3826834323650898, 0.9238795325112867]";
    let skewed =
        gltf(|all| all.replace("[0, 0, 2]", "[0, 0, 2], \"scale\": [1, 5, 1]").replace("[2, 3, 4]", rotated));
    let view = skewed.unwrap()[0].to_view([1.0, -5.0, 0.0]);
    let expected = [0.0, -26f64.sqrt(), 5.0];
    assert!((0..3).all(|axis| (view[axis] - expected[axis]).abs() < 1e-9), "{view:?}");
}

#[test]
fn an_animation_of_a_camera_or_of_a_node_above_it_is_found() {
    for (node, is_found) in [(0, true), (2, true), (3, false)] {
        let channel =
            format!(r#""animations": [{{"channels": [{{"target": {{"node": {node}}}}}]}}], "scene""#);
        let dataset = gltf_dataset(|text| text.replacen("\"scene\"", &channel, 1)).unwrap();
        assert_eq!(dataset.has_animation, is_found, "{node}");
    }
}

#[test]
fn a_camera_of_gltf_that_cannot_be_drawn_is_told_by_its_node() {
    let said = |from: &str, to: &str| gltf(|text| text.replace(from, to)).unwrap_err();
    says(said("\"ymag\": 3", "\"ymag\": 0"), "FILE: `nodes[1].camera`: expected a positive ymag, found 0");
    says(said("\"yfov\": 1.5", "\"yfov\": 4.5"), "`nodes[2].camera`: expected a yfov below pi");
    says(said("\"orthographic\": {", "\"other\": {"), "expected either perspective or orthographic");
    says(said("\"camera\": 1", "\"camera\": 7"), "`nodes.camera`: expected an index below 2, found 7");
    let found = said("\"camera\"", "\"extras\"");
    assert_eq!(found, "FILE has no cameras");
    says(said("[2, 3, 4]", "[0, 0, 0]"), "`nodes[1].camera`: the rotation is not orthonormal");
    says(said("{\"asset\"", "["), "the JSON of glTF");
}
