//! Reads Spark's `.rad` files, with chunks inside or in `.radc` files beside them, and single `.radc` files.
//!
//! A file is a header and chunks of at most 65,536 splats. Header and chunks begin with a magic number, the length of a
//! JSON text and the text, padded to 8 bytes. After a chunk's text come the payload's length and the payload: one array
//! per property, usually compressed as a raw deflate stream. The values of an array are planar: all of the first
//! component, then all of the second.
//!
//! | property | components | value |
//! |---|---|---|
//! | `center`, `scales` | 3 | position; standard deviations |
//! | `alpha` | 1 | opacity; in a tree, up to 2 |
//! | `rgb` | 3 | `0.5 + 0.282 f_dc` |
//! | `orientation` | 3 | x, y and z of a quaternion whose w is not negative, or an axis and an angle (`oct88r8`) |
//! | `sh1`, `sh2`, `sh3` | 9, 15, 21 | harmonics of a band: red, green and blue of each coefficient |
//! | `sh1_code`, ...; `sh_label` | as above; 1 | palette of harmonics, in the first chunk; index of a splat's entry |
//! | `child_count`, `child_start` | 1 | children in the tree of levels of detail, which come after their parent |
//!
//! | encoding | value of the bytes |
//! |---|---|
//! | `f32`, `f16`, `u16`, `u32` | a number, little-endian |
//! | `f32_lebytes`, `f16_lebytes` | the same, planar by byte: the lowest bytes of all values come first |
//! | `r8` | `min + u / 255 (max - min)` |
//! | `s8` | `i / 127 max` |
//! | `r8_delta`, `s8_delta` | as for `r8` and `s8`; a byte is the difference from the byte before, modulo 256 |
//! | `ln_0r8` | 0 for 0; otherwise the logarithm is `min + (u - 1) / 254 (max - min)` |
//! | `ln_f16` | a half float, the logarithm |
//! | `oct88r8` | an octahedral unit vector in two bytes, and half the angle, `u / 255 pi / 2` |
//!
//! The leaves of a tree are the splats that it was built from; only they are read. A node above them merges its
//! children and can have an opacity above 1, which encodes a profile other than a Gaussian. Format:
//! <https://github.com/sparkjsdev/spark>, `rust/spark-lib/src/rad.rs`.

mod chunk;
mod column;
mod document;
mod read;
#[cfg(test)]
pub(crate) mod tests;

pub(crate) use document::{CHUNK_MAGIC, MAGIC};
pub(crate) use read::{header, parse};
