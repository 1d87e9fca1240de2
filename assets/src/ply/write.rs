//! Writes scenes in the reference layout: binary, little endian, all properties `float`. Further properties that the
//! scene was loaded with come last.
//!
//! In a scene with an offset or wide positions, positions are `double`, because `float` lacks the precision.

use super::tags;
use crate::activation::{logarithm, logit};
use crate::scene::{Scene, Splat, sh_floats};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use crate::words::write_rows;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Lists the properties' names, in the reference implementation's order.
pub(super) fn property_names(degree: u32) -> Vec<String> {
    let rest = sh_floats(degree) - 3;
    let numbered = |name: &'static str, n: usize| (0..n).map(move |i| format!("{name}_{i}"));
    ["x", "y", "z", "nx", "ny", "nz"]
        .map(String::from)
        .into_iter()
        .chain(numbered("f_dc", 3))
        .chain(numbered("f_rest", rest))
        .chain(["opacity".into()])
        .chain(numbered("scale", 3))
        .chain(numbered("rot", 4))
        .collect()
}

/// Returns the type and the size of a property. The first three are the position.
fn kind(column: usize, wide: bool) -> (&'static str, u64) {
    if wide && column < 3 { ("double", 8) } else { ("float", 4) }
}

/// Lists the further properties of a scene that the reference layout lacks: indices and names.
fn further(scene: &Scene) -> Vec<(usize, &str)> {
    let own = property_names(scene.stored_degree());
    let all = scene.property_names().iter().map(String::as_str).enumerate();
    all.filter(|(_, name)| !own.iter().any(|own| own == name)).collect()
}

/// The columns of a file.
struct Columns<'a> {
    count: u64,
    degree: u32,
    wide: bool,
    further: &'a [(usize, &'a str)],
}

impl Columns<'_> {
    fn names(&self) -> Vec<String> {
        let further = self.further.iter().map(|(_, name)| (*name).to_owned());
        property_names(self.degree).into_iter().chain(further).collect()
    }
}

fn header(columns: &Columns, comments: &str) -> String {
    let (count, wide) = (columns.count, columns.wide);
    let names = columns.names().into_iter().enumerate();
    let properties: String =
        names.map(|(column, name)| format!("property {} {name}\n", kind(column, wide).0)).collect();
    format!(
        "ply\nformat binary_little_endian 1.0\n{comments}element vertex {count}\n{properties}end_header\n"
    )
}

fn size_breakdown(columns: &Columns, comments: &str) -> SizeBreakdown {
    let count = columns.count;
    let field = |(column, name): (usize, String)| {
        let (kind, size) = kind(column, columns.wide);
        let used = !["nx", "ny", "nz"].contains(&name.as_str());
        FieldSize { used, ..FieldSize::column(name, kind, size, count) }
    };
    let fields = columns.names().into_iter().enumerate().map(field).collect();
    let header_bytes = header(columns, comments).len() as u64;
    let vertex = ElementSize::new("vertex", count, fields);
    let format = "ply, binary_little_endian".into();
    SizeBreakdown::new(format, header_bytes + vertex.bytes, header_bytes, vec![vertex])
}

impl Scene {
    /// Returns the sizes of the parts of the file; for a generated scene, of the file that [`Scene::write_ply`] writes.
    pub fn size_breakdown(&self) -> &SizeBreakdown {
        self.size_breakdown
            .get_or_init(|| size_breakdown(&self.ply_columns(&further(self)), &tags::comments(self)))
    }

    fn ply_columns<'a>(&self, further: &'a [(usize, &'a str)]) -> Columns<'a> {
        Columns { count: self.count().into(), degree: self.stored_degree(), wide: self.is_offset(), further }
    }

    /// Returns true if positions need more precision than `float`.
    fn is_offset(&self) -> bool {
        self.offset() != [0.0; 3] || self.is_wide()
    }

    /// Writes the scene as a PLY file in the reference layout, with its stored degree, in the world's coordinates.
    ///
    /// Logarithms and logits are rounded to f32, so a scene read back agrees to a relative error of about 1e-6, but is
    /// not bit-identical. An opacity of 0 or 1 and a scale of 0 are written as finite values that read back unchanged.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn write_ply(&self, path: impl AsRef<Path>) -> std::io::Result<()> {
        let mut out = BufWriter::new(std::fs::File::create(path)?);
        self.write_ply_to(&mut out)?;
        out.flush()
    }

    /// Writes the same bytes as [`Scene::write_ply`] to any writer.
    ///
    /// # Errors
    /// The writer fails.
    pub fn write_ply_to(&self, out: &mut impl Write) -> std::io::Result<()> {
        let further = further(self);
        let columns = self.ply_columns(&further);
        out.write_all(header(&columns, &tags::comments(self)).as_bytes())?;
        write_rows(self.count() as usize, out, |index, bytes| {
            let splat = self.splat(index);
            match columns.wide {
                true => bytes.extend(self.world_position(index).into_iter().flat_map(f64::to_le_bytes)),
                false => bytes.extend(splat.position.into_iter().flat_map(f32::to_le_bytes)),
            }
            encode(&splat, columns.degree, bytes);
            let values = further.iter().map(|(name, _)| self.property(index, *name));
            bytes.extend(values.flat_map(f32::to_le_bytes));
        })
    }
}

/// Appends a row without its position to `out`.
fn encode(splat: &Splat, degree: u32, out: &mut Vec<u8>) {
    let mut put = |value: f32| out.extend_from_slice(&value.to_le_bytes());
    // Normals; the reference writes zeros.
    (0..3).for_each(|_| put(0.0));
    splat.sh[..3].iter().copied().for_each(&mut put);
    for channel in 0..3 {
        for k in 1..sh_floats(degree) / 3 {
            put(splat.sh[3 * k + channel]);
        }
    }
    put(logit(splat.opacity));
    splat.scale.map(logarithm).into_iter().for_each(&mut put);
    splat.rotation.into_iter().for_each(&mut put);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::says;

    #[test]
    fn a_reference_file_of_degree_3_has_248_bytes_per_splat() {
        let size = size_breakdown(&Columns { count: 1000, degree: 3, wide: false, further: &[] }, "");
        assert_eq!(size.elements[0].bytes, 248_000);
        assert_eq!(size.sum(), size.file_bytes);
        let text = size.to_string();
        says(&text, "f_rest_0..44");
        says(&text, "45 x 4");
        assert!(text.lines().any(|l| l.contains(" nx ") && l.ends_with("skipped")), "{text}");
    }
}
