//! Measures the quality that a budget of splats costs and the time that it saves, for several choices of splats.
//!
//! [`choice`] lists the choices and picks splats. [`measure`] draws a view with 1, 1/2, 1/4, ... of the splats and
//! compares each picture with the exact picture of the whole scene. [`approach`] moves a camera closer, where time
//! depends on covered pixels rather than on splats. [`study()`] does both, and [`page`] makes the table, the plots and
//! the page.

pub mod approach;
pub mod choice;
pub mod measure;
pub mod page;
mod study;

pub use study::{Study, Wanted, study};
