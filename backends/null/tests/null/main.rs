//! Tests the runtime call by call, on a device that executes nothing.

mod common;
mod compilers;
mod faults;
mod frames;
mod histories;
#[path = "../../../../tests/module_order.rs"]
mod module_order;
#[path = "../../../../framework/tests/nominal/mod.rs"]
mod nominal;
mod once;
mod presets;
mod results;
#[path = "../../../runtime/src/testing.rs"]
mod testing;
mod uploads;
mod window;

/// The modules of the crate, in order: each may import only earlier ones.
const ORDER: [&str; 5] = ["fault", "journal", "gpu", "encoder", "backend"];

#[test]
fn every_module_imports_only_those_before_it() {
    let source = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    module_order::assert_modules_run_one_way(&source, &ORDER);
}
