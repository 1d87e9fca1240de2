//! Writes scene files: the format follows from the file's extension, bytes are counted, and losses are listed.

use super::output::{self, OutputError};
use splatgraph_assets::{
    Dropped, FileNotes, Progress, Scene, SceneFormat, SortKey, SpzVersion, grouped, sh_floats,
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
        let (from, to) = (self.degree, written.stored_degree());
        if to < from {
            losses.push(format!("harmonics: cut from degree {from} to {to}"));
        }
        let kept = format.kept_tags(written.notes()).tags();
        let lost = written.notes().tags().into_iter().filter(|tag| !kept.contains(tag));
        losses.extend(lost.map(|(tag, value)| match kept.iter().find(|(other, _)| *other == tag) {
            Some((_, other)) => format!("the tag {tag} {value}: the file has {other} instead, another rule"),
            None => format!("the tag {tag} {value}"),
        }));
        if format == SceneFormat::Gltf && written.notes().key_of == SortKey::Depth {
            losses.push(
                "the order by depth: the format only supports order by distance from the camera".into(),
            );
        }
        let rounding = written.position_rounding(format);
        if rounding > 0.0 {
            losses.push(format!("positions: rounded to 32 bits, by {rounding:.1e} at most"));
        }
        let largest = match format {
            SceneFormat::Spz => 1.0,
            SceneFormat::CompressedPly => 4.0,
            _ => f32::INFINITY,
        };
        let above = written.sh().chunks_exact(sh_floats(to)).flat_map(|sh| &sh[3..]);
        let clipped = above.filter(|value| value.abs() > largest).count() as u64;
        if clipped > 0 {
            losses.push(format!("harmonics: {} coefficients beyond {largest} are clipped", grouped(clipped)));
        }
        if let Some(mesh) = written.mesh() {
            losses.push(format!("the mesh: {} triangles", grouped(mesh.triangles.len() as u64)));
        }
        losses.extend(format.losses(to).into_iter().map(str::to_owned));
        losses
    }
}
