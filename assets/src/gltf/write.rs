//! Writes `.glb` with `KHR_gaussian_splatting`. All values are floats, except for `COLOR_0`, which readers that support
//! only points need.

use super::container::MAGIC;
use super::document::SPLATTING;
use super::read::attributes;
use crate::activation::{SH_C0, quantised};
use crate::scene::{Scene, Splat};
use crate::spz;
use crate::words::write_rows;
use serde_json::{Map, Value, json};
use std::io::{Error, ErrorKind, Result, Write};

fn turned(scene: &Scene, index: usize) -> Splat {
    let mut splat = scene.splat(index);
    spz::flip(&mut splat, scene.stored_degree());
    splat
}

/// Writes a scene of at least one splat. Positions are relative to the node, which is at the scene's offset.
///
/// # Errors
/// The writer fails, or the file would have 4 GiB or more.
pub(crate) fn write(scene: &Scene, out: &mut impl Write) -> Result<()> {
    let (count, degree) = (scene.count() as usize, scene.stored_degree());
    let attributes = attributes(degree);
    let floats: usize = attributes.iter().map(|(_, width)| width).sum();
    // `COLOR_0` has 4 bytes, for readers that support only points.
    let binary = count * (4 * floats + 4);
    let (mut views, mut accessors, mut names, mut at) = (Vec::new(), Vec::new(), Map::new(), 0);
    let kinds = ["SCALAR", "VEC2", "VEC3", "VEC4"];
    let colour = ("COLOR_0".to_owned(), 4);
    for (index, (name, width)) in attributes.iter().chain([&colour]).enumerate() {
        let is_colour = index == attributes.len();
        let length = if is_colour { 4 * count } else { 4 * width * count };
        views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": length, "target": 34962 }));
        let component = if is_colour { 5121 } else { 5126 };
        let mut accessor = json!({ "bufferView": index, "componentType": component, "count": count, "type": kinds[width - 1] });
        if is_colour {
            accessor["normalized"] = json!(true);
        }
        if index == 0 {
            let bounds = scene.bounds();
            let ([x, y, z], [far_x, far_y, far_z]) = (bounds.min, bounds.max);
            accessor["min"] = json!([-far_x, -far_y, z]);
            accessor["max"] = json!([-x, -y, far_z]);
        }
        accessors.push(accessor);
        names.insert(name.clone(), json!(index));
        at += length;
    }
    let [x, y, z] = scene.offset();
    let node = match scene.offset() == [0.0; 3] {
        true => json!({ "mesh": 0 }),
        false => json!({ "mesh": 0, "translation": [-x, -y, z] }),
    };
    let splatting = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective", "sortingMethod": "cameraDistance",
    });
    let document = json!({
        "asset": { "version": "2.0", "generator": "splatgraph" },
        "extensionsUsed": [SPLATTING],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": Value::Object(names), "mode": 0, "extensions": { SPLATTING: splatting } }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": binary }],
    });
    write_head(&document, binary as u64, out)?;
    for (index, (_, width)) in attributes.iter().enumerate() {
        write_rows(count, out, |at, bytes| {
            let splat = turned(scene, at);
            let [w, x, y, z] = splat.rotation;
            let values = match index {
                0 => [splat.position[0], splat.position[1], splat.position[2], 0.0],
                1 => [x, y, z, w],
                2 => [splat.scale[0], splat.scale[1], splat.scale[2], 0.0],
                3 => [splat.opacity; 4],
                _ => std::array::from_fn(|c| splat.sh[(3 * (index - 4) + c).min(47)]),
            };
            values[..*width].iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
        })?;
    }
    write_rows(count, out, |at, bytes| {
        let splat = scene.splat(at);
        let byte = |value: f64| quantised(value, 255) as u8;
        bytes.extend(splat.sh[..3].iter().map(|value| byte(f64::from(*value) * SH_C0 + 0.5)));
        bytes.push(byte(splat.opacity.into()));
    })
}

/// Writes a `.glb` up to its binary chunk, which has `binary` bytes, a multiple of 4.
///
/// # Errors
/// The writer fails, or the file would have 4 GiB or more.
pub(crate) fn write_head(document: &Value, binary: u64, out: &mut impl Write) -> Result<()> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() as u64 + 8 + binary;
    let word = |value: u64| {
        let fits = || {
            Error::new(ErrorKind::InvalidInput, format!("expected a file below 4 GiB, found {total} bytes"))
        };
        u32::try_from(value).map(u32::to_le_bytes).map_err(|_| fits())
    };
    out.write_all(MAGIC)?;
    out.write_all(&[word(2)?, word(total)?, word(text.len() as u64)?].concat())?;
    out.write_all(b"JSON")?;
    out.write_all(&text)?;
    out.write_all(&word(binary)?)?;
    out.write_all(b"BIN\0")
}
