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
/// It is written in place, by whole lines. A failure does not end the program: the lines that could not be written, for
/// example because the disk is full, are kept in memory, and written before the next ones.
pub struct Log {
    /// `None` once the reader closed the pipe, or more than [`KEPT`] was pending.
    out: Option<Box<dyn Write>>,
    path: PathBuf,
    /// Queued bytes that are not written yet. After a failure, the first line may have been written in part.
    pending: Vec<u8>,
    /// True if the last write failed.
    fails: bool,
}

/// Maximum length of the lines that are kept after a failure, in bytes.
const KEPT: usize = 16 << 20;

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
            Ok(out) => Ok(Log { out: Some(out), path: path.to_owned(), pending: Vec::new(), fails: false }),
            Err(error) => Err(OutputError { path: path.to_owned(), cause: error.into() }),
        }
    }

    /// Queues a line, given without its line break, for the next [`Log::flush`]. Escapes its control characters.
    pub fn line(&mut self, line: &str) {
        self.pending.extend_from_slice(terminal::harmless(line).as_bytes());
        self.pending.push(b'\n');
    }

    /// Writes the queued lines. After a failure, the next call continues where this one ended. The first failure in a
    /// row is reported. If the reader closed the pipe, or too much is pending, the log ends.
    pub fn flush(&mut self) {
        let Some(out) = &mut self.out else { return self.pending.clear() };
        // A signal's cleanup waits for this lock, so the program does not end in the middle of a line.
        let _names = hidden_names();
        let Err(error) = drain(&mut self.pending, out) else {
            self.fails = false;
            return;
        };
        let is_closed = error.kind() == ErrorKind::BrokenPipe;
        let ends = is_closed || self.pending.len() > KEPT;
        let path = self.path.display();
        if ends && !is_closed {
            terminal::say(format!("error: {path} can no longer be written: {error}"));
        } else if !is_closed && !self.fails {
            terminal::say(format!("warning: {path} cannot be written, so its next lines are kept: {error}"));
        }
        self.fails = true;
        if ends {
            self.out = None;
            self.pending = Vec::new();
        }
    }
}

/// Writes bytes and removes them from `pending`. After an error, the bytes that were not written remain.
fn drain(pending: &mut Vec<u8>, out: &mut dyn Write) -> io::Result<()> {
    while !pending.is_empty() {
        match out.write(pending) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(written) => drop(pending.drain(..written)),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::rc::Rc;

    /// A disk with room for some bytes, and its contents.
    #[derive(Clone, Default)]
    struct Disk(Rc<RefCell<(usize, String)>>);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let (room, text) = &mut *self.0.borrow_mut();
            let written = bytes.len().min(*room);
            if written == 0 {
                return Err(ErrorKind::StorageFull.into());
            }
            *room -= written;
            text.push_str(std::str::from_utf8(&bytes[..written]).unwrap());
            Ok(written)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn log_on(disk: &Disk) -> Log {
        let out: Box<dyn Write> = Box::new(disk.clone());
        Log { out: Some(out), path: "log.jsonl".into(), pending: Vec::new(), fails: false }
    }

    #[test]
    fn lines_that_a_full_disk_cut_or_refused_are_written_once_there_is_room() {
        let disk = Disk::default();
        let mut log = log_on(&disk);
        disk.0.borrow_mut().0 = 6;
        for line in ["one", "two", "three"] {
            log.line(line);
            log.flush();
        }
        assert_eq!(disk.0.borrow().1, "one\ntw");
        disk.0.borrow_mut().0 = 100;
        log.line("four");
        log.flush();
        assert_eq!(disk.0.borrow().1, "one\ntwo\nthree\nfour\n");
    }

    #[test]
    fn a_log_ends_once_too_much_could_not_be_written() {
        let disk = Disk::default();
        let mut log = log_on(&disk);
        let line = "x".repeat(KEPT / 2);
        for _ in 0..2 {
            log.line(&line);
            log.flush();
        }
        disk.0.borrow_mut().0 = 10 * KEPT;
        log.line("after");
        log.flush();
        assert_eq!(disk.0.borrow().1, "");
    }

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
