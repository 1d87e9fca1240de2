//! Defines the input of a build: a graph's name, parameters, facts and importable data.

use std::collections::BTreeMap;

use super::{DeviceFacts, Value};

/// Prefix of facts that request outputs besides the picture, such as `outputs.depth`. A missing fact is false.
pub const OUTPUTS: &str = "outputs.";

/// Values that expressions can use.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    /// Facts of the device.
    pub device: DeviceFacts,
    /// Facts of the scene and the viewport, by full name: `scene.count`, `viewport.width`, ...
    pub host: BTreeMap<String, Value>,
}

impl Facts {
    /// Maps the full names of all facts to their values.
    pub fn named(&self) -> BTreeMap<String, Value> {
        let device = self.device.named().map(|(name, value)| (name.to_string(), value));
        self.host.clone().into_iter().chain(device).collect()
    }
}

impl From<DeviceFacts> for Facts {
    fn from(device: DeviceFacts) -> Facts {
        Facts { device, host: BTreeMap::new() }
    }
}

/// Data that a graph can import, by full name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Catalog {
    /// Attributes of the scene.
    pub attributes: BTreeMap<String, Attribute>,
    /// Sizes in bytes of the uniform blocks that the host writes for every frame.
    pub uniforms: BTreeMap<String, u64>,
    /// Storage buffers that the host supplies with every frame.
    pub buffers: BTreeMap<String, HostBuffer>,
}

/// A storage buffer that the host supplies with every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostBuffer {
    /// Bytes of an element.
    pub stride: u64,
    /// Minimum number of elements.
    pub least: u64,
}

/// An attribute of the scene: `planes` buffers of `count` elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Bytes of an element.
    pub stride: u64,
    /// Number of elements of each plane.
    pub count: u64,
    /// Number of buffers that the attribute is split into.
    pub planes: u32,
}

/// A request for a plan: a graph and everything that the plan depends on.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// A preset's name or a file's path.
    pub graph: &'a str,
    /// Names and values (as text) of parameters to set; the last entry of a name wins.
    pub set: &'a [(String, String)],
    /// Minimum values of growing parameters, from earlier frames; entries for other parameters are ignored.
    pub capacities: &'a [(String, i64)],
    /// Facts of the scene, the device and the viewport.
    pub facts: &'a Facts,
    /// Data that the graph can import.
    pub catalog: &'a Catalog,
    /// Lets resources with disjoint lifetimes share memory. Otherwise every resource keeps its contents to the end of
    /// the frame and can be inspected after any pass.
    pub share_memory: bool,
}
