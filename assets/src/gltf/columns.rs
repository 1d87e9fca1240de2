//! Reads the values of accessors as floats.

use super::container::Container;
use super::document::{Accessor, SPLATTING, item};
use crate::error::{SceneError, wrong};
use crate::input::Table;
use crate::scalar::Scalar;
use crate::size_breakdown::FieldSize;

/// The type of an accessor's numbers.
#[derive(Clone, Copy)]
pub(crate) struct Component {
    pub scalar: Scalar,
    /// Value that stands for 1; `None` unless the numbers are normalised integers.
    one: Option<f32>,
}

impl Component {
    /// Creates a type from its number in OpenGL; `None` unless it is floats, or integers of 8 or 16 bits.
    pub(crate) fn new(kind: u32, normalized: bool) -> Option<Self> {
        let (scalar, one) = match kind {
            5120 => (Scalar::I8, 127.0),
            5121 => (Scalar::U8, 255.0),
            5122 => (Scalar::I16, 32767.0),
            5123 => (Scalar::U16, 65535.0),
            5126 => return Some(Self { scalar: Scalar::F32, one: None }),
            _ => return None,
        };
        Some(Self { scalar, one: normalized.then_some(one) })
    }

    /// Reads number `at` of `bytes`.
    #[inline]
    pub(crate) fn number(self, bytes: &[u8], at: usize) -> f32 {
        let value = self.scalar.value::<false>(&bytes[at * self.scalar.size()..]);
        self.one.map_or(value, |one| (value / one).max(-1.0))
    }
}

pub(super) struct Column<'a> {
    pub table: Table<'a>,
    pub component: Component,
    pub count: u64,
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
        let found = accessor.component_type;
        let component = Component::new(found, normalized).ok_or_else(|| {
            fault(format!("expected the componentType 5120 to 5123 or 5126, found {found}"))
        })?;
        let view = accessor.buffer_view.ok_or_else(|| fault("expected a bufferView, found none".into()))?;
        let (source, view) = container.view(view)?;
        let size = (width * component.scalar.size()) as u64;
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
        let (stride, width) = (stride as usize, size as usize);
        Ok(Self { table: Table { source, start: byte_offset, stride, width }, component, count })
    }

    /// Measures the values of the attribute `name`, which loses the extension's prefix.
    pub(super) fn size(&self, name: &str) -> FieldSize {
        let name = name.trim_start_matches(SPLATTING).trim_start_matches(':');
        FieldSize::column(name, self.component.scalar.name(), self.table.width as u64, self.count)
    }
}
