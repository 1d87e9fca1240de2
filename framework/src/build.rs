//! The way from a graph's name to a plan, in one call.

use std::collections::BTreeMap;

use crate::plan::{Plan, Value};
use crate::shader::ShaderCompiler;
use crate::source::{Diagnostic, SourceMap};
use crate::{check, lower, solve};

/// What is known of the scene, the device and the viewport, by full name: `scene.count`, `device.subgroup_size`, ...
pub type Facts = BTreeMap<String, Value>;

/// What a graph can import.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Catalog {
    /// Attributes of the scene, by full name.
    pub attributes: BTreeMap<String, Attribute>,
    /// Uniform blocks that the host writes for every frame, by full name, with their size in bytes.
    pub uniforms: BTreeMap<String, u64>,
    /// Storage buffers that come with every frame, by full name.
    pub buffers: BTreeMap<String, GivenBuffer>,
}

/// A storage buffer that comes with every frame: elements of `stride` bytes, `least` of them or more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GivenBuffer {
    pub stride: u64,
    pub least: u64,
}

/// An attribute of the scene: `planes` buffers of `count` elements of `stride` bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attribute {
    pub stride: u64,
    pub count: u64,
    pub planes: u32,
}

/// What to build.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// A preset's name or a file's path.
    pub graph: &'a str,
    /// Parameters that differ from their defaults, as texts; the last of a name wins.
    pub set: &'a [(String, String)],
    pub facts: &'a Facts,
    pub catalog: &'a Catalog,
    /// Lets resources that are never alive at the same time stand in the same memory. Without it every resource keeps its
    /// contents to the frame's end, so that it can be looked at after any pass.
    pub share_memory: bool,
}

/// Reads the graph, lowers it, compiles and checks its shaders, and solves for order and barriers. Errors come with the
/// place in the file that they are about; there is at least one in an `Err`.
pub fn build(
    request: &Request,
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Plan, Vec<Diagnostic>> {
    let flat = lower::lower(request, files)?;
    let checked = check::check(flat, request, files, compiler)?;
    solve::solve(checked, request.share_memory, files)
}
