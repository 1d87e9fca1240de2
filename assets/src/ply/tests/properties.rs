//! Reads properties of a PLY file beyond those of a splat, and carries them through copies of the scene.

use super::{Made, PLAIN, edited, property_names, raw};
use crate::testing::{parse, says, written};
use crate::{QUIET, ReadOptions, Scene, SceneFormat, Similarity};
use std::path::Path;

#[test]
fn further_properties_are_read_on_request_and_stay_with_their_splats() {
    let label = |index: usize| raw(index, "nz") as f32;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let properties = ["label", "x"].map(str::to_owned);
    let load = |path: &Path| {
        Scene::load_with(path, ReadOptions { properties: &properties, ..ReadOptions::default() }, QUIET)
    };
    let rows = |scene: &Scene| -> Vec<[f32; 2]> {
        (0..scene.count() as usize).map(|index| [0, 1].map(|name| scene.property(index, name))).collect()
    };
    for (format, kind) in
        [("ascii", "double"), ("binary_big_endian", "float"), ("binary_little_endian", "double")]
    {
        let made = Made { format, kind, reversed: true, ..PLAIN };
        std::fs::write(
            at("a.ply"),
            edited(&made, &format!("property {kind} nz"), &format!("property {kind} label")),
        )
        .unwrap();
        let scene = load(&at("a.ply")).unwrap();
        assert_eq!(scene.property_names(), properties);
        let expected: Vec<[f32; 2]> =
            (0..made.count).map(|index| [label(index), raw(index, "x") as f32]).collect();
        assert_eq!(rows(&scene), expected, "{format}");
        assert_ne!(scene.identity(), Scene::load(at("a.ply"), QUIET).unwrap().identity());

        let info = scene.attribute("scene.property.label").unwrap();
        assert_eq!((info.stride, info.planes, info.count), (4, 1, 20));
        let mut bytes = [0; 8];
        scene.write_attribute("scene.property.label", 0, 12, &mut bytes).unwrap();
        assert_eq!(bytes, [label(3), label(4)].map(f32::to_le_bytes).concat()[..]);
        assert!(scene.attribute("scene.property.y").is_none());

        let by = Similarity { scale: 2.0, ..Similarity::IDENTITY };
        let picked = scene.picked(&[7, 2]).unwrap().transformed(&by).unwrap().cut_to_degree(0).unwrap();
        assert_eq!(rows(&picked), [expected[7], expected[2]]);
        picked.write_ply(at("b.ply")).unwrap();
        let labels: Vec<f32> = rows(&load(&at("b.ply")).unwrap()).iter().map(|row| row[0]).collect();
        assert_eq!(labels, [label(7), label(2)]);

        std::fs::write(at("c.ply"), PLAIN.bytes()).unwrap();
        std::fs::write(at("list.ron"), "Scenes([Scene(file: \"c.ply\"), Scene(file: \"b.ply\")])").unwrap();
        let joined = load(&at("list.ron")).unwrap();
        let at = joined.property_names().iter().position(|name| name == "label").unwrap();
        assert_eq!((joined.property(19, at), joined.property(20, at)), (0.0, label(7)));
    }
    let made = Made { count: 40, ..PLAIN };
    let mut bytes = edited(&made, "property float nz", "property float label");
    // Splat 5 is dropped, so all further ones move up.
    let stride = 4 * property_names(PLAIN.degree).len();
    let start = bytes.len() - 40 * stride;
    bytes[start + 5 * stride..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(at("a.ply"), bytes).unwrap();
    let scene = load(&at("a.ply")).unwrap();
    assert_eq!((scene.property(4, 0), scene.property(5, 0), scene.count()), (label(4), label(6), 39));
}

#[test]
fn a_property_that_no_file_has_is_an_error_with_the_nearest() {
    let folder = tempfile::tempdir().unwrap();
    let said = |name: &str, bytes: &[u8]| {
        let path = folder.path().join("a");
        std::fs::write(&path, bytes).unwrap();
        let properties = [name.to_owned()];
        let options = ReadOptions { properties: &properties, ..ReadOptions::default() };
        Scene::load_with(path, options, QUIET).unwrap_err().to_string()
    };
    let labelled = edited(&PLAIN, "property float nz", "property float label");
    says(said("labels", &labelled), "expected a property `labels`, found none; did you mean `label`?");
    says(said("confidence", &labelled), "found none; `splatgraph info` lists its properties");
    let spz = written(&parse(&PLAIN.bytes()).unwrap(), SceneFormat::Spz);
    says(said("label", &spz), "only PLY files have further properties, and this is spz");
}
