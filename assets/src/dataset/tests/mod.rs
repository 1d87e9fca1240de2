//! Reads the same cameras from every format, and damaged ones from each.

mod colmap;
mod gltf;
mod photographs;
mod transforms;

use super::*;
use crate::projection::Projection;
use crate::testing::{captures, golden, says};

const ONE: &str = r#"{"id": 3, "img_name": "a", "width": 4, "height": 2, "position": [1, 2, 3.5], "lens": "x",
    "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 5.0, "fy": 6.0}"#;

fn error(text: &str) -> String {
    Camera::parse(text, Path::new("c.json")).unwrap_err().to_string()
}

#[test]
fn the_reference_form_is_read_and_fields_not_known_are_ignored() {
    let cameras = Camera::parse(&format!("[{ONE}, {ONE}]"), Path::new("c.json")).unwrap();
    assert_eq!(cameras.len(), 2);
    assert_eq!((cameras[1].id, cameras[1].position, cameras[1].fy), (3, [1.0, 2.0, 3.5], 6.0));
}

#[test]
fn a_byte_order_mark_before_the_text_is_skipped() {
    let text =
        serde_json::to_string(&[Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 64))]).unwrap();
    let cameras = |text: &str| Camera::parse(text, Path::new("cameras.json")).unwrap();
    assert_eq!(cameras(&format!("\u{feff}{text}")), cameras(&text));
}

#[test]
fn errors_say_line_column_and_which_camera() {
    let missing = error(&format!("[{ONE},\n{}]", ONE.replace("\"fx\"", "\"fz\"")));
    assert!(
        missing.starts_with("c.json:4:") && missing.contains("camera 1: missing field `fx`"),
        "{missing}"
    );
    let skew = error(&format!("[{}]", ONE.replace("[0,1,0]", "[0,1,0.5]")));
    assert!(
        skew.contains("c.json:2:") && skew.contains("camera 0: the rotation is not orthonormal"),
        "{skew}"
    );
    says(error(&format!("[{}]", ONE.replace("[1,0,0]", "[-1,0,0]"))), "mirrors");
    says(error(&format!("[{}]", ONE.replace("5.0", "0"))), "positive fx");
    says(error(&format!("[{}]", ONE.replace(": 4", ": 0"))), "0 x 2 pixels");
    for (from, to, what) in [
        (": 4", ": 1048577", "expected an image of at most 1048576 x 1048576 pixels, found 1048577 x 2"),
        ("5.0", "1e40", "expected fx from 1e-20 to 1e20 pixels, found 1e40"),
        ("6.0", "1e-50", "expected fy from 1e-20 to 1e20 pixels, found "),
        ("3.5", "-1e40", "expected a position within 1e18 of the origin, found z = -1e40"),
        ("3.5", "1e999", "number out of range"),
        ("3.5", "NaN", "`position`: expected a number, found NaN; leave out frames without a pose"),
        ("[0,0,1]", "\n[0,0,-Infinity]", "`rotation`: expected a number, found -Infinity; leave out"),
        ("3.5", "null", "`position`: expected a number, found null; leave out"),
    ] {
        let said = error(&format!("[{ONE}, {}]", ONE.replace(from, to)));
        assert!(said.contains("camera 1: ") && said.contains(what), "{said}");
    }
    let poses = r#"[{"file_path": "images/a.png", "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}]"#;
    says(error(poses), "name the transforms.json of the training instead");
    says(error("{}"), "expected a list of cameras");
    says(error(r#"{"splats": 2, "indices": [0]}"#), "found a selection of splats, which `splatgraph convert");
    says(error(&format!("[{ONE}] x")), "trailing");
    says(error(""), "EOF");
}

#[test]
fn a_camera_is_selected_by_name_or_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.json");
    let mut cameras = vec![Camera::looking_at([0.0; 3], [1.0, 0.5, 2.0], 60.0, (64, 32)); 3];
    for (i, camera) in cameras.iter_mut().enumerate() {
        (camera.id, camera.img_name) = (i as i64, format!("view-{i}"));
    }
    Camera::save(&cameras, &path).unwrap();
    assert_eq!(Camera::load(&path).unwrap(), cameras);
    let select = |suffix: &str| {
        let spec = format!("{}{suffix}", path.display());
        Dataset::select(&spec, CameraOptions::default()).map(Dataset::into_cameras)
    };
    assert_eq!(select("").unwrap(), cameras);
    assert_eq!(select("#2").unwrap(), cameras[2..]);
    assert_eq!(select("#view-1").unwrap(), cameras[1..2]);
    for (camera, ending) in cameras.iter_mut().zip([".png", ".JPG", ".v2"]) {
        camera.img_name += ending;
    }
    Camera::save(&cameras, &path).unwrap();
    let names: Vec<String> = Camera::load(&path).unwrap().into_iter().map(|camera| camera.img_name).collect();
    assert_eq!(
        names,
        ["view-0", "view-1", "view-2.v2"],
        "pictures are named like this, with their own ending"
    );
    assert_eq!(select("#view-1.JPG").unwrap()[0].id, 1);
    says(select("#3").unwrap_err(), "no camera `3`: it has 3, numbered from 0 and named view-0, view-1");
    for (camera, name) in cameras.iter_mut().zip(["0001", "0", "shot.1001.exr"]) {
        camera.img_name = name.into();
    }
    Camera::save(&cameras, &path).unwrap();
    for (wanted, id) in [("0001", 0), ("0", 1), ("1", 1), ("2", 2), ("shot.1001", 2), ("shot.1001.exr", 2)] {
        assert_eq!(select(&format!("#{wanted}")).unwrap()[0].id, id, "{wanted}");
    }
    for (camera, name) in cameras.iter_mut().zip(["front/0001", "back/0000", "front/0000"]) {
        camera.img_name = name.into();
    }
    Camera::save(&cameras, &path).unwrap();
    let ids = |suffix: &str| select(suffix).unwrap().iter().map(|camera| camera.id).collect::<Vec<_>>();
    assert_eq!(
        [ids("#front/*"), ids("#b*"), ids("#*"), ids("#1")],
        [vec![0, 2], vec![1], vec![0, 1, 2], vec![1]]
    );
    // Of the three, back/0000 is the test view.
    let front = Dataset::select(&format!("{}#front/*", path.display()), CameraOptions::default()).unwrap();
    assert!(front.test_views().is_empty());
    says(
        select("#0001").unwrap_err(),
        "no camera `0001`: it has 3, numbered from 0 and named front/0001, back/0000",
    );
    says(select("#left/*").unwrap_err(), "no camera `left/*`");
    cameras[2].img_name = "back/0000".into();
    Camera::save(&cameras, &path).unwrap();
    let same_name = |wanted: &str| {
        let spec = format!("{}#{wanted}", path.display());
        Dataset::select(&spec, CameraOptions::default()).unwrap().same_name
    };
    let found = ["back/0000", "front/0001", "1", "2"].map(same_name);
    assert_eq!(found, [Some((2, 2)), None, None, None], "an index selects one camera");
    Camera::save(&[], &path).unwrap();
    assert!(matches!(select(""), Err(CameraError::Empty { .. })));
    cameras.iter_mut().for_each(|camera| camera.img_name.clear());
    Camera::save(&cameras, &path).unwrap();
    for wanted in ["2", "camera2"] {
        let found = select(&format!("#{wanted}")).unwrap().remove(0);
        assert_eq!((found.id, found.img_name.as_str()), (2, "camera2"), "as its picture is called");
    }
    says(select("#camera3").unwrap_err(), "no camera `camera3`");
}

#[cfg(unix)]
#[test]
fn cameras_that_never_end_or_never_come_are_refused_at_once() {
    let said = |path: &Path| Camera::load(path).unwrap_err().to_string();
    assert_eq!(said(Path::new("/dev/zero")), "/dev/zero: expected a regular file, found a device");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.json");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    assert!(said(&path).ends_with("c.json: expected a regular file, found a FIFO"), "{}", said(&path));
    std::fs::remove_file(&path).unwrap();
    std::fs::File::create(&path).unwrap().set_len(MAX_CAMERA_BYTES + 1).unwrap();
    says(said(&path), "expected a file of at most 268435456 bytes, found 268435457");
}

#[test]
fn the_cameras_of_the_captures_are_read() {
    let check = |folder: &Path, name: &str| {
        let cameras = Camera::load(folder.join(format!("{name}.cameras.json"))).unwrap();
        assert!(cameras.len() >= 3);
        assert!(cameras.iter().enumerate().all(|(i, c)| c.img_name == format!("{name}-{i}")));
    };
    check(&golden(), "rules");
    let Some(captures) = captures("the_cameras_of_the_captures_are_read") else { return };
    ["biker", "playbot-31k"].iter().for_each(|name| check(&captures, name));
}

/// A point of the world, and its pixel in the camera of these tests, computed by hand.
///
/// The camera is at (1, 2, 3) and looks along the world's -x, with the world's +z up, so its right is the world's +y.
/// The point is 4 units in front of it, 2 to the right and 1 below: at 50 + 100 * 2 / 4 and 40 + 80 * 1 / 4.
const KNOWN: ([f64; 3], [f64; 2]) = ([-3.0, 4.0, 2.0], [100.0, 60.0]);

fn pixel(camera: &Camera, point: [f64; 3]) -> [f64; 2] {
    let [x, y, z] = camera.to_view(point);
    [camera.fx * x / z + 0.5 * f64::from(camera.width), camera.fy * y / z + 0.5 * f64::from(camera.height)]
}

fn shows_the_known_point(camera: &Camera) {
    let found = pixel(camera, KNOWN.0);
    assert!((0..2).all(|axis| (found[axis] - KNOWN.1[axis]).abs() < 1e-9), "{found:?}");
}

/// The world-to-camera pose of the known camera in COLMAP's form.
///
/// Rows of the rotation: right (0, 1, 0), down (0, 0, -1), forward (-1, 0, 0). It turns by 120 degrees about
/// (1, 1, -1), so all components of the quaternion are 1/2 or -1/2. The translation is -R (1, 2, 3).
const POSE: [f64; 7] = [0.5, 0.5, 0.5, -0.5, -2.0, 3.0, 1.0];

fn colmap_text(lens: &str, image: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sparse = folder.path().join("sparse/0");
    std::fs::create_dir_all(&sparse).unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    std::fs::write(sparse.join("cameras.txt"), format!("# comment\n{lens}\n")).unwrap();
    std::fs::write(sparse.join("images.txt"), format!("# comment\n# another\n\n{image}\n1.5 2.5 -1 3 4 9\n"))
        .unwrap();
    folder
}

const LENS: &str = "7 PINHOLE 100 80 100 80 50 40";

fn image() -> String {
    let pose = POSE.map(|value| value.to_string()).join(" ");
    format!("3 {pose} 7 left/a photo.JPG")
}

#[test]
fn a_principal_point_aside_is_read_from_every_format_and_scaled_with_the_picture() {
    let folder = colmap_text("7 PINHOLE 100 80 100 80 51 37.5", &image());
    let camera = Dataset::load(folder.path()).unwrap().views.remove(0).camera;
    assert_eq!((camera.principal_offset, camera.principal_point()), ([1.0, -2.5], [51.0, 37.5]));
    assert_eq!(
        (camera.resized(200, 40).principal_offset, camera.stretched(200, 40).principal_offset),
        ([0.5, -1.25], [2.0, -1.25])
    );
    let parse = |text: &str| {
        Dataset::parse(text, Path::new("t.json")).map(|dataset| dataset.views[0].camera.principal_offset)
    };
    assert_eq!(parse(&nerfstudio("\"cx\": 50, \"cy\": 41.25,", "\"cx\": 46,")).unwrap(), [-4.0, 1.25]);
    let text = serde_json::to_string(&camera).unwrap();
    assert!(text.contains("\"cx\":51.0,\"cy\":37.5}"), "{text}");
    assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), camera);
    assert_eq!(parse(&format!("[{}]", ONE.replace("6.0", "6.0, \"cy\": 0.5"))).unwrap()[0], 0.0);
    let panorama = "\"cx\": 49.5, \"camera_model\": \"EQUIRECTANGULAR\",";
    assert_eq!(parse(&nerfstudio("", panorama)).unwrap(), [0.0; 2]);
    for (model, cx, said) in [
        (
            "OPENCV",
            "1e9",
            "expected the principal point within 1048576 pixels of the middle, found cx = 1000000000",
        ),
        (
            "EQUIRECTANGULAR",
            "48",
            "expected the principal point within a pixel of the middle of a panorama, found cx = 48",
        ),
    ] {
        let text = nerfstudio("", &format!("\"cx\": {cx}, \"camera_model\": \"{model}\","));
        let error = parse(&text).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    }
}

/// The camera-to-world pose of the known camera in the axes of OpenGL. Columns: right (0, 1, 0), up (0, 0, 1), backward
/// (1, 0, 0), and the position.
const MATRIX: &str = "[[0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]";

fn nerfstudio(of_file: &str, of_frame: &str) -> String {
    format!(
        "{{{of_file}\n\"frames\": [{{\"file_path\": \"images/f.jpg\", {of_frame}\n\"transform_matrix\": {MATRIX}}}],\n\
         \"w\": 100, \"h\": 80.0, \"fl_x\": 100, \"fl_y\": 80, \"k1\": 0, \"camera_model\": \"OPENCV\"}}"
    )
}

#[test]
fn a_file_that_is_no_camera_file_lists_the_formats() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in [("tum.txt", "# time\n1.0 0 0 0 0 0 0 1\n".as_bytes()), ("a.npy", b"\x93NUMPY")] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let said = Camera::load(&path).unwrap_err().to_string();
        assert!(said.contains("expected cameras in JSON (cameras.json, transforms.json"), "{said}");
    }
}

#[test]
fn a_folder_without_cameras_says_what_was_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    let said = Dataset::load(folder.path()).unwrap_err().to_string();
    assert!(
        said.contains("expected cameras.json, transforms.json") && said.ends_with("found none of them"),
        "{said}"
    );
}

#[test]
fn a_lens_with_distortion_in_a_cameras_json_is_refused() {
    let camera = Camera::looking_at([0.0; 3], [1.0, 0.5, 2.0], 60.0, (64, 32));
    let text = serde_json::to_string(&camera).unwrap();
    let parse = |more: &str| {
        let text = text.replacen('{', &format!("{{{more},"), 1);
        Camera::parse(&format!("[{text}]"), Path::new("cameras.json")).map_err(|error| error.to_string())
    };
    let unused = r#""k1": 0, "k2": null, "distortion": [0, 0.0], "camera_model": "OPENCV", "exposure": 2"#;
    assert_eq!(parse(unused), Ok(vec![camera]));
    for (more, what) in [
        (r#""k1": 0.3"#, "`k1`: expected 0, a lens without distortion, found 0.3"),
        (r#""distortion": [0, 0, -0.1]"#, "`distortion`: expected 0, a lens without distortion, found -0.1"),
        (r#""dist_coeffs": [0.1]"#, "`dist_coeffs`: expected 0, a lens without distortion, found 0.1"),
        (
            r#""camera_model": "SIMPLE_RADIAL", "params": [50, 32, 16, 0.1]"#,
            "`params`: k: expected 0, a lens without distortion, found 0.1",
        ),
        (
            r#""camera_model": "OPENCV_FISHEYE""#,
            "`projection`: expected fisheye, that of the `camera_model` OPENCV_FISHEYE, found pinhole",
        ),
    ] {
        says(parse(more).unwrap_err(), what);
    }
}
