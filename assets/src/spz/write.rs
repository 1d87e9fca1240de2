//! Writes SPZ versions 3 and 4, with the reference writer's quantisation steps.

use super::frame::Frame;
use super::layout::{
    ANTIALIASED, COLOR_SCALE, ENTRY, HEADER, LONG_HEADER, MAGIC, MAX_FIXED, SpzVersion, fractional_bits,
};
use crate::activation::{logarithm, omit_largest, quantised};
use crate::scene::{Scene, Splat, sh_floats};
use crate::size_breakdown::rounded;
use crate::words::write_rows;
use flate2::{Compression, write::GzEncoder};
use std::f64::consts::SQRT_2;
use std::io::{Error, ErrorKind, Result, Write};

/// Compression level of Zstandard, as in the reference writer.
const LEVEL: i32 = 12;

/// Writes a scene. Fails if a coordinate exceeds [`MAX_FIXED`] in absolute value.
pub(crate) fn write(scene: &Scene, version: SpzVersion, out: &mut impl Write) -> Result<()> {
    let largest = scene.largest_coordinate();
    let bits = fractional_bits(largest).ok_or_else(|| {
        let text =
            format!("expected coordinates up to {MAX_FIXED}, the largest of SPZ, found {}", rounded(largest));
        Error::new(ErrorKind::InvalidInput, text)
    })?;
    let flags = if scene.notes().is_antialiased() { ANTIALIASED } else { 0 };
    let mut header = [0; HEADER];
    header[..4].copy_from_slice(MAGIC);
    header[4..8].copy_from_slice(&(version as u32).to_le_bytes());
    header[8..12].copy_from_slice(&scene.count().to_le_bytes());
    header[12..15].copy_from_slice(&[scene.stored_degree() as u8, bits as u8, flags]);
    match version {
        SpzVersion::V3 => {
            let mut out = GzEncoder::new(out, Compression::default());
            out.write_all(&header)?;
            arrays(scene, bits, |_, array| array(&mut out))?;
            out.finish()?;
        }
        SpzVersion::V4 => {
            // The table of contents comes before the streams, so these are packed in memory first.
            let (mut table, mut streams) = (Vec::new(), Vec::new());
            arrays(scene, bits, |stride, array| {
                let (start, bytes) = (streams.len(), u64::from(scene.count()) * stride as u64);
                if bytes == 0 {
                    return Ok(());
                }
                let mut packer = zstd::Encoder::new(&mut streams, LEVEL)?;
                // This lets a reader use a window no larger than the array.
                packer.set_pledged_src_size(Some(bytes))?;
                packer.include_checksum(true)?;
                array(&mut packer)?;
                packer.finish()?;
                let packed = (streams.len() - start) as u64;
                table.extend_from_slice([packed, bytes].map(u64::to_le_bytes).as_flattened());
                Ok(())
            })?;
            header[15] = (table.len() / ENTRY) as u8;
            let mut rest = [0; LONG_HEADER - HEADER];
            rest[..4].copy_from_slice(&(LONG_HEADER as u32).to_le_bytes());
            for bytes in [&header[..], &rest, &table, &streams] {
                out.write_all(bytes)?;
            }
        }
    }
    Ok(())
}

/// Calls `array` for each array of a file, in order, with the bytes per splat and the array's writer. `bits` are the
/// fractional bits of positions.
fn arrays(
    scene: &Scene,
    bits: u32,
    mut array: impl FnMut(usize, &dyn Fn(&mut dyn Write) -> Result<()>) -> Result<()>,
) -> Result<()> {
    let degree = scene.stored_degree();
    let frame = Frame::new(Frame::RUB).expect("it is a number of a coordinate system");
    let turned = |index: usize| {
        let mut splat = scene.splat(index);
        frame.apply(&mut splat, degree);
        splat
    };
    let steps = f64::from(1u32 << bits);
    let count = scene.count() as usize;
    let mut rows = |stride: usize, row: &(dyn Fn(usize, &mut Vec<u8>) + Sync)| {
        array(stride, &|out: &mut dyn Write| write_rows(count, out, row))
    };
    rows(9, &|index, bytes| {
        let [x, y, z] = scene.world_position(index);
        for value in [x, -y, -z] {
            let fixed = (value * steps).round() as i32;
            bytes.extend_from_slice(&fixed.to_le_bytes()[..3]);
        }
    })?;
    rows(1, &|index, bytes| bytes.push(quantised(scene.opacities()[index].into(), 255) as u8))?;
    rows(3, &|index, bytes| bytes.extend(color(&scene.splat(index))))?;
    rows(3, &|index, bytes| bytes.extend(scene.scales()[index].map(scale)))?;
    rows(4, &|index, bytes| bytes.extend(rotation(turned(index).rotation).to_le_bytes()))?;
    rows(sh_floats(degree) - 3, &|index, bytes| {
        let splat = turned(index);
        bytes.extend(
            splat.sh[..sh_floats(degree)].iter().enumerate().skip(3).map(|(at, value)| harmonic(at, *value)),
        );
    })
}

fn color(splat: &Splat) -> [u8; 3] {
    std::array::from_fn(|channel| quantised(f64::from(splat.sh[channel]) * COLOR_SCALE + 0.5, 255) as u8)
}

fn scale(scale: f32) -> u8 {
    ((f64::from(logarithm(scale)) + 10.0) * 16.0).round().clamp(0.0, 255.0) as u8
}

fn rotation([w, x, y, z]: [f32; 4]) -> u32 {
    let (largest, others) = omit_largest([x, y, z, w]);
    others.iter().fold(largest as u32, |word, value| {
        word << 10 | u32::from(*value < 0.0) << 9 | quantised(value.abs() * SQRT_2, 511)
    })
}

/// Quantises the float at index `at` of a splat's harmonics: to 1/16 in band 1, to 1/8 above. The coarser steps
/// compress better.
fn harmonic(at: usize, value: f32) -> u8 {
    let step = if at < sh_floats(1) { 8.0 } else { 16.0 };
    let byte = (f64::from(value) * 128.0).round() + 128.0;
    (((byte + step / 2.0) / step).floor() * step).clamp(0.0, 255.0) as u8
}
