//! Data takes one way through the modules of the reference renderer, and so do the imports.

use std::path::Path;

#[path = "../../../tests/module_order.rs"]
mod module_order;

#[test]
fn every_module_imports_only_those_before_it() {
    let order = ["rules", "gaussian", "harmonics", "order", "project", "raster", "pixel"];
    module_order::assert_imports_run_one_way(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("src"),
        "crate",
        &order,
    );
}
