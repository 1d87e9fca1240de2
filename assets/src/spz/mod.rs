//! Reads Niantic's SPZ files, versions 1 to 4, and writes versions 3 and 4.
//!
//! Up to version 3, a file is a gzip stream ([`gzip`]) of a header, the arrays in order, and extension records. In
//! version 4, the header is uncompressed and longer, and each array has its own stream ([`streams`]).
//!
//! | bytes of the header | value |
//! |---|---|
//! | 0, 4 | `magic` "NGSP"; `version` |
//! | 8 | `numPoints`, splats |
//! | 12 | `shDegree`, 0 to 4: of degree 4, the bands to 3 are read |
//! | 13 | `fractionalBits` of positions |
//! | 14 | `flags`: 1 antialiased, 2 extensions |
//! | 15 | reserved (version 4: number of streams) |
//!
//! | array | bytes per splat | value |
//! |---|---|---|
//! | `positions` | 9 (version 1: 6) | 24-bit integers, `i / 2^fractionalBits` (version 1: half floats) |
//! | `alphas` | 1 | opacity `u / 255` |
//! | `colors` | 3 | band 0, `(u / 255 - 0.5) / 0.15` |
//! | `scales` | 3 | logarithm `u / 16 - 10` |
//! | `rotations` | 4 | index of the largest component, the others in 9 bits and a sign (before version 3: see below) |
//! | `sh` | 3 per coefficient | `(u - 128) / 128`, coefficient by coefficient, red, green and blue of each |
//!
//! Before version 3, rotations have 3 bytes: x, y and z. Axes point right, up and back unless the extension
//! [`layout::COORDINATE_SYSTEM`] names others. A scene's axes point right, down and to the front, so y, z and some
//! harmonics change sign ([`frame`]). Format: <https://github.com/nianticlabs/spz>.

mod frame;
mod gzip;
mod header;
mod layout;
mod read;
mod streams;
#[cfg(test)]
mod tests;
mod write;

pub(crate) use frame::flip;
pub(crate) use gzip::begins_as_spz;
pub(crate) use layout::MAGIC;
pub use layout::SpzVersion;
pub(crate) use read::{header, parse};
pub(crate) use write::write;
