//! Lists the files that are built into the binary (every graph under `pipelines/` and every shader under `shaders/`),
//! and names the commit that it is built from.

// A build script passes instructions to cargo on standard output, and creates files.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

fn main() {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo"));
    let mut files = Vec::new();
    for folder in ["pipelines", "shaders"] {
        if let Err(error) = walk(&here.join(folder), folder, &mut files) {
            panic!("the folder app/{folder}/ cannot be read: {error}");
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

    println!("cargo:rerun-if-env-changed=SPLATGRAPH_COMMIT");
    let mut version = env::var("CARGO_PKG_VERSION").expect("set by cargo");
    let commit = env::var("SPLATGRAPH_COMMIT").ok().or_else(|| commit(&here.join(".."))).unwrap_or_default();
    if let Some(commit) = commit.lines().next().filter(|commit| !commit.is_empty()) {
        version += &format!(" ({commit})");
    }
    println!("cargo:rustc-env=SPLATGRAPH_VERSION={version}");
}

/// Returns the commit of a checkout, with `-dirty` if files differ from it; `None` without a checkout or without git.
///
/// Cargo runs this script again if a source of the program differs, which compiles the program anyway. A release build
/// with `-dirty` is also built again after the next commit, so that it does not keep the earlier commit. Other builds
/// do not watch `.git`, which would compile the program after every commit.
fn commit(root: &Path) -> Option<String> {
    // In another folder, git would find a repository around it, such as a distribution's.
    if !root.join(".git").exists() {
        return None;
    }
    let sources = ["Cargo.lock", "app/src", "assets/src", "framework/src"].map(|source| root.join(source));
    let backends = fs::read_dir(root.join("backends")).into_iter().flatten().flatten();
    for source in sources.into_iter().chain(backends.map(|backend| backend.path().join("src"))) {
        println!("cargo:rerun-if-changed={}", source.display());
    }
    let git = |arguments: &[&str]| -> Option<String> {
        let mut git = Command::new("git");
        // Set in hooks of a repository that builds this one.
        for variable in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
            git.env_remove(variable);
        }
        let found = git.arg("--no-optional-locks").arg("-C").arg(root).args(arguments).output().ok()?;
        found.status.success().then(|| String::from_utf8(found.stdout).ok())?
    };
    let commit = git(&["describe", "--always", "--dirty", "--exclude=*", "--abbrev=12"])?;
    if commit.trim_end().ends_with("-dirty") && env::var("PROFILE").is_ok_and(|p| p == "release") {
        // A worktree has its log in the folder of the repository.
        let log = git(&["rev-parse", "--git-path", "logs/HEAD"]).map(|log| root.join(log.trim_end()));
        if let Some(log) = log.filter(|log| log.exists()) {
            println!("cargo:rerun-if-changed={}", log.display());
        }
    }
    Some(commit)
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
