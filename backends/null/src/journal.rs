//! Records every call, the live objects, and the submissions in flight.

use crate::fault::{Fault, Point};
use splatgraph_framework::ir::Layout;
use splatgraph_runtime::{Location, Messages, lock};
use std::collections::{BTreeMap, HashSet};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// A kind of object that the journal counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Object {
    /// A piece of memory.
    Memory,
    /// A buffer, with or without memory.
    Buffer,
    /// An image, with or without memory.
    Image,
    /// The pipelines of a plan.
    Pipelines,
    /// The bindings of a plan.
    Bindings,
    /// A set of timestamps.
    Timestamps,
    /// An encoder.
    Encoder,
    /// A swapchain.
    Swapchain,
    /// The device itself.
    Device,
}

/// A call by the runtime. Objects appear by name, with offsets and sizes in bytes.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the calls and their arguments are those of `Gpu` and `Encoder`")]
pub enum Call {
    Create {
        object: Object,
        name: String,
    },
    Destroy {
        object: Object,
        name: String,
    },
    Allocate {
        name: String,
        bytes: u64,
        location: Location,
    },
    WriteBinding {
        pass: String,
        copy: usize,
        target: String,
        bytes: Option<u64>,
    },
    Begin {
        encoder: String,
    },
    End,
    PushLabel(String),
    PopLabel,
    /// The barriers before a pass or of the handover: the number of dependencies, and the layout changes (image, old,
    /// new).
    Synchronize {
        dependencies: usize,
        images: Vec<(String, Layout, Layout)>,
    },
    FullBarrier {
        images: Vec<(String, Layout, Layout)>,
    },
    AfterCopy {
        target: String,
        range: Range<u64>,
    },
    CopiesToHost,
    BindPass {
        pass: String,
        slot: usize,
    },
    Dispatch([u32; 3]),
    DispatchIndirect {
        arguments: String,
        offset: u64,
    },
    Draw {
        targets: Vec<String>,
        vertices: u32,
        instances: u32,
    },
    DrawIndirect {
        targets: Vec<String>,
        arguments: String,
        offset: u64,
    },
    Fill {
        buffer: String,
        value: u32,
    },
    Clear {
        image: String,
    },
    CopyBuffer {
        source: (String, u64),
        target: (String, u64),
        bytes: u64,
    },
    CopyImage {
        image: String,
        target: String,
    },
    CopyToImage {
        image: String,
        target: String,
    },
    ResetTimestamps {
        count: u32,
    },
    Timestamp {
        index: u32,
    },
    Submit {
        encoder: String,
        show: Option<u32>,
    },
    Wait {
        encoder: String,
        blocks: bool,
    },
    WaitIdle,
    RenewSurface,
    CreateSwapchain {
        size: (u32, u32),
        vsync: bool,
    },
    Acquire {
        slot: usize,
    },
    RecordBlit {
        output: String,
        image: u32,
    },
    Present {
        image: u32,
    },
}

/// Something that a submission uses and that must not change while it is in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Used {
    /// An object, by its number.
    Object(u64),
    /// One copy of a pass's bindings: the number of the [`Object::Bindings`], the pass and the copy.
    Bindings(u64, u32, usize),
}

#[derive(Default)]
struct State {
    /// True to record calls.
    records: bool,
    calls: Vec<Call>,
    alive: BTreeMap<Object, i64>,
    objects: u64,
    reached: BTreeMap<Point, u64>,
    faults: Vec<Fault>,
    in_flight: Vec<InFlight>,
    /// True while the device hangs: later submissions do not complete.
    hangs: bool,
    /// Number of compilations that hang now.
    compilers: u64,
    lost: bool,
}

impl State {
    fn call(&mut self, call: Call) {
        if self.records {
            self.calls.push(call);
        }
    }
}

struct InFlight {
    /// Number of the encoder that was submitted.
    encoder: u64,
    used: HashSet<Used>,
    /// True while the submission cannot complete because the device hangs.
    hung: bool,
}

/// Effect of a device hang on a submission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hung {
    /// The device hangs in this submission.
    In,
    /// The device hangs in an earlier submission.
    Behind,
}

/// The record of a device's calls and objects. Clones share it.
#[derive(Clone, Default)]
pub struct Journal {
    state: Arc<Mutex<State>>,
    messages: Arc<Messages>,
}

impl Journal {
    pub(crate) fn new(faults: &[Fault], records: bool) -> Journal {
        let state = State { records, faults: faults.to_vec(), ..State::default() };
        Journal { state: Arc::new(Mutex::new(state)), messages: Arc::default() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Removes and returns the calls recorded since the last time.
    pub fn take(&self) -> Vec<Call> {
        std::mem::take(&mut self.state().calls)
    }

    /// Returns the number of live objects of each kind, without kinds that have none.
    pub fn alive(&self) -> BTreeMap<Object, i64> {
        self.state().alive.iter().filter(|(_, count)| **count != 0).map(|(&k, &v)| (k, v)).collect()
    }

    /// Returns the number of calls of this kind so far.
    pub fn reached(&self, point: Point) -> u64 {
        self.state().reached.get(&point).copied().unwrap_or(0)
    }

    pub(crate) fn messages(&self) -> &Arc<Messages> {
        &self.messages
    }

    pub(crate) fn call(&self, call: Call) {
        self.state().call(call);
    }

    /// Counts a call of this kind. Returns true if it must fail.
    pub(crate) fn fails(&self, point: Point) -> bool {
        let mut state = self.state();
        let reached = state.reached.entry(point).or_default();
        let now = Fault { point, after: *reached };
        *reached += 1;
        state.faults.contains(&now)
    }

    pub(crate) fn lose(&self) {
        let mut state = self.state();
        state.lost = true;
        state.in_flight.clear();
    }

    /// Makes the device hang in all later submissions, until [`Journal::resume`].
    pub fn hang(&self) {
        self.state().hangs = true;
    }

    /// Ends all hangs: of the device, which completes its work and continues, and of compilers.
    pub fn resume(&self) {
        let mut state = self.state();
        state.hangs = false;
        state.compilers = 0;
        state.in_flight.iter_mut().for_each(|submission| submission.hung = false);
    }

    /// Compiles a pipeline, which takes no time. A fault makes it block until [`Journal::resume`].
    pub(crate) fn compile(&self) {
        if !self.fails(Point::Compile) {
            return;
        }
        self.state().compilers += 1;
        while self.state().compilers > 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Counts a submission. Returns how a hang affects it; `None` if the device does not hang.
    pub(crate) fn hangs(&self) -> Option<Hung> {
        let now = self.fails(Point::Hang);
        let mut state = self.state();
        match (state.hangs, now) {
            (true, _) => Some(Hung::Behind),
            (false, true) => {
                state.hangs = true;
                Some(Hung::In)
            }
            (false, false) => None,
        }
    }

    /// Returns true if a submission of this encoder, or any submission if `None`, hangs.
    pub(crate) fn is_hung(&self, encoder: Option<&Owned>) -> bool {
        let of = |submission: &InFlight| encoder.is_none_or(|encoder| encoder.number == submission.encoder);
        self.state().in_flight.iter().any(|submission| submission.hung && of(submission))
    }

    pub(crate) fn is_lost(&self) -> bool {
        self.state().lost
    }

    pub(crate) fn create(&self, object: Object, name: &str) -> Owned {
        let mut state = self.state();
        *state.alive.entry(object).or_default() += 1;
        state.objects += 1;
        state.call(Call::Create { object, name: name.to_string() });
        Owned { object, number: state.objects, name: name.to_string(), journal: self.clone() }
    }

    pub(crate) fn submit(&self, encoder: &Owned, used: HashSet<Used>, hung: bool) {
        self.check_idle(encoder, "submitted");
        self.state().in_flight.push(InFlight { encoder: encoder.number, used, hung });
    }

    /// Adds a message if the encoder is used (`action`) before its last submission was waited for.
    pub(crate) fn check_idle(&self, encoder: &Owned, action: &str) {
        if self.state().in_flight.iter().any(|submission| submission.encoder == encoder.number) {
            self.messages.add(format!("encoder `{}` is {action} while it is in flight", encoder.name));
        }
    }

    /// Adds a message if a submission in flight uses the object or binding that is about to change.
    pub(crate) fn check_unused(&self, used: Used, what: impl FnOnce() -> String) {
        if self.state().in_flight.iter().any(|submission| submission.used.contains(&used)) {
            self.messages.add(format!("{} while it is in flight", what()));
        }
    }

    pub(crate) fn complete(&self, encoder: Option<&Owned>) {
        let other =
            |submission: &InFlight| encoder.is_some_and(|encoder| encoder.number != submission.encoder);
        self.state().in_flight.retain(other);
    }

    pub(crate) fn is_idle(&self) -> bool {
        self.state().in_flight.is_empty()
    }
}

/// An object, counted as alive until it is dropped. Dropping it while in use adds a message.
pub struct Owned {
    pub(crate) object: Object,
    pub(crate) number: u64,
    pub(crate) name: String,
    pub(crate) journal: Journal,
}

impl Drop for Owned {
    fn drop(&mut self) {
        let Owned { object, number, name, journal } = self;
        journal.check_unused(Used::Object(*number), || format!("{object:?} `{name}` is destroyed"));
        if *object == Object::Swapchain && !journal.is_idle() {
            journal.messages.add(format!("swapchain `{name}` is destroyed while the device is not idle"));
        }
        let mut state = journal.state();
        *state.alive.entry(*object).or_default() -= 1;
        state.call(Call::Destroy { object: *object, name: std::mem::take(name) });
    }
}
