//! Encodes paths for URIs.

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_encode};
use std::path::Path;

/// Bytes that are percent-encoded in a URI's path: all but the slash and RFC 3986's unreserved characters.
const RESERVED: &AsciiSet =
    &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~').remove(b'/');

/// Percent-encodes a path, whose bytes need not be UTF-8.
pub fn encoded(path: &Path) -> String {
    percent_encode(path.as_os_str().as_encoded_bytes(), RESERVED).to_string()
}
