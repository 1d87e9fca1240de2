//! Checks that the imports of the application run one way.

use std::path::Path;

#[path = "../../tests/module_order.rs"]
mod module_order;

/// The modules of the crate, from the ground up.
const CRATE: [&str; 36] = [
    "numbers",
    "output",
    "folders",
    "backend",
    "image",
    "report",
    "progress",
    "camera",
    "camera_path",
    "orbit",
    "pick",
    "demo",
    "metrics",
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
    "trade",
    "bench",
    "sweep",
    "advise",
    "experiment",
    "popping",
    "view",
    "lsp",
    "cli",
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
    module_order::assert_imports_run_one_way(&src.join("view"), "crate::view", &VIEW);
}
