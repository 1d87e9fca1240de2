//! Reads files named by options. A pipe is allowed, for example `--keep <(jq ...)`.

use splatgraph_assets::file;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Reads a file of at most `limit` bytes: a regular file, or a pipe until its last writer closes it.
///
/// # Errors
/// See [`file::read`]; a pipe is not an error.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    if !is_pipe(path) {
        return file::read(path, limit);
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let text = format!("expected at most {limit} bytes from a pipe, found more");
        return Err(Error::new(ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

#[cfg(unix)]
fn is_pipe(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    std::fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo())
}

#[cfg(not(unix))]
fn is_pipe(_: &Path) -> bool {
    false
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_pipe_is_read_to_its_end_or_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let written_and_read = |limit| {
            std::thread::scope(|scope| {
                scope.spawn(|| std::fs::write(&pipe, "four"));
                read(&pipe, limit).map_err(|error| error.to_string())
            })
        };
        assert_eq!(written_and_read(4), Ok(b"four".to_vec()));
        assert_eq!(written_and_read(3), Err("expected at most 3 bytes from a pipe, found more".into()));
        let error = read(folder.path(), 4).unwrap_err().to_string();
        assert_eq!(error, "expected a regular file, found a folder");
    }
}
