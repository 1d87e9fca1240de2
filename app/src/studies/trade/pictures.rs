//! Stores the pictures of a ledger in a folder next to its file, for its page.
//!
//! For each setting, these are the picture farthest from the truth, the truth, and their amplified difference, scaled
//! down.

use super::ledger::Ledger;
use super::measure::Row;
use crate::io::image::{Image, ImageError};
use crate::io::output::names::{MAX_NAME_BYTES, unique};
use crate::io::output::{self, OutputError};
use crate::io::own_file;
use crate::io::report::page::Linked;
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use rayon::prelude::*;
use splatgraph_reference::metrics::squared_error;
use std::path::{Path, PathBuf};

/// Maximum width of a stored picture, in pixels.
const WIDTH: usize = 640;
/// Root mean square to which differences are amplified.
const VISIBLE: f64 = 1.0 / 16.0;
/// Name of the folder with the pictures.
pub const FOLDER: &str = "pictures";

/// The folder with a ledger's pictures; the default stores nothing.
#[derive(Default)]
pub struct Album {
    folder: Option<PathBuf>,
}

impl Album {
    /// Returns the album next to the ledger in this file.
    pub fn beside(ledger: &Path) -> Album {
        Album { folder: Some(ledger.with_file_name(FOLDER)) }
    }

    /// Stores a picture, the truth and their difference, unless another view is as far from the truth.
    ///
    /// Only views of the row's setting are compared. Does nothing without a folder, or for a row without measurements.
    /// Call it before the row is added to the ledger.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn keep(&self, ledger: &Ledger, row: &Row, picture: &Image, truth: &Image) -> Result<(), ImageError> {
        let (Ok(found), Some(folder)) = (&row.found, &self.folder) else { return Ok(()) };
        let of_row = squared_error(found.error.psnr_db);
        if ledger.farthest(&row.setting).is_some_and(|(_, psnr_db)| squared_error(psnr_db) >= of_row) {
            return Ok(());
        }
        let difference = Image::difference(picture, truth, gain(found.error.psnr_db) as f32);
        let [of_picture, of_difference] = files(&row.setting);
        let all = [(truth_file(&row.camera), truth), (of_picture, picture), (of_difference, &difference)];
        all.into_par_iter().try_for_each(|(file, image)| image.reduced(WIDTH).save(&folder.join(file)))
    }

    /// Copies the pictures of a setting in the view of `camera` from another album. Missing pictures are skipped. Does
    /// nothing if either album has no folder.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn copy(&self, from: &Album, camera: &str, setting: &str) -> Result<(), OutputError> {
        let (Some(folder), Some(from)) = (&self.folder, &from.folder) else { return Ok(()) };
        for file in files(setting).into_iter().chain([truth_file(camera)]) {
            if let Ok(bytes) = own_file::read(&from.join(&file)) {
                output::write_bytes(&folder.join(&file), &bytes)?;
            }
        }
        Ok(())
    }

    /// Lists the pictures of a setting: the drawn one, the truth and the difference. Empty if one is missing.
    pub fn of(&self, ledger: &Ledger, setting: &str) -> Vec<Linked> {
        let (Some((camera, psnr_db)), Some(folder)) = (ledger.farthest(setting), &self.folder) else {
            return Vec::new();
        };
        let [picture, difference] = files(setting);
        let gain = gain(psnr_db);
        let all = [
            (format!("`{setting}`, {camera}"), picture),
            ("the truth".to_owned(), truth_file(camera)),
            (format!("their difference, {gain} times as large"), difference),
        ];
        if all.iter().any(|(_, file)| !folder.join(file).is_file()) {
            return Vec::new();
        }
        let link = |file: &str| format!("{FOLDER}/{}", utf8_percent_encode(file, NON_ALPHANUMERIC));
        all.into_iter().map(|(caption, file)| Linked { link: link(&file), caption }).collect()
    }
}

/// Returns the power of two that amplifies a difference with this PSNR to about [`VISIBLE`]. It is 1 to 2^20, and 1 for
/// equal pictures.
fn gain(psnr_db: Option<f64>) -> f64 {
    let rms = squared_error(psnr_db).sqrt();
    if rms > 0.0 { (VISIBLE / rms).log2().round().clamp(0.0, 20.0).exp2() } else { 1.0 }
}

fn files(setting: &str) -> [String; 2] {
    [format!("{}.png", stem(setting)), format!("{}.difference.png", stem(setting))]
}

fn truth_file(camera: &str) -> String {
    format!("truth.{}.png", stem(camera))
}

fn stem(name: &str) -> String {
    const ROOM: usize = MAX_NAME_BYTES - ".difference.png".len();
    unique(&[name.to_owned()], ROOM).remove(0)
}

#[cfg(test)]
mod tests {
    use super::super::ledger::testing::{ledger, measured, row};
    use super::*;

    #[test]
    fn the_view_farthest_from_the_truth_is_kept_with_its_difference() {
        let folder = tempfile::tempdir().unwrap();
        let album = Album::beside(&folder.path().join("ledger.json"));
        let (truth, picture) =
            (Image::from_fn(4, 2, |_, _| [0.5; 3]), Image::from_fn(4, 2, |_, _| [0.51; 3]));
        let mut found = ledger(Vec::new());
        for (camera, psnr_db) in [("near", 60.0), ("far/off", 40.0), ("nearer", 70.0)] {
            let row = row("key bits #1", camera, Ok(measured(1.0, Some(psnr_db))));
            album.keep(&found, &row, &picture, &truth).unwrap();
            found.rows.push(row);
        }
        let shown = album.of(&found, "key bits #1");
        let captions: Vec<&str> = shown.iter().map(|shown| shown.caption.as_str()).collect();
        assert_eq!(captions, ["`key bits #1`, far/off", "the truth", "their difference, 8 times as large"]);
        assert_eq!(shown[2].link, "pictures/key%20bits%20%231%2Edifference%2Epng");
        let difference = Image::load(&folder.path().join("pictures/key bits #1.difference.png")).unwrap();
        assert!((difference.rgb[0][0] - 0.08).abs() < 0.002, "{:?}", difference.rgb[0]);
        assert!(!folder.path().join("pictures/truth.nearer.png").exists());
        std::fs::remove_file(folder.path().join("pictures/truth.far_off.png")).unwrap();
        assert_eq!(album.of(&found, "key bits #1"), [], "one of them is missing");
    }

    #[test]
    fn equal_pictures_are_not_amplified_and_faint_errors_are() {
        assert_eq!((gain(None), gain(Some(0.0)), gain(Some(77.0))), (1.0, 1.0, 512.0));
    }
}
