//! Finds a splat's properties in `element vertex`.

use super::header::{Element, Header, PropertyType, wrong_line};
use crate::activation;
use crate::error::{SceneError, nearest};
use crate::scalar::Scalar;
use crate::scene::{FileNotes, Filter, Splat, sh_floats};

/// Index of the first slot of each attribute in [`Layout::slots`] and in a row of values.
const POSITION: usize = 0;
const SCALE: usize = 3;
const ROTATION: usize = 6;
const OPACITY: usize = 10;
const DC: usize = 11;
const REST: usize = 14;

/// Maximum number of slots for the splat: the values of degree 3, and [`FILTER`].
const MAX_SLOTS: usize = REST + 45 + 1;

/// Names of the properties of a splat, in slot order.
const NAMES: [&str; REST] = [
    "x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "opacity", "f_dc_0",
    "f_dc_1", "f_dc_2",
];

/// Names of the properties with a colour as bytes, which nerfstudio can write instead of `f_dc_*`.
const COLORS: [&str; 3] = ["red", "green", "blue"];

/// Name of the standard deviation of Mip-Splatting's 3D filter.
const FILTER: &str = "filter_3D";

/// Prefixes that CloudCompare and converters for it add to all names but `x`, `y`, `z` and those of normals.
const PREFIXES: [&str; 4] = ["", "scalar_", "scal_", "scalar_scal_"];

/// Advice for scenes of moving splats.
const MOVING: &str = "export its splats at one moment as 3D Gaussians";

/// Properties or elements of splats that are not 3D Gaussians at rest, and the words of the error. A key that ends in
/// `_` stands for all names that begin with it.
const REFUSED: [(&[&str], &str, &str); 6] = [
    (&["trbf_center", "motion_", "omega_"], "a scene of Spacetime Gaussians, which move", MOVING),
    (&["scale_t", "scale_t_", "t_scale", "rot_r_"], "a scene of 4D Gaussians (4DGS), which move", MOVING),
    (&["delta_vertex_"], "a scene of moving splats (Brush)", MOVING),
    (&["shape_"], "a scene of generalised exponentials (GES)", "only 3D Gaussians are drawn"),
    (&["beta", "sb_params_"], "a scene of Deformable Beta Splatting", "only 3D Gaussians are drawn"),
    (
        &["f_anchor_feat_"],
        "a scene of anchors (Scaffold-GS), whose splats a network computes for each view",
        "only 3D Gaussians are drawn",
    ),
];

/// Refuses splats that are not 3D Gaussians at rest.
pub(super) fn check(header: &Header) -> Result<(), SceneError> {
    let properties = header.vertex()?.properties.iter().map(|property| &property.name);
    for name in properties.chain(header.elements.iter().map(|element| &element.name)) {
        let is = |key: &&str| name == key || (key.ends_with('_') && name.starts_with(*key));
        if let Some((_, format, advice)) = REFUSED.iter().find(|(keys, ..)| keys.iter().any(is)) {
            return Err(SceneError::Unsupported { format, advice });
        }
    }
    Ok(())
}

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
    pub harmonics: Rest,
    /// Bytes of a binary row.
    pub stride: usize,
    /// Slot of each value: [`NAMES`], then `f_rest_*`, then perhaps [`FILTER`], then further properties.
    pub slots: Vec<Slot>,
    /// Index of the slot that each column fills; `None` for a column that no splat uses.
    pub slot_of: Vec<Option<usize>>,
    /// True if the file has [`COLORS`] instead of band 0.
    colors: bool,
    /// Index of the slot of [`FILTER`]; `None` if the file lacks it.
    filter: Option<usize>,
    /// Names of the requested properties, and the indices of their slots.
    pub properties: (Vec<String>, Vec<usize>),
}

/// An element's properties `f_rest_*`, the harmonics above band 0.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Rest {
    /// Number of coefficients above band 0 per channel, in the file.
    stored: usize,
    /// Degree of the harmonics that are read.
    pub degree: u32,
    /// Degree in the file, if it is above 3.
    pub cut_degree: Option<u32>,
}

impl Rest {
    /// Counts the properties, whose names `prefix` precedes. Fails if their number fits no degree from 0 to 4.
    pub(super) fn of(element: &Element, prefix: &str) -> Result<Self, SceneError> {
        let names = element.properties.iter().filter_map(|property| property.name.strip_prefix(prefix));
        let found = names.filter(|name| name.starts_with("f_rest_")).count();
        match [0, 9, 24, 45, 72].iter().position(|count| *count == found) {
            Some(degree) => {
                let degree = degree as u32;
                Ok(Self {
                    stored: found / 3,
                    degree: degree.min(3),
                    cut_degree: (degree > 3).then_some(degree),
                })
            }
            None => Err(SceneError::Invalid(format!(
                "expected 0, 9, 24, 45 or 72 properties `f_rest_*` (spherical harmonics of degree 0 to 4) in `element {}` (line {}), found {found}",
                element.name, element.line
            ))),
        }
    }

    /// Returns the number of coefficients above band 0 per channel that are read.
    fn read(self) -> usize {
        sh_floats(self.degree) / 3 - 1
    }

    /// Lists the names of the properties that are read, channel by channel.
    pub(super) fn names(self) -> impl Iterator<Item = String> {
        let numbers =
            (0..3).flat_map(move |channel| (0..self.read()).map(move |k| channel * self.stored + k));
        numbers.map(|number| format!("f_rest_{number}"))
    }
}

impl Layout {
    /// Finds the slots of a splat's values and of the requested `properties`. Skips names that the element lacks.
    pub(crate) fn find(vertex: &Element, properties: &[String]) -> Result<Self, SceneError> {
        let line = vertex.line;
        let has = |name: &str| vertex.properties.iter().any(|property| property.name == name);
        let prefix = PREFIXES.into_iter().find(|prefix| has(&format!("{prefix}scale_0"))).unwrap_or("");
        let mut columns: Vec<(&str, Slot)> = Vec::with_capacity(vertex.properties.len());
        let mut stride = 0;
        for (column, property) in vertex.properties.iter().enumerate() {
            let PropertyType::Scalar(scalar) = property.kind else {
                let text = format!("`{}` is a list: splats have only single values", property.name);
                return Err(wrong_line(property.line, &text));
            };
            let name = property.name.strip_prefix(prefix).unwrap_or(&property.name);
            columns.push((name, Slot { column, offset: stride, scalar }));
            stride += scalar.size();
        }
        let find = |name: &str| columns.iter().find(|(n, _)| *n == name).map(|(_, slot)| *slot);
        let missing = |name: &str| {
            let of_splats =
                |(n, _): &(&str, _)| ["scale_", "rot_", "f_dc_"].iter().any(|part| n.contains(part));
            let near = nearest(name, columns.iter().map(|(n, _)| *n));
            let near = near.map(|near| format!("; the nearest name there is `{near}`")).unwrap_or_default();
            let hint = match find("x").is_some() && !columns.iter().any(of_splats) {
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
        let byte = |name: &str| find(name).is_some_and(|slot| slot.scalar == Scalar::U8);
        let colors = find(NAMES[DC]).is_none() && COLORS.into_iter().all(byte);
        let dc = if colors { &COLORS } else { &NAMES[DC..] };
        let mut slots = Vec::with_capacity(MAX_SLOTS);
        for name in NAMES[..DC].iter().chain(dc) {
            slots.push(find(name).ok_or_else(|| missing(name))?);
        }
        let harmonics = Rest::of(vertex, prefix)?;
        for name in harmonics.names() {
            slots.push(find(&name).ok_or_else(|| missing(&name))?);
        }
        let filter = find(FILTER).map(|_| slots.len());
        slots.extend(find(FILTER));
        let mut slot_of = vec![None; columns.len()];
        for (index, slot) in slots.iter().enumerate() {
            slot_of[slot.column] = Some(index);
        }
        let mut further = (Vec::new(), Vec::new());
        for name in properties {
            let Some(slot) = find(name) else { continue };
            let index = *slot_of[slot.column].get_or_insert_with(|| {
                slots.push(slot);
                slots.len() - 1
            });
            further.0.push(name.clone());
            further.1.push(index);
        }
        Ok(Self { harmonics, stride, slots, slot_of, colors, filter, properties: further })
    }

    /// Adds the tags that the properties imply to those of the header.
    pub(crate) fn notes(&self, notes: FileNotes) -> FileNotes {
        let low_pass = if self.filter.is_some() { Filter::Mip } else { notes.low_pass };
        FileNotes { low_pass, cut_degree: self.harmonics.cut_degree, ..notes }
    }

    /// Returns for each axis true if the file's type has more precision than f32.
    pub(crate) fn wide(&self) -> [bool; 3] {
        std::array::from_fn(|axis| matches!(self.slots[axis].scalar, Scalar::F64 | Scalar::I32 | Scalar::U32))
    }

    /// Converts the file's values to a splat; also returns the length of the file's quaternion, before normalisation.
    /// `value` returns the value of a slot.
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
        let band_0 = std::array::from_fn(|channel| value(DC + channel));
        if self.colors {
            splat.sh = activation::flat(band_0.map(|byte| f64::from(byte) / 255.0));
        } else {
            splat.sh[..3].copy_from_slice(&band_0);
        }
        if let Some(filter) = self.filter {
            (splat.scale, splat.opacity) = activation::filtered(splat.scale, splat.opacity, value(filter));
        }
        let bands = self.harmonics.read();
        for channel in 0..3 {
            for k in 0..bands {
                splat.sh[3 * (k + 1) + channel] = value(REST + channel * bands + k);
            }
        }
        (splat, norm)
    }
}
