//! Injects faults: makes chosen calls fail.

/// A single call that fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The kind of call.
    pub point: Point,
    /// Number of calls of this kind that succeed first.
    pub after: u64,
}

/// A kind of call that can fail, and its failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Point {
    /// Memory cannot be allocated.
    Allocate,
    /// An object other than memory cannot be created.
    Create,
    /// The driver hangs while it compiles a pipeline, until [`Journal::resume`](crate::Journal::resume).
    Compile,
    /// The device is lost when commands are submitted.
    Submit,
    /// The device is lost while it executes a submission: half of the submission's timestamps are written.
    Execute,
    /// The device hangs in a submission, and so in all later ones, until [`Journal::resume`](crate::Journal::resume).
    /// Half of the submission's timestamps are written.
    Hang,
    /// The submitting thread is delayed: the call returns some milliseconds after the commands are in the queue.
    LateSubmit,
    /// A wait for a submission fails for lack of memory. The submission stays in flight.
    Wait,
    /// The swapchain is out of date when an image is acquired.
    AcquireOutOfDate,
    /// The window gives no image within the time limit.
    AcquireTimeout,
    /// The surface is lost when an image is acquired.
    AcquireLost,
    /// The acquired image is suboptimal.
    AcquireSuboptimal,
    /// The swapchain is out of date when an image is presented.
    PresentOutOfDate,
    /// The surface is lost when an image is presented.
    PresentLost,
    /// The image is presented, but the swapchain is reported suboptimal.
    PresentSuboptimal,
    /// The device is lost when an image is presented.
    Present,
    /// The window's size cannot be queried, because the surface is lost.
    Surface,
}

impl Point {
    /// Every kind of call.
    pub const ALL: [Point; 17] = [
        Point::Allocate,
        Point::Create,
        Point::Compile,
        Point::Submit,
        Point::Execute,
        Point::Hang,
        Point::LateSubmit,
        Point::Wait,
        Point::AcquireOutOfDate,
        Point::AcquireTimeout,
        Point::AcquireLost,
        Point::AcquireSuboptimal,
        Point::PresentOutOfDate,
        Point::PresentLost,
        Point::PresentSuboptimal,
        Point::Present,
        Point::Surface,
    ];
}
