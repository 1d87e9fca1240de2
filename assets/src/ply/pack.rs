//! Writes PlayCanvas's compressed PLY layout; [`super::packed`] describes it.
//!
//! Splats are written in Morton order, so that the 256 splats of a chunk are neighbours and their bounds are tight.
//! The chunk that outliers share with other splats gets the least visible ones.

use super::packed::{CHUNK, CHUNK_SPLATS, VERTEX};
use super::tags;
use crate::activation::{SH_C0, logarithm, omit_largest, quantised};
use crate::bounds::largest;
use crate::scene::{Scene, sh_floats};
use crate::words::write_rows;
use glam::DVec3;
use std::f64::consts::SQRT_2;
use std::io::{Result, Write};

/// Maximum absolute value of a scale's logarithm, as in the reference writer.
const SCALE_LIMIT: f64 = 20.0;

/// Numbers of steps of x, y and z: 11, 10 and 11 bits.
const POSITION_STEPS: DVec3 = DVec3::new(2047.0, 1023.0, 2047.0);

/// The values of a splat that are stored relative to bounds: position, logarithms of the scale, and colour.
type Ranged = [f64; 9];

fn header(count: usize, degree: u32, comments: &str) -> String {
    let lines = |kind: &str, names: &mut dyn Iterator<Item = String>| -> String {
        names.map(|name| format!("property {kind} {name}\n")).collect()
    };
    let chunks = count.div_ceil(CHUNK_SPLATS);
    let chunk = lines("float", &mut CHUNK.iter().map(|name| (*name).to_owned()));
    let vertex = lines("uint", &mut VERTEX.iter().map(|name| (*name).to_owned()));
    let rest = lines("uchar", &mut (0..sh_floats(degree) - 3).map(|index| format!("f_rest_{index}")));
    let sh = if degree > 0 { format!("element sh {count}\n{rest}") } else { String::new() };
    format!(
        "ply\nformat binary_little_endian 1.0\n{comments}element chunk {chunks}\n{chunk}element vertex {count}\n{vertex}{sh}end_header\n"
    )
}

fn ranged(scene: &Scene, index: usize) -> Ranged {
    let splat = scene.splat(index);
    let scale = splat.scale.map(|s| f64::from(logarithm(s)).clamp(-SCALE_LIMIT, SCALE_LIMIT));
    let color: [f64; 3] = std::array::from_fn(|c| f64::from(splat.sh[c]) * SH_C0 + 0.5);
    let position = scene.world_position(index);
    std::array::from_fn(|k| [position, scale, color][k / 3][k % 3])
}

/// Sorts the splats into chunks, and returns their indices.
fn chunk_order(scene: &Scene) -> Vec<u32> {
    let mut order = scene.morton_order();
    let inner = order.partition_point(|index| !scene.is_outlier(*index));
    if (CHUNK_SPLATS..order.len()).contains(&inner) {
        // Small splats are drawn as large as a pixel, whose size is unknown here.
        let least = scene.median_size();
        let visible = |index: u32| {
            let size = largest(scene.scales()[index as usize]).max(least);
            // The bits of floats that are not negative sort like the floats.
            ((scene.opacities()[index as usize] * size * size).to_bits(), index)
        };
        let mut sorted: Vec<_> = order[..inner].iter().map(|index| visible(*index)).collect();
        let (_, &mut limit, _) = sorted.select_nth_unstable(inner % CHUNK_SPLATS);
        order[..inner].sort_by_key(|index| visible(*index) < limit);
    }
    order
}

/// Returns for each splat the largest quantisation step of its coordinates, in world units.
pub(crate) fn position_steps(scene: &Scene) -> Vec<f32> {
    let mut steps = vec![0.0; scene.count() as usize];
    for chunk in chunk_order(scene).chunks(CHUNK_SPLATS) {
        let positions = || chunk.iter().map(|index| DVec3::from(scene.world_position(*index as usize)));
        let (min, max) = (positions().reduce(DVec3::min), positions().reduce(DVec3::max));
        let range = max.unwrap_or_default() - min.unwrap_or_default();
        let step = (range / POSITION_STEPS).max_element() as f32;
        chunk.iter().for_each(|index| steps[*index as usize] = step);
    }
    steps
}

/// Packs three values from 0 to 1 into 11, 10 and 11 bits.
fn pack(t: &[f64]) -> u32 {
    quantised(t[0], 2047) << 21 | quantised(t[1], 1023) << 11 | quantised(t[2], 2047)
}

fn rotation(quaternion: [f32; 4]) -> u32 {
    let (largest, others) = omit_largest(quaternion);
    others.iter().fold(largest as u32, |word, value| word << 10 | quantised(value / SQRT_2 + 0.5, 1023))
}

fn harmonic(value: f32) -> u8 {
    ((f64::from(value) / 8.0 + 0.5) * 256.0).trunc().clamp(0.0, 255.0) as u8
}

/// Writes a scene as compressed PLY.
pub(crate) fn write(scene: &Scene, out: &mut impl Write) -> Result<()> {
    let degree = scene.stored_degree();
    out.write_all(header(scene.count() as usize, degree, &tags::comments(scene)).as_bytes())?;
    let order = chunk_order(scene);
    // Splats are buffered, because the bounds of all chunks precede the first splat in the file.
    let mut vertices = Vec::new();
    vertices.try_reserve_exact(order.len() * 16)?;
    for chunk in order.chunks(CHUNK_SPLATS) {
        let values: Vec<Ranged> = chunk.iter().map(|index| ranged(scene, *index as usize)).collect();
        // The reader gets the bounds as f32, so values are quantised between the rounded bounds.
        let bound = |k: usize, pick: fn(f64, f64) -> f64| {
            let values = values.iter().map(|v| v[k]);
            values.reduce(pick).unwrap_or(0.0) as f32
        };
        let min: [f32; 9] = std::array::from_fn(|k| bound(k, f64::min));
        let max: [f32; 9] = std::array::from_fn(|k| bound(k, f64::max));
        for kind in 0..3 {
            for bounds in [&min, &max] {
                for bound in &bounds[3 * kind..3 * kind + 3] {
                    out.write_all(&bound.to_le_bytes())?;
                }
            }
        }
        for (value, index) in values.iter().zip(chunk) {
            let t: [f64; 9] = std::array::from_fn(|k| {
                let (min, max) = (f64::from(min[k]), f64::from(max[k]));
                if max > min { (value[k] - min) / (max - min) } else { 0.0 }
            });
            let index = *index as usize;
            let opacity = quantised(scene.opacities()[index].into(), 255);
            let color = t[6..].iter().fold(0, |word, t| word << 8 | quantised(*t, 255)) << 8 | opacity;
            for word in [pack(&t[..3]), rotation(scene.rotations()[index]), pack(&t[3..6]), color] {
                vertices.extend_from_slice(&word.to_le_bytes());
            }
        }
    }
    out.write_all(&vertices)?;
    if degree > 0 {
        let floats = sh_floats(degree);
        let bands = floats / 3 - 1;
        write_rows(order.len(), out, |at, bytes| {
            let sh = &scene.sh()[order[at] as usize * floats..][..floats];
            bytes.extend((0..3 * bands).map(|at| harmonic(sh[3 * (at % bands + 1) + at / bands])));
        })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::splat;

    #[test]
    fn a_far_splat_makes_the_steps_of_only_the_least_visible_splats_coarser() {
        let faint = |index: usize| index % 4 == 1;
        let scene = |far: f32| {
            Scene::generate(1000, 0, |index| {
                let mut splat = splat(index);
                splat.position[0] += if index == 7 { far } else { 0.0 };
                splat.opacity *= if faint(index) { 0.01 } else { 1.0 };
                splat
            })
        };
        let (near, far) = (position_steps(&scene(0.0)), position_steps(&scene(5000.0)));
        let most = |of: &[f32]| {
            let seen = of.iter().enumerate().filter(|(index, _)| *index != 7 && !faint(*index));
            seen.fold(0.0f32, |most, (_, step)| most.max(*step))
        };
        assert!(far[7] > 1.0 && most(&far) < 1.5 * most(&near), "{} and {}", most(&far), most(&near));
    }
}
