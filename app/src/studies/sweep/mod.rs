//! Measures the time and the error of drawing fewer splats, chosen by several criteria.
//!
//! [`choice`] has the criteria. [`measure`] draws a view with 1, 1/2, 1/4, ... of the splats and compares each picture
//! with the exact picture of the whole scene. [`approach`] moves a camera closer, to vary covered pixels and splats
//! independently. [`study()`] does both, and [`page`] makes the table, the plots and the page.

pub mod approach;
pub mod choice;
pub mod measure;
pub mod page;
mod study;

pub use study::{Study, Wanted, study};
