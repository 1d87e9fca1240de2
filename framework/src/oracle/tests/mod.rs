//! hand-made plans, each with one thing right or wrong.

mod dependencies;
#[allow(dead_code)]
mod sketch;
