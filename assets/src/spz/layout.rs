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

/// Fractional bits of positions, unless the scene is too large.
const FRACTIONAL_BITS: u32 = 12;

/// Largest signed 24-bit integer.
pub(super) const MAX_FIXED: f64 = 8_388_607.0;

/// Returns the largest number of fractional bits, at most [`FRACTIONAL_BITS`], with which a coordinate fits; `None` if
/// none does.
pub(super) fn fractional_bits(largest: f64) -> Option<u32> {
    let fits = |bits: &u32| (largest * f64::from(1u32 << bits)).round() <= MAX_FIXED;
    (0..=FRACTIONAL_BITS).rev().find(fits)
}

impl SpzVersion {
    /// Returns the step of all positions in a file whose largest coordinate has this absolute value. The step is 1/4096
    /// unit, or more beyond 2048 units. `None` if the coordinate does not fit.
    pub fn position_step(largest: f64) -> Option<f64> {
        fractional_bits(largest).map(|bits| 0.5f64.powi(bits as i32))
    }
}

/// Bit of `flags`: the splats were trained with an anti-aliasing filter.
pub(super) const ANTIALIASED: u8 = 1;

/// Bit of `flags`: the file has extension records.
pub(super) const EXTENSIONS: u8 = 2;

/// Type of the extension record that specifies the axes (Adobe).
pub(super) const COORDINATE_SYSTEM: u32 = 0xADBE_0003;

/// Scale of band 0 in `colors`: byte / 255 = 0.15 c + 0.5. The bytes thus cover colours below 0 and above 1.
pub(super) const COLOR_SCALE: f64 = 0.15;
