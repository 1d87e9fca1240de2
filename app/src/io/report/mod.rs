//! Makes tables, plots, and HTML pages of pictures, plots and tables.
//!
//! A [`plot::Plot`] is data, drawn as an SVG or a picture. A [`page::Page`] is written from top to bottom, and becomes
//! HTML that loads nothing from the network, so that it can be mailed or archived.

pub mod page;
pub mod plot;
pub mod text;
