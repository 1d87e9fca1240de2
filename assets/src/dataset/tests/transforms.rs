//! Reads the JSON of Blender, nerfstudio and instant-ngp.

use super::*;

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
    assert_eq!((own.views[0].camera.fx, own.views[0].camera.fy), (55.0, 55.0), "it has a lens of its own");
    let own = parse(&nerfstudio("", &format!("\"camera_angle_x\": {},", 2.0 * 0.5f64.atan()))).unwrap();
    assert!((own.views[0].camera.fx - 100.0).abs() < 1e-9, "the file's angle does not count");
    let own = parse(&nerfstudio("", "\"w\": 50, \"h\": 40, \"fl_x\": 50, \"cx\": 24.5,")).unwrap();
    let camera = &own.views[0].camera;
    assert_eq!((camera.width, camera.fy, camera.principal_point()), (50, 50.0, [24.5, 20.0]));
    let own = parse(&nerfstudio("\"is_fisheye\": true,", "\"is_fisheye\": false,")).unwrap();
    assert_eq!(own.views[0].camera.projection, Projection::Pinhole);
    assert!(!own.has_masks && parse(&nerfstudio("", "\"mask_path\": \"m.png\",")).unwrap().has_masks);
    for (of_frame, what) in [
        ("\"k1\": 0.1,", "`k1`: expected 0, a lens without distortion, found 0.1; undistort"),
        ("\"k2\": \"0.1\",", "`k2`: expected 0, a lens without distortion, found 0.1; undistort"),
        ("\"k5\": 0.1,", "`k5`: expected 0, a lens without distortion, found 0.1; undistort"),
        (
            "\"distortion\": [0, 0.2],",
            "`distortion`: expected 0, a lens without distortion, found 0.2; undistort",
        ),
        (
            "\"distortion_params\": [0, 0.2],",
            "`distortion_params`: expected 0, a lens without distortion, found 0.2; undistort",
        ),
        (
            "\"camera_model\": \"FISHEYE624\",",
            "`camera_model`: expected PINHOLE, OPENCV_FISHEYE, EQUIRECTANGULAR or another model without distortion, found FISHEYE624",
        ),
        (
            "\"w\": 50,",
            "`fl_x`: expected one in the frame, whose size is not the file's, found the file's 100",
        ),
        ("\"D\": [0.1],", "`D`: expected 0, a lens without distortion, found 0.1; undistort"),
        (
            "\"params\": [100, 80, 50, 40, 0.1, 0, 0, 0],",
            "`params`: k1: expected 0, a lens without distortion, found 0.1; undistort",
        ),
        (
            "\"transform_matrix\": [[1, 0, 0, NaN]],",
            "camera 0: `transform_matrix`: expected a number, found NaN; leave out frames without a pose",
        ),
        ("\"w\": 10.5,", "`w`: expected a number of pixels, found 10.5"),
        ("\"transform_matrix\": 1,", "invalid type: integer `1`"),
        ("\"transform_matrix\": [[1, 2, 3]],", "expected a number or 4 numbers in a row of the matrix"),
        (
            "\"transform_matrix\": [1, 2, 3],",
            "expected a matrix of 3 or 4 rows of 4 numbers, found 3 numbers",
        ),
        (
            "\"transform_matrix\": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0.5, 3, 1],",
            "expected 0, 0, 0, 1 as the matrix's last row, found 0, 0.5, 3, 1; is it transposed?",
        ),
    ] {
        let said = parse(&nerfstudio("", of_frame)).unwrap_err().to_string();
        assert!(said.starts_with("folder/transforms.json:") && said.contains(what), "{said}");
    }
    let of_file = "\"cx\": 50, \"cy\": 40,";
    let shared = nerfstudio(of_file, "\"w\": 50, \"h\": 40, \"fl_x\": 50,");
    let why = "`cx`: expected one in the frame, whose size is not the file's, found the file's 50";
    says(parse(&shared).unwrap_err(), why);
    let skewed = nerfstudio("", "").replace("[1, 0, 0, 2]", "[2, 0, 0, 2]");
    let said = parse(&skewed).unwrap_err().to_string();
    assert!(
        said.contains("transforms.json:3:") && said.contains("camera 0: the rotation is not orthonormal"),
        "{said}"
    );
}

#[test]
fn the_crop_and_the_seconds_of_a_path_are_read() {
    let frame = format!("{{\"camera_to_world\": {MATRIX}, \"fov\": 50}}");
    let path = |fields: &str| {
        let text = format!(
            "{{\"render_height\": 80, \"render_width\": 100, {fields} \"camera_path\": [{frame}, {frame}, {frame}]}}"
        );
        Dataset::parse(&text, Path::new("camera_path.json")).unwrap()
    };
    let fps = |fields: &str| path(fields).timing.unwrap().fps;
    assert_eq!(fps("\"fps\": 24, \"seconds\": 0.125,"), Some(24.0));
    assert_eq!(fps("\"fps\": 24, \"seconds\": 0.16,"), Some(24.0), "3.84 frames are rounded");
    assert_eq!(fps("\"fps\": 24, \"seconds\": 0.5,"), Some(6.0), "nerfstudio plays all frames in this time");
    assert_eq!((fps("\"seconds\": 1.5,"), fps("\"fps\": 24, \"seconds\": 0,")), (Some(2.0), Some(24.0)));

    let color = "\"crop_bg_color\": {\"r\": 255, \"g\": 0, \"b\": 51}";
    let place = "\"crop_center\": [1, 2, 3], \"crop_scale\": [2, 4, 6]";
    // The angles are those of Rz(yaw) Ry(pitch) Rx(roll).
    let turned =
        format!("\"crop\": {{{place}, \"crop_rot\": [0.3, {0}, {0}], {color}}},", 0.5 * std::f64::consts::PI);
    let crop = path(&turned).crop.unwrap();
    assert_eq!((crop.center, crop.size), ([1.0, 2.0, 3.0], [2.0, 4.0, 6.0]));
    assert_eq!(crop.background, [1.0, 0.0, 0.2]);
    let (sin, cos) = 0.3f64.sin_cos();
    for (axis, expected) in crop.axes.iter().zip([[0.0, 0.0, -1.0], [-cos, sin, 0.0], [sin, cos, 0.0]]) {
        assert!(axis.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{:?}", crop.axes);
    }
    let straight = path(&format!("\"crop\": {{{place}, {color}}},")).crop.unwrap();
    assert_eq!(straight.axes, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_eq!((path("\"crop\": null,").crop, path("").crop), (None, None));
}

#[test]
fn a_path_of_nerfstudio_and_a_matrix_of_three_rows_show_the_known_point() {
    let path = |kind: &str, pose: &str| {
        let text = format!(
            "{{\"keyframes\": [{{\"matrix\": \"[1]\"}}], \"camera_type\": \"{kind}\", \"render_height\": 80, \"render_width\": 100, \
             \"camera_path\": [{{\"camera_to_world\": {pose}, \"fov\": 53.13010235415598, \"aspect\": 1.25}}], \"fps\": 24, \"is_cycle\": true}}"
        );
        Dataset::parse(&text, Path::new("camera_path.json")).map(|dataset| {
            assert_eq!(dataset.timing, Some(FrameTiming { fps: Some(24.0), is_cycle: true }));
            dataset.into_cameras()
        })
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
    // A split's file, loaded on its own, gives only that split.
    for (split, count, of) in [("test", 2, 2), ("train", 0, 3), ("val", 0, 1)] {
        let split = Dataset::load(folder.path().join(format!("transforms_{split}.json"))).unwrap();
        assert_eq!((split.test_views().len(), split.views.len()), (count, of));
    }
    // A split without any photograph takes the size of the test views. Loaded on its own, it is an error.
    std::fs::remove_file(folder.path().join("r_4.png")).unwrap();
    assert_eq!(Dataset::load(folder.path()).unwrap(), dataset);
    assert!(Dataset::load(folder.path().join("transforms_val.json")).is_err());
    let elsewhere = tempfile::tempdir().unwrap();
    let file = elsewhere.path().join("transforms_val.json");
    std::fs::copy(folder.path().join("transforms_test.json"), &file).unwrap();
    let options = CameraOptions { photographs: Some(folder.path()), ..CameraOptions::default() };
    let alone = Dataset::load_with(elsewhere.path(), options).unwrap();
    assert_eq!((alone.views.len(), alone.files), (2, vec![file]));
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
    assert_eq!(
        Dataset::photograph_in(folder.path(), &test.photograph).unwrap(),
        folder.path().join("./r_0.png")
    );
}
