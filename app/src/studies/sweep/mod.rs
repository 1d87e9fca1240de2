//! Measures the time and the error of drawing fewer splats, chosen by several criteria.
//!
//! [`choice`] has the criteria. [`study()`] draws every view with 1, 1/2, 1/4, ... of the splats, and compares each
//! picture with the exact picture of the whole scene; [`measure`] defines these steps. [`approach`] moves a camera
//! closer, to vary covered pixels and splats independently. [`page`] makes the table, the plots and the page.

pub mod approach;
pub mod choice;
pub mod measure;
pub mod page;
mod study;

pub use study::{Study, Wanted, study};
