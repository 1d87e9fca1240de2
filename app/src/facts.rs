//! What graphs may know: facts of the scene, the device and the viewport, and the attributes that they can import.
//!
//! A plan is built from numbers alone, so it can be built without a scene and without a GPU: for that there are a nominal
//! scene and a portable device. [`portable_device`] has of everything the least that the built-in graphs promise to run on, so
//! what builds for it, in all the widths of [`SUBGROUP_SIZES`], builds everywhere.

use crate::camera::{CAMERA, CAMERA_BYTES};
use crate::view::paint;
use splatgraph_assets::{ATTRIBUTES, Scene, Splat};
use splatgraph_framework::ir::{Attribute, Catalog, DeviceFacts, Facts, Value};

/// Width and height of a picture where nothing says otherwise.
pub const DEFAULT_SIZE: (u32, u32) = (960, 540);

/// The facts of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneFacts {
    /// Number of splats.
    pub count: u64,
    /// The highest band of spherical harmonics that is not all zero.
    pub sh_degree: u32,
    /// The degree that the file stores.
    pub stored_sh_degree: u32,
}

impl SceneFacts {
    /// Stands in where no scene is given.
    pub const NOMINAL: SceneFacts = SceneFacts { count: 1_000_000, sh_degree: 3, stored_sh_degree: 3 };

    /// The facts of a loaded scene.
    pub fn of(scene: &Scene) -> SceneFacts {
        SceneFacts {
            count: scene.count().into(),
            sh_degree: scene.effective_degree(),
            stored_sh_degree: scene.stored_degree(),
        }
    }
}

/// All facts that a graph can use, by full name.
pub fn facts(scene: &SceneFacts, device: &DeviceFacts, (width, height): (u32, u32)) -> Facts {
    let host = [
        ("scene.count", scene.count as i64),
        ("scene.sh_degree", scene.sh_degree.into()),
        ("scene.stored_sh_degree", scene.stored_sh_degree.into()),
        ("viewport.width", width.into()),
        ("viewport.height", height.into()),
    ];
    Facts { device: *device, host: host.map(|(name, value)| (name.to_owned(), Value::Int(value))).into() }
}

/// Lanes of the subgroups of real devices: CPUs have 4 to 16, most GPUs 32, some 64.
pub const SUBGROUP_SIZES: [u32; 5] = [4, 8, 16, 32, 64];

/// What most GPUs have.
pub const USUAL_SUBGROUP_SIZE: u32 = 32;

/// The least device that the built-in graphs run on: what Vulkan 1.3 promises, but for 256 invocations per workgroup, which
/// every known device has.
pub fn portable_device(subgroup_size: u32) -> DeviceFacts {
    DeviceFacts {
        subgroup_size,
        max_storage_bytes: 1 << 27,
        max_groups_x: 65_535,
        shared_bytes: 16 << 10,
        max_invocations: 256,
        rounds_half: false,
    }
}

/// What a graph can import when it draws this scene.
pub fn catalog(scene: &Scene) -> Catalog {
    catalog_of(scene, scene.count().into())
}

/// What any graph can import: of the nominal scene, and of the viewer's window.
pub fn nominal_catalog() -> Catalog {
    let splat = |_| Splat {
        position: [0.0; 3],
        scale: [1.0; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 1.0,
        sh: [0.0; 48],
    };
    // Attributes depend on the degree alone: one splat will do.
    let scene = Scene::generate(1, SceneFacts::NOMINAL.stored_sh_degree, splat);
    let mut catalog = catalog_of(&scene, SceneFacts::NOMINAL.count);
    paint::offer(&mut catalog);
    catalog
}

fn catalog_of(scene: &Scene, count: u64) -> Catalog {
    let attributes = ATTRIBUTES.iter().filter_map(|name| {
        let info = scene.attribute(name)?;
        Some((name.to_string(), Attribute { stride: info.stride, count, planes: info.planes }))
    });
    Catalog {
        attributes: attributes.collect(),
        uniforms: [(CAMERA.to_owned(), CAMERA_BYTES)].into(),
        ..Catalog::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_catalog_has_every_attribute_of_a_scene_of_degree_3_and_the_windows_inputs() {
        let catalog = nominal_catalog();
        assert_eq!(catalog.attributes.len(), ATTRIBUTES.len());
        let expected = Attribute { stride: 16, count: 1_000_000, planes: 12 };
        assert_eq!(catalog.attributes["scene.sh"], expected);
        assert_eq!(catalog.uniforms["frame.camera"], 256);
        assert_eq!(catalog.uniforms["frame.window"], 96);
    }
}
