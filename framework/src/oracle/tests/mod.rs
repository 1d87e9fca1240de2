//! Tests of the checker on hand-made plans, each with one property right or wrong.

mod dependencies;
#[allow(dead_code)]
mod sketch;
