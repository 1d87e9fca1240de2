//! Lists what a scene loses: splats and columns that loading leaves out, and values that a written file lacks or
//! rounds. Advice follows where an option of `convert` helps.

use super::outliers::{self, Outliers};
use glam::DQuat;
use splatgraph_assets::{
    Dropped, FileNotes, Mesh, QuaternionNorms, SH_C0, Scene, SceneFormat, SizeBreakdown, SortKey, SpzVersion,
    grouped, rounded, sh_floats,
};
use std::f64::consts::PI;

/// Properties of a loaded scene that are compared with the written file.
pub struct Original {
    /// Format of the file.
    pub format: String,
    /// Size of the file, in bytes.
    pub file_bytes: u64,
    /// Number of splats.
    pub count: u64,
    /// Degree of the stored harmonics.
    pub degree: u32,
    dropped: Dropped,
    notes: FileNotes,
    norms: QuaternionNorms,
    /// Names of the properties and elements that are not read; `None` if there are none.
    unread: Option<String>,
    /// Description of the data after the last row; `None` if there is none.
    after_rows: Option<String>,
    /// Comments of a PLY, or the copyright of a glTF. A written PLY keeps the comments, unless scenes were merged.
    comments: Vec<String>,
}

/// Data of a scene, or of several merged ones, that a written file lacks. Each loss is a phrase.
#[derive(Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Losses {
    /// Losses due to the contents of the scenes, such as dropped splats, or tags that the format cannot store.
    pub losses: Vec<String>,
    /// Losses due to the chosen format and degree: cut harmonics, and values that are rounded or clipped.
    pub chosen_losses: Vec<String>,
    /// Losses that no picture shows, but training that continues from the file may.
    pub invisible_losses: Vec<String>,
}

/// Opacity (logit 9.9) above which rounding to f32 can change the logit by more than 0.0005.
const NEARLY_OPAQUE: f32 = 0.99995;

/// Standard deviation of a splat, in quantization steps of positions, below which quantization costs several dB.
const FEW_STEPS: f64 = 8.0;

/// Maximum number of properties to name.
const NAMED: usize = 8;

/// Names the file's properties and elements that are not read; `None` if there are none. Normals do not count, because
/// writers of splats fill them with zeros, nor do the points' colours of glTF, which repeat band 0, nor harmonics above
/// degree 3, which are reported elsewhere.
fn unread(breakdown: &SizeBreakdown) -> Option<String> {
    let mut names = Vec::new();
    for element in &breakdown.elements {
        let unused: Vec<&str> =
            element.fields.iter().filter(|field| !field.used).map(|field| &*field.name).collect();
        if !unused.is_empty() && unused.len() == element.fields.len() {
            names.push(format!("element {}", element.name));
        } else {
            let is_listed = |name: &&str| {
                let is_harmonic = name.starts_with("f_rest_") || name.starts_with("SH_DEGREE_");
                !is_harmonic && !["nx", "ny", "nz", "COLOR_0"].contains(name)
            };
            let others = unused.into_iter().filter(is_listed);
            names.extend(others.map(str::to_owned));
        }
    }
    listed(&names).map(|names| format!("properties that splats do not have: {names}"))
}

/// Lists the first [`NAMED`] names, and counts the others; `None` if there are none.
fn listed(names: &[String]) -> Option<String> {
    let more = names.len().saturating_sub(NAMED);
    let others = if more > 0 { format!(" and {more} others") } else { String::new() };
    (!names.is_empty()).then(|| format!("{}{others}", names[..names.len() - more].join(", ")))
}

/// Words in the names of properties that cannot change a picture: normals, second colours and labels. `rest` are
/// harmonics above degree 3, which are reported elsewhere.
const HARMLESS: [&str; 15] = [
    "nx", "ny", "nz", "normal", "red", "green", "blue", "alpha", "label", "class", "segment", "semantic",
    "object", "instance", "rest",
];

/// Lists properties of a PLY file's splats that are not read and may change their picture; `None` if there are none.
pub fn skipped(scene: &Scene) -> Option<String> {
    let splats = scene.size_breakdown().elements.iter().filter(|element| element.name == "vertex");
    let fields = splats.flat_map(|element| &element.fields).filter(|field| !field.used);
    let others = fields.filter(|field| !field.name.split('_').any(|word| HARMLESS.contains(&word)));
    listed(&others.map(|field| field.name.clone()).collect::<Vec<_>>())
}

/// Describes the data after the last row of a PLY file, such as splats that its header does not count. `None` if there
/// is none, or less than half a row, which is padding or blank lines.
pub fn after_rows(scene: &Scene) -> Option<String> {
    let SizeBreakdown { format, elements, trailing_bytes, .. } = scene.size_breakdown();
    let vertex = elements.iter().find(|element| element.name == "vertex" && format.contains("ply"))?;
    let is_padding = 2 * trailing_bytes * vertex.rows < vertex.bytes;
    (*trailing_bytes > 0 && !is_padding)
        .then(|| format!("{} bytes after the last row that the header declares", grouped(*trailing_bytes)))
}

/// Describes what is unusual about a loaded scene, one text for each peculiarity.
///
/// These are dropped splats, clamped opacities, splats and meshes or parts of one that are left out, coarse positions,
/// properties and tags that are not used, and data after the last row.
pub fn notes(scene: &Scene) -> Vec<String> {
    let dropped = scene.dropped();
    let texts = [
        (dropped.total() > 0).then(|| format!("{} dropped ({dropped})", splats(dropped.total()))),
        scene.notes().clamped(),
        scene.notes().mesh_left_out().map(|mesh| format!("left out: {mesh}")),
        scene.notes().splats_left_out().map(|splats| format!("left out: {splats}")),
        skipped(scene)
            .map(|names| format!("properties that are not read, although they may matter: {names}")),
        after_rows(scene).map(|data| format!("not read: {data}")),
        mixed_tags(scene).map(|tags| match scene.notes().mixed.up {
            true => format!("{tags}; for instance `render --up y`, or `convert --tag up=y`, gives all scenes one up direction"),
            false => tags,
        }),
    ];
    let mesh = scene.mesh().map(mesh_notes).unwrap_or_default();
    scene.coarse_notes().into_iter().chain(texts.into_iter().flatten()).chain(mesh).collect()
}

/// Describes what a mesh lacks of its files, one text for each file.
pub fn mesh_notes(mesh: &Mesh) -> Vec<String> {
    mesh.left_out.iter().map(|text| format!("left out: {text}")).collect()
}

/// Names the tags that a merged scene ignores, because the scenes differ in them; `None` if there are none.
pub fn mixed_tags(scene: &Scene) -> Option<String> {
    let tags = scene.notes().mixed_tags()?;
    Some(format!("tags that are ignored, because the scenes differ in them: {tags}"))
}

/// Describes the steps of positions if they are coarse, with a remedy if there is one; `None` for finer steps.
///
/// Steps are coarse if they are larger than more than 1/100 of the splats or, in SPZ, larger than usual or than 1/8 of
/// the splats' median deviation.
pub fn coarse_positions(scene: &Scene, format: SceneFormat) -> Option<String> {
    if let Some(steps) = scene.large_steps(format) {
        let advice = match outliers::find(scene, format) {
            Some(Outliers { count, crop }) => format!(
                "{} {} far from the others; with `{crop}`, which drops them, the steps are smaller than 99 % of the splats",
                splats(count),
                if count == 1 { "is" } else { "are" }
            ),
            None => "write the scene in parts (`--crop`), one file for each".into(),
        };
        return Some(format!("positions: {steps}; {advice}"));
    }
    if format != SceneFormat::Spz {
        return None;
    }
    let largest = scene.largest_coordinate();
    let step = SpzVersion::position_step(largest)?;
    let finest = SpzVersion::position_step(0.0)?;
    if step <= finest {
        return small_splats(scene, step, largest);
    }
    let most = scene.robust_bounds().in_world(scene.offset());
    let farthest = [most.min, most.max].as_flattened().iter().fold(0.0, |far: f64, v| v.abs().max(far));
    let finer = |largest: f64| SpzVersion::position_step(largest).filter(|finer| *finer < step);
    let advice = if let Some(finer) = finer(farthest) {
        // The step is a power of two. So is the largest coordinate that it allows, except for one step.
        let limit = finer / finest * 2048.0;
        let beyond = |index: &u32| scene.world_position(*index as usize).iter().any(|v| v.abs() >= limit);
        let count = (0..scene.count()).filter(beyond).count() as u64;
        format!(
            ": {} {} beyond {limit}; with `--crop box:-{limit},-{limit},-{limit},{limit},{limit},{limit}`, \
             which drops them, it is {}",
            splats(count),
            if count == 1 { "is" } else { "are" },
            fraction(finer)
        )
    } else if finer(0.5 * scene.bounds().extent()).is_some_and(|finer| finer <= step / 4.0) {
        move_advice(scene)
    } else {
        String::new()
    };
    let (step, finest) = (fraction(step), fraction(finest));
    Some(format!("positions: steps of {step}, not {finest}, because a coordinate is {largest:.0}{advice}"))
}

/// Names the bands of harmonics that are all zero but take bytes in a format; `None` if there are none.
///
/// The text includes the option that leaves them out.
pub fn empty_bands(scene: &Scene, format: SceneFormat) -> Option<String> {
    let (used, stored) = (scene.effective_degree(), scene.stored_degree());
    let (bytes, rounded) = match format {
        SceneFormat::Ply | SceneFormat::Gltf => (4, ""),
        SceneFormat::CompressedPly => (1, ", and keeps them zero, which the format rounds to 1/64"),
        // The other formats pack equal values, or store no bands.
        _ => return None,
    };
    let saved = u64::from(scene.count()) * bytes * (sh_floats(stored) - sh_floats(used)) as u64;
    (used < stored).then(|| {
        let saved = grouped(saved);
        format!("the bands above {used} are all zero: `--degree {used}` saves {saved} bytes{rounded}")
    })
}

/// Advises to move the scene to the origin.
fn move_advice(scene: &Scene) -> String {
    let [x, y, z] = scene.to_origin();
    format!(": the scene is far from the origin; `--transform move:{x},{y},{z}` moves it there")
}

/// Describes the finest step of positions in SPZ, with a transform that helps if there is one. `None` if the median
/// deviation of the splats is [`FEW_STEPS`] or more, or without splats.
fn small_splats(scene: &Scene, step: f64, largest: f64) -> Option<String> {
    // Splats of this many steps are typical of captures, and are above the smallest scale of SPZ.
    const STEPS: f64 = 32.0;
    let median = f64::from(scene.median_size());
    if median >= FEW_STEPS * step || scene.count() == 0 {
        return None;
    }
    let wanted = STEPS * step / median.max(1e-9);
    // Beyond 2048 units, the steps grow with the scene.
    let factor = 10f64.powf(wanted.log10().ceil().min((2048.0 / largest).log10().floor()));
    let advice = match factor >= 10.0 {
        true => format!("; `--transform scale:{factor}` enlarges the scene"),
        false => String::new(),
    };
    let (step, median) = (fraction(step), rounded(median));
    Some(format!(
        "positions: steps of {step}, but half of the splats have a deviation of at most {median}{advice}"
    ))
}

/// Formats a number of splats: `1 splat`, `2,000 splats`.
pub fn splats(count: u64) -> String {
    format!("{} {}", grouped(count), if count == 1 { "splat" } else { "splats" })
}

/// Formats a power of two: `1/8`.
fn fraction(step: f64) -> String {
    if step < 1.0 { format!("1/{}", 1.0 / step) } else { step.to_string() }
}

/// Describes how a scene with this up direction is shown without the tag, and the rotation that turns it upright.
/// `None` if the direction is within a degree of that of files without a tag.
///
/// With `others`, it is drawn beside scenes without a tag. They may have the same direction, so the text also includes
/// the option that turns all scenes upright.
pub fn lost_up(up: [f64; 3], others: bool) -> Option<String> {
    let (rotation, degrees) = upright(up)?;
    let view = if degrees > 135.0 { "is shown upside down" } else { "lies on its side" };
    let [x, y, z] = up;
    let all = match others {
        true => {
            format!("`--up {x},{y},{z}` turns all scenes upright if they share this direction; otherwise, ")
        }
        false => String::new(),
    };
    Some(format!("the tag up {x},{y},{z}: without it, the scene {view}; {all}{rotation} turns it upright"))
}

/// Formats the rotation that turns a scene with this up direction upright, for readers that assume y down. Also returns
/// the angle in degrees. `None` if the direction is within a degree of upright.
pub fn upright(up: [f64; 3]) -> Option<(String, f64)> {
    let turn = match up[1] > 0.999_999 {
        true => DQuat::from_rotation_x(PI),
        false => DQuat::from_rotation_arc(up.into(), FileNotes::UP.into()),
    };
    let (axis, angle) = turn.to_axis_angle();
    // `+ 0.0` avoids "-0".
    let [x, y, z, degrees] =
        [axis.x, axis.y, axis.z, angle.to_degrees()].map(|v| (v * 1e4).round() / 1e4 + 0.0);
    (degrees > 1.0).then(|| (format!("`convert --transform rotate:{x},{y},{z},{degrees}`"), degrees))
}

/// Counts the values that a format clips, one phrase for each kind of value; empty if it clips none.
fn clipped(scene: &Scene, format: SceneFormat) -> Vec<String> {
    // Limits of the scales' logarithms, of band 0, and of the higher bands. Values within half a step of a limit are
    // rounded to it, not clipped.
    let byte = 0.5 + 0.5 / 255.0;
    let (scales, band_0, above) = match format {
        SceneFormat::Spz => ((-10.0, 5.9375, 0.5 / 16.0), byte / 0.15, 1.0),
        SceneFormat::CompressedPly => ((-20.0, 20.0, 0.0), f64::INFINITY, 4.0),
        SceneFormat::Splat => ((f64::NEG_INFINITY, f64::INFINITY, 0.0), byte / SH_C0, f64::INFINITY),
        _ => return Vec::new(),
    };
    let (least, most, half) = scales;
    let (low, high) = ((least - half).exp(), (most + half).exp());
    let scales = |clipped: &dyn Fn(f64) -> bool| {
        scene.scales().as_flattened().iter().filter(|scale| clipped(f64::from(**scale))).count()
    };
    let splats = || scene.sh().chunks_exact(sh_floats(scene.stored_degree()));
    let beyond = |value: &&f32, limit: f64| f64::from(value.abs()) > limit;
    let colors = splats().flat_map(|sh| &sh[..3]).filter(|value| beyond(value, band_0)).count();
    let harmonics = splats().flat_map(|sh| &sh[3..]).filter(|value| beyond(value, above)).count();
    let counted = [
        ("scales", scales(&|scale| scale > high), format!("clipped to e^{most}")),
        ("scales", scales(&|scale| scale < low), format!("enlarged to e^{least}")),
        ("colour channels", colors, "clipped, too dark or too bright for the format".into()),
        ("coefficients of harmonics", harmonics, format!("clipped to {above} or -{above}")),
    ];
    let counted = counted.into_iter().filter(|(_, count, _)| *count > 0);
    counted.map(|(values, count, text)| format!("{values}: {} {text}", grouped(count as u64))).collect()
}

/// Lists what a file of a scene lacks, one phrase per loss, without the rounding that the format always does.
pub fn missing(scene: &Scene, format: SceneFormat) -> Vec<String> {
    [not_stored(scene, format), clipped(scene, format)].concat()
}

/// Lists the losses that a scene's contents cause in a file of a format, one phrase each. These are tags, the order by
/// depth, precision of positions, further properties, and the mesh.
pub fn not_stored(scene: &Scene, format: SceneFormat) -> Vec<String> {
    let mut losses = Vec::new();
    // First, because a scene is moved to the origin before it is turned about it.
    let rounding = scene.position_rounding(format);
    if rounding > 0.0 {
        // In `.glb`, positions are relative to the scene's origin.
        let at_origin = f64::from(f32::EPSILON) * scene.robust_bounds().extent();
        let is_far = format != SceneFormat::Gltf && rounding > 4.0 * at_origin;
        let advice = if is_far { move_advice(scene) } else { String::new() };
        let by = if format == SceneFormat::Sog { " by readers that decode to `float`" } else { "" };
        losses.push(format!("positions: rounded to 32 bits{by}, by {rounding:.1e} at most{advice}"));
    }
    losses.extend(coarse_positions(scene, format));
    let properties = listed(scene.property_names()).filter(|_| format != SceneFormat::Ply);
    losses.extend(properties.map(|names| format!("properties that only PLY files have: {names}")));
    let kept = format.kept_tags(scene.notes()).tags();
    let lost = scene.notes().tags().into_iter().filter(|tag| !kept.contains(tag));
    losses.extend(lost.filter_map(|(tag, value)| match kept.iter().find(|(other, _)| *other == tag) {
        Some((_, other)) => {
            Some(format!("the tag {tag} {value}: the file has {other} instead, another rule"))
        }
        None if tag == "up" => scene.notes().up.and_then(|up| lost_up(up, false)),
        None => Some(format!("the tag {tag} {value}")),
    }));
    losses.extend(scene.notes().mixed_tags().map(|tags| {
        let advice = if scene.notes().mixed.up {
            "; for instance `--tag up=y` gives all one up direction"
        } else {
            ""
        };
        format!("tags in which the merged scenes differ: {tags}{advice}")
    }));
    if format == SceneFormat::Gltf && scene.notes().key_of == SortKey::Depth {
        losses.push("the order by depth: the format only supports order by distance from the camera".into());
    }
    if let Some(mesh) = scene.mesh() {
        losses.push(format!("the mesh: {} triangles", grouped(mesh.triangles.len() as u64)));
    }
    losses
}

/// Counts the splats of a PLY file whose stored values change in a file of `format`, although their activated values
/// are kept, one phrase for each kind of value.
fn inexact(written: &Scene, format: SceneFormat) -> impl Iterator<Item = String> {
    let opacities = |is: fn(f32) -> bool| written.opacities().iter().filter(|opacity| is(**opacity)).count();
    let nearly = opacities(|opacity| opacity > NEARLY_OPAQUE);
    let mut counts =
        vec![("logits above 9.9", nearly, "rounded to those of opacities in 32 bits, at most 18")];
    if format == SceneFormat::Ply {
        let flat = written.scales().iter().filter(|scale| scale.contains(&0.0)).count();
        counts.push(("logits of opacity 0", opacities(|opacity| opacity == 0.0), "written as -104"));
        counts.push(("logarithms of scale 0", flat, "written as -104"));
    }
    let counts = counts.into_iter().filter(|(_, count, _)| *count > 0);
    counts.map(|(values, count, text)| format!("{values}, in {}: {text}", splats(count as u64)))
}

impl Original {
    /// Collects the properties of a scene.
    pub fn of(scene: &Scene) -> Original {
        let breakdown = scene.size_breakdown();
        Original {
            format: breakdown.format.clone(),
            file_bytes: breakdown.file_bytes,
            count: scene.count().into(),
            degree: scene.stored_degree(),
            dropped: *scene.dropped(),
            notes: scene.notes(),
            norms: scene.quaternion_norms(),
            unread: unread(breakdown),
            after_rows: after_rows(scene),
            comments: breakdown.comments.iter().map(|comment| format!("`{comment}`")).collect(),
        }
    }

    /// Lists what a file of `written` lacks compared with the original, one phrase per loss.
    ///
    /// Losses that no picture shows are left out.
    pub fn losses(&self, written: &Scene, format: SceneFormat) -> Vec<String> {
        let Losses { mut losses, chosen_losses, .. } = Losses::of(&[("", self)], written, format);
        losses.extend(chosen_losses);
        losses
    }

    /// Lists the data of the file that the loaded scene lacks. Comments are among them, unless they are kept.
    fn not_loaded(&self, keeps_comments: bool) -> Vec<String> {
        let mut losses = Vec::new();
        let dropped = &self.dropped;
        if dropped.total() > 0 {
            losses.push(format!("{} that cannot be drawn: {dropped}", splats(dropped.total())));
        }
        if let Some(degree) = self.notes.cut_degree {
            losses.push(format!("harmonics: cut from degree {degree} to 3, the highest that is read"));
        }
        losses.extend(self.notes.left_out());
        losses.extend(self.unread.clone());
        losses.extend(self.after_rows.clone());
        let comments = if keeps_comments { None } else { listed(&self.comments) };
        losses.extend(comments.map(|comments| format!("comments: {comments}")));
        losses
    }

    /// Describes the quaternions whose length is not 1, which a written file does not keep; `None` if there are none.
    fn lengths(&self) -> Option<String> {
        let QuaternionNorms { min, max, far_from_unit } = self.norms;
        (far_from_unit > 0).then(|| {
            let (count, min, max) = (grouped(far_from_unit), rounded(min), rounded(max));
            format!("the lengths of quaternions: {count} other than 1, in a range of {min} to {max}")
        })
    }
}

impl Losses {
    /// Collects what a file of `written` lacks compared with the original scenes, each with its name. With several
    /// scenes, a loss that concerns one of them begins with its name.
    pub fn of(originals: &[(&str, &Original)], written: &Scene, format: SceneFormat) -> Losses {
        let keeps_comments = !written.header_comments().is_empty()
            && matches!(format, SceneFormat::Ply | SceneFormat::CompressedPly);
        let mut losses = named(originals, |original| original.not_loaded(keeps_comments));
        let to = written.stored_degree();
        losses.extend(not_stored(written, format));
        // The actual step replaces the description of the format's steps.
        let positions = losses.iter().any(|loss| loss.starts_with("positions: steps"));
        let rounded = format.losses(to);
        let usual = rounded.iter().filter(|usual| !(positions && usual.starts_with("positions:")));
        let from = originals.iter().map(|(_, original)| original.degree).max().unwrap_or(to);
        let cut = (to < from).then(|| format!("harmonics: cut from degree {from} to {to}"));
        let usual = usual.map(|usual| (*usual).to_owned());
        let chosen_losses = cut.into_iter().chain(clipped(written, format)).chain(usual).collect();
        let mut invisible_losses = Vec::new();
        // Activation rounds values that a format without rounding could store.
        if rounded.is_empty() {
            invisible_losses = named(originals, |original| original.lengths().into_iter().collect());
            if originals.iter().any(|(_, original)| original.format.starts_with("ply,")) {
                invisible_losses.extend(inexact(written, format));
            }
        }
        Losses { losses, chosen_losses, invisible_losses }
    }
}

/// Lists the data of several files that their loaded scenes lack, and their comments.
pub fn not_loaded(originals: &[(&str, &Original)]) -> Vec<String> {
    named(originals, |original| original.not_loaded(false))
}

/// Lists losses of each scene, after its name if there are several scenes.
fn named(originals: &[(&str, &Original)], of: impl Fn(&Original) -> Vec<String>) -> Vec<String> {
    let prefixed = |(name, original): &(&str, &Original)| {
        let name = if originals.len() > 1 { format!("{name}: ") } else { String::new() };
        of(original).into_iter().map(move |loss| format!("{name}{loss}")).collect::<Vec<_>>()
    };
    originals.iter().flat_map(prefixed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Splat;

    fn splat(position: [f32; 3]) -> Splat {
        let rotation = [1.0, 0.0, 0.0, 0.0];
        Splat { position, scale: [0.1; 3], rotation, opacity: 0.5, sh: [0.0; 48] }
    }

    fn spread(index: usize) -> [f32; 3] {
        [0.01 * index as f32, 1.0, 0.02 * index as f32]
    }

    #[test]
    fn hidden_splats_of_a_file_are_noted() {
        let hidden = FileNotes { splats_elsewhere: 2, ..FileNotes::default() };
        let scene = Scene::generate(10, 0, |index| splat(spread(index))).with_notes(hidden);
        let expected =
            "left out: primitives of splats outside the default scene or hidden: 2; they are not read";
        assert_eq!(notes(&scene), [expected]);
    }

    #[test]
    fn a_splat_that_makes_the_steps_of_all_positions_coarser_is_reported_with_the_step() {
        let positions = |scene: &Scene| {
            let losses = Original::of(scene).losses(scene, SceneFormat::Spz);
            losses.into_iter().filter(|loss| loss.starts_with("positions:")).collect::<Vec<_>>()
        };
        let near = Scene::generate(1000, 0, |index| splat(spread(index)));
        assert_eq!(positions(&near), ["positions: steps of 1/4096, or of more in a scene beyond 2048 units"]);
        let floater = |index| splat(if index == 7 { [1e6, 0.0, 0.0] } else { spread(index) });
        assert_eq!(
            positions(&Scene::generate(1000, 0, floater)),
            [
                "positions: steps of 1/8, not 1/4096, because a coordinate is 1000000: 1 splat is beyond 2048; \
              with `--crop box:-2048,-2048,-2048,2048,2048,2048`, which drops them, it is 1/4096"
            ]
        );
        let far = near.with_offset([500_000.0, 4_100_000.0, 0.0]);
        assert_eq!(
            positions(&far),
            ["positions: steps of 1/2, not 1/4096, because a coordinate is 4100001: \
              the scene is far from the origin; `--transform move:-500005,-4100001,-10` moves it there"]
        );
        let rounded = missing(&far, SceneFormat::Splat);
        let advice =
            ": the scene is far from the origin; `--transform move:-500005,-4100001,-10` moves it there";
        assert!(rounded[0].starts_with("positions: rounded to 32 bits, by 1.5e-2 at most"), "{rounded:?}");
        assert!(rounded[0].ends_with(advice), "{rounded:?}");
        let small = |size: f32| {
            let scaled = |index| {
                let splat = splat(spread(index));
                Splat {
                    position: splat.position.map(|v| size * v),
                    scale: splat.scale.map(|v| size * v),
                    ..splat
                }
            };
            positions(&Scene::generate(1000, 0, scaled))
        };
        assert_eq!(
            small(1e-3),
            ["positions: steps of 1/4096, but half of the splats have a deviation of at most 1.000e-4; \
              `--transform scale:100` enlarges the scene"]
        );
        assert!(
            small(0.01)[0].ends_with("at most 0.001; `--transform scale:10` enlarges the scene"),
            "4 steps are few"
        );
        assert!(
            small(0.1)[0].ends_with("in a scene beyond 2048 units"),
            "the steps are smaller than the splats"
        );
        let large = Scene::generate(1000, 0, |index| splat(spread(index).map(|v| 500.0 * v)));
        assert_eq!(
            positions(&large),
            ["positions: steps of 1/512, not 1/4096, because a coordinate is 9990"]
        );
    }

    #[test]
    fn tiles_that_are_too_far_apart_for_the_steps_of_a_format_are_reported() {
        let tiles = |distance: f32| {
            Scene::generate(3000, 0, |index| {
                let at = |k: usize| (index * k % 1000) as f32 * 1e-3 + distance * (index / 1000) as f32;
                Splat { scale: [0.01; 3], ..splat([7, 13, 29].map(at)) }
            })
        };
        let positions = |distance: f32, format: SceneFormat| {
            let losses = Original::of(&tiles(distance)).losses(&tiles(distance), format);
            losses.into_iter().filter(|loss| loss.starts_with("positions")).collect::<Vec<_>>()
        };
        let parts = "; write the scene in parts (`--crop`), one file for each";
        assert_eq!(
            positions(1000.0, SceneFormat::Sog),
            [format!("positions: steps of up to 2.3e-1, larger than the deviations of 2,000 splats{parts}")]
        );
        // Only the chunks with splats of two tiles are coarse.
        let packed = positions(1000.0, SceneFormat::CompressedPly);
        assert!(
            packed[0].starts_with("positions: steps of up to 9.8e-1, larger than the deviations of 512"),
            "{packed:?}"
        );
        assert!(positions(0.0, SceneFormat::Sog)[0].starts_with("positions: 16 bits per axis"));
        assert!(positions(0.0, SceneFormat::CompressedPly)[0].starts_with("positions and scales: 10 or 11"));
    }

    #[test]
    fn bands_without_a_value_are_reported_where_they_take_bytes() {
        let scene = Scene::generate(10, 3, |index| splat(spread(index)));
        let said = |format| empty_bands(&scene, format);
        let text = |bytes| format!("the bands above 0 are all zero: `--degree 0` saves {bytes} bytes");
        assert_eq!(said(SceneFormat::Ply), Some(text("1,800")));
        let rounded = ", and keeps them zero, which the format rounds to 1/64";
        assert_eq!(said(SceneFormat::CompressedPly), Some(text("450") + rounded));
        assert_eq!(said(SceneFormat::Spz), None);
        assert_eq!(empty_bands(&scene.cut_to_degree(0).unwrap(), SceneFormat::Ply), None);
    }

    #[test]
    fn a_lost_up_direction_is_reported_with_the_rotation_that_makes_up_for_it() {
        let lost = |up| {
            let notes = FileNotes { up: Some(up), ..FileNotes::default() };
            let scene = Scene::generate(10, 0, |index| splat(spread(index))).with_notes(notes);
            missing(&scene, SceneFormat::Spz)
        };
        let said = |text: &str, rotation: &str| {
            [format!("{text}; `convert --transform rotate:{rotation}` turns it upright")]
        };
        let side = "the tag up 0,0,1: without it, the scene lies on its side";
        assert_eq!(lost([0.0, 0.0, 1.0]), said(side, "1,0,0,90"));
        let down = "the tag up 0,1,0: without it, the scene is shown upside down";
        assert_eq!(lost([0.0, 1.0, 0.0]), said(down, "1,0,0,180"));
        assert!(lost([0.0, -1.0, 0.0]).is_empty(), "readers assume it");
        let notes = FileNotes { up: Some([0.0, 0.0, 1.0]), ..FileNotes::default() };
        let far = Scene::generate(10, 0, |index| splat(spread(index))).with_offset([5e5, 5.4e6, 0.0]);
        let both = missing(&far.with_notes(notes), SceneFormat::Spz);
        assert!(
            both[0].contains("--transform move:") && both[1].starts_with(side),
            "the order of the steps: {both:?}"
        );
    }

    #[test]
    fn values_that_a_format_clips_are_counted() {
        let scene = Scene::generate(10, 1, |index| {
            let mut splat = splat(spread(index));
            match index {
                1 => splat.scale = [25f32.exp(), 1.0, 1e-6],
                2 => splat.sh[..3].copy_from_slice(&[3.4, 1.8, -1.7]),
                3 => splat.sh[3..5].copy_from_slice(&[1.5, -4.5]),
                _ => {}
            }
            splat
        });
        let colors = "clipped, too dark or too bright for the format";
        assert_eq!(
            missing(&scene, SceneFormat::Spz),
            [
                "scales: 1 clipped to e^5.9375",
                "scales: 1 enlarged to e^-10",
                &format!("colour channels: 1 {colors}"),
                "coefficients of harmonics: 2 clipped to 1 or -1",
            ]
        );
        assert_eq!(
            missing(&scene, SceneFormat::CompressedPly),
            ["scales: 1 clipped to e^20", "coefficients of harmonics: 1 clipped to 4 or -4"]
        );
        assert_eq!(missing(&scene, SceneFormat::Splat), [format!("colour channels: 2 {colors}")]);
        assert!(missing(&scene, SceneFormat::Ply).is_empty());
    }
}
