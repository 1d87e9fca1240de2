//! Checks that imports follow the order of the crate's modules.

use std::path::Path;

#[path = "../../../tests/module_order.rs"]
mod module_order;

const ORDER: [&str; 9] = ["error", "features", "lower", "progress", "times", "sync", "dump", "walk", "apple"];

#[test]
fn every_module_imports_only_those_before_it() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    module_order::assert_modules_run_one_way(&source, &ORDER);
}
