//! Runs the compiler in a separate process, which isolates crashes and limits memory and time.
//!
//! glslang is C++: some broken shaders make it dereference a null pointer, and macros can grow without bounds. It
//! therefore runs in a [`Worker`], a program that calls [`serve_if_asked`](super::serve_if_asked) first. The program is
//! started for the first shader, and kept. Parent and worker communicate over pipes: four bytes of length and a JSON
//! text in each direction, and after a success the SPIR-V as a second message. The worker receives all texts, and opens
//! no shader files.
//!
//! The worker enforces [`Limits`]: it exits with a specific code when a compilation takes too much memory or time. It
//! exits with 0 when the pipe closes, when its parent is gone, or after a compilation that leaves much memory in use.
//! The parent kills it when it does not answer for [`PATIENCE`] or when the build is cancelled. The next compilation
//! then starts a new worker.

use std::ffi::OsString;
use std::io::{self, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tracing::info_span;

use super::generate::{Failure, Key};
use crate::shader::compiler::Cancel;

/// Environment variable that makes a program serve as a worker; its value is the limits, as JSON.
pub(super) const VARIABLE: &str = "SPLATGRAPH_SHADER_COMPILER";
/// The call that a worker's `main` begins with, for errors.
const SERVE: &str = "`splatgraph_framework::shader::serve_if_asked`";
/// Marker that a worker writes before its first message: the parent skips everything before it.
pub(super) const MAGIC: &[u8] = b"\nsplatgraph shader compiler 1\n";
/// Exit code of a worker that took too much memory.
pub(super) const OUT_OF_MEMORY: i32 = 81;
/// Exit code of a worker that took too much time.
pub(super) const OUT_OF_TIME: i32 = 82;
/// Exit code of a worker that could not start its threads.
pub(super) const NO_THREAD: i32 = 83;

/// Time after which a worker that does not answer is killed; its own limit should have stopped it.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time within which a program must identify itself as a worker.
const START: Duration = Duration::from_secs(20);
/// Interval between checks for cancellation.
const ASK_EVERY: Duration = Duration::from_millis(20);
const MAX_BYTES: usize = 64 << 20;

/// Limits of a compilation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Memory of the worker process, in bytes, beyond what it has at its start. Not limited on systems other than Unix.
    pub memory_bytes: u64,
    /// Processor time of one compilation; elapsed time on systems other than Unix.
    pub time: Duration,
}

impl Default for Limits {
    /// Returns limits of 1 GiB and 10 s.
    fn default() -> Limits {
        Limits { memory_bytes: 1 << 30, time: Duration::from_secs(10) }
    }
}

/// True once this process has called [`serve_if_asked`](super::serve_if_asked).
pub(super) static SERVES: AtomicBool = AtomicBool::new(false);

/// A program that can serve as the compiler: its `main` calls [`serve_if_asked`](super::serve_if_asked) first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Worker {
    /// Path of the program.
    pub program: PathBuf,
    /// Arguments of the program.
    pub arguments: Vec<OsString>,
    /// Limits of each compilation.
    pub limits: Limits,
}

impl Worker {
    /// Selects `program` as the compiler, without arguments and with the default limits.
    pub fn new(program: impl Into<PathBuf>) -> Worker {
        Worker { program: program.into(), arguments: Vec::new(), limits: Limits::default() }
    }

    /// Selects the running program as the compiler. On Linux, this works even if its file has been replaced.
    ///
    /// # Errors
    /// The program has not called [`serve_if_asked`](super::serve_if_asked): it would start itself instead of a
    /// compiler, so a plug-in needs another program. Or the program's path cannot be determined.
    ///
    /// ```
    /// # use splatgraph_framework::shader::{Worker, serve_if_asked};
    /// assert!(Worker::this_program().is_err());
    /// serve_if_asked();
    /// assert!(Worker::this_program().is_ok());
    /// ```
    pub fn this_program() -> io::Result<Worker> {
        if !SERVES.load(Ordering::Relaxed) {
            let text = format!("expected a program that calls {SERVE} first, found none; use `Worker::new`");
            return Err(io::Error::new(io::ErrorKind::Unsupported, text));
        }
        let itself = PathBuf::from("/proc/self/exe");
        if cfg!(target_os = "linux") && itself.exists() {
            return Ok(Worker::new(itself));
        }
        std::env::current_exe().map(Worker::new)
    }
}

/// A worker's first message about a compilation. After `Ok`, a second message with the SPIR-V follows.
pub(super) type Reply = Result<(), Failure>;

/// The parent's side: starts a worker on demand, and sends compilations to it.
#[derive(Debug)]
pub(super) struct Parent {
    worker: Worker,
    process: Option<Process>,
}

/// The reason why a worker gave no answer.
enum Lost {
    Ended(Option<ExitStatus>),
    Silent,
    Cancelled,
}

impl Parent {
    pub fn new(worker: Worker) -> Parent {
        Parent { worker, process: None }
    }

    /// Compiles in the worker, and starts one if none is running. If a worker crashes that an earlier call started,
    /// tries once more in a new one.
    pub fn generate(&mut self, key: &Key, cancel: &Cancel) -> Result<Vec<u32>, Failure> {
        let request = serde_json::to_vec(key).map_err(|error| Failure::Log(format!("ERROR: {error}")))?;
        loop {
            let (mut process, fresh) = match self.process.take() {
                Some(process) => (process, false),
                None => match Process::start(&self.worker) {
                    Ok(process) => (process, true),
                    Err(error) => {
                        let program = self.worker.program.display();
                        return Err(Failure::Crash(format!(
                            "ERROR: the compiler's process {program} cannot be started ({error})"
                        )));
                    }
                },
            };
            match process.compile(&request, cancel) {
                Ok(answer) => {
                    // glslang never starts in a process where its first start failed.
                    if !matches!(answer, Err(Failure::Crash(_))) {
                        self.process = Some(process);
                    }
                    return answer;
                }
                Err(lost) => match self.failure(&lost) {
                    // The worker may have ended before it received this text.
                    None if !fresh => {}
                    failure => return Err(failure.unwrap_or_else(crashed)),
                },
            }
        }
    }

    #[cfg(test)]
    pub fn kill(&mut self) {
        let child = self.process.as_mut().map(|process| &mut process.child);
        child.map(Child::kill).expect("a process").expect("it can be ended");
    }

    /// Returns the failure that explains a lost worker; `None` for a crash.
    fn failure(&self, lost: &Lost) -> Option<Failure> {
        let Limits { memory_bytes, time } = self.worker.limits;
        let text = match lost {
            Lost::Ended(status) => match status.and_then(|status| status.code()) {
                Some(OUT_OF_MEMORY) => format!(
                    "the compiler took over {} MiB of memory for this shader (growing macros can cause this)",
                    memory_bytes >> 20
                ),
                Some(OUT_OF_TIME) => format!(
                    "the compiler ran out of its {} s on this shader (growing macros can cause this)",
                    time.as_secs_f64()
                ),
                _ => return None,
            },
            Lost::Silent => {
                let seconds = PATIENCE.as_secs();
                return Some(Failure::Crash(format!(
                    "ERROR: the compiler gave no answer for {seconds} s and was stopped"
                )));
            }
            Lost::Cancelled => return Some(Failure::Cancelled),
        };
        Some(Failure::Log(format!("ERROR: {text}")))
    }
}

fn crashed() -> Failure {
    Failure::Crash(
        "ERROR: the compiler crashed on this shader (a name declared twice can cause this, and so can a low memory limit for processes)"
            .into(),
    )
}

/// A running worker. Dropping this value ends the process.
#[derive(Debug)]
struct Process {
    child: Child,
    /// Pipe for requests to the process; `None` only during drop.
    requests: Option<ChildStdin>,
    /// Messages, read by a thread that ends with the process. The first is empty, for [`MAGIC`].
    replies: Receiver<io::Result<Vec<u8>>>,
}

impl Process {
    fn start(worker: &Worker) -> io::Result<Process> {
        let _span = info_span!("start the compiler").entered();
        // A program that does not serve would otherwise start itself again and again.
        if std::env::var_os(VARIABLE).is_some() {
            return Err(io::Error::other(format!(
                "expected a `main` that calls {SERVE} first, found a worker that compiles"
            )));
        }
        let mut command = Command::new(&worker.program);
        command
            .args(&worker.arguments)
            .env(VARIABLE, serde_json::to_string(&worker.limits)?)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        #[cfg(unix)]
        {
            use std::os::unix::process::CommandExt;
            // Ctrl+C should only reach the parent; the worker ends with it.
            command.process_group(0);
        }
        let mut child = command.spawn()?;
        let requests = child.stdin.take();
        let output = child.stdout.take().ok_or_else(|| io::Error::other("it has no output"))?;
        let (sender, replies) = channel();
        let reader = thread::Builder::new().name("shader compiler".into()).spawn(move || {
            let mut output = BufReader::new(output);
            let mut message = find_magic(&mut output).map(|()| Vec::new());
            loop {
                let ended = message.is_err();
                if sender.send(message).is_err() || ended {
                    return;
                }
                message = receive(&mut output);
            }
        });
        let mut process = Process { child, requests, replies };
        reader?;
        let has_no_thread =
            |lost| matches!(lost, Lost::Ended(Some(status)) if status.code() == Some(NO_THREAD));
        Err(io::Error::other(match process.replies.recv_timeout(START) {
            Ok(Ok(_)) => return Ok(process),
            Ok(Err(_)) if has_no_thread(process.ended()) => {
                "it could not start a thread; a limit of processes can cause this, such as `ulimit -u` or pids.max".into()
            }
            _ => format!("expected a program that calls {SERVE} first, found no answer"),
        }))
    }

    /// Runs one compilation. The outer error means that the worker is lost.
    fn compile(&mut self, request: &[u8], cancel: &Cancel) -> Result<Result<Vec<u32>, Failure>, Lost> {
        let requests = self.requests.as_mut().ok_or(Lost::Ended(None))?;
        if send(requests, request).is_err() {
            return Err(self.ended());
        }
        let reply = self.wait(cancel)?;
        let Ok(reply) = serde_json::from_slice::<Reply>(&reply) else { return Err(self.ended()) };
        if let Err(failure) = reply {
            return Ok(Err(failure));
        }
        let bytes = self.wait(cancel)?;
        let word = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().expect("chunks of four"));
        Ok(Ok(bytes.chunks_exact(4).map(word).collect()))
    }

    fn wait(&mut self, cancel: &Cancel) -> Result<Vec<u8>, Lost> {
        let begun = Instant::now();
        loop {
            match self.replies.recv_timeout(ASK_EVERY) {
                Ok(Ok(message)) => return Ok(message),
                Ok(Err(_)) | Err(RecvTimeoutError::Disconnected) => return Err(self.ended()),
                Err(RecvTimeoutError::Timeout) if cancel.is_requested() => return Err(Lost::Cancelled),
                Err(RecvTimeoutError::Timeout) if begun.elapsed() > PATIENCE => return Err(Lost::Silent),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Returns [`Lost::Ended`] with the worker's exit status; waits up to 2 s for it.
    fn ended(&mut self) -> Lost {
        let asked = Instant::now();
        while asked.elapsed() < Duration::from_secs(2) {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Lost::Ended(Some(status));
            }
            thread::sleep(Duration::from_millis(1));
        }
        Lost::Ended(None)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        drop(self.requests.take());
        // The worker may already have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn find_magic(input: &mut impl Read) -> io::Result<()> {
    let mut last = Vec::new();
    let mut byte = [0];
    // Byte by byte, so that nothing after the marker is consumed.
    for _ in 0..64 << 10 {
        input.read_exact(&mut byte)?;
        last.extend(byte);
        if last.ends_with(MAGIC) {
            return Ok(());
        }
    }
    Err(io::ErrorKind::UnexpectedEof.into())
}

pub(super) fn send(output: &mut impl Write, message: &[u8]) -> io::Result<()> {
    let length = u32::try_from(message.len()).map_err(io::Error::other)?;
    output.write_all(&length.to_le_bytes())?;
    output.write_all(message)?;
    output.flush()
}

/// Reads one message. Fails if it is longer than [`MAX_BYTES`].
pub(super) fn receive(input: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut length = [0; 4];
    input.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_BYTES {
        return Err(io::Error::other("a message is too long"));
    }
    let mut message = vec![0; length];
    input.read_exact(&mut message)?;
    Ok(message)
}
