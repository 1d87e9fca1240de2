//! The program `splatgraph`. Everything that it does is in the library, under [`splatgraph::cli`].

fn main() -> std::process::ExitCode {
    splatgraph::cli::main()
}
