//! Runs a test of this binary again, in its own process. The Vulkan backend's tests use it too.

use std::io::Write;
use std::process::Command;

/// Runs a test again with these environment variables. Returns whether it passed, and its output.
pub fn again(test: &str, set: &[(&str, &str)]) -> (bool, String) {
    let output = Command::new(std::env::current_exe().expect("this program"))
        .args([test, "--exact", "--nocapture", "--include-ignored"])
        .envs(set.iter().copied())
        .output()
        .expect("the tests can run themselves");
    if output.status.success() {
        // Shows what the test reports, such as NOT RUN lines.
        let _ = std::io::stderr().write_all(&output.stderr);
    }
    let [text, errors] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    (output.status.success(), format!("{text}{errors}"))
}

/// Runs a test again with these environment variables; it must pass. `place` describes the process. Returns its output.
pub fn passes_again(place: &str, test: &str, set: &[(&str, &str)]) -> String {
    let (passed, text) = again(test, set);
    assert!(passed, "{place}:\n{text}");
    assert!(text.contains("1 passed"), "{place}, the test did not run:\n{text}");
    text
}

/// Environment variable that makes the validation layer compare submissions with earlier ones. The layer reads it when
/// an instance is created.
const COMPARES: (&str, &str) =
    ("VK_LAYER_ENABLES", "VALIDATION_CHECK_ENABLE_SYNCHRONIZATION_VALIDATION_QUEUE_SUBMIT");

/// Returns true in a process started by [`again_comparing_submissions`].
pub fn compares_submissions() -> bool {
    std::env::var(COMPARES.0).is_ok_and(|value| value == COMPARES.1)
}

/// Runs a test again with the validation layer comparing submissions, unless this process already does.
pub fn again_comparing_submissions(test: &str) {
    if !compares_submissions() {
        passes_again("where submissions are compared", test, &[COMPARES]);
    }
}
