//! Reads whole files of limited size.
//!
//! Most are files that the program wrote: ledgers, results of views, device facts and the viewer's state. Photographs
//! are read to hash them.

use splatgraph_assets::file;
use std::io;
use std::path::Path;

/// Maximum size of a file, in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// Reads a file.
///
/// # Errors
/// See [`file::read`]; for example, the file is not a regular one, or it is larger than 1 GiB.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    file::read(path, MAX_BYTES)
}
