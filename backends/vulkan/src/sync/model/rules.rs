//! Defines the length of a replay, and the rules by which it is judged.

/// Length of a replay, and its frames in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Replay {
    /// Number of frames after the prologue and the handover.
    pub frames: u32,
    /// Number of frames in flight: the host prepares frame `n` when frame `n - in_flight` is finished.
    pub in_flight: u32,
    /// Number of copies of resources that the host accesses: frame `n` uses copy `n % copies`. With fewer than
    /// `in_flight`, the host writes data that the device is still reading.
    pub copies: u32,
}

impl Default for Replay {
    /// Four frames, two of them in flight: each copy of the host's resources is used twice.
    fn default() -> Self {
        Replay { frames: 4, in_flight: 2, copies: 2 }
    }
}

/// Choices among interpretations of the specification, and among the reasons for a bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// If true, a write after a write requires the first to be visible to the second, as in validation. Otherwise
    /// availability of the first suffices, as in the memory model (Vulkan 1.3, appendix B).
    pub writes_see_writes: bool,
    /// If true, a layout change names the preceding write in its own source even if an earlier barrier made the write
    /// available. A read between the two removes this need. Validation layers require this; the specification does not.
    pub changes_name_writes: bool,
}

impl Rules {
    /// Rules by which a plan is judged.
    pub const HAZARDS: Rules = Rules { writes_see_writes: true, changes_name_writes: false };
    /// Rules by which a part of a barrier counts as needed: the lowering adds bits to layout changes that only
    /// validation layers require.
    pub const NECESSARY: Rules = Rules { writes_see_writes: true, changes_name_writes: true };
    /// Like [`Rules::NECESSARY`], but a write after a write requires only availability.
    pub const AVAILABILITY: Rules = Rules { writes_see_writes: false, changes_name_writes: true };
}
