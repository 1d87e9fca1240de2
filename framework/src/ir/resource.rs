//! Defines shapes, owners and uses of buffers and images.

use bitflags::bitflags;
use serde::{Deserialize, Serialize};

use super::Format;

/// Dimensions of a buffer or an image; none is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// A list of elements.
    Buffer {
        /// Bytes of an element.
        stride: u64,
        /// Number of elements.
        count: u64,
    },
    /// A two-dimensional image.
    Image {
        /// The format of a pixel.
        format: Format,
        /// Pixels in x.
        width: u32,
        /// Pixels in y.
        height: u32,
    },
}

impl Shape {
    /// Returns the size in bytes, without padding.
    pub fn bytes(self) -> u64 {
        match self {
            Shape::Buffer { stride, count } => stride * count,
            Shape::Image { format, width, height } => {
                format.bytes_per_pixel() as u64 * width as u64 * height as u64
            }
        }
    }
}

/// The owner of a resource's memory and the writer of its contents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Owned by the plan, written by its passes. One copy for all frames in flight.
    Transient,
    /// An attribute of the scene, uploaded before the prologue runs and never written by a pass. An attribute that
    /// exceeds the largest storage binding is split into planes.
    Scene {
        /// The attribute's full name.
        attribute: String,
        /// Index of the plane.
        plane: u32,
    },
    /// A uniform block that the host writes for every frame, one copy per frame in flight.
    Frame {
        /// The block's full name.
        uniform: String,
    },
    /// A storage buffer that the host supplies with every frame, of varying length: words from the host, or another
    /// plan's output on the same device. No pass writes it. Its shape has the minimum length.
    HostBuffer {
        /// The buffer's full name.
        buffer: String,
    },
    /// The uniform block of the live parameters, written by the host for every frame.
    Live,
    /// Host memory for the statistics: the export writes it, the host reads it after the frame. One copy per frame in
    /// flight.
    Readback,
}

impl Source {
    /// Returns true if each frame in flight has its own copy.
    pub fn is_per_frame(&self) -> bool {
        matches!(self, Source::Frame { .. } | Source::HostBuffer { .. } | Source::Live | Source::Readback)
    }
}

bitflags! {
    /// The uses of a resource, over all passes of a plan.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Usage: u32 {
        /// Bound as a storage buffer or storage image.
        const STORAGE = 1;
        /// Bound as a uniform block.
        const UNIFORM = 1 << 1;
        /// Holds arguments of indirect commands.
        const INDIRECT = 1 << 2;
        /// Read by copies.
        const COPY_SOURCE = 1 << 3;
        /// Written by copies, fills or clears.
        const COPY_TARGET = 1 << 4;
        /// Used as a colour attachment.
        const COLOR_TARGET = 1 << 5;
        /// Tested and written by draws as their depth attachment.
        const DEPTH_TARGET = 1 << 6;
    }
}
