//! Resolves the URIs of a glTF document: base 64 in the document, or a file beside it.

use crate::file;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::percent_decode_str;
use std::path::{Path, PathBuf};

/// The bytes that a URI refers to.
pub(crate) enum Resource {
    /// Bytes in the document's text.
    Data(Vec<u8>),
    /// A file in the folder of the document.
    File(PathBuf),
}

/// Shortens a URI for a message.
pub(crate) fn shown(uri: &str) -> String {
    uri.chars().take(60).collect()
}

/// Decodes a data URI, or resolves a file in `folder`. Fails with a message for other schemes and folders.
pub(crate) fn resolve(uri: &str, folder: Option<&Path>) -> Result<Resource, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, text) = data.split_once(";base64,").ok_or("expected a data URI in base 64")?;
        let bytes = STANDARD.decode(text).map_err(|error| format!("expected base64, found: {error}"))?;
        return Ok(Resource::Data(bytes));
    }
    if uri.contains(':') {
        return Err(format!(
            "expected a file beside the document, found the address {}: only files are read",
            shown(uri)
        ));
    }
    // Decoded before it is checked: `%2E%2E%2F` is `../`.
    let name = percent_decode_str(uri).decode_utf8_lossy();
    let path = file::beside(folder, &name).map(Resource::File);
    path.ok_or_else(|| format!("expected a file in the folder of the document, found {}", shown(uri)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::says;

    #[test]
    fn names_are_decoded_before_their_place_is_checked() {
        let folder = Path::new("/scenes");
        let file = |uri: &str| match resolve(uri, Some(folder)) {
            Ok(Resource::File(path)) => path.display().to_string(),
            Ok(Resource::Data(bytes)) => format!("{bytes:?}"),
            Err(error) => error,
        };
        assert_eq!(file("my%20buf.bin"), "/scenes/my buf.bin");
        assert_eq!(file("my buf.bin"), "/scenes/my buf.bin");
        assert_eq!(file("data:application/octet-stream;base64,AQI="), "[1, 2]");
        for uri in ["../a.bin", "%2E%2E/a.bin", "%2Fetc/passwd", "a/%2e%2e%2Fb"] {
            assert!(file(uri).contains("in the folder of the document"), "{uri}: {}", file(uri));
        }
        says(file("file:///a.bin"), "only files are read");
        says(file("data:,text"), "in base 64");
    }
}
