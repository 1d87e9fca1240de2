//! Writes scene files: the format follows from the file's extension, and bytes are counted.

use super::output::{self, OutputError};
use splatgraph_assets::{Progress, Scene, SceneFormat, SpzVersion};
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
/// `version` is that of [`SceneFormat::Spz`], `None` for its default; other formats ignore it. Only
/// [`SceneFormat::Sog`] calls `progress`.
///
/// # Errors
/// The file cannot be written, the format cannot store the scene (see [`Scene::write`]), or `progress` cancels. An
/// existing file is then kept.
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

/// Writes a scene to a new file in a format, as [`write()`] does, and returns the number of bytes.
///
/// # Errors
/// Those of [`write()`]; also, the file exists, even if it was created meanwhile.
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
