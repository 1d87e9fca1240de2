//! Starts the program `splatgraph`, which is in the library under [`splatgraph::cli`].

fn main() -> std::process::ExitCode {
    splatgraph::cli::main()
}
