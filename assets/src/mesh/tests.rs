use super::*;
use crate::similarity::Similarity;
use crate::testing::{says, splat};
use crate::{Content, Scene};
use glam::{DQuat, DVec3};

/// Returns a quad without an image, and a triangle with one.
fn mesh() -> Mesh {
    let glow = Texture { first: 0, width: 2, height: 1 };
    let image = Texture { first: 2, ..glow };
    let red = MeshMaterial { base_color: [0.5, 0.25, 0.0, 1.0], metallic: 0.0, ..MeshMaterial::default() };
    Mesh {
        positions: vec![
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [1.0, 1.0, 1.0],
            [0.0, 1.0, 1.0],
            [0.0; 3],
            [2.0; 3],
            [1.0; 3],
        ],
        normals: vec![[0.0, 0.0, -1.0]; 7],
        uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [1.0, 0.0], [1.0, 1.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6]],
        material_of: vec![0, 0, 1],
        materials: vec![
            MeshMaterial { emission: [0.5, 0.0, 1.0], emission_image: glow, ..red },
            MeshMaterial { base_color_image: image, alpha_cutoff: 0.25, unlit: true, ..red },
        ],
        texels: vec![[9; 4], [8; 4], [1, 2, 3, 4], [250, 128, 0, 255]],
        ..Mesh::default()
    }
}

fn glb(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = Vec::new();
    mesh.write_glb(&mut bytes).expect("memory takes it");
    bytes
}

/// Returns a glTF file of one triangle, with `from` replaced by `to` in its JSON.
fn changed(from: &str, to: &str) -> String {
    let text = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],
        "buffers":[{"byteLength":36,"uri":"data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
    says(text, from);
    text.replace(from, to)
}

fn said(from: &str, to: &str) -> String {
    Mesh::parse(changed(from, to).as_bytes(), None).unwrap_err().to_string()
}

#[test]
fn a_written_mesh_reads_as_the_same_mesh() {
    for origin in [[0.0; 3], [-5e5, 4e6, 20.5]] {
        let mesh = Mesh { origin, ..mesh() };
        assert_eq!(Mesh::parse(&glb(&mesh), None).expect("a mesh"), mesh);
    }
}

#[test]
fn a_mesh_far_from_the_origin_keeps_its_precision_beside_splats_there() {
    let nodes = "\"translation\":[500000.3,0,0],\"children\":[1]},{\"translation\":[0,0,2],\"mesh\":0";
    let text = changed("\"mesh\":0", nodes);
    // A near mesh, in front of the others.
    let beside = text
        .replace("\"nodes\":[0]", "\"nodes\":[2,0]")
        .replace("}],\n        \"meshes\"", "},{\"mesh\":0}],\"meshes\"");
    let read = Mesh::parse(beside.as_bytes(), None).unwrap();
    assert_eq!((read.origin, read.positions[4]), ([-500_000.3, 0.0, 2.0], [-1.0, 0.0, 0.0]));
    let read = Mesh::parse(text.as_bytes(), None).unwrap();
    assert_eq!((read.origin, read.positions[1]), ([-500_000.3, 0.0, 2.0], [-1.0, 0.0, 0.0]));
    let scene = Scene::generate(3, 0, splat).with_offset([-500_000.0, 0.0, 0.0]);
    let scene = scene.beside(&read, &Similarity::IDENTITY);
    let [x, _, z] = scene.mesh().expect("a mesh").positions[1];
    assert!((x + 1.3).abs() < 1e-6 && z == 2.0, "{x}");
}

#[test]
fn the_first_directional_light_is_read_and_what_is_not_drawn_is_named() {
    let extra = |text: &str| changed("\"scene\":0,", &format!("{text},\"scene\":0,"));
    let lights = extra(
        r#""extensionsUsed":["KHR_lights_punctual"],"extensions":{"KHR_lights_punctual":{"lights":[
        {"type":"directional","color":[1,0,0]},{"type":"directional","color":[0,0,1]}]}}"#,
    );
    let light = |index: usize| format!(r#"{{"extensions":{{"KHR_lights_punctual":{{"light":{index}}}}}}}"#);
    let lights = lights
        .replace(r#"{"nodes":[0]}"#, r#"{"nodes":[0,1,2]}"#)
        .replace(r#"{"mesh":0}"#, &format!(r#"{{"mesh":0}},{},{}"#, light(0), light(1)));
    let read = Mesh::parse(lights.as_bytes(), None).unwrap();
    assert_eq!(read.light.map(|light| light.color), Some([1.0, 0.0, 0.0]));
    assert_eq!(read.left_out, ["lights besides the first directional one"]);
    let others = extra(
        r#""extensionsUsed":["KHR_materials_unlit","EXT_mesh_gpu_instancing"],"materials":[{"alphaMode":"BLEND"}],
        "samplers":[{"wrapT":33071}]"#,
    );
    let others = others.replace(r#"{"POSITION":0}"#, r#"{"POSITION":0,"COLOR_0":0}"#);
    let read = Mesh::parse(others.as_bytes(), None).unwrap();
    let expected = "vertex colours, alpha mode BLEND, wrap modes other than repeat, EXT_mesh_gpu_instancing";
    assert_eq!((read.left_out, read.light), (vec![expected.to_owned()], None));
    assert!(Mesh::parse(changed("5126", "5126").as_bytes(), None).unwrap().left_out.is_empty());
}

#[test]
fn the_default_light_stays_where_a_mesh_turns_and_the_first_mesh_with_a_light_gives_it() {
    let by = Similarity { rotation: DQuat::from_rotation_y(1.0), ..Similarity::IDENTITY };
    let own = Light { direction: [0.0, 0.0, 1.0], ..Light::default() };
    let lit = Mesh { light: Some(own), ..mesh() };
    let direction = |meshes: &[&Mesh]| {
        let scene = Scene::generate(3, 0, splat);
        let scene = meshes.iter().fold(scene, |scene, mesh| scene.beside(mesh, &by));
        let mut bytes = [0; 32];
        scene.write_attribute("mesh.light", 0, 0, &mut bytes).expect("it fits");
        [0, 4, 8].map(|at| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()))
    };
    assert_eq!(direction(&[&mesh()]), Light::default().direction);
    let turned: [f32; 3] = (by.rotation * DVec3::Z).as_vec3().into();
    assert_eq!([direction(&[&mesh(), &lit]), direction(&[&lit, &mesh()])], [turned; 2]);
}

#[test]
fn x_and_y_of_a_file_change_their_signs_and_flat_triangles_get_their_normals() {
    // The triangle (0, 0, 0), (1, 0, 0), (0, 1, 0) is counter-clockwise as seen from +z, the front in glTF.
    let read =
        Mesh::parse(changed("\"mesh\":0", "\"mesh\":0,\"translation\":[0,0,2]").as_bytes(), None).unwrap();
    assert_eq!(read.positions, [[0.0, 0.0, 2.0], [-1.0, 0.0, 2.0], [0.0, -1.0, 2.0]]);
    assert_eq!(read.normals, [[0.0, 0.0, 1.0]; 3]);
    assert_eq!((read.triangles.len(), read.materials.len()), (1, 1));
}

#[test]
fn nodes_below_a_hidden_one_are_not_read() {
    let hidden =
        r#""extensions":{"KHR_node_visibility":{"visible":false}},"children":[2]},{"mesh":0},{"mesh":0"#;
    let text = changed("\"mesh\":0", hidden).replace(r#"{"nodes":[0]}"#, r#"{"nodes":[0,1]}"#);
    assert_eq!(Mesh::parse(text.as_bytes(), None).unwrap().triangles.len(), 1);
    let shown = text.replace("false", "true");
    let required =
        shown.replace("\"scene\":0,", "\"scene\":0,\"extensionsRequired\":[\"KHR_node_visibility\"],");
    assert_eq!(Mesh::parse(required.as_bytes(), None).unwrap().triangles.len(), 2);
}

#[test]
fn positions_of_16_bits_are_read_with_the_extension_that_allows_them() {
    let floats = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let read = |kind: &str| {
        let text = changed("\"scene\":0,", "\"scene\":0,\"extensionsRequired\":[\"KHR_mesh_quantization\"],")
            .replace("5126", kind)
            .replace("\"byteLength\":36}],", "\"byteLength\":36,\"byteStride\":8}],")
            // The 16-bit words 0, 0, 0; 32767, 0, 0; and 0, -32768, 0.
            .replace(floats, "AAAAAAAAAAD/fwAAAAAAAAAAAIAAAAAAAAAAAAAAAAAAAAAA");
        Mesh::parse(text.as_bytes(), None).unwrap().positions
    };
    assert_eq!(read("5122,\"normalized\":true"), [[0.0; 3], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(read("5122"), [[0.0; 3], [-32767.0, 0.0, 0.0], [0.0, 32768.0, 0.0]]);
    assert_eq!(read("5123")[2], [0.0, -32768.0, 0.0]);
}

#[test]
fn a_mirrored_node_keeps_its_front_outside() {
    let read = Mesh::parse(changed("\"mesh\":0", "\"mesh\":0,\"scale\":[-1,1,1]").as_bytes(), None).unwrap();
    assert_eq!(read.normals, [[0.0, 0.0, 1.0]; 3]);
}

#[test]
fn attributes_are_the_lists_as_bytes_and_zeros_without_a_mesh() {
    let bare = Scene::generate(3, 0, splat);
    let scene = Scene::generate(3, 0, splat).with_mesh(Some(mesh().into()));
    assert_ne!(scene.identity(), bare.identity());
    let words = |scene: &Scene, name: &str| -> Vec<u32> {
        let info = scene.attribute(name).expect("an attribute");
        let mut bytes = vec![7; (info.stride * info.count) as usize];
        scene.write_attribute(name, 0, 0, &mut bytes).expect("it fits");
        bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    };
    assert_eq!(words(&scene, "mesh.index"), [0, 1, 2, 0, 2, 3, 4, 5, 6]);
    assert_eq!(words(&scene, "mesh.position")[3], 1f32.to_bits());
    assert_eq!(words(&scene, "mesh.texel")[2..], [0x0403_0201, 0xFF00_80FA]);
    let material = words(&scene, "mesh.material");
    assert_eq!((&material[14..16], material[18]), (&[0, 2 | 1 << 16][..], 1f32.to_bits()));
    assert_eq!((&material[20 + 8..20 + 10], material[39]), (&[2, 2 | 1 << 16][..], 1f32.to_bits()));
    assert_eq!(words(&scene, "mesh.light")[7], 0.25f32.to_bits());
    for name in MESH_ATTRIBUTES {
        assert!(words(&bare, name).iter().all(|word| *word == 0), "{name}");
    }
}

#[test]
fn a_mesh_moves_and_joins_with_its_scene() {
    let by = Similarity {
        rotation: DQuat::from_rotation_y(0.5),
        scale: 2.0,
        translation: DVec3::new(1.0, 2.0, 3.0),
    };
    let scene = Scene::generate(3, 0, splat).with_mesh(Some(mesh().into()));
    let moved = scene.transformed(&by).unwrap();
    let (own, at) = (moved.mesh().expect("a mesh"), |p: [f32; 3]| DVec3::from(p.map(f64::from)));
    let expected = by.rotation * at(mesh().positions[2]) * 2.0 + by.translation;
    assert!(at(own.positions[2]).distance(expected) < 1e-6);
    assert!(at(own.normals[0]).distance(by.rotation * DVec3::NEG_Z) < 1e-6);
    let joined = Scene::joined(&[scene, moved]).unwrap();
    let all = joined.mesh().expect("both meshes");
    assert_eq!((all.triangles[3], all.material_of[5]), ([7, 8, 9], 3));
    assert_eq!(all.materials[3].base_color_image.first, 6);
}

#[test]
fn scene_files_place_meshes_and_a_mesh_alone_is_no_scene() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("stone.glb"), glb(&mesh())).unwrap();
    Scene::generate(3, 0, splat).write_ply(at("pond.ply")).unwrap();
    let text = r#"Scenes([Scene(file: "pond.ply"), Scene(file: "stone.glb", translate: (0, 0, 4))])"#;
    std::fs::write(at("all.ron"), text).unwrap();
    let scene = Scene::load(at("all.ron"), crate::QUIET).expect("a scene");
    assert_eq!((scene.count(), scene.mesh().expect("a mesh").positions[0]), (3, [0.0, 0.0, 5.0]));
    says(
        Scene::load(at("stone.glb"), crate::QUIET).unwrap_err(),
        "expected splats, found a mesh; a scene file",
    );
    assert!(matches!(
        Scene::load_any(at("stone.glb"), crate::ReadOptions::default(), crate::QUIET),
        Ok(Content::Mesh(_))
    ));
}

#[test]
fn a_list_counts_the_buffers_of_a_mesh_and_names_what_the_mesh_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    let uri = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let text = changed(uri, "one.bin").replace(r#"{"POSITION":0}"#, r#"{"POSITION":0,"COLOR_0":0}"#);
    write("stone.gltf", text.as_bytes());
    write("one.bin", &[[0; 12], [1; 12], [2; 12]].concat());
    Scene::generate(3, 0, splat).write_ply(folder.path().join("pond.ply")).unwrap();
    write("all.ron", br#"Scenes([Scene(file: "pond.ply"), Scene(file: "stone.gltf")])"#);
    let scene = Scene::load(folder.path().join("all.ron"), crate::QUIET).expect("a scene");
    let sizes = scene.size_breakdown();
    assert_eq!((sizes.elements[1].bytes, sizes.sum()), (text.len() as u64 + 36, sizes.file_bytes));
    assert_eq!(scene.mesh().expect("a mesh").left_out, ["vertex colours (stone.gltf)"]);
}

#[test]
fn mistakes_are_told_with_their_part() {
    for (from, to, expected) in [
        ("\"count\":3", "\"count\":4", "accessor 0"),
        ("\"count\":3", "\"count\":4000000000", "accessor 0"),
        ("\"byteLength\":36,", "\"byteLength\":37,", "buffer 0`: expected 37 bytes, found 36"),
        ("\"buffer\":0,", "\"buffer\":0,\"byteOffset\":4,", "buffer view 0 is beyond its buffer"),
        ("5126", "5125", "expected floats"),
        (
            "\"scene\":0,",
            "\"scene\":0,\"extensionsRequired\":[\"KHR_mesh_quantization\"],\"extensionsUsed\":[\"KHR_texture_transform\"],",
            "expected KHR_mesh_quantization without KHR_texture_transform, found both",
        ),
        ("\"VEC3\"", "\"VEC2\"", "expected Vec3, found Vec2"),
        (
            "{\"POSITION\":0}",
            "{\"POSITION\":0},\"mode\":0",
            "expected a primitive of triangles, found Points",
        ),
        ("data:;base64,", "../secret.bin?", "expected a file in the folder"),
        ("base64,AAAAAAAA", "base64,AADAfwAA", "expected finite numbers, found NaN"),
        ("\"mesh\":0}]", "\"mesh\":0,\"children\":[0]}]", "expected a tree, found a node with two parents"),
        ("[0]}],\"nodes\":[", "[0,0]}],\"nodes\":[{},", "expected a tree"),
        (
            "\"scene\":0,",
            "\"textures\":[{}],\"scene\":0,",
            "only PNG and JPEG are read, not the images of extensions",
        ),
        (
            "\"scene\":0,",
            "\"textures\":[{\"source\":9}],\"scene\":0,",
            "found: textures[0].source: Index out of bounds",
        ),
        (
            "{\"mesh\":0}",
            "{\"mesh\":0,\"extensions\":{\"KHR_node_visibility\":{\"visible\":false}}}",
            "expected visible triangles in the default scene, found none",
        ),
        ("{\"POSITION\":0}", "{\"POSITION\":9}", "expected an accessor below 1, found 9"),
        ("\"scene\":0,", "\"scene\":0,\"extensionsRequired\":[\"KHR_x\"],", "found KHR_x"),
    ] {
        let text = said(from, to);
        assert!(text.contains(expected), "{to}: {text}");
        assert!(!text.contains("bounds; only PNG"), "{text}");
    }
}

#[test]
fn positions_are_counted_for_every_node_and_primitive_that_reads_them() {
    let primitives = vec![r#"{"attributes":{"POSITION":0}}"#; 1500].join(",");
    let text = changed(r#"{"attributes":{"POSITION":0}}"#, &primitives);
    let nodes = vec![r#"{"mesh":0}"#; 1500].join(",");
    let text = text.replace(r#""nodes":[{"mesh":0}"#, &format!(r#""nodes":[{nodes}"#));
    // The scene has one of the nodes.
    assert_eq!(Mesh::parse(text.as_bytes(), None).unwrap().triangles.len(), 1500);
    let roots = (0..1500).map(|node| node.to_string()).collect::<Vec<_>>().join(",");
    let text = text.replace("{\"nodes\":[0]}", &format!("{{\"nodes\":[{roots}]}}"));
    let said = Mesh::parse(text.as_bytes(), None).unwrap_err();
    says(said, "`nodes`: expected at most 536870912 positions and indices in all, found 582750000");
}

#[test]
fn of_several_errors_in_a_document_the_first_is_shown_and_the_others_are_counted() {
    let text = said("\"nodes\":[{\"mesh\":0}", "\"nodes\":[{\"mesh\":7},{\"mesh\":8},{\"mesh\":9}");
    assert!(text.contains("nodes[0].mesh: Index out of bounds, and 2 more"), "{text}");
}

#[cfg(unix)]
#[test]
fn buffers_share_the_start_of_the_file_that_they_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.bin");
    let corners = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    std::fs::write(&path, corners.map(f32::to_le_bytes).as_flattened()).unwrap();
    // A sparse file, which takes no space.
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
    let uri = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"}";
    let text = changed(uri, "one.bin\"},{\"byteLength\":12,\"uri\":\"./one.bin\"}");
    let read = |text: &str| Mesh::parse(text.as_bytes(), Some(folder.path()));
    assert!(read(&text).is_err_and(|error| error.to_string().contains("in the folder of the document")));
    let text = text.replace("./one", "%6Fne");
    assert_eq!(read(&text).unwrap().positions, [[0.0; 3], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]);
    let said = read(&text.replace(":12", ":1073741825")).unwrap_err().to_string();
    assert!(said.contains("buffer 1`: expected at most 1073741824 bytes, found 1073741825"), "{said}");
}

#[test]
fn a_binary_file_that_was_cut_short_is_told_with_both_lengths() {
    let whole = glb(&mesh());
    let told = |length: usize| Mesh::parse(&whole[..length], None).expect_err("it is refused").to_string();
    assert_eq!(told(10), "`header`: expected 12 bytes, found 10");
    let expected = format!("`header`: expected a file of {} bytes, found 100", whole.len());
    assert_eq!(told(100), expected);
    // The crate `gltf` subtracts the 12 bytes of the header from this length.
    let mut short = whole.clone();
    short[8..12].copy_from_slice(&11u32.to_le_bytes());
    let error = Mesh::parse(&short, None).expect_err("it is refused").to_string();
    assert_eq!(error, "`header`: expected a length of at least 12 bytes, found 11");
}

#[test]
fn damaged_files_are_errors_or_meshes_but_never_a_panic() {
    let bytes = glb(&mesh());
    for at in 0..bytes.len() {
        for value in [0, 0xFF, b'9', bytes[at] ^ 1] {
            let mut damaged = bytes.clone();
            damaged[at] = value;
            // Both an error and a mesh are correct.
            let _ = Mesh::parse(&damaged, None);
        }
        let _ = Mesh::parse(&bytes[..at], None);
    }
}
