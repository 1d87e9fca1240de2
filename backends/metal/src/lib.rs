//! Runs plans on Apple GPUs.
//!
//! The crate has two halves. One lowers a plan to Metal's terms, as plain data: `lower` describes pipelines and arguments, and
//! [`barriers`] divides the passes into encoders with fences between them. It calls nothing of Apple's and is compiled and tested
//! everywhere; [`model`] checks the fences by Metal's rules. The other half, for Apple's systems alone, makes the objects and walks over
//! that data.

#![deny(missing_docs)]

pub mod barriers;
pub mod dump;
pub mod model;
#[cfg(test)]
mod testing;
