//! Stores the parts of a layer that the USD reader needs: up axis, prims, some attributes, and references to others.

use crate::error::{SceneError, field, wrong};
use crate::input::{Source, Table};
use crate::memory::display;
use crate::scalar::Scalar;
use std::collections::BTreeMap;
use std::sync::Arc;

pub(super) const SPLATS: &str = "ParticleField3DGaussianSplat";

/// Fields by which a prim or a layer refers to others or has variants.
pub(super) const ARCS: [&str; 8] = [
    "references",
    "payload",
    "inherits",
    "inheritPaths",
    "specializes",
    "variantSets",
    "variantSetNames",
    "subLayers",
];

/// The bytes of a layer: a file, or a part of an archive. Offsets count from the layer's first byte.
#[derive(Clone, Copy)]
pub(super) struct Bytes<'a> {
    source: Source<'a>,
    pub length: u64,
}

impl<'a> Bytes<'a> {
    pub(super) fn new(source: Source<'a>) -> Self {
        Self { source, length: source.length() }
    }

    /// Fails if the layer ends before `count` bytes from offset `at` on.
    fn check(&self, at: u64, count: u64) -> Result<(), SceneError> {
        if at.checked_add(count).is_some_and(|end| end <= self.length) {
            return Ok(());
        }
        let message = format!("expected {count} bytes, found the end of the layer at {}", self.length);
        Err(field(at, "data", message))
    }

    pub(super) fn read(&self, at: u64, buffer: &mut [u8]) -> Result<(), SceneError> {
        self.check(at, buffer.len() as u64)?;
        Ok(self.source.read(at, buffer)?)
    }

    pub(super) fn vec(&self, at: u64, count: u64) -> Result<Vec<u8>, SceneError> {
        self.check(at, count)?;
        Ok(self.source.bytes(at, count as usize)?)
    }
}

/// Fails if a layer that needs `needed` bytes does not fit in the available `memory`.
pub(super) fn check_memory(needed: u64, memory: Option<u64>) -> Result<(), SceneError> {
    match memory {
        Some(memory) if needed > memory => {
            let [needed, memory] = [needed, memory].map(display);
            let text = format!(
                "expected a layer that fits in memory, found one that needs {needed}, of {memory} available"
            );
            Err(wrong("USD", text))
        }
        _ => Ok(()),
    }
}

#[derive(Default)]
pub(super) struct Layer {
    /// `usda` or `usdc`.
    pub kind: &'static str,
    pub up_axis: Option<String>,
    /// Parents come before their children.
    pub prims: Vec<Prim>,
    /// Name of a field in [`ARCS`], or `variantSet`, that the layer has; `None` without one. The reader refuses such a
    /// layer.
    pub arc: Option<String>,
}

#[derive(Default)]
pub(super) struct Prim {
    pub name: String,
    pub parent: Option<usize>,
    /// False for `over` and `class`, which define nothing to draw.
    pub defined: bool,
    /// True for a prim that is deactivated or belongs to a variant.
    pub inactive: bool,
    pub kind: String,
    pub attributes: BTreeMap<String, Attribute>,
}

#[derive(Default)]
pub(super) struct Attribute {
    pub value: Option<Value>,
    /// True if the attribute has time samples or a spline.
    pub animated: bool,
}

pub(super) enum Value {
    Numbers(Vec<f64>),
    Words(Vec<String>),
    Array(Array),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// Numbers of a scalar, a vector, a quaternion or a matrix.
    Numbers,
    /// One or more tokens.
    Words,
    /// An array of elements with this number of components.
    Array(usize),
}

/// Returns the kind of an attribute's value; `None` for an attribute that is not read.
pub(super) fn kind_of(attribute: &str) -> Option<Kind> {
    Some(match attribute {
        "positions" | "positionsh" | "scales" | "scalesh" => Kind::Array(3),
        "radiance:sphericalHarmonicsCoefficients" | "radiance:sphericalHarmonicsCoefficientsh" => {
            Kind::Array(3)
        }
        "orientations" | "orientationsh" => Kind::Array(4),
        "opacities" | "opacitiesh" => Kind::Array(1),
        "radiance:sphericalHarmonicsDegree" => Kind::Numbers,
        "xformOpOrder" | "visibility" | "purpose" | "projectionModeHint" | "sortingModeHint" => Kind::Words,
        other if other.starts_with("xformOp:") => Kind::Numbers,
        _ => return None,
    })
}

pub(super) enum Numbers {
    /// Offset in the layer.
    File(u64),
    /// The numbers' bytes, little-endian. Attributes that name one packed array share them.
    Memory(Arc<Vec<u8>>),
}

pub(super) struct Array {
    pub width: usize,
    pub count: u64,
    pub scalar: Scalar,
    /// Name of the numbers' type, from which `scalar` differs if they are stored as integers.
    pub kind: &'static str,
    pub numbers: Numbers,
    /// True if the real part of a quaternion comes last.
    pub real_last: bool,
    /// Offset in the layer.
    pub at: u64,
    /// Bytes in the file.
    pub bytes: u64,
}

impl Array {
    pub(super) fn stride(&self) -> usize {
        self.width * self.scalar.size()
    }

    /// Returns the array as a table with a row of `elements` elements for each splat.
    pub(super) fn table<'a>(&'a self, layer: &Bytes<'a>, elements: usize) -> Table<'a> {
        let width = elements * self.stride();
        match &self.numbers {
            Numbers::Memory(bytes) => Table::new(Source::Bytes(bytes), 0, width),
            Numbers::File(at) => Table::new(layer.source, *at, width),
        }
    }
}

impl Layer {
    /// Returns the last 8 names of a prim's path, each cut to 40 characters.
    pub(super) fn path(&self, prim: usize) -> String {
        let mut names = Vec::new();
        let mut next = Some(prim);
        while let Some(at) = next.filter(|_| names.len() < 8) {
            names.push(self.prims[at].name.chars().take(40).collect::<String>());
            next = self.prims[at].parent;
        }
        names.reverse();
        format!("{}/{}", if next.is_some() { "..." } else { "" }, names.join("/"))
    }

    pub(super) fn wrong(&self, prim: usize, attribute: &str, message: String) -> SceneError {
        let dot = if attribute.is_empty() { "" } else { "." };
        wrong(format!("{}{dot}{attribute}", self.path(prim)), message)
    }

    /// Returns the bytes of the arrays that are in memory. Others stay in the file.
    pub(super) fn held_bytes(&self) -> u64 {
        let attributes = self.prims.iter().flat_map(|prim| prim.attributes.values());
        let held = |attribute: &Attribute| match &attribute.value {
            Some(Value::Array(Array { numbers: Numbers::Memory(bytes), .. })) => bytes.len() as u64,
            _ => 0,
        };
        attributes.map(held).sum()
    }

    /// Returns the value of an attribute; `None` if it has none. Fails if it has time samples or a spline.
    pub(super) fn value(&self, prim: usize, name: &str) -> Result<Option<&Value>, SceneError> {
        match self.prims[prim].attributes.get(name) {
            Some(Attribute { animated: true, .. }) => {
                let text = "expected one value, found time samples or a spline";
                Err(self.wrong(prim, name, text.into()))
            }
            found => Ok(found.and_then(|attribute| attribute.value.as_ref())),
        }
    }

    /// Returns the first word of an attribute; `None` if its value has no words. Fails like [`Layer::value`].
    pub(super) fn word(&self, prim: usize, name: &str) -> Result<Option<&str>, SceneError> {
        match self.value(prim, name)? {
            Some(Value::Words(words)) => Ok(words.first().map(String::as_str)),
            _ => Ok(None),
        }
    }
}
