//! Finds the photographs of a dataset, and its test views.

use super::*;

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
    assert_eq!(found(&inner, "inner/b.png"), "b.png", "the folder may be part of the name");
    says(found(&inner, "other/b.png"), "expected the photograph ");
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
fn nerfstudio_holds_out_the_views_between_nine_tenths_of_them() {
    // numpy.setdiff1d(range(n), numpy.linspace(0, n - 1, math.ceil(0.9 * n), dtype=int))
    for (count, expected) in [
        (1, vec![]),
        (9, vec![]),
        (10, vec![8]),
        (16, vec![14]),
        (30, vec![9, 19, 28]),
        (100, vec![9, 19, 29, 39, 49, 59, 69, 79, 89, 98]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let frame = |index: usize| {
            // The list has another order than the names.
            let name = (index + count / 2) % count;
            format!(r#"{{"file_path": "{name:03}.png", "transform_matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0]}}"#)
        };
        let frames: Vec<String> = (0..count).map(frame).collect();
        let text = format!(r#"{{"w": 4, "h": 4, "fl_x": 4, "frames": [{}]}}"#, frames.join(","));
        let path = folder.path().join("transforms.json");
        std::fs::write(&path, text).unwrap();
        let options = CameraOptions { nerfstudio_split: true, ..CameraOptions::default() };
        let dataset = Dataset::load_with(&path, options).unwrap();
        assert_eq!(dataset.split, Some(NERFSTUDIO));
        let mut found: Vec<usize> =
            dataset.test_views().iter().map(|view| view.camera.img_name.parse().unwrap()).collect();
        found.sort_unstable();
        assert_eq!(found, expected, "{count}");
    }
}

#[test]
fn test_names_are_paths_and_those_without_a_view_are_listed() {
    let tests = r#""test_filenames": ["./images//f.jpg", "images/lost.jpg", "images/gone.jpg"],"#;
    let dataset = Dataset::parse(&nerfstudio(tests, ""), Path::new("transforms.json")).unwrap();
    assert_eq!(dataset.views[0].test, Some(true));
    assert_eq!(dataset.unmatched, ["images/gone.jpg", "images/lost.jpg"]);
    assert_eq!((dataset.split, dataset.capture), (Some("test_filenames"), None), "parsed, not loaded");
}

#[test]
fn test_views_are_those_of_the_first_list_with_names() {
    let [own, other] = [r#"["images/f.jpg"]"#, r#"["images/g.jpg"]"#];
    for (lists, split, is_test) in [
        (format!(r#""val_filenames": {own}, "train_filenames": {other},"#), "val_filenames", true),
        (format!(r#""val_filenames": {own}, "test_filenames": {other},"#), "test_filenames", false),
        (format!(r#""val_filenames": {own}, "test_filenames": [],"#), "val_filenames", true),
        (format!(r#""train_filenames": {own},"#), "train_filenames", false),
        (format!(r#""train_filenames": {other},"#), "train_filenames", true),
    ] {
        let dataset = Dataset::parse(&nerfstudio(&lists, ""), Path::new("transforms.json")).unwrap();
        assert_eq!((dataset.split, dataset.views[0].test), (Some(split), Some(is_test)), "{lists}");
    }
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
    // Downloads often have no `images`.
    let folder = colmap_text(LENS, &image());
    let images = folder.path().canonicalize().unwrap().join("images");
    for factor in [8, 2, 1] {
        std::fs::create_dir(images.with_file_name(format!("images_{factor}"))).unwrap();
    }
    std::fs::remove_dir(&images).unwrap();
    let colmap = Dataset::load(folder.path()).unwrap();
    assert_eq!((&colmap.photographs, colmap.reduced_factors()), (&None, vec![2, 8]));
    assert_eq!(colmap.reduced(8).unwrap().photographs, Some(images.with_file_name("images_8")));
    assert_eq!(colmap.reduced(4), None);
}
