//! Reads the same cameras from every format, and damaged ones from each.

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
    ] {
        let said = error(&format!("[{ONE}, {}]", ONE.replace(from, to)));
        assert!(said.contains("camera 1: ") && said.contains(what), "{said}");
    }
    says(error("{}"), "expected a list of cameras");
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
    Camera::save(&[], &path).unwrap();
    assert!(matches!(select(""), Err(CameraError::Empty { .. })));
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
fn colmap_text_shows_a_known_point_at_its_pixel() {
    let folder = colmap_text(LENS, &format!("{}\n\n{}", image(), image().replace("a photo", "b")));
    let dataset = Dataset::load(folder.path()).unwrap();
    assert_eq!(dataset.views.len(), 2, "an empty line of points is one");
    let view = &dataset.views[0];
    shows_the_known_point(&view.camera);
    assert_eq!(
        (view.camera.id, view.camera.img_name.as_str(), view.photograph.as_str()),
        (3, "left/a photo", "left/a photo.JPG")
    );
    assert_eq!(dataset.photographs, Some(folder.path().canonicalize().unwrap().join("images")));
    // The folder of the model, and a file in it, give the same dataset.
    for path in ["sparse/0", "sparse/0/images.txt"] {
        assert_eq!(Dataset::load(folder.path().join(path)).unwrap(), dataset, "{path}");
    }
}

/// Builds `cameras.bin` and `images.bin` of a model with two images, each with `points` points.
fn colmap_binary(model: u32, parameters: &[f64], points: u64) -> [Vec<u8>; 2] {
    let mut lenses = 1u64.to_le_bytes().to_vec();
    lenses.extend([7, model].map(u32::to_le_bytes).as_flattened());
    lenses.extend([100u64, 80].map(u64::to_le_bytes).as_flattened());
    lenses.extend(parameters.iter().flat_map(|value| value.to_le_bytes()));
    let mut images = 2u64.to_le_bytes().to_vec();
    for (id, name) in [(3u32, "a.jpg"), (4, "b.jpg")] {
        images.extend(id.to_le_bytes());
        images.extend(POSE.map(f64::to_le_bytes).as_flattened());
        images.extend(7u32.to_le_bytes());
        images.extend(name.bytes().chain([0]));
        images.extend(points.to_le_bytes());
        images.extend(vec![9; 24 * points as usize]);
    }
    [lenses, images]
}

fn write_binary(folder: &Path, [lenses, images]: [Vec<u8>; 2]) {
    std::fs::write(folder.join("cameras.bin"), lenses).unwrap();
    std::fs::write(folder.join("images.bin"), images).unwrap();
}

#[test]
fn colmap_binary_shows_a_known_point_at_its_pixel() {
    let folder = tempfile::tempdir().unwrap();
    write_binary(folder.path(), colmap_binary(1, &[100.0, 80.0, 50.0, 40.0], 1000));
    let dataset = Dataset::load(folder.path()).unwrap();
    assert_eq!(dataset.views.len(), 2);
    dataset.views.iter().for_each(|view| shows_the_known_point(&view.camera));
    assert_eq!((dataset.views[1].camera.id, dataset.photographs), (4, None));
}

#[test]
fn a_lens_without_distortion_is_a_pinhole_by_any_name_and_one_with_it_is_refused() {
    for (lens, fy) in [
        ("7 SIMPLE_PINHOLE 100 80 100 50 40", 100.0),
        ("7 SIMPLE_RADIAL 100 80 100 50 40 0", 100.0),
        ("7 OPENCV 100 80 100 80 50 40 0 0 0 0.0", 80.0),
    ] {
        let folder = colmap_text(lens, &image());
        let [view] = Dataset::load(folder.path()).unwrap().views.try_into().unwrap();
        assert_eq!((view.camera.fx, view.camera.fy), (100.0, fy), "{lens}");
    }
    let ideal = CameraOptions { ignore_distortion: true, ..CameraOptions::default() };
    for (lens, projection) in [
        ("7 OPENCV 100 80 100 80 50 40 0.1 0.2 0 1e-9", Projection::Pinhole),
        ("7 OPENCV_FISHEYE 100 80 100 80 50 40 0 0.1 0 0", Projection::Fisheye),
    ] {
        let dataset = Dataset::load_with(colmap_text(lens, &image()).path(), ideal).unwrap();
        let camera = &dataset.views[0].camera;
        assert_eq!((camera.projection, camera.fx, camera.fy), (projection, 100.0, 80.0), "{lens}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, nerfstudio("", "\"k1\": 0.1, \"distortion_params\": [0, 0.2],")).unwrap();
    shows_the_known_point(&Dataset::load_with(&path, ideal).unwrap().views[0].camera);
    says(Dataset::load(&path).unwrap_err(), "draw an ideal lens with `render --ignore-distortion`");
    for (lens, what) in [
        (
            "7 SIMPLE_RADIAL 100 80 100 50 40 0.01",
            "`k`: expected 0, a lens without distortion, found 0.01; undistort",
        ),
        (
            "7 OPENCV 100 80 100 80 50 40 0 0 0 1e-9",
            "`p2`: expected 0, a lens without distortion, found 0.000000001; undistort",
        ),
        (
            "7 OPENCV_FISHEYE 100 80 100 80 50 40 0 0.1 0 0",
            "`k2`: expected 0, a lens without distortion, found 0.1; undistort",
        ),
        (
            "7 FOV 100 80 100 80 50 40 0",
            "`MODEL`: expected a pinhole or fisheye camera, found FOV; undistort",
        ),
        (
            "7 PINHOL 100 80 100 80 50 40",
            "`MODEL`: expected a model of a camera, for instance PINHOLE, found `PINHOL`; did you mean PINHOLE?",
        ),
        ("7 PINHOLE 100 eighty 100 80 50 40", "`HEIGHT`: expected a number, found `eighty`"),
        ("7 PINHOLE 100 80 100 80 50", "`cy`: expected a value, found the end of the line"),
    ] {
        let said = Dataset::load(colmap_text(lens, &image()).path()).unwrap_err().to_string();
        assert!(said.contains("cameras.txt:2: ") && said.contains(what), "{said}");
    }
}

#[test]
fn a_fisheye_without_distortion_is_equidistant_and_a_panorama_needs_no_focal_length() {
    for (lens, fy) in [
        ("7 OPENCV_FISHEYE 100 80 100 80 50 40 0 0 0 0", 80.0),
        ("7 SIMPLE_RADIAL_FISHEYE 100 80 100 50 40 0", 100.0),
        ("7 RADIAL_FISHEYE 100 80 100 50 40 0 0", 100.0),
    ] {
        let folder = colmap_text(lens, &image());
        let [view] = Dataset::load(folder.path()).unwrap().views.try_into().unwrap();
        let camera = &view.camera;
        assert_eq!((camera.projection, camera.fx, camera.fy), (Projection::Fisheye, 100.0, fy), "{lens}");
    }
    let parse = |of_frame: &str| {
        let dataset = Dataset::parse(&nerfstudio("", of_frame), Path::new("transforms.json"));
        dataset.map(|mut dataset| dataset.views.remove(0).camera).map_err(|error| error.to_string())
    };
    for fisheye in ["\"camera_model\": \"OPENCV_FISHEYE\",", "\"is_fisheye\": true,"] {
        let camera = parse(fisheye).unwrap();
        assert_eq!((camera.projection, camera.fx, camera.fy), (Projection::Fisheye, 100.0, 80.0));
    }
    says(parse("\"is_fisheye\": true, \"k1\": 0.5,").unwrap_err(), "`k1`: expected 0");
    let text = nerfstudio("", "\"camera_model\": \"EQUIRECTANGULAR\",");
    let bare = text.replace("\"fl_x\": 100, \"fl_y\": 80, ", "");
    let camera = Dataset::parse(&bare, Path::new("transforms.json")).unwrap().views.remove(0).camera;
    assert_eq!(camera.projection, Projection::Equirectangular);
    assert_eq!(camera.focal(), [100.0 / std::f64::consts::TAU, 80.0 / std::f64::consts::PI]);
}

#[test]
fn damaged_images_of_colmap_are_told_with_line_or_byte_and_field() {
    let said = |image: &str| Dataset::load(colmap_text(LENS, image).path()).unwrap_err().to_string();
    for (from, to, what) in [
        (" 7 left", " 8 left", "`CAMERA_ID`: expected 7, the only ID of cameras, found 8"),
        ("left/a photo.JPG", "", "`NAME`: expected a value, found the end of the line"),
        ("3 0.5 0.5 0.5 -0.5", "3 0 0 0 0", "`QW`: expected a quaternion other than zero, found 0 0 0 0"),
        ("-2 3 1", "-2 3 x", "`TZ`: expected a number, found `x`"),
        ("-2 3 1", "-2 3 nan", "`IMAGE_ID`: expected a position within 1e18 of the origin"),
    ] {
        let said = said(&image().replace(from, to));
        assert!(said.contains("images.txt:4: ") && said.contains(what), "{said}");
    }
    // Without the lines of points, each second image would be taken for points.
    let found = said(&format!("{}\n{}", image(), image()));
    assert!(
        found.contains("images.txt:5: `POINTS2D`: expected the points of the image above as triples")
            && found.ends_with("or an empty line, found `left/a`"),
        "{found}"
    );
    assert!(said(&format!("{}\n1 2", image())).ends_with("found 2 numbers"));
    let padded = |bytes: usize| image() + &" ".repeat(bytes - image().len());
    assert!(Dataset::load(colmap_text(LENS, &padded(65_536)).path()).is_ok());
    assert!(said(&padded(65_537)).ends_with("`line`: expected at most 65536 bytes, found more"));
    let folder = tempfile::tempdir().unwrap();
    let said = |files: [Vec<u8>; 2]| {
        write_binary(folder.path(), files);
        Dataset::load(folder.path()).unwrap_err().to_string()
    };
    let whole = || colmap_binary(1, &[100.0, 80.0, 50.0, 40.0], 2);
    let damaged = |file: usize, at: usize, bytes: &[u8]| {
        let mut files = whole();
        files[file][at..at + bytes.len()].copy_from_slice(bytes);
        files
    };
    let cases: [(usize, usize, &[u8], &str); 7] = [
        (0, 0, &[255; 8], "cameras.bin: byte 0, `num_cameras`: expected at most 1, as the rest"),
        (0, 12, &[99], "cameras.bin: byte 12, `MODEL`: expected a model of 0 to 10, found 99"),
        (0, 24, &[0; 8], "images.bin: byte 8, `IMAGE_ID`: the image is 100 x 0 pixels"),
        (
            0,
            16,
            &[255; 4],
            "images.bin: byte 8, `IMAGE_ID`: expected an image of at most 1048576 x 1048576 pixels",
        ),
        (1, 68, &[9], "images.bin: byte 68, `CAMERA_ID`: expected 7, the only ID of cameras, found 9"),
        (1, 78, &[255; 7], "images.bin: byte 78, `num_points2D`: expected at most "),
        (1, 72, &[0xFF], "images.bin: byte 72, `NAME`: expected UTF-8 text"),
    ];
    for (file, at, bytes, expected) in cases {
        let found = said(damaged(file, at, bytes));
        assert!(found.contains(expected), "{found}; expected {expected}");
    }
    let distorted = colmap_binary(2, &[100.0, 50.0, 40.0, 0.5], 2);
    says(said(distorted), "cameras.bin: byte 56, `k`: expected 0, a lens without distortion, found 0.5");
    for file in 0..2 {
        for end in 0..whole()[file].len() {
            let mut files = whole();
            files[file].truncate(end);
            assert!(said(files).contains("byte "), "{file} {end}");
        }
    }
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
fn transforms_show_a_known_point_at_its_pixel_and_a_frame_has_the_last_word() {
    let parse = |text: &str| Dataset::parse(text, Path::new("folder/transforms.json"));
    let dataset = parse(&nerfstudio("", "")).unwrap();
    shows_the_known_point(&dataset.views[0].camera);
    assert_eq!(dataset.photographs, Some("folder".into()));
    assert_eq!(dataset.views[0].camera.img_name, "images/f");
    for (file, name) in [("shot.1001", "shot.1001"), ("./a/shot.0002.EXR", "a/shot.0002"), ("a.L", "a.L")] {
        let dataset = parse(&nerfstudio("", "").replace("images/f.jpg", file)).unwrap();
        assert_eq!(dataset.views[0].camera.img_name, name);
    }
    let own = parse(&nerfstudio("", "\"fl_x\": 55,")).unwrap();
    assert_eq!((own.views[0].camera.fx, own.views[0].camera.fy), (55.0, 80.0));
    let own = parse(&nerfstudio("\"is_fisheye\": true,", "\"is_fisheye\": false,")).unwrap();
    assert_eq!(own.views[0].camera.projection, Projection::Pinhole);
    assert!(!own.has_masks && parse(&nerfstudio("", "\"mask_path\": \"m.png\",")).unwrap().has_masks);
    for (of_frame, what) in [
        ("\"k1\": 0.1,", "`k1`: expected 0, a lens without distortion, found 0.1; undistort"),
        (
            "\"distortion_params\": [0, 0.2],",
            "`distortion_params`: expected 0, a lens without distortion, found 0.2; undistort",
        ),
        (
            "\"camera_model\": \"FISHEYE624\",",
            "`camera_model`: expected PINHOLE, OPENCV_FISHEYE, EQUIRECTANGULAR or another model without distortion, found FISHEYE624",
        ),
        ("\"w\": 10.5,", "`w`: expected a number of pixels, found 10.5"),
        ("\"transform_matrix\": 1,", "invalid type: integer `1`"),
        ("\"transform_matrix\": [[1, 2, 3]],", "expected a number or 4 numbers in a row of the matrix"),
        (
            "\"transform_matrix\": [1, 2, 3],",
            "expected a matrix of 3 or 4 rows of 4 numbers, found 3 numbers",
        ),
    ] {
        let said = parse(&nerfstudio("", of_frame)).unwrap_err().to_string();
        assert!(said.starts_with("folder/transforms.json:") && said.contains(what), "{said}");
    }
    let skewed = nerfstudio("", "").replace("[1, 0, 0, 2]", "[2, 0, 0, 2]");
    let said = parse(&skewed).unwrap_err().to_string();
    assert!(
        said.contains("transforms.json:3:") && said.contains("camera 0: the rotation is not orthonormal"),
        "{said}"
    );
}

#[test]
fn a_path_of_nerfstudio_and_a_matrix_of_three_rows_show_the_known_point() {
    let path = |kind: &str, pose: &str| {
        let text = format!(
            "{{\"keyframes\": [{{\"matrix\": \"[1]\"}}], \"camera_type\": \"{kind}\", \"render_height\": 80, \"render_width\": 100, \
             \"camera_path\": [{{\"camera_to_world\": {pose}, \"fov\": 53.13010235415598, \"aspect\": 1.25}}], \"fps\": 24}}"
        );
        Camera::parse(&text, Path::new("camera_path.json"))
    };
    let rows = MATRIX.replace(", [0, 0, 0, 1]]", "]");
    let flat = format!("[{}]", MATRIX.replace(['[', ']'], ""));
    for pose in [MATRIX, rows.as_str(), flat.as_str()] {
        let camera = path("perspective", pose).unwrap().remove(0);
        // The known camera has fx = 100; a path has one focal length, from the height: 80 / 2 / tan(53.13 / 2) = 80.
        assert!((camera.fx - 80.0).abs() < 1e-9 && camera.fx == camera.fy, "{camera:?}");
        shows_the_known_point(&Camera { fx: 100.0, fy: 80.0, ..camera });
    }
    assert_eq!(path("fisheye", &flat).unwrap()[0].projection, Projection::Fisheye);
    assert_eq!(path("equirectangular", &flat).unwrap()[0].projection, Projection::Equirectangular);
    let panorama = r#"[{"position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]], "width": 64, "height": 32, "projection": "equirectangular"}]"#;
    let camera = Camera::parse(panorama, Path::new("c.json")).unwrap().remove(0);
    assert!((camera.fx - camera.focal()[0]).abs() < 1e-12, "its scale follows from its size: {camera:?}");
    let said = path("vr180_l", &flat).unwrap_err().to_string();
    assert!(
        said.contains("`camera_type`: expected perspective")
            && said.contains("found vr180_l; draw the views"),
        "{said}"
    );
}

#[test]
fn the_cameras_of_a_capture_are_moved_to_the_scene_of_nerfstudio() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    // The file's poses have y and x for x and y, -z for z, and twice the size.
    let applied = "\"applied_transform\": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]], \"applied_scale\": 2,";
    std::fs::write(&path, nerfstudio(applied, "")).unwrap();
    let of_file = Camera::load(&path).unwrap().remove(0);
    let beside = folder.path().join("dataparser_transforms.json");
    let moves = r#"{"transform": [[0, 1, 0, 1], [0, 0, 1, 2], [1, 0, 0, 3]], "scale": 0.5}"#;
    std::fs::write(&beside, moves).unwrap();
    let parsed = Dataset::parse(&nerfstudio(applied, ""), &path).unwrap();
    assert_eq!((&parsed.views[0].camera, &parsed.alignment), (&of_file, &None), "only files are moved");
    let dataset = Dataset::load(&path).unwrap();
    assert_eq!(
        (&dataset.alignment, &dataset.files),
        (&Some(beside.clone()), &vec![path.clone(), beside.clone()])
    );
    let camera = &dataset.views[0].camera;
    let [x, y, z] = [7.0, -5.0, 4.0];
    // The point in the space of the capture is (y, x, -z), and 0.5 / 2 is the scale.
    let moved = [x + 1.0, -z + 2.0, y + 3.0].map(|v| 0.25 * v);
    let (before, after) = (of_file.to_view([x, y, z]), camera.to_view(moved));
    assert!((0..3).all(|axis| (0.25 * before[axis] - after[axis]).abs() < 1e-9), "{before:?} {after:?}");
    // COLMAP's poses are those of the capture.
    let colmap = colmap_text("7 PINHOLE 100 80 100 80 50 40", &image());
    let of_colmap = Camera::load(colmap.path()).unwrap().remove(0);
    std::fs::copy(&beside, colmap.path().join("dataparser_transforms.json")).unwrap();
    let camera = Camera::load(colmap.path()).unwrap().remove(0);
    let (before, after) =
        (of_colmap.to_view([x, y, z]), camera.to_view([y + 1.0, z + 2.0, x + 3.0].map(|v| 0.5 * v)));
    assert!((0..3).all(|axis| (0.5 * before[axis] - after[axis]).abs() < 1e-9), "{before:?} {after:?}");
    for (from, to, what) in
        [("0.5", "0", "`scale`: expected a positive"), ("[0, 1, 0, 1]", "[0, 2, 0, 1]", "orthonormal")]
    {
        std::fs::write(&beside, moves.replace(from, to)).unwrap();
        let said = Dataset::load(&path).unwrap_err().to_string();
        assert!(said.contains("dataparser_transforms.json: ") && said.contains(what), "{said}");
    }
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
fn a_blender_scene_takes_its_size_from_its_photographs_and_its_split_from_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let png = |name: &str| {
        let mut bytes = b"\x89PNG\r\n\x1A\n\0\0\0\x0DIHDR".to_vec();
        bytes.extend([100u32, 80].map(u32::to_be_bytes).as_flattened());
        std::fs::write(folder.path().join(name), bytes).unwrap();
    };
    let write = |split: &str, names: &[&str]| {
        let frame = |name: &&str| format!("{{\"file_path\": \"./{name}\", \"transform_matrix\": {MATRIX}}}");
        let frames: Vec<String> = names.iter().map(frame).collect();
        // A field of view of 2 atan(1/2) is that of 100 pixels at a focal length of 100.
        let text =
            format!("{{\"camera_angle_x\": {}, \"frames\": [{}]}}", 2.0 * 0.5f64.atan(), frames.join(","));
        std::fs::write(folder.path().join(format!("transforms_{split}.json")), text).unwrap();
    };
    write("train", &["r_1", "r_2", "r_3"]);
    write("test", &["lost", "r_0"]);
    let said = Dataset::load(folder.path()).unwrap_err().to_string();
    assert!(
        said.contains("transforms_test.json:1:")
            && said.contains(
                "missing fields `w` and `h`, the size in pixels, and its photograph: expected the photograph"
            ),
        "{said}"
    );
    write("val", &["r_4"]);
    ["r_0.png", "r_1.png", "r_4.png"].into_iter().for_each(png);
    std::fs::write(folder.path().join("r_2.png"), "\x7FPNG").unwrap();
    let said = photograph::size(&folder.path().join("r_2.png")).unwrap_err().to_string();
    assert!(said.ends_with("photograph, found a file that begins with `\\x7fPNG`"), "{said}");
    let dataset = Dataset::load(folder.path()).unwrap();
    assert_eq!(dataset.views.len(), 6);
    assert_eq!(
        dataset.files,
        ["test", "train", "val"].map(|split| folder.path().join(format!("transforms_{split}.json")))
    );
    // Photographs that are missing or damaged do not count.
    let size = |view: &View| (view.camera.width, view.camera.height, view.camera.fx.round());
    assert!(dataset.views.iter().all(|view| size(view) == (100, 80, 100.0)), "{dataset:#?}");
    let [_, test] = dataset.test_views().try_into().unwrap();
    assert_eq!(test.camera.img_name, "r_0");
    assert!((test.camera.fx - 100.0).abs() < 1e-9 && test.camera.fy == test.camera.fx);
    // A split's file alone is the split.
    for (split, count, of) in [("test", 2, 2), ("train", 0, 3), ("val", 0, 1)] {
        let split = Dataset::load(folder.path().join(format!("transforms_{split}.json"))).unwrap();
        assert_eq!((split.test_views().len(), split.views.len()), (count, of));
    }
    // A split without any photograph has the size of the test views, but not alone.
    std::fs::remove_file(folder.path().join("r_4.png")).unwrap();
    assert_eq!(Dataset::load(folder.path()).unwrap(), dataset);
    assert!(Dataset::load(folder.path().join("transforms_val.json")).is_err());
    let elsewhere = tempfile::tempdir().unwrap();
    let file = elsewhere.path().join("transforms_test.json");
    std::fs::copy(folder.path().join("transforms_test.json"), &file).unwrap();
    assert!(Dataset::load(&file).is_err());
    assert_eq!(
        Dataset::load_with(
            &file,
            CameraOptions { photographs: Some(folder.path()), ..CameraOptions::default() }
        )
        .unwrap()
        .views[0]
            .camera
            .width,
        100
    );
    assert_eq!(Dataset::photograph_in(folder.path(), test).unwrap(), folder.path().join("./r_0.png"));
}

#[test]
fn names_of_photographs_lead_no_further_than_the_folder_around_the_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let [dataset, inner] = ["dataset", "dataset/inner"].map(|name| folder.path().join(name));
    std::fs::create_dir_all(&inner).unwrap();
    for name in ["top.png", "dataset/a.png", "dataset/inner/b.png"] {
        std::fs::write(folder.path().join(name), "").unwrap();
    }
    let found = |folder: &Path, name: &str| match photograph::find(folder, name) {
        Ok(path) => path.file_name().unwrap().to_string_lossy().into_owned(),
        Err(error) => error.to_string(),
    };
    assert_eq!(found(&dataset, "./inner/./b"), "b.png");
    assert_eq!(found(&dataset, "../top.png"), "top.png");
    assert_eq!(found(&inner, "../a.png"), "a.png");
    let absolute = inner.join("b.png").display().to_string();
    assert_eq!(found(&dataset, &absolute), "b.png");
    assert_eq!(found(Path::new("/"), &absolute), "b.png");
    assert_eq!(found(&inner.join("empty"), &absolute), "b.png", "as ../b.png is");
    let top = folder.path().join("top.png").display().to_string();
    for name in ["../../top.png", "./inner/../a.png", "../dataset/../top.png", &top] {
        let said = found(&inner.join("empty"), name);
        says(&said, &format!("or in the folder around it, found {name}: "));
        says(said, "--photographs");
    }
    // The folders of `-c transforms.json`, `-c ../src/transforms.json`, and of a symbolic link to the folder.
    let here = std::env::current_dir().unwrap();
    let around = here.parent().unwrap();
    let is_near = |folder: &str, name: &Path| photograph::is_near(Path::new(folder), name);
    for folder in ["", ".", "../assets"] {
        assert!(is_near(folder, &here.join("images/a.png")), "{folder:?}");
        assert!(is_near(folder, &around.join("images/a.png")), "{folder:?}");
        assert!(!is_near(folder, &around.with_file_name("a.png")), "{folder:?}");
    }
    assert!(is_near("src", &here.join("a.png")) && !is_near("src/dataset", &here.join("a.png")));
    #[cfg(unix)]
    {
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&inner, &link).unwrap();
        assert_eq!(found(&link, &absolute), "b.png");
        assert_eq!(found(&inner, &link.join("b.png").display().to_string()), "b.png");
    }
    assert!(found(&dataset, "none").starts_with("expected the photograph "));
}

#[test]
fn each_eighth_view_in_the_order_of_names_is_a_test() {
    let view = |index: usize| View {
        camera: Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (4, 4)),
        photograph: format!("{:02}.png", (index * 7) % 17),
        test: None,
    };
    let dataset = Dataset { views: (0..17).map(view).collect(), ..Dataset::default() };
    let names: Vec<&str> = dataset.test_views().iter().map(|view| view.photograph.as_str()).collect();
    assert_eq!(names, ["00.png", "08.png", "16.png"]);
}

#[test]
fn test_names_are_paths_and_those_without_a_view_are_listed() {
    let tests = r#""test_filenames": ["./images//f.jpg", "images/lost.jpg", "images/gone.jpg"],"#;
    let dataset = Dataset::parse(&nerfstudio(tests, ""), Path::new("transforms.json")).unwrap();
    assert_eq!(dataset.views[0].test, Some(true));
    assert_eq!(dataset.unmatched, ["images/gone.jpg", "images/lost.jpg"]);
}

#[test]
fn reduced_photographs_lie_beside_those_of_full_size_and_not_beside_the_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = folder.path().join("dataset");
    for name in ["images_2", "images_3", "dataset/images", "dataset/images_2"] {
        std::fs::create_dir_all(folder.path().join(name)).unwrap();
    }
    let reduced = |name: &str, factor| {
        let text = nerfstudio("", "").replace("images/f.jpg", name);
        let views = Dataset::parse(&text, &dataset.join("transforms.json")).unwrap().reduced(factor)?.views;
        Some((views[0].photograph.clone(), views[0].camera.img_name.clone()))
    };
    let found = |photograph: &str, name: &str| Some((photograph.to_owned(), name.to_owned()));
    assert_eq!(reduced("images/f.jpg", 2), found("images_2/f.jpg", "images/f"));
    assert_eq!(reduced("./images/a/f.jpg", 2), found("./images_2/a/f.jpg", "images/a/f"));
    assert_eq!(reduced("../images/f.jpg", 3), found("../images_3/f.jpg", "../images/f"));
    assert_eq!((reduced("images/f.jpg", 3), reduced("f.jpg", 2), reduced("images", 2)), (None, None, None));
    let colmap = Dataset { photographs: Some(dataset.join("images")), ..Dataset::default() };
    assert_eq!(colmap.reduced(2).unwrap().photographs, Some(dataset.join("images_2")));
    assert_eq!(colmap.reduced(3), None);
}

#[test]
fn a_written_model_is_read_as_it_was() {
    let cameras: Vec<Camera> = (0..5)
        .map(|index| {
            let t = f64::from(index);
            let camera =
                Camera::looking_at([3.0 * t.sin(), -0.3 * t, 5.0 + t], [0.1, 0.2, t.cos()], 60.0, (64, 48));
            let principal_offset = [0.25 * t, -1.5];
            Camera { id: i64::from(index) + 1, img_name: format!("view-{index}"), principal_offset, ..camera }
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in Dataset::colmap_text(&cameras, "png").unwrap() {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let back = Dataset::load(folder.path()).unwrap();
    for (a, b) in cameras.iter().zip(&back.views) {
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert_eq!(
            (a.id, &a.img_name, a.width, a.fx, a.fy, a.principal_offset),
            (b.camera.id, &b.camera.img_name, 64, b.camera.fx, b.camera.fy, b.camera.principal_offset)
        );
        assert!(
            near(&a.position, &b.camera.position)
                && near(a.rotation.as_flattened(), b.camera.rotation.as_flattened())
        );
        assert_eq!(b.photograph, format!("{}.png", a.img_name));
    }
}

#[test]
fn a_written_fisheye_is_read_as_one_and_projections_without_a_model_are_refused() {
    let of = |projection| {
        let mut camera = Camera::looking_at([1.0, 2.0, 3.0], [0.0; 3], 60.0, (64, 48));
        (camera.img_name, camera.projection) = ("a".into(), projection);
        camera
    };
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in Dataset::colmap_text(&[of(Projection::Fisheye)], "png").unwrap() {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let camera = &Dataset::load(folder.path()).unwrap().views[0].camera;
    assert_eq!((camera.projection, camera.fx), (Projection::Fisheye, of(Projection::Fisheye).fx));
    for projection in [Projection::Orthographic, Projection::Equirectangular] {
        let said = Dataset::colmap_text(&[of(projection)], "png").unwrap_err().to_string();
        assert!(said.ends_with(&format!("found {projection}")), "{said}");
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

/// Writes a glTF file with two cameras, and reads them.
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
    says(said("[2, 3, 4]", "[-2, 3, 4]"), "`nodes[1].camera`: the rotation mirrors");
    says(said("{\"asset\"", "["), "the JSON of glTF");
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
    ] {
        says(parse(more).unwrap_err(), what);
    }
}
