//! Builds `.ksplat` files for tests.

use half::f16;

/// Bytes of the file's header, and of each section's.
const HEADER: usize = 4096;
const SECTION: usize = 1024;

/// Builds a file of one section with three splats. At levels 1 and 2, a full bucket has two, a partial one has one.
pub fn file(level: u16, degree: u16) -> Vec<u8> {
    let mut bytes = vec![0; HEADER + SECTION];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(0, &[0, 1]);
    put(4, &1u32.to_le_bytes());
    put(8, &1u32.to_le_bytes());
    put(16, &3u32.to_le_bytes());
    put(20, &level.to_le_bytes());
    put(36, &(-2f32).to_le_bytes());
    put(40, &2f32.to_le_bytes());
    let (full, partial, buckets) = if level > 0 { (1u32, 1u32, 2u32) } else { (0, 0, 0) };
    for (at, value) in [(0, 3), (4, 3), (8, 2), (12, buckets), (32, full), (36, partial)] {
        put(HEADER + at, &value.to_le_bytes());
    }
    put(HEADER + 16, &8f32.to_le_bytes());
    put(HEADER + 20, &12u16.to_le_bytes());
    put(HEADER + 40, &degree.to_le_bytes());
    if level > 0 {
        bytes.extend(1u32.to_le_bytes());
        bytes.extend([10.0, 0.0, 0.0, -10.0, 5.0, 0.0f32].map(f32::to_le_bytes).as_flattened());
    }
    let harmonics = 3 * ((degree + 1) * (degree + 1) - 1);
    for _ in 0..3 {
        let values = [0.5f32, 1.0, 2.0, 0.0, 1.0, 0.0, 0.0];
        if level == 0 {
            bytes.extend([1.0, 2.0, 3.0f32].map(f32::to_le_bytes).as_flattened());
            bytes.extend(values.map(f32::to_le_bytes).as_flattened());
        } else {
            // The block size is 8, so a step is 4 / 32767.
            bytes.extend([32_767u16, 0, 65_534].map(u16::to_le_bytes).as_flattened());
            bytes.extend(values.map(|v| f16::from_f32(v).to_le_bytes()).as_flattened());
        }
        bytes.extend([255, 0, 51, 102]);
        let floats = (1..=harmonics).map(|k| f32::from(k) / 32.0);
        match level {
            0 => bytes.extend(floats.flat_map(f32::to_le_bytes)),
            1 => bytes.extend(floats.flat_map(|v| f16::from_f32(v).to_le_bytes())),
            _ => bytes.extend((1..=harmonics).map(|k| k as u8)),
        }
    }
    bytes
}
