//! Parses binary layers (OpenUSD's crate format).
//!
//! A table of contents locates six sections: tokens (all names), strings, fields (a name and a value), field sets
//! (lists of fields), paths (the tree of prims and attributes) and specs (the kind and the field set of a path). A
//! value has 64 bits: its type, three flags, and either the value itself or its offset.

use super::layer::{ARCS, Array, Attribute, Bytes, Kind, Layer, Numbers, Prim, Value, kind_of};
use super::packing::Cursor;
use crate::error::{SceneError, field};
use crate::scalar::Scalar;
use crate::words::bytes_at;

pub(crate) const MAGIC: &[u8; 8] = b"PXR-USDC";

const HEADER: u64 = 88;

/// Bytes of an entry of the table of contents: a name of 16 bytes, a start and a size.
const SECTION: usize = 32;

const MAX_SECTIONS: u64 = 64;

const MAX_TOKENS: u64 = 64 << 20;

/// Arrays with fewer elements are stored raw, even if flagged as compressed.
const MIN_PACKED: u64 = 16;

/// Minor versions that are read. 0.7 is the first that counts elements in 64 bits.
const MINOR: std::ops::RangeInclusive<u8> = 7..=13;

const ATTRIBUTE: u32 = 1;
const PRIM: u32 = 6;
const PSEUDO_ROOT: u32 = 7;

const END: u32 = u32::MAX;

const BOOL: u64 = 1;
const INT: u64 = 3;
const HALF: u64 = 7;
const FLOAT: u64 = 8;
const DOUBLE: u64 = 9;
const TOKEN: u64 = 11;
const MATRIX_4D: u64 = 15;
const QUATD: u64 = 16;
const QUATF: u64 = 17;
const QUATH: u64 = 18;
const VEC3D: u64 = 23;
const VEC3F: u64 = 24;
const VEC3H: u64 = 25;
const TOKEN_VECTOR: u64 = 41;
const SPECIFIER: u64 = 42;

/// Returns the component type and the number of components of a value type; `None` for other types.
fn shape(kind: u64) -> Option<(Scalar, usize)> {
    Some(match kind {
        HALF => (Scalar::F16, 1),
        FLOAT => (Scalar::F32, 1),
        DOUBLE => (Scalar::F64, 1),
        VEC3H => (Scalar::F16, 3),
        VEC3F => (Scalar::F32, 3),
        VEC3D => (Scalar::F64, 3),
        QUATH => (Scalar::F16, 4),
        QUATF => (Scalar::F32, 4),
        QUATD => (Scalar::F64, 4),
        MATRIX_4D => (Scalar::F64, 16),
        _ => return None,
    })
}

/// A value: its type, flags, and payload.
#[derive(Clone, Copy)]
struct Rep(u64);

impl Rep {
    fn is_array(self) -> bool {
        self.0 >> 63 & 1 == 1
    }

    fn is_inlined(self) -> bool {
        self.0 >> 62 & 1 == 1
    }

    fn is_compressed(self) -> bool {
        self.0 >> 61 & 1 == 1
    }

    fn kind(self) -> u64 {
        self.0 >> 48 & 255
    }

    fn payload(self) -> u64 {
        self.0 & 0xFFFF_FFFF_FFFF
    }
}

struct Sections<'a, 'b> {
    layer: &'a Bytes<'b>,
    tokens: Vec<String>,
    /// Name, as the index of a token, and value.
    fields: Vec<(u32, Rep)>,
    field_sets: Vec<u32>,
    paths: Vec<Path>,
    /// Kind and field set of each path; 0 without a spec.
    specs: Vec<(u32, u32)>,
}

/// A path: the index of its parent (`None` for the root), and the index in `tokens` of its last element.
#[derive(Clone, Default)]
struct Path {
    parent: Option<u32>,
    token: u32,
    is_property: bool,
}

pub(super) fn parse(layer: &Bytes) -> Result<Layer, SceneError> {
    let (sections, order) = Sections::read(layer)?;
    sections.layer(&order)
}

impl<'a, 'b> Sections<'a, 'b> {
    /// Reads the sections. Also returns the indices of the paths, parents before their children.
    fn read(layer: &'a Bytes<'b>) -> Result<(Self, Vec<u32>), SceneError> {
        let mut cursor = Cursor { layer, at: 0, name: "header" };
        if cursor.take::<8>()? != *MAGIC {
            return Err(field(0, "ident", "expected PXR-USDC, found other bytes"));
        }
        let [major, minor, ..] = cursor.take::<8>()?;
        if major != 0 || !MINOR.contains(&minor) {
            let text = format!("expected 0.{} to 0.{}, found {major}.{minor}", MINOR.start(), MINOR.end());
            return Err(field(8, "version", text));
        }
        let contents = cursor.long()?;
        if !(HEADER..layer.length).contains(&contents) {
            let text = format!("expected {HEADER} to {}, found {contents}", layer.length);
            return Err(field(16, "tocOffset", text));
        }
        cursor.at = contents;
        cursor.name = "sections";
        let count = cursor.long()?;
        if count > MAX_SECTIONS {
            return Err(cursor.wrong(format!("expected at most {MAX_SECTIONS} sections, found {count}")));
        }
        let mut places = Vec::new();
        for _ in 0..count {
            let entry = cursor.take::<SECTION>()?;
            let name: Vec<u8> = entry[..16].iter().copied().take_while(|byte| *byte != 0).collect();
            places.push((name, u64::from_le_bytes(bytes_at(&entry, 16))));
        }
        let section = |name: &'static str| {
            let place = places.iter().find(|(found, _)| found == name.as_bytes());
            let missing = || field(contents, "sections", format!("expected the section {name}, found none"));
            place.map(|(_, at)| Cursor { layer, at: *at, name }).ok_or_else(missing)
        };
        let tokens = Self::tokens(section("TOKENS")?)?;
        let mut cursor = section("FIELDS")?;
        let count = cursor.count()?;
        let names = cursor.integers(count)?;
        let reps = cursor.unpack(8 * count as u64)?;
        if reps.len() != 8 * count {
            return Err(cursor.wrong(format!(
                "expected {} bytes of values, found {}",
                8 * count,
                reps.len()
            )));
        }
        let reps = reps.chunks_exact(8).map(|rep| Rep(u64::from_le_bytes(bytes_at(rep, 0))));
        let fields = names.into_iter().zip(reps).collect();
        let mut cursor = section("FIELDSETS")?;
        let count = cursor.count()?;
        let field_sets = cursor.integers(count)?;
        let (paths, order) = Self::paths(section("PATHS")?)?;
        let mut cursor = section("SPECS")?;
        let count = cursor.count()?;
        let [at, sets, kinds] = [cursor.integers(count)?, cursor.integers(count)?, cursor.integers(count)?];
        let mut specs = vec![(0, 0); paths.len()];
        for ((path, set), kind) in at.into_iter().zip(sets).zip(kinds) {
            let most = paths.len();
            let spec = specs.get_mut(path as usize);
            let wrong = || cursor.wrong(format!("expected the index of a path below {most}, found {path}"));
            *spec.ok_or_else(wrong)? = (kind, set);
        }
        Ok((Self { layer, tokens, fields, field_sets, paths, specs }, order))
    }

    fn tokens(mut cursor: Cursor) -> Result<Vec<String>, SceneError> {
        let count = cursor.count()?;
        let bytes = cursor.long()?;
        if bytes > MAX_TOKENS {
            return Err(cursor.wrong(format!("expected at most {MAX_TOKENS} bytes of tokens, found {bytes}")));
        }
        let unpacked = cursor.unpack(bytes)?;
        let text = unpacked.strip_suffix(b"\0").unwrap_or(&unpacked);
        let mut tokens = Vec::new();
        for token in text.split(|byte| *byte == 0) {
            tokens.push(String::from_utf8_lossy(token).into_owned());
        }
        if tokens.len() != count {
            return Err(cursor.wrong(format!("expected {count} tokens, found {}", tokens.len())));
        }
        Ok(tokens)
    }

    /// Reads the tree of paths. An entry's first child follows it; a jump leads to its next sibling.
    fn paths(mut cursor: Cursor) -> Result<(Vec<Path>, Vec<u32>), SceneError> {
        let count = cursor.count()?;
        let entries = cursor.count()?;
        if entries != count {
            return Err(cursor.wrong(format!("expected {count} paths, found entries for {entries}")));
        }
        let [indices, tokens, jumps] =
            [cursor.integers(entries)?, cursor.integers(entries)?, cursor.integers(entries)?];
        let mut paths = vec![Path::default(); count];
        let (mut seen, mut order) = (vec![false; entries], Vec::new());
        let mut pending: Vec<(usize, Option<u32>)> = vec![(0, None)];
        while let Some((mut entry, mut parent)) = pending.pop() {
            loop {
                let wrong = |text: String| cursor.wrong(text);
                if entry >= entries || std::mem::replace(&mut seen[entry], true) {
                    return Err(wrong(format!(
                        "expected a tree of {entries} paths, found a jump to {entry}"
                    )));
                }
                let index = indices[entry];
                let path = paths.get_mut(index as usize).ok_or_else(|| {
                    wrong(format!("expected the index of a path below {count}, found {index}"))
                })?;
                let token = tokens[entry] as i32;
                *path = Path { parent, token: token.unsigned_abs(), is_property: token < 0 };
                order.push(index);
                let jump = jumps[entry] as i32;
                let (has_child, has_sibling) = (jump > 0 || jump == -1, jump >= 0);
                if has_child {
                    if has_sibling {
                        pending.push((entry.saturating_add(jump as usize), parent));
                    }
                    parent = Some(index);
                } else if !has_sibling {
                    break;
                }
                entry += 1;
            }
        }
        Ok((paths, order))
    }

    fn token(&self, index: u64) -> Result<&str, SceneError> {
        let token = usize::try_from(index).ok().and_then(|index| self.tokens.get(index));
        token.map(String::as_str).ok_or_else(|| {
            let most = self.tokens.len();
            field(0, "TOKENS", format!("expected the index of a token below {most}, found {index}"))
        })
    }

    fn fields(&self, path: u32) -> Result<Vec<(&str, Rep)>, SceneError> {
        let (_, set) = self.specs[path as usize];
        let all = self.field_sets.get(set as usize..).unwrap_or_default();
        let mut found = Vec::new();
        for index in all.iter().take_while(|index| **index != END) {
            let most = self.fields.len();
            let (name, rep) = self.fields.get(*index as usize).ok_or_else(|| {
                field(0, "FIELDSETS", format!("expected the index of a field below {most}, found {index}"))
            })?;
            found.push((self.token(u64::from(*name))?, *rep));
        }
        Ok(found)
    }

    fn layer(&self, order: &[u32]) -> Result<Layer, SceneError> {
        let mut layer = Layer { kind: "usdc", ..Layer::default() };
        // Index of each path's prim.
        let mut prims: Vec<Option<usize>> = vec![None; self.paths.len()];
        for index in order {
            let path = &self.paths[*index as usize];
            let (kind, _) = self.specs[*index as usize];
            let parent = path.parent.and_then(|parent| prims[parent as usize]);
            match kind {
                PSEUDO_ROOT => {
                    for (name, rep) in self.fields(*index)? {
                        match name {
                            "upAxis" => layer.up_axis = self.words(rep)?.into_iter().next(),
                            _ if ARCS.contains(&name) => layer.arc = Some(name.into()),
                            _ => {}
                        }
                    }
                }
                PRIM if !path.is_property => {
                    let name = self.token(path.token.into())?.to_owned();
                    let mut prim = Prim { name, parent, ..Prim::default() };
                    for (name, rep) in self.fields(*index)? {
                        match name {
                            "specifier" => prim.defined = rep.kind() == SPECIFIER && rep.payload() == 0,
                            "typeName" => prim.kind = self.words(rep)?.concat(),
                            "active" => prim.inactive = rep.kind() == BOOL && rep.payload() == 0,
                            _ if ARCS.contains(&name) => layer.arc = Some(name.into()),
                            _ => {}
                        }
                    }
                    // A prim whose parent is neither a prim nor the root belongs to a variant.
                    let parent_kind = path.parent.map(|parent| self.specs[parent as usize].0);
                    prim.inactive |= parent.is_none() && parent_kind != Some(PSEUDO_ROOT);
                    prims[*index as usize] = Some(layer.prims.len());
                    layer.prims.push(prim);
                }
                ATTRIBUTE if path.is_property => {
                    let name = self.token(path.token.into())?;
                    let (Some(parent), Some(kind)) = (parent, kind_of(name)) else { continue };
                    let mut attribute = Attribute::default();
                    for (field, rep) in self.fields(*index)? {
                        match field {
                            "default" => attribute.value = self.value(rep, kind, name)?,
                            "timeSamples" | "spline" => attribute.animated = true,
                            _ => {}
                        }
                    }
                    layer.prims[parent].attributes.insert(name.to_owned(), attribute);
                }
                _ => {}
            }
        }
        Ok(layer)
    }

    /// Reads a value of an expected kind; `None` if it is blocked. A value of another kind is an error.
    fn value(&self, rep: Rep, kind: Kind, name: &str) -> Result<Option<Value>, SceneError> {
        /// Type of a value that blocks the values of weaker layers.
        const BLOCK: u64 = 51;
        if rep.kind() == BLOCK {
            return Ok(None);
        }
        let found = match kind {
            Kind::Words => Value::Words(self.words(rep)?),
            Kind::Numbers => Value::Numbers(self.numbers(rep, name)?),
            Kind::Array(width) => Value::Array(self.array(rep, width, name)?),
        };
        Ok(Some(found))
    }

    fn words(&self, rep: Rep) -> Result<Vec<String>, SceneError> {
        match (rep.kind(), rep.is_array()) {
            (TOKEN, false) if rep.is_inlined() => {
                Ok(vec![self.token(rep.payload() & 0xFFFF_FFFF)?.to_owned()])
            }
            (TOKEN, true) | (TOKEN_VECTOR, _) => {
                if rep.payload() == 0 {
                    return Ok(Vec::new());
                }
                let mut cursor = Cursor { layer: self.layer, at: rep.payload(), name: "tokens" };
                let count = cursor.long()?;
                let bytes = self.layer.vec(cursor.at, count.saturating_mul(4))?;
                let words = bytes.chunks_exact(4).map(|word| {
                    let index = u32::from_le_bytes(word.try_into().expect("the chunk has 4 bytes"));
                    Ok(self.token(index.into())?.to_owned())
                });
                words.collect()
            }
            (kind, _) => {
                Err(field(rep.payload(), "value", format!("expected tokens, found the type {kind}")))
            }
        }
    }

    /// Reads the numbers of a scalar, a vector, a quaternion (w first) or a matrix.
    fn numbers(&self, rep: Rep, name: &str) -> Result<Vec<f64>, SceneError> {
        let wrong = || {
            let text = format!("expected numbers of `{name}`, found the type {}", rep.kind());
            field(rep.payload(), "value", text)
        };
        if rep.kind() == INT && rep.is_inlined() && !rep.is_array() {
            return Ok(vec![f64::from(rep.payload() as u32 as i32)]);
        }
        let (scalar, count) = shape(rep.kind()).filter(|_| !rep.is_array()).ok_or_else(wrong)?;
        if rep.is_inlined() {
            let bytes = (rep.payload() as u32).to_le_bytes();
            let small = bytes.map(|byte| f64::from(byte as i8));
            return Ok(match (rep.kind(), count) {
                (HALF, _) => vec![Scalar::F16.wide::<false>(&bytes)],
                (_, 1) => vec![Scalar::F32.wide::<false>(&bytes)],
                (_, 3) => small[..3].to_vec(),
                // An inlined matrix is diagonal.
                (_, 16) => (0..16).map(|at| if at % 5 == 0 { small[at / 5] } else { 0.0 }).collect(),
                _ => return Err(wrong()),
            });
        }
        let bytes = self.layer.vec(rep.payload(), (count * scalar.size()) as u64)?;
        let mut numbers: Vec<f64> =
            bytes.chunks_exact(scalar.size()).map(|bytes| scalar.wide::<false>(bytes)).collect();
        if count == 4 {
            numbers.rotate_right(1);
        }
        Ok(numbers)
    }

    /// Locates an array in the layer. A compressed array is unpacked into memory; others are not read yet.
    fn array(&self, rep: Rep, width: usize, name: &str) -> Result<Array, SceneError> {
        let Some((scalar, _)) = shape(rep.kind()).filter(|(_, found)| *found == width) else {
            let text = format!("expected an array of `{name}`, found the type {}", rep.kind());
            return Err(field(rep.payload(), "value", text));
        };
        let real_last = width == 4;
        let numbers = Numbers::Memory(Vec::new());
        let (at, kind) = (rep.payload(), scalar.name());
        let empty = Array { width, count: 0, scalar, kind, numbers, real_last, at, bytes: 0 };
        if !rep.is_array() {
            let text = format!("expected an array of `{name}`, found one value");
            return Err(field(rep.payload(), "value", text));
        }
        if rep.payload() == 0 {
            return Ok(empty);
        }
        let mut cursor = Cursor { layer: self.layer, at: rep.payload(), name: "array" };
        let count = cursor.long()?;
        if rep.is_compressed() && width == 1 && count >= MIN_PACKED {
            let (numbers, scalar) = Self::packed(&mut cursor, count, scalar)?;
            let numbers = Numbers::Memory(numbers);
            return Ok(Array { count, scalar, numbers, bytes: cursor.at - rep.payload(), ..empty });
        }
        let bytes = count.saturating_mul((width * scalar.size()) as u64);
        let left = self.layer.length.saturating_sub(cursor.at);
        if bytes > left {
            let text =
                format!("expected elements of `{name}` in the {left} bytes that are left, found {count}");
            return Err(field(rep.payload(), "array", text));
        }
        Ok(Array { count, numbers: Numbers::File(cursor.at), bytes: 8 + bytes, ..empty })
    }

    /// Unpacks an array of numbers: integers, or indices into a table. Also returns the type of its numbers, which is
    /// `scalar` or a type of integers.
    fn packed(cursor: &mut Cursor, count: u64, scalar: Scalar) -> Result<(Vec<u8>, Scalar), SceneError> {
        let most = cursor.layer.length;
        if count > most {
            return Err(cursor.wrong(format!("expected at most {most} elements, found {count}")));
        }
        let [code] = cursor.take()?;
        match code {
            b'i' => {
                let integers = cursor.integers(count as usize)?.into_iter();
                Ok((integers.flat_map(u32::to_le_bytes).collect(), Scalar::I32))
            }
            b't' => {
                let entries = cursor.word()?;
                let table = cursor.layer.vec(cursor.at, u64::from(entries) * scalar.size() as u64)?;
                cursor.at += table.len() as u64;
                let mut bytes = Vec::new();
                for index in cursor.integers(count as usize)? {
                    let entry = table.chunks_exact(scalar.size()).nth(index as usize);
                    let wrong = || format!("expected the index of an entry below {entries}, found {index}");
                    bytes.extend_from_slice(entry.ok_or_else(|| cursor.wrong(wrong()))?);
                }
                Ok((bytes, scalar))
            }
            other => Err(cursor.wrong(format!("expected the packing i or t, found {other}"))),
        }
    }
}
