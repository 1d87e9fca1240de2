//! Defines the facts of the device that graphs and the linker use.

use serde::{Serialize, Serializer};

use super::{Features, Value};

/// The features that graphs can read as facts, by the fact's name.
pub const FEATURE_FACTS: [(&str, Features); 15] = [
    ("device.buffer_float_atomic_add", Features::BUFFER_FLOAT_ATOMIC_ADD),
    ("device.buffer_float_atomics", Features::BUFFER_FLOAT_ATOMICS),
    ("device.float64", Features::FLOAT64),
    ("device.fragment_stores", Features::FRAGMENT_STORES),
    ("device.image_float_atomic_add", Features::IMAGE_FLOAT_ATOMIC_ADD),
    ("device.image_float_atomics", Features::IMAGE_FLOAT_ATOMICS),
    ("device.int64", Features::INT64),
    ("device.shared_float_atomic_add", Features::SHARED_FLOAT_ATOMIC_ADD),
    ("device.shared_float_atomics", Features::SHARED_FLOAT_ATOMICS),
    ("device.subgroup_arithmetic", Features::SUBGROUP_ARITHMETIC),
    ("device.subgroup_ballot", Features::SUBGROUP_BALLOT),
    ("device.subgroup_shuffle", Features::SUBGROUP_SHUFFLE),
    ("device.subgroup_uniform_control_flow", Features::SUBGROUP_UNIFORM_CONTROL_FLOW),
    ("device.subgroup_vote", Features::SUBGROUP_VOTE),
    ("device.vertex_stores", Features::VERTEX_STORES),
];

/// Device limits and features that graphs and the linker use; 0 and absent by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceFacts {
    /// Number of invocations in a subgroup of a compute shader.
    pub subgroup_size: u32,
    /// Maximum size of a storage buffer binding, in bytes.
    pub max_storage_bytes: u64,
    /// Maximum number of workgroups of a dispatch in x, y and z.
    pub max_groups: [u32; 3],
    /// Maximum shared memory of a workgroup, in bytes.
    pub shared_bytes: u32,
    /// Maximum number of invocations of a workgroup.
    pub max_invocations: u32,
    /// Maximum size of the push constants of a pass, in bytes.
    pub max_push_bytes: u32,
    /// Maximum number of colour targets of a draw.
    pub max_targets: u32,
    /// Maximum width and height of an image, in pixels.
    pub max_image_size: u32,
    /// True if blending into half-precision targets is known to round to nearest, or is the device's most precise
    /// blending. False if it may truncate.
    pub rounds_half: bool,
    /// True if `fma` in shaders is known to round once; false if it may also round the product.
    pub fused_fma: bool,
    /// Optional features that the device was, or would be, opened with.
    pub features: Features,
}

impl DeviceFacts {
    /// Returns facts for plans without a device: limits that a common desktop GPU meets, and all features.
    ///
    /// A device with another subgroup size refuses the plan if a shader uses subgroup operations.
    pub fn typical(subgroup_size: u32) -> DeviceFacts {
        DeviceFacts {
            subgroup_size,
            max_storage_bytes: 128 << 20,
            max_groups: [65_535; 3],
            shared_bytes: 32 << 10,
            max_invocations: 1024,
            max_push_bytes: 256,
            max_targets: 8,
            max_image_size: 32_768,
            rounds_half: true,
            fused_fma: true,
            features: Features::all(),
        }
    }

    /// Lists the facts that graphs can read, with their names, in alphabetical order.
    pub fn named(&self) -> Vec<(&'static str, Value)> {
        let bytes = i64::try_from(self.max_storage_bytes).unwrap_or(i64::MAX);
        let mut all = vec![
            ("device.fused_fma", Value::Bool(self.fused_fma)),
            ("device.max_groups_x", Value::Int(self.max_groups[0].into())),
            ("device.max_image_size", Value::Int(self.max_image_size.into())),
            ("device.max_invocations", Value::Int(self.max_invocations.into())),
            ("device.max_storage_bytes", Value::Int(bytes)),
            ("device.rounds_half", Value::Bool(self.rounds_half)),
            ("device.shared_bytes", Value::Int(self.shared_bytes.into())),
            ("device.subgroup_size", Value::Int(self.subgroup_size.into())),
        ];
        all.extend(FEATURE_FACTS.map(|(name, feature)| (name, Value::Bool(self.features.contains(feature)))));
        all.sort_unstable_by_key(|(name, _)| *name);
        all
    }
}

impl Serialize for DeviceFacts {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.named())
    }
}
