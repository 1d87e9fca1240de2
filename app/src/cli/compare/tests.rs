use super::*;
use crate::cli::parsed;
use std::path::Path;

fn grey(value: f32) -> Image {
    Image { width: 12, height: 12, rgb: vec![[value; 3]; 144] }
}

fn folders(a: &[(&str, f32)], b: &[(&str, f32)]) -> (tempfile::TempDir, PathBuf, PathBuf) {
    let root = tempfile::tempdir().unwrap();
    let folder = |name: &str, pictures: &[(&str, f32)]| {
        let folder = root.path().join(name);
        for (name, value) in pictures {
            grey(*value).save(&folder.join(name)).unwrap();
        }
        folder
    };
    let (a, b) = (folder("a", a), folder("b", b));
    (root, a, b)
}

/// Returns the printed text, and the reasons to fail.
fn told(a: &Path, b: &Path, options: &[&str]) -> Result<(String, Vec<String>)> {
    let line = [&["compare", a.to_str().unwrap(), b.to_str().unwrap()], options].concat();
    compare(&parsed(line)?)
}

fn compared(a: &Path, b: &Path, options: &[&str]) -> Result<Option<String>> {
    told(a, b, options).map(|(_, failures)| failures.into_iter().next())
}

#[test]
fn folders_are_matched_by_stem_whatever_the_format_and_the_worst_decides() {
    let (_root, a, b) = folders(&[("x.npy", 0.5), ("y.exr", 0.5)], &[("x.exr", 0.5), ("y.png", 0.6)]);
    std::fs::write(a.join("stats.json"), "{}").unwrap();
    // 0.6 is 153 / 255, and a difference of 0.1 is 20 dB.
    assert_eq!(compared(&a, &b, &["--min-psnr", "19.9"]).unwrap(), None);
    let error = compared(&a, &b, &["--min-psnr", "20.1"]).unwrap().unwrap();
    assert!(error.starts_with("y: expected at least the 20.1 dB of --min-psnr, found 20.00"), "{error}");
}

#[test]
fn pictures_in_folders_are_matched_by_joined_names_unless_there_are_others_beside_the_folders() {
    let names = [("cam0_1.npy", 0.5), ("cam1_1.npy", 0.6)];
    let (_root, a, b) = folders(&names, &[("cam0/1.png", 0.6), ("cam1/1.npy", 0.6)]);
    let json: Value = serde_json::from_str(&told(&a, &b, &["--json"]).unwrap().0).unwrap();
    let found =
        [0, 1].map(|picture| (&json["pictures"][picture]["name"], &json["pictures"][picture]["psnr_db"]));
    assert!(
        found[0].0 == "cam0_1" && found[0].1.as_f64().is_some_and(|db| (db - 20.0).abs() < 0.01),
        "{json}"
    );
    assert_eq!(found[1], (&"cam1_1".into(), &"inf".into()));
    grey(0.5).save(&b.join("cam0_1.png")).unwrap();
    let json: Value = serde_json::from_str(&told(&a, &b, &["--json"]).unwrap().0).unwrap();
    assert_eq!(json["missing"], serde_json::json!(["cam1_1"]), "folders beside pictures are not read");
}

#[test]
fn the_means_of_two_folders_are_those_of_decibels() {
    let (_root, a, b) = folders(&[("x.npy", 0.5), ("y.npy", 0.5)], &[("x.npy", 0.6), ("y.npy", 0.51)]);
    let json: Value = serde_json::from_str(&told(&a, &b, &["--json"]).unwrap().0).unwrap();
    let near = |name: &str, expected: f64| {
        let found = json["mean"][name].as_f64().unwrap();
        assert!((found - expected).abs() < 1e-4, "{name}: {found}, expected {expected}");
    };
    near("psnr_db", 30.0);
    for name in ["ssim", "flip", "flip_8_bits"] {
        let of = |picture: usize| json["pictures"][picture][name].as_f64().unwrap();
        near(name, 0.5 * (of(0) + of(1)));
    }
    let text = told(&a, &b, &[]).unwrap().0;
    let mean = text.lines().find(|line| line.starts_with("mean")).unwrap();
    assert!(mean.contains(" 30.00 ") && mean.ends_with("2 pictures"), "{text}");
    std::fs::copy(a.join("x.npy"), b.join("x.npy")).unwrap();
    assert!(told(&a, &b, &["--json"]).unwrap().0.contains("\"psnr_db\": \"inf\""));
}

#[test]
fn float64_arrays_keep_their_digits_and_8_bits_are_the_nearest_float_of_either_kind() {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name);
    let said = |a: &str, b: &str, options: &[&str]| told(&path(a), &path(b), options).unwrap().0;
    let double = |name: &str, value: f64| {
        crate::io::image::save_words(&path(name), &[12, 12, 3], &[value; 3 * 144]).unwrap();
    };
    double("a.npy", 0.2);
    double("b.npy", 0.2 + 1e-9);
    let text = said("a.npy", "b.npy", &[]);
    assert!(text.starts_with("PSNR 180.00 dB") && text.contains("worst pixel 1.0e-9 at"), "{text}");
    assert!(!text.contains("identical"), "{text}");
    let json: Value = serde_json::from_str(&said("a.npy", "b.npy", &["--json"])).unwrap();
    assert!(json["identical"] == false && json["flip"].as_f64() > Some(0.0), "{json}");
    assert_eq!(json["flip_8_bits"], 0.0, "{json}");
    // 51 / 255 is 0.2 in single and in double precision.
    grey(0.2).save(&path("single.npy")).unwrap();
    grey(0.2).save(&path("levels.png")).unwrap();
    for name in ["a.npy", "single.npy"] {
        assert!(said("levels.png", name, &[]).ends_with(": identical"), "{name}");
        assert!(said(name, "levels.png", &[]).ends_with(": identical"), "{name}");
    }
    assert!(!said("a.npy", "single.npy", &[]).contains("identical"));
}

#[test]
fn depths_and_counts_of_the_program_s_own_outputs_are_compared() {
    let root = tempfile::tempdir().unwrap();
    let (a, b) = (root.path().join("a.npy"), root.path().join("b.npy"));
    crate::io::image::save_words(&a, &[12, 12], &[3u32; 144]).unwrap();
    crate::io::image::save_words(&b, &[12, 12], &[5u32; 144]).unwrap();
    let text = told(&a, &b, &[]).unwrap().0;
    assert!(text.contains("worst pixel 2.000000 at (0, 0)") && !text.contains("identical"), "{text}");
    // 20 log10(5 / 2)
    assert!(text.starts_with("PSNR 7.96 dB"), "{text}");
    assert!(compared(&a, &b, &["--min-psnr", "8"]).unwrap().is_some());
    // Of indices, one in a hundred is unequal. As values, all but the missing splats would be nearly equal.
    let mut indices = [7u32; 144];
    indices[143] = u32::MAX;
    crate::io::image::save_words(&a, &[12, 12], &indices).unwrap();
    indices[0] = 9;
    crate::io::image::save_words(&b, &[12, 12], &indices).unwrap();
    let text = told(&a, &b, &[]).unwrap().0;
    // 10 log10(144)
    assert!(text.starts_with("PSNR 21.58 dB") && text.contains("worst pixel 1.000000 at (0, 0)"), "{text}");
    assert!(compared(&a, &b, &["--min-psnr", "60"]).unwrap().is_some());
    assert!(told(&a, &a, &[]).unwrap().0.ends_with(": identical"));
    // Negative values differ, too: 20 log10((1 + 4) / 1).
    for (path, value) in [(&a, -3.0), (&b, -4.0)] {
        crate::io::image::save_words(path, &[12, 12], &[value; 144]).unwrap();
    }
    assert!(told(&a, &b, &[]).unwrap().0.starts_with("PSNR 13.98 dB"));
    // The second picture is the reference: a wild value of the first does not make its other errors small.
    let mut wild = [4.0; 144];
    let psnr = |a: &[f64], options: &[&str]| {
        let path = root.path().join("c.npy");
        crate::io::image::save_words(&path, &[12, 12], a).unwrap();
        crate::io::image::save_words(&b, &[12, 12], &[5.0; 144]).unwrap();
        let json = told(&path, &b, &[&["--json"], options].concat()).unwrap().0;
        serde_json::from_str::<Value>(&json).unwrap()["psnr_db"].as_f64().unwrap()
    };
    let before = psnr(&wild, &[]);
    wild[0] = -1000.0;
    assert!((before - 20.0 * 5f64.log10()).abs() < 1e-9 && psnr(&wild, &[]) <= before);
    assert!((psnr(&[4.0; 144], &["--range", "-5,5"]) - 20.0).abs() < 1e-9);
    // The levels of a PNG would be compared with floats that are clamped to 0..1.
    let levels = root.path().join("levels.png");
    grey(0.5).save(&levels).unwrap();
    let refused = told(&levels, &b, &["--range", "0,8"]).unwrap_err().to_string();
    assert!(
        refused.contains("levels.png: expected floats for --range 0,8, found levels 0 to 255"),
        "{refused}"
    );
    assert!(told(&b, &levels, &["--range", "0,0.5"]).is_ok());
    // A grey picture in colour channels is clamped like every picture.
    [(&a, 1.0), (&b, 7.0)].iter().for_each(|(path, value)| grey(*value).save(path).unwrap());
    assert!(told(&a, &b, &[]).unwrap().0.starts_with("PSNR inf dB"));
}

#[test]
fn a_pair_that_cannot_be_compared_does_not_stop_the_others_but_leaves_no_means() {
    let names = [("x.npy", 0.5), ("y.npy", 0.5), ("z.npy", 0.5)];
    let (_root, a, b) = folders(&names, &names);
    grey(f32::NAN).save(&a.join("x.npy")).unwrap();
    Image { width: 13, height: 12, rgb: vec![[0.5; 3]; 156] }.save(&b.join("z.npy")).unwrap();
    let (text, failures) = told(&a, &b, &[]).unwrap();
    assert_eq!(failures, ["2 of 3 pictures cannot be compared"]);
    let mean = text.lines().find(|line| line.starts_with("mean")).unwrap();
    assert!(mean.contains(" - ") && mean.ends_with("1 of 3 pictures"), "{text}");
    let json: Value = serde_json::from_str(&told(&a, &b, &["--json"]).unwrap().0).unwrap();
    assert_eq!((&json["missing"], &json["mean"]["ssim"]), (&json!(["x", "z"]), &Value::Null));
    std::fs::remove_file(a.join("y.npy")).unwrap();
    std::fs::remove_file(b.join("y.npy")).unwrap();
    assert!(told(&a, &b, &[]).unwrap_err().to_string().contains("found none"));
}

#[test]
fn a_jpeg_is_compared_by_its_levels() {
    let root = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| root.path().join(name));
    [&a, &b].iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    std::fs::write(a.join("halves.jpg"), include_bytes!("../../io/image/halves.jpg")).unwrap();
    Image::load(&a.join("halves.jpg")).unwrap().save(&b.join("halves.png")).unwrap();
    assert!(told(&a, &b, &[]).unwrap().0.contains(": identical"));
}

#[test]
fn clamped_differences_and_undeclared_encodings_are_counted() {
    let root = tempfile::tempdir().unwrap();
    let [a, b] = ["a.exr", "b.npy"].map(|name| root.path().join(name));
    let mut bright = grey(0.5);
    (bright.rgb[0], bright.rgb[1]) = ([2.0; 3], [0.9, 1.0, 1.5]);
    bright.save(&a).unwrap();
    grey(0.5).save(&b).unwrap();
    let notes = |a: &Path| {
        let line = ["compare", a.to_str().unwrap(), b.to_str().unwrap()];
        let pair = Pair { name: "a".into(), a: a.into(), b: b.clone() };
        let mut notes = Notes::default();
        measure(&pair, &parsed(line).unwrap(), &mut notes).unwrap();
        (notes.lessened, notes.undeclared.len())
    };
    assert_eq!(notes(&a), ((4, 432), 0));
    let file = std::fs::read(&a).unwrap();
    let name = b"colorInteropID";
    let at = file.windows(name.len()).position(|bytes| bytes == name).expect("an attribute");
    std::fs::write(&a, [&file[..at], b"otherAttribute", &file[at + name.len()..]].concat()).unwrap();
    assert_eq!(notes(&a).1, 1);
    // Integers end at white.
    let c = root.path().join("c.png");
    bright.save(&c).unwrap();
    assert_eq!(notes(&c), ((0, 0), 0));
}

#[test]
fn a_grey_value_counts_once_and_one_beyond_the_levels_of_the_other_picture_is_refused() {
    let root = tempfile::tempdir().unwrap();
    let depths = |name: &str, values: [f32; 2]| {
        let mut file = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }";
        file.extend(format!("{header:117}\n").bytes());
        file.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        let path = root.path().join(name);
        std::fs::write(&path, file).unwrap();
        path
    };
    let [a, b] = [("a.npy", [0.0, 9.0]), ("b.npy", [0.0, 8.0])].map(|(name, values)| depths(name, values));
    let pair = Pair { name: "a".into(), a: a.clone(), b: b.clone() };
    let line = ["compare", a.to_str().unwrap(), b.to_str().unwrap(), "--range", "0,8"];
    let mut notes = Notes::default();
    measure(&pair, &parsed(line).unwrap(), &mut notes).unwrap();
    assert_eq!(notes.lessened, (1, 2));

    let levels = root.path().join("levels.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&levels).unwrap(), 2, 1);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.write_header().unwrap().write_image_data(&[0, 0, 255, 255]).unwrap();
    for (one, other) in [(&a, &levels), (&levels, &a)] {
        let error = told(one, other, &[]).unwrap_err().to_string();
        assert!(error.starts_with(&format!("{}: expected values of 0 to 1, which ", a.display())), "{error}");
        assert!(error.contains("levels.png has by its levels, found 9; "), "{error}");
    }
    assert!(told(&depths("c.npy", [0.0, 1.0]), &levels, &[]).unwrap().0.contains(": identical"));
}

#[test]
fn a_path_that_does_not_exist_is_named() {
    let (_root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.5)]);
    let missing = b.join("missing");
    for (a, b) in [(&a, &missing), (&missing, &a), (&missing, &a.join("x.npy"))] {
        let error = told(a, b, &[]).unwrap_err();
        assert_eq!(error.to_string(), missing.display().to_string());
        assert!(error.root_cause().is::<std::io::Error>(), "{error:#}");
    }
}

#[test]
fn pictures_without_a_partner_do_not_stop_the_others_unless_all_are() {
    let (_root, a, b) = folders(&[("x.npy", 0.5), ("y.npy", 0.5)], &[("x.npy", 0.6), ("z.npy", 0.5)]);
    let (json, failures) = told(&a, &b, &["--json", "--min-psnr", "60"]).unwrap();
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["missing"], &json["mean"]["ssim"]), (&json!(["y", "z"]), &Value::Null));
    assert!(failures[0].starts_with("x: ") && failures[1] == "2 of 3 pictures cannot be compared");
    std::fs::remove_file(a.join("x.npy")).unwrap();
    let message = compared(&a, &b, &["--by-number"]).unwrap_err().to_string();
    assert!(message.contains("found none"), "{message}");
    let message = compared(&a, &b, &[]).unwrap_err().to_string();
    assert!(message.contains("y.npy") && message.contains("z.npy"), "{message}");
}

#[test]
fn names_can_be_matched_by_the_number_at_their_end() {
    let (_root, a, b) = folders(
        &[("biker-0.npy", 0.5), ("biker-10.npy", 0.2)],
        &[("camera0.npy", 0.5), ("camera10.npy", 0.2)],
    );
    grey(0.9).save(&b.join("camera0-background.npy")).unwrap();
    assert_eq!(compared(&a, &b, &["--by-number", "--min-psnr", "999"]).unwrap(), None);
    let message = compared(&a, &b, &[]).unwrap_err().to_string();
    assert!(message.contains("--by-number"), "{message}");
}

#[test]
fn two_pictures_of_one_name_in_a_folder_are_an_error() {
    let (_root, a, b) = folders(&[("x.npy", 0.5), ("x.png", 0.5)], &[("x.npy", 0.5)]);
    assert!(compared(&a, &b, &[]).unwrap_err().to_string().contains("have the same name"));
}

#[test]
fn the_difference_pictures_of_folders_go_into_a_folder() {
    let (root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.75)]);
    let out = root.path().join("differences");
    compared(&a, &b, &["--diff", out.to_str().unwrap(), "--gain", "2"]).unwrap();
    assert_eq!(Image::load(&out.join("x.png")).unwrap().rgb[0], [128.0 / 255.0; 3]);
}

#[test]
fn pictures_of_two_sizes_are_refused_before_either_is_decoded() {
    let (_root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.5)]);
    let (a, b) = (a.join("x.npy"), b.join("x.npy"));
    let wide = Image { width: 13, height: 12, rgb: vec![[0.5; 3]; 156] };
    wide.save(&b).unwrap();
    // Neither file holds all its pixels, so decoding it would report another error.
    for path in [&a, &b] {
        let bytes = std::fs::read(path).unwrap();
        std::fs::write(path, &bytes[..200]).unwrap();
    }
    let error = format!("{:#}", compared(&a, &b, &[]).unwrap_err());
    assert!(error.contains("expected pictures of the same size, found 12 x 12 and 13 x 12"), "{error}");
}

#[test]
fn a_picture_and_a_folder_are_bad_usage() {
    let (_root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.5)]);
    assert!(compared(&a.join("x.npy"), &b, &[]).unwrap_err().is::<Usage>());
}
