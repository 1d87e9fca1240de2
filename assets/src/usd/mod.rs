//! Reads the Gaussian splats of OpenUSD: `.usda` (text), `.usdc` (binary) and `.usdz` (an archive).
//!
//! A *layer* is a tree of *prims*, each with attributes. A prim of the type `ParticleField3DGaussianSplat` has these:
//!
//! | attribute | value |
//! |---|---|
//! | `positions` | centre, in the space of the prim |
//! | `orientations` | quaternion w, x, y, z (binary: x, y, z, w) |
//! | `scales` | standard deviations |
//! | `opacities` | 0 to 1 |
//! | `radiance:sphericalHarmonicsCoefficients` | red, green, blue of each coefficient from band 0 on, splat by splat |
//! | `radiance:sphericalHarmonicsDegree` | degree of the harmonics, 3 without it |
//!
//! An array can be stored as half floats instead, in an attribute whose name ends with `h`. If both exist, the floats
//! are read. The attributes `xformOp:...` of a prim and its ancestors place the splats in the world, whose vertical
//! axis is `upAxis`: y or z.
//!
//! One layer is read. Layers that refer to others, or have variants, are refused: OpenUSD's `usdcat --flatten` joins
//! them. Format: <https://openusd.org/release/api/usd_vol_page_front.html> and `pxr/usd/usd/crateFile.cpp` in
//! <https://github.com/PixarAnimationStudios/OpenUSD>.

mod binary;
mod layer;
mod package;
mod packing;
mod read;
#[cfg(test)]
pub(crate) mod tests;
mod text;
mod xform;

pub(crate) use binary::MAGIC as BINARY_MAGIC;
pub(crate) use package::begins_as_package;
pub(crate) use read::{header, parse};
pub(crate) use text::MAGIC as TEXT_MAGIC;
