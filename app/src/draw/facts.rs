//! Collects facts and imports for graphs, from the scene, the device and the viewport.
//!
//! Plans can be built without a scene or a GPU: for the nominal scene and for [`portable_device`], which has the
//! smallest limits on which the built-in graphs run.

use crate::draw::camera::{CAMERA, CAMERA_BYTES};
use crate::draw::keys;
use splatgraph_assets::{ATTRIBUTES, Filter, MESH_ATTRIBUTES, PROPERTY_ATTRIBUTE, Scene, SortKey, Splat};
use splatgraph_framework::ir::{
    Attribute, Catalog, DeviceFacts, FEATURE_FACTS, Facts, Family, Features, Value,
};
use std::collections::BTreeMap;

/// Default width and height of a picture, in pixels.
pub const DEFAULT_SIZE: (u32, u32) = (960, 540);

/// Facts of a scene, as graphs see them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneFacts {
    /// Number of splats.
    pub count: u64,
    /// Highest band of spherical harmonics with a nonzero coefficient.
    pub sh_degree: u32,
    /// Degree of the spherical harmonics in the file.
    pub stored_sh_degree: u32,
    /// Width of depth keys that sort all splats correctly in every view, in bits; see [`keys::of_scene`].
    pub key_bits: u32,
    /// Low-pass filter used in training, from the file's tags.
    pub low_pass: Filter,
    /// Distance by which splats are sorted (view depth or distance from the camera), from the file's tags.
    pub key_of: SortKey,
    /// True if positions exceed the precision of f32; see [`Scene::is_wide`].
    pub wide: bool,
    /// Largest absolute value of a coefficient of the spherical harmonics, rounded up.
    pub largest_sh: u64,
    /// Upper bound of the splats' display-encoded brightness, rounded up.
    pub brightest: u64,
    /// Number of triangles of the scene's mesh.
    pub triangles: u64,
    /// False for a loaded scene without a mesh. A scene that is not loaded may have one.
    pub mesh_possible: bool,
}

impl SceneFacts {
    /// Facts of the nominal scene, for plans that are built without a scene.
    pub const NOMINAL: SceneFacts = SceneFacts {
        count: 1_000_000,
        sh_degree: 3,
        stored_sh_degree: 3,
        key_bits: *keys::WIDTHS.end(),
        low_pass: Filter::Dilated,
        key_of: SortKey::Depth,
        wide: false,
        largest_sh: 4,
        brightest: 8,
        triangles: 0,
        mesh_possible: true,
    };

    /// Collects the facts of a loaded scene.
    pub fn of(scene: &Scene) -> SceneFacts {
        SceneFacts {
            count: scene.count().into(),
            sh_degree: scene.effective_degree(),
            stored_sh_degree: scene.stored_degree(),
            low_pass: scene.notes().low_pass,
            key_of: scene.notes().key_of,
            wide: scene.is_wide(),
            key_bits: keys::of_scene(&scene.bounds()),
            largest_sh: scene.color_range().largest_sh.ceil() as u64,
            brightest: scene.color_range().brightest.ceil() as u64,
            triangles: scene.mesh().map_or(0, |mesh| mesh.triangles.len() as u64),
            mesh_possible: scene.mesh().is_some(),
        }
    }
}

/// Returns the facts for a graph that draws a scene. `size` is the picture's width and height in pixels.
pub fn facts(scene: &SceneFacts, device: &DeviceFacts, size: (u32, u32)) -> Facts {
    let mut facts = without_scene(device, size);
    let scene_facts = [
        ("scene.count", scene.count as i64),
        ("scene.sh_degree", scene.sh_degree.into()),
        ("scene.stored_sh_degree", scene.stored_sh_degree.into()),
        ("scene.key_bits", scene.key_bits.into()),
        ("scene.largest_sh", i64::try_from(scene.largest_sh).unwrap_or(i64::MAX)),
        ("scene.brightest", i64::try_from(scene.brightest).unwrap_or(i64::MAX)),
        ("mesh.triangles", scene.triangles as i64),
    ];
    facts.host.extend(scene_facts.map(|(name, value)| (name.to_owned(), Value::Int(value))));
    let bools = [("scene.wide", scene.wide), ("mesh.possible", scene.mesh_possible)];
    facts.host.extend(bools.map(|(name, value)| (name.to_owned(), Value::Bool(value))));
    let texts = [("scene.low_pass", scene.low_pass.name()), ("scene.key_of", scene.key_of.name())];
    facts.host.extend(texts.map(|(name, text)| (name.to_owned(), Value::Text(text.to_owned()))));
    let all = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
    facts.texts.insert("scene.low_pass".into(), all(&Filter::ALL.map(Filter::name)));
    facts.texts.insert("scene.key_of".into(), all(&SortKey::ALL.map(SortKey::name)));
    facts
}

/// Returns the facts of the nominal scene on [`portable_device`], in a picture of the default size.
pub fn nominal(subgroup_size: u32) -> Facts {
    facts(&SceneFacts::NOMINAL, &portable_device(subgroup_size), DEFAULT_SIZE)
}

/// Returns the facts for a graph that draws no scene. The size is in pixels.
pub fn without_scene(device: &DeviceFacts, (width, height): (u32, u32)) -> Facts {
    let viewport = [("viewport.width", width), ("viewport.height", height)];
    Facts {
        device: *device,
        host: viewport.map(|(name, value)| (name.to_owned(), Value::Int(value.into()))).into(),
        texts: BTreeMap::new(),
    }
}

/// Maximum number of storage buffers in a shader of the built-in graphs.
///
/// The maximum is reached by `project` for tiles, with harmonics of degree 3 in f32 and the output `depth`.
pub const MAX_STORAGE_BUFFERS: usize = 20;

/// Maximum number of storage buffers in a shader that all desktop GPUs support: Apple's.
pub const DESKTOP_STORAGE_BUFFERS: usize = 31;

/// Subgroup sizes of devices, ascending; 128 is Adreno's. The built-in graphs are checked for each.
pub const SUBGROUP_SIZES: [u32; 6] = [4, 8, 16, 32, 64, 128];

/// Subgroup size that plans without a device assume: that of most GPUs.
pub const USUAL_SUBGROUP_SIZE: u32 = 32;

/// Optional features that the built-in graphs use.
pub const PORTABLE_FEATURES: Features = Features::SUBGROUP_BASIC
    .union(Features::SUBGROUP_VOTE)
    .union(Features::SUBGROUP_ARITHMETIC)
    .union(Features::SUBGROUP_BALLOT)
    .union(Features::SUBGROUP_SHUFFLE);

/// Returns the facts of the smallest device on which the built-in graphs run.
///
/// Storage range, workgroup count and shared memory are the minima that Vulkan 1.3 guarantees. Beyond its guarantees,
/// the graphs require 256 invocations per workgroup (guaranteed: 128), [`MAX_STORAGE_BUFFERS`] storage buffers per
/// shader (guaranteed: 4), and [`PORTABLE_FEATURES`] (guaranteed: only the basic subgroup operations).
///
/// Images have the maximum size that all desktop GPUs support (guaranteed: 4096), and passes up to 8 targets
/// (guaranteed: 4).
pub fn portable_device(subgroup_size: u32) -> DeviceFacts {
    DeviceFacts {
        subgroup_size,
        max_storage_bytes: 1 << 27,
        max_groups: [65_535; 3],
        shared_bytes: 16 << 10,
        max_invocations: 256,
        max_push_bytes: 128,
        max_targets: 8,
        max_image_size: 16_384,
        rounds_half: false,
        fused_fma: false,
        features: PORTABLE_FEATURES,
    }
}

/// Returns the facts of the smallest GPU of family Apple 7.
///
/// Buffer size, threadgroup memory and threads are the minima in Apple's "Metal Feature Set Tables", and `fma` rounds
/// once. All else is as for [`portable_device`].
pub fn apple_device() -> DeviceFacts {
    DeviceFacts {
        max_storage_bytes: 1 << 28,
        shared_bytes: 32 << 10,
        max_invocations: 1024,
        fused_fma: true,
        ..portable_device(USUAL_SUBGROUP_SIZE)
    }
}

/// Sets a fact of a device, by the name that graphs use.
///
/// # Errors
/// The name is unknown, or the value has another type or is out of range.
pub fn set_device_fact(device: &mut DeviceFacts, name: &str, value: &Value) -> Result<(), String> {
    let number = || match value {
        Value::Int(number @ 0..) => Ok(*number as u64),
        _ => Err(format!("expected a natural number for `{name}`, found {value}")),
    };
    let short = || u32::try_from(number()?).map_err(|_| format!("`{name}` is larger than 4294967295"));
    let truth = || match value {
        Value::Bool(truth) => Ok(*truth),
        _ => Err(format!("expected true or false for `{name}`, found {value}")),
    };
    if let Some((_, feature)) = FEATURE_FACTS.iter().find(|(fact, _)| *fact == name) {
        let truth = truth()?;
        device.features.set(*feature, truth);
        if truth && name.starts_with("device.subgroup_") {
            // Subgroups with any of these operations have the basic ones, for which there is no fact.
            device.features.insert(Features::SUBGROUP_BASIC);
        }
        return Ok(());
    }
    match name {
        "device.subgroup_size" => {
            let lanes = short()?;
            if !SUBGROUP_SIZES.contains(&lanes) {
                return Err(format!("expected a power of two from 4 to 128 for `{name}`, found {lanes}"));
            }
            device.subgroup_size = lanes;
        }
        "device.max_storage_bytes" => device.max_storage_bytes = number()?,
        "device.max_groups_x" => device.max_groups[0] = short()?,
        "device.max_image_size" => device.max_image_size = short()?,
        "device.max_invocations" => device.max_invocations = short()?,
        "device.shared_bytes" => device.shared_bytes = short()?,
        "device.rounds_half" => device.rounds_half = truth()?,
        "device.fused_fma" => device.fused_fma = truth()?,
        _ => {
            let known: Vec<&str> = device.named().iter().map(|(name, _)| *name).collect();
            return Err(format!("expected one of {}, found `{name}`", known.join(", ")));
        }
    }
    Ok(())
}

/// Lists the imports of a graph that draws `scene`.
pub fn catalog(scene: &Scene) -> Catalog {
    let properties = scene.property_names().iter().map(|name| format!("{PROPERTY_ATTRIBUTE}{name}"));
    let names = ATTRIBUTES.iter().chain(&MESH_ATTRIBUTES).map(|name| (*name).to_owned()).chain(properties);
    let attributes = names.filter_map(|name| {
        let info = scene.attribute(&name)?;
        Some((name, Attribute { stride: info.stride, count: info.count, planes: info.planes }))
    });
    let help = "--property NAME loads a property of a PLY file".to_owned();
    Catalog {
        attributes: attributes.collect(),
        families: [(PROPERTY_ATTRIBUTE.to_owned(), Family { any: None, help })].into(),
        uniforms: [(CAMERA.to_owned(), CAMERA_BYTES)].into(),
        ..Catalog::default()
    }
}

/// Changes the number of splats in a catalog. The attributes of a mesh keep their counts.
pub fn with_count(mut catalog: Catalog, splats: u64) -> Catalog {
    for name in ATTRIBUTES {
        if let Some(attribute) = catalog.attributes.get_mut(name) {
            attribute.count = splats;
        }
    }
    let any = catalog.families.values_mut().filter_map(|family| family.any.as_mut());
    any.for_each(|attribute| attribute.count = splats);
    catalog
}

/// Lists the imports of a graph that draws the nominal scene.
pub fn nominal_catalog() -> Catalog {
    let splat = |_| Splat {
        position: [0.0; 3],
        scale: [1.0; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 1.0,
        sh: [0.0; 48],
    };
    // Strides depend only on the degree.
    let scene = Scene::generate(1, SceneFacts::NOMINAL.stored_sh_degree, splat);
    let mut catalog = catalog(&scene);
    let any = Attribute { stride: 4, count: SceneFacts::NOMINAL.count, planes: 1 };
    catalog.families.values_mut().for_each(|family| family.any = Some(any));
    with_count(catalog, SceneFacts::NOMINAL.count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_catalog_has_every_attribute_of_a_scene_of_degree_3_and_the_camera() {
        let catalog = nominal_catalog();
        assert_eq!(catalog.attributes.len(), ATTRIBUTES.len() + MESH_ATTRIBUTES.len());
        let expected = Attribute { stride: 16, count: 1_000_000, planes: 12 };
        assert_eq!(catalog.attributes["scene.sh"], expected);
        assert_eq!(catalog.uniforms["frame.camera"], 256);
    }
}
