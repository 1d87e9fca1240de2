//! Parses the parts of glTF's JSON that splats and cameras need, and computes the transforms of their nodes.

use crate::error::{SceneError, row, wrong};
use crate::scene::{FileNotes, SortKey};
use crate::similarity::{self, Similarity};
use glam::{DMat4, DQuat};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::{BTreeMap, HashSet};

/// Name of the extension. The names of its attributes and of extensions to it begin with it.
pub(super) const SPLATTING: &str = "KHR_gaussian_splatting";

/// Name of the first extension with an SPZ file, in 3D Tiles of 2025. It is the primitive's only one.
const FIRST_SPZ: &str = "KHR_spz_gaussian_splats_compression";

/// Extension that hides nodes.
pub(crate) const VISIBILITY: &str = "KHR_node_visibility";

/// Maximum number of primitives of splats over all nodes. A node with many primitives is a few bytes of JSON.
const MAX_PLACED: usize = 1 << 17;

/// The error for other drafts of the extension.
pub(super) const DRAFT: SceneError = SceneError::Unsupported {
    format: "a glTF scene of an early draft of KHR_gaussian_splatting",
    advice: "write it again with a newer version of its program",
};

/// Returns the item at `index`; the error names the list `of`.
pub(super) fn item<'a, T>(items: &'a [T], index: usize, of: &str) -> Result<&'a T, SceneError> {
    let count = items.len();
    items.get(index).ok_or_else(|| wrong(of, format!("expected an index below {count}, found {index}")))
}

/// Lists the visible nodes of the scene in a document's JSON; see [`Document::placed`].
pub(crate) fn visible(text: &[u8]) -> Result<Vec<(usize, DMat4)>, SceneError> {
    let visible = |node: Placed| node.visible.then_some((node.index, node.place));
    Ok(Document::read(text)?.placed()?.into_iter().filter_map(visible).collect())
}

/// A node of the scene.
pub(super) struct Placed {
    pub index: usize,
    /// Transform into the document's world.
    pub place: DMat4,
    /// False if the node or one above it is hidden (`KHR_node_visibility`).
    visible: bool,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Document {
    pub asset: Asset,
    extensions_required: Vec<String>,
    scene: Option<usize>,
    scenes: Vec<Roots>,
    pub nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    pub cameras: Vec<Lens>,
    animations: Vec<Animation>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<BufferView>,
    pub buffers: Vec<Buffer>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Asset {
    pub copyright: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Roots {
    nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Animation {
    channels: Vec<Channel>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Channel {
    target: Target,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Target {
    node: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub name: String,
    children: Vec<usize>,
    mesh: Option<usize>,
    pub camera: Option<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    extensions: NodeExtensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct NodeExtensions {
    #[serde(rename = "KHR_node_visibility")]
    visibility: Option<Visibility>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Visibility {
    visible: Option<bool>,
}

/// The definition of a camera, without a position: nodes place it.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Lens {
    pub name: String,
    pub perspective: Option<Perspective>,
    pub orthographic: Option<Orthographic>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Perspective {
    /// Vertical field of view, in radians.
    pub yfov: f64,
    /// Width of the view, divided by its height; `None` if the reader may choose it.
    pub aspect_ratio: Option<f64>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Orthographic {
    /// Half of the view's width, in world units.
    pub xmag: f64,
    /// Half of the view's height.
    pub ymag: f64,
}

#[derive(Debug, Deserialize)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    pub attributes: BTreeMap<String, usize>,
    mode: Option<u32>,
    #[serde(default)]
    extensions: Extensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Extensions {
    #[serde(rename = "KHR_gaussian_splatting")]
    splatting: Option<Splatting>,
    #[serde(rename = "KHR_spz_gaussian_splats_compression")]
    first_spz: Option<Compression>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Splatting {
    kernel: Option<String>,
    color_space: Option<String>,
    projection: Option<String>,
    sorting_method: Option<String>,
    extensions: BTreeMap<String, Compression>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Compression {
    buffer_view: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
    #[serde(default)]
    pub normalized: bool,
    pub count: u64,
    #[serde(rename = "type")]
    pub kind: String,
    pub sparse: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: Option<u64>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub byte_length: u64,
    pub uri: Option<String>,
}

#[derive(Debug)]
pub(super) struct Splats<'a> {
    pub primitive: &'a Primitive,
    /// Index of the buffer view with an SPZ file, if the file replaces the attributes' values.
    pub spz: Option<usize>,
    pub key_of: SortKey,
    /// Transform from the primitive to the document's world.
    pub place: Similarity,
}

impl Document {
    /// Parses the JSON. Fails if it requires any extension besides those for splats, `KHR_mesh_quantization` and
    /// [`VISIBILITY`].
    pub(super) fn parse(text: &[u8]) -> Result<Self, SceneError> {
        let document = Self::read(text)?;
        let unknown = |name: &&String| {
            !name.starts_with(SPLATTING)
                && ![FIRST_SPZ, "KHR_mesh_quantization", VISIBILITY].contains(&name.as_str())
        };
        match document.extensions_required.iter().find(unknown) {
            Some(name) if name.contains("spz") => Err(DRAFT),
            Some(name) => {
                Err(wrong("extensionsRequired", format!("expected extensions of splats, found {name}")))
            }
            None => Ok(document),
        }
    }

    /// Parses the JSON, whatever extensions it requires.
    pub(super) fn read(text: &[u8]) -> Result<Self, SceneError> {
        serde_json::from_slice(text)
            .map_err(|error| row(error.line() as u64, format!("the JSON of glTF: {error}")))
    }

    /// Lists the nodes of the scene, each before its children, in the order of the document's lists.
    ///
    /// The scene is the default one, or the first. A document without scenes counts as one scene of all nodes. Fails if
    /// a node is reached twice.
    pub(super) fn placed(&self) -> Result<Vec<Placed>, SceneError> {
        let roots = match self.scene.or((!self.scenes.is_empty()).then_some(0)) {
            Some(scene) => item(&self.scenes, scene, "scene")?.nodes.clone(),
            None => {
                let mut is_child = vec![false; self.nodes.len()];
                for child in self.nodes.iter().flat_map(|node| &node.children) {
                    item(&self.nodes, *child, "nodes.children")?;
                    is_child[*child] = true;
                }
                (0..self.nodes.len()).filter(|node| !is_child[*node]).collect()
            }
        };
        // The last one is the next.
        let mut open: Vec<_> = roots.into_iter().rev().map(|node| (node, DMat4::IDENTITY, true)).collect();
        let mut seen = vec![false; self.nodes.len()];
        let mut found = Vec::new();
        while let Some((index, parent, visible)) = open.pop() {
            let node = item(&self.nodes, index, "nodes.children")?;
            if std::mem::replace(&mut seen[index], true) {
                return Err(wrong(
                    format!("nodes[{index}]"),
                    "expected a tree, found a node with two parents",
                ));
            }
            let matrix = node.matrix();
            similarity::affine(matrix.row(3)).map_err(|text| {
                wrong(format!("nodes[{index}].matrix"), format!("{text} glTF lists columns"))
            })?;
            let place = parent * matrix;
            let own = node.extensions.visibility.as_ref().and_then(|own| own.visible);
            let visible = visible && own.unwrap_or(true);
            open.extend(node.children.iter().rev().map(|child| (*child, place, visible)));
            found.push(Placed { index, place, visible });
        }
        Ok(found)
    }

    /// Lists the nodes that animations move: their targets, and all nodes below those.
    pub(super) fn animated(&self) -> HashSet<usize> {
        let channels = self.animations.iter().flat_map(|animation| &animation.channels);
        let mut open: Vec<usize> = channels.filter_map(|channel| channel.target.node).collect();
        let mut found = HashSet::new();
        while let Some(index) = open.pop() {
            if found.insert(index) {
                open.extend(self.nodes.get(index).into_iter().flat_map(|node| &node.children));
            }
        }
        found
    }

    /// Iterates over the primitives of splats without SPZ in all meshes, whatever shows them.
    pub(super) fn unpacked(&self) -> impl Iterator<Item = &Primitive> {
        self.meshes.iter().flat_map(Mesh::splats).filter(|primitive| {
            let Extensions { splatting, first_spz } = &primitive.extensions;
            first_spz.is_none() && splatting.as_ref().is_none_or(|splatting| splatting.extensions.is_empty())
        })
    }

    /// Lists the primitives of splats in the scene, once per node that places them. Also counts what is not read: the
    /// primitives of meshes, the cameras, and the primitives of splats in other scenes or hidden nodes. Fails if there
    /// are no splats, or more than [`MAX_PLACED`] primitives of them.
    pub(super) fn splats(&self) -> Result<(Vec<Splats<'_>>, FileNotes), SceneError> {
        // Primitives of splats by mesh, so that a node does not search its mesh again.
        let splats_of: Vec<Vec<&Primitive>> = self.meshes.iter().map(Mesh::splats).collect();
        let (mut found, mut notes) = (Vec::new(), FileNotes::default());
        let mut is_placed = vec![false; self.meshes.len()];
        for Placed { index, place, visible } in self.placed()? {
            notes.cameras += u64::from(self.nodes[index].camera.is_some());
            let Some(mesh) = self.nodes[index].mesh.filter(|_| visible) else { continue };
            let splats = item(&splats_of, mesh, "nodes.mesh")?;
            is_placed[mesh] = true;
            notes.mesh_primitives += (self.meshes[mesh].primitives.len() - splats.len()) as u64;
            let count = found.len() + splats.len();
            if count > MAX_PLACED {
                let text =
                    format!("expected at most {MAX_PLACED} primitives of splats, found {count} or more");
                return Err(wrong(format!("nodes[{index}]"), text));
            }
            for primitive in splats {
                let Extensions { splatting, first_spz } = &primitive.extensions;
                if primitive.mode.is_some_and(|mode| mode != 0) {
                    return Err(wrong("primitives.mode", "expected 0 (points), found another"));
                }
                let splatting = splatting.as_ref().map(Splatting::check).transpose()?;
                let (spz, key_of) = splatting.unwrap_or((None, SortKey::Distance));
                let spz = spz.or(first_spz.as_ref().and_then(|spz| spz.buffer_view));
                if spz.is_none() && primitive.attributes.contains_key("_ROTATION") {
                    return Err(DRAFT);
                }
                let place =
                    Similarity::of_matrix(place).map_err(|text| wrong(format!("nodes[{index}]"), text))?;
                found.push(Splats { primitive, spz, key_of, place });
            }
        }
        let elsewhere = splats_of.iter().zip(is_placed).filter(|(_, is_placed)| !is_placed);
        notes.splats_elsewhere = elsewhere.map(|(splats, _)| splats.len() as u64).sum();
        match (found.is_empty(), notes.splats_elsewhere) {
            (true, 0) => Err(SceneError::NotScene { found: "a glTF model without Gaussian splats".into() }),
            (true, count) => {
                let text = format!(
                    "expected visible splats in the default scene, found none, \
                     and {count} primitives of them hidden or in other scenes"
                );
                Err(wrong("scene", text))
            }
            (false, _) => Ok((found, notes)),
        }
    }
}

impl Mesh {
    fn splats(&self) -> Vec<&Primitive> {
        let is_splats = |primitive: &&Primitive| {
            primitive.extensions.splatting.is_some() || primitive.extensions.first_spz.is_some()
        };
        self.primitives.iter().filter(is_splats).collect()
    }
}

impl Node {
    fn matrix(&self) -> DMat4 {
        self.matrix.map_or_else(
            || {
                let [x, y, z, w] = self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
                DMat4::from_scale_rotation_translation(
                    self.scale.unwrap_or([1.0; 3]).into(),
                    DQuat::from_xyzw(x, y, z, w).normalize(),
                    self.translation.unwrap_or_default().into(),
                )
            },
            |matrix| DMat4::from_cols_array(&matrix),
        )
    }
}

impl Splatting {
    /// Refuses splats that this reader does not support. Returns the buffer view of SPZ, if any, and the order.
    fn check(&self) -> Result<(Option<usize>, SortKey), SceneError> {
        let field = |name: &str| format!("{SPLATTING}.{name}");
        let expect = |name: &str, value: &Option<String>, expected: &[&str]| match value.as_deref() {
            None => Ok(()),
            Some(found) if expected.contains(&found) => Ok(()),
            Some(found) => {
                Err(wrong(field(name), format!("expected {}, found {found}", expected.join(" or "))))
            }
        };
        expect("kernel", &self.kernel, &["ellipse"])?;
        expect("projection", &self.projection, &["perspective"])?;
        // Not in the extension, but in USD's.
        expect("sortingMethod", &self.sorting_method, &["cameraDistance", "zDepth"])?;
        let by_depth = self.sorting_method.as_deref() == Some("zDepth");
        let key_of = if by_depth { SortKey::Depth } else { SortKey::Distance };
        if self.color_space.as_deref() == Some("lin_rec709_display") {
            return Err(SceneError::Unsupported {
                format: "a glTF scene in the colour space lin_rec709_display, whose splats are blended as linear light",
                advice: "only srgb_rec709_display is drawn",
            });
        }
        // The second is the name in a draft.
        expect("colorSpace", &self.color_space, &["srgb_rec709_display", "BT.709-sRGB"])?;
        let Some((name, compression)) = self.extensions.first_key_value() else { return Ok((None, key_of)) };
        match (name.as_str(), compression.buffer_view) {
            (
                "KHR_gaussian_splatting_compression_spz_2" | "KHR_gaussian_splatting_compression_spz",
                Some(view),
            ) => Ok((Some(view), key_of)),
            _ => Err(wrong(field("extensions"), format!("expected SPZ compression, found {name}"))),
        }
    }
}
