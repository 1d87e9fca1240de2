//! Faults: calls that are made to fail.

/// A call that fails, once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The kind of call.
    pub point: Point,
    /// The calls of this kind that succeed before it.
    pub after: u64,
}

/// A kind of call that can fail, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Point {
    /// Memory cannot be allocated.
    Allocate,
    /// An object other than memory cannot be created.
    Create,
    /// The driver does not come to the end of a pipeline until [`Journal::resume`](crate::Journal::resume).
    Compile,
    /// The device is lost when commands are submitted.
    Submit,
    /// The device is lost while it executes a submission, half of whose timestamps are written.
    Execute,
    /// The device does not come to the end of a submission, nor of any after it, until [`Journal::resume`](crate::Journal::resume);
    /// half of the submission's timestamps are written.
    Hang,
    /// The swapchain is out of date when an image is acquired.
    AcquireOutOfDate,
    /// The window gives no image in time.
    AcquireTimeout,
    /// The surface is lost when an image is acquired.
    AcquireLost,
    /// An image is acquired, and another swapchain would fit better.
    AcquireSuboptimal,
    /// The swapchain is out of date when an image is presented.
    PresentOutOfDate,
    /// The surface is lost when an image is presented.
    PresentLost,
    /// The image is shown, and another swapchain would fit better.
    PresentSuboptimal,
    /// The device is lost when an image is presented.
    Present,
    /// The surface cannot be queried, since it is lost.
    Surface,
}

impl Point {
    /// Every kind.
    pub const ALL: [Point; 15] = [
        Point::Allocate,
        Point::Create,
        Point::Compile,
        Point::Submit,
        Point::Execute,
        Point::Hang,
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
