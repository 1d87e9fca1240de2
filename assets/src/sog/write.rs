//! Writes SOG version 2: splats in Morton order, textures as lossless WebP, stored in a ZIP archive.

use super::codebook::Codebook;
use super::meta::MAX_ENTRIES;
use super::palette::palette;
use crate::activation::{logarithm, omit_largest, quantised};
use crate::input::Progress;
use crate::scene::{Scene, sh_floats};
use image_webp::{ColorType, WebPEncoder};
use serde_json::{Value, json};
use std::f64::consts::FRAC_1_SQRT_2;
use std::io::{Cursor, Error, ErrorKind, Result, Write};
use std::ops::ControlFlow;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

const ENTRIES_PER_ROW: usize = 64;

/// Maximum width and height of a picture in libwebp, in pixels: one less than in the lossless format.
const MAX_SIDE: usize = 16_383;

/// Bounds of the weights of splats in codebooks: no weight is 0, and no sum of squares overflows.
const MIN_WEIGHT: f32 = 1e-12;
const MAX_WEIGHT: f32 = 1e12;

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

    /// Adds a texture of `width` texels per row, and pads the last row.
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

/// Compresses a coordinate logarithmically: its resolution decreases with the distance from 0.
fn compressed(value: f64) -> f64 {
    value.signum() * value.abs().ln_1p()
}

fn rotation(quaternion: [f32; 4]) -> Texel {
    let (largest, others) = omit_largest(quaternion);
    let [a, b, c] = others.map(|value| quantised(value * FRAC_1_SQRT_2 + 0.5, 255) as u8);
    [a, b, c, 252 + largest as u8]
}

/// Writes a scene of at least one splat. `progress` gets the number of palette entries found so far, and their total.
pub(crate) fn write(scene: &Scene, progress: Progress, out: &mut impl Write) -> Result<()> {
    let order: Vec<usize> = scene.morton_order().into_iter().map(|index| index as usize).collect();
    let width = ((order.len() as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4;
    let mut files = Files { zip: ZipWriter::new(Cursor::new(Vec::new())) };

    let positions: Vec<[f64; 3]> = order.iter().map(|at| scene.world_position(*at).map(compressed)).collect();
    let ends = |axis: usize| {
        let values = positions.iter().map(|position| position[axis]);
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| (min.min(value), max.max(value)))
    };
    let ends = [0, 1, 2].map(ends);
    let steps = |position: &[f64; 3]| -> [[u8; 2]; 3] {
        std::array::from_fn(|axis| {
            let (min, max) = ends[axis];
            let share = if max > min { (position[axis] - min) / (max - min) } else { 0.0 };
            (quantised(share, 65_535) as u16).to_le_bytes()
        })
    };
    for (byte, name) in ["means_l.webp", "means_u.webp"].into_iter().enumerate() {
        let texel = |position: &[f64; 3]| {
            let [x, y, z] = steps(position);
            [x[byte], y[byte], z[byte], 255]
        };
        files.texture(name, width, positions.iter().map(texel).collect())?;
    }

    let scales = |at: usize| scene.scales()[at].map(logarithm);
    // The visibility of a splat's error is proportional to its opacity and its extent.
    let weight = |at: usize| {
        let mut axes = scene.scales()[at];
        axes.sort_unstable_by(f32::total_cmp);
        ((axes[1] * axes[2]).sqrt() * scene.opacities()[at]).clamp(MIN_WEIGHT, MAX_WEIGHT)
    };
    let weighted = order.iter().flat_map(|at| scales(*at).map(|number| (number, weight(*at))));
    let scale_codes = Codebook::of(weighted.collect());
    let texel = |at: &usize| {
        let [x, y, z] = scales(*at).map(|value| scale_codes.nearest(value));
        [x, y, z, 255]
    };
    files.texture("scales.webp", width, order.iter().map(texel).collect())?;
    files.texture("quats.webp", width, order.iter().map(|at| rotation(scene.rotations()[*at])).collect())?;

    let floats = sh_floats(scene.stored_degree());
    let harmonics = |at: usize| &scene.sh()[at * floats..][..floats];
    let weighted = order.iter().flat_map(|at| {
        let weight = weight(*at);
        harmonics(*at)[..3].iter().map(move |number| (*number, weight))
    });
    let color_codes = Codebook::of(weighted.collect());
    let texel = |at: &usize| {
        let color = &harmonics(*at)[..3];
        let [r, g, b] = [0, 1, 2].map(|channel| color_codes.nearest(color[channel]));
        [r, g, b, quantised(scene.opacities()[*at].into(), 255) as u8]
    };
    files.texture("sh0.webp", width, order.iter().map(texel).collect())?;

    let mut meta = json!({
        "version": 2,
        "asset": { "generator": "splatgraph" },
        "count": order.len(),
        "means": { "mins": ends.map(|(min, _)| min), "maxs": ends.map(|(_, max)| max), "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scale_codes.codes, "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": color_codes.codes, "files": ["sh0.webp"] },
    });
    if scene.notes().is_antialiased() {
        meta["antialias"] = Value::Bool(true);
        meta["model"] = json!("antialiased");
    }
    if scene.stored_degree() > 0 {
        let rest = floats - 3;
        let points: Vec<f32> = order.iter().flat_map(|at| &harmonics(*at)[3..]).copied().collect();
        let entries = entries(order.len());
        let tell = |chosen: usize| match progress(chosen as u64, entries as u64) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Error::new(ErrorKind::Interrupted, "the writing was cancelled")),
        };
        let found = palette(&points, rest, entries, tell)?;
        let mut weights = vec![0.0; found.entries.len() / rest];
        for (at, label) in order.iter().zip(&found.labels) {
            weights[*label as usize] += weight(*at);
        }
        let weighted = found.entries.chunks_exact(rest).zip(weights);
        let weighted = weighted.flat_map(|(entry, weight)| entry.iter().map(move |number| (*number, weight)));
        let codes = Codebook::of(weighted.collect());
        let coefficients = rest / 3;
        let count = found.entries.len() / rest;
        // A row of the texture has the coefficients of 64 entries, one after the other.
        let texels = found.entries.chunks_exact(3).map(|rgb| {
            let [r, g, b] = [0, 1, 2].map(|channel| codes.nearest(rgb[channel]));
            [r, g, b, 255]
        });
        files.texture("shN_centroids.webp", ENTRIES_PER_ROW * coefficients, texels.collect())?;
        let texel = |label: &u32| {
            let [low, high] = (*label as u16).to_le_bytes();
            [low, high, 0, 255]
        };
        files.texture("shN_labels.webp", width, found.labels.iter().map(texel).collect())?;
        meta["shN"] = json!({
            "count": count, "bands": scene.stored_degree(), "codebook": codes.codes,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        });
    }
    files.add("meta.json", meta.to_string().as_bytes())?;
    out.write_all(&files.zip.finish().map_err(Error::other)?.into_inner())
}
