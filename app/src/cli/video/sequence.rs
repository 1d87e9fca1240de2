//! Numbers the pictures of a film in a folder, and finds the missing ones.
//!
//! `film.json` records the inputs that determine the pictures' pixels. Each picture is either complete or absent.
//! Therefore, pictures in a folder with an equal record need not be drawn again.

use crate::io::image::{Format, Image, ImageError};
use crate::io::output::{self, Claim, say};
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde_json::Value;
use std::path::{Path, PathBuf};

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

    /// Lists the frames without a complete picture of this size, and writes the record if there is none.
    ///
    /// # Errors
    /// The folder holds frames of another film, or the record cannot be read or written.
    pub fn missing(&self, record: &Value, frames: u32, size: (u32, u32)) -> Result<Vec<u32>> {
        self.claim(record, frames)?;
        let size = (size.0 as usize, size.1 as usize);
        let is_whole = |frame: &u32| {
            let path = self.picture(*frame);
            Image::header(&path).is_ok_and(|found| found.size == size)
                && Image::is_whole(&path).unwrap_or(false)
        };
        Ok((0..frames).into_par_iter().filter(|frame| !is_whole(frame)).collect())
    }

    /// Writes the record into the folder, or checks that the folder has an equal one.
    fn claim(&self, record: &Value, frames: u32) -> Result<()> {
        let file = self.record();
        let picture = || (0..frames).map(|frame| self.picture(frame)).find(|path| path.exists());
        let found = match output::claim(&file, format!("{record:#}\n").as_bytes(), picture)? {
            Claim::Written => return Ok(()),
            Claim::Found(found) => found,
            Claim::Stray(path) => bail!(
                "expected film.json beside {}, which describes the film: name another folder, or remove this one",
                path.display()
            ),
        };
        let found: Value = serde_json::from_slice(&found).with_context(|| file.display().to_string())?;
        if let Some(difference) = difference(&found, record) {
            bail!(
                "{} belongs to another film ({difference}): name another folder, or remove this one",
                file.display()
            );
        }
        Ok(())
    }
}

/// Describes the first difference between two records; `None` if they are equal.
fn difference(found: &Value, wanted: &Value) -> Option<String> {
    let keys = |record: &Value| record.as_object().map(|all| all.keys().cloned().collect::<Vec<_>>());
    let all = [keys(wanted), keys(found)].into_iter().flatten().flatten();
    let differs = |key: &String| found[key.as_str()] != wanted[key.as_str()];
    all.into_iter()
        .find(differs)
        .map(|key| format!("{key} is {} there and {} here", found[key.as_str()], wanted[key.as_str()]))
}
