//! Reads the values of accessors as floats.

use super::container::Container;
use super::document::{Accessor, item};
use crate::error::{SceneError, wrong};
use crate::floats::Floats;
use crate::input::Source;

pub(super) struct Column<'a> {
    source: Source<'a>,
    start: u64,
    stride: usize,
    component: Component,
    normalized: bool,
    width: usize,
    pub count: u64,
}

#[derive(Clone, Copy, PartialEq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }
}

impl<'a> Column<'a> {
    pub(super) fn open(
        container: &'a Container,
        name: &str,
        index: usize,
        width: usize,
    ) -> Result<Self, SceneError> {
        let accessor = item(&container.document.accessors, index, name)?;
        let Accessor { count, byte_offset, normalized, .. } = *accessor;
        let fault = |message: String| wrong(name, message);
        let expected = ["SCALAR", "VEC2", "VEC3", "VEC4"][width - 1];
        if accessor.kind != expected {
            return Err(fault(format!("expected the type {expected}, found {}", accessor.kind)));
        }
        if accessor.sparse.is_some() {
            return Err(fault("expected values in a row, found a sparse accessor".into()));
        }
        let component = match accessor.component_type {
            5120 => Component::I8,
            5121 => Component::U8,
            5122 => Component::I16,
            5123 => Component::U16,
            5126 => Component::F32,
            found => {
                return Err(fault(format!("expected the componentType 5120 to 5123 or 5126, found {found}")));
            }
        };
        let view = accessor.buffer_view.ok_or_else(|| fault("expected a bufferView, found none".into()))?;
        let (source, start, view) = container.view(view)?;
        let size = (width * component.bytes()) as u64;
        let stride = view.byte_stride.unwrap_or(size);
        if !(size..=252).contains(&stride) {
            return Err(fault(format!("expected a byteStride of {size} to 252, found {stride}")));
        }
        let end = count
            .checked_sub(1)
            .and_then(|last| last.checked_mul(stride)?.checked_add(byte_offset)?.checked_add(size));
        if end.is_none_or(|end| end > view.byte_length) {
            return Err(fault(format!(
                "expected 1 to as many elements as fit in {} bytes, found {count}",
                view.byte_length
            )));
        }
        let stride = stride as usize;
        Ok(Self { source, start: start + byte_offset, stride, component, normalized, width, count })
    }

    /// Returns the number of bytes of all values, without padding between elements.
    pub(super) fn total_bytes(&self) -> u64 {
        self.count * self.bytes() as u64
    }

    pub(super) fn kind(&self) -> &'static str {
        match self.component {
            Component::I8 => "char",
            Component::U8 => "uchar",
            Component::I16 => "short",
            Component::U16 => "ushort",
            Component::F32 => "float",
        }
    }

    fn number(&self, bytes: &[u8]) -> f32 {
        let signed = |value: i16, most: f32| {
            if self.normalized { (f32::from(value) / most).max(-1.0) } else { value.into() }
        };
        let unsigned = |value: u16, most: f32| {
            if self.normalized { f32::from(value) / most } else { value.into() }
        };
        match (self.component, bytes) {
            (Component::I8, [a]) => signed(i8::from_le_bytes([*a]).into(), 127.0),
            (Component::U8, [a]) => unsigned((*a).into(), 255.0),
            (Component::I16, [a, b]) => signed(i16::from_le_bytes([*a, *b]), 32767.0),
            (Component::U16, [a, b]) => unsigned(u16::from_le_bytes([*a, *b]), 65535.0),
            (Component::F32, [a, b, c, d]) => f32::from_le_bytes([*a, *b, *c, *d]),
            _ => unreachable!("a component has as many bytes as its type"),
        }
    }
}

impl Floats for Column<'_> {
    fn width(&self) -> usize {
        self.width
    }

    fn bytes(&self) -> usize {
        self.width * self.component.bytes()
    }

    fn stride(&self) -> usize {
        self.stride
    }

    fn read(&self, first: usize, buffer: &mut [u8], out: &mut [f32]) -> Result<(), SceneError> {
        let (rows, size) = (out.len() / self.width, self.component.bytes());
        let bytes = &mut buffer[..(rows - 1) * self.stride + self.width * size];
        self.source.read(self.start + (first * self.stride) as u64, bytes)?;
        for (row, out) in bytes.chunks(self.stride).zip(out.chunks_exact_mut(self.width)) {
            for (bytes, out) in row.chunks_exact(size).zip(out) {
                *out = self.number(bytes);
            }
        }
        Ok(())
    }
}
