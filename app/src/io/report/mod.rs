//! Makes tables, plots, and self-contained HTML pages of pictures, plots and tables.
//!
//! A [`plot::Plot`] is data, drawn as an SVG or a picture. A [`page::Page`] is written from top to bottom, and ends as
//! HTML that needs no other file, so that it can be mailed or archived.

pub mod page;
pub mod plot;
pub mod text;
