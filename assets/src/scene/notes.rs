//! Defines the tags of scene files: the rules that the splats were trained with.

use crate::size_breakdown::grouped;
use serde::Serialize;

/// The low-pass filter that splats were trained with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// Adds 0.3 square pixels to the diagonal of 2D covariances, as the published rasteriser does.
    #[default]
    Dilated,
    /// Covariances as for `Dilated`; opacities are multiplied by sqrt(det / det'), the determinants before and after.
    /// It is gsplat's `antialiased`, and the flag of SPZ and SOG.
    Compensated,
    /// The 2D filter of Mip-Splatting: 0.1 square pixels, and lower opacities. Brush calls it `mip`.
    Mip,
}

impl Filter {
    /// All filters.
    pub const ALL: [Filter; 3] = [Filter::Dilated, Filter::Compensated, Filter::Mip];

    /// Returns the value of the graphs' parameter `low_pass`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dilated => "dilated",
            Self::Compensated => "compensated",
            Self::Mip => "mip",
        }
    }

    /// Finds the filter with a [name](Filter::name); `None` if none has it.
    pub fn named(name: &str) -> Option<Filter> {
        Filter::ALL.into_iter().find(|filter| filter.name() == name)
    }
}

/// The quantity that splats are sorted by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SortKey {
    /// The view depth, as in the published rasteriser.
    #[default]
    Depth,
    /// The distance from the camera.
    Distance,
}

impl SortKey {
    /// All quantities.
    pub const ALL: [SortKey; 2] = [SortKey::Depth, SortKey::Distance];

    /// Returns the value of the graphs' parameter `key_of`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Distance => "distance",
        }
    }

    /// Finds the quantity with a [name](SortKey::name); `None` if none has it.
    pub fn named(name: &str) -> Option<SortKey> {
        SortKey::ALL.into_iter().find(|key| key.name() == name)
    }
}

/// Tags that were reset when scenes were merged, because the scenes have different values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct MixedTags {
    /// True if [`FileNotes::low_pass`] was reset.
    pub low_pass: bool,
    /// True if [`FileNotes::key_of`] was reset.
    pub key_of: bool,
    /// True if [`FileNotes::up`] was reset.
    pub up: bool,
}

impl MixedTags {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Tags of a file, the rules for drawing its splats; and counts of what loading leaves out or clamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FileNotes {
    /// Low-pass filter that the splats were trained with.
    pub low_pass: Filter,
    /// Quantity that the splats are sorted by.
    pub key_of: SortKey,
    /// The world's up direction, as a unit vector; `None` if the file names none.
    pub up: Option<[f64; 3]>,
    /// Degree of the file's spherical harmonics if it is above 3. The bands above 3 are not read.
    pub cut_degree: Option<u32>,
    /// Number of inner nodes of the file's level-of-detail tree. Only the leaves are read.
    #[serde(skip_serializing_if = "is_zero")]
    pub lod_nodes: u64,
    /// Number of opacities below 0 or above 1. They are read as 0 or 1.
    #[serde(skip_serializing_if = "is_zero")]
    pub clamped_opacities: u64,
    /// Number of primitives of meshes in the glTF file of the splats. They are not read.
    #[serde(skip_serializing_if = "is_zero")]
    pub mesh_primitives: u64,
    /// Number of cameras in the glTF file of the splats. They are read only as cameras.
    #[serde(skip_serializing_if = "is_zero")]
    pub cameras: u64,
    /// Number of primitives of splats that are hidden in their glTF file or outside its default scene, and not read.
    #[serde(skip_serializing_if = "is_zero")]
    pub splats_elsewhere: u64,
    /// Tags in which merged scenes differ.
    #[serde(skip_serializing_if = "MixedTags::is_empty")]
    pub mixed: MixedTags,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// Writes a count before a noun; `None` if it is 0.
fn counted(count: u64, text: &str) -> Option<String> {
    (count > 0).then(|| format!("{} {text}", grouped(count)))
}

/// Writes a count after its noun, and then advice; `None` if it is 0.
fn advised(count: u64, noun: &str, advice: &str) -> Option<String> {
    (count > 0).then(|| format!("{noun}: {}; {advice}", grouped(count)))
}

impl FileNotes {
    /// Up direction of a file that names none: y points down.
    pub const UP: [f64; 3] = [0.0, -1.0, 0.0];

    /// Returns true if the splats were trained with an anti-aliasing filter.
    pub(crate) fn is_antialiased(&self) -> bool {
        self.low_pass != Filter::Dilated
    }

    /// Lists the nonzero numbers of clamped opacities and of what is not read, a phrase for each.
    pub fn left_out(&self) -> Vec<String> {
        let nodes = counted(self.lod_nodes, "nodes of a tree of levels of detail above its leaves");
        let advice = "`--cameras` reads them, and `convert --write-cameras` writes them";
        let cameras = advised(self.cameras, "cameras", advice);
        let all = [nodes, self.clamped(), self.mesh_left_out(), self.splats_left_out(), cameras];
        all.into_iter().flatten().collect()
    }

    /// Reports how many opacities were clamped. `None` if there are none.
    pub fn clamped(&self) -> Option<String> {
        counted(self.clamped_opacities, "opacities outside 0 to 1, read as 0 or 1")
    }

    /// Reports how many mesh primitives of the splats' file were not read. `None` if there are none.
    pub fn mesh_left_out(&self) -> Option<String> {
        let advice = "in a file of its own, a mesh is drawn";
        advised(self.mesh_primitives, "mesh primitives beside the splats", advice)
    }

    /// Reports how many primitives of splats of the file were not read. `None` if there are none.
    pub fn splats_left_out(&self) -> Option<String> {
        let outside = "primitives of splats outside the default scene or hidden";
        advised(self.splats_elsewhere, outside, "they are not read")
    }

    pub(crate) fn without_tags(self) -> Self {
        let mixed = MixedTags::default();
        Self { low_pass: Filter::default(), key_of: SortKey::default(), up: None, mixed, ..self }
    }

    /// Names the tags that were reset when scenes with different values were merged: `low_pass, up`. `None` if there
    /// are none.
    pub fn mixed_tags(&self) -> Option<String> {
        let MixedTags { low_pass, key_of, up } = self.mixed;
        let all = [(low_pass, "low_pass"), (key_of, "key_of"), (up, "up")];
        let names: Vec<&str> = all.into_iter().filter(|(mixed, _)| *mixed).map(|(_, name)| name).collect();
        (!names.is_empty()).then(|| names.join(", "))
    }

    /// Returns the tags that pictures depend on, as the names and values of the graph parameters that they set.
    pub fn rules(&self) -> [(&'static str, &'static str); 2] {
        [("low_pass", self.low_pass.name()), ("key_of", self.key_of.name())]
    }

    /// Lists the file's tags with their values, `low_pass` and `key_of` only if they differ from the published rules.
    pub fn tags(&self) -> Vec<(&'static str, String)> {
        let published = Self::default().rules();
        let own = self.rules().into_iter().filter(|rule| !published.contains(rule));
        let mut tags: Vec<_> = own.map(|(name, value)| (name, value.to_owned())).collect();
        if let Some([x, y, z]) = self.up {
            tags.push(("up", format!("{x},{y},{z}")));
        }
        tags
    }

    /// Keeps the tags that are equal in both files; resets the others, and records them in [`FileNotes::mixed`]. Sums
    /// the counts; keeps the higher `cut_degree`.
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
            mesh_primitives: self.mesh_primitives + other.mesh_primitives,
            cameras: self.cameras + other.cameras,
            splats_elsewhere: self.splats_elsewhere + other.splats_elsewhere,
            mixed: MixedTags {
                low_pass: self.mixed.low_pass || other.mixed.low_pass || self.low_pass != other.low_pass,
                key_of: self.mixed.key_of || other.mixed.key_of || self.key_of != other.key_of,
                up: self.mixed.up || other.mixed.up || self.up != other.up,
            },
        }
    }
}
