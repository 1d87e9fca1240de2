//! Writes scenes in the reference layout: binary, little endian, all properties `float`.

use crate::Scene;
use crate::scene::{CHUNK, Splat, sh_floats};
use rayon::prelude::*;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Chunks that are encoded together before they are written.
const BATCH: usize = 32;

/// Names of the properties, in the reference implementation's order.
pub(crate) fn property_names(degree: u32) -> Vec<String> {
    let rest = sh_floats(degree) - 3;
    let numbered = |name: &'static str, n: usize| (0..n).map(move |i| format!("{name}_{i}"));
    ["x", "y", "z", "nx", "ny", "nz"]
        .map(String::from)
        .into_iter()
        .chain(numbered("f_dc", 3))
        .chain(numbered("f_rest", rest))
        .chain(["opacity".into()])
        .chain(numbered("scale", 3))
        .chain(numbered("rot", 4))
        .collect()
}

/// The header's text.
pub(crate) fn header(count: u64, degree: u32) -> String {
    let properties: String =
        property_names(degree).iter().map(|name| format!("property float {name}\n")).collect();
    format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n")
}

impl Scene {
    /// Writes the scene as a PLY file in the reference layout, with its stored degree. Logarithms and logits are rounded
    /// to f32, so that a scene read back agrees to about 1e-6 and not to the bit; an opacity of 0 or 1 and a scale of 0
    /// are written as the nearest finite value that reads back as the same.
    ///
    /// # Errors
    /// Whatever the system answers.
    pub fn write_ply(&self, path: impl AsRef<Path>) -> std::io::Result<()> {
        let mut out = BufWriter::new(std::fs::File::create(path)?);
        self.write_ply_to(&mut out)?;
        out.flush()
    }

    /// As [`Scene::write_ply`], to any writer.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn write_ply_to(&self, out: &mut impl Write) -> std::io::Result<()> {
        let count = self.count() as usize;
        out.write_all(header(count as u64, self.stored_degree()).as_bytes())?;
        for batch in (0..count).step_by(CHUNK * BATCH) {
            let end = count.min(batch + CHUNK * BATCH);
            let chunks: Vec<Vec<u8>> = (batch..end)
                .into_par_iter()
                .step_by(CHUNK)
                .map(|first| {
                    let mut bytes = Vec::new();
                    for index in first..end.min(first + CHUNK) {
                        encode(&self.splat(index), self.stored_degree(), &mut bytes);
                    }
                    bytes
                })
                .collect();
            for chunk in chunks {
                out.write_all(&chunk)?;
            }
        }
        Ok(())
    }
}

/// Appends a row.
fn encode(splat: &Splat, degree: u32, out: &mut Vec<u8>) {
    let mut put = |value: f32| out.extend_from_slice(&value.to_le_bytes());
    splat.position.into_iter().for_each(&mut put);
    // Normals, which the reference writes as zeros.
    (0..3).for_each(|_| put(0.0));
    splat.sh[..3].iter().copied().for_each(&mut put);
    for channel in 0..3 {
        for k in 1..sh_floats(degree) / 3 {
            put(splat.sh[3 * k + channel]);
        }
    }
    put(logit(splat.opacity));
    splat.scale.map(logarithm).into_iter().for_each(&mut put);
    splat.rotation.into_iter().for_each(&mut put);
}

/// The inverse of the sigmoid. -104 and 18 are where it rounds to 0 and to 1 in f32.
fn logit(opacity: f32) -> f32 {
    let p = f64::from(opacity);
    (p / (1.0 - p)).ln().clamp(-104.0, 18.0) as f32
}

/// The logarithm. At -104 its exponential rounds to 0 in f32.
fn logarithm(scale: f32) -> f32 {
    f64::from(scale).ln().max(-104.0) as f32
}
