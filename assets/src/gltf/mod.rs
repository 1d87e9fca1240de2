//! Reads and writes glTF with `KHR_gaussian_splatting`: `.glb`, and `.gltf` with its buffers inside or beside it.
//!
//! A primitive of points contains the splats, with an accessor for each kind of value. A *document* is JSON: nodes
//! place meshes, meshes have primitives, and accessors locate the values of an attribute in a buffer. A `.glb` contains
//! the JSON and the first buffer.
//!
//! | attribute | value |
//! |---|---|
//! | `POSITION` | centre, in the space of the node |
//! | `KHR_gaussian_splatting:ROTATION` | unit quaternion x, y, z, w |
//! | `KHR_gaussian_splatting:SCALE` | standard deviations, or (early writers) logarithms, if any is negative |
//! | `KHR_gaussian_splatting:OPACITY` | 0 to 1 |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | coefficient `n` of band `l`, red, green and blue |
//!
//! With `KHR_gaussian_splatting_compression_spz_2`, the values are an SPZ file in a buffer. Axes point left, up and
//! front in glTF, so x and y change their signs. Format: <https://github.com/KhronosGroup/glTF>,
//! extensions/2.0/Khronos.
//!
//! The crate `gltf` is not used here: it drops the names of attributes that it does not know.

mod cameras;
mod columns;
mod container;
mod document;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(crate) use cameras::cameras;
pub(crate) use columns::Component;
pub(crate) use container::{MAGIC, begins_as_gltf};
pub(crate) use document::{VISIBILITY, visible};
pub(crate) use read::{header, parse};
pub(crate) use write::{write, write_head};
