//! Parses binary layers (OpenUSD's crate format).
//!
//! A table of contents locates six sections: tokens (all names), strings, fields (a name and a value), field sets
//! (lists of fields), paths (the tree of prims and attributes) and specs (the kind and the field set of a path). A
//! value has 64 bits: its type, three flags, and either the value itself or its offset.

use super::layer::{ARCS, Array, Attribute, Bytes, Kind, Layer, Numbers, Prim, Value, check_memory, kind_of};
use super::packing::Cursor;
use crate::error::{SceneError, field};
use crate::scalar::Scalar;
use crate::words::bytes_at;
use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::sync::Arc;

pub(crate) const MAGIC: &[u8; 8] = b"PXR-USDC";

const HEADER: u64 = 88;

/// Bytes of an entry of the table of contents: a name of 16 bytes, a start and a size.
const SECTION: usize = 32;

const MAX_SECTIONS: u64 = 64;

const MAX_TOKENS: u64 = 64 << 20;

/// Maximum length of a name, in bytes. Tokens that are values of strings can be longer.
const MAX_NAME: usize = 4096;

/// Maximum number of fields of a path, on average. OpenUSD defines about 40 for a prim.
const MAX_FIELDS: usize = 64;

/// Upper bound of the memory for a path without its name and its value, in bytes. Two paths, a prim and its first
/// attribute, take 2000.
const PATH: u64 = 1 << 10;

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
    /// Available memory, and the part of it that paths and values take, in bytes.
    memory: Option<u64>,
    held: Cell<u64>,
    /// Number of fields of all paths so far. Paths can share a field set.
    listed: Cell<usize>,
    /// Packed arrays that were unpacked, by their [`Rep`].
    unpacked: RefCell<HashMap<u64, Unpacked>>,
}

/// A packed array: its end in the layer, its numbers and their type.
type Unpacked = (u64, Arc<Vec<u8>>, Scalar);

/// A path: the index of its parent (`None` for the root), and the index in `tokens` of its last element.
#[derive(Clone, Default)]
struct Path {
    parent: Option<u32>,
    token: u32,
    is_property: bool,
}

/// Parses a layer whose paths and values fit in the available `memory`.
pub(super) fn parse(layer: &Bytes, memory: Option<u64>) -> Result<Layer, SceneError> {
    let (sections, order) = Sections::read(layer, memory)?;
    sections.layer(&order)
}

impl<'a, 'b> Sections<'a, 'b> {
    /// Reads the sections. Also returns the indices of the paths, parents before their children.
    fn read(layer: &'a Bytes<'b>, memory: Option<u64>) -> Result<(Self, Vec<u32>), SceneError> {
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
        let (paths, order) = Self::paths(section("PATHS")?, memory)?;
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
        let held = Cell::new(PATH * paths.len() as u64);
        let (listed, unpacked) = (Cell::default(), RefCell::default());
        Ok((Self { layer, tokens, fields, field_sets, paths, specs, memory, held, listed, unpacked }, order))
    }

    /// Counts the bytes of a value before it is made. Fails if all together exceed the available memory: a few bytes of
    /// the layer can name a large value again.
    fn hold(&self, bytes: u64) -> Result<(), SceneError> {
        self.held.set(self.held.get().saturating_add(bytes));
        check_memory(self.held.get(), self.memory)
    }

    fn tokens(mut cursor: Cursor) -> Result<Vec<String>, SceneError> {
        let count = cursor.count()?;
        let bytes = cursor.long()?;
        if bytes > MAX_TOKENS {
            return Err(cursor.wrong(format!("expected at most {MAX_TOKENS} bytes of tokens, found {bytes}")));
        }
        let unpacked = cursor.unpack(bytes)?;
        let text = unpacked.strip_suffix(b"\0").unwrap_or(&unpacked);
        let tokens = text.split(|byte| *byte == 0);
        let found = tokens.clone().count();
        if found != count {
            return Err(cursor.wrong(format!("expected {count} tokens, found {found}")));
        }
        Ok(tokens.map(|token| String::from_utf8_lossy(token).into_owned()).collect())
    }

    /// Reads the tree of paths. An entry's first child follows it; a jump leads to its next sibling.
    fn paths(mut cursor: Cursor, memory: Option<u64>) -> Result<(Vec<Path>, Vec<u32>), SceneError> {
        let count = cursor.count()?;
        check_memory(PATH.saturating_mul(count as u64), memory)?;
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

    /// Returns the token of a name.
    fn token(&self, index: u64) -> Result<&str, SceneError> {
        let token = usize::try_from(index).ok().and_then(|index| self.tokens.get(index));
        let most = self.tokens.len();
        let wrong = |text: String| field(0, "TOKENS", text);
        let token = token
            .ok_or_else(|| wrong(format!("expected the index of a token below {most}, found {index}")))?;
        match token.len() {
            length if length > MAX_NAME => {
                Err(wrong(format!("expected a name of at most {MAX_NAME} bytes, found {length}")))
            }
            _ => Ok(token),
        }
    }

    /// Copies the token of a name.
    fn name(&self, index: u64) -> Result<String, SceneError> {
        let name = self.token(index)?;
        self.hold((size_of::<String>() + name.len()) as u64)?;
        Ok(name.to_owned())
    }

    fn fields(&self, path: u32) -> Result<Vec<(&str, Rep)>, SceneError> {
        let (_, set) = self.specs[path as usize];
        let all = self.field_sets.get(set as usize..).unwrap_or_default();
        let (mut found, paths) = (Vec::new(), self.paths.len());
        for index in all.iter().take_while(|index| **index != END) {
            self.listed.set(self.listed.get() + 1);
            if self.listed.get() > MAX_FIELDS * paths {
                let most = MAX_FIELDS * paths;
                let text = format!("expected at most {most} fields of {paths} paths, found more");
                return Err(field(0, "FIELDSETS", text));
            }
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
                    let name = self.name(path.token.into())?;
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
                    layer.prims[parent].attributes.insert(self.name(path.token.into())?, attribute);
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
            (TOKEN, false) if rep.is_inlined() => Ok(vec![self.name(rep.payload() & 0xFFFF_FFFF)?]),
            (TOKEN, true) | (TOKEN_VECTOR, _) => {
                if rep.payload() == 0 {
                    return Ok(Vec::new());
                }
                let mut cursor = Cursor { layer: self.layer, at: rep.payload(), name: "tokens" };
                let count = cursor.long()?;
                let bytes = self.layer.vec(cursor.at, count.saturating_mul(4))?;
                let words = bytes.chunks_exact(4).map(|word| {
                    let index = u32::from_le_bytes(word.try_into().expect("the chunk has 4 bytes"));
                    self.name(index.into())
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
        let numbers = Numbers::Memory(Arc::default());
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
            let known = self.unpacked.borrow().get(&rep.0).cloned();
            let (end, numbers, scalar) = match known {
                Some(known) => known,
                None => {
                    let (numbers, scalar) = self.packed(&mut cursor, count, scalar)?;
                    let found = (cursor.at, Arc::new(numbers), scalar);
                    self.unpacked.borrow_mut().insert(rep.0, found.clone());
                    found
                }
            };
            let numbers = Numbers::Memory(numbers);
            return Ok(Array { count, scalar, numbers, bytes: end - rep.payload(), ..empty });
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
    fn packed(
        &self,
        cursor: &mut Cursor,
        count: u64,
        scalar: Scalar,
    ) -> Result<(Vec<u8>, Scalar), SceneError> {
        let most = cursor.layer.length;
        if count > most {
            return Err(cursor.wrong(format!("expected at most {most} elements, found {count}")));
        }
        let [code] = cursor.take()?;
        let scalar = if code == b'i' { Scalar::I32 } else { scalar };
        // The integers of the packing, and the numbers.
        self.hold(count * (4 + scalar.size()) as u64)?;
        let mut bytes = Vec::new();
        bytes.try_reserve_exact(count as usize * scalar.size()).map_err(std::io::Error::from)?;
        match code {
            b'i' => bytes.extend(cursor.integers(count as usize)?.into_iter().flat_map(u32::to_le_bytes)),
            b't' => {
                let entries = cursor.word()?;
                let length = u64::from(entries) * scalar.size() as u64;
                self.hold(length)?;
                let table = cursor.layer.vec(cursor.at, length)?;
                cursor.at += length;
                for index in cursor.integers(count as usize)? {
                    let entry = table.chunks_exact(scalar.size()).nth(index as usize);
                    let wrong = || format!("expected the index of an entry below {entries}, found {index}");
                    bytes.extend_from_slice(entry.ok_or_else(|| cursor.wrong(wrong()))?);
                }
            }
            other => return Err(cursor.wrong(format!("expected the packing i or t, found {other}"))),
        }
        Ok((bytes, scalar))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::Source;
    use crate::testing::says;

    /// Parses a layer of `prims` prims with the name `tokens[0]`. Each has the attribute `tokens[1]`, with `fields`.
    fn parsed(
        file: &[u8],
        tokens: &[&str],
        fields: &[(u32, Rep)],
        prims: u32,
        memory: u64,
    ) -> Result<Layer, SceneError> {
        let mut sections = Sections {
            layer: &Bytes::new(Source::Bytes(file)),
            tokens: tokens.iter().map(|token| (*token).to_owned()).collect(),
            fields: fields.to_vec(),
            field_sets: (0..fields.len() as u32).chain([END]).collect(),
            paths: vec![Path::default()],
            specs: vec![(PSEUDO_ROOT, END)],
            memory: Some(memory),
            held: Cell::default(),
            listed: Cell::default(),
            unpacked: RefCell::default(),
        };
        for prim in 0..prims {
            sections.paths.push(Path { parent: Some(0), token: 0, is_property: false });
            sections.paths.push(Path { parent: Some(2 * prim + 1), token: 1, is_property: true });
            sections.specs.extend([(PRIM, END), (ATTRIBUTE, 0)]);
        }
        sections.layer(&(0..=2 * prims).collect::<Vec<_>>())
    }

    #[test]
    fn values_that_many_attributes_name_are_counted() {
        let name = "a".repeat(MAX_NAME);
        // 100 tokens with the index 0.
        let words = [&[0; 8][..], &100u64.to_le_bytes(), &[0; 400]].concat();
        let of_words = |prims, memory| {
            let tokens = [&*name, "xformOpOrder", "default"];
            parsed(&words, &tokens, &[(2, Rep(TOKEN_VECTOR << 48 | 8))], prims, memory)
        };
        assert_eq!(of_words(1, 500_000).unwrap().prims[0].attributes.len(), 1);
        says(
            of_words(9, 500_000).err().unwrap(),
            "expected a layer that fits in memory, found one that needs",
        );
        let long = name + "a";
        let said = parsed(&[], &[&long, "purpose"], &[], 1, 1 << 30).err().unwrap();
        says(said, "expected a name of at most 4096 bytes, found 4097");
    }

    #[test]
    fn a_packed_array_that_many_attributes_name_is_unpacked_once() {
        // The common difference, and a code of 0 for each of 1000 integers.
        let block = lz4_flex::block::compress(&[[7, 0, 0, 0].as_slice(), &[0; 250]].concat());
        let length = block.len() as u64 + 1;
        let (count, length) = (1000u64.to_le_bytes(), length.to_le_bytes());
        let file = [&[0; 8][..], &count, b"i", &length, &[0], &block, &[0; 1000]].concat();
        let of_arrays = |memory| {
            let rep = Rep(1 << 63 | 1 << 61 | FLOAT << 48 | 8);
            parsed(&file, &["P", "opacities", "default"], &[(2, rep)], 1000, memory)
        };
        let layer = of_arrays(100_000).unwrap();
        let numbers = |prim: usize| match &layer.prims[prim].attributes["opacities"].value {
            Some(Value::Array(Array { numbers: Numbers::Memory(bytes), .. })) => bytes.clone(),
            _ => panic!("an array in memory"),
        };
        assert_eq!((numbers(0).len(), &numbers(0)[3996..]), (4000, &7000u32.to_le_bytes()[..]));
        assert!(Arc::ptr_eq(&numbers(0), &numbers(999)));
        says(of_arrays(5000).err().unwrap(), "expected a layer that fits in memory");
    }

    #[test]
    fn fields_are_counted_for_every_path_that_shares_them() {
        let with = |fields| parsed(&[], &["P", "purpose"], &vec![(1, Rep(0)); fields], 2, 1 << 20);
        // The root, and two prims with an attribute each.
        assert_eq!(with(160).unwrap().prims.len(), 2);
        says(with(161).err().unwrap(), "expected at most 320 fields of 5 paths, found more");
    }
}
