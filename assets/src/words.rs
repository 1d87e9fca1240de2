//! Reads words from bytes, defines the layout of attributes, copies their words as bytes, and hashes them.

use rayon::prelude::*;
use std::io::Write;

/// Number of splats, or of other values, that one task of a parallel loop converts.
pub(crate) const CHUNK: usize = 8192;

/// Memory layout of an attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttributeInfo {
    /// Bytes per element and plane.
    pub stride: u64,
    /// Number of planes with data: 1; for `scene.sh`, as many as the stored degree needs.
    pub planes: u32,
    /// Number of elements: splats, or entries of one of the mesh's lists.
    pub count: u64,
}

pub(crate) fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes[at..at + N].try_into().expect("the slice has N bytes")
}

/// Reads the little-endian word at offset `at`.
pub(crate) fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes_at(bytes, at))
}

/// Reads the little-endian float at offset `at`.
pub(crate) fn float(bytes: &[u8], at: usize) -> f32 {
    f32::from_bits(word(bytes, at))
}

pub(crate) fn write_floats<T: bytemuck::Pod + Sync>(values: &[T], out: &mut [u8]) {
    let values: &[f32] = bytemuck::cast_slice(values);
    out.par_chunks_mut(4 * CHUNK).zip(values.par_chunks(CHUNK)).for_each(|(out, values)| {
        for (out, value) in out.chunks_exact_mut(4).zip(values) {
            out.copy_from_slice(&value.to_le_bytes());
        }
    });
}

/// Writes `count` rows, which are computed in parallel. `row` appends the bytes of the row at an index.
pub(crate) fn write_rows(
    count: usize,
    out: &mut dyn Write,
    row: impl Fn(usize, &mut Vec<u8>) + Sync,
) -> std::io::Result<()> {
    /// Number of chunks that are in memory at a time.
    const BATCH: usize = 32;
    let chunk = |first: usize| {
        let mut bytes = Vec::new();
        (first..count.min(first + CHUNK)).for_each(|index| row(index, &mut bytes));
        bytes
    };
    for batch in (0..count).step_by(CHUNK * BATCH) {
        let end = count.min(batch + CHUNK * BATCH);
        let chunks: Vec<Vec<u8>> = (batch..end).into_par_iter().step_by(CHUNK).map(chunk).collect();
        chunks.iter().try_for_each(|chunk| out.write_all(chunk))?;
    }
    Ok(())
}

/// Hashes values by their 32-bit words: chunks in parallel, then the chunks' hashes in order.
pub(crate) fn hash<T: bytemuck::Pod + Sync>(values: &[T]) -> u64 {
    let words: &[u32] = bytemuck::cast_slice(values);
    let chunks: Vec<u64> = words.par_chunks(1 << 16).map(hash_chunk).collect();
    chunks.into_iter().fold(words.len() as u64, mix)
}

/// Hashes a chunk in four independent lanes, whose multiplications can overlap.
fn hash_chunk(words: &[u32]) -> u64 {
    let pair = |words: &[u32]| u64::from(words[0]) | u64::from(words[1]) << 32;
    let mut lanes = [0, 1, 2, 3];
    let blocks = words.chunks_exact(8);
    let rest = blocks.remainder();
    for block in blocks {
        for (lane, pair) in lanes.iter_mut().zip(block.chunks_exact(2).map(pair)) {
            *lane = mix(*lane, pair);
        }
    }
    let rest = rest.iter().map(|word| u64::from(*word));
    lanes.into_iter().chain(rest).fold(words.len() as u64, mix)
}

/// Mixes a word into a hash: a multiplication by an odd constant between two exclusive ors.
///
/// The step is invertible in `word`, so different words lead from one state to different states.
pub(crate) fn mix(state: u64, word: u64) -> u64 {
    let x = (state ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x ^ x >> 29
}
