//! The program `splatgraph`; see [`splatgraph::cli`].

fn main() -> std::process::ExitCode {
    // Shaders are compiled in a second process of this program.
    splatgraph_framework::shader::serve_if_asked();
    splatgraph::cli::main()
}
