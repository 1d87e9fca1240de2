//! Facts of the device that graphs and the linker use.

use serde::{Serialize, Serializer};

use super::{Features, Value};

/// Describes a device to graphs and to the linker. The default is a device that can do nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceFacts {
    /// Lanes of the subgroups that compute shaders run with.
    pub subgroup_size: u32,
    /// Bytes of the largest storage binding.
    pub max_storage_bytes: u64,
    /// Workgroups of a dispatch in x, and as many in y.
    pub max_groups_x: u32,
    /// Bytes of shared memory of a workgroup.
    pub shared_bytes: u32,
    /// Invocations of a workgroup.
    pub max_invocations: u32,
    /// Blending rounds to the nearest half-precision float. Without it, digits are cut off.
    pub rounds_half: bool,
    /// Optional features that the device was opened with, or would be.
    pub features: Features,
}

impl DeviceFacts {
    /// Lists the facts under their names in graphs, in alphabetical order.
    pub fn named(&self) -> [(&'static str, Value); 6] {
        let bytes = i64::try_from(self.max_storage_bytes).unwrap_or(i64::MAX);
        [
            ("device.max_groups_x", Value::Int(self.max_groups_x.into())),
            ("device.max_invocations", Value::Int(self.max_invocations.into())),
            ("device.max_storage_bytes", Value::Int(bytes)),
            ("device.rounds_half", Value::Bool(self.rounds_half)),
            ("device.shared_bytes", Value::Int(self.shared_bytes.into())),
            ("device.subgroup_size", Value::Int(self.subgroup_size.into())),
        ]
    }
}

impl Serialize for DeviceFacts {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.named())
    }
}
