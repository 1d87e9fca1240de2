//! Defines the shape, owner and usage of buffers and images.

use bitflags::bitflags;
use serde::{Deserialize, Serialize};

use super::Format;

/// Dimensions of a buffer or an image; all are at least 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// An array of equal elements.
    Buffer {
        /// Bytes per element.
        stride: u64,
        /// Number of elements.
        count: u64,
    },
    /// A two-dimensional image.
    Image {
        /// Pixel format.
        format: Format,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
}

impl Shape {
    /// Returns the size of the contents in bytes, without padding.
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
    /// Owned by the plan and written by its passes. One copy serves all frames in flight.
    Transient,
    /// An attribute of the scene, uploaded before the prologue and never written by a pass. A large attribute consists
    /// of several planes, so that no buffer exceeds the device's limits.
    Scene {
        /// Full name of the attribute, such as `scene.position`.
        attribute: String,
        /// Index of the plane, from 0.
        plane: u32,
    },
    /// A uniform block that the host writes for every frame, one copy per frame in flight.
    Frame {
        /// Full name of the block, such as `frame.camera`.
        uniform: String,
    },
    /// A storage buffer of varying length that the host supplies with every frame. It has words from the host, or is
    /// another plan's output on the same device. No pass writes it. Its shape has the minimum length.
    HostBuffer {
        /// Full name of the buffer, such as `frame.words`.
        buffer: String,
    },
    /// The uniform block of the live parameters, written by the host for every frame.
    Live,
    /// Host-visible memory for the statistics, one copy per frame in flight: the export writes it, the host reads it.
    Readback,
}

impl Source {
    /// Returns true if there is one copy per frame in flight.
    pub fn is_per_frame(&self) -> bool {
        matches!(self, Source::Frame { .. } | Source::HostBuffer { .. } | Source::Live | Source::Readback)
    }
}

/// Formats a number of bytes with a binary unit, such as `1.5 MiB`.
pub fn bytes(n: u64) -> String {
    match n {
        0..1024 => format!("{n} B"),
        1024..1_048_576 => format!("{:.1} KiB", n as f64 / 1024.0),
        1_048_576..1_073_741_824 => format!("{:.1} MiB", n as f64 / 1_048_576.0),
        _ => format!("{:.2} GiB", n as f64 / 1_073_741_824.0),
    }
}

bitflags! {
    /// Uses of a resource, over all passes of a plan.
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
        /// Written by copies and fills; of an image, only by clears.
        const COPY_TARGET = 1 << 4;
        /// Used as a colour attachment.
        const COLOR_TARGET = 1 << 5;
        /// Used as a depth attachment.
        const DEPTH_TARGET = 1 << 6;
    }
}
