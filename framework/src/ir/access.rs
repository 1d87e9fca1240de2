//! Defines pipeline stages, memory accesses, image layouts and hazards.
//!
//! Names and meanings follow Vulkan's synchronization2, which is finer than Metal's model. The Vulkan backend maps
//! them one to one, except that `CLEAR` becomes clear and copy. The Metal backend reduces the stages of a draw to
//! vertex and fragment.

use std::fmt;

use bitflags::bitflags;
use bitflags::parser::to_writer;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Usage;

bitflags! {
    /// Pipeline stages, after `VkPipelineStageFlagBits2`.
    ///
    /// The stages of one pipeline are ordered: `INDIRECT`, `VERTEX`, `EARLY_TESTS`, `FRAGMENT`, `LATE_TESTS`,
    /// `COLOR_OUTPUT` for draws, and `INDIRECT`, `COMPUTE` for dispatches. (`INDIRECT` of a draw is not before
    /// `COMPUTE`.) `COPY`, `CLEAR` and `HOST` are unordered.
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
        /// Loads depth attachments; tests and writes depths before fragment shaders.
        const EARLY_TESTS = 1 << 8;
        /// Tests and writes depths after fragment shaders that discard or write depths; stores depth attachments.
        const LATE_TESTS = 1 << 9;
    }

    /// Kinds of memory access, modelled on `VkAccessFlagBits2`.
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
        /// Writes as the destination of a copy, a fill or a clear.
        const TRANSFER_WRITE = 1 << 7;
        /// Reads on the CPU.
        const HOST_READ = 1 << 8;
        /// Reads a depth attachment, to test.
        const DEPTH_READ = 1 << 9;
        /// Writes a depth attachment.
        const DEPTH_WRITE = 1 << 10;
    }
}

/// Implements `Display` (`A | B`) and serde (a list of names) for sets of flags.
macro_rules! named {
    ($($set:ident),*) => { $(
        impl fmt::Display for $set {
            fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
                to_writer(self, f)
            }
        }

        impl Serialize for $set {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_seq(self.iter_names().map(|(name, _)| name))
            }
        }

        impl<'de> Deserialize<'de> for $set {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<$set, D::Error> {
                let names = Vec::<String>::deserialize(deserializer)?;
                let unknown = |name: &str| D::Error::custom(format!("expected a flag, found `{name}`"));
                names.iter().map(|name| $set::from_name(name).ok_or_else(|| unknown(name))).collect()
            }
        }
    )* };
}
named!(Stages, Accesses, Usage);

impl Stages {
    /// The stages that test and write depth attachments.
    pub const DEPTH_TESTS: Stages = Stages::EARLY_TESTS.union(Stages::LATE_TESTS);
}

impl Accesses {
    /// All kinds that write.
    pub const WRITES: Accesses = Accesses::STORAGE_WRITE
        .union(Accesses::COLOR_WRITE)
        .union(Accesses::DEPTH_WRITE)
        .union(Accesses::TRANSFER_WRITE);

    /// Returns true if any of these accesses writes.
    pub fn writes(self) -> bool {
        self.intersects(Self::WRITES)
    }

    /// Returns true if any of these accesses reads.
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
    /// Depth attachment.
    DepthTarget,
    /// Source of a copy.
    TransferSource,
    /// Destination of a clear, or of a backend's copy of a history. No plan copies to an image.
    TransferTarget,
}

/// The kind of conflict that causes a dependency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Hazard {
    /// A read must see an earlier write.
    ReadAfterWrite,
    /// A write must wait for an earlier read.
    WriteAfterRead,
    /// A write must follow an earlier write.
    WriteAfterWrite,
    /// Only the image's layout change waits for earlier accesses, not the pass.
    LayoutChange,
}

/// Stages and accesses on both sides of a dependency or a barrier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Masks {
    /// The stages to wait for.
    pub source_stages: Stages,
    /// The earlier accesses; of a barrier, the writes to make available.
    pub source_accesses: Accesses,
    /// The stages that wait.
    pub target_stages: Stages,
    /// The later accesses; of a barrier, the accesses that the writes become visible to.
    pub target_accesses: Accesses,
}

impl Masks {
    /// Creates masks from the stages and accesses of each side.
    pub fn new(source: (Stages, Accesses), target: (Stages, Accesses)) -> Masks {
        Masks {
            source_stages: source.0,
            source_accesses: source.1,
            target_stages: target.0,
            target_accesses: target.1,
        }
    }

    /// Returns the masks of the source, with an empty target.
    pub fn source(self) -> Masks {
        Masks { target_stages: Stages::empty(), target_accesses: Accesses::empty(), ..self }
    }

    /// Returns the masks of the target, with an empty source.
    pub fn target(self) -> Masks {
        Masks { source_stages: Stages::empty(), source_accesses: Accesses::empty(), ..self }
    }

    /// Adds the bits of other masks.
    pub fn add(&mut self, bits: Masks) {
        self.source_stages |= bits.source_stages;
        self.source_accesses |= bits.source_accesses;
        self.target_stages |= bits.target_stages;
        self.target_accesses |= bits.target_accesses;
    }

    /// Returns the union with other masks.
    pub fn with(mut self, bits: Masks) -> Masks {
        self.add(bits);
        self
    }

    /// Returns the bits of these masks that `bits` lacks.
    pub fn without(self, bits: Masks) -> Masks {
        Masks {
            source_stages: self.source_stages - bits.source_stages,
            source_accesses: self.source_accesses - bits.source_accesses,
            target_stages: self.target_stages - bits.target_stages,
            target_accesses: self.target_accesses - bits.target_accesses,
        }
    }

    /// Splits the masks into single bits: on each side, accesses before stages.
    pub fn bits(self) -> impl Iterator<Item = Masks> {
        let none = Masks::default;
        let accesses = self.source_accesses.iter().map(move |bit| Masks { source_accesses: bit, ..none() });
        let stages = self.source_stages.iter().map(move |bit| Masks { source_stages: bit, ..none() });
        let seen = self.target_accesses.iter().map(move |bit| Masks { target_accesses: bit, ..none() });
        let seers = self.target_stages.iter().map(move |bit| Masks { target_stages: bit, ..none() });
        accesses.chain(stages).chain(seen).chain(seers)
    }
}

impl fmt::Display for Masks {
    /// Writes both sides, such as `COMPUTE STORAGE_WRITE -> INDIRECT | COMPUTE INDIRECT_READ | STORAGE_READ`. A side
    /// without stages is `NONE`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let half = |stages: Stages, accesses: Accesses| match (stages.is_empty(), accesses.is_empty()) {
            (true, _) => "NONE".to_owned(),
            (_, true) => stages.to_string(),
            _ => format!("{stages} {accesses}"),
        };
        let source = half(self.source_stages, self.source_accesses);
        write!(f, "{source} -> {}", half(self.target_stages, self.target_accesses))
    }
}
