//! Defines the tags of scene files: the rules by which the splats were trained.

use crate::size_breakdown::grouped;
use serde::{Serialize, Serializer};

/// The low-pass filter that splats were trained with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// 0.3 square pixels are added to covariances, as in the published rasteriser.
    #[default]
    Dilated,
    /// Covariances as for `Dilated`, and opacities lowered in proportion: gsplat's `antialiased`, and the flag of SPZ
    /// and SOG.
    Compensated,
    /// The 2D filter of Mip-Splatting: 0.1 square pixels, and lower opacities. Brush calls it `mip`.
    Mip,
}

impl Filter {
    /// Returns the value of the graphs' parameter `low_pass`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dilated => "dilated",
            Self::Compensated => "compensated",
            Self::Mip => "mip",
        }
    }
}

/// The distance by which splats are sorted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SortKey {
    /// The view depth, as in the published rasteriser.
    #[default]
    Depth,
    /// The distance from the camera.
    Distance,
}

impl SortKey {
    /// Returns the value of the graphs' parameter `key_of`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Distance => "distance",
        }
    }
}

fn name<S: Serializer>(name: &str, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(name)
}

impl Serialize for Filter {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        name(self.name(), serializer)
    }
}

impl Serialize for SortKey {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        name(self.name(), serializer)
    }
}

/// Tags of a file: the rules for drawing its splats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FileNotes {
    /// The filter of the training.
    pub low_pass: Filter,
    /// The distance by which the splats are sorted.
    pub key_of: SortKey,
    /// The world's direction up, of unit length; `None` if the file names none.
    pub up: Option<[f64; 3]>,
    /// Degree of the file's spherical harmonics, if it is above 3: the bands above 3 were cut off.
    pub cut_degree: Option<u32>,
    /// Nodes of a tree of levels of detail that were not read: all above the leaves.
    #[serde(skip_serializing_if = "is_zero")]
    pub lod_nodes: u64,
    /// Opacities above 1 in the file, which were read as 1.
    #[serde(skip_serializing_if = "is_zero")]
    pub clamped_opacities: u64,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

impl FileNotes {
    /// Direction up of files that name none: y points down.
    pub const UP: [f64; 3] = [0.0, -1.0, 0.0];

    /// Returns true if the splats were trained with an anti-aliasing filter.
    pub fn is_antialiased(&self) -> bool {
        self.low_pass != Filter::Dilated
    }

    /// Lists what the file has and the scene lacks, one phrase per kind of value.
    pub fn left_out(&self) -> Vec<String> {
        let counted = [
            (self.lod_nodes, "nodes of a tree of levels of detail above its leaves"),
            (self.clamped_opacities, "opacities above 1, read as 1"),
        ];
        let counted = counted.into_iter().filter(|(count, _)| *count > 0);
        counted.map(|(count, text)| format!("{} {text}", grouped(count))).collect()
    }

    /// Removes the tags, which change how a scene is drawn.
    pub(crate) fn without_tags(self) -> Self {
        Self { low_pass: Filter::default(), key_of: SortKey::default(), up: None, ..self }
    }

    /// Lists the file's tags, each with the name and the value of the parameter that it sets.
    pub fn tags(&self) -> Vec<(&'static str, String)> {
        let mut tags = Vec::new();
        if self.low_pass != Filter::default() {
            tags.push(("low_pass", self.low_pass.name().to_owned()));
        }
        if self.key_of != SortKey::default() {
            tags.push(("key_of", self.key_of.name().to_owned()));
        }
        if let Some([x, y, z]) = self.up {
            tags.push(("up", format!("{x},{y},{z}")));
        }
        tags
    }

    /// Keeps the tags that both files share; others are reset to those of a file without tags.
    pub(crate) fn common(self, other: Self) -> Self {
        fn both<T: PartialEq + Default>(a: T, b: T) -> T {
            if a == b { a } else { T::default() }
        }
        Self {
            low_pass: both(self.low_pass, other.low_pass),
            key_of: both(self.key_of, other.key_of),
            up: both(self.up, other.up),
            cut_degree: self.cut_degree.max(other.cut_degree),
            lod_nodes: self.lod_nodes + other.lod_nodes,
            clamped_opacities: self.clamped_opacities + other.clamped_opacities,
        }
    }
}
