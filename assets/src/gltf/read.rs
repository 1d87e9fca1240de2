//! Reads the splats of glTF, primitive by primitive.

use super::columns::Column;
use super::container::{self, Container};
use super::document::{Document, Primitive, SPLATTING, Splats};
use crate::activation;
use crate::error::{SceneError, wrong};
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::node_transform::NodeTransform;
use crate::scene::{FileNotes, Scene, Splat};
use crate::similarity::Similarity;
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use crate::spz;
use glam::DQuat;
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::f64::consts::PI;
use std::path::Path;

/// Number of attributes of splats of degree 3.
const MAX_COLUMNS: usize = 4 + 16;

pub(super) fn coefficient(band: u32, index: u32) -> String {
    format!("{SPLATTING}:SH_DEGREE_{band}_COEF_{index}")
}

/// Lists the attributes of splats with harmonics of `degree`, each with its number of components.
pub(super) fn attributes(degree: u32) -> Vec<(String, usize)> {
    let named = |name: &str| format!("{SPLATTING}:{name}");
    let bands = (0..=degree).flat_map(|band| (0..2 * band + 1).map(move |index| coefficient(band, index)));
    [("POSITION".to_owned(), 3), (named("ROTATION"), 4), (named("SCALE"), 3), (named("OPACITY"), 1)]
        .into_iter()
        .chain(bands.map(|name| (name, 3)))
        .collect()
}

/// Finds the degree of a primitive's harmonics. Only bands up to 3 are read.
fn file_degree(primitive: &Primitive) -> u32 {
    let has = |band: &u32| primitive.attributes.contains_key(&coefficient(*band, 0));
    (1..).take_while(has).last().unwrap_or(0)
}

pub(crate) fn header(source: &Source) -> Result<SceneHeader, SceneError> {
    let document = container::document(source)?;
    let headers: Vec<_> =
        document.splats()?.0.iter().map(|splats| splats_header(&document, splats)).collect();
    Ok(SceneHeader::joined(&headers))
}

/// Returns the number of splats that a primitive's positions declare, and the degree of its harmonics.
fn splats_header(document: &Document, splats: &Splats) -> SceneHeader {
    let positions = splats.primitive.attributes.get("POSITION");
    let positions = positions.and_then(|index| document.accessors.get(*index));
    let count = positions.map_or(0, |accessor| accessor.count);
    SceneHeader { count, stored_degree: file_degree(splats.primitive).min(3) }
}

/// Opens the attributes of a primitive that are read, up to harmonics of `degree`. Also returns their names.
fn columns<'a>(
    container: &'a Container,
    primitive: &Primitive,
    degree: u32,
) -> Result<(Vec<Column<'a>>, Vec<String>), SceneError> {
    let (mut columns, mut names) = (Vec::new(), Vec::new());
    for (name, width) in attributes(degree) {
        let index = primitive.attributes.get(&name).copied();
        let index = index.ok_or_else(|| wrong("attributes", format!("expected {name}, found none")))?;
        columns.push(Column::open(container, &name, index, width)?);
        names.push(name);
    }
    Ok((columns, names))
}

/// Measures the bytes of each kind of value of a primitive.
fn sizes(container: &Container, splats: &Splats) -> Result<Vec<FieldSize>, SceneError> {
    if let Some(view) = splats.spz {
        let (bytes, _) = container.view(view)?;
        return Ok(vec![FieldSize::whole("spz", "file", bytes.length())]);
    }
    let (columns, names) = columns(container, splats.primitive, file_degree(splats.primitive).min(3))?;
    let fields = columns.iter().zip(&names).map(|(column, name)| column.size(name));
    let is_other = |(name, _): &(&String, &usize)| !names.contains(name);
    let others = splats.primitive.attributes.iter().filter(is_other);
    let others = others.filter_map(|(name, index)| unread(container, name, *index));
    Ok(fields.chain(others).collect())
}

/// Reads a primitive without SPZ. Its scales are logarithms if `logarithmic`.
fn plain(
    input: &Input,
    container: &Container,
    splats: &Splats,
    logarithmic: bool,
) -> Result<Scene, SceneError> {
    let file_degree = file_degree(splats.primitive);
    let degree = file_degree.min(3);
    let (columns, names) = columns(container, splats.primitive, degree)?;
    let count = columns[0].count;
    if let Some((column, name)) = columns.iter().zip(&names).find(|(column, _)| column.count != count) {
        let text = format!("expected {count} elements, as of POSITION, found {}", column.count);
        return Err(wrong(name.as_str(), text));
    }
    SceneError::check_count(count)?;
    let transform = NodeTransform::new(splats.place, degree);
    let bytes = |column: &Column| column.count * column.table.width as u64;
    let done = Done::new(columns.iter().map(bytes).sum(), input.progress)?;
    let tables: [Table; MAX_COLUMNS] =
        std::array::from_fn(|at| columns.get(at).map_or(Table::NONE, |column| column.table));
    let filled = input.fill((count, degree, false), tables, 0, &done, |rows, _, out| {
        let (mut splat, norm) = splat(&columns, rows, logarithmic);
        transform.apply(&mut splat);
        out.push_clamped(&splat, norm);
    })?;
    let cut_degree = (file_degree > 3).then_some(file_degree);
    let notes = FileNotes { cut_degree, ..FileNotes::default() };
    let scene = input::finish(filled, count, SizeBreakdown::default(), notes)?;
    Ok(scene.with_offset(transform.offset()))
}

/// Measures an attribute that is not read; `None` if its accessor is of no type that [`Column::open`] accepts.
fn unread(container: &Container, name: &str, index: usize) -> Option<FieldSize> {
    let column = (1..=4).find_map(|width| Column::open(container, name, index, width).ok())?;
    Some(FieldSize { used: false, ..column.size(name) })
}

/// Converts the row of each column to a splat; also returns the length of the file's quaternion. The scales are
/// logarithms if `logarithmic`, otherwise standard deviations.
fn splat(columns: &[Column], rows: [&[u8]; MAX_COLUMNS], logarithmic: bool) -> (Splat, f64) {
    let of = |column: usize, number: usize| columns[column].component.number(rows[column], number);
    let [x, y, z, w] = [0, 1, 2, 3].map(|number| f64::from(of(1, number)));
    let (rotation, norm) = activation::unit([w, x, y, z]);
    let mut splat = Splat {
        position: [0, 1, 2].map(|axis| of(0, axis)),
        scale: [0, 1, 2].map(|axis| match logarithmic {
            true => activation::exponential(of(2, axis)),
            false => of(2, axis),
        }),
        rotation,
        opacity: of(3, 0),
        sh: [0.0; 48],
    };
    for (number, value) in splat.sh.iter_mut().enumerate().take(3 * (columns.len() - 4)) {
        *value = of(4 + number / 3, number % 3);
    }
    (splat, norm)
}

/// Returns true if the scales of a file are logarithms: one of them is negative, in any mesh, even in a hidden one.
fn is_logarithmic(container: &Container) -> Result<bool, SceneError> {
    let name = format!("{SPLATTING}:SCALE");
    let indices = container.document.unpacked().filter_map(|primitive| primitive.attributes.get(&name));
    for index in indices.collect::<HashSet<_>>() {
        // The error of an unreadable column is that of the splats, if they are read at all.
        let Ok(scales) = Column::open(container, &name, *index, 3) else { continue };
        if has_negative(&scales)? {
            return Ok(true);
        }
    }
    Ok(false)
}

fn has_negative(scales: &Column) -> Result<bool, SceneError> {
    /// Number of rows that are read at a time.
    const ROWS: usize = 4096;
    let (table, count) = (scales.table, scales.count as usize);
    let mut buffer = vec![0; ROWS.min(count) * table.stride];
    for first in (0..count).step_by(ROWS) {
        let rows = ROWS.min(count - first);
        table.read(first, rows, &mut buffer)?;
        let mut rows = buffer.chunks_exact(table.stride).take(rows);
        if rows.any(|row| (0..3).any(|axis| scales.component.number(row, axis) < 0.0)) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Unpacks the SPZ file in a buffer view once, and places its splats as each of `group` does.
fn packed(
    input: &Input,
    container: &Container,
    view: usize,
    group: &[(usize, Splats)],
) -> Result<Vec<Scene>, SceneError> {
    let (source, _) = container.view(view)?;
    let scene = spz::parse(&Input { source: &source, ..*input })?;
    if group.len() == 1 && group[0].1.place == Similarity::IDENTITY {
        return Ok(vec![scene]);
    }
    // A place is in the axes of glTF, half a turn about z from those of a scene.
    let half = Similarity { rotation: DQuat::from_rotation_z(PI), ..Similarity::IDENTITY };
    let by = |place| if place == Similarity::IDENTITY { place } else { half.then(place).then(half) };
    let done = Done::new(group.len() as u64, input.progress)?;
    let placed = group.iter().map(|(_, splats)| {
        done.add(1)?;
        Ok(scene.transformed(&by(splats.place))?)
    });
    placed.collect()
}

/// Returns the header of each placed primitive. That of an SPZ file is read once.
fn headers(container: &Container, all: &[(usize, Splats)]) -> Result<Vec<SceneHeader>, SceneError> {
    let mut known = HashMap::new();
    let header = |(_, splats): &(usize, Splats)| match splats.spz.map(|view| (view, known.entry(view))) {
        None => Ok(splats_header(&container.document, splats)),
        Some((_, Entry::Occupied(known))) => Ok(*known.get()),
        Some((view, Entry::Vacant(unknown))) => Ok(*unknown.insert(spz::header(&container.view(view)?.0)?)),
    };
    all.iter().map(header).collect()
}

/// Parses the splats of a glTF file. `path` locates the buffers beside it.
pub(crate) fn parse(input: &Input, path: Option<&Path>) -> Result<Scene, SceneError> {
    let container = Container::open(input.source, path)?;
    let scene = scene(input, &container);
    container.check_unchanged().and(scene)
}

fn scene(input: &Input, container: &Container) -> Result<Scene, SceneError> {
    let (all, counts) = container.document.splats()?;
    // Several nodes can place one primitive, or one SPZ file, which is unpacked once.
    let mut all: Vec<_> = all.into_iter().enumerate().collect();
    all.sort_by_key(|(_, splats)| splats.spz);
    SceneHeader::check_joined(&headers(container, &all)?, 0, input.memory)?;
    let logarithmic = is_logarithmic(container)?;
    let (mut scenes, mut fields, mut measured) = (Vec::new(), Vec::new(), HashSet::new());
    for group in all.chunk_by(|(_, a), (_, b)| a.spz.is_some() && a.spz == b.spz) {
        let placed = match group[0].1.spz {
            Some(view) => packed(input, container, view, group)?,
            None => vec![plain(input, container, &group[0].1, logarithmic)?],
        };
        for ((at, splats), scene) in group.iter().zip(placed) {
            // Nodes with the same mesh share its bytes.
            if measured.insert(std::ptr::from_ref(splats.primitive)) {
                fields.extend(sizes(container, splats)?);
            }
            let notes = FileNotes { key_of: splats.key_of, ..scene.notes() };
            scenes.push((*at, scene.with_notes(notes)));
        }
    }
    scenes.sort_by_key(|(at, _)| *at);
    let scene = Scene::of_one_file(scenes.into_iter().map(|(_, scene)| scene).collect())?;
    let Container { file_bytes, header_bytes, encoding_bytes, .. } = container;
    let (file_bytes, header_bytes, encoding_bytes) = (*file_bytes, *header_bytes, *encoding_bytes);
    let within = file_bytes - header_bytes - encoding_bytes;
    // Values can share bytes. Then only their total is known.
    if fields.iter().map(|field| field.bytes).sum::<u64>() > within {
        fields = vec![FieldSize::whole("values", "buffer", within)];
    }
    if encoding_bytes > 0 {
        fields.push(FieldSize::whole("base 64", "text", encoding_bytes));
    }
    let rows = u64::from(scene.count()) + scene.dropped().total();
    let values = ElementSize::new("splats", rows, fields);
    let scales = if logarithmic { ", logarithms of scales" } else { "" };
    let format = format!("gltf, KHR_gaussian_splatting{scales}");
    let copyright = container.document.asset.copyright.iter().map(|owner| format!("copyright {owner}"));
    let breakdown =
        SizeBreakdown::new(format, file_bytes, header_bytes, vec![values]).with_comments(copyright.collect());
    let FileNotes { mesh_primitives, cameras, splats_elsewhere, .. } = counts;
    let notes = FileNotes { mesh_primitives, cameras, splats_elsewhere, ..scene.notes() };
    Ok(scene.with_notes(notes).with_breakdown(breakdown))
}
