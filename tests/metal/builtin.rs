//! The Metal backend's own kernels and functions are valid, as C++ against the header of `tests/metal/`.
//!
//! The header declares what shaders use; the few additional calls for the window's images are declared here.

use super::clang;
use std::collections::BTreeSet;
use std::path::Path;

const SOURCE: &str = include_str!("../../backends/metal/src/apple/builtin.metal");

const BACKEND: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../backends/metal/src");

/// Declares texture queries, writes and sampling, after Apple's "Metal Shading Language Specification", 6.12.
const WINDOW: &str = "
#include <metal_stdlib>
namespace metal {
struct sampler {};
template<typename T, access A = access::sample> struct window_texture {
    uint get_width() const;
    uint get_height() const;
    void write(vec<T, 4> colour, uint2 at) const;
    vec<T, 4> sample(sampler pixels, float2 at) const;
};
}
#define texture2d window_texture
";

#[test]
fn the_backends_own_kernels_are_valid_cpp() {
    let text = format!("{WINDOW}{SOURCE}");
    if let Err(messages) = clang::check_text(&text) {
        panic!("{messages}");
    }
    // The compiler must reject a value of the wrong type.
    let wrong = text.replace("target.write(uint4(0), pixel)", "target.write(pixel, uint4(0))");
    assert_ne!(wrong, text);
    assert!(clang::check_text(&wrong).is_err());
}

fn named(folder: &Path) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in std::fs::read_dir(folder).expect("the backend's source").flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(named(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            let text = std::fs::read_to_string(&path).expect("a source file");
            for call in ["kernel(\"", "function(&library, \""] {
                let names = text.split(call).skip(1).filter_map(|rest| rest.split('"').next());
                found.extend(names.map(String::from));
            }
        }
    }
    found
}

fn written() -> BTreeSet<String> {
    let starts = |line: &&str| ["kernel ", "vertex ", "fragment "].iter().any(|word| line.starts_with(word));
    let name = |line: &str| Some(line.split_once('(')?.0.rsplit(' ').next()?.to_string());
    SOURCE.lines().filter(starts).filter_map(name).collect()
}

#[test]
fn the_backend_finds_every_function_that_it_names() {
    let (named, written) = (named(Path::new(BACKEND)), written());
    assert!(named.contains("fill_words") && named.contains("show_pixel"), "{named:?}");
    assert_eq!(named, written, "the backend names the first, and `builtin.metal` has the second");
}
