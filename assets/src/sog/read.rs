//! Reads SOG: unpacks the textures, then converts the texels in parallel.

use super::container::{Container, Texture};
use super::meta::{Meta, Palette, unexpected};
use crate::activation;
use crate::error::SceneError;
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::memory::SceneMemoryError;
use crate::ply::origin::origin;
use crate::scene::{FileNotes, Scene, Splat, sh_floats};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use std::f64::consts::FRAC_1_SQRT_2;
use std::ops::Range;
use std::path::Path;

const TEXEL: usize = 4;

const ENTRIES_PER_ROW: u32 = 64;

/// Memory limit of a file of equal splats if the available memory is unknown. A few kB can encode hundreds of millions
/// of equal splats.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// Maximum number of splats per byte of a file, unless the splats are equal. A splat has 20 bytes of texels, compressed
/// 1032 to 1.
const MAX_PER_BYTE: u64 = 1032 / 20;

/// Maximum number of splats: the texels of the largest lossless WebP image.
const MAX_COUNT: u32 = 16_384 * 16_384;

fn meta(files: &mut Container) -> Result<Meta, SceneError> {
    let meta = Meta::parse(&files.meta()?)?;
    if meta.count > MAX_COUNT {
        return Err(unexpected(
            "count",
            &format!("at most {MAX_COUNT}, the texels of the largest WebP"),
            meta.count,
        ));
    }
    Ok(meta)
}

/// Reads the header from `meta.json`; in version 1, also from the palette's texture.
pub(super) fn header(source: &Source, folder: Option<&Path>) -> Result<SceneHeader, SceneError> {
    let mut files = Container::open(source, folder)?;
    let meta = meta(&mut files)?;
    let stored_degree = match &meta.palette {
        None => 0,
        Some(Palette { size: Some((_, bands)), .. }) => *bands,
        // In version 1, the width of the texture determines the degree.
        Some(palette) => Entries::read(&mut files, palette)?.bands,
    };
    Ok(SceneHeader { count: meta.count.into(), stored_degree })
}

struct Entries<'a> {
    bands: u32,
    coefficients: usize,
    count: usize,
    texture: Texture,
    codebook: &'a [f32],
}

/// Returns the number of coefficients per channel above band 0.
fn coefficients(bands: u32) -> u32 {
    (sh_floats(bands) / 3 - 1) as u32
}

impl<'a> Entries<'a> {
    fn read(files: &mut Container, palette: &'a Palette) -> Result<Self, SceneError> {
        let width = |bands: u32| u64::from(ENTRIES_PER_ROW * coefficients(bands));
        let most_rows = u64::from(super::meta::MAX_ENTRIES / ENTRIES_PER_ROW);
        let texture = files.texture(&palette.files[0], most_rows * width(3), |found, rows| {
            if let Some((count, bands)) = palette.size {
                let (width, height) = (width(bands), u64::from(count.div_ceil(ENTRIES_PER_ROW)));
                let fits = found == width && (height..=height + 4).contains(&rows);
                return (!fits).then(|| format!("expected {width} x {height} texels for {count} entries"));
            }
            let fits = (1..=3).any(|bands| width(bands) == found) && rows <= most_rows + 4;
            (!fits).then(|| format!("expected 192, 512 or 960 x at most {most_rows} texels"))
        })?;
        let by_width = || (1..3).find(|bands| width(*bands) == u64::from(texture.width)).unwrap_or(3);
        let (count, bands) = palette.size.unwrap_or_else(|| (ENTRIES_PER_ROW * texture.height, by_width()));
        let coefficients = coefficients(bands) as usize;
        Ok(Self { bands, coefficients, count: count as usize, texture, codebook: &palette.codebook })
    }

    /// Sets the harmonics above band 0. A label beyond the palette gives NaN, so that the splat is dropped.
    fn apply(&self, label: usize, sh: &mut [f32; 48]) {
        let row = label / ENTRIES_PER_ROW as usize;
        let first = row * self.texture.width as usize + label % ENTRIES_PER_ROW as usize * self.coefficients;
        for (k, values) in sh[3..].chunks_exact_mut(3).take(self.coefficients).enumerate() {
            let texel = &self.texture.texels[if label < self.count { (first + k) * TEXEL } else { 0 }..];
            for (value, code) in values.iter_mut().zip(texel) {
                *value = if label < self.count { self.codebook[usize::from(*code)] } else { f32::NAN };
            }
        }
    }
}

/// Parses all splats, or those in `runs`, which do not overlap. `folder` is the folder of a `meta.json`.
pub(super) fn parse(
    input: &Input,
    folder: Option<&Path>,
    runs: Option<&[Range<u64>]>,
) -> Result<Scene, SceneError> {
    let mut files = Container::open(input.source, folder)?;
    let meta = meta(&mut files)?;
    let all = u64::from(meta.count);
    let whole = 0..all;
    let runs = runs.unwrap_or(std::slice::from_ref(&whole));
    if let Some(beyond) = runs.iter().find(|run| run.end > all) {
        return Err(unexpected(
            "count",
            &format!("at least {}, the end of a run of splats", beyond.end),
            all,
        ));
    }
    let count: u64 = runs.iter().map(|run| run.end - run.start).sum();
    let palette = meta.palette.as_ref();
    // The degree of version 1 is unknown until its palette is read, so the highest is assumed.
    let degree = palette.map_or(0, |palette| palette.size.map_or(3, |(_, bands)| bands));
    let names = meta.textures();
    let bytes = count * (TEXEL * names.iter().flatten().count()) as u64;
    // While a texture is unpacked, up to two whole copies of it exist beside the texels kept.
    let beside = bytes + 2 * all * TEXEL as u64;
    let needed = Scene::host_bytes(count, degree).saturating_add(beside);
    let file_bytes = files.bytes_of(names.iter().flatten().copied());
    let are_equal = count > file_bytes.saturating_mul(MAX_PER_BYTE);
    let available = input.memory.or(are_equal.then_some(UNKNOWN_MEMORY));
    SceneMemoryError::check_against(count, degree, needed, available)?;
    let done = Done::new(2 * bytes, input.progress)?;
    let entries = palette.map(|palette| Entries::read(&mut files, palette)).transpose()?;
    let mut textures: [Vec<u8>; 6] = Default::default();
    for (kept, name) in textures.iter_mut().zip(names) {
        let Some(name) = name else { continue };
        let texels = files.texels(name, all)?.texels;
        kept.try_reserve_exact(count as usize * TEXEL).map_err(std::io::Error::from)?;
        for run in runs {
            kept.extend_from_slice(&texels[run.start as usize * TEXEL..run.end as usize * TEXEL]);
        }
        done.add(count * TEXEL as u64)?;
    }
    let (packed, file_bytes) = files.packed_bytes()?;

    let degree = entries.as_ref().map_or(0, |entries| entries.bands);
    let is_wide = meta.means.is_wide();
    let position = |row: usize| {
        let [low, high] = [0, 1].map(|at: usize| &textures[at][row * TEXEL..][..TEXEL]);
        meta.means.position(low, high)
    };
    let origin = if is_wide { origin(count, position) } else { [0.0; 3] };
    let tables = textures.each_ref().map(|texels| match texels.is_empty() {
        true => Table::NONE,
        false => Table::new(Source::Bytes(texels), 0, TEXEL),
    });
    let filled = input.fill((count, degree, is_wide), tables, bytes, &done, |rows, _, out| {
        let (mut splat, norm) = splat(rows, &meta, entries.as_ref());
        let world = meta.means.position(rows[0], rows[1]);
        let position = std::array::from_fn(|axis| world[axis] - origin[axis]);
        splat.position = position.map(|v| v as f32);
        out.push_wide(&splat, position, norm);
    })?;
    let format = format!("sog, version {}{}", meta.version, files.kind());
    let fields = files.sizes.into_iter().map(|(name, bytes)| FieldSize::whole(name, "file", bytes));
    let textures = ElementSize::new("splats", count, fields.collect());
    let size_breakdown = SizeBreakdown {
        is_whole_sog: true,
        ..SizeBreakdown::new(format, file_bytes, file_bytes - packed, vec![textures])
    };
    let notes = FileNotes { low_pass: meta.filter, ..FileNotes::default() };
    Ok(input::finish(filled, count, size_breakdown, notes)?.with_offset(origin))
}

/// Converts a splat without its position; also returns the length of the file's quaternion.
fn splat(
    [_, _, scale, quat, color, label]: [&[u8]; 6],
    meta: &Meta,
    entries: Option<&Entries>,
) -> (Splat, f64) {
    let (rotation, norm) = activation::unit(quaternion(quat));
    let coded = |tables: &[Vec<f32>; 3], axis: usize, texel: &[u8]| tables[axis][usize::from(texel[axis])];
    let mut splat = Splat {
        position: [0.0; 3],
        scale: std::array::from_fn(|axis| activation::exponential(coded(&meta.scales.tables, axis, scale))),
        rotation,
        opacity: meta.opacities[usize::from(color[3])],
        sh: [0.0; 48],
    };
    for (channel, value) in splat.sh.iter_mut().take(3).enumerate() {
        *value = coded(&meta.colors.tables, channel, color);
    }
    if let Some(entries) = entries {
        entries.apply(usize::from(u16::from_le_bytes([label[0], label[1]])), &mut splat.sh);
    }
    (splat, norm)
}

/// Unpacks w, x, y, z. An invalid component index in alpha gives the identity, as in PlayCanvas's reader.
fn quaternion(texel: &[u8]) -> [f64; 4] {
    let Some(largest) = texel[3].checked_sub(252) else { return [1.0, 0.0, 0.0, 0.0] };
    let others = [0, 1, 2].map(|at| (f64::from(texel[at]) / 255.0 * 2.0 - 1.0) * FRAC_1_SQRT_2);
    activation::with_omitted(largest.into(), others)
}
