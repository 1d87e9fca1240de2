//! Defines the length of a replay, and the rules that decide what counts as a violation.

/// The number of frames to replay, and how far the host runs ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Replay {
    /// Number of frames to replay after the prologue and the handover.
    pub frames: u32,
    /// Maximum number of frames in flight: the host prepares frame `n` once frame `n - in_flight` has completed.
    pub in_flight: u32,
    /// Number of copies of each resource that the host writes or reads back: frame `n` uses copy `n % copies`.
    ///
    /// With fewer than `in_flight` copies, the host overwrites data that the device is still reading.
    pub copies: u32,
}

impl Default for Replay {
    /// Replays four frames, two of them in flight, so that each copy of the host's resources is used twice.
    fn default() -> Self {
        Replay { frames: 4, in_flight: 2, copies: 2 }
    }
}

/// Choices where the specification can be read in two ways, or where only validation layers demand a bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// If true, a write after a write requires the first to be visible to the second, as validation layers do.
    ///
    /// Otherwise the first need only be available, as in the memory model (Vulkan 1.3, appendix B).
    pub writes_see_writes: bool,
    /// If true, the barrier of a layout change must have the preceding write in its source masks.
    ///
    /// Validation layers require this even if an earlier barrier made the write available; the specification does not.
    /// It is not required after a read in between.
    pub changes_name_writes: bool,
}

impl Rules {
    /// Rules for finding hazards in a plan's barriers.
    pub const HAZARDS: Rules = Rules { writes_see_writes: true, changes_name_writes: false };
    /// Rules for deciding whether a part of a barrier is necessary.
    ///
    /// They demand the bits that the lowering adds to layout changes for validation layers only.
    pub const NECESSARY: Rules = Rules { writes_see_writes: true, changes_name_writes: true };
    /// The rules of [`Rules::NECESSARY`], but a write after a write requires only availability.
    pub const AVAILABILITY: Rules = Rules { writes_see_writes: false, changes_name_writes: true };
}
