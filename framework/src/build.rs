//! From a graph's name to a plan, in one call.

use crate::ir::Request;
use crate::plan::Plan;
use crate::shader::ShaderCompiler;
use crate::source::{Diagnostic, SourceMap};
use crate::{link, lower, solve};

/// Reads a graph, lowers it, compiles and links its shaders, and solves for order and barriers.
///
/// Errors point into the files; an `Err` holds at least one.
pub fn build(
    request: &Request,
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Plan, Vec<Diagnostic>> {
    let flat = lower::lower(request, files)?;
    let linked = link::link(flat, request, files, compiler)?;
    solve::solve(linked, request.share_memory, files)
}
