//! Identifies the build of the program, on which its numbers and pictures depend.

use super::report::text;
use splatgraph_assets::file;
use std::fs::File;
use std::io;
use std::path::PathBuf;
use std::sync::OnceLock;

/// Version of the program, with the commit if it was known when the program was built.
pub const VERSION: &str = env!("SPLATGRAPH_VERSION");

/// The file that contains this code; unset if it is the process's executable.
static FILE: OnceLock<PathBuf> = OnceLock::new();

/// Sets the file that contains this code, for a library loaded by an interpreter. Only the first call has an effect.
pub fn set(file: PathBuf) {
    let _ = FILE.set(file);
}

/// Hashes the file that contains this code; returns 16 hexadecimal digits.
///
/// # Errors
/// The file cannot be read.
pub fn hash() -> io::Result<String> {
    let file = match FILE.get() {
        Some(file) => File::open(file)?,
        // On Linux, the link leads to the running program, even if its file was replaced.
        None => File::open("/proc/self/exe").or_else(|_| File::open(std::env::current_exe()?))?,
    };
    file::hash(file).map(text::hex)
}
