//! A shader compiler in a separate process, for texts that crash it: the test program, running only the test that
//! serves.

use splatgraph_framework::shader::{Glslang, Limits, Worker, serve_if_asked};

pub fn compiler(limits: Limits) -> Glslang {
    let program = std::env::current_exe().expect("this program");
    let test = "worker::the_worker_of_the_other_tests_serves_when_it_is_asked";
    let arguments = ["--exact", test, "--nocapture"].map(Into::into).into();
    Glslang::in_worker(Worker { program, arguments, limits })
}

/// Serves in the worker's process; does nothing in the process that runs all tests.
#[test]
fn the_worker_of_the_other_tests_serves_when_it_is_asked() {
    serve_if_asked();
}
