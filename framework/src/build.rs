//! Builds a plan from a graph's name, in one call.

use crate::ir::Request;
use crate::plan::Plan;
use crate::shader::{CANCELLED, ShaderCompiler};
use crate::source::{Diagnostic, SourceMap};
use crate::{link, lower, solve};
use tracing::info_span;

/// Reads a graph, lowers it, compiles and links its shaders, and solves for order, memory and dependencies.
///
/// Errors point into the files; an `Err` holds at least one, and [`GraphErrors`](crate::source::GraphErrors) makes one
/// error of them. If the compiler is cancelled, the build fails with the message [`CANCELLED`].
///
/// ```
/// use splatgraph_framework::build;
/// use splatgraph_framework::ir::{Catalog, DeviceFacts, Request};
/// use splatgraph_framework::shader::Glslang;
/// use splatgraph_framework::source::{GraphErrors, Library, SourceMap};
///
/// # fn main() -> Result<(), GraphErrors> {
/// let graph = r#"Graph(version: 1, summary: "One colour", output: "image",
///     resources: { "image": Image(format: "rgba8", size: (64, 64)) },
///     passes: [Dispatch(name: "paint", shader: "paint.comp", size: Threads(64), bind: { "image": "image" })],
/// )"#;
/// let shader = "#version 460
///     layout(local_size_x = 64) in;
///     layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;
///     void main() {
///         for (int y = 0; y < 64; y++) imageStore(image, ivec2(gl_GlobalInvocationID.x, y), vec4(1.0));
///     }";
/// let memory = [("pipelines/paint.ron", graph), ("shaders/paint.comp", shader)];
/// let memory = memory.map(|(path, text)| (path.to_string(), text.to_string())).into();
/// let mut files = SourceMap::new(Library { memory, ..Library::default() });
///
/// let (facts, catalog) = (DeviceFacts::typical(32).into(), Catalog::default());
/// let request = Request::new("paint", &facts, &catalog);
/// let plan = build(&request, &mut files, &mut Glslang::default())
///     .map_err(|errors| GraphErrors::new(&files, &errors))?;
///
/// let passes: Vec<&str> = plan.frame.iter().map(|pass| plan.pass(*pass).name.as_str()).collect();
/// assert_eq!(passes, ["paint", "export"]);
/// # Ok(())
/// # }
/// ```
pub fn build(
    request: &Request,
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Plan, Vec<Diagnostic>> {
    build_candidate(request, None, files, compiler)
}

/// Builds a plan as [`build`] does, but of the graph at an index of [`lower::candidates`], if `candidate` is given.
///
/// An index beyond the end means the last graph.
pub fn build_candidate(
    request: &Request,
    candidate: Option<usize>,
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Plan, Vec<Diagnostic>> {
    let lowered = info_span!("lower the graph").in_scope(|| lower::lower(request, candidate, files))?;
    let linked = info_span!("link the shaders").in_scope(|| link::link(lowered, request, files, compiler))?;
    if compiler.is_cancelled() {
        let span = linked.lowered.output_span;
        return Err(vec![Diagnostic::new(CANCELLED, span, "")]);
    }
    info_span!("solve").in_scope(|| solve::solve(linked, request.share_memory, files))
}
