//! Numbers the pictures of a film in a folder, and finds the missing ones.
//!
//! `film.json` records the frame rate and the inputs that determine the pictures' pixels. Each picture is either
//! complete or absent. Therefore, pictures in a folder with an equal record need not be drawn again.

use crate::io::image::{Format, Image, ImageError};
use crate::io::output::{self, Claim, names, say};
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Name of the frame rate in the record. The pictures do not depend on it.
pub const FPS: &str = "fps";

#[derive(Clone, Debug)]
pub struct Sequence {
    folder: PathBuf,
    format: Format,
}

impl Sequence {
    pub fn new(folder: &Path, format: Format) -> Sequence {
        Sequence { folder: folder.to_owned(), format }
    }

    pub fn record(&self) -> PathBuf {
        self.folder.join("film.json")
    }

    pub fn picture(&self, frame: u32) -> PathBuf {
        self.folder.join(format!("{frame:05}.{}", self.format))
    }

    /// Saves a frame. Reports its pixels that the format cannot hold.
    pub fn save(&self, frame: u32, image: &Image) -> Result<(), ImageError> {
        let path = self.picture(frame);
        let not_finite = image.save_as(self.format, &path)?;
        not_finite.and_then(|found| found.note(path.display())).iter().for_each(say);
        Ok(())
    }

    /// Describes the pictures in the folder that are not of a film with so many frames; `None` if there are none.
    pub fn others(&self, frames: u32) -> Option<String> {
        let own = (0..frames).map(|frame| self.picture(frame)).collect();
        names::others(&self.folder, &self.format.to_string(), &own)
    }

    /// Lists those of `frames` that have no complete picture of this size.
    pub fn missing(&self, frames: &[u32], size: (u32, u32)) -> Vec<u32> {
        let size = (size.0 as usize, size.1 as usize);
        let is_whole = |frame: &u32| {
            let path = self.picture(*frame);
            Image::header(&path).is_ok_and(|found| found.size == size)
                && Image::is_whole(&path).unwrap_or(false)
        };
        frames.par_iter().copied().filter(|frame| !is_whole(frame)).collect()
    }

    /// Writes the record into the folder, or checks that the folder has an equal one, except for the frame rate.
    ///
    /// # Errors
    /// The folder holds frames of another film, or the record cannot be read or written.
    pub fn claim(&self, record: &Value, frames: u32) -> Result<()> {
        let file = self.record();
        let picture = || (0..frames).map(|frame| self.picture(frame)).find(|path| path.exists());
        let text = format!("{record:#}\n");
        let found = match output::claim(&file, text.as_bytes(), picture)? {
            Claim::Written => return Ok(()),
            Claim::Found(found) => found,
            Claim::Stray(path) => bail!(
                "expected film.json beside {}, which describes the film: remove the folder, or name another",
                path.display()
            ),
        };
        let found: Value = serde_json::from_slice(&found).with_context(|| file.display().to_string())?;
        if let Some(difference) = difference(&found, record) {
            bail!(
                "{} belongs to another film ({difference}): remove the folder, or name another",
                file.display()
            );
        }
        if found[FPS] != record[FPS] {
            output::write_bytes(&file, text.as_bytes())?;
        }
        Ok(())
    }
}

/// Describes the first difference between two records, except for the frame rate; `None` if there is none.
fn difference(found: &Value, wanted: &Value) -> Option<String> {
    let keys = |record: &Value| record.as_object().map(|all| all.keys().cloned().collect::<Vec<_>>());
    let all = [keys(wanted), keys(found)].into_iter().flatten().flatten();
    let differs = |key: &String| key != FPS && found[key.as_str()] != wanted[key.as_str()];
    all.into_iter()
        .find(differs)
        .map(|key| format!("{key} is {} there and {} here", found[key.as_str()], wanted[key.as_str()]))
}
