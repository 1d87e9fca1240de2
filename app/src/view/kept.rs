//! Saves the window's layout for the next start: tools, texts over the picture, theme, text size, and recently opened
//! scenes.
//!
//! The state is a JSON file in the user's state folder.

use super::panels::{Arrangement, Panels};
use crate::io::folders;
use crate::io::{output, own_file};
use egui::{Context, Theme};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Version of the file format; files of other versions are rejected.
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    version: u32,
    light: bool,
    arrangement: Arrangement,
}

/// Returns the path of the state file; `None` if the user has no folder for application state.
pub fn path() -> Option<PathBuf> {
    Some(folders::state()?.join("splatgraph/window.json"))
}

/// Restores the panels, and theme and text size of `ctx`; does nothing if there is no file.
///
/// # Errors
/// The file exists but cannot be used; nothing is changed then.
pub fn restore(path: &Path, panels: &mut Panels, ctx: &Context) -> Result<(), String> {
    let text = match own_file::read(path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(format!("{}: {error}", path.display())),
    };
    let kept: Kept = serde_json::from_slice(&text).map_err(|error| format!("{}: {error}", path.display()))?;
    if kept.version != VERSION {
        return Err(format!("{}: expected version {VERSION}, found {}", path.display(), kept.version));
    }
    if !panels.restore(kept.arrangement, ctx) {
        return Err(format!("{}: expected each tool once", path.display()));
    }
    ctx.set_theme(if kept.light { Theme::Light } else { Theme::Dark });
    Ok(())
}

/// Writes the state file, unless its content would not change.
///
/// # Errors
/// The file cannot be written; the previous one stays.
pub fn keep(path: &Path, panels: &Panels, ctx: &Context) -> Result<(), String> {
    let (light, arrangement) = (ctx.theme() == Theme::Light, panels.arrangement(ctx));
    let kept = Kept { version: VERSION, light, arrangement };
    let text = serde_json::to_string_pretty(&kept).map_err(|error| error.to_string())?;
    if own_file::read(path).is_ok_and(|former| former == text.as_bytes()) {
        return Ok(());
    }
    output::write(path, |out| out.write_all(text.as_bytes()).map_err(Into::into))
        .map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::panels::Tool;
    use std::fs;

    #[test]
    fn the_arrangement_of_the_window_is_there_again_at_the_next_start() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/window.json");
        let (mut panels, ctx) = (Panels::new(), Context::default());
        assert_eq!(restore(&path, &mut panels, &ctx), Ok(()), "nothing was kept before the first start");
        assert!(!panels.is_restored());
        panels.open_tools(&[Tool::Timeline, Tool::Inspector]);
        panels.hud = false;
        ctx.set_theme(Theme::Light);
        keep(&path, &panels, &ctx).unwrap();
        ctx.set_theme(Theme::Dark);
        let mut next = Panels::new();
        assert_eq!(restore(&path, &mut next, &ctx), Ok(()));
        assert_eq!(ctx.theme(), Theme::Light);
        let all = |panels: &Panels| serde_json::to_value(panels.arrangement(&ctx)).unwrap();
        assert_eq!(all(&next), all(&panels));
        assert_ne!(all(&next), all(&Panels::new()));
    }

    #[test]
    fn a_file_that_cannot_be_used_is_told_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("window.json");
        let (mut panels, ctx) = (Panels::new(), Context::default());
        let before = serde_json::to_value(panels.arrangement(&ctx)).unwrap();
        keep(&path, &panels, &ctx).unwrap();
        let sound = fs::read_to_string(&path).unwrap();
        let cut = sound.trim_end().strip_suffix('}').expect("an object");
        let twice = sound.replacen("\"Inspector\"", "\"Times\"", 1);
        assert_ne!(twice, sound);
        for (text, expected) in [
            ("{", "EOF"),
            (cut, "EOF"),
            (&sound.replace("\"version\": 1", "\"version\": 7"), "expected version 1, found 7"),
            (&twice, "expected each tool once"),
        ] {
            fs::write(&path, text).unwrap();
            let error = restore(&path, &mut panels, &ctx).unwrap_err();
            assert!(error.contains("window.json") && error.contains(expected), "{error}");
            assert_eq!(serde_json::to_value(panels.arrangement(&ctx)).unwrap(), before);
        }
    }
}
