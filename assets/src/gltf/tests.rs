//! Checks values and transforms, and that unsupported splats are refused.

#[path = "../../../tests/glb_file.rs"]
mod glb_file;

use crate::error::SceneError;
use crate::input::{Input, Source};
use crate::scene::{Scene, SortKey};
use crate::testing::{says, splat, written};
use crate::{QUIET, SceneFormat};
use base64::Engine as _;
use glam::{DQuat, DVec3};
use serde_json::{Value, json};
use std::ops::ControlFlow;

fn bytes(scene: &Scene) -> Vec<u8> {
    written(scene, SceneFormat::Gltf)
}

fn parts(glb: &[u8]) -> (Value, Vec<u8>) {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&glb[20..20 + length]).unwrap(), glb[28 + length..].to_vec())
}

fn changed(change: impl FnOnce(&mut Value)) -> Result<Scene, String> {
    let (mut document, binary) = parts(&bytes(&Scene::generate(5, 3, splat)));
    change(&mut document);
    Scene::parse(&glb_file::joined(&document, &binary), QUIET).map_err(|error| error.to_string())
}

#[test]
fn values_come_back_to_the_bit_and_splats_are_sorted_by_distance() {
    for degree in 0..=3 {
        let scene = Scene::generate(5000, degree, splat);
        let found = Scene::parse(&bytes(&scene), QUIET).unwrap();
        assert_eq!((found.count(), found.stored_degree()), (5000, degree));
        assert_eq!(found.positions(), scene.positions());
        assert_eq!((found.scales(), found.opacities()), (scene.scales(), scene.opacities()));
        assert_eq!(found.sh(), scene.sh(), "degree {degree}");
        let rotations = found.rotations().as_flattened().iter().zip(scene.rotations().as_flattened());
        assert!(rotations.into_iter().all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(found.notes().key_of, SortKey::Distance);
        let sizes = found.size_breakdown();
        assert_eq!(sizes.sum(), sizes.file_bytes);
    }
    let far = Scene::generate(9, 1, splat).with_offset([5e6, 0.0, -2e5]);
    let found = Scene::parse(&bytes(&far), QUIET).unwrap();
    assert_eq!((found.offset(), found.positions()), (far.offset(), far.positions()));
}

#[test]
fn buffers_beside_the_document_or_in_its_text_are_read_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::generate(500, 1, splat);
    let (mut document, binary) = parts(&bytes(&scene));
    std::fs::write(folder.path().join("my buf.bin"), &binary).unwrap();
    let data = base64::engine::general_purpose::STANDARD.encode(&binary);
    let data = format!("data:application/octet-stream;base64,{data}");
    for (uri, outside) in [("my%20buf.bin", binary.len()), (data.as_str(), 0)] {
        document["buffers"][0]["uri"] = json!(uri);
        let (path, text) = (folder.path().join("a.gltf"), document.to_string());
        std::fs::write(&path, &text).unwrap();
        let found = Scene::load(&path, QUIET).unwrap();
        assert_eq!(found.positions(), scene.positions());
        let sizes = found.size_breakdown();
        assert_eq!((sizes.sum(), sizes.file_bytes), (sizes.file_bytes, (text.len() + outside) as u64));
        // 92 bytes of each splat are read, 4 of its point are not, and base 64 is longer than what it encodes.
        let longer = if outside == 0 { data.len() - binary.len() } else { 0 };
        assert_eq!(sizes.elements[0].bytes as usize, 96 * 500 + longer);
        assert_eq!((sizes.elements[0].fields[0].bytes, sizes.trailing_bytes), (12 * 500, 0));
    }
}

#[test]
fn a_buffer_that_is_written_to_while_it_is_read_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (path, buffer) = (folder.path().join("a.gltf"), folder.path().join("buf.bin"));
    let (mut document, binary) = parts(&bytes(&Scene::generate(500, 1, splat)));
    document["buffers"][0]["uri"] = json!("buf.bin");
    std::fs::write(&path, document.to_string()).unwrap();
    std::fs::write(&buffer, &binary).unwrap();
    let touch = |done: u64, _| {
        if done == 0 {
            std::fs::write(&buffer, &binary).unwrap();
        }
        ControlFlow::Continue(())
    };
    says(Scene::load(&path, &touch).unwrap_err(), "`buffers[0]`: the file was written to while it was read");
}

#[test]
fn a_node_moves_the_splats_and_turns_their_harmonics() {
    let plain = changed(|_| {}).unwrap();
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, -0.48, 0.64), 1.1);
    let moved = changed(|document| {
        document["nodes"] = json!([
            { "children": [1], "scale": [2.0, 2.0, 2.0], "translation": [1.0, 2.0, 3.0] },
            { "mesh": 0, "rotation": turn.to_array() },
        ]);
    });
    // The same transform in the axes of a scene.
    let [x, y, z, w] = turn.to_array();
    let rotation = DQuat::from_xyzw(-x, -y, z, w);
    let by = crate::similarity::Similarity { rotation, scale: 2.0, translation: DVec3::new(-1.0, -2.0, 3.0) };
    let expected = plain.transformed(&by).unwrap();
    let found = moved.unwrap();
    for index in 0..5 {
        let (a, b) = (found.splat(index), expected.splat(index));
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near(&a.position, &b.position) && near(&a.scale, &b.scale) && near(&a.sh, &b.sh));
        let dot: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| a * b).sum();
        assert!(dot.abs() > 0.999_999);
    }
    let twice = changed(|document| {
        document["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0, "translation": [9.0, 0.0, 0.0] }]);
        document["scenes"] = json!([{ "nodes": [0, 1] }]);
    });
    let twice = twice.unwrap();
    let x = |index: usize| twice.positions()[index][0];
    assert_eq!((twice.count(), x(0), x(5)), (10, plain.positions()[0][0], plain.positions()[0][0] - 9.0));
}

#[test]
fn integers_are_numbers_or_shares_and_negative_scales_are_logarithms() {
    let found = changed(|document| {
        // The accessor of the opacities refers to the alpha bytes of the colours.
        let last = document["accessors"].as_array().unwrap().len() - 1;
        document["bufferViews"][last]["byteStride"] = json!(4);
        document["accessors"][3] = json!({ "bufferView": last, "byteOffset": 3, "componentType": 5121, "normalized": true, "count": 5, "type": "SCALAR" });
    });
    let (found, plain) = (found.unwrap(), changed(|_| {}).unwrap());
    assert!((0..5).all(|at| (found.opacities()[at] - plain.opacities()[at]).abs() < 0.5 / 255.0 + 1e-6));
    let scene = Scene::generate(5, 0, splat);
    let (mut document, mut binary) = parts(&bytes(&scene));
    let start = 5 * 28;
    for (value, scale) in binary[start..start + 60].chunks_exact_mut(4).zip(scene.scales().as_flattened()) {
        value.copy_from_slice(&scale.ln().min(-0.1).to_le_bytes());
    }
    // The opacities follow.
    binary[start + 60..][..4].copy_from_slice(&1.5f32.to_le_bytes());
    let found = Scene::parse(&glb_file::joined(&document, &binary), QUIET).unwrap();
    let expected = scene.scales()[0][0].min((-0.1f32).exp());
    assert!((found.scales()[0][0] - expected).abs() < 1e-6);
    assert_eq!((found.opacities()[0], found.notes().clamped_opacities), (1.0, 1));
    // Logarithms without a negative one, in another primitive of the file.
    let (at, accessor) = (binary.len(), document["accessors"].as_array().unwrap().len());
    binary.extend([2f32.to_le_bytes(); 15].as_flattened());
    document["buffers"][0]["byteLength"] = json!(binary.len());
    let push = |list: &mut Value, item: Value| list.as_array_mut().unwrap().push(item);
    let views = document["bufferViews"].as_array().unwrap().len();
    push(&mut document["bufferViews"], json!({ "buffer": 0, "byteOffset": at, "byteLength": 60 }));
    let scales = json!({ "bufferView": views, "componentType": 5126, "count": 5, "type": "VEC3" });
    push(&mut document["accessors"], scales);
    let mut other = document["meshes"][0]["primitives"][0].clone();
    other["attributes"]["KHR_gaussian_splatting:SCALE"] = json!(accessor);
    push(&mut document["meshes"][0]["primitives"], other);
    let found = Scene::parse(&glb_file::joined(&document, &binary), QUIET).unwrap();
    assert!((found.scales()[5][0] - 2f32.exp()).abs() < 1e-5, "{:?}", found.scales());
    assert!(found.size_breakdown().format.ends_with(", logarithms of scales"));
    // The primitive with the negative logarithms is in a mesh that is not shown.
    let other = document["meshes"][0]["primitives"].as_array_mut().unwrap().pop();
    push(&mut document["meshes"], json!({ "primitives": [other] }));
    document["nodes"][0]["mesh"] = json!(1);
    let found = Scene::parse(&glb_file::joined(&document, &binary), QUIET).unwrap();
    assert!((found.scales()[0][0] - 2f32.exp()).abs() < 1e-5, "{:?}", found.scales());
}

#[test]
fn cameras_and_splats_of_other_scenes_are_counted_and_a_default_scene_without_splats_is_told() {
    let with = |scenes: Value| {
        changed(move |document| {
            let mesh = document["meshes"][0].clone();
            document["meshes"].as_array_mut().unwrap().push(mesh);
            document["nodes"] = json!([{ "mesh": 0 }, { "mesh": 1 }, { "camera": 0 }, {}]);
            (document["scenes"], document["scene"]) = (scenes, json!(1));
        })
    };
    let notes = with(json!([{ "nodes": [0] }, { "nodes": [1, 2] }])).unwrap().notes();
    assert_eq!(
        notes.left_out(),
        [
            "primitives of splats outside the default scene or hidden: 1; they are not read",
            "cameras: 1; `--cameras` reads them, and `convert --write-cameras` writes them"
        ]
    );
    let hidden = changed(|document| {
        let hide = json!({ "KHR_node_visibility": { "visible": false } });
        let mesh = document["meshes"][0].clone();
        document["meshes"].as_array_mut().unwrap().push(mesh);
        document["nodes"] = json!([{ "mesh": 0 }, { "mesh": 1, "extensions": hide }]);
        document["scenes"] = json!([{ "nodes": [0, 1] }]);
        document["extensionsRequired"] = json!(["KHR_node_visibility"]);
    });
    let hidden = hidden.unwrap();
    assert_eq!((hidden.count(), hidden.notes().splats_elsewhere), (5, 1));
    let all = changed(|document| {
        document["nodes"][0]["extensions"] = json!({ "KHR_node_visibility": { "visible": false } });
    });
    says(all.unwrap_err(), "found none, and 1 primitives of them hidden or in other scenes");
    let said = with(json!([{ "nodes": [0, 1] }, { "nodes": [3] }])).unwrap_err();
    says(
        said,
        "`scene`: expected visible splats in the default scene, found none, and 2 primitives of them hidden or in",
    );
}

#[test]
fn spz_inside_gives_the_splats_of_the_file() {
    let scene = Scene::generate(50, 2, splat);
    let mut spz = Vec::new();
    scene.write_spz(crate::SpzVersion::V3, &mut spz).unwrap();
    let (mut document, binary) = parts(&glb_file::around_spz(&spz));
    let alone = Scene::parse(&spz, QUIET).unwrap();
    let is_same = |document: &Value| {
        let found = Scene::parse(&glb_file::joined(document, &binary), QUIET).unwrap();
        assert_eq!((found.identity(), found.notes().key_of), (alone.identity(), SortKey::Distance));
    };
    is_same(&document);
    let first = "KHR_spz_gaussian_splats_compression";
    document["extensionsRequired"] = json!([first]);
    document["meshes"][0]["primitives"][0]["extensions"] = json!({ first: { "bufferView": 0 } });
    is_same(&document);
}

#[test]
fn nodes_that_place_one_spz_file_are_counted_before_it_is_unpacked() {
    let scene = Scene::generate(500, 0, splat);
    let (mut document, binary) = parts(&glb_file::around_spz(&written(&scene, SceneFormat::Spz)));
    let moved = json!({ "mesh": 0, "translation": [9.0, 0.0, 0.0] });
    document["nodes"] = json!(vec![json!({ "mesh": 0 }), moved.clone(), moved]);
    document["nodes"].as_array_mut().unwrap().resize(200, json!({ "mesh": 0 }));
    document["scenes"] = json!([{ "nodes": (0..200).collect::<Vec<_>>() }]);
    let glb = glb_file::joined(&document, &binary);
    let with = |memory: u64| {
        let source = Source::Bytes(&glb);
        let input = Input::new(&source, Some(memory), QUIET);
        super::parse(&input, None)
    };
    let found = with(64 << 20).unwrap();
    let alone = Scene::parse(&written(&scene, SceneFormat::Spz), QUIET).unwrap();
    assert_eq!((found.count(), &found.positions()[..500]), (100_000, alone.positions()));
    assert_eq!(found.positions()[500][0], alone.positions()[0][0] - 9.0);
    assert_eq!(found.size_breakdown().elements[0].fields.len(), 1);
    let said = with(12 << 20).unwrap_err();
    assert!(matches!(&said, SceneError::Memory(error) if error.count == 100_000), "{said}");
}

#[test]
fn primitives_of_splats_are_counted_over_all_nodes() {
    let with = |nodes: usize, primitives: usize| {
        changed(|document| {
            let list = document["meshes"][0]["primitives"].as_array_mut().unwrap();
            list.resize(primitives, list[0].clone());
            document["nodes"] = json!(vec![json!({ "mesh": 0 }); nodes]);
            document["scenes"] = json!([{ "nodes": (0..nodes).collect::<Vec<_>>() }]);
        })
    };
    assert_eq!(with(300, 2).unwrap().count(), 3000);
    says(with(400, 400).unwrap_err(), "expected at most 131072 primitives of splats, found 131200 or more");
}

#[test]
fn drafts_of_the_extension_are_read_or_named() {
    let scene = changed(|document| {
        let splats = &mut document["meshes"][0]["primitives"][0];
        splats["extensions"]["KHR_gaussian_splatting"] =
            json!({ "colorSpace": "BT.709-sRGB", "sortingMethod": "zDepth" });
        splats["attributes"]["KHR_gaussian_splatting:SH_DEGREE_4_COEF_0"] = json!(0);
    });
    let notes = scene.unwrap().notes();
    assert_eq!((notes.key_of, notes.cut_degree), (SortKey::Depth, Some(4)));
    let draft = "an early draft of KHR_gaussian_splatting";
    let said = |change: fn(&mut Value)| changed(change).unwrap_err();
    says(said(|document| document["extensionsRequired"] = json!(["KHR_spz_compression"])), draft);
    let attributes = |document: &mut Value| {
        document["meshes"][0]["primitives"][0]["attributes"] = json!({ "POSITION": 0, "_ROTATION": 1 });
    };
    says(said(attributes), draft);
}

#[test]
fn a_mesh_in_the_file_of_the_splats_is_left_out_and_counted() {
    let triangle = json!({ "attributes": { "POSITION": 0 }, "mode": 4 });
    let with = |beside: fn(&mut Value, Value)| {
        let triangle = triangle.clone();
        changed(move |document| beside(document, triangle)).unwrap()
    };
    let same_mesh = with(|document, triangle| {
        document["meshes"][0]["primitives"].as_array_mut().unwrap().push(triangle);
    });
    let own_node = with(|document, triangle| {
        document["meshes"].as_array_mut().unwrap().push(json!({ "primitives": [triangle] }));
        document["nodes"] = json!([{ "mesh": 0 }, { "mesh": 1 }, { "mesh": 1 }]);
        document["scenes"] = json!([{ "nodes": [0, 1, 2] }]);
    });
    for (scene, count) in [(same_mesh, 1), (own_node, 2)] {
        assert_eq!((scene.count(), scene.notes().mesh_primitives), (5, count));
        let text =
            format!("mesh primitives beside the splats: {count}; in a file of its own, a mesh is drawn");
        assert_eq!(scene.notes().left_out(), [text.as_str()]);
        let report = crate::report::Report::new(&scene, &[]).to_string();
        assert!(report.contains(&text), "{report}");
    }
}

#[test]
fn what_is_not_drawn_is_refused_by_name() {
    let splatting = |name: &'static str, value: &'static str| {
        changed(move |document| {
            document["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"][name] =
                json!(value);
        })
        .unwrap_err()
    };
    says(splatting("colorSpace", "lin_rec709_display"), "colour space lin_rec709_display");
    says(splatting("kernel", "disk"), "expected ellipse, found disk");
    says(splatting("sortingMethod", "random"), "expected cameraDistance or zDepth, found random");
    let said = |change: fn(&mut Value)| changed(change).unwrap_err();
    says(
        said(|document| document["nodes"][0]["scale"] = json!([1.0, 2.0, 1.0])),
        "nodes[0]`: expected a rotation, a uniform scale",
    );
    says(
        said(|document| document["nodes"][0]["scale"] = json!([-1.0, -1.0, -1.0])),
        "found a matrix that skews, mirrors or projects",
    );
    says(
        said(|document| document["nodes"][0]["scale"] = json!([0.0, 0.0, 0.0])),
        "nodes[0]`: expected a scale of 1e-9 to 1e9 and a translation of at most 1e18, found 0 and [0, 0, 0]",
    );
    says(
        said(|document| {
            document["nodes"][0]["matrix"] = json!([1, 0, 0, 3, 0, 1, 0, 0.5, 0, 0, 1, 3, 0, 0, 0, 1]);
        }),
        "nodes[0].matrix`: expected 0, 0, 0, 1 as the matrix's last row, found 3, 0.5, 3, 1; is it transposed?",
    );
    says(
        said(|document| document["buffers"][0]["uri"] = json!("https://example.org/a.bin")),
        "only files are read",
    );
    says(said(|document| document["buffers"][0]["uri"] = json!("../a.bin")), "in the folder of the document");
    says(
        said(|document| document["accessors"][0]["count"] = json!(2_147_483_648u32)),
        "POSITION`: expected 1 to as many elements",
    );
    says(said(|document| document["nodes"][0]["children"] = json!([0])), "a node with two parents");
    says(
        said(|document| document["meshes"][0]["primitives"][0]["extensions"] = json!({})),
        "a glTF model without Gaussian splats",
    );
}
