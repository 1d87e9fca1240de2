//! Checks that this crate's modules import one way, and that every crate has a uniform module layout and no circular
//! imports.

use std::fs;
use std::path::{Path, PathBuf};

#[path = "../../tests/module_order.rs"]
mod module_order;

/// The top-level modules of the crate, the lowest first.
const ROOMS: [&str; 7] = ["numbers", "io", "draw", "studies", "view", "lsp", "cli"];

#[test]
fn every_room_imports_only_those_before_it() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    module_order::assert_modules_run_one_way(&source, &ROOMS);
}

#[test]
fn no_files_of_a_crate_import_each_other_in_a_circle() {
    sources().iter().for_each(|source| module_order::assert_files_have_no_circle(source));
}

#[test]
fn modules_of_every_crate_are_laid_out_alike() {
    sources().iter().for_each(|source| module_order::assert_modules_are_laid_out_alike(source));
}

/// Lists the folders `src` of the workspace's members.
fn sources() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (_, members) = include_str!("../../Cargo.toml").split_once("\nmembers = [").expect("a list");
    let members = members.split(']').next().expect("it ends");
    let folders = members.split('"').skip(1).step_by(2).flat_map(|member| match member.strip_suffix("/*") {
        Some(parent) => {
            let inside = fs::read_dir(root.join(parent)).expect("a folder");
            inside.map(|entry| entry.expect("an entry").path()).collect()
        }
        None => vec![root.join(member)],
    });
    let mut found: Vec<PathBuf> =
        folders.map(|folder| folder.join("src")).filter(|src| src.is_dir()).collect();
    found.sort();
    assert!(found.len() > 8, "only {found:?}");
    found
}
