//! Writes scene files: the format follows from the file's extension, bytes are counted, and losses are listed.

use super::output::{self, OutputError};
use splatgraph_assets::{
    Dropped, FileNotes, Progress, QuaternionNorms, Scene, SceneFormat, SizeBreakdown, SortKey, SpzVersion,
    grouped, sh_floats,
};
use std::io::{self, Write};
use std::path::Path;

/// Returns the format of a file to write, by its extension.
///
/// # Errors
/// The extension is not the usual one of a format that can be written.
pub fn format_of(path: &Path) -> Result<SceneFormat, String> {
    let named = SceneFormat::of_name(path).filter(|format| SceneFormat::WRITTEN.contains(format));
    let format = named.ok_or_else(|| {
        let endings = SceneFormat::list(&SceneFormat::WRITTEN);
        format!("expected a file name that ends in {endings}, found {}", path.display())
    })?;
    // Other extensions name other forms of the format: `.gltf` is JSON.
    let usual = format.extension();
    if !path.to_string_lossy().to_ascii_lowercase().ends_with(&format!(".{usual}")) {
        return Err(format!(
            "expected a file name that ends in .{usual}, the form that is written, found {}; name it {}",
            path.display(),
            path.with_extension(usual).display()
        ));
    }
    Ok(format)
}

/// Writes a scene in a format, and returns the number of bytes; `-` is standard output.
///
/// `version` applies only to [`SceneFormat::Spz`]; `progress` is then not called.
///
/// # Errors
/// The file cannot be written. An existing file is then kept.
pub fn write(
    scene: &Scene,
    format: SceneFormat,
    version: Option<SpzVersion>,
    progress: Progress,
    path: &Path,
) -> Result<u64, OutputError> {
    let mut bytes = 0;
    output::write(path, |out| fill(scene, format, version, progress, out).map(|count| bytes = count))?;
    Ok(bytes)
}

/// Writes a scene to a new file in a format, and returns the number of bytes.
///
/// # Errors
/// The file exists, even if it was created meanwhile, or it cannot be written.
pub fn write_new(
    scene: &Scene,
    format: SceneFormat,
    progress: Progress,
    path: &Path,
) -> Result<u64, OutputError> {
    let mut bytes = 0;
    output::write_new(path, |out| fill(scene, format, None, progress, out).map(|count| bytes = count))?;
    Ok(bytes)
}

fn fill(
    scene: &Scene,
    format: SceneFormat,
    version: Option<SpzVersion>,
    progress: Progress,
    out: &mut dyn Write,
) -> Result<u64, output::file::Cause> {
    let mut counted = Counted { out, bytes: 0 };
    match version {
        Some(version) if format == SceneFormat::Spz => scene.write_spz(version, &mut counted)?,
        _ => scene.write(format, progress, &mut counted)?,
    }
    Ok(counted.bytes)
}

struct Counted<'a> {
    out: &'a mut dyn Write,
    bytes: u64,
}

impl Write for Counted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

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
    /// Names the properties and elements that are not read.
    unread: Option<String>,
}

/// Opacity, of the logit 9.9, above which the logit of the nearest float can be off by almost 0.001.
const NEARLY_OPAQUE: f32 = 0.99995;

/// Maximum number of properties to name.
const NAMED: usize = 8;

/// Names the file's properties and elements that are not read; `None` if there are none. Normals do not count: splats
/// have none, and writers of splats fill them with zeros.
fn unread(breakdown: &SizeBreakdown) -> Option<String> {
    let mut names = Vec::new();
    for element in &breakdown.elements {
        let unused: Vec<&str> =
            element.fields.iter().filter(|field| !field.used).map(|field| &*field.name).collect();
        if !unused.is_empty() && unused.len() == element.fields.len() {
            names.push(format!("element {}", element.name));
        } else {
            let others = unused.into_iter().filter(|name| !["nx", "ny", "nz"].contains(name));
            names.extend(others.map(str::to_owned));
        }
    }
    let more = names.len().saturating_sub(NAMED);
    let others = if more > 0 { format!(" and {more} others") } else { String::new() };
    let named = names[..names.len() - more].join(", ");
    (!names.is_empty()).then(|| format!("properties that splats do not have: {named}{others}"))
}

/// Lists what a file of a scene lacks, one phrase per loss, except for the rounding that the format always does.
pub fn missing(scene: &Scene, format: SceneFormat) -> Vec<String> {
    let mut losses = Vec::new();
    let kept = format.kept_tags(scene.notes()).tags();
    let lost = scene.notes().tags().into_iter().filter(|tag| !kept.contains(tag));
    losses.extend(lost.map(|(tag, value)| match kept.iter().find(|(other, _)| *other == tag) {
        Some((_, other)) => format!("the tag {tag} {value}: the file has {other} instead, another rule"),
        None => format!("the tag {tag} {value}"),
    }));
    if format == SceneFormat::Gltf && scene.notes().key_of == SortKey::Depth {
        losses.push("the order by depth: the format only supports order by distance from the camera".into());
    }
    let rounding = scene.position_rounding(format);
    if rounding > 0.0 {
        losses.push(format!("positions: rounded to 32 bits, by {rounding:.1e} at most"));
    }
    let largest = match format {
        SceneFormat::Spz => 1.0,
        SceneFormat::CompressedPly => 4.0,
        _ => f32::INFINITY,
    };
    let above = scene.sh().chunks_exact(sh_floats(scene.stored_degree())).flat_map(|sh| &sh[3..]);
    let clipped = above.filter(|value| value.abs() > largest).count() as u64;
    if clipped > 0 {
        losses.push(format!("harmonics: {} coefficients beyond {largest} are clipped", grouped(clipped)));
    }
    if let Some(mesh) = scene.mesh() {
        losses.push(format!("the mesh: {} triangles", grouped(mesh.triangles.len() as u64)));
    }
    losses
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
        }
    }

    /// Lists what a file of `written` lacks compared with the original, one phrase per loss.
    pub fn losses(&self, written: &Scene, format: SceneFormat) -> Vec<String> {
        let mut losses = Vec::new();
        let dropped = &self.dropped;
        if dropped.total() > 0 {
            losses.push(format!("{} splats that cannot be drawn: {dropped}", grouped(dropped.total())));
        }
        if let Some(degree) = self.notes.cut_degree {
            losses.push(format!("harmonics: cut from degree {degree} to 3, the highest that is read"));
        }
        losses.extend(self.notes.left_out());
        losses.extend(self.unread.clone());
        let (from, to) = (self.degree, written.stored_degree());
        if to < from {
            losses.push(format!("harmonics: cut from degree {from} to {to}"));
        }
        losses.extend(missing(written, format));
        let rounded = format.losses(to);
        if rounded.is_empty() {
            losses.extend(self.activated(written));
        }
        losses.extend(rounded.into_iter().map(str::to_owned));
        losses
    }

    /// Lists what activation loses, which changes no picture: it matters to training that goes on from the file.
    fn activated(&self, written: &Scene) -> Vec<String> {
        let mut losses = Vec::new();
        let QuaternionNorms { min, max, far_from_unit } = self.norms;
        if far_from_unit > 0 {
            let count = grouped(far_from_unit);
            losses.push(format!("the lengths of quaternions: {count} were not 1, but {min:.3} to {max:.3}"));
        }
        let nearly = written.opacities().iter().filter(|opacity| **opacity > NEARLY_OPAQUE).count() as u64;
        if nearly > 0 && self.format.starts_with("ply,") {
            losses.push(format!(
                "logits above 9.9, in {} splats: rounded to those of opacities in 32 bits, at most 18",
                grouped(nearly)
            ));
        }
        losses
    }
}
