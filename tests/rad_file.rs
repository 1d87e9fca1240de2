//! Writes Spark's `.rad` files for tests, in all encodings, with chunks inside the file or beside it. Callers choose
//! the arrays, which may include a palette of harmonics or a tree.

use flate2::Compression;
use flate2::write::DeflateEncoder;
use half::f16;
use serde_json::{Value, json};
use std::io::Write;

/// An array of a chunk, before packing.
pub struct Array {
    pub property: &'static str,
    pub encoding: &'static str,
    pub min: f32,
    pub max: f32,
    pub bytes: Vec<u8>,
}

/// Encodes rows of `width` components; `min` and `max` are the bounds of the encodings that have them.
pub fn array(
    property: &'static str,
    (encoding, min, max): (&'static str, f32, f32),
    width: usize,
    values: &[f32],
) -> Array {
    let rows = values.len() / width;
    // Planar layout: all values of the first component, then all of the second.
    let planar: Vec<f32> =
        (0..width).flat_map(|component| (0..rows).map(move |row| values[row * width + component])).collect();
    let each =
        |bytes: &dyn Fn(f32) -> Vec<u8>| planar.iter().flat_map(|value| bytes(*value)).collect::<Vec<u8>>();
    let planes = |words: Vec<Vec<u8>>| {
        (0..words[0].len())
            .flat_map(|byte| words.iter().map(move |word| word[byte]).collect::<Vec<_>>())
            .collect()
    };
    let differences = |codes: Vec<u8>| {
        let before = |at: usize| if at.is_multiple_of(rows) { 0 } else { codes[at - 1] };
        (0..codes.len()).map(|at| codes[at].wrapping_sub(before(at))).collect::<Vec<u8>>()
    };
    let r8 = |value: f32| vec![((value - min) / (max - min) * 255.0).clamp(0.0, 255.0).round() as u8];
    let s8 = |value: f32| vec![(value / max * 127.0).clamp(-127.0, 127.0).round() as i8 as u8];
    let half = |value: f32| f16::from_f32(value).to_le_bytes().to_vec();
    let bytes = match encoding {
        "f32" => each(&|value| value.to_le_bytes().to_vec()),
        "f16" => each(&half),
        "f32_lebytes" => planes(planar.iter().map(|value| value.to_le_bytes().to_vec()).collect()),
        "f16_lebytes" => planes(planar.iter().map(|value| half(*value)).collect()),
        "r8" => each(&r8),
        "r8_delta" => differences(each(&r8)),
        "s8" => each(&s8),
        "s8_delta" => differences(each(&s8)),
        "ln_f16" => each(&|value| half(value.ln())),
        "ln_0r8" => each(&|value| match value {
            0.0 => vec![0],
            _ => vec![1 + ((value.ln() - min) / (max - min) * 254.0).clamp(0.0, 254.0).round() as u8],
        }),
        "u16" => each(&|value| (value as u16).to_le_bytes().to_vec()),
        "u32" => each(&|value| (value as u32).to_le_bytes().to_vec()),
        // Values are bytes already: two for an axis, and one for an angle.
        "oct88r8" => values.iter().map(|value| *value as u8).collect(),
        other => unreachable!("{other} is no encoding"),
    };
    Array { property, encoding, min, max, bytes }
}

fn padded(bytes: &[u8]) -> Vec<u8> {
    let mut padded = bytes.to_vec();
    padded.resize(bytes.len().next_multiple_of(8), 0);
    padded
}

fn headed(magic: &[u8], document: &Value) -> Vec<u8> {
    let text = document.to_string().into_bytes();
    [magic, &(text.len() as u32).to_le_bytes(), &padded(&text)].concat()
}

/// Builds a chunk of `count` splats that begins with splat `base`. The format calls a raw deflate stream `gz`.
pub fn chunk(base: u64, count: u64, arrays: &[Array], compressed: bool) -> Vec<u8> {
    let (mut payload, mut properties) = (Vec::new(), Vec::new());
    for Array { property, encoding, min, max, bytes } in arrays {
        let mut packed = bytes.clone();
        if compressed {
            let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(bytes).expect("memory takes it");
            packed = encoder.finish().expect("memory takes it");
        }
        let mut description = json!({
            "offset": payload.len(), "bytes": packed.len(), "property": property, "encoding": encoding,
            "min": min, "max": max,
        });
        if compressed {
            description["compression"] = json!("gz");
        }
        properties.push(description);
        payload.extend(padded(&packed));
    }
    let document = json!({
        "version": 1, "base": base, "count": count, "payloadBytes": payload.len(), "properties": properties,
    });
    [headed(b"RADC", &document), (payload.len() as u64).to_le_bytes().to_vec(), payload].concat()
}

/// Builds a file of `count` splats. If `names` are given, it lacks the chunks, and refers to files of those names.
/// `entries` is the number of entries of the palette of harmonics.
pub fn file(count: u64, chunks: &[Vec<u8>], names: &[&str], entries: Option<u64>) -> Vec<u8> {
    let mut offset = 0;
    let mut places = Vec::new();
    for (index, chunk) in chunks.iter().enumerate() {
        places.push(match names.get(index) {
            Some(name) => json!({ "offset": 0, "bytes": chunk.len(), "filename": name }),
            None => json!({ "offset": offset, "bytes": chunk.len() }),
        });
        offset += chunk.len();
    }
    let mut document = json!({
        "version": 1, "type": "gsplat", "count": count, "chunkSize": 65536, "allChunkBytes": offset, "chunks": places,
    });
    if let Some(entries) = entries {
        document["shCodeCount"] = json!(entries);
    }
    let within = if names.is_empty() { chunks.concat() } else { Vec::new() };
    [headed(b"RAD0", &document), within].concat()
}
