//! Checks that imports follow the order of the framework's folders.

use std::path::Path;

#[path = "../../tests/module_order.rs"]
mod module_order;

/// The modules, from the ground up. `lower` begins a plan, `link` adds its shaders, and `solve` the rest.
const ORDER: [&str; 14] = [
    "ir", "source", "plan", "expr", "schema", "lower", "shader", "link", "msl", "solve", "dump", "oracle",
    "reload", "build",
];

#[test]
fn every_module_imports_only_those_before_it() {
    module_order::assert_modules_run_one_way(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &ORDER);
}

#[test]
fn an_import_against_the_order_fails_with_file_line_and_both_modules() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("writable");
    write("low.rs", "//! See [`crate::high`].\nuse std::fmt;\n\nuse crate::{\n    high::Thing, low,\n};\n");
    write("high.rs", "use crate::low;\n#[cfg(test)]\nmod tests {\n    use crate::top;\n}\nuse super::low;\n");
    write("top.rs", "fn f() { crate::high::g() }\n");
    let failure = std::panic::catch_unwind(|| {
        module_order::assert_modules_run_one_way(folder.path(), &["low", "high", "top"]);
    });
    let message = *failure.expect_err("an import is wrong").downcast::<String>().expect("a text");
    let found: Vec<&str> = message.lines().skip(1).collect();
    assert_eq!(found, ["low.rs:4: names `crate::high::Thing`"]);
}

#[test]
fn a_circle_between_a_module_and_its_child_fails_and_names_that_are_passed_on_lead_to_their_file() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("high")).expect("writable");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("writable");
    write("high/mod.rs", "mod a;\nmod b;\npub use a::Thing;\nuse b::f;\n");
    write("high/a.rs", "pub struct Thing;\n");
    write(
        "high/b.rs",
        "use super::Thing;\nmod inner {\n    use super::*;\n}\n#[cfg(test)]\nmod tests {\n    use super::super::g;\n}\n",
    );
    module_order::assert_files_have_no_circle(folder.path());
    write("high/b.rs", "fn f() {\n    let _ = \"super::g\"; // super::g\n    super::g()\n}\n");
    let failure = std::panic::catch_unwind(|| module_order::assert_files_have_no_circle(folder.path()));
    let message = *failure.expect_err("there is a circle").downcast::<String>().expect("a text");
    let found: Vec<&str> = message.lines().skip(1).collect();
    assert_eq!(found, ["high/mod.rs:4: names `b::f`", "high/b.rs:3: names `super::g`"]);
}
