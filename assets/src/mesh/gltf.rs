//! Reads meshes from glTF 2.0, as text or binary (`.gltf`, `.glb`).
//!
//! The crate `gltf` parses and validates the JSON. Bytes of buffers are read here, and every range is checked against
//! its buffer. The transform of each visible node of the default scene is applied to its mesh. Of the lights
//! (`KHR_lights_punctual`), only the first directional one is read: its direction and colour. Skins, morph targets,
//! animations and cameras are ignored.

use super::data::{Light, Mesh, MeshMaterial, Texture};
use super::image::{self, MAX_TEXELS};
use crate::error::{SceneError, wrong};
use crate::gltf::{Component, MAGIC, VISIBILITY, visible};
use crate::input::read_file;
use crate::json;
use crate::similarity::Similarity;
use crate::uri::{self, Resource};
use crate::words::word;
use glam::{DMat3, DMat4, DVec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::khr_lights_punctual::Kind;
use gltf::material::AlphaMode;
use gltf::mesh::{Mode, Primitive};
use gltf::texture::WrappingMode;
use gltf::{Accessor, Document, Gltf, Semantic};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Extension for attributes of 8 and 16 bits.
const QUANTIZATION: &str = "KHR_mesh_quantization";
/// Extension for materials without shading.
const UNLIT: &str = "KHR_materials_unlit";
/// Extension that scales texture coordinates. It is not read. Quantized texture coordinates depend on it.
const TEXTURE_TRANSFORM: &str = "KHR_texture_transform";
/// Extensions that are read.
const READ: [&str; 5] =
    [QUANTIZATION, UNLIT, VISIBILITY, "KHR_lights_punctual", "KHR_materials_emissive_strength"];

/// Maximum size of a buffer in its own file, in bytes. Of an image's file, no more are read.
const MAX_BYTES: u64 = 1 << 30;

/// Maximum number of triangles, and of vertices, over all nodes.
const MAX_ELEMENTS: usize = 1 << 26;

/// Maximum number of positions and indices that all nodes read. They can exceed the mesh's: triangles without normals
/// copy only the positions that they use.
const MAX_READ: u64 = 1 << 29;

impl Mesh {
    /// Parses the bytes of a glTF file. Its buffers and images are read from `folder`.
    ///
    /// # Errors
    /// The bytes are not glTF 2.0 or are damaged, require an extension other than `KHR_mesh_quantization`,
    /// `KHR_materials_unlit` and `KHR_node_visibility`, use `KHR_texture_transform` with the first, have primitives
    /// other than triangles, or have no visible triangles; a buffer or an image cannot be read; or a limit is exceeded.
    /// The text names the part of the file, such as an accessor, a node or an image.
    pub fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<Self, SceneError> {
        check_length(bytes)?;
        json::check(json_of(bytes), json::GLTF_OBJECT).map_err(|message| wrong("glTF", message))?;
        // Drops this document before the crate parses its own, because `check` allows the memory of one.
        let placed = visible(json_of(bytes))?;
        let gltf = Gltf::from_slice_without_validation(bytes).map_err(|error| wrong("glTF", error))?;
        let allowed = [QUANTIZATION, UNLIT, VISIBILITY];
        if let Some(extension) = gltf.extensions_required().find(|name| !allowed.contains(name)) {
            let allowed = allowed.join(", ");
            let message = format!("expected no required extension besides {allowed}, found {extension}");
            return Err(wrong("extensionsRequired", message));
        }
        let is_quantized = gltf.extensions_required().any(|name| name == QUANTIZATION);
        if is_quantized && gltf.extensions_used().any(|name| name == TEXTURE_TRANSFORM) {
            let message = format!("expected {QUANTIZATION} without {TEXTURE_TRANSFORM}, found both");
            return Err(wrong("extensionsUsed", message));
        }
        let Gltf { document, blob } = gltf;
        let mut json = document.into_json();
        // The crate refuses extensions that it does not know.
        json.extensions_required.clear();
        check_accessors(&json)?;
        let document = Document::from_json(json).map_err(invalid)?;
        check_reads(&document, &placed)?;
        let files = Files::read(&document, folder)?;
        let buffers = document.buffers().map(|buffer| {
            let part = format!("buffer {}", buffer.index());
            let bytes = match buffer.source() {
                gltf::buffer::Source::Bin => {
                    Cow::Borrowed(blob.as_deref().ok_or_else(|| wrong(&part, "expected a binary chunk"))?)
                }
                gltf::buffer::Source::Uri(uri) => match resolve(uri, folder, &part)? {
                    Resource::Data(bytes) => Cow::Owned(bytes),
                    Resource::File(path) => Cow::Borrowed(files.bytes(&path)),
                },
            };
            match bytes.len() < buffer.length() {
                true => {
                    Err(wrong(part, format!("expected {} bytes, found {}", buffer.length(), bytes.len())))
                }
                false => Ok(bytes),
            }
        });
        let buffers = buffers.collect::<Result<Vec<_>, _>>()?;
        let mut reader = Reader {
            document: &document,
            folder,
            buffers,
            images: HashMap::new(),
            materials: HashMap::new(),
            mesh: Self::default(),
        };
        let has_other_lights = reader.nodes(placed)?;
        reader.mesh.left_out.extend(left_out(&document, has_other_lights));
        match reader.mesh.triangles.is_empty() {
            true => Err(wrong("meshes", "expected visible triangles in the default scene, found none")),
            false => Ok(reader.mesh),
        }
    }
}

/// Checks that a binary file (`.glb`) is at least as long as its header says. Accepts text files.
fn check_length(bytes: &[u8]) -> Result<(), SceneError> {
    if !bytes.starts_with(MAGIC) {
        return Ok(());
    }
    let found = bytes.len();
    if found < 12 {
        return Err(wrong("header", format!("expected 12 bytes, found {found}")));
    }
    match word(bytes, 8) as usize {
        length if length > found => {
            Err(wrong("header", format!("expected a file of {length} bytes, found {found}")))
        }
        length if length < 12 => {
            Err(wrong("header", format!("expected a length of at least 12 bytes, found {length}")))
        }
        _ => Ok(()),
    }
}

/// Checks that the accessors of primitives exist. The crate's own validation uses accessors before it checks them.
fn check_accessors(json: &gltf::json::Root) -> Result<(), SceneError> {
    let count = json.accessors.len();
    for (index, mesh) in json.meshes.iter().enumerate() {
        for primitive in &mesh.primitives {
            let named = primitive.attributes.values().chain(&primitive.indices);
            if let Some(accessor) = named.map(|accessor| accessor.value()).find(|accessor| *accessor >= count)
            {
                let message = format!("expected an accessor below {count}, found {accessor}");
                return Err(wrong(format!("mesh {index}"), message));
            }
        }
    }
    Ok(())
}

/// Checks the work of all `placed` nodes: many can place a mesh of many primitives that share their positions.
fn check_reads(document: &Document, placed: &[(usize, DMat4)]) -> Result<(), SceneError> {
    /// Positions that are read in the time that a primitive takes without them.
    const PRIMITIVE: u64 = 1 << 8;
    // A reader refuses an accessor with more elements than bytes.
    let count = |accessor: Accessor| accessor.count().min(accessor.view().map_or(0, |view| view.length()));
    let reads = |primitive: Primitive| {
        let lists = [primitive.get(&Semantic::Positions), primitive.indices()];
        lists.into_iter().flatten().map(|list| count(list) as u64).fold(PRIMITIVE, u64::saturating_add)
    };
    let of_mesh = |mesh: gltf::Mesh| mesh.primitives().map(reads).fold(0, u64::saturating_add);
    let of_meshes: Vec<u64> = document.meshes().map(of_mesh).collect();
    let meshes: Vec<_> = document.nodes().map(|node| node.mesh()).collect();
    let placed = placed.iter().filter_map(|(node, _)| meshes[*node].as_ref());
    match placed.map(|mesh| of_meshes[mesh.index()]).fold(0, u64::saturating_add) {
        found if found > MAX_READ => {
            let message = format!("expected at most {MAX_READ} positions and indices in all, found {found}");
            Err(wrong("nodes", message))
        }
        _ => Ok(()),
    }
}

/// Returns the JSON of a text or binary file. [`check_length`] has accepted the file.
fn json_of(bytes: &[u8]) -> &[u8] {
    match bytes.strip_prefix(MAGIC) {
        // The header's other 8 bytes, and the length and the type of the first chunk.
        Some(_) => bytes.get(20..).map_or(&[], |rest| &rest[..rest.len().min(word(bytes, 12) as usize)]),
        None => bytes,
    }
}

/// Names what a document has but no picture shows: features, and extensions that are not read. `None` if there is
/// nothing.
fn left_out(document: &Document, has_other_lights: bool) -> Option<String> {
    let primitive = |has: fn(&Primitive) -> bool| {
        document.meshes().any(|mesh| mesh.primitives().any(|primitive| has(&primitive)))
    };
    let material = |has: fn(&gltf::Material) -> bool| document.materials().any(|material| has(&material));
    let wraps = |sampler: gltf::texture::Sampler| {
        [sampler.wrap_s(), sampler.wrap_t()].iter().any(|mode| *mode != WrappingMode::Repeat)
    };
    let features = [
        ("vertex colours", primitive(|primitive| primitive.get(&Semantic::Colors(0)).is_some())),
        ("morph targets", primitive(|primitive| primitive.morph_targets().len() > 0)),
        ("skins", document.skins().len() > 0),
        ("animations", document.animations().len() > 0),
        ("alpha mode BLEND", material(|material| material.alpha_mode() == AlphaMode::Blend)),
        ("occlusion", material(|material| material.occlusion_texture().is_some())),
        ("wrap modes other than repeat", document.samplers().any(wraps)),
        ("lights besides the first directional one", has_other_lights),
    ];
    let features = features.into_iter().filter(|(_, has)| *has).map(|(name, _)| name);
    let extensions = document.extensions_used().filter(|name| !READ.contains(name));
    let all: Vec<&str> = features.chain(extensions).collect();
    (!all.is_empty()).then(|| all.join(", "))
}

/// Converts an error of a document; of several, names the first and the number of the others.
fn invalid(error: gltf::Error) -> SceneError {
    match error {
        gltf::Error::Validation(errors) if !errors.is_empty() => {
            let (path, first) = &errors[0];
            let more = errors.len() - 1;
            let others = if more > 0 { format!(", and {more} more") } else { String::new() };
            let is_missing = matches!(first, gltf::json::validation::Error::Missing);
            let advice = match is_missing && path.as_str().ends_with(".source") {
                true => "; only PNG and JPEG are read, not the images of extensions",
                false => "",
            };
            wrong("glTF", format!("expected a valid document, found: {path}: {first}{others}{advice}"))
        }
        error => wrong("glTF", error),
    }
}

fn resolve(name: &str, folder: Option<&Path>, part: &str) -> Result<Resource, SceneError> {
    uri::resolve(name, folder).map_err(|message| wrong(part, message))
}

/// The files of a document's buffers. Buffers that name the same file share its bytes.
struct Files(HashMap<PathBuf, Vec<u8>>);

impl Files {
    /// Reads each file once, up to the length of the longest buffer that names it.
    fn read(document: &Document, folder: Option<&Path>) -> Result<Self, SceneError> {
        let mut longest: HashMap<PathBuf, gltf::Buffer> = HashMap::new();
        for buffer in document.buffers() {
            let gltf::buffer::Source::Uri(uri) = buffer.source() else { continue };
            if uri.starts_with("data:") {
                continue;
            }
            if let Resource::File(path) = resolve(uri, folder, &format!("buffer {}", buffer.index()))? {
                let known = longest.entry(path).or_insert_with(|| buffer.clone());
                if known.length() < buffer.length() {
                    *known = buffer;
                }
            }
        }
        let read = longest.into_iter().map(|(path, buffer)| {
            let length = buffer.length() as u64;
            let part = format!("buffer {}", buffer.index());
            if length > MAX_BYTES {
                return Err(wrong(part, format!("expected at most {MAX_BYTES} bytes, found {length}")));
            }
            let bytes = read_file(&path, |source| Ok(source.head(length as usize)?));
            let name = path.file_name().unwrap_or_default().display().to_string();
            bytes.map(|bytes| (path, bytes)).map_err(|error| wrong(part, format!("{name}: {error}")))
        });
        read.collect::<Result<_, _>>().map(Self)
    }

    fn bytes(&self, path: &Path) -> &[u8] {
        self.0.get(path).map_or(&[], Vec::as_slice)
    }
}

struct Reader<'a> {
    document: &'a Document,
    folder: Option<&'a Path>,
    buffers: Vec<Cow<'a, [u8]>>,
    images: HashMap<usize, Texture>,
    /// Indices of materials in the mesh, by index in the file; `None` is the default material.
    materials: HashMap<Option<usize>, u32>,
    mesh: Mesh,
}

impl<'a> Reader<'a> {
    /// Reads the meshes and the first directional light of nodes, each with its transform. Returns true if there are
    /// other lights.
    fn nodes(&mut self, placed: Vec<(usize, DMat4)>) -> Result<bool, SceneError> {
        // Converts from axes left, up and front (glTF) to right, down and front, as for splats in glTF.
        let axes = DMat4::from_scale(DVec3::new(-1.0, -1.0, 1.0));
        let nodes: Vec<_> = self.document.nodes().collect();
        // All meshes share the origin of the first one that is far from 0.
        let origins = placed.iter().filter(|(index, _)| nodes[*index].mesh().is_some());
        let mut origins = origins.map(|(_, place)| (axes * *place).w_axis.truncate());
        let is_far = |at: &DVec3| (Similarity::FAR..=Similarity::FARTHEST).contains(&at.abs().max_element());
        self.mesh.origin = origins.find(is_far).unwrap_or_default().into();
        let mut has_other_lights = false;
        for (index, place) in placed {
            let (node, world) = (&nodes[index], axes * place);
            if let Some(light) = node.light() {
                if self.mesh.light.is_none() && matches!(light.kind(), Kind::Directional) {
                    // A light shines along its node's -z.
                    let direction = world.transform_vector3(DVec3::Z).normalize_or(DVec3::NEG_Y);
                    let direction = direction.as_vec3().into();
                    self.mesh.light = Some(Light { direction, color: light.color(), ..Light::default() });
                } else {
                    has_other_lights = true;
                }
            }
            let Some(mesh) = node.mesh() else { continue };
            for primitive in mesh.primitives() {
                self.primitive(&primitive, &world, &format!("node {index}"))?;
            }
        }
        Ok(has_other_lights)
    }

    fn primitive(&mut self, primitive: &Primitive<'a>, world: &DMat4, part: &str) -> Result<(), SceneError> {
        if primitive.mode() != Mode::Triangles {
            let message = format!("expected a primitive of triangles, found {:?}", primitive.mode());
            return Err(wrong(part, message));
        }
        let accessor = |semantic| primitive.get(&semantic);
        let positions = accessor(Semantic::Positions)
            .ok_or_else(|| wrong(part, "expected a primitive with positions, found none"))?;
        let positions = self.floats::<3>(&positions)?;
        let corners = match primitive.indices() {
            Some(indices) => self.indices(&indices, positions.len())?,
            None => (0..positions.len() as u32).collect(),
        };
        let triangles: Vec<[u32; 3]> = corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        let (vertices, all) = (self.mesh.positions.len(), self.mesh.triangles.len() + triangles.len());
        if vertices + 3 * positions.len() > MAX_ELEMENTS || all > MAX_ELEMENTS {
            let message =
                format!("expected at most {MAX_ELEMENTS} vertices and triangles in all, found more");
            return Err(wrong(part, message));
        }
        let uvs = accessor(Semantic::TexCoords(0)).map(|uvs| self.floats::<2>(&uvs)).transpose()?;
        let normals = accessor(Semantic::Normals).map(|normals| self.floats::<3>(&normals)).transpose()?;
        let lengths = [uvs.as_ref().map(Vec::len), normals.as_ref().map(Vec::len)];
        if let Some(other) = lengths.into_iter().flatten().find(|length| *length != positions.len()) {
            return Err(wrong(
                part,
                format!("expected {} of every attribute, found {other}", positions.len()),
            ));
        }
        let material = self.material(primitive, part)?;
        self.mesh.material_of.extend(std::iter::repeat_n(material, triangles.len()));

        let point = |p: [f32; 3]| world.transform_point3(DVec3::from(p.map(f64::from)));
        let points: Vec<DVec3> = positions.iter().copied().map(point).collect();
        if !points.iter().all(|p| p.abs().max_element() <= Similarity::FARTHEST) {
            return Err(wrong(part, "expected positions within 1e18, found one beyond"));
        }
        let (first, origin) = (vertices as u32, DVec3::from(self.mesh.origin));
        match normals {
            Some(normals) => {
                // The cofactor matrix keeps normals perpendicular to their surface under a non-uniform scale.
                let turn = cofactors(world);
                let normal = |n: [f32; 3]| turn * DVec3::from(n.map(f64::from));
                let unit = |n| <[f32; 3]>::from(normal(n).normalize_or(DVec3::NEG_Y).as_vec3());
                let list = normals.into_iter().map(unit);
                self.mesh.normals.extend(list);
                self.mesh.positions.extend(points.iter().map(|p| <[f32; 3]>::from((p - origin).as_vec3())));
                self.mesh.uvs.extend(uvs.unwrap_or_else(|| vec![[0.0; 2]; points.len()]));
                self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|corner| corner + first)));
            }
            // Without normals, triangles are flat-shaded, and each has its own vertices.
            None => {
                for (number, triangle) in triangles.iter().enumerate() {
                    let corners = triangle.map(|corner| points[corner as usize]);
                    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                    // A mirroring transform reverses the winding.
                    let normal = normal.normalize_or(DVec3::NEG_Y) * world.determinant().signum();
                    for (corner, place) in triangle.iter().zip(corners) {
                        self.mesh.positions.push((place - origin).as_vec3().into());
                        self.mesh.normals.push(normal.as_vec3().into());
                        self.mesh.uvs.push(uvs.as_ref().map_or([0.0; 2], |uvs| uvs[*corner as usize]));
                    }
                    self.mesh.triangles.push([0, 1, 2].map(|corner| first + 3 * number as u32 + corner));
                }
            }
        }
        Ok(())
    }

    /// Returns the bytes of an accessor's elements, each of `length` bytes. Fails if the accessor is sparse or exceeds
    /// its buffer view.
    fn elements(
        &self,
        accessor: &Accessor,
        length: usize,
    ) -> Result<impl Iterator<Item = &[u8]> + '_, SceneError> {
        let part = format!("accessor {}", accessor.index());
        let view = accessor.view().filter(|_| accessor.sparse().is_none());
        let view =
            view.ok_or_else(|| wrong(&part, "expected elements in a buffer view, found none or sparse"))?;
        let bytes = self.view(&view, &part)?;
        let (stride, count) = (view.stride().unwrap_or(length), accessor.count());
        let end = count.checked_sub(1).and_then(|last| last.checked_mul(stride)?.checked_add(length));
        let range = match end {
            None if count == 0 => 0..0,
            None => return Err(wrong(part, "expected a range of bytes, found an overflow")),
            Some(end) => accessor.offset()..accessor.offset().saturating_add(end),
        };
        if range.end > bytes.len() || stride == 0 {
            let message = format!("expected at most {} bytes, found {}", bytes.len(), range.end);
            return Err(wrong(part, message));
        }
        let bytes = &bytes[range];
        Ok((0..count).map(move |index| &bytes[index * stride..index * stride + length]))
    }

    fn view(&self, view: &gltf::buffer::View, part: &str) -> Result<&[u8], SceneError> {
        let end = view.offset().checked_add(view.length());
        let bytes = end.and_then(|end| self.buffers[view.buffer().index()].get(view.offset()..end));
        bytes.ok_or_else(|| wrong(part, format!("buffer view {} is beyond its buffer", view.index())))
    }

    /// Reads vectors of floats, or of integers of 8 or 16 bits, which may be normalised.
    fn floats<const N: usize>(&self, accessor: &Accessor) -> Result<Vec<[f32; N]>, SceneError> {
        let expected = if N == 3 { Dimensions::Vec3 } else { Dimensions::Vec2 };
        let part = format!("accessor {}", accessor.index());
        let (kind, dimensions) = (accessor.data_type(), accessor.dimensions());
        let component = Component::new(kind.as_gl_enum(), accessor.normalized())
            .ok_or_else(|| wrong(&part, format!("expected floats, or 8 or 16 bits, found {kind:?}")))?;
        if dimensions != expected {
            return Err(wrong(part, format!("expected {expected:?}, found {dimensions:?}")));
        }
        let elements = self.elements(accessor, N * kind.size())?;
        let read: Vec<[f32; N]> =
            elements.map(|bytes| std::array::from_fn(|axis| component.number(bytes, axis))).collect();
        match read.as_flattened().iter().find(|value| !value.is_finite()) {
            None => Ok(read),
            Some(value) => Err(wrong(part, format!("expected finite numbers, found {value}"))),
        }
    }

    /// Reads indices of vertices, each below `vertices`.
    fn indices(&self, accessor: &Accessor, vertices: usize) -> Result<Vec<u32>, SceneError> {
        let part = format!("accessor {}", accessor.index());
        let scalar: fn(&[u8]) -> u32 = match accessor.data_type() {
            DataType::U8 => |b| b[0].into(),
            DataType::U16 => |b| u16::from_le_bytes([b[0], b[1]]).into(),
            DataType::U32 => |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            other => return Err(wrong(part, format!("expected unsigned integers, found {other:?}"))),
        };
        let read: Vec<u32> = self.elements(accessor, accessor.data_type().size())?.map(scalar).collect();
        match read.iter().find(|index| **index as usize >= vertices) {
            Some(index) => Err(wrong(part, format!("expected indices below {vertices}, found {index}"))),
            None => Ok(read),
        }
    }

    fn material(&mut self, primitive: &Primitive<'a>, part: &str) -> Result<u32, SceneError> {
        let material = primitive.material();
        if let Some(known) = self.materials.get(&material.index()) {
            return Ok(*known);
        }
        let pbr = material.pbr_metallic_roughness();
        let image = |info: Option<(gltf::Texture<'a>, u32)>| match info {
            Some((_, set)) if set != 0 => {
                Err(wrong(part, format!("expected images placed by TEXCOORD_0, found TEXCOORD_{set}")))
            }
            other => Ok(other.map(|(texture, _)| texture.source().index())),
        };
        let info = |info: gltf::texture::Info<'a>| (info.texture(), info.tex_coord());
        let base = image(pbr.base_color_texture().map(info))?;
        let rough = image(pbr.metallic_roughness_texture().map(info))?;
        let glow = image(material.emissive_texture().map(info))?;
        let strength = material.emissive_strength().unwrap_or(1.0);
        let bumps = material.normal_texture();
        let normal_scale = bumps.as_ref().map_or(1.0, gltf::material::NormalTexture::scale);
        let bumps = image(bumps.map(|normal| (normal.texture(), normal.tex_coord())))?;
        let made = MeshMaterial {
            base_color: pbr.base_color_factor(),
            metallic: pbr.metallic_factor(),
            roughness: pbr.roughness_factor(),
            normal_scale,
            alpha_cutoff: match material.alpha_mode() {
                AlphaMode::Mask => material.alpha_cutoff().unwrap_or(0.5),
                AlphaMode::Opaque | AlphaMode::Blend => 0.0,
            },
            base_color_image: self.image(base)?,
            metallic_roughness_image: self.image(rough)?,
            normal_image: self.image(bumps)?,
            emission: material.emissive_factor().map(|v| v * strength),
            emission_image: self.image(glow)?,
            unlit: material.unlit(),
        };
        let index = self.mesh.materials.len() as u32;
        self.mesh.materials.push(made);
        self.materials.insert(material.index(), index);
        Ok(index)
    }

    /// Unpacks an image into the mesh's texels, once per index. Without an index, returns the empty texture.
    fn image(&mut self, index: Option<usize>) -> Result<Texture, SceneError> {
        let Some(index) = index else { return Ok(Texture::default()) };
        if let Some(known) = self.images.get(&index) {
            return Ok(*known);
        }
        let part = format!("image {index}");
        // The JSON is read directly: `gltf::Image::source` panics if the MIME type is missing.
        let image = &self.document.as_json().images[index];
        let bytes = match (&image.uri, &image.buffer_view) {
            (Some(uri), _) => Cow::Owned(match resolve(uri, self.folder, &part)? {
                Resource::Data(bytes) => bytes,
                Resource::File(path) => read_file(&path, |source| match source.length() {
                    length if length <= MAX_BYTES => Ok(source.head(length as usize)?),
                    length => Err(SceneError::Invalid(format!(
                        "expected a file of at most {MAX_BYTES} bytes, found {length}"
                    ))),
                })
                .map_err(|error| wrong(&part, format!("{}: {error}", uri::shown(uri))))?,
            }),
            (None, Some(view)) => {
                let view = self.document.views().nth(view.value());
                Cow::Borrowed(self.view(&view.ok_or_else(|| wrong(&part, "has no buffer view"))?, &part)?)
            }
            (None, None) => return Err(wrong(part, "expected a URI or a buffer view, found neither")),
        };
        let left = MAX_TEXELS - self.mesh.texels.len() as u64;
        let unpacked = image::unpack(&bytes, &part, left)?;
        let first = self.mesh.texels.len() as u32;
        let texture = Texture { first, width: unpacked.width, height: unpacked.height };
        self.mesh.texels.extend(unpacked.texels);
        self.images.insert(index, texture);
        Ok(texture)
    }
}

/// Computes the matrix that transforms normals: the cofactors of the linear part, negated if it mirrors.
fn cofactors(world: &DMat4) -> DMat3 {
    let m = DMat3::from_mat4(*world);
    let sign = m.determinant().signum();
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)) * sign
}
