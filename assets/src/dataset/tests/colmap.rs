//! Reads and writes models of COLMAP.

use super::*;

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

#[test]
fn images_of_colmap_have_the_order_of_their_names_and_other_models_are_listed() {
    let named = |name: &str| image().replace("left/a photo", name);
    let images = format!("{}\n\n{}\n\n{}", named("right/2"), named("left/10"), named("right/1"));
    let folder = colmap_text(LENS, &images);
    let dataset = Dataset::load(folder.path()).unwrap();
    let names: Vec<&str> = dataset.views.iter().map(|view| view.photograph.as_str()).collect();
    assert_eq!(names, ["left/10.JPG", "right/1.JPG", "right/2.JPG"]);
    let sparse = folder.path().join("sparse");
    assert_eq!(Dataset::load(&sparse).unwrap(), dataset, "the folder around the models");
    std::fs::create_dir(sparse.join("1")).unwrap();
    assert!(Dataset::load(folder.path()).unwrap().other_models.is_empty(), "an empty folder is no model");
    for name in ["cameras.txt", "images.txt"] {
        std::fs::copy(sparse.join("0").join(name), sparse.join("1").join(name)).unwrap();
    }
    assert_eq!(Dataset::load(folder.path()).unwrap().other_models, [sparse.join("1")]);
    assert!(Dataset::load(sparse.join("0")).unwrap().other_models.is_empty(), "a model that is named");
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
