//! Collects spans of host threads and frames of the device.
//!
//! All crates open spans of the crate `tracing`. Without a subscriber they cost an atomic load each. [`start`] installs the subscriber
//! of this module, which keeps every closed span with its thread and its two times; [`finish`] returns them. Only the program's own
//! spans are kept: libraries have others.

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

/// Beginning of the paths of the program's own crates.
const OWN: &str = "splatgraph";

/// A closed span. Times count from the start of the process's work.
#[derive(Clone, Debug)]
pub struct Span {
    /// Index into [`Recording::threads`].
    pub thread: usize,
    /// The work, as a verb and its object.
    pub name: &'static str,
    /// Details, by name.
    pub details: Vec<(&'static str, String)>,
    /// Start.
    pub begin: Duration,
    /// End.
    pub end: Duration,
}

/// A frame of the device.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its number on the device.
    pub number: u64,
    /// The host gave it to the device.
    pub submitted: Duration,
    /// The host saw it complete.
    pub seen: Duration,
    /// Start on the device's clock, in milliseconds.
    pub start_ms: Option<f64>,
    /// Milliseconds on the device.
    pub total_ms: Option<f64>,
    /// The timed passes.
    pub passes: Vec<Pass>,
}

/// A pass of a frame.
#[derive(Clone, Debug)]
pub struct Pass {
    /// Its name in the graph.
    pub name: String,
    /// Milliseconds after the frame's start.
    pub start_ms: f64,
    /// Milliseconds that it took.
    pub ms: f64,
}

/// All that was recorded.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Names of the threads; the first is the main thread.
    pub threads: Vec<String>,
    /// The closed spans, in the order of their ends.
    pub spans: Vec<Span>,
    /// The completed frames.
    pub frames: Vec<Frame>,
    /// Time of the end.
    pub end: Duration,
}

/// A recording in progress.
struct Running {
    begun: Instant,
    threads: HashMap<ThreadId, usize>,
    open: HashMap<u64, Open>,
    /// Times of submission of the frames in flight.
    flying: HashMap<u64, Duration>,
    recording: Recording,
}

/// A span that is not closed.
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

/// Starts to record. Work from `begun` until now is a span of the name `before`.
pub fn start(begun: Instant, before: &'static str) {
    let mut running = running();
    let end = begun.elapsed();
    let span = Span { thread: 0, name: before, details: Vec::new(), begin: Duration::ZERO, end };
    let recording = Recording { threads: vec!["main".to_owned()], spans: vec![span], ..Recording::default() };
    let threads = [(thread::current().id(), 0)].into();
    *running = Some(Running { begun, threads, open: HashMap::new(), flying: HashMap::new(), recording });
    drop(running);
    ACTIVE.store(true, Ordering::Relaxed);
    // A second call comes from a second test in one process.
    let _ = tracing::subscriber::set_global_default(Recorder);
}

/// Ends the recording and returns it; `None` if there is none. Spans that are still open are lost.
pub fn finish() -> Option<Recording> {
    ACTIVE.store(false, Ordering::Relaxed);
    let Running { begun, recording, .. } = running().take()?;
    Some(Recording { end: begun.elapsed(), ..recording })
}

/// Notes that a frame was given to the device.
pub fn submitted(number: u64) {
    if ACTIVE.load(Ordering::Relaxed)
        && let Some(running) = &mut *running()
    {
        let now = running.now();
        running.flying.insert(number, now);
    }
}

/// Notes that a frame completed; `frame` gets the times of submission and completion.
pub fn completed(number: u64, frame: impl FnOnce(Duration, Duration) -> Frame) {
    if ACTIVE.load(Ordering::Relaxed)
        && let Some(running) = &mut *running()
        && let Some(submitted) = running.flying.remove(&number)
    {
        let frame = frame(submitted, running.now());
        running.recording.frames.push(frame);
    }
}

/// The subscriber, of which a process has one.
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

/// The fields of a span as text.
struct Details(Vec<(&'static str, String)>);

impl Visit for Details {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.0.push((field.name(), value.to_owned()));
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.0.push((field.name(), format!("{value:?}")));
    }
}
