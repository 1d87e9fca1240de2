//! Defines the sizes and tags of SPZ files.

pub(crate) const MAGIC: &[u8; 4] = b"NGSP";

/// Size of the header up to version 3, in bytes.
pub(super) const HEADER: usize = 16;

/// Size of the header of version 4, in bytes.
pub(super) const LONG_HEADER: usize = 32;

/// Size of an entry of version 4's table of contents, in bytes.
pub(super) const ENTRY: usize = 16;

/// A version of SPZ to write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// One gzip stream of all arrays.
    V3 = 3,
    /// One Zstandard stream per array. Readers of version 3 cannot read it.
    #[default]
    V4 = 4,
}

/// Bit of `flags`: the splats were trained with an anti-aliasing filter.
pub(super) const ANTIALIASED: u8 = 1;

/// Bit of `flags`: records follow the arrays.
pub(super) const EXTENSIONS: u8 = 2;

/// Type of the extension record that specifies the axes (Adobe).
pub(super) const COORDINATE_SYSTEM: u32 = 0xADBE_0003;

/// Scale of band 0 in `colors`: byte / 255 = 0.15 c + 0.5. The bytes thus cover colours below 0 and above 1.
pub(super) const COLOR_SCALE: f64 = 0.15;
