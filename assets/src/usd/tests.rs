//! Checks the values of layers that OpenUSD wrote, transforms, and refusals of unsupported layers.

use crate::QUIET;
use crate::input::{Input, Source};
use crate::scene::{Scene, SortKey};
use crate::testing::{parse as read, says};
use std::path::PathBuf;

pub(crate) fn file(end: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/usd").join(format!("splats.{end}"));
    std::fs::read(path).unwrap()
}

fn near(a: &[f32], b: &[f64], step: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (f64::from(*a) - b).abs() <= step)
}

#[test]
fn layers_of_openusd_have_the_places_that_it_computes() {
    for end in ["usda", "usdc", "usdz"] {
        let bytes = file(end);
        let scene = read(&bytes).unwrap_or_else(|error| panic!("{end}: {error}"));
        assert_eq!((scene.count(), scene.stored_degree(), scene.dropped().total()), (22, 1, 0), "{end}");
        assert_eq!(scene.notes().key_of, SortKey::Distance);
        let sizes = scene.size_breakdown();
        assert_eq!((sizes.sum(), sizes.file_bytes), (bytes.len() as u64, bytes.len() as u64), "{end}");
        // The first two splats of both prims: place in the world, scale factor and scales, opacity.
        let expected = [
            (0, [1.578980949, 0.958878019, 2.592393944], 2.0, [0.890625, 1.0, 0.890625], 0.1953125),
            (1, [-1.446570945, 0.911089835, 3.907867538], 2.0, [0.84375, 0.734375, 0.625], 0.59375),
            (20, [1.108103567, 3.509559096, 21.588194857], 6.0, [0.765625, 0.875, 0.984375], 0.2421875),
            (21, [-2.66822377, 0.824179708, 24.589620873], 6.0, [0.96875, 0.859375, 0.75], 0.40625),
        ];
        for (index, [x, y, z], factor, scale, opacity) in expected {
            let splat = scene.splat(index);
            assert!(near(&splat.position, &[-x, -z, -y], 1e-6), "{end} {index}: {:?}", splat.position);
            assert!(near(&splat.scale, &scale.map(|value: f64| value * factor), 1e-6), "{:?}", splat.scale);
            assert_eq!(splat.opacity, opacity);
        }
    }
    // A value in the middle of the layer, which no check of its structure covers.
    let mut damaged = file("usdz");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 4;
    says(read(&damaged).unwrap_err().to_string(), "expected an intact layer, found damage: ");
    // The method of compression in the header of the file, and in the directory.
    let mut compressed = file("usdz");
    let directory = compressed.windows(4).position(|bytes| bytes == b"PK\x01\x02").unwrap();
    (compressed[8], compressed[directory + 10]) = (8, 8);
    says(read(&compressed).unwrap_err().to_string(), "expected an uncompressed file");
    let over = read(layer("", "").replace("[0.5, 1]", "[-0.5, 1.5]").as_bytes()).unwrap();
    assert_eq!((over.opacities(), over.notes().clamped_opacities), (&[0.0, 1.0][..], 2));
    let [text, binary, package] = ["usda", "usdc", "usdz"].map(|end| read(&file(end)).unwrap());
    assert_eq!((text.identity(), binary.identity()), (binary.identity(), package.identity()));
}

/// Builds a text layer of two splats of degree 0, with the given metadata and further attributes of the prim.
fn layer(metadata: &str, attributes: &str) -> String {
    format!(
        r#"#usda 1.0
({metadata})
def Xform "World" {{
    def ParticleField3DGaussianSplat "S" (apiSchemas = ["A", "B"]) {{
        {attributes}
        point3f[] positions = [(1, 2, 3), (4, 5, 6)] (doc = "a ) b")
        quatf[] orientations = [(1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)]
        float3[] scales = [(1, 2, 3), (1, 1, 1)]
        float[] opacities = [0.5, 1] # a comment ]
        int radiance:sphericalHarmonicsDegree = 0
        color3f[] radiance:sphericalHarmonicsCoefficients = [(1, 0, -1), (0.25, 0.5, 0.75),]
    }}
}}
"#
    )
}

fn said(text: &str) -> String {
    read(text.as_bytes()).unwrap_err().to_string()
}

#[test]
fn axes_of_the_world_point_up_along_y_or_z() {
    let place = |metadata: &str| read(layer(metadata, "").as_bytes()).unwrap().splat(0);
    let y = place("");
    assert_eq!(
        (y.position, y.scale, y.sh[..3].to_vec()),
        ([-1.0, -2.0, 3.0], [1.0, 2.0, 3.0], vec![1.0, 0.0, -1.0])
    );
    assert_eq!(place("upAxis = \"Y\"").position, y.position);
    assert_eq!(place("upAxis = \"Z\"\n metersPerUnit = 0.01").position, [-1.0, -3.0, -2.0]);
    says(said(&layer("upAxis = \"X\"", "")), "`upAxis`: expected Y or Z, found X");
    assert_eq!(read(layer("", "").as_bytes()).unwrap().notes().key_of, SortKey::Depth);
}

#[test]
fn harmonics_turn_with_the_prim() {
    use glam::{DQuat, DVec3};
    let with = |operation: &str| {
        let text = layer("", operation).replace("Degree = 0", "Degree = 1").replace(
            "(1, 0, -1), (0.25, 0.5, 0.75),",
            "(1,0,0), (0.5,0,0), (0.25,0,0), (0.125,0,0), (1,1,1), (1,1,1), (1,1,1), (1,1,1)",
        );
        read(text.as_bytes()).unwrap()
    };
    let turned = with(
        "float3 xformOp:rotateXYZ = (10, 20, 30)\n uniform token[] xformOpOrder = [\"xformOp:rotateXYZ\"]",
    );
    let [x, y, z] = [(DVec3::X, 10f64), (DVec3::Y, 20.0), (DVec3::Z, 30.0)]
        .map(|(axis, angle)| DQuat::from_axis_angle(axis, angle.to_radians()));
    // The axes of a scene are half a turn about z from the axes of the world.
    let half = DQuat::from_rotation_z(std::f64::consts::PI);
    let rotation = half * (z * y * x) * half.inverse();
    let by = crate::similarity::Similarity { rotation, ..crate::similarity::Similarity::IDENTITY };
    let expected = with("").transformed(&by).unwrap();
    for index in 0..2 {
        let (a, b) = (turned.splat(index), expected.splat(index));
        assert!(near(&a.position, &b.position.map(f64::from), 1e-5), "{:?} {:?}", a.position, b.position);
        assert!(near(&a.sh, &b.sh.map(f64::from), 1e-6), "{:?} {:?}", a.sh, b.sh);
        let dot: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| a * b).sum();
        assert!(dot.abs() > 0.999_999);
    }
}

#[test]
fn what_is_not_drawn_is_refused_by_name() {
    let with = |attributes: &str| said(&layer("", attributes));
    says(
        with("uniform token projectionModeHint = \"tangential\""),
        "/World/S.projectionModeHint`: expected perspective, found tangential",
    );
    says(
        with("uniform token sortingModeHint = \"rayHitDistance\""),
        "expected zDepth or cameraDistance, found rayHitDistance",
    );
    says(
        with("float3 xformOp:scale = (1, 2, 1)\n uniform token[] xformOpOrder = [\"xformOp:scale\"]"),
        "/World/S`: expected a rotation, a uniform scale",
    );
    says(
        with("uniform token[] xformOpOrder = [\"xformOp:scale\"]"),
        "/World/S.xformOp:scale`: expected numbers, which xformOpOrder names",
    );
    says(
        with("double3 xformOp:wobble = (1, 2, 1)\n uniform token[] xformOpOrder = [\"xformOp:wobble\"]"),
        "expected a transform of a known kind, found 3 numbers",
    );
    says(with("token visibility = \"invisible\""), "a USD scene that hides its Gaussian splats (1 prims)");
    says(with("uniform token purpose = \"guide\""), "hides its Gaussian splats");
    let changed = |old: &str, new: &str| said(&layer("", "").replace(old, new));
    says(changed("Degree = 0", "Degree = 2"), "expected 18 elements for 2 splats of degree 2, found 2");
    says(changed("[0.5, 1]", "[0.5]"), "/World/S.opacities`: expected 2 elements, found 1");
    says(
        changed("float3[] scales", "float3[] sizes"),
        "expected the attribute scales or scalesh, found none",
    );
    says(
        changed("opacities = [0.5, 1]", "opacities.timeSamples = { 0: [0.5, 1] }"),
        "/World/S.opacities`: expected one value, found time samples or a spline",
    );
    says(
        with("float[] opacities.timeSamples = { 0: [0.5, 1] }"),
        "/World/S.opacities`: expected one value, found time samples or a spline",
    );
    says(
        changed("apiSchemas =", "prepend references = @a.usda@</A> (offset = 1)\n kinds ="),
        "found references (join them first, e.g. by `usdcat --flatten`)",
    );
    says(changed("ParticleField3DGaussianSplat", "Mesh"), "a USD scene without Gaussian splats");
    for (kind, found) in [("ParticleField", "only applied schemas"), ("OmniNuRecFieldAsset", "NVIDIA NuRec")]
    {
        says(changed("ParticleField3DGaussianSplat", kind), found);
    }
    says(changed("def Xform", "class Xform"), "hides its Gaussian splats");
}

#[test]
fn damage_names_the_line_or_the_byte() {
    let text = layer("", "");
    says(said(&text.replace("(4, 5, 6)", "(4, 5)")), "line 6: expected ,, found )");
    says(said(&text.replace("(4, 5, 6)", "(4, five, 6)")), "line 6: expected a number, found five");
    let binary = file("usdc");
    let with = |at: usize, bytes: &[u8]| {
        let mut changed = binary.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        read(&changed).unwrap_err().to_string()
    };
    says(with(9, &[14]), "byte 8, `version`: expected 0.7 to 0.13, found 0.14");
    says(with(16, &[255; 8]), "byte 16, `tocOffset`: expected 88 to 4307");
    let contents = u64::from_le_bytes(binary[16..24].try_into().unwrap()) as usize;
    says(with(contents + 8, b"TOKENZ"), "`sections`: expected the section TOKENS, found none");
}

#[test]
fn a_text_larger_than_the_memory_is_refused() {
    let text = file("usda");
    let source = Source::Bytes(&text);
    let found = super::parse(&Input::new(&source, Some(10_000), QUIET)).unwrap_err();
    says(found, "expected a layer that fits in memory, found one that needs 18.8 KiB");
}

#[test]
fn numbers_that_stay_in_the_file_need_no_memory() {
    // Finds the least memory with which a file is read.
    let least = |end: &str| {
        let bytes = file(end);
        let source = Source::Bytes(&bytes);
        let fits = |memory: u64| super::parse(&Input::new(&source, Some(memory), QUIET)).is_ok();
        let (mut refused, mut accepted) = (0, 1 << 40);
        while accepted - refused > 1 {
            let middle = refused + (accepted - refused) / 2;
            *(if fits(middle) { &mut accepted } else { &mut refused }) = middle;
        }
        accepted
    };
    // Both files have 23 splats of degree 1, of which one is hidden and two have half floats. The numbers of a text are
    // in memory.
    let numbers = (21 * 4 + 2 * 2) * (3 + 4 + 3 + 1 + 12);
    let (text, binary) = (least("usda"), least("usdc"));
    assert_eq!(text - binary, numbers, "{text} bytes, {binary} bytes");
    let buffers = (rayon::current_num_threads() as u64) << 20;
    let scene = Scene::host_bytes(20, 1);
    assert!(binary < buffers + 2 * scene, "{binary} bytes, for buffers of {buffers} and a scene of {scene}");
}
