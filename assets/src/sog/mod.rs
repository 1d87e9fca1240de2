//! Reads and writes PlayCanvas's SOG files, version 2: a ZIP archive of lossless WebP textures with a texel per splat, and `meta.json`.
//!
//! | texture | value of the splat's texel |
//! |---|---|
//! | `means` (two) | low and high bytes of 16 bits per axis, between `mins` and `maxs`, of `sign(v) ln(1 + abs(v))` |
//! | `scales` | per axis an index into the `codebook` of logarithms |
//! | `quats` | red, green, blue: the three smaller components, `(u / 255 * 2 - 1) / sqrt(2)`; alpha - 252: the index of the largest of w, x, y, z |
//! | `sh0` | red, green, blue: indices into the `codebook` of band 0; alpha: opacity `u / 255` |
//! | `shN` (two) | label, 16 bits in red and green, of an entry of the palette, whose coefficients are indices into the `codebook` |
//!
//! Texel `i` is at column `i % width` and row `i / width`. The palette has 64 entries per row, and a texel per coefficient. Format:
//! <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/>.

mod archive;
mod codebook;
mod meta;
mod palette;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(crate) use read::{header, parse};
pub(crate) use write::write;

/// First bytes of a ZIP archive.
pub(crate) const MAGIC: &[u8; 4] = b"PK\x03\x04";
