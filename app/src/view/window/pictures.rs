//! Saves pictures of the window and of A, by default under numbered names in the working directory.

use crate::draw::session::image_of;
use crate::io::output::names;
use anyhow::Result;
use splatgraph_api::Pixels;
use std::path::{Path, PathBuf};

/// Saves a picture at `path`, in the format of its extension, and returns the path. Without a `path`, saves a new PNG
/// file named `stem` with a number.
///
/// # Errors
/// The picture has no colours, or the file cannot be written.
pub fn save(pixels: &Pixels, path: Option<&Path>, stem: &str) -> Result<PathBuf> {
    let image = image_of(pixels)?;
    match path {
        Some(path) => Ok(image.save(path).map(|()| path.to_owned())?),
        None => Ok(names::write_first_free(numbered(stem, "png"), &image.png()?)?),
    }
}

/// Returns the first of `STEM-1.EXTENSION`, `STEM-2.EXTENSION`, ... that does not exist yet.
pub fn fresh_name(stem: &str, extension: &str) -> PathBuf {
    names::first_free(numbered(stem, extension))
}

fn numbered(stem: &str, extension: &str) -> impl Fn(u32) -> PathBuf {
    move |number| PathBuf::from(format!("{stem}-{number}.{extension}"))
}
