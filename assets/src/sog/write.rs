//! Writes SOG version 2: splats in Morton order, textures as lossless WebP, stored in a ZIP archive.

use super::codebook::{Codebook, MIN_WEIGHT};
use super::meta::{MAX_ENTRIES, Means, compressed};
use super::palette::{Points, palette};
use crate::activation::{logarithm, omit_largest, quantised};
use crate::input::Progress;
use crate::memory::{self, SceneMemoryError};
use crate::scene::{Scene, sh_floats};
use crate::words::CHUNK;
use image_webp::{ColorType, WebPEncoder};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::f64::consts::FRAC_1_SQRT_2;
use std::io::{Cursor, Error, ErrorKind, Result, Write};
use std::ops::ControlFlow;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

const ENTRIES_PER_ROW: usize = 64;

/// Maximum width and height of a picture in libwebp, in pixels: one less than in the lossless format.
const MAX_SIDE: usize = 16_383;

/// Largest weight of a splat in codebooks, so that no sum of squares overflows.
const MAX_WEIGHT: f32 = 1e12;

/// Estimates the memory that writing a scene needs in addition to the scene itself, in bytes.
fn beside(count: u64, degree: u32) -> u64 {
    /// Bytes per splat: 96 while a codebook is chosen, the order, and textures.
    const SPLAT: u64 = 128;
    /// Bytes per splat while the palette is chosen: the order, the labels and textures.
    const LABELLED: u64 = 48;
    /// Bytes per coefficient of the palette: itself, the mean of its group, and 32 while the codebook is chosen.
    const COEFFICIENT: u64 = 44;
    const BUFFERS: u64 = 64 << 20;
    let coefficients = entries(count as usize) * (sh_floats(degree) - 3);
    BUFFERS + (count * SPLAT).max(count * LABELLED + coefficients as u64 * COEFFICIENT)
}

type Texel = [u8; 4];

/// Returns the maximum number of palette entries for `count` splats, as in PlayCanvas's writer.
fn entries(count: usize) -> usize {
    let thousands = (count / 1024).max(1).ilog2().min(6);
    ((1 << thousands) * 1024).min(count).min(MAX_ENTRIES as usize)
}

struct Files {
    zip: ZipWriter<Cursor<Vec<u8>>>,
}

impl Files {
    fn add(&mut self, name: &str, bytes: &[u8]) -> Result<()> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        self.zip.start_file(name, options).map_err(Error::other)?;
        self.zip.write_all(bytes)
    }

    /// Adds a texture of `width` texels per row, and pads the last row. Fails if a side exceeds [`MAX_SIDE`].
    fn texture(&mut self, name: &str, width: usize, mut texels: Vec<Texel>) -> Result<()> {
        let height = texels.len().div_ceil(width);
        if width.max(height) > MAX_SIDE {
            let text = format!(
                "expected splats for textures of at most {MAX_SIDE} x {MAX_SIDE}, found {width} x {height}"
            );
            return Err(Error::new(ErrorKind::InvalidInput, text));
        }
        texels.resize(width * height, [0, 0, 0, 255]);
        let mut bytes = Vec::new();
        let encoder = WebPEncoder::new(&mut bytes);
        encoder
            .encode(texels.as_flattened(), width as u32, height as u32, ColorType::Rgba8)
            .map_err(Error::other)?;
        self.add(name, &bytes)
    }
}

/// Returns for each axis the minimum and the maximum of the compressed coordinates.
fn ends(scene: &Scene) -> [(f64, f64); 3] {
    let none = || [(f64::INFINITY, f64::NEG_INFINITY); 3];
    let wider = |a: [(f64, f64); 3], b: [(f64, f64); 3]| {
        std::array::from_fn(|axis| (a[axis].0.min(b[axis].0), a[axis].1.max(b[axis].1)))
    };
    let indices = (0..scene.count() as usize).into_par_iter().with_min_len(CHUNK);
    indices.map(|index| scene.world_position(index).map(compressed).map(|v| (v, v))).reduce(none, wider)
}

/// Returns a function that computes the largest rounding step of a splat's coordinates, in world units, from the
/// splat's index.
pub(crate) fn position_steps(scene: &Scene) -> impl Fn(usize) -> f64 + Sync {
    let steps = ends(scene).map(|(min, max)| (max - min) / Means::STEPS);
    move |index| {
        let position = scene.world_position(index);
        // The derivative of the compression's inverse is 1 + |v|.
        (0..3).map(|axis| steps[axis] * (1.0 + position[axis].abs())).fold(0.0, f64::max)
    }
}

fn rotation(quaternion: [f32; 4]) -> Texel {
    let (largest, others) = omit_largest(quaternion);
    let [a, b, c] = others.map(|value| quantised(value * FRAC_1_SQRT_2 + 0.5, 255) as u8);
    [a, b, c, 252 + largest as u8]
}

/// Writes a scene of at least one splat. `progress` gets the share done, in percent.
pub(crate) fn write(scene: &Scene, progress: Progress, out: &mut impl Write) -> Result<()> {
    let (count, degree) = (scene.count(), scene.stored_degree());
    let needed = beside(count.into(), degree);
    SceneMemoryError::check_against(count.into(), degree, needed, memory::available())
        .map_err(Error::other)?;
    let tell = |percent: u64| match progress(percent, 100) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::new(ErrorKind::Interrupted, "the writing was cancelled")),
    };
    // Share of the progress, in percent, before the palette is searched.
    let before_palette: u64 = if degree > 0 { 20 } else { 100 };
    tell(0)?;
    let order = scene.morton_order();
    let width = ((order.len() as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4;
    let mut files = Files { zip: ZipWriter::new(Cursor::new(Vec::new())) };

    let ends = ends(scene);
    let steps = |at: usize| -> [[u8; 2]; 3] {
        let position = scene.world_position(at);
        std::array::from_fn(|axis| {
            let (min, max) = ends[axis];
            let share = if max > min { (compressed(position[axis]) - min) / (max - min) } else { 0.0 };
            (quantised(share, Means::STEPS as u32) as u16).to_le_bytes()
        })
    };
    for (byte, name) in ["means_l.webp", "means_u.webp"].into_iter().enumerate() {
        let texel = |at: &u32| {
            let [x, y, z] = steps(*at as usize);
            [x[byte], y[byte], z[byte], 255]
        };
        files.texture(name, width, order.iter().map(texel).collect())?;
    }
    tell(before_palette / 4)?;

    let scales = |at: u32| scene.scales()[at as usize].map(logarithm);
    // The visibility of a splat's error is proportional to its opacity and its extent.
    let weight = |at: u32| {
        let mut axes = scene.scales()[at as usize];
        axes.sort_unstable_by(f32::total_cmp);
        ((axes[1] * axes[2]).sqrt() * scene.opacities()[at as usize]).clamp(MIN_WEIGHT, MAX_WEIGHT)
    };
    let weighted = order.iter().flat_map(|at| scales(*at).map(|number| (number, weight(*at))));
    let scale_codes = Codebook::of(weighted.collect());
    let texel = |at: &u32| {
        let [x, y, z] = scales(*at).map(|value| scale_codes.nearest(value));
        [x, y, z, 255]
    };
    files.texture("scales.webp", width, order.iter().map(texel).collect())?;
    let texel = |at: &u32| rotation(scene.rotations()[*at as usize]);
    files.texture("quats.webp", width, order.iter().map(texel).collect())?;
    tell(before_palette / 2)?;

    let floats = sh_floats(degree);
    let color =
        |at: u32| -> [f32; 3] { std::array::from_fn(|channel| scene.sh()[at as usize * floats + channel]) };
    let weighted = order.iter().flat_map(|at| color(*at).map(|number| (number, weight(*at))));
    let color_codes = Codebook::of(weighted.collect());
    let texel = |at: &u32| {
        let [r, g, b] = color(*at).map(|value| color_codes.nearest(value));
        [r, g, b, quantised(scene.opacities()[*at as usize].into(), 255) as u8]
    };
    files.texture("sh0.webp", width, order.iter().map(texel).collect())?;
    tell(before_palette)?;

    let mut meta = json!({
        "version": 2,
        "asset": { "generator": "splatgraph" },
        "count": count,
        "means": { "mins": ends.map(|(min, _)| min), "maxs": ends.map(|(_, max)| max), "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scale_codes.codes, "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": color_codes.codes, "files": ["sh0.webp"] },
    });
    if scene.notes().is_antialiased() {
        meta["antialias"] = Value::Bool(true);
        meta["model"] = json!("antialiased");
    }
    if degree > 0 {
        let rest = floats - 3;
        let points = Points { values: scene.sh(), stride: floats, first: 3, width: rest };
        let entries = entries(order.len());
        // Each round adds up to a third more entries, and takes about as long as the one before.
        let share = |chosen: usize| (chosen as f64).ln() / (entries as f64).ln().max(1.0);
        let left = (100 - before_palette) as f64;
        let tell = |chosen: usize| tell(before_palette + (left * share(chosen)) as u64);
        let found = palette(&points, order.clone(), entries, tell)?;
        let label = |at: u32| found.labels[at as usize];
        let mut weights = vec![0.0; found.entries.len() / rest];
        for at in &order {
            weights[label(*at) as usize] += weight(*at);
        }
        let mut weighted = Vec::with_capacity(found.entries.len());
        for (entry, weight) in found.entries.chunks_exact(rest).zip(weights) {
            weighted.extend(entry.iter().map(|number| (*number, weight)));
        }
        let codes = Codebook::of(weighted);
        let coefficients = rest / 3;
        let count = found.entries.len() / rest;
        // A row of the texture has the coefficients of 64 entries, one after the other.
        let texels = found.entries.chunks_exact(3).map(|rgb| {
            let [r, g, b] = [0, 1, 2].map(|channel| codes.nearest(rgb[channel]));
            [r, g, b, 255]
        });
        files.texture("shN_centroids.webp", ENTRIES_PER_ROW * coefficients, texels.collect())?;
        let texel = |at: &u32| {
            let [low, high] = (label(*at) as u16).to_le_bytes();
            [low, high, 0, 255]
        };
        files.texture("shN_labels.webp", width, order.iter().map(texel).collect())?;
        meta["shN"] = json!({
            "count": count, "bands": degree, "codebook": codes.codes,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        });
    }
    files.add("meta.json", meta.to_string().as_bytes())?;
    out.write_all(&files.zip.finish().map_err(Error::other)?.into_inner())
}
