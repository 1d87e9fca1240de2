//! Makes tables, plots, and pages that hold pictures, plots and tables in one file.
//!
//! A [`plot::Plot`] is data; it becomes an SVG or a picture. A [`page::Page`] is written from top to bottom, and ends as
//! HTML that needs no other file, so that it can be mailed or kept.

pub mod page;
pub mod plot;
pub mod text;
