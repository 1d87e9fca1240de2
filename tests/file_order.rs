//! Checks a crate's own files: no circular imports, and a uniform layout of modules. Several crates have this test.

use std::path::Path;

mod module_order;

#[test]
fn no_files_import_each_other_in_a_circle() {
    module_order::assert_files_have_no_circle(source());
}

#[test]
fn modules_are_laid_out_alike() {
    module_order::assert_modules_are_laid_out_alike(source());
}

fn source() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src"))
}
