//! Writes a log: a file of lines that other programs read while it grows.

// Only this module and `file` create files. The lint forbids it elsewhere.
#![allow(clippy::disallowed_methods)]

use super::file::{OutputError, Target, folder_of, hidden_names};
use super::terminal;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// A file of lines that other programs read while it grows, such as the viewer's events.
///
/// It is written in place, by whole lines. A failure ends the log, but not the program.
pub struct Log {
    out: Option<Box<dyn Write>>,
    path: PathBuf,
    pending: Vec<u8>,
}

impl Log {
    /// Creates a regular file with its folder, or empties it; or opens a device or a pipe. The path `-` is standard
    /// output.
    ///
    /// # Errors
    /// The folder or the file cannot be created.
    pub fn create(path: &Path) -> Result<Log, OutputError> {
        let open = || -> io::Result<Box<dyn Write>> {
            Ok(match Target::of(path)? {
                Target::StandardOutput => Box::new(io::stdout()),
                Target::Direct(path) => Box::new(OpenOptions::new().append(true).open(path)?),
                Target::File(target) => {
                    fs::create_dir_all(folder_of(&target))?;
                    Box::new(File::create(target)?)
                }
            })
        };
        match open() {
            Ok(out) => Ok(Log { out: Some(out), path: path.to_owned(), pending: Vec::new() }),
            Err(error) => Err(OutputError { path: path.to_owned(), cause: error.into() }),
        }
    }

    /// Queues a line, given without its line break, for the next [`Log::flush`]. Escapes its control characters.
    pub fn line(&mut self, line: &str) {
        self.pending.extend_from_slice(terminal::harmless(line).as_bytes());
        self.pending.push(b'\n');
    }

    /// Writes the queued lines. The first failure ends the log, and is reported unless the reader closed the pipe.
    pub fn flush(&mut self) {
        if let Some(out) = &mut self.out {
            // A signal's cleanup waits for this lock, so the program does not end in the middle of a line.
            let _names = hidden_names();
            if let Err(error) = out.write_all(&self.pending).and_then(|()| out.flush()) {
                self.out = None;
                if error.kind() != ErrorKind::BrokenPipe {
                    terminal::say(format!(
                        "error: {} can no longer be written: {error}",
                        self.path.display()
                    ));
                }
            }
        }
        self.pending.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_has_whole_lines_and_creates_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/log.jsonl");
        let mut log = Log::create(&path).unwrap();
        log.line("one");
        assert_eq!(fs::read_to_string(&path).unwrap(), "");
        log.line("t\x1bwo");
        log.flush();
        assert_eq!(fs::read_to_string(&path).unwrap(), "one\nt\\u001bwo\n");
    }
}
