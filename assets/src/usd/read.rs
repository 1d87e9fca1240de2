//! Reads the splats of a layer, prim by prim.

use super::layer::{Array, Bytes, Layer, SPLATS, Value, check_memory};
use super::{binary, package, text, xform};
use crate::activation;
use crate::error::{SceneError, wrong};
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::memory;
use crate::node_transform::NodeTransform;
use crate::scene::{FileNotes, Scene, SortKey, Splat, sh_floats};
use crate::similarity::Similarity;
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use glam::{DMat4, DQuat};
use std::collections::BTreeSet;
use std::f64::consts::FRAC_PI_2;

const DEFAULT_DEGREE: f64 = 3.0;

/// Highest degree of a file; the bands above 3 are cut off.
const MAX_DEGREE: f64 = 8.0;

/// Types of prims whose splats are not read, and what an error calls them.
const OTHERS: [(&str, &str); 2] = [
    ("ParticleField", "a ParticleField, whose kind only applied schemas name"),
    ("OmniNuRecFieldAsset", "a volume of NVIDIA NuRec"),
];

struct Splats<'a> {
    place: Similarity,
    /// Positions, orientations, scales, opacities and harmonics, with their names.
    arrays: [(&'a Array, String); 5],
    count: u64,
    /// Degree of the harmonics in the file.
    degree: u32,
    key_of: SortKey,
}

impl Splats<'_> {
    fn header(&self) -> SceneHeader {
        SceneHeader { count: self.count, stored_degree: self.degree.min(3) }
    }
}

/// Reads and parses a text layer. The text and its numbers need three times its length; `memory` is the limit.
fn parse_text(bytes: &Bytes, memory: Option<u64>) -> Result<Layer, SceneError> {
    check_memory(bytes.length.saturating_mul(3), memory)?;
    text::parse(&bytes.vec(0, bytes.length)?)
}

/// Finds the layer of a file and parses it. In an archive, errors name the layer.
fn open<'a>(source: &'a Source<'a>, memory: Option<u64>) -> Result<(Bytes<'a>, Layer), SceneError> {
    let (bytes, name) = package::layer(source)?;
    let parse = || {
        let mut head = [0; binary::MAGIC.len()];
        let is_binary = bytes.read(0, &mut head).is_ok() && head == *binary::MAGIC;
        let layer = if is_binary { binary::parse(&bytes, memory)? } else { parse_text(&bytes, memory)? };
        if let Some(arc) = &layer.arc {
            let text = format!(
                "expected a single layer without references to others, found {arc} (join them first, e.g. by `usdcat --flatten`)"
            );
            return Err(wrong("USD", text));
        }
        Ok(layer)
    };
    let layer = parse().map_err(|error| match &name {
        Some(name) => error.in_file(name),
        None => error,
    })?;
    Ok((bytes, layer))
}

/// Returns the rotation from the file's world to one whose axes point left, up and to the front. Fails if `upAxis` is
/// neither Y nor Z.
fn upright(layer: &Layer) -> Result<Similarity, SceneError> {
    match layer.up_axis.as_deref() {
        None | Some("Y") => Ok(Similarity::IDENTITY),
        Some("Z") => Ok(Similarity { rotation: DQuat::from_rotation_x(-FRAC_PI_2), ..Similarity::IDENTITY }),
        Some(other) => {
            let found: String = other.chars().take(20).collect();
            Err(wrong("upAxis", format!("expected Y or Z, found {found}")))
        }
    }
}

/// Lists the splats of all visible prims. Fails if there are none.
fn splats(layer: &Layer) -> Result<Vec<Splats<'_>>, SceneError> {
    let upright = upright(layer)?;
    let mut worlds: Option<Vec<DMat4>> = None;
    let mut visible = Vec::with_capacity(layer.prims.len());
    let (mut found, mut hidden) = (Vec::new(), 0);
    for (index, prim) in layer.prims.iter().enumerate() {
        let shown = prim.parent.is_none_or(|parent| visible[parent])
            && prim.defined
            && !prim.inactive
            && layer.word(index, "visibility")? != Some("invisible")
            && !matches!(layer.word(index, "purpose")?, Some("guide" | "proxy"));
        visible.push(shown);
        if prim.kind != SPLATS {
            continue;
        }
        if !shown {
            hidden += 1;
            continue;
        }
        if worlds.is_none() {
            worlds = Some(xform::world(layer)?);
        }
        let world = worlds.as_ref().map_or(DMat4::IDENTITY, |worlds| worlds[index]);
        let place = Similarity::of_matrix(world).map_err(|text| layer.wrong(index, "", text))?;
        let place = if upright == Similarity::IDENTITY { place } else { place.then(upright) };
        found.push(prim_splats(layer, index, place)?);
    }
    match (found.is_empty(), hidden) {
        (false, _) => Ok(found),
        (true, 0) => {
            let other =
                layer.prims.iter().find_map(|prim| OTHERS.iter().find(|(kind, _)| *kind == prim.kind));
            Err(SceneError::NotScene {
                found: match other {
                    Some((_, what)) => format!("a USD scene with {what} (convert it to {SPLATS} first)"),
                    None => "a USD scene without Gaussian splats".into(),
                },
            })
        }
        (true, _) => {
            let found = format!("a USD scene that hides its Gaussian splats ({hidden} prims)");
            Err(SceneError::NotScene { found })
        }
    }
}

fn prim_splats(layer: &Layer, prim: usize, place: Similarity) -> Result<Splats<'_>, SceneError> {
    let names =
        ["positions", "orientations", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients"];
    let array = |name: &str| {
        let half = format!("{name}h");
        for name in [name, &half] {
            if let Some(Value::Array(array)) = layer.value(prim, name)? {
                return Ok((array, name.to_owned()));
            }
        }
        Err(layer.wrong(prim, name, format!("expected the attribute {name} or {half}, found none")))
    };
    let [positions, orientations, scales, opacities, harmonics] = names.map(array);
    let arrays = [positions?, orientations?, scales?, opacities?, harmonics?];
    let count = arrays[0].0.count;
    if count == 0 || u32::try_from(count).is_err() {
        let text = format!("expected 1 to 4,294,967,295 splats, found {count}");
        return Err(layer.wrong(prim, &arrays[0].1, text));
    }
    let degree_name = "radiance:sphericalHarmonicsDegree";
    let degree = match layer.value(prim, degree_name)? {
        Some(Value::Numbers(numbers)) => numbers.first().copied().unwrap_or(DEFAULT_DEGREE),
        _ => DEFAULT_DEGREE,
    };
    if !(0.0..=MAX_DEGREE).contains(&degree) || degree.fract() != 0.0 {
        return Err(layer.wrong(prim, degree_name, format!("expected 0 to {MAX_DEGREE}, found {degree}")));
    }
    let degree = degree as u32;
    for (at, (array, name)) in arrays.iter().enumerate() {
        let expected = if at == 4 { count * u64::from((degree + 1) * (degree + 1)) } else { count };
        if array.count != expected {
            let of = if at == 4 { format!(" for {count} splats of degree {degree}") } else { String::new() };
            let text = format!("expected {expected} elements{of}, found {}", array.count);
            return Err(layer.wrong(prim, name, text));
        }
    }
    let hint = |name: &str, expected: &[&str], fallback: &'static str| {
        let found = layer.word(prim, name)?.unwrap_or(fallback);
        match expected.iter().position(|value| *value == found) {
            Some(at) => Ok(at),
            None => {
                let found: String = found.chars().take(40).collect();
                let text = format!("expected {}, found {found}", expected.join(" or "));
                Err(layer.wrong(prim, name, text))
            }
        }
    };
    hint("projectionModeHint", &["perspective"], "perspective")?;
    let order = hint("sortingModeHint", &["zDepth", "cameraDistance"], "zDepth")?;
    let key_of = if order == 1 { SortKey::Distance } else { SortKey::Depth };
    Ok(Splats { place, arrays, count, degree, key_of })
}

pub(crate) fn header(source: &Source) -> Result<SceneHeader, SceneError> {
    let (_, layer) = open(source, memory::available())?;
    let headers: Vec<_> = splats(&layer)?.iter().map(Splats::header).collect();
    Ok(SceneHeader::joined(&headers))
}

pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    package::check(input.source)?;
    let (bytes, layer) = open(input.source, input.memory)?;
    let all = splats(&layer)?;
    let headers: Vec<_> = all.iter().map(Splats::header).collect();
    let SceneHeader { count, .. } = SceneHeader::joined(&headers);
    SceneError::check_count(count)?;
    let held = layer.held_bytes();
    SceneHeader::check_joined(&headers, held, input.memory)?;
    let stride = |splats: &Splats| -> u64 {
        splats.arrays.iter().map(|(array, _)| array.stride() as u64 * array.count).sum()
    };
    let done = Done::new(all.iter().map(stride).sum(), input.progress)?;
    let scenes = all.iter().map(|splats| prim_scene(input, &bytes, splats, held, &done));
    let scene = Scene::of_one_file(scenes.collect::<Result<_, _>>()?)?;
    Ok(scene.with_breakdown(breakdown(input.source.length(), &layer, &all)))
}

/// Reads the splats of a prim. `held` are the bytes of the layer's arrays in memory.
fn prim_scene(
    input: &Input,
    bytes: &Bytes,
    splats: &Splats,
    held: u64,
    done: &Done,
) -> Result<Scene, SceneError> {
    let Splats { place, arrays, count, degree: file_degree, key_of } = splats;
    let degree = splats.header().stored_degree;
    let transform = NodeTransform::new(*place, degree);
    // Elements of a splat in each array.
    let elements = [1, 1, 1, 1, ((file_degree + 1) * (file_degree + 1)) as usize];
    let tables: [Table; 5] = std::array::from_fn(|at| arrays[at].0.table(bytes, elements[at]));
    let filled = input.fill((*count, degree, false), tables, held, done, |rows, _, out| {
        let number = |at: usize, number: usize| {
            let scalar = arrays[at].0.scalar;
            scalar.value::<false>(&rows[at][number * scalar.size()..])
        };
        let (mut splat, norm) = splat(number, arrays[1].0.real_last, degree);
        transform.apply(&mut splat);
        out.push_clamped(&splat, norm);
    })?;
    let cut_degree = (*file_degree > 3).then_some(*file_degree);
    let notes = FileNotes { key_of: *key_of, cut_degree, ..FileNotes::default() };
    let scene = input::finish(filled, *count, SizeBreakdown::default(), notes)?;
    Ok(scene.with_offset(transform.offset()))
}

/// Converts the numbers of a splat, given by the index of their array and in it. Also returns the length of its
/// quaternion, whose w comes last if `real_last`, otherwise first.
fn splat(number: impl Fn(usize, usize) -> f32, real_last: bool, degree: u32) -> (Splat, f64) {
    let mut quaternion: [f64; 4] = std::array::from_fn(|at| number(1, at).into());
    if real_last {
        quaternion.rotate_right(1);
    }
    let (rotation, norm) = activation::unit(quaternion);
    let floats = sh_floats(degree);
    let splat = Splat {
        position: std::array::from_fn(|axis| number(0, axis)),
        scale: std::array::from_fn(|axis| number(2, axis)),
        rotation,
        opacity: number(3, 0),
        sh: std::array::from_fn(|at| if at < floats { number(4, at) } else { 0.0 }),
    };
    (splat, norm)
}

fn breakdown(file_bytes: u64, layer: &Layer, all: &[Splats]) -> SizeBreakdown {
    let mut fields: Vec<FieldSize> = Vec::new();
    // Prims can share an array.
    let mut seen = BTreeSet::new();
    for (array, name) in all.iter().flat_map(|splats| &splats.arrays) {
        if !seen.insert(array.at) {
            continue;
        }
        // Shortened, to fit into the first column of the size breakdown.
        let name = name.trim_start_matches("radiance:").replace("Coefficients", "");
        match fields.iter_mut().find(|field| field.name == name) {
            Some(field) => field.bytes += array.bytes,
            None => fields.push(FieldSize::whole(name, array.kind, array.bytes)),
        }
    }
    // In a damaged file, arrays can overlap.
    if fields.iter().map(|field| field.bytes).sum::<u64>() > file_bytes {
        fields = vec![FieldSize::whole("values", "array", file_bytes)];
    }
    let arrays = ElementSize::new("splats", all.iter().map(|splats| splats.count).sum(), fields);
    let format = format!("{}, {SPLATS}", layer.kind);
    SizeBreakdown::new(format, file_bytes, file_bytes - arrays.bytes, vec![arrays])
}
