//! Lists the 32-bit words of a storage block with names and types, for tools that show a buffer's contents.

use super::module::{Module, Type};
use crate::ir::{Member, MemberKind};
use rspirv::spirv::{Decoration, Word};

/// Maximum number of words to list. Larger blocks and structs have none.
const MAX_WORDS: usize = 64;

/// Returns the type of a 32-bit scalar; `Other` for all other types.
pub(super) fn scalar(kind: &Type) -> MemberKind {
    match kind {
        Type::Int { bits: 32, signed: false } => MemberKind::Uint,
        Type::Int { bits: 32, signed: true } => MemberKind::Int,
        Type::Float { bits: 32 } => MemberKind::Float,
        _ => MemberKind::Other,
    }
}

/// Lists the words of a block, by offset. Empty if there are more than [`MAX_WORDS`].
pub(super) fn of_block(module: &Module, block: Word) -> Result<Vec<Member>, String> {
    let mut words = Vec::new();
    let complete = Walk { module, words: &mut words, parts: 0 }.add(block, &Place::default())?;
    if !complete {
        words.clear();
    }
    words.sort_by_key(|word| word.offset);
    Ok(words)
}

/// The place of a part of a block.
#[derive(Clone, Default)]
struct Place {
    name: String,
    offset: u64,
    /// Bytes between columns, or between rows if the matrix is stored by rows.
    matrix_stride: u64,
    by_rows: bool,
}

impl Place {
    /// Returns the place of a part `name`, such as `.x` or `[2]`, at `offset` bytes within this one.
    fn part(&self, name: &str, offset: u64) -> Place {
        let full = format!("{}{name}", self.name);
        let name = full.strip_prefix('.').unwrap_or(&full).to_string();
        Place { name, offset: self.offset.saturating_add(offset), ..self.clone() }
    }
}

struct Walk<'a> {
    module: &'a Module,
    words: &'a mut Vec<Member>,
    /// Number of parts visited, which is limited because many parts can share a word or have none.
    parts: usize,
}

impl Walk<'_> {
    /// Adds the words of a type at a place. Returns false if there are too many.
    fn add(&mut self, id: Word, place: &Place) -> Result<bool, String> {
        self.parts += 1;
        if self.parts > 16 * MAX_WORDS {
            return Ok(false);
        }
        let stride = |id| self.module.number(id, None, Decoration::ArrayStride).unwrap_or(0).into();
        match &self.module.type_of(id)?.kind {
            Type::Vector { element, count } => self.vector(*element, *count, place, self.bytes(*element)?),
            Type::Matrix { column, columns } => {
                let Type::Vector { element, count } = self.module.type_of(*column)?.kind else {
                    return Err("a matrix has no columns".into());
                };
                let bytes = self.bytes(element)?;
                let (across, down) = match place.by_rows {
                    true => (bytes, place.matrix_stride),
                    false => (place.matrix_stride, bytes),
                };
                for column in 0..*columns {
                    let part = place.part(&format!("[{column}]"), across * u64::from(column));
                    if !self.vector(element, count, &part, down)? {
                        return Ok(false);
                    }
                }
                Ok(true)
            }
            Type::Array { element, length } => {
                let (element, stride): (Word, u64) = (*element, stride(id));
                for index in 0..*length {
                    let part = place.part(&format!("[{index}]"), stride.saturating_mul(index));
                    if !self.add(element, &part)? {
                        return Ok(false);
                    }
                }
                Ok(true)
            }
            Type::RuntimeArray { element } => {
                self.add(*element, &Place { name: String::new(), ..place.clone() })
            }
            Type::Struct { members } => {
                for (index, member) in members.iter().enumerate() {
                    let index = Some(index as u32);
                    let number = |decoration| self.module.number(id, index, decoration);
                    let offset = number(Decoration::Offset).unwrap_or(0).into();
                    let mut part = place.part(&format!(".{}", self.module.name(id, index)), offset);
                    part.matrix_stride = number(Decoration::MatrixStride).unwrap_or(0).into();
                    part.by_rows = self.module.decoration(id, index, Decoration::RowMajor).is_some();
                    if !self.add(*member, &part)? {
                        return Ok(false);
                    }
                }
                Ok(true)
            }
            kind @ (Type::Int { bits, .. } | Type::Float { bits }) => {
                let (kind, bits) = (scalar(kind), u64::from(*bits));
                Ok(self.push(kind, bits / 8, place))
            }
            // Not in a valid block: `Module::parse` rejects pointers to buffers.
            _ => Ok(self.push(MemberKind::Other, 8, place)),
        }
    }

    /// Returns the size of a scalar.
    fn bytes(&self, scalar: Word) -> Result<u64, String> {
        Ok(self.module.type_of(scalar)?.laid_out.unwrap_or(4))
    }

    /// Adds the components of a vector, `stride` bytes apart. Returns false if there are too many.
    fn vector(&mut self, element: Word, count: u32, place: &Place, stride: u64) -> Result<bool, String> {
        for (index, name) in (0..u64::from(count)).zip([".x", ".y", ".z", ".w"]) {
            if !self.add(element, &place.part(name, index * stride))? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Adds the words that a scalar of `bytes` bytes touches. Returns false if there are too many.
    ///
    /// A word of several small scalars is named after the first.
    fn push(&mut self, kind: MemberKind, bytes: u64, place: &Place) -> bool {
        for offset in (place.offset / 4 * 4..place.offset.saturating_add(bytes)).step_by(4) {
            let Ok(offset) = u32::try_from(offset) else { return false };
            if self.words.iter().any(|word| word.offset == offset) {
                continue;
            }
            if self.words.len() == MAX_WORDS {
                return false;
            }
            self.words.push(Member { name: place.name.clone(), offset, kind, used: true });
        }
        true
    }
}
