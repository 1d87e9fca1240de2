//! Reads and writes the PLY files of the 3DGS reference implementation.
//!
//! A PLY file is a text header followed by rows. The header names *elements* (`vertex`, perhaps `face`), their number
//! of rows, and the *properties* of a row with their types. The rows follow in that order, as text or as packed binary.
//! A splat is a row of `vertex` with these properties, in any order and of any scalar type:
//!
//! | property | meaning |
//! |---|---|
//! | `x y z` | centre, world units; y points down in captured scenes |
//! | `scale_0..2` | natural logarithm of the standard deviation along each axis |
//! | `rot_0..3` | quaternion w x y z, of any length but zero |
//! | `opacity` | logit |
//! | `f_dc_0..2` | spherical harmonics, band 0, red green blue |
//! | `f_rest_*` | bands 1 to the degree, channel-major: all of red's coefficients, then green's, then blue's |

pub(crate) mod ascii;
pub(crate) mod binary;
pub(crate) mod header;
pub(crate) mod layout;
pub(crate) mod origin;
pub(crate) mod pack;
mod packed;
pub(crate) mod read;
mod tags;
#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod write;
