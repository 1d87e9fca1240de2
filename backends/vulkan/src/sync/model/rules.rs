//! The length of a replay, and the rules by which it is judged.

/// Sets the length of a replay and its frames in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Replay {
    /// Frames after the prologue and the handover.
    pub frames: u32,
    /// The host prepares frame `n` when frame `n - in_flight` is finished.
    pub in_flight: u32,
    /// Copies of what the host touches: frame `n` uses copy `n % copies`. With fewer than `in_flight` the host writes
    /// what the device is still reading.
    pub copies: u32,
}

impl Default for Replay {
    /// Four frames, two of them in flight: each copy of what the host touches is used twice.
    fn default() -> Self {
        Replay { frames: 4, in_flight: 2, copies: 2 }
    }
}

/// Chooses among readings of the specification, and among the reasons for a bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// A write after a write needs the first to be visible to the second, as validation has it. Otherwise it is enough that the
    /// first is available, as in the memory model (Vulkan 1.3, appendix B).
    pub writes_see_writes: bool,
    /// A layout change names the write before it in its own source, if nothing has read that since, also where an earlier barrier
    /// made it available. The specification does not ask for this; validation layers do.
    pub changes_name_writes: bool,
}

impl Rules {
    /// The rules by which a plan is judged.
    pub const HAZARDS: Rules = Rules { writes_see_writes: true, changes_name_writes: false };
    /// The rules by which a part of a barrier is needed: the lowering places bits for layout changes that only layers ask for.
    pub const NECESSARY: Rules = Rules { writes_see_writes: true, changes_name_writes: true };
    /// The same, with availability alone for writes after writes.
    pub const AVAILABILITY: Rules = Rules { writes_see_writes: false, changes_name_writes: true };
}
