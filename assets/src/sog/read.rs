//! Reads SOG: unpacks the textures, then converts the texels in parallel.

use super::archive::{Archive, Texture};
use super::meta::{Meta, Palette, wrong};
use crate::activation;
use crate::error::SceneError;
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::memory::SceneMemoryError;
use crate::scene::{FileNotes, Scene, Splat, sh_floats};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use std::f64::consts::FRAC_1_SQRT_2;

/// Size of a texel, in bytes.
const TEXEL: usize = 4;

/// Palette entries per row of its texture.
const ENTRIES_PER_ROW: u32 = 64;

/// Maximum splats per byte of a file: a splat has 20 bytes of texels, packed at most 1032-fold, the limit of gzip.
const MOST_PER_BYTE: u64 = 1032 / 20;

fn meta(archive: &mut Archive, length: u64) -> Result<Meta, SceneError> {
    let meta = Meta::parse(&archive.meta()?)?;
    let most = length.saturating_mul(MOST_PER_BYTE);
    if u64::from(meta.count) > most {
        return Err(wrong("count", &format!("at most {most}, which {length} bytes can hold"), meta.count));
    }
    Ok(meta)
}

/// Reads the splats' description in `meta.json`.
pub(crate) fn header(source: &Source) -> Result<SceneHeader, SceneError> {
    let meta = meta(&mut Archive::open(source)?, source.length())?;
    Ok(SceneHeader { count: meta.count.into(), stored_degree: meta.degree() })
}

/// The palette of harmonics.
struct Entries {
    coefficients: usize,
    count: usize,
    texture: Texture,
    codebook: Vec<f32>,
}

impl Entries {
    fn read(archive: &mut Archive, palette: &Palette) -> Result<Self, SceneError> {
        let coefficients = sh_floats(palette.bands) / 3 - 1;
        let (width, height) =
            (u64::from(ENTRIES_PER_ROW) * coefficients as u64, palette.count.div_ceil(ENTRIES_PER_ROW));
        let texture = archive.texture(&palette.files[0], |found, rows| {
            let fits = found == width && (u64::from(height)..=u64::from(height) + 4).contains(&rows);
            (!fits).then(|| format!("expected {width} x {height} texels for {} entries", palette.count))
        })?;
        let codebook = palette.codebook.clone();
        Ok(Self { coefficients, count: palette.count as usize, texture, codebook })
    }

    /// Sets the harmonics above band 0. A label beyond the palette gives NaN.
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

/// Parses a scene.
pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    let length = input.source.length();
    let mut archive = Archive::open(input.source)?;
    let meta = meta(&mut archive, length)?;
    let (count, degree) = (u64::from(meta.count), meta.degree());
    let labels = meta.sh_n.as_ref().map(|palette| palette.files[1].as_str());
    let names = [
        Some(meta.means.files[0].as_str()),
        Some(meta.means.files[1].as_str()),
        Some(meta.scales.files[0].as_str()),
        Some(meta.quats.files[0].as_str()),
        Some(meta.sh0.files[0].as_str()),
        labels,
    ];
    let bytes = count * (TEXEL * names.iter().flatten().count()) as u64;
    // One more texture while it is unpacked.
    let beside = bytes + 2 * count * TEXEL as u64;
    let needed = Scene::host_bytes(count, degree).saturating_add(beside);
    SceneMemoryError::check_against(count, degree, needed, input.memory)?;
    let done = Done::new(2 * bytes, input.progress)?;
    let mut data = Vec::new();
    let mut tables = [Table { start: 0, stride: 0 }; 6];
    for (table, name) in tables.iter_mut().zip(names) {
        let Some(name) = name else { continue };
        *table = Table { start: data.len() as u64, stride: TEXEL };
        let texels = archive.texels(name, count)?.texels;
        let rows = &texels[..count as usize * TEXEL];
        data.try_reserve(rows.len()).map_err(std::io::Error::from)?;
        data.extend_from_slice(rows);
        done.add(rows.len() as u64)?;
    }
    let entries = meta.sh_n.as_ref().map(|palette| Entries::read(&mut archive, palette)).transpose()?;
    let packed = archive.packed_bytes()?;

    let mut columns = input.allocate(count, degree, false, (6 * TEXEL, bytes))?;
    let gathered = input::fill(&Source::Bytes(&data), tables, &mut columns, &done, |rows, _, out| {
        let (splat, norm) = splat(rows, &meta, entries.as_ref());
        out.push(&splat, norm);
    })?;
    let field = |(name, bytes): (String, u64)| FieldSize {
        name,
        kind: "file".into(),
        bytes_per_row: None,
        bytes,
        used: true,
    };
    let size_breakdown = SizeBreakdown {
        format: "sog, version 2".into(),
        file_bytes: length,
        header_bytes: length - packed,
        elements: vec![ElementSize {
            name: "splats".into(),
            rows: count,
            bytes: packed,
            fields: archive.sizes.into_iter().map(field).collect(),
            separator_bytes: 0,
        }],
        trailing_bytes: 0,
    };
    let notes = FileNotes { low_pass: meta.filter(), ..FileNotes::default() };
    input::finish((columns, gathered), count, size_breakdown, notes)
}

/// Converts a splat; also returns the length of its quaternion.
fn splat(
    [low, high, scale, quat, color, label]: [&[u8]; 6],
    meta: &Meta,
    entries: Option<&Entries>,
) -> (Splat, f64) {
    let (rotation, norm) = activation::unit(quaternion(quat));
    let mut splat = Splat {
        position: std::array::from_fn(|axis| {
            let part = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / 65_535.0;
            let value = meta.means.mins[axis] * (1.0 - part) + meta.means.maxs[axis] * part;
            (value.signum() * value.abs().exp_m1()) as f32
        }),
        scale: std::array::from_fn(|axis| {
            activation::exponential(meta.scales.codebook[usize::from(scale[axis])])
        }),
        rotation,
        opacity: (f64::from(color[3]) / 255.0) as f32,
        sh: [0.0; 48],
    };
    for (value, code) in splat.sh.iter_mut().zip(&color[..3]) {
        *value = meta.sh0.codebook[usize::from(*code)];
    }
    if let Some(entries) = entries {
        entries.apply(usize::from(u16::from_le_bytes([label[0], label[1]])), &mut splat.sh);
    }
    (splat, norm)
}

/// Unpacks w, x, y, z. An invalid component index in alpha gives the zero rotation, as in PlayCanvas's reader.
fn quaternion(texel: &[u8]) -> [f64; 4] {
    let Some(largest) = texel[3].checked_sub(252) else { return [1.0, 0.0, 0.0, 0.0] };
    let others = [0, 1, 2].map(|at| (f64::from(texel[at]) / 255.0 * 2.0 - 1.0) * FRAC_1_SQRT_2);
    activation::with_omitted(largest.into(), others)
}
