//! Compiles pipelines on a separate thread, so that a hanging driver compiler blocks nothing else.
//!
//! A driver's compiler cannot be stopped from outside, so the thread is abandoned instead. If one pipeline takes longer
//! than the compile patience, the load fails with an error that names the pass and the shader. If the load is
//! cancelled, it ends at once. The thread checks for this between two pipelines and frees what it created; until then
//! it holds the device open. While a thread abandoned for exceeding the patience lives, its plan is refused, so that
//! repeated loads do not pile up threads. Once there are [`MAX_ABANDONED`] threads, any other plan waits for one to
//! end, and is refused if the oldest has exceeded the patience.

use crate::gpu::{Gpu, NextPipeline};
use crate::lock::lock;
use crate::stopwatch::Stopwatch;
use splatgraph_api::{BackendError, Progress};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, Weak};
use std::thread;
use std::time::{Duration, Instant};
use tracing::info_span;

/// Maximum number of abandoned compiler threads before other plans wait for one to end.
const MAX_ABANDONED: usize = 8;

/// Interval at which a wait for the compiler checks for cancellation.
const ASK_EVERY: Duration = Duration::from_millis(20);

static ABANDONED: AtomicUsize = AtomicUsize::new(0);

/// Returns the number of abandoned compiler threads of this process that still run.
///
/// If it is not 0, a program that exits should skip its libraries' exit handlers, which may wait for the compiler.
pub fn abandoned_compilers() -> usize {
    ABANDONED.load(Ordering::Relaxed)
}

#[derive(Default)]
pub(crate) struct Compilers {
    abandoned: Mutex<Vec<Abandoned>>,
}

struct Abandoned {
    /// The plan; its strong count is 0 once its thread has ended.
    plan: Weak<Plan>,
    current: Option<NextPipeline>,
    /// Time at which the thread started its current pipeline.
    begun: Instant,
    /// Error with which the plan is refused while its thread runs; `None` if the load was cancelled.
    told: Option<BackendError>,
}

/// A guard that counts an abandoned thread in [`ABANDONED`] while it exists.
struct AbandonedThread;

impl AbandonedThread {
    fn new() -> AbandonedThread {
        ABANDONED.fetch_add(1, Ordering::Relaxed);
        AbandonedThread
    }
}

impl Drop for AbandonedThread {
    fn drop(&mut self) {
        ABANDONED.fetch_sub(1, Ordering::Relaxed);
    }
}

/// State of a compiler thread: whether it has ended, and its guard if it was abandoned before that.
#[derive(Default)]
struct End {
    over: bool,
    counted: Option<AbandonedThread>,
}

enum Message<P> {
    Next(NextPipeline),
    Made(Result<P, BackendError>),
}

impl Compilers {
    pub fn create<G: Gpu>(
        &self,
        gpu: &Arc<G>,
        plan: &Arc<Plan>,
        cancel: &Cancel,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<G::Pipelines, BackendError> {
        self.wait_for_room(plan, cancel, gpu.common().compile_patience)?;
        let (sender, messages) = channel();
        let end: Arc<Mutex<End>> = Arc::default();
        let thread = thread::Builder::new().name("pipelines".into()).spawn({
            let (gpu, plan, end) = (gpu.clone(), plan.clone(), end.clone());
            move || {
                work(&gpu, &plan, &sender);
                // Frees the device, the plan and an unreceived result before the thread counts as ended.
                drop((sender, plan, gpu));
                let mut end = lock(&end);
                end.over = true;
                end.counted = None;
            }
        });
        let thread = thread.map_err(|error| BackendError::Api {
            call: "the start of a thread for the driver's compiler",
            answer: error.to_string(),
        })?;
        let (mut current, mut begun, mut watch) = (None, Instant::now(), Stopwatch::start());
        let told = loop {
            match messages.recv_timeout(ASK_EVERY) {
                // Also checked here: while pipelines compile quickly, the timeout below never fires.
                Ok(Message::Next(_)) if cancel.is_requested() => break None,
                Ok(Message::Next(next)) => {
                    let NextPipeline { done, of, shader, .. } = next;
                    progress(Progress::Pipeline { done, of, shader: &plan.shader(shader).name });
                    (current, begun, watch) = (Some(next), Instant::now(), Stopwatch::start());
                }
                Ok(Message::Made(made)) => {
                    drop(messages);
                    thread.join().unwrap_or_else(|panic| resume_unwind(panic));
                    return made;
                }
                Err(RecvTimeoutError::Disconnected) => {
                    let Err(panic) = thread.join() else { unreachable!("a thread tells what it made") };
                    resume_unwind(panic)
                }
                Err(RecvTimeoutError::Timeout) if cancel.is_requested() => break None,
                Err(RecvTimeoutError::Timeout) if watch.look() > gpu.common().compile_patience => {
                    break Some(stuck(plan, current, gpu.common().compile_patience));
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        };
        drop(messages);
        let mut end = lock(&end);
        if !end.over {
            end.counted = Some(AbandonedThread::new());
        }
        let error = told.clone().unwrap_or(BackendError::Cancelled);
        lock(&self.abandoned).push(Abandoned { plan: Arc::downgrade(plan), current, begun, told });
        Err(error)
    }

    fn wait_for_room(&self, plan: &Plan, cancel: &Cancel, patience: Duration) -> Result<(), BackendError> {
        while !self.has_room(plan, patience)? {
            if cancel.is_requested() {
                return Err(BackendError::Cancelled);
            }
            thread::sleep(ASK_EVERY);
        }
        Ok(())
    }

    /// Returns true if another compiler thread may start.
    ///
    /// # Errors
    /// [`BackendError::StuckCompiler`] if a thread abandoned for exceeding the patience is still compiling this plan,
    /// or if too many threads run and the oldest has exceeded the patience.
    fn has_room(&self, plan: &Plan, patience: Duration) -> Result<bool, BackendError> {
        let mut abandoned = lock(&self.abandoned);
        abandoned.retain(|former| former.plan.strong_count() > 0);
        for former in abandoned.iter() {
            if let (Some(told), Some(former)) = (&former.told, former.plan.upgrade())
                && compiles_as(&former, plan)
            {
                return Err(told.clone());
            }
        }
        if abandoned.len() < MAX_ABANDONED {
            return Ok(true);
        }
        match abandoned.first().and_then(|oldest| Some((oldest, oldest.plan.upgrade()?))) {
            Some((oldest, former)) if oldest.begun.elapsed() > patience => {
                Err(stuck(&former, oldest.current, oldest.begun.elapsed()))
            }
            _ => Ok(false),
        }
    }
}

/// Creates the pipelines on the compiler's thread, and stops between two pipelines once the receiver is dropped.
fn work<G: Gpu>(gpu: &Arc<G>, plan: &Plan, sender: &Sender<Message<G::Pipelines>>) {
    let mut span = None;
    let mut next = |next: NextPipeline| {
        drop(span.take());
        span = Some(info_span!("make a pipeline", shader = plan.shader(next.shader).name).entered());
        sender.send(Message::Next(next)).map_err(|_| BackendError::Cancelled)
    };
    let made = gpu.create_pipelines(plan, &mut next);
    drop(span);
    // The receiver may have been dropped.
    let _ = sender.send(Message::Made(made));
}

/// Returns true if two plans are assumed to have the same pipelines: their names, shaders and pass names are equal.
fn compiles_as(one: &Plan, other: &Plan) -> bool {
    one.name == other.name
        && one.shaders == other.shaders
        && one.passes.len() == other.passes.len()
        && one.passes.iter().zip(&other.passes).all(|(one, other)| one.name == other.name)
}

fn stuck(plan: &Plan, current: Option<NextPipeline>, patience: Duration) -> BackendError {
    let name = |name: Option<&str>| name.unwrap_or("?").to_string();
    BackendError::StuckCompiler {
        plan: plan.name.clone(),
        pass: name(current.map(|next| plan.pass(next.pass).name.as_str())),
        shader: name(current.map(|next| plan.shader(next.shader).name.as_str())),
        seconds: patience.as_secs(),
    }
}
