//! Tests of the checker on plans made by hand, each with one thing right or wrong.

mod dependencies;
#[allow(dead_code)]
mod sketch;
