//! Checks that the imports of the application run one way.

use std::path::Path;

#[path = "../../tests/module_order.rs"]
mod module_order;

/// The rooms of the crate, from the ground up.
const CRATE: [&str; 7] = ["numbers", "io", "draw", "studies", "view", "lsp", "cli"];

/// The modules of `io`, from the ground up.
const IO: [&str; 6] = ["output", "folders", "image", "report", "progress", "demo"];

/// The modules of `draw`, from the ground up.
const DRAW: [&str; 19] = [
    "backend",
    "camera",
    "camera_path",
    "orbit",
    "pick",
    "truth",
    "inspect",
    "stats",
    "keys",
    "facts",
    "builtin",
    "capacity",
    "planner",
    "shader_cache",
    "render_command",
    "fit",
    "session",
    "interleaved",
    "capture",
];

/// The modules of `studies`, from the ground up.
const STUDIES: [&str; 10] = [
    "metrics",
    "evaluation",
    "study",
    "measurement",
    "trade",
    "bench",
    "sweep",
    "advise",
    "experiment",
    "popping",
];

/// The modules of the viewer, from the ground up.
const VIEW: [&str; 19] = [
    "profile",
    "animation",
    "history",
    "navigation",
    "wheel",
    "paint",
    "renderer",
    "events",
    "opening",
    "picking",
    "cameras",
    "viewport",
    "viewer",
    "undo",
    "panels",
    "kept",
    "shell",
    "recovery",
    "window",
];

#[test]
fn every_module_imports_only_those_before_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    module_order::assert_imports_run_one_way(&src, "crate", &CRATE);
    for (room, order) in [("io", &IO[..]), ("draw", &DRAW), ("studies", &STUDIES), ("view", &VIEW)] {
        module_order::assert_imports_run_one_way(&src.join(room), &format!("crate::{room}"), order);
    }
}
