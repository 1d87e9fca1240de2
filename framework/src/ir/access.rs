//! Pipeline stages, memory accesses, image layouts and hazards.
//!
//! Names and meanings are from Vulkan's synchronization2, which is finer than Metal's model. The dependencies of a plan
//! use them. Vulkan maps them one to one; Metal maps them to the two stages of a draw.

use bitflags::bitflags;
use serde::{Deserialize, Serialize};

bitflags! {
    /// Pipeline stages, after `VkPipelineStageFlagBits2`.
    ///
    /// The stages of one pipeline are ordered: `INDIRECT`, `VERTEX`, `FRAGMENT`, `COLOR_OUTPUT` for draws, and
    /// `INDIRECT`, `COMPUTE` for dispatches. (`INDIRECT` of a draw is not before `COMPUTE`.) `COPY`, `CLEAR` and `HOST`
    /// are unordered.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Stages: u32 {
        /// Reads the arguments of indirect commands.
        const INDIRECT = 1;
        /// Runs vertex shaders.
        const VERTEX = 1 << 1;
        /// Runs fragment shaders.
        const FRAGMENT = 1 << 2;
        /// Loads, blends and stores colour attachments.
        const COLOR_OUTPUT = 1 << 3;
        /// Runs compute shaders.
        const COMPUTE = 1 << 4;
        /// Runs copies.
        const COPY = 1 << 5;
        /// Runs fills and clears outside of draws.
        const CLEAR = 1 << 6;
        /// Reads on the CPU.
        const HOST = 1 << 7;
    }

    /// Kinds of memory access, after `VkAccessFlagBits2`.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Accesses: u32 {
        /// Reads arguments of an indirect command.
        const INDIRECT_READ = 1;
        /// Reads a uniform block.
        const UNIFORM_READ = 1 << 1;
        /// Reads a storage buffer or storage image.
        const STORAGE_READ = 1 << 2;
        /// Writes a storage buffer or storage image.
        const STORAGE_WRITE = 1 << 3;
        /// Reads a colour attachment, to load or to blend.
        const COLOR_READ = 1 << 4;
        /// Writes a colour attachment.
        const COLOR_WRITE = 1 << 5;
        /// Reads as a copy's source.
        const TRANSFER_READ = 1 << 6;
        /// Writes as a copy's or a fill's destination.
        const TRANSFER_WRITE = 1 << 7;
        /// Reads on the CPU.
        const HOST_READ = 1 << 8;
    }
}

impl Accesses {
    /// All kinds that write.
    pub const WRITES: Accesses =
        Accesses::STORAGE_WRITE.union(Accesses::COLOR_WRITE).union(Accesses::TRANSFER_WRITE);

    /// Returns true if any of them writes.
    pub fn writes(self) -> bool {
        self.intersects(Self::WRITES)
    }

    /// Returns true if any of them reads.
    pub fn reads(self) -> bool {
        !self.difference(Self::WRITES).is_empty()
    }
}

/// An image layout, as in Vulkan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Layout {
    /// The contents may be discarded.
    Undefined,
    /// Storage image.
    General,
    /// Colour attachment.
    ColorTarget,
    /// Source of a copy.
    TransferSource,
    /// Destination of a copy or a clear.
    TransferTarget,
}

/// The conflict behind a dependency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Hazard {
    /// A read must see an earlier write.
    ReadAfterWrite,
    /// A write must wait for an earlier read.
    WriteAfterRead,
    /// A write must follow an earlier write.
    WriteAfterWrite,
    /// Only the image's layout changes.
    LayoutChange,
}
