//! Tests the checker on hand-made plans, each without a mistake or with one.

mod dependencies;
#[allow(dead_code)]
mod sketch;
