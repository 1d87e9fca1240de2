//! Reads files that the program writes and reads again: ledgers, results of views, statistics, selections of devices.

use splatgraph_assets::file;
use std::io;
use std::path::Path;

/// Maximum size of such a file, in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// Reads a file.
///
/// # Errors
/// The errors of [`file::read`]: among others, the file is not a regular one, or it is longer than 1 GiB.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    file::read(path, MAX_BYTES)
}
