//! Reads and writes the `.splat` files of antimatter15's viewer: 32 bytes per splat and no header.
//!
//! | bytes | value |
//! |---|---|
//! | 0 to 11 | centre, three `f32` |
//! | 12 to 23 | standard deviation along each axis, three `f32` |
//! | 24 to 27 | red, green and blue of band 0, and opacity, 0 to 255 for 0 to 1 |
//! | 28 to 31 | quaternion w, x, y, z, a byte `u` for `(u - 128) / 128` |
//!
//! There are no spherical harmonics above band 0. Format: <https://github.com/antimatter15/splat>.

use crate::activation::{self, SH_C0, quantised};
use crate::error::{SceneError, field};
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::scene::{FileNotes, Scene, Splat};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use crate::words::{float, write_rows};
use std::io::{Result as IoResult, Write};

pub(crate) const STRIDE: usize = 32;

/// Returns true if all whole rows of `head` can be splats, and most have quaternions of about unit length.
///
/// The format has no magic number: only its values can distinguish it from other data.
pub(crate) fn is_plausible(head: &[u8]) -> bool {
    let rows = head.chunks_exact(STRIDE);
    let count = rows.len();
    let mut unit = 0;
    for row in rows {
        let finite = (0..3).all(|axis| float(row, 4 * axis).is_finite());
        let scaled = (3..6).all(|axis| float(row, 4 * axis).is_finite() && float(row, 4 * axis) >= 0.0);
        if !finite || !scaled {
            return false;
        }
        unit += usize::from((0.9..1.1).contains(&activation::unit(quaternion(row)).1));
    }
    count > 0 && 2 * unit > count
}

/// Decodes the quaternion w, x, y, z of a row, without normalising it.
fn quaternion(row: &[u8]) -> [f64; 4] {
    std::array::from_fn(|at| (f64::from(row[28 + at]) - 128.0) / 128.0)
}

pub(crate) fn header(source: &Source) -> Result<SceneHeader, SceneError> {
    let length = source.length();
    let count = length / STRIDE as u64;
    let left = length % STRIDE as u64;
    if left != 0 {
        let message =
            format!("expected a multiple of 32 bytes, found {length}: {count} splats and {left} bytes");
        return Err(field(length - left, "splat", message));
    }
    SceneError::check_count(count)?;
    Ok(SceneHeader { count, stored_degree: 0 })
}

pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    let SceneHeader { count, .. } = header(input.source)?;
    let done = Done::new(input.source.length(), input.progress)?;
    let table = [Table::new(*input.source, 0, STRIDE)];
    let filled = input.fill((count, 0, false), table, 0, &done, |[row], _, out| {
        let (splat, norm) = splat(row);
        out.push(&splat, norm);
    })?;
    let fields =
        [("position", "float", 12), ("scale", "float", 12), ("color", "uchar", 4), ("rotation", "uchar", 4)];
    let field = |(name, kind, size): (&str, &str, u64)| FieldSize::column(name, kind, size, count);
    let rows = ElementSize::new("splat", count, fields.into_iter().map(field).collect());
    let size_breakdown = SizeBreakdown::new(".splat".into(), input.source.length(), 0, vec![rows]);
    input::finish(filled, count, size_breakdown, FileNotes::default())
}

/// Converts a row; also returns the length of the file's quaternion.
fn splat(row: &[u8]) -> (Splat, f64) {
    let (rotation, norm) = activation::unit(quaternion(row));
    let part = |at: usize| f64::from(row[24 + at]) / 255.0;
    let splat = Splat {
        position: std::array::from_fn(|axis| float(row, 4 * axis)),
        scale: std::array::from_fn(|axis| float(row, 12 + 4 * axis)),
        rotation,
        opacity: part(3) as f32,
        sh: activation::flat([0, 1, 2].map(part)),
    };
    (splat, norm)
}

/// Writes a scene, without the harmonics above band 0.
pub(crate) fn write(scene: &Scene, out: &mut impl Write) -> IoResult<()> {
    write_rows(scene.count() as usize, out, |index, bytes| {
        let splat = scene.splat(index);
        let position = scene.world_position(index).map(|v| v as f32);
        bytes.extend(position.into_iter().chain(splat.scale).flat_map(f32::to_le_bytes));
        bytes.extend(splat.sh[..3].iter().map(|c| quantised(f64::from(*c) * SH_C0 + 0.5, 255) as u8));
        bytes.push(quantised(splat.opacity.into(), 255) as u8);
        let component = |c: f32| (f64::from(c) * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8;
        bytes.extend(splat.rotation.map(component));
    })
}
