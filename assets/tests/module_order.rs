//! Checks that the imports of the crate run one way.

use std::path::Path;

#[path = "../../tests/module_order.rs"]
mod module_order;

/// The modules, from the ground up.
const ORDER: [&str; 22] = [
    "bounds",
    "file",
    "memory",
    "error",
    "activation",
    "harmonics",
    "size_breakdown",
    "scene",
    "edit",
    "attributes",
    "camera",
    "dataset",
    "input",
    "ply",
    "splat",
    "ksplat",
    "spz",
    "sog",
    "recognise",
    "formats",
    "report",
    "synth",
];

#[test]
fn every_module_imports_only_those_before_it() {
    module_order::assert_imports_run_one_way(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("src"),
        "crate",
        &ORDER,
    );
}
