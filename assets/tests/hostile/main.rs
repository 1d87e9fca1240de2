//! Robustness tests of the readers: damaged files, and files that change while they are read.

mod allocation;
mod changing;
mod damage;
mod fuzz;
#[path = "../../../tests/glb_file.rs"]
mod glb_file;
#[path = "../files/ksplat.rs"]
mod ksplat_file;
#[path = "../../../tests/numbers.rs"]
mod numbers;
#[path = "../../../tests/rad_file.rs"]
mod rad_file;
#[path = "../files/sog.rs"]
mod sog_file;
#[path = "../../../tests/spz_file.rs"]
mod spz_file;

/// Returns true for the long forms of tests (`./x test --long`).
fn long() -> bool {
    std::env::var_os("SPLATGRAPH_LONG").is_some()
}
