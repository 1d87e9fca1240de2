//! Starts the program `splatgraph`, which is in the library under [`splatgraph::cli`].

fn main() -> std::process::ExitCode {
    // Shaders are compiled in a second process of this program.
    splatgraph_framework::shader::serve_if_asked();
    splatgraph::cli::main()
}
