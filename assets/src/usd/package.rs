//! Finds the layer of an archive: the first file of an uncompressed ZIP archive.

use super::layer::Bytes;
use crate::error::{SceneError, wrong};
use crate::input::{self, Source};
use crate::sog::MAGIC;
use std::io::{self, Read};
use zip::CompressionMethod;
use zip::read::ZipFile;

/// Returns true if the bytes begin a ZIP archive whose first file has the name of a layer.
pub(crate) fn begins_as_package(head: &[u8]) -> bool {
    let length = head.get(26..28).map_or(0, |bytes| usize::from(u16::from_le_bytes([bytes[0], bytes[1]])));
    let name = head.get(30..30 + length).unwrap_or_default().to_ascii_lowercase();
    let is_layer = [&b".usd"[..], b".usda", b".usdc"].iter().any(|end| name.ends_with(end));
    head.starts_with(MAGIC) && is_layer
}

/// Returns true if a file of an archive is neither compressed nor encrypted.
fn is_plain(file: &ZipFile<impl Read>) -> bool {
    file.compression() == CompressionMethod::Stored && !file.encrypted()
}

/// Checks the checksum of the layer in an archive. Does nothing for other files, and for layers that [`layer`] refuses.
pub(super) fn check(source: &Source) -> Result<(), SceneError> {
    if source.head(MAGIC.len())? != MAGIC {
        return Ok(());
    }
    let mut zip = input::archive(source)?;
    if !zip.by_index_raw(0).is_ok_and(|file| is_plain(&file)) {
        return Ok(());
    }
    // The reader compares the checksum at the end of the file.
    let read =
        zip.by_index(0).map_err(io::Error::from).and_then(|mut file| io::copy(&mut file, &mut io::sink()));
    read.map(drop).map_err(|error| wrong("zip", format!("expected an intact layer, found damage: {error}")))
}

/// Finds the bytes of the layer; in an archive, also returns the layer's name.
pub(super) fn layer<'a>(source: &'a Source<'a>) -> Result<(Bytes<'a>, Option<String>), SceneError> {
    if source.head(MAGIC.len())? != MAGIC {
        return Ok((Bytes::new(*source), None));
    }
    let mut zip = input::archive(source)?;
    let file = zip
        .by_index_raw(0)
        .map_err(|error| wrong("zip", format!("expected a readable file of the archive, found: {error}")))?;
    let name: String = String::from_utf8_lossy(file.name_raw()).chars().take(60).collect();
    if !is_plain(&file) {
        return Err(wrong(name, "expected an uncompressed file, as the format requires, found another"));
    }
    let (start, length) = (file.data_start(), file.size());
    let end = start.and_then(|start| start.checked_add(length));
    match (start, end) {
        (Some(start), Some(end)) if end <= source.length() => {
            Ok((Bytes::new(source.part(start, length)), Some(name)))
        }
        _ => Err(wrong(name, "expected a file in the archive, found its end")),
    }
}
