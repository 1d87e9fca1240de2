//! Defines the input of a build: the graph's name, parameters, facts and data to import.

use std::collections::BTreeMap;

use super::{DeviceFacts, Value};

/// Prefix of the facts that request additional outputs, such as `outputs.depth`. A missing fact counts as false.
pub const OUTPUTS: &str = "outputs.";

/// Values that expressions of a graph can read.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    /// Facts of the device.
    pub device: DeviceFacts,
    /// Facts of the scene and the viewport by full name, such as `scene.count`; also the requested outputs
    /// ([`OUTPUTS`]).
    pub host: BTreeMap<String, Value>,
    /// Possible values of facts that are texts, by full name. A comparison with another text is an error.
    pub texts: BTreeMap<String, Vec<String>>,
}

impl Facts {
    /// Returns all facts by full name.
    pub fn named(&self) -> BTreeMap<String, Value> {
        let device = self.device.named().into_iter().map(|(name, value)| (name.to_string(), value));
        self.host.clone().into_iter().chain(device).collect()
    }
}

impl From<DeviceFacts> for Facts {
    fn from(device: DeviceFacts) -> Facts {
        Facts { device, host: BTreeMap::new(), texts: BTreeMap::new() }
    }
}

/// Data that a graph can import: attributes, uniform blocks and buffers by full name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Catalog {
    /// Attributes of the scene, by full name such as `scene.position`.
    pub attributes: BTreeMap<String, Attribute>,
    /// Families of attributes by the prefix of their names, such as `scene.property.`.
    pub families: BTreeMap<String, Family>,
    /// Sizes in bytes of the uniform blocks that the host writes for every frame.
    pub uniforms: BTreeMap<String, u64>,
    /// Storage buffers that the host supplies with every frame.
    pub buffers: BTreeMap<String, HostBuffer>,
}

impl Catalog {
    /// Returns an attribute of the scene, listed or of a family with any name; `None` if there is none.
    pub fn attribute(&self, name: &str) -> Option<Attribute> {
        self.attributes.get(name).copied().or_else(|| self.family(name)?.any)
    }

    /// Returns the family that a name belongs to.
    pub fn family(&self, name: &str) -> Option<&Family> {
        self.families.iter().find(|(prefix, _)| name.starts_with(*prefix)).map(|(_, family)| family)
    }
}

/// Attributes that scenes have on request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Family {
    /// The attribute of any name, if the scene is not known; otherwise `None`, and [`Catalog::attributes`] has them.
    pub any: Option<Attribute>,
    /// Advice for a name that the scene lacks.
    pub help: String,
}

/// A storage buffer that the host supplies with every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostBuffer {
    /// Bytes per element.
    pub stride: u64,
    /// Minimum number of elements.
    pub least: u64,
}

/// An attribute of the scene: `planes` buffers of `count` elements each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Bytes per element.
    pub stride: u64,
    /// Number of elements of each plane.
    pub count: u64,
    /// Number of buffers over which the attribute is split.
    pub planes: u32,
}

/// A request for a plan: a graph and everything that the plan depends on.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The graph, by preset name or file path.
    pub graph: &'a str,
    /// Parameters to set: names, and values as text. The last entry for a name wins.
    pub set: &'a [(String, String)],
    /// Minimum values of growing parameters, learnt from earlier frames. Entries for other parameters are ignored.
    pub capacities: &'a [(String, i64)],
    /// Facts of the scene, the device and the viewport, and the requested outputs.
    pub facts: &'a Facts,
    /// Data that the graph can import.
    pub catalog: &'a Catalog,
    /// Allows resources with disjoint lifetimes to share memory. If false, every resource keeps its contents until the
    /// end of the frame and can be inspected after any pass.
    pub share_memory: bool,
}

impl<'a> Request<'a> {
    /// Returns a request without parameters and capacities, whose resources share memory.
    pub fn new(graph: &'a str, facts: &'a Facts, catalog: &'a Catalog) -> Request<'a> {
        Request { graph, set: &[], capacities: &[], facts, catalog, share_memory: true }
    }
}
