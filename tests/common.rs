//! What the tests share: an opened device, the data folder, and whether the long runs are wanted.

use splatgraph_api::Device;
use splatgraph_vulkan::{Options, Validation, Vulkan};
use std::io::Write;
use std::path::PathBuf;

/// The CPU driver, with synchronization validation on.
pub fn device() -> Vulkan {
    let name = std::env::var("SPLATGRAPH_TEST_DEVICE").unwrap_or_else(|_| "llvmpipe".into());
    let options = Options { device: Some(name), validation: Validation::Synchronization };
    let device = Vulkan::open(&options)
        .unwrap_or_else(|e| panic!("the tests need lavapipe and the validation layers: {e}"));
    if let Ok(lanes) = std::env::var(EXPECTED_LANES) {
        let found = &device.info().facts["device.subgroup_size"];
        assert_eq!(found.to_string(), lanes, "the driver did not take the vector width");
    }
    device
}

/// Set in the processes that [`again_with_vectors_of`] starts.
const EXPECTED_LANES: &str = "SPLATGRAPH_EXPECT_LANES";

/// Fails if the validation layers had anything to say.
pub fn assert_silent(device: &mut dyn Device, what: &str) {
    let messages = device.take_messages();
    assert!(messages.is_empty(), "{what}: the validation layers say\n{}", messages.join("\n"));
}

/// The folder with `scenes/` and `golden/`, or `None` after saying so.
pub fn data(test: &str) -> Option<PathBuf> {
    let found = std::env::var_os("SPLATGRAPH_DATA").map(PathBuf::from);
    match found {
        Some(folder) => {
            assert!(folder.join("scenes").is_dir(), "SPLATGRAPH_DATA has no scenes/: {}", folder.display());
            Some(folder)
        }
        None => {
            // Not by `eprintln!`, which is kept back in tests that pass.
            let _ = writeln!(std::io::stderr(), "NOT RUN: {test} needs captured scenes; set SPLATGRAPH_DATA");
            None
        }
    }
}

/// Whether `./x test --long` asked for the whole cross products.
pub fn long() -> bool {
    std::env::var_os("SPLATGRAPH_LONG").is_some()
}

/// Runs a test of this binary again in a process of its own, where lavapipe has vectors of this many bits. The driver reads
/// the variable once, when it is loaded.
pub fn again_with_vectors_of(bits: u32, test: &str) {
    let output = std::process::Command::new(std::env::current_exe().expect("this program"))
        .args([test, "--exact", "--nocapture", "--include-ignored"])
        .env("LP_NATIVE_VECTOR_WIDTH", bits.to_string())
        .env(EXPECTED_LANES, (bits / 32).to_string())
        .output()
        .expect("the tests can run themselves");
    let text =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "with vectors of {bits} bits:\n{text}");
    assert!(text.contains("1 passed"), "the test did not run:\n{text}");
}
