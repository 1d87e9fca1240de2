//! A nominal scene and device, for plans without a real one: their facts and importable data.

use splatgraph_framework::ir::{Attribute, Catalog, DeviceFacts, Facts, Value};

pub const CAMERA_BYTES: u64 = 256;

/// Returns the facts of a scene of `count` splats of degree 3, drawn at a size in pixels. The device has subgroups of
/// 32 lanes and every feature.
pub fn facts(count: u32, (width, height): (u32, u32)) -> Facts {
    let ints = [
        ("scene.count", count),
        ("scene.sh_degree", 3),
        ("scene.stored_sh_degree", 3),
        ("scene.key_bits", 24),
        ("scene.largest_sh", 4),
        ("scene.brightest", 8),
        ("mesh.triangles", 0),
        ("viewport.width", width),
        ("viewport.height", height),
    ];
    let ints = ints.map(|(name, value)| (name.to_string(), Value::Int(value.into())));
    let texts = [("scene.low_pass", "dilated"), ("scene.key_of", "depth")];
    let texts = texts.map(|(name, text)| (name.to_string(), Value::Text(text.to_string())));
    let bools = [("scene.wide", false), ("mesh.possible", true)];
    let bools = bools.map(|(name, value)| (name.to_string(), Value::Bool(value)));
    let host = ints.into_iter().chain(texts).chain(bools).collect();
    Facts { host, ..DeviceFacts::typical(32).into() }
}

/// Returns the importable data of a scene of `count` splats without a mesh: attributes of splats and mesh, and the
/// camera.
pub fn catalog(count: u32) -> Catalog {
    let attributes = [
        ("position", 12, 1),
        ("position_wide", 24, 1),
        ("scale", 12, 1),
        ("rotation", 16, 1),
        ("opacity", 4, 1),
        ("sh", 16, 12),
    ];
    let attribute =
        |(name, stride, planes)| (format!("scene.{name}"), Attribute { stride, count: count.into(), planes });
    // A scene without a mesh has one element of each attribute, and two for the light.
    let mesh = [
        ("position", 12, 1),
        ("normal", 12, 1),
        ("uv", 8, 1),
        ("index", 4, 1),
        ("material_of", 4, 1),
        ("material", 80, 1),
        ("texel", 4, 1),
        ("light", 16, 2),
    ];
    let of_mesh = |(name, stride, count)| (format!("mesh.{name}"), Attribute { stride, count, planes: 1 });
    Catalog {
        attributes: attributes.map(attribute).into_iter().chain(mesh.map(of_mesh)).collect(),
        uniforms: [("frame.camera".to_string(), CAMERA_BYTES)].into(),
        ..Catalog::default()
    }
}
