//! Finds a splat's properties in `element vertex`.

use super::header::{Element, PropertyType, wrong_line};
use crate::activation;
use crate::error::{SceneError, nearest};
use crate::scalar::Scalar;
use crate::scene::Splat;

/// Index of the first slot of each attribute in [`Layout::slots`] and in a row of values.
const POSITION: usize = 0;
const SCALE: usize = 3;
const ROTATION: usize = 6;
const OPACITY: usize = 10;
const DC: usize = 11;
const REST: usize = 14;

pub(crate) const MAX_SLOTS: usize = REST + 45;

/// Names of the properties that every splat has, in slot order.
const NAMES: [&str; REST] = [
    "x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "opacity", "f_dc_0",
    "f_dc_1", "f_dc_2",
];

#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    /// Index of the property.
    pub column: usize,
    /// Offset in a binary row, in bytes.
    pub offset: usize,
    pub scalar: Scalar,
}

/// The mapping from rows of `element vertex` to splats.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    /// Degree of the stored spherical harmonics.
    pub degree: u32,
    /// Bytes of a binary row.
    pub stride: usize,
    /// Slot of each value: [`NAMES`], then `f_rest_*`.
    pub slots: Vec<Slot>,
    /// Index of the slot that each column fills; `None` for a column that no splat uses.
    pub slot_of: Vec<Option<usize>>,
}

/// Counts an element's properties `f_rest_*`. Also returns the degree of their harmonics.
pub(super) fn rest(element: &Element) -> Result<(usize, u32), SceneError> {
    let found = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    match [0, 9, 24, 45].iter().position(|count| *count == found) {
        Some(degree) => Ok((found, degree as u32)),
        None => Err(SceneError::Invalid(format!(
            "expected 0, 9, 24 or 45 properties `f_rest_*` (spherical harmonics of degree 0, 1, 2 or 3) in `element {}` (line {}), found {found}",
            element.name, element.line
        ))),
    }
}

impl Layout {
    pub(crate) fn find(vertex: &Element) -> Result<Self, SceneError> {
        let line = vertex.line;
        let mut columns: Vec<(&str, Slot)> = Vec::with_capacity(vertex.properties.len());
        let mut stride = 0;
        for (column, property) in vertex.properties.iter().enumerate() {
            let PropertyType::Scalar(scalar) = property.kind else {
                let text = format!("`{}` is a list: splats have only single values", property.name);
                return Err(wrong_line(property.line, &text));
            };
            columns.push((&property.name, Slot { column, offset: stride, scalar }));
            stride += scalar.size();
        }
        let find = |name: &str| columns.iter().find(|(n, _)| *n == name).map(|(_, slot)| *slot);
        let missing = |name: &str| {
            let cloud = name.starts_with("scale") || name.starts_with("f_dc");
            let near = nearest(name, columns.iter().map(|(n, _)| *n));
            let near = near.map(|near| format!("; the nearest name there is `{near}`")).unwrap_or_default();
            let hint = match cloud && find("x").is_some() && find("scale_0").is_none() {
                true => " (it may be a point cloud or a mesh, which has no splats)",
                false => "",
            };
            SceneError::Invalid(format!(
                "`element vertex` (line {line}) has no property `{name}`{near}{hint}"
            ))
        };
        if find("scale_1").is_some() && find("rot_0").is_some() && find("scale_2").is_none() {
            return Err(SceneError::SURFELS);
        }
        let mut slots = Vec::with_capacity(MAX_SLOTS);
        for name in NAMES {
            slots.push(find(name).ok_or_else(|| missing(name))?);
        }
        let (rest, degree) = rest(vertex)?;
        for index in 0..rest {
            let name = format!("f_rest_{index}");
            slots.push(find(&name).ok_or_else(|| missing(&name))?);
        }
        let mut slot_of = vec![None; columns.len()];
        for (index, slot) in slots.iter().enumerate() {
            slot_of[slot.column] = Some(index);
        }
        Ok(Self { degree, stride, slots, slot_of })
    }

    /// Returns for each axis true if the file's type has more precision than f32.
    pub(crate) fn wide(&self) -> [bool; 3] {
        std::array::from_fn(|axis| matches!(self.slots[axis].scalar, Scalar::F64 | Scalar::I32 | Scalar::U32))
    }

    /// Converts the file's values to a splat; also returns the length of its quaternion.
    #[inline]
    pub(crate) fn splat(&self, value: impl Fn(usize) -> f32) -> (Splat, f64) {
        let (rotation, norm) = activation::unit(std::array::from_fn(|i| f64::from(value(ROTATION + i))));
        let mut splat = Splat {
            position: [value(POSITION), value(POSITION + 1), value(POSITION + 2)],
            scale: std::array::from_fn(|i| activation::exponential(value(SCALE + i))),
            rotation,
            opacity: activation::sigmoid(value(OPACITY)),
            sh: [0.0; 48],
        };
        for channel in 0..3 {
            splat.sh[channel] = value(DC + channel);
        }
        let bands = ((self.degree + 1) * (self.degree + 1)) as usize - 1;
        for channel in 0..3 {
            for k in 0..bands {
                splat.sh[3 * (k + 1) + channel] = value(REST + channel * bands + k);
            }
        }
        (splat, norm)
    }
}
