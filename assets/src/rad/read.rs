//! Reads the splats of a file. Unpacks the arrays of all chunks, then converts the rows of the leaves in parallel.

use super::chunk::{Arrays, Chunks};
use super::document::{BANDS, Name};
use crate::activation;
use crate::error::SceneError;
use crate::input::{self, Done, Input, SceneHeader, Source};
use crate::memory::SceneMemoryError;
use crate::scene::{FileNotes, Scene, Splat};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use rayon::prelude::*;
use std::path::Path;

/// Bytes that a converted splat adds to the progress.
const CONVERTED: u64 = 64;

/// Reads the number of splats, nodes of a tree included, and the degree of their harmonics.
pub(crate) fn header(source: &Source, path: Option<&Path>) -> Result<SceneHeader, SceneError> {
    let chunks = Chunks::read(source, path.and_then(Path::parent))?;
    Ok(SceneHeader { count: chunks.count, stored_degree: chunks.degree })
}

/// Parses the splats of a `.rad` or `.radc` file. `path` locates the chunks beside it.
pub(crate) fn parse(input: &Input, path: Option<&Path>) -> Result<Scene, SceneError> {
    let folder = path.and_then(Path::parent);
    let all = Chunks::read(input.source, folder)?;
    let unpacked = all.chunks.iter().fold(0u64, |sum, chunk| sum.saturating_add(chunk.unpacked_bytes));
    // Each leaf has an index of 4 bytes.
    let beside = unpacked.saturating_add(4 * all.count);
    let needed = Scene::host_bytes(all.count, all.degree).saturating_add(beside);
    SceneMemoryError::check_against(all.count, all.degree, needed, input.memory)?;
    let done = Done::new(unpacked + all.count * CONVERTED, input.progress)?;
    let arrays: Vec<Result<Arrays, SceneError>> =
        all.chunks.par_iter().map(|chunk| chunk.unpack(input.source, folder, &done)).collect();
    let arrays: Vec<Arrays> = arrays.into_iter().collect::<Result<_, _>>()?;

    let mut ends = Vec::with_capacity(arrays.len());
    let mut count = 0;
    for chunk in &arrays {
        count += chunk.kept();
        ends.push(count);
    }
    let lod_nodes = all.count - count as u64;
    done.add(lod_nodes * CONVERTED)?;
    if count == 0 {
        let reasons = format!("{lod_nodes} nodes above the leaves of a tree");
        return Err(SceneError::AllDropped { count: all.count, reasons });
    }
    let mut columns = input.allocate(count as u64, all.degree, false, (0, beside))?;
    let gathered = columns.fill(|out| {
        for index in out.first()..out.first() + out.len() {
            let at = ends.partition_point(|end| *end <= index);
            let chunk = &arrays[at];
            let row = chunk.row(index - if at > 0 { ends[at - 1] } else { 0 });
            let (splat, norm) = splat(chunk, &arrays[0], row);
            out.push_clamped(&splat, norm);
        }
        done.add(out.len() as u64 * CONVERTED)
    })?;
    let notes = FileNotes { lod_nodes, ..FileNotes::default() };
    input::finish((columns, gathered), count as u64, breakdown(&all, count as u64), notes)
}

/// Converts a row; also returns the length of the file's quaternion. The palette of harmonics is in the `first` chunk.
/// A label beyond it gives NaN.
fn splat(chunk: &Arrays, first: &Arrays, row: usize) -> (Splat, f64) {
    let column = |name: Name| chunk.get(name).expect("each chunk was checked to have it");
    let vector = |name: Name| [0, 1, 2].map(|component| column(name).value(row, component));
    let (rotation, norm) = activation::unit(column(Name::Orientation).quaternion(row));
    let mut splat = Splat {
        position: vector(Name::Center),
        scale: vector(Name::Scales),
        rotation,
        opacity: column(Name::Alpha).value(row, 0),
        sh: activation::flat(vector(Name::Rgb).map(f64::from)),
    };
    for (band, (own, code)) in BANDS.into_iter().enumerate() {
        let (column, row) = match (chunk.get(own), first.get(code), chunk.get(Name::ShLabel)) {
            (Some(column), ..) => (column, row),
            (None, Some(palette), Some(label)) => (palette, label.index(row)),
            _ => continue,
        };
        let values = splat.sh[[3, 12, 27][band]..].iter_mut().take(own.width());
        for (component, value) in values.enumerate() {
            *value = if row < column.rows { column.value(row, component) } else { f32::NAN };
        }
    }
    (splat, norm)
}

fn breakdown(all: &Chunks, leaves: u64) -> SizeBreakdown {
    let kind = if leaves < all.count { ", leaves of a tree" } else { "" };
    let field = |(name, bytes): (Name, u64)| FieldSize {
        used: name != Name::ChildStart,
        ..FieldSize::whole(name.text(), "array", bytes)
    };
    let format = format!("rad, {} chunks{kind}", all.chunks.len());
    let arrays = ElementSize::new("splats", all.count, all.sizes().into_iter().map(field).collect());
    let header_bytes = all.file_bytes - arrays.bytes - all.trailing_bytes;
    SizeBreakdown::new(format, all.file_bytes, header_bytes, vec![arrays])
}
