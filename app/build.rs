//! Lists the files that are built into the binary: every graph under `pipelines/` and every shader under `shaders/`.

// A build script passes instructions to cargo on standard output, and creates files.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() {
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo")).join("..");
    let mut files = Vec::new();
    for folder in ["pipelines", "shaders"] {
        if let Err(error) = walk(&root.join(folder), folder, &mut files) {
            panic!("the folder {folder}/ beside app/ cannot be read: {error}");
        }
    }
    files.sort();

    let mut code = String::from("&[\n");
    for (name, path) in &files {
        writeln!(code, "    ({name:?}, include_str!({path:?})),").expect("a string takes everything");
    }
    code.push_str("]\n");
    let target = PathBuf::from(env::var_os("OUT_DIR").expect("set by cargo")).join("builtin.rs");
    fs::write(&target, code).unwrap_or_else(|error| panic!("{}: {error}", target.display()));
}

/// Adds the files under `folder`, each by its name from the root, with slashes, and its absolute path.
///
/// Cargo watches the folders for added and removed files; it knows the files from `include_str!`.
fn walk(folder: &Path, name: &str, files: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    println!("cargo:rerun-if-changed={}", folder.display());
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let file = entry.file_name();
        // Hidden files and editors' backups are not built in.
        let Some(file) = file.to_str().filter(|f| !f.starts_with('.') && !f.ends_with('~')) else { continue };
        let name = format!("{name}/{file}");
        if entry.file_type()?.is_dir() {
            walk(&entry.path(), &name, files)?;
        } else if [".ron", ".comp", ".vert", ".frag", ".glsl"].iter().any(|e| file.ends_with(e)) {
            files.push((name, entry.path().canonicalize()?));
        }
    }
    Ok(())
}
