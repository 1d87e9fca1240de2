//! `experiment` as a command: the pages it writes, their pictures and their numbers.

use crate::place::Place;
use splatgraph_assets::{Scene, synth};
use std::collections::BTreeMap;

fn page(place: &Place, kind: &str, more: &str) -> String {
    let line = "scene.ply -c cameras.json#0 --device llvmpipe --validate";
    place.done(&format!("experiment {kind} {line} {more}"));
    place.text(&format!("experiment-{kind}.html"))
}

/// Returns the cells of the page's table rows by the row's first cell. Of rows with equal first cells, the first is
/// kept.
fn rows(page: &str) -> BTreeMap<String, Vec<String>> {
    let mut found = BTreeMap::new();
    for row in page.split("<tr>").skip(1) {
        let row = row.split("</tr>").next().expect("text");
        let cells = row.split("<td>").skip(1).map(|cell| cell.split("</td>").next().expect("text"));
        let cells: Vec<String> =
            cells.map(|cell| cell.replace("<code>", "").replace("</code>", "")).collect();
        if let Some((name, numbers)) = cells.split_first() {
            found.entry(name.clone()).or_insert_with(|| numbers.to_vec());
        }
    }
    found
}

fn number(cell: &str) -> f64 {
    cell.parse().unwrap_or_else(|e| panic!("`{cell}`: {e}"))
}

#[test]
#[cfg(target_os = "linux")]
fn folders_that_cannot_be_made_are_refused_before_the_work() {
    let place = Place::new();
    let lines = [
        "experiment sh -o /proc/no/a.html",
        "popping -o /proc/no",
        "bench -o /proc/no",
        "bench --json=/proc/no/a",
        "sweep scene.ply -o /proc/no",
        "trade scene.ply -o /proc/no",
        "advise scene.ply --psnr 40 --json=/proc/no",
        "render scene.ply --orbit 9 --json=/proc/no",
    ];
    for line in lines {
        // Outputs are checked before the device is opened, so the missing device is not reported.
        let told = place.fails(&format!("{line} --device no-such-card"), 2);
        assert!(
            told.contains(" names /proc/no") && told.contains("which cannot be written"),
            "{line}: {told}"
        );
    }
}

#[test]
fn the_page_on_the_order_has_every_way_with_its_picture_and_the_errors_that_theory_demands() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let page = page(&place, "order", "");
    // Four variants, their four differences, and five pictures of two splats.
    assert_eq!(page.matches("data:image/png;base64,").count(), 4 + 4 + 5, "pictures");
    assert_eq!(page.matches("<svg").count(), 1, "a plot");
    let rows = rows(&page);
    let way = |name: &str| rows.get(name).unwrap_or_else(|| panic!("{name}: {rows:?}"));
    let psnr = |name: &str| number(&way(name)[0]);
    for right in ["back to front", "front to back"] {
        assert!(psnr(right) > 60.0, "{rows:?}");
        for wrong in ["unsorted", "front to back, naive"] {
            assert!(psnr(wrong) + 20.0 < psnr(right), "{rows:?}");
        }
        assert_eq!(way(right)[2..4], ["0", "0"], "{rows:?}");
    }
    // The naive variant has a correctly sorted list, and blends every pair in the wrong order.
    let naive = way("front to back, naive");
    assert!(naive[2] == "0" && naive[3] == naive[4] && number(&naive[4]) > 0.0, "{naive:?}");
    let unsorted = way("unsorted");
    assert!(number(&unsorted[3]) > 0.0 && number(&unsorted[3]) < number(&unsorted[4]), "{unsorted:?}");
    // Coarser keys put more pairs in the wrong order.
    let wrong = |bits: u32| number(&way(&format!("key_bits = {bits}"))[0]);
    assert!(wrong(8) > wrong(12) && wrong(12) >= wrong(16) && wrong(32) == 0.0, "{rows:?}");
    let of_key = |bits: u32| number(&way(&format!("key_bits = {bits}"))[2]);
    assert!(of_key(8) < of_key(32), "{rows:?}");
    assert!(page.contains("Porter") && page.contains("c_1 = ("), "the source, and the numbers of two splats");
}

#[test]
fn the_page_on_bands_has_a_row_for_each_direction_and_more_bands_are_nearer_to_the_truth() {
    let place = Place::new();
    // 3000 splats make a closed surface, with glossy splats among them.
    synth::generate("demo", 3000, 0).expect("a scene").write_ply(place.at("scene.ply")).expect("written");
    place.cameras(&["one"]);
    let page = page(&place, "sh", "--size 96x64");
    // One overview. For each of three directions: four pictures, three differences and the exact picture.
    assert_eq!(page.matches("data:image/png;base64,").count(), 1 + 3 * 8, "pictures");
    let rows = rows(&page);
    let row = |degree: usize| rows.get(&degree.to_string()).expect("a row").as_slice();
    let left_out = |degree: usize| (number(&row(degree)[1]), number(&row(degree)[2]));
    assert_eq!(left_out(3), (0.0, 0.0), "{rows:?}");
    for degree in 0..3 {
        let (sum, measured) = left_out(degree);
        assert!(sum > left_out(degree + 1).0 && measured > 0.0, "{rows:?}");
    }
    // In one direction, adding a band can increase the error. With all bands, the error must be small.
    for direction in 4..7 {
        assert!(number(&row(0)[direction]) + 10.0 < number(&row(3)[direction]), "{rows:?}");
        assert!(number(&row(3)[direction]) > 55.0, "{rows:?}");
    }
    assert!(page.contains("Ramamoorthi"), "the source");
}

#[test]
fn a_scene_of_degree_0_has_a_page_that_says_so() {
    let place = Place::new();
    let glossy = synth::generate("demo", 50, 0).expect("a scene");
    Scene::generate(50, 0, |index| glossy.splat(index)).write_ply(place.at("scene.ply")).expect("written");
    place.cameras(&["one"]);
    let page = page(&place, "sh", "");
    assert!(page.contains("The scene has degree 0 only"), "{page}");
    assert!(!page.contains("data:image"), "no pictures");
}

#[test]
fn a_page_goes_over_no_input_and_mistakes_are_told_before_anything_is_drawn() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.refuses(
        "experiment",
        &[
            ("order scene.ply -o scene.ply", 2, "would overwrite the scene"),
            ("sh scene.ply -c cameras.json -o cameras.json", 2, "would overwrite the cameras"),
            ("order missing.ply", 1, "missing.ply"),
            ("sh scene.ply -c cameras.json#9", 1, "has no camera `9`"),
            ("colour scene.ply", 2, "colour"),
            ("order scene.ply --size 0x1", 2, "WIDTHxHEIGHT"),
        ],
    );
}
