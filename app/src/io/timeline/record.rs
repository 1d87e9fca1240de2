//! Records the spans of host threads, and the frames of the device.
//!
//! The program's crates open spans with the crate `tracing`. [`start`] installs this module's subscriber, which keeps
//! every closed span with its thread, start and end. [`finish`] returns them. Spans of other libraries are ignored.

use std::collections::HashMap;
use std::fmt::Debug;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};
use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::subscriber::{Interest, Subscriber};
use tracing::{Event, Metadata};

/// Prefix of the module paths of the program's own crates.
const OWN: &str = "splatgraph";

/// A closed span. Times are relative to the start of the recording.
#[derive(Clone, Debug)]
pub struct Span {
    /// Index of the span's thread in [`Recording::threads`].
    pub thread: usize,
    /// The work of the span, as a verb with its object: `build the plan`.
    pub name: &'static str,
    /// The span's fields, as text, by name.
    pub details: Vec<(&'static str, String)>,
    /// Time when the span was entered.
    pub begin: Duration,
    /// Time when the span was exited.
    pub end: Duration,
}

/// A frame that the device drew. Times of the host are relative to the start of the recording.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The frame's number on the device.
    pub number: u64,
    /// The frame's camera, and the time when the host submitted it.
    pub submission: Submission,
    /// Time when the host saw that the frame was complete.
    pub seen: Duration,
    /// Start of the frame on the device's clock, in milliseconds; `None` without timestamps.
    pub start_ms: Option<f64>,
    /// Duration on the device, in milliseconds; `None` without timestamps.
    pub total_ms: Option<f64>,
    /// The passes that have timestamps.
    pub passes: Vec<Pass>,
}

/// The host's part of a frame in flight.
#[derive(Clone, Debug)]
pub struct Submission {
    /// Time when the host began to submit the frame, relative to the start of the recording.
    pub begun: Duration,
    /// Name of the frame's camera.
    pub camera: String,
    /// True if the frame only warms the device up, and is not measured.
    pub warm_up: bool,
}

/// A timed pass of a frame.
#[derive(Clone, Debug)]
pub struct Pass {
    /// The pass's name in the plan.
    pub name: String,
    /// Start of the pass, in milliseconds from the start of the frame.
    pub start_ms: f64,
    /// Duration of the pass, in milliseconds.
    pub ms: f64,
}

/// A finished recording. Its times are relative to its start.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Names of the threads. The first is the main thread.
    pub threads: Vec<String>,
    /// The closed spans, in the order in which they were closed.
    pub spans: Vec<Span>,
    /// The completed frames.
    pub frames: Vec<Frame>,
    /// Time when the recording ended.
    pub end: Duration,
}

struct Running {
    begun: Instant,
    threads: HashMap<ThreadId, usize>,
    open: HashMap<u64, Open>,
    /// Frames in flight, by their numbers on the device.
    flying: HashMap<u64, Submission>,
    recording: Recording,
}

struct Open {
    name: &'static str,
    details: Vec<(&'static str, String)>,
    begin: Duration,
}

static RUNNING: Mutex<Option<Running>> = Mutex::new(None);
/// True while [`RUNNING`] holds a recording.
static ACTIVE: AtomicBool = AtomicBool::new(false);
static NEXT: AtomicU64 = AtomicU64::new(1);

fn running() -> MutexGuard<'static, Option<Running>> {
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Running {
    fn now(&self) -> Duration {
        self.begun.elapsed()
    }

    fn thread(&mut self) -> usize {
        let current = thread::current();
        let threads = &mut self.recording.threads;
        *self.threads.entry(current.id()).or_insert_with(|| {
            threads.push(current.name().unwrap_or("a thread of a library").to_owned());
            threads.len() - 1
        })
    }
}

/// Starts recording. The time from `begun` until now becomes a span with the name `before`.
pub fn start(begun: Instant, before: &'static str) {
    let mut running = running();
    let end = begun.elapsed();
    let span = Span { thread: 0, name: before, details: Vec::new(), begin: Duration::ZERO, end };
    let recording = Recording { threads: vec!["main".to_owned()], spans: vec![span], ..Recording::default() };
    let threads = [(thread::current().id(), 0)].into();
    *running = Some(Running { begun, threads, open: HashMap::new(), flying: HashMap::new(), recording });
    drop(running);
    ACTIVE.store(true, Ordering::Relaxed);
    // Fails if an earlier recording of the process has already set it.
    let _ = tracing::subscriber::set_global_default(Recorder);
}

/// Ends the recording, and returns it; `None` if nothing is being recorded. Spans that are still open are lost.
pub fn finish() -> Option<Recording> {
    ACTIVE.store(false, Ordering::Relaxed);
    let Running { begun, recording, .. } = running().take()?;
    Some(Recording { end: begun.elapsed(), ..recording })
}

/// Records a frame, whose submission began at `begun`; does nothing without a recording. See `Submission` for
/// `camera` and `warm_up`.
pub fn submitted(number: u64, begun: Instant, (camera, warm_up): (&str, bool)) {
    if ACTIVE.load(Ordering::Relaxed)
        && let Some(running) = &mut *running()
    {
        let begun = begun.saturating_duration_since(running.begun);
        running.flying.insert(number, Submission { begun, camera: camera.to_owned(), warm_up });
    }
}

/// Records that a frame is complete. `frame` makes the record from the submission and the time of completion; it is not
/// called without a recording, or if [`submitted`] did not record the frame.
pub fn completed(number: u64, frame: impl FnOnce(Submission, Duration) -> Frame) {
    if ACTIVE.load(Ordering::Relaxed)
        && let Some(running) = &mut *running()
        && let Some(submission) = running.flying.remove(&number)
    {
        let frame = frame(submission, running.now());
        running.recording.frames.push(frame);
    }
}

struct Recorder;

impl Subscriber for Recorder {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        match metadata.is_span() && metadata.target().starts_with(OWN) {
            true => Interest::sometimes(),
            false => Interest::never(),
        }
    }

    fn enabled(&self, _: &Metadata) -> bool {
        ACTIVE.load(Ordering::Relaxed)
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::INFO)
    }

    fn new_span(&self, span: &Attributes) -> Id {
        let mut details = Details(Vec::new());
        span.record(&mut details);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        if let Some(running) = &mut *running() {
            let begin = running.now();
            running.open.insert(id, Open { name: span.metadata().name(), details: details.0, begin });
        }
        Id::from_u64(id)
    }

    fn record(&self, _: &Id, _: &Record) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, _: &Event) {}

    fn enter(&self, id: &Id) {
        if let Some(running) = &mut *running() {
            let now = running.now();
            if let Some(open) = running.open.get_mut(&id.into_u64()) {
                open.begin = now;
            }
        }
    }

    fn exit(&self, id: &Id) {
        if let Some(running) = &mut *running()
            && let Some(Open { name, details, begin }) = running.open.remove(&id.into_u64())
        {
            let (thread, end) = (running.thread(), running.now());
            running.recording.spans.push(Span { thread, name, details, begin, end });
        }
    }
}

struct Details(Vec<(&'static str, String)>);

impl Visit for Details {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.0.push((field.name(), value.to_owned()));
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.0.push((field.name(), format!("{value:?}")));
    }
}
