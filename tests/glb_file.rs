//! Writes `.glb` files for tests.

use serde_json::{Value, json};

/// Joins a JSON document and its binary chunk into a `.glb` file.
///
/// The format demands that chunks are padded to 4 bytes. These are not, and the readers accept that.
pub fn joined(document: &Value, binary: &[u8]) -> Vec<u8> {
    let text = document.to_string();
    let word = |value: usize| (value as u32).to_le_bytes();
    let total = word(28 + text.len() + binary.len());
    let head = [&b"glTF"[..], &word(2), &total, &word(text.len()), b"JSON"].concat();
    [&head, text.as_bytes(), &word(binary.len()), b"BIN\0", binary].concat()
}

/// Builds a `.glb` scene whose splats are an SPZ file in the binary chunk.
pub fn around_spz(spz: &[u8]) -> Vec<u8> {
    let document = json!({
        "asset": { "version": "2.0" },
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": {}, "mode": 0, "extensions": { "KHR_gaussian_splatting": {
            "extensions": { "KHR_gaussian_splatting_compression_spz_2": { "bufferView": 0 } } } } }] }],
        "bufferViews": [{ "buffer": 0, "byteLength": spz.len() }],
        "buffers": [{ "byteLength": spz.len() }],
    });
    joined(&document, spz)
}
