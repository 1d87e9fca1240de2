//! Checks that the imports of the crate run one way, and that its modules are laid out alike.

use std::path::Path;

#[path = "../../tests/module_order.rs"]
mod module_order;

/// The top-level modules of the crate, the lowest first.
const ROOMS: [&str; 7] = ["numbers", "io", "draw", "studies", "view", "lsp", "cli"];

#[test]
fn every_room_imports_only_those_before_it() {
    module_order::assert_modules_run_one_way(&source(), &ROOMS);
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    module_order::assert_files_have_no_circle(&source());
}

#[test]
fn modules_are_laid_out_alike() {
    module_order::assert_modules_are_laid_out_alike(&source());
}

fn source() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}
